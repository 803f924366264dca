"""Forces in joints: how far reduced and component models are from full-order multipliers, and what they cost.

    python -m benchmarks.joint_forces scenes/*.toml
    python -m benchmarks.joint_forces scenes/four_bar.toml --doubt 4
    python -m benchmarks.joint_forces scenes/slider_crank.toml --cost

Every joint of a scene gets outputs of its force and moment in the ground's axes, and every prescribed motion one of its
drive; what redundant constraints leave open is left out. Printed is, for each joint, the largest error over the run as
a share of the largest size of force or moment in it, at the scene's own settings. The doubt is the same of a full-order
run with a part of the step. The start itself is left out: of loads that set in at once on undeformed bodies the mesh
has ``(C M^-1 C^T)^-1 C M^-1 f`` there, what the masses of the nodes at the joint carry: it goes to zero with the
elements.

With ``--cost``, in place of that, what reading takes of a step of the reduced model, by processor time in batches of
512 samples: of the scene's own outputs, and of a joint's force in the ground's axes besides; at the instants of the
bands, as by default, and at every step, as extremes and events "ever" ask for.
"""

from __future__ import annotations

import argparse
import re
import time
from collections import defaultdict
from functools import partial
from pathlib import Path

import numpy as np
from mpi4py import MPI

from benchmarks.programs import end, guarded
from pgmp_petsc.base.errors import InputError
from pgmp_petsc.bench.reference import component_model
from pgmp_petsc.ensemble.watchers import Begun, watch_over_time
from pgmp_petsc.mechanism.capabilities import Purpose
from pgmp_petsc.models import FullModel, Model, ReducedModel
from pgmp_petsc.ranks.groups import RankGroup
from pgmp_petsc.ranks.petsc import start_petsc
from pgmp_petsc.reduction.build import build_rom
from pgmp_petsc.results import Trajectory
from pgmp_petsc.scene import Scene, load_scene
from pgmp_petsc.scene.effects import Driving
from pgmp_petsc.scene.joints import CouplingEntry
from pgmp_petsc.stepping.generalised_alpha import integrate
from pgmp_petsc.studies.inputs import read_scene
from pgmp_petsc.studies.simulate import simulate

MOST = 0.99  # of instants, the largest errors of which are those at jumps of loads
BATCH, REPEATED = 512, 5  # samples, and runs whose median counts
QUIET = ("simulation.error_indicator=false", "simulation.frames=0")


def wanted(scene: Scene) -> dict[str, list[str]]:
    """Return overrides of outputs of every joint and drive, by what they are components of."""
    found = defaultdict(list)
    for name, joint in scene.joints.items():
        for kind in ("joint_force", "joint_torque"):
            if isinstance(joint, CouplingEntry):
                entries = ['component="axial", of="first"']
            else:
                axes = "z" if (kind, scene.dimension) == ("joint_torque", 2) else "xyz"[: scene.dimension]
                entries = [f'component="{axis}"' for axis in axes]
            for k, more in enumerate(entries):
                found[f"{kind} {name}"].append(f'outputs.f_{kind}_{name}_{k}={{type="{kind}", joint="{name}", {more}}}')
    for effect in scene.effects.values():
        if isinstance(effect, Driving):
            one = f'outputs.f_drive_{effect.coordinate}={{type="drive_torque", coordinate="{effect.coordinate}"}}'
            found[f"drive {effect.coordinate}"].append(one)
    return found


def determined(path: Path, more: list[str]) -> dict[str, list[str]]:
    """Return those that constraints determine."""
    groups = wanted(load_scene(path, more))
    while True:
        asked = [one for group in groups.values() for one in group]
        try:
            scene, meshes = read_scene(path, [*more, *QUIET, *asked], (), MPI.COMM_SELF, Purpose.FULL)
            FullModel(scene, meshes)
            return groups
        except InputError as error:
            bad = set(re.findall(r"outputs\.(f_\w+)", str(error)))
            if not bad:
                raise
            print(f"  left out: {', '.join(sorted(bad))}", flush=True)
            groups = {
                name: [one for one in group if one.split("=")[0].removeprefix("outputs.") not in bad]
                for name, group in groups.items()
            }
            groups = {name: group for name, group in groups.items() if group}


def runs_of(model: Model) -> Trajectory:
    """Return the run of a model on this process."""
    return simulate(model, MPI.COMM_SELF)


def compare(path: Path, given: argparse.Namespace) -> None:
    """Run the models of a scene and print how far they are apart."""
    print(f"{path}", flush=True)
    groups = determined(path, given.override)
    own = [*given.override, *QUIET, *(one for group in groups.values() for one in group)]
    scene, meshes = read_scene(path, own, (), MPI.COMM_SELF, Purpose.FULL)
    full = FullModel if given.against == "full" else partial(component_model, comm=MPI.COMM_SELF)
    exact = runs_of(full(scene, meshes))
    found: dict[str, Trajectory] = {}
    if given.doubt > 1:
        step = scene.simulation.step / given.doubt
        finer, _ = read_scene(path, [*own, f"simulation.step={step!r}"], (), MPI.COMM_SELF, Purpose.FULL)
        found["doubt"] = runs_of(full(finer, meshes))
    if "components" in given.models:
        found["components"] = runs_of(component_model(scene, meshes, MPI.COMM_SELF))
    if "reduced" in given.models:
        try:
            scene, meshes = read_scene(path, own, (), MPI.COMM_SELF, Purpose.BUILD)
            with RankGroup.split(MPI.COMM_SELF, 1) as group:
                found["reduced"] = runs_of(ReducedModel(scene, build_rom(scene, meshes, group)))
        except InputError as error:
            print(f"  no reduced model: {error}"[:200], flush=True)
    for model, run in {"full": exact, **found}.items():
        if run.time[-1] < scene.simulation.duration * (1.0 - 1e-9):
            print(f"  {model}: stopped at {run.time[-1]:.4g} s; compared up to there", flush=True)
    rows = {}
    for name, group in groups.items():
        outputs = [one.split("=")[0].removeprefix("outputs.") for one in group]
        reference = np.array([exact.outputs[one] for one in outputs])
        largest = np.linalg.norm(reference, axis=0).max()
        if largest == 0.0:
            continue
        rows[name] = [largest]
        for model, run in found.items():
            every = max(1, round(exact.time[1] / run.time[1]))  # one that failed was tried again with half the step
            own = np.array([run.outputs[one][::every] for one in outputs])
            both = min(own.shape[1], reference.shape[1])
            errors = np.abs(own[:, 1:both] - reference[:, 1:both]).max(axis=0) / largest
            worst = exact.time[1 + errors.argmax()]
            rows[name] += [f"{errors.max():.1e} ({worst:.4g}), {np.quantile(errors, MOST):.1e}"]
    words = [f"{model}: largest (at s), at {100.0 * MOST:g} % of instants below" for model in found]
    print("  " + " | ".join(["", "largest", *words]))
    for name, (largest, *cells) in rows.items():
        print("  " + " | ".join([name, f"{largest:.3g}", *cells]), flush=True)


def time_of(model: ReducedModel, read: bool) -> float:
    """Return what a step of a sample takes, s of a processor, with its outputs read as the scene asks for or not."""
    simulation, rng = model.scene.simulation, np.random.default_rng(1)
    values = {
        name: value
        * (1.0 + 0.02 * rng.standard_normal(BATCH) * (model.scene.parameters[name].distribution is not None))
        for name, value in model.scene.values.items()
    }
    begin = time.process_time()
    system = model.batch(values, BATCH)
    if read:
        watch = watch_over_time(model, True).watch(Begun(system, values, np.arange(BATCH), simulation))
        watch.found(integrate(system, simulation, observer=watch.observer).status)
    else:
        integrate(system, simulation)
    return (time.process_time() - begin) / (BATCH * simulation.n_steps)


def cost(path: Path, given: argparse.Namespace) -> None:
    """Print what reading takes of a step."""
    print(f"{path}", flush=True)
    kind, forces = next((name, one) for name, one in determined(path, given.override).items() if "joint_force" in name)
    for instants, more in (("bands", ()), ("every step", ("ensemble.extremes=true",))):
        models = []
        for asked in ((), forces):
            scene, meshes = read_scene(path, [*given.override, *QUIET, *more, *asked], (), MPI.COMM_SELF, Purpose.BUILD)
            with RankGroup.split(MPI.COMM_SELF, 1) as group:
                models.append(ReducedModel(scene, build_rom(scene, meshes, group)))
        rows = [[time_of(models[0], False), *(time_of(model, True) for model in models)] for _ in range(1 + REPEATED)]
        step, own, both = np.median(rows[1:], axis=0)  # the first one compiles
        print(
            f"  read at {instants}: step {1e6 * step:.3g} us, own outputs {(own - step) / step:.2f} of it, "
            f"{kind} {(both - own) / step:.2f} more",
            flush=True,
        )


def main() -> None:
    """Compare what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", type=Path, nargs="+")
    parser.add_argument("--override", action="append", default=[])
    parser.add_argument("--doubt", type=int, default=1, help="part of the step of a second full-order run")
    parser.add_argument("--models", nargs="+", choices=("components", "reduced"), default=["reduced"])
    parser.add_argument("--against", choices=("full", "components"), default="full")
    parser.add_argument("--cost", action="store_true", help="what reading them takes of a step, instead")
    given = parser.parse_args()
    start_petsc()

    def every() -> None:
        for path in given.scenes:
            try:
                (cost if given.cost else compare)(path, given)
            except Exception as error:
                print(f"  {type(error).__name__}: {error}"[:300], flush=True)

    end(guarded(every))


if __name__ == "__main__":
    main()
