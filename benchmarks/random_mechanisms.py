"""How good estimated errors are of mechanisms made at random: friction, stops, springs, frames in space.

    python -m benchmarks.random_mechanisms [--refinement 16] [--seed 0] [--each 3] [NAME ...]

Lengths, sections, materials, loads, friction and stops of four-bars, slider-cranks, frames, five-bars, plane-stress
bodies and others (`KINDS`) are drawn; nothing else is said, so that steps, modes and all the rest are those of default
settings. A mechanism that is not built, or whose run or reference stops, is a row that says so.
True errors are those against full-order runs with steps `refinement` times smaller, or half of that where such a run
stops (friction on light nodes); see `benchmarks.effectivity`.
"""

from __future__ import annotations

import argparse
import math
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from mpi4py import MPI

from benchmarks.effectivity import FACTOR, Case, compare, refer
from benchmarks.programs import end, guarded
from pgmp_petsc.base.errors import InputError, RunError
from pgmp_petsc.ensemble.plan import Plan
from pgmp_petsc.ensemble.sampling import Sampler
from pgmp_petsc.mechanism.capabilities import Purpose
from pgmp_petsc.models import ReducedModel
from pgmp_petsc.ranks.groups import RankGroup
from pgmp_petsc.ranks.petsc import start_petsc
from pgmp_petsc.reduction.build import build_rom

HEAD = """[scene]
name = "random"
[ground.points]
{point}
[materials.steel]
E = 210e9
nu = 0.3
rho = 7800.0
[materials.alu]
E = 70e9
nu = 0.33
rho = 2700.0
"""
SCENES = Path(__file__).resolve().parents[1] / "scenes"
SEED = 2027  # of parameters
ROUND = '[coordinates.q]\njoint = "j0"\nrange = [0.0, 6.283185307179586]\nperiodic = true\n'
LIMITED = '[coordinates.q]\njoint = "j0"\nrange = [-3.0, 3.0]\n'


class Made:
    """The text of a scene that is drawn; numbers are rounded to what a user would write."""

    def __init__(self, rng: np.random.Generator, point: str = "d = [1.0, 0.0]") -> None:
        self._rng, self._parts = rng, [HEAD.format(point=point)]

    def number(self, low: float, high: float) -> float:
        """Return a number between two limits."""
        return float(f"{self._rng.uniform(low, high):.4g}")

    def material(self) -> str:
        """Return one of the materials."""
        return str(self._rng.choice(["steel", "alu"]))

    def add(self, kind: str, name: str, **entries: object) -> None:
        """Add a table."""
        lines = (f"{key} = {value if isinstance(value, str) else repr(value)}" for key, value in entries.items())
        self._parts.append("\n".join([f"[{kind}.{name}]", *lines, ""]))

    def bar(self, name: str, length: float, n: int, material: str, section: str, place: tuple, angle: float) -> None:
        """Add a beam in the plane."""
        self.add("bodies", name, line=f"{{ length = {length!r}, elements = {n} }}", element='"beam2d"',
                 material=f'"{material}"', section=section,
                 placement=f"{{ origin = {list(place)!r}, angle = {angle!r} }}")  # fmt: skip

    def joint(self, name: str, first: str, second: str, kind: str = "revolute", **entries: object) -> None:
        """Add a joint."""
        self.add("joints", name, type=f'"{kind}"', connect=f'["{first}", "{second}"]', **entries)

    def effect(self, name: str, kind: str, **entries: object) -> None:
        """Add an effect."""
        self.add("effects", name, type=f'"{kind}"', **entries)

    def outputs(self, **entries: str) -> None:
        """Add outputs by their tables."""
        self._parts.append("[outputs]\n" + "".join(f"{name} = {{ {text} }}\n" for name, text in entries.items()))

    def text(self, coordinate: str) -> str:
        """Return the scene."""
        return "".join([*self._parts[:-1], coordinate, self._parts[-1]])


def rectangle(width: float, height: float) -> str:
    """Return a section."""
    return f'{{ shape = "rectangle", width = {width!r}, height = {height!r} }}'


def circle(radius: float) -> str:
    """Return a section."""
    return f'{{ shape = "circle", radius = {radius!r} }}'


def four_bar(rng: np.random.Generator, stop: bool) -> str:
    """Return a four-bar with friction and a spring at the rocker."""
    a, b, c, d = (float(f"{rng.uniform(*ends):.4g}") for ends in ((0.05, 0.12), (0.35, 0.5), (0.25, 0.35), (0.35, 0.5)))
    s, along = Made(rng, f"d = [{d!r}, 0.0]"), (b * b - c * c + (d - a) ** 2) / (2 * (d - a))
    height = math.sqrt(b * b - along * along)
    rest = math.atan2(height, a + along - d)
    for name, length, n, place, angle in (("crank", a, 4, (0.0, 0.0), 0.0), ("rocker", c, 6, (d, 0.0), rest),
                                          ("coupler", b, 8, (a, 0.0), math.atan2(height, along))):  # fmt: skip
        s.bar(name, length, n, s.material(), rectangle(0.02, s.number(0.006, 0.012)), place, angle)
    for number, pair in enumerate((("ground:origin", "crank:hinge"), ("crank:tip", "coupler:hinge"),
                                   ("coupler:tip", "rocker:tip"), ("ground:d", "rocker:hinge"))):  # fmt: skip
        s.joint(f"j{number}", *pair)
    table = [[0.0, 0.0], [s.number(0.1, 0.4), s.number(0.2, 0.6)], [s.number(0.5, 0.8), s.number(-0.2, 0.2)]]
    s.effect("motor", "torque", joint='"j0"', table=table)
    s.effect("brake", "joint_friction", joint='"j3"', limit=s.number(0.02, 0.1), speed=s.number(0.05, 0.1))
    s.effect("spring", "spring_damper", joint='"j3"', stiffness=s.number(0.1, 0.5), damping=s.number(0.003, 0.02),
             rest=float(f"{rest:.4g}"))  # fmt: skip
    s.effect("tool", "point_mass", point='"coupler:middle"', mass=s.number(0.05, 0.4))
    if stop:
        s.effect("stop", "end_stop", joint='"j3"', lower=rest - 0.08, stiffness=s.number(50, 500), damping=0.2)
    s.outputs(q='type = "angle", joint = "j0"', r='type = "angle", joint = "j3"',
              mid='type = "deformation", point = "coupler:middle", axis = "y"',
              s='type = "stress", body = "coupler", quantity = "stress_max"',
              F=f'type = "stress", body = "rocker", quantity = "axial_force", at = [{c / 2!r}, 0.0]')  # fmt: skip
    return s.text(ROUND)


def slider(rng: np.random.Generator, stop: bool) -> str:
    """Return a slider-crank with friction at the slider, a spring or a stop."""
    s = Made(rng)
    a, b = s.number(0.06, 0.2), s.number(0.3, 0.7)
    s.bar("crank", a, 4, "steel", circle(s.number(0.005, 0.01)), (0.0, 0.0), 0.0)
    s.bar("rod", b, 10, s.material(), circle(s.number(0.004, 0.008)), (a, 0.0), 0.0)
    s.joint("j0", "ground:origin", "crank:hinge")
    s.joint("j1", "crank:tip", "rod:hinge")
    s.joint("sl", "ground:origin", "rod:tip", "point_on_line", direction=[1.0, 0.0])
    table = [[0.0, 0.0], [s.number(0.1, 0.4), s.number(0.5, 2.0)], [1.0, s.number(0.2, 1.0)]]
    s.effect("motor", "torque", joint='"j0"', table=table)
    s.effect("load", "point_mass", point='"rod:tip"', mass=s.number(0.3, 1.5))
    s.effect("brake", "joint_friction", joint='"sl"', limit=s.number(0.5, 3.0), speed=s.number(0.01, 0.05))
    if stop:
        s.effect("stop", "end_stop", joint='"sl"', lower=b - a + 0.01 + s.number(0.0, 0.3) * a,
                 stiffness=s.number(3e3, 1.5e5), damping=s.number(0.1, 0.8))  # fmt: skip
    else:
        s.effect("spring", "spring_damper", joint='"sl"', stiffness=s.number(20, 200), damping=s.number(0.2, 2.0),
                 rest=a + b)  # fmt: skip
    s.outputs(q='type = "angle", joint = "j0"', x='type = "sliding", joint = "sl"',
              mid='type = "deformation", point = "rod:middle", axis = "y"',
              F=f'type = "stress", body = "rod", quantity = "axial_force", at = [{b / 2!r}, 0.0]')  # fmt: skip
    return s.text(ROUND)


def frame(rng: np.random.Generator, rope: bool) -> str:
    """Return an L-shaped frame in space under gravity, with a rope or friction."""
    s = Made(rng, "top = [0.0, 0.0, 0.8]")
    arm, cross = s.number(0.3, 0.6), s.number(0.15, 0.35)
    s.add("bodies", "arm", line=f"{{ length = {arm!r}, elements = 6 }}", element='"beam3d"', material='"steel"',
          section=rectangle(s.number(0.005, 0.01), s.number(0.01, 0.015)), orientation=[0.0, 0.0, 1.0])  # fmt: skip
    turned = f"{{ origin = [{arm!r}, 0.0, 0.0], rotation = [0.0, 0.0, 1.5707963267948966] }}"
    s.add("bodies", "cross", line=f"{{ length = {cross!r}, elements = 5 }}", element='"beam3d"',
          material=f'"{s.material()}"', section=circle(s.number(0.004, 0.007)), placement=turned)  # fmt: skip
    s.joint("j0", "ground:origin", "arm:hinge", axis=[0.0, 1.0, s.number(0.0, 0.5)])
    s.joint("weld", "arm:tip", "cross:hinge", "fixed")
    s.effect("weight", "gravity", direction=[0.0, 0.0, -1.0])
    s.effect("load", "point_mass", point='"cross:tip"', mass=s.number(0.05, 0.4))
    if rope:
        s.effect("rope", "spring_damper", points='["ground:top", "cross:hinge"]', stiffness=s.number(20, 80),
                 damping=s.number(0.2, 1.0), rest=0.8)  # fmt: skip
    else:
        s.effect("brake", "joint_friction", joint='"j0"', limit=s.number(0.1, 0.5), speed=s.number(0.05, 0.2))
    s.outputs(q='type = "angle", joint = "j0"', z='type = "position", point = "cross:tip", axis = "z"',
              dz='type = "deformation", point = "cross:tip", axis = "z"',
              dx='type = "deformation", point = "cross:tip", axis = "x"')  # fmt: skip
    return s.text(LIMITED)


def arm(rng: np.random.Generator, stop: bool) -> str:
    """Return an arm that a motor swings against friction, between stops or round and round."""
    s = Made(rng)
    length = s.number(0.3, 0.9)
    s.bar("arm", length, 12, s.material(), rectangle(0.02, s.number(0.003, 0.008)), (0.0, 0.0), 0.0)
    s.joint("j0", "ground:origin", "arm:hinge")
    motor = f"{{ amplitude = {s.number(0.2, 0.8)!r}, frequency_hz = {s.number(1.0, 5.0)!r} }}"
    s.effect("motor", "torque", joint='"j0"', harmonic=motor)
    s.effect("weight", "gravity")
    s.effect("brake", "joint_friction", joint='"j0"', limit=s.number(0.02, 0.15), speed=s.number(0.1, 0.3))
    if stop:
        s.effect("stop", "end_stop", joint='"j0"', lower=-0.8, upper=0.5, stiffness=s.number(50, 300), damping=0.3)
    at = f"at = [{length / 2!r}, 0.0]"
    s.outputs(q='type = "angle", joint = "j0"', F=f'type = "stress", body = "arm", quantity = "axial_force", {at}',
              tip='type = "deformation", point = "arm:tip", axis = "y", frame = "body"',
              M=f'type = "stress", body = "arm", quantity = "bending_moment", {at}')  # fmt: skip
    return s.text(LIMITED if stop else ROUND)


def rssr(rng: np.random.Generator, friction: bool) -> str:
    """Return a four-bar in space of a ball and a universal joint, with friction or a spring at the rocker."""
    s = Made(rng, "pivot = [0.35, 0.1, 0.0]")
    rocker = s.number(0.23, 0.27)
    far = np.array([0.25, 0.1, rocker])  # from the tip of the crank to that of the rocker
    length, across = float(np.linalg.norm(far)), np.array([0.0, -far[2], far[1]])
    turn = (across / np.linalg.norm(across) * math.acos(far[0] / length)).tolist()
    bar = {"element": '"beam3d"', "orientation": [0.0, 1.0, 0.0]}
    s.add("bodies", "crank", line="{ length = 0.1, elements = 3 }", material='"steel"',
          section=rectangle(0.01, s.number(0.008, 0.012)), **bar)  # fmt: skip
    placed = f"{{ origin = [0.1, 0.0, 0.0], rotation = {turn} }}"
    s.add("bodies", "coupler", line=f"{{ length = {length!r}, elements = 6 }}", element='"beam3d"', material='"alu"',
          section=circle(s.number(0.003, 0.005)), placement=placed)  # fmt: skip
    s.add("bodies", "rocker", line=f"{{ length = {rocker!r}, elements = 4 }}", material=f'"{s.material()}"',
          section=rectangle(0.008, s.number(0.008, 0.012)), **bar,
          placement="{ origin = [0.35, 0.1, 0.0], rotation = [0.0, -1.5707963267948966, 0.0] }")  # fmt: skip
    s.joint("j0", "ground:origin", "crank:hinge", axis=[0.0, 0.0, 1.0])
    s.joint("ball", "crank:tip", "coupler:hinge", "spherical")
    s.joint("cross", "rocker:tip", "coupler:tip", "universal", axis=[0.0, 1.0, 0.0], second_axis=[0.0, 0.0, 1.0])
    s.joint("j3", "ground:pivot", "rocker:hinge", axis=[0.0, 1.0, 0.0])
    s.effect("motor", "torque", joint='"j0"', table=[[0.0, 0.0], [s.number(0.1, 0.3), s.number(0.1, 0.3)]])
    s.effect("weight", "gravity", direction=[0.0, 0.0, -1.0])
    if friction:
        s.effect("brake", "joint_friction", joint='"j3"', limit=s.number(0.01, 0.05), speed=s.number(0.05, 0.1))
    else:
        s.effect("spring", "spring_damper", joint='"j3"', stiffness=s.number(0.2, 0.8), damping=s.number(0.0, 0.01))
    s.outputs(q='type = "angle", joint = "j0"', r='type = "angle", joint = "j3"',
              mid='type = "deformation", point = "coupler:middle", axis = "z"',
              s='type = "stress", body = "coupler", quantity = "stress_max"')  # fmt: skip
    return s.text(ROUND) + "[simulation]\nduration = 0.5\n"


def press(rng: np.random.Generator, spring: bool) -> str:
    """Return a press between two stops that a motor swings to and fro, with friction and perhaps a spring."""
    s = Made(rng)
    a, b = s.number(0.08, 0.15), s.number(0.35, 0.5)
    s.bar("crank", a, 4, "steel", circle(s.number(0.006, 0.01)), (0.0, 0.0), 0.0)
    s.bar("rod", b, 10, s.material(), circle(s.number(0.004, 0.007)), (a, 0.0), 0.0)
    s.joint("j0", "ground:origin", "crank:hinge")
    s.joint("j1", "crank:tip", "rod:hinge")
    s.joint("sl", "ground:origin", "rod:tip", "point_on_line", direction=[1.0, 0.0])
    motor = f"{{ amplitude = {s.number(0.8, 2.0)!r}, frequency_hz = {s.number(1.0, 3.0)!r} }}"
    s.effect("motor", "torque", joint='"j0"', harmonic=motor)
    s.effect("load", "point_mass", point='"rod:tip"', mass=s.number(0.4, 1.2))
    s.effect("brake", "joint_friction", joint='"sl"', limit=s.number(0.5, 2.0), speed=s.number(0.02, 0.05))
    ends = {"lower": b + a * s.number(-0.7, -0.2), "upper": b + a * s.number(0.5, 0.9)}
    s.effect("stops", "end_stop", joint='"sl"', **ends, stiffness=s.number(1e4, 2e5), damping=s.number(0.2, 0.6))
    if spring:
        s.effect("spring", "spring_damper", joint='"sl"', stiffness=s.number(50, 300), damping=1.0, rest=b)
    s.outputs(q='type = "angle", joint = "j0"', x='type = "sliding", joint = "sl"',
              mid='type = "deformation", point = "rod:middle", axis = "y"',
              F=f'type = "stress", body = "rod", quantity = "axial_force", at = [{b / 2!r}, 0.0]')  # fmt: skip
    start = f"[simulation]\nduration = 0.6\n[simulation.initial.q]\nposition = {s.number(1.0, 1.6)!r}\n"
    return s.text('[coordinates.q]\njoint = "j0"\nrange = [-3.0, 6.0]\n') + start


def toggle(rng: np.random.Generator, stop: bool) -> str:
    """Return two bars that a spring stretches through their dead centre, with a stop or friction on the knee."""
    s = Made(rng)
    a, b, q = s.number(0.15, 0.25), s.number(0.2, 0.3), s.number(0.6, 0.9)
    knee = (a * math.cos(q), a * math.sin(q))
    s.bar("first", a, 5, "steel", rectangle(0.015, s.number(0.005, 0.008)), (0.0, 0.0), q)
    s.bar("second", b, 6, s.material(), rectangle(0.015, s.number(0.004, 0.008)), knee, -math.asin(knee[1] / b))
    s.joint("j0", "ground:origin", "first:hinge")
    s.joint("knee", "first:tip", "second:hinge")
    s.joint("sl", "ground:origin", "second:tip", "point_on_line", direction=[1.0, 0.0])
    s.effect("load", "point_mass", point='"second:tip"', mass=s.number(0.3, 1.0))
    s.effect("spring", "spring_damper", joint='"sl"', stiffness=s.number(200, 1500), damping=s.number(0.5, 3.0),
             rest=a + b + s.number(-0.02, 0.02))  # fmt: skip
    s.effect("weight", "gravity")
    if stop:
        lower, stiffness = s.number(-0.3, 0.0), s.number(100, 1000)
        s.effect("stop", "end_stop", joint='"j0"', lower=lower, stiffness=stiffness, damping=0.3)
    s.effect("brake", "joint_friction", joint='"knee"', limit=s.number(0.02, 0.1), speed=s.number(0.1, 0.3))
    s.outputs(q='type = "angle", joint = "j0"', x='type = "sliding", joint = "sl"',
              mid='type = "deformation", point = "second:middle", axis = "y", frame = "body"',
              s='type = "stress", body = "second", quantity = "stress_max"')  # fmt: skip
    start = f"[simulation]\nduration = 0.5\n[simulation.initial.q]\nposition = {q!r}\n"
    return s.text('[coordinates.q]\njoint = "j0"\nrange = [-1.2, 1.2]\n') + start


def radii(rng: np.random.Generator, stop: bool) -> str:
    """Return a slider-crank with friction whose rod has a radius by chance, with a spring or a stop."""
    before, after = slider(rng, stop).split("[bodies.rod]")
    r = float(after.split("radius = ")[1].split(" ")[0])
    made = f'[parameters.r]\nnominal = {r!r}\nbounds = [{0.7 * r!r}, {1.3 * r!r}]\n' \
           f'distribution = {{ name = "norm", loc = {r!r}, scale = {0.1 * r!r} }}\n'  # fmt: skip
    return before + "[bodies.rod]" + after.replace(f"radius = {r!r}", 'radius = "r"', 1) + made


def two(rng: np.random.Generator, stop: bool) -> str:
    """Return a five-bar of two coordinates with friction, perhaps between stops."""
    s = Made(rng, "left = [-0.15, 0.0]\nright = [0.15, 0.0]")
    for name, place, angle in (("left", -0.15, 2.0), ("right", 0.15, 1.1416)):
        s.bar(f"{name}_crank", 0.25, 4, s.material(), circle(s.number(0.005, 0.007)), (place, 0.0), angle)
    for name, place, angle in (("left", (-0.254, 0.2273), 0.9), ("right", (0.254, 0.2273), 2.24)):
        s.bar(f"{name}_bar", 0.4, 6, "alu", circle(s.number(0.004, 0.006)), place, angle)
    for name in ("left", "right"):
        s.joint(name, f"ground:{name}", f"{name}_crank:hinge")
        s.joint(f"{name}_elbow", f"{name}_crank:tip", f"{name}_bar:hinge")
    s.joint("tip", "left_bar:tip", "right_bar:tip")
    for name in ("left", "right"):
        motor = f"{{ amplitude = {s.number(0.1, 0.3)!r}, frequency_hz = {s.number(1.0, 3.0)!r} }}"
        s.effect(f"{name}_motor", "torque", joint=f'"{name}"', harmonic=motor)
        s.effect(f"{name}_brake", "joint_friction", joint=f'"{name}"', limit=s.number(0.01, 0.04), speed=0.1)
        if stop:
            s.effect(f"{name}_stop", "end_stop", joint=f'"{name}"', stiffness=s.number(20, 100), damping=0.3,
                     lower=(1.9 if name == "left" else 1.0), upper=(2.1 if name == "left" else 1.3))  # fmt: skip
    s.effect("tool", "point_mass", point='"left_bar:tip"', mass=s.number(0.1, 0.3))
    s.outputs(l='type = "angle", joint = "left"', r='type = "angle", joint = "right"',
              x='type = "position", point = "left_bar:tip", axis = "x"',
              tip='type = "deformation", point = "left_bar:tip", axis = "y"')  # fmt: skip
    places = "left = { position = 2.0 }\nright = { position = 1.1416 }\n"
    start = f"[simulation]\nduration = 0.4\n[simulation.initial]\n{places}"
    ranges = (("left", [1.2, 2.8]), ("right", [0.4, 1.9]))
    return s.text("".join(f'[coordinates.{name}]\njoint = "{name}"\nrange = {ends}\n' for name, ends in ranges)) + start


def solid(rng: np.random.Generator, stop: bool) -> str:
    """Return the slider-crank of plane-stress bodies with friction at the slider, a spring or a stop."""
    text, s = (SCENES / "slider_crank_solid2d.toml").read_text(), Made(rng)
    mass = s.number(0.2, 1.0)
    added = f'[effects.load]\ntype = "point_mass"\npoint = "rod:tip"\nmass = {mass!r}\n[effects.brake]\n' \
            f'type = "joint_friction"\njoint = "slider"\nlimit = {s.number(0.3, 1.0)!r}\nspeed = 0.02\n'  # fmt: skip
    kind = f'type = "end_stop"\nlower = {s.number(0.5, 0.8)!r}\nstiffness = {s.number(1e4, 1e5)!r}\ndamping = 0.3\n'
    if not stop:
        kind = f'type = "spring_damper"\nstiffness = {s.number(5.0, 30.0)!r}\ndamping = 0.5\nrest = 0.8\n'
    text = text.replace("[reduction]", f'{added}[effects.other]\njoint = "slider"\n{kind}[reduction]')
    return text.replace('"../meshes', f'"{SCENES.parent}/meshes')


KINDS: dict[str, tuple[Callable[[np.random.Generator, bool], str], bool]] = {
    "four_bar": (four_bar, False), "four_bar_stop": (four_bar, True), "slider": (slider, False),
    "slider_stop": (slider, True), "frame_rope": (frame, True), "frame_friction": (frame, False),
    "arm": (arm, False), "arm_stop": (arm, True), "rssr_friction": (rssr, True), "rssr_spring": (rssr, False),
    "press": (press, False), "press_spring": (press, True), "toggle": (toggle, False), "toggle_stop": (toggle, True),
    "radii": (radii, False), "radii_stop": (radii, True), "two": (two, False), "two_stops": (two, True),
    "solid": (solid, False), "solid_stop": (solid, True),
}  # fmt: skip


def measure(path: Path, refinement: int) -> list[str]:
    """Return a line for every output: true error, its doubt, and the estimate over it."""
    case = Case(path)
    scene, meshes = case.read((), Purpose.BUILD)
    values = Sampler(scene, Plan(1, SEED)).draw(0, 1) if scene.parameters else {"none": np.zeros(1)}
    with RankGroup.split(MPI.COMM_SELF, 1) as group:
        model = ReducedModel(scene, build_rom(scene, meshes, group))
    reference = refer(case, (), values, refinement)
    while refinement > 2 and not all(np.isfinite(one).all() for one in reference.exact.values()):
        refinement //= 2
        reference = refer(case, (), values, refinement)
    found = compare(model, reference, values)
    lines = []
    for name, (share, (ratio,), (doubt,)) in found.items():
        if np.isnan(share):
            lines.append(f"| {path.stem} | {name} | the run or its reference stopped | | |")
            continue
        verdict = "not estimated" if np.isnan(ratio) else f"{ratio:.2f}"
        beyond = " beyond" if ratio > FACTOR or ratio < 1.0 / FACTOR else ""
        lines.append(f"| {path.stem} | {name} | {100 * share:.2g} % | {doubt:.2g} | {verdict}{beyond} |")
    return lines


def main() -> int:
    """Print a table of all mechanisms."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.random_mechanisms", description=__doc__.split("\n")[0])
    parser.add_argument("names", nargs="*", choices=[*KINDS, []], metavar="NAME", help=f"of {', '.join(KINDS)}")
    parser.add_argument("--refinement", type=int, default=16, metavar="K", help="steps of the reference in one")
    parser.add_argument("--seed", type=int, default=0, metavar="S")
    parser.add_argument("--each", type=int, default=3, metavar="N", help="mechanisms of a name")
    given = parser.parse_args()
    start_petsc()

    def run() -> None:
        print("| mechanism | output | true error | doubt | estimated over true |\n| --- | --- | --- | --- | --- |")
        with tempfile.TemporaryDirectory() as folder:
            for number, (name, (make, choice)) in enumerate(KINDS.items()):
                for k in range(given.each if name in given.names or not given.names else 0):
                    path = Path(folder) / f"{name}_{k}.toml"
                    path.write_text(make(np.random.default_rng([given.seed, number, k]), choice))
                    try:
                        lines = measure(path, given.refinement)
                    except (InputError, RunError) as error:
                        lines = [f"| {path.stem} | not built: {error} | | | |"]
                    print("\n".join(lines), flush=True)

    return guarded(run)


if __name__ == "__main__":
    end(main())
