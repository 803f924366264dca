"""Stresses of flexible bodies: what is made of strains, and where a body has them.

Stresses are those of Hooke's law for the strains (St. Venant and Kirchhoff's with Green and Lagrange's), of the
material's elasticity alone: what damps is no part of them. In plane stress the principal stresses are the two in the
plane; von Mises' stress is that of the whole tensor, whose components across the plane vanish.

Of beams it is forces and moments in their sections, and the stress of the outermost fibres.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from operator import attrgetter
from typing import Any

import numpy as np

from pgmp_petsc.bodies.affine import Quantity, Values, total_at
from pgmp_petsc.bodies.beam_strains import BeamStrains
from pgmp_petsc.bodies.elasticity import Lame
from pgmp_petsc.bodies.floating import Beams, Recovery
from pgmp_petsc.bodies.framed_solid import cells_of_materials
from pgmp_petsc.bodies.profile import Profile
from pgmp_petsc.bodies.random_fields import profiles_of
from pgmp_petsc.bodies.solid_strains import SolidStrains
from pgmp_petsc.lanes.compiled import njit
from pgmp_petsc.mesh.meshes import LineMesh, SolidMesh
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.outputs import OF_FIBRES, STRESSES
from pgmp_petsc.scene.references import points_used

Strains = SolidStrains | BeamStrains


@dataclass(frozen=True, eq=False)
class SolidLaw:
    """Stresses of a continuum body."""

    materials: tuple[tuple[Quantity, Lame], ...]  # Young's modulus (Pa) and Lame's constants over it of every material
    profile: Profile = Profile()  # what the modulus is multiplied by, cell by cell
    #: in plane stress, and what it is multiplied by, cell by cell
    thickness: tuple[Quantity, Profile] = (Quantity(1.0), Profile())

    def forces(self, points: SolidStrains, strains: np.ndarray, parameters: Values) -> np.ndarray:
        """Return the stresses of points, shape (n_points, n_strains, n), for strains of that shape."""
        stresses = np.empty(strains.shape)
        of_each = [np.broadcast_to(modulus.at(parameters), strains.shape[2]) for modulus, _ in self.materials]
        lame = np.array([(lame.first, lame.shear) for _, lame in self.materials])
        strains, material = np.ascontiguousarray(strains), np.ascontiguousarray(points.material)
        _fill_stresses(strains, material, lame, np.array(of_each, dtype=float), stresses)
        if self.profile:
            stresses *= np.expand_dims(self.profile.at(parameters, points.of_cells), 1)
        return stresses

    def values(
        self, quantities: Iterable[str], points: SolidStrains, forces: np.ndarray, parameters: Values
    ) -> dict[str, np.ndarray]:
        """Return quantities at all points, each of shape (n_points, n), for their stresses."""
        return {
            quantity: von_mises(forces) if quantity == "von_mises" else principal(forces, quantity == "principal_max")
            for quantity in quantities
        }

    def softening(self, points: SolidStrains, nominal: Mapping[str, float], parameters: Values) -> np.ndarray:
        """Return how much larger strains are than at the nominal parameters for the same forces, shape (n_points, 1, 1
        or n), or (1, 1, 1 or n) if they are so at all points."""
        thickness, sizes = self.thickness
        of_materials = [np.atleast_1d(modulus.at(nominal) / modulus.at(parameters)) for modulus, _ in self.materials]
        ratio = np.array(np.broadcast_arrays(*of_materials))
        if len(self.materials) > 1 or self.profile or sizes:
            ratio = ratio[points.material]
        ratio = ratio * np.atleast_1d(thickness.at(nominal) / thickness.at(parameters))
        for profile in (self.profile, sizes):
            if profile:
                ratio = ratio * (profile.at(nominal, points.of_cells) / profile.at(parameters, points.of_cells))
        return ratio[:, None]

    def size(self, quantity: str, points: SolidStrains, nominal: Mapping[str, float]) -> float:
        """Return the quantity for a strain of 1, at nominal parameters."""
        return max(float(modulus.at(nominal)) for modulus, _ in self.materials)


@dataclass(frozen=True, eq=False)
class BeamLaw:
    """Forces and moments in the sections of beams, and stresses in their outermost fibres."""

    modulus: Quantity | None  # Young's modulus, Pa; None of a section given by coefficients
    #: distances of the outermost fibre from the axis, along the section's second and third axis, m
    reach: tuple[Quantity, Quantity] | None
    round: bool  # whether the section is a circle

    def forces(self, points: BeamStrains, strains: np.ndarray, parameters: Values) -> np.ndarray:
        """Return forces and moments in the sections of points, shape (n_points, n_forces, n), for strains (n_points,
        n_strains, n)."""
        return points.forces(strains, points.stiffnesses(parameters))

    def values(
        self, quantities: Iterable[str], points: BeamStrains, forces: np.ndarray, parameters: Values
    ) -> dict[str, np.ndarray]:
        """Return quantities at all points, each of shape (n_points, n), for their forces and moments."""
        found, fibres = {}, None
        for quantity in quantities:
            if quantity not in OF_FIBRES:
                found[quantity] = forces[:, _number_of(quantity, points.body)]
                continue
            if fibres is None:
                # moments at the points: other strains than came
                fibres = self._of_fibres(points, forces / points.stiffnesses(parameters), parameters)
            axial, bending = fibres
            found[quantity] = axial + bending if quantity == "stress_max" else axial - bending
        return found

    def softening(self, points: BeamStrains, nominal: Mapping[str, float], parameters: Values) -> np.ndarray:
        """Return how much larger strains are than at the nominal parameters for the same forces, shape (n_points,
        n_strains, 1 or n)."""
        ratio = points.stiffnesses(nominal) / points.stiffnesses(parameters)
        # behind the strains of the points are the shears in the middles of their elements
        return np.concatenate([ratio, ratio[:, 1 : 2 if points.body.planar else 3]], axis=1)

    def _of_fibres(self, points: BeamStrains, bent: np.ndarray, parameters: Values) -> tuple[np.ndarray, np.ndarray]:
        """Return the stress of the axial force and the largest one of bending, each of shape (n_points, n), for strains
        of the points (n_points, n_strains, n)."""
        young = self.modulus.at(parameters) * points.body.profiles.modulus.at(parameters, points.of_cells)
        along_2, along_3 = (reach.at(parameters) for reach in self.reach)
        if points.body.planar:
            bending = np.abs(bent[:, 2]) * along_2
        elif self.round:
            bending = np.hypot(bent[:, 4], bent[:, 5]) * along_2
        else:
            bending = np.abs(bent[:, 5]) * along_2 + np.abs(bent[:, 4]) * along_3
        return young * bent[:, 0], young * bending

    def size(self, quantity: str, points: BeamStrains, nominal: Mapping[str, float]) -> float:
        """Return the quantity for a strain of 1, or a curvature of 1 over the body's length, at nominal parameters."""
        body = points.body
        if quantity in OF_FIBRES:
            return float(self.modulus.at(nominal))
        resists = total_at(body.sections("stiffness"), nominal)[:, _number_of(quantity, body)]
        return float(resists.max() / (body.extent if "moment" in quantity else 1.0))


def _number_of(quantity: str, body: Beams) -> int:
    """Return which of the forces and moments in a body's sections a quantity is."""
    return list(STRESSES[f"beam{body.dimension}d"]).index(quantity)


class BodyStresses(ABC):
    """Stresses of a flexible body, and the points that have them."""

    mesh: SolidMesh | LineMesh  # its cells, or lines
    points: type[Strains]
    law: SolidLaw | BeamLaw  # what gives stresses from strains
    _of: tuple[Any, Any]  # what points are of: a mesh and the cells of its materials, or beams and the nodes held

    def __init__(self, scene: Scene, name: str) -> None:
        self._scene, self._name, self._entry = scene, name, scene.bodies[name]

    @property
    def units(self) -> dict[str, str]:
        """The quantities that the body has, with their units: no fibre of a section given by coefficients."""
        of_element = STRESSES[self._entry.element]
        return {key: unit for key, unit in of_element.items() if self._entry.material or key not in OF_FIBRES}

    @abstractmethod
    def _nodes_of(self, name: str, entry: str) -> np.ndarray:
        """Return the nodes of a group; see `in_group`."""

    def everywhere(self) -> Strains:
        """Return all points of the body: the nodes of a mesh of cells, the ends of all elements of beams."""
        return self.points.at_nodes(*self._of, np.arange(self.mesh.n_nodes))

    def in_middles(self) -> Strains:
        """Return the middles of all cells or elements."""
        return self.points.in_middles(*self._of)

    def at_place(self, place: np.ndarray) -> Strains | None:
        """Return a place in the body's frame, shape (d,), m; None where it is outside."""
        return self.points.at_place(*self._of, place)

    def in_group(self, name: str, entry: str) -> Strains:
        """Return a group of faces, or a named point of beams; `entry` is the scene's to blame where there is none."""
        return self.points.at_nodes(*self._of, self._nodes_of(name, entry))


class CellStresses(BodyStresses):
    """Those of a mesh of continuum elements."""

    points = SolidStrains

    def __init__(self, scene: Scene, name: str, mesh: SolidMesh) -> None:
        super().__init__(scene, name)
        self.mesh = mesh

    @cached_property
    def _materials(self) -> list[tuple[str, np.ndarray]]:
        """The materials with their cells."""
        return cells_of_materials(self._name, self._entry, self.mesh)

    @property
    def _of(self) -> tuple[SolidMesh, list[np.ndarray]]:
        return self.mesh, [cells for _, cells in self._materials]

    @property
    def law(self) -> SolidLaw:
        used, plane = (self._scene.materials[material] for material, _ in self._materials), self.mesh.dimension == 2
        materials = tuple((Quantity.of(one.E), Lame.of(one.nu, plane)) for one in used)
        profiles, thickness = profiles_of(self._scene, self._name, self.mesh), self._entry.thickness if plane else None
        of_plane = (Quantity.of(1.0 if thickness is None else thickness), profiles.size)
        return SolidLaw(materials, profiles.modulus, of_plane)

    def _nodes_of(self, name: str, entry: str) -> np.ndarray:
        return np.unique(self.mesh.faces(name, entry))

    def in_region(self, name: str, entry: str) -> SolidStrains:
        """Return the nodes of a region of cells, with the material there; `entry` as of `in_group`."""
        cells, (mesh, materials) = self.mesh.region(name, entry), self._of
        return SolidStrains.at_nodes(mesh, materials, np.unique(mesh.cells[cells])).within(materials, cells)


class BeamStresses(BodyStresses):
    """Those of a body of beams."""

    points = BeamStrains

    def __init__(self, scene: Scene, body: Beams) -> None:
        super().__init__(scene, body.name)
        self.mesh, self._body = body.mesh, body

    @property
    def law(self) -> BeamLaw:
        if self._entry.material is None:
            return BeamLaw(None, None, False)
        section = self._entry.section
        return BeamLaw(Quantity.of(self._scene.materials[self._entry.material].E), section.reach, section.round)

    @property
    def _of(self) -> tuple[Beams, set[int]]:
        used = points_used(self._scene, self._name)  # by joints, effects or outputs
        return self._body, {self.mesh.point(point, entry) for point, entry in used.items()}

    def _nodes_of(self, name: str, entry: str) -> np.ndarray:
        return np.array([self.mesh.point(name, entry)])


class Recovered:
    """Interface of a body that has a few coordinates for its mesh; see `bodies.body.Body`."""

    name: str
    #: What brings it back to its mesh, where that is known.
    recovery: Recovery | None

    @property
    def drawn(self) -> SolidMesh | LineMesh | None:
        return None if self.recovery is None else self.recovery.mesh

    def stresses(self, scene: Scene) -> BodyStresses | None:
        if self.recovery is None:
            return None
        carrier = self.recovery.carrier
        return CellStresses(scene, self.name, carrier) if isinstance(carrier, SolidMesh) else carrier.stresses(scene)

    @property
    def answered(self) -> bool:
        return self.recovery is None or self.recovery.answered

    by_node = property(attrgetter("recovery.by_node"))


Points = np.ndarray  # what is known at points, shape (n_points, n_components, n)


@njit(cache=True, error_model="numpy")
def _fill_stresses(strains, material, lame, moduli, stresses):
    """Fill stresses (Pa) by Hooke's law from strains, shape (n_points, n_strains, n) both, components as of
    `solid_strains`; of each point the number of its material, and of materials Lame's constants (first, shear) over
    Young's modulus, and this modulus, shape (n_materials, n), Pa."""
    n_points, m, n = strains.shape
    d = 2 if m == 3 else 3
    for point in range(n_points):
        first, twice = lame[material[point], 0], 2.0 * lame[material[point], 1]
        for k in range(n):
            modulus, volume = moduli[material[point], k], 0.0
            for i in range(d):
                volume += strains[point, i, k]
            for i in range(d):
                stresses[point, i, k] = (twice * strains[point, i, k] + first * volume) * modulus
            for i in range(d, m):
                stresses[point, i, k] = twice * strains[point, i, k] * modulus


@njit(cache=True, error_model="numpy")
def _fill_von_mises(stresses, found):
    """Fill von Mises' stresses (n_points, n)."""
    for point in range(stresses.shape[0]):
        s = stresses[point]
        for k in range(stresses.shape[2]):
            if stresses.shape[1] == 3:
                square = s[0, k] ** 2 + s[1, k] ** 2 - s[0, k] * s[1, k] + 3.0 * s[2, k] ** 2
            else:
                across = (s[0, k] - s[1, k]) ** 2 + (s[1, k] - s[2, k]) ** 2 + (s[2, k] - s[0, k]) ** 2
                square = 0.5 * across + 3.0 * (s[3, k] ** 2 + s[4, k] ** 2 + s[5, k] ** 2)
            found[point, k] = np.sqrt(0.0 if square < 0.0 else square)


def von_mises(stresses: Points) -> np.ndarray:
    """Return von Mises' stress, shape (n_points, n)."""
    found = np.empty((stresses.shape[0], stresses.shape[2]))
    _fill_von_mises(np.ascontiguousarray(stresses, dtype=float), found)
    return found


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


def _extreme(place: Callable[[np.ndarray], np.ndarray]) -> Callable[[np.ndarray], np.ndarray]:
    """Return what takes of values (n_points, n) those at a place of each, shape (n,); no number where one of them is
    none."""

    def found(values: np.ndarray) -> np.ndarray:
        known = np.isfinite(values)
        at = place(np.where(known, values, 0.0))
        return np.where(known.all(axis=0), np.take_along_axis(values, at[None], axis=0)[0], np.nan)

    return found


LARGEST = _extreme(lambda values: np.argmax(values, axis=0))
SMALLEST = _extreme(lambda values: np.argmin(values, axis=0))
#: Of forces and moments: the one of largest magnitude, with its sign.
FURTHEST = _extreme(lambda values: np.argmax(np.abs(values), axis=0))
EXTREMES = {"von_mises": LARGEST, "principal_max": LARGEST, "stress_max": LARGEST} | dict.fromkeys(
    ("principal_min", "stress_min"), SMALLEST
)
