"""The look that all pictures share: colours, type, grid, units on axes, titles; and captions above
pictures, how results differ and what their reader has to know besides.

Results belong together where their scenes have one name and the same bodies, joints and coordinates. What may differ
within that is said: ``r1 = 5 mm``, ``simulation.step = 0.001``, ``without effects.weight``, ``reduced``, and the name
of the file where nothing else differs. Runs that ended early are named, and warnings that come with results.
"""

from __future__ import annotations

import functools
import io
import os
import re
import textwrap
import tomllib
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, ParamSpec
from warnings import catch_warnings, filterwarnings, showwarning

import matplotlib
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.ticker import Formatter, MaxNLocator

from pgmp_petsc.base import __version__
from pgmp_petsc.base.errors import counted
from pgmp_petsc.base.units import behind
from pgmp_petsc.files.claims import KINDS, named, replacing
from pgmp_petsc.files.hdf5 import RunRecord, open_file
from pgmp_petsc.files.seal import kind_of
from pgmp_petsc.results import Trajectory
from pgmp_petsc.results.numbers import axis_unit

Arguments = ParamSpec("Arguments")

# Okabe and Ito's palette: told apart with any common kind of colour blindness, and printed in grey.
PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#4D4D4D")
FULL_COLOUR = "#4D4D4D"
COMPONENT_COLOUR = "#0072B2"
REDUCED_COLOUR = "#D55E00"
QUIET = "#6B6B6B"
CROSSES = {"linestyle": "none", "marker": "x", "markersize": 4.5, "markeredgewidth": 1.1, "clip_on": False}
MODELS = {"full": "full order", "components": "component modes", "reduced": "reduced"}
RESOLUTION = 150
SHOWN = 75  # in notebooks
PROGRAM = f"pgmp_petsc {__version__}"
LACKING = r"Glyph (\d+) .* missing from (current )?font"  # of matplotlib

_SETTINGS = {
    "font.family": "sans-serif",
    "font.sans-serif": ["Source Sans 3", "Open Sans", "Liberation Sans", "DejaVu Sans"],
    "font.size": 9.5,
    "axes.titlesize": 10.5,
    "axes.titlelocation": "left",
    "axes.titlepad": 7.0,
    "axes.labelsize": 9.5,
    "axes.edgecolor": "#8A8A8A",
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.formatter.useoffset": False,
    "axes.prop_cycle": matplotlib.cycler(color=PALETTE),
    "grid.color": "#E4E4E4",
    "grid.linewidth": 0.6,
    "xtick.color": "#555555",
    "ytick.color": "#555555",
    "xtick.labelsize": 8.5,
    "ytick.labelsize": 8.5,
    "lines.linewidth": 1.5,
    "legend.frameon": False,
    "legend.fontsize": 9.0,
    "figure.facecolor": "white",
}
# Texts above all axes: height of a line, and characters an inch, which tell where lines break.
_TITLE = {"font": {"fontsize": 12.5, "weight": "bold"}, "inches": 0.23, "characters_per_inch": 9.6}
_NOTE = {"font": {"fontsize": 8.5, "color": "#A32A00"}, "inches": 0.16, "characters_per_inch": 15.0}


def styled(draw: Callable[Arguments, Figure]) -> Callable[Arguments, Figure]:
    """Run a drawing function under the shared settings, without changing those of the process."""

    @functools.wraps(draw)
    def wrapped(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Figure:
        with matplotlib.rc_context(_SETTINGS):
            return draw(*args, **kwargs)

    return wrapped


class Picture(Figure):
    """A figure that notebooks show without pyplot."""

    def _repr_png_(self) -> bytes:
        with matplotlib.rc_context(_SETTINGS), io.BytesIO() as stream:
            self.savefig(stream, format="png", dpi=SHOWN)
            return stream.getvalue()


def new_figure(width: float, height: float) -> Figure:
    """Return an empty figure of the given size (inches), drawn by Agg, with constrained layout."""
    figure = Picture(figsize=(width, height), dpi=RESOLUTION, layout="constrained")
    FigureCanvasAgg(figure)
    figure.get_layout_engine().set(w_pad=0.1, h_pad=0.08, wspace=0.04, hspace=0.04)
    return figure


def panel_grid(
    n: int, size: tuple[float, float], margin: float, least: float = 0.0, ratios: Sequence[float] = (1.0,),
    columns: int = 3, **sharing: Any,
) -> tuple[Figure, np.ndarray]:  # fmt: skip
    """Return a figure of n blocks, row by row, and the axes of each from above, shape (n, len(ratios)), of such
    heights.

    `size`, `margin` and `least` are width and height of a block, what the figure is higher than all of them, and its
    least width, inches.
    """
    n_columns = min(n, columns)
    n_rows = -(-n // n_columns)
    figure = new_figure(max(size[0] * n_columns, least), size[1] * n_rows + margin)
    heights = {"height_ratios": [*ratios] * n_rows}
    panels = figure.subplots(n_rows * len(ratios), n_columns, squeeze=False, gridspec_kw=heights, **sharing)
    blocks = panels.reshape(n_rows, len(ratios), n_columns).swapaxes(1, 2).reshape(-1, len(ratios))
    for axes in blocks[n:].flat:
        axes.set_visible(False)
    return figure, blocks[:n]


def save(figure: Figure, path: str | os.PathLike[str]) -> Path:
    """Write a figure as PNG (or what the suffix says), whole or not at all, and return the path. Raises `RunError` if
    the system fails to write (a full disk, say); an older picture is left as it was."""
    path = Path(path)
    with matplotlib.rc_context(_SETTINGS):
        # tells `check_output` that the picture is ours to replace
        software = {"Software": PROGRAM} if path.suffix == ".png" else None
        with replacing(path, "picture") as partial:
            figure.savefig(partial, dpi=RESOLUTION, format=path.suffix[1:] or "png", metadata=software)
    return path


@contextmanager
def letters_lacking() -> Iterator[list[str]]:
    """Catch what is said of letters that the font of pictures saved within does not have; what is yielded has a line on
    them behind the block, where there are any."""
    lines: list[str] = []
    with catch_warnings(record=True) as said:
        filterwarnings("always", LACKING, UserWarning)
        yield lines
    letters = []
    for one in said:
        code = re.match(LACKING, str(one.message))
        if code is None:
            showwarning(one.message, one.category, one.filename, one.lineno)
        elif chr(int(code[1])) not in letters:
            letters.append(chr(int(code[1])))
    if letters:
        lines.append(f"the font of pictures has no {', '.join(letters)}: boxes are in their place")


def top_legend(figure: Figure, handles: Sequence[Artist], title: str | None, notes: Sequence[str] = ()) -> Figure:
    """Put a title, what has to be known besides, and rows of keys above all axes; return the figure.

    The strip is kept free of axes; the figure grows by what lies beyond one line of title and one row of keys.
    """
    width = figure.get_figwidth()
    lines = [(line, _TITLE) for line in _wrapped(title or "", width, _TITLE)]
    lines += [(line, _NOTE) for note in notes for line in _wrapped(note, width, _NOTE)]
    needed = [0.6 + 0.065 * len(handle.get_label()) for handle in handles]
    n_columns = len(handles) if sum(needed) <= width else min(len(handles), max(1, int(width / max(1.6, *needed))))
    n_rows = -(-len(handles) // n_columns) if handles else 0
    more = sum(look["inches"] for _, look in lines[1:]) + 0.2 * max(n_rows - 1, 0)
    inches = figure.get_figheight() + more
    figure.set_figheight(inches)

    used = 0.1
    for line, look in lines:
        figure.text(0.12 / width, 1 - used / inches, line, va="top", **look["font"])
        used += look["inches"]
    used += 0.04
    if handles:
        figure.legend(
            handles=handles,
            loc="upper left",
            bbox_to_anchor=(0.0, 1 - (used - 0.06) / inches),
            ncol=n_columns,
            handlelength=1.9,
            columnspacing=1.8,
        )
        used += 0.24 + 0.2 * (n_rows - 1)
    figure.get_layout_engine().set(rect=(0, 0, 1, 1 - used / inches))
    return figure


def _wrapped(text: str, width: float, look: Mapping[str, Any]) -> list[str]:
    return textwrap.wrap(text, int((width - 0.24) * look["characters_per_inch"]))


class PlainNumbers(Formatter):
    """Numbers on an axis without a common factor or offset, which would cover the text above.

    They have six digits, or as many as tell one tick from the next.
    """

    def __init__(self) -> None:
        self.digits = 6

    def set_locs(self, locs: Sequence[float]) -> None:
        """Find the digits for ticks at these places, on a linear axis."""
        super().set_locs(locs)
        places = np.unique(locs)
        apart, largest = np.diff(places).min(initial=np.inf), np.abs(places).max(initial=0.0)
        if 0.0 < apart < largest:
            self.digits = int(np.clip(np.floor(np.log10(largest)) - np.floor(np.log10(apart)) + 1, 6, 15))

    def __call__(self, value: float, pos: int | None = None) -> str:
        return f"{value:.{self.digits}g}"


def axis_label(name: str, unit: str) -> str:
    """Return ``crank_angle (rad)``; a number without unit has no brackets."""
    return name if unit in ("", "1") else f"{name} ({unit})"


def quantity(name: str, value: float, unit: str) -> str:
    """Return ``r1 = 5.6 mm``."""
    factor, shown = axis_unit(unit, np.array([value]))
    return f"{name} = {value * factor:.4g}{behind(shown)}"


def scene_of(record: RunRecord) -> dict[str, Any]:
    """Return the resolved scene of a result; empty where it is no TOML."""
    try:
        return record.tables
    except tomllib.TOMLDecodeError:
        return {}


def scene_name(record: RunRecord) -> str:
    return str(scene_of(record).get("scene", {}).get("name", ""))


def heading(what: str, record: RunRecord, label: str = "") -> str:
    """Return what a picture shows, and of which scene and result: ``Balance of energy: four_bar, r1 = 5 mm``."""
    of = ", ".join(filter(None, (scene_name(record), label)))
    return f"{what}: {of}" if of else what


def upward(points: np.ndarray) -> int:
    """Return which axis points upwards in pictures of places in space (n, 3): y where they extend least along z, else
    z."""
    return 1 if int(np.argmin(np.ptp(points, axis=0))) == 2 else 2


def distinct_colours(n: int) -> list[str]:
    """Return n colours, each only once: those of the palette, or as many as are needed from dark violet to yellow."""
    if n <= len(PALETTE):
        return list(PALETTE[:n])
    return [to_hex(colour) for colour in matplotlib.colormaps["viridis"](np.linspace(0.0, 0.92, n))]


def round_below(value: float) -> float:
    """Return the largest of 1, 2 and 5 times a power of ten that is no more than a positive number."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(power * max(step for step in (1.0, 2.0, 5.0) if step * power <= value * (1.0 + 1e-9)))


def span(axes: Axes, low: float, high: float) -> None:
    """Let a horizontal axis reach from one value to another, with few ticks, whose numbers do not touch; a single value
    leaves its reach as it is."""
    axes.xaxis.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10]))
    if high > low:
        axes.set_xlim(low, high)


def angle_ticks(axes: Axes, values: np.ndarray, unit: str) -> None:
    """Tick an axis of angles that spans about a revolution at quarters of it."""
    span(axes, values[0], values[-1])
    if unit == "rad" and abs(values[0]) < 0.05 and abs(values[-1] - 2 * np.pi) < 0.2:
        axes.set_xlim(0.0, 2 * np.pi)
        axes.set_xticks(np.arange(5) * np.pi / 2, ["0", "π/2", "π", "3π/2", "2π"])


MOST, LONGEST = 3, 220  # a picture has room for so many, of so many characters; the files have the rest


def planned_end(run: Trajectory) -> float:
    """Return the instant (s) at which the scene ends, the run's own end where it says none."""
    return max(scene_of(run.record).get("simulation", {}).get("duration", 0.0), float(run.time[-1]))


def ended_early(run: Trajectory) -> bool:
    """Tell whether a run ended before its scene does."""
    return bool(run.time[-1] < planned_end(run) * (1.0 - 1e-9))


def notes_of_runs(runs: Sequence[Trajectory], labels: Sequence[str] = ()) -> list[str]:
    """Return the notes for a picture of runs, the labels before them where there are several."""
    labels = labels or [""] * len(runs)
    early = [
        _labelled(f"ended early, at {run.time[-1]:.4g} s of {planned_end(run):.4g} s", label)
        for run, label in zip(runs, labels)
        if ended_early(run)
    ]
    return [*early, *notes_of_records([run.record for run in runs], labels)]


def headed(figure: Figure, keys: Sequence[Artist], what: str, record: RunRecord, label: str) -> Figure:
    """Put what a picture of one result shows above it, the warnings that come with the result, and rows of keys."""
    return top_legend(figure, keys, heading(what, record, label), notes_of_records([record]))


def notes_of_records(records: Sequence[RunRecord], labels: Sequence[str] = ()) -> list[str]:
    """Return the warnings of results, each once."""
    labels = labels or [""] * len(records)
    texts = dict.fromkeys(
        _labelled(str(remark), label)
        for record, label in zip(records, labels)
        for remark in record.remarks
        if remark.kind == "warning"
    )
    shown = [_short(text) for text in list(texts)[:MOST]]
    left = len(texts) - len(shown)
    return [*shown, f"and {counted(left, 'more warning')}: see pgmp info"] if left else shown


def _short(text: str) -> str:
    """Return as many clauses of a warning as a picture has room for, the first one at least."""
    if len(text) <= LONGEST:
        return text
    end = max(text.rfind(mark, 0, LONGEST) for mark in ("; ", ": ", ". "))
    return f"{text[:end]} …" if end > 0 else textwrap.shorten(text, LONGEST, placeholder=" …")


def _labelled(text: str, label: str) -> str:
    return f"{label}: {text}" if label else text


# Parts of a scene that change nothing in a run, and those that one model has alone or that only resolve it in time.
WITHOUT_EFFECT = ("scene", "parameters", "outputs", "ensemble", "simulation.frames", "simulation.error_indicator")
OF_THE_MODEL = ("reduction", "simulation")
OF_RUNS = ("simulation", "simulation.initial", "initial")
_START = "simulation.initial"
MOST_ENTRIES, LONGEST_VALUE = 3, 24  # more entries, and longer values, are not spelled out: the file's name says more
_ABSENT = object()


def mechanism_key(record: RunRecord) -> tuple:
    """Return what results that belong together have in common: the scene's name and those of the mechanism's parts."""
    scene = scene_of(record)
    parts = (tuple(sorted(scene.get(part, {}))) for part in ("bodies", "joints", "coordinates"))
    return (scene.get("scene", {}).get("name", ""), *parts)


def read_scenes(
    files: Sequence[Path], readers: Mapping[str, type], done: str, **most: int
) -> tuple[list[list[tuple[Path, Any, str]]], list[str]]:
    """Return results with their files before and the programs' versions behind, one list a scene, in the order in which
    they come, and a line for each file given twice, of what is done once, or of a kind that there is no reader for. At
    `most` so many entries along a size are read. Raises `InputError` if a file is damaged, or all are of such kinds.
    """
    scenes: dict[tuple, list[tuple[Path, Any, str]]] = {}
    lines, seen = [], set()
    for path in files:
        if (real := os.path.realpath(path)) in seen:
            lines.append(f"{path} is given twice and {done} once")
            continue
        seen.add(real)
        kind = kind_of(path)
        if kind in KINDS and kind not in readers:
            lines.append(f"{path} holds {named(kind)} and is not {done}: see pgmp info")
            continue
        with open_file(path, readers) as file:
            program = str(file.attrs["program_version"])
        result = readers[kind].read(path, **most)
        scenes.setdefault(mechanism_key(result.record), []).append((path, result, program))
    if not scenes:
        open_file(files[0], readers)  # which says what there is to give
    return list(scenes.values()), lines


def same_case(one: RunRecord, other: RunRecord, ignored: Collection[str] = ()) -> bool:
    """Tell whether the runs of two models show the same case: equal parameters, but for the last digits, and scenes
    that differ in what concerns one model or the resolution in time alone, or in tables and entries that are ignored.
    """
    mine, theirs = one.parameters, other.parameters
    alike = (np.isclose(mine[name], theirs[name], rtol=1e-9, atol=0.0) for name in mine)
    equal = mine.keys() == theirs.keys() and all(alike)
    different = _differing([scene_of(one), scene_of(other)])
    return equal and not any(_counts(name, (*WITHOUT_EFFECT, *OF_THE_MODEL, *ignored)) for name, _ in different)


def tell_apart(
    records: Sequence[RunRecord],
    kinds: Sequence[str] = (),
    files: Sequence[Path | None] = (),
    ignored: Collection[str] = WITHOUT_EFFECT,
) -> list[str]:
    """Return for each result the words that tell it from the others; empty texts where there is one result alone.

    What else a result is, the model say, is told where `kinds` vary, and the file it comes from where nothing else
    differs; `ignored` tables and entries of scenes make no difference.
    """
    if len(records) < 2:
        return [""] * len(records)
    words = [[text] if text else [] for text in labels_by_parameters(records)]
    entries = [row for row in _differing([scene_of(record) for record in records]) if _counts(row[0], ignored)]
    for name, values in entries[:MOST_ENTRIES]:
        for text, value in zip(words, values):
            text.append(_entry(name, value))
    if kinds and len(set(kinds)) > 1:
        for text, kind in zip(words, kinds):
            text.insert(0, kind)
    if len({record.seed for record in records}) > 1:
        for text, record in zip(words, records):
            text.append(f"seed {'none' if record.seed is None else record.seed}")
    texts = [", ".join(filter(None, text)) for text in words]
    alone = len(entries) <= MOST_ENTRIES
    if alone and len(set(texts)) == len(texts) or not files or None in files:
        return texts
    return [
        text if texts.count(text) == 1 and alone else ", ".join(filter(None, (text, name)))
        for text, name in zip(texts, short_names(files))
    ]


def labels_by_parameters(records: Sequence[RunRecord]) -> list[str]:
    """Return for each run the parameters in which the runs differ; an empty text where they do not."""
    names = sorted({name for record in records for name in record.parameters})
    varied = [name for name in names if len({record.parameters.get(name) for record in records}) > 1]
    words = []
    for record in records:
        entries, known = scene_of(record).get("parameters", {}), [name for name in varied if name in record.parameters]
        units = (str(entries.get(name, {}).get("unit", "1")) for name in known)
        words.append(", ".join(quantity(name, record.parameters[name], unit) for name, unit in zip(known, units)))
    return words


def short_names(files: Sequence[Path]) -> list[str]:
    """Return the files' names, with as many of their directories as tell them apart."""
    absolute = [Path(os.path.abspath(file)).parts for file in files]
    for length in range(1, max(map(len, absolute)) + 1):
        names = [os.path.join(*parts[-length:]) for parts in absolute]
        if len(set(names)) == len(set(absolute)):
            break
    return names


def _differing(scenes: Sequence[Any], prefix: str = "") -> Iterator[tuple[str, list[Any]]]:
    """Yield dotted names of entries in which scenes differ, with every scene's value; a missing table as a whole."""
    for name in dict.fromkeys(name for scene in scenes for name in scene):
        values = [scene.get(name, _ABSENT) for scene in scenes]
        if all(isinstance(value, dict) for value in values):
            yield from _differing(values, f"{prefix}{name}.")
        elif any(value != values[0] for value in values):
            yield f"{prefix}{name}", values


def _counts(name: str, ignored: Collection[str]) -> bool:
    """Tell whether an entry makes a difference. How a run starts is no matter of its resolution in time."""
    if f"{name}.".startswith(f"{_START}."):
        return _START not in ignored
    return not any(f"{name}.".startswith(f"{table}.") for table in ignored)


def _entry(name: str, value: Any) -> str:
    """Return ``simulation.step = 0.001``, ``with effects.weight`` or ``without effects.weight``."""
    if value is _ABSENT:
        return f"without {name}"
    if isinstance(value, dict):
        return f"with {name}"
    if isinstance(value, float):
        return f"{name} = {value:.6g}"
    text = f"{name} = {str(value).lower() if isinstance(value, bool) else value}"
    # long values are all cut alike: names of files then tell the results apart
    return text if len(text) <= len(name) + LONGEST_VALUE else f"{name} = …"
