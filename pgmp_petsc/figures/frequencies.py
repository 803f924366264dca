"""Eigenfrequencies over the configurations, full-order and reduced (as Fig. 2 of Naets et al. 2015)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from pgmp_petsc.figures import cautions
from pgmp_petsc.figures.differences import OF_RUNS, WITHOUT_EFFECT, tell_apart
from pgmp_petsc.figures.style import (
    QUIET,
    angle_ticks,
    axis_label,
    distinct_colours,
    heading,
    new_figure,
    styled,
    top_legend,
)
from pgmp_petsc.results import ModesTable
from pgmp_petsc.runtime.errors import InputError

# About as many crosses as can be told from the line below them.
N_CROSSES = 24


@styled
def frequencies(
    tables: Sequence[ModesTable],
    n_modes: int = 4,
    labels: Sequence[str] | None = None,
    titles: Sequence[str] | None = None,
) -> Figure:
    """Draw the first ``n_modes`` flexible eigenfrequencies, one panel a mode.

    Parameters
    ----------
    tables : sequence of ModesTable
        Drawn over each other, one colour each.
    n_modes : int
        Number of panels; fewer where no table has as many.
    labels : sequence of str, optional
        Names of the tables; by default that in which they differ.
    titles : sequence of str, optional
        Titles of the panels; by default the number of the flexible mode.

    Raises
    ------
    InputError
        If no table has a flexible mode.
    """
    labels = labels_of(tables) if labels is None else labels
    colours = distinct_colours(len(tables))
    n_modes = min(n_modes, max(table.full_hz.shape[1] for table in tables))
    if n_modes == 0:
        raise InputError("the tables have no flexible modes to draw: every body is rigid")
    n_columns = 1 if n_modes == 1 else 2
    n_rows = -(-n_modes // n_columns)
    figure = new_figure(4.2 * n_columns, 2.45 * n_rows + 0.75)
    panels = figure.subplots(n_rows, n_columns, sharex=True, squeeze=False)
    for mode, axes in enumerate(panels.flat):
        if mode >= n_modes:
            axes.set_visible(False)
            continue
        for table, colour in zip(tables, colours):
            _draw_mode(axes, table, mode, colour)
        axes.set_title(titles[mode] if titles else f"flexible mode {mode + 1}: frequency (Hz)")
        axes.margins(y=0.12)
        theta, name, unit = _abscissa(tables[0])
        angle_ticks(axes, theta, unit)
        if mode >= n_modes - n_columns:
            axes.set_xlabel(axis_label(name, unit))
            axes.tick_params(labelbottom=True)

    several, reduced = len(tables) > 1, any(table.reduced_hz is not None for table in tables)
    keys = [Line2D([], [], color=colour, label=label) for label, colour in zip(labels, colours) if label and several]
    line_colour = QUIET if keys else colours[0]
    if reduced:
        keys.append(Line2D([], [], color=line_colour, label="full order"))
        keys.append(Line2D([], [], color=line_colour, linestyle="none", marker="x", label="reduced"))
    what = "Eigenfrequencies, full order" + (" and reduced" if reduced else "")
    notes = cautions.of_records([table.record for table in tables], labels)
    top_legend(figure, keys, heading(what, tables[0].record, "" if several else labels[0]), notes)
    return figure


def labels_of(tables: Sequence[ModesTable], files: Sequence[Path] = ()) -> list[str]:
    """Return what tells tables of modes apart; motion and time make no difference to them."""
    return tell_apart([table.record for table in tables], files=files, ignored=(*WITHOUT_EFFECT, *OF_RUNS))


def _draw_mode(axes, table: ModesTable, mode: int, colour: str) -> None:
    """Draw one mode of one table, the reduced one as sparse crosses."""
    theta = _abscissa(table)[0]
    if mode < table.full_hz.shape[1]:
        axes.plot(theta, table.full_hz[:, mode], color=colour)
    if table.reduced_hz is not None and mode < table.reduced_hz.shape[1]:
        step = max(1, len(theta) // N_CROSSES)
        axes.plot(
            theta[::step],
            table.reduced_hz[::step, mode],
            color=colour,
            linestyle="none",
            marker="x",
            markersize=4.5,
            markeredgewidth=1.1,
            clip_on=False,
        )


def _abscissa(table: ModesTable) -> tuple[np.ndarray, str, str]:
    """Return values, name and unit of the horizontal axis; with several coordinates a running number."""
    if table.theta.ndim == 1:
        (name, unit), *_ = table.coordinate_units.items()
        return table.theta, name, unit
    return np.arange(table.theta.shape[1]), "configuration", "1"
