"""What effects cost: processor time of a step and sample without any effect, with one of each type, and with all.

    python -m benchmarks.effect_cost scenes/slider_crank.toml

The mechanism of the scene is taken, with its first coordinate at `SPEED`; the effects are made up, of one type each, on
the joint of this coordinate and on its bodies. An end stop is never reached: it costs a look whether it is. All
together is without the prescribed motion, which excludes torque and stop.

The reduced model has effects of its own: terms of second order in the deformation, and inertia forces quadratic in the
velocities, which are there unless a scene leaves them out.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from time import process_time
from types import MappingProxyType

import numpy as np
from mpi4py import MPI

from benchmarks.programs import end, guarded
from pgmp_petsc.mechanism.capabilities import Purpose
from pgmp_petsc.mesh.meshes import LineMesh
from pgmp_petsc.models import FullModel, Model, ReducedModel
from pgmp_petsc.ranks.groups import RankGroup
from pgmp_petsc.ranks.petsc import start_petsc
from pgmp_petsc.reduction.build import build_rom
from pgmp_petsc.scene import Scene, scene_from_toml, scene_to_toml
from pgmp_petsc.stepping.generalised_alpha import integrate
from pgmp_petsc.studies.inputs import read_scene

N_SAMPLES, N_STEPS, N_REPEATS = 64, 50, 3
SPEED = 1.0  # rad/s: at rest the iteration of a step would have nothing to do
NONE, ALL = "none", "all"
DRIVE = "prescribed_motion"
WAVE = "harmonic = { amplitude = 1e-3, frequency_hz = 1.0 }"
SLOW, SECOND_ORDER = "without gyroscopic", "second order"
# no part of the reduced basis may depend on the effects: their costs are to be compared
SAME_BASIS = (
    "reduction.static_modes=false",
    "reduction.spring_modes=false",
    "reduction.parameter_modes=0",
    "reduction.second_order=false",
)
# entries of the reduced model alone, by the name of their line
OF_REDUCED = {
    SLOW: {"gyroscopic": '{ type = "gyroscopic", keep = false }'},
    SECOND_ORDER: {kind: f'{{ type = "{kind}" }}' for kind in ("geometric_stiffening", "mode_inertia")},
}


@dataclass(frozen=True)
class EffectCost:
    """Processor time (s) of one step of one sample, and Newton corrections of a step, with some effects."""

    effects: str
    seconds: float
    corrections: float


def one_of_each(scene: Scene, meshes: Mapping[str, LineMesh]) -> dict[str, str]:
    """Return an effect of each type that acts on a scene's mechanism, as TOML tables by type."""
    coordinate, entry = next(iter(scene.coordinates.items()))
    start = scene.initial_state(coordinate)
    flexible = [name for name, body in scene.bodies.items() if body.flexible]
    body = (flexible or list(scene.bodies))[-1]
    points = meshes[body].points
    last = f"{body}:{max(points, key=points.get)}"
    joint = f'joint = "{entry.joint}"'
    tables = {
        "torque": f"{joint}, {WAVE}",
        "force": f'point = "{last}", direction = [1.0, 0.0], follows = true, {WAVE}',
        "gravity": "",
        "point_mass": f'point = "{last}", mass = 1e-3',
        "joint_damping": f"{joint}, coefficient = 1e-6",
        "joint_friction": f"{joint}, limit = 1e-6, speed = 0.1",
        "spring_damper": f'points = ["ground:origin", "{last}"], stiffness = 1e-3, rest = 1.0',
        "structural_damping": f'bodies = ["{body}"], stiffness = 1e-6',
        "end_stop": f"{joint}, upper = {start.position + 1e3}, stiffness = 1.0",
        DRIVE: f'coordinate = "{coordinate}", constant_speed = {{ speed = {SPEED}, start = {start.position} }}',
    }
    if not flexible:
        del tables["structural_damping"]
    return {kind: f'{{ type = "{kind}"{", " if rest else ""}{rest} }}' for kind, rest in tables.items()}


def with_effects(scene: Scene, effects: Mapping[str, str]) -> Scene:
    """Return a scene with other effects, for a few steps."""
    overrides = ["effects={}", f"simulation.duration={N_STEPS * scene.simulation.step}", *SAME_BASIS]
    moving = f"simulation.initial.{next(iter(scene.coordinates))}.velocity={SPEED}"
    overrides.append("simulation.initial={}" if DRIVE in effects else moving)
    overrides += [f"effects.{kind}={table}" for kind, table in effects.items()]
    return scene_from_toml(scene_to_toml(scene), scene.directory, overrides)


def seconds_a_step(model: Model) -> tuple[float, float]:
    """Return processor time and Newton corrections of a step and sample; the least of some runs, compiling left out."""
    values = {name: np.full(N_SAMPLES, value) for name, value in model.scene.values.items()}
    times = []
    for _ in range(1 + N_REPEATS):
        system = model.batch(values, N_SAMPLES)
        start = process_time()
        run = integrate(system, model.scene.simulation)
        times.append(process_time() - start)
    return min(times[1:]) / (run.n_steps * N_SAMPLES), run.counted[0] / (run.n_steps * N_SAMPLES)


def measure(
    scene: Scene,
    meshes: Mapping[str, LineMesh],
    model_of: Callable[[Scene], Model],
    further: Mapping[str, Mapping[str, str]] = MappingProxyType({}),
) -> list[EffectCost]:
    """Measure a model of the scene's mechanism without effects, with each type alone, and with all that go together.

    Parameters
    ----------
    further
        Further cases by their names: tables of their effects, by type. All but `SLOW` are among those that go together.
    """
    effects = one_of_each(scene, meshes)
    cases = {NONE: {}, **{kind: {kind: table} for kind, table in effects.items()}, **further}
    together = {kind: table for kind, table in effects.items() if kind != DRIVE}
    for name, case in further.items():
        if name != SLOW:
            together |= case
    cases[ALL] = together
    return [EffectCost(name, *seconds_a_step(model_of(with_effects(scene, chosen)))) for name, chosen in cases.items()]


def of_reduced(scene: Scene) -> dict[str, dict[str, str]]:
    """Return the cases of the reduced model alone; terms of second order are there for one coordinate."""
    return {name: case for name, case in OF_REDUCED.items() if name != SECOND_ORDER or len(scene.coordinates) == 1}


def reduced_model(scene: Scene, meshes: Mapping[str, LineMesh]) -> ReducedModel:
    """Build the reduced model of a scene on this process."""
    with RankGroup.split(MPI.COMM_SELF, 1) as group:
        return ReducedModel(scene, build_rom(scene, meshes, group))


def table(costs: list[EffectCost]) -> str:
    """Return the costs as text, one line an effect."""
    nothing = next(cost.seconds for cost in costs if cost.effects == NONE)
    lines = [f"{'effects':<20} {'us a step':>10} {'of none':>8} {'corrections':>12}"]
    for cost in costs:
        figures = f"{1e6 * cost.seconds:>10.2f} {cost.seconds / nothing:>8.2f} {cost.corrections:>12.2f}"
        lines.append(f"{cost.effects:<20} {figures}")
    return "\n".join(lines)


def print_tables(path: Path) -> None:
    """Measure the full-order and the reduced model of a scene, and print both tables."""
    scene, meshes = read_scene(path, (), (), MPI.COMM_SELF, Purpose.BUILD)
    full = measure(scene, meshes, lambda changed: FullModel(changed, meshes))
    print(f"full-order model\n{table(full)}\n", flush=True)
    reduced = measure(scene, meshes, lambda changed: reduced_model(changed, meshes), of_reduced(scene))
    print(f"reduced model\n{table(reduced)}")


def main() -> int:
    """Print the tables for the full-order and the reduced model of the scene on the command line."""
    if len(sys.argv) != 2:
        print("usage: python -m benchmarks.effect_cost SCENE", file=sys.stderr)
        return 2
    start_petsc()
    return guarded(lambda: print_tables(Path(sys.argv[1])))


if __name__ == "__main__":
    end(main())
