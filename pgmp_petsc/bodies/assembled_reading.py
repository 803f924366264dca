"""A body's matrices and nodes from the files that a scene names, in SI units."""

from __future__ import annotations

import numpy as np

from pgmp_petsc.bodies.assembled import Assembled
from pgmp_petsc.bodies.assembled_checks import (
    check_diagonal,
    check_free,
    check_mass,
    check_places,
    check_stated,
    made_symmetric,
)
from pgmp_petsc.mesh.matrix_files import read_matrix
from pgmp_petsc.mesh.matrix_rows import in_order_of_nodes, read_rows
from pgmp_petsc.mesh.node_file import read_nodes
from pgmp_petsc.runtime.errors import shortened
from pgmp_petsc.scene import Scene


def read_assembled(scene: Scene, name: str) -> Assembled:
    """Read a body's matrices, and check what can be checked without a factorisation: see `assembled_checks`.

    Raises
    ------
    InputError
        If a file is missing, unreadable or of another body, or the matrices are none of a free body of displacements.
    """
    entry, given, d = f"bodies.{name}.matrices", scene.bodies[name].matrices, scene.bodies[name].dimension
    received = {
        key: shortened(f'{entry}.{key} = "{getattr(given, key)}"') for key in ("nodes", "rows", "stiffness", "mass")
    }
    file = read_nodes(scene.path_of(given.nodes), d, received["nodes"])
    check_places(file.nodes, received["nodes"])
    rows = None if given.rows is None else read_rows(scene.path_of(given.rows), received["rows"])
    length, mass, time = (given.units.in_si(key) for key in ("length", "mass", "time"))
    nodes, found = length * file.nodes, {}
    for kind, unit in (("stiffness", mass / time**2), ("mass", mass)):
        read = read_matrix(scene.path_of(getattr(given, kind)), received[kind])
        matrix = in_order_of_nodes(read, rows, file, received[kind], received["nodes"])
        matrix.data = unit * np.asarray(matrix.data, dtype=float)
        check_diagonal(matrix, kind, file.labels, d, received[kind], unit)
        found[kind] = made_symmetric(matrix, file.labels, d, received[kind])
    body = Assembled.of(nodes, file.labels, file.sets, file.mesh, found["stiffness"], found["mass"])
    check_mass(body, received["mass"])
    check_free(body, received["stiffness"])
    if given.stated is not None:
        check_stated(body.properties, given.stated, f"{entry}.stated")
    return body
