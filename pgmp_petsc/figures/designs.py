"""A design: how the search went, and outputs at its start and of the design.

A fit: what was measured, the run that was begun with, the fitted one, and what is left.

What one change of each parameter does to the outputs of a run, over time.
"""

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
    distinct_colours,
    new_figure,
    quantity,
    span,
    styled,
)
from pgmp_petsc.results import Derivatives, Design, Fit
from pgmp_petsc.results.fit import FittedParameter


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


MEASURED = PALETTE[0]


@styled
def fit(found: Fit, label: str = "") -> Figure:
    """Draw every output over time (left), and what is left of it (right), a row each."""
    figure = new_figure(8.6, 1.0 + 1.9 * len(found.outputs))
    panels = figure.subplots(len(found.outputs), 2, sharex=True, squeeze=False)
    dots = {"linestyle": "", "marker": ".", "markersize": 3.0, "color": MEASURED}
    for (left, right), (name, output) in zip(panels, found.outputs.items()):
        factor, unit = axis_unit(output.unit, output.measured, output.fitted)
        left.plot(found.time, factor * output.measured, **dots)
        left.plot(found.time, factor * output.begun, color=QUIET, linestyle=":")
        left.plot(found.time, factor * output.fitted, color=REDUCED_COLOUR)
        left.set_ylabel(axis_label(name, unit))
        rest = output.measured - output.fitted
        factor, unit = axis_unit(output.unit, rest)
        right.plot(found.time, factor * rest, **dots)
        for side in (-2.0, 2.0):
            right.axhline(factor * side * output.noise, color=QUIET, linewidth=0.8, linestyle="--")
        right.set_ylabel(axis_label("left", unit))
    for axes in panels[-1]:
        span(axes, found.time[0], found.time[-1])
        axes.set_xlabel("time (s)")
    values = ", ".join(_with_error(p) for p in found.parameters)
    keys = [
        Line2D([], [], label="measured", **dots),
        Line2D([], [], color=QUIET, linestyle=":", label="begun with"),
        Line2D([], [], color=REDUCED_COLOUR, label=f"fitted, {values}"),
        Line2D([], [], color=QUIET, linewidth=0.8, linestyle="--", label="two deviations of the noise"),
    ]
    cautions.headed(figure, keys, "Fit", found.record, label)
    return figure


def _with_error(parameter: FittedParameter) -> str:
    """Return ``r1 = 6.001 ± 0.005 mm``."""
    factor, unit = axis_unit(parameter.unit, np.array([parameter.estimate]))
    shown = f"{parameter.name} = {factor * parameter.estimate:.4g}"
    if not np.isfinite(parameter.error):
        return f"{shown}, not identifiable"
    shown = f"{shown} ± {factor * parameter.error:.1g}"
    return shown if unit in ("", "1") else f"{shown} {unit}"


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
