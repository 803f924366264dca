"""Result files that a program reads; what they hold, in words and without reading their arrays; and how far two results
of the same kind are apart: of an output the largest difference, and where it is. Results as films, as
pictures and as one page.
"""

from __future__ import annotations

import os
import re
import tomllib
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import datetime
from os import PathLike
from pathlib import Path
from textwrap import indent
from typing import TYPE_CHECKING, Any, NamedTuple

import h5py
import numpy as np

from pgmp_petsc.api.arguments import Range
from pgmp_petsc.api.declared import Argument, command, interface, numbers_by_name
from pgmp_petsc.api.ranks import ranks_of, solving_ranks_of, tell
from pgmp_petsc.api.result import MODELS, Result, Rom, file_of, in_memory
from pgmp_petsc.base.errors import InputError, counted
from pgmp_petsc.base.plugins import SHOWN
from pgmp_petsc.base.resources import Timings
from pgmp_petsc.base.surroundings import Comm
from pgmp_petsc.base.units import behind, measure
from pgmp_petsc.files.claims import TABULAR, check_output, named
from pgmp_petsc.files.hdf5 import KINDS, RunRecord, open_file, shapes_of
from pgmp_petsc.ranks.agreement import agreed, on_root
from pgmp_petsc.results import EffectSizes, Selection, Trajectory
from pgmp_petsc.results.numbers import axis_unit, felt, share_text
from pgmp_petsc.results.summary import json_data, origin_of, summary_of

if TYPE_CHECKING:
    from pgmp_petsc.figures.motion import Motion
    from pgmp_petsc.results.trajectory import ModeShape


@interface(path=Argument("File of a result of any kind but a shard."))
def read(path: str | PathLike[str], *, comm: Comm | None = None) -> Result:
    """Read a result file: a `Rom`, or a `Result`; raises `InputError` if it is no whole result of this program."""
    comm, path = ranks_of(comm), Path(path)
    kind = on_root(comm, kind_in, path, [kind for kind in KINDS if kind != "shard"])
    if kind in MODELS:
        # its modules need PETSc, which all ranks start together
        solving_ranks_of(comm)
    return (Rom if kind in MODELS else Result)(kind, on_root(comm, _read, path, kind), comm, path.parent, path)


def stopped_runs(*paths: Path) -> list[str]:
    """Return a line for every file that holds only a part of a run, saying why; by one process."""
    lines = []
    for path in paths:
        with open_file(path, KINDS) as file:
            if file.attrs.get("status", 0):
                lines += [f"{path}: {remark}" for remark in RunRecord.read(file).remarks[:1]]
    return lines


def kind_in(path: Path, kinds: Collection[str] = tuple(KINDS)) -> str:
    """Return the kind of a whole file of one of some kinds; by one process."""
    with open_file(path, kinds) as file:
        return str(file.attrs["kind"])


def _read(path: Path, kind: str) -> Any:
    if kind not in MODELS:
        from pgmp_petsc.results import READERS

        return in_memory(READERS[kind].read(path))
    if kind == "components":
        from pgmp_petsc.models.component_file import ComponentsFile

        return ComponentsFile.read(path)
    from pgmp_petsc.studies.building import Built

    return Built.read(path)


class DataSet(NamedTuple):
    """A data set: its shape, unit ("" where none is given), and what it is."""

    shape: tuple[int, ...]
    unit: str
    description: str


@dataclass(frozen=True)
class Contents:
    """Contents of a result file."""

    #: path, kind: the file, and one of `files.claims.KINDS`
    path: Path
    kind: str
    model: str  # of runs; empty where the file is of none
    #: program_version, format_version: what wrote it
    program_version: str
    format_version: int
    record: RunRecord  # where it comes from: scene, parameters, seed, ranks, timings, remarks
    #: selection, sizes: what was chosen for tolerances, and effects by their size; None where nothing was
    selection: Selection | None
    sizes: EffectSizes | None
    datasets: dict[str, DataSet]  # by their names, in the file's order

    def summary(self) -> dict[str, Any]:
        """Return its figures as plain data, those of ``pgmp info --json``; reads the result's own. Raises `InputError`
        if it is no whole result of this program."""
        from pgmp_petsc.results import READERS

        about = {"file": self.path, "kind": self.kind, "program_version": self.program_version}
        about |= origin_of(self.record)
        about["plugins"] = self.record.plugins
        about["chosen"] = None if self.selection is None else self.selection.chosen
        about["datasets"] = {name: one._asdict() for name, one in self.datasets.items()}
        if self.kind in READERS:
            about |= summary_of(READERS[self.kind].read(self.path))
        return json_data(about)

    @property
    def scene(self) -> dict[str, Any]:
        """The tables of the scene that it was made from."""
        return tomllib.loads(self.record.scene_toml)


def _contents(path: Path) -> Contents:
    with open_file(path, KINDS) as file, shapes_of(file):
        return Contents(
            path,
            str(file.attrs["kind"]),
            str(file.attrs.get("model", "")),
            str(file.attrs["program_version"]),
            int(file.attrs["format_version"]),
            RunRecord.read(file),
            Selection.found_in(file),
            EffectSizes.found_in(file),
            _all_datasets(file),
        )


def _all_datasets(file: h5py.File) -> dict[str, DataSet]:
    found = {}

    def visit(name: str, item: object) -> None:
        if isinstance(item, h5py.Dataset):
            found[f"/{name}"] = DataSet(item.shape, *(str(item.attrs.get(key, "")) for key in DataSet._fields[1:]))

    file.visititems(visit)
    return found


def describe(found: Contents, path: Path | None = None, said: object = (), scene: bool = False) -> str:
    """Return the description of a result file of any kind; by one process. Raises `InputError` if what it holds does
    not fit together."""
    if scene:
        return found.record.scene_toml.rstrip()
    record, path = found.record, found.path
    parameters = ", ".join(f"{name} = {value:g}" for name, value in record.parameters.items())
    lines = [
        f"{path}: {KINDS[found.kind]}" + (f" of the {found.model} model" if found.model else ""),
        f"written    {datetime.fromtimestamp(os.path.getmtime(path)):%Y-%m-%d %H:%M}"
        f" by pgmp {found.program_version}, format {found.format_version}",
        f"scene      {origin_of(record)['scene'] or 'without a name'}",
        *(f"plugin     {name}, SHA-256 {sha256[:SHOWN]}" for name, sha256 in record.plugins.items()),
        f"parameters {parameters or 'none'}",
        f"seed       {'none' if record.seed is None else record.seed}",
        f"ranks      {record.ranks}",
    ]
    with shapes_of(path):
        parts = [
            [f"  {remark}" for remark in record.remarks],
            [] if found.selection is None else found.selection.lines(),
            [] if found.sizes is None else ["effects, chosen by their size", *found.sizes.lines()],
            ["timings", indent(Timings(record.timings).table(), "  ")] if record.timings else [],
            ["datasets", indent(_datasets(found), "  ")],
            _estimates(found),
        ]
    return "\n".join([*lines, *(line for part in parts if part for line in ("", *part))])


def _estimates(found: Contents) -> list[str]:
    """Return the figures of an ensemble, estimated errors, validity, and its balance of energy; a remark says what is
    not there."""
    from pgmp_petsc.results import READERS
    from pgmp_petsc.texts import ensemble_table, models, studies

    lines_of = {
        "ensemble": ensemble_table.lines_with_estimates,
        "rare_event": ensemble_table.lines_of_rare_event,
        "sensitivities": studies.lines_of,
        "fit": studies.fit_lines,
        "design": studies.design_lines,
        "tradeoff": lambda study: ["summary", indent(studies.summary(study), "  ")],
    }
    if any(name.startswith(("/validity/", "/errors/")) for name in found.datasets):
        lines_of["trajectory"] = models.of_run
    return list(lines_of[found.kind](READERS[found.kind].read(found.path))) if found.kind in lines_of else []


def _datasets(found: Contents) -> str:
    """Return one line a dataset: name, shape, unit, description; a numbered series (frames) is one line."""
    rows: list[tuple[str, str, str, str]] = []
    for full_name, data in found.datasets.items():
        name = full_name.removeprefix("/")
        if name.startswith("timings/"):
            continue
        if of_lengths := re.match(r"lengths/(\d+)(?:/|$)", name):
            if int(of_lengths[1]):
                continue
            name = f"lengths/<models of all lengths>/{name[of_lengths.end() :]}"
        group, _, last = name.rpartition("/")
        description = data.description
        if last.isdigit():
            if int(last) > 0:
                continue
            n_frames = sum(other.rpartition("/")[0] == full_name.rpartition("/")[0] for other in found.datasets)
            name, description = f"{group}/<{n_frames} frames>", description.replace(" at 0 s", "")
        shape = " x ".join(str(length) for length in data.shape) or "scalar"
        rows.append((f"/{name}", shape, data.unit, description))
    widths = [max((len(row[column]) for row in rows), default=0) for column in range(3)]
    padded = [[f"{text:<{width}}" for text, width in zip(row, [*widths, 0])] for row in rows]
    return "\n".join("  ".join(row).rstrip() for row in padded)


@command(
    "info", "Say what a result file holds.", 170, petsc=False, report=describe,
    figures=lambda found, scene: found.scene if scene else found.summary(),
    path=Argument("Result file of any kind.", word="FILE"),
    shell={"scene": Argument("Print the scene that the file was made from, as TOML.")},
)  # fmt: skip
def contents(path: str | PathLike[str], *, comm: Comm | None = None) -> Contents:
    """Say what `path` holds: its origin, parameters, timings and datasets."""
    return on_root(ranks_of(comm), _contents, Path(path))


@dataclass(frozen=True)
class Difference:
    """The largest difference of an output; that of the second result less the first."""

    #: largest, unit: its value, unit
    largest: float
    unit: str
    #: of the output's largest magnitude in the first result; infinite where that is zero and the second's is not, and
    #: 0 where it vanishes beside others of its unit in both
    share: float
    place: float  # instant (s) of a run, number of the sample of an ensemble


@dataclass(frozen=True)
class Differences:
    """How far two results are apart."""

    kind: str  # ``trajectory`` or ``ensemble``
    compared: int  # number of instants, or of samples that are fine in both
    outputs: dict[str, Difference]  # by name, of outputs that both have
    #: what one of the two lacks, in words: outputs, numbers of them, the end of a run, samples that failed there alone
    lacking: tuple[str, ...]
    tolerance: float | None = None  # largest share that passes; None where any does

    @property
    def is_within(self) -> bool:
        """Whether no output differs by more than the tolerance, and nothing is lacking."""
        largest = max(one.share for one in self.outputs.values())
        return self.tolerance is None or (not self.lacking and largest <= self.tolerance)

    def summary(self) -> dict[str, object]:
        """Return its figures as plain data, those of ``pgmp diff --json``."""
        return json_data(asdict(self) | {"is_within": self.is_within})


def _report_of_differences(found: Differences, name: Path, said: object) -> str:
    what, where = {
        "trajectory": ("instants", "at {:g} s"), "ensemble": ("samples that are fine in both", "in sample {:.0f}"),
    }[found.kind]  # fmt: skip
    lines = [f"{found.compared} {what}"]
    for output, one in found.outputs.items():
        factor, unit = axis_unit(one.unit, np.array([one.largest]))
        told = np.isfinite(one.share) and (one.share or not one.largest)
        share = "" if not told else f" ({share_text(one.share)} of its largest value)"
        lines.append(f"  {output:24s}{factor * one.largest:+14.6g}{behind(unit)} {where.format(one.place)}{share}")
    return "\n".join([*lines, *(f"  {text}" for text in found.lacking)])


@command(
    "diff", "Largest differences of the outputs of two results.", 175, petsc=False, report=_report_of_differences,
    status=lambda found: int(not found.is_within),
    first=Argument("Run or ensemble, or its file.", word="A.h5"),
    second=Argument("Another one, of the same kind.", word="B.h5"),
    tolerance=Argument(
        "End with status 1 if an output differs by more than this share of its largest value in A.h5, or if one of "
        "the two lacks an output, the end of the run, or a sample that is fine in the other.", word="SHARE",
        allowed=Range(0.0),
    ),
    gives="By output.",
)  # fmt: skip
def diff(
    first: Result | str | PathLike[str],
    second: Result | str | PathLike[str],
    *,
    tolerance: float | None = None,
    comm: Comm | None = None,
) -> Differences:
    """Compare the outputs of `first` and `second`: two runs over time, or two ensembles of the same samples.

    Runs are compared at the instants of the one that has fewer, in the time that both cover; the other is interpolated
    linearly between its own. What joints carry as undeformed bodies start, which hangs on the mesh and on modes alone,
    is compared from the next instant on. Outputs in other units, as of scenes in mm and in SI, are compared in those of
    the first. Ensembles are compared sample by sample at the end.
    """
    comm = ranks_of(comm)
    a, b = (one if isinstance(one, Result) else read(one, comm=comm) for one in (first, second))
    with agreed(comm, "comparing the results"):
        for one, name in ((a, first), (b, second)):
            if one.kind not in ("trajectory", "ensemble"):
                cure = "in Python pgmp.read has its figures"
                if one.kind in ("rom", "components"):
                    cure = "pgmp simulate makes runs of models"
                elif one.kind in TABULAR:
                    cure = "pgmp export (-o NAME.csv) writes the columns of a table"
                known = "two runs or two ensembles can be compared"
                raise InputError(f"{_called(name)}: {named(one.kind)}; {known}; {cure}")
        if a.kind != b.kind:
            cure = "take two runs, or two ensembles; pgmp simulate with --set makes a sample of an ensemble a run"
            both = f"{named(a.kind)} ({_called(first)}) and {named(b.kind)} ({_called(second)})"
            raise InputError(f"{both}: two kinds; {cure}")
        common = [name for name in a.outputs if name in b.outputs]
        if not common:
            raise InputError(f"{_called(first)} and {_called(second)} have no output in common")
        places, of_a, of_b, lacking = _runs(a, b, common) if a.kind == "trajectory" else _samples(a, b, common)
        if not places.size:
            raise InputError(f"{_called(first)} and {_called(second)} have no instant, or no fine sample, in common")
        of_b = {name: _times(name, a.units[name], b.units[name]) * values for name, values in of_b.items()}
        there = felt({name: _size(of_a[name], of_b[name]) for name in common}, a.units)
        found = {name: _largest(of_a[name], of_b[name], a.units[name], places, there[name]) for name in common}
        entries = a.record.tables.get("outputs", {}) if a.kind == "trajectory" and len(places) > 1 else {}
        early = {name for name in entries.keys() & found if found[name].largest and not found[name].place}
        if early:
            from pgmp_petsc.scene.outputs import after_start  # takes a noticeable time

            for name in early.intersection(after_start(a.scene)):
                later = (values[1:] for values in (of_a[name], of_b[name]))
                found[name] = _largest(*later, a.units[name], places[1:], there[name])
        unknown = {name: int(np.sum(np.isfinite(of_a[name]) != np.isfinite(of_b[name]))) for name in common}
        lacking += [f"output {name} is no number {n} times in one of the two alone" for name, n in unknown.items() if n]
        lacking += [f"output {name} is in one of the two" for name in sorted({*a.outputs} ^ {*b.outputs})]
        return Differences(a.kind, len(places), found, tuple(lacking), tolerance)


Columns = dict[str, np.ndarray]


def _called(result: Result | str | PathLike[str]) -> str:
    return f"'{(result.path or 'a result without a file') if isinstance(result, Result) else result}'"


def _times(output: str, unit: str, other: str) -> float:
    """Return how many of a unit one of another is; raises `InputError` if they are of different quantities."""
    if unit == other:
        return 1.0
    (size, dimension), (factor, measured) = measure(unit), measure(other)
    if dimension != measured:
        raise InputError(f"output {output} is in {unit} in one of the two and in {other} in the other")
    return factor / size


def _runs(a: Result, b: Result, names: list[str]) -> tuple[np.ndarray, Columns, Columns, list[str]]:
    """Return the instants (n,) at which two runs are compared, s, their outputs there, and what one lacks."""
    coarse = min((a.time, b.time), key=len)
    # the last instants of two steps may differ by round-off
    begin, end = max(a.time[0], b.time[0]), min(a.time[-1], b.time[-1]) * (1.0 + 1e-12)
    time = coarse[(coarse >= begin) & (coarse <= end)]
    of_a, of_b = ({name: np.interp(time, one.time, one.outputs[name]) for name in names} for one in (a, b))
    last = max(a.time[-1], b.time[-1])
    return time, of_a, of_b, [f"one of the two ends at {end:g} s, the other at {last:g} s"] if last > end else []


def _samples(a: Result, b: Result, names: list[str]) -> tuple[np.ndarray, Columns, Columns, list[str]]:
    """Return the numbers (n,) of the samples that are fine in both ensembles, their outputs, and what one lacks."""
    same = len(a.status) == len(b.status) and {*a.parameters} == {*b.parameters}
    # samples of a table (--samples) went through other units and back
    if not same or any(not np.allclose(a.parameters[name], b.parameters[name], 1e-12, 0.0) for name in a.parameters):
        why = "they are not of the same values of parameters; give two of one scene, number and seed"
        raise InputError(f"ensembles of {len(a.status)} and {len(b.status)} samples: {why}")
    fine = np.flatnonzero((a.status == 0) & (b.status == 0))
    of_a, of_b = ({name: np.asarray(one.outputs[name])[fine] for name in names} for one in (a, b))
    n = int(np.sum((a.status == 0) != (b.status == 0)))
    return fine, of_a, of_b, [f"{counted(n, 'sample')} failed in one of the two"] if n else []


def _size(*values: np.ndarray) -> float:
    return float(np.max(np.abs(values), where=np.isfinite(values), initial=0.0))


def _largest(a: np.ndarray, b: np.ndarray, unit: str, places: np.ndarray, size: float) -> Difference:
    """Return the difference of an output, where it is a number in both, whose size is 0 where it vanishes beside others
    of its unit in both."""
    away = np.subtract(b, a, where=np.isfinite(a) & np.isfinite(b), out=np.zeros(a.shape))
    k, scale = int(np.argmax(np.abs(away))), _size(a)
    share = (abs(away[k]) / scale if scale > 0.0 else np.inf) if away[k] and size else 0.0
    return Difference(float(away[k]), unit, float(share), float(places[k]))


FIELDS = ("mises", "deformation", "displacement", "none")
RATE = 20.0
LARGEST_SCALE = 1e9  # that deformations are drawn enlarged by
ENDINGS = (".mp4", ".gif")


@command(
    "animate", "A run or a mode as a film, MP4 or GIF.", 140, petsc="mode",
    result=Argument("A trajectory, or with `mode` a reduced model; or its file.", word="FILE"),
    output=Argument(
        "File to write, NAME.mp4 or NAME.gif; it replaces an older one when it is complete.", "-o --output", "FILE",
        required=True,
    ),
    mode=Argument("Mode K of a reduced model.", word="K", allowed=Range(1)),
    at=Argument(
        "Coordinate (rad, or a length) where the mode is seen. Those at the start where not given.", word="NAME=VALUE",
        allowed="angles (rad), lengths of what slides, by the names of coordinates, such as {'theta': 0.5}",
        read=numbers_by_name("--at", "needed is NAME=VALUE, a coordinate and its value (rad, or a length)"),
    ),
    field=Argument(
        "What the colours are: mises (von Mises stress; of beams in the outermost fibres), deformation, displacement "
        "from the first frame. By default mises, of modes displacement; none where no body deforms.", allowed=FIELDS,
    ),
    scale=Argument(
        "Enlarge the deformation N times; where not given as much as shows it. It is said in the film.", word="N",
        allowed=Range(0.0, LARGEST_SCALE, above=True),
    ),
    seconds=Argument(
        "How long the film takes, s; as long as all frames do where not given.", word="T",
        allowed=Range(0.0, 3600.0, above=True, unit="s"),
    ),
    fps=Argument("Pictures a second.", word="N", allowed=Range(0.5, 120.0)),
    gives="The film.",
)  # fmt: skip
def animate(
    result: Result | str | PathLike[str],
    output: str | PathLike[str],
    *,
    mode: int | None = None,
    at: Mapping[str, float] | None = None,
    field: str | None = None,
    scale: float | None = None,
    seconds: float | None = None,
    fps: float = RATE,
    comm: Comm | None = None,
) -> Path:
    """Make a film of `result`: of a trajectory's frames or, with `mode`, of a mode of a reduced model.

    Forces in joints are arrows, where their components along all axes of the ground are outputs.

    It is written as MP4 (-o film.mp4) or GIF (-o film.gif). One rank draws.
    """
    comm = ranks_of(comm) if mode is None else solving_ranks_of(comm)
    with agreed(comm, "looking at the arguments"):
        file = file_of(result)
        places = dict(at or {})
    target = Path(output)
    on_root(comm, _check, file, target, mode, places)
    shape = None if mode is None else _shape(file, mode, places, comm)
    for line in on_root(comm, _draw, file, target, shape, field, scale, seconds, fps):
        tell(comm, line)
    return target


def _check(file: Path, output: Path, mode: int | None, at: Mapping[str, float]) -> None:
    """Refuse what cannot become a film, before anything is computed; by one process."""
    if output.suffix.lower() not in ENDINGS:
        raise InputError(f"output file '{output}': a film is named .mp4 or .gif")
    check_output(output, "film", (file,))
    kind = kind_in(file, ("trajectory", "rom", "components", "modes"))
    if kind == "components":
        cure = "simulate it first, and animate the run"
        raise InputError(f"file '{file}' is a component model, which has no modes of the mechanism; {cure}")
    if kind == "modes":
        cure = "the shapes are in a reduced model: pgmp build SCENE -o rom.h5, then pgmp animate rom.h5 --mode K"
        raise InputError(f"file '{file}': a table of modes holds frequencies alone; {cure}")
    if kind == "rom" and mode is None:
        raise InputError(f"file '{file}' is a reduced model; give --mode K for one of its modes, or simulate it first")
    if kind == "trajectory" and mode is not None:
        raise InputError(f"--mode {mode}: for reduced models; '{file}' is a trajectory")
    if at and mode is None:
        raise InputError("--at: for modes (--mode K); a film of a trajectory shows all of its frames")


def _shape(file: Path, mode: int, at: Mapping[str, float], comm: Comm) -> ModeShape:
    """Return a mode of a reduced model. Collective on `comm`."""
    from pgmp_petsc.api.sources import Origin  # takes a noticeable time
    from pgmp_petsc.studies.field_frames import mode_shape

    model = Origin.of(comm, file, None, (), ()).prepared(comm, told=False)
    return on_root(comm, mode_shape, model, mode, at)


def _draw(
    file: Path,
    output: Path,
    shape: ModeShape | None,
    field: str | None,
    scale: float | None,
    seconds: float | None,
    fps: float,
) -> list[str]:
    """Write the film and return what is to be said of it; by one process."""
    from pgmp_petsc.figures.motion import motion_of, vibration_of
    from pgmp_petsc.figures.solids import Pace, write_film  # matplotlib takes a noticeable time

    if shape is None:
        run = Trajectory.read(file)
        # frames that are not there are refused where they are drawn
        deforms = run.frames is None or not set(run.frames.positions) <= set(run.frames.rigid)
        motion: Motion = motion_of(run, field or ("mises" if deforms else "none"), scale)
    else:
        motion = vibration_of(shape, field or "displacement", scale)
    pace = Pace.of(len(motion.captions), fps, seconds)
    n = write_film(motion, output, pace)
    of = f"{n} of {len(motion.captions)} instants" if n < len(motion.captions) else f"{n} pictures"
    enlarged = f", deformation enlarged {motion.scale:g} times" if motion.scale != 1.0 else ""
    notes = (text if text.startswith("warning: ") else f"note: {text}" for text in motion.notes)
    said = [f"{output}: {of}, {pace.seconds:.3g} s{enlarged}", *(f"  {text}" for text in notes)]
    return said if shape is not None else [*said, *stopped_runs(file)]


@command(
    "plot", "Draw result files as pictures.", 130, petsc=False,
    files=Argument("Result files.", word="FILE", allowed="a list of names of files"),
    output=Argument("Directory for the pictures; made if it does not exist.", "-o --output", "DIR", required=True),
    exaggerate=Argument(
        "Enlarge the deformation in the pictures of the mechanism.", word="FACTOR", allowed=Range(1.0, LARGEST_SCALE)
    ),
    at=Argument(
        "Instant of the picture of solids; that of the largest stress if not given.", word="SECONDS",
        allowed=Range(0.0),
    ),
    gives="The folder.",
)  # fmt: skip
def plot(
    files: Sequence[str | PathLike[str]],
    output: str | PathLike[str],
    *,
    exaggerate: float = 1.0,
    at: float | None = None,
    comm: Comm | None = None,
) -> Path:
    """Draw result FILEs: what belongs together goes into one picture.

    Results of different scenes never share a picture: with several, the names of pictures end with those of the
    scenes. Within one, keys tell results apart by what differs: parameters, other entries of the scene, the model,
    the seed, or else the file. Brackets hold confidence intervals.

    Tables of modes become frequencies.png or, with two coordinates, frequency_maps.png. Trajectories become
    trajectories.png (full-order and reduced ones are compared where they are of one case); the first that has
    them gives mechanism.png, energies.png, of solids solids.png (surfaces with von Mises' stress in colour), forces.png
    (of joints, polar), torques.png (of drives over their speed), rainflow.png and, with two coordinates,
    coordinate_path.png. Ensembles become densities.png and, each ensemble by itself, bands.png (outputs over time) and
    sobol.png (which parameters matter), rare events rare_event.png, trade-off studies tradeoff.png,
    tradeoff_total.png and tradeoff_mesh.png.
    """
    comm = ranks_of(comm)
    paths, folder = [Path(file) for file in files], Path(output)

    def drawing_the_pictures() -> list[str]:
        from pgmp_petsc.figures.collection import draw  # matplotlib takes a noticeable time

        return draw(paths, folder, exaggerate, at)

    _tell_of_files(comm, on_root(comm, drawing_the_pictures), paths)
    return folder


@command(
    "report", "Write results as one page that needs no network.", 150, petsc=False,
    results=Argument(
        "Results, or names of their files: trajectories, ensembles, trade-offs, fits and reduced models.", word="FILE",
        allowed="a list of results, or of names of files",
    ),
    path=Argument(
        "Page to write; it replaces an older one when it is complete.", "-o --output", "FILE.html", required=True
    ),
    gives="The page.",
)  # fmt: skip
def write_report(
    results: Sequence[Result | str | PathLike[str]], path: str | PathLike[str], *, comm: Comm | None = None
) -> Path:
    """Write result FILEs as one page that needs no network: for the screen, the phone and the printer.

    FILEs are trajectories, ensembles, trade-off studies, fits, and reduced models, whose choices are a part of the
    error budget. Figures of several ensembles, or of several runs of one model, stand beside each other. It begins
    with a verdict and has the mechanism as a film, outputs with bands, distributions with intervals, which parameters
    matter, the error budget, the balance of energy, samples that failed, warnings, costs, the commands that repeat it,
    and the data as CSV. What is not known is said.

    Results of different scenes get sections of their own, with the scenes' names.

    A page names the files that it is of: what a program holds and was not written yet is written beside it, as
    PAGE_KIND_NUMBER.h5.
    """
    comm = ranks_of(comm)
    path, files = Path(path), []
    for number, result in enumerate(results, 1):
        if not isinstance(result, Result):
            files.append(Path(result))
        else:
            files.append(result.path or result.write(path.with_name(f"{path.stem}_{result.kind}_{number}.h5")))

    def writing_the_page() -> list[str]:
        from pgmp_petsc.report.page import write_report as write

        return write(files, path)

    _tell_of_files(comm, on_root(comm, writing_the_page), files)
    return path


def _tell_of_files(comm: Comm, lines: Sequence[str], files: Sequence[Path]) -> None:
    """Tell what was made, and of which files only a part could be shown. Collective on `comm`."""
    for line in (*lines, *on_root(comm, stopped_runs, *files)):
        tell(comm, line)
