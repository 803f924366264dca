"""What candidates are predicted to take, and which of them are too dear."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pgmp_petsc.bench.candidates import MOST_BYTES, SHARE, CandidatePrices, Limits, families_of
from pgmp_petsc.mechanism.mechanism import Mechanism
from scenes import meshes_of, slider_crank

LIMITS = Limits(n_modes=30, n_static=1, n_terms=3)


def prices(n_steps: int = 1000, angles: int = 96, n_unknowns: int = 36) -> CandidatePrices:
    return CandidatePrices(n_unknowns, 3, 1, 5e-6, n_steps, angles)


def test_prices_rise_along_a_family_with_steps_and_with_angles() -> None:
    for family in families_of({}, LIMITS):
        seconds = [prices().seconds(rung) for rung in family]
        assert seconds == sorted(seconds)
        assert all(prices(n_steps=10_000).seconds(rung) > prices().seconds(rung) for rung in family)
        assert all(prices(angles=192).bytes(rung) == 2.0 * prices().bytes(rung) for rung in family)


def test_configurations_take_more_with_unknowns_and_with_what_is_built_beside_the_modes() -> None:
    plain, extended, second, _ = (family[4] for family in families_of({}, replace(LIMITS, uncertain=True))[:4])
    idle = prices(n_steps=0)
    assert prices(n_steps=0, n_unknowns=72).seconds(plain) == pytest.approx(2.0 * idle.seconds(plain))
    assert extended.entries["parameter_modes"] and idle.seconds(extended) == pytest.approx(2.0 * idle.seconds(plain))
    assert 2.0 * idle.seconds(plain) < idle.seconds(second) < 3.0 * idle.seconds(plain)
    assert idle.seconds(plain, 48) == pytest.approx(0.5 * idle.seconds(plain))


def test_nothing_is_left_out_where_the_budget_has_no_end() -> None:
    families = families_of({}, LIMITS)
    assert prices().affordable(families, np.inf) == (families, "")


@pytest.mark.parametrize("budget", [1.0, 5.0, 10.0])
def test_what_stays_is_within_the_share_of_the_budget(budget: float) -> None:
    families = families_of({}, LIMITS)
    kept, said = prices().affordable(families, budget)
    assert len(kept) == len(families) and said
    for family, rest in zip(families, kept):
        assert rest == family[: len(rest)] and rest, "the cheapest stays in any case"
        assert all(prices().seconds(rung) <= SHARE * budget for rung in rest[1:])
    assert f"reference.budget = {budget:g} s" in said


def test_tables_beyond_the_memory_are_left_out_whatever_the_budget() -> None:
    large = prices(angles=768, n_unknowns=3000)
    kept, said = large.affordable(families_of({}, LIMITS), np.inf)
    assert all(large.bytes(rung) <= MOST_BYTES for family in kept for rung in family)
    assert "MB" in said and len(kept[2]) < len(families_of({}, LIMITS)[2])


def test_the_size_of_tables_is_that_of_a_built_model() -> None:
    """Of 12 angles with 40 coordinates of beams in space 63 MB were measured."""
    (family,) = families_of({"modes": 28, "second_order": True, "stretching": "dynamic"}, Limits(40, 12, 3))
    of_space = CandidatePrices(120, 3, 1, 3.5e-5, 1000, 12)
    assert family[0].n_flexible == 40
    assert of_space.bytes(family[0]) == pytest.approx(63e6, rel=0.5)


def test_local_effects_cost_steps() -> None:
    damping = 'effects.bearing={type="joint_damping",joint="elbow",coefficient=0.1}'
    plain, damped = (
        CandidatePrices.of(Mechanism.from_scene(scene, meshes_of(scene)), LIMITS, 1000, 96)
        for scene in (slider_crank(), slider_crank(damping))
    )
    assert damped.step > plain.step and damped.n_unknowns == plain.n_unknowns
