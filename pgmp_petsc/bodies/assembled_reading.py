"""A body's matrices and nodes from the files that a scene names, in SI units, and what is checked of them
(docs/matrices.md, what is checked).

The mass m along an axis is positive definite by the smallest eigenvalue of m scaled to a diagonal of 1, by Lanczos'
method. Of undistorted cells it is 0.08 (hexahedron20) to 0.5, and no smaller of a mesh of them (Wathen, IMA J. Numer.
Anal. 7, 1987): few steps find it. Rigid motions R are free where eigenvalues of ``R^T K R`` in ``R^T M R`` are below
1e-6 of that of the slowest polynomial field. Nodes hang together by entries of K.

Of a body that is reduced already (Craig and Bampton) the stiffness is K_r of amplitudes, with the fields T
(d n_nodes, m) behind them and the mass M of all nodes. Displacements are split by amplitudes L, ``L T = 1``,

    K = L^T K_r L + kappa Q^T M Q,    Q = 1 - T L,    L = (T^T S T)^-1 T^T S,

so that fields of T have their own energies, and what is left is held by a stiffness kappa. S is M, with nodes that
joints and effects hold weighted by 1e4: what is left then does not move these where T can, so that it lends them no
flexibility of its own. (With S = M it did, by a share of 1 / kappa: hinged frequencies were 2e-6 too low, and a
larger kappa costs digits of the lowest ones, of which 1e7 times their eigenvalue leaves eight.)

Whether K is positive, and whether anything but rigid motion is free, takes a factorisation: it is found out where
bodies are condensed (`components.body_problem`).
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from scipy.linalg import eigh
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import ArpackNoConvergence, eigsh

from pgmp_petsc.base.errors import InputError, shortened
from pgmp_petsc.base.units import UnitSystem
from pgmp_petsc.bodies.assembled import Assembled, MassProperties
from pgmp_petsc.bodies.component import linear_fields, rigid_motions
from pgmp_petsc.bodies.framed_solid import framed_solid
from pgmp_petsc.mesh.matrix_files import in_order_of_nodes, read_matrix, read_nodes, read_rows
from pgmp_petsc.mesh.reading import RELATIVE_TOLERANCE
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.bodies import Stated


def read_assembled(scene: Scene, name: str) -> Assembled:
    """Read a body's matrices, and check what can be checked without a factorisation: see the module.

    Raises `InputError` if a file is missing, unreadable or of another body, or the matrices are none of a free body of
    displacements.
    """
    entry, given, d = f"bodies.{name}.matrices", scene.bodies[name].matrices, scene.bodies[name].dimension
    received = {
        key: shortened(f'{entry}.{key} = "{getattr(given, key)}"')
        for key in ("nodes", "rows", "stiffness", "mass", "modes")
    }
    file = read_nodes(scene.path_of(given.nodes), d, received["nodes"])
    check_places(file.nodes, received["nodes"])
    rows = None if given.rows is None else read_rows(scene.path_of(given.rows), received["rows"])
    system = scene.system
    length, mass, time = given.units.factors(system)
    nodes, found = length * file.nodes, {}
    units = {"stiffness": mass / time**2, "mass": mass}
    for kind in sorted(units, reverse=given.modes is None):  # a reduced stiffness is spread by the mass
        unit = units[kind]
        read = read_matrix(scene.path_of(getattr(given, kind)), received[kind], kind)
        if kind == "stiffness" and given.modes is not None:
            modes = read_matrix(scene.path_of(given.modes), received["modes"], "modes").matrix
            at_rest = Assembled.of(nodes, file.labels, file.sets, file.mesh, found["mass"], found["mass"])
            frames = framed_solid(scene, name, at_rest).frames.values()
            held = np.unique([node for frame in frames for node in frame.nodes]).astype(int)
            matrix = of_all_nodes(read.matrix, modes, found["mass"] / mass, held, d, received)
        else:
            matrix = in_order_of_nodes(read, rows, file, received[kind], received["nodes"])
        matrix.data = unit * np.asarray(matrix.data, dtype=float)
        check_diagonal(matrix, kind, file.labels, d, received[kind], unit)
        found[kind] = made_symmetric(matrix, file.labels, d, received[kind])
    body = Assembled.of(nodes, file.labels, file.sets, file.mesh, found["stiffness"], found["mass"])
    check_mass(body, received["mass"])
    check_free(body, received["stiffness"])
    if given.stated is not None:
        check_stated(body.properties, given.stated, f"{entry}.stated", system)
    return body


SYMMETRIC = 1e-9  # of the largest entry
ALIKE = 1e-8  # of the largest entry: masses along two axes
FLATTEST = 1e-6  # extent across to that along, of a body
FREE = 1e-6  # of the eigenvalue of the slowest polynomial field
SAFETY = 10.0  # times the round-off of sums that cancel
PENALTY = 1e30  # of Abaqus' 1e36 on the diagonal where displacements are prescribed
DENSE = 100  # nodes up to which all eigenvalues are as quick
AXES = "xyz"
MOST_REDUCED = 6000  # displacements of a reduced body, whose stiffness is full: 0.3 GB
BEYOND = 1e7  # times the first elastic eigenvalue of a reduced body, at which the rest vibrates at least
WEIGHT = 1e4  # of the mass of nodes that are held, where fields are told apart from the rest
DEPENDENT = 1e-13  # smallest eigenvalue of the products of columns of size 1


def of_all_nodes(
    stiffness: sp.csr_matrix,
    modes: sp.csr_matrix,
    mass: sp.csr_matrix,
    held: np.ndarray,
    d: int,
    received: dict[str, str],
) -> sp.coo_matrix:
    """Return the stiffness of all nodes (d n_nodes, d n_nodes) that a reduced one (m, m) has: see the module.

    The modes, (d n_nodes, m), are the fields behind its amplitudes; the mass is that of all nodes, of which joints and
    effects hold some (n,). What was `received` are the scene's entries and their values.

    Raises `InputError` if the sizes do not fit, there are more nodes than a full matrix may have, or columns of the
    modes depend on each other.
    """
    n, m = mass.shape[0], stiffness.shape[0]
    if modes.shape != (n, m):
        raise InputError(
            f"{received['modes']}: {' by '.join(map(str, modes.shape))} entries; {n} displacements of the nodes, node "
            f"after node, by {m} rows of the stiffness are needed"
        )
    if n > MOST_REDUCED:
        raise InputError(
            f"{received['modes']}: {n} displacements, and a reduced body has at most {MOST_REDUCED}; take fewer nodes, "
            "with the mass lumped to them, or the matrices of all nodes without `modes`"
        )
    fields = modes.toarray()
    sizes = np.sqrt(np.einsum("im,im->m", fields, mass @ fields))
    sizes[sizes == 0.0] = 1.0
    fields /= sizes
    gram = fields.T @ (mass @ fields)
    if np.linalg.eigvalsh(gram)[0] < DEPENDENT:
        raise InputError(f"{received['modes']}: its columns depend on each other; each is to be a motion of its own")
    values, shapes = eigh(stiffness.toarray() / np.outer(sizes, sizes), gram)
    shapes = fields @ shapes
    shapes = shapes @ (1.5 * np.eye(m) - 0.5 * shapes.T @ (mass @ shapes))  # once more, against round-off
    momenta = mass @ shapes
    weights = np.ones(n)
    weights[(d * held[:, None] + np.arange(d)).ravel()] = np.sqrt(WEIGHT)
    weighted = weights[:, None] * (mass @ (weights[:, None] * shapes))
    oblique = np.linalg.solve(shapes.T @ weighted, weighted.T) - momenta.T
    oblique -= (oblique @ shapes) @ (oblique + momenta.T)  # that of a shape is 0, but for round-off
    amplitudes = oblique + momenta.T
    beyond = max(values[-1], BEYOND * values[min(d * (d + 1) // 2, m - 1)])
    rest = mass.toarray() - momenta @ momenta.T + oblique.T @ oblique
    whole = beyond * rest + (amplitudes.T * values) @ amplitudes
    return sp.coo_matrix(0.5 * (whole + whole.T))


def check_places(nodes: np.ndarray, received: str) -> None:
    """Refuse nodes (n, d) that all lie in one place, on a line, or (in space) in a plane: no solid has such ones, and
    what is turned about them has no inertia."""
    d, extents = nodes.shape[1], np.linalg.svd(nodes - nodes.mean(axis=0), compute_uv=False)
    n_wide = int((extents > max(FLATTEST * extents[0], RELATIVE_TOLERANCE * np.abs(nodes).max())).sum())
    if n_wide < d:
        where = ("in one place", "on a line", "in a plane")[n_wide]
        raise InputError(
            f"{received}: all {len(nodes)} nodes lie {where}; those of a solid{d}d body span "
            f"{'a plane' if d == 2 else 'space'}: check the file's columns and its unit"
        )


def check_diagonal(matrix: sp.coo_matrix, kind: str, labels: np.ndarray, d: int, received: str, unit: float) -> None:
    """Refuse boundary conditions, and nodes without stiffness or mass, in a ``"stiffness"`` or ``"mass"`` matrix (d
    n_nodes, d n_nodes) in SI units, of which the file's unit is given; messages name nodes by `labels` and begin with
    the scene's entry and its value."""
    diagonal = matrix.diagonal() / unit
    held = np.flatnonzero(np.abs(diagonal) >= PENALTY)
    if held.size:
        raise InputError(
            f"{received}: {held.size} entries of the diagonal, the first of {_unknown(held[0], labels, d)}, are "
            f"boundary conditions ({diagonal[held[0]]:.2g}); a body is free: write its matrices without them"
        )
    none = np.flatnonzero(diagonal <= 0.0)
    if none.size:
        cure = "leave out nodes that are in no element"
        if kind == "mass":
            cure += ", and take a consistent mass or one lumped to all nodes"
        raise InputError(
            f"{received}: not positive: {none.size} of {diagonal.size} entries of the diagonal are not, the first is "
            f"{diagonal[none[0]]:.3g} of {_unknown(none[0], labels, d)}; {cure}"
        )


def made_symmetric(matrix: sp.coo_matrix, labels: np.ndarray, d: int, received: str) -> sp.csr_matrix:
    """Return the symmetric part of a matrix that is symmetric but for round-off; the other parameters are those of
    `check_diagonal`."""
    whole = matrix.tocsr()
    apart, largest = abs(whole - whole.T).tocoo(), np.abs(whole.data).max()
    if apart.nnz and apart.data.max() > SYMMETRIC * largest:
        worst = int(np.argmax(apart.data))
        i, j = apart.row[worst], apart.col[worst]
        one, other = whole[i, j], whole[j, i]
        cure = "matrices of elastic bodies are symmetric; write it without friction, followers or gyroscopic terms"
        if sp.triu(whole, 1).nnz == 0 or sp.tril(whole, -1).nnz == 0:
            cure = "the file holds one triangle and does not say so: write the whole matrix, or declare it symmetric"
        raise InputError(
            f"{received}: not symmetric: {one:.6g} in the row of {_unknown(i, labels, d)} and the column of "
            f"{_unknown(j, labels, d)}, {other:.6g} the other way round; {cure}"
        )
    return 0.5 * (whole + whole.T)


def check_mass(body: Assembled, received: str) -> None:
    """Refuse a mass that is not the same along every axis, or not positive definite."""
    d, whole, scalar = body.dimension, body.matrix("mass"), body.scalar_mass
    largest = scalar.diagonal().max()
    for i in range(d):
        for j in range(d):
            part = whole[i::d, j::d] - (scalar if i == j else 0.0 * scalar)
            if np.abs(part.data).max(initial=0.0) > ALIKE * largest:
                what = (
                    f"along {AXES[i]} it is another one than along x" if i == j else f"it ties {AXES[i]} to {AXES[j]}"
                )
                raise InputError(
                    f"{received}: not the mass of displacements: {what}, by {np.abs(part.data).max() / largest:.2g} of "
                    "its largest entry; inertia forces of large rotations need the same mass along every axis: write "
                    "it without rotary inertia, added mass and couplings"
                )
    scale = sp.diags(1.0 / np.sqrt(scalar.diagonal()))
    scaled = (scale @ scalar @ scale).tocsr()
    if body.n_nodes <= DENSE:
        smallest = float(np.linalg.eigvalsh(scaled.toarray())[0])
    else:
        start = np.random.default_rng(0).standard_normal(body.n_nodes)
        try:
            smallest = float(eigsh(scaled, 1, which="SA", v0=start, tol=1e-3, return_eigenvectors=False)[0])
        except ArpackNoConvergence as error:
            raise InputError(
                f"{received}: whether it is positive definite cannot be told, Lanczos' method did not converge; take a "
                "consistent mass, or one lumped with positive shares"
            ) from error
    if smallest <= 0.0:
        raise InputError(
            f"{received}: not positive definite: scaled to a diagonal of 1 it has the eigenvalue {smallest:.3g}; take "
            "a consistent mass, or one lumped with positive shares"
        )


def check_free(body: Assembled, received: str) -> None:
    """Refuse a body in several pieces, and one whose rigid motions have stiffness, counted."""
    stiffness, mass, d = body.matrix("stiffness"), body.matrix("mass"), body.dimension
    entries = stiffness.tocoo()
    tied = entries.data != 0.0
    pairs = entries.row[tied] // d, entries.col[tied] // d
    n_pieces, piece = connected_components(
        sp.coo_matrix((np.ones(tied.sum()), pairs), shape=(body.n_nodes,) * 2).tocsr(), directed=False
    )
    if n_pieces > 1:
        aside = body.labels[np.flatnonzero(piece != piece[0])[0]]
        raise InputError(
            f"{received}: {n_pieces} pieces that no stiffness joins: node {aside} does not hang together with node "
            f"{body.labels[0]}; each body is one piece"
        )
    arms = body.nodes - body.nodes.mean(axis=0)
    places = arms / np.abs(arms).max()
    rigid = linear_fields(places) @ rigid_motions(np.zeros(d))
    fields = np.hstack([rigid, _bending(places)])
    n = rigid.shape[1]
    energies, momenta = (fields.T @ (matrix @ fields) for matrix in (stiffness, mass))
    # the least of all that is no rigid motion: fields M-orthogonal to these
    beside = np.vstack([-np.linalg.solve(momenta[:n, :n], momenta[:n, n:]), np.eye(fields.shape[1] - n)])
    slowest = eigh(beside.T @ energies @ beside, beside.T @ momenta @ beside, eigvals_only=True)[0]
    found, least = eigh(energies[:n, :n], momenta[:n, :n], eigvals_only=True), np.linalg.eigvalsh(momenta[:n, :n])[0]
    # what is left of sums of entries that cancel
    round_off = np.finfo(float).eps * np.linalg.norm(abs(stiffness) @ np.abs(rigid)) / least
    tolerance = max(FREE * abs(slowest), SAFETY * round_off)
    if found[0] < -tolerance or slowest <= 0.0:
        raise InputError(
            f"{received}: not positive: a smooth displacement of the body has negative energy; it must be that of an "
            "elastic body at rest, without preload, and with all its digits"
        )
    n_free = int((found < tolerance).sum())
    if n_free < n:
        raise InputError(
            f"{received}: {n_free} of {n} rigid-body motions are free of stiffness; the stiffest has {_hz(found[-1])} "
            f"Hz, where the body itself has about {_hz(slowest)}. Write the matrices without supports and springs to "
            "the ground, with all their digits, and let rows and nodes be of the same body in the same order"
        )


def check_stated(found: MassProperties, stated: Stated, entry: str, system: UnitSystem) -> None:
    """Refuse mass properties that differ from what a scene states."""
    extent = float(np.sqrt(np.trace(found.second) / found.mass))
    has = {"mass": np.array([found.mass]), "centre": found.centre, "inertia": np.diag(found.inertia)}
    sizes = {"mass": found.mass, "centre": extent, "inertia": float(np.max(np.diag(found.inertia)))}
    for key, values in has.items():
        wanted = getattr(stated, key)
        if wanted is None:
            continue
        wanted = np.atleast_1d(np.array(wanted))
        if wanted.shape != values.shape:
            raise InputError(f"{entry}.{key} = {wanted.tolist()}: {values.size} numbers are needed for this body")
        if np.abs(values - wanted).max() > stated.within * sizes[key]:
            unit = {"mass": "kg", "centre": "m", "inertia": "kg m2"}[key]
            wanted, values = system.shown(wanted, unit), system.shown(values, unit)
            shown = values.tolist() if values.size > 1 else float(values[0])
            raise InputError(
                f"{entry}.{key} = {wanted.tolist() if wanted.size > 1 else float(wanted[0])}: the matrices have "
                f"{shown} {system.unit(unit)}, which differs by more than {entry}.within = {stated.within:g} of "
                f"{'the radius of gyration' if key == 'centre' else 'it'}; check units, and the frame of the nodes"
            )


def _bending(places: np.ndarray) -> np.ndarray:
    """Return strains that are constant, and bending, as displacement fields at places (n, d), shape (n d, n_fields).

    A slender body bends at the frequency of the latter: across an axis by the square of the place along it, with the
    sections turning.
    """
    n, d = places.shape
    found = []
    for i in range(d):
        for j in range(i + 1):  # x_j along i, and symmetric
            field = np.zeros((n, d))
            field[:, i] += places[:, j]
            field[:, j] += places[:, i]
            found.append(field)
        for j in range(d):
            if j != i:
                field = np.zeros((n, d))
                field[:, j], field[:, i] = 0.5 * places[:, i] ** 2, -places[:, i] * places[:, j]
                found.append(field)
    return np.array(found).reshape(len(found), n * d).T


def _unknown(row: int, labels: np.ndarray, d: int) -> str:
    return f"node {labels[row // d]}, {AXES[row % d]}"


def _hz(eigenvalue: float) -> str:
    return f"{np.sqrt(abs(eigenvalue)) / (2.0 * np.pi):.3g}"
