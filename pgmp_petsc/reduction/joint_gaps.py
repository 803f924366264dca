"""Forces in joints of a reduced model: what dual gaps have in its equations.

With theta held, and T the statements of the coordinates, let ``Y_i`` answer statically a unit gap in constraint i,

    [K C^T; C 0] [Y_i; L] = [0; e_i],     T Y_i = 0;     lambda_i = Y_i^T (f - M x'' - g_int)

is the multiplier of a motion x: minus the residual of a flexible coordinate whose vector is ``Y_i`` and whose amplitude
is zero (docs/method.md, forces in joints; `modes.built_in` has the primal problem). Tables keep the products of the
``Y_i`` with the basis, with curvature and cubic energy in pairs with it (`modes.curvature`) but where joints are off or
bodies are matrices without a third derivative. The multiplier of a prescribed coordinate is minus its own residual.
Where constraints follow from others, ``C Y_i`` is the part of ``e_i`` that can be opened, and the multipliers are the
smallest that do the same.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from pgmp_petsc.declare.records import Record, array, declared
from pgmp_petsc.reduction.interpolation import interpolant
from pgmp_petsc.reduction.sample_grid import SampleGrid
from pgmp_petsc.reduction.tables import CURVATURE_UNITS, NODE_UNITS, WEIGHT_FREE, beside_rigid, mode_changes

if TYPE_CHECKING:
    import scipy.sparse as sp

    from pgmp_petsc.bodies.affine import Monomial
    from pgmp_petsc.mechanism.kinematics import RigidKinematics
    from pgmp_petsc.modes.built_in import Closing
    from pgmp_petsc.modes.problem import ModalProblem, ModeSet
    from pgmp_petsc.outputs.multipliers import ForceOutput
    from pgmp_petsc.reduction.sampler import TurnedLoads


#: Arrays of second order with one index of the basis.
CURVED = ("curved_load", "curved_inertia", "curved_mass", "curvature")


def rows_of(outputs: Iterable[ForceOutput], n_held: int) -> np.ndarray:
    """Return the numbers of the constraints whose multipliers outputs take, without those of prescribed coordinates,
    increasing."""
    rows = sorted({int(row) for output in outputs for row in output.rows})
    return np.array([row for row in rows if row < n_held], dtype=int)


@dataclass(frozen=True, eq=False)
class JointGaps(Record):
    """Products of the static answers Y to unit gaps in constraints of joints with a basis of m flexible vectors; what
    is of second order is None where the model has none, or not yet."""

    rows: np.ndarray = array("gap", at="constraints", about="numbers of the constraints that joints hold in the motion")
    mass: np.ndarray = array(
        "configuration", "mass term", "gap", "eta", unit=WEIGHT_FREE, about="Y^T M_i [d rho/d theta, Psi]"
    )
    inertia: np.ndarray = array(
        "configuration", "mass term", "coordinate", "coordinate", "gap", unit=WEIGHT_FREE,
        about="(d2 rho/d theta2)^T M_i Y",
    )  # fmt: skip
    stiffness: np.ndarray = array(
        "configuration", "stiffness term", "gap", "mode", unit=WEIGHT_FREE, about="Y^T K_i Psi"
    )
    load: np.ndarray = array("configuration", "load term", "gap", unit=WEIGHT_FREE, about="Y^T f_j")
    shapes: np.ndarray = array("configuration", "unknown", "gap", unit=NODE_UNITS, about="Y in body frames")
    cubic: np.ndarray | None = array(
        "configuration", "stiffness term", "gap", "mode", "mode", unit=WEIGHT_FREE, absent=None,
        about="cubic strain energy of Y and two vectors of the basis",
    )  # fmt: skip
    curved_load: np.ndarray | None = array(
        "configuration", "load term", "gap", "mode", unit=WEIGHT_FREE, absent=None, about="work on the curvature"
    )
    curved_inertia: np.ndarray | None = array(
        "configuration", "mass term", "pair of coordinates", "gap", "mode", unit=WEIGHT_FREE, absent=None,
        about="inertia of the curvature",
    )  # fmt: skip
    curved_mass: np.ndarray | None = array(
        "configuration", "mass term", "coordinate where any is prescribed", "gap", "mode", unit=WEIGHT_FREE,
        absent=None, about="momentum of the curvature along prescribed coordinates",
    )  # fmt: skip
    curvature: np.ndarray | None = array(
        "configuration", "unknown", "gap", "mode", unit=CURVATURE_UNITS, absent=None,
        about="of Y and a vector of the basis",
    )  # fmt: skip
    gyroscopic: np.ndarray | None = array(
        "configuration", "mass term", "coordinate", "gap", "mode", unit=WEIGHT_FREE, absent=None,
        about="Y^T M_i dPsi/d theta",
    )  # fmt: skip
    spread: np.ndarray | None = array(
        "configuration", "mass term", "pair of coordinates", "gap", "mode", unit=WEIGHT_FREE, absent=None,
        about="inertia of Y and a vector of the basis as they turn and change",
    )  # fmt: skip

    def turned(self, rotations: np.ndarray) -> JointGaps:
        """Express the flexible coordinates in another basis, ``Psi_new = Psi Q``, Q (n, m, m); without what `changing`
        adds."""
        whole = beside_rigid(rotations, self.mass.shape[-1] - rotations.shape[1])
        by = {"mass": whole, "stiffness": rotations} | ({} if self.cubic is None else dict.fromkeys(CURVED, rotations))
        turned = {name: np.einsum("n...i,nij->n...j", getattr(self, name), one) for name, one in by.items()}
        if self.cubic is not None:
            turned["cubic"] = np.einsum("ntgij,nia,njb->ntgab", self.cubic, rotations, rotations, optimize=True)
        return replace(self, **turned, gyroscopic=None, spread=None)

    def changing(
        self, kinematics: RigidKinematics, masses: Mapping[Monomial, sp.csr_matrix], samples: SampleGrid,
        projection: np.ndarray, scheme: str,
    ) -> JointGaps:  # fmt: skip
        """Add what changes as the vectors do, of the basis and Y together, where there are tables of second order; see
        `mode_changes`.

        Terms ``A[k,ij] v_k w_i d_j`` of the reduced Lagrangian are skew, as inertia ``m_ij`` of a basis does not
        change; that of Y and Psi does, and leaves ``1/2 m_ij'' d_j`` over, of which what is quadratic in velocities is
        added here.
        """
        if self.cubic is None:
            return self
        m, r = projection.shape[2], kinematics.n_coordinates
        both = mode_changes(kinematics, masses, samples, np.concatenate([projection, self.shapes], axis=2), scheme)
        inertia, spread = interpolant(samples, self.mass[..., -m:], scheme), both.spread[..., m:, :m].copy()
        for pair, (k, j) in enumerate(zip(*np.tril_indices(r))):
            slope = interpolant(samples, inertia(samples.theta, k), scheme)
            spread[:, :, pair] -= 0.5 * slope(samples.theta, j)
        return replace(self, gyroscopic=both.gyroscopic[..., m:, :m], spread=spread)

    def of_rows(self, rows: np.ndarray) -> JointGaps:
        """Return those of some of the constraints, given by their numbers."""
        chosen, found = np.searchsorted(self.rows, rows), {}
        for one in declared(JointGaps):
            table = getattr(self, one.name)
            found[one.name] = None if table is None else table.take(chosen, one.entry.sizes.index("gap"))
        return JointGaps(**found)


def gap_answers_at(
    problem: ModalProblem, loads: TurnedLoads, closing: Closing, rows: np.ndarray, modes: ModeSet, shape: np.ndarray
) -> tuple[np.ndarray, ...]:
    """Return Y, local rows (n_local, g), and behind it the arrays of `JointGaps` of first order, in its order, at the
    configuration that the problem is at, of the basis there, local rows (n_local, m). Collective on the problem's
    communicator.

    `rows` are the numbers of the constraints that are opened, shape (g,). Raises `RunError` if the refinement of an
    answer does not converge.
    """
    theta = modes.theta
    gaps = np.zeros((problem.constraints.at(problem.kinematics.motion(theta).poses).shape[0], rows.size))
    gaps[rows, np.arange(rows.size)] = -1.0
    found, _ = closing.at(modes, gaps, "static answers to gaps of joints")
    everywhere = problem.all_rows(found)
    mass = [term @ everywhere for term in (problem.matrices.mass[w] for w in problem.mechanism.mass_weights)]
    stiffness = [problem.matrices.stiffness[weight] @ everywhere for weight in problem.mechanism.stiffness_weights]
    return (
        found,
        np.swapaxes(problem.inner(np.hstack([modes.rigid, shape]), np.array(mass)), 1, 2),
        problem.work_of_motion(modes, found, np.array(mass)),
        np.swapaxes(problem.inner(shape, np.array(stiffness)), 1, 2),
        problem.inner(loads.at(theta), found),
    )
