"""Loads over the angle or the way of a joint: against scipy, the work over a turn, derivatives, in C, on ranks."""

from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT
from coupled_scenes import SCREW
from differences import SHARES, compare
from exported import assert_same_in_c, needs_compiler
from length_scenes import BRIEF, long_crank
from machine_scenes import ACROSS, MODELS, RIGID, CartAndPole, cart, rail, run
from refusals import cases, check_said, refusal
from runs import assert_close, reduced_model, trajectory
from scipy.integrate import cumulative_trapezoid, solve_ivp
from scipy.optimize import root

from pgmp_petsc.effects.formula import table_law, turns_of
from pgmp_petsc.models import of_samples
from pgmp_petsc.scene import load_scene, scene_from_toml
from pgmp_petsc.scene.uses import motion_over
from scenes import pendulum, slider_crank

ROWS = ((-3.0, 0.3), (-2.0, -0.2), (-1.0, 0.4), (0.0, 0.0), (0.1, 0.5))
WAY = ((-0.1, 2.0), (0.0, 0.0), (0.02, -3.0))
LOADS = (
    f'effects.motor={{type="torque",joint="pivot",over="pivot",table={[list(row) for row in ROWS]}}}',
    f'effects.push={{type="force",joint="rail",over="rail",table={[list(row) for row in WAY]},scale="factor"}}',
    "parameters.factor={nominal=2.0}", "simulation.initial.x.velocity=0.3",
)  # fmt: skip


def test_the_law_of_a_table() -> None:
    """Linear between rows, constant beyond; one over a turn goes on for ever."""
    law, h = table_law(ROWS, 0), 1e-6
    for s in np.linspace(-4.0, 1.0, 41) + 1e-3:
        found = law.evaluate([2.0], s, 0.3)
        assert found.force == pytest.approx(2.0 * np.interp(s, *zip(*ROWS)), abs=1e-14)
        slope = np.diff(np.interp([s - h, s + h], *zip(*ROWS)))[0] / (2 * h)
        assert found.stiffness == pytest.approx(-2.0 * slope, abs=1e-8) and found.damping == 0.0
        law.code.slopes([2.0], 0.0, s, 0.3, slopes := [0.0, 0.0])
        assert slopes == [found.force / 2.0, 0.0]
    for turns in (1, 2):
        period = 2.0 * np.pi * turns
        rows = ((0.5, 1.0), (2.0, -1.0), (0.5 + period, 1.0))
        assert turns_of(rows) == turns
        law = table_law(rows, turns)
        for s in np.linspace(0.5, 0.5 + period, 31)[:-1] + 1e-3:
            for k in (-3, 0, 5):
                found = law.evaluate([1.0], s + period * k)
                assert found.force == pytest.approx(np.interp(s, *zip(*rows)), abs=1e-12)
    ends = [((0.0, 1.0), (span, 2.0)) for span in (2.0 * np.pi, 4.0 * np.pi, 5.0)]
    assert [turns_of(rows) for rows in ends] == [None, 0, 0]


def test_the_work_of_a_torque_over_turns_of_a_crank() -> None:
    """An engine's torque: the energy after each turn has grown by the area under the table."""
    turn = 2.0 * np.pi
    scene = slider_crank(
        f'effects={{engine={{type="torque",joint="crank_hinge",over="crank_hinge",table=[[0.0,0.0],[1.0,3.0],[2.0,0.0],[{turn!r},0.0]]}}}}',
        "bodies.crank.flexible=false", "bodies.rod.flexible=false", "simulation.initial.theta.velocity=40.0",
        "simulation.duration=0.5", "simulation.step=5e-4", 'outputs.angle={type="angle",joint="crank_hinge"}',
    )  # fmt: skip
    found = trajectory("full", scene)
    angle, kinetic = found.outputs["angle"], found.balance.kinetic
    grid = np.linspace(0.0, angle[-1], 100_001)
    area = cumulative_trapezoid(np.interp(grid % turn, [0.0, 1.0, 2.0], [0.0, 3.0, 0.0]), grid, initial=0.0)
    assert angle[-1] > 2.0 * turn
    # (w h)^2 / 12 of the energy, with accelerations by the crank 20 times as fast as it
    np.testing.assert_allclose(kinetic - kinetic[0], np.interp(angle, grid, area), rtol=0, atol=1e-2)


def blow(x: float) -> float:
    return float(np.interp(x, [-0.1, 0.3], [1.0, 0.2]))


def force(t: float, x: float, phi: float, v: float, w: float) -> float:
    return 2.0 * (phi + 1.2) - 0.3 * w + float(np.interp(phi, [-3.0, -1.5, 0.0], [1.0, -0.5, 1.5])) + blow(x)


def torque(t: float, x: float, phi: float, v: float, w: float) -> float:
    return 2.0 * float(np.interp(x, [-0.2, 0.0, 0.2], [-0.6, 0.0, 0.8])) - 0.5 * np.sin(phi) * blow(x)


def push(t: float, x: float, phi: float, v: float, w: float) -> float:
    return 2.0 * float(np.interp(x, *zip(*WAY)))


def turn(t: float, x: float, phi: float, v: float, w: float) -> float:
    return float(np.interp(phi, *zip(*ROWS)))


# a reduced model has bodies that deform, if only a little
NEAR = ("coordinates.x.range=[-0.2,0.4]", "coordinates.swing.range=[-2.4,0.3]", "reduction.angles=18")


@pytest.mark.parametrize(("model", "own"), [("full", True), *((model, False) for model in MODELS)])
def test_loads_over_joints_move_a_cart_and_a_pole(model: str, own: bool) -> None:
    loads, forces = (LOADS, (push, turn)) if own else (ACROSS, (force, torque))
    stiff = ("materials.steel.E=2e14", *NEAR) if model == "reduced" else RIGID
    times, found = run(cart(*stiff, *loads, "simulation.step=5e-4"), model)
    exact = CartAndPole().motion(times, (0.0, 0.0, 0.3, 0.0), *forces)
    # the step leaves 2e-6, a quarter of it at half the step; the distances of 28 angles in the whole range 6e-6, twice
    # as large ones 8e-5
    for name, values in zip(("x", "swing"), exact):
        np.testing.assert_allclose(found[name], values, rtol=0, atol=1e-5 * np.abs(values).max())


@pytest.mark.parametrize(("loads", "moved", "bent"), [(LOADS, 1e-4, 0.02), (ACROSS, 2e-4, 0.03)], ids=["own", "other"])
def test_loads_over_a_joint_in_every_model(loads: tuple[str, ...], moved: float, bent: float) -> None:
    (_, full), (_, components), (_, reduced) = (run(cart(*loads), model) for model in MODELS)
    assert_close(full, reduced, components, x=moved, swing=moved, bent=bent)


def test_loads_over_the_other_joint_in_space() -> None:
    """A torque on the crank over the rocker's angle, and a formula on the rocker over the crank's, which turns on."""
    settings = (
        'effects={cross={type="law",joint="rocker_hinge",over="crank_hinge",force="0.5 * sin(s) - 0.02 * v"},'
        'gas={type="torque",joint="crank_hinge",over="rocker_hinge",table=[[-3.0,0.6],[3.0,-0.4]]}}',
        "simulation.initial.theta.velocity=30.0", "simulation.duration=0.05", "simulation.step=2.5e-4",
        "reduction.angles=32", "reduction.second_order=false", "materials.aluminium.E=7e12",
    )  # fmt: skip
    scene = load_scene(ROOT / "scenes" / "rssr_beams.toml", settings)
    (_, full), (_, components), (_, reduced) = (run(scene, model) for model in MODELS)
    assert full["crank_angle"][-1] > 1.5
    # the loads act at once: the vibrations that this sets off, of which models have not the same, leave 5e-3 at 70 GPa
    assert_close(full, reduced, components, crank_angle=5e-4, rocker_angle=5e-4)


#: A cart and a pole on springs, each pushed over the other: a stiffness that is not symmetric, its mean not positive.
AT_REST = (
    'effects.hold={type="spring_damper",joint="rail",stiffness=400.0}',
    'effects.keep={type="spring_damper",joint="pivot",stiffness=6.0,rest=-0.5}',
    'effects.follow={type="law",joint="rail",over="pivot",force="k * (s + 0.2) + 1",constants={k="push"}}',
    'effects.lead={type="torque",joint="pivot",over="rail",table=[[-20.0,-10.0],[20.0,10.0]]}',
    "parameters.push={nominal=1000.0}", 'initial={equilibrium=true,coordinates="free"}',
    "coordinates.x.range=[-5.0,5.0]", "simulation.duration=0.02",
)  # fmt: skip


@pytest.mark.parametrize("model", MODELS)
def test_static_equilibrium_with_loads_over_the_other_joint(model: str) -> None:
    bodies = CartAndPole()
    weight = bodies.pole * bodies.half * 9.80665

    def left(at: np.ndarray) -> list[float]:
        x, phi = at
        return [-400.0 * x + 1000.0 * (phi + 0.2) + 1.0, -6.0 * (phi + 0.5) + 0.5 * x - weight * np.cos(phi)]

    exact = root(left, (-1.5, -0.8), tol=1e-12).x
    scene = cart(*AT_REST, RIGID[1], "materials.steel.E=2e14" if model == "reduced" else RIGID[0])
    _, found = run(scene, model)
    # tables over 14 angles leave 2e-5 of the reduced model's
    for name, value in zip(("x", "swing"), exact):
        np.testing.assert_allclose(found[name], value, rtol=1e-4 if model == "reduced" else 1e-9)
    if model == "reduced":
        compare(reduced_model(scene))


def test_derivatives_of_loads_over_the_other_joint() -> None:
    compare(reduced_model(cart(*ACROSS, "simulation.duration=0.1")))


def test_derivatives_with_a_length_of_what_leads() -> None:
    """The way of the slider hangs on the rod's length, and the crank's torque on that; the elbow's on the crank."""
    scene = long_crank(
        *BRIEF, "simulation.initial.theta={position=0.4,velocity=-20.0}", "parameters.rod_length.value=0.698",
        'effects.brake={type="law",joint="crank_hinge",over="slider",force="-0.3 * s - 0.02 * v"}',
        'effects.turn={type="torque",joint="elbow",over="crank_hinge",table=[[-1.0,0.3],[1.0,-0.2]]}',
    )  # fmt: skip
    compare(of_samples(reduced_model(scene), ["rod_length"]), SHARES, "rod_length")


@needs_compiler
@pytest.mark.usefixtures("short_tables")
def test_loads_over_joints_in_c(tmp_path: Path) -> None:
    """Over the joint that they act on, and over the other one."""
    across = (entry.replace("effects.", "effects.across_") for entry in ACROSS)
    scene = cart(*LOADS, *across, "simulation.duration=0.2", "reduction.angles=6")
    assert {f"across_{name}" for name in ("motor", "push")} | {"motor", "push"} <= scene.effects.keys()
    assert_same_in_c(reduced_model(scene), tmp_path)


REFUSED = """
effects.e={type="torque",joint="pivot",over="crank",table=[[0,1],[1,2]]} -> \
    effects.e.over = "crank": there is no such
effects.e={type="law",joint="pivot",over="raill",force="s"} -> effects.e.over = "raill": there is no such
effects.e={type="law",joint="pivot",over="clamp",force="s"} -> \
    effects.e.over = "clamp": there is no such | known: pivot, rail, rail2
effects.e={type="force",point="pole:tip",direction=[1,0],over="rail",harmonic={amplitude=1,frequency_hz=1}} -> \
    effects.e.over = "rail": needs a table; a harmonic is over time
effects.e={type="torque",joint="pivot",over="pivot",harmonic={amplitude=1,frequency_hz=1}} -> \
    effects.e.over = "pivot": needs a table; a harmonic is over time
effects.e={type="torque",joint="pivot",over="pivot",table=[[0,1],[6.283185307179586,2]]} -> \
    effects.e.table: is over a whole turn, and its ends differ; it has to close
effects.e={type="force",joint="rail",over="pivot",table=[[0,1],[6.283185307179586,"k"]]} -> \
    effects.e.table: is over a whole turn, and its ends differ; it has to close
effects.e={type="torque",joint="pivot",over="pivot",table=[[1,1],[0,2]]} -> effects.e.table
effects.e={type="torque",joint="pivot",over="pivot",over_motion="sliding",table=[[0,1],[1,2]]} -> \
    effects.e.over_motion = "sliding": pivot is revolute: allowed is "turning"
effects.e={type="torque",joint="pivot",over_motion="turning",table=[[0,1],[1,2]]} -> \
    effects.e.over_motion = "turning": needs over, the joint that has it
effects.e={type="law",joint="pivot",over_motion="turning",force="s"} -> \
    effects.e.over_motion = "turning": needs over, the joint that has it
"""


@pytest.mark.parametrize(("override", "said"), cases(REFUSED))
def test_what_hangs_on_nothing_is_explained(override: str, said: str) -> None:
    check_said(refusal(cart, override, "parameters.k={nominal=1.0}"), said, override)


def test_a_parameter_in_a_row_is_a_load_of_its_own() -> None:
    named = 'effects.push={type="force",joint="rail",over="rail",table=[[-0.1,"one"],[0.0,0.0],[0.1,-4.0]]}'
    plain = 'effects.push={type="force",joint="rail",over="rail",table=[[-0.1,3.0],[0.0,0.0],[0.1,-4.0]]}'
    moving = "simulation.initial.x.velocity=-0.4", "simulation.duration=0.1"
    for model in ("full", "reduced"):
        (_, one), (_, other) = (
            run(rail(*own, *moving), model) for own in ((named, "parameters.one={nominal=3.0}"), (plain,))
        )
        np.testing.assert_allclose(one["x"], other["x"], rtol=0, atol=1e-9)


@pytest.mark.parametrize("model", ["full", "reduced"])
def test_a_parameter_in_a_table_over_a_whole_turn(model: str) -> None:
    """Each part of it is over the whole turn, and goes on for ever."""
    last, found = 1.0 + 2.0 * np.pi, []
    for one in ('"one"', 2.0):
        push = f'effects.push={{type="force",joint="rail",over="pivot",table=[[1.0,{one}],[3.0,0.5],[{last!r},{one}]]}}'
        found.append(run(cart(push, "parameters.one.nominal=2.0", "reduction.angles=6"), model)[1])
    np.testing.assert_allclose(found[0]["x"], found[1]["x"], rtol=0, atol=1e-9)


@pytest.mark.parametrize("model", MODELS)
def test_a_table_over_two_turns_is_that_of_four_strokes(model: str) -> None:
    """A stiff bar that is driven in every other turn, against the integral of its equation of motion."""
    rows = [[0.0, 0.0], [1.0, 40.0], [3.0, 0.0], [7.0, -10.0], [9.0, 0.0], [4.0 * np.pi, 0.0]]
    scene = pendulum(
        "bodies.arm.section.radius=5e-3", "materials.steel.E=2e13",
        f'effects.engine={{type="torque",joint="hinge",over="hinge",table={rows}}}',
        "simulation.initial.phi.velocity=30.0", "simulation.duration=0.5", "simulation.step=5e-4",
        'outputs.phi={type="angle",joint="hinge"}', "reduction.angles=12", "reduction.static_modes=true",
    )  # fmt: skip
    times, found = run(scene, model)
    inertia = 7800.0 * np.pi * 5e-3**2 * (1.0 / 3.0 + 5e-3**2 / 4.0)

    def rates(t: float, y: np.ndarray) -> list[float]:
        return [y[1], float(np.interp(y[0] % (4.0 * np.pi), *zip(*rows))) / inertia]

    exact = solve_ivp(rates, (0.0, times[-1]), [0.0, 30.0], t_eval=times, rtol=1e-9, atol=1e-10, max_step=2e-4).y[0]
    assert exact[-1] > 5.0 * np.pi
    np.testing.assert_allclose(found["phi"], exact, rtol=0, atol=2e-4 * exact[-1])


def test_a_joint_that_turns_and_slides_is_asked_for_its_motion() -> None:
    """Unless it is the joint that the load acts on, where the motion is the same."""
    both = 'joints.rail.type="cylindrical"', 'coordinates.x.motion="sliding"', 'outputs.v.motion="sliding"'
    table = 'over="rail",table=[[0.0,1.0],[1.0,2.0]]'
    message = refusal(rail, *both, f'effects.e={{type="force",point="arm:tip",direction=[1.0,0.0,0.0],{table}}}')
    said = 'effects.e.over_motion: missing; rail is cylindrical: "turning" or "sliding" is needed'
    assert message == said
    for kind, way in (("force", "sliding"), ("torque", "turning")):
        scene = rail(*both, f'effects.e={{type="{kind}",joint="rail",{table}}}')
        assert motion_over(scene, scene.effects["e"]) == way


@pytest.mark.parametrize("model", ["full", "components"])
def test_loads_over_either_motion_of_a_cylindrical_joint(model: str) -> None:
    """A nut that is pushed over the angle that it has turned by, and turned over the way that it has come."""
    push, twist = [[-1.0, -2.0], [0.5, 3.0], [2.0, 6.0]], [[-0.1, 0.05], [0.2, -0.02]]
    scene = scene_from_toml(
        SCREW[: SCREW.index("[joints.thread]")] + SCREW[SCREW.index("[coordinates.x]") :], ".",
        (
            'coordinates.phi={joint="shaft",motion="turning",range=[-3.0,3.0]}', "simulation.duration=0.5",
            f'effects.push={{type="force",joint="shaft",over="shaft",over_motion="turning",table={push}}}',
            f'effects.twist={{type="torque",joint="shaft",over="shaft",over_motion="sliding",table={twist}}}',
            'effects.drag={type="law",joint="shaft",motion="sliding",over="shaft",over_motion="turning",force="-0.5*v"}',
        ),
    )  # fmt: skip
    times, found = run(scene, model)

    def rates(t: float, y: np.ndarray) -> list[float]:
        x, phi, v, w = y
        force = float(np.interp(phi, *zip(*push))) - 0.5 * w
        return [v, w, force / 3.0, float(np.interp(x, *zip(*twist))) / 0.02]

    exact = solve_ivp(rates, (0.0, times[-1]), [0.0] * 4, t_eval=times, rtol=1e-10, atol=1e-12, max_step=1e-3).y
    for name, values in zip(("x", "phi"), exact):  # the step of 2 ms leaves 2e-5
        np.testing.assert_allclose(found[name], values, rtol=0, atol=1e-4 * np.abs(values).max())
