"""Entries of a beam's cross-section in a scene, and what all else has to know of one; see `bodies.sections`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from pgmp_petsc.declare.ideas import SECTIONS, Found, refuse
from pgmp_petsc.scene.fields import Table, Unit, quantities_of

if TYPE_CHECKING:
    from pgmp_petsc.scene.bodies import Material

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
    #: Entries that stiffness and mass of a beam2d are proportional to.
    proportional: ClassVar[tuple[str, ...]] = ()
    #: Entries of which the first is below a share of the second, in every sample.
    ordered: ClassVar[tuple[tuple[str, str, float], ...]] = ()
    #: Entries that may name a parameter, with their signs and units.
    quantities: ClassVar[dict[str, tuple[str, Unit]]] = {}

    @classmethod
    def __pydantic_init_subclass__(cls, **arguments: Any) -> None:
        if not SECTIONS.take(cls):
            return
        try:
            cls.quantities = quantities_of(cls)
        except ValueError as error:
            raise refuse(cls, str(error)) from error
        if cls.coefficients is SectionEntry.coefficients:
            raise refuse(cls, "a section has the method coefficients(self, dimension, material, nominal, spans)")
        if bool(cls.sizes) != (cls.reach is not SectionEntry.reach):
            raise refuse(cls, "outermost fibres are declared by the property reach and the entries sizes, both or none")
        if not set(cls.elements) <= set(BEAMS):
            raise refuse(cls, f"its elements are among {', '.join(BEAMS)}")

    def coefficients(
        self, dimension: int, material: Material | None, nominal: Mapping[str, float], spans: Spans
    ) -> Any:
        """Return its stiffness and inertia, a `bodies.sections.section.BeamSection`.

        Parameters
        ----------
        dimension
            2 in the plane, 3 in space.
        material
            Where it is of one.
        nominal
            Nominal values of all parameters.
        spans
            Returns the smallest and largest values that parameters take, where they vary.
        """
        raise NotImplementedError

    @property
    def reach(self) -> Any:
        """Distances of the outermost fibre from the axis along the second and third axis, quantities in m, or None."""
        return None


#: The section of a body.
Section = Annotated[SectionEntry, Found(SECTIONS)]
