"""Better models, rules, budgets and further tries of failed samples: through the command, and as it runs them."""

from collections.abc import Sequence
from copy import copy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI
from refusals import assert_refused, refusal
from runs import PAPER_SCENE, SMALL, full_model, in_turn, overridden, paper_scene, pgmp, refused, rom_of, with_step

from pgmp_petsc.api.ensembles import Correction, better_models, exit_status, in_order
from pgmp_petsc.api.sources import Origin
from pgmp_petsc.base.errors import InputError, RunError
from pgmp_petsc.ensemble import integration, joined
from pgmp_petsc.ensemble.checkpoint import remove_checkpoint
from pgmp_petsc.ensemble.integration import read_earlier, run_batch, run_ensemble
from pgmp_petsc.ensemble.joined import PILOT, Better, plan_of
from pgmp_petsc.ensemble.plan import Plan, SampleFile
from pgmp_petsc.ensemble.sampling import draw
from pgmp_petsc.ensemble.stopping import Stop, read_rule
from pgmp_petsc.figures.ensembles import joined as picture_of_means
from pgmp_petsc.figures.ensembles import stopping as picture_of_looks
from pgmp_petsc.models import ReducedModel
from pgmp_petsc.ranks.groups import RankGroup
from pgmp_petsc.results import Ensemble
from pgmp_petsc.scene import Scene
from pgmp_petsc.stepping.generalised_alpha import DIVISORS, integrate_with_smaller_steps
from pgmp_petsc.texts.ensemble_table import report

N, K, SEED = 300, 60, 3
EVENT = 'ensemble.probabilities.late={output="crank_angle", below=1.8e-3}'
ASKED = ("ensemble.checked_share=0.0", "ensemble.bands=5", "ensemble.extremes=true", EVENT)
RULE = "std(crank_angle) < 8 %"


@pytest.fixture(scope="module")
def scene() -> Scene:
    return paper_scene(*SMALL, *ASKED)


@pytest.fixture(scope="module")
def model(scene: Scene) -> ReducedModel:
    return ReducedModel(scene, rom_of(scene))


@pytest.fixture(scope="module")
def rom(folder: Path, scene: Scene) -> Path:
    path = folder / "rom.h5"
    rom_of(scene).write(path)
    return path


def better(model: ReducedModel, *texts: str, n: int | None = N) -> list[Better]:
    return better_models(wanted(texts, "reduced", n), model, Origin("rom.h5", "reduced", (), (), True), MPI.COMM_SELF)


def wanted(texts: Sequence[str], own: str, n: int | None) -> list[Correction]:
    return in_order([Correction.read(text) for text in texts], own, n)


def bounded(scene: Scene, low: float) -> Scene:
    """Return a scene whose radius is at least so large."""
    radius = scene.parameters["r1"].model_copy(update={"bounds": (low, 12e-3)})
    return scene.model_copy(update={"parameters": {"r1": radius}})


def ran(model: ReducedModel, plan: Plan, **options: object) -> Ensemble:
    with RankGroup.split(MPI.COMM_SELF, 1) as group:
        return run_ensemble(model, plan, group, **options)


@pytest.fixture(scope="module")
def together(folder: Path, rom: Path) -> tuple[Ensemble, str]:
    """Return an ensemble joined with two better models, and what the command said."""
    path = folder / "together.h5"
    options = ("--correct", f"full/2={K}", "--correct", f"full={2 * K}")
    done = pgmp("montecarlo", rom, "-n", N, "--seed", SEED, *options, "-o", path)
    return Ensemble.read(path), done.stdout


def test_better_models_have_the_same_draws(together: tuple[Ensemble, str], scene: Scene) -> None:
    found = together[0].joined
    assert found.models == ("full/2", "full", "reduced")
    values = draw(scene, SEED, 0, K)
    for name, divisor in (("full", 1), ("full/2", 2)):
        step = scene.simulation.step / divisor
        full = full_model(with_step(scene, step))
        batch = run_batch(full, values)
        assert len(found.status[name]) == (K if divisor == 2 else 2 * K)
        for output, expected in batch.outputs.items():
            np.testing.assert_allclose(found.outputs[name][output][:K], expected, rtol=1e-8, atol=1e-14)


def test_corrected_figures_are_those_of_their_samples(together: tuple[Ensemble, str]) -> None:
    ensemble, said = together
    found = ensemble.joined
    for name, own in ensemble.outputs.items():
        values = [*(found.outputs[model][name] for model in found.models[:-1]), own]
        nearer = joined.calibrated(values)
        mean = joined.mean_of(nearer, None, sum(one is not other for one, other in zip(nearer, values)))
        one = found.corrected[name]
        assert one.figures["mean"].estimate == pytest.approx(mean.value, rel=1e-12)
        np.testing.assert_allclose(one.figures["mean"].interval, mean.interval(0.95), rtol=1e-12)
        np.testing.assert_array_equal(one.counts, [K, 2 * K, N])
        assert one.figures["std"].interval[0] < one.figures["std"].estimate < one.figures["std"].interval[1]
    assert {"crank_angle.max", "crank_angle.min", "late"} <= set(found.corrected)
    late = found.corrected["late"].figures["estimate"]
    assert late.interval[0] < late.estimate < late.interval[1]
    # steps half as long decide on few samples
    assert "note: /corrected/late: full/2 and full disagree in " in said and "holds more often than it says" in said


def test_the_interval_has_the_mean_of_the_better_model(together: tuple[Ensemble, str], scene: Scene) -> None:
    """Of all N draws in the full-order model, with which sampling has nothing to do: what is left is the bias."""
    ensemble, _ = together
    exact = run_batch(full_model(with_step(scene, 0.5 * scene.simulation.step)), draw(scene, SEED, 0, N))
    for name, values in exact.outputs.items():
        one = ensemble.joined.corrected[name]
        bias = ensemble.outputs[name].mean() - values.mean()
        low, high = one.figures["bias"].interval
        # nearly all of its width is that of coefficients which 60 samples tell; sampling of N draws adds a little
        assert low - 0.5 * (high - low) <= bias <= high + 0.5 * (high - low)
        assert abs(one.figures["mean"].estimate - values.mean()) < 0.2 * np.ptp(one.figures["mean"].interval)
        assert one.figures["mean"].narrower > 1.5  # sqrt(300 / 60) = 2.2 at most


def test_the_terminal_and_the_picture_say_so(together: tuple[Ensemble, str], folder: Path) -> None:
    _, said = together
    assert f"against {K} samples of full/2 alone" in said and "times narrower" in said
    assert "full/2: reduced less full/2" in said and "full/2: probability" in said
    assert f"({K} of full/2, {2 * K} of full, {N} of reduced)" in said
    assert "has the steps of the ensemble" not in said
    assert len(picture_of_means(together[0]).axes) == 9  # three outputs at the end, largest and smallest


def test_ranks_have_no_part_in_it(together: tuple[Ensemble, str], rom: Path, model: ReducedModel, folder: Path) -> None:
    paths = [folder / f"{name}_ranks.h5" for name in ("joined", "until", "budget")]
    options = [
        ["-n", str(N), "--correct", f"full/2={K}", "--correct", f"full={2 * K}"],
        ["-n", "100000", "--until", RULE],
        ["--correct", "full=auto", "--budget", "2s"],
    ]
    commands = [["montecarlo", rom, "--seed", SEED, *words, "-o", path] for words, path in zip(options, paths)]
    assert in_turn(2, commands)[0] == [[0, 0]] * len(commands)
    found, expected = Ensemble.read(paths[0]).joined, together[0].joined
    # the rigid closure of a whole batch stops at 1e-12; a bias is a difference of nearly equal values
    close = {"rtol": 1e-6, "atol": 1e-12}
    for name, one in expected.corrected.items():
        for key, figure in one.figures.items():
            np.testing.assert_allclose(found.corrected[name].figures[key].interval, figure.interval, **close)
    alone = ran(model, Plan(100_000, SEED, folder / "alone.h5"), stop=Stop((read_rule(RULE, model.scene),)))
    np.testing.assert_allclose(Ensemble.read(paths[1]).stopping.intervals, alone.stopping.intervals, **close)
    allotted = Ensemble.read(paths[2])
    assert allotted.joined.corrected["crank_angle"].counts[1] == len(allotted.status) > PILOT


def test_a_stopped_run_is_taken_up_bit_for_bit(model: ReducedModel, folder: Path) -> None:
    """Pieces that are missing are computed again, whichever model they are of; more samples of one may be asked for."""
    whole = ran(model, Plan(N, SEED, folder / "whole.h5"), better=better(model, f"full={K}"))
    plan = Plan(N, SEED, folder / "stopped.h5")
    ran(model, plan, better=better(model, "full=20"))
    models = better(model, f"full={K}")
    for one in (plan, plan_of(plan, models[0])):
        pieces = sorted(Path(f"{one.output}.partial").glob("samples_*.npz"))
        pieces[0].unlink()
    assert Path(f"{plan.output}.partial/full.partial").is_dir()
    found = ran(model, replace(plan, resume=True), better=models)
    for name, one in whole.joined.corrected.items():
        for key, figure in one.figures.items():
            np.testing.assert_array_equal(found.joined.corrected[name].figures[key].interval, figure.interval)
    fewer = replace(plan, resume=True)
    assert_refused("only a larger number may be given", ran, model, fewer, better=better(model, "full=20"))
    remove_checkpoint(plan)
    assert not Path(f"{plan.output}.partial").exists()


def test_a_sample_that_fails_in_one_model_is_left_out(model: ReducedModel, folder: Path) -> None:
    one = better(model, "full=40")[0]
    one.model.scene = bounded(one.model.scene, 5.0e-3)
    found = ran(model, Plan(N, SEED, folder / "lost.h5"), better=[one])
    n_lost = int(np.sum(found.parameters["r1"][:40] < 5.0e-3))
    assert 0 < n_lost == found.joined.n_failed
    np.testing.assert_array_equal(found.joined.corrected["crank_angle"].counts, [40 - n_lost, N - n_lost])
    assert any(f"is without {n_lost} draws that failed" in remark.text for remark in found.record.remarks)
    assert exit_status(found) == 1


def test_a_budget_allots_samples_and_a_resume_keeps_them(model: ReducedModel, folder: Path) -> None:
    plan = Plan(10**9, SEED, folder / "allotted.h5", is_limited=False)
    models = better(model, "full=auto", n=None)
    found = ran(model, plan, better=models, stop=Stop((), 2.0))
    counts = found.joined.corrected["crank_angle"].counts
    assert PILOT <= counts[0] < counts[1] == len(found.status)
    for piece in Path(f"{plan.output}.partial").glob("samples_*.npz"):
        piece.unlink()
        break
    again = ran(model, replace(plan, resume=True), better=better(model, "full=auto", n=None), stop=Stop((), 1e-3))
    np.testing.assert_array_equal(again.joined.corrected["crank_angle"].counts, counts)
    with pytest.raises(InputError, match="does not pay for 16 samples of each better model"):
        ran(model, Plan(10**6, SEED, folder / "dear.h5"), better=better(model, "full=auto"), stop=Stop((), 0.5))


def test_a_budget_allots_whole_sequences(rom: Path, folder: Path) -> None:
    """Of Sobol sequences each has as many samples of every model."""
    path = folder / "sequences.h5"
    pgmp("montecarlo", rom, "--sampler", "sobol", "--correct", "full=auto", "--budget", "2s", "-o", path)
    counts = Ensemble.read(path).joined.corrected["crank_angle"].counts
    assert counts[0] % 32 == counts[1] % 8 == 0 < counts[0]


BAD = [
    ("full", "--correct full: allowed are [SCENE:]MODEL[/D]=K with full, components or reduced"),
    ("fast=20", "--correct fast=20: allowed are [SCENE:]MODEL"),
    ("full=0.5", "--correct full=0.5: allowed are [SCENE:]MODEL"),
    ("full/0=20", "--correct full/0=20: allowed are [SCENE:]MODEL"),
    ("full=7", "at least 8 samples"),
    ("reduced=20", "reduced is no better than the ensemble's own model, reduced"),
    ("full=301", "301 samples of full and 300 of reduced, which is worse"),
    ("full=20 full=30", "full is there twice"),
    ("components=20 full=50", "50 samples of full and 20 of components"),
]


@pytest.mark.parametrize(("texts", "said"), BAD)
def test_what_is_no_better_model_is_refused(texts: str, said: str) -> None:
    assert said in refusal(wanted, texts.split(), "reduced", N)


REFUSED = [
    (("--correct", "full=20", "--until", RULE), '--until "std(crank_angle) < 8 %" and --correct'),
    (("--correct", "full=auto"), "--correct full=auto: what decides on the number is missing; give --budget"),
    (("--correct", "full=20", "--budget", "9s"), "gives the number of samples, and nothing is left to choose"),
    (("--correct", "full=20", "--sampler", "saltelli", "-n", "30"), "--correct with the sampler saltelli"),
    (("--correct", "full=20", "--sampler", "sobol"), "needs as many samples, and 4 at least; give a multiple of 32"),
    (("--until", RULE, "--sampler", "latin_hypercube"), "--until and --budget with the sampler latin_hypercube"),
    (("--until", RULE, "--shard", "1/2"), "--shard 1/2: --until goes by all samples"),
    (("--budget", "soon"), "--budget soon: allowed is a time such as 60s, 10min or 2h"),
    (("--until", "std(crank_angle) < 8"), "expected at character 21: '%'"),
    (("--retry-failed", "a.h5"), "-n: --retry-failed a.h5 takes samples and their number from the file"),
]


def test_options_that_do_not_fit_are_one_message(folder: Path, rom: Path) -> None:
    output = folder / "no.h5"
    messages = refused(1, [["montecarlo", rom, "-n", N, *words, "-o", output] for words, _ in REFUSED])
    assert not output.exists() and all(said in message for (_, said), message in zip(REFUSED, messages))


def test_a_rule_stops_and_a_resume_stops_there_too(model: ReducedModel, rom: Path, folder: Path) -> None:
    path = folder / "until.h5"
    done = pgmp("montecarlo", rom, "-n", 100_000, "--seed", SEED, "--until", RULE, "-o", path)
    found = Ensemble.read(path)
    n = len(found.status)
    assert found.stopping.is_met and found.stopping.rules == (RULE,) and n == found.stopping.samples[-1] < 5000
    assert f"stopped after {n} samples" in done.stdout and "96.28 %" in done.stdout
    statistics = found.statistics["crank_angle"]
    np.testing.assert_array_equal(statistics.std_interval, found.stopping.intervals[0, -1])
    assert statistics.confidence == 0.95 and found.stopping.reached[0, -1] <= 0.08 < found.stopping.reached[0, -2]
    plan = Plan(100_000, SEED, folder / "resumed.h5")
    stop = Stop((read_rule(RULE, model.scene),))
    ran(model, plan, stop=stop)
    sorted(Path(f"{plan.output}.partial").glob("samples_*.npz"))[-1].unlink()
    again = ran(model, replace(plan, resume=True), stop=stop)
    np.testing.assert_array_equal(again.stopping.intervals, found.stopping.intervals)
    assert picture_of_looks(found).axes[0].get_xscale() == "log"


def test_a_rule_that_is_not_met_ends_with_status_one(model: ReducedModel, folder: Path) -> None:
    rule = "std(crank_angle) < 1 %"
    found = ran(model, Plan(100, SEED, folder / "unmet.h5"), stop=Stop((read_rule(rule, model.scene),)))
    said = f'--until "{rule}" is not met: these are all samples (-n 100), and +- '
    assert said in report(found, folder / "unmet.h5") and len(found.status) == 100
    assert exit_status(found) == 1 and "--until" in found.record.remarks[-2].text
    # one look is said to be one; a budget alone needs no number
    stop = Stop((read_rule("mean(crank_angle) < 90 %", model.scene),))
    found = ran(model, Plan(200, SEED, folder / "once.h5"), stop=stop)
    assert len(found.status) == 64 and "samples were looked at once; each" in report(found, folder / "once.h5")
    found = ran(model, Plan(10**9, SEED, folder / "budget.h5", is_limited=False), stop=Stop((), 0.2))
    assert "the budget of 0.2 s is spent" in report(found, folder / "budget.h5") and len(found.status) >= 8
    assert exit_status(found) == 0


def test_failed_samples_are_tried_further(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Samples that an ensemble has lost come back: the file is that of one run with so many attempts."""
    long = paper_scene(*SMALL, *ASKED, "simulation.duration=0.4", "simulation.step=0.02", "ensemble.checked_share=0.1")
    model = ReducedModel(long, rom_of(long))
    path = folder / "lossy.h5"

    def lossy(run, simulation, alive, divisors=DIVISORS):
        """Lose every seventh sample unless further attempts are made."""
        found = integrate_with_smaller_steps(run, simulation, alive, divisors)
        if len(divisors) > len(DIVISORS):
            return found
        status = found.status.copy()
        status[np.arange(status.size) % 7 == 3] = 2
        return replace(found, status=status, failure_time=np.where(status != 0, 0.1, found.failure_time))

    whole = ran(model, Plan(50, SEED, folder / "fine.h5"))
    monkeypatch.setattr(integration, "integrate_with_smaller_steps", lossy)
    found = ran(model, Plan(50, SEED, path))
    n_failed = int(np.sum(found.status != 0))
    assert n_failed >= 7 and set(found.kept) > {"unstable_start"}
    found.write(path)
    earlier = read_earlier(path, model)
    again = ran(model, Plan(50, earlier.seed, folder / "again.h5"), earlier=earlier)
    np.testing.assert_array_equal(again.status, 0)
    for kind in ("parameters", "outputs", "extremes", "validity", "errors"):
        for name, values in getattr(whole, kind).items():
            np.testing.assert_allclose(getattr(again, kind)[name], values, rtol=1e-9, atol=1e-14, err_msg=name)
    for name, band in whole.bands.items():
        np.testing.assert_allclose(again.bands[name].quantiles, band.quantiles, rtol=1e-9, atol=1e-14)
    assert any(f"{n_failed} samples that had failed" in remark.text for remark in again.record.remarks)
    with pytest.raises(InputError, match="all of its 50 samples are fine; nothing is left to do"):
        again.write(folder / "again.h5")
        read_earlier(folder / "again.h5", model)
    other = ReducedModel(with_step(long, 0.01),
                         rom_of(long))  # fmt: skip
    assert_refused(r"simulation\.step is not that of the file", read_earlier, path, other)


def test_a_rule_that_is_not_met_is_gone_on_with(rom: Path, folder: Path) -> None:
    """Its samples stay beside the file until --resume has met it, or another run takes their place."""
    path, rule = folder / "unmet.h5", "mean(crank_angle) < 40 %"
    kept = path.with_name("unmet.h5.partial")
    command = ["montecarlo", rom, "--seed", SEED, "-o", path]
    pgmp(*command, "-n", 40, "--until", "mean(crank_angle) < 1e-6 %", status=1)
    first = {piece.name: piece.stat().st_mtime_ns for piece in kept.glob("*.npz")}
    assert first
    pgmp(*command, "-n", 64, "--until", "mean(crank_angle) < 1e-6 %", "--resume", status=1)
    assert {piece.name: piece.stat().st_mtime_ns for piece in kept.glob("*.npz")}.items() > first.items()
    pgmp(*command, "-n", 64, "--until", rule, "--resume")
    assert not kept.exists() and len(Ensemble.read(path).status) == 64


def test_the_command_tries_failed_samples_again(rom: Path, folder: Path) -> None:
    """What no step helps fails again, with status 1."""
    table, one, other = folder / "table.csv", folder / "once.h5", folder / "twice.h5"
    table.write_text("r1\n" + "".join(f"{r1}\n" for r1 in (5e-3, 1.1e-3, 5.6e-3, 6e-3)))
    push = overridden("effects.motor.table=[[0.0, 1e9], [1.0, 1e9]]", "simulation.duration=5e-3")
    pgmp("montecarlo", rom, "--samples", table, *push, "-o", one, status=1)
    done = pgmp("montecarlo", rom, "--retry-failed", one, *push, "-o", other, status=1)
    found = [Ensemble.read(path) for path in (one, other)]
    assert "samples that had failed in" in done.stdout
    # r1 = 1.1 mm is outside of what the model was built for
    outside = [[remark.text for remark in both.record.remarks if " outside" in remark.text] for both in found]
    assert len(outside[0]) == len(outside[1]) == 1, outside
    assert np.all([one.status != 0 for one in found])
    assert found[0].steps_divided.max() <= 8 < found[1].steps_divided.max() <= 64
    assert not Path(f"{other}.partial").exists()


def test_what_cannot_be_tried_again_is_refused(model: ReducedModel, together: tuple, folder: Path) -> None:
    def refused(ensemble: Ensemble, said: str, here: ReducedModel = model) -> None:
        path = folder / "refused.h5"
        status = np.where(np.arange(len(ensemble.status)) == 2, 2, ensemble.status)
        replace(ensemble, status=status).write(path)
        message = refusal(read_earlier, path, here)
        assert message.startswith(f"--retry-failed {path}: ") and said in message

    plain = ran(model, Plan(10, SEED, folder / "plain.h5"))
    kept = {"unstable_start": np.zeros(10)}
    refused(together[0], "an ensemble with --correct")
    stop = Stop((read_rule(RULE, model.scene),))
    refused(ran(model, Plan(10, SEED, folder / "ten.h5"), stop=stop), "an ensemble with --until or --budget")
    refused(plain, "written by another version, which kept less of its samples")
    refused(replace(plain, kept=kept, model="full"), "samples of the full model; here it is the reduced one")
    other = copy(model)
    other.scene = bounded(model.scene, 2e-3)
    refused(replace(plain, kept=kept), "parameters.r1 is not that of the file", other)
    drawn = {"r1": np.where(np.arange(10) == 7, 1.000001, 1.0) * plain.parameters["r1"]}
    refused(replace(plain, kept=kept, parameters=drawn), "sample 7 has r1 = ")
    record = replace(plain.record, seed=None)
    path = folder / "of_table.h5"
    status = np.where(np.arange(10) == 2, 2, 0)
    replace(plain, kept=kept, record=record, status=status).write(path)
    earlier = read_earlier(path, model)
    np.testing.assert_array_equal(earlier.file.values["r1"], plain.parameters["r1"])


def test_too_many_failures_leave_bounds_of_quantiles_alone(scene: Scene, folder: Path) -> None:
    """Half of the radii and a few are outside of the bounds of a model whose samples are from a table."""
    bounds: list[np.ndarray] = []
    for share in (0.5, 1.0):
        asked = scene.ensemble.model_copy(update={"failed_share": share})
        changed = bounded(scene, 5.6e-3).model_copy(update={"ensemble": asked})
        model = ReducedModel(changed, rom_of(scene))
        values = np.linspace(4e-3, 6.9e-3, 30)
        table = SampleFile(Path("table"), {"r1": values}, "")
        found = ran(model, Plan(30, 0, folder / "hidden.h5", file=table))
        n_failed = int(np.sum(found.status != 0))
        one, text = found.statistics["crank_angle"], report(found, folder / "hidden.h5")
        assert n_failed == int(np.sum(values < 5.6e-3)) > 15
        bounds.append(one.quantile_bounds)
        np.testing.assert_array_equal(one.quantile_bounds, bounds[0])
        assert np.isfinite(one.quantile_bounds).any()
        if share == 1.0:
            assert one.count == 30 - n_failed and "failed_share" not in text
            continue
        assert one.count == 0 and np.isnan([one.mean, one.std]).all() and not found.sobol
        assert found.bands["crank_angle"].count == 0 and np.isnan(found.probabilities["late"].estimate)
        assert f"{n_failed} of 30 samples failed, more than ensemble.failed_share = 0.5" in text
        # no smaller step helps against unphysical values
        assert "Cure: that of the reason above" in text and "--retry-failed" not in text and "unknown" in text
        found.write(folder / "hidden.h5")
        assert np.isnan(Ensemble.read(folder / "hidden.h5").statistics["crank_angle"].mean)


def test_few_fine_samples_correct_nothing(model: ReducedModel, folder: Path) -> None:
    one = better(model, "full=10")[0]
    one.model.scene = bounded(one.model.scene, 5.6e-3)
    found = ran(model, Plan(40, SEED, folder / "few.h5"), better=[one])
    assert not found.joined.corrected and "too few for /corrected, which takes 8" in report(found, Path("few.h5"))
    found.write(folder / "few.h5")
    assert Ensemble.read(folder / "few.h5").joined.n_failed == found.joined.n_failed > 2


def test_models_that_do_not_vary_cannot_be_weighed(model: ReducedModel, folder: Path) -> None:
    one = better(model, "full=auto")
    table = SampleFile(Path("table"), {"r1": np.full(40, 5.6e-3)}, "")
    with pytest.raises(RunError, match="no output varies in all of them"):
        ran(model, Plan(40, 0, folder / "still.h5", file=table), better=one, stop=Stop((), 5.0))


def test_meshes_come_from_the_scene_that_is_named(model: ReducedModel, tmp_path: Path) -> None:
    own, named = better(model, "full=20")[0].model, better(model, f"{PAPER_SCENE}:full=20")[0].model
    values = draw(model.scene, SEED, 0, 2)
    found = run_batch(named, values).outputs
    for name, expected in run_batch(own, values).outputs.items():
        np.testing.assert_allclose(found[name], expected, rtol=1e-9, atol=1e-14)
    # a ROM.h5 of cells has condensed bodies in place of their meshes
    condensed = copy(model)
    condensed.rom = replace(model.rom, meshes={**model.rom.meshes, "rod": None})
    assert_refused(r"'rom\.h5' has no mesh of rod, .* --correct SCENE\.toml:full=20", better, condensed, "full=20")
    other = tmp_path / "other.toml"
    text = PAPER_SCENE.read_text().replace("../meshes", str(PAPER_SCENE.parent.parent / "meshes"))
    other.write_text(text.replace("rho = 7800.0", "rho = 7900.0"))
    with pytest.raises(InputError, match=r"\[materials\] of '.*other\.toml' differs from that of 'rom\.h5'"):
        better(model, f"{other}:full=20")


def test_a_row_of_models_from_steps_and_components(model: ReducedModel, folder: Path) -> None:
    models = better(model, "reduced/2=40", "components=20")
    assert [one.name for one in models] == ["components", "reduced/2"]
    found = ran(model, Plan(100, SEED, folder / "row.h5"), better=models).joined
    assert found.models == ("components", "reduced/2", "reduced") and len(found.status["reduced/2"]) == 40
    values = draw(model.scene, SEED, 0, 20)
    expected = run_batch(models[0].model, values).outputs["crank_angle"]
    np.testing.assert_allclose(found.outputs["components"]["crank_angle"], expected, rtol=1e-8)
