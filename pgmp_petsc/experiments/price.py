"""What runs of a model take, predicted from its size alone before anything is run.

Times are processor times of a step of one sample, on a common processor of 2023. They follow from the numbers of
unknowns and from constants that were measured (`python -m benchmarks.prices` measures them again), so that every rank,
and every number of ranks, predicts the same: what is measured in a run is said afterwards, and decides nothing.

=========================== ==========================================================================
body                        grows with
=========================== ==========================================================================
beams                       nodes
cells in the plane, slender unknowns of the mesh
solids, slender             unknowns of the mesh; beyond a few thousand a parallel solver takes them
in a floating frame         pairs of amplitudes, all of which its frames couple
=========================== ==========================================================================
"""

from __future__ import annotations

from dataclasses import dataclass

from pgmp_petsc.bodies.body import Body
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.models.full import MOST_IN_LANES

# s, a step of a sample: of a node of beams in the plane and in space, of an unknown of plane and solid meshes in lanes
# and in PETSc's solvers, of a pair of amplitudes, of a body that is rigid
PLANAR_NODE, SPATIAL_NODE = 4.0e-7, 4.0e-6
PLANE_UNKNOWN, SOLID_UNKNOWN, DISTRIBUTED_UNKNOWN = 1.5e-6, 2.0e-5, 4.0e-5
PAIR, RIGID = 6.0e-8, 1.0e-6


@dataclass(frozen=True)
class Price:
    """What some runs are predicted to take.

    Attributes
    ----------
    step
        Processor time of a step of a sample, s.
    steps
        Steps of all samples together.
    """

    step: float
    steps: float

    @property
    def seconds(self) -> float:
        """Processor time of all, s."""
        return self.step * self.steps

    def __str__(self) -> str:
        return duration_text(self.seconds)


def step_seconds(mechanism: Mechanism) -> float:
    """Return the predicted processor time of a step of one sample of a full-order or component model, s."""
    in_lanes = mechanism.n_dofs <= MOST_IN_LANES
    return sum(_of_body(body, in_lanes) for body in mechanism.bodies)


def _of_body(body: Body, in_lanes: bool) -> float:
    if body.floating is not None:
        return PAIR * body.floating.n**2
    if body.meshed is not None:
        plane = body.node_dofs == 3
        unknown = (PLANE_UNKNOWN if plane else SOLID_UNKNOWN) if in_lanes else DISTRIBUTED_UNKNOWN
        return unknown * body.n_internal
    if body.is_beam:
        return (PLANAR_NODE if body.is_planar_beam else SPATIAL_NODE) * body.n_nodes
    return RIGID


def duration_text(seconds: float) -> str:
    """Return a time in words: ``40 s``, ``12 min``, ``3.1 h``."""
    for unit, size in (("s", 60.0), ("min", 60.0), ("h", 48.0)):
        if seconds < 2.0 * size:
            return f"{seconds:.2g} {unit}"
        seconds /= size if unit != "h" else 24.0
    return f"{seconds:.2g} days"
