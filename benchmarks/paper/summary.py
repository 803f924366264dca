"""The paper's figures and numbers beside this program's: writes ``summary.md``.

    python -m benchmarks.paper.summary results/

Reads the files that `scripts/demo` leaves in the directory, and computes besides: the observed order of the time
integration and the cost of a sample. Every figure is computed when it runs; only published numbers are constants
(:mod:`~benchmarks.paper.published`).
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from benchmarks.paper.results import PaperResults
from benchmarks.programs import end, guarded
from benchmarks.tables import Table, number
from pgmp_petsc import __version__
from pgmp_petsc.ranks.petsc import start_petsc

if TYPE_CHECKING:
    from benchmarks.paper.cost import Cost

SCENE = Path(__file__).resolve().parents[2] / "scenes" / "slider_crank_paper.toml"
PICTURES = {
    "fig6_densities.png": "Fig. 6: crank angle and slider deformation at 1 s, full-order beside reduced",
    "fig2_frequencies.png": "Fig. 2: eigenfrequencies over a revolution",
    "fig4_trajectories.png": "Fig. 4: motion and errors of the reduced model",
    "fig5_density_r1.png": "Fig. 5: the sampled crank radius",
    "mechanism.png": "the motion; `motion.xdmf` shows it in ParaView",
}


def summarise(directory: Path, scene: Path = SCENE) -> str:
    """Return the summary as Markdown.

    Raises
    ------
    InputError
        If a result file is missing or damaged.
    """
    # after PETSc was started by `main`
    from benchmarks.paper import accuracy, comparison, cost, equal_error, inertia, order, ranks

    results = PaperResults.read(directory)
    costs = cost.measure(scene, directory)
    at_equal_error = equal_error.measure(scene, directory)
    at_rest = order.exact_run(order.AT_REST, scene)
    tables = [
        comparison.published_table(results),
        accuracy.frequency_table(results),
        accuracy.end_table(results, at_rest, order.AT_REST.fine_step),
        order.order_table(scene, at_rest),
        inertia.inertia_table(results),
        accuracy.distance_table(results),
        cost.wall_table(results),
        cost.cost_table(costs),
        equal_error.equal_error_table(at_equal_error),
        ranks.rank_table(directory / "ranks"),
    ]
    saved = [equal_error.in_words(one) for one in at_equal_error] + [one.in_words for one in costs]
    return "\n\n".join([_opening(results, costs, saved, tables), *(table.markdown() for table in tables)]) + "\n"


def _opening(results: PaperResults, costs: Sequence[Cost], saved: Sequence[str], tables: Sequence[Table]) -> str:
    """Return the result in a few lines, before any table."""
    angle, deformation = (
        max(results.largest_error(output, factor) for factor in results.modes)
        for output in ("crank_angle", "slider_deformation")
    )
    count = verdicts(tables)
    lines = [
        "# Slider-crank with an uncertain crank radius",
        "The example of F. Naets, T. Tamarozzi, W. Desmet, *A system level model reduction approach for flexible "
        "multibody systems with parametric uncertainties*, Procedia IUTAM 13 (2015) 4-13, computed by "
        f"pgmp {__version__} with {results.ensembles['full'].record.ranks} MPI ranks on {os.cpu_count()} processors. "
        "`scripts/demo` repeats all of it.",
        f"- The reduced model follows the full-order crank angle to {number(100 * angle, 2)} % and the slider's "
        f"deformation to {number(100 * deformation, 2)} % of their largest values, with three crank radii.\n"
        f"- {len(results.ensembles['reduced'].status)} reduced and {len(results.ensembles['full'].status)} full-order "
        "samples give the distributions of the paper's Fig. 6; the reduced deformation is a little too small, because "
        "15 modes leave out part of the static answer to the loads.\n"
        f"- {' '.join(saved)}\n"
        f"- The paper's mesh of 5 elements a body is not converged; on {costs[-1].n_elements} elements some "
        "frequencies are much lower.\n"
        f"- {count['ok']} of {count['all']} verdicts below are ok; the others say what differs and why.",
        "\n".join(f"- [{name}]({name}): {words}" for name, words in PICTURES.items()),
    ]
    return "\n\n".join(lines)


def verdicts(tables: Sequence[Table]) -> dict[str, int]:
    """Count how many rows with a verdict are ok."""
    rows = [row[-1] for table in tables if table.header[-1] == "verdict" for row in table.rows]
    return {"ok": sum(row.startswith("ok") for row in rows), "all": len(rows)}


def write(path: Path) -> None:
    """Write the summary of a path's directory, and print the path."""
    path.write_text(summarise(path.parent), encoding="utf-8")
    print(path)


def main() -> int:
    """Write the summary into the directory on the command line."""
    if len(sys.argv) != 2:
        print("usage: python -m benchmarks.paper.summary DIRECTORY", file=sys.stderr)
        return 2
    start_petsc()
    return guarded(lambda: write(Path(sys.argv[1]) / "summary.md"))


if __name__ == "__main__":
    end(main())
