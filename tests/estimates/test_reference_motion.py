"""The motion of all unknowns behind a reduced state, its velocities and its accelerations."""

import numpy as np
import pytest
from runs import paper_scene, reduced_model

import pgmp_petsc.estimates.reference_motion as module
from pgmp_petsc.estimates.checking_model import CheckingModel
from pgmp_petsc.estimates.reference_motion import ReferenceMotion
from pgmp_petsc.models import ReducedModel


@pytest.fixture(scope="module")
def model() -> ReducedModel:
    return reduced_model(paper_scene("reduction.modes=4", "reduction.angles=24", 'reduction.interpolation="spline"'))


def states_of(model: ReducedModel, n_instants: int = 6, n_samples: int = 3, bent: float = 1.0) -> np.ndarray:
    """Return made-up states, (n_instants, 4, n_samples, n_eta): speeds from rest to fast, and bending of 1e-4 m."""
    states = np.random.default_rng(1).normal(size=(n_instants, 4, n_samples, 1 + model.terms.tables.n_modes))
    states[..., 1:] *= bent * 1e-5
    states[:, 1] *= np.linspace(0.0, 30.0, n_instants)[:, None, None]
    states[:, 2] *= 50.0
    states[:, 3] *= 1e-3
    return states


def motion_of(model: ReducedModel, states: np.ndarray) -> ReferenceMotion:
    checking = CheckingModel(model)
    n_dofs = checking.full.kinematics.mechanism.n_dofs
    return ReferenceMotion(checking.unknowns_of, n_dofs, states, 1, np.full(3, 3e-3), checking.rotations)


@pytest.mark.parametrize("turning", [0.0, 5.0])
def test_accelerations_of_bodies_that_are_shaken_hard(turning: float) -> None:
    """Loads that bend bodies at once lead not off the path: J eta'' + d^2 q / d tau^2 along eta', of second order."""
    basis = ("reduction.modes=4", "reduction.angles=24", 'reduction.interpolation="spline"')
    model = reduced_model(paper_scene(*basis, "reduction.second_order=true"))
    states = states_of(model)
    states[:, 1, :, 0] = turning
    states[:, 2, :, 0] = 1e3
    states[:, 2, :, 1:] *= 1e9
    motion = motion_of(model, states)
    checking = CheckingModel(model)

    def unknowns(eta: np.ndarray) -> np.ndarray:
        return checking.unknowns_of(eta[None])[:, 0]

    rotations = checking.rotations
    tau = module.TURN / np.sqrt(module.TURN * 1e3 + turning**2)
    assert np.max(tau**2 * np.abs(states[:, 2, :, 1:]) @ rotations) > 30.0
    for number, (q, v, a, _) in enumerate(states):
        far = 1e-3 / np.abs(a[:, 1:] @ np.diag(rotations)).sum(axis=1)
        pushed = (unknowns(q + far[:, None] * a) - unknowns(q - far[:, None] * a)) / (2.0 * far)
        curved = (unknowns(q + 1e-4 * v) - 2.0 * unknowns(q) + unknowns(q - 1e-4 * v)) / 1e-8
        scale = np.abs(pushed).max()
        # BEND by which bodies bend on the path, times the turn meanwhile, 1e-4 rad; the mechanism's turn alone sets
        # a path on which it is 0.03 to 3
        np.testing.assert_allclose(motion.at(number).a, pushed + curved, rtol=0, atol=5e-5 * scale)


def test_instants_do_not_depend_on_what_is_computed_together(model: ReducedModel, monkeypatch) -> None:
    states = states_of(model)
    together = motion_of(model, states)
    expected = [together.at(number) for number in range(len(states))]
    monkeypatch.setattr(module, "LARGEST", 1)
    alone = motion_of(model, states)
    for number in (0, 1, 5, 2):
        np.testing.assert_array_equal(alone.at(number).q, expected[number].q)
        np.testing.assert_allclose(alone.at(number).a, expected[number].a, rtol=1e-12)
    np.testing.assert_array_equal(alone.over(1, 4)[0], [expected[number].q for number in range(1, 5)])
    np.testing.assert_array_equal(alone.over(3, 2)[2], alone.over(2, 4)[2, 1:3])
