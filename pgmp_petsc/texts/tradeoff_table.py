"""A trade-off study on the terminal; needs no PETSc, so that `pgmp info` shows it too."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pgmp_petsc.results.numbers import plain, share_text
from pgmp_petsc.results.tradeoff import Tradeoff
from pgmp_petsc.texts.models import closing

if TYPE_CHECKING:
    from pgmp_petsc.base.errors import Remark

WIDTH = 118
REASONS_SHOWN = 5


def report(study: Tradeoff, path: Path, said: Sequence[Remark] = ()) -> str:
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
    """Return the aligned table: a setting a line, times last."""
    header = ["", "setting", *(name.replace("_", " ") for name in study.outputs)]
    header += ["offline s", "online ms", "alone ms", f"{study.samples} in s"]
    front, total = study.pareto, study.total_seconds(study.samples)
    body = []
    for row in shown_rows(study):
        marks = ["*" if on_front else " " for on_front in front[row]]
        known = zip(study.errors[row], marks)
        errors = [f"{plain(100 * error)}{mark}" if np.isfinite(error) else "- " for error, mark in known]
        times = [study.times.offline[row], 1e3 * study.times.batch[row], 1e3 * study.times.single[row], total[row]]
        own = ">" if row == 0 else ""
        body.append([own, study.name(row), *errors, *(plain(value, 3) for value in times)])
    widths = [max(len(line[column]) for line in [header, *body]) for column in range(len(header))]
    aligned = [
        "  ".join(
            text.ljust(width) if column < 2 else text.rjust(width)
            for column, (text, width) in enumerate(zip(line, widths))
        ).rstrip()
        for line in [header, *body]
    ]
    legend = (
        "Largest errors in % of the output's largest value; * on the front of its family: none is both cheaper online "
        f"and better; > the scene as it is. Online: a sample of {study.batch} together."
    )
    busy = (
        f"The machine was busy: the timed runs took {study.waiting:.2g} times their processor time. Times are "
        "processor times, which a quiet machine takes."
    )
    return [*aligned, *textwrap.wrap(legend, WIDTH), *textwrap.wrap(busy if study.busy else "", WIDTH)]


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
    return [
        f"mesh error, {cells} cells: {_errors(study, errors)}"
        for cells, errors in zip(mesh.cells[:-1], mesh.errors[:-1])
    ] + [f"  against {mesh.cells[-1]} cells; not part of the errors above"]


def _failures(study: Tradeoff) -> list[str]:
    """List the settings that failed, with their reasons."""
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
    lines = []
    for line in advice.splitlines():
        first = "  " if lines else ""
        lines += (
            [f"    {line}"]
            if line.startswith("--")
            else textwrap.wrap(line, WIDTH, initial_indent=first, subsequent_indent="  ")
        )
    return lines
