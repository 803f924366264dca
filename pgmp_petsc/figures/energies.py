"""The balance of energy of a run: what is stored, what the effects brought, and what is left over."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pgmp_petsc.figures import cautions
from pgmp_petsc.figures.style import MODELS, PALETTE, QUIET, axis_unit, heading, new_figure, span, styled, top_legend
from pgmp_petsc.results import Trajectory
from pgmp_petsc.runtime.errors import InputError

WIDTH = 8.6
# Decades below its largest value that the residual is shown in: where it changes its sign it has no smallest one.
DECADES = 6


@styled
def energies(trajectory: Trajectory, label: str = "") -> Figure:
    """Draw the energies of a run over time, the work of each effect, and the residual of their balance.

    The strain energy has a panel of its own, because it is often far smaller than the others. What is zero
    throughout is left out. The residual is a share of the energy that was exchanged, on a logarithmic axis. The label
    tells the run from others.

    Raises
    ------
    InputError
        If the trajectory holds no energies.
    """
    balance = trajectory.balance
    if balance is None:
        raise InputError("the trajectory holds no energies; simulate it again")
    stored = {"kinetic": balance.kinetic, "potential": balance.potential}
    groups = {"stored energy": stored, "work of the effects": balance.work, "strain energy": {"strain": balance.strain}}
    groups = {title: {name: v for name, v in curves.items() if v.any()} for title, curves in groups.items()}
    groups = {title: curves for title, curves in groups.items() if curves}
    # an inch for a panel, and what its keys need
    heights = [max(1.1, 0.4 + 0.17 * len(curves)) for curves in groups.values()] + [1.1]
    figure = new_figure(WIDTH, sum(heights) + 0.4 * len(heights) + 0.7)
    panels = figure.subplots(len(heights), sharex=True, squeeze=False, gridspec_kw={"height_ratios": heights})[:, 0]
    for axes, (title, curves) in zip(panels, groups.items()):
        _draw_curves(axes, trajectory.time, curves, title)
    _draw_residual(panels[-1], trajectory.time, balance.residual, balance.exchanged)
    span(panels[-1], trajectory.time[0], cautions.planned_end(trajectory))
    panels[-1].set_xlabel("time (s)")
    figure.align_ylabels(panels)
    what = heading(f"Balance of energy, {MODELS[trajectory.model]}", trajectory.record, label)
    top_legend(figure, [], what, cautions.of_runs([trajectory]))
    return figure


def _draw_curves(axes: Axes, time: np.ndarray, curves: Mapping[str, np.ndarray], title: str) -> None:
    """Draw energies in one unit, with their keys on the right where there are several."""
    factor, unit = axis_unit("J", *curves.values())
    for number, (name, values) in enumerate(curves.items()):
        # beyond the palette, its colours come again as dashes
        dashes = "-" if number < len(PALETTE) else (0, (4, 2))
        colour, label = PALETTE[number % len(PALETTE)], name.replace("_", " ")
        axes.plot(time, values * factor, color=colour, linestyle=dashes, label=label)
    axes.set_title(f"{title} ({unit})")
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), labelspacing=0.3)


def _draw_residual(axes: Axes, time: np.ndarray, residual: np.ndarray, exchanged: float) -> None:
    """Draw the residual as a share of the energy exchanged; at the start it is zero."""
    share = np.abs(residual[1:]) / (exchanged or 1.0)
    largest = share.max(initial=0.0)
    axes.plot(time[1:], share, color=QUIET, linewidth=1.0)
    if largest > 0.0:
        axes.set_yscale("log")
        axes.set_ylim(10.0**-DECADES * largest, 3.0 * largest)
    factor, unit = axis_unit("J", np.array([exchanged]))
    axes.set_title(f"residual, as a share of the {exchanged * factor:.3g} {unit} exchanged: at most {largest:.1e}")
