"""The constants of a component model in C: the tree of its joints, and moments and stiffness of its bodies.

All is what compiled functions take (`full.joint_systems`), evaluated with one sample for each monomial, of which that
alone is one (`Apart`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.bodies.affine import Monomial
from pgmp_petsc.c_export.constants import Constants, Tables, carried_by, check_size, checked_scene, shared_of
from pgmp_petsc.c_export.statements import Terms, braced, side_in_c, statement_in_c
from pgmp_petsc.full.joint_systems import JointBatch, JointEquations
from pgmp_petsc.full.parts import Share, floating_bodies, planar_masses, spatial_masses
from pgmp_petsc.full.problem import FullEquations
from pgmp_petsc.lanes.lane_items import SampleBlocks
from pgmp_petsc.models import ComponentModel
from pgmp_petsc.outputs.multipliers import OfPrescribed
from pgmp_petsc.scene import Scene
from pgmp_petsc.stepping import alpha_step

#: How it takes steps: those of the program.
STEPS = {
    "ROTATION_LIMIT": np.inf,
    "EXCHANGE": 0,
    "CORRECTIONS": 1,
    "NEWTON_TOLERANCE": alpha_step.NEWTON_TOLERANCE,
    "TOLERANCE_OF_ONE": alpha_step.TOLERANCE_OF_ONE,
}


class Apart(Share):
    """A mechanism in as many samples as there are monomials, in each of which one of them is 1 and all others are 0;
    `values` are their numbers, which are given as they come."""

    def evaluate(self, terms: Mapping[Monomial, Sequence[float] | np.ndarray]) -> np.ndarray:
        """Return the coefficients of all monomials, shape (..., n_samples)."""
        n = self.blocks.n_samples
        columns = [self.values.setdefault(weight, len(self.values)) for weight in terms]
        return sum(
            np.multiply.outer(np.array(p), np.eye(1, n, column)[0]) for column, p in zip(columns, terms.values())
        )


def tree_constants_of(model: ComponentModel, what: str) -> Constants:
    """Collect the constants of a component model; raises as `constants_of`."""
    scene = checked_scene(model.scene, what)
    if scene is not model.scene:
        model = model.in_scene(scene)
    system = model.batch({name: np.array([value]) for name, value in scene.values.items()}, 1)
    _require_taken(model, system, what)
    own, equations = system.own, system.own.equations
    mechanism = model.kinematics.mechanism
    n_parts = sum(len(action.statement.terms) for action in equations.actions)
    windings = np.zeros((n_parts, len(mechanism.coordinates)))
    of_joints = [one for one in (*carried_by(model), *model.outputs.forces) if not isinstance(one, OfPrescribed)]
    gaps = sorted({int(row) for one in of_joints for row in one.rows})
    system.require_settled()
    turned = equations.turns(equations.initial[0][:, None])[:, 0]  # in the plane nodes count turns
    turned = turned if turned.size else np.zeros(len(mechanism.coordinates) + n_parts)
    parts, terms = _parts_of(own, equations), Terms()
    tables = _tables(model, system, parts) | {"start_turned": ("[]", turned)}
    check_size(tables, what)
    given = set(own.driven[:, 0].tolist())
    found = shared_of(
        model, range(mechanism.n_nodes), equations.actions, equations.loads, windings, gaps, terms,
        {"terms": parts.weights, "loads": equations.load_weights},
        kind="tree", tables=tables, prescribed=[k in given for k in range(own.n)],
    )  # fmt: skip
    prescribed = [k for k, one in enumerate(mechanism.coordinates) if one.prescribed]
    constraints, bonds = _constraints(own, prescribed, terms)
    held, holds, left = _holds(own, gaps, mechanism.n_nodes, len(constraints), terms) if gaps else ([], [], [])
    drives = [braced(one, prescribed[motion], float(sign)) for one, motion, sign in own.driven.tolist()]
    pushes, (owners, behind) = _pushes(own, equations), _carried(own, mechanism.n_nodes)
    strengths, gravity = list(found.strength_units), own.problem.floating.gravity_loads
    faces = own.joints.tree
    ranges = [braced(c.lower, c.upper - c.lower, 1, 2, c.periodic, 0) for c in mechanism.coordinates]
    sizes = _sizes(system, parts) | {
        "N_CONSTRAINT_TERMS": len(constraints), "N_PUSHES": len(pushes), "N_DRIVES": len(drives),
        "PROJECTS": int(_projects(scene, system)), "N_GAPS": len(gaps), "N_HOLDS": len(holds),
    }  # fmt: skip
    lists = {
        "const struct body tree[N_TREE]": list(_bodies(own)),
        "const struct face faces[]": list(map(braced, faces.face_nodes, *faces.at.T, faces.centres)),
        "const struct mass masses[]": parts.masses,
        "const struct push pushes[]": pushes,
        "const struct drive drives[]": drives,
        "const struct bond bonds[]": bonds,
        "const struct hold holds[]": holds,
        "const struct term constraints[]": [*constraints, *held],
        "const struct axis branch_axes[R]": ranges,
        "const int left_of_gap[]": left,
        "const int owners[]": owners,
        "const int behind[]": behind,
        "const int gravity_strengths[]": [strengths.index(equations.loads[load].name) for load in gravity],
        "const int body_nodes[]": _base_nodes(equations),
    }
    return replace(found, settings=found.settings | STEPS | sizes, lists=found.lists | lists)


def _tables(model: ComponentModel, system: JointBatch, parts: Parts) -> Tables:
    own, tree, state = system.own, system.own.joints.tree, system.start()
    equations, space = own.equations, model.kinematics.mechanism.space
    poses = model.kinematics.poses(equations.initial[0])[..., 0]
    frames, d = equations.unknowns.frames(equations.start[0]), space.dimension
    # where the nodes of the frames of all bodies are in them, m
    centres = [
        space.to_body(pose[:, None], (frames[node] - pose)[:d, None])[:, 0]
        for node, pose in zip(_base_nodes(equations), poses)
    ]
    return {
        "moments": ("[N_TERMS][AT_LEAST_ONE(N_WORDS)]", parts.moments),
        "densities": ("[N_TERMS][AT_LEAST_ONE(N_MASSES)][1 + D][1 + D]", parts.densities),
        "gravity": ("[N_TERMS][AT_LEAST_ONE(N_GRAVITY)][D]", parts.gravity),
        "shapes": ("[]", tree.shapes),
        "curves": ("[]", tree.bent),
        "curve_rows": ("[]", tree.rows),
        "curve_columns": ("[]", tree.columns),
        "first_entries": ("[]", own.problem.floating.rows),
        "columns": ("[]", own.problem.floating.columns),
        "body_centres": ("[N_BODIES][D]", np.array(centres)),
        "scale": ("[]", own.joints.units),
        "start_coordinates": ("[N]", system.unpack(state.q)[:, 0]),
        "start_rates": ("[N]", system.unpack(state.v)[:, 0]),
    }


def _sizes(system: JointBatch, parts: Parts) -> dict[str, float]:
    own, tree, equations = system.own, system.own.joints.tree, system.own.equations
    return {
        "N": own.n,
        "N_LEFT": own.n_statements,
        "N_TREE": len(tree.kinds),
        "N_WORDS": parts.moments.shape[1],
        "N_MASSES": len(parts.masses),
        "N_GRAVITY": own.problem.floating.gravity_loads.size,
        "N_TERMS": len(parts.weights),
        "N_LOAD_TERMS": len(equations.load_weights),
        "MOST": max(2, *tree.n_amplitudes),
        "ALWAYS_PROBED": int(any(action.law.bends for action in equations.actions)),
        "TYPICAL_MASS": float(system.typical_mass[0]),
    }


def _require_taken(model: ComponentModel, system: JointBatch, what: str) -> None:
    """Refuse what models in C of component models do not have."""
    scene = model.scene
    if system.own.problem.modal.kinds.size:
        raise InputError(
            f"effects: a model in C has no modal damping of bodies on their meshes; {what} cannot be written. Take "
            "pgmp simulate for this model, or a reduced one"
        )
    if scene.controllers and _projects(scene, system):
        raise InputError(
            f"simulation.spectral_radius = {scene.simulation.spectral_radius:g}: a model in C does not project "
            "motions beside controllers, which need some numerical damping then; "
            f"{what} cannot be written. Take at most {alpha_step.DAMPED:g}"
        )


def _projects(scene: Scene, system: JointBatch) -> bool:
    """Return whether steps end with a projection, see `AlphaStep`."""
    return scene.simulation.spectral_radius > alpha_step.DAMPED and system.moving_constraints


class Parts(NamedTuple):
    """What of the equations hangs on parameters: monomials, and their coefficients; and nodes with masses, in C."""

    weights: list[Monomial]
    moments: np.ndarray  # shape (n_weights, n_words)
    densities: np.ndarray  # shape (n_weights, n_masses, 1 + d, 1 + d)
    gravity: np.ndarray  # shape (n_weights, n_gravity, d)
    masses: list[str]


def _parts_of(own: JointEquations, equations: FullEquations) -> Parts:
    """Return the parts of the equations, one by one in their monomials."""
    unknowns, d = equations.unknowns, equations.unknowns.dimension
    falling = [(load, equations.loads[load]) for load in own.problem.floating.gravity_loads.tolist()]
    weights: dict[Monomial, int] = {}
    n = 1  # until all are known
    while True:
        share = Apart(unknowns.bodies, range(equations.n_dofs), weights, SampleBlocks.of(n), equations.damping)
        floating = floating_bodies(share, unknowns, falling)[0]
        lumps, masses = planar_masses(share)[0], spatial_masses(share, unknowns)[0]
        if n == len(weights):
            break
        n = len(weights)

    def apart(array: np.ndarray) -> np.ndarray:
        return np.moveaxis(share.blocks.unpack(array), -1, 0)

    if d == 3:
        nodes, owners, densities = masses.dofs[:, 0] // unknowns.frame(0).size, masses.body, apart(masses.density)
    else:
        every, (parts, values) = lumps.dofs // 3, (lumps.dofs % 3, apart(lumps.mass))
        nodes, rows = np.unique(every, return_inverse=True)
        owners, densities = np.zeros(nodes.size, dtype=int), np.zeros((n, nodes.size, 3, 3))
        owners[rows] = lumps.body
        densities[:, rows[parts == 0], 0, 0] = values[:, parts == 0]
        for k in (1, 2):  # of directors, which turn together
            densities[:, rows[parts == 2], k, k] = 0.5 * values[:, parts == 2]
    rayleigh = own.problem.rayleigh
    texts = [braced(node, float(rayleigh[body, 1])) for node, body in zip(nodes.tolist(), owners.tolist())]
    return Parts(list(weights), apart(floating.table), densities, apart(floating.gravity), texts)


def _bodies(own: JointEquations) -> Iterator[str]:
    tree, floating = own.joints.tree, own.problem.floating
    for k, kind in enumerate(tree.kinds.tolist()):
        on, held, base = tree.nodes[k]
        turning, sliding, natural, first = tree.firsts[k, :4]
        number, table, rows, columns, damped, curved = tree.floating[k], -1, 0, 0, (0.0, 0.0), 0
        if number >= 0:
            _, table, _, rows, columns, _ = floating.firsts[number]
            damped = own.problem.rayleigh[floating.body[number]]
            n, d = tree.n_amplitudes[k], own.problem.dimension
            curved = int(floating.firsts[number + 1, 3] - rows > d * d * n + n + 1)
        yield braced(
            kind, on, held, base, turning, sliding, natural, first, tree.n_amplitudes[k], tree.faces[k],
            tree.faces[k + 1], table, rows, columns, curved, *map(float, (*damped, tree.rest[k])), tree.before[k],
            tree.after[k],
        )  # fmt: skip


def _pushes(own: JointEquations, equations: FullEquations) -> list[str]:
    loads, tree, unknowns = own.problem.loads, own.joints.tree, equations.unknowns
    n_frame, found = unknowns.frame(0).size, []
    of_frames = n_frame * unknowns.mechanism.n_nodes
    for term, dof, value in zip(loads.numbers.tolist(), loads.dofs.tolist(), loads.values.tolist()):
        node, component = divmod(dof, n_frame)
        if dof >= of_frames:
            k = int(np.flatnonzero((tree.internal <= dof) & (dof < tree.internal + tree.n_amplitudes))[0])
            node, component = -1, tree.firsts[k, 3] + dof - tree.internal[k]
        found.append(braced(term, node, component, value))
    return found


def _carried(own: JointEquations, n_nodes: int) -> tuple[list[int], list[int]]:
    """Return the body of the tree that each node is on, and the first one behind what each body carries."""
    bodies, owners = own.equations.unknowns.bodies, [0] * n_nodes
    for k, motion in enumerate(own.motions):
        body = bodies[motion.body]
        owners[body.first_node : body.first_node + body.n_nodes] = [k] * body.n_nodes
    parents = [-1 if m.on is None or m.on.on_ground else owners[m.on.node] for m in own.motions]
    behind = list(range(1, len(parents) + 1))
    for k in reversed(range(len(parents))):
        if parents[k] >= 0:
            behind[parents[k]] = max(behind[parents[k]], behind[k])
    return owners, behind


def _holds(
    own: JointEquations, gaps: Sequence[int], n_nodes: int, first: int, terms: Terms
) -> tuple[list[str], list[str], list[int]]:
    """Return the terms of what the tree's joints hold, which stand from `first` on, that in C, and of each gap the
    constraint that is left whose multiplier it has, -1 of those of the tree and of what follows from others."""
    slots, numbers, held = {k: k for k in range(n_nodes)}, {row: k for k, row in enumerate(gaps)}, own.held
    found = [
        terms.term(-1, statement_in_c(one, *(side_in_c(side, slots) for side in sides)), one.terms[0][1])
        for one, sides in held.rows.parts
    ]
    places = enumerate(zip(held.places.tolist(), held.bodies.tolist()))
    holds = [braced(body, numbers.get(place, -1), first + k) for k, (place, body) in places]
    left = {row: k for k, row in enumerate(own.chosen.tolist())}
    return found, holds, [left.get(row, -1) for row in gaps]


def _base_nodes(equations: FullEquations) -> list[int]:
    return [body.first_node + body.n_nodes - 1 for body in equations.unknowns.bodies]


def _constraints(own: JointEquations, prescribed: Sequence[int], terms: Terms) -> tuple[list[str], list[str]]:
    """Return the terms of the constraints that the tree leaves, and the constraints in C."""
    _, parts, wanted, motions = own.set.statements_among(own.chosen)
    mechanism = own.equations.unknowns.mechanism
    found = terms.of(parts, mechanism.coordinates, {k: k for k in range(mechanism.n_nodes)})
    bonds = [braced(float(w), -1 if k < 0 else prescribed[k]) for w, k in zip(wanted, motions.tolist())]
    return found, bonds
