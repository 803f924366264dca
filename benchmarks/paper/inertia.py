"""What the inertia coupling of rigid and flexible motion is worth, which the paper's eq. (12) does not have."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from mpi4py import MPI

from benchmarks.paper.published import LARGEST_ERROR_PERCENT, NOMINAL
from benchmarks.paper.results import PaperResults
from benchmarks.programs import reduced_model
from benchmarks.tables import Table, percent
from pgmp_petsc.base.errors import RunError
from pgmp_petsc.models import ReducedModel
from pgmp_petsc.reduction.interpolation import interpolant
from pgmp_petsc.reduction.tables import ReducedTables
from pgmp_petsc.studies.simulate import simulate


def inertia_table(results: PaperResults) -> Table:
    """Compare the reduced model's largest errors with the coupling and without it, nominal radius."""
    model = reduced_model(results.directory / "rom.h5")
    tables = uncoupled(model.rom.tables, model.scene.reduction.interpolation)
    without = simulate(ReducedModel(model.scene, replace(model.rom, tables=tables)), MPI.COMM_SELF)
    if without.status:
        raise RunError(without.record.remarks[0].text)
    rows = []
    for output in LARGEST_ERROR_PERCENT:
        exact = results.nominal_run.outputs[output]
        error = np.max(np.abs(without.outputs[output] - exact)) / np.max(np.abs(exact))
        rows.append([output.replace("_", " "), percent(error), percent(results.largest_error(output, NOMINAL))])
    after = (
        "Largest error over 1 s, over the largest full-order value. `b` stands for the inertia forces of the rigid "
        "motion that bend the bodies; see `docs/method.md`."
    )
    header = ("output", "without b, as in eq. (12)", "with b")
    return Table("What the inertia coupling b is worth", header, rows, after=after)


def uncoupled(tables: ReducedTables, scheme: str) -> ReducedTables:
    """Return the tables with ``(d rho/d theta)^T M (d Psi/d theta) = 0`` at every sample.

    That term is the derivative of the mass table's coupling block less the inertia table, so the latter is set to that
    derivative.
    """
    samples = tables.samples.axes[0]
    slope = interpolant(samples, tables.mass[:, :, 0, 1:], scheme)(samples.theta, 0)
    return replace(tables, inertia=slope[:, :, None, None, :])
