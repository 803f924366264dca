"""Ensembles on any number of ranks, killed and resumed, and with samples that fail."""

from pathlib import Path

import numpy as np
import pytest
from conftest import run_mpi
from runs import PAPER_SCENE, PGMP, overridden, paper_scene, pgmp, refused
from sealed import resealed_piece

from pgmp_petsc.ensemble.sampling import draw
from pgmp_petsc.results import Ensemble
from pgmp_petsc.stepping.status import Status

N, SEED = 22, 5
CHECKED = overridden("ensemble.checked_share=0.02")  # of runs as short as these it would be less
BATCHES = (*CHECKED, "--override", "ensemble.batch=4")
# 50 batches: several are left where a run is killed
LONG = ("-n", 100, "--seed", SEED, *overridden("simulation.duration=0.1", "ensemble.batch=2"))
# A run that ends right after its thirteenth piece was stored; ten of them are estimates of errors.
KILLED = """
import os, signal, sys
from pgmp_petsc.ensemble.checkpoint import Checkpoint
add, done = Checkpoint.add, []
def add_and_end(self, piece, batch):
    add(self, piece, batch)
    done.append(batch)
    if len(done) == 13:
        os.kill(os.getpid(), signal.SIGKILL)
Checkpoint.add = add_and_end
from pgmp_petsc.cli.main import main
main(sys.argv[1:])
"""


@pytest.fixture(scope="module")
def expected(folder: Path, small_rom: Path) -> Ensemble:
    path = folder / "expected.h5"
    pgmp("montecarlo", small_rom, "-n", N, "--seed", SEED, *CHECKED, "-o", path)
    return Ensemble.read(path)


@pytest.fixture(scope="module")
def uninterrupted(folder: Path, small_rom: Path) -> Ensemble:
    """Return the ensemble that the killed ones are to give; its batches are larger, which changes nothing."""
    path = folder / "uninterrupted.h5"
    pgmp("montecarlo", small_rom, *LONG, "--override", "ensemble.batch=100", "-o", path)
    return Ensemble.read(path)


def assert_equal(found: Ensemble, expected: Ensemble, tolerance: float = 1e-9) -> None:
    """Check that ensembles agree; the rigid closure of a whole batch stops at 1e-12, so that batches differ by less."""
    np.testing.assert_equal(found.parameters, expected.parameters)
    assert found.outputs.keys() == expected.outputs.keys()
    for name, values in expected.outputs.items():
        np.testing.assert_allclose(found.outputs[name], values, rtol=tolerance, atol=1e-3 * tolerance, err_msg=name)
    for kind in ("errors", "errors_at_end", "validity"):
        one, other = getattr(found, kind), getattr(expected, kind)
        assert one.keys() == other.keys(), kind
        for name, values in other.items():
            # an error is a difference of nodal positions of order 1, known to 1e-12
            np.testing.assert_allclose(one[name], values, rtol=1e-6, atol=1e-12, err_msg=f"{kind} of {name}")
    np.testing.assert_array_equal(found.status, expected.status)
    np.testing.assert_array_equal(found.failure_time, expected.failure_time)
    for name, statistics in expected.statistics.items():
        for item in ("mean", "std", "quantiles", "pdf", "edges"):
            one, other = getattr(found.statistics[name], item), getattr(statistics, item)
            np.testing.assert_allclose(one, other, rtol=1e-6, err_msg=f"{item} of {name}")


def test_samples_do_not_depend_on_ranks_and_batches(folder, small_rom, expected: Ensemble) -> None:
    path = folder / "3.h5"
    run_mpi(3, *PGMP, "montecarlo", small_rom, "-n", N, "--seed", SEED, *BATCHES, "-o", path)
    found = Ensemble.read(path)
    assert (found.record.ranks, found.record.seed) == (3, SEED)
    assert_equal(found, expected)
    assert [int(np.isfinite(values).sum()) for values in found.errors.values()] == [20] * 3, "the first of a thousand"
    np.testing.assert_array_equal(found.status, 0)
    assert not path.with_name(f"{path.name}.partial").exists()


def test_the_sampled_values_are_those_of_the_scene(expected: Ensemble) -> None:
    np.testing.assert_array_equal(expected.parameters["r1"], draw(paper_scene(), SEED, 0, N)["r1"])


def test_the_share_of_checked_samples(folder: Path, small_rom: Path, expected: Ensemble) -> None:
    """All, none, or no indicator: outputs are the same, estimates where they are wanted."""
    for share, n_checked in (("1.0", N), ("0.005", 5), ("0.0", None)):
        path = folder / f"share_{share}.h5"
        asked = overridden(f"ensemble.checked_share={share}")
        done = pgmp("montecarlo", small_rom, "-n", N, "--seed", SEED, "-o", path, *asked)
        found = Ensemble.read(path)
        np.testing.assert_equal(found.outputs, expected.outputs)
        if n_checked is None:
            assert (found.errors, found.errors_at_end) == ({}, {})
            assert done.stdout.count("errors were not estimated: ensemble.checked_share = 0") == 1
            continue
        assert f"{n_checked} samples" in done.stdout
        for name, values in found.errors.items():
            np.testing.assert_array_equal(np.isfinite(values), np.arange(N) < n_checked)
            both = np.arange(N) < min(n_checked, 20)
            np.testing.assert_allclose(values[both], expected.errors[name][both], rtol=1e-6, atol=1e-12)
            assert np.all(values[:n_checked] >= np.abs(found.errors_at_end[name][:n_checked]))
    path = folder / "unwatched.h5"
    pgmp("montecarlo", small_rom, "-n", 3, "--seed", SEED, "-o", path, "--override", "simulation.error_indicator=false")
    unwatched = Ensemble.read(path)
    assert unwatched.errors == {}
    assert any("error_indicator = false" in remark.text for remark in unwatched.record.remarks)
    for name, values in unwatched.validity.items():
        np.testing.assert_array_equal(values, expected.validity[name][:3])


def test_a_killed_run_is_resumed_on_other_ranks(folder: Path, small_rom: Path, uninterrupted: Ensemble) -> None:
    """SIGKILL on one of two; what is stored is not computed again: a piece with other numbers stays as it is."""
    path = folder / "killed.h5"
    killed = run_mpi(2, "-c", KILLED, "montecarlo", small_rom, *LONG, "-o", path, check_status=None)
    assert killed.returncode != 0 and not path.exists()
    partial = path.with_name("killed.h5.partial")
    marked = sorted(partial.glob("samples_*.npz"))[1]
    first = int(marked.stem.removeprefix("samples_"))
    with resealed_piece(marked) as arrays:
        arrays["validity.elastic_strain"] += 1.0
    stored = {file.name: file.stat().st_mtime_ns for file in partial.glob("*.npz")}
    assert len(stored) == 13
    refused = pgmp("montecarlo", small_rom, *LONG, "--seed", SEED + 1, "-o", path, "--resume", status=2)
    assert f"its seed differs ({SEED} there, {SEED + 1} here)" in refused.stderr
    assert {file.name: file.stat().st_mtime_ns for file in partial.glob("*.npz")} == stored
    run_mpi(3, *PGMP, "montecarlo", small_rom, *LONG, "-o", path, "--resume")
    found = Ensemble.read(path)
    found.validity["elastic_strain"][first : first + 2] -= 1.0
    assert_equal(found, uninterrupted)
    assert not partial.exists()


def test_unphysical_samples_are_recorded_and_not_integrated(folder: Path, small_rom: Path) -> None:
    """A distribution ten times too wide, without bounds, gives negative radii; others are as they would be alone."""
    path = folder / "wide.h5"
    wide = 'parameters.r1={nominal=5.6e-3, unit="m", distribution={name="norm", loc=5.6e-3, scale=5.6e-3}}'
    words = ("montecarlo", small_rom, "-n", N, "--seed", SEED, *BATCHES, *overridden(wide), "-o", path)
    done = run_mpi(2, *PGMP, *words, check_status=1)
    found = Ensemble.read(path)
    values = found.parameters["r1"]
    outside = values <= 0.0
    assert 0 < outside.sum() < N
    np.testing.assert_array_equal(found.status, np.where(outside, Status.UNPHYSICAL, Status.FINE))
    np.testing.assert_array_equal(found.failure_time, np.where(outside, 0.0, np.nan))
    for name, output in found.outputs.items():
        np.testing.assert_array_equal(np.isnan(output), outside)
        np.testing.assert_array_equal(np.isfinite(found.errors[name]), ~outside & (np.arange(N) < 20))
        assert found.statistics[name].mean == pytest.approx(output[~outside].mean(), rel=1e-12)
    assert f"{outside.sum()} of {N} samples failed (status 1)" in done.stdout
    assert "may be biased: no parameter alone tells" in done.stdout  # one of 22 tells nothing
    assert "Traceback" not in done.stderr
    assert not path.with_name(f"{path.name}.partial").exists()


def test_the_balance_of_energy_is_kept_where_it_is_asked_for(folder: Path, small_rom: Path) -> None:
    """Its residual falls with the square of the step, in both models; sample by sample on any ranks."""
    found = {}
    for model, source in (("reduced", (small_rom,)), ("full", (PAPER_SCENE, "--full"))):
        for step in (1e-3, 5e-4):
            path = folder / f"balance_{model}_{step}.h5"
            asked = overridden("ensemble.balance=true", f"simulation.step={step}", "simulation.duration=0.1")
            done = pgmp("montecarlo", *source, "-n", 3, "--seed", SEED, "-o", path, *asked)
            assert "balance of energy: residual" in done.stdout
            ensemble = Ensemble.read(path)
            assert ensemble.balance["exchanged"].shape == (3,) and ensemble.balance["exchanged"].min() > 0.0
            found[model, step] = ensemble.balance["residual"] / ensemble.balance["exchanged"]
        order = np.log2(found[model, 1e-3] / found[model, 5e-4])
        assert np.all((order > 1.5) & (order < 2.5)), f"{model}: {order}"


def test_groups_of_ranks_share_samples(folder: Path) -> None:
    """Two groups, of two ranks and of one; a rank alone has the samples in a batch."""
    asked = ("-n", 3, "--seed", SEED, "--full", *overridden("simulation.duration=0.002"))
    alone, shared = folder / "alone.h5", folder / "shared.h5"
    pgmp("montecarlo", PAPER_SCENE, *asked, "-o", alone)
    done = run_mpi(3, *PGMP, "montecarlo", PAPER_SCENE, *asked, "-o", shared, "--ranks-per-sample", 2)
    assert done.stderr.count("a sample has 36 unknowns, less than 3000 for each of its ranks") == 1
    one, other = Ensemble.read(alone), Ensemble.read(shared)
    for name, values in one.outputs.items():
        np.testing.assert_allclose(other.outputs[name], values, rtol=0, atol=1e-9 * max(1e-3, np.abs(values).max()))


def test_groups_that_cannot_be(folder: Path, small_rom: Path) -> None:
    words = ("montecarlo", "-n", 2, "-o", folder / "no.h5", "--ranks-per-sample")
    small, many = refused(2, [[*words, 2, small_rom], [*words, 4, PAPER_SCENE, "--full"]])
    assert small.startswith("--ranks-per-sample = 2: samples of a reduced model are small")
    assert many.startswith("--ranks-per-sample = 4: allowed are 1 to 2")
