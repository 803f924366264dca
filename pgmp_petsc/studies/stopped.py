"""Why a run stopped before its end, and what to do."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from pgmp_petsc.dynamics.generalised_alpha import Run
from pgmp_petsc.dynamics.reduced_energy import least_stiffness
from pgmp_petsc.dynamics.status import Status
from pgmp_petsc.models import FullModel, ReducedModel
from pgmp_petsc.reduction.definiteness import smoother
from pgmp_petsc.runtime.remarks import Remark, warning

LOOK_BACK = 400  # steps before a failure in which its cause is looked for


def why_stopped(model: FullModel | ReducedModel, run: Run, reason: str) -> list[Remark]:
    """Return why a run stopped, and what to do; nothing where it did not.

    Parameters
    ----------
    run
        A run of one sample.
    reason
        What is known beyond the status, with its cure.
    """
    status = Status(run.status[0])
    if status == Status.FINE:
        return []
    what = (
        f"{model.name} simulation stopped at {run.failure_time[0]:.6g} s of "
        f"{model.scene.simulation.duration:g} s: {status.meaning}"
    )
    return [warning("; ".join(filter(None, (what, reason or status.cure))))]


def lost_definiteness(model: ReducedModel, values: Mapping[str, np.ndarray], time: np.ndarray, eta: np.ndarray) -> str:
    """Return since when the stiffness was indefinite before the end, and why; empty where it was not."""
    looked_at = slice(-LOOK_BACK, None)
    share = least_stiffness(model.terms, values, eta[looked_at])
    unsound = np.isnan(share)
    if unsound.any():
        first = eta[looked_at][np.argmax(unsound)]
        where = ", ".join(f"{c.name} = {angle:.4g} rad" for c, angle in zip(model.kinematics.coordinates, first))
        return (
            f"the stiffness at rest, interpolated between sampled angles, is not positive definite at {where}; build "
            f"with {smoother(model.scene.reduction.interpolation)}"
        )
    lost = share <= 0.0
    if not lost[-1]:
        return ""
    since = time[looked_at][lost.size - int(np.argmin(lost[::-1])) if not lost.all() else 0]
    return (
        f"the stiffness of the deformed mechanism is indefinite from {since:.6g} s on (its least eigenvalue is "
        f"{share[-1]:.2g} of that at rest at the end): the cubic strain energy of geometric_stiffening has no lower "
        f"bound and runs away at deformations beyond what second order describes; {Status.BROKE_DOWN.cure}"
    )
