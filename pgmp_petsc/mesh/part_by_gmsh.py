"""A program of its own: gmsh meshes the solid of a STEP file with tetra10. It imports nothing of the package.

    python -P part_by_gmsh.py PART.step SIZE COARSER MESH.npz

SIZE is the largest size of a cell in mm, or 0 for one that follows from the thickness of the walls: rays from a coarse
mesh of each face go into the solid, the 20 % quantile of their lengths is the thickness at the face, and cells are
between a half and the whole of it, the smaller the fewer they are altogether. All of them are COARSER times as large in
the end. MESH.npz has lengths in mm; a part that is refused has the array ``refused`` alone. gmsh and OpenCASCADE end a
process now and then, which is why it is one.
"""

from __future__ import annotations

import sys

import numpy as np

try:
    import gmsh
except (ImportError, OSError) as error:
    MISSING = f"gmsh, which meshes parts of CAD, cannot be imported ({error}); pip install gmsh (Debian: python3-gmsh)"
else:
    MISSING = ""

PER_TURN = 12  # cells along a circle
MOST_WANTED = 8_000  # cells up to which walls have two of them across
MOST = 400_000  # cells that memory holds
WIDEST = 6.0  # extent over the largest cell, at least
RAYS = 40  # of a face
QUANTILE = 0.2  # of the lengths of rays
CELLS_PER_CUBE = 6.0 * np.sqrt(2.0)  # of regular tetrahedra
STRAIGHT = 1e-6  # of the extent: what surfaces of cylinders may be off
WHOLE_TURN = np.radians(60.0)  # widest gap in the angles of nodes around a whole cylinder


class Refused(Exception):
    """Why a part is not taken."""


def opened(path: str) -> int:
    """Read a file in mm and return its solid."""
    gmsh.option.setString("Geometry.OCCTargetUnit", "MM")
    try:
        gmsh.model.occ.importShapes(path, highestDimOnly=False)
    except Exception as error:
        raise Refused(
            f"OpenCASCADE cannot read this STEP file ({error}); export the part anew as STEP AP214"
        ) from error
    gmsh.model.occ.synchronize()
    solids = [tag for _, tag in gmsh.model.getEntities(3)]
    faces = gmsh.model.getEntities(2)
    if len(solids) > 1:
        names = ", ".join(
            f"{name_of(3, tag) or f'solid {tag}'} ({gmsh.model.occ.getMass(3, tag):.4g} mm3)" for tag in solids
        )
        raise Refused(
            f"it has {len(solids)} solids: {names}; a body is one: export each to a file of its own, or fuse them"
        )
    if not solids and faces:
        if len(faces) > 1:  # faces that nobody has sewn share no edges
            gmsh.model.occ.removeAllDuplicates()
        gmsh.model.occ.synchronize()
        faces = gmsh.model.getEntities(2)
        edges = len(gmsh.model.getBoundary(faces, combined=True, oriented=False))
        shell = f"an open shell of {len(faces)} faces with {edges} free edges" if edges else f"{len(faces)} loose faces"
        shell = shell if len(faces) > 1 else "one face"
        raise Refused(f"it has no solid, but {shell}; close it to a solid in CAD and export that")
    if not solids:
        raise Refused("it has no solid; export the part, not its sketch or its wires, as STEP")
    return solids[0]


def name_of(dimension: int, tag: int) -> str:
    """Return the last part of the name that CAD gives to something; empty where it has none of its own."""
    return gmsh.model.getEntityName(dimension, tag).rpartition("/")[2].strip()


def places() -> np.ndarray:
    """Return the places of all nodes by their tags, mm, shape (n, 3)."""
    tags, found, _ = gmsh.model.mesh.getNodes()
    at = np.zeros((int(tags.max()) + 1, 3))
    at[tags.astype(int)] = found.reshape(-1, 3)
    return at


def nodes_of(kind: int, n_nodes: int, tag: int = -1) -> np.ndarray:
    """Return the tags of the nodes of cells of one of gmsh's kinds, of a face or of all, shape (n, n_nodes)."""
    return gmsh.model.mesh.getElementsByType(kind, tag)[1].astype(int).reshape(-1, n_nodes)


def hits(starts: np.ndarray, ways: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Return where rays meet triangles, along the rays, shape (n_rays, n_triangles); inf where they do not
    (Möller and Trumbore, J. Graphics Tools 2, 1997)."""
    one, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    across = np.cross(ways[:, None], other[None])
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = 1.0 / (across * one).sum(-1)
        apart = starts[:, None] - corners[None, :, 0]
        u = (apart * across).sum(-1) * inverse
        beside = np.cross(apart, one[None])
        v = (ways[:, None] * beside).sum(-1) * inverse
        along = (other[None] * beside).sum(-1) * inverse
        met = (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & np.isfinite(along)
    return np.where(met, along, np.inf)


def thickness(extent: float) -> dict[int, float]:
    """Return the thickness of the wall at every face, mm, from a coarse mesh of all faces."""
    gmsh.option.setNumber("Mesh.MeshSizeMax", extent / 15.0)
    gmsh.option.setNumber("Mesh.MeshSizeFromCurvature", PER_TURN)
    gmsh.model.mesh.generate(2)
    at = places()
    own = {tag: at[nodes_of(2, 3, tag)] for _, tag in gmsh.model.getEntities(2)}
    corners, found = np.concatenate(list(own.values())), {}
    for tag, faces in own.items():
        chosen = faces[np.linspace(0, len(faces) - 1, min(RAYS, len(faces))).astype(int)]
        normals = np.cross(chosen[:, 1] - chosen[:, 0], chosen[:, 2] - chosen[:, 0])
        normals /= np.linalg.norm(normals, axis=1)[:, None]
        met = hits(chosen.mean(axis=1), normals, corners)
        outwards, inwards = met > 1e-6 * extent, np.isfinite(met) & (met < -1e-6 * extent)
        # a ray that leaves the solid meets an even number of faces, one that enters it an odd one
        flipped = np.mean(outwards.sum(axis=1) % 2) > 0.5
        lengths = np.where(outwards, met, np.inf) if flipped else np.where(inwards, -met, np.inf)
        lengths = lengths.min(axis=1)
        lengths = lengths[np.isfinite(lengths)]
        found[tag] = float(np.quantile(lengths, QUANTILE)) if lengths.size else extent
    gmsh.model.mesh.clear()
    return found


def made(size: float, coarser: float, extent: float, solid: int) -> None:
    """Mesh a solid with cells of a size, in mm, or by its walls; or with cells so many times as large."""
    walls = {tag: size for _, tag in gmsh.model.getEntities(2)} if size else thickness(extent)
    share = set_sizes(walls, size, extent, solid, 0.0 if size else 0.5)
    meshed(size)
    n = len(gmsh.model.mesh.getElementsByType(11)[0])
    if not size and share < 1.0 and n > MOST_WANTED:
        gmsh.model.mesh.clear()
        set_sizes(walls, size, extent, solid, min(1.0, share * (n / MOST_WANTED) ** (1.0 / 3.0)))
        meshed(size)
    if coarser != 1.0:
        gmsh.model.mesh.clear()
        gmsh.option.setNumber("Mesh.MeshSizeFactor", coarser)
        meshed(size)


def set_sizes(walls: dict[int, float], size: float, extent: float, solid: int, share: float) -> float:
    """Say how large cells may be: a share of the walls, or more where there would be too many; or as asked for. Return
    the share."""
    widest, total = extent / WIDEST, gmsh.model.occ.getMass(3, solid)  # mm3
    areas = {tag: gmsh.model.occ.getMass(2, tag) for tag in walls}
    sizes = {tag: min(max(wall, extent / 200.0), widest) if not size else size for tag, wall in walls.items()}
    # shares of the volume behind the faces
    behind = {tag: areas[tag] * sizes[tag] for tag in sizes}
    n = total * CELLS_PER_CUBE * sum(behind[tag] / sizes[tag] ** 3 for tag in sizes) / sum(behind.values())
    if n > MOST:
        cure = "give mesh_size, the largest size of a cell" if not size else "a larger mesh_size"
        what = f"mesh_size = {size:.3g} mm" if size else f"walls as thin as {min(sizes.values()):.3g} mm"
        raise Refused(f"{what} would take about {n:.1g} cells; {cure} is needed")
    share = 1.0 if size else min(max((n / MOST_WANTED) ** (1.0 / 3.0), share), 1.0)
    for tag, wall in sorted(sizes.items(), key=lambda item: -item[1]):  # of neighbours the thinner one counts
        points = gmsh.model.getBoundary([(2, tag)], combined=False, oriented=False, recursive=True)
        gmsh.model.mesh.setSize([point for point in points if point[0] == 0], share * wall)
    gmsh.option.setNumber("Mesh.MeshSizeMax", share * max(sizes.values()))
    gmsh.option.setNumber("Mesh.MeshSizeMin", 0.2 * share * min(sizes.values()))
    gmsh.option.setNumber("Mesh.MeshSizeFromCurvature", PER_TURN)
    return share


def inverted() -> bool:
    """Whether a cell of second order is turned inside out at one of its nodes."""
    at = [0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 0.5, 0, 0, 0.5, 0.5, 0, 0, 0.5, 0, 0, 0, 0.5, 0, 0.5, 0.5, 0.5, 0, 0.5]
    return bool((gmsh.model.mesh.getJacobians(11, at)[1] <= 0.0).any())


def meshed(size: float) -> None:
    """Make the cells, of second order, and better ones where some are turned inside out."""
    try:
        gmsh.model.mesh.generate(3)
        gmsh.model.mesh.setOrder(2)
        if inverted():
            gmsh.model.mesh.optimize("HighOrder")
    except Exception as error:
        cure = "another mesh_size" if size else "a mesh_size"
        raise Refused(f"gmsh cannot mesh it ({error}); repair the solid in CAD, or try {cure}") from error
    if not len(gmsh.model.mesh.getElementsByType(11)[0]):
        raise Refused("gmsh made no cells of it; repair the solid in CAD: its faces do not close")


def cylinder(tag: int, nodes: np.ndarray, extent: float) -> tuple[np.ndarray, np.ndarray, float] | None:
    """Return axis, a place on it and the radius of a face that is a cylinder; None of others.

    The normals n of a cylinder are across its axis, and its places are ``c + r n``.
    """
    if gmsh.model.getType(2, tag) != "Cylinder":
        return None
    parameters = gmsh.model.getParametrization(2, tag, nodes.ravel())
    normals = np.reshape(gmsh.model.getNormal(tag, parameters), (-1, 3))
    axis = np.linalg.svd(normals)[2][2]
    axis *= np.sign(axis[np.argmax(np.abs(axis) > 0.5)]) or 1.0
    ways = np.linalg.svd(axis[None])[2][1:]  # across the axis
    flat, turned = nodes @ ways.T, normals @ ways.T
    n = len(nodes)
    rows = np.zeros((2 * n, 3))
    rows[:n, 0] = rows[n:, 1] = 1.0
    rows[:, 2] = turned.T.ravel()
    found, *_ = np.linalg.lstsq(rows, flat.T.ravel(), rcond=None)
    if np.abs(rows @ found - flat.T.ravel()).max() > STRAIGHT * extent:
        return None
    return axis, found[:2] @ ways, float(found[2])  # the radius is negative where normals point at the axis


def cylinders(faces: dict[int, np.ndarray], nodes: np.ndarray, outward: dict[int, np.ndarray], extent: float) -> list:
    """Return whole cylinders: whether each is a bore, radius, axis, middle, length and faces."""
    kin: list[list] = []  # faces of one axis, radius and side
    for tag, cells in faces.items():
        own = nodes[np.unique(cells)]
        found = cylinder(tag, own, extent)
        if found is None:
            continue
        axis, place, radius = found
        arms = nodes[cells[:, :3]].mean(axis=1) - place
        arms -= np.outer(arms @ axis, axis)
        inner = bool(np.sum(arms * outward[tag]) < 0.0)
        for one in kin:
            apart = one[2] - place
            apart -= (apart @ axis) * axis
            near = np.linalg.norm(apart) < 1e-4 * extent and np.linalg.norm(np.cross(one[1], axis)) < 1e-4
            along, extents = own @ axis, one[5]
            touch = along.min() <= extents[1] + 1e-6 * extent and along.max() >= extents[0] - 1e-6 * extent
            if one[0] == inner and near and touch and abs(one[3] - abs(radius)) < 1e-4 * extent:
                one[4].append(tag)
                one[5] = [min(extents[0], along.min()), max(extents[1], along.max())]
                break
        else:
            along = own @ axis
            kin.append([inner, axis, place, abs(radius), [tag], [along.min(), along.max()]])
    whole = []
    for inner, axis, place, radius, tags, (low, high) in kin:
        own = nodes[np.unique(np.concatenate([faces[tag].ravel() for tag in tags]))]
        ways = np.linalg.svd(axis[None])[2][1:]
        angles = np.sort(np.arctan2(*((own - place) @ ways.T).T))
        gap = np.diff(np.append(angles, angles[0] + 2.0 * np.pi)).max()
        if gap < WHOLE_TURN:
            middle = place + (0.5 * (low + high) - place @ axis) * axis
            whole.append((inner, radius, axis, middle, high - low, tags))
    return sorted(whole, key=lambda one: (-round(one[1] / extent, 6), *np.round(one[3] / extent, 6)))


def main(path: str, size: float, coarser: float, output: str) -> None:
    """Mesh a part; see the module."""
    solid = opened(path)
    box = np.reshape(gmsh.model.getBoundingBox(3, solid), (2, 3))
    extent = float(np.max(box[1] - box[0]))
    made(size, coarser, extent, solid)
    at, cells = places(), nodes_of(11, 10)[:, [*range(8), 9, 8]]
    number, used = np.zeros(len(at), dtype=int), np.unique(cells)
    number[used] = np.arange(len(used))
    nodes, cells = at[used], number[cells]
    faces = {tag: number[nodes_of(9, 6, tag)] for _, tag in gmsh.model.getEntities(2)}
    whole = cylinders(faces, nodes, outward_normals(nodes, cells, faces), extent)
    arrays = {f"face{tag}": own for tag, own in faces.items()}
    arrays |= {f"named{tag}": np.array(name_of(2, tag)) for tag in faces}
    for k, (inner, radius, axis, middle, length, own) in enumerate(whole):
        arrays[f"cylinder{k}"] = np.array([inner, radius, *axis, *middle, length])
        arrays[f"faces{k}"] = np.array(own)
    arrays |= {"volume": gmsh.model.occ.getMass(3, solid), "centre": gmsh.model.occ.getCenterOfMass(3, solid)}
    arrays |= {"inertia": np.reshape(gmsh.model.occ.getMatrixOfInertia(3, solid), (3, 3))}
    np.savez(output, nodes=nodes, cells=cells, **arrays)


def outward_normals(nodes: np.ndarray, cells: np.ndarray, faces: dict[int, np.ndarray]) -> dict[int, np.ndarray]:
    """Return normals of the triangles of every face, out of the cells that they bound, shape (n, 3) each."""
    sides = np.sort(cells[:, [[0, 1, 2], [0, 1, 3], [1, 2, 3], [0, 2, 3]]].reshape(-1, 3), axis=1)
    owners = {tuple(side): k // 4 for k, side in enumerate(sides.tolist())}
    found = {}
    for tag, own in faces.items():
        corners = nodes[own[:, :3]]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        inside = nodes[cells[[owners[tuple(side)] for side in np.sort(own[:, :3], axis=1).tolist()], :4]].mean(axis=1)
        away = np.sign(np.sum(normals * (corners.mean(axis=1) - inside), axis=1))
        found[tag] = normals * away[:, None]
    return found


if __name__ == "__main__":
    if MISSING:
        np.savez(sys.argv[4], refused=np.array(MISSING))
        sys.exit()
    gmsh.initialize(sys.argv[:1])
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.option.setNumber("General.NumThreads", 1)
    try:
        main(sys.argv[1], *map(float, sys.argv[2:4]), sys.argv[4])
    except Refused as refused:
        np.savez(sys.argv[4], refused=np.array(str(refused)))
    gmsh.finalize()
