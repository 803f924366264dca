"""Mechanisms with more than two coordinates: full-order and component runs, and what a reduction of them would cost."""

from collections.abc import Callable

import numpy as np
import pytest
from conftest import ROOT
from runs import MODELS, assert_close, components_model, full_model, history, run_model, samples
from scipy.integrate import solve_ivp

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.estimates.own_error import why_not_of_full_order
from pgmp_petsc.models import Model
from pgmp_petsc.scene import Scene, load_scene, scene_from_toml
from pgmp_petsc.stepping.status import Status
from scenes import HEADER, TURN, meshes_of, tables

LENGTHS = (0.4, 0.3, 0.2)
G = 9.80665


def chain(flexible: bool, *overrides: str) -> Scene:
    """Return a triple pendulum of beams in the plane, stretched out along x at first."""
    text = HEADER
    for k, length in enumerate(LENGTHS):
        held = "ground:origin" if k == 0 else f"link{k - 1}:tip"
        text += tables(f"""
bodies.link{k}: mesh = "0.0:{length}:4"; element = "beam2d"; material = "steel"; flexible = {str(flexible).lower()};
    section = {{ shape = "circle", radius = 5e-3 }}
joints.joint{k}: type = "revolute"; connect = ["{held}", "link{k}:hinge"]
coordinates.theta{k}: joint = "joint{k}"; {TURN}
outputs.theta{k}: type = "angle"; joint = "joint{k}"
""")
    text += tables("""
effects.weight: type = "gravity"
outputs.bending: type = "deformation"; point = "link2:tip"; axis = "y"
reduction: modes = 3
simulation: duration = 0.4; step = 1e-3
""")
    return scene_from_toml(text, ".", overrides)


def rigid_chain(theta: np.ndarray, rates: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Return the relative angles (3, n_t) of the chain of slender rods by their own equations in absolute angles.

    With ``c_ij`` the inertia coupling of rods i and j, ``sum_j c_ij (cos(a_i - a_j) a_j'' + sin(a_i - a_j) a_j'^2) =
    -g s_i cos a_i``.
    """
    lengths, line = np.array(LENGTHS), 7800.0 * np.pi * 5e-3**2
    masses = line * lengths
    behind = np.array([masses[k + 1 :].sum() for k in range(3)])
    first = lengths * (0.5 * masses + behind)
    coupling = np.array([[lengths[min(i, j)] * first[max(i, j)] for j in range(3)] for i in range(3)])
    rotary = 7800.0 * np.pi * 5e-3**4 / 4.0 * lengths
    np.fill_diagonal(coupling, lengths**2 * (masses / 3.0 + behind) + rotary)

    def slopes(_: float, state: np.ndarray) -> np.ndarray:
        angles, spins = np.split(state, 2)
        between = angles[:, None] - angles
        right = -G * first * np.cos(angles) - (coupling * np.sin(between)) @ spins**2
        return np.concatenate([spins, np.linalg.solve(coupling * np.cos(between), right)])

    start = np.concatenate([np.cumsum(theta), np.cumsum(rates)])
    found = solve_ivp(slopes, (0.0, times[-1]), start, "DOP853", times, rtol=1e-11, atol=1e-12).y[:3]
    return np.diff(found, axis=0, prepend=0.0)


@pytest.mark.parametrize("make", [full_model, components_model])
def test_a_rigid_chain_obeys_its_own_equations(make: Callable[..., Model]) -> None:
    """Three coordinates, started with positions and velocities of all of them; of order two in the step. In joint
    coordinates no constraint is left."""
    position, velocity = np.array([0.2, -0.6, 0.4]), np.array([1.0, 0.0, -3.0])
    initial = ", ".join(f"theta{k}={{position={position[k]}, velocity={velocity[k]}}}" for k in range(3))
    errors = []
    for step in (5e-4, 2.5e-4):
        scene = chain(False, f"simulation.initial={{{initial}}}", f"simulation.step={step}")
        model = make(scene)
        system = model.batch(samples(scene, 1), 1)
        assert make is full_model or (system.n_dofs, system.n_constraints) == (3, 0)
        times, found = history(model, samples(scene, 1), 1, system=system)
        exact = rigid_chain(position, velocity, times)
        errors.append(max(np.abs(found[f"theta{k}"][:, 0] - exact[k]).max() for k in range(3)))
    assert errors[1] < 1e-5
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.1)


def test_a_flexible_chain_moves_as_its_mesh() -> None:
    """Released at once; later the vibrations are out of phase, as what is of second order in them changes theirs."""
    scene = chain(True, "simulation.duration=0.2", "simulation.initial={theta1={position=-0.5}}")
    full = full_model(scene)
    both = (full, components_model(scene, full.meshes))
    exact, found = (history(model, samples(scene, 1), 1)[1] for model in both)
    assert_close(exact, found, theta0=1e-4, theta1=1e-4, theta2=1e-4, bending=1e-2)


def test_a_study_of_errors_is_offered_where_it_takes_all_coordinates() -> None:
    fourth = (
        'bodies.link3={line={length=0.1,elements=2},element="beam2d",material="steel",'
        'section={shape="circle",radius=5e-3}}',
        'joints.joint3={type="revolute",connect=["link2:tip","link3:hinge"]}',
        'coordinates.theta3={joint="joint3",range=[-1.0,1.0]}',
    )
    for more, cure in (((), "pgmp tradeoff measures them"), (fourth, "compare with a finer mesh")):
        (said,) = why_not_of_full_order(full_model(chain(True, *more)))
        assert said.text.endswith(cure)


def test_rigid_bodies_have_neither_a_mesh_nor_modes_whose_errors_are_not_known() -> None:
    scene = chain(False)
    for model in (full_model(scene), components_model(scene)):
        assert why_not_of_full_order(model) == ()


@pytest.mark.parametrize("name", ["six_joint_arm", "scara", "palletizer"])
def test_open_chains_are_placed_along_their_tree(name: str) -> None:
    """As Newton's method does from afar, by joints that turn and slide; a closed loop is left to it."""
    kinematics = components_model(load_scene(ROOT / "scenes" / f"{name}.toml")).kinematics
    walk = kinematics._walk  # noqa: SLF001
    theta = walk.assembled[0] + np.random.default_rng(0).uniform(-0.5, 0.5, (5, kinematics.n_coordinates))
    if name == "palletizer":
        assert walk.chain is None
        return
    exact = walk.chain.poses(theta)
    walk.chain = None
    np.testing.assert_allclose(walk.poses(theta), exact, rtol=0, atol=1e-11)


#: Scenes, models, what is given to them, and the shares that are allowed of deformations. Of components' places 1e-6 is
#: measured, of deformations 3e-4, from modes that are left out. Reduced models have few angles: two arms and a quill on
#: a spring 0.41 % over 0.2 s (0.06 % with 7; without terms of second order 0.85 and 0.38 %), a closed loop in space,
#: whose rods forces stiffen, 4e-4 (3 % without such terms). Half of that time is run.
ROBOTS = [
    *((name, "components", ("simulation.duration=0.3", "simulation.step=1e-3"), 1e-3)
      for name in ("six_joint_arm", "scara", "delta_robot", "payload_arm", "palletizer")),
    ("scara", "reduced", ("simulation.duration=0.1", "reduction.angles=5"), 5e-3),
    ("delta_robot", "reduced", ("simulation.duration=0.1", "reduction.angles=4"), 1e-3),
]  # fmt: skip


@pytest.mark.usefixtures("coarse")
@pytest.mark.parametrize(("name", "model", "given", "share"), ROBOTS)
def test_robots_move_as_their_mesh(name: str, model: str, given: tuple[str, ...], share: float) -> None:
    """Open chains, a closed one with three coordinates and one with four, and elastic gearboxes with a payload."""
    scene = load_scene(ROOT / "scenes" / f"{name}.toml", given)
    exact, found = (history(MODELS[kind](scene), samples(scene, 1), 1)[1] for kind in ("full", model))
    limits = {name: share if one.type == "deformation" else 1e-5 for name, one in scene.outputs.items()}
    assert_close(exact, found, **limits)


# an arm whose hand is driven away from its shoulder: its links make 0.9 m, which is reached at 0.1 s
REACH = HEADER + tables("""
bodies.upper: mesh = "0.0:0.5:2"; element = "beam2d"; material = "steel"; flexible = false
bodies.upper.section: shape = "circle"; radius = 0.01
bodies.fore: mesh = "0.0:0.4:2"; element = "beam2d"; material = "steel"; flexible = false
bodies.fore.section: shape = "circle"; radius = 0.01
bodies.fore.placement: origin = [0.5, 0.0]; angle = 1.0
joints.shoulder: type = "revolute"; connect = ["ground:origin", "upper:hinge"]
joints.elbow: type = "revolute"; connect = ["upper:tip", "fore:hinge"]
coordinates.turn: joint = "shoulder"; range = [-1.0, 1.0]
coordinates.reach: points = ["ground:origin", "fore:tip"]; range = [0.4, 0.85]
effects.out: type = "prescribed_motion"; coordinate = "reach"; constant_speed = { speed = 1.0, start = 0.8 }
outputs.elbow: type = "angle"; joint = "elbow"
simulation: duration = 0.2; step = 1e-3
""")


@pytest.mark.parametrize("model", [full_model, components_model])
def test_an_arm_that_is_driven_beyond_a_straight_elbow_ends_with_its_instant(model: Callable) -> None:
    """Within two steps of where its elbow is straight."""
    scene = scene_from_toml(REACH, ".")
    _, run = run_model(model(scene, meshes_of(scene)))
    assert run.status[0] not in (Status.FINE, Status.LEFT_RANGE)
    assert run.failure_time[0] == pytest.approx(0.1, abs=2.5e-3)


def test_a_straight_elbow_within_the_range_is_refused_with_the_configuration() -> None:
    for end, refused in ((0.85, False), (0.9, True), (0.95, True)):
        scene = scene_from_toml(REACH, ".", [f"coordinates.reach.range=[0.4,{end}]"])
        found = pytest.raises(InputError, full_model, scene, meshes_of(scene)) if refused else None
        assert not refused or "they do not control the mechanism at turn = -1 rad, reach = 0.9 m" in str(found.value)
