"""The shape of the mechanism at several instants, as a fan of positions coloured by time."""

from __future__ import annotations

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.figure import Figure

from pgmp_petsc.figures import cautions
from pgmp_petsc.figures.shapes import Shapes, TimeColours
from pgmp_petsc.figures.style import MODELS, axis_label, axis_unit, heading, new_figure, styled, top_legend
from pgmp_petsc.results import Trajectory
from pgmp_petsc.runtime.errors import InputError

N_INSTANTS = 14
WIDTH = 8.6


@styled
def mechanism(
    trajectory: Trajectory, n_instants: int = N_INSTANTS, exaggeration: float = 1.0, label: str = ""
) -> Figure:
    """Draw the mechanism's shape at instants that divide the run equally.

    Parameters
    ----------
    trajectory : Trajectory
        With frames.
    n_instants : int
        Number of shapes; fewer where there are fewer frames.
    exaggeration : float
        Factor on each body's deformation: its nodes' distances from the undeformed body laid through the
        body's two ends, so that the bodies stay joined. Stated in the picture if it is not 1.
    label : str
        What tells the run from others.

    Raises
    ------
    InputError
        If the trajectory has no frames.
    """
    frames = trajectory.frames
    if frames is None or not len(frames.time):
        raise InputError("the trajectory has no frames to draw; use --override simulation.frames=100")
    factor, unit = axis_unit("m", *frames.positions.values())
    shapes = Shapes.of(frames, exaggeration, factor)
    chosen = np.unique(np.linspace(0, len(frames.time) - 1, n_instants).round().astype(int))

    low, high = shapes.limits
    # The width that labels and the colour bar leave sets the height: equal scales then fill the picture.
    height = (WIDTH - 1.6) * (high - low)[1] / (high - low)[0]
    keys = shapes.keys()
    figure = new_figure(WIDTH, float(np.clip(height, 2.0, 8.0)) + 1.2 + (0.24 if keys else 0.0))
    axes = figure.subplots()
    colours = TimeColours.over(frames.time)
    shapes.draw_paths(axes)
    shapes.draw_ground(axes)
    for number in chosen[:-1]:
        shapes.draw(axes, number, colours.at(frames.time[number], strength=0.75), width=1.6, pin=3.0, zorder=2)
    shapes.draw(axes, chosen[-1], colours.at(frames.time[chosen[-1]]), width=3.0, pin=5.5, zorder=4)
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    axes.set_aspect("equal")
    axes.set_xlabel(axis_label(shapes.axis_names[0], unit))
    axes.set_ylabel(axis_label(shapes.axis_names[1], unit))
    bar = figure.colorbar(ScalarMappable(colours.scale, colours.colours), ax=axes, pad=0.01, aspect=32)
    bar.outline.set_visible(False)
    bar.set_label("time (s)")
    notes, plain, enlarged = cautions.of_runs([trajectory]), shapes.not_enlarged, ""
    if exaggeration != 1.0:
        deformable = len(frames.nodes) - len(frames.rigid)
        if plain:
            why = "only bodies in a plane, with two ends, can be"
            notes.append(f"deformation of {', '.join(plain)} as it is, not enlarged: {why}")
        if len(plain) < deformable:
            enlarged = f", deformation enlarged {exaggeration:g} times"
    instants = f"at {len(chosen)} instants" if len(chosen) > 1 else "at one instant"
    what = f"Shape {instants}, {MODELS[trajectory.model]}{enlarged}"
    top_legend(figure, keys, heading(what, trajectory.record, label), notes)
    return figure
