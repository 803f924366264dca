"""The look that all pictures share: colours, type, grid, units on axes, and what tells several runs apart."""

from __future__ import annotations

import functools
import os
import tomllib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import ParamSpec

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from pgmp_petsc import __version__
from pgmp_petsc.runtime.files import RunRecord

Arguments = ParamSpec("Arguments")

# Okabe and Ito's palette: told apart with any common kind of colour blindness, and printed in grey.
PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#4D4D4D")
FULL_COLOUR = "#4D4D4D"
REDUCED_COLOUR = "#D55E00"
QUIET = "#6B6B6B"
RESOLUTION = 150
PROGRAM = f"pgmp_petsc {__version__}"

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
# Powers of 1000 that are written as prefixes, for the units that are used with them.
_PREFIXES = {0: "", -1: "m", -2: "µ", -3: "n", 1: "k", 2: "M", 3: "G"}
_PREFIXED_UNITS = {"m", "s", "N", "Pa", "J", "W", "rad", "Hz"}


def styled(draw: Callable[Arguments, Figure]) -> Callable[Arguments, Figure]:
    """Run a drawing function under the shared settings, without changing those of the process."""

    @functools.wraps(draw)
    def wrapped(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Figure:
        with matplotlib.rc_context(_SETTINGS):
            return draw(*args, **kwargs)

    return wrapped


def new_figure(width: float, height: float) -> Figure:
    """Return an empty figure of the given size (inches), drawn by Agg, with constrained layout."""
    figure = Figure(figsize=(width, height), dpi=RESOLUTION, layout="constrained")
    FigureCanvasAgg(figure)
    figure.get_layout_engine().set(w_pad=0.1, h_pad=0.08, wspace=0.04, hspace=0.04)
    return figure


def save(figure: Figure, path: str | os.PathLike[str]) -> Path:
    """Write a figure as PNG (or what the suffix says) and return the path."""
    with matplotlib.rc_context(_SETTINGS):
        # tells `check_output` that the picture is ours to replace
        figure.savefig(path, dpi=RESOLUTION, metadata={"Software": PROGRAM} if Path(path).suffix == ".png" else None)
    return Path(path)


def top_legend(figure: Figure, handles: Sequence[Line2D], title: str | None = None) -> None:
    """Put a title and rows of keys above all axes, and keep that strip free of them."""
    inches = figure.get_figheight()
    used = 0.1
    if title:
        left = 0.12 / figure.get_figwidth()
        figure.text(left, 1 - used / inches, title, va="top", fontsize=12.5, weight="bold")
        used += 0.27
    if handles:
        n_columns = len(handles)
        if sum(0.6 + 0.065 * len(handle.get_label()) for handle in handles) > figure.get_figwidth():
            n_columns = min(len(handles), max(1, int(figure.get_figwidth() / 1.6)))
        figure.legend(
            handles=handles,
            loc="upper left",
            bbox_to_anchor=(0.0, 1 - (used - 0.06) / inches),
            ncol=n_columns,
            handlelength=1.9,
            columnspacing=1.8,
        )
        used += 0.24 + 0.2 * (-(-len(handles) // n_columns) - 1)
    figure.get_layout_engine().set(rect=(0, 0, 1, 1 - used / inches))


def axis_unit(unit: str, *arrays: np.ndarray) -> tuple[float, str]:
    """Return the factor and the prefixed unit that give values of at most three digits before the point."""
    largest = max((np.nanmax(np.abs(values), initial=0.0) for values in arrays), default=0.0)
    if unit not in _PREFIXED_UNITS or not np.isfinite(largest) or largest == 0.0:
        return 1.0, unit
    # 0.3 m reads better than 300 mm: the prefix changes at a tenth of the unit.
    power = int(np.floor(np.log10(largest * 10.0) / 3.0 + 1e-9))
    power = min(max(power, -3), 0 if unit in ("m", "s", "rad") else 3)
    return 1000.0**-power, f"{_PREFIXES[power]}{unit}"


def axis_label(name: str, unit: str) -> str:
    """Return ``crank angle (rad)`` for ``crank_angle``; a number without unit has no brackets."""
    words = name.replace("_", " ")
    return words if unit in ("", "1") else f"{words} ({unit})"


def quantity(name: str, value: float, unit: str) -> str:
    """Return ``r1 = 5.6 mm``."""
    factor, shown = axis_unit(unit, np.array([value]))
    return f"{name} = {value * factor:.4g}{'' if shown in ('', '1') else ' ' + shown}"


def labels_by_parameters(records: Sequence[RunRecord]) -> list[str]:
    """Return for each run the parameters in which the runs differ; an empty text where they do not."""
    names = sorted({name for record in records for name in record.parameters})
    varied = [name for name in names if len({record.parameters.get(name) for record in records}) > 1]
    return [
        ", ".join(
            quantity(name, record.parameters[name], _parameter_unit(record, name))
            for name in varied
            if name in record.parameters
        )
        for record in records
    ]


def scene_name(record: RunRecord) -> str:
    """Return the scene's name in words; an empty text if it has none."""
    try:
        return str(tomllib.loads(record.scene_toml)["scene"]["name"]).replace("_", " ")
    except (tomllib.TOMLDecodeError, KeyError, TypeError):
        return ""


def angle_ticks(axes: Axes, values: np.ndarray, unit: str) -> None:
    """Tick an axis of angles that spans about a revolution at quarters of it."""
    axes.set_xlim(values[0], values[-1])
    if unit == "rad" and abs(values[0]) < 0.05 and abs(values[-1] - 2 * np.pi) < 0.2:
        axes.set_xlim(0.0, 2 * np.pi)
        axes.set_xticks(np.arange(5) * np.pi / 2, ["0", "π/2", "π", "3π/2", "2π"])


def _parameter_unit(record: RunRecord, name: str) -> str:
    """Return the unit that the scene gives for a parameter."""
    try:
        return str(tomllib.loads(record.scene_toml)["parameters"][name]["unit"])
    except (tomllib.TOMLDecodeError, KeyError, TypeError):
        return "1"
