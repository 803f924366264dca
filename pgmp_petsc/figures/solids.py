"""Bodies drawn in space, without a screen: pyvista and VTK make the picture, matplotlib draws its surround, with title,
units, scale and notes. There are pictures, films (MP4, or GIF) and meshed parts with their named faces, or those of
whole cylinders. Both libraries are imported when something is drawn. Where there is no display, VTK draws by EGL or
OSMesa."""

from __future__ import annotations

import ctypes
import os
import subprocess
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import closing, suppress
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from tempfile import TemporaryFile
from types import ModuleType
from typing import TYPE_CHECKING

import matplotlib
import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import Normalize, to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from PIL import Image

from pgmp_petsc.base.errors import InputError, RunError
from pgmp_petsc.figures import style
from pgmp_petsc.figures.motion import Motion, Skin, drawn_faces, motion_of, normals
from pgmp_petsc.files.claims import replacing
from pgmp_petsc.mesh.meshes import SolidMesh
from pgmp_petsc.ranks.ending import child
from pgmp_petsc.results import Trajectory

if TYPE_CHECKING:
    import pyvista

COLOURS = "viridis"
RIGID, PLAIN = "#B9BEC4", "#7FA6C9"
EDGE = "#3A3A3A"
FORCE = "#A32A00"
WINDOWS = {"vtkEGLRenderWindow": "libEGL.so.1", "vtkOSOpenGLRenderWindow": "libOSMesa.so.8"}
OLDEST = (9, 4)  # of VTK: older ones end the process where there is no display
THINNEST = 1.5e-3  # radius of beams over the size of the picture: thinner ones are drawn so
MARGIN = 1.06
TILT = (0.5, 0.4)  # how far from the axis of least extent a mechanism in space is seen: along up and to the side
SPLIT = 35.0  # degrees between neighbouring faces beyond which an edge is sharp


def drawing() -> ModuleType:
    """Return pyvista, ready to draw without a screen. Raises `InputError` if it cannot be imported, or cannot draw
    here; with the cure."""
    try:
        if not os.environ.get("DISPLAY"):
            # VTK looks for a display first, and complains of none; without the library that it needs it crashes
            os.environ.setdefault("VTK_DEFAULT_OPENGL_WINDOW", _window_without_display())
        import pyvista
    except ImportError as error:
        raise InputError(
            f"surfaces are drawn by pyvista, which cannot be imported ({error}); pip install 'pyvista<0.47', or look "
            "at mechanism.png of pgmp plot"
        ) from error
    found = tuple(pyvista.vtk_version_info)[:2]
    if found < OLDEST and not os.environ.get("DISPLAY"):
        raise InputError(
            f"surfaces: VTK {'.'.join(map(str, found))} cannot draw without a display; pip install 'vtk>=9.4', or set "
            "DISPLAY"
        )
    return pyvista


def _window_without_display() -> str:
    """Return the kind of VTK's window that draws without a display."""
    for window, library in WINDOWS.items():
        with suppress(OSError):
            ctypes.CDLL(library)
            return window
    raise InputError(
        f"surfaces cannot be drawn without a display: none of {', '.join(WINDOWS.values())} is installed; on Debian "
        "apt-get install libegl1 libgl1-mesa-dri, or set DISPLAY"
    )


def view_of(points: np.ndarray, flat: bool) -> np.ndarray:
    """Return the directions of a picture to the right, up and towards the eye, shape (3, 3), for places (n, 3)."""
    if flat:
        return np.eye(3)
    thin, up = int(np.argmin(np.ptp(points, axis=0))), np.eye(3)[style.upward(points)]
    towards = np.eye(3)[thin] * (-1.0 if thin == 1 else 1.0)
    side = np.cross(up, towards)
    eye = towards + TILT[0] * up + TILT[1] * side
    eye /= np.linalg.norm(eye)
    right = np.cross(up, eye)
    right /= np.linalg.norm(right)
    return np.array([right, np.cross(eye, right), eye])


#: Draws a part of the stage as it is at the instant of a number.
Show = Callable[[int], object]


class Stage:
    """Bodies in front of a camera that sees all of their motion, in a picture of so many pixels; to be closed.

    `metre` is in pixels a metre across the line of sight.
    """

    def __init__(self, motion: Motion, width: int, height: int) -> None:
        pyvista = drawing()
        low, high, view = bounds_of(motion)
        half = MARGIN * 0.5 * np.maximum(high - low, 1e-12)
        reach = max(half[1], half[0] * height / width)
        self.metre = 0.5 * height / reach
        thinnest = THINNEST * 2.0 * reach * width / height
        self._plotter = pyvista.Plotter(off_screen=True, window_size=[width, height], lighting="light kit")
        try:
            self._plotter.set_background("white")
            self._plotter.enable_anti_aliasing("ssaa")
            self._shows: list[Show] = [
                _surface(pyvista, self._plotter, skin, motion) if len(skin.triangles)
                else _tubes(pyvista, self._plotter, skin, motion, thinnest) for skin in motion.skins
            ]  # fmt: skip
            depth = float(np.ptp(motion.points @ view[2]))
            # in front of all bodies; without perspective that is the same place of the picture
            before = (depth + 2.0 * max(skin.radius for skin in motion.skins)) * view[2]
            for arrow in motion.arrows:
                ends = arrow.place + before, motion.end(arrow) + before
                self._shows.append(_arrow(pyvista, self._plotter, *ends, 1.4e-2 * reach))
            centre = 0.5 * (low + high)
            middle = centre @ view[:2] + float(np.mean(motion.points @ view[2])) * view[2]
            camera, away = self._plotter.camera, 2.0 * (depth + reach)
            camera.parallel_projection = True
            camera.focal_point, camera.position = middle, middle + away * view[2]
            camera.up, camera.parallel_scale = view[1], reach
            camera.clipping_range = (1e-3 * away, 4.0 * away)
        except BaseException:
            self.close()
            raise

    def picture(self, number: int) -> np.ndarray:
        """Return the picture of an instant, shape (height, width, 3), of bytes."""
        for show in self._shows:
            show(number)
        self._plotter.render()
        return np.asarray(self._plotter.screenshot(return_img=True, transparent_background=False))[:, :, :3]

    def close(self) -> None:
        """Free what VTK holds."""
        self._plotter.close()


def bounds_of(motion: Motion) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the corners (2,) of what a picture has to hold, in its own directions, m, and these, shape (3, 3)."""
    points = motion.points
    view = view_of(points, motion.flat)
    across = points @ view[:2].T
    thick = max(skin.radius for skin in motion.skins)
    return across.min(axis=0) - thick, across.max(axis=0) + thick, view


def _surface(pyvista: ModuleType, plotter: pyvista.Plotter, skin: Skin, motion: Motion) -> Show:
    """Put a surface on the stage, with its nodes split at sharp edges."""
    curved = skin.points[..., 2].any()
    mesh = pyvista.PolyData(skin.points[0].astype(float), faces=_counted(skin.triangles))
    mesh["number"] = np.arange(skin.points.shape[1])
    if curved:
        mesh = mesh.compute_normals(cell_normals=False, split_vertices=True, feature_angle=SPLIT)
    edges = pyvista.PolyData(skin.points[0].astype(float), lines=_counted(skin.edges))

    def show(number: int) -> None:
        mesh.points = skin.points[number][mesh["number"]]
        if skin.values is not None:
            mesh["rgb"] = _bytes(skin.values[number][mesh["number"]], motion.largest)
        if curved:
            mesh.compute_normals(cell_normals=False, split_vertices=False, consistent_normals=False, inplace=True)
        edges.points = skin.points[number]

    show(0)
    plotter.add_mesh(mesh, smooth_shading=not motion.flat, lighting=not motion.flat, **_look(skin))
    actor = plotter.add_mesh(edges, color=EDGE, line_width=1.0, opacity=0.45, lighting=False)
    actor.mapper.resolve = "polygon_offset"
    return show


def _tubes(pyvista: ModuleType, plotter: pyvista.Plotter, skin: Skin, motion: Motion, thinnest: float) -> Show:
    """Put beams on the stage as tubes, or a point mass as a ball."""
    radius, line = max(skin.radius, thinnest), None
    if len(skin.edges):
        line = pyvista.PolyData(skin.points[0].astype(float), lines=_counted(skin.edges))
        line["number"] = np.arange(skin.points.shape[1])
        line = line.strip()

    def shape(number: int) -> pyvista.PolyData:
        if line is None:
            return pyvista.Sphere(radius=3.0 * radius, center=skin.points[number][0])
        line.points = skin.points[number][line["number"]]
        if skin.values is not None:
            line["rgb"] = _bytes(skin.values[number][line["number"]], motion.largest)
        tube = line.tube(radius=radius, n_sides=20, capping=True)
        if skin.values is not None:
            tube.set_active_scalars("rgb")  # VTK draws what is active
        return tube

    mesh = shape(0)
    plotter.add_mesh(mesh, smooth_shading=True, lighting=True, **_look(skin))
    return lambda number: mesh.copy_from(shape(number))


def _arrow(
    pyvista: ModuleType, plotter: pyvista.Plotter, starts: np.ndarray, ends: np.ndarray, thickest: float
) -> Show:
    """Put a force on the stage, an arrow of one thickness from starts to ends (n_f, 3)."""

    def shape(number: int) -> pyvista.PolyData:
        way = ends[number] - starts[number]
        length = max(float(np.linalg.norm(way)), 1e-3 * thickest)
        thick = min(thickest, 0.2 * length)
        return pyvista.Arrow(
            start=starts[number], direction=way if way.any() else (1.0, 0.0, 0.0), scale=length,
            shaft_radius=thick / length, tip_radius=2.5 * thick / length, tip_length=min(6.0 * thick / length, 0.5),
        )  # fmt: skip

    mesh = shape(0)
    plotter.add_mesh(mesh, color=FORCE, lighting=False)
    return lambda number: mesh.copy_from(shape(number))


def _look(skin: Skin) -> dict[str, object]:
    look = {"ambient": 0.3, "diffuse": 0.75, "specular": 0.1, "show_scalar_bar": False}
    if skin.values is None:
        return look | {"color": RIGID if skin.rigid else PLAIN}
    return look | {"rgb": True, "scalars": "rgb"}


def _bytes(values: np.ndarray, largest: float) -> np.ndarray:
    return (255.0 * colours_of(values, largest)).round().astype(np.uint8)


def colours_of(values: np.ndarray, largest: float) -> np.ndarray:
    """Return the colours of values (n,), shape (n, 3); what is not known is grey."""
    found = matplotlib.colormaps[COLOURS](values / max(largest, 1e-300))[:, :3]
    found[~np.isfinite(values)] = to_rgb(style.QUIET)
    return found


def _counted(cells: np.ndarray) -> np.ndarray:
    return np.column_stack([np.full(len(cells), cells.shape[1]), cells]).ravel()


WIDTH = 8.6  # inches
LOWEST, HIGHEST = 2.2, 6.6


@style.styled
def solids(run: Trajectory, at: float | None = None, exaggeration: float = 1.0, label: str = "") -> Figure:
    """Draw the bodies of a run, with frames and fields, which `label` tells from others, with von Mises' stress in
    colour.

    Drawn and named is the frame nearest to the instant `at`, s, by default that of the largest stress. The
    exaggeration, a factor on the deformation, is stated in the picture if it is not 1. Raises `InputError` if there is
    nothing to draw, `at` is outside the run, or there is nothing to draw with.
    """
    motion = motion_of(run, "mises", exaggeration, label)
    number, why = motion.peak, ", when it is largest"
    if at is not None:
        number, why = frame_at(run, at), ""
    return still(motion, number, why)


def frame_at(run: Trajectory, at: float) -> int:
    """Return the number of the frame nearest to an instant, s; raises `InputError` if that is outside the run."""
    time = run.frames.time
    if not time[0] <= at <= time[-1]:
        raise InputError(f"--at {at:g}: outside the run, which goes from {time[0]:g} to {time[-1]:g} s")
    return int(np.argmin(np.abs(time - at)))


def has_solids(run: Trajectory) -> bool:
    """Tell whether a run has surfaces to draw."""
    return any(own.kind != "line" for own in run.fields.values())


@style.styled
def still(motion: Motion, number: int, why: str = "") -> Figure:
    """Return the picture of an instant; `why` follows its caption."""
    motion = motion.only(number)
    frame = Surround(motion, motion.captions[0] + why)
    with closing(Stage(motion, *frame.size)) as stage:
        frame.measure(stage.metre, motion.metre)
        frame.axes.imshow(stage.picture(0), interpolation="antialiased", aspect="auto")
    return frame.figure


@style.styled
def images(motion: Motion, numbers: np.ndarray, resolution: int = style.RESOLUTION) -> Iterator[np.ndarray]:
    """Return an iterator over the pictures of instants, all of one size, as bytes of shape (height, width, 3); raises
    `InputError` if there is nothing to draw with."""
    drawing()
    return _images(motion, numbers, Surround(motion, "", resolution))


def _images(motion: Motion, numbers: np.ndarray, frame: Surround) -> Iterator[np.ndarray]:
    with closing(Stage(motion, *frame.size)) as stage:
        frame.measure(stage.metre, motion.metre)
        for number in numbers:
            yield frame.around(stage.picture(number), motion.captions[number])


class Surround:
    """Surround of the bodies: title, notes, bar of the colours, bar of the scale, and the instant with its caption.

    `resolution` is in pixels an inch; `axes` is where in the figure the bodies are, in `size`, pixels.
    """

    def __init__(self, motion: Motion, caption: str, resolution: int = style.RESOLUTION) -> None:
        low, high, _ = bounds_of(motion)
        extent = np.maximum(high - low, 1e-12)
        height = float(np.clip((WIDTH - 1.3) * extent[1] / extent[0], LOWEST, HIGHEST))
        self.figure = style.new_figure(WIDTH, height + 1.1)
        self.figure.set_dpi(resolution)
        self.axes = self.figure.subplots()
        self.axes.set(xticks=[], yticks=[])
        self.axes.spines[:].set_visible(False)
        self.axes.set_xlabel("t = 0.0000 s", loc="right")
        if motion.quantity:
            colours = ScalarMappable(Normalize(0.0, motion.largest or 1.0), matplotlib.colormaps[COLOURS])
            bar = self.figure.colorbar(colours, ax=self.axes, pad=0.01, aspect=26, shrink=0.9)
            bar.outline.set_visible(False)
            bar.set_label(motion.quantity)
        # what grey and plain bodies are, where they are beside coloured ones
        rigid = [skin.rigid for skin in motion.skins]
        plain = {skin.is_span for skin in motion.skins if not skin.rigid and skin.values is None}
        keys = [Patch(color=RIGID, label="rigid")] if any(rigid) and not all(rigid) else []
        if motion.quantity:
            keys += [Patch(color=PLAIN, label="flexible, not coloured")] if False in plain else []
            keys += [Line2D([], [], color=PLAIN, label="acts between two points")] if True in plain else []
        keys += [Patch(color=FORCE, label=motion.forces)] if motion.forces else []
        style.top_legend(self.figure, keys, motion.title, motion.notes)
        self.figure.set_figheight(round(self.figure.get_figheight() * resolution / 2) * 2 / resolution)
        self.figure.canvas.draw()
        # the layout is found: what is written from here on moves nothing
        self.figure.set_layout_engine("none")
        self._box = self.axes.get_window_extent()
        self.size = int(round(self._box.width)), int(round(self._box.height))
        self._caption = self.axes.set_xlabel(caption, loc="right")

    def measure(self, metre: float, unit: str) -> None:
        """Draw a bar of a round length below the bodies, of which a unit of length has so many pixels."""
        nice = style.round_below(self.size[0] / 5.0 / metre)
        factor, unit = style.axis_unit(unit, np.array([nice]))
        share = nice * metre / self.size[0]
        below = {"transform": self.axes.transAxes, "clip_on": False, "color": style.QUIET}
        at = -9.0 / self.size[1] * style.RESOLUTION / 72.0
        self.axes.plot([0.0, share], [at, at], linewidth=1.6, **below)
        beside = {"transform": self.axes.transAxes, "va": "center", "color": style.QUIET}
        self.axes.text(share + 0.01, at, f"{nice * factor:g} {unit}", **beside)

    def around(self, picture: np.ndarray, caption: str) -> np.ndarray:
        """Return a picture of the bodies with its surround, as bytes of shape (height, width, 3)."""
        self._caption.set_text(caption)
        self.figure.canvas.draw()
        whole = np.asarray(self.figure.canvas.buffer_rgba())[:, :, :3].copy()
        left, top = int(round(self._box.x0)), whole.shape[0] - int(round(self._box.y1))
        whole[top : top + self.size[1], left : left + self.size[0]] = picture
        return whole


GIF, MP4 = ".gif", ".mp4"
RESOLUTIONS = {GIF: 80, MP4: 120}  # pixels an inch
QUALITY = "10"  # of x264, from 0, without losses, to 51
N_COLOURS = 128  # of a GIF
SLOWEST = 655.0  # s that a GIF may show a picture: two bytes of hundredths
FASTEST = 50.0  # pictures a second that a GIF may have: its times are whole hundredths


@dataclass(frozen=True)
class Pace:
    """Which instants a film shows, and how fast."""

    numbers: np.ndarray  # of the instants, in their order
    rate: float  # pictures a second

    @property
    def seconds(self) -> float:
        return len(self.numbers) / self.rate

    @classmethod
    def of(cls, n: int, rate: float, seconds: float | None) -> Pace:
        """Choose from n instants: all of them, or as many as fit into the time; no picture twice.

        A film that is to take longer than all instants do at this rate shows them more slowly.
        """
        if seconds is None:
            return cls(np.arange(n), rate)
        wanted = max(1, round(seconds * rate))
        if wanted >= n:
            return cls(np.arange(n), n / seconds)
        return cls(np.unique(np.linspace(0, n - 1, wanted).round().astype(int)), rate)


def write_film(motion: Motion, path: Path, pace: Pace) -> int:
    """Write a film, whole or not at all, and return how many pictures it has; by one process. Raises `InputError` if
    there is nothing to draw or to write it with; `RunError` if the system, or what makes the film, fails."""
    ending = path.suffix.lower()
    if ending == GIF and 1.0 / pace.rate > SLOWEST:
        raise InputError(
            f"--seconds: a GIF shows one picture for {SLOWEST:g} s at most, and these would take "
            f"{1.0 / pace.rate:.4g} s each; give fewer seconds, or name the film .mp4"
        )
    pictures = images(motion, pace.numbers, RESOLUTIONS[ending])
    with replacing(path, "film") as partial:
        (_write_gif if ending == GIF else _write_mp4)(pictures, partial, pace.rate)
    return len(pace.numbers)


def _write_gif(pictures: Iterable[np.ndarray], path: Path, rate: float) -> None:
    first, *rest = [Image.fromarray(picture) for picture in pictures]
    palette = first.quantize(N_COLOURS)
    # one palette for all: colours mean the same in every picture
    same = [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in (first, *rest)]
    duration = max(1, round(100.0 / min(rate, FASTEST))) * 10
    with open(path, "wb") as stream:
        same[0].save(
            stream, format="GIF", save_all=True, append_images=same[1:], duration=duration, loop=0,
            comment=style.PROGRAM.encode(),
        )  # fmt: skip


def _write_mp4(pictures: Iterator[np.ndarray], path: Path, rate: float) -> None:
    try:
        import imageio_ffmpeg
    except ImportError as error:
        raise InputError(
            f"MP4 is written by imageio-ffmpeg, which cannot be imported ({error}); pip install imageio-ffmpeg, or "
            "name the film .gif"
        ) from error
    first = next(pictures)
    height, width = (length - length % 2 for length in first.shape[:2])
    command = [
        imageio_ffmpeg.get_ffmpeg_exe(), "-y", "-v", "error",
        "-f", "rawvideo", "-s", f"{width}x{height}", "-pix_fmt", "rgb24", "-r", str(Fraction(rate).limit_denominator()),
        "-i", "-", "-an", "-vcodec", "libx264", "-pix_fmt", "yuv420p", "-crf", QUALITY,
        "-metadata", f"comment={style.PROGRAM}", "-f", "mp4", "-movflags", "+faststart", path,
    ]  # fmt: skip
    with TemporaryFile() as said:
        with child(command, stdin=subprocess.PIPE, stderr=said) as ffmpeg:
            with suppress(BrokenPipeError):  # it has ended, and its status says so
                for picture in (first, *pictures):
                    ffmpeg.stdin.write(np.ascontiguousarray(picture[:height, :width]))
                ffmpeg.stdin.close()
            ffmpeg.wait()
        if ffmpeg.returncode != 0:
            said.seek(0)
            lines = said.read().decode(errors="replace").split("\n")
            raise RunError(f"the film could not be written: {lines[0] or f'ffmpeg ended with {ffmpeg.returncode}'}")


STEEL, LIT = np.array([0.72, 0.74, 0.77]), np.array([0.35, -0.5, 0.79])
FRAME, LABEL = 0.9, 0.14  # shares of half the extent: what the axes show, and the height of a name
CELLS = {"edgecolors": (0.2, 0.2, 0.2, 0.35), "linewidths": 0.25}
MOST_FACES = 16  # that have a name in a picture


def meshed_part(mesh: SolidMesh, body: str, unit: str) -> Figure:
    """Return the picture of a meshed part with its named groups of faces, those of most faces where there are many."""
    named = sorted(mesh.groups, key=lambda name: -len(mesh.groups[name]))
    shown = {name: mesh.nodes[np.unique(mesh.groups[name])].mean(axis=0) for name in sorted(named[:MOST_FACES])}
    more = f", {len(named) - MOST_FACES} more have names" if len(named) > MOST_FACES else ""
    title = f"{body}: {len(mesh.cells)} cells, {'named faces' if named else 'no face has a name'}{more}"
    return (plane_part if mesh.dimension == 2 else part_picture)(mesh, shown, title, unit)


@style.styled
def plane_part(mesh: SolidMesh, places: Mapping[str, np.ndarray], title: str, unit: str) -> Figure:
    """Return the cells of a plane mesh, with named groups of edges coloured and named at their places (2,)."""
    middle, half = 0.5 * (mesh.nodes.max(axis=0) + mesh.nodes.min(axis=0)), 0.5 * np.ptp(mesh.nodes, axis=0)
    half = np.maximum(1.2 * half, LABEL * half.max())
    figure = style.new_figure(8.0, float(np.clip(8.0 * half[1] / half[0], 1.2, 7.0)) + 0.8)
    axes = figure.subplots()
    cells = mesh.nodes[drawn_faces(mesh.kind, mesh.cells)]
    axes.add_collection(PolyCollection(cells, facecolors="#E8EAED", edgecolors="#B5BBC2", linewidths=0.5))
    for (name, place), colour in zip(places.items(), style.distinct_colours(len(places))):
        edges = mesh.nodes[mesh.groups[name][:, :2]]
        axes.add_collection(LineCollection(edges, colors=colour, linewidths=3.0, zorder=3))
        axes.annotate(name, place, xytext=(6, 6), textcoords="offset points", color=colour, fontweight="bold", zorder=4)
    axes.set_aspect("equal")
    limits = [(m - h, m + h) for m, h in zip(middle, half)]
    axes.set(xlim=limits[0], ylim=limits[1], xlabel=f"x ({unit})", ylabel=f"y ({unit})")
    axes.yaxis.set_major_locator(MaxNLocator(3))
    axes.set_title(title, loc="left", weight="bold")
    return figure


@style.styled
def part_picture(mesh: SolidMesh, places: Mapping[str, np.ndarray], title: str, unit: str) -> Figure:
    """Return the surface of a mesh, with named groups coloured and named at their places (3,)."""
    figure = style.new_figure(8.0, 6.0)
    axes = figure.add_subplot(projection="3d", computed_zorder=False)
    bare = drawn_faces(mesh.kind, mesh.cells)
    owned = {frozenset(face[: bare.shape[1]].tolist()): name for name in places for face in mesh.groups[name]}
    colours = dict(zip(places, style.distinct_colours(len(places))))
    shade = 0.55 + 0.45 * np.clip(normals(bare, mesh.nodes) @ LIT, 0.0, 1.0)
    own = [owned.get(frozenset(face.tolist())) for face in bare]
    base = np.array([STEEL if name is None else to_rgb(colours[name]) for name in own])
    axes.add_collection3d(Poly3DCollection(mesh.nodes[bare], facecolors=shade[:, None] * base, **CELLS))
    middle, half = 0.5 * (mesh.nodes.max(axis=0) + mesh.nodes.min(axis=0)), 0.5 * np.ptp(mesh.nodes, axis=0)
    across, seen = int(np.argmin(half)), list[np.ndarray]()
    for name, place in places.items():
        text = place.copy()
        beside = sum(float(np.abs(np.delete(place - one, across)).max()) < LABEL * half.max() for one in seen)
        text[across] += (0.3 + LABEL * beside) * half.max()  # one above the other on one axis
        seen.append(place)
        outlined = {"color": colours[name], "path_effects": [withStroke(linewidth=3.0, foreground="white")]}
        axes.plot(*np.array([place, text]).T, linewidth=1.0, zorder=5, clip_on=False, **outlined)
        axes.text(*text, name, ha="center", va="bottom", zorder=6, fontweight="bold", **outlined)
    limits = [
        (m - max(FRAME * h, 0.2 * half.max()), m + max(FRAME * h, 0.2 * half.max())) for m, h in zip(middle, half)
    ]
    axes.set(xlim=limits[0], ylim=limits[1], zlim=limits[2])
    axes.set_title(title, loc="left", weight="bold")
    axes.set_box_aspect([high - low for low, high in limits])
    for name, (low, high) in zip("xyz", limits):
        getattr(axes, f"{name}axis").set_major_locator(MaxNLocator(5 if high - low > half.max() else 2))
        getattr(axes, f"set_{name}label")(f"{name} ({unit})")
    return figure
