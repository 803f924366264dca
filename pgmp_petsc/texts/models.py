"""What is said of single runs, of reduced models and of tables of frequencies."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pgmp_petsc.results.numbers import axis_unit
from pgmp_petsc.texts import estimates

if TYPE_CHECKING:
    from pgmp_petsc.reduction.rom import ReducedOrderModel
    from pgmp_petsc.results import ModesTable, Trajectory
    from pgmp_petsc.runtime.errors import Remark
    from pgmp_petsc.studies.building import Built

SHOWN = 6
NOTHING = 1e-6  # of a mode's highest frequency


def report_of_run(trajectory: Trajectory, path: Path, said: Sequence[Remark] = ()) -> str:
    """Return the outputs at the end, estimated errors and validity of a reduced run, and all remarks."""
    lines = [f"{path}: {trajectory.model} model, {len(trajectory.time) - 1} steps to {trajectory.time[-1]:g} s"]
    for name, values in trajectory.outputs.items():
        factor, unit = axis_unit(trajectory.units[name], values)
        lines.append(f"  {name:24s}{factor * values[-1]:16.8g} {unit}")
    lines += estimates.of_run(trajectory)
    # why it stopped is the error that ends the command
    return "\n".join([*lines, *estimates.closing(trajectory.record, said, trajectory.why_stopped or "")])


def report_of_modes(table: ModesTable, path: Path, said: Sequence[Remark] = ()) -> str:
    """Return the range of every frequency, how far the reduced ones are from it, and all remarks."""
    lines = [
        f"{path}: {len(table.full_hz)} {'angles' if table.theta.ndim == 1 else 'configurations'}",
        "  mode     lowest Hz    highest Hz   reduced, largest difference",
    ]
    for mode in range(min(SHOWN, table.full_hz.shape[1])):
        full = table.full_hz[:, mode]
        line = f"  {mode + 1:4d} {full.min():13.6g} {full.max():13.6g}"
        if table.reduced_hz is not None and mode < table.reduced_hz.shape[1]:
            # a mechanism on a spring has no stiffness at a dead centre: there is nothing to compare with
            some = np.abs(full) > NOTHING * np.max(np.abs(full))
            line += f" {np.max(np.abs(table.reduced_hz[some, mode] / full[some] - 1), initial=0.0):14.2e}"
        lines.append(line)
    return "\n".join([*lines, *estimates.closing(table.record, said)])


def report_of_build(made: Built, path: Path, said: Sequence[Remark] = ()) -> str:
    """Say what was built, what is doubtful about it, and what was chosen for tolerances."""
    chosen = [] if made.selection is None else made.selection.lines(attempts=False)
    return "\n".join([report(made.rom, path, said), *chosen])


def report(rom: ReducedOrderModel, path: Path, said: Sequence[Remark] = ()) -> str:
    """Say what was built, and what is doubtful about it."""
    tables = rom.tables
    lines = [
        f"{path}: {len(rom.frequencies_hz)} {'angles' if tables.n_coordinates == 1 else 'configurations'}, "
        f"{rom.frequencies_hz.shape[1]} modes from {rom.frequencies_hz[:, 0].min():.4g} to "
        f"{rom.frequencies_hz[:, -1].max():.4g} Hz{beside_modes(rom)}",
        *points_report(rom),
        f"  tables: {tables.mass.shape[1]} mass, {tables.stiffness.shape[1]} stiffness and "
        f"{tables.load.shape[1]} load terms",
        f"  neighbouring spaces of modes agree to a cosine of {rom.cosines.min():.6f}",
    ]
    if tables.samples.n > len(rom.frequencies_hz):
        lines.append("  one mode changes its sign after a turn: the tables cover two turns")
    return "\n".join([*lines, *estimates.closing(rom.record, said)])


def beside_modes(rom: ReducedOrderModel) -> str:
    """Name what a basis has besides modes."""
    n_parameter = rom.n_parameter
    n_static = rom.tables.n_modes - rom.frequencies_hz.shape[1] - n_parameter
    return (f", {n_static} static" if n_static else "") + (
        f", {n_parameter} of other parameters" if n_parameter else ""
    )


def points_report(rom: ReducedOrderModel) -> list[str]:
    """Say where in the parameter space the basis has further modes."""
    if not rom.n_parameter:
        return []
    places = "; ".join(
        ", ".join(f"{name} = {value:.4g}" for name, value in point.items()) for point in rom.points.points
    )
    first, last = rom.points.missed[[0, -1]]
    return [
        f"  modes at other parameters: {places}",
        f"  at the worst parameters tried, the basis misses {last:.2g} of the modes' energy norm instead of "
        f"{first:.2g}",
    ]
