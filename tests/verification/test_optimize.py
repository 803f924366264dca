"""Designs against closed forms: the sag of a cantilever, and a spring that a torque winds up."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from differences import failing_at
from mpi4py import MPI
from runs import reduced_model

from pgmp_petsc.base.errors import InputError, PgmpError, RunError
from pgmp_petsc.design import optimization
from pgmp_petsc.design.derivatives import Dual, read_constraint, read_goal, sensitivities
from pgmp_petsc.design.fitting import MeasuredHistory, fit
from pgmp_petsc.design.optimization import DesignFigures, Question, _searched, designed_parameters, optimize
from pgmp_petsc.ensemble import intervals
from pgmp_petsc.ensemble.rare_run import run_rare_event
from pgmp_petsc.ensemble.sampling import draw
from pgmp_petsc.estimates.runs_at_points import RunsAtPoints
from pgmp_petsc.gradients.differences import Off
from pgmp_petsc.gradients.differentiated import DifferentiatedRun, differentiate
from pgmp_petsc.models import ReducedModel
from pgmp_petsc.results import Design
from pgmp_petsc.scene.numerics import Event
from pgmp_petsc.texts.studies import design_lines
from scenes import PENDULUM, STEEL, of_text, slider_crank

G, LENGTH, N_CELLS = 9.80665, 1.0, 20
SAG = 4e-3
# held at its hinge, the pendulum is a cantilever; of circles of radius r its tip sags by rho g L^4 / (2 E r^2)
bending = of_text(
    PENDULUM, f'bodies.arm.mesh="0.0:1.0:{N_CELLS}"', 'bodies.arm.section.radius="r"',
    'reduction={modes=3,angles=16,static_modes=true,interpolation="spline"}',
    "parameters.r={nominal=5e-3,bounds=[2e-3,20e-3]}", 'effects.weight={type="gravity"}', "initial.equilibrium=true",
    'outputs.sag={type="deformation",point="arm:tip",axis="y"}', "simulation={duration=2e-3,step=1e-3}",
)  # fmt: skip
STIFFNESS, LEAST = 40.0, 0.05
# a torque of `push` times an uncertain factor winds up a spring in the hinge: angle = push factor / k
winding = of_text(
    PENDULUM, "bodies.arm.section.radius=2e-2",
    'reduction={modes=2,angles=16,static_modes=true,interpolation="spline"}',
    'parameters.push={nominal=1.0,bounds=[0.1,20.0],distribution={name="norm",loc=1.0,scale=0.1}}',
    f'effects.spring={{type="spring_damper",joint="hinge",stiffness={STIFFNESS}}}',
    'effects.motor={type="torque",joint="hinge",table=[[0.0,1.0],[1.0,1.0]],scale="push"}',
    'initial={equilibrium=true,coordinates="free"}', 'outputs.angle={type="angle",joint="hinge"}',
    "simulation={duration=2e-3,step=1e-3}",
)  # fmt: skip


@pytest.fixture(scope="module")
def cantilever() -> ReducedModel:
    return reduced_model(bending())


@pytest.fixture(scope="module")
def wound() -> ReducedModel:
    return reduced_model(winding())


def design_of(model: ReducedModel, goal: str, *constraints: str, **robust: float) -> Design:
    known = model.outputs.functions, model.scene.parameters
    read = tuple(read_constraint(text, *known) for text in constraints)
    names = designed_parameters(model.scene, ())
    return optimize(model, Question(read_goal(goal, *known), read, names, **robust), MPI.COMM_SELF)


def test_the_thinnest_cantilever_that_sags_by_no_more(cantilever: ReducedModel) -> None:
    found = design_of(cantilever, "minimise r", f"start(sag) >= -{SAG}")
    expected = np.sqrt(STEEL["rho"] * G * LENGTH**4 / (2.0 * STEEL["E"] * SAG))
    # the mesh leaves 1 / n^2 or so of the sag, and half of it of the radius
    assert found.parameters[0].value == pytest.approx(expected, rel=0.5 / N_CELLS**2 + 1e-3)
    assert found.converged and found.constraints[0].active
    # the model's own optimum: the sag is exactly what is allowed
    assert -found.designed["sag"][0] == pytest.approx(SAG, rel=1e-6)


def test_a_goal_at_its_limit_ends_there(cantilever: ReducedModel) -> None:
    """A thicker bar sags less: the least sag is at the largest radius."""
    found = design_of(cantilever, "minimise max(abs(sag))")
    assert found.parameters[0].value == pytest.approx(20e-3, rel=1e-6)
    assert any("r ends at the upper limit" in remark.text for remark in found.record.remarks)


def test_what_cannot_be_met_is_said(wound: ReducedModel) -> None:
    found = design_of(wound, "minimise push", "start(angle) >= 2")
    assert not found.converged
    assert any("is missed by" in remark.text and remark.kind == "warning" for remark in found.record.remarks)
    assert not any("nearest optimum" in remark.text for remark in found.record.remarks)


def test_a_parameter_that_nothing_depends_on_is_named(wound: ReducedModel) -> None:
    found = design_of(wound, "minimise 3")
    assert found.parameters[0].value == found.parameters[0].start
    said = [remark.text for remark in found.record.remarks]
    assert "push: neither the goal nor a constraint depends on it, at the first and at the last design" in said
    said = [remark.text for remark in design_of(wound, "minimise start(angle)").record.remarks]
    assert not any("depends on it" in text for text in said)


def test_a_robust_design_keeps_its_distance(wound: ReducedModel) -> None:
    """The angle is linear in the torque: ``(push mean - K std) / k = least`` with the drawn samples' own moments."""
    found = design_of(wound, "minimise push", f"start(angle) >= {LEAST}", deviations=3.0, n_samples=12, seed=4)
    offsets = draw(wound.scene, 4, 0, 12)["push"] - 1.0
    expected = LEAST * STIFFNESS - offsets.mean() + 3.0 * offsets.std(ddof=1)
    # the angle of the node, which the modes turn a little
    assert found.parameters[0].value == pytest.approx(expected, rel=1e-4)
    nominal = design_of(wound, "minimise push", f"start(angle) >= {LEAST}")
    assert nominal.parameters[0].value == pytest.approx(LEAST * STIFFNESS, rel=1e-4)
    assert found.n_samples == 12 and nominal.n_samples == 1
    # the angle is linear in the torque, so that its interval is that of the samples
    ends = intervals.of_mean_and_deviations(-(expected + offsets) / STIFFNESS, 3.0, 0.95) + LEAST
    np.testing.assert_allclose(found.constraints[0].interval, ends, rtol=1e-3)
    assert nominal.constraints[0].interval is None and np.isnan(nominal.goal_interval).all()
    np.testing.assert_allclose(
        found.goal_interval, intervals.of_mean_and_deviations(expected + offsets, 3.0, 0.95), rtol=1e-4
    )
    assert any("leave open whether the design meets 'start(angle) >=" in str(remark) for remark in found.record.remarks)
    lines = "\n".join(design_lines(found))
    assert "95 % interval of mean and 3 deviations" in lines and lines.count("[") == 3


def test_what_the_model_is_off_by_in_any_sample_is_told(wound: ReducedModel, monkeypatch: pytest.MonkeyPatch) -> None:
    """Errors of the nominal run alone were 0.15 % of a stress that one of 32 samples had made a third too large."""
    off = 0.4 * LEAST * (np.arange(12) == 2)
    estimate = SimpleNamespace(over=lambda time, names, sample: {"angle": np.full(time.size, off[sample])})
    monkeypatch.setattr(
        RunsAtPoints, "of", lambda model, points: RunsAtPoints(model, estimate if len(points) == 12 else None, {})
    )
    found = design_of(wound, "minimise push", f"start(angle) >= {LEAST}", deviations=3.0, n_samples=12, seed=4)
    better = (found.parameters[0].value + draw(wound.scene, 4, 0, 12)["push"] - 1.0) / STIFFNESS - off
    (told,) = [remark.text for remark in found.record.remarks if "own error is a good part" in remark.text]
    both = re.search(r"'start\(angle\) >= 0.05': ([\d.]+), about ([\d.-]+) without", told)
    assert float(both[1]) == pytest.approx(LEAST, rel=1e-3)
    assert float(both[2]) == pytest.approx(better.mean() - 3.0 * better.std(ddof=1), rel=2e-2)


def test_that_a_model_does_not_hold_reaches_what_is_made_of_its_runs() -> None:
    """A beam of a radius of 1 mm turns by 0.16 rad against its frame; 0.14 rad is the limit of small rotations."""
    model, text = reduced_model(bending("parameters.r={nominal=1e-3,bounds=[0.8e-3,20e-3]}")), "elastic rotations of"
    for sag, beyond in ((0.2, ["warning: elastic rotations of 0.17 rad, beyond 0.14"]), (SAG, [])):
        found = design_of(model, "minimise r", f"start(sag) >= -{sag}")
        told = [str(one) for one in found.record.remarks if text in one.text]
        assert [one[: len(expected)] for one, expected in zip(told, beyond, strict=True)] == beyond
    told = sensitivities(model, ["r"], MPI.COMM_SELF).record.remarks
    assert any(f"2 of 2 runs (as given, and with each parameter changed): {text}" in one.text for one in told)
    sags = MeasuredHistory(found.time, {"sag": np.full(found.time.size, -0.14)})
    assert any(one.text.startswith(text) for one in fit(model, sags, ["r"], {}, MPI.COMM_SELF).record.remarks)


def test_that_a_model_does_not_hold_reaches_probabilities() -> None:
    law = '{name="norm", loc=1e-3, scale=5e-5}'
    model = reduced_model(bending(f"parameters.r={{nominal=1e-3, bounds=[0.8e-3, 20e-3], distribution={law}}}"))
    found = run_rare_event(model, Event(output="sag", below=-0.14), 500, 1, MPI.COMM_SELF)
    n = r"(\d) of \1 samples that are nearest to the level: elastic rotations of"
    assert any(re.match(n, remark.text) for remark in found.record.remarks)


class OneOfTwo:
    """One of two ranks, of which the other has no sample, and derivatives that are far off."""

    rank, size = 0, 1

    def allgather(self, own: object) -> list[object]:
        return [own, Off(0.5, "angle", "push")] if isinstance(own, Off) else [own]

    def bcast(self, own: object) -> object:
        return own


def test_derivatives_are_as_far_off_as_on_any_rank(wound: ReducedModel) -> None:
    question = Question(read_goal("minimise push", ["angle"], ["push"]), (), ("push",))
    figures = DesignFigures(wound, question, OneOfTwo())
    figures.at(figures.start)
    assert figures.off.share == 0.5


def test_a_search_says_what_it_has_found(wound: ReducedModel) -> None:
    known = ["angle"], ["push"]
    constraints = tuple(read_constraint(f"start(angle) >= {least}", *known) for least in (LEAST, 0.0))
    figures = DesignFigures(wound, Question(read_goal("maximise push", *known), constraints, ("push",)), MPI.COMM_SELF)
    figures.at(figures.start)
    assert figures.progress.found == "design 1: push = 1, 1 of 2 constraints missed"
    figures = DesignFigures(wound, Question(read_goal(" minimise(push)", *known), (), ("push",)), MPI.COMM_SELF)
    figures.at(figures.start)
    assert figures.progress.found == "design 1: (push) = 1"


def test_more_of_a_figure_is_wanted(wound: ReducedModel) -> None:
    """``angle (10 - push)`` is largest at 5."""
    found = design_of(wound, "maximise start(angle) * (10 - push)")
    assert found.parameters[0].value == pytest.approx(5.0, rel=1e-4)
    assert found.goal_value > found.goal_start and found.goals[-1] <= found.goals.max()


def test_samples_keep_within_the_bounds(wound: ReducedModel) -> None:
    found = design_of(wound, "minimise push", deviations=0.0, n_samples=8, seed=4)
    offsets = draw(wound.scene, 4, 0, 8)["push"] - 1.0
    assert found.parameters[0].lower == pytest.approx(0.1 - offsets.min(), rel=1e-12)
    assert found.parameters[0].value == found.parameters[0].lower
    (told,) = [remark.text for remark in found.record.remarks if "its samples vary" in remark.text]
    assert told.startswith(f"push: its samples vary from {offsets.min():+.4g} to {offsets.max():+.4g} about the design")
    assert f"searched in [{found.parameters[0].lower:.6g}, {found.parameters[0].upper:.6g}] alone;" in told


def test_a_start_without_room_for_samples_is_moved_and_said(wound: ReducedModel) -> None:
    away = ReducedModel(wound.scene.with_values({"push": 20.0}), wound.rom)
    found = design_of(away, "minimise push", deviations=0.0, n_samples=8, seed=4)
    (told,) = [remark.text for remark in found.record.remarks if "its samples vary" in remark.text]
    assert f"alone, from {found.parameters[0].upper:.6g} on and not from 20; wider bounds" in told


def test_limits_without_room_for_samples_are_refused(cantilever: ReducedModel) -> None:
    law = {"distribution": {"name": "uniform", "loc": -20e-3, "scale": 40e-3}}
    wide = type(cantilever.scene.parameters["r"])(nominal=5e-3, **law)
    scene = cantilever.scene.model_copy(update={"parameters": {"r": wide}})
    with pytest.raises(InputError, match="parameters.r: its samples vary .* which leaves no room"):
        design_of(ReducedModel(scene, cantilever.rom), "minimise r", deviations=3.0, n_samples=64, seed=4)


@pytest.mark.parametrize("kind", [RunError, InputError])
def test_a_run_that_stops_on_the_way_names_the_design_and_the_cure(
    cantilever: ReducedModel, monkeypatch: pytest.MonkeyPatch, kind: type[PgmpError]
) -> None:
    def stopping(*_: object) -> None:
        raise kind("no run")

    monkeypatch.setattr(optimization, "differentiate", stopping)
    with pytest.raises(kind, match=r"at r = 0\.005 m: no run") as error:
        design_of(cantilever, "minimise r")
    assert ("--override parameters.r.bounds=" in str(error.value)) == (kind is RunError)


def test_a_design_that_takes_smaller_steps_is_kept_at_those_of_the_scene(cantilever: ReducedModel, monkeypatch) -> None:
    halved = reduced_model(bending("simulation.step=5e-4"))

    def with_half_the_step(model: ReducedModel, values: dict[str, float], names: tuple[str, ...]) -> DifferentiatedRun:
        if values["r"] < 10e-3:
            return differentiate(model, values, names)
        return replace(differentiate(halved, values, names), steps_divided=2)

    monkeypatch.setattr(optimization, "differentiate", with_half_the_step)
    found = design_of(cantilever, "maximise r")
    np.testing.assert_allclose(found.time, [0.0, 1e-3, 2e-3], rtol=1e-12)
    assert found.begun["sag"].shape == found.designed["sag"].shape == (3,)
    assert any("it was integrated with 1/2 of it" in remark.text for remark in found.record.remarks)


def test_a_search_turns_back_from_where_a_run_stops(wound: ReducedModel, monkeypatch: pytest.MonkeyPatch) -> None:
    failing_at(2, optimization, monkeypatch)
    found = design_of(wound, "maximise start(angle) * (10 - push)")
    assert found.converged and found.parameters[0].value == pytest.approx(5.0, rel=1e-4)
    assert np.isfinite(found.goals).all() and len(found.goals) == len(found.tried)
    (told,) = [remark.text for remark in found.record.remarks if remark.kind == "warning"]
    assert told.startswith("the search turned back once from where no run comes to its end, first at push = ")
    said = [remark.text for remark in found.record.remarks if "nearby" in remark.text]
    assert len(said) == 1 and "before an optimum, as runs stopped on its way; another start (--set)" in said[0]
    assert "the run stopped at 1 ms; what lies beyond was not searched, and" in told


def test_a_design_beside_which_runs_stop_says_so(wound: ReducedModel, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a design of 2 N m, a thousandth is tried to either side."""

    def stopping(model: ReducedModel, values: dict[str, float], names: tuple[str, ...]) -> DifferentiatedRun:
        if 1.9975 < values["push"] < 1.9985:
            raise RunError("the run stopped at 1 ms")
        return differentiate(model, values, names)

    monkeypatch.setattr(optimization, "differentiate", stopping)
    found = design_of(wound, "minimise push", f"start(angle) >= {LEAST}")
    (told,) = [remark.text for remark in found.record.remarks if "at the edge" in remark.text]
    assert "0.1 % to one side of it a run stops, first at push = 1.998" in told and found.converged


def test_a_search_turns_back_from_where_the_ends_of_a_stop_cross() -> None:
    stop = 'effects.stop={type="end_stop",joint="hinge",lower=-1.0,upper="top",stiffness=50.0}'
    model = reduced_model(winding(stop, 'parameters.top={nominal=1.0,unit="rad",bounds=[-2.0,2.0]}'))
    known = model.outputs.functions, model.scene.parameters
    found = optimize(model, Question(read_goal("minimise top", *known), (), ("top",)), MPI.COMM_SELF)
    assert found.parameters[0].value == pytest.approx(-1.0, abs=1e-3) and found.parameters[0].value > -1.0
    (told,) = [remark.text for remark in found.record.remarks if "turned back" in remark.text]
    assert "effects.stop.lower is not below upper there" in told and re.search(r"first at top = -[\d.]+ rad: ", told)


def test_of_samples_the_first_that_stops_is_named(wound: ReducedModel, monkeypatch: pytest.MonkeyPatch) -> None:
    failing_at(8 + 4, optimization, monkeypatch)
    found = design_of(wound, "minimise push", f"start(angle) >= {LEAST}", deviations=3.0, n_samples=8, seed=4)
    (told,) = [remark.text for remark in found.record.remarks if "turned back" in remark.text]
    assert re.search(r"first at push = [\d.]+( N m)?, sample \d: the run stopped", told)
    assert found.converged


def test_nothing_to_design_is_refused() -> None:
    scene = slider_crank("simulation.duration=0.01", 'outputs.angle={type="angle",joint="crank_hinge"}')
    with pytest.raises(InputError, match="parameters: none has bounds or a distribution"):
        designed_parameters(scene, ())
    with pytest.raises(InputError, match="--parameter r2: there is no such parameter; known: r1"):
        designed_parameters(scene, ("r2",))


class Valley:
    """A goal that is least at (1, 1), in a valley whose bottom is a kink, along the parabola y = x^2."""

    scale, limits, start = np.ones(2), np.array([[-1.0, 2.0], [-1.0, 2.0]]), np.array([0.2, 0.9])
    tried: list[np.ndarray] = []
    missed: list[list[float]] = []

    def at(self, design: np.ndarray) -> list[Dual]:
        x, y = design
        side = 10.0 * np.sign(y - x**2)
        return [Dual(side * (y - x**2) + (1.0 - x) ** 2, np.array([-2.0 * side * x - 2.0 * (1.0 - x), side]))]


def test_a_search_that_ends_at_a_kink_begins_again_there() -> None:
    """SLSQP by itself ends at 0.009, and says that it has converged; at last it finds no better design."""
    done, best = _searched(Valley(), 1.0, np.zeros(0))
    assert done.status == optimization.STALLED and done.message == "its last 6 iterations brought no better design"
    assert Valley().at(best)[0].value < 3e-4


class Cliff(Valley):
    """A goal that falls towards where a constraint is missed all at once, without a slope that says so."""

    def __init__(self) -> None:
        self.tried, self.goals, self.missed = [], [], []

    def at(self, design: np.ndarray) -> list[Dual]:
        off = 0.1 if design[0] < 0.0 else -0.1
        self.tried, self.goals, self.missed = [*self.tried, design], [*self.goals, design[0]], [*self.missed, [off]]
        return [Dual(design[0], np.array([1.0, 0.0])), Dual(off, np.zeros(2))]


def test_a_search_that_ends_outside_keeps_the_best_design_that_meets_the_constraints() -> None:
    cliff = Cliff()
    done, best = _searched(cliff, 1.0, np.ones(1))
    inside = [x for x in cliff.tried if x[0] >= 0.0]
    assert min(x[0] for x in cliff.tried) < 0.0 <= best[0] == min(x[0] for x in inside)
    assert done.status not in (0, 8) and done.message.endswith("the best one tried that meets all constraints")


class Swing(Valley):
    """A figure that is never below 0.99 and is to be between 0.8 and 0.9; its derivatives are a little off."""

    def __init__(self) -> None:
        self.tried, self.goals, self.missed = [], [], []

    def at(self, design: np.ndarray) -> list[Dual]:
        self.tried, self.goals = [*self.tried, design], [*self.goals, design[0]]
        x, y = design
        figure, slope = 1.0 + (x - 0.7) ** 2 - 0.005 * y, np.array([2.0 * (x - 0.7) + 1e-3 * np.sin(1e4 * x), -0.005])
        self.missed = [*self.missed, [0.9 - figure, figure - 0.8]]
        return [Dual(x, np.array([1.0, 0.0])), Dual(0.9 - figure, -slope), Dual(figure - 0.8, slope)]


def test_a_search_between_constraints_that_none_meets_ends_where_it_gets_no_nearer() -> None:
    swing = Swing()
    done, best = _searched(swing, 1.0, np.ones(2))
    # twice six iterations; SLSQP by itself goes on for all of its 200
    assert done.status == optimization.STUCK and done.nit <= 24 and "brought it no nearer" in done.message
    least = min(swing.tried, key=lambda x: swing.at(x)[2].value)
    assert swing.at(best)[2].value == pytest.approx(swing.at(least)[2].value, abs=optimization.GAINED)


def test_what_contradicts_is_named(wound: ReducedModel) -> None:
    def told(*constraints: str) -> list[str]:
        remarks = design_of(wound, "minimise push", *constraints).record.remarks
        return [remark.text.split(" contradict")[0] for remark in remarks if "contradict one another" in remark.text]

    assert told("start(angle) >= 0.2", "start(angle) <= 0.1") == ["'start(angle) >= 0.2' and 'start(angle) <= 0.1'"]
    assert told("start(angle) >= 2") == ["'start(angle) >= 2' and the upper limit of push"]
    assert told("start(angle) >= 0.2") == []


def test_a_search_that_meets_no_constraint_ends_where_they_are_missed_least() -> None:
    """SLSQP by itself stood half as far again away: the sag of a tube that falls is least at the largest radius, with a
    wall that lies between its limits."""
    tube = of_text(
        PENDULUM, 'bodies.arm.mesh="0.0:0.6:8"', 'bodies.arm.section={shape="hollow_circle",radius="r",wall="w"}',
        'parameters.r={nominal=12e-3,unit="m",bounds=[11.5e-3,20e-3]}', "reduction.modes=4",
        'parameters.w={nominal=3e-3,unit="m",bounds=[1e-3,7e-3]}', 'effects.weight={type="gravity"}',
        'effects.tool={type="point_mass",point="arm:tip",mass=1.0}', "reduction.static_modes=true",
        'outputs.sag={type="deformation",point="arm:tip",axis="y"}', "simulation={duration=8e-3,step=1e-3}",
    )  # fmt: skip
    model = reduced_model(tube())
    least = design_of(model, "minimise max(abs(sag))").goal_value
    found = design_of(model, "minimise r - w", "max(abs(sag)) <= 2e-6")
    assert not found.converged
    # both searches end where steps change what they search by 1e-5
    assert found.constraints[0].value == pytest.approx(least - 2e-6, rel=1e-4)
    told = [remark.text for remark in found.record.remarks if "contradict one another" in remark.text]
    assert len(told) == 1 and told[0].startswith("'max(abs(sag)) <= 2e-6' and the upper limit of r contradict")
    found = design_of(model, "minimise r - w", f"max(abs(sag)) <= {1.001 * least}")
    assert found.converged and found.constraints[0].value <= 1e-6 * least
