"""What one change of each parameter does to the outputs of a run, over time."""

from __future__ import annotations

from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from pgmp_petsc.figures import cautions
from pgmp_petsc.figures.style import (
    QUIET,
    axis_label,
    axis_unit,
    distinct_colours,
    new_figure,
    quantity,
    span,
    styled,
)
from pgmp_petsc.results import Derivatives


@styled
def sensitivities(found: Derivatives, label: str = "") -> Figure:
    """Draw every output (left) and what a change of each parameter does to it (right), a row each."""
    figure = new_figure(8.6, 0.9 + 1.9 * len(found.outputs))
    panels = figure.subplots(len(found.outputs), 2, sharex=True, squeeze=False)
    colours = distinct_colours(len(found.parameters))
    for (left, right), (output, values) in zip(panels, found.outputs.items()):
        unit = found.units.get(output, "1")
        factor, shown = axis_unit(unit, values)
        left.plot(found.time, factor * values, color=QUIET)
        left.set_ylabel(axis_label(output, shown))
        effects = [found.derivatives[output][name] * change for name, (change, _) in found.changes.items()]
        factor, shown = axis_unit(unit, *effects)
        for effect, colour in zip(effects, colours):
            right.plot(found.time, factor * effect, color=colour)
        right.set_ylabel(axis_label("change", shown))
    for axes in panels[-1]:
        span(axes, found.time[0], found.time[-1])
        axes.set_xlabel("time (s)")
    keys = []
    for (name, (change, what)), colour in zip(found.changes.items(), colours):
        text = quantity(name, change, found.units.get(name, "1")).replace(" = ", " + ")
        keys.append(Line2D([], [], color=colour, label=f"{text}, {what}"))
    cautions.headed(figure, keys, "Sensitivities, to first order", found.record, label)
    return figure
