"""Scenes of machines that slide: a cart with a pole, an arm on a rail, and runs of them in every model."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from runs import MODELS, history, samples
from scipy.integrate import solve_ivp

from pgmp_petsc.scene import Scene, scene_from_toml
from scenes import HEADER, of_text, tables

# a cart on a rail with a pole that swings, which starts level
CART = HEADER + tables("""
bodies.cart: line = { length = 0.2, elements = 1 }; element = "beam2d"; material = "steel"; flexible = false;
    section = { shape = "rectangle", width = 0.05, height = 0.05 }
bodies.pole: line = { length = 0.5, elements = 4 }; element = "beam2d"; material = "steel";
    section = { shape = "rectangle", width = 0.01, height = 0.02 }
joints.rail: type = "point_on_line"; connect = ["ground:origin", "cart:hinge"]; direction = [1.0, 0.0]
joints.rail2: type = "point_on_line"; connect = ["ground:origin", "cart:tip"]; direction = [1.0, 0.0]
joints.pivot: type = "revolute"; connect = ["cart:hinge", "pole:hinge"]
coordinates.x: joint = "rail"; motion = "sliding"; range = [-0.5, 0.5]
coordinates.swing: joint = "pivot"; range = [-3.4, 0.3]
effects.weight: type = "gravity"
reduction: modes = 2; angles = 14; static_modes = true
simulation: duration = 0.4; step = 1e-3
outputs.x: type = "sliding"; joint = "rail"
outputs.swing: type = "angle"; joint = "pivot"
outputs.bent: type = "deformation"; point = "pole:tip"; axis = "y"; frame = "body"
""")  # the cart's turning is held by its second point, the pole has one freedom of its own
cart = of_text(CART)
RIGID = ("bodies.pole.flexible=false", "outputs={x={type='sliding',joint='rail'},swing={type='angle',joint='pivot'}}")

RAIL = HEADER + tables("""
bodies.arm: line = { length = 0.5, elements = 4 }; element = "beam3d"; material = "steel";
    section = { shape = "rectangle", width = 0.02, height = 0.02 }; orientation = [0.0, 1.0, 0.0]
joints.rail: type = "prismatic"; connect = ["ground:origin", "arm:hinge"]; axis = [0.0, 1.0, 0.0]
coordinates.x: joint = "rail"; range = [-0.2, 0.5]
reduction: modes = 3; angles = 12; static_modes = true; inertia_modes = true
simulation: duration = 0.3; step = 1e-3
outputs.x: type = "sliding"; joint = "rail"
outputs.v: type = "speed"; joint = "rail"
outputs.tip: type = "deformation"; point = "arm:tip"; axis = "y"
""")
IN_PLANE = (
    RAIL.replace("beam3d", "beam2d")
    .replace("orientation = [0.0, 1.0, 0.0]", "")
    .replace("[0.0, 1.0, 0.0]", "[0.0, 1.0]")
)
RAIL_MASS = 7800.0 * 0.5 * 0.02**2


def rail(*overrides: str, dimension: int = 3) -> Scene:
    return scene_from_toml(RAIL if dimension == 3 else IN_PLANE, ".", overrides)


def run(scene: Scene, model: str, every: int = 1, **values: float) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Return times and outputs of the scene's run, after every so many steps, at other values of parameters."""
    times, outputs = history(MODELS[model](scene), samples(scene, 1, **values), 1, every)
    return times, {name: values[:, 0] for name, values in outputs.items()}


@dataclass(frozen=True)
class CartAndPole:
    """The cart and the pole as rigid bodies: masses (kg), half the pole's length (m), its inertia about its middle."""

    cart: float = 7800.0 * 0.2 * 0.05**2
    pole: float = 7800.0 * 0.5 * 0.01 * 0.02
    half: float = 0.25
    inertia: float = 7800.0 * 0.5 * 0.01 * 0.02 * (0.5**2 + 0.02**2) / 12.0

    def motion(
        self, times: np.ndarray, start: tuple[float, ...], force: Callable[..., float] = lambda *_: 0.0,
        torque: Callable[..., float] = lambda *_: 0.0, gravity: float = 9.80665,
    ) -> np.ndarray:  # fmt: skip
        """Return x and the angle, shape (2, n), for a force along the rail and a torque, of (t, x, phi, x', phi')."""

        def rates(t: float, y: np.ndarray) -> np.ndarray:
            _, phi, v, w = y
            lever = self.pole * self.half
            mass = [
                [self.cart + self.pole, -lever * np.sin(phi)],
                [-lever * np.sin(phi), self.inertia + lever * self.half],
            ]
            right = [force(t, *y) + lever * np.cos(phi) * w * w, torque(t, *y) - lever * gravity * np.cos(phi)]
            return np.concatenate([y[2:], np.linalg.solve(mass, right)])

        return solve_ivp(rates, (0.0, times[-1]), start, "DOP853", times, rtol=1e-10, atol=1e-12).y[:2]


#: Each acts on one joint, and hangs on the other: a torque and a formula, forces along a joint and at a point.
ACROSS = (
    'effects.motor={type="torque",joint="pivot",over="rail",table=[[-0.2,-0.6],[0.0,0.0],[0.2,0.8]],scale="factor"}',
    'effects.follow={type="law",joint="rail",over="pivot",force="k * (s + 1.2) - c * v",constants={k=2.0,c="drag"}}',
    'effects.push={type="force",joint="rail",over="pivot",table=[[-3.0,1.0],[-1.5,-0.5],[0.0,1.5]]}',
    'effects.blow={type="force",point="pole:tip",direction=[1.0,0.0],over="rail",table=[[-0.1,1.0],[0.3,0.2]]}',
    "parameters.factor={nominal=2.0}", "parameters.drag={nominal=0.3}", "simulation.initial.x.velocity=0.3",
)  # fmt: skip

#: A cart with every entry of machines: rigid bodies by their mass, formulas, a shaken base, loads over joints.
EVERYTHING = (
    "bodies.cart={rigid={mass=3.9,centre=[0.1,0.0],inertia=0.0138,points={hinge=[0,0],tip=[0.2,0]}}}",
    'effects.cogging={type="law",joint="pivot",force="A * sin(12 * s) - c * v * (t > 0.1)",constants={A=0.2,c="drag"}}',
    'effects.pull={type="law",points=["ground:origin","pole:tip"],force="-k * (s - 0.5)",constants={k=3.0}}',
    'effects.base={type="base_motion",direction=[1.0,0.0],of="velocity",table=[[0.0,0.0],[0.2,0.1],[0.4,0.0]]}',
    'effects.motor={type="torque",joint="pivot",over="pivot",table=[[-3.0,0.3],[0.3,0.0]]}',
    'effects.push={type="force",joint="rail",table=[[0.0,0.0],[0.1,8.0]]}',
    'effects.rub={type="joint_friction",joint="rail",motion="sliding",limit=0.1,speed=0.1}',
    "parameters.drag={nominal=0.01}",
    'outputs.place={type="position",point="pole:tip",axis="x",absolute=true}',
    'outputs.jolt={type="rate",of="place",order=2}',
    'outputs.weighed={type="formula",formula="drag * jolt / max(abs(jolt), 1) + t * drag",unit="1"}',
)


def errors_of(
    scene: Callable[[str], Scene], model: str, exact: Callable[[np.ndarray], dict[str, np.ndarray]], *steps: float
) -> np.ndarray:
    """Return the largest errors of outputs, shape (n_steps, n_outputs), of runs with these steps against what outputs
    are exactly at their times."""
    found = []
    for step in steps:
        times, outputs = run(scene(f"simulation.step={step}"), model)
        found.append([np.abs(outputs[name] - values).max() for name, values in exact(times).items()])
    return np.array(found)


def cart_errors(
    entries: tuple[str, ...], start: tuple[float, ...], *of: Callable[..., float]
) -> Callable[..., np.ndarray]:
    """Return what gives the errors of a rigid cart's x and its pole's angle, as `errors_of` does, for steps; from a
    start, under the force and the torque that are given."""

    def exact(times: np.ndarray) -> dict[str, np.ndarray]:
        return dict(zip(("x", "swing"), CartAndPole().motion(times, start, *of)))

    return lambda *steps: errors_of(lambda step: cart(*RIGID, *entries, step), "full", exact, *steps)
