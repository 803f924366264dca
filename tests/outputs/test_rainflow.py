"""Cycles by rainflow and their damage: the standard's example, closed forms, every model, and what is refused."""

from math import gamma

import numpy as np
import pytest
from differences import SHARES, compare
from machine_scenes import MODELS, cart
from refusals import cases, check_said
from runs import history, motion, reduced_model, samples, trajectory

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.bench.history import errors_between, run_history
from pgmp_petsc.ensemble.integration import run_batch
from pgmp_petsc.ensemble.watchers import watch_over_time
from pgmp_petsc.estimates.own_error import largest_at_start
from pgmp_petsc.figures.trajectories import loads
from pgmp_petsc.lanes.rainflow import cycles
from pgmp_petsc.outputs.rainflow import Counted, Counting, Rainflow
from pgmp_petsc.studies.plausibility.check import plausibility
from scenes import meshes_of

PIN = 'outputs.pin={type="joint_force",joint="pivot",component="y"}'
RIGID_POLE = ("bodies.pole.flexible=false",)
CURVE = {"exponent": 3.0, "reference": 2.0, "cycles": 1e3}


def damage(values: np.ndarray, in_parts_of: int = 0, **entries: object) -> np.ndarray:
    """Return the damages over histories (n_t, n), taken in parts of so many instants."""
    entry = Rainflow(type="rainflow", of="x", **{"curve": CURVE} | entries)
    counting, n_t = Counting({"x": Counted(None, entry)}, {}, values.shape[1]), len(values)
    parts = [slice(k, k + (in_parts_of or n_t)) for k in range(0, n_t, in_parts_of or n_t)]
    return np.concatenate([counting.over(np.arange(n_t)[part], {"x": values[part]})["x"] for part in parts])


def test_the_example_of_the_standard() -> None:
    """ASTM E1049-85, figure 6 and table X1.1."""
    found: dict[float, float] = {}
    for first, second, count in cycles(np.array([-2.0, 1.0, -3.0, 5.0, -1.0, 3.0, -4.0, 4.0, -2.0])):
        found[abs(first - second)] = found.get(abs(first - second), 0.0) + count
    assert found == {3.0: 0.5, 4.0: 1.5, 6.0: 0.5, 8.0: 1.0, 9.0: 0.5}


def test_a_count_in_parts_is_that_of_the_whole_and_never_falls() -> None:
    """Bit for bit, with flat parts and equal turning points; the damage so far is that of the history up to there."""
    random = np.random.default_rng(3)
    values = np.concatenate([random.normal(size=(400, 3)).round(1), np.cumsum(random.normal(size=(400, 3)), axis=0)])
    whole = damage(values)
    for size in (1, 7, 300):
        np.testing.assert_array_equal(damage(values, size), whole)
    np.testing.assert_array_equal(damage(values[:333])[-1], whole[332])
    np.testing.assert_array_equal(damage(values[:, 1:2])[:, 0], whole[:, 1])
    assert np.diff(whole, axis=0).min() >= -1e-15 * whole.max()  # sums of other halves: rounding
    by_hand = [count / 1e3 * (abs(a - b) / 4.0) ** 3 for a, b, count in cycles(values[:, 0])]
    assert whole[-1, 0] == pytest.approx(sum(by_hand), rel=1e-12)


def test_means_tables_and_lives() -> None:
    """Two half cycles from -1 to 5 and back: amplitude 3 at a mean of 2."""
    history = np.array([-1.0, 5.0, -1.0])[:, None]
    assert damage(history)[-1, 0] == pytest.approx((3.0 / 2.0) ** 3 / 1e3, rel=1e-14)
    goodman = {"mean_stress": "goodman", "ultimate": 8.0}
    assert damage(history, **goodman)[-1, 0] == pytest.approx((4.0 / 2.0) ** 3 / 1e3, rel=1e-14)
    # compression does not help, and a cycle whose mean reaches the strength is the last one
    assert damage(-history, **goodman)[-1, 0] == damage(history)[-1, 0]
    assert damage(history, mean_stress="goodman", ultimate=2.0)[-1, 0] == 1.0
    # on the second of two lines, each a power
    table = {"table": [(1.0, 1e5), (2.0, 1e4), (4.0, 10.0)]}
    assert damage(history, curve=table)[-1, 0] == pytest.approx(1.5 ** np.log2(1e3) / 1e4, rel=1e-14)
    life = damage(history, quantity="life", run_out=1e5)[:, 0]
    assert life.tolist() == [1e5, 1.0 / (0.5 * (1.5**3 / 1e3)), 2.0 / (1.5**3 / 1e3)]
    assert np.isnan(damage(np.array([[0.0], [np.nan], [1.0]]))[1:]).all()


def test_a_narrow_band_has_rayleigh_s_damage() -> None:
    """``nu (sqrt(2) sigma)^k Gamma(1 + k/2) / C`` with N = C a^-k: mean of 400 histories of 100 cycles, within four
    deviations of that mean; 60 instants a cycle cut peaks by 0.1 %."""
    random, n_lines, sigma = np.random.default_rng(1), 40, 0.7
    frequencies = 1.0 + 0.02 * (np.arange(n_lines) / n_lines - 0.5)
    times = np.arange(6000) / 60.0
    total = np.empty(400)
    for k in range(total.size):
        size = random.rayleigh(sigma / np.sqrt(n_lines), n_lines)
        phases = random.uniform(0.0, 2.0 * np.pi, n_lines)
        total[k] = damage(np.cos(2.0 * np.pi * times[:, None] * frequencies + phases).dot(size)[:, None])[-1, 0]
    wanted = 100.0 * (np.sqrt(2.0) * sigma) ** 3 * gamma(2.5) / (1e3 * 2.0**3)
    assert abs(total.mean() - wanted) < 4.0 * total.std() / np.sqrt(total.size) + 0.003 * wanted


FATIGUE = (
    'outputs.s={type="stress",body="pole",quantity="stress_max",at=[0.1,0.0]}',
    'outputs.damage={type="rainflow",of="s",mean_stress="goodman",ultimate="r",curve={exponent="k",reference="a",cycles=1e6}}',
    'outputs.life={type="rainflow",of="s",quantity="life",run_out=1e9,curve={exponent=3.0,reference="a",cycles=1e6}}',
    'parameters.k={nominal=4.0,distribution={name="uniform",loc=3.5,scale=1.0}}', "parameters.r={nominal=6e7}",
    'parameters.a={nominal=2e6,unit="Pa",distribution={name="uniform",loc=1.5e6,scale=1e6}}',
    "parameters.E={nominal=210e9}", 'materials.steel.E="E"', "simulation.duration=0.1",
    "simulation.initial.swing.position=-1.0",
)  # fmt: skip


@pytest.mark.parametrize("model", MODELS)
def test_samples_are_counted_as_they_run(model: str) -> None:
    """Bit for bit what a count after the run gives, in a batch and alone; models agree
    as their stresses do, times the exponent."""
    scene = cart(*FATIGUE, "ensemble.extremes=true", "ensemble.bands=3")
    made = MODELS[model](scene)
    values = samples(scene, 3, k=[3.5, 4.0, 4.5], a=[1.5e6, 2e6, 2.5e6])
    _, wanted = history(made, values, 3)
    batch = run_batch(made, values)
    one = run_batch(made, {name: column[1:2] for name, column in values.items()})
    for name in ("damage", "life"):
        np.testing.assert_array_equal(batch.outputs[name], wanted[name][-1])
        assert one.outputs[name][0] == batch.outputs[name][1]
    assert (np.diff(batch.outputs["damage"]) < 0.0).all()
    reference = run_batch(MODELS["full"](scene), values)
    np.testing.assert_allclose(batch.outputs["damage"], reference.outputs["damage"], rtol=0.05)


@pytest.mark.parametrize("model", ("full", "reduced"))
def test_errors_are_those_at_the_end(model: str) -> None:
    """Of a run and of the bench, as shares of the damage and the life of the run: a life begins at its run-out. The
    pole is let go at once, and the step loses how it trembles: the damage is 2.5e-11, with an eighth of it 1.1e-10."""
    scene = cart(*FATIGUE)
    run = trajectory(model, scene)
    assert run.outputs["life"][0] == 1e9 > 5.0 * run.outputs["life"][-1]
    for name in ("life", "damage"):
        assert run.errors.largest[name] == run.outputs[name][-1] and len(set(run.errors.outputs[name])) == 1
    assert 0.5 < run.errors.share("damage") < 2.0
    runs = [run_history(MODELS[model](scene), samples(scene, 1), 1, n) for n in (50, 100)]
    life = list(run.outputs).index("life")
    ends = [one.outputs[life, -1, 0] for one in runs]
    shares = errors_between(*runs, np.full(len(run.outputs), 1e-300))
    assert shares[life, 0] == pytest.approx(abs(ends[0] / ends[1] - 1.0), rel=1e-12)


def test_what_joints_carry_is_judged_after_the_start() -> None:
    """A level pole that is let go at once: what its pin carries then hangs on the mesh, and models differ by eight
    times what they do later. Errors, sizes and runs of the bench have the next instant there, of formulas too."""
    scene = cart(PIN, 'outputs.twice={type="formula",formula="2 * pin"}', "reduction.modes=1")
    run, other = trajectory("reduced", scene), motion("full", scene)
    off = np.abs(run.outputs["pin"] - other.outputs["pin"])
    assert off[0] > 8.0 * off[1:].max()
    for name in ("pin", "twice"):
        errors, one = run.errors.outputs[name], list(run.outputs).index(name)
        assert errors[0] == errors[1] and run.errors.largest[name] == np.abs(run.outputs[name][1:]).max()
        kept = run_history(MODELS["full"](scene), samples(scene, 1), 1, 100).outputs[one, :, 0]
        assert kept[0] == kept[1]


@pytest.mark.parametrize("rigid", (True, False))
def test_extremes_and_events_begin_where_outputs_are_judged(rigid: bool) -> None:
    """What the pin of a level pole carries as it is let go is ``m g (1 - (l/2)^2 / (l^2/3 + h^2/12))`` where it is
    rigid, the least of the first steps. Of a flexible one it is a third of that at time 0, which does not count, and as
    much a step later."""
    events = "ensemble.probabilities.light={output='pin',when='ever',below=0.8}", "ensemble.extremes=true"
    young = "parameters.E={nominal=210e9}", 'materials.steel.E="E"'
    scene = cart(PIN, *events, *young, "simulation.duration=5e-3", *RIGID_POLE[: int(rigid)])
    made, values = MODELS["full"](scene), samples(scene, 1)
    found = run_batch(made, values, 0, [watch_over_time(made, True)])
    (least,), (at,) = found.extremes["pin/min"], found.extremes["pin/time_of_min"]
    pin = history(made, values, 1)[1]["pin"][:, 0]
    np.testing.assert_array_equal(found.bands["pin"][0], [pin[int(not rigid)], *pin[1:]])
    exact = 0.78 * 9.80665 * (1.0 - 0.25 / (1.0 / 3.0 + 0.02**2 / 0.5**2 / 12.0))
    assert np.isnan(found.first_passages["light"]) and least == pin[int(not rigid) :].min() and (at == 0.0) == rigid
    assert pin[int(not rigid)] == pytest.approx(exact, rel=1e-8 if rigid else 0.02) and (pin[0] < 0.8) == (not rigid)


def test_what_is_largest_at_the_start_is_said() -> None:
    """Of a run that goes on with less; not where bodies are rigid or settled, where what joints carry is known then."""
    run = {"pin": np.array([-92.0, 17.0, -3.0]), "s": np.array([-9.2, 1.7, 0.0]), "life": np.array([3.0, 1.0, 1.0])}
    counted = (
        PIN, "parameters.A={nominal=10.0,unit='m^2'}", "outputs.s={type='formula',formula='pin / A'}",
        "outputs.life={type='rainflow',of='s',quantity='life',run_out=3.0,curve={exponent=3,reference=1,cycles=1e3}}",
    )  # fmt: skip
    scene, units = cart(*counted), {"pin": "N", "s": "Pa", "life": "1"}
    (said,) = largest_at_start(scene, run, units)
    both = "largest at time 0: pin (92 N, later 17 N at most), s (9.2 Pa, later 1.7 Pa at most). What joints carry"
    assert said.kind == "warning" and said.text.startswith(both) and "but cycles are counted from time 0" in said.text
    (plain,) = largest_at_start(cart(*counted[:3]), {name: run[name] for name in ("pin", "s")}, units)
    assert plain.text == said.text.replace(", but cycles are counted from time 0", "")
    for known in (RIGID_POLE[0], "initial.equilibrium=true"):
        assert not largest_at_start(cart(*counted, known), run, units)
    for values in ([17.1, 17.0, -3.0], [92.0]):
        assert not largest_at_start(cart(PIN), {"pin": np.array(values)}, units)


def test_the_matrix_of_a_run() -> None:
    run = motion("reduced", cart(*FATIGUE))
    drawn = loads(run, "rainflow").axes[0].collections[0].get_array()
    assert np.nansum(drawn) == pytest.approx(cycles(run.outputs["s"])[:, 2].sum())
    with pytest.raises(InputError, match="the scene counts no cycles"):
        loads(motion("reduced", cart("simulation.duration=0.01")), "rainflow")


def test_derivatives_of_damages_are_central_differences() -> None:
    compare(reduced_model(cart(*FATIGUE)), SHARES)


REFUSED = """
outputs.o={type="rainflow",of="bemt",curve=C} -> \
    outputs.o.of = "bemt": there is no such output | did you mean 'bent'
RAIN,curve={exponent=0,reference=1e6,cycles=1e6}} -> outputs.o.curve.exponent = 0: | positive
RAIN,curve={exponent=-3.0,reference=1e6,cycles=1e6}} -> outputs.o.curve.exponent = -3.0: | positive
RAIN,curve={exponent=3,cycles=1e6}} -> outputs.o.curve.reference: missing
RAIN,curve={table=[[1e6,1e5],[2e6,1e5]]}} -> outputs.o.curve.table | must fall
RAIN,curve={table=[[2e6,1e5],[1e6,1e4]]}} -> outputs.o.curve.table | must rise
RAIN,curve={table=[[2e6,1e5]]}} -> outputs.o.curve.table
RAIN,curve={table=[[1e6,1e5],[2e6,1e4]],cycles=3}} -> outputs.o.curve.cycles = 3 | beside a table
RAIN,curve={}} -> outputs.o.curve.exponent | exactly one
RAIN,mean_stress="goodman",curve=C} -> outputs.o.ultimate: missing
RAIN,ultimate=1e8,curve=C} -> \
    outputs.o.ultimate = 100000000.0: for goodman alone
RAIN,quantity="life",curve=C} -> outputs.o.run_out: missing
RAIN,run_out=1e8,curve=C} -> \
    outputs.o.run_out = 100000000.0: for a life alone
RAIN,curve={exponent="q",reference=1e6,cycles=1e6}} -> outputs.o.curve.exponent = "q": there is no
outputs={o={type="rate",of="d"},d={type="rainflow",of="o",curve=C}} -> \
    outputs.o.of = "d": d is counted || outputs.o.of = "d": a circle || outputs.d.of = "o": a circle
"""
FILLED = REFUSED.replace("RAIN", 'outputs.o={type="rainflow",of="bent"').replace(
    "=C", "={exponent=3,reference=1e6,cycles=1e6}"
)


@pytest.mark.parametrize(("override", "said"), cases(FILLED))
def test_what_is_refused(override: str, said: str) -> None:
    with pytest.raises(InputError) as caught:
        cart(override)
    check_said(str(caught.value), said, override)


def test_what_is_no_stress_is_doubted() -> None:
    scene = cart('outputs.o={type="rainflow",of="bent",curve={exponent=3,reference=1e6,cycles=1e6}}')
    doubts = [one.text for one in plausibility(scene, meshes_of(scene))]
    assert any(text.startswith('outputs.o.of = "bent": it is in m') for text in doubts), doubts
