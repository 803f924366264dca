"""Pictures of ensembles: densities of parameters and outputs (as Figs. 5 and 6 of Naets et al. 2015); outputs over
time, mean and bands between quantiles; Sobol indices; how well figures were known at every look; those of a better
model beside what its own samples, and the ensemble's, say alone; and of a rare event the probability of beyond every
value, level by level, and at the event's level with its interval."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import scipy
from matplotlib.axes import Axes
from matplotlib.colors import to_hex, to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from pgmp_petsc.base.errors import InputError, counted, nearest_name
from pgmp_petsc.base.units import behind, inverse
from pgmp_petsc.figures import style
from pgmp_petsc.figures.style import tell_apart
from pgmp_petsc.results import Band, Ensemble, Statistics
from pgmp_petsc.results.ensemble import RareEvent, Sensitivity
from pgmp_petsc.results.numbers import ROUND_OFF, interval_text, number_text, share_text

LINES, LINE_POINTS = 2, 11.5  # above each panel, for an ensemble
NOTE_SIZE, NOTE_LENGTH = 8.5, 40  # of the letters there, points, and for how many there is room beside the last panel
MOST_DIGITS = 8  # of a mean beside its interval
DASHES = (0, (4, 3))
BAND = "#F3F3F3"
N_PLACES = 400  # of a density
REPEATED = 0.05  # of all samples: a value that more have is drawn by itself
WORDS = 0.4, 0.1  # room for those at such a bar, of the axes
COLOURS = {"full": style.FULL_COLOUR, "components": style.COMPONENT_COLOUR, "reduced": style.REDUCED_COLOUR}


@style.styled
def densities(
    ensembles: Sequence[Ensemble], labels: Sequence[str] | None = None, names: Sequence[str] | None = None
) -> Figure:
    """Draw the density of every drawn parameter and output that the ensembles have in common, one panel each; of
    `names` only, in their order, where they are given.

    Densities are by a kernel (`kernel_density`); the file has them counted in bins. Values that many samples have alike
    are bars as high as their share of the panel. Outputs are those of the samples that are fine, parameters those of
    all samples, as in the file's statistics. The first ensemble is drawn as an area, the others as steps over it.
    Dashed lines mark the means; the band reaches a standard deviation to both sides of the first ensemble's mean. Above
    each panel are mean and standard deviation, each with its confidence interval in brackets. With two ensembles a
    lower panel shows by how much the second density differs, in % of the first one's peak.

    Labels are by default the model, how many of its samples are fine, and what else tells the ensembles apart. Raises
    `InputError` if the ensembles do not share one of `names`, or have no quantity in common or one has no sample that
    is fine.
    """
    labels = labels_of(ensembles) if labels is None else labels
    names = _common(ensembles, names)
    compared = len(ensembles) == 2
    height, ratios = (4.1, (2.8, 1.0)) if compared else (3.1 + 0.3 * len(ensembles), (1.0,))
    figure, blocks = style.panel_grid(len(names), (3.6, height), 0.65, 5.0, ratios)
    models = [ensemble.model for ensemble in ensembles]
    colours = style.distinct_colours(len(models))
    colours = [COLOURS[model] for model in models] if len(set(models)) == len(models) else colours
    for block, name in zip(blocks, names):
        _draw_quantity(block, ensembles, name, colours)
    keys = [
        Patch(facecolor="none" if number else _tint(colour), edgecolor=colour, linewidth=1.5, label=label)
        for number, (label, colour) in enumerate(zip(labels, colours))
    ]
    keys.append(Line2D([], [], color=style.QUIET, linestyle=DASHES, linewidth=1.0, label="mean"))
    if any(np.isfinite(ensembles[0].statistics[name].std) for name in names):
        beside = "" if len(ensembles) == 1 else " of the first"
        keys.append(Patch(facecolor=BAND, label=f"a standard deviation{beside} to both sides"))
    levels = sorted({ensemble.statistics[name].confidence for ensemble in ensembles for name in names})
    brackets = " and ".join(f"{100 * level:g} %" for level in levels)
    keys.append(Line2D([], [], linestyle="none", label=f"[ ]: {brackets} interval"))
    what = style.heading("Densities of parameters and outputs at the end", ensembles[0].record)
    return style.top_legend(figure, keys, what, _notes(ensembles, labels))


def labels_of(ensembles: Sequence[Ensemble], files: Sequence[Path] = ()) -> list[str]:
    """Return each ensemble's model, how many of its samples are fine, and what tells it from the others."""
    kinds = []
    for ensemble in ensembles:
        n, n_fine = len(ensemble.status), int(np.count_nonzero(ensemble.status == 0))
        count = counted(n, "sample") if n_fine == n else f"{n_fine} fine of {n} samples"
        kinds.append(f"{style.MODELS[ensemble.model]}, {count}")
    apart = tell_apart([ensemble.record for ensemble in ensembles], kinds, files)
    return [
        text if text.startswith(kind) else ", ".join(filter(None, (kind, text))) for kind, text in zip(kinds, apart)
    ]


def _notes(ensembles: Sequence[Ensemble], labels: Sequence[str]) -> list[str]:
    """Return what has to be known besides: samples that failed, and warnings."""
    several = len(ensembles) > 1
    failed = [
        f"{label + ': ' if several else ''}outputs are described without the failed samples, which may bias them"
        for ensemble, label in zip(ensembles, labels)
        if ensemble.status.any()
    ]
    return [*failed, *style.notes_of_records([ensemble.record for ensemble in ensembles], labels if several else ())]


def _draw_quantity(block: np.ndarray, ensembles: Sequence[Ensemble], name: str, colours: Sequence[str]) -> None:
    known = [ensemble.statistics[name] for ensemble in ensembles]
    factor, unit = style.axis_unit(ensembles[0].units.get(name, "1"), *(s.edges for s in known))
    samples = [factor * values_of(ensemble, name) for ensemble in ensembles]
    places = np.linspace(min(map(np.min, samples)), max(map(np.max, samples)), N_PLACES)
    heights = [kernel_density(values, places) for values in samples]
    axes = block[0]
    if np.isfinite(known[0].std):
        mean, std = factor * known[0].mean, factor * known[0].std
        axes.axvspan(mean - std, mean + std, color=BAND, zorder=0.5, linewidth=0)
    for number, (one, height, colour) in enumerate(zip(known, heights, colours)):
        if number == 0:
            axes.fill_between(places, height, color=_tint(colour), linewidth=0)
        axes.plot(places, height, color=colour, linewidth=1.4 if number else 1.1)
        axes.axvline(factor * one.mean, color=colour, linestyle=DASHES, linewidth=1.0)
    draw_repeated(axes, samples, colours)
    style.span(axes, places[0], places[-1])
    axes.set_ylim(0.0, 1.08 * max(height.max() for height in heights) or 1.0)
    axes.set_title(name, pad=8.0 + LINES * LINE_POINTS * len(known))
    axes.yaxis.set_major_formatter(style.PlainNumbers())
    axes.set_ylabel(style.axis_label("density", inverse(unit)))
    axes.yaxis.set_visible(any(map(np.any, heights)))  # what is constant has no density
    _write_moments(axes, known, colours, factor, unit)
    if len(block) > 1:
        axes.tick_params(labelbottom=False)
        block[1].sharex(axes)
        peak = heights[0].max() or np.nan  # none of what is constant, or has but values that come again and again
        block[1].fill_between(places, 100.0 * (heights[1] - heights[0]) / peak, color=colours[1], linewidth=0)
        if np.isnan(peak):
            look = {"ha": "center", "color": style.QUIET, "fontsize": NOTE_SIZE, "transform": block[1].transAxes}
            block[1].text(0.5, 0.6, "no density to compare with", **look)
        block[1].axhline(0.0, color=style.QUIET, linewidth=0.8)
        block[1].set_ylabel("difference\n(% of peak)")
        reach = max(np.abs(block[1].get_ylim()).max(), 1.0)
        block[1].set_ylim(-1.1 * reach, 1.1 * reach)
    block[-1].set_xlabel(style.axis_label(name, unit))


def _write_moments(axes: Axes, known: Sequence[Statistics], colours: Sequence[str], factor: float, unit: str) -> None:
    """Write mean and standard deviation with their intervals above the axes, two lines for each ensemble."""
    shown = behind(unit)

    def figure(value: float, ends: np.ndarray) -> str:
        text = number_text(factor * value, factor * ends, MOST_DIGITS)
        return f"{text} {interval_text(factor * ends)}" if ends[1] > ends[0] else text

    for number, (one, colour) in enumerate(zip(known, colours)):
        mean, std = figure(one.mean, one.mean_interval), figure(one.std, one.std_interval)
        spread = f"deviation {std}{shown}" if np.isfinite(one.std) else "no deviation"
        spread = "constant" if one.constant else spread
        text = f"mean {mean}{shown}\n{spread}, N = {one.count}"
        longest = max(map(len, text.splitlines()))
        note = axes.annotate(
            text.replace("-", "\N{MINUS SIGN}"),
            xy=(0.0, 1.0),
            xycoords="axes fraction",
            xytext=(0.0, 5.0 + LINES * LINE_POINTS * (len(known) - 1 - number)),
            textcoords="offset points",
            fontsize=NOTE_SIZE * min(1.0, NOTE_LENGTH / longest),
            color=colour,
        )
        # a long line must not narrow the panels
        note.set_in_layout(False)


def values_of(ensemble: Ensemble, name: str) -> np.ndarray:
    """Return the samples that the statistics of a name are of: finite ones, of outputs those that are fine."""
    extremes = {key.replace("/", "."): of for key, of in ensemble.extremes.items()}
    own = {**extremes, **ensemble.first_passages, **ensemble.outputs, **ensemble.parameters}[name]
    known = np.isfinite(own) if name in ensemble.parameters else np.isfinite(own) & (ensemble.status == 0)
    return own[known]


def kernel_density(values: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Return the density of samples (n,) at places: Gaussian kernels of Scott's width, reflected at both ends.

    Reflected, as many distributions end within their range, where kernels would reach beyond (Schuster 1985). Zero
    beyond the samples, and everywhere where they do not differ. Values that many have alike have no density: what is
    left is that of the others, a share of one.
    """
    known = {value for value, _ in repeated(values)}
    rest = values[~np.isin(values, list(known))] if known else values
    if rest.size < 2 or not _differ(rest):
        return np.zeros(places.shape)
    low, high, of = rest.min(), rest.max(), scipy.stats.gaussian_kde(rest)
    mirrored = of(places) + of(2 * low - places) + of(2 * high - places)
    return np.where((low <= places) & (places <= high), rest.size / values.size * mirrored, 0.0)


def _differ(values: np.ndarray) -> bool:
    return np.ptp(values) > ROUND_OFF * np.abs(values).max()


def repeated(values: np.ndarray) -> list[tuple[float, float]]:
    """Return values that more than `REPEATED` of samples (n,) have to the last bit, as the force of a contact that is
    open, and the share that does; none where all are the same but for round-off."""
    found, counts = np.unique(values, return_counts=True)
    many = counts > max(1.0, REPEATED * values.size)
    return list(zip(found[many].tolist(), (counts[many] / values.size).tolist())) if _differ(values) else []


def draw_repeated(axes: Axes, samples: Sequence[np.ndarray], colours: Sequence[str]) -> None:
    """Draw what share of samples, each (n,), has each of the `repeated` values, the height of the axes being all of
    them; words that would lie on others stand above these."""
    low, high = min(map(np.min, samples)), max(map(np.max, samples))
    wide, written = WORDS[0] * (high - low), list[tuple[float, float]]()
    bars = [(share, value, colour) for own, colour in zip(samples, colours) for value, share in repeated(own)]
    for share, value, colour in sorted(bars):
        at_left, top = value <= 0.5 * (low + high), share
        first = value if at_left else value - wide
        for other, theirs in sorted(written, key=lambda place: place[1]):
            if abs(first - other) < wide and abs(top - theirs) < WORDS[1]:
                top = theirs + WORDS[1]
        written.append((first, top))
        look = {"color": colour, "clip_on": False, "transform": axes.get_xaxis_transform()}
        axes.plot([value, value], [0.0, share], linewidth=3.0, **look)
        axes.annotate(
            f"{share_text(share)} at {value:.4g}".replace("-", "\N{MINUS SIGN}"),
            xy=(value, top),
            xycoords=axes.get_xaxis_transform(),
            xytext=(3.0 if at_left else -3.0, 0.0),
            textcoords="offset points",
            ha="left" if at_left else "right",
            va="top",
            fontsize=NOTE_SIZE,
            color=colour,
        )


def _common(ensembles: Sequence[Ensemble], wanted: Sequence[str] | None) -> list[str]:
    """Return the wanted quantities, or all whose statistics the ensembles have in common, parameters first."""
    first = ensembles[0]
    shared = [name for name in (*first.parameters, *first.outputs) if all(name in one.statistics for one in ensembles)]
    if not shared:
        raise InputError("the ensembles have nothing in common; plot those of one scene together")
    known = [name for name in shared if all(one.statistics[name].count for one in ensembles)]
    names = (known or shared) if wanted is None else list(wanted)
    for name in names:
        if name not in shared:
            raise InputError(f"not every ensemble has '{name}'{nearest_name(name, shared)}")
    for ensemble in ensembles:
        for name in names:
            if not ensemble.statistics[name].count:
                what = f"no sample of the {ensemble.model} ensemble has a value of '{name}', or too many failed"
                raise InputError(f"{what}; pgmp info says which")
    return names


def _tint(colour: str) -> str:
    """Return a colour mixed with white, for areas."""
    return to_hex(1.0 - 0.3 * (1.0 - np.array(to_rgb(colour))))


OPACITY = 0.45  # of all bands over each other, where they are darkest


@style.styled
def bands(ensemble: Ensemble, label: str = "") -> Figure:
    """Draw the outputs of an ensemble over time, one panel each: mean, median, and areas between pairs of quantiles.

    Pairs are the lowest probability of the scene's ``ensemble.quantiles`` with the highest, and so on inwards.
    """
    shown = {name: band for name, band in ensemble.bands.items() if band.count}
    figure, blocks = style.panel_grid(len(shown), (7.2, 2.0), 0.9, columns=1, sharex=True)
    panels, colour = blocks[:, 0], COLOURS[ensemble.model]
    for axes, (name, band) in zip(panels, shown.items()):
        factor, unit = style.axis_unit(ensemble.units.get(name, "1"), band.mean, band.quantiles)
        _draw(axes, band, factor, colour)
        axes.set_ylabel(style.axis_label(name, unit))
    first = next(iter(shown.values()))
    style.span(panels[-1], first.time[0], first.time[-1])
    panels[-1].set_xlabel("time (s)")
    pairs, middle = pairs_of(first.probabilities)
    keys = [Line2D([], [], color=colour, label=f"mean of {counted(first.count, 'sample')}")]
    if middle is not None:
        text = f"{100 * first.probabilities[middle]:g} % quantile"
        keys.append(Line2D([], [], color=colour, linestyle=":", label=text))
    for number, (low, high) in enumerate(pairs):
        ends = f"{100 * first.probabilities[low]:g} to {100 * first.probabilities[high]:g} %"
        alpha = 1.0 - (1.0 - OPACITY / len(pairs)) ** (number + 1)  # as over each other
        keys.append(Patch(facecolor=colour, alpha=alpha, linewidth=0, label=ends))
    return style.headed(figure, keys, "Outputs over time", ensemble.record, label)


def _draw(axes: Axes, band: Band, factor: float, colour: str) -> None:
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
    return [(order[k], order[n - 1 - k]) for k in range(n // 2)], order[n // 2] if n % 2 else None


HEIGHT = 0.36  # of a bar, where the distance of parameters is 1
FIRST, TOTAL = style.PALETTE[0], style.PALETTE[4]


@style.styled
def sobol(ensemble: Ensemble, label: str = "") -> Figure:
    """Draw first and, where they are known, total indices of every output with their intervals, one panel each."""
    names = list(ensemble.sobol)
    one = ensemble.sobol[names[0]]
    size = 3.4, 0.75 + 0.42 * len(one.parameters)
    figure, blocks = style.panel_grid(len(names), size, 0.9, 6.4, sharex=True)
    for axes, name in zip(blocks[:, 0], names):
        draw_indices(axes, ensemble.sobol[name], np.arange(len(one.parameters))[::-1])
        axes.set_title(name)
    level = f"{100 * one.confidence:g} % intervals"
    keys = [Patch(facecolor=FIRST, label=f"first index: share of the variance by itself, {level}")]
    if one.total is not None:
        keys.append(Patch(facecolor=TOTAL, label="total index: with all that it acts together with"))
    return style.headed(figure, keys, "Sobol indices of outputs", ensemble.record, label)


def draw_indices(axes: Axes, found: Sensitivity, places: np.ndarray) -> None:
    """Draw Sobol indices with their intervals as bars at the parameters' places, first ones above total ones."""
    kinds = [(found.first, found.first_interval, FIRST, "first: by itself")]
    if found.total is not None:
        kinds.append((found.total, found.total_interval, TOTAL, "total: with all others"))
    for shift, (values, ends, colour, label) in zip((0.5, -0.5) if len(kinds) > 1 else (0.0,), kinds):
        look = {"color": colour, "label": label, "ecolor": "#333333", "capsize": 2.0}
        axes.barh(places + shift * HEIGHT, values, HEIGHT, xerr=np.abs(ends.T - values), **look)
    axes.set_yticks(places, list(found.parameters))
    axes.grid(axis="y", visible=False)


@style.styled
def stopping(ensemble: Ensemble, label: str = "") -> Figure:
    """Draw half the width of every rule's interval over the number of samples, as a multiple of what was wanted."""
    found = ensemble.stopping
    figure = style.new_figure(6.4, 3.6)
    axes = figure.subplots()
    keys = []
    for number, (text, wanted, reached) in enumerate(zip(found.rules, found.wanted, found.reached)):
        known = np.isfinite(reached)
        colour = style.PALETTE[number % len(style.PALETTE)]
        keys += axes.loglog(found.samples[known], reached[known] / wanted, "o-", color=colour, label=text, markersize=4)
    axes.axhline(1.0, color="#333333", linewidth=1.0)
    axes.set(xlabel="samples", ylabel="half the interval / what was wanted")
    return style.headed(figure, keys, "precision at every look", ensemble.record, label)


JOINED_COLOURS = (style.PALETTE[0], style.PALETTE[4], "#333333")


@style.styled
def joined(ensemble: Ensemble, label: str = "") -> Figure:
    """Draw the mean of every output with its interval: of the ensemble, of the better model alone, and of all models.

    An interval that knows of sampling alone is drawn thin, one that knows of the model too is drawn thick.
    """
    found = ensemble.joined
    names = [name for name, one in found.corrected.items() if "mean" in one.figures]
    figure, blocks = style.panel_grid(len(names), (3.4, 1.7), 0.9, 6.4)
    best, own = found.models[0], found.models[-1]
    counts = found.corrected[names[0]].counts
    rows = [f"{own}, {len(ensemble.status)}", f"{best}, {counts[0]}", "joined"]
    for axes, name in zip(blocks[:, 0], names):
        mean, of_own = found.corrected[name].figures["mean"], ensemble.statistics[name]
        ends = np.array([of_own.mean_interval, mean.alone_interval, mean.interval])
        factor, unit = style.axis_unit(ensemble.units.get(name, "1"), ends[np.isfinite(ends)])
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
        axes.set_xlabel(style.axis_label(f"mean {name}".replace(".", ", "), unit))
    what = f"{best} model from few samples of it, {100 * found.confidence:g} % intervals"
    return style.headed(figure, [], what, ensemble.record, label)


@style.styled
def rare_event(found: RareEvent, label: str = "") -> Figure:
    """Draw the probability over values of the output."""
    figure = style.new_figure(6.4, 4.2)
    axes = figure.subplots()
    factor, unit = style.axis_unit(found.unit, found.value[np.isfinite(found.value)])
    values, probabilities = found.curve
    keys = axes.plot(values * factor, probabilities, color=style.PALETTE[0], label="subset simulation")
    shares = np.cumprod(found.share)
    keys += axes.plot(found.threshold * factor, shares, "o", color=style.PALETTE[0], label="levels", markersize=4.0)
    if found.reached and np.isfinite(found.interval).all():
        level = found.threshold[-1] * factor
        errors = np.abs(found.interval[:, None] - found.estimate)
        words = f"importance sampling, {100 * found.confidence:g} % interval"
        look = {"fmt": "D", "color": style.PALETTE[1], "capsize": 4.0, "label": words}
        keys.append(axes.errorbar([level], [found.estimate], yerr=errors, **look))
    if len(found.threshold):
        axes.axvline(found.threshold[-1] * factor, color=style.QUIET, linewidth=0.8, linestyle=":")
    axes.set(yscale="log", xlabel=style.axis_label(found.output, unit), ylabel="probability of beyond")
    return style.headed(figure, keys, found.event, found.record, label)
