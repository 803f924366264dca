"""Sobol indices of an ensemble's outputs: which parameters their variance comes from."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from pgmp_petsc.figures import cautions
from pgmp_petsc.figures.style import PALETTE, heading, new_figure, styled, top_legend
from pgmp_petsc.results import Ensemble

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
