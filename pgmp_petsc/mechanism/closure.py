"""The loop closure of the rigid mechanism and what drives it: one system of equations for the poses.

The poses P solve the loop closure together with the coordinates' definition,

    c(P) = 0,    theta_k(P) = theta_k,

by Newton's method. Its unknowns are displacements and turns y of the bodies, along the inertial axes, so that bodies
stay rigid: ``dP = T y``, with the second derivatives P_kl in space where y is constant. With J the derivatives of both
in y, implicit differentiation gives

    J y_k = e_k,    dP/dtheta_k = T y_k,
    J y_kl = (d2c/dP2)[dP_k, dP_l] + (dc/dP) P_kl,    d2P/dtheta_k dtheta_l = P_kl - T y_kl.

Redundant constraints (the same statement twice) are allowed: J then has more rows than columns and full column rank.
Where they do not agree to the last digit, as axes that are a little off, the loops are closed in least squares, and
what is left over of c, the gap, lies in the left null space of J. With the residual r a step of the Gauss-Newton method
is the y of ``|W (r + J y)| -> min``, lengths in W in units of the mechanism's size. It has converged where ``W J y`` is
small, whatever is left of r.

What elastic joints allow beside the motion of the coordinates: `ReleasedClosure`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property

import numpy as np
import scipy
import scipy.sparse as sp

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.lanes.compiled import njit
from pgmp_petsc.mechanism.block_solves import Blocks, solver, triangular_blocks
from pgmp_petsc.mechanism.joints import Attached, Connection, Coupling
from pgmp_petsc.mechanism.mechanism import Mechanism, words_of
from pgmp_petsc.mechanism.space import SPATIAL
from pgmp_petsc.mechanism.statement_rows import StatementRows
from pgmp_petsc.mechanism.statements import Combination, Statement

MAX_ITERATIONS = 25
NEAR = 1e-9  # scaled residual, left by a step of 3e-5, of which the same J leaves 3e-14
RELEASED_TOLERANCE = 1e-8  # of a released direction's whole change, what of it is independent of others and allowed
STIFF = 1e3  # weight of given coordinates against joints, where these cannot all hold
NO_GAP = 1e-9  # of the mechanism's size
CROOKED = 0.02  # singular values of constraints over the largest, above SINGULAR_TOLERANCE: a degree off
NEAREST = 1e-3  # share of a gap that can still be closed, where it is known to be as small as it can be
SINGULAR_TOLERANCE = 1e-5  # smallest singular value of J over the largest, lengths scaled by the mechanism's size
LARGEST_GAP = 1e-6  # of the mechanism's size or of 1 rad: what redundant constraints may miss each other by
GUESSED = " (the first guess of how it is assembled; angles in rad)"
TRIES = 12  # assemblies that are tried from other places before it is said that there is none
CLOSURE_TOLERANCE = 1e-12  # of the mechanism's size (positions) or of 1 rad
AT_ONCE, FEWEST = 2**17, 32  # entries of Jacobians that are evaluated together: they stay in the cache; and of these


class LoopClosure:
    """Closure and driving equations of a mechanism, all of whose coordinates drive.

    `size` is a length that is typical of it, the largest extent of a body, m; `scales`, shape (n_theta,), what small
    changes of its `n_coordinates` independent coordinates are measured against, 1 rad or the size. `equations` are all
    that its solutions depend on; what is the same has the same. `jacobian` leads from poses (n_bodies, n_pose, n) to
    the derivatives J of the residual in displacements and turns of bodies, shape (n, n_constraints + n_theta, n_dofs
    n_bodies). `has_redundant` says whether joints and coordinates say more than poses can obey, so that a gap may be
    left.
    """

    def __init__(self, mechanism: Mechanism) -> None:
        self.mechanism = mechanism
        self.size = size_of(mechanism)
        self.n_coordinates = len(mechanism.coordinates)
        self.scales = np.array([c.scale(self.size) for c in mechanism.coordinates])
        space, (parts, wanted) = mechanism.space, mechanism.holding([])
        self.n_constraints = len(parts)
        parts += [(c.statement, c.sides) for c in mechanism.coordinates]
        self._rows = StatementRows.on_poses(parts, space)
        self.jacobian = RowsOfMotions(self._rows, mechanism)
        self._wanted = np.concatenate([wanted, np.zeros(self.n_coordinates)])
        periodic = [c.periodic for c in mechanism.coordinates]
        counted = len(mechanism.bodies), mechanism.n_constraints, len(mechanism.couplings)
        self.equations = self._rows.parts, wanted, periodic, counted, self.size
        self._units = np.tile(
            np.where(np.arange(space.n_dofs) < space.dimension, self.size, 1.0), len(mechanism.bodies)
        )
        self._scale = _scales(parts, self.size)
        self.has_redundant = self._rows.n > self._units.size

    def describe(self, theta: np.ndarray) -> str:
        """Name a configuration (n_theta,): ``theta = 0.1 rad``."""
        return words_of(self.mechanism.coordinates, theta)

    def measured(self, poses: np.ndarray) -> np.ndarray:
        """Return the coordinates at poses (n_bodies, n_pose, n), shape (n_theta, n)."""
        return self._rows.values(_unknowns(poses))[self.n_constraints :]

    def residual(self, poses: np.ndarray, theta: np.ndarray) -> np.ndarray:
        """Return closure and driving residuals at theta (n, n_theta), shape (n_constraints + n_theta, n)."""
        wanted = np.repeat(self._wanted[:, None], len(theta), axis=1)
        wanted[self.n_constraints :] = theta.T
        return self._rows.values(_unknowns(poses), wanted) - wanted

    def scaled(self, jacobian: np.ndarray, scale: np.ndarray | None = None) -> np.ndarray:
        """Return J (..., n_rows, n_dofs n_bodies) with lengths in units of the size, those of rows by a scale (n_rows,)
        of their own if it is given: singular values then do not depend on the unit."""
        scale = self._scale[: jacobian.shape[1]] if scale is None else scale
        return jacobian * self._units / scale[:, None]

    def singular_values(self, jacobian: np.ndarray) -> np.ndarray:
        """Return those of the scaled J, descending, shape (n, n_dofs n_bodies)."""
        return np.linalg.svd(self.scaled(jacobian), compute_uv=False)

    def rates(self, poses: np.ndarray, jacobian: np.ndarray | None = None) -> np.ndarray:
        """Return ``dP/dtheta_k`` at poses (n_bodies, n_pose, n), shape (n_bodies, n_pose, n_theta, n), with J there if
        it is known."""
        unit = np.zeros((1, self._rows.n, self.n_coordinates))
        unit[:, -self.n_coordinates :] = np.eye(self.n_coordinates)
        found = np.empty((*poses.shape[:2], self.n_coordinates, poses.shape[2]))
        for k in self.pieces(poses.shape[2]):
            own = self.jacobian(poses[..., k]) if jacobian is None else jacobian[k]
            found[..., k] = self._changed(poses[..., k], self._solver(own)(np.repeat(unit, len(own), axis=0)))
        return found

    def jets(self, poses: np.ndarray, motion: Sequence[np.ndarray]) -> list[np.ndarray]:
        """Return the first and, if these of the coordinates are given, the second derivatives over time of poses
        (n_bodies, n_pose, n), of that shape each, for the derivatives (n, n_theta) of the coordinates.

        They are `rates` and `curvatures` along the motion, of one J and a right-hand side for each derivative.
        """
        found, r = [np.empty(poses.shape) for _ in motion], self.n_coordinates
        for k in self.pieces(poses.shape[2]):
            at, where = poses[..., k], _unknowns(poses[..., k])
            slopes = self._rows.jacobian_values(where)
            solve, right = self._solver(self.jacobian(at, slopes)), np.zeros((at.shape[2], self._rows.n, 1))
            right[:, -r:, 0] = motion[0][k]
            found[0][..., k] = speed = self._changed(at, solve(right))[:, :, 0]
            if len(motion) > 1:
                bent = self.mechanism.space.bends(at, speed[:, :, None])[:, :, 0]
                right = -self._rows.drift(where, _unknowns(speed)).T[..., None] - self.jacobian.along(slopes, bent)
                right[:, -r:, 0] += motion[1][k]
                found[1][..., k] = (bent + self._changed(at, solve(right)))[:, :, 0]
        return found

    def curvatures(self, poses: np.ndarray, rates: np.ndarray) -> np.ndarray:
        """Return ``d2P/dtheta_k dtheta_l``, shape (n_bodies, n_pose, n_theta, n_theta, n)."""
        space, found = self.mechanism.space, []
        for k in self.pieces(poses.shape[2]):
            at, own, unknowns = poses[..., k], rates[..., k], _unknowns(poses[..., k])
            bends = space.bends(at, own)
            right = self._rows.second_along(unknowns, own.reshape(len(unknowns), *own.shape[2:]))
            right = right.reshape(own.shape[3], self._rows.n, -1)
            flat = bends.reshape(*bends.shape[:2], -1, bends.shape[-1])
            slopes = self._rows.jacobian_values(unknowns)
            motions = self._solver(self.jacobian(at, slopes))(right + self.jacobian.along(slopes, flat))
            found.append(flat - self._changed(at, motions))
        return np.concatenate(found, axis=-1).reshape(*rates.shape[:3], *rates.shape[2:])

    def open_and_gap(self, poses: np.ndarray, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return how far loops at theta (n, n_theta) can still be closed, and the gap that stays, both scaled, (n,).

        Without redundant constraints all that is open can be closed; nor is a large gap one that they explain. Open are
        bodies too that are not rigid.
        """
        found = []
        for k in self.pieces(len(theta)):
            residual = self.residual(poses[..., k], theta[k])
            found.append(self._split(residual, self._step(poses[..., k], residual)[1]))
        still_open, gap = (np.concatenate(part) for part in zip(*found))
        bent = np.abs(self.mechanism.space.straightened(poses) - poses).max(axis=(0, 1))
        return np.maximum(still_open, bent), gap

    def _split(self, residual: np.ndarray, left: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return `open_and_gap` of a residual (n_rows, n), of which a step leaves a part."""
        whole, stays = self._largest(residual), self._largest(left)
        explained = self.has_redundant & (stays < LARGEST_GAP)
        return np.where(explained, self._largest(residual - left), whole), np.where(explained, stays, 0.0)

    def _largest(self, residual: np.ndarray) -> np.ndarray:
        """Return the largest scaled part (n,) of residuals (n_rows, n)."""
        return np.max(np.abs(residual) / self._scale[: len(residual), None], axis=0, initial=0.0)

    def close(
        self,
        poses: np.ndarray,
        theta: np.ndarray,
        placed: bool = False,
        tolerance: float = CLOSURE_TOLERANCE,
        missing: bool = False,
    ) -> np.ndarray:
        """Run Newton's method at all theta (n, n_theta) together, from poses (n_bodies, n_pose, n), which may be the
        bodies as `placed`, down to a tolerance of the scaled residual.

        Raises `InputError` where it does not converge; poses may be `missing` instead, and are not a number there.
        """
        closed, gap = self.newton(poses, theta, tolerance)
        if missing:
            closed[..., ~(gap < tolerance)] = np.nan
        elif not np.all(gap < tolerance):
            self.require_closed(poses, theta, gap, placed)
        return closed

    def require_closed(self, poses: np.ndarray, theta: np.ndarray, gap: np.ndarray, placed: bool = False) -> None:
        """Refuse theta (n, n_theta) where a gap (n,) remained, from poses (n_bodies, n_pose, n)."""
        if np.all(gap < CLOSURE_TOLERANCE):
            return
        worst = int(np.nanargmax(gap)) if np.any(np.isfinite(gap)) else 0
        ranges = " or ".join(f"coordinates.{c.name}.range" for c in self.mechanism.coordinates)
        start, where = poses[..., [worst]], theta[[worst]]
        found = self._nearest(start, where)
        residual = self.residual(found, where)[:, 0]
        gaps, blame = self._gaps(residual)
        if self._contradicts(found, where):
            raise InputError(
                f"joints.{blame}: the joints of rigid bodies contradict one another at {self.describe(theta[worst])}; "
                f"{gaps}, and redundant constraints may miss each other by {LARGEST_GAP:g} of the mechanism's size, "
                f"{self.mechanism.scene.system.text(LARGEST_GAP * self.size, 'm')}, or as many rad. Check "
                f"points and axes, and placements{GUESSED}, from which bodies take the axes of joints; let joints that "
                "say the same be ones that hold less; or, if it is meant and bodies give way, give points and axes as "
                "they should be, and how far the joint is off as its offset"
            )
        closed = self._closed_from(start, found, where, TRIES if placed else 0)
        if closed is None and self._largest(residual[:, None])[0] < NO_GAP:
            closed = found  # as near as the search of the nearest poses comes
        if closed is not None:
            raise InputError(
                f"joints.{blame}: the mechanism can close at {self.describe(theta[worst])}, but "
                + (
                    "not from where its bodies are placed: placements are the first guess of how it is assembled, and "
                    f"these are too far off (angles are in rad). It closes with {self._placements(closed)}"
                    if placed
                    else "not in the way that it is assembled: on the way there it goes through a dead centre, or into "
                    f"another assembly. Narrow {ranges}, or assemble it the other way by its placements"
                )
            )
        raise InputError(
            f"joints.{blame}: the mechanism cannot close at {self.describe(theta[worst])}; {gaps}. Check the bodies' "
            f"lengths and placements{GUESSED if placed else ''}, or narrow {ranges}"
        )

    def _contradicts(self, poses: np.ndarray, theta: np.ndarray) -> bool:
        """Return whether loops at poses (n_bodies, n_pose, 1) are as closed as redundant constraints let them be.

        Loops that do not reach are as near as they can come too, in a configuration in which J is singular.
        """
        residual, jacobian = self.residual(poses, theta), self.jacobian(poses)
        left = self._step(poses, residual)[1]
        values = self.singular_values(jacobian)[0]
        nearest = self._largest(residual - left)[0] < NEAREST * self._largest(left)[0]
        return self.has_redundant and nearest and values[-1] > SINGULAR_TOLERANCE * values[0]

    def missed(self, poses: np.ndarray, theta: np.ndarray) -> str:
        """Say which joint redundant constraints keep furthest from closed at poses (n_bodies, n_pose, n), how far, and
        at which of theta (n, n_theta); empty where loops close."""
        residual = self.residual(poses, theta)
        gap = self._largest(residual)
        worst = int(np.argmax(gap))
        if gap[worst] < CLOSURE_TOLERANCE:
            return ""
        gaps, blame = self._gaps(residual[:, worst])
        return f"joints.{blame}: {gaps} at {self.describe(theta[worst])}"

    def crooked(self, poses: np.ndarray, rank: int) -> str:
        """Name the joint that gives the constraints at poses (n_bodies, n_pose, 1) more than a rank, by little; empty
        where they have no more, or by much."""
        rows = slice(self.n_constraints)
        left, values, _ = np.linalg.svd(self.scaled(self.jacobian(poses)[:, rows])[0])
        share = values[rank] / values[0] if values.size > rank else 0.0
        if not SINGULAR_TOLERANCE < share < CROOKED:
            return ""
        most = max(self.mechanism.holders, key=lambda c: np.max(np.abs(left[c.rows, rank])))
        return (
            f"joints.{most.name}: what it holds (by {share:.2g} of what others hold) nearly follows from the other "
            "constraints, and keeps the rigid mechanism from moving: its axis or point is a little off. Check axes, "
            f"points, and placements{GUESSED}, from which bodies take the axes of joints. If it is meant, give them as "
            f"they should be, and how far the joint is off as its offset{self._straightened(poses, most, rank)}"
        )

    def _straightened(self, poses: np.ndarray, joint: Connection | Coupling, rank: int) -> str:
        """Return axis and offset with which a joint that turns about one axis holds what it does: the rest of the
        mechanism turns it about the axis that it should have. Empty of others, and where the rest moves freely."""
        if self.mechanism.space is not SPATIAL or joint in self.mechanism.couplings:
            return ""
        angles = [k for k, part in enumerate(joint.statements) if not part.is_length]
        rows = np.delete(np.arange(self.n_constraints), joint.rows.start + np.array(angles, dtype=int))
        _, values, motions = np.linalg.svd(self.scaled(self.jacobian(poses)[:, rows])[0])
        if len(angles) != 2 or values.size < rank or values[rank - 1] < SINGULAR_TOLERANCE * values[0]:
            return ""
        spins, frames = [], []
        for side in joint.sides:
            turning = slice(6 * side.body + 3, 6 * side.body + 6)
            spins.append(np.zeros(3) if side.on_ground else motions[rank, turning])
            frames.append(np.eye(3) if side.on_ground else poses[side.body, 3:, 0].reshape(3, 3))
        spin, given = frames[0] @ (spins[1] - spins[0]), joint.axes[0][:, 0]
        axis = spin / np.linalg.norm(spin) * np.sign(spin @ given)
        sine = np.cross(axis, given)
        turn = sine / max(np.linalg.norm(sine), 1e-300) * np.arcsin(min(np.linalg.norm(sine), 1.0))
        if not np.linalg.norm(turn) < 0.2:
            return ""
        axis, turn = (", ".join(f"{x:.6g}" for x in np.round(part, 9) + 0.0) for part in (axis, turn))
        return f": joints.{joint.name} with axis = [{axis}] and offset = {{ turn = [{turn}] }}"

    def _closed_from(self, start: np.ndarray, nearest: np.ndarray, theta: np.ndarray, tries: int) -> np.ndarray | None:
        """Return poses (n_bodies, n_pose, 1) at which the joints close at theta (1, n_theta), None if none are found:
        from the nearest ones, and from bodies that are moved by chance."""
        rng, far = np.random.default_rng(0), self.mechanism.space.units(self.size)[:, None]
        for guess in (nearest, *(start + far * rng.normal(size=start.shape) for _ in range(tries))):
            closed, gap = self.newton(guess, theta)
            if gap[0] < CLOSURE_TOLERANCE:
                return closed
        return None

    def _placements(self, poses: np.ndarray) -> str:
        """Return the placements of bodies at poses (n_bodies, n_pose, 1) as entries of a scene."""
        texts, d = [], self.mechanism.space.dimension
        for body, pose in zip(self.mechanism.bodies, poses[..., 0]):
            origin = ", ".join(f"{x:.4g}" for x in np.where(np.abs(pose[:d]) > NO_GAP * self.size, pose[:d], 0.0))
            if d == 2:
                turn = f"angle = {np.remainder(pose[2] + np.pi, 2.0 * np.pi) - np.pi:.4g}"
            else:
                vector = scipy.spatial.transform.Rotation.from_matrix(pose[3:].reshape(3, 3).T).as_rotvec()
                turn = f"rotation = [{', '.join(f'{x:.4g}' for x in vector)}]"
            texts.append(f"bodies.{body.name}.placement = {{ origin = [{origin}], {turn} }}")
        return ", ".join(texts)

    def _gaps(self, residual: np.ndarray) -> tuple[str, str]:
        """Return what remains of a residual (n_rows,), and the name of the joint that is furthest from closed."""
        scaled = residual / self._scale
        blame = max(self.mechanism.holders, key=lambda c: np.max(np.abs(scaled[c.rows])))
        if blame in self.mechanism.couplings:
            return f"the coupling is {residual[blame.rows][0]:.3g} off", blame.name
        lengths = [np.array([part.is_length for part in c.statements]) for c in self.mechanism.connections]
        apart = sum(np.linalg.norm(residual[c.rows][of]) for c, of in zip(self.mechanism.connections, lengths))
        if apart > NO_GAP * self.size:
            return f"a gap of {self.mechanism.scene.system.text(apart, 'm')} remains", blame.name
        turned = np.max(np.abs(scaled[blame.rows]))
        return f"the points meet, and an angle of {np.arcsin(min(turned, 1.0)):.3g} rad remains", blame.name

    def _nearest(self, poses: np.ndarray, theta: np.ndarray) -> np.ndarray:
        """Return poses (n_bodies, n_pose, 1) of rigid bodies whose joints come as near as they can, from such poses at
        theta (1, n_theta)."""
        weights = STIFF / self._scale
        weights[: self.n_constraints] /= STIFF
        space, start = self.mechanism.space, self.mechanism.space.straightened(poses)

        def moved(motions: np.ndarray) -> np.ndarray:
            return space.displaced(start, motions.reshape(len(poses), space.n_dofs, 1))

        def weighted(motions: np.ndarray) -> np.ndarray:
            return weights * self.residual(moved(motions), theta)[:, 0]

        origin = np.zeros(self._units.size)
        return moved(scipy.optimize.least_squares(weighted, origin, "3-point", x_scale=self._units).x)

    def closed_freely(self, poses: np.ndarray) -> np.ndarray:
        """Close the loops near poses (n_bodies, n_pose, n) wherever the coordinates then are; best effort."""
        return self.newton(poses, None)[0]

    def moving(self, parts: Sequence[Attached], poses: np.ndarray) -> np.ndarray:
        """Return which statements, with their sides, can change at poses (n_bodies, n_pose, 1) while the coordinates
        rest."""
        rows = StatementRows.on_poses(parts, self.mechanism.space)
        _, values, right = np.linalg.svd(self.scaled(self.jacobian(poses))[0])
        free = right[np.sum(values > SINGULAR_TOLERANCE * values[0]) :]
        slopes = (RowsOfMotions(rows, self.mechanism)(poses)[0] * self._units) @ free.T
        scale = _scales(parts, self.size)
        return np.abs(slopes).max(axis=1, initial=0.0) > SINGULAR_TOLERANCE * scale

    def corrected(self, poses: np.ndarray, theta: np.ndarray) -> np.ndarray:
        """Return poses (n_bodies, n_pose, n) that close the loops at theta (n, n_theta), after one step more: to the
        last digit."""
        motions, _ = self._step(poses, self.residual(poses, theta))
        return self.mechanism.space.displaced(poses, -motions)

    def _step(self, poses: np.ndarray, residual: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the motions of bodies to be taken back, (n_bodies, n_dofs, n), and what then is left of the residual
        (n_rows, n) at first order; of the closure alone, if the residual has no driving rows."""
        jacobian = self.jacobian(poses)[:, : len(residual)]
        motions = self._solver(jacobian)(residual.T[..., None])
        return self.jacobian.by_body(motions)[:, :, 0], residual - (jacobian @ motions)[..., 0].T

    def pieces(self, n: int) -> list[slice]:
        """Return pieces of n configurations whose dense Jacobians stay in a cache, if these are not few."""
        several = max(FEWEST, AT_ONCE // (self._rows.n * len(self._units)))
        return [slice(first, first + several) for first in range(0, max(n, 1), several)]

    def newton(
        self, poses: np.ndarray, theta: np.ndarray | None, tolerance: float = CLOSURE_TOLERANCE
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return poses as from `close` and how far each is open (n,), below the tolerance where it converged; undriven
        where no theta is given."""
        parts = self.pieces(poses.shape[2])
        found = [self._newton(poses[..., k], None if theta is None else theta[k], tolerance) for k in parts]
        return np.concatenate([one for one, _ in found], axis=2), np.concatenate([gap for _, gap in found])

    def _newton(self, poses: np.ndarray, theta: np.ndarray | None, tolerance: float) -> tuple[np.ndarray, np.ndarray]:
        """Run `newton` of a few configurations."""
        space, n_rows = self.mechanism.space, self.n_constraints if theta is None else self._rows.n
        poses = space.straightened(poses)
        closed, known, sound = np.zeros((3, poses.shape[2]), dtype=bool)
        # where nothing but J^-1 makes a step it serves the next one too, which by then is too small to need its own
        again = n_rows == self._rows.n and self._blocks is not None and not self.has_redundant
        kept = np.empty((0, 0, 0))
        for n_steps in range(MAX_ITERATIONS + 1):
            wanted = self.measured(poses).T if theta is None else theta
            residual = self.residual(poses, wanted)[:n_rows]
            gap = np.where(closed, 0.0, self._largest(residual))
            # each theta stops by itself, so that the others in the call have no part in its last digits
            open_ones = np.flatnonzero((gap >= tolerance) & np.isfinite(gap))
            if not open_ones.size or n_steps == MAX_ITERATIONS:
                # once more to the last digit, with the J that each has
                ended = np.flatnonzero(sound & (gap < tolerance))
                if ended.size:
                    poses[..., ended] = space.displaced(poses[..., ended], -self._again(kept, residual, ended))
                break
            moving = poses[..., open_ones]
            if not again:
                motions, left = self._step(moving, residual[:, open_ones])
                gap[open_ones] = self._split(residual[:, open_ones], left)[0]
                closed[open_ones] = gap[open_ones] < tolerance
            else:
                anew = open_ones[~known[open_ones] | (gap[open_ones] > NEAR)]
                if anew.size:
                    made = self.jacobian(poses[..., anew]) / self._scale[:, None]
                    sound[anew] = self._blocks.factorise(made)
                    kept = kept if kept.size else np.empty((known.size, *made.shape[1:]))
                    kept[anew] = made
                known[:] = False  # J serves once more at most
                known[anew] = True
                motions = self._again(kept, residual, open_ones)
                odd = ~sound[open_ones]
                if odd.any():
                    motions[..., odd] = self._step(moving[..., odd], residual[:, open_ones[odd]])[0]
            # far from the solution a whole step can throw a body around; no more than half a radian at once
            turn = np.abs(motions[:, space.dimension :]).max(axis=(0, 1))
            poses[..., open_ones] = space.displaced(moving, -motions * np.minimum(1.0, 0.5 / np.maximum(turn, 1e-300)))
        return poses, gap

    @cached_property
    def _blocks(self) -> Blocks | None:
        """Statements and motions that follow together; None where there are not as many of one as of the other."""
        rows, dofs = self._rows, self._rows.dofs
        bodies = np.zeros((rows.n, len(self.mechanism.bodies)), dtype=bool)
        felt = dofs >= 0
        own = np.broadcast_to(rows.row_of[:, None], dofs.shape)[felt]
        bodies[own, dofs[felt] // self.mechanism.space.n_pose] = True
        pattern = np.repeat(bodies, self.mechanism.space.n_dofs, axis=1)
        return Blocks.of(triangular_blocks(pattern)) if pattern.shape[0] == pattern.shape[1] else None

    def _again(self, factors: np.ndarray, residual: np.ndarray, chosen: np.ndarray) -> np.ndarray:
        """Return the motions to be taken back, (n_bodies, n_dofs, n), by chosen ones (n,) of J that were factorised and
        the residuals (n_rows, n_all) there."""
        right = residual[:, chosen].T[..., None] / self._scale[:, None]
        return self.jacobian.by_body(self._blocks.substituted(factors, chosen, right))[:, :, 0]

    def _solver(self, jacobian: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
        """Return what gives the least y (n, n_dofs n_bodies, k) that comes nearest to ``J y = right`` for right-hand
        sides of J (n, n_rows, k)."""
        n_rows = jacobian.shape[1]
        scale = self._scale[:n_rows, None]
        solve = solver(jacobian / scale, self._blocks if n_rows == self._rows.n else None)
        return lambda right: solve(right / scale)

    def _changed(self, poses: np.ndarray, motions: np.ndarray) -> np.ndarray:
        """Return how poses (n_bodies, n_pose, n) change, (n_bodies, n_pose, k, n), by motions (n, n_dofs n_bodies, k)
        of bodies."""
        return self.mechanism.space.changes(poses, self.jacobian.by_body(motions))


class RowsOfMotions:
    """Derivatives of statements in displacements and turns of rigid bodies, along the inertial axes, those of one body
    after the other.

    Called with poses (n_bodies, n_pose, n) it returns them, shape (n, n_rows, n_dofs n_bodies). Derivatives of the
    statements in the numbers of poses, `StatementRows.jacobian_values`, may be at hand.
    """

    def __init__(self, rows: StatementRows, mechanism: Mechanism) -> None:
        self._rows, self._space, self._n_bodies = rows, mechanism.space, len(mechanism.bodies)
        of, columns = rows.jacobian_pattern
        self._pattern = of, *np.divmod(columns, self._space.n_pose)
        self._sums = sp.csr_matrix((np.ones(of.size), (of, np.arange(of.size))), shape=(rows.n, of.size))

    def __call__(self, poses: np.ndarray, values: np.ndarray | None = None) -> np.ndarray:
        found = np.zeros((poses.shape[2], self._rows.n, self._space.n_dofs * self._n_bodies))
        values = self._rows.jacobian_values(_unknowns(poses)) if values is None else values
        _fill(values, *self._pattern, np.ascontiguousarray(poses), self._space.n_dofs, found)
        return found

    def along(self, values: np.ndarray, changes: np.ndarray) -> np.ndarray:
        """Return how statements with such derivatives change with changes of poses (n_bodies, n_pose, k, n), shape (n,
        n_rows, k)."""
        _, body, place = self._pattern
        parts = [self._sums @ (values * changes[body, place, k]) for k in range(changes.shape[2])]
        return np.stack(parts, axis=-1).swapaxes(0, 1)

    def by_body(self, motions: np.ndarray) -> np.ndarray:
        """Return motions (n, n_dofs n_bodies, k) by bodies, (n_bodies, n_dofs, k, n)."""
        shape = self._n_bodies, self._space.n_dofs, motions.shape[2], len(motions)
        return np.moveaxis(motions, 0, -1).reshape(shape)


@njit(cache=True, entry=True, error_model="numpy", counted=False)
def _fill(values, of, body, place, poses, n_dofs, found):
    """Add derivatives (n_entries, n), of rows in numbers of poses, in displacements and turns of bodies."""
    for number in range(poses.shape[2]):
        for entry in range(of.size):
            slope, row, first, at = values[entry, number], of[entry], n_dofs * body[entry], place[entry]
            if at < 3:
                found[number, row, first + at] += slope
            else:  # of a director, which turns by (phi x d)_c = phi_c+1 d_c+2 - phi_c+2 d_c+1
                c, start = at % 3, at - at % 3
                one, other = (c + 1) % 3, (c + 2) % 3
                found[number, row, first + 3 + one] += slope * poses[body[entry], start + other, number]
                found[number, row, first + 3 + other] -= slope * poses[body[entry], start + one, number]


def size_of(mechanism: Mechanism) -> float:
    """Return a length that is typical of a mechanism: the largest extent of a body, m."""
    return max(body.extent for body in mechanism.bodies)


def _scales(parts: Sequence[Attached], size: float) -> np.ndarray:
    """Return what statements are measured in, (n,): the size, m, or 1 rad, and of sums the largest of their terms."""

    def own(part: Statement | Combination) -> float:
        return size if part.is_length else 1.0

    def largest(part: Statement | Combination) -> float:
        return max([own(part), *(abs(f.factor) * own(one) for one, f in part.terms if not f.breaks.size)])

    return np.array([largest(part) for part, _ in parts])


def _unknowns(poses: np.ndarray) -> np.ndarray:
    """Return the poses (n_bodies, n_pose, n) of all bodies one after the other, shape (n_bodies n_pose, n)."""
    return poses.reshape(poses.shape[0] * poses.shape[1], poses.shape[2])


class ReleasedClosure:
    """Velocities that elastic joints allow rigid bodies while all coordinates are held: columns N_i of poses' rates.

    With the Jacobians C of what the joints hold in the motion, T of the coordinates and S of what they release,

        C N_i = 0,    T N_i = 0,    S_j N_i = delta_ij,

    where j goes over as many independent ones of the released directions as there are such motions: a frame on two
    mounts in the plane has three, of the six directions that these release. The closure is that of the configuration,
    whose joints are locked.
    """

    def __init__(self, closure: LoopClosure) -> None:
        mechanism = closure.mechanism
        self._closure = closure
        parts = mechanism.holding([], moving=True)[0] + [(c.statement, c.sides) for c in mechanism.coordinates]
        self._n_held = len(parts)
        parts += [(part.statement, c.sides) for c in mechanism.connections for part in c.released]
        carries = [part.key != "clearance" for c in mechanism.connections for part in c.released]
        parts += [(c.combination, c.sides) for c in mechanism.couplings if c.elastic]
        turning = [c.combination.terms for c in mechanism.couplings if c.elastic]
        carries += [any(function.breaks.size for _, function in terms) for terms in turning]
        self._carries = np.array([False] * self._n_held + carries, dtype=bool)
        self._rows = StatementRows.on_poses(parts, mechanism.space)
        self._jacobian_at = RowsOfMotions(self._rows, mechanism)
        self._scale = _scales(parts, closure.size)
        self._chosen: np.ndarray | None = None  # numbers of the rows, all that are held and the chosen released ones

    def rates(self, poses: np.ndarray) -> np.ndarray:
        """Return them at poses (n_bodies, n_pose, n), shape (n_bodies, n_pose, n_released, n): m and rad for 1 m or 1
        rad of a released direction."""
        n_bodies, n_pose, n = poses.shape
        if self._n_held == self._rows.n:
            return np.zeros((n_bodies, n_pose, 0, n))
        jacobian = self._jacobian_at(poses)
        if self._chosen is None:
            self._chosen = self._independent(jacobian[0])
        n_released = self._chosen.size - self._n_held
        unit = np.zeros((n, self._chosen.size, n_released))
        unit[:, self._n_held :] = np.eye(n_released)
        motions = self._jacobian_at.by_body(solver(jacobian[:, self._chosen])(unit))
        return self._closure.mechanism.space.changes(poses, motions)

    @property
    def carries(self) -> np.ndarray:
        """Whether these motions are of elastic joints or cams, (n_released,), once rates were asked for: couplings of
        one ratio and joints with clearance carry nothing along."""
        return self._carries[:0] if self._chosen is None else self._carries[self._chosen[self._n_held :]]

    def unheld(self, poses: np.ndarray, stiff: np.ndarray) -> int | None:
        """Return the released direction that moves most in a motion that is measured by none of the stiff ones, a mask
        (n_directions,), at poses (n_bodies, n_pose, 1); None where every motion is measured."""
        free, moved, whole = self._moved(self._jacobian_at(poses)[0])
        moved, whole = moved[self._n_held :], whole[self._n_held :]
        if not free.shape[1]:  # all that is released is held by other joints
            return None
        values, right = np.linalg.svd(np.vstack([moved[stiff], np.zeros((1, free.shape[1]))]))[1:]
        rank = int(np.sum(values > RELEASED_TOLERANCE * np.max(whole[stiff], initial=1e-300)))
        return int(np.argmax(np.abs(moved @ right[rank]))) if rank < free.shape[1] else None

    def _moved(self, jacobian: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return a basis of what the held rows allow, (n, n_free), how all rows change along it and, (n_rows,), by how
        much where nothing is held, all scaled."""
        scaled = self._closure.scaled(jacobian, self._scale)
        values, right = np.linalg.svd(scaled[: self._n_held])[1:]
        rank = int(np.sum(values > RELEASED_TOLERANCE * values[0]))
        return right[rank:].T, scaled @ right[rank:].T, np.linalg.norm(scaled, axis=1)

    def _independent(self, jacobian: np.ndarray) -> np.ndarray:
        """Return all rows that are held, and of the released ones as many as are independent of these, the first ones
        that are."""
        (free, moved, whole), chosen = self._moved(jacobian), list(range(self._n_held))
        basis = np.zeros((free.shape[1], 0))
        for row in range(self._n_held, len(moved)):
            rest = moved[row] - basis @ (basis.T @ moved[row])
            size = np.linalg.norm(rest)
            if size > RELEASED_TOLERANCE * whole[row]:
                chosen.append(row)
                basis = np.column_stack([basis, rest / size])
        return np.array(chosen)
