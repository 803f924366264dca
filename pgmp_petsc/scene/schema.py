"""The scene: everything that a user says about a mechanism, validated. Numbers are in SI units once it is read."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, Self

from pydantic import Field, PrivateAttr, ValidationInfo, model_validator

from pgmp_petsc.base.errors import Remark
from pgmp_petsc.base.notebooks import Grid, card
from pgmp_petsc.base.units import SAID, SI, UnitSystem, system_of
from pgmp_petsc.declare.ideas import WHEN_GROWN
from pgmp_petsc.scene import numerics
from pgmp_petsc.scene.bodies import Body, Material
from pgmp_petsc.scene.controllers import Controller, controller_problems
from pgmp_petsc.scene.effects import Driving, Effect
from pgmp_petsc.scene.fields import Name, Number, OneLine, Sign, Table
from pgmp_petsc.scene.joints import TURNS, Coordinate, Ground, Joint
from pgmp_petsc.scene.messages import input_error
from pgmp_petsc.scene.outputs import Output
from pgmp_petsc.scene.parameters import Parameter, RandomField, correlation_problems, field_problems
from pgmp_petsc.scene.references import part_problems, parts_of, reference_problems
from pgmp_petsc.scene.units import text_problems, unit_problems
from pgmp_petsc.scene.uses import length_problems, uses_of

ANGLES_OF_SEVERAL = {2: 24, 3: 16}  # along each of several coordinates, where a scene does not say
MOST_OF_SEVERAL = {2: 10_000, 3: 100_000}  # configurations: adaptive sampling begins with twice as many along each
A_TURN, WITH_ENDS = 22, 5  # along each of three that turn: in a whole turn, and how many more where it has two ends


def _along(coordinate: object) -> int:
    """Return how many angles the range of one of three coordinates asks for; of what is no range, 0."""
    given = coordinate if isinstance(coordinate, dict) else {}
    try:
        lower, upper = map(float, given["range"])
        turns = 1.0 if given.get("periodic") else (upper - lower) / (2.0 * math.pi)
        return min(A_TURN, round(A_TURN * turns) + (0 if given.get("periodic") else WITH_ENDS))
    except (KeyError, TypeError, ValueError, OverflowError):
        return 0


class Header(Table):
    """Name and units of the scene."""

    name: OneLine = Field(min_length=1, description="short name, used in reports and titles")
    description: str = Field("", description="what the scene shows")
    units: Literal["SI", "mm"] | None = Field(
        None,
        description='units of all numbers of the scene, of its meshes and of what is computed: "SI", the same as '
        'nothing; "mm": mm, t, s, N, MPa and mJ. Angles are in rad. A number may also be a text with its own unit, '
        '"500 mm" or "30 deg"',
    )


OF_RUNS = ("simulation", "reference", "ensemble")  # tables that no mechanism is made of


class Scene(Table):
    """A validated scene. Names that entries refer to exist and are of the right kind; see `load_scene`."""

    scene: Header = Field(description="table with the scene's name")
    ground: Ground = Field(Ground(), description="points fixed in space")
    parameters: dict[Name, Parameter] = Field({}, description="uncertain quantities by name")
    materials: dict[Name, Material] = Field({}, description="a table for each material, [materials.NAME]")
    bodies: dict[Name, Body] = Field(min_length=1, description="a table for each body, [bodies.NAME]")
    joints: dict[Name, Joint] = Field(min_length=1, description="a table for each joint, [joints.NAME]")
    coordinates: dict[Name, Coordinate] = Field(
        min_length=1, description="a table for each rigid coordinate, [coordinates.NAME]"
    )
    effects: dict[Name, Effect] = Field({}, description="what acts on the mechanism")
    controllers: dict[Name, Controller] = Field({}, description="a table for each controller, [controllers.NAME]")
    reduction: numerics.Reduction = Field(numerics.Reduction(), description="the reduced model")
    initial: numerics.Initial = Field(numerics.Initial(), description="start from static equilibrium")
    simulation: numerics.Simulation = Field(numerics.Simulation(), description="a run over time")
    reference: numerics.Reference = Field(numerics.Reference(), description="what errors are measured against")
    correlation: dict[Name, dict[Name, Number]] = Field(
        {}, description="of the normal variables behind two uncertain parameters: [correlation] r1 = { E = 0.5 }"
    )
    fields: dict[Name, RandomField] = Field({}, description="a table for each random field over a body, [fields.NAME]")
    ensemble: numerics.Ensemble = Field(numerics.Ensemble(), description="many runs with drawn parameters")
    outputs: dict[Name, Output] = Field({}, description="what a run reports over time")

    _directory: Path = PrivateAttr(default=Path("."))
    _remarks: tuple[Remark, ...] = PrivateAttr(default=())

    @property
    def name(self) -> str:
        return self.scene.name

    @property
    def directory(self) -> Path:
        """Directory that the paths of meshes are relative to; no part of the TOML."""
        return self._directory

    @property
    def remarks(self) -> tuple[Remark, ...]:
        """Doubts about the scene that its reader found; results keep them. No part of the TOML."""
        return self._remarks

    def _repr_html_(self) -> str:
        """Return what a notebook shows: what there is, and the parameters."""
        kinds = {
            table: ", ".join(f"{name} ({getattr(one, kind)})" for name, one in getattr(self, table).items())
            for table, kind in {"bodies": "element", "joints": "type", "effects": "type", "outputs": "type"}.items()
        }
        ranges = {name: "periodic" if one.periodic else f"{one.range}" for name, one in self.coordinates.items()}
        about = {"": self.scene.description, **kinds}
        about["coordinates"] = ", ".join(f"{name} ({text})" for name, text in ranges.items())
        drawn = {name: one.distribution.name if one.distribution else "" for name, one in self.parameters.items()}
        rows = [(name, one.current, one.unit, drawn[name], one.description) for name, one in self.parameters.items()]
        head = ("parameter", "value", "unit", "distribution", "")
        return card(f"pgmp scene '{self.name}'", about, [Grid(head, rows)], self.remarks)

    def moves_as(self, other: Scene) -> bool:
        """Return whether another scene differs in what runs are asked for alone: its mechanism starts and moves as this
        one's."""
        tables = (name for name in Scene.model_fields if name not in OF_RUNS)
        begins = self.simulation.initial == other.simulation.initial
        return self is other or (begins and all(getattr(self, name) == getattr(other, name) for name in tables))

    def with_remarks(self, remarks: tuple[Remark, ...]) -> Self:
        """Return the scene with what is doubtful about it."""
        remarked = self.model_copy()
        remarked._remarks = remarks
        return remarked

    @property
    def system(self) -> UnitSystem:
        """Units in which it is shown and written: those that it says, while its numbers are in SI units (`units`).

        One that says none is computed with its numbers as they are, and shown with the names of `number_units`.
        """
        said = self.scene.units
        return SAID[said] if said else replace(self.number_units, length=1.0, mass=1.0, time=1.0)

    @property
    def number_units(self) -> UnitSystem:
        """Units that its numbers are in: SI units, or of one that says none those in which its materials exist."""
        return SI if self.scene.units else self.material_units or SI

    @property
    def material_units(self) -> UnitSystem | None:
        """Units in which the materials of bodies are ones that exist, None of none; those that name no parameter there
        is tell nothing."""
        used = {material for body in self.bodies.values() for material in (body.material, *body.regions.values())}
        values = self.values
        given = [(one.rho, one.E) for name, one in self.materials.items() if name in used]
        known = [pair for pair in given if all(not isinstance(one, str) or one in values for one in pair)]
        return system_of([(self.number(rho, values), self.number(modulus, values)) for rho, modulus in known])

    @property
    def dimension(self) -> int:
        """2 for a mechanism in the plane, 3 in space: as soon as one body is a beam3d or a solid3d."""
        return max(body.dimension for body in self.bodies.values())

    @property
    def n_overconstrained(self) -> int:
        """Number of constraints that rigid bodies with these coordinates do not need: those of parallel hinges, say."""
        motions = (self.dimension + TURNS[self.dimension]) * len(self.bodies)
        held = sum(joint.n_constraints(self.dimension) for joint in self.joints.values())
        return max(0, held - (motions - len(self.coordinates)))

    @property
    def values(self) -> dict[str, float]:
        """Value of each parameter in a single run: nominal, or what ``--set`` gave."""
        return {name: parameter.current for name, parameter in self.parameters.items()}

    @property
    def counted(self) -> tuple[str, ...]:
        """Outputs that are counted over a run: figures of the whole of it, as a damage."""
        return tuple(name for name, output in self.outputs.items() if output.is_counted)

    @property
    def nominal(self) -> dict[str, float]:
        """Nominal value of each parameter, where the reduced basis is built."""
        return {name: parameter.nominal for name, parameter in self.parameters.items()}

    @property
    def second_order(self) -> bool:
        """Whether the reduced model has what is of second order in deformation: both effects that make it up or all."""
        return self.reduction.second_order or any(e.second_order for e in self.effects.values())

    @property
    def static_stiffening(self) -> bool:
        """Whether an effect asks bodies to follow their shortening by bending at once: in component runs too."""
        return any(effect.is_stretching == "static" for effect in self.effects.values())

    @property
    def static_stretching(self) -> bool:
        """Whether the reduced model follows the shortening of bodies at once, instead of by coordinates that stretch
        them."""
        return self.static_stiffening or self.reduction.second_order and self.reduction.stretching == "static"

    @property
    def interpolation(self) -> str:
        """The interpolation of reduced tables between samples. Where joints are elastic, splines take the place of
        Overhauser's tangents: rigid motion and what these joints carry along share inertia, whose slopes are forces.
        """
        scheme = self.reduction.interpolation
        elastic = any(joint.elastic is not None for joint in self.joints.values())
        return "spline" if elastic and scheme == "overhauser" else scheme

    @property
    def gyroscopic(self) -> bool:
        """Whether the reduced model has the inertia forces that are quadratic in velocities."""
        return all(effect.keeps_velocity_forces for effect in self.effects.values())

    @property
    def positive_parameters(self) -> frozenset[str]:
        """Parameters that only make sense where they are positive: those of materials and sections."""
        return self._of_signs("positive")

    @property
    def parameters_not_negative(self) -> frozenset[str]:
        """Parameters that make no sense below zero: the positive ones, and those of damping and friction."""
        return self._of_signs("positive", "not negative")

    def _of_signs(self, *signs: Sign) -> frozenset[str]:
        return frozenset(use.parameter for use in uses_of(self) if use.sign in signs and use.parameter is not None)

    @property
    def driven(self) -> tuple[str, ...]:
        """The coordinates that follow given motions."""
        return tuple(effect.coordinate for effect in self.effects.values() if isinstance(effect, Driving))

    @property
    def carried(self) -> dict[str, Effect]:
        """The effects whose force hangs on the one that their joint carries, in the order of `plain_effects`."""
        return {name: effect for name, effect in self.plain_effects.items() if effect.by_load}

    @property
    def jumping(self) -> tuple[str, ...]:
        """The entries of forces that jump with the motion."""
        return tuple(f"effects.{name}.force" for name, effect in self.effects.items() if effect.jumps_with - {"t"})

    @property
    def beyond_steps(self) -> str:
        """What helps where smaller steps do not, as where forces have no balance, or bodies turn fast."""
        cures = []
        if self.carried:
            cures.append(f"less coefficient or radius of {', '.join(self.carried)}, with which joints may jam")
        if self.jumping:
            cures.append(f"{', '.join(self.jumping)} written without a jump (max, min, tanh)")
        if self.simulation.spectral_radius > numerics.Simulation.model_fields["spectral_radius"].default:
            cures.append("a smaller simulation.spectral_radius, with which bodies may turn by more in a step")
        return f", and where none helps {', or '.join(cures)}" if cures else ""

    @property
    def loose(self) -> tuple[str, ...]:
        """The entries of joints with a clearance, of which statics do not find where their parts rest."""
        return tuple(f"joints.{name}.clearance" for name, one in self.joints.items() if one.gives_way == "clearance")

    @property
    def beside(self) -> tuple[str, ...]:
        """The entries whose forces are found between the corrections of a step."""
        return (*(f"controllers.{name}" for name in self.controllers), *(f"effects.{name}" for name in self.carried))

    @property
    def held(self) -> bool:
        """Whether these forces hold still within steps: where all are those of controllers that are sampled."""
        return not self.carried and all(one.sample_time for one in self.controllers.values())

    @property
    def plain_effects(self) -> dict[str, Effect]:
        """The effects with loads whose functions of time hold numbers alone; see `parts_of`."""
        return {part: plain for name, effect in self.effects.items() for part, plain in parts_of(name, effect).items()}

    def path_of(self, mesh: str) -> Path:
        """Return the path of a body's mesh file, which a scene gives relative to its own directory."""
        return self._directory / mesh

    def number(self, entry: float | str, values: Mapping[str, float] | None = None) -> float:
        """Return the number behind an entry that is a number or a parameter's name, such as
        ``scene.bodies["crank"].section.radius``, at values of the parameters; those of a single run (`values`) if not
        given."""
        return (self.values if values is None else values)[entry] if isinstance(entry, str) else entry

    def ground_position(self, point: str) -> tuple[float, ...]:
        """Return the position of a ground point (m): as many numbers as the mechanism's space has dimensions."""
        place = (*self.ground.positions[point], 0.0)[: self.dimension]
        return tuple(float(self.number(entry)) for entry in place)

    def with_values(self, values: Mapping[str, float]) -> Self:
        """Return the scene with values of a single run for some of its parameters."""
        changed = {name: self.parameters[name].model_copy(update={"value": float(values[name])}) for name in values}
        return self.model_copy(update={"parameters": {**self.parameters, **changed}})

    def with_entries(self, **tables: Any) -> Self:
        """Return the scene with other tables; of one of settings a mapping has the entries that are other ones."""
        for name, given in tables.items():
            if isinstance(given, dict) and isinstance(own := getattr(self, name), Table):
                tables[name] = own.model_copy(update=given)
        return self.model_copy(update=tables)

    def initial_state(self, coordinate: str) -> numerics.InitialState:
        """Return where a coordinate starts: as given, or 0 and at rest."""
        return self.simulation.initial.get(coordinate, numerics.InitialState())

    @model_validator(mode="before")
    @classmethod
    def _defaults_of_the_reduction(cls, data: Any) -> Any:
        """Take ``effects = "auto"`` for a choice without loads, fewer angles along each of several coordinates, and
        splines over three, whose samples are far apart, and where joints are elastic (`interpolation`)."""
        if not isinstance(data, dict) or not isinstance(data.get("reduction", {}), dict):
            return data
        reduction = dict(data.get("reduction", {}))
        automatic = data.get("effects") == "auto"
        if automatic:
            reduction["effects"] = "auto"
        n = len(data["coordinates"]) if isinstance(data.get("coordinates"), dict) else 1
        if reduction.get("tolerance") is None:  # which leaves to the choice what is not given
            joints = data["joints"].values() if isinstance(data.get("joints"), dict) else ()
            if n == 3 or any(isinstance(one, dict) and "elastic" in one for one in joints):
                reduction.setdefault("interpolation", "spline")
            if n > 1:
                few = ANGLES_OF_SEVERAL[min(n, max(ANGLES_OF_SEVERAL))]
                reduction.setdefault("angles", max(few, *map(_along, data["coordinates"].values())) if n == 3 else few)
                if reduction.get("sampling_tolerance") is not None:
                    reduction.setdefault("max_angles", MOST_OF_SEVERAL[min(n, max(MOST_OF_SEVERAL))])
        changed = {**data, "reduction": reduction} if reduction else data
        return {**changed, "effects": {}} if automatic else changed

    def model_post_init(self, context: Any, /) -> None:
        """Take the directory from the context of the validation, where `loading` puts it."""
        if context:
            self._directory = Path(context["directory"])

    @model_validator(mode="after")
    def _references_hold(self, info: ValidationInfo) -> Self:
        context = info.context or {}
        given, raw = context.get("units", {}), context.get("raw", {})
        problems = [
            *reference_problems(self),
            *controller_problems(self),
            *correlation_problems(self),
            *field_problems(self),
            *length_problems(self),
            *part_problems(self),
            *numerics.ensemble_problems(self),
            *unit_problems(self, given),
            *text_problems(self, raw),
        ]
        if problems:
            raise input_error(problems)
        return self


WHEN_GROWN.append(lambda: [table.model_rebuild(force=True) for table in (Body, Scene)])  # sections are of bodies
