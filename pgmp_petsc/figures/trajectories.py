"""Outputs over time, full-order and reduced, and the error between them (as Fig. 4 of Naets et al. 2015)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from pgmp_petsc.figures.style import (
    PALETTE,
    QUIET,
    axis_label,
    axis_unit,
    labels_by_parameters,
    new_figure,
    scene_name,
    styled,
    top_legend,
)
from pgmp_petsc.results import Trajectory
from pgmp_petsc.runtime.errors import InputError

N_CROSSES = 36
COLUMNS = 3


@dataclass(frozen=True)
class Comparison:
    """The full-order and the reduced run with the same parameters; one of them may be absent."""

    full: Trajectory | None
    reduced: Trajectory | None

    @property
    def runs(self) -> tuple[Trajectory, ...]:
        """The runs that are there."""
        return tuple(run for run in (self.full, self.reduced) if run is not None)

    def error_percent(self, output: str) -> tuple[np.ndarray, np.ndarray] | None:
        """Return time (s) and error of the reduced output in % of the full-order output's maximum.

        The reduced output is interpolated linearly to the full-order instants that it covers. None where one
        of the runs is absent or the full-order output is zero throughout.
        """
        if self.full is None or self.reduced is None:
            return None
        covered = self.full.time <= self.reduced.time[-1] * (1 + 1e-12)
        time, exact = self.full.time[covered], self.full.outputs[output][covered]
        largest = np.max(np.abs(exact), initial=0.0)
        if largest == 0.0:
            return None
        reduced = np.interp(time, self.reduced.time, self.reduced.outputs[output])
        return time, 100.0 * np.abs(reduced - exact) / largest


def paired(runs: Sequence[Trajectory]) -> list[Comparison]:
    """Pair full-order and reduced runs whose parameters are equal, in the order in which they come."""
    full = [run for run in runs if run.model == "full"]
    comparisons = []
    for run in runs:
        if run.model == "reduced":
            partner = next((other for other in full if _same_parameters(run, other)), None)
            if partner is not None:
                full = [other for other in full if other is not partner]
            comparisons.append(Comparison(partner, run))
    return comparisons + [Comparison(run, None) for run in full]


@styled
def trajectories(
    comparisons: Sequence[Comparison],
    outputs: Sequence[str] | None = None,
    labels: Sequence[str] | None = None,
) -> Figure:
    """Draw outputs over time, one column each: full order as a line, reduced as crosses, errors below.

    A run that stands alone is a line, with a band where its errors were estimated; without any pair there is no panel
    of errors.

    Parameters
    ----------
    comparisons : sequence of Comparison
        One colour each.
    outputs : sequence of str, optional
        By default all that every run has.
    labels : sequence of str, optional
        By default the parameters in which the runs differ.

    Raises
    ------
    InputError
        If the runs have no output in common.
    """
    runs = [run for comparison in comparisons for run in comparison.runs]
    if outputs is None:
        outputs = [name for name in runs[0].outputs if all(name in run.outputs for run in runs)]
    if not outputs:
        raise InputError("the trajectories have no output in common; plot those of one scene together")
    if labels is None:
        labels = labels_by_parameters([comparison.runs[0].record for comparison in comparisons])
    with_errors = any(comparison.error_percent(name) for comparison in comparisons for name in outputs)

    n_columns = min(len(outputs), COLUMNS)
    n_blocks = -(-len(outputs) // n_columns)
    block_height = 4.1 if with_errors else 2.9
    figure = new_figure(max(3.7 * n_columns, 5.0), block_height * n_blocks + 0.65)
    ratios = ([2.1, 1.0] if with_errors else [1.0]) * n_blocks
    panels = figure.subplots(len(ratios), n_columns, squeeze=False, gridspec_kw={"height_ratios": ratios})
    rows_a_block = len(ratios) // n_blocks
    for place in range(n_blocks * n_columns):
        row, column = rows_a_block * (place // n_columns), place % n_columns
        block = panels[row : row + rows_a_block, column]
        if place < len(outputs):
            _draw_output(block, comparisons, outputs[place])
        else:
            for axes in block:
                axes.set_visible(False)

    top_legend(figure, _keys(comparisons, labels), _title(runs))
    return figure


def _draw_output(block: np.ndarray, comparisons: Sequence[Comparison], output: str) -> None:
    """Draw one output, and below it its error where there is one."""
    runs = [run for comparison in comparisons for run in comparison.runs]
    factor, unit = axis_unit(runs[0].units.get(output, "1"), *(run.outputs[output] for run in runs))
    axes = block[0]
    for comparison, colour in zip(comparisons, PALETTE * 10):
        line, crosses = comparison.runs[0], comparison.reduced if comparison.full is not None else None
        axes.plot(line.time, line.outputs[output] * factor, color=colour)
        if line.errors is not None:
            # against a full-order run, the errors have a panel of their own
            error = np.interp(line.time, line.errors.time, np.abs(line.errors.outputs[output]))
            band = ((line.outputs[output] + sign * error) * factor for sign in (-1.0, 1.0))
            axes.fill_between(line.time, *band, color=colour, alpha=0.25, linewidth=0.0)
        if crosses is not None:
            step = max(1, len(crosses.time) // N_CROSSES)
            axes.plot(
                crosses.time[::step],
                crosses.outputs[output][::step] * factor,
                color=colour,
                linestyle="none",
                marker="x",
                markersize=4.5,
                markeredgewidth=1.1,
                clip_on=False,
            )
    axes.set_title(axis_label(output, unit))
    if len(block) > 1:
        axes.tick_params(labelbottom=False)
        block[1].sharex(axes)
        _draw_errors(block[1], comparisons, output)
    axes.set_xlim(min(run.time[0] for run in runs), max(run.time[-1] for run in runs))
    block[-1].set_xlabel("time (s)")


def _draw_errors(axes: Axes, comparisons: Sequence[Comparison], output: str) -> None:
    """Draw the errors of one output and write their largest value above them."""
    largest = []
    for comparison, colour in zip(comparisons, PALETTE * 10):
        error = comparison.error_percent(output)
        if error is not None:
            axes.plot(*error, color=colour, linewidth=1.1)
            largest.append(float(np.max(error[1])))
    axes.set_ylim(bottom=0.0)
    axes.set_ylabel("error (%)")
    if largest:
        axes.set_title(
            f"at most {max(largest):.2g} % of the full-order maximum", fontsize=8.5, color=QUIET, pad=4.0
        )


def _keys(comparisons: Sequence[Comparison], labels: Sequence[str]) -> list[Artist]:
    """Return the keys: a colour for each label, then what lines, crosses and bands are."""
    keys = [Line2D([], [], color=colour, label=label) for label, colour in zip(labels, PALETTE * 10) if label]
    if any(len(comparison.runs) == 2 for comparison in comparisons):
        colour = QUIET if keys else PALETTE[0]
        keys.append(Line2D([], [], color=colour, label="full order"))
        keys.append(Line2D([], [], color=colour, linestyle="none", marker="x", label="reduced"))
    if any(comparison.runs[0].errors is not None for comparison in comparisons):
        keys.append(Patch(color=QUIET if keys else PALETTE[0], alpha=0.25, linewidth=0.0, label="estimated error"))
    return keys


def _title(runs: Sequence[Trajectory]) -> str:
    """Return the scene's name and, where all runs are of one model, which."""
    models = {run.model for run in runs}
    words = {"full": "full-order model", "reduced": "reduced model"}
    model = f", {words[models.pop()]}" if len(models) == 1 else ""
    return f"Motion of the {scene_name(runs[0].record) or 'mechanism'}{model}"


def _same_parameters(one: Trajectory, other: Trajectory) -> bool:
    """Tell whether two runs have the same parameters, but for the last digits."""
    mine, theirs = one.record.parameters, other.record.parameters
    return mine.keys() == theirs.keys() and all(
        np.isclose(mine[name], theirs[name], rtol=1e-9, atol=0.0) for name in mine
    )
