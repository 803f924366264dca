"""Forces in sections away from the nominal parameters: against statics, full-order runs and their differences."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import ROOT
from length_scenes import long_crank, numbered
from mpi4py import MPI
from runs import full_model, motion, reduced_model, rom_of
from sealed import resealed
from test_stress_outputs import asked, held

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.design.design_figures import Question
from pgmp_petsc.design.goals import read_goal
from pgmp_petsc.design.optimization import optimize
from pgmp_petsc.design.sensitivities import sensitivities
from pgmp_petsc.ensemble.integration import run_ensemble
from pgmp_petsc.ensemble.plan import Plan
from pgmp_petsc.ensemble.rare_run import run_rare_event
from pgmp_petsc.mesh.line_mesh import straight_beam
from pgmp_petsc.models import ReducedModel, of_samples
from pgmp_petsc.ranks.groups import RankGroup
from pgmp_petsc.reduction.angles import TARGET
from pgmp_petsc.scene import load_scene
from pgmp_petsc.scene.numerics import Event
from pgmp_petsc.stepping.generalised_alpha import integrate
from pgmp_petsc.stepping.second_order_system import State

SCENE = ROOT / "scenes" / "slider_crank.toml"
NOMINAL, THINNER, DEVIATION = 5.6e-3, 5.04e-3, 0.56e-3
FORCES = (
    asked("rod_force", "axial_force", "at=[0.35,0.0]", "rod"),
    asked("crank_force", "axial_force", "at=[0.15,0.0]", "crank"),
    asked("crank_shear", "shear_force", "at=[0.15,0.0]", "crank"),
    asked("rod_worst", "stress_max", "", "rod"),
)


def mechanism(*settings: str) -> ReducedModel:
    """Return the slider-crank with forces in sections; values of a run have no part in what is built."""
    return ReducedModel(load_scene(SCENE, FORCES, settings), rom_of(load_scene(SCENE, FORCES)))


def without_answers(model: ReducedModel) -> ReducedModel:
    """Return a model that takes the forces of a state from its strains alone."""
    return ReducedModel(model.scene, replace(model.rom, missed=None))


@pytest.mark.parametrize("radius", [THINNER, NOMINAL + DEVIATION, NOMINAL - 3 * DEVIATION])
def test_forces_follow_the_mesh_at_every_radius(radius: float) -> None:
    """Before there were answers, shear in the crank was 30 % of its largest value off at one deviation, and 130 % at
    three; estimates know it."""
    model = mechanism(f"r1={radius}")
    found, reference = motion(model), motion(full_model(model.scene))
    for name, exact in reference.outputs.items():
        largest = np.max(np.abs(exact))
        # at three deviations the basis itself is off by a percent and more
        assert np.max(np.abs(found.outputs[name] - exact)) < (0.02 if radius < THINNER else 0.006) * largest, name
    worse, shear = motion(without_answers(model)), reference.outputs["crank_shear"]
    assert np.max(np.abs(worse.outputs["crank_shear"] - shear)) > 0.1 * np.max(np.abs(shear))


def test_forces_follow_the_mesh_at_other_lengths_too() -> None:
    """Of a rod of another length and a crank of another radius at once, in a single run and in lanes; without answers
    shear in the crank was 24 % off and axial forces 8 to 22 %."""
    late = "effects.motor.table=[[0.0, 0.0], [0.25, 0.5], [1.0, 0.5]]"
    light, short = "effects.weight.acceleration=1e-9", "simulation.duration=0.25"
    # a build takes 192 angles by itself, which leave 0.1 % in place of 0.4; see the next test
    changed = (*FORCES, late, light, short, "reduction.length_points=4", "reduction.max_angles=96")
    model = reduced_model(long_crank(*changed, settings=("rod_length=0.68", f"r1={THINNER}")))
    family = model.rom.family
    members = tuple(replace(member, missed=None) for member in family.members)
    bare = ReducedModel(model.scene, replace(model.rom, missed=None, family=replace(family, members=members)))
    found, worse, reference = motion(model), motion(bare), motion(full_model(model.scene))
    lanes = of_samples(model, ["rod_length"])
    batch = lanes.batch({name: np.full(2, value) for name, value in model.scene.values.items()}, 2)
    ended = lanes.outputs.evaluate(lanes.observed(batch, integrate(batch, model.scene.simulation).state))
    for name, exact in reference.outputs.items():
        largest = np.max(np.abs(exact))
        assert np.max(np.abs(found.outputs[name] - exact)) < TARGET * largest, name
        assert np.max(np.abs(ended[name] - exact[-1])) < TARGET * largest, name
    for name in ("crank_force", "crank_shear", "rod_force"):
        exact = reference.outputs[name]
        assert np.max(np.abs(worse.outputs[name] - exact)) > 3.0 * np.max(np.abs(found.outputs[name] - exact)), name


def test_forces_at_other_lengths_where_loads_depend_on_each_other() -> None:
    """Weight and tool of an arm: polynomials of what such loads answer made stresses of single runs with another tool
    78 % too large, those of lanes not."""
    own = "parameters.L={nominal=0.6,bounds=[0.56,0.64],distribution={name='uniform',loc=0.56,scale=0.08}}"
    entries = (
        "bodies.arm.line.length='L'",
        own,
        'effects.weight={type="gravity"}',
        asked("worst", "stress_max", "", "arm"),
    )
    few = "reduction.length_points=3", "reduction.angles=12"
    model = reduced_model(load_scene(ROOT / "scenes" / "servo_arm.toml", (*entries, *few)))
    lanes, values, rng = (
        of_samples(model, ["L"]),
        model.scene.nominal | {"L": 0.57, "tool": 0.25},
        np.random.default_rng(4),
    )
    alone, n = model.at_lengths(model.scene.with_values(values)), 50
    states = State(
        *(size * rng.normal(size=(n, model.terms.scale.size)) / model.terms.scale for size in (0.01, 0.1, 1.0)), ()
    )
    every = {name: np.full(n, value) for name, value in values.items()}
    one, other = (of.outputs.evaluate(of.observed_of(0.0, states, every))["worst"] for of in (alone, lanes))
    np.testing.assert_allclose(one, other, rtol=0, atol=1e-3 * other.max())  # of three lengths


def test_what_is_left_at_the_nominal_parameters_is_interpolation_over_the_angles() -> None:
    """Axial forces are 2.9 and 1.7 % of their largest values off with 48 angles, 0.38 and 0.14 % with 96: a build
    takes as many as bring them below a percent by its own estimate, and says where it may not."""
    late = "effects.motor.table=[[0.0, 0.0], [0.25, 0.5], [1.0, 0.5]]"
    changed = (*FORCES[:2], late, "effects.weight.acceleration=1e-9", "simulation.duration=0.25")
    coarse, fine = (reduced_model(numbered(0.7, *changed, f"reduction.max_angles={n}")) for n in (48, 96))
    free = reduced_model(numbered(0.7, *changed))
    reference = motion(full_model(coarse.scene)).outputs
    for name in ("rod_force", "crank_force"):
        largest = np.max(np.abs(reference[name]))
        left = [np.max(np.abs(motion(one).outputs[name] - reference[name])) / largest for one in (coarse, fine, free)]
        assert left[0] > TARGET > 1.6 * left[1] and left[1] < left[0] / 5.0, name
        assert left[2] < 0.1 * TARGET, name
    assert [one.rom.tables.samples.n for one in (coarse, fine, free)] == [48, 96, 192]
    said = [[remark.text for remark in one.rom.record.remarks] for one in (coarse, fine, free)]
    assert "rod_force 6.99 %, crank_force 5.91 %; raise reduction.max_angles (48)" in said[0][0]
    assert said[2] == [
        "reduction.angles: 192 in place of 48, as stress outputs change quickly between them: rod_force, crank_force"
    ]


def test_nothing_is_missed_at_the_nominal_parameters() -> None:
    """There the basis holds the answers to its own loads, whatever the state."""
    model = mechanism()
    bare, rng = without_answers(model), np.random.default_rng(7)
    eta = np.hstack([rng.uniform(0.0, 6.28, (20, 1)), 1e-3 * rng.standard_normal((20, model.terms.tables.n_modes))])
    both = [one.stresses.of(eta, model.scene.values) for one in (model, bare)]
    np.testing.assert_allclose(*both, rtol=0.0, atol=1e-9 * np.max(np.abs(both[1])))  # of sums of large parts


@pytest.mark.parametrize("element", ["beam2d", "beam3d"])
def test_a_force_across_and_along_is_that_of_statics(element: str) -> None:
    """One load pulls and bends, so that one vector has both: of a thicker bar it is another one."""
    shear = "shear_force" if element == "beam2d" else "shear_force_2"
    place = "at=[0.3,0.0,0.0]" if element == "beam3d" else "at=[0.3,0.0]"
    scene = held(
        element, 'bodies.bar.section={shape="circle", radius="r"}',
        'parameters.r={nominal=0.01, value=0.013, distribution={name="norm", loc=0.01, scale=0.001}}',
        asked("pulled", "axial_force", place), asked("sheared", shear, place), direction=(0.6, -0.8),
    )  # fmt: skip
    found = motion("reduced", scene, {"bar": straight_beam(1.0, 10, dimension=int(element[4]))})
    assert found.outputs["pulled"][0] == pytest.approx(60.0, rel=1e-6)
    assert abs(found.outputs["sheared"][0]) == pytest.approx(80.0, rel=1e-6)


def test_derivatives_are_those_of_full_order_runs_and_say_where_they_are_not() -> None:
    model = mechanism()
    step = 0.02 * DEVIATION
    ends = [motion(full_model(mechanism(f"r1={NOMINAL + move}").scene)).outputs for move in (-step, step)]
    found, worse = (sensitivities(one, ["r1"], MPI.COMM_SELF) for one in (model, without_answers(model)))
    for name in ("rod_force", "crank_force"):  # shear in the crank hardly depends on its radius
        exact = (ends[1][name][-1] - ends[0][name][-1]) / (2.0 * step)
        assert found.derivatives[name]["r1"][-1] == pytest.approx(exact, rel=0.1), name
        assert abs(worse.derivatives[name]["r1"][-1] / exact - 1.0) > 0.15, name
    (said,) = (remark.text for remark in worse.record.remarks if "own error is a good part" in remark.text)
    assert "d rod_force / d r1 at the end" in said and "reduction.tolerance" in said


def test_statistics_say_where_they_are_the_models_error() -> None:
    with RankGroup.split(MPI.COMM_SELF, 1) as group:
        model = reduced_model(load_scene(SCENE, (*FORCES, "ensemble.checked_share=0.02"), ()))  # 20 of these
        found, worse = (run_ensemble(one, Plan(60, 1), group) for one in (model, without_answers(model)))
    said = [[r.text for r in one.record.remarks if "own error is a good part" in r.text] for one in (found, worse)]
    assert "deviation, quantiles of rod_force: " in said[1][0] and "checked samples have a deviation of" in said[1][0]
    assert not any("rod_force" in text for text in said[0])


def test_a_search_stays_where_the_model_serves_and_says_so() -> None:
    model = mechanism()
    goal = read_goal("minimise max(abs(rod_force))", list(model.outputs.functions), ["r1"])
    design = optimize(model, Question(goal, (), ("r1",)), MPI.COMM_SELF)
    served = model.served["r1"]
    assert served.low <= design.parameters[0].value <= served.high
    assert (design.parameters[0].lower, design.parameters[0].upper) == (served.low, served.high)
    (said,) = (remark.text for remark in design.record.remarks if "r1 is searched in" in remark.text)
    assert "not in all of its bounds [0.001, 0.012]" in said and "pgmp build SCENE" in said


def test_the_answers_are_kept_with_the_model_and_count_for_its_identity(tmp_path) -> None:
    rom = rom_of(load_scene(SCENE, FORCES))
    rom.write(tmp_path / "rom.h5")
    again = type(rom).read(tmp_path / "rom.h5")
    np.testing.assert_array_equal(again.missed.answers, rom.missed.answers)
    assert again.identity == rom.identity != replace(rom, missed=None).identity
    assert rom_of(load_scene(SCENE, ())).missed is None  # nobody asked for forces
    with resealed(tmp_path / "rom.h5") as file:
        answers = file["missed/answers"][:, :-1]
        del file["missed/answers"]
        file["missed/answers"] = answers
    with pytest.raises(InputError, match="missed/answers has shape .*; build it again"):
        type(rom).read(tmp_path / "rom.h5")


def test_a_rare_event_says_what_the_models_error_does_to_it() -> None:
    event = Event(output="rod_force", when="end", above=8.0)
    found, worse = (
        run_rare_event(one, event, 1000, 1, MPI.COMM_SELF) for one in (mechanism(), without_answers(mechanism()))
    )
    said = [[r.text for r in one.record.remarks if "of the probability" in r.text or "own error" in r.text]
            for one in (found, worse)]  # fmt: skip
    assert said[0][0].startswith("errors of the reduced model are estimated at up to ")
    assert said[1][0].startswith("the reduced model's own error is a good part of the probability: ")
    without = float(said[1][0].split("about ")[1].split()[0])
    # measured 0.02 to 0.12 with four seeds; samples of both are off by 4 % each
    assert abs(np.log(without / found.estimate)) < 0.25 * abs(np.log(worse.estimate / found.estimate))
