"""Velocities and accelerations projected onto constraints that turn or move, where nothing damps the rest."""

import numpy as np
import pytest
from effect_scenes import CANTILEVER, line_model, scene_of
from mpi4py import MPI
from runs import full_model, quick_return, samples

from pgmp_petsc.effects import driven
from pgmp_petsc.models import FullModel
from pgmp_petsc.stepping.generalised_alpha import integrate
from pgmp_petsc.stepping.second_order_system import State

RUN = ("simulation.duration=0.05", "simulation.step=1e-3")


def turning(radius: float) -> FullModel:
    """Return a quick-return, whose pin slides along a line that turns with a flexible body."""
    return full_model(quick_return(*RUN, f"simulation.spectral_radius={radius}"))


def moving(radius: float) -> FullModel:
    """Return a beam clamped to a hub that swings."""
    swing = 'effects.hold={type="prescribed_motion", coordinate="theta", harmonic={amplitude=0.5, frequency_hz=4.0}}'
    run = "simulation={duration=0.05, step=1e-3}"
    return line_model(scene_of(CANTILEVER, "", swing, run, f"simulation.spectral_radius={radius}"))


def last(model: FullModel) -> tuple[float, float]:
    """Return the largest rate of the constraints at the end, and how far accelerations are from those that follow."""
    system = model.batch(samples(model.scene, 1), 1)
    state = integrate(system, model.scene.simulation).state
    constraints, sources = system._equations.constraints, system._sources  # noqa: SLF001
    now = driven(sources.motions, model.scene.simulation.duration)
    q, v, a = (system.unpack(part) for part in (state.q, state.v, state.a))
    against = np.abs(constraints.rates(q, v, now.speed)).max()
    # C a = -(dC/dt) v + c_tt
    missing = constraints.rates(q, a, np.zeros_like(now.speed)) + constraints.drift(q, v, now.acceleration)
    return float(against / np.abs(v).max()), float(np.abs(missing).max() / np.abs(a).max())


@pytest.mark.parametrize("make", [turning, moving])
def test_without_numerical_damping_velocities_obey_the_constraints(make) -> None:
    velocity, acceleration = last(make(1.0))
    # round-off: a projection of v is the difference of accelerations over a step
    assert velocity < 1e-10 and acceleration < 1e-10


@pytest.mark.parametrize("make", [turning, moving])
def test_the_scheme_by_itself_leaves_them_where_it_damps_them(make) -> None:
    velocity, acceleration = last(make(0.9))
    assert velocity > 1e-8 and acceleration > 1e-8


@pytest.mark.parametrize("make", [turning, moving])
def test_a_sample_that_ranks_could_share_does_the_same(make) -> None:
    model, found = make(1.0), []
    for system in (model.batch(samples(model.scene, 1), 1), model.distributed(model.scene.values, MPI.COMM_SELF)):
        places = []

        def observe(number: int, time: float, state: State, system=system, places=places) -> None:
            places.append(system.unpack(state.q)[:, 0].copy())

        integrate(system, model.scene.simulation, observer=observe)
        system.close()
        found.append(np.array(places))
    assert np.ptp(found[0], axis=0).max() > 1e-2
    # Newton's iteration stops at 1e-12, and other factors round otherwise
    np.testing.assert_allclose(found[1], found[0], rtol=0, atol=1e-8 * np.abs(found[0]).max())
