"""A rare event: the probability of beyond every value, level by level, and at the event's level with its interval."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from pgmp_petsc.figures import cautions
from pgmp_petsc.figures.style import PALETTE, QUIET, axis_label, axis_unit, heading, new_figure, styled, top_legend
from pgmp_petsc.results.rare_event import RareEvent


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
