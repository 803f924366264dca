"""Samplers, events, extremes, bands, files of samples and shards, through the command, on one rank and on several."""

import json
import re
from pathlib import Path

import h5py
import numpy as np
import pytest
from conftest import run_mpi
from runs import PGMP, SMALL, overridden, paper_scene, pgmp, refused, rom_of

from pgmp_petsc.ensemble.plan import Plan
from pgmp_petsc.ensemble.sampling import Sampler
from pgmp_petsc.results import Ensemble, Trajectory
from pgmp_petsc.results.numbers import interval_text
from pgmp_petsc.scene import scene_from_toml
from scenes import tables

UNCERTAIN = (
    *SMALL,
    'parameters.push={nominal=1.0, distribution={name="uniform", loc=0.8, scale=0.4}}',
    'effects.motor.scale="push"',
)
UNCHECKED = "ensemble.checked_share=0.0"
LEVEL = 2e-3
ASKED = overridden(
    UNCHECKED, "ensemble.extremes=true", "ensemble.bands=11",
    f'ensemble.probabilities.begun={{output="crank_angle", above={LEVEL}, when="ever"}}',
    'ensemble.probabilities.behind={output="crank_angle", below=0.0}',
)  # fmt: skip


@pytest.fixture(scope="module")
def rom(folder: Path) -> Path:
    path = folder / "rom.h5"
    rom_of(paper_scene(*UNCERTAIN)).write(path)
    return path


@pytest.fixture(scope="module")
def sobol(folder: Path, rom: Path) -> tuple[Ensemble, str]:
    """Return an ensemble of scrambled Sobol points, and what the command said."""
    path = folder / "sobol.h5"
    done = pgmp("montecarlo", rom, "-n", 64, "--seed", 3, "--sampler", "sobol", *ASKED, "-o", path)
    return Ensemble.read(path), done.stdout


def test_figures_over_time_are_those_of_single_runs(folder: Path, rom: Path, sobol: tuple[Ensemble, str]) -> None:
    ensemble, _ = sobol
    band, angles = ensemble.bands["crank_angle"], []
    passages = ensemble.first_passages["begun"]
    for number in (0, 9):
        values = [f"{name}={column[number]:.17g}" for name, column in ensemble.parameters.items()]
        path = folder / f"run_{number}.h5"
        pgmp("simulate", rom, *(word for value in values for word in ("--set", value)), "-o", path)
        run = Trajectory.read(path)
        for name, output in run.outputs.items():
            assert ensemble.extremes[f"{name}/max"][number] == pytest.approx(output.max(), rel=1e-9, abs=1e-15)
            assert ensemble.extremes[f"{name}/min"][number] == pytest.approx(output.min(), rel=1e-9, abs=1e-15)
        np.testing.assert_allclose(band.time, run.time[::5], atol=1e-12)
        angle = run.outputs["crank_angle"]
        angles.append(angle)
        if number:  # one that never gets there
            assert np.isnan(passages[number]) and angle.max() <= LEVEL
            continue
        first = int(np.argmax(angle > LEVEL))
        share = (LEVEL - angle[first - 1]) / (angle[first] - angle[first - 1])
        assert passages[number] == pytest.approx(run.time[first - 1] + share * 1e-3, rel=1e-6)
    np.testing.assert_allclose(band.mean[-1], ensemble.outputs["crank_angle"].mean(), rtol=1e-12)
    np.testing.assert_allclose(band.std[-1], ensemble.outputs["crank_angle"].std(ddof=1), rtol=1e-9)
    np.testing.assert_allclose(band.quantiles[-1], ensemble.statistics["crank_angle"].quantiles, rtol=1e-12)
    assert np.all((band.quantiles[:, 0] <= np.min(angles, axis=0)[::5]) | (band.count > 40))
    begun, behind = ensemble.probabilities["begun"], ensemble.probabilities["behind"]
    assert (begun.count, begun.n) == (int(np.isfinite(passages).sum()), 64) and behind.count == 0
    assert behind.interval[0] == 0.0 < behind.interval[1]
    assert ensemble.statistics["crank_angle.max"].mean == pytest.approx(ensemble.extremes["crank_angle/max"].mean())


def test_the_terminal_says_what_the_file_holds(sobol: tuple[Ensemble, str], folder: Path, undrawn: None) -> None:
    ensemble, said = sobol
    assert "95 % interval" in said and "crank_angle below 0 rad at the end, 0 of 64 samples" in said
    assert "note: intervals follow from the spread between 8 scrambled Sobol sequences" in said
    assert "mean, deviation and quantiles of 64 samples at 11 instants" in said
    assert "64 samples are too few to rank parameters" in said
    assert "begun: first passage" in said
    told = pgmp("info", folder / "sobol.h5").stdout
    assert "crank_angle below 0 rad at the end, 0 of 64 samples" in told
    pictures = pgmp("plot", folder / "sobol.h5", "-o", folder / "pictures").stdout
    assert "densities.png" in pictures and "bands.png" in pictures
    found = ensemble.statistics["crank_angle"]
    assert found.mean_interval[0] < found.mean < found.mean_interval[1]


def test_ranks_batches_and_longer_runs_have_no_part_in_it(folder: Path, rom: Path, sobol: tuple[Ensemble, str]) -> None:
    path = folder / "ranks.h5"
    asked = (*ASKED, *overridden("ensemble.batch=7"))
    run_mpi(2, *PGMP, "montecarlo", rom, "-n", 64, "--seed", 3, "--sampler", "sobol", *asked, "-o", path)
    found, (expected, _) = Ensemble.read(path), sobol
    scene = scene_from_toml(expected.record.scene_toml, folder)
    longer = Sampler(scene, Plan(1000, 3)).draw(0, 64)
    for name, values in expected.parameters.items():
        np.testing.assert_array_equal(found.parameters[name], values)
        np.testing.assert_array_equal(longer[name], values)
    for kind in ("outputs", "extremes", "first_passages"):
        for name, values in getattr(expected, kind).items():
            # the rigid closure of a whole batch stops at 1e-12
            np.testing.assert_allclose(getattr(found, kind)[name], values, rtol=1e-9, atol=1e-12, err_msg=name)
    for name, band in expected.bands.items():
        for part in ("mean", "std", "quantiles"):
            np.testing.assert_allclose(getattr(found.bands[name], part), getattr(band, part), rtol=1e-6, atol=1e-12)


def test_blocks_lead_to_sobol_indices(rom: Path, folder: Path) -> None:
    path = folder / "saltelli.h5"
    done = pgmp("montecarlo", rom, "-n", 128, "--sampler", "saltelli", "-o", path, *overridden(UNCHECKED))
    found = Ensemble.read(path)
    indices = found.sobol["crank_angle"]
    assert (indices.parameters, indices.count, indices.method) == (("push", "r1"), 32, "saltelli")
    # the angle is nearly the torque's integral over a nearly rigid mechanism: what is left is the inertia of the crank
    # 32 blocks know an index to 0.15
    assert indices.first[0] > indices.first[1] and np.sum(indices.first) == pytest.approx(1.0, abs=0.4)
    assert "from 8 Sobol sequences of 4 blocks each" in done.stdout + done.stderr
    assert found.statistics["crank_angle"].count == 64
    assert "Sobol indices" in done.stdout and "base points A and B" in done.stdout
    done = pgmp("montecarlo", rom, "-n", 130, "--sampler", "saltelli", "-o", path, status=2)
    assert "-n 130 with the sampler saltelli: each of its base points takes 4 samples" in done.stderr
    assert "such as 128 or 132" in done.stderr


def test_a_file_of_samples_repeats_them_in_another_model(rom: Path, folder: Path, sobol: tuple[Ensemble, str]) -> None:
    """An ensemble's file is a table too; a table of text gives the same."""
    ensemble, _ = sobol
    table = folder / "table.csv"
    rows = zip(*(ensemble.parameters[name] for name in ("push", "r1")))
    table.write_text("push,r1\n" + "".join(f"{push:.17g},{r1:.17g}\n" for push, r1 in rows))
    for source, given in ((folder / "sobol.h5", ()), (table, ("-n", 5))):
        path = folder / "repeated.h5"
        done = pgmp("montecarlo", rom, "--samples", source, *given, "-o", path, *overridden(UNCHECKED))
        found = Ensemble.read(path)
        n = 5 if given else 64
        assert found.record.seed is None and len(found.status) == n
        for name, values in ensemble.outputs.items():
            np.testing.assert_allclose(found.outputs[name], values[:n], rtol=1e-9, atol=1e-12)
        assert f"samples are those of '{source}'" in done.stdout
    with h5py.File(path) as file:
        assert json.loads(file.attrs["remarks"])


def test_bad_input_is_one_message(folder: Path, rom: Path) -> None:
    table, fixed = folder / "bad.csv", folder / "fixed.csv"
    table.write_text("push,r1\n1.0,5e-3\n1.0,wide\n")
    fixed.write_text("push,r1\n1.0,5e-3\n")
    cases = (
        ((), "-n: missing; give the number of samples, a file of samples with --samples, or a time with --budget"),
        (("--samples", table), f"--samples {table}: line 3: r1 = 'wide'; a number is needed"),
        (("--samples", table, "--sampler", "sobol"), "--sampler sobol: the samples are those of --samples"),
        (("-n", 4, *overridden('ensemble.probabilities.x={output="angle", above=1.0}')),
         "ensemble.probabilities.x.output = \"angle\": there is no such output; did you mean 'crank_angle'?"),
        # a table with the parameter that is set
        (("--samples", fixed, "--set", "r1=5e-3", *overridden("parameters.r1={nominal=5.6e-3}")),
         f"--set r1=5e-3: every sample takes 'r1' from --samples {fixed}; leave one of them out"),
    )  # fmt: skip
    messages = refused(1, [["montecarlo", rom, *words, "-o", folder / "no.h5"] for words, _ in cases])
    for (_, said), message in zip(cases, messages):
        assert message.startswith(said)
    assert not (folder / "no.h5").exists()


# A bar of 1 kg and a flywheel about a hinge: theta(1 s) = w + a / (2 (1/3 + 1)); runs end where it leaves its range.
BAR = tables("""
scene: name = "bar"
parameters.a: nominal = 1.0; distribution = { name = "norm", loc = 1.0, scale = 0.3 }
parameters.w: nominal = 0.5; distribution = { name = "uniform", loc = 0.0, scale = 1.0 }
materials.steel: E = 210e9; nu = 0.3; rho = 2500.0
bodies.bar: line = { length = 1.0, elements = 2 }; element = "beam2d"; material = "steel";
    section = { shape = "rectangle", width = 0.02, height = 0.02 }
joints.hinge: type = "revolute"; connect = ["ground:origin", "bar:hinge"]
coordinates.theta: joint = "hinge"; range = [-0.5, 1.3]
effects.torque: type = "torque"; joint = "hinge"; table = [[0.0, 1.0], [1.0, 1.0]]; scale = "a"
effects.flywheel: type = "point_mass"; point = "bar:hinge"; mass = 1.0; inertia = 1.0
reduction: modes = 1; angles = 12
simulation: duration = 1.0; step = 0.05
simulation.initial.theta: velocity = "w"
ensemble: bands = 0; sampler = "sobol"
ensemble.probabilities.far: output = "angle"; above = 1.25
outputs.angle: type = "angle"; joint = "hinge"
outputs.still: type = "position"; point = "bar:hinge"; axis = "y"
outputs.bend: type = "deformation"; point = "bar:tip"; axis = "y"; frame = "body"
""")


def test_failed_samples_belong_to_the_probability_on_the_line_in_json_and_in_the_file(tmp_path: Path) -> None:
    """All that fail are in the event: the interval of the others is below the true probability, worked out here."""
    (tmp_path / "bar.toml").write_text(BAR)
    pgmp("build", tmp_path / "bar.toml", "-o", tmp_path / "bar.h5")
    said = pgmp("montecarlo", tmp_path / "bar.h5", "-n", 512, "-o", tmp_path / "many.h5", status=1).stdout
    (line,) = (line for line in said.splitlines() if line.split()[:1] == ["far"])
    random = np.random.default_rng(0)
    angle = random.uniform(size=10**6) + random.normal(1.0, 0.3, 10**6) / (8.0 / 3.0)
    true = float(np.mean(angle > 1.25))
    found = Ensemble.read(tmp_path / "many.h5")
    chance, n_failed = found.probabilities["far"], int(np.count_nonzero(found.status))
    assert n_failed > 20
    assert f"{chance.count} of {512 - n_failed} samples, {n_failed} more failed and count both ways" in line
    assert (chance.n, chance.n_failed) == (512 - n_failed, n_failed)
    low, high = chance.interval
    assert low <= true <= high and interval_text(chance.interval) in line
    assert chance.estimate < true - 0.05
    of_event = json.loads(pgmp("info", tmp_path / "many.h5", "--json").stdout)["probabilities"]["far"]
    assert of_event["failed"] == n_failed and of_event["interval"] == [low, high] and of_event["decided"] is True
    exported = pgmp("export", tmp_path / "bar.h5", "-o", tmp_path / "c").stdout
    assert "note: w = 0.5 rad/s: the model is made with it" in exported
    # the hinge stands still
    assert found.statistics["still"].constant and "still" not in found.sobol
    assert next(line for line in said.splitlines() if line.split()[:1] == ["still"]).split()[2] == "constant"
    assert "note: still is constant" in said
    # the sampler knows no more of heavy tails than others do, and says so
    heavy = [f"parameters.{one}.distribution={{name={law}}}" for one, law in
             (("a", '"lognorm",s=1.0,scale=0.1'), ("w", '"uniform",loc=0.4995,scale=1e-3'))]  # fmt: skip
    said = pgmp("montecarlo", tmp_path / "bar.h5", "-n", 512, *overridden(*heavy), "-o", tmp_path / "h.h5", status=None)
    assert re.search(r"warning: the deviation of [a-z, ]*angle[a-z, ]* rests on a few samples", said.stdout)


N, COUNT = 101, 3  # of samples, so that shards are not of one size, and of shards
SHARDED = overridden(
    "ensemble.extremes=true",
    "ensemble.bands=5",
    "ensemble.band_samples=50",  # they end within the second shard
    'ensemble.probabilities.begun={output="crank_angle", above=2e-3, when="ever"}',
)
# a Latin hypercube depends on the number of all samples
KINDS = {"random": (), "latin_hypercube": ("--sampler", "latin_hypercube", *overridden("ensemble.checked_share=0.01"))}
MANY = 1200  # beyond 1,000 more samples are checked: as many as of the whole, of which shards have parts


def ensemble(rom: Path, output: Path, *options: object, n: int = N, seed: int = 3, status: int = 0) -> Path:
    pgmp("montecarlo", rom, "-n", n, "--seed", seed, *SHARDED, *options, "-o", output, status=status)
    return output


@pytest.fixture(scope="module")
def shards(folder: Path, rom: Path) -> list[Path]:
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
    n = N if kind == "random" else MANY
    whole, parts = ensemble(rom, folder / f"{kind}.h5", *KINDS[kind], n=n), shards
    if kind != "random":
        of = {k: ("--shard", f"{k}/{COUNT}") for k in range(1, COUNT + 1)}
        parts = [ensemble(rom, folder / f"{kind}_{k}.h5", *KINDS[kind], *words, n=n) for k, words in of.items()]
    told = pgmp("info", parts[1]).stdout
    assert "shard of an ensemble of the reduced model" in told and "/columns/outputs.crank_angle" in told
    said = pgmp("merge", *parts[::-1], "-o", folder / f"{kind}_merged.h5").stdout
    same(whole, folder / f"{kind}_merged.h5")
    assert f"{n} samples" in said and "crank_angle.max" in said


def test_failed_samples_end_shards_and_their_whole_with_status_one(folder: Path, rom: Path) -> None:
    short = overridden("simulation.duration=0.012")
    table = folder / "samples.csv"
    rows = "\n".join(f"5.6e-3,{1.0 if k % 4 else 1e12}" for k in range(8))
    table.write_text(f"r1,push\n{rows}\n")
    options = ("--samples", table, *short)
    pgmp("montecarlo", rom, *SHARDED, *options, "-o", folder / "failing.h5", status=1)
    parts = [folder / f"failing_{k}.h5" for k in (1, 2)]
    for k, part in enumerate(parts, start=1):
        done = pgmp("montecarlo", rom, *SHARDED, *options, "--shard", f"{k}/2", "-o", part, status=1)
        assert "of 4 samples failed; pgmp merge says why" in done.stdout
    pgmp("merge", *parts, "-o", folder / "failing_merged.h5", status=1)
    same(folder / "failing.h5", folder / "failing_merged.h5")
    assert np.sum(Ensemble.read(folder / "failing_merged.h5").status != 0) == 2


def test_ranks_have_no_part_in_it(folder: Path, rom: Path, shards: list[Path]) -> None:
    output = folder / "two_ranks.h5"
    run_mpi(2, *PGMP, "montecarlo", rom, "-n", N, "--seed", 3, *SHARDED, "--shard", "2/3", "-o", output)
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


def refusal_of(folder: Path, *files: Path) -> str:
    output = folder / "no.h5"
    said = pgmp("merge", *files, "-o", output, status=2).stderr
    assert said.startswith("pgmp: error: ") and not output.exists()
    return said


def test_shards_that_do_not_belong_together_are_refused(folder: Path, rom: Path, shards: list[Path]) -> None:
    assert "missing: shard 2/3; give the files of all 3" in refusal_of(folder, shards[0], shards[2])
    assert "shard 1/3 is there twice" in refusal_of(folder, shards[0], shards[0], shards[1], shards[2])
    other = ensemble(rom, folder / "seed.h5", "--shard", "2/3", seed=4)
    assert f"its seed differs (3 in '{shards[0]}', 4 in '{other}')" in refusal_of(folder, shards[0], other, shards[2])
    other = ensemble(rom, folder / "size.h5", "--shard", "2/3", n=120)
    assert "its number of samples differs (101 in" in refusal_of(folder, shards[0], other, shards[2])
    other = ensemble(rom, folder / "halves.h5", "--shard", "2/2")
    assert "is one of 2 shards and" in refusal_of(folder, shards[0], other)
    other = ensemble(rom, folder / "scene.h5", "--shard", "2/3", *overridden("simulation.duration=0.01"))
    assert "its scene differs" in refusal_of(folder, shards[0], other, shards[2])


def test_other_files_are_refused(folder: Path, rom: Path, shards: list[Path]) -> None:
    assert "holds a reduced model; needed: a shard of an ensemble" in refusal_of(folder, rom)
    cut = folder / "cut.h5"
    cut.write_bytes(shards[0].read_bytes()[:-100])
    assert "is damaged" in refusal_of(folder, cut, *shards[1:])
    done = pgmp("merge", *shards, "-o", shards[0], status=2)
    assert "no.h5" not in done.stderr and done.stderr.startswith("pgmp: error: ")
