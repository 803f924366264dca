"""Scenes to begin with that are made of a file of another program: of a part of CAD, or of a robot.

A part is held at its widest bore (or pin, or at one end), and a force acts on the bore that is farthest from there.
What a user does not know yet has a number that fits the part: the force bends a bar of the part's length and volume
to a third of the yield stress of mild steel, and a period of the first bending between hinged ends has twenty steps.

Links of a robot (URDF, MJCF) become rigid bodies, its joints have axes and ranges, all in SI units. A link's frame is
its body's frame, placed as the robot stands where all its joints are at zero. The root is the ground. Links without
mass that are fixed to another one are points of that one. Joints are held by drives, so that the first run says the
torques and forces that hold the robot against its weight.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from importlib import resources
from pathlib import Path
from string import Template
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from pgmp_petsc.base.errors import InputError, shortened
from pgmp_petsc.base.units import STANDARD_GRAVITY
from pgmp_petsc.bodies.solid import Solid
from pgmp_petsc.mesh.matrix_files import PROGRAM
from pgmp_petsc.mesh.reading import check_file, made_by
from pgmp_petsc.mesh.solid_mesh_reading import CadPart, read_part
from pgmp_petsc.scene.bodies import CAD, IN_ORDER, MOMENTS
from pgmp_petsc.scene.loading import scene_from_toml
from pgmp_petsc.studies.plausibility.bodies import LONGEST_MESH, sizes_of

_BEGINNINGS = resources.files("pgmp_petsc.studies") / "beginnings"
MILLIMETRE = 1e-3
STEEL = {"nu": 0.3, "rho": 7.85e-9, "yields": 250.0}  # in mm, t, s
STEPS_A_PERIOD, PERIODS = 20.0, 15.0
ROUND_OFF = 1e-9  # of the largest moment of inertia
SMALLEST = 1e-30  # number that a scene takes, but for 0


@dataclass(frozen=True, eq=False)
class PartScene:
    """The scene of a part, in mm, t, s."""

    text: str  # of the scene's file
    lines: list[str]  # about the part
    part: CadPart


@dataclass(frozen=True)
class _Place:
    """A group of faces to hold a part at."""

    name: str
    centre: np.ndarray  # shape (3,)
    axis: np.ndarray | None  # of a cylinder


def scene_of_part(source: Path, file: Path) -> PartScene:
    """Return the scene of a STEP file; `file` is where the scene will be. Raises `InputError` as `read_part`."""
    if source.suffix.lower() == ".xacro":
        made = f"{source.stem.removesuffix('.urdf')}.urdf"
        raise InputError(f"--from {source}: run xacro first, and take what it makes: xacro {source.name} -o {made}")
    if source.suffix.lower() not in CAD:
        raise InputError(
            f"--from {source}: a scene is made of a part of CAD as STEP ({', '.join(CAD)}; export it so from CAD), or "
            f"of a robot ({', '.join(ROBOT)})"
        )
    part = read_part(source, shortened(f"--from {source}"), MILLIMETRE)
    name = "".join(c if c.isascii() and (c.isalnum() or c == "_") else "_" for c in source.stem).strip("_")
    name = name if name[:1].isalpha() else f"part_{name}".rstrip("_")
    hold, load = _places(part)
    step, shape = 1e-3, replace(part.mesh, nodes=MILLIMETRE * part.mesh.nodes)
    for _ in range(2):  # the second time with a step that fits the part's size
        text = _text(part, name, file, source, hold, load, step)
        frequency = sizes_of(scene_from_toml(text, file.parent), {name: shape})[name].frequency_hz
        step = float(f"{1.0 / (STEPS_A_PERIOD * frequency):.1g}")
    return PartScene(text, _lines(part, name, hold, load), part)


def _places(part: CadPart) -> tuple[_Place, _Place]:
    """Return where the part is held and where it is loaded."""
    mesh = part.mesh
    round_ones = sorted(part.cylinders, key=lambda one: not one.inner)
    places = [_Place(one.name, one.centre, one.axis) for one in round_ones]
    ends = []
    long = int(np.argmax(np.ptp(mesh.nodes, axis=0)))
    for k in range(1, part.n_faces + 1):
        ends.append(_Place(f"face{k}", mesh.nodes[np.unique(mesh.groups[f"face{k}"])].mean(axis=0), None))
    ends.sort(key=lambda one: one.centre[long])
    hold = places[0] if places else ends[0]
    beside = [place for place in places[1:] if _apart(place, hold) > 0.05 * float(np.ptp(mesh.nodes, axis=0).max())]
    return hold, max(beside or ends, key=lambda place: _apart(place, hold))


def _apart(one: _Place, other: _Place) -> float:
    return float(np.linalg.norm(one.centre - other.centre))


def _directions(hold: _Place, load: _Place) -> tuple[np.ndarray, np.ndarray]:
    """Return the axis of the hinge, and the direction of the force, across it and across the part."""
    arm = load.centre - hold.centre
    axis = hold.axis
    if axis is None or np.linalg.norm(np.cross(axis, arm)) < 1e-3 * np.linalg.norm(arm):
        flat = np.eye(3)[int(np.argmin(np.abs(arm)))]
        if axis is None:
            axis = np.cross(np.cross(arm, flat), arm)
    across = np.cross(axis, arm)
    if np.linalg.norm(across) < 1e-3 * np.linalg.norm(arm):
        across = np.cross(flat, arm)
    return axis / np.linalg.norm(axis), across / np.linalg.norm(across)


def _numbers(values: Sequence[float], digits: int = 9) -> str:
    """Return numbers as TOML; what is round-off beside the largest one is 0."""
    given = np.ravel(values)
    least = max(10.0**-digits * np.abs(given).max(initial=0.0), SMALLEST)
    given = np.where(np.abs(given) < least, 0.0, given)
    return "[" + ", ".join(repr(float(f"{value:.{digits}g}") + 0.0) for value in given) + "]"


_exact = partial(_numbers, digits=12)


def _text(part: CadPart, name: str, file: Path, source: Path, hold: _Place, load: _Place, step: float) -> str:
    axis, across = _directions(hold, load)
    extent = float(np.ptp(part.mesh.nodes, axis=0).max())
    across_part = part.volume / extent
    bending = 0.35 * STEEL["yields"] * across_part**1.5 / 6.0 / max(_apart(load, hold), 0.1 * extent)
    force = float(f"{bending:.1g}")
    mesh = source.name if source.parent.resolve() == file.parent.resolve() else str(source.resolve())
    mesh = f'"{mesh}"' if '"' not in mesh and "\\" not in mesh else f"'{mesh}'"
    duration = float(f"{PERIODS * STEPS_A_PERIOD * step:.2g}")
    entries = {
        "source": source.name, "file": file.name, "name": name, "hold": hold.name, "loaded": load.name,
        "n_faces": part.n_faces, "cylinders": "\n".join(f"#   {line}" for line in _cylinder_lines(part)) or "#   none",
        "mesh": mesh, "centre": _numbers(hold.centre), "axis": _numbers(axis), "across": _numbers(-across),
        "force": f"{force:g}", "ramp": f"{0.3 * duration:.2g}", "duration": f"{duration:g}", "step": f"{step:g}",
        "damping": f"{2.0 * step:.1g}", "deflection": "xyz"[int(np.argmax(np.abs(across)))],
    }  # fmt: skip
    return _filled("part.toml", STEEL | entries)


def _filled(name: str, entries: Mapping[str, object]) -> str:
    """Return a text of the folder of scenes to begin with, with what stands for its ``${entries}``."""
    return Template((_BEGINNINGS / name).read_text(encoding="utf-8")).substitute(entries)


def _cylinder_lines(part: CadPart) -> list[str]:
    return [
        f"{one.name}: radius {one.radius:.6g}, {one.length:.6g} long, middle {_numbers(one.centre)}, "
        f"axis {_numbers(one.axis)}"
        for one in part.cylinders
    ]


def _lines(part: CadPart, name: str, hold: _Place, load: _Place) -> list[str]:
    mesh, density = part.mesh, STEEL["rho"] * 1e3
    box = " x ".join(f"{extent:.4g}" for extent in np.ptp(mesh.nodes, axis=0))
    centre = ", ".join(f"{x:.5g}" for x in part.centre)
    inertia = np.where(np.abs(part.inertia) > ROUND_OFF * np.abs(part.inertia).max(), part.inertia, 0.0)
    moments = ", ".join(f"{x:.4g}" for x in (density * inertia)[IN_ORDER])
    share = Solid("part", mesh, ()).volume / part.volume - 1.0
    n_pins = sum(not one.inner for one in part.cylinders)
    lines = _cylinder_lines(part)
    mass = f"whose mass is that of the solid to {abs(share):.1g}"
    return [
        f"  part          {name}: {box} mm, {part.volume:.6g} mm3, {part.n_faces} faces, "
        f"{len(part.cylinders) - n_pins} bores, {n_pins} pins",
        f"  of steel      {density * part.volume:.4g} kg, centre of mass ({centre}) mm, inertia about it "
        f"({', '.join(MOMENTS)}) {moments} kg mm2",
        *(f"  {'bore' if one.inner else 'pin':12}  {line}" for one, line in zip(part.cylinders, lines)),
        f"  mesh          {mesh.n_nodes} nodes, {mesh.n_cells} {mesh.kind}, {mass}",
        f"  scene         held at {hold.name}, loaded at {load.name}",
    ]


#: Formats by the endings of files with robots; MJCF files end in .xml too.
ROBOT = {".urdf": "urdf", ".mjcf": "mjcf", ".xml": "mjcf"}
SECONDS = 120.0  # that a library may take
MOVING = {"revolute": "revolute", "continuous": "revolute", "prismatic": "prismatic"}
PACKAGE = re.compile(r"package://[^/]+/")
WHOLE_TURN = 6.283185307179586
EARTH = (0.0, 0.0, -STANDARD_GRAVITY)  # m/s2
#: What to do about what is left out.
CURES = {
    "stiffness": "add effects spring_damper of the joints",
    "damping": "add effects joint_damping",
    "friction": "add effects joint_friction",
    "armature": "add the inertia of the drive to its bodies",
    "tendon": "add springs or couplings",
    "equality": "it is not active; where it should hold, add a joint or a coupling",
    "actuator": "drives hold the joints in place of it; change effects hold_JOINT, or take controllers",
}


@dataclass
class _Body:
    name: str
    place: np.ndarray  # of its frame in that of the ground, shape (4, 4)
    link: Mapping[str, Any]
    points: dict[str, np.ndarray] = field(default_factory=dict)


def scene_of_robot(source: Path, file: Path) -> tuple[str, list[str]]:
    """Return the text of a robot's scene, and what to say of it. Raises `InputError` where it is no tree of links that
    can be bodies; `file` is where the scene will be."""
    received = shortened(f"--from {source}")
    check_file(source, received, "a URDF or an MJCF is needed")
    found = made_by(PROGRAM, (ROBOT[source.suffix.lower()], "links", source.resolve()), SECONDS)
    if isinstance(found, str):
        raise InputError(f"{received}: {found}")
    robot = {name: json.loads(str(text)) for name, text in found.items()}
    links, joints = {link["name"]: link for link in robot["links"]}, robot["joints"]
    try:
        root = _root(links, joints)
        _check_meshes(links.values(), source)
        _check_followed(joints)
        bodies, kept = _placed(links, joints, root)
        if not any(joint["type"] in MOVING for joint in kept):
            raise InputError("no joint of it moves; a scene needs one that is revolute, continuous or prismatic")
        text = _robot_text(file, source, root, bodies, kept, _weight(robot.get("gravity", EARTH)))
        scene_from_toml(text, file.parent)  # which refuses inertia that no body has, say
    except InputError as error:
        raise InputError(f"{received}: {error}") from error
    moving = [joint for joint in kept if joint["type"] in MOVING]
    extent = _extent(bodies.values())
    lines = [
        f"  robot         {robot['name']}: {len(links)} links, {len(joints)} joints, {len(moving)} of them move; "
        f"joints and centres span {extent:.4g} m",
        f"  ground        {root}, and what is fixed to it",
    ]
    for joint in moving:
        if joint["follows"]:
            other, factor, offset = joint["follows"]
            lines.append(f"  coupling      {joint['name']} = {factor:g} {other} + {offset:g}")
    own = {one.name: one for one in bodies.values() if one.name}
    lines += [f"  body          {name}: {one.link['mass']:g} kg" for name, one in own.items()]
    if extent > LONGEST_MESH:
        lines.append(f"  warning: lengths of {source.name} are taken as m; if they are in mm, write it in m, kg, s")
    return text, lines + _left_out(robot["left"])


def _left_out(left: Sequence[tuple[str, str]]) -> list[str]:
    where: dict[str, list[str]] = {}
    for what, name in left:
        where.setdefault(what, []).append(name)
    return [f"  left out      {what} ({', '.join(names)}); {CURES[what]}" for what, names in where.items()]


def _extent(bodies: Iterable[_Body]) -> float:
    """Return the largest extent of the places of a robot along an axis: its points and centres of mass."""
    places = [
        body.place[:3, :3] @ np.array(place) + body.place[:3, 3]
        for body in bodies
        for place in (*body.points.values(), *([body.link["centre"]] if body.name else []))
    ]
    return float(np.ptp(places, axis=0).max())


def _root(links: Mapping[str, Any], joints: Sequence[Mapping[str, Any]]) -> str:
    """Return the link that no joint moves; refuse what is no tree."""
    parents: dict[str, str] = {}
    for joint in joints:
        for key in ("parent", "child"):
            if joint[key] not in links:
                raise InputError(f"the joint {joint['name']} names the link {joint[key]}, which is not there")
        if joint["child"] in parents:
            raise InputError(
                f"the link {joint['child']} hangs on {parents[joint['child']]} and, by the joint {joint['name']}, on "
                f"{joint['parent']}: a loop, which a URDF cannot have; leave one joint out and add it to the scene"
            )
        parents[joint["child"]] = joint["parent"]
    roots = [name for name in links if name not in parents]
    if not roots:
        raise InputError("every link hangs on another one, in a loop; one has to be the base")
    if len(roots) > 1:
        raise InputError(f"the links {', '.join(roots)} hang on no other; one base is needed, joined to all")
    return roots[0]


def _check_meshes(links: Sequence[Mapping[str, Any]], source: Path) -> None:
    """Refuse meshes that are not there: a package's are looked for in the folders above the file."""
    for link in links:
        for mesh in link["meshes"]:
            name = PACKAGE.sub("", mesh).removeprefix("file://")
            folders = [source.resolve().parent, *(source.resolve().parents if PACKAGE.match(mesh) else ())]
            if not any((folder / name).is_file() for folder in folders):
                raise InputError(
                    f"the mesh {mesh} of the link {link['name']} is not there; put it beside the file, or "
                    "leave the geometry out: bodies have their masses from the inertial entries"
                )


def _placed(links: Mapping, joints: Sequence, root: str) -> tuple[dict[str, _Body], list[dict]]:
    """Return the bodies by link, and the joints between bodies with their places in these, from the root on."""
    of_parent: dict[str, list] = {}
    for joint in joints:
        of_parent.setdefault(joint["parent"], []).append(joint)
    ground = _Body("", np.eye(4), links[root])
    bodies, kept, taken = {root: ground}, [], {"ground"}
    frames, waiting = {root: np.eye(4)}, [root]  # of every link, in that of the ground
    while waiting:
        parent = waiting.pop(0)
        owner = bodies[parent]
        for joint in of_parent.get(parent, ()):
            kind, child = joint["type"], joint["child"]
            if kind not in MOVING and kind != "fixed":
                raise InputError(
                    f"the joint {joint['name']} is {kind}; revolute, continuous, prismatic and fixed ones are taken"
                )
            link, place = links[child], frames[parent] @ np.array(joint["place"])
            within = np.linalg.solve(owner.place, place)
            follows = joint["follows"] if kind in MOVING else None
            if follows:
                place = place @ _moved(kind, joint["axis"], follows[2])
            frames[child] = place
            waiting.append(child)
            if kind == "fixed" and (not link["mass"] or owner is ground):
                bodies[child] = owner
                owner.points[_free_name(child, owner.points)] = within[:3, 3]
                continue
            if not link["mass"]:
                raise InputError(
                    f"the link {child} moves in the joint {joint['name']} and has no mass; give it an inertial entry, "
                    "or make the joint fixed"
                )
            if not np.any(link["inertia"]):
                raise InputError(f"the link {child} has a mass and no moments of inertia; its inertial needs them")
            low, high = joint["limit"] or (None, None)
            if not follows and kind in ("revolute", "prismatic") and (None in (low, high) or not low < high):
                raise InputError(
                    f"the joint {joint['name']} has no limits that are a range ({joint['limit']}); give "
                    "lower and upper, or make it continuous"
                )
            point = _free_name(joint["name"], owner.points)
            owner.points[point] = within[:3, 3]
            name = _free_name(child, taken)
            taken.add(name)
            bodies[child] = _Body(name, place, link, {"origin": np.zeros(3)})
            axis = within[:3, :3] @ np.array(joint["axis"], dtype=float)
            kept.append({**joint, "of": owner.name or "ground", "point": point, "body": name, "in_owner": axis})
    return bodies, kept


def _moved(kind: str, axis: Sequence[float], by: float) -> np.ndarray:
    """Return the motion of a joint by an angle or a way, shape (4, 4)."""
    motion, way = np.eye(4), by * np.array(axis, dtype=float) / np.linalg.norm(axis)
    if kind == "prismatic":
        motion[:3, 3] = way
    else:
        motion[:3, :3] = Rotation.from_rotvec(way).as_matrix()
    return motion


def _check_followed(joints: Sequence[Mapping[str, Any]]) -> None:
    """Refuse joints that follow what does not move, or one another in a ring."""
    moving = {joint["name"]: joint["follows"] for joint in joints if joint["type"] in MOVING}
    for name, follows in moving.items():
        behind = [name]
        while follows:
            other, factor, _ = follows
            if not factor:
                raise InputError(f"the joint {behind[-1]} follows {other} with the factor 0; make it fixed")
            if other not in moving:
                cure = f"one that is revolute, continuous or prismatic is needed ({', '.join(moving)})"
                raise InputError(f"the joint {behind[-1]} follows {other}; {cure}")
            if other in behind:
                raise InputError(f"the joints {', '.join(behind)} follow one another in a ring; one has to lead")
            behind.append(other)
            follows = moving[other]


def _free_name(given: str, taken: object) -> str:
    """Return a name that scenes take, and that is not taken."""
    name = re.sub(r"[^A-Za-z0-9_]+", "_", given).strip("_") or "link"
    name = name if name[0].isalpha() else f"link_{name}"
    while name in taken or name == "centre":
        name += "_"
    return name


def _points(points: Mapping[str, np.ndarray]) -> str:
    return "{ " + ", ".join(f"{name} = {_exact(place)}" for name, place in points.items()) + " }"


def _robot_text(
    file: Path, source: Path, root: str, bodies: Mapping[str, _Body], joints: Sequence[Mapping], weight: list[str]
) -> str:
    own = {id(body): body for body in bodies.values()}.values()
    names, joined, coordinates = dict[str, str](), [], []  # scene's names by the file's
    for joint in joints:
        names[joint["name"]] = _free_name(joint["name"], names.values())
    for joint in joints:
        name, follows = names[joint["name"]], joint["follows"]
        kind = MOVING.get(joint["type"], "fixed")
        joined += [
            f"[joints.{name}]",
            f'type = "{kind}"',
            f'connect = ["{joint["of"]}:{joint["point"]}", "{joint["body"]}:origin"]',
            *([f"axis = {_exact(joint['in_owner'])}"] if kind != "fixed" else []),
            "",
        ]
        if kind != "fixed" and follows:
            other, factor, offset = follows
            joined += [
                f"[joints.{_free_name(f'{name}_follows', names.values())}]",
                f'type = "coupling"  # {name} = {factor:g} {names[other]} + {offset:g}; it stands at {offset:g} here',
                f"terms = {{ {name} = 1.0, {names[other]} = {-factor!r} }}",
                "",
            ]
        elif kind != "fixed":
            coordinates += _held(name, kind, joint)
    held = {joint["point"]: bodies[root].points[joint["point"]] for joint in joints if joint["of"] == "ground"}
    ground = [f"# {root}", "[ground]", f"points = {_points(held)}  # m", ""]
    entries = {
        "source": source.name, "file": file.name, "title": _free_name(file.stem, ()),
        "bodies": "\n".join(line for body in own for line in (_rigid(body) if body.name else ground)),
        "joints": "\n".join(joined), "coordinates": "\n".join(coordinates), "weight": "\n".join(weight),
    }  # fmt: skip
    return _filled("robot.toml", entries)


def _weight(gravity: Sequence[float]) -> list[str]:
    size = float(np.linalg.norm(gravity))
    if not size:
        return ["# the file has no gravity", ""]
    lines = ["[effects.weight]", 'type = "gravity"', f"direction = {_exact(np.array(gravity) / size)}"]
    return [*lines, f"acceleration = {size!r}  # m/s2", ""]


def _rigid(body: _Body) -> list[str]:
    link, turn = body.link, Rotation.from_matrix(body.place[:3, :3]).as_rotvec()
    tensor = np.array(link["inertia"])
    return [
        f"[bodies.{body.name}]",
        f"rigid.mass = {link['mass']!r}  # kg",
        f"rigid.centre = {_exact(link['centre'])}  # m",
        f"rigid.inertia = {_exact(tensor[IN_ORDER])}  # kg m2: {', '.join(MOMENTS)}",
        f"rigid.points = {_points(body.points)}  # m",
        f"placement = {{ origin = {_exact(body.place[:3, 3])}, rotation = {_exact(turn)} }}  # m, rad",
        "",
    ]


def _held(name: str, kind: str, joint: Mapping[str, Any]) -> list[str]:
    """Return the lines of a joint's coordinate, of the drive that holds it, and of what the drive takes."""
    whole = joint["type"] == "continuous"
    low, high = (0.0, WHOLE_TURN) if whole else joint["limit"]
    unit, effort = ("m", "N") if kind == "prismatic" else ("rad", "N m")
    return [
        f"[coordinates.{name}]",
        f'joint = "{name}"',
        f"range = {_exact((low, high))}  # {unit}",
        *(["periodic = true"] if whole else []),
        "",
        f"[effects.hold_{name}]",
        'type = "prescribed_motion"',
        f'coordinate = "{name}"',
        f"constant_speed = {{ speed = 0.0, start = {0.0 if low <= 0.0 <= high else 0.5 * (low + high)!r} }}",
        "",
        f"[outputs.drive_{name}]  # {effort}",
        'type = "drive_torque"',
        f'coordinate = "{name}"',
        "",
    ]
