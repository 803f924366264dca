"""What a build takes over the unknowns of its meshes and over ranks: data in, a `Figure` out.

python -m benchmarks.scaling.figures results/scaling
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from benchmarks.programs import guarded
from benchmarks.scaling import case as phases
from benchmarks.scaling.case import ScalingCase, exponent, over_unknowns
from pgmp_petsc.base.errors import InputError
from pgmp_petsc.figures.style import (
    FULL_COLOUR,
    PALETTE,
    QUIET,
    REDUCED_COLOUR,
    new_figure,
    save,
    styled,
    top_legend,
)

PARTS = (phases.ASSEMBLY, phases.FACTORISATION, phases.EIGENSOLVER, phases.ANSWERS, phases.PROJECTION)
ALLOWED = 1.5  # power of the unknowns
DASHED = (0, (4, 2))
_PLAIN = FuncFormatter(lambda value, _: f"{value:g}")


@styled
def costs(cases: Sequence[ScalingCase]) -> Figure:
    """Draw over the unknowns, for one rank: times of condensing, the memory, and one angle against fresh solves."""
    figure = new_figure(12.6, 4.6)
    time, memory, angle = figure.subplots(1, 3)
    keys = []
    for name, colour in zip(PARTS, PALETTE[:5]):
        _line(time, cases, lambda case, name=name: case.processor[name], color=colour, linewidth=1.1)
        keys.append(Line2D([], [], color=colour, marker="o", markersize=4, label=name))
    _line(time, cases, lambda case: case.processor[phases.CONDENSING], color=FULL_COLOUR, linewidth=2.2)
    keys.append(Line2D([], [], color=FULL_COLOUR, marker="o", markersize=4, linewidth=2.2, label="condensing in all"))
    keys.append(Line2D([], [], color=QUIET, linestyle=DASHED, label=f"unknowns$^{{{ALLOWED}}}$"))
    unknowns = np.array([case.unknowns for case in cases], dtype=float)
    total = np.array([case.processor[phases.CONDENSING] for case in cases])
    time.plot(unknowns, total[0] * (unknowns / unknowns[0]) ** ALLOWED, color=QUIET, linestyle=DASHED, linewidth=1.0)
    time.set_title(f"processor time (s); in all with power {exponent(unknowns, total):.2f}")

    _line(memory, cases, lambda case: sum(case.peak) / 1e9, color=FULL_COLOUR)
    memory.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    memory.set_title("peak memory (GB)")

    _line(angle, cases, lambda case: case.angle, color=REDUCED_COLOUR)
    _line(angle, cases, lambda case: case.bodies_alone, color=FULL_COLOUR)
    coupled = [case for case in cases if phases.FRESH in case.processor]
    _line(angle, coupled, lambda case: case.processor[phases.FRESH], color=FULL_COLOUR, linestyle=":", marker="s")
    angle.set_title("processor time of one angle (s)")
    beside = [
        Line2D([], [], color=REDUCED_COLOUR, marker="o", markersize=4, label="in the build"),
        Line2D([], [], color=FULL_COLOUR, marker="o", markersize=4, label="full meshes, bodies alone"),
    ]
    if coupled:
        look = {"color": FULL_COLOUR, "marker": "s", "markersize": 4, "linestyle": ":"}
        beside.append(Line2D([], [], label="full meshes, coupled", **look))
    angle.legend(handles=beside, loc="upper left")
    low, high = angle.get_ylim()
    angle.set_ylim(low, high * (high / low) ** 0.35)  # room for the keys
    for axes in (time, memory, angle):
        axes.set_xlabel("unknowns of all bodies")
    top_legend(figure, keys, f"What condensing takes: {cases[0].scene.replace('_', ' ')}, {cases[0].modes} modes")
    return figure


@styled
def ranks(cases: Sequence[ScalingCase]) -> Figure:
    """Draw speed-ups of condensing and of the angles over ranks, a line a mesh and way to deal the work out."""
    figure = new_figure(8.8, 4.2)
    meshes = sorted({case.unknowns for case in cases if case.ranks > 1})
    keys = [Line2D([], [], color=colour, label=f"{n} unknowns") for n, colour in zip(meshes, PALETTE)]
    keys.append(Line2D([], [], color=QUIET, label="bodies and angles dealt out"))
    keys.append(Line2D([], [], color=QUIET, linestyle=DASHED, label="shared by all ranks"))
    most = max(case.ranks for case in cases)
    for axes, phase in zip(figure.subplots(1, 2), (phases.CONDENSING, phases.ANGLES)):
        axes.plot([1, most], [1, most], color=QUIET, linewidth=0.8, linestyle=":")
        for unknowns, colour in zip(meshes, PALETTE):
            one = next((c for c in cases if c.unknowns == unknowns and c.ranks == 1), None)
            if one is None:
                continue
            for shared, style in ((False, "-"), (True, DASHED)):
                line = [c for c in cases if c.unknowns == unknowns and 1 < c.ranks and _shared(c) == shared]
                line = [one, *sorted(line, key=lambda case: case.ranks)]
                speed = [one.wall[phase] / case.wall[phase] for case in line]
                axes.plot([c.ranks for c in line], speed, color=colour, linestyle=style, marker="o", markersize=4)
        axes.set_title(f"speed-up of the wall time, {phase}")
        axes.set_xlabel("ranks")
        axes.set_xticks(sorted({case.ranks for case in cases}))
        axes.set_ylim(bottom=0.0)
    top_legend(figure, keys, "Ranks")
    return figure


def draw(directory: Path) -> list[Path]:
    """Draw the records ``case_*.json`` of a directory into it; return the paths of the pictures.

    Raises
    ------
    InputError
        If there is no record, or one is damaged.
    """
    cases = [ScalingCase.read(path) for path in sorted(directory.glob("case_*.json"))]
    if not cases:
        raise InputError(f"no case_*.json in '{directory}'; run scripts/bench_scaling first")
    pictures = [
        save(costs(chosen), directory / f"scaling_{dimension}d.png")
        for dimension in (2, 3)
        if len(chosen := over_unknowns(cases, dimension)) > 1
    ]
    if any(case.ranks > 1 for case in cases):
        pictures.append(save(ranks(cases), directory / "scaling_ranks.png"))
    return pictures


def _shared(case: ScalingCase) -> bool:
    return case.ranks_per_angle > 1


def _line(axes: Axes, cases: Sequence[ScalingCase], cost: Callable[[ScalingCase], float], **look: object) -> None:
    """Draw a cost over the unknowns on logarithmic axes."""
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.yaxis.set_major_formatter(_PLAIN)
    axes.yaxis.set_minor_formatter(NullFormatter())
    look = {"marker": "o", "markersize": 4} | look
    axes.plot([case.unknowns for case in cases], [cost(case) for case in cases], **look)


def main() -> int:
    """Draw the records of the directory on the command line."""
    if len(sys.argv) != 2:
        print("usage: python -m benchmarks.scaling.figures DIRECTORY", file=sys.stderr)
        return 2
    return guarded(lambda: print(*draw(Path(sys.argv[1])), sep="\n"))


if __name__ == "__main__":
    sys.exit(main())
