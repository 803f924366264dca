"""Pictures over time: outputs, full-order and reduced, and the error between them (as Fig. 4 of Naets et al. 2015); the
balance of energy of a run, what is stored, what the effects brought and what is left over; how the search for a design
went, and outputs at its start and of the design; a fit, what was measured, the run that was begun with, the fitted one
and what is left; and what one change of each parameter does to outputs.

What parts are sized by: forces in joints as polar diagrams, torques of drives over speed, rainflow matrices.

Each is drawn into axes by one function, for pictures and for the page of a run alike.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.base.units import behind
from pgmp_petsc.figures import style
from pgmp_petsc.figures.mechanism import paths_of
from pgmp_petsc.figures.style import same_case, tell_apart
from pgmp_petsc.lanes.rainflow import cycles
from pgmp_petsc.results import Derivatives, Design, Fit, Trajectory
from pgmp_petsc.results.gradients import FittedParameter
from pgmp_petsc.results.numbers import ROUND_OFF, plain, sizes_of

N_CROSSES = 36


@dataclass(frozen=True)
class Comparison:
    """The full-order and the reduced run of the same case; one of them may be absent."""

    full: Trajectory | None
    reduced: Trajectory | None

    @property
    def runs(self) -> tuple[Trajectory, ...]:
        return tuple(run for run in (self.full, self.reduced) if run is not None)

    @property
    def kind(self) -> str:
        """The models that are there, in words."""
        return _models(self.runs)

    @property
    def same_steps(self) -> bool:
        """Whether both runs have the same instants, as far as both go, so that what the time step does wrong in both
        does not show."""
        n = min(len(run.time) for run in self.runs)
        return len({(run.time[:n].tobytes(), run.steps_divided) for run in self.runs}) == 1

    @property
    def covered(self) -> float:
        """Instant up to which the runs are compared, s: one of them may have stopped."""
        return min(float(run.time[-1]) for run in self.runs)

    @property
    def planned(self) -> float:
        """Instant at which the run was to end, s."""
        return max(map(style.planned_end, self.runs))

    @property
    def is_whole(self) -> bool:
        """Whether all of the run is compared."""
        return self.covered >= self.planned * (1.0 - 1e-9)

    @property
    def part(self) -> str:
        """The part of the run that is compared, in words."""
        if self.is_whole:
            return "over the run"
        stopped = [style.MODELS[run.model] for run in self.runs if run.time[-1] <= self.covered * (1.0 + 1e-9)]
        runs = f"{' and '.join(stopped)} run{'s' if len(stopped) > 1 else ''}"
        return f"over the first {self.covered:.4g} s of {self.planned:.4g} s, where the {runs} stopped"

    def error_percent(self, output: str) -> tuple[np.ndarray, np.ndarray] | None:
        """Return time (s) and error of the reduced output in % of the full-order output's maximum.

        The reduced output is interpolated linearly to the full-order instants that it covers, but for the start of
        forces in joints: what a joint carries there of undeformed bodies hangs on the mesh alone. None where one
        of the runs is absent, one of them did no step, or the full-order output is zero throughout but for round-off of
        the largest output of its unit, of an angle of 1 rad, or of the mechanism's lengths where frames tell them.
        """
        if self.full is None or self.reduced is None:
            return None
        covered = self.full.time <= self.reduced.time[-1] * (1 + 1e-12)
        covered[:1] = output not in late_outputs(self.full.record.scene_toml)
        time, exact = self.full.time[covered], self.full.outputs[output][covered]
        largest = np.max(np.abs(exact), initial=0.0)
        of_part = {name: values[covered] for name, values in self.full.outputs.items()}
        length = max((run.frames.extent for run in self.runs if run.frames is not None), default=0.0)
        if not largest > ROUND_OFF * sizes_of(of_part, self.full.units, length)[output] or len(time) < 2:
            return None
        reduced = np.interp(time, self.reduced.time, self.reduced.outputs[output])
        return time, 100.0 * np.abs(reduced - exact) / largest


def paired(runs: Sequence[Trajectory]) -> list[Comparison]:
    """Pair runs with those of the best model at hand of the same case, in the order in which they come.

    That is the full-order model, and the component model where no run is full-order. Several runs share one of it where
    there are not as many.
    """
    best = min((run.model for run in runs), key=tuple(style.MODELS).index, default="full")
    best = "components" if best == "reduced" else best
    full = [run for run in runs if run.model == best]
    left, comparisons = list(full), []
    for run in runs:
        if run.model != best:
            free, taken = (
                (other for other in others if same_case(run.record, other.record)) for others in (left, full)
            )
            partner = next(free, None) or next(taken, None)
            left = [other for other in left if other is not partner]
            comparisons.append(Comparison(partner, run))
    return comparisons + [Comparison(run, None) for run in left]


@style.styled
def trajectories(
    comparisons: Sequence[Comparison], outputs: Sequence[str] | None = None, labels: Sequence[str] | None = None
) -> Figure:
    """Draw outputs over time, one column each: full order as a line, reduced as crosses, errors below; a colour each
    comparison.

    A single run is a line, with a band where its errors were estimated; without any pair there is no panel of errors. A
    full-order run that several reduced ones share is grey. A square ends a run that ended before its scene. Outputs are
    by default all that every run has, and labels that in which the runs differ. Raises `InputError` if the runs have no
    output in common.
    """
    runs = [run for comparison in comparisons for run in comparison.runs]
    if outputs is None:
        outputs = [name for name in runs[0].outputs if all(name in run.outputs for run in runs)]
    if not outputs:
        raise InputError("the trajectories have no output in common; plot those of one scene together")
    if labels is None:
        labels = labels_of(comparisons)
    with_errors = any(comparison.error_percent(name) for comparison in comparisons for name in outputs)

    height, ratios = (4.1, (2.1, 1.0)) if with_errors else (2.9, (1.0,))
    figure, blocks = style.panel_grid(len(outputs), (3.7, height), 0.65, 5.0, ratios)
    for block, output in zip(blocks, outputs):
        _draw_output(block, comparisons, output)
    notes = style.notes_of_runs(*_labelled_runs(comparisons, labels))
    what = f"Outputs over time, {_models(runs)}"
    alone = labels[0] if len(comparisons) == 1 else ""
    return style.top_legend(figure, _keys(comparisons, labels), style.heading(what, runs[0].record, alone), notes)


def _models(runs: Sequence[Trajectory | None]) -> str:
    """Return the models of runs in words."""
    there = {run.model for run in runs if run is not None}
    return " and ".join(words for model, words in style.MODELS.items() if model in there)


def _labelled_runs(comparisons: Sequence[Comparison], labels: Sequence[str]) -> tuple[list[Trajectory], list[str]]:
    """Return every run once, and what it is called in notes: with its model where another one is beside it."""
    shared, names = _shared(comparisons), {}
    for comparison, label in zip(comparisons, labels):
        for run in comparison.runs:
            model = style.MODELS[run.model] if len(comparison.runs) == 2 else ""
            names[id(run)] = run, ", ".join(filter(None, (model, "" if id(run) in shared else label)))
    return [run for run, _ in names.values()], [name for _, name in names.values()]


def labels_of(comparisons: Sequence[Comparison], files: Mapping[int, Path] | None = None) -> list[str]:
    """Return what tells comparisons apart; the files of runs are given by their `id`."""
    last = [comparison.runs[-1] for comparison in comparisons]
    kinds = [comparison.kind if len(comparison.runs) == 1 else "" for comparison in comparisons]
    nodes = [None if run.frames is None else sum(map(len, run.frames.nodes.values())) for run in last]
    if len({*nodes} - {None}) > 1:  # pgmp run cuts lines, which scenes do not say
        kinds = [", ".join(filter(None, (kind, f"{n} nodes" if n else ""))) for kind, n in zip(kinds, nodes)]
    return tell_apart([run.record for run in last], kinds, [(files or {}).get(id(run)) for run in last])


def _draw_output(block: np.ndarray, comparisons: Sequence[Comparison], output: str) -> None:
    runs = [run for comparison in comparisons for run in comparison.runs]
    factor, unit = style.axis_unit(runs[0].units.get(output, "1"), *(run.outputs[output] for run in runs))
    axes, drawn = block[0], set()
    shared = _shared(comparisons)
    for comparison, colour in zip(comparisons, style.distinct_colours(len(comparisons))):
        line, crosses = comparison.runs[0], comparison.reduced if comparison.full is not None else None
        if id(line) not in drawn:
            look = {"color": style.FULL_COLOUR if id(line) in shared else colour}
            axes.plot(line.time, line.outputs[output] * factor, **look)
            drawn.add(id(line))
        for run in filter(style.ended_early, comparison.runs):
            axes.plot(run.time[-1], run.outputs[output][-1] * factor, "s", color=colour, markersize=6.0, clip_on=False)
        if line.errors is not None:
            # against a full-order run, the errors have a panel of their own
            known = line.time <= line.errors.time[-1] * (1.0 + 1e-9)
            error = np.interp(line.time, line.errors.time, np.abs(line.errors.outputs[output]))
            error[~known] = np.nan
            band = ((line.outputs[output] + sign * error) * factor for sign in (-1.0, 1.0))
            axes.fill_between(line.time, *band, color=colour, alpha=0.25, linewidth=0.0)
        if crosses is not None:
            step = max(1, len(crosses.time) // N_CROSSES)
            axes.plot(crosses.time[::step], crosses.outputs[output][::step] * factor, color=colour, **style.CROSSES)
    axes.set_title(style.axis_label(output, unit))
    if len(block) > 1:
        axes.tick_params(labelbottom=False)
        block[1].sharex(axes)
        _draw_errors(block[1], comparisons, output)
    style.span(axes, min(run.time[0] for run in runs), max(style.planned_end(run) for run in runs))
    block[-1].set_xlabel("time (s)")


def _draw_errors(axes: Axes, comparisons: Sequence[Comparison], output: str) -> None:
    largest = []
    for comparison, colour in zip(comparisons, style.distinct_colours(len(comparisons))):
        error = comparison.error_percent(output)
        if error is not None:
            axes.plot(*error, color=colour, linewidth=1.1)
            largest.append(float(np.max(error[1])))
    axes.set_ylim(bottom=0.0)
    axes.yaxis.set_major_formatter(style.PlainNumbers())
    axes.set_ylabel("error (%)")
    said = "not known: zero, or nothing to compare with"
    if largest:
        said = f"at most {plain(max(largest))} % of the maximum ({_models([one.full for one in comparisons])})"
    axes.set_title(said, fontsize=8.5, color=style.QUIET, pad=4.0)


def _keys(comparisons: Sequence[Comparison], labels: Sequence[str]) -> list[Artist]:
    """Return the keys: a colour for each label, then what lines, crosses and bands are."""
    colours = style.distinct_colours(len(comparisons))
    keys: list[Artist] = []
    if len(comparisons) > 1:
        keys = [Line2D([], [], color=colour, label=label) for label, colour in zip(labels, colours) if label]
    plain = style.QUIET if keys else colours[0]
    pairs = [comparison for comparison in comparisons if len(comparison.runs) == 2]
    if pairs:
        better, other = (_models(runs) for runs in zip(*(pair.runs for pair in pairs)))
        keys.append(Line2D([], [], color=style.FULL_COLOUR if _shared(comparisons) else plain, label=better))
        keys.append(Line2D([], [], color=plain, linestyle="none", marker="x", label=other))
    if any(comparison.runs[0].errors is not None for comparison in comparisons):
        keys.append(Patch(color=plain, alpha=0.25, linewidth=0.0, label="estimated error"))
    if any(style.ended_early(run) for comparison in comparisons for run in comparison.runs):
        keys.append(Line2D([], [], color=plain, linestyle="none", marker="s", markersize=6.0, label="ended early"))
    return keys


def _shared(comparisons: Sequence[Comparison]) -> set[int]:
    """Return the full-order runs, by `id`, that belong to several comparisons."""
    counts = Counter(id(comparison.full) for comparison in comparisons if comparison.full is not None)
    return {run for run, count in counts.items() if count > 1}


WIDTH = 8.6
# Decades below its largest value that the residual is shown in: where it changes its sign it has no smallest one.
DECADES = 6


@style.styled
def energies(trajectory: Trajectory, label: str = "") -> Figure:
    """Draw the energies of a run over time, the work of each effect, and the residual of their balance.

    The strain energy has a panel of its own, because it is often far smaller than the others. What is zero throughout
    is left out. The residual is a share of the energy that was exchanged, on a logarithmic axis. The label tells the
    run from others. Raises `InputError` if the trajectory holds no energies.
    """
    balance, joule = trajectory.balance, trajectory.record.system.unit("J")
    if balance is None:
        raise InputError("the trajectory holds no energies; simulate it again")
    stored = {"kinetic": balance.kinetic, "potential": balance.potential}
    groups = {"stored energy": stored, "work of the effects": balance.work, "strain energy": {"strain": balance.strain}}
    groups = {title: {name: v for name, v in curves.items() if v.any()} for title, curves in groups.items()}
    groups = {title: curves for title, curves in groups.items() if curves}
    # an inch for a panel, and what its keys need
    heights = [max(1.1, 0.4 + 0.17 * len(curves)) for curves in groups.values()] + [1.1]
    figure = style.new_figure(WIDTH, sum(heights) + 0.4 * len(heights) + 0.7)
    panels = figure.subplots(len(heights), sharex=True, squeeze=False, gridspec_kw={"height_ratios": heights})[:, 0]
    for axes, (title, curves) in zip(panels, groups.items()):
        _draw_curves(axes, trajectory.time, curves, title, joule)
    _draw_residual(panels[-1], trajectory.time, balance.residual, balance.exchanged, joule)
    style.span(panels[-1], trajectory.time[0], style.planned_end(trajectory))
    panels[-1].set_xlabel("time (s)")
    figure.align_ylabels(panels)
    what = style.heading(f"Balance of energy, {style.MODELS[trajectory.model]}", trajectory.record, label)
    return style.top_legend(figure, [], what, style.notes_of_runs([trajectory]))


def _draw_curves(axes: Axes, time: np.ndarray, curves: Mapping[str, np.ndarray], title: str, joule: str) -> None:
    """Draw energies in one unit, with their keys on the right where there are several."""
    factor, unit = style.axis_unit(joule, *curves.values())
    for number, (name, values) in enumerate(curves.items()):
        # beyond the palette, its colours come again as dashes
        dashes = "-" if number < len(style.PALETTE) else (0, (4, 2))
        colour, label = style.PALETTE[number % len(style.PALETTE)], name
        axes.plot(time, values * factor, color=colour, linestyle=dashes, label=label)
    axes.set_title(f"{title} ({unit})")
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), labelspacing=0.3)


def _draw_residual(axes: Axes, time: np.ndarray, residual: np.ndarray, exchanged: float, joule: str) -> None:
    """Draw the residual as a share of the energy exchanged; at the start it is zero."""
    share = np.abs(residual[1:]) / (exchanged or 1.0)
    largest = share.max(initial=0.0)
    axes.plot(time[1:], share, color=style.QUIET, linewidth=1.0)
    if largest > 0.0:
        axes.set(yscale="log", ylim=(10.0**-DECADES * largest, 3.0 * largest))
    factor, unit = style.axis_unit(joule, np.array([exchanged]))
    axes.set_title(f"residual, as a share of the {exchanged * factor:.3g} {unit} exchanged: at most {largest:.1e}")


@style.styled
def design(found: Design, label: str = "") -> Figure:
    """Draw the goal of the designs that were tried, and below it every output at the start and of the design."""
    n = len(found.designed)
    figure = style.new_figure(7.2, 1.0 + 1.8 * (1 + n))
    panels = figure.subplots(1 + n, 1, squeeze=False)[:, 0]
    panels[0].plot(np.arange(1, 1 + len(found.goals)), found.goals, color=style.PALETTE[0], marker=".")
    panels[0].set(xlabel="design that was tried", ylabel=style.axis_label("goal", found.goal_unit))
    for axes, (name, values) in zip(panels[1:], found.designed.items()):
        factor, unit = style.axis_unit(found.units.get(name, "1"), values, found.begun[name])
        axes.plot(found.time, factor * found.begun[name], color=style.QUIET, linestyle=":")
        axes.plot(found.time, factor * values, color=style.REDUCED_COLOUR)
        axes.set_ylabel(style.axis_label(name, unit))
        style.span(axes, found.time[0], found.time[-1])
    panels[-1].set_xlabel("time (s)")
    begun, ended = (
        ", ".join(style.quantity(p.name, value, p.unit) for p, value in zip(found.parameters, row))
        for row in zip(*((p.start, p.value) for p in found.parameters))
    )
    keys = [
        Line2D([], [], color=style.QUIET, linestyle=":", label=f"at the start, {begun}"),
        Line2D([], [], color=style.REDUCED_COLOUR, label=f"design, {ended}"),
    ]
    return style.headed(figure, keys, f"Design, {found.goal}", found.record, label)


DOTS = {"linestyle": "", "marker": ".", "markersize": 3.0, "color": style.PALETTE[0]}


@style.styled
def fit(found: Fit, label: str = "") -> Figure:
    """Draw every output over time (left), and what is left of it (right), a row each."""
    figure = style.new_figure(8.6, 1.0 + 1.9 * len(found.outputs))
    panels = figure.subplots(len(found.outputs), 2, sharex=True, squeeze=False)
    for (left, right), name in zip(panels, found.outputs):
        fitted(left, found, name)
        residuals(right, found, name)
    for axes in panels[-1]:
        axes.set_xlabel("time (s)")
    values = ", ".join(with_error(p) for p in found.parameters)
    keys = [*panels[0, 0].get_legend_handles_labels()[0], *panels[0, 1].get_legend_handles_labels()[0][1:]]
    keys[2].set_label(f"fitted, {values}")
    return style.headed(figure, keys, "Fit", found.record, label)


def fitted(axes: Axes, found: Fit, name: str) -> None:
    """Draw an output as it was measured, with the values at the start, and fitted."""
    output = found.outputs[name]
    factor, unit = style.axis_unit(output.unit, output.measured, output.fitted)
    axes.plot(found.time, factor * output.measured, label="measured", **DOTS)
    axes.plot(found.time, factor * output.begun, color=style.QUIET, linestyle=":", label="begun with")
    axes.plot(found.time, factor * output.fitted, color=style.REDUCED_COLOUR, label="fitted")
    axes.set_ylabel(style.axis_label(name, unit))
    style.span(axes, found.time[0], found.time[-1])


def residuals(axes: Axes, found: Fit, name: str) -> None:
    """Draw what is left of an output, and two deviations of its noise to both sides."""
    output = found.outputs[name]
    rest = output.measured - output.fitted
    factor, unit = style.axis_unit(output.unit, rest)
    axes.plot(found.time, factor * rest, label="left", **DOTS)
    look = {"color": style.QUIET, "linewidth": 0.8, "linestyle": "--"}
    axes.axhline(2.0 * factor * output.noise, label="two deviations of the noise", **look)
    axes.axhline(-2.0 * factor * output.noise, **look)
    axes.set_ylabel(style.axis_label("left", unit))
    style.span(axes, found.time[0], found.time[-1])


def with_error(parameter: FittedParameter) -> str:
    """Return ``r1 = 6.001 ± 0.005 mm``."""
    factor, unit = style.axis_unit(parameter.unit, np.array([parameter.estimate]))
    error = f" ± {factor * parameter.error:.1g}{behind(unit)}"
    error = error if np.isfinite(parameter.error) else ", not identifiable"
    return f"{parameter.name} = {factor * parameter.estimate:.4g}{error}"


@style.styled
def sensitivities(found: Derivatives, label: str = "") -> Figure:
    """Draw every output (left) and what a change of each parameter does to it (right), a row each."""
    figure = style.new_figure(8.6, 0.9 + 1.9 * len(found.outputs))
    panels = figure.subplots(len(found.outputs), 2, sharex=True, squeeze=False)
    colours = style.distinct_colours(len(found.parameters))
    for (left, right), (output, values) in zip(panels, found.outputs.items()):
        unit = found.units.get(output, "1")
        factor, shown = style.axis_unit(unit, values)
        left.plot(found.time, factor * values, color=style.QUIET)
        left.set_ylabel(style.axis_label(output, shown))
        effects = [found.derivatives[output][name] * change for name, (change, _) in found.changes.items()]
        factor, shown = style.axis_unit(unit, *effects)
        for effect, colour in zip(effects, colours):
            right.plot(found.time, factor * effect, color=colour)
        right.set_ylabel(style.axis_label("change", shown))
    for axes in panels[-1]:
        style.span(axes, found.time[0], found.time[-1])
        axes.set_xlabel("time (s)")
    keys = []
    for (name, (change, what)), colour in zip(found.changes.items(), colours):
        text = style.quantity(name, change, found.units.get(name, "1")).replace(" = ", " + ")
        keys.append(Line2D([], [], color=colour, label=f"{text}, {what}"))
    return style.headed(figure, keys, "Sensitivities, to first order", found.record, label)


N_BINS = 24  # of ranges and of means
OF_FORMULAS = 64.0 * np.finfo(float).eps  # of a coordinate: that of a formula, through the weights of differences
TOGETHER = 1e-3  # of a body's motion: nodes nearer than that are one joint
POLAR = {"projection": "polar"}


@lru_cache(maxsize=8)
def late_outputs(scene_toml: str) -> tuple[str, ...]:
    """Return the outputs of a scene that are compared from the first step on; none where the text is no scene."""
    from pgmp_petsc.scene import scene_from_toml  # takes a noticeable time, and few pictures need it
    from pgmp_petsc.scene.outputs import after_start

    try:
        return after_start(scene_from_toml(scene_toml, Path()))
    except InputError:
        return ()


def outputs_of(run: Trajectory, kinds: tuple[str, ...]) -> dict[str, Mapping[str, Any]]:
    """Return the entries of the outputs of some types that a run has, by name."""
    entries = style.scene_of(run.record).get("outputs", {})
    return {name: entry for name, entry in entries.items() if entry["type"] in kinds and name in run.outputs}


@dataclass(frozen=True)
class Load:
    """What one diagram shows."""

    title: str  # joint, or outputs where a joint has several diagrams
    names: tuple[str, ...]  # of the outputs


def _components(run: Trajectory) -> dict[tuple[str, str, str], dict[str, str]]:
    """Return the outputs of forces in joints by their components, by joint, which body they act on, and frame."""
    found: dict[tuple[str, str, str], dict[str, str]] = {}
    for name, entry in outputs_of(run, ("joint_force",)).items():
        of, frame = entry.get("of", "second"), entry.get("frame", "ground")
        found.setdefault((entry["joint"], of, frame), {})[entry.get("component", "magnitude")] = name
    return found


def joint_forces(run: Trajectory) -> list[Load]:
    """Return the outputs of the forces in joints along x and y, on one body in one frame."""
    found = _components(run).items()
    pairs = [(joint, (own["x"], own["y"])) for (joint, *_), own in found if {"x", "y"} <= own.keys()]
    joints = [joint for joint, _ in pairs]
    return [Load(joint if joints.count(joint) == 1 else ", ".join(names), names) for joint, names in pairs]


@dataclass(frozen=True, eq=False)
class Arrow:
    """The force in a joint at the frames of a run."""

    joint: str
    body: str  # on which it acts
    place: np.ndarray  # of the joint, shape (n_f, 3), m
    force: np.ndarray  # shape (n_f, 3), N


def arrows_of(run: Trajectory) -> tuple[list[Arrow], list[str]]:
    """Return the forces in joints whose components are all outputs, in the ground's axes, and why others have no
    arrow."""
    scene, frames = style.scene_of(run.record), run.frames
    found: list[Arrow] = []
    without: list[str] = []
    axes = "xy" if next(iter(frames.nodes.values())).shape[1] == 2 else "xyz"
    for (joint, of, frame), own in _components(run).items():
        if frame != "ground":
            words = 'no arrow of it, as it is along axes of a body; take frame = "ground"'
            without += [f"{name}: {words}" for name in own.values()]
            continue
        if not set(axes) <= own.keys():
            without.append(f"{joint}: no arrow of its force, which takes outputs {', '.join(axes)} of joint_force")
            continue
        connect = scene["joints"][joint].get("connect")
        place = None if connect is None else _place(run, connect)
        if place is None:
            without.append(f"{joint}: no arrow of its force, as the run does not say where it is")
            continue
        force = np.zeros((len(frames.time), 3))
        for k, axis in enumerate(axes):
            force[:, k] = np.interp(frames.time, run.time, run.outputs[own[axis]])
        found.append(Arrow(joint, connect[0 if of == "first" else 1].partition(":")[0], place, force))
    return found, without


def _place(run: Trajectory, connect: Sequence[str]) -> np.ndarray | None:
    paths = [paths_of(run.frames, run.record, name, run.frames.positions) for name in connect]
    first, second = (np.pad(path, ((0, 0), (0, 0), (0, 3 - path.shape[2]))) for path in paths)
    if second.shape[1] == 1:
        return second[:, 0]
    # a point of a mesh has a number that the run does not keep: where both bodies always are is the joint
    apart = np.linalg.norm(first[:, :, None] - second[:, None], axis=3).max(axis=0)
    k = np.unravel_index(np.argmin(apart), apart.shape)[1]
    return second[:, k] if apart.min() < TOGETHER * np.ptp(second, axis=(0, 1)).max() else None


def draw_force(axes: Axes, run: Trajectory, load: Load) -> str:
    """Draw the force in a joint over the run on polar axes: how large, and where it points; a dot at the largest.
    Return the title."""
    x, y = (run.outputs[name] for name in load.names)
    factor, unit = style.axis_unit(run.units.get(load.names[0], "N"), x, y)
    angle, size = np.arctan2(y, x), factor * np.hypot(x, y)
    axes.plot(angle, size, linewidth=1.2)
    most = int(np.argmax(size))
    axes.plot(angle[most], size[most], "o", color=style.QUIET, markersize=4.0)
    tried = np.arange(22.5, 360.0, 45.0)  # numbers go where there is most room for them
    apart = np.abs(np.angle(np.exp(1j * (angle[:, None] - np.radians(tried)))))
    emptiest = np.argmin(np.where(apart < np.pi / 8.0, size[:, None], 0.0).max(axis=0))
    axes.set_rlabel_position(float(tried[emptiest]))
    axes.yaxis.set_major_locator(MaxNLocator(4))
    return style.axis_label(load.title, unit)


def driven(run: Trajectory) -> list[Load]:
    """Return the outputs of what prescribed motions take."""
    return [Load(name, (name,)) for name in outputs_of(run, ("drive_torque",)) if len(run.time) > 2]


def _size(run: Trajectory, unit: str) -> float:
    """Return what a coordinate's round-off is measured by where it stays near zero: a radian, or the mechanism."""
    if unit == "rad" or run.frames is None:
        return float(unit == "rad")
    return max(float(np.ptp(places, axis=(0, 1)).max()) for places in run.frames.positions.values())


def _rate(values: np.ndarray, time: np.ndarray, size: float) -> np.ndarray:
    """Return the rate of values; one that is constant but for their round-off is drawn as one number."""
    rate = np.gradient(values, time, edge_order=2)
    round_off = OF_FORMULAS * max(np.abs(values).max(), size) / np.diff(time).min()
    if np.ptp(rate) > round_off:
        return rate
    mean = float(rate.mean())
    return np.full_like(rate, 0.0 if abs(mean) <= round_off else mean)


def draw_torque(axes: Axes, run: Trajectory, load: Load) -> str:
    """Draw what a drive takes over its speed, which is the rate of the coordinates that the run keeps."""
    scene, (name,) = style.scene_of(run.record), load.names
    entry, moved = scene["outputs"][name], scene["coordinates"]
    given = {one["coordinate"] for one in scene["effects"].values() if one["type"] == "prescribed_motion"}
    wanted = entry.get("coordinate") or next(k for k in given if moved[k].get("joint") == entry["joint"])
    k = list(run.coordinate_units).index(wanted)
    speed = _rate(run.coordinates[:, k], run.time, _size(run, run.coordinate_units[wanted]))
    factor, unit = style.axis_unit(run.units.get(name, "1"), run.outputs[name])
    rate, per_second = style.axis_unit(f"{run.coordinate_units[wanted]}/s", speed)
    axes.plot(rate * speed, factor * run.outputs[name], linewidth=0.9)
    most = int(np.argmax(np.abs(run.outputs[name])))
    axes.plot(rate * speed[most], factor * run.outputs[name][most], "o", color=style.QUIET, markersize=4.0)
    axes.axhline(0.0, color=style.QUIET, linewidth=0.6)
    axes.set(xlabel=style.axis_label("speed", per_second), ylabel=style.axis_label(name, unit))
    return style.axis_label(name, "1")


def counted_outputs(run: Trajectory) -> list[Load]:
    """Return the outputs whose cycles the scene of a run counts."""
    named = dict.fromkeys(entry["of"] for entry in outputs_of(run, ("rainflow",)).values())
    return [Load(name, (name,)) for name in named if name in run.outputs and len(cycles(run.outputs[name]))]


def draw_rainflow(axes: Axes, run: Trajectory, load: Load) -> str:
    """Draw how many cycles of an output have which range and mean."""
    first, second, count = cycles(run.outputs[load.names[0]]).T
    factor, unit = style.axis_unit(run.units.get(load.names[0], "1"), first, second)
    ranges, means = factor * np.abs(second - first), 0.5 * factor * (first + second)
    matrix, *edges = np.histogram2d(ranges, means, N_BINS, weights=count)
    drawn = axes.pcolormesh(*edges, np.where(matrix > 0.0, matrix, np.nan).T, cmap="viridis")
    axes.set(xlabel=style.axis_label("range", unit), ylabel=style.axis_label("mean", unit))
    axes.figure.colorbar(drawn, ax=axes, label="cycles")
    return style.axis_label(load.title, "1")


@dataclass(frozen=True)
class Diagram:
    """A kind of diagram."""

    title: str  # above a picture of several
    of: Callable[[Trajectory], list[Load]]  # what a run has of them
    draw: Callable[[Axes, Trajectory, Load], str]
    lacking: str  # why a run has none
    words: str  # behind the title of one that stands alone
    about: str  # what is seen
    mark: str = ""  # what a dot is
    axes: Mapping[str, Any] | None = None


#: by the name of their pictures
DIAGRAMS = {
    "forces": Diagram(
        "Forces in joints",
        joint_forces,
        draw_force,
        "no joint has its forces along x and y among the outputs; add two of type joint_force",
        ", polar",
        "Size and direction of the force over the run; the dot is the largest.",
        "the largest",
        POLAR,
    ),
    "torques": Diagram(
        "Drives over their speed",
        driven,
        draw_torque,
        "the scene has no output of type drive_torque; add one",
        " over speed",
        "The dot is the largest.",
        "the largest",
    ),
    "rainflow": Diagram(
        "Rainflow matrix",
        counted_outputs,
        draw_rainflow,
        "the scene counts no cycles; add an output of type rainflow",
        ", rainflow matrix",
        "Cycles of the run by range and mean.",
    ),
}


@style.styled
def loads(run: Trajectory, kind: str, label: str = "") -> Figure:
    """Draw all diagrams of a kind, one of `DIAGRAMS`, that a run has. Raises `InputError` if there is none."""
    diagram = DIAGRAMS[kind]
    found = diagram.of(run)
    if not found:
        raise InputError(diagram.lacking)
    figure, blocks = style.panel_grid(len(found), (3.7, 3.4), 0.65, 5.0, subplot_kw=diagram.axes)
    for (axes,), load in zip(blocks, found):
        axes.set_title(diagram.draw(axes, run, load))
    look = {"color": style.QUIET, "linestyle": "none", "marker": "o", "markersize": 4.0}
    keys = [Line2D([], [], label=diagram.mark, **look)] if diagram.mark else []
    what = style.heading(f"{diagram.title}, {style.MODELS[run.model]}", run.record, label)
    return style.top_legend(figure, keys, what, style.notes_of_runs([run], [label]))
