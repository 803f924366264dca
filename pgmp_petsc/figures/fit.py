"""A fit: what was measured, the run that was begun with, the fitted one, and what is left."""

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
    span,
    styled,
)
from pgmp_petsc.results import Fit
from pgmp_petsc.results.fit import FittedParameter

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
