"""Runs of a program: one over time, many with drawn parameters, and derivatives."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

from pgmp_petsc.api.models import in_memory
from pgmp_petsc.api.ranks import solving_ranks_of, tell, tell_remarks
from pgmp_petsc.api.result import Result, Rom, StoppedRun, wrong
from pgmp_petsc.api.scenes import Overrides, Parameters, changed, overrides_of, settings_of
from pgmp_petsc.ensemble.batch import LARGEST_SEED, MOST_SAMPLES, SAMPLERS, Plan
from pgmp_petsc.runtime.agreement import agreed, on_root
from pgmp_petsc.runtime.claims import claimed
from pgmp_petsc.runtime.errors import InputError
from pgmp_petsc.scene import Scene

if TYPE_CHECKING:
    from mpi4py import MPI

    from pgmp_petsc.models import Model


def simulate(
    source: Rom | Scene,
    parameters: Parameters | None = None,
    *,
    model: str | None = None,
    overrides: Overrides = (),
    comm: MPI.Comm | None = None,
) -> Result:
    """Run a model over time, as ``pgmp simulate``. Collective on `comm`.

    Parameters
    ----------
    source
        A reduced model; or a scene, with `model`.
    parameters
        Values of parameters in this run, SI units.
    model
        ``"full"`` or ``"components"`` with a scene; ``"reduced"`` or nothing with a reduced model.
    overrides
        Entries of the scene, as in `load`; with a reduced model those that its tables do not depend on.

    Returns
    -------
    Result
        With the attributes of `results.Trajectory`.

    Raises
    ------
    StoppedRun
        If the run stops before its end; it holds what was computed.
    InputError, RunError
        As the command.
    """
    comm = solving_ranks_of(comm)
    from pgmp_petsc.studies.simulate import simulate as simulated

    prepared = _prepared(source, parameters, model, overrides, comm)
    run = _result("trajectory", simulated(prepared, comm), prepared.scene, comm)
    if run.why_stopped:
        raise StoppedRun(f"{run.why_stopped}; the error's result holds the run up to there", run)
    return run


def montecarlo(
    source: Rom | Scene,
    n: int,
    seed: int = 0,
    *,
    sampler: str | None = None,
    parameters: Parameters | None = None,
    model: str | None = None,
    overrides: Overrides = (),
    output: str | PathLike[str] | None = None,
    resume: bool = False,
    comm: MPI.Comm | None = None,
) -> Result:
    """Integrate samples and describe their distributions, as ``pgmp montecarlo``. Collective on `comm`.

    Parameters
    ----------
    source, parameters, model, overrides
        As of `simulate`; parameters are those that are not drawn.
    n
        Number of samples.
    seed
        Of the random streams: the same samples for any number of ranks.
    sampler
        ``random``, ``latin_hypercube``, ``sobol`` or ``saltelli``; otherwise as ``ensemble.sampler`` says.
    output, resume
        File to write, beside which finished samples are kept until then, and whether to take up what a killed run left
        there. Without a file nothing is kept on the way.

    Returns
    -------
    Result
        With the attributes of `results.Ensemble`. Samples that failed are in it, with their reasons.

    Raises
    ------
    InputError, RunError
        As the command.
    """
    comm = solving_ranks_of(comm)
    from pgmp_petsc.ensemble.checkpoint import remove_checkpoint
    from pgmp_petsc.ensemble.runner import run_ensemble
    from pgmp_petsc.runtime.groups import RankGroup

    with agreed(comm, "looking at the arguments"):
        _whole("n", n, 1, MOST_SAMPLES)
        _whole("seed", seed, 0, LARGEST_SEED)
        if resume and output is None:
            raise InputError("resume: without output nothing is kept that could be taken up; give the file's name")
        if sampler is not None and sampler not in SAMPLERS:
            raise InputError(f"sampler = {sampler!r}: allowed are {', '.join(SAMPLERS)}")
        texts = overrides_of(overrides)
        texts += () if sampler is None else (f'ensemble.sampler="{sampler}"',)
    prepared = _prepared(source, parameters, model, texts, comm, ensemble=True)
    with _place_of(output, comm) as target, RankGroup.split(comm, 1) as group:
        plan = Plan(n, seed, target, resume)
        found = run_ensemble(prepared, plan, group)

        def writing_the_result() -> None:
            found.write(target)
            remove_checkpoint(plan)

        if output is not None:
            on_root(comm, writing_the_result)
    return _result("ensemble", found, prepared.scene, comm, None if output is None else target)


def sensitivities(
    rom: Rom,
    names: Sequence[str] = (),
    *,
    parameters: Parameters | None = None,
    overrides: Overrides = (),
    comm: MPI.Comm | None = None,
) -> Result:
    """Differentiate the outputs of a run with parameters, as ``pgmp sensitivities``. Collective on `comm`.

    Parameters
    ----------
    rom
        A reduced model.
    names
        Parameters to differentiate with; all of the scene where none is named.
    parameters, overrides
        As of `simulate`.

    Returns
    -------
    Result
        With the attributes of `results.Derivatives`.

    Raises
    ------
    InputError, RunError
        As the command.
    """
    comm = solving_ranks_of(comm)
    from pgmp_petsc.studies.sensitivities import sensitivities as differentiated

    with agreed(comm, "looking at the arguments"):
        if not isinstance(rom, Rom):
            raise wrong("rom", rom, "a reduced model, as from pgmp.build or pgmp.read")
        if isinstance(names, str):
            raise InputError(f"names = {names!r}: allowed is a list of parameters' names, such as [{names!r}]")
    model = _prepared(rom, parameters, None, overrides, comm)
    return _result("sensitivities", differentiated(model, tuple(names), comm), model.scene, comm)


def _prepared(
    source: Rom | Scene,
    parameters: Parameters | None,
    name: str | None,
    overrides: Overrides,
    comm: MPI.Comm,
    ensemble: bool = False,
) -> Model:
    """Return the model that is asked for, with the step that its tolerance asks for. Collective on `comm`."""
    from pgmp_petsc.ensemble.sampling import refuse_drawn
    from pgmp_petsc.studies.inputs import scene_of_rom, with_meshes
    from pgmp_petsc.studies.prepared import PURPOSES, mesh_model, reduced_model, settled

    with agreed(comm, "looking at the arguments"):
        _check_model(source, name, PURPOSES)
        texts, settings = overrides_of(overrides), settings_of(parameters)

    def preparing_the_scene() -> tuple[Scene, dict]:
        if isinstance(source, Rom):
            scene, meshes = scene_of_rom(source.data.rom, source.directory, texts, settings, "the reduced model"), {}
        else:
            scene, meshes = with_meshes(changed(source, texts, parameters), PURPOSES[name])
        if ensemble:
            refuse_drawn(scene, settings)
        return scene, meshes

    scene, meshes = on_root(comm, preparing_the_scene)
    tell_remarks(comm, scene.remarks)
    if isinstance(source, Rom):
        model = reduced_model(scene, source.data.rom, comm)
    else:
        model = mesh_model(scene, meshes, name, comm)
    model, remark = settled(model, comm, ensemble)
    tell(comm, remark)
    return model


def _check_model(source: object, name: str | None, of_scenes: Sequence[str]) -> None:
    """Refuse models that a source does not have."""
    if isinstance(source, Rom):
        if name not in (None, "reduced"):
            raise InputError(
                f"model = {name!r}: a reduced model is given; give its scene, such as pgmp.simulate(rom.scene, "
                "model='full')"
            )
    elif not isinstance(source, Scene):
        raise wrong("source", source, "a reduced model (pgmp.build, pgmp.read) or a scene (pgmp.load, pgmp.compose)")
    elif name not in of_scenes:
        known = " and ".join(f"'{model}'" for model in of_scenes)
        raise InputError(
            f"model = {name!r}: of a scene there are {known}; for the reduced one give what pgmp.build(scene) returns"
        )


def _result(kind: str, data: object, scene: Scene, comm: MPI.Comm, path: Path | None = None) -> Result:
    """Return the result of the first rank on all, and say its remarks but those on the scene. Collective on `comm`."""

    def handing_out_the_result() -> object:
        return in_memory(data)

    found = Result(kind, on_root(comm, handing_out_the_result), comm, scene.directory, path)
    tell_remarks(comm, tuple(remark for remark in found.remarks if remark not in scene.remarks))
    return found


@contextmanager
def _place_of(output: str | PathLike[str] | None, comm: MPI.Comm) -> Iterator[Path]:
    """Yield where an ensemble is kept on the way: beside its file, or in a folder of its own. Collective on `comm`."""
    if output is not None:
        with claimed(comm, output, "ensemble") as target:
            yield target
        return
    folder = on_root(comm, _temporary_folder)
    try:
        yield folder / "ensemble.h5"
    finally:
        if comm.rank == 0:
            shutil.rmtree(folder, ignore_errors=True)


def _temporary_folder() -> Path:
    return Path(tempfile.mkdtemp(prefix="pgmp_ensemble_"))


def _whole(name: str, value: object, least: int, most: int) -> None:
    """Refuse what is no whole number within limits."""
    if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= most:
        raise InputError(f"{name} = {value!r}: allowed are whole numbers from {least} to {most}")
