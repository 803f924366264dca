"""Stress outputs: strains at points of a body, what a quantity makes of them, and the largest of the points.

Every model knows the strains in its own way (`models.stresses`): from the positions of a mesh, or as a constant linear
map of the coordinates that a body is condensed to. From there on all is the same.

What is made of stresses, or of the forces and moments in a beam's section: one number at every point.

Stresses are those of Hooke's law for the strains (St. Venant and Kirchhoff's with Green and Lagrange's), of the
material's elasticity alone: what damps is no part of them. In plane stress the principal stresses are the two in the
plane; von Mises' stress is that of the whole tensor, whose components across the plane vanish.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from pgmp_petsc.bodies.affine import Quantity
from pgmp_petsc.bodies.beam_strains import BeamStrains
from pgmp_petsc.bodies.body import Body
from pgmp_petsc.bodies.elasticity import Lame
from pgmp_petsc.bodies.framed_solid import cells_of_materials
from pgmp_petsc.bodies.profile import Profile
from pgmp_petsc.bodies.random_fields import profiles_of
from pgmp_petsc.bodies.recovery import Recovery
from pgmp_petsc.bodies.solid_strains import SolidStrains
from pgmp_petsc.mechanism.composition import bodies_of
from pgmp_petsc.mesh.line_mesh import LineMesh
from pgmp_petsc.mesh.solid_mesh import SolidMesh
from pgmp_petsc.runtime.errors import InputError
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.outputs import OF_FIBRES, STRESSES
from pgmp_petsc.scene.stress_checks import points_used, stressed_bodies

Values = Mapping[str, "np.ndarray | float"]


@dataclass(frozen=True, eq=False)
class SolidLaw:
    """Stresses of a continuum body.

    Attributes
    ----------
    materials
        Young's modulus (Pa) and Lame's constants over it of every material.
    profile
        What the modulus is multiplied by, cell by cell.
    thickness
        In plane stress, and what it is multiplied by, cell by cell.
    """

    materials: tuple[tuple[Quantity, Lame], ...]
    profile: Profile = Profile()
    thickness: tuple[Quantity, Profile] = (Quantity(1.0), Profile())

    def values(
        self, quantities: Iterable[str], points: SolidStrains, strains: np.ndarray, parameters: Values
    ) -> dict[str, np.ndarray]:
        """Return quantities at all points, each of shape (n_points, n), for strains (n_points, n_strains, n)."""
        stresses = np.empty_like(strains)
        for number, (modulus, lame) in enumerate(self.materials):
            own = points.material == number
            stresses[own] = hooke(strains[own], lame) * modulus.at(parameters)
        if self.profile:
            stresses *= np.expand_dims(self.profile.at(parameters, points.of_cells), 1)
        return {
            quantity: von_mises(stresses)
            if quantity == "von_mises"
            else principal(stresses, quantity == "principal_max")
            for quantity in quantities
        }

    def softening(self, points: SolidStrains, nominal: Mapping[str, float], parameters: Values) -> np.ndarray:
        """Return how much larger strains are than at the nominal parameters for the same forces, shape (n_points, 1, 1
        or n)."""
        thickness, sizes = self.thickness
        ratio = np.ones((points.material.size, 1)) * np.atleast_1d(thickness.at(nominal) / thickness.at(parameters))
        of_materials = [np.atleast_1d(modulus.at(nominal) / modulus.at(parameters)) for modulus, _ in self.materials]
        ratio = ratio * np.array(np.broadcast_arrays(*of_materials))[points.material]
        for profile in (self.profile, sizes):
            if profile:
                ratio = ratio * (profile.at(nominal, points.of_cells) / profile.at(parameters, points.of_cells))
        return ratio[:, None]

    def size(self, quantity: str, body: Body | SolidMesh, nominal: Mapping[str, float]) -> float:
        """Return the quantity for a strain of 1, at nominal parameters."""
        return max(float(modulus.at(nominal)) for modulus, _ in self.materials)


@dataclass(frozen=True, eq=False)
class BeamLaw:
    """Forces and moments in the sections of beams, and stresses in their outermost fibres.

    Attributes
    ----------
    modulus
        Young's modulus, Pa; None of a section given by coefficients.
    reach
        Distances of the outermost fibre from the axis, along the section's second and third axis, m.
    round
        Whether the section is a circle.
    """

    modulus: Quantity | None
    reach: tuple[Quantity, Quantity] | None
    round: bool

    def values(
        self, quantities: Iterable[str], points: BeamStrains, strains: np.ndarray, parameters: Values
    ) -> dict[str, np.ndarray]:
        """Return quantities at all points, each of shape (n_points, n), for strains (n_points, n_strains, n)."""
        resists = points.stiffnesses(parameters)
        forces = points.forces(strains, resists)
        found, fibres = {}, None
        for quantity in quantities:
            if quantity not in OF_FIBRES:
                found[quantity] = forces[:, _number_of(quantity, points.body)]
                continue
            if fibres is None:
                # moments at the points: other strains than came
                fibres = self._of_fibres(points, forces / resists, parameters)
            found[quantity] = outermost(*fibres, quantity == "stress_max")
        return found

    def softening(self, points: BeamStrains, nominal: Mapping[str, float], parameters: Values) -> np.ndarray:
        """Return how much larger strains are than at the nominal parameters for the same forces, shape (n_points,
        n_strains, 1 or n)."""
        ratio = points.stiffnesses(nominal) / points.stiffnesses(parameters)
        # behind the strains of the points are the shears in the middles of their elements
        return np.concatenate([ratio, ratio[:, 1 : 3 if points.in_space else 2]], axis=1)

    def _of_fibres(self, points: BeamStrains, bent: np.ndarray, parameters: Values) -> tuple[np.ndarray, np.ndarray]:
        """Return the stress of the axial force and the largest one of bending, each of shape (n_points, n), for strains
        of the points (n_points, n_strains, n)."""
        young = self.modulus.at(parameters) * points.body.profiles.modulus.at(parameters, points.of_cells)
        along_2, along_3 = (reach.at(parameters) for reach in self.reach)
        if not points.in_space:
            bending = np.abs(bent[:, 2]) * along_2
        elif self.round:
            bending = np.hypot(bent[:, 4], bent[:, 5]) * along_2
        else:
            bending = np.abs(bent[:, 5]) * along_2 + np.abs(bent[:, 4]) * along_3
        return young * bent[:, 0], young * bending

    def size(self, quantity: str, body: Body | SolidMesh, nominal: Mapping[str, float]) -> float:
        """Return the quantity for a strain of 1, or a curvature of 1 over the body's length, at nominal parameters."""
        if quantity in OF_FIBRES:
            return float(self.modulus.at(nominal))
        terms = body.sections("stiffness").items()
        resists = sum(float(weight.evaluate(nominal)) * c[:, _number_of(quantity, body)] for weight, c in terms)
        return float(resists.max() / (body.extent if "moment" in quantity else 1.0))


def _number_of(quantity: str, body: Body) -> int:
    """Return which of the forces and moments in a body's sections a quantity is."""
    return list(STRESSES[f"beam{body.mesh.nodes.shape[1]}d"]).index(quantity)


@dataclass(frozen=True, eq=False)
class StressOutput:
    """One stress output.

    Attributes
    ----------
    name, entry
        In the scene.
    body
        Number of the body.
    points
        Where strains are taken.
    law
        What makes the quantity of them.
    size
        The quantity for a strain of 1: what is small beside it by the round-off of strains is nothing.
    """

    name: str
    entry: Stress
    body: int
    points: SolidStrains | BeamStrains
    law: SolidLaw | BeamLaw
    size: float

    @property
    def unit(self) -> str:
        """Unit of the output."""
        return next(table[self.entry.quantity] for table in STRESSES.values() if self.entry.quantity in table)

    def value(self, strains: np.ndarray, parameters: Values) -> np.ndarray:
        """Return the output, shape (n,), for strains of the points (n_points, n_strains, n).

        Forces and moments have their sign at a place. Of many sections the magnitude is reported: the largest ones of
        either sign may be equal, and an output that jumped from one to the other would have no error to speak of.
        Parameter values are numbers, or of shape (n,).
        """
        values = self.law.values([self.entry.quantity], self.points, strains, parameters)[self.entry.quantity]
        if self.entry.quantity in EXTREMES:
            return EXTREMES[self.entry.quantity](values)
        return LARGEST(np.abs(values)) if self.entry.at is None else FURTHEST(values)

    @classmethod
    def of(cls, name: str, scene: Scene, number: int, body: Body) -> StressOutput:
        """Prepare an output of a scene.

        Parameters
        ----------
        name
            In the scene.
        number, body
            The body that the output names, with its number.

        Raises
        ------
        InputError
            If the place is not on the body's mesh, or the body was condensed without what stresses need.
        """
        entry = scene.outputs[name]
        carrier, recovery = carrier_of(body), recovery_of(body)
        if carrier is None or recovery is not None and not recovery.answered:
            raise InputError(
                f'outputs.{name}.body = "{entry.body}": the reduced model was built without what its stresses need; '
                "name the output in the scene and run pgmp build again"
            )
        law = law_of(scene, entry.body, carrier)
        points = _points(f"outputs.{name}", entry, scene, carrier)
        return cls(name, entry, number, points, law, law.size(entry.quantity, carrier, scene.nominal))


def carrier_of(body: Body) -> SolidMesh | Body | None:
    """Return what a flexible body's stresses live on: its mesh, or for beams itself; None where it is not known."""
    if body.is_beam:
        return body
    if body.meshed is not None:
        return body.meshed.solid.mesh
    recovery = recovery_of(body)
    return None if recovery is None else recovery.carrier


def recovery_of(body: Body) -> Recovery | None:
    """Return what brings a body that is condensed or in a floating frame back to its mesh; None of others, and where it
    is not known."""
    condensed = body.component or body.floating
    return None if condensed is None else condensed.recovery


def law_of(scene: Scene, name: str, carrier: SolidMesh | Body) -> SolidLaw | BeamLaw:
    """Return what makes stresses of a body's strains."""
    entry = scene.bodies[name]
    if isinstance(carrier, SolidMesh):
        used = (scene.materials[material] for material, _ in cells_of_materials(name, entry, carrier))
        plane = carrier.dimension == 2
        materials = tuple((Quantity.of(one.E), Lame.of(one.nu, plane)) for one in used)
        profiles, thickness = profiles_of(scene, name, carrier), entry.thickness if plane else None
        of_plane = (Quantity.of(1.0 if thickness is None else thickness), profiles.size)
        return SolidLaw(materials, profiles.modulus, of_plane)
    if entry.material is None:
        return BeamLaw(None, None, False)
    modulus, section = Quantity.of(scene.materials[entry.material].E), entry.section
    return BeamLaw(modulus, section.reach, section.round)


def quantities_of(scene: Scene, name: str) -> dict[str, str]:
    """Return the quantities that a body has, with their units: no fibre of a section given by coefficients."""
    entry = scene.bodies[name]
    return {key: unit for key, unit in STRESSES[entry.element].items() if entry.material or key not in OF_FIBRES}


def all_points(scene: Scene, name: str, carrier: SolidMesh | Body) -> SolidStrains | BeamStrains:
    """Return all points of a body: the nodes of a mesh of cells, the ends of all elements of beams."""
    if not isinstance(carrier, SolidMesh):
        return BeamStrains.at_ends(carrier, _held(scene, name, carrier))
    materials = [cells for _, cells in cells_of_materials(name, scene.bodies[name], carrier)]
    return SolidStrains.at_nodes(carrier, materials, np.arange(carrier.n_nodes))


def cell_points(scene: Scene, name: str, carrier: SolidMesh | Body) -> SolidStrains | BeamStrains:
    """Return the middles of all cells of a body, or of all elements of beams."""
    if not isinstance(carrier, SolidMesh):
        return BeamStrains.in_middles(carrier)
    return SolidStrains.in_cells(carrier, [cells for _, cells in cells_of_materials(name, scene.bodies[name], carrier)])


def _held(scene: Scene, name: str, body: Body) -> set[int]:
    """Return the nodes of beams that joints, effects or outputs hold."""
    return {body.mesh.point(point, entry) for point, entry in points_used(scene, name).items()}


def check_stresses(scene: Scene, meshes: Mapping[str, LineMesh | SolidMesh]) -> None:
    """Refuse stress outputs at places that their body's mesh has not, before anything is computed.

    Raises
    ------
    InputError
        Naming the entry, what came, and what is there.
    """
    if stressed_bodies(scene):
        bodies = {body.name: body for body in bodies_of(scene, meshes)}
        for name, entry in scene.outputs.items():
            if entry.reads == "stresses":
                _points(f"outputs.{name}", entry, scene, carrier_of(bodies[entry.body]))


def _points(name: str, entry: Stress, scene: Scene, carrier: SolidMesh | Body) -> SolidStrains | BeamStrains:
    if entry.at is not None:
        return _at_place(name, entry, scene, carrier)
    if not isinstance(carrier, SolidMesh):
        if entry.group is None:
            return all_points(scene, entry.body, carrier)
        node = carrier.mesh.point(entry.group, f"{name}.group")
        return BeamStrains.at_ends(carrier, _held(scene, entry.body, carrier), np.array([node]))
    if entry.group is None and entry.region is None:
        return all_points(scene, entry.body, carrier)
    materials = [cells for _, cells in cells_of_materials(entry.body, scene.bodies[entry.body], carrier)]
    if entry.region is not None:
        cells = carrier.region(entry.region, f"{name}.region")
        return SolidStrains.at_nodes(carrier, materials, np.unique(carrier.cells[cells])).within(materials, cells)
    return SolidStrains.at_nodes(carrier, materials, np.unique(carrier.faces(entry.group, f"{name}.group")))


def _at_place(name: str, entry: Stress, scene: Scene, carrier: SolidMesh | Body) -> SolidStrains | BeamStrains:
    place = np.array(entry.at)
    if isinstance(carrier, SolidMesh):
        materials = [cells for _, cells in cells_of_materials(entry.body, scene.bodies[entry.body], carrier)]
        points, nodes = SolidStrains.at_place(carrier, materials, place), carrier.nodes
    else:
        held = _held(scene, entry.body, carrier)
        points, nodes = BeamStrains.at_place(carrier, place, held), carrier.mesh.nodes
    if points is None:
        nearest = nodes[np.argmin(np.linalg.norm(nodes - place, axis=1))]
        low, high = (", ".join(f"{x:.6g}" for x in corner) for corner in (nodes.min(axis=0), nodes.max(axis=0)))
        raise InputError(
            f"{name}.at = {list(entry.at)}: outside the mesh of {entry.body}, which reaches from ({low}) to ({high}) "
            f"m; its nearest node is at ({', '.join(f'{x:.6g}' for x in nearest)})"
        )
    return points


Points = np.ndarray  # what is known at points, shape (n_points, n_components, n)


def hooke(strains: Points, lame: Lame) -> Points:
    """Return stresses over Young's modulus, components as those of the strains (`solid_strains`)."""
    d = 2 if strains.shape[1] == 3 else 3
    found = 2.0 * lame.shear * strains
    found[:, :d] += lame.first * strains[:, :d].sum(axis=1, keepdims=True)
    return found


def von_mises(stresses: Points) -> np.ndarray:
    """Return von Mises' stress, shape (n_points, n)."""
    if stresses.shape[1] == 3:
        xx, yy, xy = np.moveaxis(stresses, 1, 0)
        return np.sqrt(np.maximum(xx**2 + yy**2 - xx * yy + 3.0 * xy**2, 0.0))
    xx, yy, zz, *shear = np.moveaxis(stresses, 1, 0)
    across = (xx - yy) ** 2 + (yy - zz) ** 2 + (zz - xx) ** 2
    return np.sqrt(0.5 * across + 3.0 * sum(part**2 for part in shear))


def principal(stresses: Points, largest: bool) -> np.ndarray:
    """Return the largest or the smallest principal stress, tension positive, shape (n_points, n).

    In space the three are ``p + 2 q cos(phi + 2 pi k / 3)`` with the mean p, ``6 q^2 = |S|^2`` of the deviator S and
    ``cos(3 phi) = det(S) / (2 q^3)`` (Smith 1961): of all points at once, to round-off of the largest stress but where
    two are equal to its root.
    """
    if stresses.shape[1] == 3:
        xx, yy, xy = np.moveaxis(stresses, 1, 0)
        reach = np.hypot(0.5 * (xx - yy), xy)
        return 0.5 * (xx + yy) + (reach if largest else -reach)
    xx, yy, zz, xy, xz, yz = np.moveaxis(stresses, 1, 0)
    mean = (xx + yy + zz) / 3.0
    xx, yy, zz = xx - mean, yy - mean, zz - mean
    q = np.sqrt((xx**2 + yy**2 + zz**2 + 2.0 * (xy**2 + xz**2 + yz**2)) / 6.0)
    unit = np.where(q > 0.0, q, 1.0)  # of a pressure alone any direction is principal
    xx, yy, zz, xy, xz, yz = (part / unit for part in (xx, yy, zz, xy, xz, yz))
    det = xx * (yy * zz - yz**2) - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz)
    phi = np.arccos(np.clip(0.5 * det, -1.0, 1.0)) / 3.0
    return mean + 2.0 * q * np.cos(phi + (0.0 if largest else 2.0 * np.pi / 3.0))


def outermost(axial: np.ndarray, bending: np.ndarray, largest: bool) -> np.ndarray:
    """Return the normal stress in the fibre that is stretched most or least, for that of the axial force and the
    largest one of bending, of one shape."""
    return axial + bending if largest else axial - bending


@dataclass(frozen=True)
class Extreme:
    """Which of several values an output reports.

    Attributes
    ----------
    of
        From values (n_points, n) to the place of the one that is reported, shape (n,).
    """

    of: Callable[[np.ndarray], np.ndarray]

    def __call__(self, values: np.ndarray) -> np.ndarray:
        """Return the value reported, shape (n,); no number where one of them is none."""
        known = np.isfinite(values)
        place = self.of(np.where(known, values, 0.0))
        found = np.take_along_axis(values, place[None], axis=0)[0]
        return np.where(known.all(axis=0), found, np.nan)


LARGEST = Extreme(lambda values: np.argmax(values, axis=0))
SMALLEST = Extreme(lambda values: np.argmin(values, axis=0))
#: Of forces and moments: the one of largest magnitude, with its sign.
FURTHEST = Extreme(lambda values: np.argmax(np.abs(values), axis=0))
EXTREMES = {"von_mises": LARGEST, "principal_max": LARGEST, "stress_max": LARGEST} | dict.fromkeys(
    ("principal_min", "stress_min"), SMALLEST
)
