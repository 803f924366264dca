"""Which setting to take: the cheapest one measured that meets an error, in words and as options to paste.

Cheap is what takes the least time for the study's number of samples, build included. Settings on refined meshes are
left out, because their errors are against another reference. Errors are the largest at some test values: a setting
meets an error with a margin for other draws, and with what the reference itself may be off by: its last move, and its
distance from the mesh where it is another model.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from pgmp_petsc.bench.prices import MODELS, cheapest_from
from pgmp_petsc.results.numbers import share_text, with_unit
from pgmp_petsc.results.tradeoff import Tradeoff

THRESHOLDS = (0.05, 0.01, 0.001)
NOT_KNOWN = 0.1  # share of an error by which the reference may have moved
SMALL = 0.01  # of an output's largest value at other test values: shares of one as small are said with its size
MARGIN = 1.25  # over the largest error at test values, for other draws: those were seen to be up to 1.14 times as large


@dataclass(frozen=True)
class Sizes:
    """How large outputs are, in their units."""

    reference: np.ndarray  # largest value at each test value, shape (n_outputs, n_test); 0 where it is round-off
    #: of every output the test value at which the own meshes are off most, and by how much; None where not measured
    meshes: tuple[tuple[int, float], ...] | None = None


def advise(
    study: Tradeoff, from_mesh: Mapping[str, float] = MappingProxyType({}), sizes: Sizes | None = None
) -> tuple[str, ...]:
    """Return advice for all outputs together, for each of them, and what to keep in mind.

    A piece of advice is one line, or several: a line that begins with ``--`` holds options to paste. `from_mesh` says
    how far the reference is from the mesh in outputs, as far as that was measured; `sizes` of the outputs what shares
    of small ones are of.
    """
    targets, bounds = _targets(study, study.errors), _targets(study, bounds_of(study, from_mesh))
    alike: dict[tuple[Choice, ...], list[str]] = {}
    for target, errors in bounds.items():
        alike.setdefault(_choices(study, errors), []).append(target)
    said: dict[int, str] = {}
    advice = []
    for choices, names in alike.items():
        for choice in choices:
            aim = f"{_joined([f'{100 * threshold:g} %' for threshold in choice[0]])} in {_joined(names)}"
            advice.append(_piece(study, choice, aim, (targets[names[0]], bounds[names[0]]), said))
    first, errors = next(iter(bounds.items()))
    return (
        *advice,
        *_model_sentences(study, first, errors),
        *_break_even(study, first, errors),
        *_margin_sentences(study, from_mesh),
        *_size_sentences(study, sizes),
        *_surface_sentences(study),
        *_mesh_sentences(study, sizes),
        *_reference_sentences(study),
    )


def bounds_of(study: Tradeoff, from_mesh: Mapping[str, float]) -> np.ndarray:
    """Return what errors of settings hardly exceed, shape (n, n_outputs): at other draws than the test values, and
    with the reference's own doubt, its last move, which is more than what is left of its error, and `from_mesh`."""
    own = study.references.refinement == 1
    moved = np.nan_to_num(study.references.moved[own][0]) if own.any() else 0.0
    doubt = moved + np.array([from_mesh.get(name, 0.0) for name in study.outputs])
    return (MARGIN if study.varied else 1.0) * study.errors + doubt


def _targets(study: Tradeoff, errors: np.ndarray) -> dict[str, np.ndarray]:
    """Return errors of every setting, shape (n,), in all outputs together where there are several, and in each."""
    targets = {name: errors[:, column] for column, name in enumerate(study.outputs)}
    return {"every output": errors.max(axis=1), **targets} if len(targets) > 1 else targets


def _margin_sentences(study: Tradeoff, from_mesh: Mapping[str, float]) -> Iterator[str]:
    if study.varied:
        n = len(next(iter(study.test_values.values())))
        yield (
            f"Errors are the largest at {n} test values; a setting meets an error where {MARGIN:g} times as much does, "
            "with the last move of the reference: other draws may be worse."
        )
    if from_mesh:
        apart = _joined([f"{share_text(error)} in {name}" for name, error in from_mesh.items()])
        yield f"The reference is {apart} away from the mesh; a setting meets an error with that added."


#: Errors, and the cheapest settings that meet them: of the models and of the response surfaces; None where none does.
Choice = tuple[tuple[float, ...], int | None, int | None]


def cheapest(study: Tradeoff, errors: np.ndarray, threshold: float, among: np.ndarray) -> int | None:
    """Return the cheapest setting `among` some, a mask (n,), whose error, (n,), NaN where it failed, is at most
    `threshold`; None where there is none."""
    total = study.total_seconds(study.samples)
    good = among & (errors <= threshold) & np.isfinite(total)
    return int(np.argmin(np.where(good, total, np.inf))) if good.any() else None


def _choices(study: Tradeoff, errors: np.ndarray) -> tuple[Choice, ...]:
    """Return what meets each threshold; those with the same setting share a choice."""
    models = study.simulated & study.own_mesh
    shared: dict[int | None, list[float]] = {}
    for threshold in THRESHOLDS:
        shared.setdefault(cheapest(study, errors, threshold, models), []).append(threshold)
    return tuple(
        (tuple(thresholds), row, cheapest(study, errors, min(thresholds), ~study.simulated))
        for row, thresholds in shared.items()
    )


def _piece(
    study: Tradeoff, choice: Choice, aim: str, errors: tuple[np.ndarray, np.ndarray], said: dict[int, str]
) -> str:
    """Return the piece of advice for a choice, by errors without and with margins; `said` has the settings whose
    options were given before, with what for, and is extended."""
    thresholds, row, surface = choice
    if row is None:
        lines = [f"For {aim} no setting is good enough{_nearest(study, *errors, thresholds)}."]
    else:
        lines = [f"For {aim} take {_name(study, row)}: {_price(study, row)}"]
        if row in said:
            lines[0] += f", as for {said[row]}."
        elif study.flags[row]:
            lines = [f"{lines[0]}:", study.flags[row]]
        said.setdefault(row, aim)
    if surface is not None:
        verb, runs = "would do" if row is None else "does it too", study.columns["nodes"][surface]
        lines.append(f"A response surface through {runs} {study.reference_runs} {verb}: {_price(study, surface)}.")
    return "\n".join(lines)


def _name(study: Tradeoff, row: int) -> str:
    return f"the scene as it is ({study.name(row)})" if not study.flags[row] else study.name(row)


def _nearest(study: Tradeoff, errors: np.ndarray, bounds: np.ndarray, thresholds: tuple[float, ...]) -> str:
    known = study.simulated & study.own_mesh & np.isfinite(errors)
    if not known.any():
        return ": none could be measured"
    row = int(np.argmin(np.where(known, errors, np.inf)))
    more = f", {share_text(bounds[row])} with the margin below" if errors[row] <= max(thresholds) else ""
    return f"; the best is {study.name(row)}, with {share_text(errors[row])}{more}"


def _price(study: Tradeoff, row: int) -> str:
    online, offline = study.times.batch[row], study.times.offline[row]
    after = {"full": "preparation", "components": "condensing", "reduced": "build"}.get(study.families[row], "runs")
    total = study.total_seconds(study.samples)[row]
    together = f"{total:.3g} s for {study.samples} samples"
    return f"{1e3 * online:.2g} ms a sample after {offline:.2g} s of {after} ({together})"


def _break_even(study: Tradeoff, target: str, errors: np.ndarray) -> Iterator[str]:
    """Say from how many samples on which setting is the cheapest one that is good enough, build included, by the errors
    of every setting in a target, shape (n,)."""
    for threshold in THRESHOLDS:
        pieces = envelope(study, errors, threshold)
        if len(pieces) > 1:
            later = "; ".join(f"from {n} samples on, take {_name(study, row)}" for n, row in pieces[1:])
            few = f"below {pieces[1][0]} samples take {_name(study, pieces[0][1])}"
            yield f"{100 * threshold:g} % in {target}: {few}; {later}."


def _model_sentences(study: Tradeoff, target: str, errors: np.ndarray) -> Iterator[str]:
    """Say which model to take: the cheapest setting of each that is good enough, and how many times dearer it is
    online, by the errors of every setting in a target, shape (n,)."""
    families, total = np.array(study.families), study.total_seconds(study.samples)
    for threshold in THRESHOLDS:
        each = {name: cheapest(study, errors, threshold, study.own_mesh & (families == name)) for name in MODELS}
        found = sorted((row for row in each.values() if row is not None), key=total.__getitem__)
        if len(found) < 2:
            continue
        least, online = found[0], study.times.batch
        others = [
            f"{MODELS[study.families[row]]} {online[row] / online[least]:.2g} times that ({study.name(row)})"
            for row in found[1:]
        ]
        none = [title for name, title in MODELS.items() if each[name] is None and (families == name).any()]
        yield (
            f"Which model, for {100 * threshold:g} % in {target}: {MODELS[study.families[least]]}, "
            f"{1e3 * online[least]:.2g} ms a sample; {', '.join(others)}"
            + (f"; {' and '.join(none)} not at any setting tried." if none else ".")
        )


def envelope(study: Tradeoff, errors: np.ndarray, threshold: float) -> list[tuple[int, int]]:
    """Return from how many samples on which simulation is the cheapest one that is good enough: pairs of the number of
    samples and the setting, beginning with one sample; none where nothing is good enough."""
    offline, online = study.times.offline, study.times.batch
    good = study.simulated & study.own_mesh & (errors <= threshold) & np.isfinite(offline) & np.isfinite(online)
    rows = np.flatnonzero(good)
    if not rows.size:
        return []
    return [(n, int(rows[row])) for n, row in cheapest_from(offline[rows], online[rows])]


def _surface_sentences(study: Tradeoff) -> Iterator[str]:
    if (~study.simulated & np.isfinite(study.errors).any(axis=1)).any():
        yield (
            "A response surface holds for these loads, this start and these outputs, between its runs over "
            f"{_joined(list(study.varied))}; anything else needs new runs, and every further parameter many more."
        )


def _size_sentences(study: Tradeoff, known: Sizes | None) -> Iterator[str]:
    """Say where shares are of nothing, or of a value that is much smaller than at other test values."""
    for name, sizes in zip(study.outputs, () if known is None else known.reference):
        least, most = int(np.argmin(sizes)), float(np.max(sizes, initial=0.0))
        if most == 0.0:
            yield f"{name} is zero to round-off in the reference: settings that give as little have no error in it."
        elif sizes[least] < SMALL * most:
            unit, system, of = study.units[name], study.record.system, study.parameter_units
            small = (
                f"at most {with_unit(*system.named(sizes[least], unit), 2)}" if sizes[least] else "zero to round-off"
            )
            values = ", ".join(
                f"{one} = {system.shown(study.test_values[one][least], of[one]):.3g}" for one in study.varied
            )
            yield (
                f"{name} is {small} at test value {least + 1} of {len(sizes)} ({values}), and up to "
                f"{with_unit(*system.named(most, unit), 2)} at others: errors are in per cent of each, and the largest "
                "may be there."
            )


def _mesh_sentences(study: Tradeoff, sizes: Sizes | None) -> Iterator[str]:
    mesh, own = study.mesh, study.own_mesh & study.simulated
    if not mesh.cells.size:
        yield "What finer meshes would change was not measured: those of continuum cells are not cut."
    if not mesh.cells.size or not own.any():
        return
    best = np.min(np.where(np.isnan(study.errors[own]), np.inf, study.errors[own]), axis=0)
    worse = [
        f"{share_text(error)} in {name}{_apart(study, sizes, column)}"
        for column, (name, error, floor) in enumerate(zip(study.outputs, mesh.errors[0], best))
        if error > floor
    ]
    if worse:
        yield (
            f"The scene's meshes themselves are off by {_joined(worse)}, against cells cut into {mesh.refinement[-1]}; "
            "where that matters, refine them before anything else."
        )


def _apart(study: Tradeoff, sizes: Sizes | None, column: int) -> str:
    """Return what the own meshes are off by in an output's unit, and at which test value."""
    if sizes is None or sizes.meshes is None:
        return ""
    worst, apart = sizes.meshes[column]
    at = f" at test value {worst + 1}" if study.varied else ""
    return f" ({with_unit(*study.record.system.named(apart, study.units[study.outputs[column]]), 2)}{at})"


def _reference_sentences(study: Tradeoff) -> Iterator[str]:
    own = study.references.refinement == 1
    if not own.any():
        return
    moved = study.references.moved[own][0]
    poor = [
        f"{share_text(move)} in {name}"
        for name, move, errors in zip(study.outputs, moved, study.errors[study.own_mesh].T)
        if np.isfinite(errors).any() and move > NOT_KNOWN * np.nanmin(errors)
    ]
    if poor:
        moved_by = f"halving its step the last time moved it by {_joined(poor)}"
        yield f"The reference is not settled: {moved_by}; errors that small are not known."


def _joined(words: Sequence[str]) -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"
