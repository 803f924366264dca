"""Scenes of robots: links of a URDF or an MJCF as rigid bodies, joints with axes and ranges, in SI units.

A link's frame is its body's frame, placed as the robot stands where all its joints are at zero. The root is the
ground. Links without mass that are fixed to another one are points of that one. Joints are held by drives, so that
the first run says the torques and forces that hold the robot against its weight.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from pgmp_petsc.base.errors import InputError, shortened
from pgmp_petsc.mesh.matrix_files import PROGRAM
from pgmp_petsc.mesh.reading import check_file, made_by
from pgmp_petsc.scene.loading import scene_from_toml

#: Formats by the endings of files with robots; MJCF files end in .xml too.
ROBOT = {".urdf": "urdf", ".mjcf": "mjcf", ".xml": "mjcf"}
LONGEST = 120.0  # s that a library may take
MOVING = {"revolute": "revolute", "continuous": "revolute", "prismatic": "prismatic"}
PACKAGE = re.compile(r"package://[^/]+/")
WHOLE_TURN = 6.283185307179586


@dataclass
class _Body:
    """A body that links make up, or the ground (without a name)."""

    name: str
    place: np.ndarray  # of its frame in that of the ground, shape (4, 4)
    link: Mapping[str, Any]
    points: dict[str, np.ndarray] = field(default_factory=dict)


def scene_of_robot(source: Path, file: Path) -> tuple[str, list[str]]:
    """Return the text of a robot's scene, and what to say of it. Raises `InputError` where it is no tree of links that
    can be bodies; `file` is where the scene will be."""
    received = shortened(f"--from {source}")
    check_file(source, received, "a URDF or an MJCF is needed")
    found = made_by(PROGRAM, (ROBOT[source.suffix.lower()], "links", source.resolve()), LONGEST)
    if isinstance(found, str):
        raise InputError(f"{received}: {found}")
    links = {link["name"]: link for link in json.loads(str(found["links"]))}
    joints = json.loads(str(found["joints"]))
    root = _root(links, joints, received)
    _check_meshes(links.values(), source, received)
    bodies, kept = _placed(links, joints, root, received)
    text = _text(file, source, root, bodies, kept)
    try:
        scene_from_toml(text, file.parent)
    except InputError as error:  # inertia that no body has, say
        raise InputError(f"{received}: {error}") from error
    moving = [joint for joint in kept if joint["type"] in MOVING]
    lines = [
        f"  robot         {found['name']}: {len(links)} links, {len(joints)} joints, {len(moving)} of them move",
        f"  ground        {root}, and what is fixed to it",
    ]
    own = {one.name: one for one in bodies.values() if one.name}
    lines += [f"  body          {name}: {one.link['mass']:g} kg" for name, one in own.items()]
    return text, lines


def _root(links: Mapping[str, Any], joints: Sequence[Mapping[str, Any]], received: str) -> str:
    """Return the link that no joint moves; refuse what is no tree."""
    parents: dict[str, str] = {}
    for joint in joints:
        for key in ("parent", "child"):
            if joint[key] not in links:
                raise InputError(
                    f"{received}: the joint {joint['name']} names the link {joint[key]}, which is not there"
                )
        if joint["child"] in parents:
            raise InputError(
                f"{received}: the link {joint['child']} hangs on {parents[joint['child']]} and, by the joint "
                f"{joint['name']}, on {joint['parent']}: a loop, which a URDF cannot have; leave one joint out and add "
                "it to the scene"
            )
        parents[joint["child"]] = joint["parent"]
    roots = [name for name in links if name not in parents]
    if not roots:
        raise InputError(f"{received}: every link hangs on another one, in a loop; one has to be the base")
    if len(roots) > 1:
        raise InputError(
            f"{received}: the links {', '.join(roots)} hang on no other; one base is needed, joined to all"
        )
    return roots[0]


def _check_meshes(links: Sequence[Mapping[str, Any]], source: Path, received: str) -> None:
    """Refuse meshes that are not there: a package's are looked for in the folders above the file."""
    for link in links:
        for mesh in link["meshes"]:
            name = PACKAGE.sub("", mesh).removeprefix("file://")
            folders = [source.resolve().parent, *(source.resolve().parents if PACKAGE.match(mesh) else ())]
            if not any((folder / name).is_file() for folder in folders):
                raise InputError(
                    f"{received}: the mesh {mesh} of the link {link['name']} is not there; put it beside the file, or "
                    "leave the geometry out: bodies have their masses from the inertial entries"
                )


def _placed(links: Mapping, joints: Sequence, root: str, received: str) -> tuple[dict[str, _Body], list[dict]]:
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
                    f"{received}: the joint {joint['name']} is {kind}; revolute, continuous, prismatic and fixed ones "
                    "are taken"
                )
            if joint["mimic"]:
                raise InputError(
                    f"{received}: the joint {joint['name']} mimics another one; leave that out, and couple both in the "
                    'scene by type = "coupling"'
                )
            link, place = links[child], frames[parent] @ np.array(joint["place"])
            frames[child] = place
            waiting.append(child)
            within = np.linalg.solve(owner.place, place)
            if kind == "fixed" and (not link["mass"] or owner is ground):
                bodies[child] = owner
                owner.points[_name(child, owner.points)] = within[:3, 3]
                continue
            if not link["mass"]:
                raise InputError(
                    f"{received}: the link {child} moves in the joint {joint['name']} and has no mass; give it an "
                    "inertial entry, or make the joint fixed"
                )
            if kind in ("revolute", "prismatic") and (joint["limit"] is None or not _ordered(joint["limit"])):
                raise InputError(
                    f"{received}: the joint {joint['name']} has no limits that are a range ({joint['limit']}); give "
                    "lower and upper, or make it continuous"
                )
            point = _name(joint["name"], owner.points)
            owner.points[point] = within[:3, 3]
            name = _name(child, taken)
            taken.add(name)
            bodies[child] = _Body(name, place, link, {"origin": np.zeros(3)})
            axis = within[:3, :3] @ np.array(joint["axis"], dtype=float)
            kept.append({**joint, "of": owner.name or "ground", "point": point, "body": name, "in_owner": axis})
    return bodies, kept


def _ordered(limit: Sequence[float | None]) -> bool:
    return None not in limit and limit[0] < limit[1]


def _name(given: str, taken: object) -> str:
    """Return a name that scenes take, and that is not taken."""
    name = re.sub(r"[^A-Za-z0-9_]+", "_", given).strip("_") or "link"
    name = name if name[0].isalpha() else f"link_{name}"
    while name in taken or name == "centre":
        name += "_"
    return name


def _numbers(values: Sequence[float]) -> str:
    return "[" + ", ".join(repr(float(f"{value:.12g}") + 0.0) for value in np.ravel(values)) + "]"


def _points(points: Mapping[str, np.ndarray]) -> str:
    return "{ " + ", ".join(f"{name} = {_numbers(place)}" for name, place in points.items()) + " }"


def _text(file: Path, source: Path, root: str, bodies: Mapping[str, _Body], joints: Sequence[Mapping]) -> str:
    """Return the text of the scene."""
    own = {id(body): body for body in bodies.values()}.values()
    title = _name(file.stem, ())
    lines = [
        f"# The robot of {source.name}: links are rigid bodies, joints are held by drives. SI units throughout.",
        "#",
        f"#   pgmp check {file.name} --plot robot.png",
        f"#   pgmp simulate {file.name} --full -o run.h5      torques and forces that hold it",
        "#",
        "# A link becomes flexible with a mesh or a beam in place of its entries `rigid`, its points named anew:",
        '#   mesh = "link.step"',
        '#   element = "solid3d"',
        '#   material = "steel"',
        '#   faces = { origin = "bore1", elbow = "bore2" }',
        "# or with line, element, material, section and orientation, whose points are hinge and tip.",
        "",
        "[scene]",
        f'name = "{title}"',
        "",
    ]
    for body in own:
        if not body.name:
            if body.points:
                lines += [f"# {root}", "[ground]", f"points = {_points(body.points)}  # m", ""]
            continue
        link, turn = body.link, Rotation.from_matrix(body.place[:3, :3]).as_rotvec()
        tensor = np.array(link["inertia"])
        moments = tensor[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
        lines += [
            f"[bodies.{body.name}]",
            f"rigid.mass = {link['mass']!r}  # kg",
            f"rigid.centre = {_numbers(link['centre'])}  # m",
            f"rigid.inertia = {_numbers(moments)}  # kg m2: xx, yy, zz, xy, xz, yz",
            f"rigid.points = {_points(body.points)}  # m",
            f"placement = {{ origin = {_numbers(body.place[:3, 3])}, rotation = {_numbers(turn)} }}  # m, rad",
            "",
        ]
    names, coordinates = set[str](), []
    for joint in joints:
        name = _name(joint["name"], names)
        names.add(name)
        kind = MOVING.get(joint["type"], "fixed")
        lines += [
            f"[joints.{name}]",
            f'type = "{kind}"',
            f'connect = ["{joint["of"]}:{joint["point"]}", "{joint["body"]}:origin"]',
        ]
        lines += [f"axis = {_numbers(joint['in_owner'])}", ""] if kind != "fixed" else [""]
        if kind == "fixed":
            continue
        whole = joint["type"] == "continuous"
        low, high = (0.0, WHOLE_TURN) if whole else joint["limit"]
        unit = "m" if kind == "prismatic" else "rad"
        coordinates += [
            f"[coordinates.{name}]",
            f'joint = "{name}"',
            f"range = {_numbers((low, high))}  # {unit}",
            *(["periodic = true"] if whole else []),
            "",
            f"[effects.hold_{name}]",
            'type = "prescribed_motion"',
            f'coordinate = "{name}"',
            f"constant_speed = {{ speed = 0.0, start = {0.0 if low <= 0.0 <= high else 0.5 * (low + high)!r} }}",
            "",
            f"[outputs.drive_{name}]  # {'N' if kind == 'prismatic' else 'N m'}",
            'type = "drive_torque"',
            f'coordinate = "{name}"',
            "",
        ]
    lines += [*coordinates, "[effects.weight]", 'type = "gravity"', "direction = [0.0, 0.0, -1.0]", ""]
    lines += ["[simulation]", "duration = 0.1  # s", "step = 1e-3  # s", ""]
    return "\n".join(lines)
