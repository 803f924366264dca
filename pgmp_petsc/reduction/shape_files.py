"""What bodies are made from, in files: line meshes, and condensed continuum bodies."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pgmp_petsc.bodies.affine import Monomial
from pgmp_petsc.bodies.component import Component
from pgmp_petsc.bodies.recovery import Recovery
from pgmp_petsc.mesh.line_mesh import LineMesh
from pgmp_petsc.mesh.solid_mesh import SolidMesh
from pgmp_petsc.runtime.errors import InputError
from pgmp_petsc.runtime.files import BUILD_AGAIN, put, take

if TYPE_CHECKING:
    import h5py

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
    return Component(
        frames=_names(group),
        centres=take(group, "centres", 2),
        mass=_take_terms(group, "mass"),
        stiffness=_take_terms(group, "stiffness"),
        fields=take(group, "fields", 2),
        probes=take(group, "probes", 2),
        n_mesh_dofs=int(group.attrs["n_mesh_dofs"]),
        error=float(group.attrs["error"]),
        centre_of_mass=take(group, "centre_of_mass", 1) if "centre_of_mass" in group else None,
        recovery=_take_recovery(group["recovery"], take(group, "fields", 2)) if "recovery" in group else None,
    )


def _put_component(group: h5py.Group, component: Component) -> None:
    put(group, "centres", component.centres, "m", "of the frames, in the body's frame")
    _put_names(group, component.frames)
    for name in ("mass", "stiffness"):
        terms = getattr(component, name)
        stacked = np.array(list(terms.values())).reshape(len(terms), component.n, component.n)
        data = put(group, name, stacked, "SI, weight taken out", f"(term, ...): {UNKNOWNS}")
        data.attrs["weights"] = [str(weight) for weight in terms]
    put(group, "fields", component.fields, "m, 1", f"unknowns of the linear displacement fields: {UNKNOWNS}")
    put(group, "probes", component.probes, "SI", f"what tells modes apart: {UNKNOWNS}")
    group.attrs["n_mesh_dofs"] = component.n_mesh_dofs
    group.attrs["error"] = component.error
    if component.rigid:
        put(group, "centre_of_mass", component.centre_of_mass, "m", "of a rigid body, in its frame")
    if component.recovery is not None:
        _put_recovery(group.create_group("recovery"), component.recovery)


def _put_recovery(group: h5py.Group, recovery: Recovery) -> None:
    """Write the mesh of a condensed body, and its nodes' displacements per unit of the unknowns."""
    mesh = recovery.carrier
    put(group, "nodes", mesh.nodes, "m", "coordinates in the body's frame")
    put(group, "cells", mesh.cells, "1", f"nodes of the cells, {mesh.kind}")
    group.attrs["kind"] = mesh.kind
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
    return Recovery(mesh, shapes)


def _take_terms(group: h5py.Group, name: str) -> dict[Monomial, np.ndarray]:
    weights = (Monomial.parse(str(text)) for text in group[name].attrs["weights"])
    return dict(zip(weights, take(group, name, 3)))


def _put_names(group: h5py.Group, names: dict[str, int]) -> None:
    group.attrs["point_names"] = list(names)
    group.attrs["point_nodes"] = list(names.values())


def _names(group: h5py.Group) -> dict[str, int]:
    return {str(k): int(v) for k, v in zip(group.attrs["point_names"], group.attrs["point_nodes"])}
