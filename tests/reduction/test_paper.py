"""The comparison with the paper: rules of the verdicts, measures, tables and messages."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import synthetic
from runs import rom_of

from benchmarks.paper import accuracy, comparison, equal_error, summary
from benchmarks.paper import figures as pictures
from benchmarks.paper.inertia import uncoupled
from benchmarks.paper.published import BANDS, DENSITIES, RADII
from benchmarks.paper.results import PaperResults
from benchmarks.tables import Table
from pgmp_petsc.base.errors import InputError
from pgmp_petsc.reduced.terms import coupling_of
from pgmp_petsc.reduction.tables import ReducedTables
from scenes import slider_crank

LAW = 'distribution = { name = "norm", loc = 5.6e-3, scale = 0.56e-3 }\n'


def ensemble(model: str):
    """Return a made-up ensemble with everything that the paper's figures need."""
    made = synthetic.ensemble(model)
    made.outputs["slider_position"] = made.outputs["crank_angle"] / 6.0
    record = replace(made.record, scene_toml=made.record.scene_toml + LAW, timings={"integration": 2.0})
    statistics = made.statistics | {"r1": synthetic.statistics(made.parameters["r1"])}
    return replace(made, record=record, statistics=statistics, units=made.units | {"slider_position": "m"})


@pytest.fixture
def directory(tmp_path: Path) -> Path:
    """Return a directory with made-up results, as the demo leaves them."""
    for factor, r1 in RADII.items():
        synthetic.modes_table(r1).write(tmp_path / f"modes_{factor}.h5")
        for model in ("full", "reduced"):
            synthetic.trajectory(model, r1).write(tmp_path / f"{model}_{factor}.h5")
    synthetic.modes_table(reduced=False).write(tmp_path / "modes_40_elements.h5")
    for model in ("full", "reduced"):
        ensemble(model).write(tmp_path / f"montecarlo_{model}.h5")
    return tmp_path


def test_a_band_must_agree_with_the_reference_and_fit_the_axis(directory: Path) -> None:
    results = PaperResults.read(directory)
    f4 = replace(next(band for band in BANDS if band.name == "f4"), reference={"1.0": (277.0, 357.0)})
    assert comparison.frequency_row(f4, results)[-1].startswith("ok")
    elsewhere = replace(f4, reference={"1.0": (277.0, 400.0)})
    assert comparison.frequency_row(elsewhere, results)[-1].startswith("differs from the reference")
    narrow = replace(f4, labels=(300.0, 310.0, 10.0))
    assert comparison.frequency_row(narrow, results)[-1].startswith("differs from the paper's axis")


def test_a_mean_is_judged_by_both_sampling_errors() -> None:
    published = DENSITIES["crank_angle"]
    random = np.random.default_rng(3).normal(published.mean, published.std, 10_000)
    assert comparison.moment_verdict(published, synthetic.statistics(random), "no") == "ok"
    shifted = synthetic.statistics(random + 0.1 * published.std)
    assert comparison.moment_verdict(published, shifted, "no").startswith("no (")
    support = np.array(published.support)
    assert comparison.shape_verdict(published, support, published.peak) == "ok"
    assert "ends" in comparison.shape_verdict(published, support - 1.0, published.peak)
    words = comparison.shape_verdict(published, support, 1.2 * published.peak, ", why")
    assert words == "differs: the peak by 20 %, why"


def test_the_published_table_has_a_verdict_in_every_row(directory: Path) -> None:
    table = comparison.published_table(PaperResults.read(directory))
    assert len(table.rows) == 4 + 2 + 1 + 8 + 1
    assert all(row[-1].startswith(("ok", "differs")) for row in table.rows)
    assert summary.verdicts([table])["all"] == len(table.rows)


def test_costs_are_compared_at_equal_error() -> None:
    """The cheapest run that is good enough counts, whatever its step; what nobody reaches is said."""
    runs = {
        "full": [equal_error.Run(64, 0.05, 3e-3), equal_error.Run(128, 0.015, 2e-3), equal_error.Run(256, 0.004, 4e-3)],
        "small": [equal_error.Run(64, 0.09, 1e-4), equal_error.Run(128, 0.018, 2e-4)],
    }
    one = equal_error.Comparison(5, runs["full"], {"small": runs["small"]})
    assert equal_error.cheapest(one.full, 0.1).n_steps == 128
    assert [row[-1] for row in equal_error.equal_error_table([one]).rows] == ["20", "10", "not reached"]
    assert "with small a reduced sample costs 10 to 20 times less (2 to 10 %)" in equal_error.in_words(one)


def test_a_basis_that_leaves_more_is_compared_at_the_least_error_that_it_leaves() -> None:
    full = [equal_error.Run(40, 0.14, 1e-3), equal_error.Run(128, 0.015, 2e-3)]
    coarse = [equal_error.Run(32, 0.17, 1e-5), equal_error.Run(64, 0.141, 1e-4)]
    one = equal_error.Comparison(40, full, {"coarse": coarse})
    rows = equal_error.equal_error_table([one]).rows
    assert [(row[2], row[-1]) for row in rows] == [("15 %", "10"), *((f"{e} %", "not reached") for e in (10, 2, 1))]
    assert "with coarse a reduced sample costs 10 times less (15 %)" in equal_error.in_words(one)
    better = equal_error.Comparison(40, full, {"fine": [equal_error.Run(64, 0.001, 1e-4)]})
    assert list(equal_error.savings(better, "fine")) == [0.1, 0.02]
    worse = equal_error.Comparison(40, [equal_error.Run(40, 0.3, 1e-3)], {"coarse": coarse})
    assert "with coarse no step of the full-order model is as good" in equal_error.in_words(worse)


def test_tables_without_inertia_coupling() -> None:
    scene = slider_crank("reduction.modes=4", "reduction.angles=12")
    tables: ReducedTables = rom_of(scene).tables
    for scheme in ("overhauser", "spline", "spectral"):
        assert np.abs(coupling_of(tables, scheme)).max() > 0.0
        np.testing.assert_array_equal(coupling_of(uncoupled(tables, scheme), scheme), 0.0)


def test_all_pictures_are_drawn(directory: Path) -> None:
    names = {path.name for path in pictures.draw(directory)}
    assert names == set(summary.PICTURES)
    assert all((directory / name).stat().st_size > 10_000 for name in names)


def test_what_does_not_fit_is_refused() -> None:
    with pytest.raises(InputError, match="did you mean 'crank_angle'"):
        pictures.densities([ensemble("full")], names=["crank_angel"])
    with pytest.raises(ValueError, match="row has 1 cells; needed: 2"):
        Table("T", ("a", "b"), [["1"]])
    theta = 2 * np.pi / 8 * np.arange(8)
    assert accuracy.nearest(theta, np.pi / 2) == 2
    with pytest.raises(ValueError, match="no angle 1 rad"):
        accuracy.nearest(theta, 1.0)


@pytest.mark.parametrize("program", [summary, pictures])
def test_the_programs_say_what_they_need(program, tmp_path: Path, monkeypatch, capsys) -> None:
    monkeypatch.setattr("sys.argv", ["program"])
    assert program.main() == 2
    assert "usage" in capsys.readouterr().err
    monkeypatch.setattr("sys.argv", ["program", str(tmp_path)])
    assert program.main() == 2
    assert "modes_0.9.h5" in capsys.readouterr().err
