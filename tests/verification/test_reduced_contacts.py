"""Edges of laws in batches of the reduced model: lanes search them by themselves, in compiled code."""

from functools import cache

import numpy as np
import pytest
from runs import reduced_model, samples, watched

from pgmp_petsc.effects.joint_effects import STOP as STOPS
from pgmp_petsc.effects.law import Law
from pgmp_petsc.models import ReducedModel
from pgmp_petsc.reduced.system import ReducedSystem
from pgmp_petsc.stepping import generalised_alpha
from pgmp_petsc.stepping.generalised_alpha import Run
from pgmp_petsc.stepping.second_order_system import SecondOrderSystem
from pgmp_petsc.stepping.status import Outcome, Status
from scenes import slider_crank

MODES = (
    "reduction.modes=3", "reduction.static_modes=true", "reduction.angles=24", 'reduction.interpolation="spline"',
    "simulation.step=1e-3", "simulation.duration=0.2",
)  # fmt: skip
STOP = 'effects.stop={type="end_stop",joint="slider",lower=0.94,upper=0.97,stiffness="k",damping=0.2}'
STIFFNESS = "parameters.k={nominal=2e4}"
# loads of every kind, a table with a corner among them, of which the search has to know what they are within a step
SCENES = {
    "loads": (STOP, STIFFNESS,
        'effects.jet={type="force",point="rod:1",direction=[0.0,1.0],follows=true,harmonic={amplitude=4.0,frequency_hz=30.0}}',
        'effects.push={type="force",point="rod:tip",direction=[1.0,0.0],harmonic={amplitude=9.0,frequency_hz=11.0}}',
        'effects.rub={type="joint_friction",joint="slider",limit=1.0,speed=0.05}',
        "effects.motor.table=[[0.0,0.0],[0.0512,1.5],[0.1024,-1.5],[1.0,-1.5]]",
        "simulation.initial.theta.position=0.5", "simulation.initial.theta.velocity=-2.0",),
    "drive": ('effects={extra={type="prescribed_motion",coordinate="theta",'
        "harmonic={amplitude=0.12,frequency_hz=10.0,mean=0.5}}}",
        STOP, "parameters.k={nominal=3e3}", "simulation.initial={}",),
}  # fmt: skip
# the range ends just behind a soft stop
NARROW = (
    "coordinates.theta={joint='crank_hinge',range=[-0.2,0.5]}", "parameters.k={nominal=1.0}",
    "effects={stop={type='end_stop',joint='crank_hinge',upper=0.4999,stiffness='k'}}",
    "simulation.initial.theta={position=0.2,velocity=5.0}",
)  # fmt: skip
N = 11  # two blocks of lanes
RADII, FACTORS = np.linspace(5.0e-3, 6.0e-3, N), np.geomspace(0.5, 2.0, N)


@cache
def model_of(name: str) -> ReducedModel:
    """Return a reduced model; made once."""
    return reduced_model(slider_crank(*MODES, *(SCENES | {"range": NARROW})[name]))


def values_of(model: ReducedModel, chosen: np.ndarray) -> dict[str, np.ndarray]:
    """Return the values of some of N samples, by their numbers."""
    stiffness = model.scene.values["k"] * FACTORS[chosen]
    return samples(model.scene, chosen.size, r1=RADII[chosen], k=stiffness)


class OneByOne:
    """A system that does not step by itself: `EventLocation` finds its edges, one sample after the other."""

    def __init__(self, system: ReducedSystem) -> None:
        self._system = system

    def __getattr__(self, name: str) -> object:
        return getattr(self._system, name)

    steps_at_once, advance, take_steps = 1, SecondOrderSystem.advance, SecondOrderSystem.take_steps


def motion_of(
    model: ReducedModel, values: dict[str, np.ndarray], one_by_one: bool = False
) -> tuple[np.ndarray, np.ndarray, Run]:
    """Return coordinates (n_t, n, n_eta) and depths (n_t, n_events, n) after all steps, and the run."""
    system = model.batch(values, next(iter(values.values())).size)
    steps = OneByOne(system) if one_by_one else system
    run, states = watched(steps, model.scene.simulation, lambda time, state: (time, state.copy()))
    everyone = np.ones(system.n_samples, dtype=bool)
    depths = np.concatenate([system.depths(np.array([time]), state.alone, everyone) for time, state in states])
    return np.array([state.q for _, state in states]), depths, run


@pytest.mark.parametrize("name", SCENES)
def test_edges_are_found_where_they_are_found_one_sample_at_a_time(name: str) -> None:
    model = model_of(name)
    chosen = np.array([0, 4, 10])
    found, depths, run = motion_of(model, values_of(model, chosen))
    expected, _, other = motion_of(model, values_of(model, chosen), one_by_one=True)
    assert not run.status.any() and not other.status.any()
    reached = np.count_nonzero(np.diff(depths > 0.0, axis=0), axis=0)
    assert (reached.sum(axis=0) >= 4).all(), "stops are entered and left"
    # what may remain of Newton's iteration is 1e-11 in a step of the one and 1e-12 in the other, and some 1e2 times as
    # much after 200 steps with contacts
    np.testing.assert_allclose(found, expected, rtol=0, atol=2e-8)


def test_a_search_is_worth_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without it samples are elsewhere, far beyond the tolerance above."""
    model = model_of("loads")
    values = values_of(model, np.array([0, 4, 10]))
    found = motion_of(model, values)[0]
    for name, value in vars(Law("unsearched", STOPS.parameters, STOPS.force, STOPS.potential)).items():
        monkeypatch.setitem(vars(STOPS), name, value)
    for name in ("code", "address"):
        monkeypatch.delitem(vars(STOPS), name)
    system = model.batch(values, 3)
    assert not system.n_events
    _, states = watched(system, model.scene.simulation, lambda time, state: state.q.copy())
    assert np.abs(np.array(states) - found).max(axis=(0, 2)).min() > 1e-5


@pytest.mark.parametrize("name", SCENES)
def test_no_number_depends_on_neighbours_or_on_the_steps_of_a_call(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Bit for bit: alone, among others, in another order, and however many steps are taken in a call."""
    model = model_of(name)
    everyone = np.arange(N)
    together, _, run = motion_of(model, values_of(model, everyone))
    assert not run.status.any()
    for at_once in (1, 7):
        monkeypatch.setattr(generalised_alpha, "MOST_AT_ONCE", at_once)
        np.testing.assert_array_equal(motion_of(model, values_of(model, everyone))[0], together)
    monkeypatch.undo()
    np.testing.assert_array_equal(motion_of(model, values_of(model, everyone[::-1]))[0][:, ::-1], together)
    for sample in (0, 3, N - 1):
        alone = motion_of(model, values_of(model, everyone[[sample]]))[0]
        np.testing.assert_array_equal(alone[:, 0], together[:, sample])


# nominal or nearly, stiffer than steps resolve, and so stiff that Newton's iteration fails for good where round-off
# leaves it behind the edge: of several for one at least
STIFFER = {
    "loads": (2e4, 3e6, 1.7e4, *np.geomspace(1e13, 1e15, 21)), "drive": (3e3, 10**10.5, 2.5e3, 1e16, 2e16),
}  # fmt: skip


@pytest.mark.parametrize("name", SCENES)
def test_what_a_lane_cannot_do_by_itself_is_done_with_care(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where Newton's iteration fails within parts of a step it is tried again outside: nobody else's business."""
    model, stiffness, outcomes = model_of(name), np.array(STIFFER[name]), set()
    n, fine = stiffness.size, stiffness < 1e12
    advance = ReducedSystem.advance

    def recorded(system: ReducedSystem, *arguments: object) -> object:
        found = advance(system, *arguments)
        outcomes.update((sample, Outcome(int(outcome))) for sample, outcome in enumerate(found[0]))
        return found

    with monkeypatch.context() as patched:
        patched.setattr(ReducedSystem, "advance", recorded)
        together, _, run = motion_of(model, samples(model.scene, n, k=stiffness))
    assert (run.status[fine] == Status.FINE).all() and (run.status[~fine] != Status.FINE).any()
    given_up = Outcome.CROSSED if name == "drive" else Outcome.LOST  # within a search, or in a step as a whole
    assert {(sample, given_up) for sample in np.flatnonzero(~fine)} & outcomes
    for sample in np.flatnonzero(fine):
        alone, _, _ = motion_of(model, samples(model.scene, 1, k=stiffness[[sample]]))
        np.testing.assert_array_equal(alone[:, 0], together[:, sample])
    if name == "loads":
        expected, _, _ = motion_of(model, samples(model.scene, 1, k=stiffness[[1]]), one_by_one=True)
        # the force of a stop 150 times as stiff makes as much more of what remains of Newton's iteration
        np.testing.assert_allclose(together[:, 1], expected[:, 0], rtol=0, atol=3e-6)


def test_a_sample_that_leaves_the_range_within_a_search_stands_where_it_was() -> None:
    """It enters a stop and leaves the range in one step, as it does one sample at a time."""
    model = model_of("range")
    values = values_of(model, np.arange(N))
    found, depths, run = motion_of(model, values)
    np.testing.assert_array_equal(run.status, Status.LEFT_RANGE)
    failed = np.rint(run.failure_time / model.scene.simulation.step).astype(int)
    assert (depths[failed - 1, 0, np.arange(N)] < 0.0).all(), "before the step the stop is not entered"
    for sample, last in enumerate(failed):
        assert (found[last:, sample] == found[last - 1, sample]).all()
    expected, _, other = motion_of(model, values, one_by_one=True)
    np.testing.assert_array_equal(other.status, run.status)
    np.testing.assert_array_equal(run.failure_time, other.failure_time)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-7)  # as above; this one is faster: 5e-8
    for sample in range(N):
        alone, _, own = motion_of(model, values_of(model, np.array([sample])))
        assert own.failure_time[0] == run.failure_time[sample]
        np.testing.assert_array_equal(alone[:, 0], found[:, sample])
