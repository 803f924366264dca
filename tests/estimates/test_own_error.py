"""What a model's own error does to figures, in words."""

import numpy as np
from runs import reduced_model

from pgmp_petsc.estimates.own_error import OwnErrors, not_known, of_figures, of_statistics
from scenes import slider_crank

WORDS = ("mean", "deviation, quantiles")


def told(values: np.ndarray, errors: np.ndarray) -> str:
    """Return what is said of an output in N; all samples are fine."""
    found = of_statistics([("force", values)], {"force": errors}, np.ones(values.size, bool), {"force": "N"}, WORDS)
    return " ".join(f"{remark.kind}: {remark.text}" for remark in found)


def test_a_spread_of_errors_is_told_beside_the_deviation() -> None:
    exact = np.linspace(-1.0, 1.0, 100) * 0.012 / 0.58 + 3.0
    errors = np.where(np.arange(100) < 20, 30.0 * (exact - 3.0), np.nan)
    values = exact + 30.0 * (exact - 3.0)
    said = told(values, errors)
    assert said.startswith("warning: the reduced model's own error is a good part of deviation, quantiles of force: ")
    deviations = values[:20].std(ddof=1), exact[:20].std(ddof=1)
    assert f"20 checked samples have a deviation of {deviations[0]:.3g} N, and of {deviations[1]:.3g} N without" in said


def test_a_mean_of_errors_is_told_beside_the_mean_and_small_errors_are_not() -> None:
    values = np.random.default_rng(1).normal(2.0, 0.5, 50)
    assert "mean of force: about +0.4 N of" in told(values, np.full(50, 0.4))
    assert told(values, np.full(50, 0.01)) == told(values, np.full(50, np.nan)) == ""
    assert "(1 checked sample)" in told(values, np.append(0.4, np.full(49, np.nan)))
    # one tells of no deviation, and its error is named beside that where it is a good part
    assert "deviation, quantiles of force, of 0.445 N" in told(values, np.append(0.4, np.full(49, np.nan)))
    assert "errors up to 0.05 N" in told(values, np.append(0.05, np.full(49, np.nan)))
    assert told(values, np.append(0.02, np.full(49, np.nan))).startswith("note: ")


def test_errors_of_full_order_samples_are_the_steps_and_not_cured_by_full_order_runs() -> None:
    values = np.random.default_rng(1).normal(2.0, 0.5, 50)
    (said,) = of_statistics(
        [("force", values)], {"force": np.full(50, 0.4)}, np.ones(50, bool), {"force": "N"}, WORDS, "full"
    )
    assert "time step" in said.text and "simulation.step" in said.text
    assert "reduced" not in said.text and "--full" not in said.text


def test_figures_are_told_from_a_share_of_their_size_on() -> None:
    (said,) = of_figures([("a", 2.0, 1.0, 2.0), ("b", 2.0, 1.99, 2.0)])
    assert said.kind == "warning" and "a: 2, about 1 without" in said.text and "b:" not in said.text
    (said,) = of_figures([("a", 8e-3, 8e-3 + 1e-9, 1e-9)])  # no more digits than tell both apart
    assert "a: 0.008, about 0.008000001 without" in said.text
    (said,) = of_figures([("b", 2.0, 1.99, 2.0), ("idle", 0.0, 0.0, 0.0)], "the standard errors")
    assert said.kind == "note" and "up to 0.5 % of the standard errors" in said.text


def test_errors_that_are_not_estimated_are_said_to_be_unknown() -> None:
    model = reduced_model(slider_crank())  # without outputs
    assert OwnErrors.of_runs(model, [model.scene.values]) is None
    said = not_known(model, "derivatives")
    assert said.kind == "note" and "errors of the reduced model do to derivatives is not known: errors" in said.text
