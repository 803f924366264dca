"""Where the local effects of a reduced model hold: rigid kinematics and mode shapes of their nodes, as interpolants."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pgmp_petsc.bodies.body import DOFS_PER_NODE
from pgmp_petsc.dynamics.action_kernel import N_PAIR, LocalEffects, Places
from pgmp_petsc.dynamics.reduced_terms import fine_grid
from pgmp_petsc.effects.action import Action, compile_actions
from pgmp_petsc.mechanism.attachment import place_points
from pgmp_petsc.mechanism.joints import N_FRAME
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.reduction.interpolation import interpolant
from pgmp_petsc.reduction.rom import ReducedOrderModel
from pgmp_petsc.reduction.sample_grid import SampleGrid


@dataclass(frozen=True)
class ReducedActions:
    """The actions of a scene in the reduced model.

    Attributes
    ----------
    actions
        Actions of all effects.
    places
        Where they hold; without actions all of its arrays are empty.
    """

    actions: tuple[Action, ...]
    places: Places

    @classmethod
    def of(
        cls, actions: Sequence[Action], kinematics: RigidKinematics, rom: ReducedOrderModel, scheme: str
    ) -> ReducedActions:
        """Prepare the tables of the nodes that actions hold at.

        Parameters
        ----------
        scheme
            Interpolation of the mode shapes over the samples.
        """
        sides = [side for action in actions for side in action.sides]
        nodes = sorted({side.node for side in sides if not side.on_ground})
        rows = (DOFS_PER_NODE * np.array(nodes, dtype=int)[:, None] + np.arange(DOFS_PER_NODE)).ravel()
        shapes = rom.projection[:, rows]
        if rom.curvature is not None:
            shapes = np.concatenate([shapes, rom.curvature[:, rows]], axis=2)
        fine = fine_grid(rom.tables.samples)
        winding = _winding(kinematics, fine)
        bodies = [kinematics.mechanism.body_of(node) for node in nodes]
        rigid = np.empty((fine.n, len(nodes), N_FRAME))
        if nodes:
            poses = kinematics.poses(fine.theta)
            for k, (body, point) in enumerate(bodies):
                rigid[:, k] = place_points(poses[body], point[None])[0].T
                rigid[:, k, 2] -= fine.theta @ winding[body]
        places = Places(
            rigid=interpolant(fine, rigid.reshape(fine.n, -1), "spline").polynomials(),
            shapes=interpolant(rom.tables.samples, shapes.reshape(len(shapes), -1), scheme).polynomials(),
            winding=np.array([winding[body] for body, _ in bodies]).reshape(len(nodes), fine.n_coordinates),
            sides=np.array([-1 if s.on_ground else nodes.index(s.node) for s in sides], dtype=np.int64).reshape(-1, 2),
            arms=np.array([side.arm for side in sides]).reshape(-1, 2, 2),
            ground=np.array([side.ground_frame(()) for side in sides]).reshape(-1, N_PAIR),
        )
        return cls(tuple(actions), places)

    @classmethod
    def none(cls, n_theta: int) -> ReducedActions:
        """Return no actions."""
        empty = np.zeros((1, 4**n_theta, 0))
        sides, arms = np.zeros((0, 2), dtype=np.int64), np.zeros((0, 2, 2))
        return cls((), Places(empty, empty, np.zeros((0, n_theta)), sides, arms, np.zeros((0, N_PAIR))))

    @property
    def edges(self) -> list[int]:
        """Numbers of the actions whose law has an edge."""
        return [k for k, action in enumerate(self.actions) if action.has_events]

    def of_samples(self, values: Mapping[str, np.ndarray], n_samples: int) -> LocalEffects:
        """Return what the kernel takes, for samples with values of shape (n_samples,)."""
        return LocalEffects(self.places, compile_actions(self.actions, values, n_samples))


def _winding(kinematics: RigidKinematics, fine: SampleGrid) -> np.ndarray:
    """Return how far every body turns with each periodic coordinate, 0 for others, shape (n_bodies, n_theta)."""
    lower = np.array([axis.lower for axis in fine.axes])
    ranges = np.diag([axis.upper - axis.lower if axis.periodic else 0.0 for axis in fine.axes])
    angles = kinematics.poses(np.stack([lower, *(lower + ranges)]))[:, 2]
    return np.rint((angles[:, 1:] - angles[:, :1]) / (2 * np.pi)) * 2 * np.pi / [a.upper - a.lower for a in fine.axes]
