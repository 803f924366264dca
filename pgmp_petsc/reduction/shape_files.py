"""What bodies are made from, in files: line meshes, and condensed continuum bodies."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from pgmp_petsc.bodies.affine import Monomial
from pgmp_petsc.bodies.component import Component
from pgmp_petsc.bodies.floating import FloatingBody
from pgmp_petsc.bodies.recovery import Recovery
from pgmp_petsc.mesh.line_mesh import LineMesh
from pgmp_petsc.mesh.solid_mesh import SolidMesh
from pgmp_petsc.runtime.errors import InputError
from pgmp_petsc.runtime.files import BUILD_AGAIN, put, take

if TYPE_CHECKING:
    import h5py

AMPLITUDES = "amplitudes in the floating frame"
UNKNOWNS = "frames' displacements and rotations, then internal coordinates"


def put_shape(group: h5py.Group, shape: LineMesh | Component) -> None:
    """Write a body's mesh, or what it is condensed to, into its group."""
    if isinstance(shape, Component):
        _put_component(group, shape)
        return
    put(group, "nodes", shape.nodes, "m", "coordinates in the body's frame")
    put(group, "cells", shape.cells, "1", "nodes of the elements")
    _put_names(group, shape.points)


def take_shape(group: h5py.Group) -> LineMesh | Component:
    """Read back what `put_shape` wrote."""
    if "centres" not in group:
        return LineMesh(take(group, "nodes", 2), take(group, "cells", 2), _names(group))
    component = Component(
        frames=_names(group),
        centres=take(group, "centres", 2),
        mass=_take_terms(group, "mass"),
        stiffness=_take_terms(group, "stiffness"),
        moments={},
        fields=take(group, "fields", 2),
        probes=take(group, "probes", 2),
        n_mesh_dofs=int(group.attrs["n_mesh_dofs"]),
        error=float(group.attrs["error"]),
        centre_of_mass=take(group, "centre_of_mass", 1) if "centre_of_mass" in group else None,
        recovery=_take_recovery(group["recovery"], take(group, "fields", 2)) if "recovery" in group else None,
    )
    return component if component.rigid else replace(component, floating=_take_floating(group["floating"], component))


def _put_component(group: h5py.Group, component: Component) -> None:
    put(group, "centres", component.centres, "m", "of the frames, in the body's frame")
    _put_names(group, component.frames)
    for name in ("mass", "stiffness"):
        _put_terms(group, name, getattr(component, name), (component.n, component.n), UNKNOWNS)
    put(group, "fields", component.fields, "m, 1", f"unknowns of the linear displacement fields: {UNKNOWNS}")
    put(group, "probes", component.probes, "SI", f"what tells modes apart: {UNKNOWNS}")
    group.attrs["n_mesh_dofs"] = component.n_mesh_dofs
    group.attrs["error"] = component.error
    if component.rigid:
        put(group, "centre_of_mass", component.centre_of_mass, "m", "of a rigid body, in its frame")
    if component.recovery is not None:
        _put_recovery(group.create_group("recovery"), component.recovery)
    if component.floating is not None:
        _put_floating(group.create_group("floating"), component.floating)


def _put_floating(group: h5py.Group, floating: FloatingBody) -> None:
    """Write what a condensed body is in a floating frame, besides its frames."""
    d, n = floating.centres.shape[1], floating.n
    put(group, "parts", floating.parts, "m, 1", f"motion of the frame, then {AMPLITUDES}, (part, unknown): {UNKNOWNS}")
    about = f"displacements and rotations of the frames, (frame, component, amplitude): {AMPLITUDES}"
    put(group, "shapes", floating.shapes, "m, 1", about)
    put(group, "bent", floating.bent, "m", f"second derivatives of the frames' displacements: {AMPLITUDES}")
    _put_terms(group, "stiffness", floating.stiffness, (n, n), AMPLITUDES)
    fields = "1, coordinates, then the shapes' first components, second ones ..."
    _put_terms(group, "moments", floating.moments, (1 + d + d * n, 1 + d + d * n), fields)
    _put_terms(group, "curved", floating.curved, (d, d, n, n), f"coordinates, components of second order: {AMPLITUDES}")


def _take_floating(group: h5py.Group, component: Component) -> FloatingBody:
    """Read back what `_put_floating` wrote."""
    parts, kept = take(group, "parts", 2), component.recovery
    shapes = take(group, "shapes", 3)
    if kept is not None:
        kept = replace(kept, shapes=kept.shapes @ np.linalg.inv(parts)[:, -shapes.shape[2] :])
    return FloatingBody(
        frames=component.frames,
        centres=component.centres,
        shapes=shapes,
        moments=_take_terms(group, "moments"),
        stiffness=_take_terms(group, "stiffness"),
        bent=take(group, "bent", 4),
        curved=_take_terms(group, "curved", 5),
        recovery=kept,
        parts=parts,
    )


def _put_terms(
    group: h5py.Group, name: str, terms: Mapping[Monomial, np.ndarray], shape: tuple[int, ...], about: str
) -> None:
    stacked = np.array(list(terms.values())).reshape(len(terms), *shape)
    data = put(group, name, stacked, "SI, weight taken out", f"(term, ...): {about}")
    data.attrs["weights"] = [str(weight) for weight in terms]


def _put_recovery(group: h5py.Group, recovery: Recovery) -> None:
    """Write the mesh of a condensed body, and its nodes' displacements per unit of the unknowns."""
    mesh = recovery.carrier
    put(group, "nodes", mesh.nodes, "m", "coordinates in the body's frame")
    put(group, "cells", mesh.cells, "1", f"nodes of the cells, {mesh.kind}")
    group.attrs["kind"] = mesh.kind
    group.attrs["answered"] = recovery.answered
    put(group, "shapes", recovery.shapes, "m, 1", f"(displacement of a node, unknown): {UNKNOWNS}")
    for name, about in (("groups", "nodes of the faces"), ("regions", "numbers of the cells")):
        table = group.create_group(name, track_order=True)
        table.attrs["names"] = list(getattr(mesh, name))
        for number, numbers in enumerate(getattr(mesh, name).values()):
            put(table, f"of_{number}", numbers, "1", about)


def _take_recovery(group: h5py.Group, fields: np.ndarray) -> Recovery:
    """Read back what `_put_recovery` wrote; `fields` has as many rows as there are unknowns.

    Raises
    ------
    InputError
        If the parts do not fit together.
    """
    named = {
        name: {str(key): take(group[name], f"of_{k}", n) for k, key in enumerate(group[name].attrs["names"])}
        for name, n in (("groups", 2), ("regions", 1))
    }
    mesh = SolidMesh(str(group.attrs["kind"]), take(group, "nodes", 2), take(group, "cells", 2), **named)
    shapes, wanted = take(group, "shapes", 2), (mesh.n_nodes * mesh.dimension, len(fields))
    if shapes.shape != wanted or mesh.cells.size and not 0 <= mesh.cells.min() <= mesh.cells.max() < mesh.n_nodes:
        raise InputError(
            f"file '{group.file.filename}': {group.name} has shapes {shapes.shape}, not {wanted}, or cells beyond its "
            f"nodes; {BUILD_AGAIN}"
        )
    return Recovery(mesh, shapes, bool(group.attrs["answered"]))


def _take_terms(group: h5py.Group, name: str, n_axes: int = 3) -> dict[Monomial, np.ndarray]:
    weights = (Monomial.parse(str(text)) for text in group[name].attrs["weights"])
    return dict(zip(weights, take(group, name, n_axes)))


def _put_names(group: h5py.Group, names: dict[str, int]) -> None:
    group.attrs["point_names"] = list(names)
    group.attrs["point_nodes"] = list(names.values())


def _names(group: h5py.Group) -> dict[str, int]:
    return {str(k): int(v) for k, v in zip(group.attrs["point_names"], group.attrs["point_nodes"])}
