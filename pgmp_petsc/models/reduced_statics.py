"""Statics of the reduced model: deformation under the loads at time zero with coordinates held or free.

The flexible coordinates delta follow from their own equations, ``R_delta(theta, delta) = 0``, at a given theta. Free
coordinates theta are in equilibrium where also ``R_theta = 0``. A held coordinate is the angle s of its joint,
``theta + Psi_joint(theta) delta`` where the modes turn the joint, as it is in the full-order model: with torques mu
that hold it and ``G = d s / d eta``,

    R(eta) + G^T mu = 0,     s(eta) = s_0,

solved by Newton's method for theta and mu, with derivatives by differences; delta follows from its equations in
between. Samples are solved together, each to its own convergence.
"""

from __future__ import annotations

import numpy as np

from pgmp_petsc.lanes.lane_items import solutions
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.outputs.readings import Reading
from pgmp_petsc.reduced.system import ReducedSystem
from pgmp_petsc.reduction.reconstruction import Reconstruction
from pgmp_petsc.reduction.rom import ReducedOrderModel
from pgmp_petsc.stepping.second_order_system import State
from pgmp_petsc.stepping.static_equilibrium import LONGEST, cause_of, iterate_at_rest, put_on, settled_in

TURN = 1e-6  # of differences, in rad or of the mechanism's size
TORQUE = 1e-3  # of differences along torques, in units of those that are left
SHAPE = 1e-4  # of differences along flexible coordinates, in units of the mechanism's size or of 1 rad
STATES = 4096  # whose angles are looked at together
MAX_STEPS = 60  # the slopes of the joints follow the deformation from step to step


class ReducedStatics:
    """A batch of samples; see `Statics`.

    Angles are those of the joints that are coordinates, or None where coordinates are free: then it is theta that is
    held.
    """

    def __init__(self, system: ReducedSystem, angles: JointAngles | None) -> None:
        self._system, self._angles = system, angles
        self.n_samples, self._n_theta = system.n_samples, system.tables.n_coordinates
        self._eta = system.undeformed(0.0)
        # of the loads, with which a deformation was found last; how far a joint that is not held is away
        self._share, self._away = np.zeros(system.n_samples), np.zeros(system.n_samples)

    def hold(self, theta: np.ndarray, samples: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Find the deformation, from the undeformed mechanism; see `Statics.hold`."""
        before = self._eta.copy()
        self._away[samples] = 0.0
        eta = self._system.undeformed(theta)
        torques, lost = self._deform(eta, np.zeros((self.n_samples, 0)), None, samples)
        if self._angles is not None:
            torques, lost = self._hold_joints(eta, theta, samples & ~lost, lost)
        # one that ran away is a record: no number of it may reach what is evaluated for the whole batch
        eta[lost] = self._system.undeformed(theta)[lost]
        self._eta = np.where(samples[:, None], eta, before)
        return torques, lost & samples

    def cause(self, sample: int) -> str:
        """Return why a sample was lost; see `Statics.cause`."""
        if self._away[sample] == 0.0:
            return cause_of(self._share[sample])
        return (
            f"the deformation under the loads was, but no rigid coordinates with which the joints stand there: "
            f"{self._away[sample]:.2g} {self._angles.unit} remain. The modes may turn the joint by too much for the "
            "model; take reduction.static_modes = true or more reduction.angles and build again, or let "
            "simulation.initial begin elsewhere"
        )

    def unknowns(self) -> np.ndarray:
        """Return the reduced coordinates, shape (n_eta, n_samples)."""
        return self._eta.T

    def inertia(self) -> np.ndarray:
        """Return the inertia of the rigid mechanism, shape (n_samples, n_theta)."""
        q, moments = np.zeros_like(self._eta), []
        q[:, : self._n_theta] = self._eta[:, : self._n_theta]
        for k in range(self._n_theta):
            v = np.zeros_like(q)
            v[:, k] = 1.0
            moments.append(2.0 * self._system.kinetic_energy(q, v))
        return np.stack(moments, axis=1)

    def _hold_joints(
        self, eta: np.ndarray, angles: np.ndarray, active: np.ndarray, lost: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Solve for theta and the holding torques mu of the active samples; return minus mu, and the samples lost."""
        r = self._n_theta
        scales = self._angles.scales
        mu, last, moved_by = np.zeros((self.n_samples, r)), np.full(self.n_samples, np.inf), np.full(lost.shape, np.inf)
        for _ in range(MAX_STEPS + 1):
            slopes = self._angles.gradient(eta)
            # what is differenced below: with the slopes of the step before, differences over `TURN` would be of theirs
            left, failed = self._deform(eta, mu, slopes, active)
            lost = lost | (failed & active)
            away = (self._angles.of(eta) - angles) / scales
            # theta may be at rest while mu still bends the joint
            size = np.maximum(moved_by, np.max(np.abs(away), axis=1))
            active = active & ~lost & ~settled_in(size, last)
            last = size
            if not active.any():
                return -mu, lost
            # the torque of 1 rad of the flexible coordinates is unknown; what is left on theta is of the right size,
            # and a part of it bends the bodies by little beside what the loads do
            pull = np.maximum(np.max(np.abs(left), axis=1), np.max(np.abs(mu), axis=1))
            defect = np.concatenate([left, away], axis=1)
            jacobian = np.zeros((self.n_samples, 2 * r, 2 * r))
            for column in range(2 * r):
                moved, torque, k = eta.copy(), mu.copy(), column % r
                by_torque = TORQUE * np.where(pull > 0.0, pull, 1.0)
                step = np.full(self.n_samples, TURN * scales[k]) if column < r else by_torque
                (moved if column < r else torque)[:, k] += step
                changed, failed = self._deform(moved, torque, slopes, active)
                lost = lost | (failed & active)
                found = np.concatenate([changed, (self._angles.of(moved) - angles) / scales], axis=1)
                jacobian[:, :, column] = (found - defect) / step[:, None]
            step = solutions(jacobian, -defect)
            lost = lost | (active & ~np.isfinite(step).all(axis=1))
            active = active & ~lost
            eta[active, :r] += step[active, :r]
            mu[active] += step[active, r:]
            moved_by[active] = np.max(np.abs(step[active, :r]) / scales, axis=1)
        self._away[active] = np.max(np.abs(away), axis=1)[active]
        return -mu, lost | active

    def _deform(
        self, eta: np.ndarray, mu: np.ndarray, slopes: np.ndarray | None, samples: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Find delta at the theta of some samples, in place; return what is left over on theta, and the samples lost.

        `mu` are torques on the joints with the derivatives `slopes` of their angles, shapes (n_samples, n_theta) and
        (n_samples, n_theta, n_eta).
        """
        r = self._n_theta
        force = np.zeros_like(eta) if slopes is None else np.einsum("sk,ski->si", mu, slopes)
        first = eta.copy()

        def begin(going: np.ndarray) -> None:
            eta[going] = first[going]

        def converge(going: np.ndarray, share: float) -> np.ndarray:
            state, part = self._state(eta), share * force
            found = iterate_at_rest(
                lambda active: self._system.correct_at_rest(state, part, active, share, LONGEST), going
            )
            # a sample that runs away is lost; angles of joints are asked for where it was
            sound = going & np.isfinite(state.q).all(axis=1)
            eta[sound] = state.q[sound]
            return found

        lost, reached = put_on(begin, converge, samples)
        self._share[samples] = reached[samples]
        state = self._state(eta)
        return -(self._system.residual(0.0, state) + force)[:, :r], lost

    def _state(self, eta: np.ndarray) -> State:
        return State(eta.copy(), np.zeros_like(eta), np.zeros_like(eta), np.zeros(0))


class JointAngles:
    """Coordinates as the joints have them, for reduced states; `scale` is the displacement per unit of each reduced
    coordinate, shape (n_eta,), as in `ReducedTerms`; `scales` and `unit` are 1 rad or the mechanism's size, shape
    (n_theta,), and in words."""

    def __init__(self, kinematics: RigidKinematics, rom: ReducedOrderModel, scheme: str, scale: np.ndarray) -> None:
        self._angles = [Reading.of_coordinate(coordinate, kinematics) for coordinate in kinematics.coordinates]
        self._nodes = sorted(set().union(*(angle.nodes for angle in self._angles)))
        self._reconstruction = Reconstruction(kinematics, rom, scheme, self._nodes)
        turn = all(coordinate.turns for coordinate in kinematics.coordinates)
        self.unit = "rad" if turn else "of 1 rad or of the mechanism's size"
        self.scales = np.array([coordinate.scale(kinematics.size) for coordinate in kinematics.coordinates])
        self._steps = np.concatenate([TURN * self.scales, SHAPE / np.maximum(scale[self.scales.size :], 1e-300)])

    def of(self, eta: np.ndarray) -> np.ndarray:
        """Return the angles, shape (n, n_theta), for reduced coordinates (n, n_eta)."""
        frames = dict(zip(self._nodes, self._reconstruction.frames(eta)))
        return np.stack([angle.value(frames) for angle in self._angles], axis=1)

    def gradient(self, eta: np.ndarray) -> np.ndarray:
        """Return the derivatives of the angles, shape (n, n_theta, n_eta)."""
        (n, n_eta), result = eta.shape, []
        at_once = max(1, STATES // (2 * n))
        for first in range(0, n_eta, at_once):
            steps = np.diag(self._steps)[first : first + at_once]
            moved = eta + np.stack([steps, -steps])[:, :, None]  # (side, coordinate, sample, n_eta)
            ahead, behind = self.of(moved.reshape(-1, n_eta)).reshape(*moved.shape[:3], -1)
            result.append((ahead - behind) / (2.0 * self._steps[first : first + at_once, None, None]))
        return np.moveaxis(np.concatenate(result), 0, 2)
