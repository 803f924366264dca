"""A mass that travels along a simply supported beam: deflection at every place, and motion against its modal equations.

The trolley is a rigid body on two wheels; with w its wheels' deflections, y the mean of both and r their difference
over the wheelbase, and ``w = sum_k q_k(t) sin(k pi x / L)``, Lagrange's equations of q and the place x of the first
wheel are integrated by scipy: moving mass, Coriolis and centripetal terms included, and how the slope drives the mass.
"""

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
import pytest
from conftest import ROOT
from machine_scenes import MODELS, run
from refusals import cases, check_said, refusal
from runs import assert_close, motion, reduced_model
from scipy.integrate import solve_ivp

from pgmp_petsc.scene import Scene, load_scene, scene_from_toml
from scenes import tables

LENGTH, WIDTH, HEIGHT, E, RHO, MASS, INERTIA, BASE, GRAVITY = 2.0, 0.04, 0.02, 210e9, 7800.0, 5.0, 1e-4, 0.04, 9.81
PLANE = tables("""
scene: name = "moving_mass"
ground.points: left = [0.0, 0.0]; right = [2.0, 0.0]
materials.steel: E = 210e9; nu = 0.3; rho = 7800.0
bodies.beam: line = { length = 2.0, elements = 16 }; element = "beam2d"; material = "steel";
    section = { shape = "rectangle", width = 0.04, height = 0.02 }
bodies.trolley: placement = { origin = [0.3, 0.0] };
    rigid = { mass = 5.0, centre = [0.0, 0.0], inertia = 1e-4, points = { rear = [-0.02, 0.0], front = [0.02, 0.0] } }
joints.left: type = "revolute"; connect = ["ground:left", "beam:hinge"]
joints.right: type = "point_on_line"; connect = ["ground:right", "beam:tip"]; direction = [1.0, 0.0]
joints.rear: type = "point_on_beam"; connect = ["beam:hinge", "trolley:rear"]; direction = [1.0, 0.0]
joints.front: type = "point_on_beam"; connect = ["beam:hinge", "trolley:front"]; direction = [1.0, 0.0]
coordinates.x: joint = "rear"; motion = "sliding"; range = [0.05, 1.9]
effects.weight: type = "gravity"; acceleration = 9.81; direction = [0.0, -1.0]
effects.stiffening: type = "geometric_stiffening"
effects.shapes: type = "mode_inertia"
reduction: modes = 4; angles = 40; static_modes = true; inertia_modes = true; interpolation = "spline"
simulation: duration = 0.33; step = 5.5e-4
outputs.middle: type = "position"; point = "beam:middle"; axis = "y"
outputs.wheel: type = "position"; point = "trolley:rear"; axis = "y"
outputs.way: type = "position"; point = "trolley:rear"; axis = "x"
""")
# in space a third point holds the trolley upright, and the hinge holds the beam's turning about itself
SPACE = (
    PLANE.replace("0.0]", "0.0, 0.0]")
    .replace("beam2d", "beam3d")
    .replace('steel"\nsection', 'steel"\norientation = [0.0, 1.0, 0.0]\nsection')
    .replace("direction = [0.0, -1.0]", "direction = [0.0, -1.0, 0.0]")
    .replace("inertia = 1e-4", "inertia = [1e-4, 1e-4, 1e-4, 0.0, 0.0, 0.0]")
    .replace("points = { rear", "points = { arm = [0.0, 0.1, 0.0], rear")
    .replace('type = "revolute"', 'type = "revolute"\naxis = [0.0, 0.0, 1.0]')
) + tables("""
joints.upright: type = "point_on_plane"; connect = ["beam:hinge", "trolley:arm"]; normal = [0.0, 0.0, 1.0]
""")
STARTED = ("simulation.initial.x={position=0.1,velocity=5.0}",)


def moving(*overrides: str, space: bool = False) -> Scene:
    return scene_from_toml(SPACE if space else PLANE, ".", overrides)


@dataclass(frozen=True)
class Supported:
    """The beam in n sine shapes, with shear and rotary inertia to their first order, and the trolley."""

    n: int = 14

    @cached_property
    def wave(self) -> np.ndarray:
        return np.arange(1, self.n + 1) * np.pi / LENGTH

    @cached_property
    def mass(self) -> np.ndarray:
        return RHO * WIDTH * HEIGHT * LENGTH / 2 * (1 + self.wave**2 * HEIGHT**2 / 12)

    @cached_property
    def stiffness(self) -> np.ndarray:
        bending, shear = E * WIDTH * HEIGHT**3 / 12, 5 / 6 * E / 2.6 * WIDTH * HEIGHT
        return bending * self.wave**4 * LENGTH / 2 / (1 + bending * self.wave**2 / shear)

    @cached_property
    def weight(self) -> np.ndarray:
        return -RHO * WIDTH * HEIGHT * GRAVITY * (1 - np.cos(self.wave * LENGTH)) / self.wave

    def at(self, x: float) -> tuple[np.ndarray, np.ndarray]:
        """Return y and r with their first and second derivatives in x for units of q, shape (3, n) each."""
        k = self.wave
        rear, front = (np.array([np.sin(k * s), k * np.cos(k * s), -k * k * np.sin(k * s)]) for s in (x, x + BASE))
        return (rear + front) / 2, (front - rear) / BASE

    def static(self, x: float) -> np.ndarray:
        return (self.weight - MASS * GRAVITY * self.at(x)[0][0]) / self.stiffness

    def rates(self, _: float, state: np.ndarray) -> np.ndarray:
        q, p, (x, v), n = state[: self.n], state[self.n : 2 * self.n], state[-2:], self.n
        inertia, force = np.diag(np.append(self.mass, MASS)), np.append(self.weight - self.stiffness * q, 0.0)
        for mass, of, pull in zip((MASS, INERTIA), self.at(x), (GRAVITY, 0.0)):
            slopes = np.append(of[0], of[1] @ q)
            inertia += mass * np.outer(slopes, slopes)
            force -= mass * slopes * (pull + 2 * v * (of[1] @ p) + v * v * (of[2] @ q))
        found = np.linalg.solve(inertia, force)
        return np.concatenate([p, found[:n], [v, found[n]]])

    def motion(self, times: np.ndarray) -> dict[str, np.ndarray]:
        start = np.concatenate([np.zeros(2 * self.n), [0.1, 5.0]])
        # to 2e-9 of the sag: these equations are stiff, and this is the method of fewest evaluations
        found = solve_ivp(self.rates, (0.0, times[-1]), start, method="DOP853", t_eval=times, rtol=1e-8, atol=1e-10).y
        wheel = np.array([np.sin(self.wave * x) @ q for x, q in zip(found[-2], found[: self.n].T)])
        return {"middle": np.sin(self.wave * LENGTH / 2) @ found[: self.n], "wheel": wheel, "way": found[-2]}


@lru_cache(maxsize=None)
def exact_motion(end: float, n: int) -> dict[str, np.ndarray]:
    """Return the motion at n instants up to an end, which all runs here share."""
    return Supported().motion(np.linspace(0.0, end, n))


@lru_cache(maxsize=None)
def errors(model: str, elements: int, space: bool = False) -> dict[str, float]:
    """Return the largest errors of a run over those of the outputs, of the way as a part of the deflection too."""
    # in space two of the first six modes are across the plane
    enough = ("reduction.modes=6", "reduction.angles=80") if space else ()
    scene = moving(*STARTED, f"bodies.beam.line.elements={elements}", *enough, space=space)
    times, found = run(scene, model)
    exact = exact_motion(times[-1], len(times))
    sag = np.abs(exact["middle"]).max()
    return {name: np.abs(found[name] - exact[name]).max() / sag for name in exact}


@pytest.mark.parametrize("model", MODELS)
def test_the_trolley_bends_the_beam_at_every_place(model: str) -> None:
    """Errors fall with the square of the elements' length, wherever in an element the wheels are."""
    shares = []
    for elements in (8, 16):
        shares.append([])
        for x in (0.3, 0.71, 0.96875, 1.333):
            scene = moving(
                "initial={equilibrium=true,coordinates='held'}", f"simulation.initial.x.position={x}",
                f"bodies.beam.line.elements={elements}", "simulation.duration=1e-3", "simulation.step=5e-4",
            )  # fmt: skip
            _, found = run(scene, model)
            q = Supported(200).static(x)
            exact = {s: np.sin(Supported(200).wave * s) @ q for s in (LENGTH / 2, x)}
            shares[-1] += [found["middle"][0] / exact[LENGTH / 2] - 1, found["wheel"][0] / exact[x] - 1]
    coarse, fine = np.abs(shares)
    np.testing.assert_allclose(coarse / fine, 4.0, atol=0.3)
    assert fine.max() < 7e-3


def test_the_moving_mass_follows_its_modal_equations() -> None:
    """Of second order in the elements' length, full-order; the way of the trolley, which the slope drives, too."""
    found = [errors("full", elements) for elements in (8, 16, 32)]
    for name, share in (("middle", 8e-3), ("wheel", 5e-3), ("way", 5e-4)):
        ratios = [coarse[name] / fine[name] for coarse, fine in zip(found, found[1:])]
        # what the modal equations leave out, shear and rotary inertia beyond their first order, is a tenth of the last
        assert all(3.4 < ratio < 5.2 for ratio in ratios), (name, ratios)
        assert found[-1][name] < share


@pytest.mark.parametrize(("model", "space"), [(m, space) for space in (False, True) for m in MODELS])
def test_all_models_agree_on_the_moving_mass(model: str, space: bool) -> None:
    """With the same elements, what the models differ by is hundredths of the mesh's own error."""
    elements = 8 if space else 16
    full, found = errors("full", elements), errors(model, elements, space)
    for name in full:
        assert found[name] == pytest.approx(full[name], abs=1e-3), name


@pytest.mark.parametrize("model", MODELS)
def test_the_wheels_carry_the_trolley(model: str) -> None:
    """Half of its weight each at rest, whichever nodes they press on."""
    pressed = (f'outputs.{name}={{type="joint_force",joint="{name}",component="y"}}' for name in ("rear", "front"))
    held = ("initial={equilibrium=true,coordinates='held'}", "simulation.initial.x.position=0.71")
    _, found = run(moving(*held, *pressed, "simulation.duration=1e-3", "reduction.angles=16"), model)
    for name in ("rear", "front"):
        # the trolley is let go on a slope of 4e-3, whose square is what changes
        np.testing.assert_allclose(found[name][0], MASS * GRAVITY / 2, rtol=5e-5)


def test_the_bridge_crane_reduced_and_full_order() -> None:
    """Trolley, girder and load over the first 3 s; of the stress the nodes' own forces are the rest."""
    scene = load_scene(ROOT / "scenes" / "bridge_crane.toml", ("simulation.duration=3.0",))
    full, reduced = motion("full", scene), motion(reduced_model(scene))
    assert_close(full.outputs, reduced.outputs, sag=1e-3, trolley=1e-3, swing=1e-3, stress=1e-2)


SHORT = "simulation.duration=0.1", "coordinates.x.range=[0.05,0.8]", "reduction.angles=32"  # as near as 80 of the beam


def test_reduced_runs_in_space_are_those_of_the_plane() -> None:
    """The first six modes in space have the plane's four among them, and the other two do not move: round-off is left,
    80 configurations being enough for both sets to be continued alike."""
    plane = motion("reduced", moving(*STARTED, *SHORT)).outputs
    space = motion("reduced", moving(*STARTED, *SHORT, "reduction.modes=6", space=True)).outputs
    sag = np.abs(plane["middle"]).max()
    for name, own in plane.items():
        np.testing.assert_allclose(space[name], own, rtol=0, atol=1e-8 * sag, err_msg=name)


def test_an_oblique_weight_bends_the_beam_both_ways() -> None:
    """Reduced against full order, whose difference is of the modes that are left out."""
    aside = 'outputs.aside={type="position",point="trolley:rear",axis="z"}'
    weight = "effects.weight.direction=[0.1,-0.8,0.6]"
    oblique = *STARTED, *SHORT, weight, "reduction.modes=7", "bodies.beam.line.elements=8", aside
    full, reduced = (motion(model, moving(*oblique, space=True)).outputs for model in ("full", "reduced"))
    assert min(np.abs(full[name]).max() for name in ("middle", "wheel", "aside")) > 1e-4
    assert_close(full, reduced, middle=3e-3, wheel=3e-3, aside=3e-3)


REFUSED = """
joints.rear.connect=["ground:left", "trolley:rear"] -> = ["ground:left", "trolley:rear"]: a point of a beam | ground
joints.rear.connect=["trolley:rear", "beam:hinge"] -> = ["trolley:rear", "beam:hinge"]: a point of a beam is needed
joints.rear.elastic={reference=[[1.0, 0.0]], stiffness=[0.0, 1e6]} -> joints.rear.elastic: this joint is rigid
joints.rear.offset={place=[0.0, 1e-4]} -> joints.rear.offset: this joint is rigid and where it should be
joints.rear.direction=[1.0, 1.0] -> joints.rear: no nodes of beams are beside this point of beam
coordinates.x.range=[0.05, 2.1] -> = [0.05, 2.1]: must be within the run of nodes, 0 to 2 m from the first point
coordinates.x.range=[-0.1, 1.5] -> = [-0.1, 1.5]: must be within the run of nodes
"""


@pytest.mark.parametrize(("asked", "said"), cases(REFUSED))
def test_what_cannot_be_ridden_is_refused(asked: str, said: str) -> None:
    check_said(refusal(lambda: MODELS["full"](moving(*STARTED, asked))), said, asked)
