"""Which setting to take: the cheapest one measured that meets an error, in words and as options to paste.

Cheap is what takes the least time for the study's number of samples, build included. Settings on refined meshes are
left out, because their errors are against another reference. Errors are the largest at some test values: a setting
meets an error with a margin for other draws, and with what the reference itself may be off by: its last move, and its
distance from the mesh where it is another model.

Before anything is measured, which model to take: what steps and builds of the mesh, of component modes and of a reduced
model take, predicted from sizes, and from how many samples on which is the cheapest.

Times are processor times of a step of one sample in a batch that fills the lanes; `python -m benchmarks.prices`
measures them beside what is predicted. Over n coordinates a step of a reduced model makes ``4^n`` coefficients of each
entry. Bodies in floating frames keep as many fields as modes are asked for, and the static answers of their joints.

Errors are those that were measured of deformations in the scenes of this project (docs/components.md, docs/costs.md): a
prediction is of their size, and `pgmp tradeoff` measures those of a scene.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from pgmp_petsc.bench.finished import BESIDE, component_step, duration_text, step_of_samples, step_seconds
from pgmp_petsc.bodies.shape import BodyShape
from pgmp_petsc.full.joint_tree import count_of
from pgmp_petsc.mechanism.capabilities import SECONDS, SECONDS_PER_UNKNOWN, Purpose, why_refused
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.models.lengths import why_of_one_mesh
from pgmp_petsc.outputs.stress import points_of
from pgmp_petsc.results.numbers import share_text, with_unit
from pgmp_petsc.results.tradeoff import Tradeoff
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.parameters import uncertain_names
from pgmp_petsc.scene.references import points_used

# s, of a step of a sample of a reduced model: by itself, an entry of its matrices over one coordinate, a local effect
REDUCED_SAMPLE, REDUCED_ENTRY, REDUCED_EFFECT = 1.0e-7, 2.0e-9, 3.0e-7
# s, of a step of a sample in a batch: friction by the force that a joint carries, of components and reduced; a
# controller, of reduced models
CARRIED_BESIDE, CARRIED_IN_LANES, CONTROLLED_IN_LANES = 2e-4, 4.5e-6, 1e-6
MODEL = 0.6  # s, of a build besides its configurations
CONDENSING, CONDENSING_POWER = 9e-6, 1.3  # s, of a body of cells by its unknowns; measured from 5,850 to 298,134
STRAIN = 1.6e-8  # s, of a strain at a point of a body of cells, from some 80 coordinates of the body condensed
GOOD = 0.01  # share of a deformation up to which an error is small
MANY = 10_000  # samples that a choice is said for


@dataclass(frozen=True)
class Prospect:
    """A model of a scene, as far as it can be told before anything is solved."""

    model: str  # mesh, components or reduced
    refused: str = ""  # why the scene has none; the rest is then 0
    unknowns: int = 0  # of a step
    build: float = 0.0  # s, before the first sample
    step: float = 0.0  # s, of a step of a sample in a batch
    error: float = 0.0  # of a deformation, as a share
    why: str = ""  # which error that is

    @property
    def text(self) -> str:
        """The model in words."""
        if self.refused:
            return f"{self.model}: refused, {self.refused}"
        before = f", {duration_text(self.build)} before the first sample" if self.build else ""
        step = f"{_microseconds(self.step)} us a step and sample"
        return f"{self.model}: {self.unknowns} unknowns, {step}{before}; {self.why}"


def prospects(
    scene: Scene, meshes: Mapping[str, BodyShape], mechanism: Mechanism, n_flexible: int, n_loads: int
) -> list[Prospect]:
    """Return what is predicted of the mesh, of component modes and of a reduced model.

    Parameters
    ----------
    mechanism
        Of the scene's meshes.
    n_flexible, n_loads
        Flexible coordinates of the reduced model, and load patterns that static modes could answer.
    """
    n_local = sum(effect.local for effect in scene.effects.values())
    n_rigid, fields = len(scene.coordinates), amplitudes(scene, mechanism, scene.reduction.modes)
    answered = scene.reduction.static_modes or not n_loads or scene.reduction.tolerance is not None
    besides, n_carried = STRAIN * n_strains(scene, mechanism), len(scene.carried)
    of_components = component_step(mechanism, fields) + CARRIED_BESIDE * n_carried + besides
    of_components += BESIDE * len(scene.controllers)
    in_lanes = CARRIED_IN_LANES * n_carried + CONTROLLED_IN_LANES * len(scene.controllers) + besides
    share = "0.1 to 1 % of deformations, with static answers to loads"
    if not answered:
        share = "1 to 6 % of deformations, without static answers to loads (reduction.static_modes)"
    found = [
        Prospect(
            "mesh", why_refused(scene, Purpose.FULL, meshes), mechanism.n_dofs, 0.0,
            step_of_samples(scene, step_seconds(mechanism)), 0.0, "errors are those of the elements and of the step",
        ),
        Prospect(
            "components",
            why_refused(scene, Purpose.COMPONENTS, meshes) or why_of_one_mesh(scene, uncertain_names(scene)),
            sum(fields.values()) + sum(count_of(mechanism)), condensing(mechanism),
            step_of_samples(scene, of_components), 0.002, "0.002 to 0.8 % of deformations",
        ),
        Prospect(
            "reduced", why_refused(scene, Purpose.BUILD, meshes), n_flexible + n_rigid, build_seconds(scene, mechanism),
            reduced_step(n_flexible + n_rigid, n_rigid, n_local) + in_lanes, 0.005 if answered else 0.03, share,
        ),
    ]  # fmt: skip
    return [Prospect(one.model, one.refused) if one.refused else one for one in found]


def _microseconds(seconds: float) -> str:
    return f"{float(f'{1e6 * seconds:.2g}'):g}"


def choice(scene: Scene, meshes: Mapping[str, BodyShape], found: Sequence[Prospect], n_steps: int) -> str:
    """Return which model to take for how many samples of so many steps, in words; among those whose error is small."""
    good = [one for one in found if not one.refused and one.error <= GOOD]
    compared = not why_refused(scene, Purpose.TRADEOFF, meshes)
    if not good:
        return "no model is predicted to be good enough" + ("; pgmp tradeoff measures them" if compared else "")
    offline, online = (np.array([getattr(one, name) for one in good]) for name in ("build", "step"))
    pieces = cheapest_from(offline, n_steps * online)
    names = [good[row].model for _, row in pieces]
    counts = [f"from {n:.2g} samples on" if n >= MANY else f"from {n} samples on" for n, _ in pieces[1:]]
    said = [names[0], *(f"{name} {count}" for name, count in zip(names[1:], counts))]
    row = [row for n, row in pieces if n <= MANY][-1]
    many = duration_text(offline[row] + MANY * n_steps * online[row])
    left = [one.model for one in found if not one.refused and one.error > GOOD]
    return (
        f"{', '.join(said)}; {MANY} samples of {n_steps} steps are predicted to take {many} with {good[row].model}"
        + (f"; {', '.join(left)} is left out by its error" if left else "")
        + ("; pgmp tradeoff measures times and errors" if compared else "")
    )


def cheapest_from(offline: np.ndarray, online: np.ndarray) -> list[tuple[int, int]]:
    """Return from how many samples on which way is the cheapest: pairs of the number of samples and the way, beginning
    with one sample, of what ways take before and for each sample, shape (n,), s; of as cheap ones the first."""
    n, pieces = 1, []
    while True:
        now = int(np.lexsort((online, offline + n * online))[0])
        pieces.append((n, now))
        cheaper = np.flatnonzero(online < online[now])
        if not cheaper.size:
            return pieces
        # where the lines cross: the first whole number of samples at which the cheaper one is
        crossing = (offline[cheaper] - offline[now]) / (online[now] - online[cheaper])
        n = int(np.floor(crossing.min())) + 1


def amplitudes(scene: Scene, mechanism: Mechanism, n_modes: int) -> dict[str, int]:
    """Return how many amplitudes flexible bodies in floating frames are predicted to have for so many modes."""
    found = {}
    for body in mechanism.bodies:
        if body.flexible:
            rigid = body.dimension * (body.dimension + 1) // 2
            free = (body.dofs.size if not body.to_condense else body.n_internal) - rigid
            found[body.name] = max(min(n_modes + rigid * len(points_used(scene, body.name)), free), 0)
    return found


def n_strains(scene: Scene, mechanism: Mechanism) -> int:
    """Return how many strains of bodies of cells the stress outputs of an instant are found from."""
    bodies, found = {body.name: body for body in mechanism.bodies if body.to_condense}, 0
    for name, entry in scene.outputs.items():
        if "stresses" in entry.reads and entry.body in bodies:
            body = bodies[entry.body]
            points = points_of(f"outputs.{name}", entry, body.stresses(scene))
            found += points.n_points * body.dimension * (body.dimension + 1) // 2
    return found


def reduced_step(n: int, n_rigid: int, n_local: int = 0) -> float:
    """Return the predicted processor time of a step of a sample of a reduced model with n coordinates in all, of which
    some are rigid, and so many local effects."""
    return REDUCED_SAMPLE + REDUCED_EFFECT * n_local + REDUCED_ENTRY * n**2 * 4.0 ** (n_rigid - 1)


def condensing(mechanism: Mechanism) -> float:
    """Return the predicted processor time of condensing all bodies of cells, s."""
    return sum(CONDENSING * body.n_internal**CONDENSING_POWER for body in mechanism.bodies if body.to_condense)


def build_seconds(scene: Scene, mechanism: Mechanism) -> float:
    """Return the predicted processor time of the build of a reduced model, s; bodies of cells are condensed first."""
    n_unknowns = sum(body.dofs.size for body in mechanism.bodies if not body.to_condense)
    n_configurations = scene.reduction.angles ** len(scene.coordinates)
    return MODEL + condensing(mechanism) + n_configurations * (SECONDS + SECONDS_PER_UNKNOWN * n_unknowns)


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
            aim = f"{_joined([f'{100 * threshold:g} %' for threshold in choice.thresholds])} in {_joined(names)}"
            advice.append(_piece(study, choice, aim, targets[names[0]], said))
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
    """Say by how much errors stay below what is asked for."""
    if study.varied:
        n = len(next(iter(study.test_values.values())))
        yield (
            f"Errors are the largest at {n} test values; a setting meets an error where {MARGIN:g} times as much does, "
            "with the last move of the reference: other draws may be worse."
        )
    if from_mesh:
        apart = _joined([f"{share_text(error)} in {name}" for name, error in from_mesh.items()])
        yield f"The reference is {apart} away from the mesh; a setting meets an error with that added."


@dataclass(frozen=True)
class Choice:
    """The cheapest settings that meet some errors: of the models and of the response surfaces; None where none does."""

    thresholds: tuple[float, ...]
    row: int | None
    surface: int | None


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
        Choice(tuple(thresholds), row, cheapest(study, errors, min(thresholds), ~study.simulated))
        for row, thresholds in shared.items()
    )


def _piece(study: Tradeoff, choice: Choice, aim: str, errors: np.ndarray, said: dict[int, str]) -> str:
    """Return the piece of advice for a choice; `said` has the settings whose options were given before, with what for,
    and is extended."""
    row = choice.row
    if row is None:
        lines = [f"For {aim} no setting is good enough{_nearest(study, errors)}."]
    else:
        lines = [f"For {aim} take {_name(study, row)}: {_price(study, row)}"]
        if row in said:
            lines[0] += f", as for {said[row]}."
        elif study.flags[row]:
            lines = [f"{lines[0]}:", study.flags[row]]
        said.setdefault(row, aim)
    if choice.surface is not None:
        verb = "would do" if row is None else "does it too"
        runs = study.columns["nodes"][choice.surface]
        lines.append(
            f"A response surface through {runs} {study.reference_runs} {verb}: {_price(study, choice.surface)}."
        )
    return "\n".join(lines)


def _name(study: Tradeoff, row: int) -> str:
    return f"the scene as it is ({study.name(row)})" if not study.flags[row] else study.name(row)


def _nearest(study: Tradeoff, errors: np.ndarray) -> str:
    known = study.simulated & study.own_mesh & np.isfinite(errors)
    if not known.any():
        return ": none could be measured"
    row = int(np.argmin(np.where(known, errors, np.inf)))
    return f"; the best is {study.name(row)}, with {share_text(errors[row])}"


def _price(study: Tradeoff, row: int) -> str:
    """Return ``1.2 ms a sample after 0.7 s``."""
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


MODELS = {"full": "the mesh", "components": "component modes", "reduced": "the reduced model"}


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
    """Say where the mesh is worse than the best settings on it."""
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
    """Say where the reference is no better than the errors that are asked for."""
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
