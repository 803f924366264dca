"""How well the figures that an ensemble was to know were known at every look."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from pgmp_petsc.figures import cautions
from pgmp_petsc.figures.style import PALETTE, heading, new_figure, styled, top_legend
from pgmp_petsc.results import Ensemble


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
