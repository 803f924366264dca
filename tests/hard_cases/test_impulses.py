"""Torques that set in at once and impulses, against momentum, energy and the rigid mechanism's closed forms."""

from dataclasses import dataclass

import numpy as np
import pytest
from elimination import Beams, chain, circle
from mechanisms import accurate, both, nominal_rom, run_for, start
from runs import assert_close, full_model, history, reduced_model, samples, watched

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.mechanism.mechanism import Unknowns
from pgmp_petsc.models import FullModel
from pgmp_petsc.scene import Scene
from pgmp_petsc.stepping.generalised_alpha import integrate
from pgmp_petsc.stepping.second_order_system import State
from scenes import CRANK, RADIUS, ROD, kinematics_of, pendulum

IMPULSE = 0.1  # N m s, on a beam of 1 m and 0.6 kg
BEAM = (
    "bodies.arm.section.radius=5e-3", "reduction.modes=4", "reduction.static_modes=true", "reduction.angles=16",
    'outputs.angle={type="angle", joint="hinge"}', 'outputs.tip={type="rotation", point="arm:tip"}',
)  # fmt: skip


def motor(table: list) -> str:
    """Return the override of a torque in the beam's hinge."""
    return f'effects.motor={{type="torque", joint="hinge", table={table}}}'


@dataclass(frozen=True)
class Balance:
    """Of a full-order run, over time, shape (n,): time, angle of the driven hinge, energy, and angular momentum
    about the origin."""

    time: np.ndarray
    angle: np.ndarray
    energy: np.ndarray
    momentum: np.ndarray

    def work(self, table: np.ndarray) -> np.ndarray:
        """Return the work of the torque of a table (time, torque) on the hinge's rotation."""
        torque = np.interp(self.time, *table.T)
        return np.concatenate([[0.0], np.cumsum(0.5 * (torque[1:] + torque[:-1]) * np.diff(self.angle))])


def balance_of(model: FullModel, beams: Beams) -> Balance:
    """Integrate a full-order model; energy and momentum by formulas of the tests' own."""
    mass, system = beams.mass(), model.batch(samples(model.scene, 1), 1)

    def row(time: float, state: State) -> tuple[float, ...]:
        q, v = system.unpack(state.q)[:, 0], system.unpack(state.v)[:, 0]
        rotation = np.ones_like(q)  # velocity of every node when all turns about the origin at 1 rad/s
        rotation[0::3], rotation[1::3] = -q[1::3], q[0::3]
        return time, q[2], 0.5 * v @ mass @ v + beams.energy(q), rotation @ mass @ v

    run, rows = watched(system, model.scene.simulation, row)
    assert run.status[0] == 0
    return Balance(*np.array(rows).T)


def hinged_beam(pulse: float, step: float, duration: float) -> tuple[Scene, Beams, np.ndarray]:
    """Return a beam of 1 m and 5 mm under a triangular pulse whose corners are ends of steps, and the pulse's table."""
    table = np.array([[10 * step, 0.0], [10 * step + pulse / 2, 2 * IMPULSE / pulse], [10 * step + pulse, 0.0]])
    scene = pendulum(*BEAM, motor(table.tolist()), *run_for(duration, step))
    return scene, chain((10,), (1.0,), [circle(5e-3, 210e9, 7800.0)]), table


# pulse and step (s); what the momentum may miss: the steps resolve the pulse 20 to 200 times, measured 3e-5 and 3e-7
@pytest.mark.parametrize(("pulse", "step", "allowed"), [(2e-3, 1e-4, 1e-4), (2e-2, 1e-4, 1e-6)])
def test_an_impulse_is_the_change_of_the_angular_momentum(pulse: float, step: float, allowed: float) -> None:
    """About the hinge, whatever the beam's vibration: it bends by 7 degrees under the shorter pulse."""
    scene, beams, table = hinged_beam(pulse, step, 10 * pulse)
    balance = balance_of(full_model(scene), beams)
    after = balance.time > table[-1, 0] - 0.5 * step
    np.testing.assert_allclose(balance.momentum[after], IMPULSE, rtol=allowed, atol=0)
    # vibration takes 6 to 160 times the energy of the rigid beam: impulses are no matter for rigid formulas
    rigid = 0.5 * IMPULSE**2 / (circle(5e-3, 210e9, 7800.0)[3] / 3)
    assert balance.energy[-1] > 5 * rigid
    # numerical damping takes 5e-3 of the shorter pulse's vibration
    work = balance.work(table)[-1]
    assert 0.99 * work < balance.energy[-1] < work * (1 + 1e-5)


def test_a_slow_impulse_moves_the_beam_as_if_it_were_rigid() -> None:
    """0.2 s, many periods of the first bending mode: speed J / I and energy J^2 / 2 I, both models."""
    scene, beams, table = hinged_beam(0.2, 1e-3, 1.0)
    balance = balance_of(full_model(scene), beams)
    line, rotary = circle(5e-3, 210e9, 7800.0)[3:]
    inertia = line / 3 + rotary
    # the vibration left over has 2e-4 of the energy
    assert balance.energy[-1] == pytest.approx(0.5 * IMPULSE**2 / inertia, rel=5e-4)
    after = balance.time > table[-1, 0]
    outputs = history(reduced_model(scene), {}, 1)[1]
    for angle in (balance.angle, outputs["angle"][:, 0]):
        speed = np.polyfit(balance.time[after], angle[after], 1)[0]
        assert speed == pytest.approx(IMPULSE / inertia, rel=5e-4)
    assert_close(history(full_model(scene), {}, 1)[1], outputs, angle=5e-6, tip=5e-6)


def test_an_impulse_on_the_slider_crank_turns_it_as_if_it_were_rigid() -> None:
    """Work and speed by the rigid inertia: 1/2 I(theta) theta'^2 = the torque's work, after 0.2 s of a torque."""
    table = np.array([[0.0, 0.0], [0.1, 0.4], [0.2, 0.0]])
    scene = accurate(f"effects.motor.table={table.tolist()}", *start(1.0), *run_for(0.4, 1e-3))
    section = circle(RADIUS, 210e9, 7800.0)
    beams = chain((5, 5), (CRANK, ROD), [section, section])
    balance = balance_of(full_model(scene), beams)
    work = balance.work(table)
    # numerical damping of what vibrates, and the trapezoidal rule of the work
    assert np.abs(balance.energy - work).max() < 1e-4 * work[-1]
    kinematics = kinematics_of(scene)
    poses = kinematics.poses(balance.angle)
    rates = kinematics.rates(poses)
    unknowns = Unknowns(kinematics.mechanism)
    rigid = np.array([unknowns.place(poses[..., k], rates[..., 0, k]) for k in range(balance.angle.size)])
    inertia = np.einsum("ki,ij,kj->k", rigid, beams.mass(), rigid)
    after = balance.time > 0.25
    # time to turn from 1/4 s to the end: integral of sqrt(I / 2 E) d theta
    slowness = np.sqrt(inertia / (2 * work[-1]))[after]
    angle = balance.angle[after]
    taken = np.sum(0.5 * (slowness[1:] + slowness[:-1]) * np.diff(angle))
    assert taken == pytest.approx(np.ptp(balance.time[after]), rel=2e-3)
    assert_close(*both(scene, rom=nominal_rom()), angle=2e-5, bent=5e-3, slider=1e-5)


def test_a_torque_that_sets_in_within_a_nanosecond() -> None:
    """Two rows 1e-9 s apart. The deformation errs by the hinge's fast vibration (README, Limits), measured 2 %."""
    table = np.array([[0.0, 0.0], [0.05, 0.0], [0.05 + 1e-9, 0.5]])
    scene = accurate(f"effects.motor.table={table.tolist()}", *start(0.5), *run_for(0.3, 5e-4))
    section = circle(RADIUS, 210e9, 7800.0)
    balance = balance_of(full_model(scene), chain((5, 5), (CRANK, ROD), [section, section]))
    work = balance.work(table)
    # the torque is there from the first end of a step after its row on: half a step of 500 is not seen
    assert np.abs(balance.energy - work).max() < 2e-3 * work[-1]
    assert_close(*both(scene, rom=nominal_rom()), angle=2e-5, bent=0.04, slider=1e-6)


IMPULSE = 1e-3


def pulse(peak: float, step: float) -> Scene:
    """Return a pendulum with a pulse of torque of a fifth of a millisecond."""
    table = [[peak - 1e-4, 0.0], [peak, IMPULSE / 1e-4], [peak + 1e-4, 0.0]]
    return pendulum(*BEAM, motor(table), *run_for(0.3, step))


@pytest.mark.parametrize("peak", [0.0100, 0.0105], ids=["on the end of a step", "between ends"])
def test_a_pulse_that_the_steps_do_not_see_is_refused(peak: float) -> None:
    """The torque is read at the ends of steps: it would act for a whole step, or not at all."""
    with pytest.raises(InputError, match="effects.motor.table: has an impulse of 0.001 N m s, but (0.01|0) with"):
        pulse(peak, 1e-3)


@pytest.mark.parametrize("name", ["full", "reduced"])
def test_a_resolved_pulse_of_a_fifth_of_a_millisecond_keeps_its_impulse(name: str) -> None:
    """The mean speed that it leaves is J / I."""
    scene = pulse(0.0105, 5e-5)
    model = full_model(scene) if name == "full" else reduced_model(scene)
    time, outputs = history(model, {}, 1)
    after = time > 0.02
    speed = np.polyfit(time[after], outputs["tip"][after, 0], 1)[0]
    line, rotary = circle(5e-3, 210e9, 7800.0)[3:]
    # what is left is the vibration that a straight line does not take out
    assert speed == pytest.approx(IMPULSE / (line / 3 + rotary), rel=0.1)


def test_a_sudden_torque_on_ever_thinner_cranks() -> None:
    """0.5 N m at once throws thin cranks around within a step: every step converges, with corrections kept short."""
    model = full_model(accurate("effects.motor.table=[[0.0, 0.5], [1.0, 0.5]]", "simulation.duration=0.05"))
    radii = np.linspace(0.5, 1.4, 46) * RADIUS
    assert not integrate(model.batch({"r1": radii}, radii.size), model.scene.simulation).status.any()
