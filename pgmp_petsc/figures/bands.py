"""Outputs of an ensemble over time: mean, and bands between quantiles."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from pgmp_petsc.figures import cautions
from pgmp_petsc.figures.style import (
    COMPONENT_COLOUR,
    FULL_COLOUR,
    REDUCED_COLOUR,
    axis_label,
    axis_unit,
    heading,
    new_figure,
    span,
    styled,
    top_legend,
)
from pgmp_petsc.results import Band, Ensemble

COLOURS = {"full": FULL_COLOUR, "components": COMPONENT_COLOUR, "reduced": REDUCED_COLOUR}
OPACITY = 0.45  # of all bands over each other, where they are darkest


@styled
def bands(ensemble: Ensemble, label: str = "") -> Figure:
    """Draw the outputs of an ensemble over time, one panel each: mean, median, and areas between pairs of quantiles.

    Pairs are the lowest probability of the scene's ``ensemble.quantiles`` with the highest, and so on inwards.
    """
    shown = {name: band for name, band in ensemble.bands.items() if band.count}
    figure = new_figure(7.2, 0.9 + 2.0 * len(shown))
    panels = figure.subplots(len(shown), 1, sharex=True, squeeze=False)[:, 0]
    colour = COLOURS[ensemble.model]
    for axes, (name, band) in zip(panels, shown.items()):
        factor, unit = axis_unit(ensemble.units.get(name, "1"), band.mean, band.quantiles)
        _draw(axes, band, factor, colour)
        axes.set_ylabel(axis_label(name, unit))
    first = next(iter(shown.values()))
    span(panels[-1], first.time[0], first.time[-1])
    panels[-1].set_xlabel("time (s)")
    pairs, middle = pairs_of(first.probabilities)
    keys = [Line2D([], [], color=colour, label=f"mean of {first.count} samples")]
    if middle is not None:
        text = f"{100 * first.probabilities[middle]:g} % quantile"
        keys.append(Line2D([], [], color=colour, linestyle=":", label=text))
    for number, (low, high) in enumerate(pairs):
        ends = f"{100 * first.probabilities[low]:g} to {100 * first.probabilities[high]:g} %"
        alpha = 1.0 - (1.0 - OPACITY / len(pairs)) ** (number + 1)  # as over each other
        keys.append(Patch(facecolor=colour, alpha=alpha, linewidth=0, label=ends))
    notes = cautions.of_records([ensemble.record])
    top_legend(figure, keys, heading("Outputs over time", ensemble.record, label), notes)
    return figure


def _draw(axes: Axes, band: Band, factor: float, colour: str) -> None:
    """Draw one output."""
    pairs, middle = pairs_of(band.probabilities)
    for low, high in pairs:
        ends = factor * band.quantiles[:, [low, high]]
        axes.fill_between(band.time, *ends.T, color=colour, alpha=OPACITY / len(pairs), linewidth=0)
    if middle is not None:
        axes.plot(band.time, factor * band.quantiles[:, middle], color=colour, linestyle=":", linewidth=1.0)
    axes.plot(band.time, factor * band.mean, color=colour, linewidth=1.2)


def pairs_of(probabilities: np.ndarray) -> tuple[list[tuple[int, int]], int | None]:
    """Return pairs of places from the outermost probabilities inwards, and the place of the one that is left."""
    order = [int(place) for place in np.argsort(probabilities)]
    n = len(order)
    pairs = [(order[k], order[n - 1 - k]) for k in range(n // 2)]
    return pairs, order[n // 2] if n % 2 else None
