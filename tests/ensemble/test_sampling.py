"""Samples: drawn by seed and number alone, stratified, and taken from a table."""

from pathlib import Path

import h5py
import numpy as np
import pytest
from refusals import assert_refused, cases, check_said, refusal
from scipy import stats
from scipy.stats import qmc

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.ensemble import sampling
from pgmp_petsc.ensemble.plan import LARGEST_SEED, MOST_SAMPLES, Plan, read_samples
from pgmp_petsc.ensemble.sampling import (
    Sampler,
    draw,
    draw_remarks,
    independent,
    latin_hypercube,
    physical,
    saltelli,
    sampler_remarks,
    sobol,
    stream,
)
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.parameters import Distribution, Parameter
from scenes import slider_crank

NORMAL = 'parameters.r1.distribution={name="norm", loc=5.6e-3, scale=0.56e-3}'
YOUNG = ('parameters.E={nominal=2.1e11, distribution={name="lognorm", s=0.05, scale=2.1e11}}', 'materials.steel.E="E"')
FIXED = "parameters.rho={nominal=7800.0}"


@pytest.fixture
def scene() -> Scene:
    return slider_crank(NORMAL, *YOUNG, FIXED, 'materials.steel.rho="rho"')


def test_the_order_of_the_parameters_has_no_part_in_it(scene: Scene) -> None:
    other = scene.model_copy(update={"parameters": dict(reversed(scene.parameters.items()))})
    np.testing.assert_equal(draw(other, 3, 0, 20), draw(scene, 3, 0, 20))


def test_a_parameter_without_a_distribution_keeps_the_value_of_the_run(scene: Scene) -> None:
    np.testing.assert_array_equal(draw(scene, 1, 0, 5)["rho"], 7800.0)
    changed = scene.model_copy(deep=True)
    changed.parameters["rho"] = scene.parameters["rho"].model_copy(update={"value": 8000.0})
    np.testing.assert_array_equal(draw(changed, 1, 0, 5)["rho"], 8000.0)
    (remark,) = draw_remarks(slider_crank(NORMAL, "parameters.r1.value=5e-3"))
    assert remark.text.startswith("parameters.r1.value = 0.005")
    assert_refused(r"parameters: none has a distribution", draw, slider_crank(), 0, 0, 3)


def test_damping_and_friction_are_not_negative() -> None:
    """Zero is none of either; springs may be negative."""
    effects = (
        'effects.loss={type="joint_damping",joint="crank_hinge",coefficient="c"}',
        'effects.rub={type="joint_friction",joint="elbow",limit="limit",speed=1.0}',
        'effects.coil={type="spring_damper",joint="elbow",stiffness="k"}',
    )
    scene = slider_crank(*(f"parameters.{name}={{nominal=1.0}}" for name in ("c", "limit", "k")), *effects)
    rows = [[1.0, 1.0, 1.0], [0.0, 0.0, -1.0], [-1e-3, 1.0, 1.0], [1.0, -1e-3, 1.0]]
    values = {"r1": np.full(4, 5e-3)} | dict(zip(("c", "limit", "k"), np.array(rows).T))
    np.testing.assert_array_equal(physical(scene, values), [True, True, False, False])


def test_sections_and_materials_need_positive_numbers_even_without_bounds(scene: Scene) -> None:
    n = 4
    values = {"r1": np.full(n, 5e-3), "E": np.full(n, 2e11), "rho": np.full(n, 7800.0)}
    values["r1"][1], values["E"][2], values["rho"][3] = -1e-3, 0.0, np.nan
    np.testing.assert_array_equal(physical(scene, values), [True, False, False, False])
    scene = slider_crank(NORMAL, "parameters.r1.bounds=[5e-3, 6e-3]")
    values = {"r1": np.array([5e-3, 6e-3, 4.999e-3, 6.001e-3, 5.5e-3, np.nan, np.inf, -5.5e-3])}
    np.testing.assert_array_equal(physical(scene, values), [True, True, False, False, True, False, False, False])
    load = bounded(-40.0, 40.0)  # a parameter of a load may be negative
    drawn = draw(load, 0, 0, 50)
    assert (drawn["s"] < 0).any() and physical(load, drawn).all()


def bounded(low: float, high: float, name: str = '"norm", loc=0.0, scale=1.0') -> Scene:
    """Return a scene with a standard normal parameter of a load between bounds."""
    nominal = min(max(0.0, low), high)
    return slider_crank(
        f"parameters.s={{nominal={nominal}, bounds=[{low}, {high}], distribution={{name={name}}}}}",
        'effects.motor.scale="s"',
    )


# ordinary; one-sided; both tails so far out that probabilities of smaller values are 1, or larger ones are, to
# round-off
@pytest.mark.parametrize(("low", "high"), [(-0.5, 1.5), (-40.0, 0.3), (9.0, 12.0), (-12.0, -9.0), (30.0, 31.0)])
def test_a_distribution_is_truncated_to_its_bounds_and_renormalised(low: float, high: float) -> None:
    values = draw(bounded(low, high), 2, 0, 3000)["s"]
    assert np.all((values >= low) & (values <= high))
    assert np.unique(values).size == 3000
    assert stats.kstest(values, stats.truncnorm(low, high).cdf).pvalue > 1e-3


@pytest.mark.parametrize("law", ['name="cauchy", loc=5.6e-3, scale=1e-5', 'name="t", df=1.5, loc=5.6e-3, scale=1e-5'])
def test_a_distribution_without_a_finite_variance_is_warned_of(law: str) -> None:
    (cut,) = draw_remarks(slider_crank(f"parameters.r1.distribution={{{law}}}", "parameters.r1.bounds=[-1e9, 1e9]"))
    assert cut.kind == "note" and "cut off" in cut.text
    scene = slider_crank(f"parameters.r1.distribution={{{law}}}")
    unbounded = scene.parameters["r1"].model_copy(update={"bounds": None})
    (endless,) = draw_remarks(scene.model_copy(update={"parameters": {"r1": unbounded}}))
    assert endless.kind == "warning" and "has no finite variance" in endless.text


def test_what_bounds_cut_off_is_said() -> None:
    (cut,) = draw_remarks(bounded(-2.0, 3.0))
    assert cut.kind == "note" and "truncated to the bounds [-2, 3]" in cut.text
    assert "2.3 % below and 0.13 % above" in cut.text
    (much,) = draw_remarks(bounded(0.0, 3.0))
    assert much.kind == "warning" and "50 % below" in much.text
    assert draw_remarks(slider_crank(NORMAL)) == ()
    (length,) = draw_remarks(slider_crank(NORMAL, "parameters.r1.bounds=[5e-3, 6e-3]"))
    assert "the bounds [0.005, 0.006] m and" in length.text


@pytest.mark.parametrize("law", ['name="norm", loc=5.6e-3, scale=0.56e-3', 'name="uniform", loc=4e-3, scale=3e-3'])
@pytest.mark.parametrize("bounds", ["", "[1e-3, 12e-3]", "[5.5e-3, 6.9e-3]", "[6.5e-3, 6.9e-3]"])
def test_laws_of_our_own_are_those_of_scipy(law: str, bounds: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Normal and uniform distributions, also where bounds leave a part of the upper tail."""
    limits = f", bounds={bounds}" if bounds else ""
    parameter = slider_crank(f"parameters.r1={{nominal=6.6e-3, distribution={{{law}}}{limits}}}").parameters["r1"]
    shares = np.concatenate([np.random.default_rng(1).uniform(size=200), [1e-12, 1.0 - 1e-12]])
    own = parameter.quantiles(shares)
    monkeypatch.setattr(Distribution, "frozen", property(Distribution._of_scipy))
    np.testing.assert_allclose(own, parameter.quantiles(shares), rtol=1e-12)


SAMPLERS = ("random", "latin_hypercube", "sobol", "saltelli")


def drawn_by(sampler: str, *overrides: str) -> Scene:
    return slider_crank(NORMAL, *YOUNG, f'ensemble.sampler="{sampler}"', *overrides)


@pytest.mark.filterwarnings("error")  # scipy's about numbers that are no powers of two would reach the terminal
@pytest.mark.parametrize("sampler", SAMPLERS)
def test_samplers_draw_the_distributions_of_the_scene_by_seed_and_number_alone(sampler: str) -> None:
    n, scene = 2048, drawn_by(sampler)
    whole = Sampler(scene, Plan(n, 4))
    values, chosen = whole.draw(0, n), whole.described(n)
    size = chosen.sum()
    assert size == (n // 2 if sampler == "saltelli" else n)
    for name, law in (("r1", stats.norm(5.6e-3, 0.56e-3)), ("E", stats.lognorm(0.05, scale=2.1e11))):
        sample = values[name][chosen]
        assert np.unique(sample).size == size and np.isfinite(values[name]).all()
        # four standard errors
        assert abs(sample.mean() - law.mean()) < 4 * law.std() / np.sqrt(size)
        assert abs(sample.std() / law.std() - 1) < 4 / np.sqrt(2 * size) * 1.1
        assert stats.kstest(sample, law.cdf).pvalue > 1e-3
    assert abs(np.corrcoef(values["r1"][chosen], values["E"][chosen])[0, 1]) < 4 / np.sqrt(size)
    again, other = (Sampler(scene, Plan(n, seed)) for seed in (4, 5))
    for first, last in ((0, 1), (17, 42), (50, 50), (3, 77), (1000, 1033), (n - 1, n)):
        for name, column in again.draw(first, last).items():
            np.testing.assert_array_equal(column, values[name][first:last], strict=True)
    assert not np.array_equal(other.draw(0, n)["r1"], values["r1"])
    longer = Sampler(scene, Plan(2 * n, 4)).draw(0, n)
    assert whole.extends == all(np.array_equal(longer[name], column) for name, column in values.items())
    assert whole.extends == (sampler != "latin_hypercube")


def test_points_of_scrambled_sequences_know_a_mean_better_than_independent_ones() -> None:
    """The mean of a smooth function of two parameters, over 10 seeds each."""

    def error(sampler: str) -> float:
        means = []
        for seed in range(10):
            values = Sampler(drawn_by(sampler), Plan(512, seed)).draw(0, 512)
            means.append(np.mean((values["r1"] / 5.6e-3) ** 2 * values["E"] / 2.1e11))
        # of a square of a normal variable and the mean of a lognormal one
        return float(np.sqrt(np.mean((np.array(means) - 1.01 * np.exp(0.5 * 0.05**2)) ** 2)))

    independent = error("random")
    # an error of 1 / sqrt(20) is one that takes 20 times the samples
    assert error("sobol") < independent / np.sqrt(20.0)
    assert error("latin_hypercube") < independent / np.sqrt(20.0)


def test_what_intervals_of_each_sampler_rest_on_is_said() -> None:
    def said(sampler: str, n: int, *overrides: str) -> str:
        return " ".join(map(str, sampler_remarks(drawn_by(sampler, *overrides), Plan(n, 0))))

    assert said("random", 10) == ""
    assert "intervals take the samples of a Latin hypercube for independent ones" in said("latin_hypercube", 10)
    assert "statistics, probabilities and bands are of the base points A and B" in said("saltelli", 8)
    assert "warning: 8 samples are 0 blocks to each of 8 scrambled Sobol sequences" in said("saltelli", 8)
    assert "1024 or 2048 samples are better used than 1028" in said("saltelli", 1028)
    assert "balanced" not in said("saltelli", 1024)
    for sampler in ("sobol", "saltelli"):
        assert "spread between 8 scrambled Sobol sequences" in said(sampler, 512)
    assert "balanced" not in said("sobol", 512) and "warning" not in said("sobol", 512)
    assert "256 or 512 samples are better used than 500" in said("sobol", 500)
    assert "256 or 512 samples are better used than 300" in said("sobol", 300)
    assert "warning: 20 samples are 2 to each of 8 scrambled Sobol sequences" in said("sobol", 20)
    assert "warning" not in said("sobol", 64, "ensemble.replicates=4")


@pytest.mark.parametrize(("n", "near"), [(3, "4 or 8"), (130, "128 or 132")])
def test_blocks_that_are_not_whole_are_refused(n: int, near: str) -> None:
    with pytest.raises(InputError, match=f"-n {n} with the sampler saltelli: .* takes 4 samples.*such as {near}"):
        Sampler(drawn_by("saltelli"), Plan(n, 0))


NOT_ASKED = cases("""
ensemble.sampler="halton" -> = "halton": unknown
ensemble.replicates=1 -> = 1: must be at least 2
ensemble.confidence=1.0 -> = 1.0: must be less than 1
ensemble.bands=1 -> = 1: must be 0, or at least 2: the start and the end
ensemble.extremes=1 -> = 1: true or false is needed
ensemble.probabilities.p={output="no", above=1.0} -> ensemble.probabilities.p.output = "no": there is no such
ensemble.probabilities.p={output="crank_angle"} ->
    ensemble.probabilities.p | exactly one of above, below is needed; none is given
ensemble.probabilities.p={output="crank_angle", above=1.0, below=2.0} ->
    ensemble.probabilities.p | exactly one of above, below is needed; above and below are given
ensemble.probabilities.r1={output="crank_angle", above=1.0} ->
    : parameters.r1 has the same name; give the event another one
ensemble.probabilities.crank_angle={output="crank_angle", above=1.0} -> : outputs.crank_angle has the same name
ensemble.probabilities.p={output="crank_angle", above=1.0, when="often"} ->
    ensemble.probabilities.p.when = "often": unknown
""")


@pytest.mark.parametrize(("override", "said"), NOT_ASKED)
def test_what_an_ensemble_cannot_be_asked_for(override: str, said: str) -> None:
    output = 'outputs.crank_angle={type="angle", joint="crank_hinge"}'
    check_said(refusal(slider_crank, NORMAL, output, override), said, override)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("name", "shapes"),
    [
        ("beta", {"a": 2.0, "b": 5.0}), ("gamma", {"a": 2.0}), ("triang", {"c": 0.3}), ("weibull_min", {"c": 1.8}),
        ("truncnorm", {"a": -1.0, "b": 2.0}), ("loguniform", {"a": 0.01, "b": 1.25}), ("t", {"df": 3.0}),
        ("gumbel_r", {}), ("expon", {}), ("arcsine", {}), ("johnsonsu", {"a": 2.5, "b": 2.2}),
    ],
)  # fmt: skip
def test_any_continuous_distribution_is_truncated_to_bounds(name: str, shapes: dict[str, float]) -> None:
    law = getattr(stats, name)(**shapes, loc=0.5, scale=2.0)
    low, high = law.ppf([0.1, 0.9])
    given = ", ".join(f"{key}={value}" for key, value in shapes.items() | {"loc": 0.5, "scale": 2.0}.items())
    scene = slider_crank(
        f"parameters.s={{nominal={law.median()}, bounds=[{low}, {high}], distribution={{name='{name}', {given}}}}}",
        'effects.motor.scale="s"',
    )
    shares = np.linspace(0.0, 1.0, 11)
    np.testing.assert_allclose(scene.parameters["s"].quantiles(shares), law.ppf(0.1 + 0.8 * shares), rtol=1e-7)


@pytest.mark.parametrize(
    ("law", "bounds", "expected"),
    [
        ({"name": "norm", "loc": 5.0, "scale": 0.5}, None, 0.5),
        ({"name": "norm", "loc": 5.0, "scale": 0.5}, (1.0, 9.0), 0.5),
        ({"name": "uniform", "loc": 4.0, "scale": 2.0}, None, 2.0 / np.sqrt(12.0)),
        ({"name": "uniform", "loc": 4.0, "scale": 2.0}, (4.5, 5.5), 1.0 / np.sqrt(12.0)),
        # half a normal distribution
        ({"name": "norm", "loc": 5.0, "scale": 0.5}, (5.0, 9.0), 0.5 * np.sqrt(1.0 - 2.0 / np.pi)),
        ({"name": "gamma", "a": 4.0, "loc": 3.0, "scale": 0.5}, None, 1.0),
    ],
)
def test_the_deviation_is_that_of_the_truncated_distribution(law, bounds, expected: float) -> None:
    parameter = Parameter.model_validate({"nominal": 5.0, "distribution": law, "bounds": bounds})
    assert parameter.deviation == pytest.approx(expected, rel=2e-4)


@pytest.mark.parametrize("sampler", SAMPLERS)
def test_a_design_is_named_by_what_it_draws(sampler: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a longer run alike where that has the same samples; not of another seed, sampler or reading of the sampler."""
    scene = drawn_by(sampler)
    named = Sampler(scene, Plan(40, 4)).named
    assert (Sampler(scene, Plan(80, 4)).named == named) == (sampler != "latin_hypercube")
    assert Sampler(scene, Plan(40, 4)).named == named != Sampler(scene, Plan(40, 5)).named
    assert all(Sampler(drawn_by(other), Plan(40, 4)).named != named for other in SAMPLERS if other != sampler)
    if sampler in ("sobol", "saltelli"):
        fewer = scene.model_copy(update={"ensemble": scene.ensemble.model_copy(update={"replicates": 4})})
        assert "8 replicates" in named[0] and "4 replicates" in Sampler(fewer, Plan(40, 4)).named[0]
        # as when one sequence had all points, or all blocks
        design = getattr(sampling, sampler)
        monkeypatch.setattr(sampling, sampler, lambda seed, d, n_replicates, *purpose: design(seed, d, 1, *purpose))
        found = Sampler(scene, Plan(40, 4)).named
        assert found[0] == named[0] and found[1] != named[1]


@pytest.mark.parametrize("seed", [0, 1, 42, 2**32 - 1, 2**32, 123456789012345678, LARGEST_SEED])
def test_samples_are_the_first_numbers_of_streams_of_their_own(seed: int) -> None:
    """Bit for bit, for seeds of one word and of two, and the last samples that there may be."""
    for first, last, d in ((0, 40, 1), (MOST_SAMPLES - 3, MOST_SAMPLES, 5), (0, 0, 2), (0, 4, 0)):
        expected = [stream(seed, number).random(d) for number in range(first, last)]
        np.testing.assert_array_equal(independent(seed, d)(first, last), np.reshape(expected, (last - first, d)))


N = 96


def test_each_slice_of_a_latin_hypercube_holds_one_sample() -> None:
    values = latin_hypercube(1, 3, N)(0, N)
    slices = np.floor(N * values).astype(int)
    for column in slices.T:
        np.testing.assert_array_equal(np.sort(column), np.arange(N))
    assert len({tuple(column) for column in slices.T}) == 3
    assert stats.kstest((N * values - slices).ravel(), "uniform").pvalue > 1e-3


def test_replicates_are_scrambled_sobol_sequences_of_their_own() -> None:
    """A (0, m, 2)-net has one point in each of 64 boxes, whatever their shape; replicates differ."""
    values = sobol(2, 2, 8)(0, 8 * 64).reshape(64, 8, 2)
    for k in range(8):
        for rows in (1, 2, 8, 32, 64):
            boxes = np.floor(values[:, k] * [rows, 64 // rows]).astype(int)
            assert len({tuple(box) for box in boxes}) == 64
    assert len({tuple(values[0, k]) for k in range(8)}) == 8


def test_blocks_differ_in_one_parameter_from_their_first_point() -> None:
    blocks = saltelli(3, 3, 2)(0, 5 * 64).reshape(64, 5, 3)
    a, b = blocks[:, 0], blocks[:, 4]
    for k in range(3):
        expected = a.copy()
        expected[:, k] = b[:, k]
        np.testing.assert_array_equal(blocks[:, k + 1], expected)
    # A and B are the halves of points in six dimensions, evenly spread together in either of two replicates
    for points in (np.hstack([a, b])[k::2] for k in range(2)):
        assert qmc.discrepancy(points) < 0.7 * qmc.discrepancy(np.random.default_rng(1).random((32, 6)))


def test_a_latin_hypercube_that_no_rank_could_hold_is_refused() -> None:
    with pytest.raises(InputError, match="-n 200000000 with the sampler latin_hypercube: at most 100,000,000"):
        latin_hypercube(0, 1, 200_000_000)


def test_a_far_stretch_of_a_million_takes_no_time() -> None:
    """It is reached without the samples before it."""
    far = 1_000_000
    np.testing.assert_array_equal(sobol(1, 2, 8)(far, far + 9)[1:], sobol(1, 2, 8)(far + 1, far + 9))


RADII = [5e-3, 5.5e-3, 6e-3]


@pytest.fixture(scope="module")
def uncertain() -> Scene:
    return slider_crank(
        'parameters.r1={nominal=5.6e-3, bounds=[1e-3, 12e-3], distribution={name="norm", loc=5.6e-3, scale=1e-3}}',
        'parameters.r1.unit="m"', "parameters.rho={nominal=7800.0}", 'materials.steel.rho="rho"',
    )  # fmt: skip


def csv(folder: Path, text: str) -> Path:
    path = folder / "s.csv"
    path.write_text(text)
    return path


def test_columns_of_parameters_are_taken_and_others_named(uncertain: Scene, tmp_path: Path) -> None:
    path = csv(tmp_path, "\ufeffrun, rho, r1\n1, 7800, 5e-3\n\n2, 7900.5, 5.5e-3\n3, 7700, 6e-3\n")
    file = read_samples(path, uncertain, None)
    sampler = Sampler(uncertain, Plan(3, 0, file=file))
    assert sampler.kind == "file" and sampler.names == ["r1", "rho"] and sampler.extends
    found = sampler.draw(1, 3)
    np.testing.assert_array_equal(found["r1"], RADII[1:])
    np.testing.assert_array_equal(found["rho"], [7900.5, 7700.0])
    texts = [remark.text for remark in sampler_remarks(uncertain, Plan(3, 0, file=file))]
    assert f"columns of '{path}' that are no parameters have no part: run" in texts
    assert any("which nothing here can check" in text for text in texts)
    np.testing.assert_array_equal(read_samples(path, uncertain, 2).values["r1"], RADII[:2])
    identity = file.identity
    path = csv(tmp_path, "sample,status,r1 (m),angle (rad)\n0,0,5e-3,0.1\n1,0,5.5e-3,0.2\n2,0,6e-3,0.3\n")
    file = read_samples(path, uncertain, None)
    assert file.identity != identity
    np.testing.assert_array_equal(file.values["r1"], RADII)
    assert [remark.text for remark in file.remarks] == [
        f"columns of '{path}' that are no parameters have no part: sample, status, angle (rad)"
    ]
    np.testing.assert_array_equal(Sampler(uncertain, Plan(2, 0, file=file)).draw(0, 2)["rho"], 7800.0)


@pytest.mark.parametrize("group", ["", "parameters/"])
def test_data_sets_are_columns(uncertain: Scene, tmp_path: Path, group: str) -> None:
    path = tmp_path / "s.h5"
    with h5py.File(path, "w", userblock_size=512) as file:  # as results of this program have
        file[f"{group}r1"] = RADII
        file[f"{group}other"] = ["a", "b", "c"]
    found = read_samples(path, uncertain, None)
    np.testing.assert_array_equal(found.values["r1"], RADII)
    assert list(found.values) == ["r1"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "there is no column 'r1', an uncertain parameter; it has none at all"),
        ("r_1\n5e-3\n", "there is no column 'r1', an uncertain parameter; did you mean 'r_1'?"),
        ("r1\n", "there are no samples in it, only a first line of names"),
        ("r1\n5e-3\nthick\n", "line 3: r1 = 'thick'; a number is needed"),
        ("rho,r1\n7800,5e-3\n7800,\n", "line 3: r1 = nothing; a number is needed"),
        ("rho,r1\n7800,5e-3\n7800\n", "line 3 has 1 entries; the first line names 2 columns"),
        ("r1\n5e-3\nnan\n", "line 3: r1 = nan; a finite number is needed"),
        ("r1\n5e-3\n\ninf\n", "line 4: r1 = inf; a finite number is needed"),
        ("r1\n5e-3\n0.5e-3\n", "line 3: r1 = 0.0005; must lie in parameters.r1.bounds, [0.001, 0.012] m"),
        ("r1,rho\n5e-3,-1\n", "line 2: rho = -1; must be positive for what uses it"),
        ("r1 (mm)\n5\n", "the column 'r1 (mm)' has to be in m: convert it, and name it 'r1'"),
        ("r1,rho (g/cm3)\n5e-3,7.8\n", "the column 'rho (g/cm3)' has to be in kg/m3: convert it, and name it"),
        ("rho;r1\n7800;0,005\n", "columns are separated by semicolons ('rho;r1'); commas are needed"),
        ("r1,r1\n5e-3,5e-3\n", "2 columns are called 'r1'; one is needed"),
        ("r1\n" + "1\n" * 20, "... and 2 more problems"),
    ],
)
def test_a_bad_table_is_one_message_with_its_line(uncertain: Scene, tmp_path: Path, text: str, message: str) -> None:
    said = refusal(read_samples, csv(tmp_path, text), uncertain, None)
    assert message in said and said.startswith("--samples ")


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ('effects.e={type="joint_damping",joint="crank_hinge",coefficient="c"}',
         "c = -2; must not be negative for what uses it"),
        ('effects.e={type="end_stop",joint="crank_hinge",stiffness=10.0,lower=-1.0,upper="c"}',
         r"effects\.e\.lower = -1; must be below upper, -2"),
        ('controllers.e={type="pid",joint="crank_hinge",measures="angle",gains={p=1.0},limits=[-1.0,"c"]}',
         r"controllers\.e\.limits\[0\] = -1; must be below limits\[1\], -2"),
    ],
    ids=["damping", "ends that cross", "limits that cross"],
)  # fmt: skip
def test_what_an_entry_cannot_have_is_refused_with_its_line(entry: str, message: str, tmp_path: Path) -> None:
    """Of a table; samples that are drawn are unphysical."""
    law = "parameters.r1.distribution={name='norm',scale=1e-3}"
    angle = 'outputs.angle={type="angle",joint="crank_hinge"}'
    uncertain = slider_crank("parameters.c={nominal=1.0}", angle, entry, law)
    path = csv(tmp_path, "r1,c\n5e-3,0.5\n5e-3,-2\n")
    assert_refused(f"line 3: {message}", read_samples, path, uncertain, None)
    drawn = {"r1": np.full(2, 5e-3), "c": np.array([0.5, -2.0])}
    np.testing.assert_array_equal(physical(uncertain, drawn), [True, False])
    # lines beyond -n are not looked at
    assert read_samples(path, uncertain, 1).values["c"].tolist() == [0.5]


def test_a_data_set_in_another_unit_is_refused(uncertain: Scene, tmp_path: Path) -> None:
    with h5py.File(tmp_path / "s.h5", "w") as file:
        file["r1"] = np.full(2, 5e-3)
        file["r1"].attrs["unit"] = "m"
    assert read_samples(tmp_path / "s.h5", uncertain, None).values["r1"].tolist() == [5e-3, 5e-3]
    with h5py.File(tmp_path / "s.h5", "a") as file:
        file["r1"].attrs["unit"] = "mm"
    with pytest.raises(InputError, match=r"the column 'r1 \(mm\)' has to be in m: convert it"):
        read_samples(tmp_path / "s.h5", uncertain, None)


def test_no_table_at_all(uncertain: Scene, tmp_path: Path) -> None:
    assert_refused("there is no such file", read_samples, tmp_path / "no.csv", uncertain, None)
    (tmp_path / "b.csv").write_bytes(b"r1\n\xff\xfe\n")
    assert_refused("it cannot be read as CSV or HDF5", read_samples, tmp_path / "b.csv", uncertain, None)
    with pytest.raises(InputError, match=r"-n 4: --samples .* has 1 samples; give at most so many"):
        read_samples(csv(tmp_path, "r1\n5e-3\n"), uncertain, 4)
    fixed = slider_crank()
    with pytest.raises(InputError, match="none of its columns is a parameter of the scene"):
        read_samples(csv(tmp_path, "x\n5e-3\n"), fixed, None)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"r1": np.zeros((2, 2))}, r"data set '/r1' has shape \(2, 2\)"),
        ({"r1": np.array([b"a"])}, r"data set '/r1' has shape \(1,\) and type"),
        ({"r1": np.zeros(0)}, r"data set '/r1' has shape \(0,\)"),
        ({"r1": np.full(2, 5e-3), "rho": np.full(3, 7e3)}, "columns differ in length: r1 2, rho 3"),
        ({"r1": np.array([5e-3, np.nan])}, "sample 1: r1 = nan; a finite number is needed"),
    ],
)
def test_bad_data_sets(uncertain: Scene, tmp_path: Path, content: dict, message: str) -> None:
    with h5py.File(tmp_path / "s.h5", "w") as file:
        for name, values in content.items():
            file[name] = values
    assert_refused(message, read_samples, tmp_path / "s.h5", uncertain, None)


def test_a_drawn_parameter_is_held_in_the_units_of_the_scene(scene: Scene) -> None:
    r1 = scene.parameters["r1"].model_copy(update={"unit": "m", "value": 5.1234567e-3})
    in_mm = scene.with_entries(scene={"units": "mm"}, parameters={**scene.parameters, "r1": r1})
    assert_refused(r"'parameters.r1=\{nominal=5.6, value=5.1234567\}'", sampling.refuse_drawn, in_mm, ["r1=5.1234567"])
