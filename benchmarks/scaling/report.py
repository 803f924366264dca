"""What a scaling study found, as Markdown: cost over unknowns and ranks, one angle against a full solve, beams.

    python -m benchmarks.scaling.report results/scaling

Reads what `scripts/bench_scaling` left in the directory: ``case_*.json``, the runs ``run_<unknowns>_*.h5`` of the
reduced models on them, and ``beams.json``; writes ``scaling.md``.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from benchmarks.programs import guarded
from benchmarks.scaling import case as phases
from benchmarks.scaling.case import ScalingCase, exponent, over_unknowns
from benchmarks.scaling.fine_beams import TOLERANCE, FineBeams
from benchmarks.tables import Table, number
from pgmp_petsc import __version__
from pgmp_petsc.base.errors import InputError
from pgmp_petsc.results.trajectory import Trajectory

LIMIT = 1.5  # allowed exponent of the cost with the unknowns
Column = tuple[str, Callable[[ScalingCase], float]]
COST: tuple[Column, ...] = (
    *((name, lambda case, name=name: case.processor[name]) for name in (
        phases.READING, phases.ASSEMBLY, phases.FACTORISATION, phases.EIGENSOLVER, phases.ANSWERS, phases.PROJECTION,
    )),
    ("condensing in all", lambda case: case.processor[phases.CONDENSING]),
    ("the same, wall", lambda case: case.wall[phases.CONDENSING]),
    ("memory, MB", lambda case: sum(case.peak) / 1e6),
    ("without the program's own", lambda case: (sum(case.peak) - sum(case.idle)) / 1e6),
)  # fmt: skip
AFTER: tuple[Column, ...] = (
    ("kinematics, s", lambda case: case.processor[phases.KINEMATICS]),
    ("one angle, ms", lambda case: 1e3 * case.angle),
    ("tables, s", lambda case: case.processor[phases.TABLES]),
    ("writing, s", lambda case: case.processor[phases.WRITING]),
)


def summarise(directory: Path) -> str:
    """Return the summary as Markdown.

    Raises
    ------
    InputError
        If there is no record, or one is damaged.
    """
    cases = read_cases(directory)
    tables = []
    for dimension in (3, 2):
        chosen = over_unknowns(cases, dimension)
        if chosen:
            tables += [cost_table(chosen), after_table(chosen), angle_table(chosen)]
    parallel = [case for case in cases if case.ranks > 1]
    if parallel:
        tables.append(rank_table(cases))
    runs = integration_times(directory)
    if runs:
        tables.append(simulation_table(runs))
    beams = directory / "beams.json"
    if beams.exists():
        tables.append(beam_table(FineBeams(**json.loads(beams.read_text(encoding="utf-8")))))
    return "\n\n".join([_opening(cases), *(table.markdown() for table in tables)]) + "\n"


def read_cases(directory: Path) -> list[ScalingCase]:
    """Return all records of a directory; raises `InputError` where there is none."""
    cases = [ScalingCase.read(path) for path in sorted(directory.glob("case_*.json"))]
    if not cases:
        raise InputError(f"no case_*.json in '{directory}'; run scripts/bench_scaling first")
    return cases


def cost_table(cases: Sequence[ScalingCase]) -> Table:
    """Show what condensing takes over the unknowns, on one rank, and with which power of them."""
    table = _over_unknowns(cases, COST, f"Cost over unknowns, bodies in {_space(cases)}")
    after = (
        f"Seconds of a processor, one rank, {cases[0].modes} modes. Factorisations are those of PETSc's log, "
        f"{cases[-1].factorisations // cases[-1].bodies} a body."
    )
    if len(cases) > 1:
        power = exponent([case.unknowns for case in cases], [case.processor[phases.CONDENSING] for case in cases])
        after += (
            f" Condensing grows with the power {power:.2f} of the unknowns, over a factor of "
            f"{cases[-1].unknowns / cases[0].unknowns:.0f} ({'' if power <= LIMIT else 'too much: '}{LIMIT} is "
            "allowed)."
        )
    return Table(table.title, table.header, table.rows, after=after)


def after_table(cases: Sequence[ScalingCase]) -> Table:
    """Show what follows the condensing, which does not know the mesh."""
    title = f"After condensing, bodies in {_space(cases)}, {cases[0].angles} angles"
    return _over_unknowns(cases, AFTER, title)


def angle_table(cases: Sequence[ScalingCase]) -> Table:
    """Compare one angle of the build with a fresh solve on the full mesh."""
    rows = []
    for case in cases:
        fresh = case.processor.get(phases.FRESH)
        costs = [case.bodies_at_least, case.bodies_alone, fresh]
        shown = ["" if cost is None else f"{number(cost, 3)} s, {number(cost / case.angle, 2)}" for cost in costs]
        shown[-1] = f"refused: {case.refusal}" if case.refusal else shown[-1]
        rows.append([str(case.unknowns), f"{1e3 * case.angle:.3g} ms", *shown])
    header = ("unknowns", "one angle of the build", "bodies alone, at least", "bodies alone", "whole mechanism")
    after = (
        "Fresh solves on the full meshes, processor time and how many angles of the build it buys. Whole mechanism: "
        "assembly, factorisation and eigensolver of the constrained eigenproblem of the coupled bodies. Bodies alone: "
        "the same of each free body, which is less work; at least: without the second factorisation, which counts "
        "eigenvalues."
    )
    return Table(f"One angle of the build against a fresh solve, bodies in {_space(cases)}", header, rows, after=after)


def rank_table(cases: Sequence[ScalingCase]) -> Table:
    """Show wall times and memory over ranks; against one rank on the same mesh."""
    alone = {(case.scene, case.unknowns): case for case in cases if case.ranks == 1}
    parallel = [case for case in cases if case.ranks > 1 and (case.scene, case.unknowns) in alone]
    shown = [case for case in cases if any(case.scene == p.scene and case.unknowns == p.unknowns for p in parallel)]
    rows = []
    for case in sorted(shown, key=lambda c: (c.dimension, c.unknowns, c.ranks, c.ranks_per_angle)):
        base = alone[case.scene, case.unknowns]
        parts = [phases.CONDENSING, phases.ANGLES]
        times = [f"{case.wall[p]:.3g} s, {base.wall[p] / case.wall[p]:.2f}" for p in parts]
        memory = [f"{sum(case.peak) / 1e6:.0f}", f"{max(case.peak) / 1e6:.0f}"]
        rows.append([str(case.unknowns), str(case.ranks), str(case.ranks_per_angle), *times, *memory,
                     f"{case.share:.2f}", f"{case.load:.1f}"])  # fmt: skip
    header = (
        "unknowns", "ranks", "ranks a body", "condensing, speed-up", "all angles, speed-up", "memory, MB",
        "largest rank, MB", "share of a processor", "load before",
    )  # fmt: skip
    after = (
        "Wall times, and how many times as fast as one rank. One rank a body: the bodies are dealt out, and the "
        "largest one decides. The share is processor over wall time: below 1 other work was in the way."
    )
    return Table("Ranks", header, rows, after=after)


def integration_times(directory: Path) -> dict[int, list[float]]:
    """Return the wall times of integration in the runs, by the unknowns of the mesh behind the reduced model."""
    found: dict[int, list[float]] = {}
    for path in sorted(directory.glob("run_*_*.h5")):
        unknowns = int(path.stem.split("_")[1])
        found.setdefault(unknowns, []).append(Trajectory.read(path).record.timings["integration"])
    return dict(sorted(found.items()))


def simulation_table(runs: dict[int, list[float]]) -> Table:
    """Show that a reduced run's time does not depend on the mesh behind it."""
    rows = [[str(n), f"{min(times):.2f} s", ", ".join(f"{t:.2f}" for t in times)] for n, times in runs.items()]
    least = [min(times) for times in runs.values()]
    after = f"`/timings/integration` of `pgmp simulate`. Largest over smallest mesh: {least[-1] / least[0]:.2f}."
    return Table("Reduced simulation over the mesh", ("unknowns", "least of the runs", "all"), rows, after=after)


def beam_table(beams: FineBeams) -> Table:
    """Show the frequencies of lines of many elements beside the extrapolated ones."""
    rows = []
    for row, n in enumerate(beams.elements):
        differences = ", ".join(f"{value:.1e}" for value in beams.differences[row])
        rows.append([str(n), differences, beams.verdict(row)])
    before = (
        f"Extrapolated from 40 and 80 elements: {', '.join(f'{hz:.6g}' for hz in beams.extrapolated)} Hz, uncertain by "
        f"{beams.uncertain:.1e} (80 and 160 elements). Needed: {TOLERANCE:g}, or a reason why not."
    )
    return Table("Beams of many elements", ("elements a body", "relative differences", "verdict"), rows, before)


def _over_unknowns(cases: Sequence[ScalingCase], columns: Sequence[Column], title: str) -> Table:
    """Show columns over the unknowns and, with two sizes or more, the powers with which they grow."""
    rows = [[str(case.unknowns), *(f"{cost(case):.3g}" for _, cost in columns)] for case in cases]
    several = {"exponent": cases, "exponent of the last two": cases[-2:]} if len(cases) > 1 else {}
    for name, chosen in several.items():
        powers = [exponent([c.unknowns for c in chosen], [cost(c) for c in chosen]) for _, cost in columns]
        rows.append([name, *(f"{power:.2f}" for power in powers)])
    return Table(title, ("unknowns", *(name for name, _ in columns)), rows)


def _space(cases: Sequence[ScalingCase]) -> str:
    return "space" if cases[0].dimension == 3 else "the plane"


def _opening(cases: Sequence[ScalingCase]) -> str:
    loads = [case.load for case in cases]
    shares = [case.share for case in cases if case.ranks == 1]
    text = (
        f"# Scaling\n\npgmp {__version__} on {os.cpu_count()} processors; linear algebra: "
        f"{cases[0].blas or 'unknown'}. Load averages before the runs: {min(loads):.1f} to {max(loads):.1f}."
    )
    if shares and min(shares) < 0.9:
        text += (
            f" The machine was shared: runs on one rank had {min(shares):.2f} to {max(shares):.2f} of a processor, so "
            "only processor times, and ratios within a run, say something."
        )
    return text


def main() -> int:
    """Write the summary of the directory on the command line."""
    if len(sys.argv) != 2:
        print("usage: python -m benchmarks.scaling.report DIRECTORY", file=sys.stderr)
        return 2

    def write() -> None:
        path = Path(sys.argv[1]) / "scaling.md"
        path.write_text(summarise(path.parent), encoding="utf-8")
        print(path)

    return guarded(write)


if __name__ == "__main__":
    sys.exit(main())
