"""Surfaces of bodies in colours, with title, units, scale and notes around them: as pictures, and for films."""

from __future__ import annotations

from collections.abc import Iterator

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from pgmp_petsc.figures.motion import Motion, motion_of
from pgmp_petsc.figures.stage import COLOURS, PLAIN, RIGID, Stage, bounds_of, drawing
from pgmp_petsc.figures.style import QUIET, RESOLUTION, axis_unit, new_figure, styled, top_legend
from pgmp_petsc.results import Trajectory
from pgmp_petsc.runtime.errors import InputError

WIDTH = 8.6  # inches
LOWEST, HIGHEST = 2.2, 6.6


@styled
def solids(run: Trajectory, at: float | None = None, exaggeration: float = 1.0, label: str = "") -> Figure:
    """Draw the bodies of a run with von Mises' stress in colour.

    Parameters
    ----------
    run
        With frames and fields.
    at
        Instant, s: the nearest frame is drawn, and named. None for that of the largest stress.
    exaggeration
        Factor on the deformation; stated in the picture if it is not 1.
    label
        What tells the run from others.

    Raises
    ------
    InputError
        If there is nothing to draw, `at` is outside the run, or there is nothing to draw with.
    """
    motion = motion_of(run, "mises", exaggeration, label)
    number, why = motion.peak, ", when it is largest"
    if at is not None:
        time = run.frames.time
        if not time[0] <= at <= time[-1]:
            raise InputError(f"--at {at:g}: outside the run, which goes from {time[0]:g} to {time[-1]:g} s")
        number, why = int(np.argmin(np.abs(time - at))), ""
    return still(motion, number, why)


def has_solids(run: Trajectory) -> bool:
    """Tell whether a run has surfaces to draw."""
    return any(own.kind != "line" for own in run.fields.values())


@styled
def still(motion: Motion, number: int, why: str = "") -> Figure:
    """Return the picture of an instant; `why` follows its caption."""
    motion = motion.only(number)
    frame = Surround(motion, motion.captions[0] + why)
    with Stage(motion, *frame.size) as stage:
        frame.measure(stage.metre)
        frame.axes.imshow(stage.picture(0), interpolation="antialiased", aspect="auto")
    return frame.figure


@styled
def images(motion: Motion, numbers: np.ndarray, resolution: int = RESOLUTION) -> Iterator[np.ndarray]:
    """Return an iterator over the pictures of instants, all of one size, as bytes of shape (height, width, 3).

    Raises
    ------
    InputError
        If there is nothing to draw with.
    """
    drawing()
    return _images(motion, numbers, Surround(motion, "", resolution))


def _images(motion: Motion, numbers: np.ndarray, frame: Surround) -> Iterator[np.ndarray]:
    with Stage(motion, *frame.size) as stage:
        frame.measure(stage.metre)
        for number in numbers:
            yield frame.around(stage.picture(number), motion.captions[number])


class Surround:
    """What stands around the bodies: title, notes, bar of the colours, bar of the scale, and the instant.

    Parameters
    ----------
    motion
        What is drawn.
    caption
        Of the instant.
    resolution
        Pixels an inch.

    Attributes
    ----------
    figure, axes
        The figure, and where in it the bodies are.
    size
        Width and height of that place, pixels.
    """

    def __init__(self, motion: Motion, caption: str, resolution: int = RESOLUTION) -> None:
        low, high, _ = bounds_of(motion)
        extent = np.maximum(high - low, 1e-12)
        height = float(np.clip((WIDTH - 1.3) * extent[1] / extent[0], LOWEST, HIGHEST))
        self.figure = new_figure(WIDTH, height + 1.1)
        self.figure.set_dpi(resolution)
        self.axes = self.figure.subplots()
        _bare(self.axes)
        if motion.quantity:
            colours = ScalarMappable(Normalize(0.0, motion.largest or 1.0), matplotlib.colormaps[COLOURS])
            bar = self.figure.colorbar(colours, ax=self.axes, pad=0.01, aspect=26, shrink=0.9)
            bar.outline.set_visible(False)
            bar.set_label(motion.quantity)
        top_legend(self.figure, _keys(motion), motion.title, motion.notes)
        self.figure.set_figheight(round(self.figure.get_figheight() * resolution / 2) * 2 / resolution)
        self.figure.canvas.draw()
        # the layout is found: what is written from here on moves nothing
        self.figure.set_layout_engine("none")
        self._box = self.axes.get_window_extent()
        self.size = int(round(self._box.width)), int(round(self._box.height))
        self._caption = self.axes.set_xlabel(caption, loc="right")
        self._canvas: np.ndarray | None = None

    def measure(self, metre: float) -> None:
        """Draw a bar of a round length below the bodies, of which a metre has so many pixels."""
        metres = self.size[0] / 5.0 / metre
        power = 10.0 ** np.floor(np.log10(metres))
        nice = max(step * power for step in (1.0, 2.0, 5.0) if step * power <= metres)
        factor, unit = axis_unit("m", np.array([nice]))
        share = nice * metre / self.size[0]
        below = {"transform": self.axes.transAxes, "clip_on": False, "color": QUIET}
        at = -9.0 / self.size[1] * RESOLUTION / 72.0
        self.axes.plot([0.0, share], [at, at], linewidth=1.6, **below)
        self.axes.text(
            share + 0.01, at, f"{nice * factor:g} {unit}", transform=self.axes.transAxes, va="center", color=QUIET
        )

    def around(self, picture: np.ndarray, caption: str) -> np.ndarray:
        """Return a picture of the bodies with all that stands around it, as bytes of shape (height, width, 3)."""
        self._caption.set_text(caption)
        self.figure.canvas.draw()
        whole = np.asarray(self.figure.canvas.buffer_rgba())[:, :, :3].copy()
        left, top = int(round(self._box.x0)), whole.shape[0] - int(round(self._box.y1))
        whole[top : top + self.size[1], left : left + self.size[0]] = picture
        return whole


def _bare(axes: Axes) -> None:
    axes.set_xticks([])
    axes.set_yticks([])
    axes.grid(False)
    for spine in axes.spines.values():
        spine.set_visible(False)
    axes.set_xlabel("t = 0.0000 s", loc="right")


def _keys(motion: Motion) -> list:
    """Return what grey and plain bodies are, where they are beside coloured ones."""
    from matplotlib.patches import Patch

    rigid = any(skin.rigid for skin in motion.skins)
    plain = any(not skin.rigid and skin.values is None for skin in motion.skins)
    keys = [Patch(color=RIGID, label="rigid")] if rigid and not all(skin.rigid for skin in motion.skins) else []
    return [*keys, Patch(color=PLAIN, label="flexible, not coloured")] if plain and motion.quantity else keys
