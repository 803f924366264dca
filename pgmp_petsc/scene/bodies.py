"""Materials, cross-sections of beams (see `bodies.sections`) and bodies: of a mesh, of matrices that another finite
element program assembled, or rigid, of mass properties."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field, field_validator, model_validator

from pgmp_petsc.base.units import UnitSystem, UnknownUnit, measure
from pgmp_petsc.declare.ideas import SECTIONS, Found, blaming, refuse
from pgmp_petsc.scene.fields import (
    Along,
    Angle,
    Axis,
    FixedPlace,
    Inertia,
    Integer,
    Name,
    Number,
    PositiveNumber,
    PositiveOrParameter,
    Table,
    Triple,
    Unit,
    at_most,
    is_number,
    needed,
    no_parameter,
    quantities_of,
    refusal,
)

Spans = Callable[[], Mapping[str, tuple[float, float]]]
BEAMS = ("beam2d", "beam3d")


class SectionEntry(Table):
    """A table ``section = { shape = ... }``. A section is a subclass with ``shape: Literal["..."]`` and its entries.

    Its axes are the second, along `orientation` and in the plane of motion, and the third. An entry that may name a
    parameter says its `Unit`.
    """

    #: Elements that it is for.
    elements: ClassVar[tuple[str, ...]] = BEAMS
    #: Whether it takes its elasticity and density from a material.
    of_material: ClassVar[bool] = True
    #: Whether it is the same in all directions: it needs no orientation.
    round: ClassVar[bool] = False
    #: Entries of its sizes along the second and the third axis; none where it has no outermost fibre.
    sizes: ClassVar[tuple[str, ...]] = ()
    #: Distances of the outermost fibre from the axis along the second and third axis, quantities in m, or None.
    reach: ClassVar[Any] = None
    #: Entries that stiffness and mass of a beam2d are proportional to.
    proportional: ClassVar[tuple[str, ...]] = ()
    #: Entries of which the first is below a share of the second, in every sample.
    ordered: ClassVar[tuple[tuple[str, str, float], ...]] = ()

    @classmethod
    def __pydantic_init_subclass__(cls, **arguments: Any) -> None:
        if not SECTIONS.take(cls):
            return
        quantities_of(cls)
        if cls.coefficients is SectionEntry.coefficients:
            raise refuse(cls, "a section has the method coefficients(self, dimension, material, nominal, spans)")
        if bool(cls.sizes) != (cls.reach is not SectionEntry.reach):
            raise refuse(cls, "outermost fibres are declared by the property reach and the entries sizes, both or none")
        named = {*cls.sizes, *cls.proportional, *(key for pair in cls.ordered for key in pair[:2])}
        if strange := sorted(named - set(cls.model_fields)):
            raise refuse(cls, f"there is no entry {strange[0]}; its entries: {', '.join(cls.model_fields)}")
        if not set(cls.elements) <= set(BEAMS):
            raise refuse(cls, f"its elements are among {', '.join(BEAMS)}")

    def blamed(self) -> AbstractContextManager[None]:
        """Name the section where its coefficients cannot be worked with, if it is a plugin's."""
        return blaming(type(self))

    def coefficients(
        self, dimension: int, material: Material | None, nominal: Mapping[str, float], spans: Spans
    ) -> Any:
        """Return its stiffness and inertia, a `bodies.sections.section.BeamSection`, in so many dimensions.

        It may be of a material; nominal values are those of all parameters, and spans the smallest and largest values
        that they take, where they vary.
        """
        raise NotImplementedError


#: The section of a body.
Section = Annotated[SectionEntry, Found(SECTIONS)]


#: What each unit of a system is of: exponents of kilogram, metre and second, and examples.
QUANTITIES = {
    "length": ((0, 1, 0), 'of a length, such as "m", "mm" or "in"'),
    "mass": ((1, 0, 0), 'of a mass, such as "kg", "t" or "lbf s2/in"'),
    "time": ((0, 0, 1), 'of a time, such as "s" or "ms"'),
}


def _is_full_list(value: object, fits: Callable[[Any], bool]) -> bool:
    return isinstance(value, (list, tuple)) and bool(value) and all(map(fits, value))


#: A set of nodes by its name, or numbers of nodes.
NodeSet = Annotated[
    str | tuple[int, ...],
    needed(
        "the name of a set of the nodes' file, or numbers of nodes in brackets, is needed",
        lambda value: value if isinstance(value, str) else _is_full_list(value, lambda number: type(number) is int),
    ),
]
#: A group of faces by its name, or several.
Groups = Annotated[
    str | tuple[str, ...],
    needed(
        "the name of a group of faces, or several in brackets, is needed",
        lambda value: value if isinstance(value, str) else _is_full_list(value, lambda name: isinstance(name, str)),
    ),
]
Numbers = Annotated[
    tuple[float, ...], needed("finite numbers in brackets are needed", lambda value: _is_full_list(value, is_number))
]


class FileUnits(Table):
    """The units that matrices and nodes are written in, those of the scene if not said; stiffness is in
    mass / time^2."""

    length: str | None = Field(None, description="unit of the nodes' coordinates")
    mass: str | None = Field(None, description="unit of the mass matrix")
    time: str | None = Field(None, description="unit of time")

    @field_validator("length", "mass", "time")
    @classmethod
    def _is_one(cls, value: str | None, info) -> str | None:
        if value is None:
            return value
        wanted, words = QUANTITIES[info.field_name]
        try:
            dimension = measure(value)[1]
        except UnknownUnit as error:
            raise refusal(str(error)) from error
        if dimension != wanted:
            raise refusal(f"a unit {words}, is needed")
        return value

    def factors(self, system: UnitSystem) -> tuple[float, float, float]:
        """Return how many SI units those of length, mass and time are, which are of a system where none is said."""
        given = ((getattr(self, key), dimension) for key, (dimension, _) in QUANTITIES.items())
        length, mass, time = (system.size(dimension) if unit is None else measure(unit)[0] for unit, dimension in given)
        return length, mass, time


class Stated(Table):
    """Mass properties that matrices must have, in the scene's units: what the program that wrote them says of the
    body."""

    mass: Annotated[PositiveNumber, Unit("kg")] | None = Field(None, description="mass (kg)")
    centre: Annotated[Numbers, Unit("m")] | None = Field(
        None, description="centre of mass in the frame of the nodes (m)"
    )
    inertia: Annotated[Numbers, Unit("kg m2")] | None = Field(
        None,
        description="moments of inertia about the centre of mass (kg m2): one in the plane; in space about x, y, z",
    )
    within: PositiveNumber = Field(1e-3, lt=1.0, description="share by which they may differ")


class Matrices(Table):
    """Files of stiffness, mass and nodes."""

    stiffness: str = Field(min_length=1, description="file of the stiffness matrix, relative to the scene's directory")
    mass: str = Field(min_length=1, description="file of the mass matrix of all nodes")
    modes: str | None = Field(
        None,
        min_length=1,
        description="of a body that is reduced already (Craig and Bampton): file of what each row of the stiffness is "
        "of, displacements of all nodes, a column each; the mass stays that of the nodes",
    )
    nodes: str = Field(min_length=1, description="file of the nodes: a mesh, .csv or .npz")
    rows: str | None = Field(
        None,
        min_length=1,
        description="file that says of which node and direction each row is: Ansys' .mapping, CalculiX' .dof",
    )
    units: FileUnits = Field(FileUnits(), description="units of the files: length, mass, time")
    faces: dict[Name, NodeSet] = Field(
        {}, description="points of the body: a set of the nodes' file, or numbers of nodes"
    )
    stiffness_scale: Annotated[PositiveOrParameter, Unit("1")] = Field(1.0, description="factor of the stiffness")
    mass_scale: Annotated[PositiveOrParameter, Unit("1")] = Field(1.0, description="factor of the mass")
    stated: Stated | None = Field(None, description="mass properties that the matrices must have")


#: Entries of an inertia in space, in their order; where each is in the tensor.
MOMENTS = {"ixx": (0, 0), "iyy": (1, 1), "izz": (2, 2), "ixy": (0, 1), "ixz": (0, 2), "iyz": (1, 2)}
IN_ORDER = tuple(map(list, zip(*MOMENTS.values())))  # of a tensor, its entries in the order of a scene's
ROUNDED = 3e-3  # of the largest moment: moments of flat bodies of three figures may be off by so much
SINGULAR = 1e-12  # of the largest moment: one below is zero


class Rigid(Table):
    """Mass properties of a rigid body, and its points."""

    mass: Annotated[PositiveOrParameter, Unit("kg")] = Field(description="mass (kg)")
    inertia: Inertia = Field(
        description="about the centre of mass (kg m2): in the plane izz; in space entries [ixx, iyy, izz, ixy, ixz, "
        "iyz] of the tensor along the axes of the body's frame, of which ixy is minus the integral of x y dm; numbers "
        "or parameters' names"
    )
    centre: FixedPlace | None = Field(
        None, description="centre of mass in the body's frame (m); its origin if left out"
    )
    points: dict[Name, FixedPlace] = Field({}, description="points by name, in the body's frame (m); centre is one")

    @property
    def dimension(self) -> int:
        """2 in the plane, 3 in space."""
        return 3 if isinstance(self.inertia, tuple) else 2

    @property
    def moments(self) -> dict[str, float | str]:
        """Entries of the inertia by name; in the plane ``izz`` alone."""
        return dict(zip(MOMENTS, self.inertia)) if isinstance(self.inertia, tuple) else {"izz": self.inertia}

    @property
    def places(self) -> dict[str, np.ndarray]:
        """Points by name, shape (d,) each, the centre of mass first, m."""
        centre = (0.0,) * self.dimension if self.centre is None else self.centre
        return {name: np.array(place) for name, place in ({"centre": centre} | self.points).items()}

    def tensor(self, number: Callable[[float | str], float]) -> np.ndarray:
        """Return the inertia about the centre of mass, shape (1, 1) or (3, 3), kg m2; `number` is of an entry."""
        if self.dimension == 2:
            return np.array([[number(self.inertia)]])
        found = np.zeros((3, 3))
        for name, value in self.moments.items():
            i, j = MOMENTS[name]
            found[i, j] = found[j, i] = number(value)
        return found

    def extent(self, number: Callable[[float | str], float]) -> float:
        """Return the largest extent of the points along an axis, or, if it is longer, the length of the straight bar
        with the largest radius of gyration, m."""
        gyration = np.sqrt(np.linalg.eigvalsh(self.tensor(number))[-1] / number(self.mass))
        return max(float(np.max(np.ptp(list(self.places.values()), axis=0))), float(np.sqrt(12.0) * gyration))

    def unlike_mass(self, number: Callable[[float | str], float]) -> str:
        """Say why nothing that has mass has this inertia; empty where something has."""
        principal = np.linalg.eigvalsh(self.tensor(number))
        words = ", ".join(f"{moment:.6g}" for moment in principal)
        if principal[0] <= SINGULAR * principal[-1]:
            return f"is not positive definite: its principal moments are {words}"
        if principal.size > 1 and principal[2] > principal[0] + principal[1] + ROUNDED * principal[2]:
            return f"no body has it: of the principal moments {words} the last is above the sum of the others"
        return ""


MOST_ELEMENTS = 100_000


class Material(Table):
    """An isotropic linear elastic material."""

    E: Annotated[PositiveOrParameter, Unit("Pa")] = Field(description="Young's modulus (Pa)")
    nu: Annotated[
        Number,
        no_parameter("stiffness is no sum of products of parameters with it; build once for each value (--override)"),
    ] = Field(gt=-1.0, lt=0.5, description="Poisson's ratio")
    rho: Annotated[PositiveOrParameter, Unit("kg/m3")] = Field(description="density (kg/m3)")


class StraightBeam(Table):
    """A straight line of equal elements along the x axis of the body's frame. It has the points hinge and tip at its
    ends, middle where a node is there, and any node by its index from 0 on."""

    length: Annotated[PositiveOrParameter, Unit("m")] = Field(description="length (m); see docs/method.md")
    elements: Annotated[Integer, at_most(MOST_ELEMENTS, "no straight beam needs more, and they fill memory")] = Field(
        ge=1, description="number of elements"
    )
    start: Along = Field(0.0, description="x of the hinge (m)")


class Placement(Table):
    """First guess of a body's place for the assembly: rotate about the mesh's origin, then move."""

    origin: FixedPlace = Field((0.0, 0.0), description="where the mesh's origin goes (m)")
    angle: Angle = Field(0.0, description="rotation about the mesh's origin (rad, anticlockwise); in the plane")
    rotation: Annotated[Triple, Unit("rad")] | None = Field(
        None,
        description="rotation vector: axis times angle (rad); in space, where the angles of joints are zero as placed",
    )

    @field_validator("rotation", mode="before")
    @classmethod
    def _is_a_vector(cls, rotation: object) -> object:
        if isinstance(rotation, (int, float, str)):
            raise refusal("a rotation vector has three numbers, such as [0.0, 0.0, 1.0]; in the plane give angle")
        return rotation


CAD = (".step", ".stp")  # endings of files with parts of CAD
OF_MESHES = ("mesh_size", "faces")  # entries of meshed solids


class Body(Table):
    """A body: flexible, or rigid with the same mass."""

    one_of = ("mesh", "line", "matrices", "rigid")
    mesh: str | None = Field(
        None, min_length=1, description="mesh file, or STEP file of one solid, relative to the scene's directory"
    )
    mesh_size: Annotated[PositiveNumber, Unit("m")] | None = Field(
        None, description="of a STEP file, the largest size of a cell (m); by the thickness of its walls if left out"
    )
    faces: dict[Name, Groups] = Field(
        {}, description="further points of a meshed solid: a group of faces of its mesh, or several in brackets"
    )
    line: StraightBeam | None = Field(
        None, description="instead of a mesh file, a straight line { length = 0.3, elements = 5 }"
    )
    matrices: Matrices | None = Field(
        None, description="instead of a mesh and a material, assembled matrices of another program; solids only"
    )
    rigid: Rigid | None = Field(
        None, description="instead of a mesh and a material, mass, centre of mass and inertia of a rigid body"
    )
    element: Literal["beam2d", "beam3d", "solid2d", "solid3d"] | None = Field(
        None,
        description="beam in the plane or in space, plane stress or solid; the cells of the mesh say which element of "
        "its kind. Needed but with rigid",
    )
    material: str | None = Field(None, description="name of a material; not for a section given by coefficients")
    section: Section | None = Field(
        None, description='cross-section of a beam, such as { shape = "circle", radius = 0.01 }'
    )
    orientation: Axis | None = Field(
        None,
        description="direction (x, y, z) of the second axis of the section of a beam3d, that of its height, in the "
        "body's frame; circles need none",
    )
    thickness: Annotated[PositiveOrParameter | None, Unit("m")] = Field(None, description="thickness of solid2d (m)")
    section_scale: Annotated[PositiveOrParameter | None, Unit("1")] = Field(
        None,
        description="scale of the cross-section of a continuum body about the x axis of its mesh, of which the mesh "
        "has 1",
    )
    regions: dict[str, str] = Field(
        {}, description="materials of named regions of the mesh, other than the body's; continuum elements only"
    )
    flexible: bool = Field(True, strict=True, description="false makes the body rigid")
    placement: Placement | None = Field(None, description="first guess for the assembly")

    @model_validator(mode="before")
    @classmethod
    def _does_not_deform(cls, data: Any) -> Any:
        given = isinstance(data, dict) and data.get("rigid") is not None
        return {"flexible": False, **data} if given else data

    def check_entries(self) -> None:
        in_matrices = ("material", "thickness", "section", "orientation", "section_scale", "regions")
        if self.rigid is not None:
            self._has_none("rigid says all mass properties; leave it out", "element", *in_matrices, *OF_MESHES)
            if self.flexible:
                raise refusal("a body with rigid does not deform; leave it out", "flexible")
        elif self.element is None:
            raise refusal("missing; needed: beam2d, beam3d, solid2d or solid3d", "element")
        elif self.matrices is not None:
            if not self.continuum:
                raise refusal("for solid2d and solid3d only", "matrices")
            self._has_none("for solids from a mesh only; matrices have their own faces", *OF_MESHES)
            cure = "matrices.stiffness_scale and matrices.mass_scale multiply these"
            self._has_none(f"is in the matrices already; {cure}", *in_matrices)
        elif self.of_cad and self.element != "solid3d":
            raise refusal('a part of CAD is a solid: element = "solid3d" is needed', "element")
        elif self.continuum:
            self._check_solid()
        else:
            self._check_beam()

    def _has_none(self, why: str, *keys: str) -> None:
        """Refuse entries that are given, and why."""
        for key in keys:
            if getattr(self, key):
                raise refusal(why, key)

    @property
    def of_cad(self) -> bool:
        """Whether the body is a part of CAD, which is meshed here."""
        return self.mesh is not None and self.mesh.lower().endswith(CAD)

    @property
    def continuum(self) -> bool:
        """Whether the body is made of continuum elements, meshed here or assembled by another program."""
        return self.element in ("solid2d", "solid3d")

    @property
    def kind(self) -> str:
        """Its element, or ``"rigid"``."""
        return self.element or "rigid"

    @property
    def dimension(self) -> int:
        """2 in the plane, 3 in space."""
        return int(self.element[-2]) if self.rigid is None else self.rigid.dimension

    def _check_solid(self) -> None:
        for key in ("line", "section", "orientation"):
            if getattr(self, key) is not None:
                beam = f"beam{self.dimension}d" if key != "orientation" else "beam3d"
                raise refusal(f"{self.element} takes its shape from a mesh; {key} is for {beam}", key)
        if self.material is None:
            raise refusal("missing; needed: name of a material", "material")
        if self.mesh_size is not None and not self.of_cad:
            raise refusal('for a part of CAD, mesh = "PART.step"; a mesh file has its cells already', "mesh_size")
        if self.element == "solid2d" and self.thickness is None:
            raise refusal("missing; needed: thickness of the body (m), a number or a parameter's name", "thickness")
        if self.element == "solid3d" and self.thickness is not None:
            raise refusal("for solid2d only; a solid3d body has its thickness from its mesh", "thickness")
        if self.section_scale is not None and not self.flexible:
            raise refusal("for flexible bodies; the inertia of a rigid one would not be affine in it", "section_scale")

    def _check_beam(self) -> None:
        self._has_none("for solid2d and solid3d only", "thickness", "section_scale", "regions", *OF_MESHES)
        if self.section is None:
            raise refusal('missing; needed: a cross-section, such as { shape = "circle", radius = 0.01 }', "section")
        section = self.section
        if self.element not in section.elements:
            kinds = {name: one for name, one in zip(SECTIONS.names, SECTIONS.found()) if self.element in one.elements}
            alike = (name for name, one in kinds.items() if one.of_material == section.of_material)
            raise refusal(f'a {self.element} has the shape "{" or ".join(alike)}"', "section")
        if not section.of_material and self.material is not None:
            raise refusal("a section given by coefficients has no material", "material")
        if section.of_material and self.material is None:
            raise refusal("missing; needed: name of a material", "material")
        none = next((key for key in quantities_of(type(section)) if getattr(section, key) == 0.0), None)
        if none is not None and self.flexible:
            raise refusal(f"a flexible body needs section.{none} above 0", "section")
        if self.dimension == 2 and self.orientation is not None:
            raise refusal("for beam3d only; in the plane the height of a section is in the plane", "orientation")
        if self.dimension == 3 and self.orientation is None and not self.section.round:
            raise refusal(
                "missing; needed in space for every section but a circle: orientation = [x, y, z], the direction of "
                "the section's height (its second axis) in the body's frame",
                "orientation",
            )
