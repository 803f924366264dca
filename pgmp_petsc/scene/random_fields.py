"""Random fields over bodies, and the parameters that they are made of.

Field NAME with n terms has the parameters ``NAME_1`` .. ``NAME_n``, its uncorrelated variables of mean 0 and variance 1
(`bodies.random_fields`): uniform, or normal and cut off at a number of deviations. They are put among the scene's
parameters when it is read, and from there on are parameters like any others.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from pgmp_petsc.runtime.errors import nearest_name
from pgmp_petsc.scene.fields import Integer, Number, PositiveNumber, Table, at_most, refusal
from pgmp_petsc.scene.messages import problem
from pgmp_petsc.scene.parameters import Parameter

if TYPE_CHECKING:
    from pgmp_petsc.scene.schema import Scene

MOST_TERMS = 100
Terms = Annotated[Integer, Field(ge=1), at_most(MOST_TERMS, "each is a parameter, and an affine term of its body")]
NOT_AFFINE = (
    "stiffness and mass are not affine in a field of it; give fields of E and rho, or bodies of their own to the parts "
    "that differ"
)


class RandomField(Table):
    """A quantity that varies over a body at random: mean (1 + variation g(x)), g a Gaussian field or one like it."""

    body: str = Field(description="name of a flexible body")
    quantity: Literal["E", "rho", "width", "thickness", "radius", "height"] = Field(
        description='what varies: "E" or "rho", of a section by coefficients all its stiffness or mass; "width" of a '
        'rectangle of beam2d; "thickness" of solid2d'
    )
    variation: PositiveNumber = Field(description="coefficient of variation: deviation over mean")
    length: PositiveNumber = Field(description="correlation length (m)")
    kernel: Literal["exponential", "squared_exponential", "matern"] = Field(
        "exponential", description="correlation over the distance"
    )
    smoothness: PositiveNumber | None = Field(
        None, le=20.0, description="of the kernel matern, and needed there: 0.5 is exponential, 1.5 has a slope"
    )
    terms: Terms = Field(description="number of terms of the Karhunen-Loeve expansion, each with a parameter NAME_k")
    least_share: Number = Field(
        0.0, ge=0.0, lt=1.0, description="share of the variance that the terms have to keep; with less it is refused"
    )
    distribution: Literal["normal", "uniform"] = Field("normal", description="of the parameters NAME_k")
    limit: PositiveNumber = Field(
        3.0, le=8.0, description="where the normal distribution is cut off, in deviations; its variance stays 1"
    )

    @property
    def scale(self) -> float:
        """Deviation of the normal distribution that has a variance of 1 where it is cut off."""
        density = math.exp(-0.5 * self.limit**2) / math.sqrt(2.0 * math.pi)
        return 1.0 / math.sqrt(1.0 - 2.0 * self.limit * density / math.erf(self.limit / math.sqrt(2.0)))

    @property
    def reach(self) -> float:
        """Largest value of a parameter NAME_k."""
        return math.sqrt(3.0) if self.distribution == "uniform" else self.limit * self.scale

    def names(self, name: str) -> list[str]:
        """Return the names of the parameters of the field of some name."""
        return [f"{name}_{k}" for k in range(1, self.terms + 1)]

    def parameter(self, name: str, number: int) -> dict[str, Any]:
        """Return the raw table of a parameter, counted from 1, of the field of some name."""
        law = {"name": "norm", "loc": 0.0, "scale": self.scale}
        if self.distribution == "uniform":
            law = {"name": "uniform", "loc": -self.reach, "scale": 2.0 * self.reach}
        return {
            "nominal": 0.0,
            "description": f"variable {number} of the random field {name}",
            "distribution": law,
            "bounds": [-self.reach, self.reach],
        }

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.kernel == "matern" and self.smoothness is None:
            raise refusal("missing; needed: smoothness of the kernel matern, such as 1.5", "smoothness")
        if self.kernel != "matern" and self.smoothness is not None:
            raise refusal('for the kernel "matern" only', "smoothness")
        return self


def add_field_parameters(data: dict[str, Any]) -> None:
    """Put the parameters of all fields into raw tables, where they are not; what is no field is left for the
    validation."""
    fields, parameters = data.get("fields"), data.setdefault("parameters", {}) if data.get("fields") else None
    if not isinstance(fields, dict) or not isinstance(parameters, dict):
        return
    for name, entry in fields.items():
        try:
            field = RandomField.model_validate(entry)
        except ValueError:  # pydantic's; names that are none raise it too
            continue
        for number, parameter in enumerate(field.names(name), 1):
            parameters.setdefault(parameter, field.parameter(name, number))


def variables_of(scene: Scene) -> dict[str, str]:
    """Return the parameters that are variables of fields, with the field of each."""
    return {parameter: name for name, field in scene.fields.items() for parameter in field.names(name)}


def field_problems(scene: Scene) -> Iterator[str]:
    """Yield one line for each field that does not fit its body, or whose parameters are other ones."""
    taken: dict[tuple[str, str], str] = {}
    for name, field in scene.fields.items():
        yield from _of_body(scene, name, field)
        other = taken.setdefault((field.body, field.quantity), name)
        if other != name:
            yield problem(f"fields.{name}.quantity", f"fields.{other} is of the same body already", field.quantity)
        for number, parameter in enumerate(field.names(name), 1):
            wanted = Parameter.model_validate(field.parameter(name, number))
            found = scene.parameters.get(parameter)
            if found is None or found.model_copy(update={"value": None}) != wanted:
                cure = "leave the table out (the field makes it), change the field, or give it another name"
                yield problem(f"parameters.{parameter}", f"is variable {number} of fields.{name}; {cure}")
    variables = variables_of(scene)
    for one, others in scene.correlation.items():
        for parameter in (one, *others):
            if parameter in variables:
                field = f"fields.{variables[parameter]}"
                yield problem(f"correlation.{one}", f"{parameter} is a variable of {field}, all uncorrelated")


def _of_body(scene: Scene, name: str, field: RandomField) -> Iterator[str]:
    entry, body = f"fields.{name}", scene.bodies.get(field.body)
    if body is None:
        yield problem(f"{entry}.body", f"there is no such body{nearest_name(field.body, scene.bodies)}", field.body)
        return
    if not body.flexible:
        yield problem(f"{entry}.body", "is rigid; a field needs a flexible body", field.body)
    if body.section_scale is not None:
        what = "its section_scale changes the mesh that the field is over; give numbers to one of them"
        yield problem(f"{entry}.body", what, field.body)
    if body.matrices is not None:
        what = "its matrices are assembled, and nothing of them is known place by place; give it a mesh"
        yield problem(f"{entry}.body", what, field.body)
    affine = {"E", "rho"} | ({"thickness"} if body.element == "solid2d" else set())
    if body.element == "beam2d":
        affine |= set(body.section.proportional)
    if field.quantity not in affine:
        yield problem(f"{entry}.quantity", f"of a {body.element}: {NOT_AFFINE}", field.quantity)
