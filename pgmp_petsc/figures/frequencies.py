"""Eigenfrequencies over the configurations, full-order and reduced (as Fig. 2 of Naets et al. 2015).

Mechanisms with two coordinates: eigenfrequencies as maps over their plane, and the path of a run through it.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.figures import captions, style
from pgmp_petsc.figures.captions import OF_RUNS, WITHOUT_EFFECT, tell_apart
from pgmp_petsc.figures.mechanism import TimeColours
from pgmp_petsc.results import ModesTable, Trajectory

N_CROSSES = 24  # about as many crosses as can be told from the line below them
COLUMNS = 2


@style.styled
def frequencies(
    tables: Sequence[ModesTable],
    n_modes: int = 4,
    labels: Sequence[str] | None = None,
    titles: Sequence[str] | None = None,
) -> Figure:
    """Draw the first flexible eigenfrequencies of tables, one colour each, in `n_modes` panels, one a mode, or fewer
    where no table has as many.

    Labels of the tables are by default that in which they differ, and titles of the panels the number of the flexible
    mode. Raises `InputError` if no table has a flexible mode.
    """
    labels = labels_of(tables) if labels is None else labels
    colours = style.distinct_colours(len(tables))
    n_modes = min(n_modes, max(table.full_hz.shape[1] for table in tables))
    if n_modes == 0:
        raise InputError("the tables have no flexible modes to draw: every body is rigid")
    figure, blocks = style.panel_grid(n_modes, (4.2, 2.45), 0.75, columns=COLUMNS, sharex=True)
    for mode, axes in enumerate(blocks[:, 0]):
        for table, colour in zip(tables, colours):
            _draw_mode(axes, table, mode, colour)
        axes.set_title(titles[mode] if titles else f"flexible mode {mode + 1}: frequency (Hz)")
        axes.margins(y=0.12)
        theta, name, unit = _abscissa(tables[0])
        style.angle_ticks(axes, theta, unit)
        if mode >= n_modes - COLUMNS:
            axes.set_xlabel(style.axis_label(name, unit))
            axes.tick_params(labelbottom=True)

    several, reduced = len(tables) > 1, any(table.reduced_hz is not None for table in tables)
    keys = [Line2D([], [], color=colour, label=label) for label, colour in zip(labels, colours) if label and several]
    line_colour = style.QUIET if keys else colours[0]
    if reduced:
        keys.append(Line2D([], [], color=line_colour, label="full order"))
        keys.append(Line2D([], [], color=line_colour, linestyle="none", marker="x", label="reduced"))
    what = "Eigenfrequencies, full order" + (" and reduced" if reduced else "")
    notes = captions.of_records([table.record for table in tables], labels)
    return style.top_legend(figure, keys, style.heading(what, tables[0].record, "" if several else labels[0]), notes)


def labels_of(tables: Sequence[ModesTable], files: Sequence[Path] = ()) -> list[str]:
    """Return what tells tables of modes apart; motion and time make no difference to them."""
    return tell_apart([table.record for table in tables], files=files, ignored=(*WITHOUT_EFFECT, *OF_RUNS))


def _draw_mode(axes, table: ModesTable, mode: int, colour: str) -> None:
    theta = _abscissa(table)[0]
    if mode < table.full_hz.shape[1]:
        axes.plot(theta, table.full_hz[:, mode], color=colour)
    if table.reduced_hz is not None and mode < table.reduced_hz.shape[1]:
        step = max(1, len(theta) // N_CROSSES)
        axes.plot(theta[::step], table.reduced_hz[::step, mode], color=colour, **style.CROSSES)


def _abscissa(table: ModesTable) -> tuple[np.ndarray, str, str]:
    """Return values, name and unit of the horizontal axis; with several coordinates a running number."""
    if table.theta.ndim == 1:
        (name, unit), *_ = table.coordinate_units.items()
        return table.theta, name, unit
    return np.arange(table.theta.shape[1]), "configuration", "1"


MAPS = 4  # of the first modes
N_LEVELS = 12
N_SEGMENTS = 200  # shorter segments of a path are paler, because each is smoothed at its edges


@style.styled
def frequency_maps(table: ModesTable, label: str = "") -> Figure:
    """Draw the first flexible eigenfrequencies over the grid of two coordinates, one map each.

    With a reduced model beside the full order, each title says by how much its frequencies differ at most. The label
    tells the table from others. Raises `InputError` if the table has not two coordinates.
    """
    if len(table.coordinate_units) != 2:
        raise InputError(f"maps of frequencies need two coordinates, the table has {len(table.coordinate_units)}")
    first, second = (np.unique(theta) for theta in table.theta)
    n_modes = min(MAPS, table.full_hz.shape[1])
    figure, blocks = style.panel_grid(n_modes, (4.2, 3.1), 0.5, columns=COLUMNS, sharex=True, sharey=True)
    (x_name, x_unit), (y_name, y_unit) = table.coordinate_units.items()
    for mode, axes in enumerate(blocks[:, 0]):
        # the last coordinate runs fastest: rows are the first one
        values = table.full_hz[:, mode].reshape(len(first), len(second))
        filled = axes.contourf(first, second, values.T, MaxNLocator(N_LEVELS).tick_values(values.min(), values.max()))
        figure.colorbar(filled, ax=axes, pad=0.02, ticks=MaxNLocator(5)).outline.set_visible(False)
        within = ""
        if table.reduced_hz is not None and mode < table.reduced_hz.shape[1]:
            off = np.max(np.abs(table.reduced_hz[:, mode] / table.full_hz[:, mode] - 1.0))
            within = f", reduced within {100.0 * off:.1g} %"
        axes.set_title(f"flexible mode {mode + 1} (Hz){within}")
        axes.grid(False)
        if mode >= n_modes - COLUMNS:
            axes.set_xlabel(style.axis_label(x_name, x_unit))
            axes.tick_params(labelbottom=True)
        if mode % COLUMNS == 0:
            axes.set_ylabel(style.axis_label(y_name, y_unit))
    what = "Eigenfrequencies, full order" + (" and reduced" if table.reduced_hz is not None else "")
    return captions.headed(figure, [], what, table.record, label)


@style.styled
def coordinate_path(trajectory: Trajectory, label: str = "") -> Figure:
    """Draw the path of a run through the plane of its two coordinates, coloured by time, and their ranges in the scene;
    raises `InputError` if the run has not two coordinates."""
    if len(trajectory.coordinate_units) != 2:
        raise InputError(f"a path needs two coordinates, the run has {len(trajectory.coordinate_units)}")
    figure = style.new_figure(6.4, 5.2)
    axes = figure.subplots()
    keys = _draw_ranges(axes, trajectory)
    n_times = len(trajectory.time)
    chosen = np.unique(np.linspace(0, n_times - 1, min(n_times, N_SEGMENTS + 1)).round().astype(int))
    time, points = trajectory.time[chosen], trajectory.coordinates[chosen]
    colours = TimeColours.over(trajectory.time)
    segments = np.stack([points[:-1], points[1:]], axis=1)
    scaled = {"array": time[1:], "cmap": colours.colours, "norm": colours.scale}
    axes.add_collection(LineCollection(segments, linewidths=2.2, capstyle="round", **scaled))
    for number in (0, -1):
        axes.plot(*points[number], "o", color=colours.at(time[number]), markersize=7.0)
    (x_name, x_unit), (y_name, y_unit) = trajectory.coordinate_units.items()
    axes.set_xlabel(style.axis_label(x_name, x_unit))
    axes.set_ylabel(style.axis_label(y_name, y_unit))
    axes.margins(0.12)
    axes.autoscale_view()
    colours.add_bar(axes)
    what = style.heading(f"Path of the coordinates, {style.MODELS[trajectory.model]}", trajectory.record, label)
    return style.top_legend(figure, keys, what, captions.of_runs([trajectory]))


def _draw_ranges(axes: Axes, trajectory: Trajectory) -> list[Line2D]:
    """Draw the ends of the ranges that the scene gives, and return their key; a periodic coordinate has none."""
    coordinates = style.scene_of(trajectory.record).get("coordinates", {})
    dashed, keys = {"color": style.QUIET, "linewidth": 0.9, "linestyle": (0, (4, 3))}, []
    for name, draw in zip(trajectory.coordinate_units, (axes.axvline, axes.axhline)):
        entry = coordinates.get(name, {"periodic": True})
        if not entry.get("periodic", False):
            for end in entry["range"]:
                draw(end, **dashed)
            keys = [Line2D([], [], label="ends of the ranges", **dashed)]
    return keys
