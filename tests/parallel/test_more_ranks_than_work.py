"""Work on any number of ranks, more than there is work too: pieces once each, results of one rank, failures of all.

The commands run one after the other in one start of MPI. That this process ends is part of the test: ranks
that had no work must not leave the others waiting at the end of PETSc. ``PGMP_RANKS=7`` takes another number of ranks.
"""

import json
import os
import re
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest
import synthetic
from click.testing import CliRunner
from conftest import ROOT, SCRIPTS, run_mpi
from mpi4py import MPI
from runs import PGMP, in_turn, overridden, rom_of

from benchmarks.scaling.case import FRESH, ScalingCase
from pgmp_petsc.cli.declared import Session
from pgmp_petsc.cli.main import COMMANDS, load
from pgmp_petsc.reduction.rom import ReducedOrderModel
from pgmp_petsc.results import Ensemble, ModesTable, Trajectory
from scenes import slider_crank

BEAMS, SOLIDS = (str(ROOT / "scenes" / f"{name}.toml") for name in ("slider_crank", "slider_crank_solid2d"))
FEW = overridden(
    "reduction.modes=3", "reduction.angles=4", "simulation.duration=0.01", "simulation.step=1e-3", "simulation.frames=3"
)
PLAIN = [*FEW, *overridden("reduction.parameter_modes=0", "reduction.second_order=false")]
MANY = int(os.environ.get("PGMP_RANKS", "5"))
SHORT = overridden("simulation.duration=0.002", "simulation.step=1e-3")


def commands(folder: Path, n_ranks: int) -> list[list[str]]:
    """Return commands with fewer angles, bodies, samples, results than ranks; pairs of ranks share some angles."""
    pairs = ["--ranks-per-angle", "2"] if n_ranks > 1 else []

    def to(name: str) -> list[str]:
        return ["-o", str(folder / name)]

    rom, trajectory = str(folder / "rom.h5"), str(folder / "reduced.h5")
    beams = [
        ["build", BEAMS, *FEW, *to("rom.h5")],
        ["modes", BEAMS, *FEW, "--rom", rom, *to("modes.h5")],
        ["build", BEAMS, *PLAIN, *pairs, *to("pairs.h5")],
    ]
    solids = [["modes", SOLIDS, *FEW, *pairs, *to("solid_modes.h5")], ["build", SOLIDS, *PLAIN, *to("solid_rom.h5")]]
    runs = [
        ["simulate", rom, *to("reduced.h5")],
        ["simulate", rom, *overridden("initial={equilibrium=true}"), *to("settled.h5")],
        ["simulate", BEAMS, "--full", *SHORT, *to("full.h5")],
        ["simulate", SOLIDS, "--full", *SHORT, *to("solid_full.h5")],
        ["montecarlo", rom, "-n", "1", *to("one.h5")],
        ["montecarlo", rom, "-n", "3", *to("three.h5")],
        ["montecarlo", BEAMS, "--full", *SHORT, "-n", "2", *to("full_samples.h5")],
    ]
    inspected = [
        ["check", BEAMS], ["check", BEAMS, "--effects", *SHORT], ["info", trajectory],
        ["plot", trajectory, *to("pictures")], ["export", trajectory, *to("shapes.xdmf")],
    ]  # fmt: skip
    return [*beams, *solids, *runs, *inspected]


def failing(folder: Path) -> list[list[str]]:
    """Return commands whose run stops, or whose samples fail."""
    pushed = ["--full", *SHORT, *overridden("effects.motor.table=[[0.0, 1e9], [1.0, 1e9]]"), "-o"]
    return [
        ["simulate", BEAMS, *pushed, str(folder / "stopped.h5")],
        ["montecarlo", BEAMS, "-n", "2", *pushed, str(folder / "failed.h5")],
    ]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Callable[[int], Path]:
    """Return a function that gives the results of a number of ranks."""

    def made_by(n: int) -> Path:
        if n not in made:
            made[n] = tmp_path_factory.mktemp(f"ranks_{n}")
            wanted, others = commands(made[n], n), failing(made[n])
            statuses, done = in_turn(n, wanted + others)
            expected = [[0] * n] * len(wanted) + [[1] * n] * len(others)
            assert statuses == expected, f"{done.stdout}\n{done.stderr}"
        return made[n]

    made: dict[int, Path] = {}
    return made_by


def close(found: Mapping[str, np.ndarray], expected: Mapping[str, np.ndarray]) -> None:
    """Check results to 1e-7 of the largest value: the eigensolver's round-off, 1e-9 of a basis, over a short run."""
    assert found.keys() == expected.keys() and expected
    for name, values in expected.items():
        np.testing.assert_allclose(found[name], values, rtol=0, atol=1e-7 * np.abs(values).max(), err_msg=name)


FILES = {
    ModesTable: ["modes", "solid_modes"],
    ReducedOrderModel: ["rom", "pairs", "solid_rom"],
    Trajectory: ["reduced", "settled", "full", "solid_full"],
    Ensemble: ["one", "three", "full_samples"],
}


@pytest.mark.parametrize(("kind", "name"), [(kind, name) for kind, names in FILES.items() for name in names])
def test_results_are_those_of_one_rank(folder: Callable, kind: type, name: str) -> None:
    one, several = (kind.read(folder(ranks) / f"{name}.h5") for ranks in (1, MANY))
    assert several.record.ranks == MANY
    if kind in (Trajectory, Ensemble):
        return close(several.outputs, one.outputs)
    named = ["full_hz", "reduced_hz"][: 1 + (name == "modes")] if kind is ModesTable else ["frequencies_hz"]
    for frequencies in named:
        np.testing.assert_allclose(getattr(several, frequencies), getattr(one, frequencies), rtol=1e-8)


def test_seven_ranks(folder: Callable, tmp_path: Path) -> None:
    """Each command in a start of its own: nothing of another one may help it to end."""
    assert (folder(MANY) / "shapes.xdmf").exists() and list((folder(MANY) / "pictures").glob("*.png"))
    modes, samples = tmp_path / "modes.h5", tmp_path / "three.h5"
    run_mpi(7, *PGMP, "modes", BEAMS, *FEW, "-o", modes)
    found, one = (ModesTable.read(path).full_hz for path in (modes, folder(1) / "modes.h5"))
    np.testing.assert_allclose(found, one, rtol=1e-8)
    run_mpi(7, *PGMP, "montecarlo", folder(1) / "rom.h5", "-n", 3, "-o", samples)
    close(Ensemble.read(samples).outputs, Ensemble.read(folder(1) / "three.h5").outputs)


def test_runs_that_stop_and_samples_that_fail_end_too(folder: Callable) -> None:
    assert Trajectory.read(folder(MANY) / "stopped.h5").status != 0
    assert np.all(Ensemble.read(folder(MANY) / "failed.h5").status != 0)


def test_a_refused_option_of_petsc_ends_all_ranks(tmp_path: Path) -> None:
    output, option = tmp_path / "none.h5", ("--", "-pgmp_ts_ts_max_time", 0.1)
    done = run_mpi(2, *PGMP, "montecarlo", BEAMS, "--full", *SHORT, "-n", 2, "-o", output, *option, check_status=2)
    assert done.stderr.count("option -pgmp_ts_ts_max_time 0.1: it cannot be changed here") == 1
    assert not output.exists()


FINE = {"none": 0, "few": 2, "many": 25, "unequal": 41, "large": 12, "groups": 25}
FAILING = dict.fromkeys(("one fails", "a group fails"), "RunError: piece 7 failed")
FAILING["the writing fails"] = "RunError: the disk is full"


@pytest.fixture(scope="module")
def said() -> Callable[[int, str], list[str]]:
    """Return a function that gives what the ranks said of a case; all cases of one number of ranks are one run."""

    def lines(n: int, case: str) -> list[str]:
        if n not in done:
            printed = run_mpi(n, SCRIPTS / "dealing.py", *FINE, *FAILING).stdout
            done[n] = [line.split("|") for line in printed.splitlines()]
        return [text for name, _, text in done[n] if name == case]

    done: dict[int, list[list[str]]] = {}
    return lines


@pytest.mark.parametrize("n", [1, 2, 5])
@pytest.mark.parametrize("case", FINE)
def test_every_piece_is_computed_once_and_taken_in_by_the_first_rank(said: Callable, n: int, case: str) -> None:
    texts = said(n, case)
    assert len(texts) == n
    computed, taken = zip(*(re.fullmatch(r"computed \[(.*)\] took \[(.*)\]", text).groups() for text in texts))
    everything, groups = list(range(FINE[case])), 2 if case == "groups" and n > 1 else 1
    assert [int(k) for k in taken[0].split(",") if k] == everything and not any(taken[1:])
    by_groups = sorted(int(k) for part in computed for k in part.split(",") if k)
    if groups == 1:
        assert by_groups == everything
    else:  # both ranks of a group compute a piece, three where one is left over
        assert sorted(set(by_groups)) == everything and len(by_groups) >= 2 * len(everything)


@pytest.mark.parametrize("n", [1, 2, 5])
@pytest.mark.parametrize("case", FAILING)
def test_a_failure_is_that_of_all_ranks(said: Callable, n: int, case: str) -> None:
    assert said(n, case) == [FAILING[case]] * n


def test_pieces_go_to_whoever_is_ready(said: Callable) -> None:
    """Every tenth one takes twenty times as long: who has one of these gets fewer of the others."""
    counts = [len(re.search(r"computed \[(.*?)\]", text)[1].split(",")) for text in said(2, "unequal")]
    assert sum(counts) == FINE["unequal"] and min(counts) >= 2


LIMITED = 'coordinates.theta={joint="crank_hinge", range=[-0.5, 1.0]}'
FEW_STEPS = (LIMITED, "simulation.duration=0.01", "reduction.angles=8")


def test_a_study_on_more_ranks_than_it_has_tasks() -> None:
    one, many = (json.loads(run_mpi(n, SCRIPTS / "tradeoff.py", *FEW_STEPS).stdout) for n in (1, 6))
    assert many["told"] == one["told"] and all(many["timed"])
    for several, alone in zip(many["numbers"], one["numbers"], strict=True):
        # the eigensolver's random start changes the last digits
        np.testing.assert_allclose(several, alone, rtol=1e-6, atol=1e-12)


SMALL = ("reduction.modes=4", "reduction.angles=6")


def test_two_ranks_have_a_body_each(tmp_path: Path) -> None:
    options = [word for entry in SMALL for word in ("--override", entry)]
    path = tmp_path / "case.json"
    run_mpi(2, "-m", "benchmarks.scaling.build", SOLIDS, "-o", path, *options)
    found = ScalingCase.read(path)
    assert (found.ranks, found.ranks_per_angle, len(found.peak)) == (2, 1, 2)
    assert found.factorisations == 2, "of one body"
    assert FRESH not in found.wall
    assert path.with_suffix(".h5").exists()


def test_one_rank_draws(tmp_path: Path) -> None:
    rom_of(slider_crank()).write(tmp_path / "rom.h5")
    synthetic.trajectory(n_frames=3, n_times=11).write(tmp_path / "run.h5")
    commands = [
        ["animate", str(tmp_path / "rom.h5"), "--mode", "2", "--seconds", "0.1", "-o", str(tmp_path / "several.gif")],
        ["animate", str(tmp_path / "rom.h5"), "--mode", "99", "-o", str(tmp_path / "none.gif")],
        ["animate", str(tmp_path / "run.h5"), "-o", str(tmp_path / "none.gif")],
    ]
    statuses, done = in_turn(2, commands)
    assert statuses == [[0, 0], [2, 2], [2, 2]]
    assert done.stderr.count("--mode 99") == 1 and done.stderr.count("nothing of this run is known") == 1
    assert not (tmp_path / "none.gif").exists()
    words = [*commands[0][1:-1], str(tmp_path / "one.gif")]
    one = CliRunner().invoke(load(COMMANDS["animate"]), words, obj=Session(MPI.COMM_SELF))
    assert one.exit_code == 0
    assert (tmp_path / "several.gif").read_bytes() == (tmp_path / "one.gif").read_bytes()
