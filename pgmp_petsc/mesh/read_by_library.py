"""A program of its own: files of Nastran, Ansys and robots are read by the libraries below.

    python -P read_by_library.py FORMAT KIND FILE OUT.npz

It imports nothing of the package. FORMAT is a function below, KIND is ``stiffness``, ``mass`` or ``modes``, of files
that may hold several, or ``nodes``. OUT.npz has the entries of a matrix (``row``, ``column``, ``value``, ``size``)
with the node and direction of each row (``rows``) where the file says them, or ``nodes`` and ``labels``, sets
``set:NAME`` of labels and cells ``cells:TYPE`` of labels in meshio's order; of a robot JSON: ``links``, ``joints``,
what is ``left`` out and, where the file says it, ``gravity``; or, of a file that is refused, the array ``refused``
alone. These libraries are large, print, and some end their process on a damaged file.
"""

from __future__ import annotations

import json
import re
import sys
from io import StringIO

import numpy as np
import scipy.sparse as sp

#: Module, what is installed, and what it reads, by format.
LIBRARIES = {
    "dmig": ("pyNastran", "pyNastran", "Nastran's DMIG"),
    "op2": ("pyNastran", "pyNastran", "Nastran's OP2"),
    "op4": ("pyNastran", "pyNastran", "Nastran's OP4"),
    "deck": ("pyNastran", "pyNastran", "a Nastran deck"),
    "full": ("ansys.mapdl.reader", "ansys-mapdl-reader", "an Ansys .full"),
    "cdb": ("ansys.mapdl.reader", "ansys-mapdl-reader", "an Ansys .cdb"),
    "urdf": ("yourdfpy", "yourdfpy", "a URDF"),
    "mjcf": ("mujoco", "mujoco", "an MJCF"),
}
LETTERS = {"stiffness": "K", "mass": "M", "modes": "P"}  # Nastran's PHG, PHA
#: meshio's type of Nastran's and Ansys' elements by their number of nodes.
NASTRAN = {
    "CTETRA": {4: "tetra", 10: "tetra10"},
    "CHEXA": {8: "hexahedron", 20: "hexahedron20"},
    "CTRIA3": {3: "triangle"},
    "CTRIA6": {6: "triangle6"},
    "CQUAD4": {4: "quad"},
    "CQUAD8": {8: "quad8"},
}
OF_HEXAHEDRON20 = [*range(12), *range(16, 20), *range(12, 16)]  # Nastran has those along z before those on top
ANSYS = {185: {8: "hexahedron"}, 186: {20: "hexahedron20"}, 187: {10: "tetra10"}, 285: {4: "tetra"}}
FIRST_NODE = 10  # of an element of Ansys: before it are its material, type, section and others
OTHER = "other"  # cells that nobody asks for


class Refused(Exception):
    """Why a file is not taken."""


def chosen(names: list[str], kind: str) -> str:
    """Return which of the matrices of a file is the stiffness or the mass, by the first letter of its name."""
    fitting = [name for name in names if name.upper().startswith(LETTERS[kind])]
    if len(names) == 1 or len(fitting) == 1:
        return (fitting or names)[0]
    if not names:
        raise Refused("it has no matrices; write K and M of the body")
    raise Refused(
        f"it has the matrices {', '.join(sorted(names))}, of which {len(fitting)} begin with {LETTERS[kind]}; one "
        f"{kind} is needed: write it to a file of its own"
    )


def entries(matrix: object, rows: np.ndarray | None = None) -> dict[str, np.ndarray]:
    found = sp.coo_matrix(matrix)
    arrays = {"row": found.row, "column": found.col, "value": found.data, "size": np.array(found.shape)}
    return arrays if rows is None else arrays | {"rows": rows}


def read_deck(path: str) -> object:
    """Return pyNastran's model of a deck, or of a part of one."""
    from pyNastran.bdf.bdf import BDF

    with open(path, encoding="utf-8", errors="replace") as file:
        text = file.read()
    begun, whole = (re.search(rf"^\s*{line}", text, re.IGNORECASE | re.MULTILINE) for line in (r"BEGIN\s+BULK", "CEND"))
    model = BDF(debug=None)
    # pre-processors write bulk data with its first line and without what a run has before it
    source = StringIO(f"CEND\n{text}") if begun and not whole else path
    model.read_bdf(source, punch=not (begun or whole), xref=False, validate=False)
    return model


def dmig(path: str, kind: str) -> dict[str, np.ndarray]:
    """Read a matrix of a file with DMIG cards, such as what ``EXTSEOUT(DMIGPCH)`` punches."""
    model = read_deck(path)
    found = model.dmigs if hasattr(model, "dmigs") else model.dmig
    matrix = found[chosen([name for name in found if name != "UACCEL"], kind)]
    if matrix.is_complex:
        raise Refused("its entries are complex; real ones are needed")
    values, rows, columns = matrix.get_matrix(is_sparse=True, apply_symmetry=True)
    places = {pair: k for k, pair in enumerate(sorted({*rows.values(), *columns.values()}))}
    of_row, of_column = ([places[of[k]] for k in range(len(of))] for of in (rows, columns))
    found = sp.coo_matrix(values)
    size, at = len(places), (np.array(of_row)[found.row], np.array(of_column)[found.col])
    return entries(sp.coo_matrix((found.data, at), shape=(size, size)), np.array(list(places)))


def op2(path: str, kind: str) -> dict[str, np.ndarray]:
    from pyNastran.op2.op2 import read_op2

    matrices = read_op2(path, build_dataframe=False, debug=None).matrices
    return entries(matrices[chosen(list(matrices), kind)].data)


def op4(path: str, kind: str) -> dict[str, np.ndarray]:
    from pyNastran.op4.op4 import read_op4

    matrices = read_op4(path, debug=False)
    return entries(matrices[chosen(list(matrices), kind)].data)


def full(path: str, kind: str) -> dict[str, np.ndarray]:
    from ansys.mapdl.reader import read_binary

    file = read_binary(path)
    rows, stiffness, mass = file.load_km(sort=False)
    empty = (stiffness.diagonal() == 0.0) & (mass.diagonal() == 0.0)
    held = max(len(file.const), int(empty.sum()))
    if held:
        cure = "a body is free: write it without D, CP and CE"
        raise Refused(f"{held} of {len(rows)} rows are held by constraints; {cure}")
    return entries(sp.coo_matrix({"stiffness": stiffness, "mass": mass}[kind]), np.asarray(rows) + [0, 1])


def deck(path: str, kind: str) -> dict[str, np.ndarray]:
    """Read nodes, SET1s and solid elements of a bulk data file."""
    model = read_deck(path)
    if not model.nodes:
        raise Refused("it has no GRID; the nodes of the body are needed")
    every = ("elements", "properties", "masses", "materials", "loads", "constraints", "aero", "sets", "optimization")
    model.cross_reference(xref=True, **{f"xref_{name}": False for name in every})
    labels = np.array(sorted(model.nodes))
    found = {"nodes": np.array([model.nodes[label].get_position() for label in labels]), "labels": labels}
    for number, one in model.sets.items():
        found[f"set:{number}"] = np.array(sorted(one.get_ids() if hasattr(one, "get_ids") else one.ids))
    cells: dict[str, list[list[int]]] = {}
    for element in model.elements.values():
        nodes = [node for node in element.node_ids if node]
        kind = NASTRAN.get(element.type, {}).get(len(nodes), OTHER)
        places = OF_HEXAHEDRON20 if kind == "hexahedron20" else range(len(nodes))
        cells.setdefault(kind, []).append([nodes[k] for k in places])
    return found | of_cells(cells)


def cdb(path: str, kind: str) -> dict[str, np.ndarray]:
    """Read nodes, components of nodes and solid elements of an archive."""
    from ansys.mapdl.reader import Archive

    archive = Archive(path, parse_vtk=False)
    if not len(archive.nodes):
        raise Refused("it has no nodes; write the archive with CDWRITE,DB")
    found = {"nodes": np.asarray(archive.nodes)[:, :3], "labels": np.asarray(archive.nnum)}
    found |= {f"set:{name}": np.asarray(own) for name, own in archive.node_components.items()}
    cells: dict[str, list[np.ndarray]] = {}
    for element, number in zip(archive.elem, archive.etype):
        nodes = np.asarray(element)[FIRST_NODE:]
        alone = len(np.unique(nodes)) == len(nodes) and (nodes > 0).all()
        kind = ANSYS.get(int(number), {}).get(len(nodes), OTHER) if alone else OTHER
        cells.setdefault(kind, []).append(nodes)
    return found | of_cells(cells)


def urdf(path: str, kind: str) -> dict[str, np.ndarray]:
    from xml.etree import ElementTree

    from yourdfpy import URDF

    written = ElementTree.parse(path).getroot()  # yourdfpy would leave out what is behind a mistake
    if any("ros.org/wiki/xacro" in one.tag for one in written.iter()):
        raise Refused("it has tags of xacro: run xacro first, and take what it makes")
    for part in ("link", "joint"):  # and of two links of a name the first
        names = [one.get("name") for one in written.findall(part)]
        if twice := [name for name in names if names.count(name) > 1]:
            raise Refused(f"it has {names.count(twice[0])} {part}s {twice[0]}; give each a name of its own")
    robot = URDF.load(path, build_scene_graph=False, load_meshes=False, build_collision_scene_graph=False).robot
    links, joints, left = [], [], []
    for link in robot.links:
        inertial, shapes = link.inertial, [*link.visuals, *link.collisions]
        meshes = [shape.geometry.mesh.filename for shape in shapes if shape.geometry and shape.geometry.mesh]
        own = {"name": link.name, "meshes": sorted(set(meshes)), "mass": 0.0}
        if inertial is not None and inertial.mass:
            place = np.eye(4) if inertial.origin is None else np.asarray(inertial.origin)
            tensor = np.zeros((3, 3)) if inertial.inertia is None else np.asarray(inertial.inertia)
            turn = place[:3, :3]
            own |= {"mass": float(inertial.mass), "centre": place[:3, 3].tolist()}
            own |= {"inertia": (turn @ tensor @ turn.T).tolist()}
        links.append(own)
    for joint in robot.joints:
        place = np.eye(4) if joint.origin is None else np.asarray(joint.origin)
        axis = [1.0, 0.0, 0.0] if joint.axis is None else np.asarray(joint.axis).tolist()
        limit = None if joint.limit is None else (joint.limit.lower, joint.limit.upper)
        own = {"name": joint.name, "type": joint.type, "parent": joint.parent, "child": joint.child, "axis": axis}
        mimic = joint.mimic and (joint.mimic.joint, joint.mimic.multiplier, joint.mimic.offset)
        joints.append(own | {"place": place.tolist(), "limit": limit, "follows": mimic})
        given = {name: getattr(joint.dynamics, name, None) for name in ("damping", "friction")}  # yourdfpy's are text
        left += [(name, joint.name) for name, value in given.items() if float(value or 0.0)]
    return as_text({"name": robot.name, "links": links, "joints": joints, "left": left})


def as_text(robot: dict[str, object]) -> dict[str, np.ndarray]:
    """Return what is known of a robot as JSON."""
    return {name: np.array(json.dumps(found)) for name, found in robot.items()}


def mjcf(path: str, kind: str) -> dict[str, np.ndarray]:
    """Read links and joints of a robot; a link's frame is that of its body, moved to where its joint is."""
    import mujoco
    from scipy.spatial.transform import Rotation

    def turned(quaternion: np.ndarray) -> np.ndarray:
        return Rotation.from_quat(np.roll(quaternion, -1)).as_matrix()  # of (w, x, y, z)

    model = mujoco.MjModel.from_xml_path(path)
    of = {"body": mujoco.mjtObj.mjOBJ_BODY, "joint": mujoco.mjtObj.mjOBJ_JOINT}
    names = [mujoco.mj_id2name(model, of["body"], k) or f"body{k}" for k in range(model.nbody)]
    equal = [k for k in range(model.neq) if model.eq_active0[k]]
    pairs = [k for k in equal if model.eq_type[k] == int(mujoco.mjtEq.mjEQ_JOINT) and model.eq_obj2id[k] >= 0]
    straight = [k for k in pairs if not model.eq_data[k, 2:5].any()]
    if len(straight) < len(equal):
        cure = "those of one joint in proportion to another are taken; leave others out and add them to the scene"
        raise Refused(f"it has {len(equal)} equality constraints, of loops or by powers among them; {cure}")
    follows = {
        int(model.eq_obj1id[k]): (mujoco.mj_id2name(model, of["joint"], model.eq_obj2id[k]), *model.eq_data[k, 1::-1])
        for k in straight
    }
    if len(follows) < len(straight):
        raise Refused(f"of its {len(equal)} equality constraints several move the same joint; leave one for each")
    kinds = {"mjJNT_HINGE": "revolute", "mjJNT_SLIDE": "prismatic", "mjJNT_BALL": "ball", "mjJNT_FREE": "floating"}
    kinds = {int(getattr(mujoco.mjtJoint, name)): kind for name, kind in kinds.items()}
    shift, links, joints, left = np.zeros((model.nbody, 3)), [], [], []
    for k, name in enumerate(names):
        first, n = int(model.body_jntadr[k]), int(model.body_jntnum[k])
        if n > 1:
            raise Refused(f"the body {name} has {n} joints; give each a body of its own")
        if n:
            shift[k] = model.jnt_pos[first]
        own = {"name": name, "meshes": [], "mass": float(model.body_mass[k])}
        turn = turned(model.body_iquat[k])
        own |= {"centre": (model.body_ipos[k] - shift[k]).tolist()}
        links.append(own | {"inertia": (turn @ np.diag(model.body_inertia[k]) @ turn.T).tolist()})
        if k == 0:
            continue
        place, parent = np.eye(4), int(model.body_parentid[k])
        place[:3, :3] = turned(model.body_quat[k])
        place[:3, 3] = model.body_pos[k] + place[:3, :3] @ shift[k] - shift[parent]
        kind = kinds[int(model.jnt_type[first])] if n else "fixed"
        limited = bool(n and model.jnt_limited[first])
        if kind == "revolute" and not limited:
            kind = "continuous"
        joint = (n and mujoco.mj_id2name(model, of["joint"], first)) or f"joint_{name}"
        axis = model.jnt_axis[first].tolist() if n else [1.0, 0.0, 0.0]
        # a joint's body is placed where the joint is at its reference, from which a coordinate of a scene counts
        limit = (model.jnt_range[first] - model.qpos0[model.jnt_qposadr[first]]).tolist() if limited else None
        own = {"name": joint, "type": kind, "parent": names[parent], "child": name, "axis": axis}
        joints.append(own | {"place": place.tolist(), "limit": limit, "follows": follows.get(first) if n else None})
        at = int(model.jnt_dofadr[first])
        own = {"stiffness": model.jnt_stiffness[first], "damping": model.dof_damping[at]} if n else {}
        own |= {"friction": model.dof_frictionloss[at], "armature": model.dof_armature[at]} if n else {}
        left += [(what, joint) for what, value in own.items() if np.any(value)]
    of |= {"equality": mujoco.mjtObj.mjOBJ_EQUALITY}
    for k in set(range(model.neq)) - {*equal}:
        left.append(("equality", mujoco.mj_id2name(model, of["equality"], k) or f"number {k + 1}"))
    of |= {"tendon": mujoco.mjtObj.mjOBJ_TENDON, "actuator": mujoco.mjtObj.mjOBJ_ACTUATOR}
    for what, count in (("tendon", model.ntendon), ("actuator", model.nu)):
        left += [(what, mujoco.mj_id2name(model, of[what], k) or f"number {k + 1}") for k in range(count)]
    named = names[1] if len(names) > 1 else "robot"
    gravity = model.opt.gravity.tolist()
    return as_text({"name": named, "links": links, "joints": joints, "left": left, "gravity": gravity})


def of_cells(cells: dict[str, list]) -> dict[str, np.ndarray]:
    """Return cells by their type; none where some are of no type that bodies have, since all of the body is needed."""
    return {} if OTHER in cells else {f"cells:{kind}": np.array(own) for kind, own in cells.items()}


def main(form: str, kind: str, path: str) -> dict[str, np.ndarray]:
    """Return what a file holds, or why it is refused."""
    module, name, what = LIBRARIES[form]
    try:
        __import__(module)
    except Exception as error:
        cure = f"cannot be imported ({error}): pip install {name}"
        return {"refused": np.array(f"{what} is read by {name}, which {cure}")}
    try:
        return globals()[form](path, kind)
    except Refused as error:
        return {"refused": np.array(str(error))}
    except (Exception, SystemExit) as error:
        reason = " ".join(f"{type(error).__name__}: {error}".split())[:200]
        return {"refused": np.array(f"{name} cannot read this file ({reason}); it may be damaged: write it anew")}


if __name__ == "__main__":
    np.savez(sys.argv[4], **main(*sys.argv[1:4]))
