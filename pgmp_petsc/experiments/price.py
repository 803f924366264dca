"""What runs of a model take, predicted from its size alone before anything is run.

Times are processor times of a step of one sample, on a common processor of 2023. They follow from the numbers of
unknowns and from constants that were measured (`python -m benchmarks.prices` measures them again), so that every rank,
and every number of ranks, predicts the same: what is measured in a run is said afterwards, and decides nothing.

=========================== ==========================================================================
body                        grows with
=========================== ==========================================================================
beams                       nodes
cells in the plane, slender unknowns of the mesh
solids, slender             unknowns of the mesh
in a floating frame         pairs of amplitudes, all of which its frames couple
=========================== ==========================================================================

Local effects come on top. Of the scenes of this project predictions were within a factor of two or three, but for
mechanisms of few unknowns that hit a stop, which cost five times as much.
"""

from __future__ import annotations

from dataclasses import dataclass

from pgmp_petsc.bodies.body import Body
from pgmp_petsc.mechanism.mechanism import Mechanism

# s, a step of a sample: of a node of beams in the plane and in space, of an unknown of plane and solid meshes, of a
# pair of amplitudes, of a rigid body, and of a local effect, which also costs Newton corrections
PLANAR_NODE, SPATIAL_NODE = 4.0e-7, 4.0e-5
PLANE_UNKNOWN, SOLID_UNKNOWN = 7.0e-7, 3.0e-5
PAIR, RIGID, LOCAL_EFFECT = 5.0e-8, 1.0e-6, 1.5e-5
#: Effects that act between nodes; those along a constant pattern cost nothing to speak of.
LOCAL = ("joint_damping", "joint_friction", "spring_damper", "bushing", "end_stop")


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
    local = sum(effect.type in LOCAL for effect in mechanism.scene.effects.values())
    return LOCAL_EFFECT * local + sum(_of_body(body) for body in mechanism.bodies)


def _of_body(body: Body) -> float:
    if body.floating is not None:
        return PAIR * body.floating.n**2
    if body.meshed is not None:
        return (PLANE_UNKNOWN if body.node_dofs == 3 else SOLID_UNKNOWN) * body.n_internal
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
