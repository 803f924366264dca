"""Parameters from measured histories: recovered within their standard errors, and said where they cannot be."""

from dataclasses import replace

import numpy as np
import pytest
from differences import failing_at
from mpi4py import MPI
from runs import FEW_MODES, components_model, full_model, history, reduced_model, samples
from scipy.interpolate import CubicSpline
from scipy.signal import lfilter

from pgmp_petsc.design import fitting
from pgmp_petsc.design.fitting import MeasuredHistory, autocorrelation, fit, uncertainty
from pgmp_petsc.gradients.differentiated import differentiate
from pgmp_petsc.models import ReducedModel
from pgmp_petsc.results import Fit
from pgmp_petsc.results.gradients import FittedParameter
from pgmp_petsc.scene import scene_from_toml
from scenes import HEADER, slider_crank, tables

IDLE = HEADER + tables("""
bodies.wheel: rigid = { mass = 2.0, inertia = 0.1, points = { hub = [0.0, 0.0] } }
joints.hinge: type = "revolute"; connect = ["ground:origin", "wheel:hub"]
coordinates.theta: joint = "hinge"; range = [-1.5, 1.5]
effects.spring: type = "spring_damper"; joint = "hinge"; stiffness = "k"; damping = "c"
outputs.angle: type = "angle"; joint = "hinge"
outputs.other: type = "formula"; formula = "angle + idle"; unit = "rad"
parameters.k: nominal = 40.0; bounds = [20.0, 60.0]
parameters.c: nominal = 0.2; bounds = [0.05, 0.6]
parameters.idle: nominal = 3.0; distribution = { name = "discrete", values = [2.0, 3.0, 4.0] }
simulation: duration = 1.0; step = 1e-3
simulation.initial.theta: velocity = 2.0
""")
MODES = *FEW_MODES, "reduction.second_order=true"
SCENE = (
    'parameters.r1={nominal=5.6e-3,bounds=[3e-3,9e-3],distribution={name="norm",loc=5.6e-3,scale=0.56e-3}}',
    "parameters.c={nominal=0.02,bounds=[1e-3,0.1]}",
    'effects.bearing={type="joint_damping",joint="crank_hinge",coefficient="c"}',
    "effects.motor.table=[[0.0,0.0],[0.05,1.5],[1.0,1.5]]", "simulation.duration=0.3", "simulation.step=1e-3",
    'outputs.angle={type="angle",joint="crank_hinge"}', 'outputs.bend={type="deformation",point="rod:tip",axis="x"}',
)  # fmt: skip
TRUE = {"r1": 6.1e-3, "c": 0.03}
NOISE = {"angle": 2e-3, "bend": 2e-6}
EVERY = 3


def test_what_nothing_depends_on_stays_where_it_began() -> None:
    """A free vibration, ``exp(-c t / 2 I) sin(omega t)``, and a parameter of another output; the method went to the end
    of its region along it in every step, and took 35 runs."""
    time, damping = np.arange(0.0, 1.0, 5e-3), 0.3 / (2.0 * 0.1)
    omega = np.sqrt(43.0 / 0.1 - damping**2)
    exact = 2.0 / omega * np.exp(-damping * time) * np.sin(omega * time)
    angle = exact + 1e-3 * np.random.default_rng(3).normal(size=time.size)
    model, history = components_model(scene_from_toml(IDLE, ".")), MeasuredHistory(time, {"angle": angle})
    found = fit(model, history, ["k", "c", "idle"], {}, MPI.COMM_SELF)
    assert found is not None and found.n_runs <= 7  # one more where it weighs one output anew
    assert of(found)["idle"].estimate == 3.0 and np.isinf(of(found)["idle"].error)
    for name, true in (("k", 43.0), ("c", 0.3)):
        assert abs(of(found)[name].estimate - true) < 4.0 * of(found)[name].error
    said = " ".join(remark.text for remark in found.record.remarks)
    assert "all bodies are rigid, so that these are errors of the time step" in said
    assert "idle is searched over all numbers between its limits, also between single values" in said


def test_springs_that_only_their_sums_tell_apart_are_named_with_one_another() -> None:
    """Two springs of one joint, two dampers of it, and what no output depends on."""
    second = """
parameters.k2 = { nominal = 20.0, bounds = [5.0, 60.0] }
parameters.c2 = { nominal = 0.2, bounds = [0.05, 1.0] }
effects.second = { type = "spring_damper", joint = "hinge", stiffness = "k2", damping = "c2" }
"""
    time = np.arange(0.0, 0.5, 5e-3)
    scene = scene_from_toml(second + IDLE, ".")
    history = MeasuredHistory(time, {"angle": 0.1 * np.exp(-4.0 * time) * np.sin(25.0 * time)})
    found = fit(components_model(scene), history, ["k", "c", "k2", "c2", "idle"], {}, MPI.COMM_SELF)
    said = [remark.text for remark in found.record.remarks]
    assert not any("of the standard errors" in text for text in said)  # there are none
    told = {text.split()[0]: text.split(": ")[1] for text in said if "is not identifiable" in text}
    held = "is better held (--parameter with the others)"
    for one, other in (("k", "k2"), ("k2", "k"), ("c", "c2"), ("c2", "c")):
        only = f"outputs depend on it only together with {other}"
        assert told[one] == f"{only}; its value is none, and one of them {held}"
    assert told["idle"] == f"no output depends on it; its value is none, and it {held}"


@pytest.fixture(scope="module")
def model() -> ReducedModel:
    return reduced_model(slider_crank(*MODES, *SCENE))


@pytest.fixture(scope="module")
def of_full() -> dict[str, np.ndarray]:
    """Return the full-order history of the true values."""
    full = full_model(slider_crank(*MODES, *SCENE))
    time, outputs = history(full, samples(full.scene, 1, **TRUE), 1)
    return {"time": time, **{name: values[:, 0] for name, values in outputs.items()}}


def measured(exact: dict[str, np.ndarray], seed: int, *names: str, size: float = 1.0) -> MeasuredHistory:
    random, chosen = np.random.default_rng(seed), slice(2, None, EVERY)
    found = {name: exact[name][chosen] for name in names or NOISE}
    noisy = {name: values + size * NOISE[name] * random.normal(size=values.size) for name, values in found.items()}
    return MeasuredHistory(exact["time"][chosen], noisy)


def of(found: Fit) -> dict[str, FittedParameter]:
    return {parameter.name: parameter for parameter in found.parameters}


def test_a_radius_and_a_damping_are_recovered_from_a_full_order_history(model, of_full) -> None:
    found = fit(model, measured(of_full, 5), ["r1", "c"], {}, MPI.COMM_SELF)
    assert found.converged
    for name, parameter in of(found).items():
        # three standard errors: a chance of 0.3 % each
        assert abs(parameter.estimate - TRUE[name]) < 3.0 * parameter.error
        assert abs(parameter.estimate - parameter.start) > 10.0 * parameter.error
    for name, output in found.outputs.items():
        # the deviation of 100 numbers is known to 7 %
        assert output.noise == pytest.approx(NOISE[name], rel=0.25)


def test_a_search_turns_back_from_where_a_run_stops(model, of_full, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = model, measured(of_full, 5), ["r1", "c"], NOISE, MPI.COMM_SELF
    expected = of(fit(*asked))
    failing_at(3, fitting, monkeypatch)  # after the start, and its place inside the limits
    found = fit(*asked)
    (told,) = [remark.text for remark in found.record.remarks if "turned back" in remark.text]
    assert told.startswith("the search turned back once from where no run comes to its end, first at r1 = ")
    for name, parameter in of(found).items():
        # both end where steps are 1e-10 of the values
        assert parameter.estimate == pytest.approx(expected[name].estimate, rel=1e-6)


def test_standard_errors_are_the_spread_of_estimates(model) -> None:
    """Of 8 histories of the reduced model itself: errors over standard errors have a mean square of 1. Its own run is
    found again to what iterations leave, which is said to be nothing else."""
    run = differentiate(model, model.scene.values | TRUE, ["r1"])
    exact, squares = {"time": run.time, **run.outputs}, []
    for seed in range(8):
        found = fit(model, measured(exact, seed), ["r1", "c"], NOISE, MPI.COMM_SELF)
        assert abs(found.correlation[0, 1]) < 0.9
        assert not any("hardly told apart" in remark.text for remark in found.record.remarks)
        for name, parameter in of(found).items():
            squares.append(((parameter.estimate - TRUE[name]) / parameter.error) ** 2)
    assert 0.3 < np.mean(squares) < 2.2  # of 16: within 3.4 deviations
    again = fit(model, measured(exact, 0, size=0.0), ["r1", "c"], {}, MPI.COMM_SELF)
    assert of(again)["c"].estimate == pytest.approx(TRUE["c"], rel=1e-6)
    assert not any("what is left of" in remark.text for remark in again.record.remarks)


def test_what_runs_do_not_resolve_is_no_doubt_of_the_model(model) -> None:
    """A run of the reduced model ends its iterations 1e-13 of the mechanism's size early, 1e-9 of its deformations."""
    time, outputs = history(model, samples(model.scene, 1, **TRUE), 1)
    exact = {"time": time, **{name: values[:, 0] for name, values in outputs.items()}}
    found = fit(model, measured(exact, 0, size=0.0), ["r1", "c"], {}, MPI.COMM_SELF)
    assert of(found)["r1"].estimate == pytest.approx(TRUE["r1"], rel=1e-6)
    told = [remark for remark in found.record.remarks if "what is left of" in remark.text]
    assert [remark.kind for remark in told] == ["note"] and "bend is no more than the run's own error" in told[0].text


def test_a_parameter_without_effect_is_named(of_full) -> None:
    scene = slider_crank(*MODES, *SCENE, "parameters.idle={nominal=1.0,bounds=[0.5,2.0]}")
    model = reduced_model(scene)
    found = fit(model, measured(of_full, 5), ["r1", "idle"], {}, MPI.COMM_SELF)
    assert np.isinf(of(found)["idle"].error) and np.isfinite(of(found)["r1"].error)
    texts = [str(remark) for remark in found.record.remarks]
    assert any("warning: idle is not identifiable" in text and "no output depends on it" in text for text in texts)
    # the damping was left at a wrong value: what is left is no noise
    assert any("what is left of angle is no independent noise" in text for text in texts)


def test_runs_with_smaller_steps_are_said(model, of_full, monkeypatch: pytest.MonkeyPatch) -> None:
    """A run at the scene's step is another one: a fit through a stop was 1.4 mrad off it, without a word."""
    monkeypatch.setattr(fitting, "differentiate", lambda *given: replace(differentiate(*given), steps_divided=2))
    found = fit(model, measured(of_full, 5), ["r1"], {}, MPI.COMM_SELF)
    assert any("it was integrated with 1/2 of it" in remark.text for remark in found.record.remarks)


def test_a_limit_that_is_met_is_said(model, of_full) -> None:
    narrow = model.scene.parameters["r1"].model_copy(update={"bounds": (5.0e-3, 5.9e-3)})
    scene = model.scene.model_copy(update={"parameters": model.scene.parameters | {"r1": narrow}})
    other = ReducedModel(scene, model.rom)
    found = fit(other, measured(of_full, 5), ["r1"], {}, MPI.COMM_SELF)
    assert of(found)["r1"].estimate == pytest.approx(5.9e-3, rel=1e-5)
    assert any("r1 ends at the upper limit of its search" in remark.text for remark in found.record.remarks)


def test_what_the_basis_does_not_span_is_said_of_what_tables_depend_on(model, of_full) -> None:
    """Of the damping, on which no table depends, nothing is said."""
    narrow = (
        'parameters.r1.distribution={name="norm",loc=5.6e-3,scale=0.1e-3}',
        'parameters.c.distribution={name="norm",loc=0.02,scale=1e-3}',
    )
    other = ReducedModel(slider_crank(*MODES, *SCENE, *narrow), model.rom)
    said = [remark.text for remark in fit(other, measured(of_full, 5), ["r1", "c"], {}, MPI.COMM_SELF).record.remarks]
    told = [text for text in said if "the reduced basis spans" in text]
    assert len(told) == 1 and told[0].startswith("r1 = 0.006") and "outside [0.0053, 0.0059]," in told[0]
    assert "all but 0.27 % of its distribution" in told[0]


def test_noise_that_is_exceeded_and_a_fit_that_does_not_converge_are_said(model, of_full, monkeypatch) -> None:
    import scipy.optimize

    found = fit(model, measured(of_full, 5), ["r1", "c"], {"angle": 1e-4, "bend": 2e-6}, MPI.COMM_SELF)
    assert any("is more than its noise, 0.1 mrad (--noise)" in remark.text for remark in found.record.remarks)
    whole = scipy.optimize.least_squares
    monkeypatch.setattr(scipy.optimize, "least_squares", lambda *a, **k: whole(*a, **k, max_nfev=1))
    found = fit(model, measured(of_full, 5), ["r1", "c"], {}, MPI.COMM_SELF)
    assert not found.converged and any("the fit did not converge" in remark.text for remark in found.record.remarks)


def test_uncertainty_is_that_of_linear_regression() -> None:
    """And where parameters only act together there is none."""
    random = np.random.default_rng(2)
    jacobian, scale = random.normal(size=(40, 3)) * [1.0, 1e6, 1e-3], np.array([1.0, 1e-6, 1e3])
    errors, correlation, tied = uncertainty([jacobian], scale)
    covariance = np.linalg.inv(jacobian.T @ jacobian)
    np.testing.assert_allclose(errors, np.sqrt(np.diag(covariance)), rtol=1e-9)
    np.testing.assert_allclose(correlation, covariance / np.outer(errors, errors), atol=1e-9)
    assert not tied.any()
    column = random.normal(size=40)
    errors, _, tied = uncertainty([np.stack([column, 2.0 * column, np.arange(40.0)], axis=1)], np.ones(3))
    assert tied.tolist() == [[True, True, False], [True, True, False], [False] * 3]
    assert np.isinf(errors[:2]).all() and np.isfinite(errors[2])


def test_standard_errors_allow_for_correlated_noise() -> None:
    """With noise correlated by 0.4 intervals of independent noise hold in 79 % (1.96 / sqrt(1.4 / 0.6) deviations)."""
    random, n, held, independent = np.random.default_rng(3), 300, [], []
    slopes = np.column_stack([np.sin(3.0 * np.arange(n) / n), np.arange(n) / n])
    for _ in range(200):
        noise = lfilter([np.sqrt(0.84)], [1.0, -0.4], random.normal(size=n + 50))[50:]
        estimate = np.linalg.lstsq(slopes, noise, rcond=None)[0]
        left = noise - slopes @ estimate
        weighted = slopes[None] / np.sqrt(np.sum(left**2) / (n - 2))
        held += list(np.abs(estimate) < 1.96 * uncertainty(weighted, np.ones(2), [autocorrelation(left)])[0])
        independent += list(np.abs(estimate) < 1.96 * uncertainty(weighted, np.ones(2))[0])
    # of 400, in pairs: their share is known to 1.5 %
    assert 0.90 < np.mean(held) < 0.985 and np.mean(independent) < 0.86


def test_correlated_noise_is_said(model) -> None:
    run = differentiate(model, model.scene.values | TRUE, ["r1"])
    random = np.random.default_rng(4)
    noisy = {
        name: run.outputs[name] + size * lfilter([np.sqrt(0.84)], [1.0, -0.4], random.normal(size=run.time.size))
        for name, size in NOISE.items()
    }
    asked = ["r1", "c"], NOISE, MPI.COMM_SELF
    found = fit(model, MeasuredHistory(run.time, noisy), *asked)
    texts = [str(remark) for remark in found.record.remarks]
    assert any("note: what is left of angle is correlated (0." in text for text in texts)
    assert not any("standard errors are too small" in text for text in texts)


def test_many_measurements_are_condensed_without_a_difference(model, monkeypatch: pytest.MonkeyPatch) -> None:
    run = differentiate(model, model.scene.values | TRUE, ["r1"])
    random, time = np.random.default_rng(5), np.sort(np.random.default_rng(6).uniform(0.0, run.time[-1], 6100))
    noisy = {
        name: CubicSpline(run.time, run.outputs[name])(time) + size * random.normal(size=time.size)
        for name, size in NOISE.items()
    }
    asked, runs = (model, MeasuredHistory(time, noisy), ["r1", "c"], {"angle": 2e-3}, MPI.COMM_SELF), []
    condensing = fitting._Condensed.rows
    monkeypatch.setattr(fitting._Condensed, "rows", lambda *a: runs.append(a) or condensing(*a))
    condensed = fit(*asked)
    assert runs
    monkeypatch.setattr(fitting, "DENSE", 1000)
    whole, n = fit(*asked), len(runs)
    assert len(runs) == n
    for name, parameter in of(whole).items():
        # both search until steps are 1e-10 of the values
        assert of(condensed)[name].estimate == pytest.approx(parameter.estimate, rel=1e-7)
        assert of(condensed)[name].error == pytest.approx(parameter.error, rel=1e-6)
    for name, output in whole.outputs.items():
        assert condensed.outputs[name].noise == pytest.approx(output.noise, rel=1e-7)


@pytest.mark.parametrize("dense", [fitting.DENSE, 0.1])
def test_sensors_at_instants_of_their_own_count_as_those_at_common_ones(model, of_full, monkeypatch, dense) -> None:
    """One sensor is a nanosecond late, in rows of its own, in which the other one has gaps."""
    monkeypatch.setattr(fitting, "DENSE", dense)
    common = measured(of_full, 5)
    time = np.ravel([common.time, common.time + 1e-9], order="F")
    angle, bend = common.outputs.values()
    gaps = np.full(angle.size, np.nan)
    apart = {"angle": np.ravel([angle, gaps], order="F"), "bend": np.ravel([gaps, bend], order="F")}
    found, known = (fit(model, one, ["r1", "c"], {}, MPI.COMM_SELF) for one in (MeasuredHistory(time, apart), common))
    for name, parameter in of(known).items():
        # a nanosecond is 1e-7 of a millimetre's and a milliradian's changes; the search ends at 1e-10 of the values
        assert of(found)[name].estimate == pytest.approx(parameter.estimate, rel=1e-5)
        assert of(found)[name].error == pytest.approx(parameter.error, rel=1e-4)
    for name, output in known.outputs.items():
        assert found.outputs[name].noise == pytest.approx(output.noise, rel=1e-5)
        assert np.isfinite(found.outputs[name].fitted).all()


def test_parameters_that_are_hardly_told_apart_are_named(model, of_full) -> None:
    """Mass and torque of a motion without deformation act as their quotient."""
    scene = slider_crank(
        *MODES, *SCENE, "parameters.push={nominal=1.0,bounds=[0.5,2.0]}", "parameters.rho={nominal=7800.0}",
        'effects.motor.scale="push"', 'materials.steel.rho="rho"',
    )  # fmt: skip
    other = replace(measured(of_full, 5, "angle"))
    found = fit(reduced_model(scene), other, ["push", "rho"], {}, MPI.COMM_SELF)
    assert any("rho and push are hardly told apart" in remark.text for remark in found.record.remarks)
