"""Eigenfrequencies over the configurations, full-order and reduced (as Fig. 2 of Naets et al. 2015), of two
coordinates as maps over their plane, and the path of a run through it.

Work-precision diagrams of a trade-off study: error against time, of a sample and of many; what meshes cost.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.figures import style
from pgmp_petsc.figures.mechanism import TimeColours
from pgmp_petsc.figures.style import OF_RUNS, WITHOUT_EFFECT, tell_apart
from pgmp_petsc.results import ModesTable, Tradeoff, Trajectory
from pgmp_petsc.results.tradeoff import pareto_front

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
    notes = style.notes_of_records([table.record for table in tables], labels)
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
    return style.headed(figure, [], what, table.record, label)


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
    axes.set(xlabel=style.axis_label(x_name, x_unit), ylabel=style.axis_label(y_name, y_unit))
    axes.margins(0.12)
    axes.autoscale_view()
    colours.add_bar(axes)
    what = style.heading(f"Path of the coordinates, {style.MODELS[trajectory.model]}", trajectory.record, label)
    return style.top_legend(figure, keys, what, style.notes_of_runs([trajectory]))


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


SURFACE_COLOUR = style.PALETTE[3]
SECOND_ORDER_COLOUR = style.PALETTE[2]
FLOOR = 1e-10  # %, shown for errors that are zero
RIGHT = 0.6  # share of an axis beyond which labels are to the left of their points
_HOLLOW = {"markerfacecolor": "white"}
_SMALLER = {"markersize": 5.0}
#: Looks of settings by what keys call them, in the order of the keys.
LOOKS: dict[str, dict[str, Any]] = {
    "reduced": {"marker": "o", "color": style.REDUCED_COLOUR} | _HOLLOW,
    "static modes": {"marker": "o", "color": style.REDUCED_COLOUR},
    "second order": {"marker": "o", "color": SECOND_ORDER_COLOUR} | _HOLLOW,
    "second order, static modes": {"marker": "o", "color": SECOND_ORDER_COLOUR},
    "component modes": {"marker": "D", "color": style.COMPONENT_COLOUR} | _SMALLER,
    "full order": {"marker": "s", "color": style.FULL_COLOUR} | _SMALLER,
    "full order, more cells": {"marker": "s", "color": style.FULL_COLOUR} | _SMALLER | _HOLLOW,
    "response surface (runs)": {"marker": "^", "color": SURFACE_COLOUR},
}
_OWN, _STAR = "the scene as it is", {"marker": "*", "markersize": 11.0, "markeredgecolor": "black", "zorder": 4}
# Lines of those whose points are connected.
CONNECTED = {"full order": "-", "full order, more cells": ":", "response surface (runs)": "-"}
CLOSE = 1.3  # ratio of errors whose points share a label
#: Models that have a front each, by its colour.
FRONTS = {style.REDUCED_COLOUR: "reduced", style.COMPONENT_COLOUR: "components", style.FULL_COLOUR: "full"}
_DASHED = {"linestyle": (0, (4, 2)), "markerfacecolor": "white"}
_MESH = {"color": style.QUIET, "linestyle": (0, (5, 3)), "linewidth": 1.0, "zorder": 1}


@style.styled
def online_costs(study: Tradeoff) -> Figure:
    """Draw the error of every output against the online time of a sample, one panel an output."""
    label = f"{_clock(study)} of a sample, {study.batch} together (ms)"
    return _work_precision(study, 1e3 * study.times.batch, label, "What accuracy costs a sample")


@style.styled
def total_costs(study: Tradeoff) -> Figure:
    """Draw the error of every output against the time of all samples, build included."""
    label = f"{_clock(study)} of {study.samples} samples, build included (s)"
    title = f"What accuracy costs {study.samples} samples"
    return _work_precision(study, study.total_seconds(study.samples), label, title)


@style.styled
def mesh_costs(study: Tradeoff) -> Figure:
    """Draw errors and times over the meshes: of the discretisation, the full order, and one reduced setting on each."""
    figure = style.new_figure(9.4, 4.4)
    errors, costs = figure.subplots(1, 2)
    cells, reduced = study.mesh.cells, _over_meshes(study, "reduced")
    for column, colour in enumerate(style.distinct_colours(len(study.outputs))):
        _draw_known(errors, cells, 100 * study.mesh.errors[:, column], color=colour, marker="o")
        own = cells[:1] * study.columns["refinement"][reduced]
        _draw_known(errors, own, 100 * study.errors[reduced, column], color=colour, marker="o", **_DASHED)
    against = f"; of meshes against {cells[-1]} cells" if cells.size else ""
    errors.set_title(f"largest error (%){against}")
    for family, colour, marker in (("full", style.FULL_COLOUR, "s"), ("reduced", style.REDUCED_COLOUR, "o")):
        rows = _over_meshes(study, family)
        at = cells[:1] * study.columns["refinement"][rows]
        _draw_known(costs, at, 1e3 * study.times.batch[rows], color=colour, marker=marker)
        _draw_known(costs, at, 1e3 * study.times.single[rows], color=colour, marker=marker, linestyle=":")
    costs.set_title(f"{_clock(study)} of a sample (ms)")
    for axes in (errors, costs):
        axes.set_xscale("log", base=2)
        axes.set_xticks(cells, [str(number) for number in cells])
        axes.minorticks_off()
        if cells.size:
            axes.set_xlim(cells[0] / 2**0.25, cells[-1] * 2**0.25)
        axes.yaxis.set_major_formatter(style.PlainNumbers())
        axes.set_xlabel("cells of all bodies")
    for axes, keys in ((errors, _keys_of_errors(study)), (costs, _keys_of_times(study))):
        if keys:
            axes.legend(handles=keys, loc="upper center", bbox_to_anchor=(0.5, -0.16), ncol=3 if len(keys) > 4 else 2)
        else:
            axes.text(0.5, 0.5, "nothing known", transform=axes.transAxes, ha="center", color=style.QUIET)
    what = style.heading("What meshes cost in error and time", study.record)
    return style.top_legend(figure, [], what, _notes(study))


def _keys_of_errors(study: Tradeoff) -> list[Line2D]:
    """Return the keys of errors over meshes, of what is drawn alone."""
    of_meshes, of_reduced = study.mesh.errors > 0.0, study.errors[_over_meshes(study, "reduced")] > 0.0
    seen = of_meshes.any(axis=0) | of_reduced.any(axis=0)
    outputs = zip(study.outputs, style.distinct_colours(len(study.outputs)), seen)
    keys = [Line2D([], [], color=colour, label=name) for name, colour, drawn in outputs if drawn]
    if of_meshes.any():
        keys.append(Line2D([], [], color=style.QUIET, marker="o", label="mesh"))
    if of_reduced.any():
        keys.append(Line2D([], [], color=style.QUIET, marker="o", label="reduction on it", **_DASHED))
    return keys


def _keys_of_times(study: Tradeoff) -> list[Line2D]:
    looks = (("full", style.FULL_COLOUR, "s"), ("reduced", style.REDUCED_COLOUR, "o"))
    run = [look for look in looks if _over_meshes(study, look[0]).size]
    keys = [
        Line2D([], [], color=colour, marker=marker, markersize=5.5, label=_on_meshes(study, family))
        for family, colour, marker in run
    ]
    if keys:
        keys.append(Line2D([], [], color=style.QUIET, label=f"{study.batch} together"))
        keys.append(Line2D([], [], color=style.QUIET, linestyle=":", label="one alone"))
    return keys


def _draw_known(axes: Axes, x: np.ndarray, y: np.ndarray, **look: object) -> None:
    """Draw what a logarithmic axis can show, if there is anything."""
    known = np.isfinite(y) & (y > 0.0)
    if known.any():
        axes.set_yscale("log")
        axes.plot(x[known], y[known], **look)


def _work_precision(study: Tradeoff, cost: np.ndarray, label: str, title: str) -> Figure:
    figure, blocks = style.panel_grid(len(study.outputs), (4.3, 4.2), 0.95, 6.0, sharex=True)
    for column, axes in enumerate(blocks[:, 0]):
        _draw_output(axes, study, cost, column)
        axes.set_xlabel(label)
        axes.tick_params(labelbottom=True)
    blocks[0, 0].annotate(
        "better",
        (0.02, 0.02),
        xytext=(0.09, 0.09),
        xycoords="axes fraction",
        textcoords="axes fraction",
        fontsize=8.5,
        color=style.QUIET,
        arrowprops={"arrowstyle": "->", "color": style.QUIET, "shrinkA": 0.0},
    )
    known = np.array([_known(study, cost, column) for column in range(len(study.outputs))]).any(axis=0)
    return style.top_legend(figure, _keys(study, known, cost), style.heading(title, study.record), _notes(study))


def _draw_output(axes: Axes, study: Tradeoff, cost: np.ndarray, column: int) -> None:
    error = np.maximum(100 * study.errors[:, column], FLOOR)
    known = _known(study, cost, column)
    axes.set(xscale="log", yscale="log")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter(style.PlainNumbers())
    for colour, family in FRONTS.items():
        rows = _front(study, cost, column, family)
        axes.step(cost[rows], error[rows], where="post", color=colour, linewidth=5.0, alpha=0.22, zorder=1.5)
    for rows, colour, order in (
        (_rows(known, study, "full", own_mesh=True), style.FULL_COLOUR, study.columns["step"]),
        (_rows(known, study, "surface", own_mesh=True), SURFACE_COLOUR, study.columns["nodes"]),
    ):
        rows = rows[np.argsort(order[rows])]
        axes.plot(cost[rows], error[rows], color=colour, linewidth=0.9, zorder=2)
    rows = [row for row in _over_meshes(study, "full") if known[row]]
    axes.plot(cost[rows], error[rows], color=style.FULL_COLOUR, linewidth=0.9, linestyle=":", zorder=2)
    for row in np.flatnonzero(known):
        axes.plot(cost[row], error[row], **_marker(study, row))
    _write_labels(axes, study, cost, error, known)
    # draw what the mesh is worth, and below what the reference is not known
    moved = 100 * _unsettled(study, column)
    if _has_mesh_error(study, column):
        axes.axhline(100 * study.mesh.errors[0, column], **_MESH)
    if moved:
        low = axes.get_ylim()[0]
        axes.axhspan(low, moved, color="#EEEEEE", zorder=0.5, linewidth=0)
        axes.set_ylim(bottom=low)
    axes.set_title(f"{study.outputs[column].replace('_', ' ')}: largest error (%)")


def _known(study: Tradeoff, cost: np.ndarray, column: int) -> np.ndarray:
    """Return which settings are drawn in an output's panel, shape (n,)."""
    # what a mesh costs the reduced model has a picture of its own
    shown = study.own_mesh | np.array([family == "full" for family in study.families])
    return np.isfinite(study.errors[:, column]) & np.isfinite(cost) & (cost > 0.0) & shown


def _front(study: Tradeoff, cost: np.ndarray, column: int, family: str) -> np.ndarray:
    """Return the settings on the front of a model, the cheapest first: the least error that a cost buys; none where one
    setting is cheaper and better than all."""
    error = np.maximum(100 * study.errors[:, column], FLOOR)
    rows = _rows(_known(study, cost, column), study, family, own_mesh=True)
    rows = rows[pareto_front(cost[rows], error[rows])]
    return rows[np.argsort(cost[rows])] if rows.size > 1 else rows[:0]


def _has_mesh_error(study: Tradeoff, column: int) -> bool:
    """Tell whether the error of the scene's mesh is known and can be shown on a logarithmic axis."""
    return bool(np.any(study.mesh.errors[:1, column] > 0.0))


def _unsettled(study: Tradeoff, column: int) -> float:
    """Return by how much the reference on the scene's meshes moved last, 0 where it is less than every error."""
    own, errors = study.references.refinement == 1, study.errors[study.own_mesh, column]
    moved = study.references.moved[own, column].max(initial=0.0)
    return float(moved) if np.any(errors < moved) else 0.0


def _write_labels(axes: Axes, study: Tradeoff, cost: np.ndarray, error: np.ndarray, known: np.ndarray) -> None:
    """Write the runs at surfaces, once for those that are as good, and how many times the cells a finer mesh has."""
    surfaces = _rows(known, study, "surface", own_mesh=True)
    surfaces = surfaces[np.argsort(study.columns["nodes"][surfaces])]
    groups: list[list[int]] = []
    for row in surfaces:
        if groups and error[groups[-1][-1]] < CLOSE * error[row]:
            groups[-1].append(row)
        else:
            groups.append([row])
    for group in groups:
        _write(axes, ", ".join(str(study.columns["nodes"][row]) for row in group), cost[group[-1]], error[group[-1]])
    for row in np.flatnonzero(known & (study.columns["refinement"] > 1)):
        _write(axes, f"\N{MULTIPLICATION SIGN}{study.columns['refinement'][row]}", cost[row], error[row])


def _write(axes: Axes, text: str, x: float, y: float) -> None:
    """Write beside a point, on the side where there is room."""
    left = axes.transAxes.inverted().transform(axes.transData.transform((x, y)))[0] > RIGHT
    side = {"xytext": (-7 if left else 7, 4), "ha": "right" if left else "left"}
    look = {"textcoords": "offset points", "fontsize": 8.0, "color": style.QUIET, "zorder": 5}
    axes.annotate(text, (x, y), **side, **look).set_in_layout(False)


def _marker(study: Tradeoff, row: int) -> dict[str, Any]:
    look = {"linestyle": "none", "markersize": 5.5, "markeredgewidth": 1.1, "zorder": 3} | LOOKS[_kind(study, row)]
    return look | _STAR if row == 0 and study.families[row] == "reduced" else look


def _keys(study: Tradeoff, drawn: np.ndarray, cost: np.ndarray) -> list[Line2D | Patch]:
    """Return the keys of what is drawn, shape (n,) of bool: of every mark one, and of nothing else."""
    rows: dict[str, list[int]] = {}
    for row in np.flatnonzero(drawn):
        rows.setdefault(_kind(study, row) if row else _OWN, []).append(row)
    keys: list[Line2D | Patch] = []
    connected = {label: len(each) for label, each in rows.items()}
    # from the scene's own mesh on
    connected["full order, more cells"] = np.count_nonzero(drawn[_over_meshes(study, "full")])
    for label in sorted(rows, key=(_OWN, *LOOKS).index):
        look = {name: value for name, value in _marker(study, rows[label][0]).items() if name != "zorder"}
        if label in CONNECTED and connected[label] > 1:
            look["linestyle"] = CONNECTED[label]
        keys.append(Line2D([], [], label=label, **look))
    columns = range(len(study.outputs))
    for colour, family in FRONTS.items():
        if any(_front(study, cost, column, family).size for column in columns):
            label = f"best for the time, {style.MODELS[family]}"
            keys.append(Line2D([], [], color=colour, linewidth=5.0, alpha=0.22, label=label))
    if any(_has_mesh_error(study, column) for column in columns):
        keys.append(Line2D([], [], label="error of the mesh itself", **_MESH))
    if any(_unsettled(study, column) for column in columns):
        keys.append(Patch(facecolor="#EEEEEE", label="reference not settled"))
    return keys


def _kind(study: Tradeoff, row: int) -> str:
    """Return which of `LOOKS` a setting has."""
    at, family = study.columns, study.families[row]
    if family == "reduced":
        kinds = {"second order": at["second_order"][row], "static modes": at["static_modes"][row]}
        return ", ".join(kind for kind, has in kinds.items() if has) or "reduced"
    more = ", more cells" * bool(family == "full" and at["refinement"][row] > 1)
    return {"surface": "response surface (runs)", "components": "component modes", "full": "full order"}[family] + more


def _on_meshes(study: Tradeoff, family: str) -> str:
    rows = _over_meshes(study, family)
    step = f"{1e3 * study.columns['step'][rows[0]]:.4g} ms"
    return f"full order, {step}" if family == "full" else f"reduced, {study.modes(rows[0])} modes, {step}"


def _clock(study: Tradeoff) -> str:
    return "processor time" if study.busy else "time"


def _rows(known: np.ndarray, study: Tradeoff, family: str, own_mesh: bool) -> np.ndarray:
    chosen = known & np.array([each == family for each in study.families])
    return np.flatnonzero(chosen & study.own_mesh if own_mesh else chosen)


def _over_meshes(study: Tradeoff, family: str) -> np.ndarray:
    """Return the settings of a family that differ in the mesh alone, the coarsest first; none without refined ones."""
    rows = _rows(np.isfinite(study.times.batch), study, family, own_mesh=False)
    refined = rows[study.columns["refinement"][rows] > 1]
    if not refined.size:
        return np.empty(0, dtype=int)
    same = [name for name in study.columns if name not in ("refinement", "coordinates", "cosine")]
    alike = [row for row in rows if all(study.columns[name][row] == study.columns[name][refined[0]] for name in same)]
    return np.array(sorted(alike, key=lambda row: study.columns["refinement"][row]))


def _notes(study: Tradeoff) -> list[str]:
    """Return what has to be known besides: settings that failed and are not drawn, and warnings."""
    unknown, timed = np.isnan(study.errors).all(axis=1), np.isfinite(study.times.batch)
    counts = {"failed": int(np.sum(unknown & ~timed)), "have times alone": int(np.sum(unknown & timed))}
    n = len(study.families)
    failed = [f"{k} of {n} settings {what} and are not drawn: see pgmp info" for what, k in counts.items() if k]
    return [*failed, *style.notes_of_records([study.record])]
