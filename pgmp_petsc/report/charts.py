"""Charts of a page: small SVG pictures that read as well on a phone as on paper, drawn by matplotlib.

Texts stay texts. A chart over time says where its axis is, so that the page can mark an instant in it.
"""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from textwrap import fill
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, NullFormatter
from matplotlib.transforms import blended_transform_factory

from pgmp_petsc.base.errors import counted
from pgmp_petsc.base.units import inverse
from pgmp_petsc.figures.ensembles import COLOURS, N_PLACES, draw_indices, draw_repeated, kernel_density, pairs_of
from pgmp_petsc.figures.style import PALETTE, QUIET, PlainNumbers, axis_label, axis_unit, new_figure, span, styled
from pgmp_petsc.figures.trajectories import DIAGRAMS, fitted, residuals
from pgmp_petsc.results import Balance, Band, Fit, Sensitivity, Tradeoff, Trajectory
from pgmp_petsc.results.numbers import with_unit

WIDTH, HEIGHT = 4.3, 2.5  # inches: on a phone type is then as large as in the text
ROW = 58  # characters that keys above a picture may take in a row
MOST_MARKS = 300  # of samples that failed
MISSED = 0.1  # share of what a run varies by, which lines between the instants of an ensemble may miss
NARROW = 1e-3  # share of the values that their range takes, below which numbers on its axis are long
FAILED = "#A32A00"
LEVEL = "#A32A00"
_SVG = {"svg.fonttype": "none", "axes.titlesize": 9.5, "figure.facecolor": "none"}


@dataclass(frozen=True)
class Chart:
    """A picture."""

    svg: str  # its element
    title: str  # title, caption: above and below it
    caption: str = ""
    #: of charts over time: left and right end of the axis and its lower and upper end in the SVG's own unit, and the
    #: instants (s) at both ends; empty for others
    axis: tuple[float, ...] = ()
    output: str = ""  # name of the output that it shows, where it shows one over time
    factor: float = 1.0  # factor, unit: of that output: the picture's unit, and how many of it the file's unit is
    unit: str = ""


@dataclass(frozen=True)
class Curve:
    """A run in a chart: its label, model, instants (s), and values."""

    label: str
    model: str
    time: np.ndarray
    values: np.ndarray


@styled
def _drawn(draw: Callable[[Axes], None], height: float, kind: Mapping[str, Any] | None) -> Figure:
    figure = new_figure(WIDTH, height)
    draw(figure.subplots(subplot_kw=kind))
    return figure


def chart(
    draw: Callable[[Axes], None],
    title: str,
    caption: str = "",
    height: float = HEIGHT,
    over_time: bool = False,
    output: str = "",
    kind: Mapping[str, Any] | None = None,
) -> Chart:
    """Return what `draw` draws on axes of its own, of a kind that matplotlib's `subplot_kw` names."""
    figure = _drawn(draw, height, kind)
    stream = io.StringIO()
    for patch in (figure.patch, *(axes.patch for axes in figure.axes)):
        patch.set(facecolor="none", edgecolor="none")
    with matplotlib.rc_context({**_SVG, "svg.hashsalt": title + output}):
        # `savefig` would go through all that is drawn twice, for the layout first
        FigureCanvasSVG(figure).print_svg(stream, metadata=dict.fromkeys(("Date", "Creator", "Type", "Format")))
    axis = ()
    if over_time:
        axes = figure.axes[0]
        box, (width, tall) = axes.get_position(), (72.0 * WIDTH, 72.0 * figure.get_figheight())
        ends = (box.x0 * width, box.x1 * width, (1.0 - box.y1) * tall, (1.0 - box.y0) * tall)
        axis = tuple(round(float(value), 6) for value in (*ends, *axes.get_xlim()))
    return Chart(_element(stream.getvalue(), title), title, caption, axis, output)


def _element(text: str, title: str) -> str:
    """Return the SVG element alone, of any size, without addresses, which a page does not need."""
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r' xmlns(:xlink)?="[^"]*"', "", text).replace("xlink:href", "href")
    label = title.replace("&", "&amp;").replace('"', "&quot;").replace("<", "&lt;")
    head, rest = text.split(">", 1)
    box = re.search(r'viewBox="[^"]*"', head)[0]
    return f'<svg class="chart" role="img" aria-label="{label}" {box}>{rest.strip()}'


@dataclass(frozen=True)
class Level:
    """The level of an event: its label, the value (the output's unit), whether above it, and ``end`` or ``ever``."""

    label: str
    value: float
    above: bool
    when: str


def _seen(event: Level | None, unit: str, *arrays: np.ndarray) -> tuple[float | None, str]:
    """Return the level where it is within the picture, or as far beyond as the data reach; else what to say."""
    if event is None:
        return None, ""
    known = np.concatenate([values[np.isfinite(values)] for values in arrays])
    low, high = (known.min(), known.max()) if known.size else (event.value, event.value)
    room = high - low
    if low - room <= event.value <= high + room:
        return event.value, ""
    return None, f"The level of {event.label}, {with_unit(event.value, unit)}, is far beyond this picture."


def _is_missed(curve: Curve, instants: np.ndarray) -> bool:
    """Return whether straight lines between instants miss a run by more than `MISSED` of what it varies by."""
    straight = np.interp(curve.time, instants, np.interp(instants, curve.time, curve.values))
    known = np.isfinite(straight)
    return bool(known.any()) and np.abs(straight - curve.values)[known].max() > MISSED * np.ptp(curve.values[known])


def output_over_time(
    name: str, unit: str, curves: Sequence[Curve], band: Band | None, model: str, event: Level | None
) -> Chart:
    """Return an output over time: runs as lines, an ensemble as areas between quantiles and its mean."""
    arrays = [curve.values for curve in curves]
    arrays += [] if band is None else [band.quantiles, band.mean]
    factor, shown = axis_unit(unit, *arrays)
    level, beyond = _seen(event, unit, *arrays)
    sparse = band is not None and any(_is_missed(curve, band.time) for curve in curves)

    def draw(axes: Axes) -> None:
        if band is not None:
            pairs, _ = pairs_of(band.probabilities)
            for low, high in pairs:
                ends = factor * band.quantiles[:, [low, high]]
                look = {"color": COLOURS[model], "alpha": 0.4 / len(pairs)}
                if sparse:
                    axes.vlines(band.time, *ends.T, linewidth=3.0, **look)
                else:
                    axes.fill_between(band.time, *ends.T, linewidth=0, **look)
            look = {"linestyle": "", "marker": ".", "markersize": 4.0} if sparse else {"linestyle": ":"}
            axes.plot(band.time, factor * band.mean, color=COLOURS[model], label="mean of the samples", **look)
        for number, curve in enumerate(curves):
            is_first = number < 3 and all(one.model != curve.model for one in curves[:number])
            colour = COLOURS[curve.model] if is_first else PALETTE[number % len(PALETTE)]
            look = {"color": colour, "linestyle": (0, (4, 2.5)) if number else "-", "linewidth": 1.3}
            axes.plot(curve.time, factor * curve.values, label=curve.label, **look)
        if level is not None:
            axes.axhline(factor * level, color=LEVEL, linewidth=0.9, linestyle=(0, (1, 1.5)), label=event.label)
        axes.set_ylabel(axis_label(name, shown))
        axes.yaxis.set_major_formatter(PlainNumbers())
        axes.set_xlabel("time (s)")
        times = [*(curve.time for curve in curves), *([] if band is None else [band.time])]
        span(axes, min(time[0] for time in times), max(time[-1] for time in times))
        if len(axes.get_legend_handles_labels()[0]) > 1:
            _keys(axes)

    caption = beyond
    if band is not None:
        pairs, _ = pairs_of(band.probabilities)
        ends = ", ".join(f"{100 * band.probabilities[a]:g} to {100 * band.probabilities[b]:g} %" for a, b in pairs)
        of, at = counted(band.count, "sample"), counted(len(band.time), "instant")
        at += ", between which the run goes to and fro; a larger ensemble.bands tells more" if sparse else ""
        caption = f"Areas: {ends} of {of}, at {at}. {beyond}".rstrip()
    drawn = chart(draw, name, caption, over_time=True, output=name)
    return replace(drawn, factor=factor, unit="" if shown == "1" else shown)


def distribution(
    name: str, unit: str, values: np.ndarray, model: str, event: Level | None, failed: np.ndarray, of_input: bool
) -> Chart:
    """Return the density of samples with their mean, and where the samples lie that failed."""
    factor, shown = axis_unit(unit, values)
    level, beyond = _seen(event, unit, values)
    if failed.size > MOST_MARKS:
        beyond = f"{beyond} {MOST_MARKS} of {failed.size} samples that failed are marked.".strip()
        failed = failed[np.linspace(0, failed.size - 1, MOST_MARKS).round().astype(int)]

    def draw(axes: Axes) -> None:
        places = np.linspace(factor * values.min(), factor * values.max(), N_PLACES)
        height = kernel_density(factor * values, places)
        colour = QUIET if of_input else COLOURS[model]
        axes.fill_between(places, height, color=colour, alpha=0.3, linewidth=0)
        axes.plot(places, height, color=colour, linewidth=1.1)
        axes.axvline(factor * values.mean(), color=colour, linestyle=(0, (4, 3)), linewidth=1.1, label="mean")
        draw_repeated(axes, [factor * values], [colour])
        if level is not None:
            axes.axvline(factor * level, color=LEVEL, linewidth=1.1, label=event.label)
        if failed.size:
            axes.plot(
                factor * failed, np.full(failed.size, 0.04), "|", color=FAILED, markersize=9,
                transform=axes.get_xaxis_transform(), label="samples that failed",
            )  # fmt: skip
        axes.set_ylim(bottom=0.0)
        axes.yaxis.set_major_locator(MaxNLocator(4))
        axes.yaxis.set_major_formatter(PlainNumbers())
        axes.set_ylabel(axis_label("density", inverse(shown)))
        # numbers that differ in a late digit are long
        narrow = np.ptp(places) < NARROW * np.abs(places).max()
        axes.xaxis.set_major_locator(MaxNLocator(2 if narrow else 5))
        axes.xaxis.set_major_formatter(PlainNumbers())
        axes.set_xlabel(axis_label(name, shown))
        _keys(axes)

    return chart(draw, name, beyond, height=2.2)


def ranking(name: str, found: Sensitivity) -> Chart:
    """Return Sobol indices of an output with their intervals, the largest on top."""
    order = np.argsort(found.first if found.total is None else found.total)

    def draw(axes: Axes) -> None:
        draw_indices(axes, found, np.argsort(order))
        axes.set_xlabel("share of the variance")
        _keys(axes)

    return chart(draw, name, height=1.2 + 0.42 * order.size)


def energies(run: Trajectory, balance: Balance) -> Chart:
    curves = {"kinetic": balance.kinetic, "strain": balance.strain, "potential": balance.potential}
    curves = {name: values for name, values in curves.items() if values.any()}
    curves |= {f"work of {name.replace('_', ' ')}": values for name, values in balance.work.items() if values.any()}
    curves["residual"] = balance.residual
    factor, unit = axis_unit(run.record.system.unit("J"), *curves.values())

    def draw(axes: Axes) -> None:
        for number, (name, values) in enumerate(curves.items()):
            # the work of a drive often is the kinetic energy: dashes show what lies below
            style = (0, (4, 2)) if name.startswith("work of") else "-"
            colour = "#A32A00" if name == "residual" else PALETTE[number % len(PALETTE)]
            axes.plot(run.time, factor * values, color=colour, linestyle=style, linewidth=1.2, label=name)
        axes.set_ylabel(f"energy ({unit})")
        axes.set_xlabel("time (s)")
        span(axes, run.time[0], run.time[-1])
        _keys(axes)

    return chart(draw, "Energy", height=HEIGHT + 0.13 * len(curves), over_time=True)


def residual(run: Trajectory, balance: Balance) -> Chart:
    """Return what is left over of the balance of energy, as a share of what is moved around."""
    share = 100.0 * balance.residual / balance.exchanged

    def draw(axes: Axes) -> None:
        axes.plot(run.time, share, color=FAILED, linewidth=1.2)
        axes.set_ylabel("residual (%)")
        axes.set_xlabel("time (s)")
        span(axes, run.time[0], run.time[-1])

    caption = "Energies gained less the work of all effects, as a share of the energy that is moved around."
    return chart(draw, "Residual of the balance", caption, over_time=True)


def loads(run: Trajectory) -> list[Chart]:
    """Return the diagrams of what parts are sized by that a run has: forces, torques, cycles."""
    found = []
    for diagram in DIAGRAMS.values():
        for load in diagram.of(run):
            titles: list[str] = []
            drawn = chart(
                lambda axes: titles.append(diagram.draw(axes, run, load)),
                f"{diagram.title}: {load.title}",
                diagram.about,
                1.35 * HEIGHT if diagram.axes else HEIGHT,
                kind=diagram.axes,
            )
            found.append(replace(drawn, title=f"{titles[0]}{diagram.words}"))
    return found


def fit(found: Fit) -> list[Chart]:
    """Return for each output what was measured and fitted, and the residuals."""

    def drawn(draw: Callable[[Axes, Fit, str], None], name: str, title: str) -> Chart:
        def own(axes: Axes) -> None:
            draw(axes, found, name)
            axes.set_xlabel("time (s)")
            _keys(axes)

        return chart(own, f"{name}: {title}")

    pairs = [(drawn(fitted, name, "fit"), drawn(residuals, name, "residuals")) for name in found.outputs]
    return [one for pair in pairs for one in pair]


def accuracy_and_time(study: Tradeoff, output: str) -> Chart:
    """Return the errors of an output over the time of a sample, one colour a family of settings."""
    errors, times = study.errors[:, study.outputs.index(output)], study.times.batch
    families = [("reduced", PALETTE[1]), ("components", PALETTE[0]), ("full", "#4D4D4D"), ("surface", PALETTE[2])]
    names = {"full": "full order", "surface": "response surface", "components": "component modes"}

    def draw(axes: Axes) -> None:
        for family, colour in families:
            chosen = (np.array(study.families) == family) & (errors > 0.0) & np.isfinite(times)
            if chosen.any():
                label = names.get(family, family)
                axes.loglog(1e3 * times[chosen], 100 * errors[chosen], "o", color=colour, markersize=4, label=label)
        axes.set_xlabel("time of a sample (ms)")
        axes.set_ylabel("largest error (%)")
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_formatter(PlainNumbers())
            axis.set_minor_formatter(NullFormatter())
        _keys(axes)

    return chart(draw, output)


def _keys(axes: Axes) -> None:
    handles, labels = axes.get_legend_handles_labels()
    if handles:
        labels = [fill(label, ROW - 6) for label in labels]  # a longer row would leave the axes no width
        needed = [min(len(label), ROW - 6) + 6 for label in labels]
        columns = len(labels) if sum(needed) <= ROW else max(1, min(len(labels), ROW // max(needed)))
        # from the picture's edge, not from that of the axes, which long numbers beside them move to the right
        axes.legend(
            handles, labels, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncol=columns, fontsize=8.5,
            bbox_transform=blended_transform_factory(axes.figure.transFigure, axes.transAxes),
            handlelength=1.6, columnspacing=1.2, borderaxespad=0.1, labelspacing=0.25,
        )  # fmt: skip


def levels_of(events: Mapping[str, Mapping[str, object]]) -> dict[str, Level]:
    """Return the level of the first event of each output, by the output's name."""
    found: dict[str, Level] = {}
    for label, event in events.items():
        value = event.get("above", event.get("below"))
        if isinstance(value, (int, float)):
            level = Level(label, float(value), "above" in event, str(event.get("when")))
            found.setdefault(str(event.get("output")), level)
    return found
