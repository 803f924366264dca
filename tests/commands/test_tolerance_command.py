"""Tolerances on the command line: what is said and kept, and what a tolerance that cannot be met is answered."""

from collections.abc import Callable
from pathlib import Path

import pytest
from refusals import cases
from runs import PAPER_SCENE, PGMP, overridden, pgmp, refused

RIGID = 'outputs={crank_angle={type="angle", joint="crank_hinge"}}'
NO_MORE = "inertia_modes=false, parameter_modes=0"
PLAIN = f'modes=4, static_modes=true, {NO_MORE}, second_order=false, angles=48, interpolation="spectral"'
SHORT = "simulation={duration=0.1, step=1e-3}"
WORDS = {"NO_MORE": NO_MORE, "PLAIN": PLAIN, "SHORT": SHORT, "RIGID": RIGID}
# Overrides, and words of the message; * also on three ranks. What stands in the way: the basis, all modes of the mesh,
# angles, different errors of time integration, round-off, the step, gravity at once and impacts, nothing.
REFUSED = cases("""
* reduction={tolerance=6e-3, modes=2, static_modes=false, NO_MORE, second_order=false} & SHORT ->
    reduction.tolerance = 0.006: cannot be met, the basis stands in the way | basis: at best 0. | allowed 0.0027 |
    the mesh itself leaves more than the tolerance: cells cut in two would move slider_deformation by 0.0 |
    slider_deformation, load ' | half the load leaves | can be met by this part | kept as given: reduction.modes = 2,
    reduction.static_modes = false, reduction.inertia_modes = false, reduction.parameter_modes = 0, reduction.second
reduction={tolerance=1e-4, modes=30, static_modes=false, second_order=false, angles=48, interpolation="spectral"} &
    simulation={duration=0.05, step=1e-3} ->
    cannot be met, the basis stands in the way | these are all flexible modes that the meshes have
reduction={tolerance=1e-3, modes=7, static_modes=true, NO_MORE, second_order=false, angles=16, interpolation="spline"} &
    simulation={duration=0.4, step=2e-3} ->
    the basis stands in the way | interpolation: at best 0. | part of the basis's error | reduction.angles = 16
reduction={tolerance=1e-4, PLAIN} & simulation={duration=0.3, step=5e-3} & RIGID ->
    reduction.tolerance = 0.0001: cannot be met, the time step stands in the way | with 60 steps |
    take a smaller simulation.step, or let simulation.tolerance choose it
reduction={tolerance=1e-8, PLAIN} & SHORT & RIGID & effects.motor.table=[[0.0, 0.0], [0.05, 1e-7]] ->
    reduction.tolerance = 1e-08: cannot be met, round-off stands in the way | 1e-10 rad
simulation={tolerance=1e-3, duration=0.1, step=1e-3} ->
    simulation.tolerance = 0.001: cannot be met, the time step stands in the way | step: at best 0.00 |
    allowed 0.0005 | simulation.step = 0.001 is kept as given; leave it out to have it chosen
reduction={tolerance=1e-4, PLAIN} & simulation={duration=0.15, step=1e-3, initial={theta={position=1.0}}} &
    effects.weight={type='gravity'} & effects.wall={type='end_stop', joint='slider', upper=0.86, stiffness=1e5} ->
    effects.weight acts at once at the start | starts where they are, halving the step then moves 0.00 |
    and the same basis leaves 0.00
* reduction={tolerance=1e-3} & outputs={} -> reduction.tolerance: errors are those of outputs, and the scene has none
""")


def arguments(asked: str, folder: Path) -> list[str]:
    for word, meaning in WORDS.items():
        asked = asked.replace(word, meaning)
    return ["build", str(PAPER_SCENE), "-o", str(folder / "rom.h5"), *overridden(*asked.lstrip("* ").split(" & "))]


@pytest.mark.parametrize("n_ranks", [1, 3])
def test_the_message_says_what_stands_in_the_way(tmp_path: Path, n_ranks: int) -> None:
    """Exit status 2 on every rank, one message, no file, and no rank waits for another."""
    chosen = [case for case in REFUSED if n_ranks == 1 or case[0].startswith("* ")]
    for (asked, said), message in zip(chosen, refused(n_ranks, [arguments(asked, tmp_path) for asked, _ in chosen])):
        assert all(words in message for words in said.split(" | ")), (asked, message)
    assert not list(tmp_path.iterdir())


def test_what_was_chosen_is_said_and_kept(tmp_path: Path) -> None:
    """A build says it, `info` shows the attempts, a run takes the chosen step or another for a tolerance of its own."""
    rom, run = tmp_path / "rom.h5", tmp_path / "run.h5"
    given = f"reduction={{tolerance=1e-2, {PLAIN}}}"
    asked = overridden(given, "simulation={tolerance=1e-2, duration=0.1}", RIGID)
    said = pgmp("build", PAPER_SCENE, "-o", rom, *asked).stdout
    assert "reference: the mesh" in said
    for words in (
        "chosen for reduction.tolerance = 0.01 and simulation.tolerance = 0.01", "kept as given: reduction.modes = 4",
        "the step was found with 'own'", "simulation.step = 0.00156", "trained on r1 = 0.0056",
        "no part of the tolerance: cells cut in two", "processor time of a sample",
    ):  # fmt: skip
        assert words in said, said
    told = pgmp("info", rom).stdout
    for words in ("  basis, allowed 0.005", "  step, allowed 0.005", "modes = 4, static_modes = true, inertia_modes"):
        assert words in told, told
    assert "reduced model, 65 steps to 0.1 s" in pgmp("simulate", rom, "-o", run).stdout
    again = pgmp("simulate", rom, "-o", run, *overridden("simulation={tolerance=1e-3, duration=0.1}")).stdout
    assert "simulation.tolerance = 0.001: simulation.step = " in again
    too_long = overridden("simulation={tolerance=1e-4, duration=0.1, step=4e-3}")
    refused = pgmp("simulate", rom, "-o", run, *too_long, status=2)
    assert "the time step stands in the way\n  step: at best" in refused.stderr
    assert 'model = "reduced"' in refused.stderr


def test_one_rank_and_two_choose_the_same(mpirun: Callable, tmp_path: Path) -> None:
    given = "reduction={tolerance=1e-2, %s}" % PLAIN.replace("modes=4, ", "").replace("48", "24")
    command = ["build", str(PAPER_SCENE), *overridden(given, SHORT, RIGID, 'reference.model="components"')]
    one = pgmp(*command, "-o", tmp_path / "one.h5").stdout
    two = mpirun(2, *PGMP, *command, "-o", tmp_path / "two.h5").stdout

    def chosen(text: str) -> list[str]:
        lines = text[text.index("chosen for") :].splitlines()
        return [line for line in lines if "processor time" not in line]

    assert chosen(one) == chosen(two)
    assert "away from the mesh" in one


def test_parameter_modes_that_are_given_and_cannot_be_are_bad_input(tmp_path: Path) -> None:
    given = overridden("reduction={tolerance=1e-2, parameter_modes=9}", "simulation.duration=0.1")
    done = pgmp("build", PAPER_SCENE, "-o", tmp_path / "rom.h5", *given, status=2)
    assert "reduction.parameter_modes = 9" in done.stderr and "independent at every configuration" in done.stderr
