"""Candidates in the order of their cost, what they are predicted to take, and the search for the first good enough."""

from dataclasses import replace

import numpy as np
import pytest

from pgmp_petsc.bench.candidates import (
    MODES,
    MOST_BYTES,
    SHARE,
    CandidatePrices,
    Limits,
    by_distance_from_middle,
    families_of,
    first_passing,
)
from scenes import kinematics_of, slider_crank

PAPER = Limits(n_modes=30, n_static=1, n_terms=3)
UNCERTAIN = Limits(n_modes=30, n_static=1, n_terms=3, uncertain=True)
PLAIN = {"inertia_modes": False, "parameter_modes": 0}


@pytest.mark.parametrize("start", [0, 3, 8, 20])
@pytest.mark.parametrize("first", range(10))
def test_the_first_that_passes_is_found_wherever_the_search_begins(first: int, start: int) -> None:
    asked: list[int] = []

    def passes(k: int) -> bool:
        asked.append(k)
        return k >= first

    assert first_passing(9, passes, start) == (first if first < 9 else None)
    assert len(asked) == len(set(asked)) <= 8, "nothing is asked twice"


@pytest.mark.parametrize(
    ("start", "useful", "probes"),
    [(2, 0, [2, 3, 5]), (0, 3, [0, 1, 3, 7])],  # candidates 1 and 3 help, 7 no more than 3: nor do those between
)
def test_a_search_without_progress_ends(start: int, useful: int, probes: list[int]) -> None:
    asked: list[int] = []

    def passes(k: int) -> bool:
        asked.append(k)
        return False

    assert first_passing(12, passes, start, lambda before, now: now > useful) is None
    assert asked == probes


def test_limits_of_the_slider_crank() -> None:
    scene = slider_crank()
    assert Limits.of(scene, kinematics_of(scene)) == PAPER
    without = slider_crank("effects={}")
    assert Limits.of(without, kinematics_of(without)).n_static == 0


def test_costs_rise_along_a_family_and_from_one_to_the_next() -> None:
    plain, curved, _ = families_of(PLAIN, PAPER)
    for family in (plain, curved):
        assert [rung.cost for rung in family] == sorted(rung.cost for rung in family)
        # one is the static mode
        assert [rung.entries["modes"] for rung in family] == [n for n in MODES if n < 29] + [29]
        assert all(rung.entries["static_modes"] for rung in family)
    assert all(two.cost > one.cost for one, two in zip(plain, curved))
    assert [rung.entries["second_order"] for rung in (plain[0], curved[0])] == [False, True]


def test_what_is_given_is_kept() -> None:
    (family,) = families_of({"second_order": True, "modes": 11, "stretching": "static"} | PLAIN, PAPER)
    kept = {"modes": 11, "static_modes": True, "second_order": True, "stretching": "static"}
    assert [rung.entries for rung in family] == [kept | PLAIN]
    plain, *_ = families_of({"static_modes": False} | PLAIN, PAPER)
    kept = {"modes": 30, "static_modes": False, "second_order": False, "stretching": "dynamic"}
    assert plain[-1].entries == kept | PLAIN
    no_load, *_ = families_of(PLAIN, Limits(5, 0, 2))
    assert [rung.entries["modes"] for rung in no_load] == [1, 2, 3, 4, 5]
    assert not any(rung.entries["static_modes"] for rung in no_load)
    # a large mesh is not climbed to the top, and one without room beside the static modes has no rung
    assert families_of({}, Limits(3000, 1, 3))[0][-1].entries["modes"] == MODES[-1]
    assert families_of({}, Limits(1, 1, 1)) == [[]]


def test_slender_bodies_follow_their_shortening_at_once_or_by_coordinates() -> None:
    def kinds(given: dict, limits: Limits) -> list[str]:
        return [family[0].entries["stretching"] for family in families_of(given | PLAIN, limits)]

    assert kinds({}, PAPER) == ["dynamic", "static", "dynamic"], "without terms of second order nothing is followed"
    assert kinds({}, replace(PAPER, slender=False)) == ["dynamic", "dynamic"]
    assert kinds({"stretching": "dynamic"}, PAPER) == ["dynamic", "dynamic"]


def test_other_vectors_come_on_top_of_the_modes_that_bodies_of_cells_are_condensed_for() -> None:
    cells = Limits(n_modes=100, n_static=2, n_terms=3, n_condensed=10)
    plain, extended, *others = families_of({}, cells)
    assert [family[-1].entries["modes"] for family in (plain, extended, *others)] == [10] * 6
    assert (plain[-1].n_flexible, extended[-1].n_flexible) == (12, 13)
    with_modes = families_of({"modes": 10}, cells)
    kinds = [family[0].entries["stretching"] for family in with_modes]
    assert kinds == [*["dynamic"] * 2, *["static"] * 2, *["dynamic"] * 2], "given modes leave room for every family"
    assert "condensed for 10 modes" in cells.last_mode and "meshes" in PAPER.last_mode


def test_the_middle_is_of_seven_coordinates_or_eight() -> None:
    plain, extended, *_ = families_of({}, UNCERTAIN)
    assert [by_distance_from_middle(family)[0].n_flexible for family in (plain, extended)] == [8, 7]
    assert [rung.n_flexible for rung in by_distance_from_middle(plain)[:4]] == [8, 6, 5, 11], "some of both sides"
    assert by_distance_from_middle(plain[:2])[0] is plain[1]


def test_few_vectors_extend_a_basis_where_a_parameter_is_uncertain() -> None:
    entries = [family[0].entries for family in families_of({}, UNCERTAIN)]
    kinds = [(entry["inertia_modes"], entry["parameter_modes"], entry["second_order"]) for entry in entries]
    assert kinds == [(with_few, 2 * with_few, curved) for curved in (False, True, True) for with_few in (False, True)]
    assert [family[0].entries["parameter_modes"] for family in families_of({}, PAPER)] == [0] * 6
    assert [family[0].entries["parameter_modes"] for family in families_of({"modes": 28}, UNCERTAIN)] == [0] * 3
    assert len(families_of({"inertia_modes": True, "parameter_modes": 1}, UNCERTAIN)) == 3


def prices(n_steps: int = 1000, angles: int = 96, n_unknowns: int = 36) -> CandidatePrices:
    return CandidatePrices(n_unknowns, 3, 1, 5e-6, n_steps, angles)


@pytest.mark.parametrize("budget", [1.0, 5.0, 10.0])
def test_what_stays_is_within_the_share_of_the_budget(budget: float) -> None:
    families = families_of({}, PAPER)
    kept, said = prices().affordable(families, budget)
    assert len(kept) == len(families) and said
    for family, rest in zip(families, kept):
        assert rest == family[: len(rest)] and rest, "the cheapest stays in any case"
        assert all(prices().seconds(rung) <= SHARE * budget for rung in rest[1:])
    assert f"reference.budget = {budget:g} s" in said


def test_tables_beyond_the_memory_are_left_out_whatever_the_budget() -> None:
    large = prices(angles=768, n_unknowns=3000)
    kept, said = large.affordable(families_of({}, PAPER), np.inf)
    assert all(large.bytes(rung) <= MOST_BYTES for family in kept for rung in family)
    assert "MB" in said and len(kept[2]) < len(families_of({}, PAPER)[2])


def test_the_size_of_tables_is_that_of_a_built_model() -> None:
    """Of 12 angles with 40 coordinates of beams in space 63 MB were measured."""
    (family,) = families_of({"modes": 28, "second_order": True, "stretching": "dynamic"}, Limits(40, 12, 3))
    of_space = CandidatePrices(120, 3, 1, 3.5e-5, 1000, 12)
    assert family[0].n_flexible == 40
    assert of_space.bytes(family[0]) == pytest.approx(63e6, rel=0.5)
