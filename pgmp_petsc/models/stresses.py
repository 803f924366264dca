"""Stresses as the models know them.

The full-order model has the strains of its meshes themselves. A body that is condensed has strains ``S y`` linear in
its coordinates y, with a constant matrix S: those of the displacements T y. In the component model y are the
amplitudes of its fields; in the reduced model they follow from the modes, ``y = Psi(theta) delta`` (Naets et al. 2015,
eq. (4)). What modes leave out of the static answers to loads and inertia forces is in S as far as the basis has it:
`reduction.static_modes` and `reduction.inertia_modes`, on bodies that are condensed with the answers to their own
inertia forces.

A reduced model of second order has beams with ``u = Psi delta + 1/2 chi delta delta``; their strains are taken in full
there, as those of the same order cancel in an extension: ``u' + 1/2 w'^2``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

import numpy as np

from pgmp_petsc.bodies.beam_strains import BeamStrains
from pgmp_petsc.bodies.body import Body
from pgmp_petsc.bodies.solid_strains import SolidStrains
from pgmp_petsc.bodies.strain_kernel import products
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import on_mesh
from pgmp_petsc.mechanism.space import Space
from pgmp_petsc.mechanism.unknowns import Unknowns
from pgmp_petsc.mesh.line_mesh import LineMesh
from pgmp_petsc.mesh.solid_mesh import SolidMesh
from pgmp_petsc.models.stress_fields import Fields, field_points
from pgmp_petsc.outputs.outputs import OutputSet
from pgmp_petsc.outputs.stress import StressOutput, Values
from pgmp_petsc.reduction.interpolation import Interpolant, interpolant
from pgmp_petsc.reduction.rom import ReducedOrderModel
from pgmp_petsc.reduction.second_order import pair_products
from pgmp_petsc.scene import Scene

AT_ONCE = 2**22  # strains that are evaluated together: 32 MB


class FullStresses:
    """Stresses from the unknowns of a full-order or a component model.

    Parameters
    ----------
    scene, outputs
        The scene and its outputs.
    unknowns
        The numbering.

    Attributes
    ----------
    points
        Of the fields, by body.
    """

    def __init__(self, scene: Scene, outputs: OutputSet, unknowns: Unknowns) -> None:
        self._stresses, self._unknowns = outputs.stresses, unknowns
        self.points = field_points(scene, unknowns.bodies, outputs)
        self._linear = {
            stress.name: linear_map(stress, unknowns.bodies[stress.body].floating.recovery.by_node)
            for stress in outputs.stresses
            if unknowns.bodies[stress.body].floating is not None
        }

    def of(self, q: np.ndarray, values: Values) -> np.ndarray:
        """Return the stresses, shape (n_stresses, n), for unknowns (n_dofs, n); values are numbers or of shape (n,)."""
        rows = [self._of(stress, q, values) for stress in self._stresses]
        return np.array(rows).reshape(len(rows), q.shape[1])

    def _of(self, stress: StressOutput, q: np.ndarray, values: Values) -> np.ndarray:
        body = self._unknowns.bodies[stress.body]
        if body.floating is not None:
            return in_blocks(stress, lambda part: _times(self._linear[stress.name], q[body.internal, part]), q, values)
        return in_blocks(stress, lambda part: _of_unknowns(stress, body, self._unknowns, q[:, part]), q, values)

    def fields(self, q: np.ndarray, values: Values) -> Fields:
        """Return the stresses over whole bodies for unknowns (n_dofs, 1)."""
        found = {}
        for name, field in self.points.items():
            body, frames = self._unknowns.bodies[field.number], self._unknowns.frames(q)
            if body.floating is None:
                strains = field.points.of_places(on_mesh(body, q) if body.meshed is not None else frames[body.nodes])
                d = field.mesh.nodes.shape[1]
                places = (on_mesh(body, q) if body.meshed is not None else frames[body.nodes][:, :d])[..., 0]
            else:
                moved = body.floating.recovery.by_node @ q[body.internal]
                strains = field.points.of_displacements(moved)
                places = _placed(self._unknowns.mechanism.space, frames[body.nodes.stop - 1, :, 0], field.mesh, moved)
            found[name] = places, field.at_nodes(strains, values)
        return found


class ReducedStresses:
    """Stresses from reduced coordinates.

    Parameters
    ----------
    scene, outputs
        The scene and its outputs.
    kinematics
        Of the mechanism.
    rom
        The reduced model with its projection.

    Attributes
    ----------
    points
        Of the fields, by body.
    """

    def __init__(self, scene: Scene, outputs: OutputSet, kinematics: RigidKinematics, rom: ReducedOrderModel) -> None:
        self._stresses, self._n_theta = outputs.stresses, kinematics.n_coordinates
        self._kinematics, scheme = kinematics, scene.reduction.interpolation
        self.points = field_points(scene, kinematics.mechanism.bodies, outputs)
        self._bodies, self._curved = kinematics.mechanism.bodies, rom.curvature is not None
        self._shapes: dict[int, Interpolant] = {}
        for number in {stress.body for stress in outputs.stresses}:
            self._shapes[number] = _shapes_of(rom, self._bodies[number], scheme)
        self._linear = {s.name: linear_map(s, _by_node(self._bodies[s.body])) for s in outputs.stresses}

    def of(self, eta: np.ndarray, values: Values) -> np.ndarray:
        """Return the stresses, shape (n_stresses, n), for eta (n, n_eta); values are numbers, or of shape (n,)."""
        amplitudes = {number: self._amplitudes(shapes, eta) for number, shapes in self._shapes.items()}
        rows = [self._of(stress, amplitudes[stress.body], values) for stress in self._stresses]
        return np.array(rows).reshape(len(rows), len(eta))

    def fields(self, eta: np.ndarray, values: Values) -> Fields:
        """Return the stresses over whole bodies for reduced coordinates (1, n_eta)."""
        poses, found = self._kinematics.poses(eta[:, : self._n_theta]), {}
        for name, field in self.points.items():
            body = self._bodies[field.number]
            y = self._amplitudes(self._shapes[field.number], eta)
            moved = _by_node(body) @ y
            strains = self._strains_of_beams(body, field.points, y) if self._curves(body) else None
            strains = field.points.of_displacements(moved) if strains is None else strains
            places = _placed(self._kinematics.mechanism.space, poses[field.number, :, 0], field.mesh, moved)
            found[name] = places, field.at_nodes(strains, values)
        return found

    def _amplitudes(self, shapes: Interpolant, eta: np.ndarray) -> np.ndarray:
        """Return the unknowns of a body in its frame, shape (n_dofs, n)."""
        delta = np.ascontiguousarray(eta[:, self._n_theta :])
        factors = np.hstack([delta, pair_products(delta)]) if self._curved else delta
        return shapes.product(eta[:, : self._n_theta], factors).T

    def _of(self, stress: StressOutput, y: np.ndarray, values: Values) -> np.ndarray:
        body = self._bodies[stress.body]
        if self._curves(body):
            return in_blocks(stress, lambda part: self._strains_of_beams(body, stress.points, y[:, part]), y, values)
        return in_blocks(stress, lambda part: _times(self._linear[stress.name], y[:, part]), y, values)

    def _curves(self, body: Body) -> bool:
        return self._curved and body.is_planar_beam

    def _strains_of_beams(self, body: Body, points: BeamStrains, y: np.ndarray) -> np.ndarray:
        """Return the strains of what is of second order in the deformation, for unknowns (n_dofs, n) in its frame."""
        frames = y.reshape(body.n_nodes, body.node_dofs, -1).copy()
        frames[:, :2] += body.mesh.nodes[:, :, None]
        return points.of_places(frames)


def linear_map(stress: StressOutput, by_node: np.ndarray) -> np.ndarray:
    """Return S, shape (n_points, n_strains, n), of displacements of the nodes (n_nodes, n_of_a_node, n)."""
    parts = (stress.points.of_displacements(by_node[..., part]) for part in _blocks(stress, by_node.shape[2]))
    return np.concatenate(list(parts), axis=2)


def in_blocks(
    stress: StressOutput, strains: Callable[[slice], np.ndarray], motion: np.ndarray, values: Values
) -> np.ndarray:
    """Return a stress output, shape (n,), from strains of some instants at a time; `motion` has n as its last axis."""
    found = np.empty(motion.shape[-1])
    for part in _blocks(stress, found.size):
        found[part] = stress.value(strains(part), values_of(values, part))
    return found


def _blocks(stress: StressOutput, n: int) -> Iterator[slice]:
    """Yield parts of n columns that are evaluated together."""
    points = stress.points
    width = points.cells.size * points.gradients.shape[1] * 9 if isinstance(points, SolidStrains) else points.n_points
    step = max(1, AT_ONCE // max(1, width))
    for first in range(0, n, step):
        yield slice(first, min(first + step, n))


def values_of(values: Mapping[str, np.ndarray | float], part: slice) -> dict[str, np.ndarray | float]:
    """Return the parameter values of some samples; numbers are those of all."""
    return {name: value[part] if np.ndim(value) and np.size(value) > 1 else value for name, value in values.items()}


def _times(linear: np.ndarray, y: np.ndarray) -> np.ndarray:
    return products(linear.reshape(1, -1, linear.shape[2]), y[None]).reshape(*linear.shape[:2], y.shape[1])


def _of_unknowns(stress: StressOutput, body: Body, unknowns: Unknowns, q: np.ndarray) -> np.ndarray:
    return stress.points.of_places(on_mesh(body, q) if body.meshed is not None else unknowns.frames(q)[body.nodes])


def _placed(space: Space, pose: np.ndarray, mesh: SolidMesh | LineMesh, moved: np.ndarray) -> np.ndarray:
    """Return positions (n_nodes, d) of nodes displaced in a frame at a pose (n_pose,); moved is (n_nodes, >= d, 1)."""
    d = mesh.nodes.shape[1]
    return space.place(pose[: space.n_pose], mesh.nodes + moved[:, :d, 0])[:, :d]


def _by_node(body: Body) -> np.ndarray:
    """Return the displacements of nodes for a unit of each of a body's unknowns, (n_nodes, n_of_a_node, n)."""
    if body.is_beam:
        return np.eye(body.dofs.size).reshape(body.n_nodes, body.node_dofs, -1)
    return body.component.recovery.by_node


def _shapes_of(rom: ReducedOrderModel, body: Body, scheme: str) -> Interpolant:
    """Return the modes of a body's unknowns, and their curvatures, over the configurations."""
    shapes = [rom.projection[:, body.dofs]]
    if rom.curvature is not None:
        shapes.append(rom.curvature[:, body.dofs])
    table = np.ascontiguousarray(np.swapaxes(np.concatenate(shapes, axis=2), 1, 2))
    return interpolant(rom.tables.samples, table, scheme)
