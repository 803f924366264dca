"""The figures of Naets, Tamarozzi and Desmet (2015), from the result files that `scripts/demo` leaves.

    python -m benchmarks.paper.figures results/

Read from the directory: ``modes_<r>.h5``, ``full_<r>.h5`` and ``reduced_<r>.h5`` for r in 0.9, 1.0, 1.1 times the
nominal radius, ``montecarlo_full.h5`` and ``montecarlo_reduced.h5``. Written there: the paper's Figs. 2, 4, 5 and 6,
and a picture of the motion.
"""

from __future__ import annotations

import sys
import tomllib
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from scipy import stats

from benchmarks.programs import guarded
from pgmp_petsc.figures.ensembles import densities
from pgmp_petsc.figures.studies import frequencies
from pgmp_petsc.figures.mechanism import mechanism
from pgmp_petsc.figures.style import REDUCED_COLOUR, axis_unit, save, styled
from pgmp_petsc.figures.trajectories import paired, trajectories
from pgmp_petsc.results import Ensemble, ModesTable, Trajectory

RADII = ("0.9", "1.0", "1.1")  # of the crank, over the nominal one
LABELS = tuple(f"r1 = {factor} r_ref" for factor in RADII)
OUTPUTS = ("crank_angle", "slider_deformation")
EXAGGERATION = 100.0


def draw(directory: Path) -> list[Path]:
    """Draw all figures into `directory` and return their paths.

    Raises
    ------
    InputError
        If a result file is missing or damaged.
    """
    tables = [ModesTable.read(directory / f"modes_{factor}.h5") for factor in RADII]
    runs = [Trajectory.read(directory / f"{model}_{factor}.h5") for factor in RADII for model in ("full", "reduced")]
    full, reduced = (Ensemble.read(directory / f"montecarlo_{model}.h5") for model in ("full", "reduced"))
    figures = {
        "fig2_frequencies": frequency_bands(tables),
        "fig4_trajectories": trajectories(paired(runs), OUTPUTS, LABELS),
        "fig5_density_r1": radius_density(full, "r1"),
        "fig6_densities": densities([full, reduced], names=OUTPUTS),
        "mechanism": mechanism(runs[2 * RADII.index("1.0")], exaggeration=EXAGGERATION),
    }
    return [save(figure, directory / f"{name}.png") for name, figure in figures.items()]


def frequency_bands(tables: Sequence[ModesTable]) -> Figure:
    """Draw Fig. 2: the paper counts the rigid motion as the first mode, so its panels are f2 to f5."""
    return frequencies(tables, 4, LABELS, [f"f{number} (Hz)" for number in range(2, 6)])


@styled
def radius_density(ensemble: Ensemble, name: str) -> Figure:
    """Draw Fig. 5: the samples of a parameter, and the distribution that they were drawn from."""
    figure = densities([ensemble], [f"{len(ensemble.status)} samples"], [name])
    axes = figure.axes[0]
    factor, _ = axis_unit(ensemble.units[name], ensemble.parameters[name])
    law = dict(tomllib.loads(ensemble.record.scene_toml)["parameters"][name]["distribution"])
    frozen = getattr(stats, law.pop("name"))(**law)
    shown = np.linspace(*axes.get_xlim(), 400)
    axes.plot(shown, frozen.pdf(shown / factor) / factor, color=REDUCED_COLOUR, zorder=5)
    axes.legend(handles=[Line2D([], [], color=REDUCED_COLOUR, label="distribution")], loc="upper right")
    return figure


def main() -> int:
    """Draw the figures of the directory on the command line."""
    if len(sys.argv) != 2:
        print("usage: python -m benchmarks.paper.figures DIRECTORY", file=sys.stderr)
        return 2
    return guarded(lambda: print(*draw(Path(sys.argv[1])), sep="\n"))


if __name__ == "__main__":
    sys.exit(main())
