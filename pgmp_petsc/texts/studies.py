"""Texts on derivatives, fits, designs and trade-off studies; need no PETSc, so that `pgmp info` shows them too."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from pgmp_petsc.base.errors import Remark, counted
from pgmp_petsc.base.units import behind
from pgmp_petsc.results.gradients import Derivatives, Design, Figure, Fit
from pgmp_petsc.results.numbers import ROUND_OFF, VANISHING, interval_text, percent, plain, share_text, sizes_of
from pgmp_petsc.results.tradeoff import Tradeoff
from pgmp_petsc.texts.models import closing

WIDTH = 118
REASONS_SHOWN = 5
NOTHING = 1e-9  # share of what a constraint had at the start


def report_of_derivatives(found: Derivatives, path: Path, said: Sequence[Remark] = ()) -> str:
    """Return what each parameter does to each figure, and all remarks."""
    lines = [f"{path}: {len(found.time) - 1} steps to {found.time[-1]:g} s", *lines_of(found)]
    return "\n".join([*lines, *closing(found.record, said)])


def report_of_fit(found: Fit, path: Path, said: Sequence[Remark] = ()) -> str:
    missing = {name: int(np.isnan(own.measured).sum()) for name, own in found.outputs.items()}
    gaps = ", ".join(f"{name} {n}" for name, n in missing.items() if n)
    first = f"{path}: {len(found.time)} instants of {', '.join(found.outputs)}, {counted(found.n_runs, 'run')}"
    first += f"; not measured there: {gaps}" if gaps else ""
    return "\n".join([first, *fit_lines(found), *closing(found.record, said)])


def report_of_design(found: Design, path: Path, said: Sequence[Remark] = ()) -> str:
    first = f"{path}: {counted(len(found.tried), 'design')} of {counted(found.n_samples, 'run')} each"
    return "\n".join([first, *design_lines(found), *closing(found.record, said)])


def lines_of(found: Derivatives) -> Iterator[str]:
    """Yield the table of effects, the largest first."""
    yield "  what a change of each parameter does, to first order"
    width = max(4, *(len(_named(found.units.get(output, "1"))) for output in found.outputs))
    yield f"  {'':24s}{'':11s}{'value':>14s}{'':{width + 3}s}{'':20s}{'change':>14s}  derivative"
    sizes = sizes_of(found.outputs, found.units)
    for output, values in found.outputs.items():
        # derivatives have 3e-9 of themselves
        shown, none = output, max(ROUND_OFF * sizes[output], VANISHING * float(np.max(np.abs(values), initial=0.0)))
        for figure in found.figures(output):
            yield from _rows(found, output, figure, shown, none, width)
            shown = ""
    for name, (change, what) in found.changes.items():
        yield f"  {name:24s}{'changes by':11s}{change:14.5g}{behind(found.units.get(name, '1'))}, {what}"


def _rows(found: Derivatives, output: str, figure: Figure, shown: str, none: float, width: int) -> Iterator[str]:
    """Yield the rows of a figure, without effects that are `none`: round-off."""
    unit = f"{_named(found.units.get(output, '1')):{width}s}"
    effects = found.effects(figure)
    value = f"{shown:24s}{figure.name:11s}{figure.value if abs(figure.value) > none else 0.0:14.6g} {unit}"
    felt = [place for place in np.argsort(-np.abs(effects), kind="stable") if abs(effects[place]) > none]
    for place in felt:
        name = found.parameters[place]
        slope = f"{figure.derivatives[place]:.6g}{behind(found.unit(output, name))}"
        yield f"  {value}  {name:20s}{effects[place]:+14.5g} {unit} {slope}".rstrip()
        value = " " * len(value)
    if len(felt) < len(effects):
        idle = ", ".join(name for place, name in enumerate(found.parameters) if place not in felt)
        yield f"  {value}  nothing with {idle}"
    if felt and np.count_nonzero(np.diag(found.correlation)) > 1:
        together = found.deviation(figure)
        blank = " " * len(value)
        yield f"  {blank}  {'together':20s}{together:14.5g} {unit} standard deviation of all distributions".rstrip()


def _named(unit: str) -> str:
    return "" if unit == "1" else unit


def fit_lines(found: Fit) -> Iterator[str]:
    """Yield the parameters with their standard errors, their correlations, and the noise of the outputs."""
    yield f"  {'':24s}{'estimate':>14s}{'standard error':>18s}{'':12s}{'began at':>14s}  searched in"
    for p in found.parameters:
        share = f"({share_text(p.error / abs(p.estimate))})" if np.isfinite(p.error) and p.estimate else ""
        limits = f"[{p.lower:.5g}, {p.upper:.5g}]{behind(p.unit)}"
        error = f"{p.error:18.3g}" if np.isfinite(p.error) else f"{'not identifiable':>18s}"
        yield f"  {p.name:24s}{p.estimate:14.7g}{error}{share:>12s}{p.start:14.5g}  {limits}".rstrip()
    names = [p.name for p in found.parameters]
    pairs = [(j, k) for j in range(len(names)) for k in range(j) if np.isfinite(found.correlation[j, k])]
    for number, (j, k) in enumerate(pairs):
        yield f"  {'correlation' if number == 0 else '':24s}{found.correlation[j, k]:+14.4f}  {names[k]}, {names[j]}"
    for name, output in found.outputs.items():
        left = float(np.sqrt(np.nanmean((output.fitted - output.measured) ** 2)))
        begun = float(np.sqrt(np.nanmean((output.begun - output.measured) ** 2)))
        noise = f"its noise is {output.noise:.3g}{behind(output.unit)}" if output.noise_given else "taken for its noise"
        yield f"  {name:24s}{left:14.4g}{behind(output.unit)} left of {begun:.4g}; {noise}"


def design_lines(found: Design) -> Iterator[str]:
    """Yield goal, constraints and parameters of a design."""
    robust = ""
    if found.deviations is not None:
        of = f"{percent(found.confidence)} interval of mean and {found.deviations:g} deviations"
        robust = f" {interval_text(found.goal_interval)}, {of}"
    yield f"  {'':40s}{'at the start':>14s}{'design':>14s}"
    yield f"  {found.goal:40s}{found.goal_start:14.6g}{found.goal_value:14.6g}{behind(found.goal_unit)}{robust}"
    for constraint in found.constraints:
        how = "just met" if constraint.active else "missed" if constraint.value > 0.0 else "met"
        # of what is just met nothing but round-off is left
        met = constraint.active and abs(constraint.value) < NOTHING * abs(constraint.start)
        ends = (constraint.start, 0.0 if met else constraint.value)
        begun, now = (f"{value:+14.4g}" if value else f"{'0':>14s}" for value in ends)
        now += behind(constraint.measure)
        now += "" if constraint.interval is None else f" {interval_text(np.array(constraint.interval))}"
        yield f"  {constraint.text:40s}{begun}{now}  {how} (missed by; negative: room to spare)"
    for p in found.parameters:
        yield f"  {p.name:40s}{p.start:14.6g}{p.value:14.6g}{behind(p.unit)}, of [{p.lower:.5g}, {p.upper:.5g}]"


def report_of_tradeoff(study: Tradeoff, path: Path, said: Sequence[Remark] = ()) -> str:
    """Return what was measured, the advice, and all remarks."""
    n_values = len(next(iter(study.test_values.values()), (0,)))
    where = f"{n_values} values of {', '.join(study.varied)}" if study.varied else "the scene's values"
    first = f"{path}: {len(study.families)} settings, errors at {where}, {study.record.ranks} rank(s)"
    return "\n".join([first, summary(study), *closing(study.record, said)])


def summary(study: Tradeoff) -> str:
    """Return the table of the settings that matter, what the reference and the mesh are worth, and the advice."""
    lines = [*_table(study), "", *_reference(study), *_mesh(study), *_failures(study)]
    lines += ["", *(line for advice in study.advice for line in _wrapped(advice))]
    return "\n".join(lines)


def shown_rows(study: Tradeoff) -> list[int]:
    """Return the fronts, the scene's own setting and the full order with the scene's step, the cheapest first."""
    chosen = study.pareto.any(axis=1)
    step = study.columns["step"][0]
    for row, family in enumerate(study.families):
        as_scene = family in ("full", "components") and study.columns["step"][row] == step
        chosen[row] |= row == 0 or family == "surface" or as_scene
    rows = np.flatnonzero(chosen & np.isfinite(study.times.batch))
    return rows[np.argsort(study.times.batch[rows], kind="stable")].tolist()


def _table(study: Tradeoff) -> list[str]:
    header = ["", "setting", *(name for name in study.outputs)]
    header += ["offline s", "online ms", "alone ms", f"{study.samples} in s"]
    front, total = study.pareto, study.total_seconds(study.samples)
    body = []
    for row in shown_rows(study):
        known = zip(study.errors[row], ["*" if on_front else " " for on_front in front[row]])
        errors = [f"{plain(100 * error)}{mark}" if np.isfinite(error) else "- " for error, mark in known]
        times = [study.times.offline[row], 1e3 * study.times.batch[row], 1e3 * study.times.single[row], total[row]]
        body.append([">" if row == 0 else "", study.name(row), *errors, *(plain(value, 3) for value in times)])
    columns = [
        [f"{text:{'<' if number < 2 else '>'}{max(map(len, column))}}" for text in column]
        for number, column in enumerate(zip(header, *body))
    ]
    aligned = ["  ".join(line).rstrip() for line in zip(*columns)]
    front = "* on the front of its family: none is both cheaper online and better; > the scene as it is"
    legend = f"Largest errors in % of the output's largest value; {front}. Online: a sample of {study.batch} together."
    busy = f"The machine was busy: the timed runs took {study.waiting:.2g} times their processor time."
    busy = f"{busy} Times are processor times, which a quiet machine takes." if study.busy else ""
    return [*aligned, *textwrap.wrap(legend, WIDTH), *textwrap.wrap(busy, WIDTH)]


def _reference(study: Tradeoff) -> list[str]:
    """Say how fine the references are, and by how much they still moved."""
    at = study.references
    lines = [study.reference] if study.reference else []
    for refinement, step, moved, reason in zip(at.refinement, at.step, at.moved, at.reason):
        mesh = "the scene's meshes" if refinement == 1 else f"cells cut into {refinement}"
        model = "component model" if study.reference_model == "components" else "full order"
        how_fine = f"{model}, {1e3 * step:.4g} ms; moved last by {_errors(study, moved)}"
        lines.append(f"reference, {mesh}: {how_fine}; {reason}")
    return [wrapped for line in lines for wrapped in textwrap.wrap(line, WIDTH, subsequent_indent="  ")]


def _mesh(study: Tradeoff) -> list[str]:
    """Return the discretisation errors, not part of the others."""
    mesh = study.mesh
    if not mesh.cells.size:
        return ["mesh error: not measured; meshes of continuum cells are not cut"]
    rows = zip(mesh.cells[:-1], mesh.errors[:-1])
    lines = [f"mesh error, {cells} cells: {_errors(study, errors)}" for cells, errors in rows]
    return [*lines, f"  against {mesh.cells[-1]} cells; not part of the errors above"]


def _failures(study: Tradeoff) -> list[str]:
    failed = [row for row, reason in enumerate(study.reasons) if reason]
    # a setting with times only cost too much to be run to its end
    what = ["not run" if np.isfinite(batch) else "failed" for batch in study.times.batch]
    lines = [f"{what[row]}: {study.name(row)}: {study.reasons[row]}" for row in failed[:REASONS_SHOWN]]
    if len(failed) > REASONS_SHOWN:
        lines.append(f"without errors: {len(failed) - REASONS_SHOWN} more; see /settings/reason")
    return [wrapped for line in lines for wrapped in textwrap.wrap(line, WIDTH, subsequent_indent="  ")]


def _errors(study: Tradeoff, errors: np.ndarray) -> str:
    return ", ".join(f"{name} {share_text(error)}" for name, error in zip(study.outputs, errors))


def _wrapped(advice: str) -> list[str]:
    """Wrap a piece of advice; options to paste stay on one line, however long."""
    lines: list[str] = []
    for line in advice.splitlines():
        wrapped = textwrap.wrap(line, WIDTH, initial_indent="  " if lines else "", subsequent_indent="  ")
        lines += [f"    {line}"] if line.startswith("--") else wrapped
    return lines
