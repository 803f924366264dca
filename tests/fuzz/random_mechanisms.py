"""Random planar mechanisms of flexible beams as scenes: chains, four-bars and slider-cranks, with random effects.

Lengths, sections, materials, loads and effects are drawn so that the mechanism is one that somebody might build: it
assembles, turns without a dead centre where it is to turn, and its loads move it by radians, not by thousands of turns.
Whether its deformations are small is left to chance.
"""

import math
from dataclasses import dataclass, field

import numpy as np

MATERIALS = {
    "steel": "E = 210e9\nnu = 0.3\nrho = 7850.0",
    "aluminium": "E = 70e9\nnu = 0.33\nrho = 2700.0",
    "polymer": "E = 3e9\nnu = 0.38\nrho = 1200.0",
}
DENSITIES = {"steel": 7850.0, "aluminium": 2700.0, "polymer": 1200.0}
KINDS = ("pendulum", "double_pendulum", "four_bar", "slider_crank")
FULL_TURN = "range = [0.0, 6.283185307179586]\nperiodic = true"
SECOND_ORDER = {
    "none": "",
    "terms": "",
    "effects": '[effects.stiffening]\ntype = "geometric_stiffening"\n[effects.shapes]\ntype = "mode_inertia"\n',
}


@dataclass
class Link:
    """One body: a straight beam with a place to begin the assembly at."""

    name: str
    length: float
    elements: int
    material: str
    height: float
    width: float
    origin: tuple[float, float]
    angle: float

    @property
    def mass(self) -> float:
        """Mass, kg."""
        return DENSITIES[self.material] * self.height * self.width * self.length

    def toml(self) -> str:
        """Return the body's table."""
        return (
            f"[bodies.{self.name}]\nline = {{ length = {self.length:.6g}, elements = {self.elements} }}\n"
            f'element = "beam2d"\nmaterial = "{self.material}"\n'
            f'section = {{ shape = "rectangle", width = {self.width:.6g}, height = {self.height:.6g} }}\n'
            f"placement = {{ origin = [{self.origin[0]:.6g}, {self.origin[1]:.6g}], angle = {self.angle:.6g} }}\n"
        )


@dataclass
class Drawing:
    """What has been drawn of one mechanism."""

    kind: str
    links: list[Link]
    joints: list[str]
    coordinates: list[str]
    ground: str = ""
    effects: list[str] = field(default_factory=list)


def random_scene(seed: int, kinds: tuple[str, ...] = KINDS) -> str:
    """Return a scene as TOML; equal seeds give equal scenes."""
    rng = np.random.default_rng(seed)
    kind = kinds[rng.integers(len(kinds))]
    drawing = DRAWN[kind](rng)
    second_order = ("none", "terms", "effects")[rng.integers(3)] if len(drawing.coordinates) == 1 else "none"
    _add_effects(drawing, rng)
    angles = 48 if len(drawing.coordinates) == 1 else 12
    parts = [
        f'[scene]\nname = "random_{seed}"\ndescription = "{kind}"\n',
        *(f"[materials.{name}]\n{MATERIALS[name]}\n" for name in sorted({link.material for link in drawing.links})),
        drawing.ground,
        *(link.toml() for link in drawing.links),
        *drawing.joints,
        *drawing.coordinates,
        *drawing.effects,
        SECOND_ORDER[second_order],
        f"[reduction]\nmodes = {rng.integers(3, 7)}\nstatic_modes = true\ninertia_modes = true\nangles = {angles}\n"
        f'interpolation = "spline"\nsecond_order = {"true" if second_order == "terms" else "false"}\n',
        "[simulation]\nduration = 0.3\nstep = 1e-3\nspectral_radius = 0.8\n",
        '[outputs.angle]\ntype = "angle"\njoint = "base"\n',
        f'[outputs.bending]\ntype = "deformation"\npoint = "{drawing.links[-1].name}:middle"\naxis = "y"\n',
    ]
    return "\n".join(part for part in parts if part)


def _link(
    rng: np.random.Generator, name: str, length: float, origin: tuple[float, float] = (0.0, 0.0), angle: float = 0.0
) -> Link:
    height = length / np.exp(rng.uniform(math.log(15.0), math.log(100.0)))
    material = str(rng.choice(sorted(MATERIALS)))
    return Link(
        name, length, 2 * int(rng.integers(2, 5)), material, height, height * rng.uniform(0.8, 3.0), origin, angle
    )


def _hinge(name: str, one: str, other: str) -> str:
    return f'[joints.{name}]\ntype = "revolute"\nconnect = ["{one}", "{other}"]\n'


def _coordinate(name: str, joint: str) -> str:
    return f'[coordinates.{name}]\njoint = "{joint}"\n{FULL_TURN}\n'


def _pendulum(rng: np.random.Generator) -> Drawing:
    link = _link(rng, "arm", rng.uniform(0.2, 1.5))
    return Drawing("pendulum", [link], [_hinge("base", "ground:origin", "arm:hinge")], [_coordinate("theta", "base")])


def _double_pendulum(rng: np.random.Generator) -> Drawing:
    first = _link(rng, "arm", rng.uniform(0.3, 1.0))
    second = _link(rng, "forearm", rng.uniform(0.3, 1.0), (first.length, 0.0))
    joints = [_hinge("base", "ground:origin", "arm:hinge"), _hinge("elbow", "arm:tip", "forearm:hinge")]
    return Drawing(
        "double_pendulum", [first, second], joints, [_coordinate("theta", "base"), _coordinate("phi", "elbow")]
    )


def _four_bar(rng: np.random.Generator) -> Drawing:
    while True:
        crank, coupler, rocker, base = rng.uniform(0.1, 0.3), *rng.uniform(0.4, 1.2, 3)
        longest = max(coupler, rocker, base)
        # Grashof's condition, with room to spare so that no dead centre is near
        if crank + longest < 0.9 * (coupler + rocker + base - longest):
            break
    # at a crank angle of zero
    span = base - crank
    along = (coupler**2 - rocker**2 + span**2) / (2 * span)
    up = math.sqrt(coupler**2 - along**2)
    links = [
        _link(rng, "crank", crank),
        _link(rng, "rocker", rocker, (base, 0.0), math.atan2(up, along - span)),
        _link(rng, "coupler", coupler, (crank, 0.0), math.atan2(up, along)),
    ]
    joints = [
        _hinge("base", "ground:origin", "crank:hinge"),
        _hinge("elbow", "crank:tip", "coupler:hinge"),
        _hinge("knee", "coupler:tip", "rocker:tip"),
        _hinge("pivot", "ground:pivot", "rocker:hinge"),
    ]
    ground = f"[ground.points]\npivot = [{base:.6g}, 0.0]\n"
    return Drawing("four_bar", links, joints, [_coordinate("theta", "base")], ground)


def _slider_crank(rng: np.random.Generator) -> Drawing:
    crank = rng.uniform(0.1, 0.4)
    rod = crank * rng.uniform(1.6, 4.0)
    links = [_link(rng, "crank", crank), _link(rng, "rod", rod, (crank, 0.0))]
    joints = [
        _hinge("base", "ground:origin", "crank:hinge"),
        _hinge("elbow", "crank:tip", "rod:hinge"),
        '[joints.slider]\ntype = "point_on_line"\nconnect = ["ground:origin", "rod:tip"]\ndirection = [1.0, 0.0]\n',
    ]
    return Drawing("slider_crank", links, joints, [_coordinate("theta", "base")])


def _felt_inertia(drawing: Drawing) -> float:
    """Return about what the first joint has to turn, kg m2: of a loop, its links as they follow the crank's tip."""
    first, *others = drawing.links
    own = first.mass * first.length**2 / 3.0
    if len(drawing.coordinates) > 1:
        return own + sum(link.mass * (first.length + link.length) ** 2 for link in others)
    return own + sum(link.mass * first.length**2 / 2.0 for link in others)


def _add_effects(drawing: Drawing, rng: np.random.Generator) -> None:
    """Add a motor, and each further effect by the toss of a coin."""
    inertia = _felt_inertia(drawing)
    torque = inertia * rng.uniform(2.0, 60.0)
    ramp = rng.uniform(0.02, 0.2)
    motor = f'type = "torque"\njoint = "base"\ntable = [[0.0, 0.0], [{ramp:.4g}, {torque:.4g}], [1.0, {torque:.4g}]]'
    last = drawing.links[-1].name
    mass = min(link.mass for link in drawing.links)
    chances = {
        "motor": (0.8, motor),
        "weight": (0.5, 'type = "gravity"'),
        "push": (
            0.2,
            f'type = "force"\npoint = "{last}:middle"\ndirection = [0.3, 1.0]\n'
            f"harmonic = {{ amplitude = {mass * rng.uniform(0.5, 10.0):.4g}, frequency_hz = {rng.uniform(1, 8):.3g} }}",
        ),
        "tool": (0.3, f'type = "point_mass"\npoint = "{last}:tip"\nmass = {mass * rng.uniform(0.05, 0.5):.4g}'),
        "bearing": (
            0.3,
            f'type = "joint_damping"\njoint = "base"\ncoefficient = {inertia * rng.uniform(0.1, 2.0):.4g}',
        ),
        "rubbing": (0.15, f'type = "joint_friction"\njoint = "base"\nlimit = {0.2 * torque:.4g}\nspeed = 0.05'),
        "spring": (0.2, f'type = "spring_damper"\njoint = "base"\nstiffness = {inertia * rng.uniform(1.0, 50.0):.4g}'),
        "material": (0.4, f'type = "structural_damping"\nstiffness = {rng.uniform(1e-5, 3e-4):.3g}'),
    }
    drawn = [f"[effects.{name}]\n{text}\n" for name, (chance, text) in chances.items() if rng.random() < chance]
    drawing.effects = drawn or [f"[effects.weight]\n{chances['weight'][1]}\n"]


DRAWN = {
    "pendulum": _pendulum, "double_pendulum": _double_pendulum, "four_bar": _four_bar, "slider_crank": _slider_crank,
}  # fmt: skip
