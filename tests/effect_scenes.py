"""Small scenes with bodies by `line`, and their full-order runs, for tests of effects."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI
from runs import full_model
from scipy.integrate import solve_ivp
from scipy.linalg import eigh

from pgmp_petsc.bodies.matrices import AffineMatrices, weighted_sum
from pgmp_petsc.models import FullModel
from pgmp_petsc.results import Balance
from pgmp_petsc.scene import Scene, scene_from_toml
from pgmp_petsc.stepping.generalised_alpha import integrate
from pgmp_petsc.stepping.second_order_system import Observer, SecondOrderSystem, State, joined
from pgmp_petsc.studies.single_run import balance_of
from scenes import tables

G = 9.80665  # m/s2
STEP = 2e-3  # s

# a uniform bar of 1 kg and 1 m that turns about its end: J = 1/3 kg m2
BAR = tables("""
scene: name = "bar"
bodies.bar: line = { length = 1.0, elements = 2 }; element = "beam2d"; flexible = false;
    section = { shape = "coefficients", axial = 1.0, shear = 1.0, bending = 1.0, line_density = 1.0 }
joints.hinge: type = "revolute"; connect = ["ground:origin", "bar:hinge"]
coordinates.theta: joint = "hinge"; range = [0.0, 6.283185307179586]; periodic = true
""")
BAR_INERTIA = 1.0 / 3.0

# a light and stiff crank pushes a block, a rigid bar of 1 kg, along x; both ends of the block are on the line
BLOCK = tables("""
scene: name = "block"
ground.points: rail = [0.0, 0.0]
bodies.crank: line = { length = 0.5, elements = 1 }; element = "beam2d"; flexible = false;
    section = { shape = "coefficients", axial = 1.0, shear = 1.0, bending = 1.0, line_density = 1e-6 };
    placement = { origin = [0.0, 0.0], angle = 1.5707963267948966 }
bodies.rod: line = { length = 1.0, elements = 1 }; element = "beam2d"; flexible = false;
    section = { shape = "coefficients", axial = 1.0, shear = 1.0, bending = 1.0, line_density = 1e-6 };
    placement = { origin = [0.0, 0.5], angle = -0.5235987755982988 }
joints.pivot: type = "revolute"; connect = ["ground:origin", "crank:hinge"]
joints.pin: type = "revolute"; connect = ["crank:tip", "rod:hinge"]
joints.slide: type = "point_on_line"; connect = ["ground:rail", "rod:tip"]; direction = [1.0, 0.0]
coordinates.theta: joint = "pivot"; range = [0.3, 2.8]
effects.load: type = "point_mass"; point = "rod:tip"; mass = 1.0
simulation.initial.theta: position = 1.5707963267948966
""")

# a beam of 1 m clamped to a hub that is held: EI = 1, rho A = 1, stiff against shear and extension
CANTILEVER = tables("""
scene: name = "cantilever"
[bodies.beam]
line = { length = 1.0, elements = 8 }
element = "beam2d"
section = { shape = "coefficients", axial = 1e5, shear = 1e5, bending = 1.0, line_density = 1.0, rotary_density = 1e-5 }
joints.hub: type = "revolute"; connect = ["ground:origin", "beam:hinge"]
coordinates.theta: joint = "hub"; range = [0.0, 6.283185307179586]; periodic = true
effects.hold: type = "prescribed_motion"; coordinate = "theta"; constant_speed = { speed = 0.0 }
""")
# a rigid crank, a flexible rod, a slider; a coordinate that is driven, in a range without 0; and a weld
BASE = tables("""
scene: name = "base"
parameters.p: nominal = 1.0
parameters.negative: nominal = -1.0
ground.points: wall = [2.0, 0.0]
bodies.crank: line = { length = 0.3, elements = 2 }; element = "beam2d"; flexible = false;
    section = { shape = "coefficients", axial = 1.0, shear = 1.0, bending = 1.0, line_density = 1.0 }
[bodies.rod]
line = { length = 0.7, elements = 2 }
element = "beam2d"
section = { shape = "coefficients", axial = 1e5, shear = 1e5, bending = 10.0, line_density = 1.0, \
rotary_density = 1e-4 }
placement = { origin = [0.3, 0.0] }
bodies.block: line = { length = 0.1, elements = 1 }; element = "beam2d"; flexible = false;
    section = { shape = "coefficients", axial = 1.0, shear = 1.0, bending = 1.0, line_density = 1.0 };
    placement = { origin = [1.0, 0.0] }
joints.hinge: type = "revolute"; connect = ["ground:origin", "crank:hinge"]
joints.elbow: type = "revolute"; connect = ["crank:tip", "rod:hinge"]
joints.slider: type = "point_on_line"; connect = ["ground:origin", "rod:tip"]; direction = [1.0, 0.0]
joints.weld: type = "fixed"; connect = ["rod:tip", "block:hinge"]
coordinates.theta: joint = "hinge"; range = [-3.0, 3.0]
""")


def scene_of(base: str, text: str = "", *overrides: str) -> Scene:
    """Return a scene from a base above and further tables."""
    return scene_from_toml(base + text, ".", overrides)


@dataclass(frozen=True)
class Recorded:
    """A full-order run."""

    time: np.ndarray  # (n_t,), s
    frames: np.ndarray  # of all nodes, (n_t, n_nodes, 3)
    rates: np.ndarray  # of the frames, (n_t, n_nodes, 3)
    balance: Balance
    model: FullModel
    status: int  # of the sample

    @property
    def angle(self) -> np.ndarray:
        """The first coordinate, shape (n_t,), rad."""
        connection = self.model.kinematics.mechanism.coordinates[0].connection
        return self.side(connection.b)[:, 2] - self.side(connection.a)[:, 2]

    def point(self, address: str) -> np.ndarray:
        """Return the frame of a point, shape (n_t, 3)."""
        return self.side(self.model.kinematics.mechanism.attachment(address, "test"))

    def side(self, attachment: object) -> np.ndarray:
        """Return the frame of an attachment, shape (n_t, 3)."""
        if attachment.on_ground:
            return attachment.ground_frame((len(self.time),)).T
        return attachment.frame_of(self.frames[:, attachment.node].T).T


def run_distributed(scene: Scene, start: np.ndarray | None = None) -> Recorded:
    """Run the distributed model on one rank; `start` is added to the velocities at the start, shape (n_dofs,)."""
    model = full_model(scene)
    with model.distributed(scene.values, MPI.COMM_SELF) as system:
        return _run(model, system, start)


def run_batch(scene: Scene, n: int = 2, start: np.ndarray | None = None) -> Recorded:
    """Run a batch of equal samples; return the last one."""
    model = full_model(scene)
    return _run(model, model.batch({name: np.full(n, value) for name, value in scene.values.items()}, n), start)


def _run(model: FullModel, system: SecondOrderSystem, start: np.ndarray | None) -> Recorded:
    if start is not None:  # further velocities, which have to obey its constraints
        state = system.start()
        q, v = (system.unpack(part)[:, 0] for part in (state.q, state.v))
        theta = system._equations.initial[0]  # noqa: SLF001
        system.start = lambda: system.consistent(q, v + start, theta)
    n, times, frames, rates, instants = system.n_samples, [], [], [], []

    class Record(Observer):
        def over(self, numbers: np.ndarray, at: np.ndarray, states: State) -> None:
            times.extend(at)
            instants.append(system.energies_over(at, states)[n - 1 :: n])
            for kept, parts in ((frames, states.q), (rates, states.v)):
                kept.extend(system.unpack(part)[:, -1].reshape(-1, 3) for part in parts)

    run = integrate(system, model.scene.simulation, observer=Record())
    time = np.array(times)
    balance = balance_of(time, joined(instants))
    return Recorded(time, np.array(frames), np.array(rates), balance, model, int(run.status[-1]))


def recorded(scene: Scene, start: np.ndarray | None = None) -> Recorded:
    """Run the model of a sample, which comes to its end."""
    found = run_batch(scene, 1, start)
    assert found.status == 0
    return found


def run_of(duration: float, step: float = STEP, spectral_radius: float = 0.99, **initial: float) -> str:
    """Return the table of a simulation, with hardly any numerical damping unless told: with none at all steps of
    full-order models end with a projection, which takes them out of the compiled ones."""
    start = "".join(f"\n{key} = {value}" for key, value in initial.items())
    begin = f"[simulation.initial.theta]{start}\n" if initial else ""
    return tables(f"""
simulation: duration = {duration}; step = {step}; spectral_radius = {spectral_radius}
{begin}""")


def bar(effects: str, duration: float, step: float = STEP, **initial: float) -> Scene:
    """Return a rigid bar of 1 kg and 1 m that turns about its end."""
    return scene_of(BAR, effects + run_of(duration, step, **initial))


def turning(
    torque: Callable[[float, float, float], float],
    time: np.ndarray,
    position: float = 0.0,
    velocity: float = 0.0,
    inertia: float = BAR_INERTIA,
) -> np.ndarray:
    """Return the angle of a rigid bar under a torque of (t, angle, speed), good to ten digits."""
    found = solve_ivp(
        lambda t, y: [y[1], torque(t, *y) / inertia], (0.0, time[-1]), [position, velocity],
        "DOP853", time, rtol=1e-11, atol=1e-12, max_step=5e-3,
    )  # fmt: skip
    return found.y[0]


def linear_mode(scene: Scene, clamped: int, number: int) -> tuple[float, np.ndarray]:
    """Return angular frequency and shape (n_dofs,) of a mode of a single beam at rest, the unknowns `clamped` held."""
    model = full_model(scene)
    n = model.kinematics.mechanism.n_dofs
    matrices = AffineMatrices(model.kinematics.mechanism.bodies, range(n))
    free = np.setdiff1d(np.arange(n), clamped)
    mass, stiffness = (
        weighted_sum(m, scene.values).toarray()[np.ix_(free, free)] for m in (matrices.mass, matrices.stiffness)
    )
    squares, vectors = eigh(stiffness, mass)
    shape = np.zeros(n)
    shape[free] = vectors[:, number]
    return float(np.sqrt(squares[number])), shape / np.abs(shape).max()


#: Effects of every kind, on beams and on what is rigid between them.
EVERYTHING = (
    CANTILEVER.split("[effects.hold]")[0]
    + tables("""
ground.points: anchor = [0.4, 0.9]
bodies.pendant: line = { length = 0.4, elements = 2 }; element = "beam2d"; flexible = false;
    section = { shape = "coefficients", axial = 1.0, shear = 1.0, bending = 1.0, line_density = 1.0 };
    placement = { origin = [1.0, 0.0], angle = -0.5 }
[bodies.tail]
line = { length = 0.4, elements = 3 }
element = "beam2d"
section = { shape = "coefficients", axial = 1e4, shear = 1e4, bending = 5.0, line_density = 1.0, rotary_density = 1e-4 }
placement = { origin = [1.351, -0.1918], angle = -0.9 }
joints.weld: type = "fixed"; connect = ["beam:tip", "pendant:hinge"]
joints.second_weld: type = "fixed"; connect = ["pendant:tip", "tail:hinge"]
effects.motor: type = "torque"; joint = "hub"; harmonic = { amplitude = 2.0, frequency_hz = 3.0 }
effects.jet: type = "force"; point = "pendant:tip"; direction = [0.0, 1.0]; follows = true;
    table = [[0.0, 0.0], [0.2, 1.0]]
effects.rope: type = "force"; point = "beam:tip"; towards = "ground:anchor"; table = [[0.0, 0.5], [0.2, 0.5]]
effects.weight: type = "gravity"
effects.bob: type = "point_mass"; point = "pendant:tip"; mass = 0.2
effects.lump: type = "point_mass"; point = "beam:middle"; mass = 0.3; inertia = 0.01
effects.oil: type = "joint_damping"; joint = "hub"; coefficient = 0.1
effects.rub: type = "joint_friction"; joint = "hub"; limit = 0.1; speed = 0.2
effects.spring: type = "spring_damper"; points = ["ground:anchor", "tail:tip"]; stiffness = 3.0; damping = 0.1;
    rest = 0.5
effects.loss: type = "structural_damping"; bodies = ["beam"]; stiffness = 1e-3; mass = 0.2; ratios = [0.05, 0.02]
effects.stop: type = "end_stop"; joint = "hub"; lower = -0.05; stiffness = 300.0; damping = 0.2
""")
    + run_of(0.2, STEP, 0.8)
)
