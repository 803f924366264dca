"""Candidates in the order of their cost, and the search for the first that is good enough."""

from __future__ import annotations

import pytest
from scenes import kinematics_of, slider_crank

from pgmp_petsc.selection.ladder import MODES, Limits, families_of, first_passing, nearest, operations

PAPER = Limits(n_modes=30, n_static=1, n_terms=3)


@pytest.mark.parametrize("start", [0, 3, 8, 20])
@pytest.mark.parametrize("first", range(10))
def test_the_first_that_passes_is_found_wherever_the_search_begins(first: int, start: int) -> None:
    asked: list[int] = []

    def passes(k: int) -> bool:
        asked.append(k)
        return k >= first

    assert first_passing(9, passes, start) == (first if first < 9 else None)
    assert len(asked) == len(set(asked)) <= 8, "nothing is asked twice"


def test_a_search_without_progress_ends() -> None:
    asked: list[int] = []

    def passes(k: int) -> bool:
        asked.append(k)
        return False

    assert first_passing(12, passes, 2, lambda before, now: True) is None
    assert asked == [2, 3, 5]


def test_limits_of_the_slider_crank() -> None:
    scene = slider_crank()
    assert Limits.of(scene, kinematics_of(scene)) == PAPER
    without = slider_crank("effects={}")
    assert Limits.of(without, kinematics_of(without)).n_static == 0


def test_costs_rise_along_a_family_and_from_one_to_the_next() -> None:
    plain, curved = families_of({}, PAPER)
    for family in (plain, curved):
        assert [rung.cost for rung in family] == sorted(rung.cost for rung in family)
        assert [rung.entries["modes"] for rung in family] == [n for n in MODES if n < 29] + [29], "one is the static mode"
        assert all(rung.entries["static_modes"] for rung in family)
    assert all(two.cost > one.cost for one, two in zip(plain, curved))
    assert [rung.entries["second_order"] for rung in (plain[0], curved[0])] == [False, True]


def test_the_cost_of_terms_of_second_order_grows_with_the_third_power() -> None:
    assert operations(16, 3, True) / operations(8, 3, True) > 5
    assert operations(16, 3, False) / operations(8, 3, False) < 4.5


def test_what_is_given_is_kept() -> None:
    (family,) = families_of({"second_order": True, "modes": 11}, PAPER)
    assert [rung.entries for rung in family] == [{"modes": 11, "static_modes": True, "second_order": True}]
    plain, _ = families_of({"static_modes": False}, PAPER)
    assert plain[-1].entries == {"modes": 30, "static_modes": False, "second_order": False}
    no_load, _ = families_of({}, Limits(5, 0, 2))
    assert [rung.entries["modes"] for rung in no_load] == [1, 2, 3, 4, 5]
    assert not any(rung.entries["static_modes"] for rung in no_load)


def test_a_large_mesh_is_not_climbed_to_the_top() -> None:
    plain, _ = families_of({}, Limits(3000, 1, 3))
    assert plain[-1].entries["modes"] == MODES[-1]


def test_a_mesh_without_room_beside_the_static_modes() -> None:
    assert families_of({}, Limits(1, 1, 1)) == [[], []]


def test_nearest() -> None:
    assert nearest((1, 2, 4, 8), 7) == 3
    assert nearest((1, 2, 4, 8), 2.4) == 1
