"""What is said of single runs, of reduced models and of tables of frequencies."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pgmp_petsc.results.numbers import axis_unit
from pgmp_petsc.texts import estimates

if TYPE_CHECKING:
    from pgmp_petsc.results import ModesTable, Trajectory
    from pgmp_petsc.runtime.errors import Remark

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
