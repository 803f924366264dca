"""A body that is given by its assembled matrices, from another finite element program, in place of a mesh."""

from __future__ import annotations

from typing import Annotated

from pydantic import BeforeValidator, Field, field_validator

from pgmp_petsc.scene.fields import Name, PositiveNumber, PositiveOrParameter, Table, is_number, refusal
from pgmp_petsc.scene.units import UnknownUnit, measure

#: What each unit of a system is of: exponents of kilogram, metre and second, and examples.
QUANTITIES = {
    "length": ((0, 1, 0), 'of a length, such as "m", "mm" or "in"'),
    "mass": ((1, 0, 0), 'of a mass, such as "kg", "t" or "lbf s2/in"'),
    "time": ((0, 0, 1), 'of a time, such as "s" or "ms"'),
}


def _node_set(value: object) -> object:
    named = isinstance(value, str) and value
    if not (named or isinstance(value, (list, tuple)) and value and all(type(number) is int for number in value)):
        raise refusal("the name of a set of the nodes' file, or numbers of nodes in brackets, is needed")
    return value


def _numbers(value: object) -> object:
    if not (isinstance(value, (list, tuple)) and value and all(map(is_number, value))):
        raise refusal("finite numbers in brackets are needed")
    return value


Numbers = Annotated[tuple[float, ...], BeforeValidator(_numbers)]


class UnitSystem(Table):
    """The units that matrices and nodes are written in; stiffness is in mass / time^2."""

    length: str = Field("m", description="unit of the nodes' coordinates")
    mass: str = Field("kg", description="unit of the mass matrix")
    time: str = Field("s", description="unit of time")

    @field_validator("length", "mass", "time")
    @classmethod
    def _is_one(cls, value: str, info) -> str:
        wanted, words = QUANTITIES[info.field_name]
        try:
            dimension = measure(value)[1]
        except UnknownUnit as error:
            raise refusal(str(error)) from error
        if dimension != wanted:
            raise refusal(f"a unit {words}, is needed")
        return value

    def in_si(self, key: str) -> float:
        """Return how many of the SI unit the unit of ``"length"``, ``"mass"`` or ``"time"`` is."""
        return measure(getattr(self, key))[0]


class Stated(Table):
    """Mass properties that matrices must have, in SI units: what the program that wrote them says of the body."""

    mass: PositiveNumber | None = Field(None, description="mass (kg)")
    centre: Numbers | None = Field(None, description="centre of mass in the frame of the nodes (m)")
    inertia: Numbers | None = Field(
        None,
        description="moments of inertia about the centre of mass (kg m2): one in the plane; in space about x, y, z",
    )
    within: PositiveNumber = Field(1e-3, lt=1.0, description="share by which they may differ")


class Matrices(Table):
    """Files of stiffness, mass and nodes."""

    stiffness: str = Field(min_length=1, description="file of the stiffness matrix, relative to the scene's directory")
    mass: str = Field(min_length=1, description="file of the mass matrix")
    nodes: str = Field(min_length=1, description="file of the nodes: a mesh, .csv or .npz")
    rows: str | None = Field(
        None,
        min_length=1,
        description="file that says of which node and direction each row is, such as Ansys' .mapping",
    )
    units: UnitSystem = Field(UnitSystem(), description="units of the files: length, mass, time")
    faces: dict[Name, Annotated[str | tuple[int, ...], BeforeValidator(_node_set)]] = Field(
        {}, description="points of the body: a set of the nodes' file, or numbers of nodes"
    )
    stiffness_scale: PositiveOrParameter = Field(1.0, description="factor of the stiffness, or a parameter's name")
    mass_scale: PositiveOrParameter = Field(1.0, description="factor of the mass, or a parameter's name")
    stated: Stated | None = Field(None, description="mass properties that the matrices must have")
