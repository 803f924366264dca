"""Scenes, meshes and figures that the hard cases share. The table of the cases is docs/hard_cases.md."""

from collections.abc import Mapping
from functools import lru_cache

import numpy as np
import scipy.linalg
from pencils import constraints_at, dense_of
from runs import history, rom_of, samples

from pgmp_petsc.bodies.affine import evaluate_weights
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mesh import LineMesh
from pgmp_petsc.models import FullModel, ReducedModel
from pgmp_petsc.reduction.interpolation import interpolant
from pgmp_petsc.reduction.rom import ReducedOrderModel
from pgmp_petsc.scene import Scene
from scenes import meshes_of, slider_crank

OUTPUTS = (
    'outputs.angle={type="angle", joint="crank_hinge"}',
    'outputs.bent={type="deformation", point="rod:tip", axis="x"}',
    'outputs.slider={type="position", point="rod:tip", axis="x"}',
)
GRAVITY = 'effects.weight={type="gravity"}'
QUIET = "effects.motor.table=[[0.0, 0.0]]"  # without torque; the load and its static mode stay in the model
Outputs = dict[str, np.ndarray]


def accurate(*overrides: str, angles: int = 96) -> Scene:
    """Return the slider-crank with 7 modes and a static one, splines, and outputs angle, bent and slider."""
    return slider_crank(
        "reduction.modes=7", "reduction.static_modes=true", f"reduction.angles={angles}",
        'reduction.interpolation="spline"', *OUTPUTS, *overrides,
    )  # fmt: skip


@lru_cache(maxsize=1)
def nominal_rom() -> ReducedOrderModel:
    """Return the model of `accurate`; start, duration and the torque's table have no part in it."""
    return rom_of(accurate())


def start(position: float, velocity: float = 0.0) -> tuple[str, str]:
    """Return the overrides of the slider-crank's start (rad, rad/s)."""
    return f"simulation.initial.theta.position={position}", f"simulation.initial.theta.velocity={velocity}"


def run_for(duration: float, step: float) -> tuple[str, str]:
    return f"simulation.duration={duration}", f"simulation.step={step}"


def smooth_torque(duration: float, peak: float) -> str:
    """Return the override of a torque ``256 peak u^4 (1 - u)^4``, u from 0 to 1 over the duration.

    It excites no vibration that the steps do not resolve, so that the order of the integrator can be seen.
    """
    u = np.linspace(0.0, 1.0, 401)
    rows = ", ".join(f"[{t}, {torque}]" for t, torque in zip(duration * u, 256 * peak * (u * (1 - u)) ** 4))
    return f"effects.motor.table=[{rows}]"


def flywheel(length: float, differ: float = 0.0, n_cells: int = 4, n_arm: int = 5) -> LineMesh:
    """Return a crank of 0.3 m with three equal blades on its hub, 120 degrees apart; one blade's tip is a point.

    With the hub pinned, blades that bend with amplitudes of sum zero leave the hub at rest: each frequency of a clamped
    blade is there twice, whatever the rest of the mechanism does. `differ` is the relative difference in length (m)
    from a blade to the next.
    """
    nodes = [np.column_stack([np.linspace(0.0, 0.3, n_arm + 1), np.zeros(n_arm + 1)])]
    cells, first = [np.column_stack([np.arange(n_arm), np.arange(1, n_arm + 1)])], n_arm + 1
    for blade in range(3):
        angle = 0.4 + 2 * np.pi / 3 * blade
        radius = length * (1 + blade * differ) * np.arange(1, n_cells + 1) / n_cells
        nodes.append(radius[:, None] * [np.cos(angle), np.sin(angle)])
        line = np.concatenate([[0], first + np.arange(n_cells)])
        cells.append(np.column_stack([line[:-1], line[1:]]))
        first += n_cells
    points = {"hinge": 0, "tip": n_arm, "blade": n_arm + n_cells}
    return LineMesh(np.vstack(nodes), np.vstack(cells), points)


def with_flywheel(*overrides: str) -> Scene:
    """Return the slider-crank, loaded by gravity and the motor, for a crank with blades; 9 modes hold two pairs."""
    return slider_crank(
        "bodies.rod.section.radius=8e-3", GRAVITY, "reduction.modes=9", "reduction.angles=48",
        'reduction.interpolation="spline"', *OUTPUTS, 'outputs.blade={type="rotation", point="crank:blade"}',
        "simulation.duration=0.3", *start(0.0, 8.0), *overrides,
    )  # fmt: skip


def flywheel_meshes(scene: Scene, length: float = 0.25, differ: float = 0.0) -> dict[str, LineMesh]:
    return {"crank": flywheel(length, differ), "rod": meshes_of(scene)["rod"]}


def dense_eigenvalues(kinematics: RigidKinematics, theta: float, values: Mapping[str, float], n: int) -> np.ndarray:
    """Return the n lowest flexible eigenvalues, by SciPy's dense solver on a null space of the constraints.

    Unknowns are scaled to a unit diagonal of K, and the solver is given ``M x = mu (K + s M) x``, ``mu = 1 / (lambda +
    s)``: the largest mu are good to round-off, 1e-11 where radii differ by a factor of ten (checked with 40 digits).
    On K and M unscaled it errs by round-off of the highest lambda, there 7e-7 of the lowest.
    """
    (stiffness, mass), shift = dense_of(kinematics.mechanism, values), 1e4
    scale = 1 / np.sqrt(np.diag(stiffness))
    null = scale[:, None] * scipy.linalg.null_space(constraints_at(kinematics, theta) * scale)
    stiffness, mass = null.T @ stiffness @ null, null.T @ mass @ null
    mu = scipy.linalg.eigvalsh(mass, stiffness + shift * mass)[::-1]
    return 1 / mu[1 : n + 1] - shift


def interpolated_eigenvalues(rom: ReducedOrderModel, scene: Scene, theta: float) -> np.ndarray:
    """Return the eigenvalues of the flexible part of the interpolated tables at the nominal parameters."""
    tables, scheme = rom.tables, scene.interpolation

    def at(weights: tuple, table: np.ndarray) -> np.ndarray:
        total = np.einsum("t,nt...->n...", evaluate_weights(weights, scene.nominal), table)
        return interpolant(tables.samples.axes[0], total, scheme)(np.array([theta]))[0]

    mass = at(tables.mass_weights, tables.mass)[tables.n_coordinates :, tables.n_coordinates :]
    return scipy.linalg.eigvalsh(at(tables.stiffness_weights, tables.stiffness), mass)


def both(
    scene: Scene, values: Mapping[str, np.ndarray] | None = None, n: int = 1, rom: ReducedOrderModel | None = None
) -> tuple[Outputs, Outputs]:
    """Return the outputs over time of the full-order and the reduced model, each of shape (n_t, n)."""
    rom = rom_of(scene) if rom is None else rom
    values = samples(scene, n) if values is None else values
    return tuple(history(model, values, n)[1] for model in (FullModel(scene, rom.meshes), ReducedModel(scene, rom)))
