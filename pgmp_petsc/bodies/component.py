"""A continuum body condensed to the frames of its face groups and internal coordinates (a superelement; docs/solids.md,
condensing).

The displacements of the mesh's nodes in the body's frame are ``u = T y``, with ``y`` the small displacements and
rotations of the frames, one after the other, and after them the internal coordinates.

A rigid body's mass about its centre of mass comes from a continuum mesh, from the lines of beams in space, or as given.
Its unknowns are the displacement and rotation of the centre of mass, y. With the body's mass matrix M, its rigid
motions R and its linear displacement fields F, the mass is ``R^T M R``, and ``(R^T M R)^-1 R^T M F`` is the rigid
motion that has the momenta of the fields: the inertia forces of any motion are exact.

The linear fields are ordered as in `Component.fields`: the d displacements, then ``u_i = x_j`` at number
``d + d i + j``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.bodies.affine import Monomial, Quantity, total_at
from pgmp_petsc.bodies.beam3d import N_FRAME, at_rest
from pgmp_petsc.bodies.floating import Recovery, bar_length
from pgmp_petsc.bodies.framed_solid import FramedSolid
from pgmp_petsc.bodies.solid import Solid
from pgmp_petsc.mesh.meshes import LineMesh, SolidMesh
from pgmp_petsc.scene.bodies import MOMENTS, Rigid

if TYPE_CHECKING:
    from pgmp_petsc.bodies.floating import FloatingBody


# the axes (from, to) that each rotation turns into each other, in the order of the rotations
TURNS = {2: ((0, 1),), 3: ((1, 2), (2, 0), (0, 1))}


def linear_fields(places: np.ndarray) -> np.ndarray:
    """Return the linear displacement fields at places (n, d), m, shape (n d, d (d + 1))."""
    n, d = places.shape
    fields = np.zeros((n, d, d + d * d))
    for i in range(d):
        fields[:, i, i] = 1.0
        fields[:, i, d + d * i : d + d * (i + 1)] = places
    return fields.reshape(n * d, d + d * d)


def rigid_motions(centre: np.ndarray) -> np.ndarray:
    """Return unit displacements and rotations about a centre (d,) as linear fields, shape (d (d + 1), n_rigid)."""
    d = centre.size
    fields = np.zeros((d + d * d, d + len(TURNS[d])))
    fields[:d, :d] = np.eye(d)
    for column, (i, j) in enumerate(TURNS[d], d):
        # from axis i to axis j: u_j = x_i - c_i, u_i = -(x_j - c_j)
        fields[d + d * j + i, column], fields[d + d * i + j, column] = 1.0, -1.0
        fields[j, column], fields[i, column] = -centre[i], centre[j]
    return fields


def directors(inertia: np.ndarray) -> np.ndarray:
    """Return ``int rho X X^T dV`` of a tensor of inertia (3, 3)."""
    return 0.5 * np.trace(inertia) * np.eye(3) - inertia


def of_directors(inertia: np.ndarray) -> np.ndarray:
    """Return the moments of nodes (n, 3, 3, 6, 6) with an inertia of their directors (n, 3, 3)."""
    gradient = at_rest()[3:N_FRAME, :6].reshape(3, 3, 6).swapaxes(0, 1)
    return np.einsum("iak,nab,jbl->nijkl", gradient, inertia, gradient, optimize=True)


def incommensurate(rows: np.ndarray, n: int, waves: np.ndarray) -> np.ndarray:
    """Return waves with given numbers (k,), from 1, over some rows (m,) of n unknowns, shape (m, k): no mode shape is
    orthogonal to all of them but by accident."""
    return np.cos(np.outer(1.0 + rows * (np.sqrt(5.0) / n), 1.0 + np.sqrt(2.0) * waves))


SLENDER = 3.0  # longest over second extent of a body that has a long axis
MASSLESS = 1e-9  # over the largest translational mass of a term: round-off of none


@dataclass(frozen=True, eq=False)
class LargeDeformation:
    """Terms of n displacement fields of a body, by weight; what remains when the weight is taken out."""

    third: dict[Monomial, np.ndarray]  # W3, symmetric, shape (n, n, n)
    stretching: dict[Monomial, np.ndarray]  # stiffness against the mean strains of pieces, shape (n, n)
    #: longest over second extent of the body along its principal axes: below `SLENDER` stretching means nothing
    slenderness: float


@dataclass(frozen=True, eq=False)
class Component:
    """A condensed body."""

    frames: dict[str, int]  # name and number (from 0) of every frame
    centres: np.ndarray  # of the frames in the body's frame, shape (n_frames, d), m
    #: mass, stiffness: ``T^T M_i T`` and ``T^T K_i T`` by weight, shape (n, n)
    mass: dict[Monomial, np.ndarray]
    stiffness: dict[Monomial, np.ndarray]
    #: ``int rho u_i v_j dV`` of unit unknowns by weight, shape (d, d, n, n), i and u first; their trace is the mass.
    #: Empty of rigid bodies, and of those read back from a reduced model, whose tables hold it: it is the same without
    moments: dict[Monomial, np.ndarray] = field(compare=False)
    #: what of y makes the linear displacement fields of the body, shape (n, d (d + 1)): first the translations, then
    #: ``x_j`` in direction i as number ``d (1 + i) + j``. They hold rigid motion and the directions of inertia forces.
    fields: np.ndarray
    #: ``T^T M w`` for fixed fields w of the mesh, shape (n, n_probes): what tells modes apart whatever T is
    probes: np.ndarray
    n_mesh_dofs: int  # number of unknowns of the mesh
    error: float  # estimated relative error of the interface's answers over the frequencies asked for
    #: of a rigid body, whose unknowns are its displacement and rotation there, shape (d,), m; None of a flexible one
    centre_of_mass: np.ndarray | None = None
    #: t and the mesh, where stresses are asked for or where they are small; of a rigid body the rigid motions of its
    #: mesh. None where they are not known.
    recovery: Recovery | None = None
    #: what is of second order in y; None where it is not known: of rigid bodies, of scaled cross-sections, and of
    #: bodies read back from a reduced model, whose tables hold it
    large: LargeDeformation | None = field(default=None, compare=False)
    #: second derivatives of the amplitudes of the elastic free modes, shape (n_modes, n_modes, n_modes), 1/m; None
    #: where the body does not follow it, and of bodies read back, whose floating frames hold it
    foreshortening: np.ndarray | None = field(default=None, compare=False)
    floating: FloatingBody | None = None  # the same body in a floating frame; None of rigid bodies
    #: of a rigid body, see `Body.lost_momenta`
    lost_momenta: dict[Monomial, np.ndarray] = field(default_factory=dict, compare=False)

    def terms(self, kind: str) -> dict[Monomial, np.ndarray]:
        """Return the matrices (n, n) of ``"mass"``, ``"stiffness"`` or ``"stretching"`` by weight; none of the last
        where `large` is None."""
        if kind == "stretching":
            return {} if self.large is None else self.large.stretching
        return {"mass": self.mass, "stiffness": self.stiffness}[kind]

    @property
    def rigid(self) -> bool:
        """Whether the body does not deform."""
        return self.centre_of_mass is not None

    @property
    def extent(self) -> float:
        """Length of the straight bar that has the body's largest radius of gyration along an axis of its frame, m."""
        d = self.centres.shape[1]
        if self.rigid:
            return max(float(np.sqrt(12.0 * np.max(np.diag(m)[d:]) / m[0, 0])) for m in self.mass.values())
        moved = self.fields[:, [0, *range(d, 2 * d)]]  # by one and by every coordinate, all in the first direction
        return bar_length([moved.T @ matrix @ moved for matrix in self.mass.values()])

    @property
    def n(self) -> int:
        """Number of unknowns."""
        return len(self.fields)

    @property
    def n_frame_dofs(self) -> int:
        """Number of unknowns of all frames, or of a rigid body."""
        n_nodes, d = 1 if self.rigid else len(self.frames), self.centres.shape[1]
        return n_nodes * (d + len(TURNS[d]))

    @property
    def n_internal(self) -> int:
        """Number of internal coordinates."""
        return self.n - self.n_frame_dofs


def rigid_component(meshed: FramedSolid) -> Component:
    """Return the component of a rigid body.

    Raises `InputError` if its parts have densities that vary apart: its centre of mass would move with the parameters.
    """
    solid = meshed.solid
    moments = solid.second_moments()
    if len(moments) > 1:
        raise InputError(
            f"bodies.{solid.name}.flexible = false: a rigid body's density has one factor, but its regions have "
            f"{', '.join(map(str, sorted(moments)))}; its centre of mass would move with the parameters"
        )
    frames = {name: number for number, name in enumerate(meshed.frames)}
    centres = np.array([frame.centre for frame in meshed.frames.values()])
    ((weight, second),) = moments.items()
    component = _component(frames, centres, weight, second, solid.n_dofs)
    if not isinstance(solid, Solid):  # matrices have no cells to be drawn
        return component
    return on_cells(component, solid.mesh)


def on_cells(component: Component, mesh: SolidMesh) -> Component:
    """Return a rigid component with the mesh that moves with it."""
    shapes = linear_fields(mesh.nodes) @ rigid_motions(component.centre_of_mass)
    return replace(component, recovery=Recovery(mesh, shapes))


def rigid_line(mesh: LineMesh, terms: Mapping[Monomial, tuple[float, ...]], axes: np.ndarray) -> Component:
    """Return the component of a rigid body with the mass of beams in space, the one term of a section, their axes of
    shape (n_cells, 3, 3). Inertia forces would not be affine in several (`mechanism.capabilities` refuses them).

    A line of length L with its middle at m and the axes e has ``int rho X X^T dV = rho A L (m m^T + L^2 / 12 e_1 e_1^T)
    + L (rho I_3 e_2 e_2^T + rho I_2 e_3 e_3^T)``.
    """
    lengths, middles = mesh.lengths, mesh.nodes[mesh.cells].mean(axis=1)
    ((weight, (line, *rotary)),) = terms.items()
    points = np.column_stack([middles, np.ones(len(middles))])
    second = line * np.einsum("e,ei,ej->ij", lengths, points, points)
    within = np.array([line * lengths**2 / 12.0, np.full(len(lengths), rotary[1]), np.full(len(lengths), rotary[0])])
    second[:3, :3] += np.einsum("e,se,eis,ejs->ij", lengths, within, axes, axes)
    return _component(dict(mesh.points), mesh.nodes, weight, second, 6 * mesh.n_nodes)


def rigid_of_properties(shape: LineMesh, given: Rigid, nominal: Mapping[str, float]) -> Component:
    """Return the component of a rigid body in space with given mass properties, whose points are those of `shape`.

    Where entries of the inertia have several factors, no rigid motion has the momenta of a linear field in every term:
    `fields` have those at the nominal values, and each term the rest.
    """
    parts = [(given.mass, np.diag([1.0, 1.0, 1.0, 0.0, 0.0, 0.0]))]
    for name, moment in given.moments.items():
        i, j = MOMENTS[name]
        unit = np.zeros((6, 6))
        unit[3 + i, 3 + j] = unit[3 + j, 3 + i] = 1.0
        parts.append((moment, unit))
    mass: dict[Monomial, np.ndarray] = {}
    for value, unit in parts:
        quantity = Quantity.of(value)
        if quantity.coefficient:
            mass[quantity.monomial] = mass.get(quantity.monomial, 0.0) + quantity.coefficient * unit
    matrix = total_at(mass, nominal)
    centre = shape.nodes[0]

    def momenta(term: np.ndarray) -> np.ndarray:
        return _momenta(term[0, 0], centre, directors(term[3:, 3:]))

    fields = np.linalg.solve(matrix, momenta(matrix))
    lost = {weight: momenta(term) - term @ fields for weight, term in mass.items()}
    lost = {weight: part for weight, part in lost.items() if np.abs(part).max() > MASSLESS * matrix.max()}
    return rigid_about(dict(shape.points), shape.nodes, mass, fields, centre, lost_momenta=lost)


def rigid_about(
    frames: dict[str, int], centres: np.ndarray, mass: dict[Monomial, np.ndarray], fields: np.ndarray,
    centre: np.ndarray, **more: Any,
) -> Component:  # fmt: skip
    """Return a rigid component, which has a mass alone, about its centre."""
    more = {"n_mesh_dofs": 6, "error": 0.0, "probes": np.zeros((len(fields), 1)), "centre_of_mass": centre} | more
    return Component(frames, centres, mass, stiffness={}, moments={}, fields=fields, **more)


def _component(
    frames: dict[str, int], centres: np.ndarray, weight: Monomial, second: np.ndarray, n_mesh_dofs: int
) -> Component:
    """Return the component of a body with moments ``int rho (x, 1) (x, 1)^T dV``."""
    d = centres.shape[1]
    mass, centre = second[d, d], second[:d, d] / second[d, d]
    about = second[:d, :d] - mass * np.outer(centre, centre)  # int rho x x^T about the centre of mass
    momenta = _momenta(mass, centre, about)
    matrix = momenta @ rigid_motions(centre)
    mass, fields = {weight: 0.5 * (matrix + matrix.T)}, np.linalg.solve(matrix, momenta)
    return rigid_about(frames, centres, mass, fields, centre, n_mesh_dofs=n_mesh_dofs)


def _momenta(mass: float, centre: np.ndarray, about: np.ndarray) -> np.ndarray:
    """Return the momentum and the angular momentum about the centre of every linear field, (n_rigid, d (d + 1))."""
    d = centre.size
    found = np.zeros((d + len(TURNS[d]), d + d * d))
    found[:d, :d] = mass * np.eye(d)
    for i in range(d):
        found[i, d + d * i : d + d * (i + 1)] = mass * centre
    for row, (i, j) in enumerate(TURNS[d], d):
        found[row, d + d * j : d + d * (j + 1)] += about[i]
        found[row, d + d * i : d + d * (i + 1)] -= about[j]
    return found
