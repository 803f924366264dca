"""The constants of a model in C: sizes, settings, and the tables of the reduced Lagrangian, weights taken out; and what
such a model does not have, named by its entry in the scene.

The tables are those that `reduced.terms` interpolates, as samples or spline coefficients; that of the rigid inertia has
beside it what makes polynomials of degree 7, as in `reduced.cells`. Poses come from the table of the assembly branch.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate
from typing import Any

import numpy as np

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.base.units import UnitSystem, dimension_of
from pgmp_petsc.bodies.affine import Monomial
from pgmp_petsc.c_export import statements
from pgmp_petsc.c_export.statements import braced, function, monomial_in_c
from pgmp_petsc.controllers import running
from pgmp_petsc.controllers.acting import ACTING_LAW, measured_by
from pgmp_petsc.declare.ideas import OUTPUTS
from pgmp_petsc.effects import motions_of
from pgmp_petsc.effects.action import Action
from pgmp_petsc.effects.effect import Effect
from pgmp_petsc.mechanism.capabilities import Purpose, check_capabilities
from pgmp_petsc.mechanism.continuation import PoseBranch
from pgmp_petsc.models import ComponentModel, ReducedModel
from pgmp_petsc.outputs.multipliers import ForceOutput, OfConnection
from pgmp_petsc.outputs.readings import Reading
from pgmp_petsc.reduced import action_kernel
from pgmp_petsc.reduced import steps as reduced_steps
from pgmp_petsc.reduced.actions import nodes_of
from pgmp_petsc.reduced.gap_forces import GapForces
from pgmp_petsc.reduced.system import STARTING_CORRECTIONS
from pgmp_petsc.reduction.cell_products import B_SPLINE, Axis, count_rows
from pgmp_petsc.reduction.interpolation import Interpolant
from pgmp_petsc.reduction.reconstruction import Reconstruction
from pgmp_petsc.reduction.rom import Served
from pgmp_petsc.results.estimates import limits_of
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.joints import CouplingEntry
from pgmp_petsc.scene.units import own_values, to_own
from pgmp_petsc.scene.uses import length_names, offset_directions, uses_of, velocity_names
from pgmp_petsc.stepping import alpha_step, edge_search
from pgmp_petsc.stepping.second_order_system import Scheme

# Always done, with two factorisations. Where steps resolve the motion the program takes one or two corrections, and up
# to six where loads set in with a jump (tests/verification/test_exported.py, in space).
CORRECTIONS = 2 * alpha_step.REFRESH_EVERY
# Of all three attempts at a step.
MOST_CORRECTIONS = 2 * alpha_step.MAX_ITERATIONS + alpha_step.CAREFUL_ITERATIONS
CLOSURES = 3  # of Newton: from 1e-4 of a grid's middle to 1e-8, 1e-16 and round-off
LACKING = "but for those beside controllers and of couplings by a table"
#: Constants of steps and iterations that are the program's own, by their modules.
SHARED = {
    alpha_step: "MAX_ITERATIONS CAREFUL_ITERATIONS REFRESH_EVERY PROBED_EVERY LONGEST ROUND_OFF CAUTION "
    "FIRST_CONTRACTION LEAST_CONTRACTION WORST_CONTRACTION",
    edge_search: "MAX_EVENTS MAX_TRIALS SHORTEST TIME_TOLERANCE",
    running: "SETTLED SETTLED_IN_STEP FIRST_SECANT SMALLEST_SECANT WEAKEST STRONGEST JUMPS HALVINGS HALF",
}
OF_PLACES = {"actions_table", "branch_table", "rigid_table"}
MOST_NUMBERS = 4_000_000  # in the tables: some 80 MB of source, which a compiler takes a minute for


#: Tables of a model in C by name, each with its sizes there.
Tables = Mapping[str, tuple[str, np.ndarray]]


@dataclass(frozen=True, eq=False, kw_only=True)
class Constants:
    """All that a model in C is made of."""

    kind: str  # of model: "reduced" or "tree"
    name: str  # of the scene
    system: UnitSystem  # its units
    settings: Mapping[str, int | float]  # numbers of ``sizes.h`` by name
    tables: Tables  # of ``tables.c``
    lists: Mapping[str, Iterable[str | float]]  # entries of its lists by their declarations
    code: Sequence[str]  # its functions
    prescribed: Sequence[bool]  # of all coordinates, whether they are given
    parameters: Mapping[str, float]  # nominal values, or those that were set, by name
    served: Mapping[str, Served]  # by name, ranges that the model was built for, else bounds
    coordinate_units: Mapping[str, str]  # of the rigid coordinates, by their names
    #: output_units, strength_units, parameter_units: by name; empty where nothing says which
    output_units: Mapping[str, str]
    strength_units: Mapping[str, str]
    parameter_units: Mapping[str, str]

    @property
    def exchanges(self) -> bool:
        """Whether its states are for an integrator of its caller's: neither those of controllers and of what is
        counted, which are in its steps, nor vibrations of component models, which no explicit integrator follows."""
        return bool(self.settings["EXCHANGE"])

    @property
    def free(self) -> list[str]:
        """Names of the coordinates, rigid and flexible, that are not given."""
        names = [*self.coordinate_units, *(f"mode[{k + 1}]" for k in range(self.settings["M"]))]
        return [name for name, given in zip(names, self.prescribed) if not given]


def constants_of(model: ReducedModel, what: str) -> Constants:
    """Collect the constants of a reduced model. Raises `InputError` if the model has what a model in C does not have,
    or tables too large for a source file; it names what is to be written."""
    scene = checked_scene(model.scene, what)
    if scene is not model.scene:
        model = ReducedModel(scene, model.rom, model.kinematics)
    terms, kinematics = model.terms, model.kinematics
    actions, mechanism = model.actions.actions, kinematics.mechanism
    held, driven = nodes_of(actions), {node for c in mechanism.coordinates for node in _nodes(c.sides)}
    joints = [one.connection for one in (*carried_by(model), *model.outputs.forces) if isinstance(one, OfConnection)]
    ends = {node for joint in joints for node in _nodes([*joint.sides, *(s for _, own in joint.held for s in own)])}
    nodes = sorted({*model.outputs.nodes, *held, *driven, *ends})
    bodies = np.repeat(np.arange(len(mechanism.bodies)), [body.n_nodes for body in mechanism.bodies])
    effects = {effect.name: effect for effect in model.effects}
    places = model.actions.rigid
    gaps = model.multipliers and model.multipliers.gaps
    tables = _tables(model, nodes, places) | _tables_of_gaps(gaps, len(_flat(terms.terms.rows)))
    check_size(tables, what)
    shapes = {name: table.shape for name, (_, table) in tables.items()}
    exchange = int(not (scene.controllers or model.outputs.counts))
    sizes = {
        **_sizes(model, shapes), **_sizes_of_gaps(gaps, shapes), "CORRECTIONS": CORRECTIONS, "EXCHANGE": exchange,
        "ALWAYS_PROBED": 0, "PROJECTS": 0,
    }  # fmt: skip
    gap_weights = [] if gaps is None else [weight for own in gaps.weights for weight in own]
    in_c, arrays = parameters_in_c(scene), ("weigh_gaps(const double *p, double *weights)", "p weights")
    lines = (f"weights[{k}] = {monomial_in_c(one, in_c)};" for k, one in enumerate(gap_weights))
    given = [Monomial(() if name is None else ((name, 1),)) for name in offset_directions(scene)]
    lists = {"const int node_bodies[]": bodies[nodes].tolist(), **_axes(model, places)}
    found = shared_of(
        model, nodes, actions, [effects[name] for name in terms.tables.load_effects], model.actions.places.winding,
        [] if gaps is None else model.multipliers.rows, statements.Terms(),
        {"terms": terms.weights, "loads": terms.tables.load_weights, "given": given},
        kind="reduced", tables=tables, prescribed=terms.tables.prescribed(model.motions),
    )  # fmt: skip
    code = [*found.code, function(*arrays, lines)]
    return replace(found, settings=found.settings | sizes, lists=found.lists | lists, code=code)


def carried_by(model: ReducedModel | ComponentModel) -> Sequence[ForceOutput]:
    """Return the forces in joints that friction of a model hangs on."""
    return () if model.measures is None else model.measures.carried


def shared_of(
    model: ReducedModel | ComponentModel, nodes: Sequence[int], actions: Sequence[Action], loads: Sequence[Effect],
    windings: Iterable[np.ndarray], gaps: Sequence[int], terms: statements.Terms,
    weights: Mapping[str, Sequence[Monomial]], **fields: Any,
) -> Constants:  # fmt: skip
    """Collect what models in C of all kinds have; `fields` are those of the kind.

    Nodes are those whose frames are known, in the order of their slots; actions are local effects, loads the effects of
    all load terms, and windings what the angle of each part of an effect grows by with the coordinates; gaps are as of
    `statements.force_in_c`, terms those that there are so far, and weights those of ``weigh`` in C.
    """
    scene, kinematics, parameters = model.scene, model.kinematics, tunable(model.scene)
    slots, in_c = {node: slot for slot, node in enumerate(nodes)}, parameters_in_c(scene)
    values, carried, settings = scene.values | in_c, carried_by(model), _steps(scene)
    load_names = list(dict.fromkeys(effect.name for effect in loads))
    over_time = {effect.name: effect.strength for effect in loads}
    over_time |= {action.effect: action.amplitude for action in actions if action.amplitude is not None}
    strengths = {name: _unit_of_strength(name, scene) for name in over_time}
    motions = motions_of(scene, kinematics.mechanism)
    functions = [one.pieces for one in over_time.values()]
    functions += [motions[k].angle.pieces if k in motions else () for k in range(kinematics.n_coordinates)]
    functions += [base.course.pieces for base in model.outputs.bases]
    measured = [Reading.of_coordinate(c, kinematics) for c in kinematics.coordinates]
    control_actions = [k for k, action in enumerate(actions) if action.law is ACTING_LAW]
    carried_actions = [k for k, action in enumerate(actions) if action.law.loaded]
    parts = (
        statements.closure_in_c(kinematics, terms),
        statements.actions_in_c(actions, nodes_of(actions), slots, list(over_time), iter(windings), values, terms),
        statements.outputs_in_c(
            model.outputs, carried, slots, values, gaps, actions, scene.system, settings["N_STEPS"], terms
        ),
        statements.controls_in_c(scene, values, settings["STEP"], functions),
    )
    sizes = {
        "D": kinematics.mechanism.space.dimension,
        "R": kinematics.n_coordinates,
        "SIZE": float(kinematics.size),
        "N_BODIES": len(kinematics.mechanism.bodies),
        "N_PARAMETERS": len(parameters),
        "N_CONTROL_ROWS": len(control_actions),
        "N_CARRIED": len(carried_actions),
        "N_LOADS": len(load_names),
        "N_STRENGTHS": len(strengths),
        "N_NODES": len(nodes),
    }
    lists = {
        "const int load_of_term[]": [load_names.index(effect.name) for effect in loads],
        "const int strength_of_load[]": [list(over_time).index(name) for name in load_names],
        "const double strength_sizes[]": list(map(scene.system.size_of, strengths.values())),
        "const int carried_actions[]": carried_actions,
        "const int control_actions[]": control_actions,
        "const double control_origins[]": [] if model.measures is None else model.measures.origins.tolist(),
        "const struct statement coordinates[R]": [statements.read_in_c(one, slots) for one in measured],
        "const int function_pieces[]": [0, *accumulate(map(len, functions))],
        "const struct piece pieces[]": [statements.piece_in_c(piece) for pieces in functions for piece in pieces],
        "const struct spline_piece spline_pieces[]": terms.pieces,
    }
    weighed = [line for part in parts for line in part.weighed]
    for into, monomials in weights.items():
        weighed += (f"{into}[{k}] = {monomial_in_c(weight, in_c)};" for k, weight in enumerate(monomials))
    arrays = "double *terms, double *loads, double (*laws)[N_LAW], double *given"
    head = f"weigh(const double *p, {arrays},\n           double (*controls)[AT_LEAST_ONE(N_CONTROL)])"
    code = [text for part in parts for text in part.code]
    return Constants(
        name=scene.name,
        system=scene.system,
        settings=settings | sizes | {name: size for part in parts for name, size in part.sizes.items()},
        lists=lists | {name: entries for part in parts for name, entries in part.lists.items()},
        code=[*dict.fromkeys(code), function(head, "p terms loads laws given controls", weighed)],
        parameters=own_values(scene, parameters),
        served={name: _bounds(scene, name) for name in parameters} | model.served,
        coordinate_units={c.name: c.unit for c in kinematics.coordinates},
        output_units={name: scene.system.unit(unit) for name, unit in model.outputs.units.items()},
        strength_units={name: scene.system.unit(unit) for name, unit in strengths.items()},
        parameter_units={name: _unit_of(name, scene) for name in parameters},
        **fields,
    )


def _tables_of_gaps(gaps: GapForces | None, n_rows: int) -> Tables:
    """Return the tables of what opens joints whose forces are outputs, if there are any."""
    table, changes = (
        (np.zeros((n_rows, 1, 1)),) * 2 if gaps is None else (_flat(gaps.table.rows), _flat(gaps.changing.rows))
    )
    return {
        "gap_table": ("[N_ROWS][AT_LEAST_ONE(N_GAPS)][AT_LEAST_ONE(N_GAP_ENTRIES)]", table),
        "gap_changes": ("[N_ROWS][AT_LEAST_ONE(N_GAPS)][AT_LEAST_ONE(N_GAP_CHANGES)]", changes),
    }


def _sizes_of_gaps(gaps: GapForces | None, shapes: Mapping[str, tuple[int, ...]]) -> dict[str, int]:
    mass, stiffness, loads, damping = (0, 0, 0, 0) if gaps is None else map(len, gaps.weights)
    sizes = (0,) * 5
    if gaps is not None:
        sizes = (*shapes["gap_table"][1:], shapes["gap_changes"][2], *gaps.sizes[2:])
    names = "N_GAPS N_GAP_ENTRIES N_GAP_CHANGES GAPS_CURVED GAPS_DRIVEN GAP_MASS GAP_STIFFNESS GAP_DAMPING N_GAP_TERMS"
    counts = (*sizes, mass, stiffness, damping, mass + stiffness + loads + damping)
    return {name: int(count) for name, count in zip(names.split(), counts, strict=True)}


def in_c(scene: Scene, name: str) -> bool:
    """Return whether a model in C has an output: forces in joints and what drives take it does not have beside
    controllers, nor those of couplings by a table; and nothing is made of these, or counted."""
    entry = scene.outputs[name]
    if "multipliers" in entry.reads:
        joint = scene.joints.get(getattr(entry, "joint", None))
        by_table = isinstance(joint, CouplingEntry) and any(share.table for share in joint.shares_in(scene))
        return not (scene.controllers or by_table)
    return "stresses" not in entry.reads and all(in_c(scene, one) for one in entry.made_in(scene))


def tunable(scene: Scene) -> dict[str, float]:
    """Return the parameters that a model in C takes, with the values of the scene's run: lengths, places and ratios are
    fixed, as its mechanism is made with them, and so are velocities at the start, which it has before it takes any."""
    fixed = {*length_names(scene), *velocity_names(scene).values()}
    return {name: value for name, value in scene.values.items() if name not in fixed}


def _bounds(scene: Scene, name: str) -> Served:
    """Return between what runs of the program take a parameter that no tables depend on."""
    low, high = scene.parameters[name].bounds or (-math.inf, math.inf)
    low = max(low, 0.0) if name in scene.parameters_not_negative else low
    return Served(low, high, low, high, to_own(scene, name))


def parameters_in_c(scene: Scene) -> dict[str, str]:
    """Return what the parameters that a model in C takes are there in SI units; it takes them in those of the scene."""
    sizes = {name: 1.0 / to_own(scene, name) for name in tunable(scene)}
    return {name: f"p[{k}]" if size == 1.0 else f"({size!r} * p[{k}])" for k, (name, size) in enumerate(sizes.items())}


def _unit_of_strength(name: str, scene: Scene) -> str:
    """Return the SI unit of a strength; that of a load's part is a factor of its parameter, and so are those that a
    parameter with their unit scales."""
    effect = scene.effects.get(name)
    scale = getattr(effect, "scale", None)
    is_factor = isinstance(scale, str) and any(dimension_of(scene.parameters[scale].unit or "1"))
    return "1" if effect is None or is_factor else effect.strength_unit


def _unit_of(name: str, scene: Scene) -> str:
    used = (use.units for use in uses_of(scene) if use.parameter == name)
    taken = next((units[0] for units in used if len(units) == 1), "")
    return scene.system.unit(scene.parameters[name].unit or taken)


def _nodes(sides: Sequence) -> list[int]:
    return [side.node for side in sides if not side.on_ground]


def starts_balanced(model: ReducedModel | ComponentModel) -> bool:
    """Return whether flexible coordinates start from a balance with forces, which a model in C does not look for."""
    if isinstance(model, ComponentModel):
        return model.scene.initial.equilibrium or model.is_off
    off = model.terms.tables.n_given > 0
    return model.scene.initial.equilibrium or off and bool(model.actions.of_joints(model.kinematics.mechanism).actions)


def _start(model: ReducedModel) -> tuple[np.ndarray, np.ndarray]:
    """Return coordinates and rates (n_eta,) at the start of the scene's run, undeformed where a model in C finds its
    deformation. Raises `InputError` if the run has no static equilibrium to start from."""
    if starts_balanced(model):
        system = model.batch({name: np.array([value]) for name, value in model.scene.values.items()}, 1)
        system.require_settled()
        state = system.start()
        return state.q[0], state.v[0]
    return tuple(np.pad(part, (0, model.terms.tables.n_modes)) for part in model.start)


def _tables(model: ReducedModel, nodes: Sequence[int], places: Interpolant | None) -> Tables:
    begun, rates = _start(model)
    terms, mechanism, scheme = model.terms, model.kinematics.mechanism, model.scene.interpolation
    flexible = [node for body in mechanism.bodies if body.flexible for node in range(body.nodes.start, body.nodes.stop)]
    of_outputs, of_all = (Reconstruction(model.kinematics, model.rom, scheme, some) for some in (nodes, flexible))
    d, n_dofs = mechanism.space.dimension, mechanism.space.n_dofs
    turned = of_all.displacements.rows
    turned = turned.reshape(*turned.shape[:-1], -1, n_dofs)[..., d:].reshape(*turned.shape[:-1], -1)
    shapes = np.concatenate([of_outputs.displacements.rows, turned], axis=-1)
    points, rigid = np.concatenate([body.mesh.nodes for body in mechanism.bodies]), terms.cells.rigid
    return {
        "rigid_table": ("[RIGID_ROWS][N_TERMS][PACKED(R)]", rigid.rows),
        "rigid_stencils": ("[R][RIGID_CELLS][RIGID_REACH]", rigid.stencils),
        "rigid_matrices": ("[R][RIGID_CELLS][8][RIGID_REACH]", rigid.matrices),
        "terms_table": ("[N_ROWS][N_TERMS][END]", _flat(terms.terms.rows)),
        "loads_table": ("[AT_LEAST_ONE(N_LOAD_TERMS)][N_ROWS][LOAD_END]", np.swapaxes(_flat(terms.load.rows), 0, 1)),
        "shapes_table": ("[N_ROWS][N_FACTORS][N_SHAPES]", _flat(shapes)),
        "branch_table": (
            "[N_BRANCH_PARTS][N_BRANCH][N_BODIES][N_POSE]",
            _branch(model.rom.branch, len(mechanism.bodies)),
        ),
        "actions_table": (
            "[AT_LEAST_ONE(N_FINE)][AT_LEAST_ONE(N_ACTION_ENTRIES)]",
            np.zeros((0, 0)) if places is None else _flat(places.rows)[:, 0],
        ),
        "scale": ("[]", terms.scale),
        "winding": ("[R][N_BODIES]", model.rom.branch.winding),
        "node_points": ("[AT_LEAST_ONE(N_NODES)][D]", points[nodes].reshape(-1, d)),
        "start_coordinates": ("[N]", begun),
        "start_rates": ("[N]", rates),
    }


def _flat(rows: np.ndarray) -> np.ndarray:
    """Return rows of several coordinates, of matrices each, one after the other."""
    return rows.reshape(math.prod(rows.shape[:-2]), *rows.shape[-2:])


def _branch(branch: PoseBranch, n_bodies: int) -> np.ndarray:
    """Return poses and derivatives (n_parts, n, n_bodies, n_pose): of one coordinate in units of the step, with half
    the second one."""
    n, r = len(branch.poses), len(branch.axes)
    rates, curvatures = branch.rates.reshape(n, n_bodies, -1, r), branch.curvatures.reshape(n, n_bodies, -1, r, r)
    if r == 1:
        step = branch.steps[0]
        return np.array([branch.poses, rates[..., 0] * step, curvatures[..., 0, 0] * (0.5 * step**2)])
    second = [curvatures[..., k, j] for k in range(r) for j in range(k + 1)]
    return np.array([branch.poses, *(rates[..., k] for k in range(r)), *second])


def _axes(model: ReducedModel, places: Interpolant | None) -> dict[str, list[str]]:
    """Return the cells and rows of tables along the coordinates."""

    def of_tables(axes: Iterable[Axis]) -> Iterator[str]:
        for one in axes:
            yield braced(one.lower, one.step, one.n_cells, count_rows(one), one.periodic, one.basis == B_SPLINE)

    terms, branch = model.terms, model.rom.branch
    periodic = [c.periodic for c in model.kinematics.coordinates]
    found = {
        "axes": of_tables(terms.terms.axes),
        "rigid_axes": (
            braced(cells.lower, cells.step, cells.n_cells, count_rows(rows), cells.periodic, 0)
            for cells, rows in zip(terms.grid, terms.rigid.axes)
        ),
        "fine_axes": [braced(0.0, 1.0, 1, 1, 0, 0)] * len(periodic) if places is None else of_tables(places.axes),
        "branch_axes": (
            braced(float(lower), float(step), n - 1, n, turns, 0)
            for lower, step, n, turns in zip(branch.lower, branch.steps, branch.shape.tolist(), periodic)
        ),
    }
    return {f"const struct axis {name}[R]": list(axes) for name, axes in found.items()}


def check_size(tables: Tables, what: str) -> None:
    sizes = {name: table.size for name, (_, table) in tables.items()}
    size = sum(sizes.values())
    if size > MOST_NUMBERS:
        cure = "Build with fewer reduction.modes or reduction.angles, or with reduction.interpolation = 'spline'"
        if sum(sizes[name] for name in OF_PLACES & sizes.keys()) > size / 2:
            cure = "Most say where the rigid mechanism is: build with smaller ranges of the coordinates, "
            cure += "or let effects act at fewer points, none of them on motors behind gears"
        raise InputError(f"{what}: the tables have {size} numbers; at most {MOST_NUMBERS} are written. {cure}")


def _sizes(model: ReducedModel, shapes: Mapping[str, tuple[int, ...]]) -> dict[str, int | float]:
    terms, branch = model.terms, model.rom.branch
    layout = terms.layout
    return {
        "M": layout.n_eta - len(layout.rigid),
        "N_GIVEN": terms.tables.n_given,
        "BALANCED": int(starts_balanced(model)),
        "SECOND_ORDER": int(layout.second_order),
        "DRIVEN_CURVATURE": int(layout.driven < layout.damping),
        "STRUCTURAL_DAMPING": int(layout.damping < layout.end),
        "QUADRATIC": int(layout.quadratic),
        "N_ROWS": shapes["terms_table"][0],
        "RIGID_ROWS": shapes["rigid_table"][0],
        "RIGID_CELLS": shapes["rigid_stencils"][1],
        "RIGID_REACH": shapes["rigid_stencils"][2],
        "N_TERMS": len(terms.weights),
        "N_LOAD_TERMS": len(terms.tables.load_weights),
        "N_SHAPES": shapes["shapes_table"][2],
        "N_BRANCH_PARTS": shapes["branch_table"][0],
        "N_BRANCH": shapes["branch_table"][1],
        "BRANCH_IS_EXACT": int(branch.is_exact),
        "N_FINE": shapes["actions_table"][0],
        "N_ACTION_ENTRIES": shapes["actions_table"][1],
        "MASS_DAMPING": 0.0 if terms.damping is None else terms.damping.mass,
        "NEWTON_TOLERANCE": reduced_steps.NEWTON_TOLERANCE,
        "TOLERANCE_OF_ONE": reduced_steps.NEWTON_TOLERANCE,
        "OF_OLD_FACTORS": reduced_steps.OF_OLD_FACTORS,
        "ROTATION_LIMIT": limits_of(model.scene.second_order)["elastic_rotation"],
    }


def _steps(scene: Scene) -> dict[str, int | float]:
    """Return the settings of steps and iterations; the latter are the program's own."""
    simulation, n_steps = scene.simulation, scene.simulation.n_steps
    step = simulation.duration / n_steps
    scheme = Scheme.of(simulation.spectral_radius, step)
    return {
        "N_STEPS": n_steps,
        "STEP": step,
        **{name.upper(): getattr(scheme, name) for name in ("alpha_m", "alpha_f", "beta", "gamma")},
        "TOLERANCE_OF_TRIALS": alpha_step.NEWTON_TOLERANCE,
        "GOES_ON_RESOLVED": int(alpha_step.goes_on_resolved(simulation.spectral_radius)),
        "STARTING_CORRECTIONS": STARTING_CORRECTIONS,
        "CLOSURES": CLOSURES,
        "UNBALANCED": action_kernel.UNBALANCED,
        **{name: getattr(module, name) for module, names in SHARED.items() for name in names.split()},
    }


def checked_scene(scene: Scene, what: str) -> Scene:
    """Return a scene without the outputs that a model in C does not have; raise `InputError` that names what is to be
    written if it asks for more."""
    check_capabilities(scene, Purpose.EXPORT)
    for entry, text in _of_scene(scene):
        raise InputError(f"{entry}: {text}; {what} cannot be written. Take pgmp simulate for this model")
    left = {name: output for name, output in scene.outputs.items() if in_c(scene, name)}
    return scene if len(left) == len(scene.outputs) else scene.with_entries(outputs=left)


def started(model: ReducedModel) -> str:
    """Say where a model in C starts that begins in balance; empty where it begins with what it computes itself."""
    if not starts_balanced(model) or not tunable(model.scene):
        return ""
    return (
        "note: it starts from the state of pgmp simulate at the parameters of this export, which is written in it: "
        "with others it starts off balance; export it with these (--set)"
    )


def left_out(scene: Scene) -> str:
    """Say which outputs of a scene a model in C leaves out; empty where it has them all."""
    lacking = {name: entry.type for name, entry in scene.outputs.items() if not in_c(scene, name)}
    if not lacking:
        return ""
    kinds = zip(OUTPUTS.names, OUTPUTS.found())
    known = [kind for kind, found in kinds if found.of_frames() or "beside" in found.reads]
    having = ", ".join(known)
    made = {name: f"{kind}, made of what is" if kind in known else kind for name, kind in lacking.items()}
    named = ", ".join(f"outputs.{name} ({words})" for name, words in made.items())
    forces = any("multipliers" in scene.outputs[name].reads for name in lacking)
    why = f", drives, forces in joints{f' {LACKING}' if forces else ''}, and rainflow of these"
    return f"note: {named} left out: a model in C has {having}{why}; pgmp simulate has all outputs"


def _of_scene(scene: Scene) -> Iterator[tuple[str, str]]:
    for name, one in scene.controllers.items():
        for output in measured_by(scene, one).motions:
            if not scene.outputs[output].is_stated:
                what = f"outputs.{output} ({scene.outputs[output].type})"
                yield f"controllers.{name}.measures", f"a model in C has no controllers that measure {what}"
    if scene.fields:
        yield f"fields.{next(iter(scene.fields))}", "a model in C has no random fields"
    if scene.simulation.tolerance is not None:
        yield "simulation.tolerance", "the step of a model in C is a constant; give simulation.step in the build"
