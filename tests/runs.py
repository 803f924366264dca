"""Models and runs of small scenes, for tests of what follows the mechanism: dynamics, ensembles, commands."""

import io
import json
import os
import re
import subprocess
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import warm_start
from conftest import MPI_ENVIRONMENT, ROOT, TIMEOUT_SECONDS, run_mpi
from mpi4py import MPI

from pgmp_petsc.bodies.shape import shape_in_scene
from pgmp_petsc.cli.main import main
from pgmp_petsc.mesh import read_line_mesh
from pgmp_petsc.models import FullModel, Model, ReducedModel
from pgmp_petsc.modes.problem import ModeSet
from pgmp_petsc.ranks.groups import RankGroup
from pgmp_petsc.reduction.build import build_rom
from pgmp_petsc.reduction.rom import ReducedOrderModel
from pgmp_petsc.scene import Scene, load_scene, scene_from_toml, scene_to_toml
from pgmp_petsc.stepping.generalised_alpha import Run, integrate
from pgmp_petsc.stepping.second_order_system import SecondOrderSystem, State
from scenes import HEADER, meshes_of, tables

MOST_ROMS = 40  # that are kept, of some megabytes each
_ROMS: dict[tuple[str, Path], ReducedOrderModel] = {}
PAPER_SCENE = ROOT / "scenes" / "slider_crank_paper.toml"
# runs several commands one after the other on all ranks and prints every rank's exit status
IN_TURN = """
import json, sys
from mpi4py import MPI
from pgmp_petsc.cli.main import main
for argv in json.loads(sys.argv[1]):
    try:
        main(argv)
    except SystemExit as end:
        statuses = MPI.COMM_WORLD.gather(end.code)
    if statuses:
        print(json.dumps(statuses), flush=True)
"""
PGMP = ("-m", "pgmp_petsc.cli.main")
# few modes and angles, and a tenth of the time: enough for everything but accuracy
SMALL = ("reduction.modes=4", "reduction.angles=24", "simulation.duration=0.05", "simulation.step=1e-3")

# A quick-return: the crank's pin slides along the rocker, so the line of the joint `pin` turns with a flexible body.
QUICK_RETURN = HEADER + tables("""
ground.points: pivot = [0.0, -0.4]
parameters.r1: nominal = 5.6e-3
bodies.crank: mesh = "0.0:0.2:3"; element = "beam2d"; material = "steel";
    section = { shape = "circle", radius = "r1" }
bodies.rocker: mesh = "0.0:0.8:4"; element = "beam2d"; material = "steel";
    section = { shape = "circle", radius = 4e-3 }; placement = { origin = [0.0, -0.4], angle = 1.1 }
joints.crank_hinge: type = "revolute"; connect = ["ground:origin", "crank:hinge"]
joints.rocker_hinge: type = "revolute"; connect = ["ground:pivot", "rocker:hinge"]
joints.pin: type = "point_on_line"; connect = ["rocker:2", "crank:tip"]; direction = [1.0, 0.0]
coordinates.theta: joint = "crank_hinge"; range = [0.0, 6.283185307179586]; periodic = true
effects.motor: type = "torque"; joint = "crank_hinge"; table = [[0.0, 0.0], [0.05, 2.0], [1.0, 2.0]]
effects.weight: type = "gravity"
reduction: modes = 4; angles = 24
simulation: duration = 0.2; step = 1e-3
simulation.initial.theta: position = 0.3; velocity = 4.0
""")


def quick_return(*overrides: str) -> Scene:
    """Return a mechanism whose point_on_line turns with a flexible body; it starts moving."""
    return scene_from_toml(QUICK_RETURN, ".", overrides)


def paper_scene(*overrides: str, settings: tuple[str, ...] = ()) -> Scene:
    """Return the slider-crank of the repository's scenes."""
    return load_scene(PAPER_SCENE, overrides, settings)


def read_meshes(scene: Scene) -> dict:
    """Return the meshes of a scene whose entries are paths, or that need none."""
    return {
        name: shape_in_scene(scene, name) or read_line_mesh(scene.path_of(body.mesh), name)
        for name, body in scene.bodies.items()
    }


def full_model(scene: Scene) -> FullModel:
    """Return the full-order model of a scene with meshes made in memory or in files."""
    return FullModel(scene, _meshes(scene))


def rom_of(scene: Scene, scramble: Callable[[ModeSet], ModeSet] | None = None) -> ReducedOrderModel:
    """Return the reduced-order model, built on this process; scenes that differ in their runs alone share one."""
    if scramble is not None:
        return built_rom(scene, scramble)
    same = scene.model_copy(update={"simulation": scene.simulation.tolerance, "ensemble": None})
    key = repr(same), scene.path_of("")
    if key not in _ROMS:
        _ROMS[key] = built_rom(scene)
        if len(_ROMS) > MOST_ROMS:
            del _ROMS[next(iter(_ROMS))]
    rom = _ROMS[key]
    return replace(rom, record=replace(rom.record, scene_toml=scene_to_toml(scene)))


def built_rom(scene: Scene, *scramble: Callable[[ModeSet], ModeSet]) -> ReducedOrderModel:
    """Build the reduced-order model on this process, also where there is one; for tests that patch what builds it."""
    with RankGroup.split(MPI.COMM_SELF, 1) as group:
        return build_rom(scene, _meshes(scene), group, *scramble)


def reduced_model(scene: Scene) -> ReducedModel:
    """Build and return the reduced model of a scene."""
    return ReducedModel(scene, rom_of(scene))


def paper_rom() -> ReducedOrderModel:
    """Return the paper's own reduced-order model, 15 modes at 629 angles (4 s)."""
    return rom_of(paper_scene())


def accurate_scene(*overrides: str) -> Scene:
    """Return the paper's slider-crank with a reduction that is both smaller and more accurate than the paper's."""
    return paper_scene(
        "reduction.modes=7", "reduction.static_modes=true", "reduction.angles=48", 'reduction.interpolation="spline"',
        *overrides,
    )  # fmt: skip


def samples(scene: Scene, n: int, **given: object) -> dict[str, np.ndarray]:
    """Return the parameter values of n samples, those of the scene where none are given."""
    return {name: np.broadcast_to(given.get(name, value), (n,)).astype(float) for name, value in scene.values.items()}


def run_model(
    model: Model, n: int = 1, values: Mapping[str, np.ndarray] | None = None, alive: np.ndarray | None = None
) -> tuple[SecondOrderSystem, Run]:
    """Integrate n samples of a model over its scene's duration; return the system and what is left."""
    system = model.batch(samples(model.scene, n) if values is None else values, n)
    return system, integrate(system, model.scene.simulation, alive)


def history(model: Model, values: Mapping[str, np.ndarray], n: int) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Integrate n samples; return times (n_t,) and outputs over time, each of shape (n_t, n)."""
    system = model.batch(values, n)
    times, rows = [], []

    def record(step: int, time: float, state: State) -> None:
        times.append(time)
        rows.append(model.outputs.evaluate(model.observed(system, state)))

    integrate(system, model.scene.simulation, observer=record)
    return np.array(times), {name: np.array([row[name] for row in rows]) for name in rows[0]}


def largest_errors(exact: Mapping[str, np.ndarray], found: Mapping[str, np.ndarray]) -> dict[str, float]:
    """Return the largest difference of every output, as a share of its largest value."""
    return {name: float(np.abs(found[name] - one).max() / np.abs(one).max()) for name, one in exact.items()}


def assert_close(exact: Mapping[str, np.ndarray], found: Mapping[str, np.ndarray], **allowed: float) -> None:
    """Check the largest difference of every output named, as a share of its largest value."""
    errors = largest_errors(exact, found)
    for name, share in allowed.items():
        assert errors[name] < share, (name, errors)


def pgmp(*arguments: object, status: int | None = 0, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    """Run ``pgmp`` on one rank and check its exit status (None: any).

    It runs in this process, or in one of its own where that is given a folder or options for PETSc, which starts once.
    """
    words = [str(argument) for argument in arguments]
    if cwd is None and "--" not in words:
        out, err = io.StringIO(), io.StringIO()
        with redirect_stdout(out), redirect_stderr(err), pytest.raises(SystemExit) as end:
            main(words)
        done = subprocess.CompletedProcess(words, end.value.code or 0, out.getvalue(), err.getvalue())
    else:
        done = subprocess.run(
            [*warm_start.python(), *PGMP, *words], stdin=subprocess.DEVNULL, capture_output=True, text=True,
            env=os.environ | MPI_ENVIRONMENT, cwd=cwd, timeout=TIMEOUT_SECONDS,
        )  # fmt: skip
    shown = f"{words} ended with {done.returncode}\n{done.stdout}\n{done.stderr}"
    assert status is None or done.returncode == status, shown
    return done


def in_turn(n: int, commands: Iterable[Iterable[object]]) -> tuple[list, subprocess.CompletedProcess[str]]:
    """Run commands one after the other in one start of n ranks; return all ranks' statuses of each and what was
    printed."""
    words = json.dumps([[str(word) for word in command] for command in commands])
    done = run_mpi(n, "-c", IN_TURN, words)
    assert "Traceback" not in done.stderr, done.stderr
    return [json.loads(line) for line in done.stdout.splitlines() if line.startswith("[")], done


def refused(n: int, commands: Sequence[Iterable[object]]) -> list[str]:
    """Run commands that are bad input in one start of n ranks; return the only message of each.

    Every rank ends with status 2, and none waits for another.
    """
    statuses, done = in_turn(n, commands)
    assert statuses == [n * [2]] * len(commands), f"{done.stdout}\n{done.stderr}"
    messages = besides_progress(done.stderr).split("pgmp: error: ")[1:]
    assert len(messages) == len(commands), messages
    return [message.removesuffix("\n") for message in messages]


def besides_progress(stderr: str) -> str:
    """Return what a program said on stderr besides lines of progress, which a busy machine brings about."""
    return re.sub(r"^[a-z -]+: (\d+ of \d+, .*|[a-z, -]+, \d+ (s|min \d+ s))\n", "", stderr, flags=re.MULTILINE)


def overridden(*entries: str) -> list[str]:
    """Return the arguments ``--override entry`` for every entry."""
    return [word for entry in entries for word in ("--override", entry)]


def _meshes(scene: Scene) -> dict:
    return meshes_of(scene) if ":" in (next(iter(scene.bodies.values())).mesh or "") else read_meshes(scene)
