"""The gallery: a small picture of every scene, with the mechanism at several instants and one telling curve.

Solids are shown by their surfaces, with von Mises' stress in colour.

    python -m scripts.portraits RUNS IMAGES

Read from the directory RUNS: ``<scene>.h5``, trajectories with frames, which `scripts/gallery` leaves there. Written to
IMAGES: ``gallery_<scene>.png``.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from PIL import Image

from benchmarks.programs import guarded
from pgmp_petsc.base.errors import InputError
from pgmp_petsc.figures.mechanism import Shapes, TimeColours
from pgmp_petsc.figures.motion import motion_of
from pgmp_petsc.figures.solids import COLOURS, Stage, bounds_of, has_solids
from pgmp_petsc.figures.style import QUIET, axis_label, axis_unit, new_figure, round_below, save, styled, top_legend
from pgmp_petsc.results import Trajectory

WIDTH, HEIGHT = 5.4, 2.65
NARROWEST, WIDEST = 0.34, 0.54  # shares of the width that the mechanism may take
FOOT = 0.14  # room for the scale below the mechanism, as a share of its height
N_COLOURS = 256


@dataclass(frozen=True)
class Portrait:
    """Picture and curve of a scene."""

    title: str  # above the picture
    output: str  # the output whose curve is drawn
    exaggeration: float = 1.0  # factor on the deformation of the shapes
    until: float | None = None  # instant (s) of the last shape; None for the end of the run. The curve shows all of it.
    n_instants: int = 9  # number of shapes


PORTRAITS = {
    "four_bar": Portrait("Four-bar linkage", "coupler_bending", 50.0, until=0.785, n_instants=6),
    "five_bar": Portrait("Five-bar linkage", "tip_deformation", 3000.0, n_instants=7),
    "double_pendulum": Portrait("Double pendulum", "tip_deformation", 1000.0, until=0.8, n_instants=8),
    "slider_crank_effects": Portrait("Slider-crank with every effect", "rod_bending", 50.0, until=0.72, n_instants=8),
    "spinning_beam": Portrait("Spin-up of a beam", "tip_deflection", 5.0, until=7.0),
    "quick_return": Portrait("Quick-return mechanism", "ram_deformation", 5.0, until=0.59, n_instants=7),
    "geared_five_bar": Portrait("Geared five-bar linkage", "bending", 100.0, n_instants=7),
    "geared_four_bar": Portrait("Geared four-bar linkage", "bending", 1000.0, n_instants=6),
    "machine_on_mounts": Portrait("Machine frame on mounts", "shake", until=1.3, n_instants=6),
    "bridge_crane": Portrait("Bridge crane", "sag", 20.0, until=8.0, n_instants=6),
    "servo_arm": Portrait("Servo arm", "tip_deformation", 30.0, until=0.6, n_instants=7),
    "worn_slider_crank": Portrait("Slider-crank with a worn pin", "way", until=0.117, n_instants=6),
    "crank_press": Portrait("Crank press", "bearing_force", 50.0, until=0.395, n_instants=6),
    "engine": Portrait("Two-stroke engine", "rod_force", 20.0, until=0.0105, n_instants=5),
    "double_four_bar": Portrait("Double four-bar, rigid", "pin_x", until=1.7, n_instants=6),
    "delta_robot": Portrait("Delta robot", "sway", 20.0, until=0.3, n_instants=5),
    "palletizer": Portrait("Palletizer", "sway", 10.0, until=0.5, n_instants=5),
    "spatial_slider_crank": Portrait("Spatial slider-crank of solids", "slider_position", n_instants=4),
}


@styled
def portrait(run: Trajectory, shown: Portrait) -> Figure:
    """Draw a run's shapes, equally spaced in the motion of its coordinates, beside the curve of an output.

    Dots on the curve have the colours of the shapes; those of surfaces are their stresses, and dots are grey. Raises
    `InputError` if the run has no frames or not this output.
    """
    if run.frames is None or shown.output not in run.outputs:
        raise InputError(
            f"the run has no frames or no output '{shown.output}'; simulate the scene with simulation.frames=401"
        )
    if has_solids(run):
        return _portrait_of_solids(run, shown)
    factor, unit = axis_unit(run.record.system.unit("m"), *run.frames.positions.values())
    shapes = Shapes.of(run.frames, shown.exaggeration, factor)
    low, high = shapes.limits
    share = np.clip((HEIGHT - 0.6) / WIDTH * (high - low)[0] / (high - low)[1], NARROWEST, WIDEST)
    figure = new_figure(WIDTH, HEIGHT)
    # figures of their own: the mechanism then takes the whole height, not that of the curve without its labels
    left, right = (part.subplots() for part in figure.subfigures(1, 2, width_ratios=[share, 1.0 - share]))
    instants = spaced_by_motion(run, shown.n_instants, shown.until)
    # by their order, not by time: a mechanism that speeds up would be dark in nearly all of them
    colours = TimeColours.over(np.arange(len(instants)))

    shapes.draw_paths(left)
    shapes.draw_ground(left, size=18.0)
    for order, number in enumerate(instants[:-1]):
        shapes.draw(left, number, colours.at(order, strength=0.75), width=1.5, pin=2.8, zorder=2 + order)
    last = len(instants) - 1
    shapes.draw(left, instants[last], colours.at(last), width=2.6, pin=4.6, zorder=3 + last)
    _draw_scale(left, shapes, unit)
    left.set_xlim(low[0], high[0])
    left.set_ylim(low[1] - FOOT * (high - low)[1], high[1])
    left.set_aspect("equal")
    left.axis("off")
    _draw_curve(right, run, shown.output, run.frames.time[instants], colours.at)
    return top_legend(figure, shapes.keys(), f"{shown.title}{_enlarged(shown)}")


def _enlarged(shown: Portrait) -> str:
    return f", deformation × {shown.exaggeration:g}" if shown.exaggeration != 1.0 else ""


def _portrait_of_solids(run: Trajectory, shown: Portrait) -> Figure:
    """As `portrait`, with the surfaces of all instants in front of one camera."""
    motion = motion_of(run, scale=shown.exaggeration)
    # at the start nothing is stressed; the colours reach up to the instant of the largest stress
    instants = np.unique([*spaced_by_motion(run, shown.n_instants, shown.until)[1:], motion.peak])
    motion = motion.together(instants)
    low, high, _ = bounds_of(motion)
    share = np.clip((HEIGHT - 0.6) / WIDTH * (high - low)[0] / (high - low)[1] + 0.1, NARROWEST, WIDEST)
    figure = new_figure(WIDTH, HEIGHT)
    left, right = (part.subplots() for part in figure.subfigures(1, 2, width_ratios=[share, 1.0 - share]))
    left.axis("off")
    colours = ScalarMappable(Normalize(0.0, motion.largest or 1.0), matplotlib.colormaps[COLOURS])
    bar = left.figure.colorbar(colours, ax=left, location="bottom", shrink=0.8, aspect=30, pad=0.02)
    bar.outline.set_visible(False)
    bar.set_label(motion.quantity, fontsize=8.5)
    _draw_curve(right, run, shown.output, run.frames.time[instants], lambda order: QUIET)
    top_legend(figure, (), f"{shown.title}{_enlarged(shown)}")
    figure.canvas.draw()
    figure.set_layout_engine("none")
    box = left.get_window_extent()
    with Stage(motion, round(box.width), round(box.height)) as stage:
        left.imshow(stage.picture(0), aspect="auto")
    return figure


def spaced_by_motion(run: Trajectory, n_instants: int, until: float | None) -> np.ndarray:
    """Return the numbers of frames between which the coordinates turn by about the same angle.

    At most `n_instants` of them, fewer where there are few frames; none after the instant `until` (s).
    """
    time = run.frames.time
    steps = np.abs(np.diff(run.coordinates, axis=0)).sum(axis=1)
    turned = np.interp(time, run.time, np.concatenate([[0.0], np.cumsum(steps)]))
    turned = turned if until is None else turned[: np.searchsorted(time, until, side="right")]
    return np.unique(np.searchsorted(turned, np.linspace(0.0, turned[-1], n_instants)))


def draw(runs: Path, images: Path) -> list[Path]:
    """Draw the portraits of all scenes and return their paths. Raises `InputError` if a run is missing or damaged."""
    read = {name: Trajectory.read(runs / f"{name}.h5") for name in PORTRAITS}
    images.mkdir(parents=True, exist_ok=True)
    return [_save_small(portrait(run, PORTRAITS[name]), images / f"gallery_{name}.png") for name, run in read.items()]


def _save_small(figure: Figure, path: Path) -> Path:
    """Write a figure as PNG of few colours: a third of the size, and no difference to the eye."""
    with Image.open(save(figure, path)) as picture:
        few = picture.convert("RGB").quantize(N_COLOURS, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
    few.save(path, optimize=True)
    return path


def _draw_scale(axes: Axes, shapes: Shapes, unit: str) -> None:
    """Draw a line of a round length below the mechanism."""
    low, high = shapes.limits
    length = round_below(0.3 * (high - low).max())
    x, y = low[0], low[1] - 0.7 * FOOT * (high - low)[1]
    axes.plot([x, x + length], [y, y], color=QUIET, linewidth=1.6, clip_on=False, solid_capstyle="butt")
    beside = {"xytext": (4, 0), "textcoords": "offset points", "va": "center", "annotation_clip": False}
    axes.annotate(f"{length:g} {unit}", (x + length, y), fontsize=8.5, color=QUIET, **beside)


def _draw_curve(axes: Axes, run: Trajectory, output: str, instants: np.ndarray, colour: Callable) -> None:
    values = run.outputs[output]
    factor, unit = axis_unit(run.units.get(output, "1"), values)
    axes.plot(run.time, values * factor, color=QUIET, linewidth=1.1)
    for order, instant in enumerate(instants):
        value = np.interp(instant, run.time, values) * factor
        axes.plot(instant, value, "o", color=colour(order), markersize=5.0, zorder=3, clip_on=False)
    axes.set_title(axis_label(output, unit), fontsize=9.5)
    axes.set_xlabel("time (s)")
    axes.set_xlim(run.time[0], run.time[-1])


def main() -> int:
    """Draw the gallery on the command line."""
    if len(sys.argv) != 3:
        print("usage: python -m scripts.portraits RUNS IMAGES", file=sys.stderr)
        return 2
    return guarded(lambda: print(*draw(*map(Path, sys.argv[1:])), sep="\n"))


if __name__ == "__main__":
    sys.exit(main())
