"""Sobol indices against Ishigami's function, whose indices are known, and against SALib's own analysis."""

from __future__ import annotations

import numpy as np
import pytest
from SALib.analyze import sobol

from pgmp_petsc.ensemble import sensitivity
from pgmp_petsc.ensemble.designs import Blocks
from pgmp_petsc.ensemble.sensitivity import of_blocks, of_given, sensitivities, sensitivity_remarks

NAMES = ["x1", "x2", "x3"]
A, B = 7.0, 0.1
# Ishigami and Homma 1990: y = sin x1 + A sin^2 x2 + B x3^4 sin x1, x uniform between -pi and pi
V1, V2, V13 = 0.5 * (1.0 + B * np.pi**4 / 5.0) ** 2, A**2 / 8.0, B**2 * np.pi**8 * 8.0 / 225.0
FIRST = np.array([V1, V2, 0.0]) / (V1 + V2 + V13)
TOTAL = np.array([V1 + V13, V2, V13]) / (V1 + V2 + V13)


def ishigami(uniform: np.ndarray) -> np.ndarray:
    x = np.pi * (2.0 * uniform.T - 1.0)
    return np.sin(x[0]) + A * np.sin(x[1]) ** 2 + B * x[2] ** 4 * np.sin(x[0])


def test_blocks_have_the_indices_of_ishigamis_function() -> None:
    found = of_blocks(ishigami(Blocks(1, 3).uniform(0, 5 * 1024)), NAMES, 0.95)
    assert (found.parameters, found.method, found.count) == (tuple(NAMES), "saltelli", 1024)
    for values, ends, true in (
        (found.first, found.first_interval, FIRST), (found.total, found.total_interval, TOTAL),
    ):  # fmt: skip
        assert np.all((ends[:, 0] <= true) & (true <= ends[:, 1])), (values, ends, true)
        # random blocks know an index to about 1 / sqrt(1024), 0.03; those of a Sobol sequence better
        np.testing.assert_allclose(values, true, rtol=0, atol=0.06)


def test_indices_and_the_size_of_intervals_are_those_of_salib() -> None:
    n = 256
    values = ishigami(Blocks(2, 3).uniform(0, 5 * n))
    found = of_blocks(values, NAMES, 0.95)
    problem = {"num_vars": 3, "names": NAMES, "bounds": [[0.0, 1.0]] * 3}
    known = sobol.analyze(problem, values, calc_second_order=False, num_resamples=200, seed=1)
    np.testing.assert_allclose(found.first, known["S1"], rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(found.total, known["ST"], rtol=1e-10, atol=1e-12)
    for ends, width in ((found.first_interval, "S1_conf"), (found.total_interval, "ST_conf")):
        # deviations of 100 and 200 resamples are known to 7 and 5 %
        np.testing.assert_allclose(0.5 * (ends[:, 1] - ends[:, 0]), known[width], rtol=0.3)


def test_any_samples_have_first_indices_whose_intervals_hold() -> None:
    """In 40 repetitions of 95 % intervals 5 misses or more come once in 30 times for each of three indices."""
    held = np.zeros(3)
    for seed in range(40):
        uniform = np.random.default_rng(seed).random((1000, 3))
        found = of_given(ishigami(uniform), dict(zip(NAMES, uniform.T)), 0.95)
        held += (found.first_interval[:, 0] <= FIRST) & (FIRST <= found.first_interval[:, 1])
    assert found.total is None and found.count == 1000
    assert np.all(held >= 34), held


def test_failed_samples_are_left_out_and_that_is_said() -> None:
    uniform = Blocks(1, 3).uniform(0, 5 * 64)
    values, fine = ishigami(uniform), np.ones(5 * 64, dtype=bool)
    fine[[7, 8, 100]] = False  # two blocks
    (found,) = sensitivities([("y", values)], {}, NAMES, fine, "saltelli", 0.95).values()
    assert found.count == 62
    (said,) = sensitivity_remarks({"y": found}, "saltelli", 3, fine, False)
    assert said.kind == "warning" and "62 of 64 blocks without a failed sample" in said.text


def test_what_does_not_vary_or_is_too_little_has_no_indices() -> None:
    few = np.ones(5 * 15, dtype=bool)
    assert sensitivities([("y", np.arange(75.0))], {}, NAMES, few, "saltelli", 0.95) == {}
    (said,) = sensitivity_remarks({}, "saltelli", 3, few, False)
    assert "15 blocks of samples are too few for Sobol indices, which take 16; give at least -n 80" in said.text
    columns = {"a": np.arange(79.0), "b": np.arange(79.0)}
    fine = np.ones(79, dtype=bool)
    assert sensitivities([("y", np.arange(79.0))], columns, ["a", "b"], fine, "random", 0.95) == {}
    (said,) = sensitivity_remarks({}, "random", 2, fine, False)
    assert "79 samples are too few to rank parameters by first Sobol indices, which takes 80" in said.text
    assert of_blocks(np.full(5 * 20, 3.0), NAMES, 0.95) is None
    assert of_given(np.full(200, 3.0), {"a": np.arange(200.0)}, 0.95) is None
    assert sensitivities([("y", np.arange(200.0))], columns, ["a"], np.ones(200, dtype=bool), "random", 0.95) == {}
    assert sensitivity_remarks({}, "random", 1, np.ones(200, dtype=bool), False) == ()


def test_many_samples_are_ranked_by_the_first_of_them(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sensitivity, "MOST_GIVEN", 300)
    uniform = np.random.default_rng(1).random((1000, 3))
    values, fine = ishigami(uniform), np.arange(1000) % 2 == 0
    (found,) = sensitivities([("y", values)], dict(zip(NAMES, uniform.T)), NAMES, fine, "random", 0.95).values()
    assert found.count == 300
    expected = of_given(values[:600][fine[:600]], dict(zip(NAMES, uniform[:600][fine[:600]].T)), 0.95)
    np.testing.assert_allclose(
        found.first, expected.first, atol=0.02
    )  # slices are of 600 parameters there, of 300 here


def test_a_repeated_command_repeats_its_intervals() -> None:
    values = ishigami(Blocks(1, 3).uniform(0, 5 * 32))
    np.testing.assert_array_equal(
        of_blocks(values, NAMES, 0.9).first_interval, of_blocks(values, NAMES, 0.9).first_interval
    )
