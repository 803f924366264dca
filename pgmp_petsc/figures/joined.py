"""Figures of a better model beside what its own samples, and the ensemble's, say alone."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from pgmp_petsc.figures import cautions
from pgmp_petsc.figures.style import PALETTE, axis_label, axis_unit, heading, new_figure, styled, top_legend
from pgmp_petsc.results import Ensemble

COLUMNS = 3
COLOURS = (PALETTE[0], PALETTE[4], "#333333")


@styled
def joined(ensemble: Ensemble, label: str = "") -> Figure:
    """Draw the mean of every output with its interval: of the ensemble, of the better model alone, and of all models.

    An interval that knows of sampling alone is drawn thin, one that knows of the model too is drawn thick.
    """
    found = ensemble.joined
    names = [name for name, one in found.corrected.items() if "mean" in one.figures]
    n_columns = min(len(names), COLUMNS)
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
        for place, (value, (low, high), colour) in enumerate(zip(values, ends, COLOURS)):
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
