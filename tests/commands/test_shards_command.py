"""Shards of an ensemble, joined, are what one run gives: bit for bit, whatever the sampler, ranks and failures."""

from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
from runs import PGMP, SMALL, overridden, paper_scene, pgmp, rom_of

from pgmp_petsc.results import Ensemble

UNCERTAIN = (
    *SMALL,
    'parameters.push={nominal=1.0, distribution={name="uniform", loc=0.8, scale=0.4}}',
    'effects.motor.scale="push"',
)
N, COUNT = 101, 3  # of samples, so that shards are not of one size, and of shards
ASKED = overridden(
    "ensemble.extremes=true",
    "ensemble.bands=5",
    "ensemble.band_samples=50",  # they end within the second shard
    'ensemble.probabilities.begun={output="crank_angle", above=2e-3, when="ever"}',
)
# a Latin hypercube depends on the number of all samples
KINDS = {"random": (), "latin_hypercube": ("--sampler", "latin_hypercube")}


@pytest.fixture(scope="module")
def rom(folder: Path) -> Path:
    path = folder / "rom.h5"
    rom_of(paper_scene(*UNCERTAIN)).write(path)
    return path


def ensemble(rom: Path, output: Path, *options: object, n: int = N, seed: int = 3, status: int = 0) -> Path:
    pgmp("montecarlo", rom, "-n", n, "--seed", seed, *ASKED, *options, "-o", output, status=status)
    return output


@pytest.fixture(scope="module")
def shards(folder: Path, rom: Path) -> list[Path]:
    """Return the files of all shards of the random ensemble."""
    names = range(1, COUNT + 1)
    return [ensemble(rom, folder / f"random_{k}.h5", "--shard", f"{k}/{COUNT}") for k in names]


def same(one: Path, other: Path) -> None:
    """Check that two files have the same datasets, bit for bit, but for times, and say the same."""
    with h5py.File(one) as a, h5py.File(other) as b:
        found: list[set[str]] = [set(), set()]
        for names, file in zip(found, (a, b)):
            file.visititems(lambda name, item, names=names: names.add(name) if hasattr(item, "shape") else None)
        assert found[0] == found[1] and len(found[0]) > 50
        for name in found[0] - {name for name in found[0] if name.startswith("timings/")}:
            np.testing.assert_array_equal(a[name][()], b[name][()], err_msg=name)
            one, other = ({key: str(value) for key, value in file[name].attrs.items()} for file in (a, b))
            assert one == other, name
        for name in ("scene", "parameters", "model", "remarks"):
            assert a.attrs[name] == b.attrs[name]
        assert str(a.attrs["seed"]) == str(b.attrs["seed"])


@pytest.mark.parametrize("kind", ["random", "latin_hypercube"])
def test_joined_shards_are_what_one_run_gives(folder: Path, rom: Path, shards: list[Path], kind: str) -> None:
    whole, parts = ensemble(rom, folder / f"{kind}.h5", *KINDS[kind]), shards
    if kind != "random":
        of = {k: ("--shard", f"{k}/{COUNT}") for k in range(1, COUNT + 1)}
        parts = [ensemble(rom, folder / f"{kind}_{k}.h5", *KINDS[kind], *words) for k, words in of.items()]
    told = pgmp("info", parts[1]).stdout
    assert "shard of an ensemble of the reduced model" in told and "/columns/outputs.crank_angle" in told
    said = pgmp("merge", *parts[::-1], "-o", folder / f"{kind}_merged.h5").stdout
    same(whole, folder / f"{kind}_merged.h5")
    assert "101 samples" in said and "crank_angle.max" in said


def test_failed_samples_end_shards_and_their_whole_with_status_one(folder: Path, rom: Path) -> None:
    short = overridden("simulation.duration=0.012")
    table = folder / "samples.csv"
    rows = "\n".join(f"5.6e-3,{1.0 if k % 4 else 1e12}" for k in range(12))
    table.write_text(f"r1,push\n{rows}\n")
    options = ("--samples", table, *short)
    pgmp("montecarlo", rom, *ASKED, *options, "-o", folder / "failing.h5", status=1)
    parts = [folder / f"failing_{k}.h5" for k in (1, 2)]
    for k, part in enumerate(parts, start=1):
        done = pgmp("montecarlo", rom, *ASKED, *options, "--shard", f"{k}/2", "-o", part, status=1)
        assert "of 6 samples failed; pgmp merge says why" in done.stdout
    pgmp("merge", *parts, "-o", folder / "failing_merged.h5", status=1)
    same(folder / "failing.h5", folder / "failing_merged.h5")
    assert np.sum(Ensemble.read(folder / "failing_merged.h5").status != 0) == 3


def test_ranks_have_no_part_in_it(folder: Path, rom: Path, shards: list[Path], mpirun: Callable) -> None:
    output = folder / "two_ranks.h5"
    mpirun(2, *PGMP, "montecarlo", rom, "-n", N, "--seed", 3, *ASKED, "--shard", "2/3", "-o", output)
    pgmp("merge", shards[0], output, shards[2], "-o", folder / "two_ranks_merged.h5")
    pgmp("merge", *shards, "-o", folder / "merged.h5")
    same(folder / "merged.h5", folder / "two_ranks_merged.h5")


@pytest.mark.parametrize("shard", ["0/3", "4/3", "2", "1/0", "a/b", "1/3/3", "-1/3", "1/10", "1/9"])
def test_what_is_no_part_is_refused(folder: Path, rom: Path, shard: str) -> None:
    steps = overridden("simulation.tolerance=1e-2") if shard == "1/9" else []
    said = pgmp("montecarlo", rom, "-n", 9, f"--shard={shard}", *steps, "-o", folder / "no.h5", status=2).stderr
    known = {"1/10": "10 shards of 9 samples; take no more shards than samples",
             "1/9": "every shard would measure a step of its own"}  # fmt: skip
    assert known.get(shard, f"--shard {shard}: allowed are I/K with I from 1 to K, such as 2/8") in said


def refused(folder: Path, *files: Path) -> str:
    output = folder / "no.h5"
    said = pgmp("merge", *files, "-o", output, status=2).stderr
    assert said.startswith("pgmp: error: ") and not output.exists()
    return said


def test_shards_that_do_not_belong_together_are_refused(folder: Path, rom: Path, shards: list[Path]) -> None:
    assert "missing: shard 2/3; give the files of all 3" in refused(folder, shards[0], shards[2])
    assert "shard 1/3 is there twice" in refused(folder, shards[0], shards[0], shards[1], shards[2])
    other = ensemble(rom, folder / "seed.h5", "--shard", "2/3", seed=4)
    assert f"its seed differs (3 in '{shards[0]}', 4 in '{other}')" in refused(folder, shards[0], other, shards[2])
    other = ensemble(rom, folder / "size.h5", "--shard", "2/3", n=120)
    assert "its number of samples differs (101 in" in refused(folder, shards[0], other, shards[2])
    other = ensemble(rom, folder / "halves.h5", "--shard", "2/2")
    assert "is one of 2 shards and" in refused(folder, shards[0], other)
    other = ensemble(rom, folder / "scene.h5", "--shard", "2/3", *overridden("simulation.duration=0.01"))
    assert "its scene differs" in refused(folder, shards[0], other, shards[2])


def test_other_files_are_refused(folder: Path, rom: Path, shards: list[Path]) -> None:
    assert "holds a reduced model; needed: a shard of an ensemble" in refused(folder, rom)
    cut = folder / "cut.h5"
    cut.write_bytes(shards[0].read_bytes()[:-100])
    assert "is damaged" in refused(folder, cut, *shards[1:])
    done = pgmp("merge", *shards, "-o", shards[0], status=2)
    assert "no.h5" not in done.stderr and done.stderr.startswith("pgmp: error: ")
