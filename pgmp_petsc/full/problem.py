"""The equations of full-order samples on one rank as compiled functions take them, made from mechanism and effects.

A rank has the elements, joints and effects that touch its unknowns: all of them where samples are not shared.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from itertools import compress

import numpy as np
import scipy.sparse as sp

from pgmp_petsc.bodies.affine import Monomial, evaluate_weights
from pgmp_petsc.bodies.matrices import AffineMatrices
from pgmp_petsc.controllers.acting import given_to
from pgmp_petsc.controllers.running import Controls
from pgmp_petsc.effects import Action, Effect, Load, Motion, actions_of, loads_of
from pgmp_petsc.effects.action import amplitudes_over, compile_actions, counted_from
from pgmp_petsc.full.batched_ldl import analyse
from pgmp_petsc.full.damping import BodyDampings, ModalFactors
from pgmp_petsc.full.forces import BlockActions, Loads
from pgmp_petsc.full.kernel import FullProblem, Strengths
from pgmp_petsc.full.node_constraints import ConstraintParts
from pgmp_petsc.full.parts import (
    Share,
    contiguous,
    floating_bodies,
    placed,
    planar_beams,
    planar_masses,
    section_owners,
    sections,
    solids,
    spatial_beams,
    spatial_masses,
)
from pgmp_petsc.full.rank_solver import NoMatrix, RankLayout, WholeLayout
from pgmp_petsc.lanes.lane_items import SampleBlocks, width_of
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import Unknowns
from pgmp_petsc.mechanism.statement_rows import StatementRows

MESH, TIES, FRAMES, JOINTS = range(4)  # levels of elimination, see `batched_ldl`


class Sources:
    """Strengths that change with time alone: effect of every load, actions of all effects, and prescribed motions.

    `controls` are controllers of the only sample; None where there are none.
    """

    def __init__(self, loads: Sequence[Effect], actions: Sequence[Action], motions: Sequence[Motion]) -> None:
        self.loads, self.actions, self.motions = tuple(loads), tuple(actions), tuple(motions)
        self.controls: Controls | None = None

    @cached_property
    def controlled(self) -> tuple[list[int], list[int]]:
        """Numbers of the actions here to which forces are given, and numbers of these parts among those of all
        (`Controls.firsts`)."""
        found = [] if self.controls is None else given_to(self.actions)
        before = [sum(self.actions[k].effect == self.actions[one].effect for one in found if one < k) for k in found]
        firsts = dict(zip(self.controls.names, self.controls.firsts)) if found else {}
        return found, [firsts[self.actions[k].effect] + n for k, n in zip(found, before)]

    @cached_property
    def led_by_states(self) -> tuple[list[int], list[int]]:
        """Numbers of the actions here that are the first part of a force that is given, and of these forces."""
        numbers = dict(zip(self.controls.firsts, range(len(self.controls.names))))
        pairs = [(k, numbers[row]) for k, row in zip(*self.controlled) if row in numbers]
        return [k for k, _ in pairs], [number for _, number in pairs]

    def at(self, times: np.ndarray) -> Strengths:
        """Return what acts at times of shape (n,), s."""
        n = times.size
        of_effects = {id(effect): np.broadcast_to(effect.amplitude(times), n) for effect in self.loads}
        loads = np.array([of_effects[id(effect)] for effect in self.loads]).reshape(-1, n)
        moved = np.array([motion.at(times)[:2] for motion in self.motions]).reshape(-1, 2, n)
        angles, speeds = (np.ascontiguousarray(moved[:, k].T) for k in range(2))
        return Strengths(np.ascontiguousarray(loads.T), self.amplitudes(times), angles, speeds)

    def amplitudes(self, times: np.ndarray) -> np.ndarray:
        """Return those of the actions alone at times (n,), s, shape (n, n_actions)."""
        amplitudes = amplitudes_over(self.actions, times)
        if self.controls is not None and not self.controls.iterates:
            columns, numbers = self.led_by_states
            amplitudes[:, columns] += self.controls.forces(times)[:, 0, numbers]
        return amplitudes


class FullEquations:
    """The equations of a mechanism for some samples, on one rank.

    Samples have parameter values (n_samples,) each, and lie in arrays as `blocks` say; `initial` are positions (rad)
    and velocities (rad/s) of the coordinates at the start, (n_theta,) each. Where ranks share one sample, this one has
    `owned` unknowns. `in_joints` the matrix is made in joint coordinates: then there is none here, and of the
    constraints driven angles alone, for the power of their motions.

    `constraints` are all constraints; but in joint coordinates without those that follow from others. Of these `chosen`
    are here, and `owned_constraints` says which have their multiplier on this rank. `actions` are those here, `loads`
    the effect of every load, with `load_weights`; `damping` is that of all bodies, `modal` of those here. `layout` says
    where unknowns and entries lie in arrays.
    """

    def __init__(
        self,
        kinematics: RigidKinematics,
        effects: Sequence[Effect],
        values: Mapping[str, np.ndarray],
        blocks: SampleBlocks,
        initial: tuple[np.ndarray, np.ndarray],
        owned: range | None = None,
        in_joints: bool = False,
    ) -> None:
        mechanism = kinematics.mechanism
        unknowns = self.unknowns = Unknowns(mechanism)
        self._kinematics, self.initial, self.values = kinematics, initial, dict(values)
        self.size = kinematics.size
        self.constraints = kinematics.constraints
        if not in_joints:
            self.constraints = self.constraints.independent(self._place(initial[0])[1])
        self.n_dofs, n_all = unknowns.n_dofs, unknowns.n_dofs + self.constraints.n_constraints
        rows = self.rows = range(self.n_dofs) if owned is None else owned
        self.damping = BodyDampings.of(effects, mechanism, unknowns.bodies)
        values = {name: np.broadcast_to(value, (blocks.n_samples,)) for name, value in values.items()}
        share = Share(unknowns.bodies, rows, values, blocks, self.damping)
        d = unknowns.dimension
        n, n_driven = self.constraints.n_constraints, self.constraints.n_driven
        of_entries, columns = self.constraints.jacobian_pattern
        # the lowest unknown of every constraint, with which its multiplier goes
        self.owners = np.full(n, self.constraints.n_dofs)
        np.minimum.at(self.owners, of_entries, columns)
        self.chosen = np.arange(n - n_driven, n) if in_joints else np.unique(of_entries[share.owns(columns)])
        self.owned_constraints = share.owns(self.owners[self.chosen])
        masses = AffineMatrices(kinematics.mechanism.bodies, unknowns.in_mechanism(self.rows))
        # a couple that is constant in body frames is none in space
        loads = [one for one in loads_of(effects, masses) if unknowns.dimension == 2 or not one.in_bodies]
        floating = any(body.n_amplitudes for body in unknowns.bodies)
        falling = [one for one in effects if floating and one.field is not None]
        gravity = list(enumerate(falling, len(loads)))
        by_name = {effect.name: effect for effect in effects}
        self.loads = [*(by_name[load.effect] for load in loads), *falling]
        self.load_weights = [*(load.weight for load in loads), *(Monomial() for _ in falling)]
        parts = (
            planar_beams(share), planar_masses(share), solids(share, d), spatial_beams(share),
            spatial_masses(share, unknowns), floating_bodies(share, unknowns, gravity),
        )  # fmt: skip
        bound = ConstraintParts(self.constraints, self.chosen, kinematics.size)
        self._acts = _acting(actions_of(effects, d), unknowns, share)
        self.actions = acting = self._actions_of(effects)
        dofs, entries, of_actions = pairs_of(acting, unknowns.frame)
        none = np.iinfo(dofs.dtype).max  # behind all unknowns
        coordinates = mechanism.coordinates if d == 3 else ()
        angles = StatementRows([(c.statement, c.sides) for c in coordinates], unknowns.frame, d)
        modal = self.modal = [one for one in self.damping.modal if share.owns(one.dofs).any()]
        patterns = [pattern for _, pattern in parts] + [bound.pattern, of_actions]
        needed = [np.arange(rows.start, rows.stop), angles.dofs[angles.dofs >= 0], *(one.dofs for one in modal)]
        pattern = tuple(np.concatenate([*(part[k].ravel() for part in patterns), *needed]) for k in range(2))
        if in_joints:
            self.layout = NoMatrix(self.n_dofs, n_all)
        else:
            self.layout = self._whole(pattern, n_all) if owned is None else RankLayout(self.n_dofs, n_all, pattern)
        placed_parts = [placed(part, pattern, self.layout) for part, pattern in parts]
        filled = {name: blocks.fill(value) for name, value in values.items()}
        compiled = compile_actions(acting, filled, blocks.n_places, d)
        n_parameters = compiled.parameters.shape[-1]
        parameters = compiled.parameters.reshape(len(acting), blocks.n_blocks, blocks.n_lanes, n_parameters)
        actions = BlockActions(
            compiled.statements, compiled.laws, np.ascontiguousarray(np.moveaxis(parameters, 1, 0)), compiled.roles,
            compiled.firsts, self.layout.unknowns(dofs), entries, self.layout.positions(*of_actions),
            share.owns(np.where(dofs < 0, none, dofs).min(axis=1, initial=none)[compiled.firsts[:-1]]),
            np.full((blocks.n_blocks, len(acting), blocks.n_lanes), np.nan),
        )  # fmt: skip
        counting = angles.compiled._replace(dofs=self.layout.unknowns(angles.dofs))
        units = self.units = np.full(self.n_dofs, 1.0 / kinematics.size)
        unknowns.frames(units)[:, d:] = 1.0
        here = self.layout.needed[: self.layout.n_unknowns]
        self.problem = contiguous(FullProblem(
            width_of(blocks.n_lanes), d, *placed_parts, self._entries_of(loads, len(falling), values, blocks), actions,
            ModalFactors.of(modal, d, self.layout.unknowns, rows), bound.placed(self.layout, self.owned_constraints),
            counting, self.layout.pattern, sections(share),
            self.damping.rayleigh[section_owners(unknowns.bodies)], units[here],
        ))  # fmt: skip
        self._coordinates = angles
        self.n_turns = angles.n + len(dofs) if d == 3 else 0

    @cached_property
    def start(self) -> tuple[np.ndarray, np.ndarray]:
        """Unknowns and velocities (n_dofs,) of the undeformed mechanism at the start."""
        return self.place(*self.initial)

    def place(self, theta: np.ndarray, rates: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return unknowns and velocities (n_dofs,) of the undeformed mechanism for coordinates and rates (n_theta,)."""
        poses, q = self._place(theta)
        return q, self.unknowns.place(poses[..., 0], self._kinematics.rates(poses)[..., 0] @ rates)

    def _place(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return poses (n_bodies, n_pose, 1) and unknowns (n_dofs,) of the undeformed mechanism."""
        poses = self._kinematics.poses(theta)
        return poses, self.unknowns.place(poses[..., 0])

    def turns(self, theta: np.ndarray) -> np.ndarray:
        """Return the angles that turns are counted from, those of coordinates (n_theta, n) and zero for others, rad,
        shape (n_turns, n)."""
        if not self.n_turns:
            return np.zeros((0, theta.shape[1]))
        return np.concatenate([theta, *(counted_from(action, self._kinematics, theta) for action in self.actions)])

    def sources(self, effects: Sequence[Effect], motions: Sequence[Motion]) -> Sources:
        """Return what changes with time alone of the effects that these equations were made of, or of others that
        differ from them in nothing else."""
        by_name = {effect.name: effect for effect in effects}
        return Sources([by_name[effect.name] for effect in self.loads], self._actions_of(effects), motions)

    def _actions_of(self, effects: Sequence[Effect]) -> tuple[Action, ...]:
        return tuple(compress(actions_of(effects, self.unknowns.dimension), self._acts))

    @property
    def edges(self) -> list[int]:
        """Numbers of the actions of all edges of laws."""
        return [k for k, action in enumerate(self.actions) for _ in action.law.edges]

    def frames(self, q: np.ndarray, turns: np.ndarray) -> np.ndarray:
        """Return the frames of all nodes as outputs take them, in space with the coordinates behind.

        Unknowns and turns have the shapes (n_dofs, n) and (n_turns, n), the frames (n_nodes, n_frame, n).
        """
        frames = self.unknowns.frames(q)
        if self.unknowns.dimension == 2:
            return frames
        angles = self._coordinates.values(q, turns[: self._coordinates.n])
        return np.concatenate([frames, np.broadcast_to(angles, (len(frames), *angles.shape))], axis=1)

    def _whole(self, pattern: tuple[np.ndarray, np.ndarray], n: int) -> WholeLayout:
        rows, columns = pattern
        both = np.concatenate([rows, columns]), np.concatenate([columns, rows])
        whole = sp.csr_matrix((np.ones(both[0].size), both), shape=(n, n))
        levels = np.full(n, MESH)
        frames = self.unknowns.frames(levels)
        for body in self.unknowns.bodies:
            frames[body.tied_nodes] = FRAMES
        levels[self.n_dofs :] = np.where(self.constraints.of_ties, TIES, JOINTS)
        return WholeLayout(analyse(whole, levels), self.n_dofs)

    def _entries_of(
        self, loads: Sequence[Load], n_falling: int, values: Mapping[str, np.ndarray], blocks: SampleBlocks
    ) -> Loads:
        """Return the loads by their entries, and behind them as many without any as bodies in floating frames need to
        know the strength of their weight."""
        own = self.unknowns.in_mechanism(self.rows)
        weights = evaluate_weights((load.weight for load in loads), values)
        weights = np.broadcast_to(weights if weights.ndim == 2 else weights[:, None], (len(loads), blocks.n_samples))
        vectors = sp.coo_matrix(np.array([load.vector for load in loads]).reshape(len(loads), len(own)))
        dofs = self.layout.unknowns(self.unknowns.of_mechanism(own.start + vectors.col.astype(int)))
        weights = np.concatenate([weights, np.ones((n_falling, blocks.n_samples))])
        return Loads(vectors.row.astype(int), dofs, vectors.data, blocks.pack(weights))


def _acting(actions: Sequence[Action], unknowns: Unknowns, share: Share) -> list[bool]:
    """Return which actions are on an unknown of a rank, those that lead where the ones behind them are."""
    acts = [
        any(share.owns(unknowns.frame(side.node)).any() for side in action.sides if not side.on_ground)
        for action in actions
    ]
    for k, action in enumerate(actions):
        if action.leads:
            acts[k] = acts[k + 1]
    return acts


def pairs_of(
    actions: Sequence[Action], frame: Callable[[int], np.ndarray]
) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]:
    """Return the unknowns of both nodes of every term of actions, -1 on the ground, shape (n_terms, 2 m), which entries
    of the actions' tangents there are (`evaluate_actions`), and the unknowns that these pair.

    `frame` gives the unknowns (m,) of a node.
    """
    m, every = frame(0).size, [side for action in actions for side in action.sides]
    dofs = np.full((len(every), m), -1)
    for side, own in zip(every, dofs):
        if not side.on_ground:
            own[:] = frame(side.node)
    dofs = dofs.reshape(-1, 2 * m)
    last_terms = np.cumsum([len(action.statement.terms) for action in actions], dtype=int)
    each = [own.ravel() for own in np.split(dofs, last_terms)[:-1]]
    lower = [_lower(own) for own in each]
    starts = np.cumsum([0, *(i.size for i, _ in lower)])
    rows, columns = (np.concatenate([np.zeros(0, dtype=int), *(pair[k] for pair in lower)]) for k in (0, 1))
    paired = (
        np.concatenate([np.zeros(0, dtype=int), *(own[pair[k]] for own, pair in zip(each, lower))]) for k in (0, 1)
    )
    return dofs, (starts, rows, columns), tuple(paired)


def _lower(dofs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return places of pairs among unknowns (n,), -1 on the ground, that a tangent has on and below its diagonal; of
    an unknown that is there twice both pairs with itself."""
    moving = np.flatnonzero(dofs >= 0)
    i, j = (moving[part] for part in np.tril_indices(moving.size))
    twice = (dofs[i] == dofs[j]) & (i != j)
    return np.concatenate([i, j[twice]]), np.concatenate([j, i[twice]])
