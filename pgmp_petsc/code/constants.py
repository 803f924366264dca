"""The constants of a model in C: sizes, settings, and the tables of the reduced Lagrangian, weights taken out.

The tables are those that `dynamics.reduced_terms` interpolates, as samples or spline coefficients; the rigid inertia is
in the polynomials of degree 7 that the compiled kernel takes, and poses are in quintic Hermite polynomials.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pgmp_petsc.bodies.affine import Monomial, Quantity
from pgmp_petsc.code.refusal import check_model, check_scene
from pgmp_petsc.dynamics.generalised_alpha import count_steps
from pgmp_petsc.dynamics.second_order_system import Scheme
from pgmp_petsc.effects.time_function import Piece
from pgmp_petsc.mechanism.attachment import Attachment
from pgmp_petsc.models import ReducedModel
from pgmp_petsc.reduction.reconstruction import Reconstruction
from pgmp_petsc.reduction.served_range import Served
from pgmp_petsc.reduction.stencil import B_SPLINE
from pgmp_petsc.results.errors import limits_of
from pgmp_petsc.runtime.errors import InputError
from pgmp_petsc.runtime.vectors import N_POWERS_OF_RIGID

# Each divides what is left by a thousand and more with steps that resolve the motion; measured in docs/export.md.
CORRECTIONS = 3
CONVERGED = 1e-9  # of the mechanism's size or of 1 rad: what a run of the program agrees to
MOST_NUMBERS = 4_000_000  # in the tables: some 80 MB of source, which a compiler takes a minute for
AXES = {"x": 0, "y": 1}


@dataclass(frozen=True)
class Side:
    """A point of a body or of the ground: slot of its node, number of its body, and its place, `Attachment`."""

    slot: int
    body: int
    point: tuple[float, float]
    arm: tuple[float, float]


@dataclass(frozen=True)
class Output:
    """An output: kind and sides; `numbers` are an origin (position), or a direction (sliding)."""

    kind: str
    a: Side
    b: Side
    axis: int = 0
    in_body: bool = False
    numbers: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True, eq=False)
class Constants:
    """All that a model in C is made of.

    Attributes
    ----------
    name
        Of the scene.
    settings
        Whole numbers and numbers of ``sizes.h`` by name.
    tables
        Arrays of ``tables.c`` by name.
    weights, load_weights
        Monomials of the terms and of the load terms.
    dampers, coefficients
        Slots of the two nodes of each damped joint, and its coefficient (N m s/rad).
    parameters
        Nominal values, or those that were set, by name.
    served
        Ranges that the model was built for, by name.
    loads
        Pieces of the strength of each load over time, by the effect's name.
    load_of_term
        Number of the load of each load term.
    outputs, measured
        Outputs by name, and the two sides of the coordinate's joint.
    output_units, parameter_units
        By name.
    node_bodies
        Body of every output node.
    """

    name: str
    settings: Mapping[str, int | float]
    tables: Mapping[str, np.ndarray]
    weights: tuple[Monomial, ...]
    load_weights: tuple[Monomial, ...]
    dampers: Sequence[tuple[int, int]]
    coefficients: Sequence[Quantity]
    parameters: Mapping[str, float]
    served: Mapping[str, Served]
    loads: Mapping[str, Sequence[Piece]]
    load_of_term: Sequence[int]
    outputs: Mapping[str, Output]
    measured: Output
    output_units: Mapping[str, str]
    parameter_units: Mapping[str, str]
    node_bodies: Sequence[int]


def constants_of(model: ReducedModel, what: str) -> Constants:
    """Collect the constants of a reduced model.

    Parameters
    ----------
    what
        What is to be written, for messages.

    Raises
    ------
    InputError
        If the model has what a model in C does not have, or tables too large for a source file.
    """
    check_scene(model.scene, what)
    check_model(model, what)
    terms, mechanism, scene = model.terms, model.kinematics.mechanism, model.scene
    actions = model.actions.actions
    nodes = sorted({*model.outputs.nodes, *(s.node for a in actions for s in a.sides if not s.on_ground)})
    slots = {node: slot for slot, node in enumerate(nodes)}
    bodies = np.repeat(np.arange(len(mechanism.bodies)), [body.n_nodes for body in mechanism.bodies])
    points = np.concatenate([body.mesh.nodes for body in mechanism.bodies])
    effects = {effect.name: effect for effect in model.effects}
    loads = {name: effects[name].strength.pieces for name in dict.fromkeys(terms.tables.load_effects)}
    tables = _tables(model, nodes, points)
    _check_size(tables, what)
    (sides,) = [c.connection.sides for c in mechanism.coordinates]
    return Constants(
        name=scene.name,
        settings=_settings(model, tables, len(nodes), len(loads), len(actions)),
        tables=tables,
        weights=terms.weights,
        load_weights=terms.tables.load_weights,
        dampers=[(slots.get(a.a.node, -1), slots.get(a.b.node, -1)) for a in actions],
        coefficients=[action.parameters[1] for action in actions],
        parameters=dict(scene.values),
        served=model.served,
        loads=loads,
        load_of_term=[list(loads).index(name) for name in terms.tables.load_effects],
        outputs={name: _output(model, name, slots) for name in scene.outputs},
        measured=Output("ANGLE", *(_side(side, slots) for side in sides)),
        output_units=model.outputs.units,
        parameter_units={name: "SI" if entry.unit is None else entry.unit for name, entry in scene.parameters.items()},
        node_bodies=[int(bodies[node]) for node in nodes],
    )


def _tables(model: ReducedModel, nodes: Sequence[int], points: np.ndarray) -> dict[str, np.ndarray]:
    terms, mechanism, branch = model.terms, model.kinematics.mechanism, model.rom.branch
    flexible = [node for body in mechanism.bodies if body.flexible for node in range(body.nodes.start, body.nodes.stop)]
    scheme, n_bodies = model.scene.reduction.interpolation, len(mechanism.bodies)
    of_outputs, of_all = (Reconstruction(model.kinematics, model.rom, scheme, some) for some in (nodes, flexible))
    shapes = [of_outputs.displacements.rows, of_all.displacements.rows[..., 2::3]]
    rigid = terms.polynomials.rigid
    step = branch.axes[0][1] - branch.axes[0][0]
    n_branch = branch.axes[0].size
    return {
        "rigid_table": rigid.reshape(*rigid.shape[:2], N_POWERS_OF_RIGID),
        "terms_table": terms.terms.rows,
        "loads_table": np.swapaxes(terms.load.rows, 0, 1),
        "shapes_table": np.concatenate(shapes, axis=2),
        "branch_table": np.array(
            [
                branch.poses,
                branch.rates.reshape(n_branch, n_bodies, 3) * step,
                branch.curvatures.reshape(n_branch, n_bodies, 3) * (0.5 * step**2),
            ]
        ),
        "scale": terms.scale,
        "winding": branch.winding[0],
        "node_points": points[list(nodes)].reshape(-1, 2),
    }


def _check_size(tables: Mapping[str, np.ndarray], what: str) -> None:
    size = sum(table.size for table in tables.values())
    if size > MOST_NUMBERS:
        raise InputError(
            f"{what}: the tables have {size} numbers; at most {MOST_NUMBERS} are written. Build with fewer "
            "reduction.modes or reduction.angles, or with reduction.interpolation = 'spline'"
        )


def _settings(
    model: ReducedModel, tables: Mapping[str, np.ndarray], n_nodes: int, n_loads: int, n_dampers: int
) -> dict[str, int | float]:
    terms, branch, simulation = model.terms, model.rom.branch, model.scene.simulation
    (axis,), (grid,) = terms.terms.axes, terms.grid
    n_steps = count_steps(simulation.duration, simulation.step)
    step = simulation.duration / n_steps
    scheme, first = Scheme.of(simulation.spectral_radius, step), branch.axes[0]
    return {
        "M": terms.layout.n_eta - 1,
        "SECOND_ORDER": int(terms.layout.second_order),
        "STRUCTURAL_DAMPING": int(terms.layout.damping < terms.layout.end),
        "PERIODIC": int(axis.periodic),
        "B_SPLINE": int(axis.basis == B_SPLINE),
        "N_ROWS": len(tables["terms_table"]),
        "N_CELLS": grid.n_cells,
        "AXIS_CELLS": axis.n_cells,
        "N_TERMS": len(terms.weights),
        "N_LOAD_TERMS": len(terms.tables.load_weights),
        "N_LOADS": n_loads,
        "N_DAMPERS": n_dampers,
        "N_PARAMETERS": len(model.scene.values),
        "N_OUTPUTS": len(model.scene.outputs),
        "N_NODES": n_nodes,
        "N_SHAPES": tables["shapes_table"].shape[2],
        "N_BODIES": tables["branch_table"].shape[2],
        "N_BRANCH": tables["branch_table"].shape[1],
        "N_STEPS": n_steps,
        "CORRECTIONS": CORRECTIONS,
        "CONVERGED": CONVERGED,
        "ROTATION_LIMIT": limits_of(model.scene.second_order)["elastic_rotation"],
        "AXIS_LOWER": axis.lower,
        "AXIS_STEP": axis.step,
        "CELL_LOWER": grid.lower,
        "CELL_WIDTH": grid.step,
        "BRANCH_LOWER": float(first[0]),
        "BRANCH_UPPER": float(first[-1]),
        "BRANCH_STEP": float(first[1] - first[0]),
        "START_POSITION": float(model.start[0][0]),
        "START_VELOCITY": float(model.start[1][0]),
        "STEP": step,
        "ALPHA_M": scheme.alpha_m,
        "ALPHA_F": scheme.alpha_f,
        "BETA": scheme.beta,
        "GAMMA": scheme.gamma,
        "GAIN_V": scheme.gain_v,
        "GAIN_A": scheme.gain_a,
        "MASS_DAMPING": 0.0 if terms.damping is None else terms.damping.mass,
    }


def _side(side: Attachment, slots: Mapping[int, int]) -> Side:
    point, arm = (tuple(float(x) for x in place) for place in (side.point, side.arm))
    return Side(slots.get(side.node, -1), side.body, point, arm)


def _output(model: ReducedModel, name: str, slots: Mapping[int, int]) -> Output:
    """Return an output as the model in C takes it; see `outputs.outputs`."""
    entry, mechanism = model.scene.outputs[name], model.kinematics.mechanism
    if entry.type in ("angle", "sliding"):
        sides = [_side(side, slots) for side in mechanism.connection(entry.joint).sides]
        if entry.type == "angle":
            return Output("ANGLE", *sides)
        axis = np.array(mechanism.scene.joints[entry.joint].axes[0], dtype=float)
        return Output("SLIDING", *sides, numbers=tuple((axis / np.linalg.norm(axis)).tolist()))
    if entry.type == "distance":
        points = [mechanism.attachment(point, f"outputs.{name}.points") for point in entry.points]
        return Output("DISTANCE", *(_side(point, slots) for point in points))
    point = mechanism.attachment(entry.point, f"outputs.{name}.point")
    side = _side(point, slots)
    if entry.type == "rotation":
        return Output("ROTATION", side, side)
    axis = AXES[entry.axis]
    if entry.type == "deformation":
        return Output("DEFORMATION", side, side, axis, entry.frame == "body")
    origin = 0.0
    if entry.type == "displacement":
        origin = float(point.frame_of_pose(model.kinematics.poses(model.start[0][None]))[axis, 0])
    return Output("POSITION", side, side, axis, numbers=(origin, 0.0))
