"""The constants of a model in C: sizes, settings, and the tables of the reduced Lagrangian, weights taken out; and what
such a model does not have, named by its entry in the scene.

The tables are those that `reduced.terms` interpolates, as samples or spline coefficients; that of the rigid inertia has
beside it what makes polynomials of degree 7, as in `reduced.cells`. Poses come from the table of the assembly branch.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import accumulate

import numpy as np

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.base.units import UnitSystem, dimension_of
from pgmp_petsc.bodies.affine import AffineSum, Monomial, Quantity
from pgmp_petsc.c_export import statements
from pgmp_petsc.controllers import running
from pgmp_petsc.controllers.acting import ACTING_LAW, measured_by
from pgmp_petsc.declare.ideas import OUTPUTS
from pgmp_petsc.effects import motions_of
from pgmp_petsc.effects.action import Action
from pgmp_petsc.effects.effect import Effect
from pgmp_petsc.effects.time_function import Piece
from pgmp_petsc.mechanism.capabilities import Purpose, check_capabilities
from pgmp_petsc.mechanism.continuation import PoseBranch
from pgmp_petsc.models import ComponentModel, ReducedModel
from pgmp_petsc.outputs.multipliers import OfConnection, OfPrescribed
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
MOST_WAITING = 4096  # turning points of a count that wait for their cycle to close
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


@dataclass(frozen=True)
class Along:
    """The cells and rows of a table along a coordinate."""

    lower: float
    step: float
    n_cells: int
    n_rows: int
    periodic: bool
    b_spline: bool = False

    @classmethod
    def of(cls, axis: Axis) -> Along:
        return cls(axis.lower, axis.step, axis.n_cells, count_rows(axis), axis.periodic, axis.basis == B_SPLINE)


@dataclass(frozen=True, eq=False, kw_only=True)
class Constants:
    """All that a model in C is made of."""

    kind: str = ""  # of model: "reduced" or "tree"
    name: str  # of the scene
    system: UnitSystem  # its units
    settings: Mapping[str, int | float] = field(default_factory=dict)  # numbers of ``sizes.h`` by name
    tables: Tables = field(default_factory=dict)  # of ``tables.c``
    #: structures of the kind in C, and whole numbers, by declaration
    lists: Mapping[str, Sequence[str | int]] = field(default_factory=dict)
    axes: Mapping[str, Sequence[Along]] = field(default_factory=dict)  # of the tables' coordinates, by name
    #: weights, load_weights: monomials of the terms and of the load terms
    weights: tuple[Monomial, ...] = ()
    load_weights: tuple[Monomial, ...] = ()
    gap_weights: Sequence[Monomial] | None = None  # of the terms of what opens joints; None of a kind that has none
    given: Sequence[Monomial] = ()  # amplitudes of the coordinates that say how far joints are off, the last ones
    prescribed: Sequence[bool] = ()  # of all coordinates, whether they are given
    laws: Sequence[Sequence[Quantity | AffineSum]]  # parameters of the laws of the local effects
    parameters: Mapping[str, float]  # nominal values, or those that were set, by name
    parameters_in_c: Mapping[str, str]  # in SI units, by name
    served: Mapping[str, Served]  # by name, ranges that the model was built for, else bounds
    #: strengths, motions: pieces over time of what loads and drives, by the effect's name, and of the coordinates, none
    #: of a free one
    strengths: Mapping[str, Sequence[Piece]]
    motions: Sequence[Sequence[Piece]]
    #: load_of_term, strength_of_load: number of the load of each load term, and of the strength of each load
    load_of_term: Sequence[int]
    strength_of_load: Sequence[int]
    coordinate_units: Mapping[str, str]  # of the rigid coordinates, by their names
    #: coordinates, closure, closure_wanted: what measures the coordinates, what holds the bodies together, and the
    #: values that this has
    coordinates: Sequence[statements.StatementInC]
    closure: Sequence[statements.TermInC]
    closure_wanted: Sequence[float]
    constraints: Sequence[statements.TermInC] | None = None  # of what a tree leaves; None of a kind that has none
    #: actions, action_slots: local effects, and the slots of their nodes
    actions: Sequence[statements.ActionInC]
    action_slots: Sequence[int]
    carried_actions: Sequence[int]  # numbers of those that hang on forces in joints, the first of the outputs' forces
    #: controls, control_actions, control_origins: controllers, the numbers of the actions by which they act, and what
    #: counts as zero of the motions that these measure
    controls: Sequence[statements.ControlInC]
    control_actions: Sequence[int]
    control_origins: Sequence[float]
    outputs: statements.OutputsInC
    #: output_units, strength_units, parameter_units: by name; empty where nothing says which
    output_units: Mapping[str, str]
    strength_units: Mapping[str, str]
    strength_sizes: Sequence[float]  # how many SI units one of each strength is
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
    forces = (*(() if model.measures is None else model.measures.carried), *model.outputs.forces)
    joints = [one.connection for one in forces if isinstance(one, OfConnection)]
    ends = {node for joint in joints for node in _nodes([*joint.sides, *(s for _, own in joint.held for s in own)])}
    nodes = sorted({*model.outputs.nodes, *held, *driven, *ends})
    bodies = np.repeat(np.arange(len(mechanism.bodies)), [body.n_nodes for body in mechanism.bodies])
    effects = {effect.name: effect for effect in model.effects}
    places = model.actions.rigid
    gaps = model.multipliers and model.multipliers.gaps
    tables = _tables(model, nodes, places) | _tables_of_gaps(gaps, len(_flat(terms.terms.rows)))
    check_size(tables, what)
    shared = shared_of(
        model, nodes, actions, [effects[name] for name in terms.tables.load_effects],
        model.actions.places.winding, [] if gaps is None else model.multipliers.rows,
    )  # fmt: skip
    shapes = {name: table.shape for name, (_, table) in tables.items()}
    sizes = {**_sizes(model, shapes), **_sizes_of_gaps(gaps, shapes)}
    exchange = int(not (scene.controllers or model.outputs.counts))
    sizes |= {"CORRECTIONS": CORRECTIONS, "EXCHANGE": exchange, "ALWAYS_PROBED": 0, "PROJECTS": 0}
    return replace(
        shared,
        kind="reduced",
        settings=shared.settings | sizes,
        tables=tables,
        lists={"const int node_bodies[]": bodies[nodes].tolist()},
        axes=_axes(model, places),
        weights=terms.weights,
        gap_weights=() if gaps is None else [weight for own in gaps.weights for weight in own],
        load_weights=terms.tables.load_weights,
        given=[Monomial(() if name is None else ((name, 1),)) for name in offset_directions(scene)],
        prescribed=terms.tables.prescribed(model.motions),
    )


def shared_of(
    model: ReducedModel | ComponentModel, nodes: Sequence[int], actions: Sequence[Action],
    loads: Sequence[Effect], windings: Iterable[np.ndarray], gaps: Sequence[int],
) -> Constants:  # fmt: skip
    """Collect what models in C of all kinds have.

    Nodes are those whose frames are known, in the order of their slots; actions are local effects, loads the effects of
    all load terms, and windings what the angle of each part of an effect grows by with the coordinates; gaps are as of
    `ForceInC.of`.
    """
    scene, kinematics, held = model.scene, model.kinematics, nodes_of(actions)
    slots, parameters = {node: slot for slot, node in enumerate(nodes)}, tunable(scene)
    load_names = list(dict.fromkeys(effect.name for effect in loads))
    over_time = {effect.name: effect.strength for effect in loads}
    over_time |= {action.effect: action.amplitude for action in actions if action.amplitude is not None}
    windings, motions = iter(windings), motions_of(scene, kinematics.mechanism)
    closure, wanted = statements.closure_of(kinematics)
    measures = [Reading.of_coordinate(c, kinematics) for c in kinematics.coordinates]
    first_edges = [0, *accumulate(len(action.law.edges) for action in actions)]
    in_c = parameters_in_c(scene)
    carried = () if model.measures is None else model.measures.carried
    outputs = statements.outputs_in_c(model.outputs, carried, slots, scene.values | in_c, gaps, actions, scene.system)
    settings = _steps(model.scene)
    controls = statements.controls_in_c(scene, parameters, settings["STEP"])
    control_actions = [k for k, action in enumerate(actions) if action.law is ACTING_LAW]
    strengths = {name: _unit_of_strength(name, scene) for name in over_time}
    found = Constants(
        name=scene.name,
        system=scene.system,
        laws=[action.parameters for action in actions],
        parameters=own_values(scene, parameters),
        parameters_in_c=in_c,
        served={name: _bounds(scene, name) for name in parameters} | model.served,
        strengths={name: function.pieces for name, function in over_time.items()},
        motions=[motions[k].angle.pieces if k in motions else () for k in range(kinematics.n_coordinates)],
        load_of_term=[load_names.index(effect.name) for effect in loads],
        strength_of_load=[list(over_time).index(name) for name in load_names],
        coordinate_units={c.name: c.unit for c in kinematics.coordinates},
        coordinates=[statements.StatementInC.of_reading(one, slots) for one in measures],
        closure=closure,
        closure_wanted=wanted,
        actions=[
            statements.action_in_c(number, action, edge, held, slots, list(over_time), windings)
            for number, (action, edge) in enumerate(zip(actions, first_edges))
        ],
        controls=controls,
        control_actions=control_actions,
        control_origins=[] if model.measures is None else model.measures.origins.tolist(),
        action_slots=[slots[node] for node in held],
        carried_actions=[k for k, action in enumerate(actions) if action.law.loaded],
        outputs=outputs,
        output_units={name: scene.system.unit(unit) for name, unit in model.outputs.units.items()},
        strength_units={name: scene.system.unit(unit) for name, unit in strengths.items()},
        strength_sizes=list(map(scene.system.size_of, strengths.values())),
        parameter_units={name: _unit_of(name, scene) for name in parameters},
    )
    return replace(found, settings=_counts(found, model, len(nodes), settings["N_STEPS"]) | settings)


def _counts(found: Constants, model: ReducedModel | ComponentModel, n_nodes: int, n_steps: int) -> dict[str, float]:
    kinematics, outputs, laws = model.kinematics, found.outputs, [one.law for one in found.controls]
    edges = [len(action.law.edges) for action in found.actions]
    return {
        "D": kinematics.mechanism.space.dimension,
        "R": kinematics.n_coordinates,
        "SIZE": float(kinematics.size),
        "N_BODIES": len(kinematics.mechanism.bodies),
        "N_PARAMETERS": len(found.parameters),
        "N_OUTPUTS": len(model.scene.outputs),
        "N_CONTROLS": len(found.controls),
        "N_CONTROL_ROWS": len(found.control_actions),
        "N_CONTROL": max((len(one.parameters) for one in found.controls), default=0),
        "N_BESIDE": sum(3 * len(law.states) + 1 for law in laws),
        "MOST_MOTIONS": max((law.n_motions for law in laws), default=0),
        "MOST_STATES": max((len(law.states) for law in laws), default=0),
        "N_READINGS": len(outputs.readings),
        "N_BASES": len(outputs.courses),
        "N_FORCES": len(outputs.forces),
        "N_CARRIED": len(found.carried_actions),
        "DRIVES": int(any(isinstance(one, OfPrescribed) for one in model.outputs.forces)),
        "DEPTH": outputs.depth,
        "N_COUNTS": len(outputs.counts),
        "MOST_PARTS": max((len(one.curve) for one in outputs.counts), default=1),
        "N_WAITING": min(n_steps + 2, MOST_WAITING) if outputs.counts else 1,
        "N_LOADS": len(found.strength_of_load),
        "N_STRENGTHS": len(found.strengths),
        "N_NODES": n_nodes,
        "N_ACTIONS": len(found.actions),
        "N_ACTION_NODES": len(found.action_slots),
        "N_PARTS": sum(len(action.parts) for action in found.actions),
        "N_CLOSURE": len(found.closure_wanted),
        "N_CLOSURE_TERMS": len(found.closure),
        "N_LAW": max([1, *map(len, found.laws)]),
        "N_EDGES": sum(edges),
        "MOST_EDGES": max([1, *edges]),  # an array in C has at least one
    }


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


def _axes(model: ReducedModel, places: Interpolant | None) -> dict[str, list[Along]]:
    terms, periodic = model.terms, [c.periodic for c in model.kinematics.coordinates]
    branch = model.rom.branch
    fine = [Along(0.0, 1.0, 1, 1, False)] * len(periodic) if places is None else [Along.of(a) for a in places.axes]
    return {
        "axes": [Along.of(axis) for axis in terms.terms.axes],
        "rigid_axes": [
            Along(cells.lower, cells.step, cells.n_cells, count_rows(rows), cells.periodic)
            for cells, rows in zip(terms.grid, terms.rigid.axes)
        ],
        "fine_axes": fine,
        "branch_axes": [
            Along(float(lower), float(step), n - 1, n, turns)
            for lower, step, n, turns in zip(branch.lower, branch.steps, branch.shape.tolist(), periodic)
        ],
    }


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
    having = ", ".join(kind for kind, found in kinds if found.of_frames() or "beside" in found.reads)
    named = ", ".join(f"outputs.{name} ({kind})" for name, kind in lacking.items())
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
