"""A design: how the search went, and outputs at its start and of the design."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from pgmp_petsc.figures import cautions
from pgmp_petsc.figures.style import (
    PALETTE,
    QUIET,
    REDUCED_COLOUR,
    axis_label,
    axis_unit,
    new_figure,
    quantity,
    span,
    styled,
)
from pgmp_petsc.results import Design


@styled
def design(found: Design, label: str = "") -> Figure:
    """Draw the goal of the designs that were tried, and below it every output at the start and of the design."""
    n = len(found.designed)
    figure = new_figure(7.2, 1.0 + 1.8 * (1 + n))
    panels = figure.subplots(1 + n, 1, squeeze=False)[:, 0]
    panels[0].plot(np.arange(1, 1 + len(found.goals)), found.goals, color=PALETTE[0], marker=".")
    panels[0].set_xlabel("design that was tried")
    panels[0].set_ylabel("goal")
    for axes, (name, values) in zip(panels[1:], found.designed.items()):
        factor, unit = axis_unit(found.units.get(name, "1"), values, found.begun[name])
        axes.plot(found.time, factor * found.begun[name], color=QUIET, linestyle=":")
        axes.plot(found.time, factor * values, color=REDUCED_COLOUR)
        axes.set_ylabel(axis_label(name, unit))
        span(axes, found.time[0], found.time[-1])
    panels[-1].set_xlabel("time (s)")
    begun, ended = (
        ", ".join(quantity(p.name, value, p.unit) for p, value in zip(found.parameters, row))
        for row in zip(*((p.start, p.value) for p in found.parameters))
    )
    keys = [
        Line2D([], [], color=QUIET, linestyle=":", label=f"at the start, {begun}"),
        Line2D([], [], color=REDUCED_COLOUR, label=f"design, {ended}"),
    ]
    cautions.headed(figure, keys, f"Design, {found.goal}", found.record, label)
    return figure
