"""Texts on single runs, reduced models and tables of frequencies.

Texts on estimated errors, on how far runs left small deformations, and on their balance of energy; and how
every report ends.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pgmp_petsc.base.errors import counted
from pgmp_petsc.base.units import behind
from pgmp_petsc.results.estimates import OF_STEP
from pgmp_petsc.results.numbers import ROUND_OFF, axis_unit, plain, share_text, sizes_of

if TYPE_CHECKING:
    from pgmp_petsc.base.errors import Remark
    from pgmp_petsc.files.hdf5 import RunRecord
    from pgmp_petsc.models.component_file import ComponentsFile
    from pgmp_petsc.reduction.rom import ReducedOrderModel
    from pgmp_petsc.results import Ensemble, EstimatedErrors, ModesTable, Trajectory
    from pgmp_petsc.studies.building import Built

SHOWN = 6
IN_LINE = 3  # outputs in the first line of a run: the last ones of the scene
LARGEST = 24  # characters of the column of largest values
NOTHING = 1e-6  # of a mode's highest frequency


def report_of_run(trajectory: Trajectory, path: Path, said: Sequence[Remark] = ()) -> str:
    """Return the outputs at the end and their largest values, estimated errors and validity of a reduced run, and all
    remarks."""
    lines = [""]
    lines += [f"  {'':24s}{'at the end':>16s}{'largest by size':>{LARGEST}s}"] if trajectory.outputs else []
    length = 0.0 if trajectory.frames is None else trajectory.frames.extent
    sizes, peaks = sizes_of(trajectory.outputs, trajectory.units, length), list[str]()
    for name, values in trajectory.outputs.items():
        values = np.where(np.abs(values) <= ROUND_OFF * sizes[name], 0.0, values)
        factor, unit = axis_unit(trajectory.units[name], values)
        end = f"{factor * values[-1]:16.8g}{behind(unit)}"
        known = np.abs(np.nan_to_num(values))
        most = int(np.argmax(known))
        width = max(9, LARGEST + 16 - len(end))
        largest = f"{factor * values[most]:>{width}.5g} at {trajectory.time[most]:.4g} s"
        lines.append(f"  {name:24s}{end}{largest if np.isfinite(values).any() else ''}")
        if np.isfinite(values).any():
            peaks.append(f"{name} {factor * values[most]:.4g}{behind(unit)}")
    first = f"{path}: {trajectory.model} model, {len(trajectory.time) - 1} steps to {trajectory.time[-1]:g} s"
    more = f", and {len(peaks) - IN_LINE} more" if len(peaks) > IN_LINE else ""
    lines[0] = f"{first}; at most {', '.join(peaks[-IN_LINE:])}{more}" if peaks else first
    lines += of_run(trajectory)
    # why it stopped is the error that ends the command
    return "\n".join([*lines, *closing(trajectory.record, said, trajectory.why_stopped or "")])


def report_of_modes(table: ModesTable, path: Path, said: Sequence[Remark] = ()) -> str:
    """Return the range of every frequency, how far the reduced ones are from it, and all remarks."""
    places = f"{len(table.full_hz)} {'angles' if table.theta.ndim == 1 else 'configurations'}"
    first = table.full_hz[:, :1]
    answer = f"; lowest frequency {first.min():.5g} to {first.max():.5g} Hz" if first.size else ""
    lines = [f"{path}: {places}{answer}", "  mode     lowest Hz    highest Hz   reduced, largest difference"]
    for mode in range(min(SHOWN, table.full_hz.shape[1])):
        full = table.full_hz[:, mode]
        line = f"  {mode + 1:4d} {full.min():13.6g} {full.max():13.6g}"
        if table.reduced_hz is not None and mode < table.reduced_hz.shape[1]:
            # a mechanism on a spring has no stiffness at a dead centre: there is nothing to compare with
            some = np.abs(full) > NOTHING * np.max(np.abs(full))
            line += f" {np.max(np.abs(table.reduced_hz[some, mode] / full[some] - 1), initial=0.0):14.2e}"
        lines.append(line)
    return "\n".join([*lines, *closing(table.record, said)])


def report_of_build(made: Built | ComponentsFile, path: Path, said: Sequence[Remark] = ()) -> str:
    """Say what was built, what is doubtful about it, and what was chosen for tolerances."""
    if made.kind == "components":
        counts = ", ".join(f"{name} {n}" for name, n in made.n_amplitudes.items())
        return "\n".join([f"{path}: component model; amplitudes: {counts or 'none'}", *closing(made.record, said)])
    chosen = [] if made.selection is None else made.selection.lines(attempts=False)
    return "\n".join([report(made.rom, path, said), *chosen])


def report(rom: ReducedOrderModel, path: Path, said: Sequence[Remark] = ()) -> str:
    """Say what was built, and what is doubtful about it."""
    tables, (n, n_modes) = rom.tables, rom.frequencies_hz.shape
    low, high = rom.frequencies_hz[:, 0].min(), rom.frequencies_hz[:, -1].max()
    places = f"{n} {'angles' if tables.n_coordinates == 1 else 'configurations'}"
    n_mass, n_stiffness, n_load = (table.shape[1] for table in (tables.mass, tables.stiffness, tables.load))
    n_released, n_given = tables.unstrained.size, tables.n_given
    n_static = tables.n_modes - n_modes - n_released - rom.points.n_vectors - n_given
    counts = {"of elastic joints": n_released, "static": n_static, "of other parameters": rom.points.n_vectors}
    beside = "".join(f", {n} {what}" for what, n in (counts | {"of joints that are off": n_given}).items() if n)
    lines = [
        f"{path}: {places}, {n_modes} modes from {low:.4g} to {high:.4g} Hz{beside}",
        *points_report(rom),
        f"  tables: {n_mass} mass, {n_stiffness} stiffness and {n_load} load terms",
        f"  neighbouring spaces of modes agree to a cosine of {rom.cosines.min():.6f}",
    ]
    if tables.samples.n > n:
        lines.append("  one mode changes its sign after a turn: the tables cover two turns")
    return "\n".join([*lines, *closing(rom.record, said)])


def points_report(rom: ReducedOrderModel) -> list[str]:
    """Say where in the parameter space the basis has further modes."""
    if not rom.points.n_vectors:
        return []
    points = (", ".join(f"{name} = {value:.4g}" for name, value in point.items()) for point in rom.points.points)
    first, last = rom.points.missed[[0, -1]]
    missed = f"the basis misses {last:.2g} of the modes' energy norm instead of {first:.2g}"
    return [f"  modes at other parameters: {'; '.join(points)}", f"  at the worst parameters tried, {missed}"]


#: How the values of `VALIDITY` are written; those that are not known are left out.
WRITTEN = {
    "elastic_rotation": "largest elastic rotation {} rad",
    "elastic_strain": "elastic strain {}",
    "stiffness_gained": "stiffness of a mode gained {}",
    "stiffness_lost": "lost {} by forces in the bodies",
}

OF_REDUCED = "the reduction and the time step, not of the mesh (pgmp run)"


def closing(record: RunRecord, said: Sequence[Remark] = (), but: str = "") -> list[str]:
    """Return the last lines of a report: remarks but those that were `said` before and one that ends with `but`, and
    timings."""
    lines = [f"  {remark}" for remark in record.remarks if remark not in said and not (but and remark.text == but)]
    return [*lines, *(f"  {phase:28s}{seconds:12.2f} s" for phase, seconds in record.timings.items())]


def of_run(run: Trajectory) -> list[str]:
    """Return estimated errors and validity of a run; nothing where neither is known."""
    lines = [] if run.errors is None else of_trajectory(run.errors, run.units, run.time[-1])
    return [*lines, of_validity(run.validity)] if run.validity else lines


def of_trajectory(errors: EstimatedErrors, units: dict[str, str], end: float) -> list[str]:
    """Return a line an output; the run ends at `end`, s, and what is estimated perhaps before."""
    what = "the time step" if errors.what == OF_STEP else OF_REDUCED
    part = f"up to {errors.time[-1]:.4g} s only" if errors.end_before(end) else "over the run"
    lines = [f"  estimated errors {part}, of {what}"]
    for name in errors.outputs:
        lines.append(f"  {name:24s}{_error(errors.maximum(name), errors.share(name), units.get(name, '1'))}")
    return lines


def of_ensemble(ensemble: Ensemble) -> list[str]:
    """Return the same for the samples that were checked: median and largest; and the validity of all."""
    lines = []
    found = dict(_known(ensemble.errors))
    if found:
        n_checked = max(known.size for known in found.values())
        what = OF_REDUCED if ensemble.model == "reduced" else "the time step"
        lines.append(f"  estimated errors over the run, of {what}; {counted(n_checked, 'sample')}: median, largest")
        for name, known in found.items():
            s = ensemble.statistics.get(name)
            factor, unit = axis_unit(ensemble.units[name], known if s is None else np.append(s.quantiles, known))
            median, most = (f"{plain(factor * value):>14s}" for value in (np.median(known), np.max(known)))
            lines.append(f"  {name:24s}{median}{most}{behind(unit)}")
    worst = {name: float(known[np.argmax(np.abs(known))]) for name, known in _known(ensemble.validity)}
    return [*lines, of_validity(worst)] if worst else lines


def _known(columns: Mapping[str, np.ndarray]) -> Iterator[tuple[str, np.ndarray]]:
    """Yield what is known of each column, where anything is; one column at a time."""
    for name, values in columns.items():
        known = values[np.isfinite(values)]
        if known.size:
            yield name, known


def of_balance(ensemble: Ensemble) -> list[str]:
    """Return one line of the samples' balance of energy; none where it was not drawn up."""
    if not ensemble.balance:
        return []
    residual, exchanged = (ensemble.balance[name] for name in ("residual", "exchanged"))
    known = np.flatnonzero(np.isfinite(residual) & (exchanged > 0.0))
    if not known.size:
        return ["  balance of energy: no sample is fine and moves any energy"]
    shares = residual[known] / exchanged[known]
    worst = f"{share_text(shares.max())} at most (sample {int(known[np.argmax(shares)])})"
    return [
        f"  balance of energy: residual {share_text(np.median(shares))} of what is moved around in the median, {worst}"
    ]


def of_validity(validity: Mapping[str, float]) -> str:
    """Return one line of how far a run, or the worst of several, left small deformations."""
    known = {name: value for name, value in validity.items() if np.isfinite(value)}
    return "  " + ", ".join(text.format(f"{known[name]:.2g}") for name, text in WRITTEN.items() if name in known)


def _error(maximum: float, share: float, unit: str) -> str:
    if not np.isfinite(maximum):
        return f"{'not estimated':>16s}"
    relative = f" ({share_text(share)} of its largest value)" if share <= 1.0 else ""
    factor, shown = axis_unit(unit, np.array([maximum / share if 0.0 < share <= 1.0 else maximum]))
    if share > 1.0:  # an output that is zero but for round-off, or one that is not computed at all
        relative = f" (its largest value is {plain(factor * maximum / share)}{behind(shown)})"
    return f"{plain(factor * maximum):>16s}{behind(shown)}{relative}"
