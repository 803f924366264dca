"""What parts are sized by: forces in joints as polar diagrams, torques of drives over speed, rainflow matrices.

Each is drawn into axes by one function, for pictures and for the page of a run alike.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.figures import captions, style
from pgmp_petsc.figures.mechanism import paths_of
from pgmp_petsc.lanes.rainflow import cycles
from pgmp_petsc.results import Trajectory

N_BINS = 24  # of ranges and of means
ROUND_OFF = 64.0 * np.finfo(float).eps  # of a coordinate: that of a formula, through the weights of differences
TOGETHER = 1e-3  # of a body's motion: nodes nearer than that are one joint
POLAR = {"projection": "polar"}
#: outputs of multipliers, by type
OF_JOINTS = ("joint_force", "joint_torque", "drive_torque", "power")


def outputs_of(run: Trajectory, kinds: tuple[str, ...]) -> dict[str, Mapping[str, Any]]:
    """Return the entries of the outputs of some types that a run has, by name."""
    entries = style.scene_of(run.record).get("outputs", {})
    return {name: entry for name, entry in entries.items() if entry["type"] in kinds and name in run.outputs}


@dataclass(frozen=True)
class Load:
    """What one diagram shows."""

    title: str  # joint, or outputs where a joint has several diagrams
    names: tuple[str, ...]  # of the outputs


def _components(run: Trajectory) -> dict[tuple[str, str, str], dict[str, str]]:
    """Return the outputs of forces in joints by their components, by joint, which body they act on, and frame."""
    found: dict[tuple[str, str, str], dict[str, str]] = {}
    for name, entry in outputs_of(run, ("joint_force",)).items():
        of, frame = entry.get("of", "second"), entry.get("frame", "ground")
        found.setdefault((entry["joint"], of, frame), {})[entry.get("component", "magnitude")] = name
    return found


def joint_forces(run: Trajectory) -> list[Load]:
    """Return the outputs of the forces in joints along x and y, on one body in one frame."""
    found = _components(run).items()
    pairs = [(joint, (own["x"], own["y"])) for (joint, *_), own in found if {"x", "y"} <= own.keys()]
    joints = [joint for joint, _ in pairs]
    return [Load(joint if joints.count(joint) == 1 else ", ".join(names), names) for joint, names in pairs]


@dataclass(frozen=True, eq=False)
class Arrow:
    """The force in a joint at the frames of a run."""

    joint: str
    body: str  # on which it acts
    place: np.ndarray  # of the joint, shape (n_f, 3), m
    force: np.ndarray  # shape (n_f, 3), N


def arrows_of(run: Trajectory) -> tuple[list[Arrow], list[str]]:
    """Return the forces in joints whose components are all outputs, in the ground's axes, and why others have no
    arrow."""
    scene, frames = style.scene_of(run.record), run.frames
    found: list[Arrow] = []
    without: list[str] = []
    axes = "xy" if next(iter(frames.nodes.values())).shape[1] == 2 else "xyz"
    for (joint, of, frame), own in _components(run).items():
        if frame != "ground":
            words = 'no arrow of it, as it is along axes of a body; take frame = "ground"'
            without += [f"{name}: {words}" for name in own.values()]
            continue
        if not set(axes) <= own.keys():
            without.append(f"{joint}: no arrow of its force, which takes outputs {', '.join(axes)} of joint_force")
            continue
        connect = scene["joints"][joint].get("connect")
        place = None if connect is None else _place(run, connect)
        if place is None:
            without.append(f"{joint}: no arrow of its force, as the run does not say where it is")
            continue
        force = np.zeros((len(frames.time), 3))
        for k, axis in enumerate(axes):
            force[:, k] = np.interp(frames.time, run.time, run.outputs[own[axis]])
        found.append(Arrow(joint, connect[0 if of == "first" else 1].partition(":")[0], place, force))
    return found, without


def _place(run: Trajectory, connect: Sequence[str]) -> np.ndarray | None:
    paths = [paths_of(run.frames, run.record, name, run.frames.positions) for name in connect]
    first, second = (np.pad(path, ((0, 0), (0, 0), (0, 3 - path.shape[2]))) for path in paths)
    if second.shape[1] == 1:
        return second[:, 0]
    # a point of a mesh has a number that the run does not keep: where both bodies always are is the joint
    apart = np.linalg.norm(first[:, :, None] - second[:, None], axis=3).max(axis=0)
    k = np.unravel_index(np.argmin(apart), apart.shape)[1]
    return second[:, k] if apart.min() < TOGETHER * np.ptp(second, axis=(0, 1)).max() else None


def draw_force(axes: Axes, run: Trajectory, load: Load) -> str:
    """Draw the force in a joint over the run on polar axes: how large, and where it points; a dot at the largest.
    Return the title."""
    x, y = (run.outputs[name] for name in load.names)
    factor, unit = style.axis_unit(run.units.get(load.names[0], "N"), x, y)
    angle, size = np.arctan2(y, x), factor * np.hypot(x, y)
    axes.plot(angle, size, linewidth=1.2)
    most = int(np.argmax(size))
    axes.plot(angle[most], size[most], "o", color=style.QUIET, markersize=4.0)
    tried = np.arange(22.5, 360.0, 45.0)  # numbers go where there is most room for them
    apart = np.abs(np.angle(np.exp(1j * (angle[:, None] - np.radians(tried)))))
    emptiest = np.argmin(np.where(apart < np.pi / 8.0, size[:, None], 0.0).max(axis=0))
    axes.set_rlabel_position(float(tried[emptiest]))
    axes.yaxis.set_major_locator(MaxNLocator(4))
    return style.axis_label(load.title, unit)


def driven(run: Trajectory) -> list[Load]:
    """Return the outputs of what prescribed motions take."""
    return [Load(name, (name,)) for name in outputs_of(run, ("drive_torque",)) if len(run.time) > 2]


def _size(run: Trajectory, unit: str) -> float:
    """Return what a coordinate's round-off is measured by where it stays near zero: a radian, or the mechanism."""
    if unit == "rad" or run.frames is None:
        return float(unit == "rad")
    return max(float(np.ptp(places, axis=(0, 1)).max()) for places in run.frames.positions.values())


def _rate(values: np.ndarray, time: np.ndarray, size: float) -> np.ndarray:
    """Return the rate of values; one that is constant but for their round-off is drawn as one number."""
    rate = np.gradient(values, time, edge_order=2)
    round_off = ROUND_OFF * max(np.abs(values).max(), size) / np.diff(time).min()
    if np.ptp(rate) > round_off:
        return rate
    mean = float(rate.mean())
    return np.full_like(rate, 0.0 if abs(mean) <= round_off else mean)


def draw_torque(axes: Axes, run: Trajectory, load: Load) -> str:
    """Draw what a drive takes over its speed, which is the rate of the coordinates that the run keeps."""
    scene, (name,) = style.scene_of(run.record), load.names
    entry, moved = scene["outputs"][name], scene["coordinates"]
    given = {one["coordinate"] for one in scene["effects"].values() if one["type"] == "prescribed_motion"}
    wanted = entry.get("coordinate") or next(k for k in given if moved[k].get("joint") == entry["joint"])
    k = list(run.coordinate_units).index(wanted)
    speed = _rate(run.coordinates[:, k], run.time, _size(run, run.coordinate_units[wanted]))
    factor, unit = style.axis_unit(run.units.get(name, "1"), run.outputs[name])
    rate, per_second = style.axis_unit(f"{run.coordinate_units[wanted]}/s", speed)
    axes.plot(rate * speed, factor * run.outputs[name], linewidth=0.9)
    most = int(np.argmax(np.abs(run.outputs[name])))
    axes.plot(rate * speed[most], factor * run.outputs[name][most], "o", color=style.QUIET, markersize=4.0)
    axes.axhline(0.0, color=style.QUIET, linewidth=0.6)
    axes.set_xlabel(style.axis_label("speed", per_second))
    axes.set_ylabel(style.axis_label(name, unit))
    return style.axis_label(name, "1")


def counted_outputs(run: Trajectory) -> list[Load]:
    """Return the outputs whose cycles the scene of a run counts."""
    named = dict.fromkeys(entry["of"] for entry in outputs_of(run, ("rainflow",)).values())
    return [Load(name, (name,)) for name in named if name in run.outputs and len(cycles(run.outputs[name]))]


def draw_rainflow(axes: Axes, run: Trajectory, load: Load) -> str:
    """Draw how many cycles of an output have which range and mean."""
    first, second, count = cycles(run.outputs[load.names[0]]).T
    factor, unit = style.axis_unit(run.units.get(load.names[0], "1"), first, second)
    ranges, means = factor * np.abs(second - first), 0.5 * factor * (first + second)
    matrix, *edges = np.histogram2d(ranges, means, N_BINS, weights=count)
    drawn = axes.pcolormesh(*edges, np.where(matrix > 0.0, matrix, np.nan).T, cmap="viridis")
    axes.set_xlabel(style.axis_label("range", unit))
    axes.set_ylabel(style.axis_label("mean", unit))
    axes.figure.colorbar(drawn, ax=axes, label="cycles")
    return style.axis_label(load.title, "1")


@dataclass(frozen=True)
class Diagram:
    """A kind of diagram."""

    title: str  # above a picture of several
    of: Callable[[Trajectory], list[Load]]  # what a run has of them
    draw: Callable[[Axes, Trajectory, Load], str]
    lacking: str  # why a run has none
    words: str  # behind the title of one that stands alone
    about: str  # what is seen
    mark: str = ""  # what a dot is
    axes: Mapping[str, Any] | None = None


#: by the name of their pictures
DIAGRAMS = {
    "forces": Diagram(
        "Forces in joints",
        joint_forces,
        draw_force,
        "no joint has its forces along x and y among the outputs; add two of type joint_force",
        ", polar",
        "Size and direction of the force over the run; the dot is the largest.",
        "the largest",
        POLAR,
    ),
    "torques": Diagram(
        "Drives over their speed",
        driven,
        draw_torque,
        "the scene has no output of type drive_torque; add one",
        " over speed",
        "The dot is the largest.",
        "the largest",
    ),
    "rainflow": Diagram(
        "Rainflow matrix",
        counted_outputs,
        draw_rainflow,
        "the scene counts no cycles; add an output of type rainflow",
        ", rainflow matrix",
        "Cycles of the run by range and mean.",
    ),
}


@style.styled
def loads(run: Trajectory, kind: str, label: str = "") -> Figure:
    """Draw all diagrams of a kind, one of `DIAGRAMS`, that a run has. Raises `InputError` if there is none."""
    diagram = DIAGRAMS[kind]
    found = diagram.of(run)
    if not found:
        raise InputError(diagram.lacking)
    figure, blocks = style.panel_grid(len(found), (3.7, 3.4), 0.65, 5.0, subplot_kw=diagram.axes)
    for (axes,), load in zip(blocks, found):
        axes.set_title(diagram.draw(axes, run, load))
    look = {"color": style.QUIET, "linestyle": "none", "marker": "o", "markersize": 4.0}
    keys = [Line2D([], [], label=diagram.mark, **look)] if diagram.mark else []
    what = style.heading(f"{diagram.title}, {style.MODELS[run.model]}", run.record, label)
    return style.top_legend(figure, keys, what, captions.of_runs([run], [label]))
