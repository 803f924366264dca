"""Models and runs of small scenes, for tests of what follows the mechanism: dynamics, ensembles, commands.

Meshes are those of the scene's files; an entry ``mesh`` that is ``"first:last:n"`` is a line, as in `scenes`, or a bar
of cells, as in `spatial`.
"""

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
from conftest import ALONE, MPI_ENVIRONMENT, PGMP, ROOT, TIMEOUT_SECONDS, run_mpi
from mpi4py import MPI

from benchmarks.called import Called
from pgmp_petsc.bench.reference import component_model
from pgmp_petsc.bodies.shape import BodyShape
from pgmp_petsc.cli.main import main
from pgmp_petsc.lanes.compiled import njit
from pgmp_petsc.models import ComponentModel, FullModel, Model, OutputRecord, ReducedModel
from pgmp_petsc.modes.problem import ModeSet
from pgmp_petsc.ranks.groups import RankGroup
from pgmp_petsc.reduced.cells import Cells, place_of
from pgmp_petsc.reduction import tables as tables_of_reduction
from pgmp_petsc.reduction.build import build_rom
from pgmp_petsc.reduction.rom import ReducedOrderModel
from pgmp_petsc.results import Trajectory
from pgmp_petsc.scene import Scene, load_scene, scene_to_toml
from pgmp_petsc.scene.numerics import Simulation
from pgmp_petsc.stepping.generalised_alpha import Run, integrate
from pgmp_petsc.stepping.second_order_system import SecondOrderSystem, State
from pgmp_petsc.stepping.status import Status
from pgmp_petsc.studies.simulate import simulate
from scenes import HEADER, meshes_of, of_text, tables

MODULES = os.environ.get("PYTHONPATH")  # as this process found them
MOST_ROMS = 40  # that are kept, of some megabytes each
#: This process by itself.
ONE_RANK = RankGroup.split(MPI.COMM_SELF, 1)
_ROMS: dict[tuple[object, ...], ReducedOrderModel] = {}
Meshes = Mapping[str, BodyShape]
PAPER_SCENE = ROOT / "scenes" / "slider_crank_paper.toml"
# runs several commands one after the other on all ranks and prints every rank's exit status
IN_TURN = """
import json, sys
from mpi4py import MPI
from pgmp_petsc.cli.main import main
from pgmp_petsc.lanes.compiled import njit
for argv in json.loads(sys.argv[1]):
    try:
        main(argv)
    except SystemExit as end:
        statuses = MPI.COMM_WORLD.gather(end.code)
    if statuses:
        print(json.dumps(statuses), flush=True)
"""
# few modes and angles, and a tenth of the time: enough for everything but accuracy
SMALL = (
    "reduction.modes=4", "reduction.angles=24", "simulation.duration=0.05", "simulation.step=1e-3",
    "simulation.frames=9",
)  # fmt: skip
# few modes beside static answers, and angles close enough to compare with differences of runs
FEW_MODES = (
    "reduction.modes=3", "reduction.static_modes=true", "reduction.inertia_modes=true", "reduction.angles=32",
    'reduction.interpolation="spline"',
)  # fmt: skip

# A quick-return that moves: the crank's pin slides along the rocker, so the line of the joint `pin` turns with a
# flexible body.
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
quick_return = of_text(QUICK_RETURN)


def paper_scene(*overrides: str, settings: tuple[str, ...] = ()) -> Scene:
    """Return the slider-crank of the repository's scenes."""
    return load_scene(PAPER_SCENE, overrides, settings)


def full_model(scene: Scene, meshes: Meshes | None = None) -> FullModel:
    return FullModel(scene, meshes_of(scene) if meshes is None else meshes)


def components_model(scene: Scene, meshes: Meshes | None = None) -> ComponentModel:
    """Return the model of bodies in floating frames, likewise."""
    return component_model(scene, meshes_of(scene) if meshes is None else meshes, MPI.COMM_SELF)


def rom_of(
    scene: Scene, scramble: Callable[[ModeSet], ModeSet] | None = None, meshes: Meshes | None = None
) -> ReducedOrderModel:
    """Return the reduced-order model, built on this process; scenes that differ in their runs alone share one."""
    if scramble is not None:
        return built_rom(scene, scramble, meshes=meshes)
    same = scene.model_copy(update={"simulation": scene.simulation.tolerance, "ensemble": None})
    own = tuple((name, repr(type(mesh)), mesh.nodes.tobytes()) for name, mesh in (meshes or {}).items())
    fine = tables_of_reduction.N_FINE_OF_MORE, tables_of_reduction.FEWEST_OF_THREE  # tests have fewer
    key = repr(same), scene.path_of(""), own, fine
    if key not in _ROMS:
        _ROMS[key] = built_rom(scene, meshes=meshes)
        if len(_ROMS) > MOST_ROMS:
            del _ROMS[next(iter(_ROMS))]
    rom = _ROMS[key]
    return replace(rom, record=replace(rom.record, scene_toml=scene_to_toml(scene)))


def built_rom(scene: Scene, *scramble: Callable[[ModeSet], ModeSet], meshes: Meshes | None = None) -> ReducedOrderModel:
    """Build the reduced-order model on this process, also where there is one; for tests that patch what builds it."""
    return build_rom(scene, meshes_of(scene) if meshes is None else meshes, ONE_RANK, *scramble)


def reduced_model(scene: Scene, meshes: Meshes | None = None) -> ReducedModel:
    return ReducedModel(scene, rom_of(scene, meshes=meshes))


#: What makes a model of every kind.
MODELS: dict[str, Callable[..., Model]] = {
    "full": full_model, "components": components_model, "reduced": reduced_model,
}  # fmt: skip


def trajectory(model: Model | str, scene: Scene | None = None, meshes: Meshes | None = None) -> Trajectory:
    """Run a model on this process, or the model of a kind of a scene, with all that belongs to a run."""
    return simulate(MODELS[model](scene, meshes) if isinstance(model, str) else model, MPI.COMM_SELF)


def motion(model: Model | str, scene: Scene | None = None, meshes: Meshes | None = None) -> Trajectory:
    """Do the same for the motion, the outputs and the energies alone, in a fraction of the time: no errors are
    estimated, and no frames kept. It reaches its end."""
    model = MODELS[model](scene, meshes) if isinstance(model, str) else model
    alone = model.scene.simulation.model_copy(update={"error_indicator": False, "frames": 0})
    found = trajectory(model.with_loads(model.scene.model_copy(update={"simulation": alone})))
    assert found.status == Status.FINE, found.record.remarks
    return found


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


def with_step(scene: Scene, step: float) -> Scene:
    return scene.model_copy(update={"simulation": scene.simulation.model_copy(update={"step": step})})


def run_model(
    model: Model, n: int = 1, values: Mapping[str, np.ndarray] | None = None, alive: np.ndarray | None = None
) -> tuple[SecondOrderSystem, Run]:
    """Integrate n samples of a model over its scene's duration; return the system and what is left."""
    system = model.batch(samples(model.scene, n) if values is None else values, n)
    return system, integrate(system, model.scene.simulation, alive)


def still(eta: np.ndarray) -> State:
    """Return states of reduced coordinates (n, n_eta) at rest."""
    return State(eta, np.zeros_like(eta), np.zeros_like(eta), np.zeros(0))


def assert_forces_do_the_work(model: ReducedModel, state: State, values: Mapping[str, np.ndarray], time: float) -> None:
    """Check ``-r.eta'`` of the effect `extra` alone against its power and the rate of its elastic energy along the
    motion."""
    n, h = len(state.q), 1e-6
    system = model.batch(values, n)
    without = system.__class__(model.terms, model.effects, values, model.start, n)
    power = np.einsum("ni,ni->n", without.residual(time, state) - system.residual(time, state), state.v)

    def stored(dt: float) -> np.ndarray:
        moved = State(state.q + dt * state.v, state.v, state.a, state.multipliers)
        return system.energies(time, moved).potential["extra"]

    expected = system.energies(time, state).powers["extra"] - (stored(h) - stored(-h)) / (2 * h)
    np.testing.assert_allclose(power, expected, rtol=1e-6, atol=1e-6 * np.abs(expected).max())
    assert np.abs(power).max() > 1e-3


def watched(
    system: SecondOrderSystem, simulation: Simulation, see: Callable[[float, State], object], every: int = 1
) -> tuple[Run, list]:
    """Integrate a system; return what is left, and what is seen of time and state after every so many steps."""
    seen = []

    def look(number: int, time: float, state: State) -> None:
        if number % every == 0:
            seen.append(see(time, state))

    return integrate(system, simulation, observer=Called(look)), seen


def history(
    model: Model, values: Mapping[str, np.ndarray], n: int, every: int = 1, system: SecondOrderSystem | None = None
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Integrate n samples, or those of a system; return times (n_t,) and outputs over time, each of shape (n_t, n),
    after every so many steps."""
    system = system or model.batch(values, n)
    record = OutputRecord(model, system, every=every)
    integrate(system, model.scene.simulation, observer=record)
    return record.outputs()


def largest_errors(exact: Mapping[str, np.ndarray], found: Mapping[str, np.ndarray]) -> dict[str, float]:
    """Return the largest difference of every output, as a share of its largest value."""
    return {name: float(np.abs(found[name] - one).max() / np.abs(one).max()) for name, one in exact.items()}


def assert_close(exact: Mapping[str, np.ndarray], *found: Mapping[str, np.ndarray], **allowed: float) -> None:
    """Check the largest difference of every output named in every run, as a share of its largest value."""
    for one in found:
        errors = largest_errors({name: exact[name] for name in allowed}, one)
        assert all(errors[name] < share for name, share in allowed.items()), errors


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
            env=os.environ | MPI_ENVIRONMENT | ALONE, cwd=cwd, timeout=TIMEOUT_SECONDS,
        )  # fmt: skip
    shown = f"{words} ended with {done.returncode}\n{done.stdout}\n{done.stderr}"
    assert status is None or done.returncode == status, shown
    return done


def said(*arguments: object, status: int = 0) -> tuple[str, str]:
    """Run ``pgmp`` on one rank and check its exit status; return what it printed, and what it printed of errors."""
    done = pgmp(*arguments, status=status)
    return done.stdout, done.stderr


def one_message(*arguments: object) -> str:
    """Return the one line with which ``pgmp`` refuses what it is asked for; it prints nothing else."""
    out, err = said(*arguments, status=2)
    err = besides_progress(err)
    assert out == "" and err.startswith("pgmp: error: ") and err.count("\n") == 1 and "Traceback" not in err, err
    return err


def in_turn(
    n: int, commands: Iterable[Iterable[object]], before: str = ""
) -> tuple[list, subprocess.CompletedProcess[str]]:
    """Run commands one after the other in one start of n ranks; return all ranks' statuses of each and what was
    printed. On one rank they run in this process, but where modules are to be found elsewhere; several ranks run a
    text first."""
    if n == 1 and os.environ.get("PYTHONPATH") == MODULES:
        each = [pgmp(*command, status=None) for command in commands]
        printed = ("".join(part) for part in zip(*((done.stdout, done.stderr) for done in each)))
        return [[done.returncode] for done in each], subprocess.CompletedProcess([], 0, *printed)
    words = json.dumps([[str(word) for word in command] for command in commands])
    done = run_mpi(n, "-c", before + IN_TURN, words)
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
    return re.sub(r"^[a-z, -]+: (\d+( of \d+)?, \d+ .*|[a-z, -]+, \d+ (s|min \d+ s))\n", "", stderr, flags=re.MULTILINE)


def overridden(*entries: str) -> list[str]:
    """Return the arguments ``--override entry`` for every entry."""
    return [word for entry in entries for word in ("--override", entry)]


@njit(cache=True, entry=True)
def place_in(cells: Cells, cell: int) -> int:
    """Return where among the polynomials of a table those of a cell are."""
    return place_of(cells, cell)
