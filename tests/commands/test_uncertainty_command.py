"""Samplers, events, extremes, bands and files of samples, through the command, on one rank and on several."""

import json
import re
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
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


def test_ranks_batches_and_longer_runs_have_no_part_in_it(
    mpirun: Callable, folder: Path, rom: Path, sobol: tuple[Ensemble, str]
) -> None:
    path = folder / "ranks.h5"
    asked = (*ASKED, *overridden("ensemble.batch=7"))
    mpirun(2, *PGMP, "montecarlo", rom, "-n", 64, "--seed", 3, "--sampler", "sobol", *asked, "-o", path)
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
    refused = pgmp("montecarlo", rom, "-n", 130, "--sampler", "saltelli", "-o", path, status=2)
    assert "-n 130 with the sampler saltelli: each of its base points takes 4 samples" in refused.stderr
    assert "such as 128 or 132" in refused.stderr


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


def test_bad_input_is_one_message_on_several_ranks(folder: Path, rom: Path) -> None:
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
    messages = refused(2, [["montecarlo", rom, *words, "-o", folder / "no.h5"] for words, _ in cases])
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
    # the hinge stands still
    assert found.statistics["still"].constant and "still" not in found.sobol
    assert next(line for line in said.splitlines() if line.split()[:1] == ["still"]).split()[2] == "constant"
    assert "note: still is constant" in said
    # the sampler knows no more of heavy tails than others do, and says so
    heavy = [f"parameters.{one}.distribution={{name={law}}}" for one, law in
             (("a", '"lognorm",s=1.0,scale=0.1'), ("w", '"uniform",loc=0.4995,scale=1e-3'))]  # fmt: skip
    said = pgmp("montecarlo", tmp_path / "bar.h5", "-n", 512, *overridden(*heavy), "-o", tmp_path / "h.h5", status=None)
    assert re.search(r"warning: the deviation of [a-z, ]*angle[a-z, ]* rests on a few samples", said.stdout)
