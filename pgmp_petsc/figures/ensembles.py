"""Outputs of an ensemble over time: mean, and bands between quantiles.

Sobol indices of an ensemble's outputs: which parameters their variance comes from.

How well the figures that an ensemble was to know were known at every look.

Figures of a better model beside what its own samples, and the ensemble's, say alone.

A rare event: the probability of beyond every value, level by level, and at the event's level with its interval.
"""

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
    PALETTE,
    QUIET,
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
from pgmp_petsc.results.rare_event import RareEvent

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


COLUMNS = 3
HEIGHT = 0.36  # of a bar, where the distance of parameters is 1
FIRST, TOTAL = PALETTE[0], PALETTE[4]


@styled
def sobol(ensemble: Ensemble, label: str = "") -> Figure:
    """Draw first and, where they are known, total indices of every output with their intervals, one panel each."""
    names = list(ensemble.sobol)
    one = ensemble.sobol[names[0]]
    n_columns = min(len(names), COLUMNS)
    n_rows = -(-len(names) // n_columns)
    height = 0.9 + (0.75 + 0.42 * len(one.parameters)) * n_rows
    figure = new_figure(max(3.4 * n_columns, 6.4), height)
    panels = figure.subplots(n_rows, n_columns, sharex=True, squeeze=False).ravel()
    for axes in panels[len(names) :]:
        axes.set_visible(False)
    for axes, name in zip(panels, names):
        found = ensemble.sobol[name]
        places = np.arange(len(found.parameters))[::-1]
        kinds = [(found.first, found.first_interval, FIRST, 0.0)]
        if found.total is not None:
            kinds = [(found.first, found.first_interval, FIRST, 0.5 * HEIGHT)]
            kinds.append((found.total, found.total_interval, TOTAL, -0.5 * HEIGHT))
        for values, ends, colour, shift in kinds:
            errors = np.abs(ends.T - values)
            axes.barh(places + shift, values, HEIGHT, xerr=errors, color=colour, ecolor="#333333", capsize=2.0)
        axes.set_yticks(places, [parameter.replace("_", " ") for parameter in found.parameters])
        axes.grid(axis="y", visible=False)
        axes.set_title(name.replace("_", " ").replace(".", ", "))
    level = f"{100 * one.confidence:g} % intervals"
    keys = [Patch(facecolor=FIRST, label=f"first index: share of the variance by itself, {level}")]
    if one.total is not None:
        keys.append(Patch(facecolor=TOTAL, label="total index: with all that it acts together with"))
    what = heading("Sobol indices of outputs", ensemble.record, label)
    top_legend(figure, keys, what, cautions.of_records([ensemble.record]))
    return figure


@styled
def stopping(ensemble: Ensemble, label: str = "") -> Figure:
    """Draw half the width of every rule's interval over the number of samples, as a multiple of what was wanted."""
    found = ensemble.stopping
    figure = new_figure(6.4, 3.6)
    axes = figure.subplots()
    keys = []
    for number, (text, wanted, reached) in enumerate(zip(found.rules, found.wanted, found.reached)):
        known = np.isfinite(reached)
        colour = PALETTE[number % len(PALETTE)]
        keys += axes.loglog(found.samples[known], reached[known] / wanted, "o-", color=colour, label=text, markersize=4)
    axes.axhline(1.0, color="#333333", linewidth=1.0)
    axes.set_xlabel("samples")
    axes.set_ylabel("half the interval / what was wanted")
    top_legend(figure, keys, heading("precision at every look", ensemble.record, label), cautions.of_records(
        [ensemble.record]))  # fmt: skip
    return figure


JOINED_COLUMNS = 3
JOINED_COLOURS = (PALETTE[0], PALETTE[4], "#333333")


@styled
def joined(ensemble: Ensemble, label: str = "") -> Figure:
    """Draw the mean of every output with its interval: of the ensemble, of the better model alone, and of all models.

    An interval that knows of sampling alone is drawn thin, one that knows of the model too is drawn thick.
    """
    found = ensemble.joined
    names = [name for name, one in found.corrected.items() if "mean" in one.figures]
    n_columns = min(len(names), JOINED_COLUMNS)
    n_rows = -(-len(names) // n_columns)
    figure = new_figure(max(3.4 * n_columns, 6.4), 0.9 + 1.7 * n_rows)
    panels = figure.subplots(n_rows, n_columns, squeeze=False).ravel()
    for axes in panels[len(names) :]:
        axes.set_visible(False)
    best, own = found.models[0], found.models[-1]
    counts = found.corrected[names[0]].counts
    rows = [f"{own}, {len(ensemble.status)}", f"{best}, {counts[0]}", "joined"]
    for axes, name in zip(panels, names):
        mean, of_own = found.corrected[name].figures["mean"], ensemble.statistics[name]
        ends = np.array([of_own.mean_interval, mean.alone_interval, mean.interval])
        factor, unit = axis_unit(ensemble.units.get(name, "1"), ends[np.isfinite(ends)])
        values = (of_own.mean, mean.alone, mean.estimate)
        for place, (value, (low, high), colour) in enumerate(zip(values, ends, JOINED_COLOURS)):
            width = 3.0 if place == len(values) - 1 else 1.2
            axes.plot([low * factor, high * factor], [-place] * 2, color=colour, linewidth=width)
            axes.plot(value * factor, -place, "o", color=colour, markersize=4.5)
        axes.set_yticks([0, -1, -2], rows)
        axes.set_ylim(-2.6, 0.6)
        axes.grid(axis="y", visible=False)
        long = np.nanmax(ends) - np.nanmin(ends) < 1e-4 * np.nanmax(np.abs(ends))  # labels of many digits
        axes.locator_params(axis="x", nbins=2 if long else 4)
        axes.set_xlabel(axis_label(f"mean {name}".replace(".", ", "), unit))
    what = heading(
        f"{best} model from few samples of it, {100 * found.confidence:g} % intervals", ensemble.record, label
    )
    top_legend(figure, [], what, cautions.of_records([ensemble.record]))
    return figure


@styled
def rare_event(found: RareEvent, label: str = "") -> Figure:
    """Draw the probability over values of the output."""
    figure = new_figure(6.4, 4.2)
    axes = figure.subplots()
    factor, unit = axis_unit(found.unit, found.value[np.isfinite(found.value)])
    values, probabilities = found.curve
    keys = axes.plot(values * factor, probabilities, color=PALETTE[0], label="subset simulation")
    shares = np.cumprod(found.share)
    keys += axes.plot(found.threshold * factor, shares, "o", color=PALETTE[0], label="levels", markersize=4.0)
    if found.reached and np.isfinite(found.interval).all():
        level = found.threshold[-1] * factor
        errors = np.abs(found.interval[:, None] - found.estimate)
        words = f"importance sampling, {100 * found.confidence:g} % interval"
        keys.append(
            axes.errorbar([level], [found.estimate], yerr=errors, fmt="D", color=PALETTE[1], capsize=4.0, label=words)
        )
    if len(found.threshold):
        axes.axvline(found.threshold[-1] * factor, color=QUIET, linewidth=0.8, linestyle=":")
    axes.set_yscale("log")
    axes.set_xlabel(axis_label(found.output, unit))
    axes.set_ylabel("probability of beyond")
    what = heading(found.event.replace("_", " "), found.record, label)
    top_legend(figure, keys, what, cautions.of_records([found.record]))
    return figure
