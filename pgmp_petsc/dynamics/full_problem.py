"""The equations of a batch of full-order samples as compiled functions take them, made from mechanism and effects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import scipy.sparse as sp

from pgmp_petsc.bodies.affine import evaluate_weights
from pgmp_petsc.bodies.beam2d import PACKED_COLUMNS, PACKED_ROWS
from pgmp_petsc.bodies.body import DOFS_PER_NODE
from pgmp_petsc.bodies.matrices import assemble, element_dofs
from pgmp_petsc.dynamics.batched_ldl import analyse
from pgmp_petsc.dynamics.body_damping import BodyDampings
from pgmp_petsc.dynamics.full_forces import BlockActions, Loads, ModalFactors
from pgmp_petsc.dynamics.full_kernel import Elements, FullProblem, Lumps, Pattern, Strengths
from pgmp_petsc.dynamics.local_forces import LocalForces
from pgmp_petsc.dynamics.lumped_masses import lumped_masses
from pgmp_petsc.dynamics.node_constraints import NodeConstraints
from pgmp_petsc.dynamics.sample_blocks import SampleBlocks
from pgmp_petsc.effects import Action, Effect, Motion, loads_of
from pgmp_petsc.mechanism.constraint_set import ConstraintSet
from pgmp_petsc.mechanism.kinematics import RigidKinematics


class Sources:
    """What changes with time alone.

    Parameters
    ----------
    loads
        Effect of every load.
    actions
        Actions of all effects.
    motions
        Prescribed motions.
    """

    def __init__(self, loads: Sequence[Effect], actions: Sequence[Action], motions: Sequence[Motion]) -> None:
        self.loads, self.actions, self.motions = tuple(loads), tuple(actions), tuple(motions)

    def at(self, times: np.ndarray) -> Strengths:
        """Return what acts at times of shape (n,), s."""
        n = times.size
        of_effects = {id(effect): np.broadcast_to(effect.amplitude(times), n) for effect in self.loads}
        loads = np.array([of_effects[id(effect)] for effect in self.loads]).reshape(-1, n)
        actions = np.zeros((n, len(self.actions)))
        for column, action in zip(actions.T, self.actions):
            if action.amplitude is not None:
                column[:] = [float(action.amplitude(time)) for time in times]
        moved = np.array([[motion.at(time)[:2] for motion in self.motions] for time in times]).reshape(n, -1, 2)
        angles, speeds = (np.ascontiguousarray(moved[..., k]) for k in range(2))
        return Strengths(np.ascontiguousarray(loads.T), actions, angles, speeds)


def full_problem(
    kinematics: RigidKinematics,
    effects: Sequence[Effect],
    values: Mapping[str, np.ndarray],
    blocks: SampleBlocks,
    constraints: ConstraintSet,
    damping: BodyDampings,
    local: LocalForces,
) -> tuple[FullProblem, list[Effect]]:
    """Return the equations of samples with parameter values of shape (n_samples,), and the effect of every load.

    Parameters
    ----------
    kinematics
        Rigid kinematics.
    effects
        Effects of the scene.
    values, blocks
        Parameter values, and how samples lie in arrays.
    constraints, damping, local
        What was made of the mechanism and its effects.
    """
    mechanism = kinematics.mechanism
    loads, load_effects = _loads(kinematics, effects, values, blocks)
    section = _sections(kinematics, damping, values, blocks)
    lumped = lumped_masses(mechanism.bodies, values, blocks.n_samples)
    lengths = np.array([body.mesh.lengths.sum() for body in mechanism.bodies])
    total = np.einsum("kbl,b->kl", section[:, :, 3], lengths)
    total += blocks.pack(lumped.mass[::DOFS_PER_NODE].sum(axis=0))
    dofs = np.concatenate([element_dofs(body.elements) for body in mechanism.bodies])
    n = mechanism.n_dofs + constraints.n_constraints
    rows, columns = constraints.jacobian_pattern
    lower = [
        (dofs[:, PACKED_ROWS].ravel(), dofs[:, PACKED_COLUMNS].ravel()),
        (mechanism.n_dofs + rows, columns),
        constraints.curvature_pattern,
        local.pattern,
        (lumped.dofs, lumped.dofs),
    ]
    i, j = (np.concatenate(parts) for parts in zip(*lower))
    pattern = sp.coo_matrix((np.ones(i.size), (i, j)), shape=(n, n))
    symbolic = analyse(pattern + pattern.T, np.arange(mechanism.n_dofs, n))
    elements = Elements(
        dofs,
        np.concatenate([body.mesh.lengths for body in mechanism.bodies]),
        np.concatenate([body.directions for body in mechanism.bodies]),
        np.concatenate([np.full(len(b.mesh.cells), k) for k, b in enumerate(mechanism.bodies)]),
        symbolic.position(dofs[:, PACKED_ROWS], dofs[:, PACKED_COLUMNS]),
        damping.any_rayleigh,
    )
    own = local.compiled
    in_blocks = (local.n_actions, blocks.n_blocks, blocks.n_lanes, own.parameters.shape[-1])
    parameters = own.parameters.reshape(in_blocks)
    actions = BlockActions(
        own.statements, own.laws, np.ascontiguousarray(np.moveaxis(parameters, 1, 0)), local.dofs, local.entries,
        symbolic.position(*local.pattern),
    )  # fmt: skip
    problem = FullProblem(
        elements,
        Lumps(lumped.dofs, lumped.body, symbolic.position(lumped.dofs, lumped.dofs), blocks.pack(lumped.mass)),
        loads,
        actions,
        ModalFactors.of(damping.modal),
        NodeConstraints.of(constraints, mechanism.n_dofs, symbolic),
        Pattern(symbolic.place, symbolic.starts, symbolic.rows, symbolic.targets),
        section,
        total / mechanism.n_nodes,
        np.tile([1 / kinematics.size, 1 / kinematics.size, 1.0], mechanism.n_nodes),
    )
    return problem, load_effects


def _sections(
    kinematics: RigidKinematics, damping: BodyDampings, values: Mapping[str, np.ndarray], blocks: SampleBlocks
) -> np.ndarray:
    """Evaluate ``(EA, k_s GA, EI, rho A, rho I, beta, alpha)`` of every body (n_blocks, n_bodies, 7, n_lanes)."""
    bodies, ones = kinematics.mechanism.bodies, np.ones(blocks.n_samples)
    table = np.zeros((len(bodies), 7, blocks.n_samples))
    for number, (body, row) in enumerate(zip(bodies, table)):
        if body.flexible:
            s = body.section
            quantities = (s.axial, s.shear, s.bending, s.line_density, s.rotary_density)
            row[:5] = [q.coefficient * (q.monomial.evaluate(values) * ones) for q in quantities]
            row[5:] = np.array(damping.rayleigh_of(number))[:, None]
    return blocks.pack(table)


def _loads(
    kinematics: RigidKinematics, effects: Sequence[Effect], values: Mapping[str, np.ndarray], blocks: SampleBlocks
) -> tuple[Loads, list[Effect]]:
    """Return the loads, and the effect of each."""
    mechanism = kinematics.mechanism
    loads = loads_of(effects, assemble(mechanism.bodies, range(mechanism.n_dofs)))
    by_name = {effect.name: effect for effect in effects}
    weights = evaluate_weights((load.weight for load in loads), values)
    weights = np.broadcast_to(weights if weights.ndim == 2 else weights[:, None], (len(loads), blocks.n_samples))
    vectors = sp.coo_matrix(np.array([load.vector for load in loads]).reshape(len(loads), mechanism.n_dofs))
    entries = Loads(vectors.row.astype(int), vectors.col.astype(int), vectors.data, blocks.pack(weights))
    return entries, [by_name[load.effect] for load in loads]
