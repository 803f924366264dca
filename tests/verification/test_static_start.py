"""Runs that start from static equilibrium, against closed forms, between the models, and over time."""

from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
import spatial
from combinations import without_effects
from refusals import assert_refused
from runs import ONE_RANK, full_model, motion, reduced_model, rom_of, samples, trajectory
from two_coordinates import DOUBLE_PENDULUM

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.ensemble.integration import run_ensemble
from pgmp_petsc.ensemble.plan import Plan
from pgmp_petsc.models import FullModel, ReducedModel, reduced_statics
from pgmp_petsc.scene import Scene, scene_from_toml, scene_to_toml
from pgmp_petsc.stepping.generalised_alpha import integrate
from pgmp_petsc.stepping.static_equilibrium import Search, settle
from pgmp_petsc.stepping.status import Status
from scenes import PENDULUM, RADIUS, SLIDER_CRANK, STEEL, tables

BAR = PENDULUM.replace("radius = 2e-4", "radius = 5e-3").replace(
    "modes = 2\nangles = 6", 'modes = 5\nangles = 24\nstatic_modes = true\ninterpolation = "spectral"'
)
GRAVITY = '\n[effects.weight]\ntype = "gravity"\n'
RUN = "\n[simulation]\nduration = 0.1\nstep = 1e-3\nspectral_radius = 0.99\n"
LINK = SLIDER_CRANK.replace('"0.3:1.0:5"', '"0.3:1.0:16"').replace("angles = 24", "angles = 24\nstatic_modes = true")
LINK = LINK[: LINK.index("[effects.motor]")] + LINK[LINK.index("[reduction]") :]
HINGED = '\n[effects.spring]\ntype = "spring_damper"\njoint = "hinge"\nstiffness = 4.0\ndamping = 0.1\nrest = 0.3\n'


def scene_of(text: str, coordinates: str | None, start: float = 0.0, more: str = "") -> Scene:
    name = "theta" if "coordinates.theta" in text else "phi"
    initial = "" if coordinates is None else f'\n[initial]\nequilibrium = true\ncoordinates = "{coordinates}"\n'
    text += GRAVITY + more + initial + RUN + f"[simulation.initial.{name}]\nposition = {start}\n"
    return scene_from_toml(text, ".")


def reduced_of(scene: Scene) -> ReducedModel:
    """Return the reduced model; one for all starts of a mechanism."""
    held = scene.model_copy(update={"initial": scene_of(BAR, "held").initial})
    return ReducedModel(scene, rom_of(held))


def settled_frames(model: FullModel | ReducedModel) -> np.ndarray:
    """Return the frames of all nodes at the start, shape (n_nodes, 3)."""
    system = model.batch(samples(model.scene, 1), 1)
    state = system.start()
    return (model.frames_of(state.q) if isinstance(model, ReducedModel) else system.frames(state))[..., 0]


def both(scene: Scene) -> list[FullModel | ReducedModel]:
    return [full_model(scene), reduced_of(scene)]


def test_a_held_bar_bends_under_its_weight_as_a_cantilever_does() -> None:
    line_load = STEEL["rho"] * np.pi * 5e-3**2 * 9.80665
    stiffness = STEEL["E"] * np.pi * 5e-3**4 / 4
    for model in both(scene_of(BAR, "held")):
        frames = settled_frames(model)
        # 1e-4: shear makes it longer by 2e-4 of (r / L)^2; large deflections shorter by the square of 0.7 %
        np.testing.assert_allclose(frames[-1, 1], -line_load / (8 * stiffness), rtol=1e-4)
        np.testing.assert_allclose(frames[0, 2], 0.0, atol=1e-11)


def test_a_link_between_two_hinges_bends_as_a_beam_on_two_supports() -> None:
    length, area = 0.7, np.pi * RADIUS**2
    line_load, stiffness = STEEL["rho"] * area * 9.80665, STEEL["E"] * np.pi * RADIUS**4 / 4
    sag = 5 * line_load * length**4 / (384 * stiffness)
    text = LINK.replace(":16", ":64")
    for model in both(scene_of(text, "held")):
        rod = settled_frames(model)[-65:, 1]
        # elements: 1.5 / n^2 = 4e-4 (n = 16: 6e-3); shear: 10 EI / (k_s G A L^2) = 4e-4 to the other side
        np.testing.assert_allclose(0.5 * (rod[0] + rod[-1]) - rod[32], sag, rtol=1e-3)


@pytest.mark.parametrize("start", [0.3, 3.0])
def test_a_free_pendulum_hangs_straight_down_and_stays_there(start: float) -> None:
    for model in both(scene_of(BAR, "free", start)):
        system = model.batch({}, 1)
        down = system.settled.theta[0, 0] + np.pi / 2
        np.testing.assert_allclose(down, 2 * np.pi * np.rint(down / (2 * np.pi)), atol=1e-10)
        assert not system.settled.unstable[0]
        run = integrate(system, model.scene.simulation)
        # what is left of round-off of the forces: nothing rings (held at 0 rad, it falls at 1 m/s by then)
        assert run.status[0] == Status.FINE
        assert np.max(np.abs(run.state.v)) < 1e-8
        assert np.max(np.abs(run.state.q - system.start().q)) < 1e-10


def test_a_pendulum_on_its_head_is_said_to_be_unstable() -> None:
    for model in both(scene_of(BAR, "free", np.pi / 2)):
        assert model.batch({}, 1).settled.unstable[0]
    trajectory = motion(reduced_of(scene_of(BAR, "free", np.pi / 2)))
    assert [r.kind for r in trajectory.record.remarks if "unstable" in r.text] == ["warning"]


def test_a_spring_holds_free_coordinates_where_its_torque_balances_the_weight() -> None:
    scene = scene_of(BAR, "free", 0.2, HINGED)
    mass = STEEL["rho"] * np.pi * 5e-3**2
    theta = 0.0
    for _ in range(50):  # of the rigid bar: 4 (theta - 0.3) = - m g L / 2 cos(theta)
        theta -= (4 * (theta - 0.3) + 0.5 * mass * 9.80665 * np.cos(theta)) / (4 - 0.5 * mass * 9.80665 * np.sin(theta))
    full, reduced = (model.batch({}, 1).settled.theta[0, 0] for model in both(scene))
    # the bar bends by 0.7 % of its length: the weight's arm changes by its square and by the turn of the load
    assert abs(full - theta) < 2e-3
    # that of the hinge, as runs say it; the reduced coordinate is the mean turn of the bar, up to 2e-2 away
    np.testing.assert_allclose(reduced, full, atol=2e-4)
    np.testing.assert_allclose(settled_frames(reduced_of(scene))[0, 2], reduced, rtol=0, atol=1e-12)


def test_reduced_and_full_deformation_agree_anywhere() -> None:
    for start in (0.7, 2.0, 4.4):
        full, reduced = (settled_frames(model) for model in both(scene_of(LINK, "held", start)))
        undeformed = scene_of(LINK, None, start)
        bent = np.max(np.abs(full - settled_frames(full_model(undeformed))))
        assert np.max(np.abs(full - reduced)) < 0.02 * bent


@pytest.mark.filterwarnings("error")
def test_samples_settle_each_for_itself() -> None:
    scene = scene_of(LINK, "held", 0.4)
    radii = np.array([4e-3, 5.6e-3, 7e-3, 7e-3])
    for model in both(scene):
        together = model.batch({"r1": radii}, 4)
        for k, radius in enumerate(radii):
            alone = model.batch({"r1": np.array([radius])}, 1)
            np.testing.assert_array_equal(together.settled.unknowns[:, k], alone.settled.unknowns[:, 0])


class Fragile:
    """Statics of a joint that `tanh(20 (theta - middle))` pulls back; bodies bear no more than theta = `most`."""

    n_samples = 2

    def __init__(self, middle: list[float], most: float) -> None:
        self.middle, self.most = np.array(middle)[:, None], most

    def hold(self, theta: np.ndarray, samples: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        self.theta = theta.copy()
        return -np.tanh(20.0 * (theta - self.middle)), samples & (theta[:, 0] > self.most)

    def cause(self, sample: int) -> str:
        return "too far"

    def unknowns(self) -> np.ndarray:
        return self.theta.T

    def inertia(self) -> np.ndarray:
        return np.ones((2, 1))


@pytest.mark.parametrize(
    ("statics", "start", "most", "reason"),
    [
        (Fragile([0.1, 0.1], 0.15), 0.2, 1.0, "too far"),
        (Fragile([0.1, 0.3], 9.0), 0.0, 0.15, "no static equilibrium within coordinates.phi.range; at phi = 0.15"),
    ],
)
def test_a_step_beyond_what_bodies_bear_or_the_range_is_taken_in_parts(statics, start, most, reason) -> None:
    coordinates = full_model(scene_of(BAR, "free")).kinematics.mechanism.coordinates
    search = Search((0,), coordinates, np.array([-1.0]), np.array([most]), 1.0, 1.0)
    settled = settle(statics, np.array([[0.0], [start]]), search)
    assert abs(settled.theta[0, 0] - 0.1) < 1e-9
    assert set(settled.reasons) == {1} and reason in settled.reasons[1]


def test_energy_is_kept_from_the_strain_at_the_start_on() -> None:
    scene = scene_of(LINK, "held", 0.4)
    full, reduced = both(scene)
    found = motion(full).balance, motion(reduced).balance
    for balance in found:
        assert balance.strain[0] > 0.0 and balance.kinetic[0] == 0.0
        total = balance.kinetic + balance.strain + balance.potential
        # trapezoidal rule over a step of 1 ms while the bent crank, let go, swings back
        assert np.max(np.abs(total - total[0])) < 2e-2 * np.ptp(balance.potential)
    np.testing.assert_allclose(found[1].strain[0], found[0].strain[0], rtol=0.02)


def test_a_torque_that_nothing_holds_is_refused_with_what_it_leaves() -> None:
    motor = '\n[effects.motor]\ntype = "torque"\njoint = "hinge"\ntable = [[0.0, 50.0], [1.0, 50.0]]\n'
    scene = scene_of(BAR, "free", 0.0, motor)
    assert_refused(r'initial.coordinates = "free".*no static equilibrium.*N m on phi.*"held"', motion, "full", scene)
    model = reduced_of(scene)
    assert_refused('take coordinates = "held"', motion, model)
    run = integrate(model.batch({}, 2), scene.simulation)
    assert (run.status == Status.NO_EQUILIBRIUM).all() and (run.failure_time == 0.0).all()
    narrow = BAR.replace("range = [0.0, 6.283185307179586]\nperiodic = true", "range = [-1.0, 1.0]")
    out = r"equilibrium within coordinates\.phi\.range; at phi = -1.* rad .* on phi\. Widen coordinates\.phi\.range, "
    assert_refused(out, motion, "full", scene_of(narrow, "free"))


@pytest.mark.parametrize(("entry", "message"), [
    ('[initial]\ncoordinates = "free"\n', "initial.coordinates.*equilibrium = true"),
    ("[initial]\nequilibrium = 1\n", "initial.equilibrium"),
    ('[initial]\nequilibrium = true\ncoordinates = "loose"\n', "initial.coordinates.*held.*free"),
    ("[initial]\nequilibrum = true\n", "initial.equilibrum.*equilibrium"),
    ("[initial]\nequilibrium = true\n[simulation.initial.phi]\nvelocity = 3.0\n", "phi.velocity.*starts at rest"),
])  # fmt: skip
def test_entries_of_initial_are_checked(entry: str, message: str) -> None:
    assert_refused(message, scene_from_toml, BAR + entry, ".")


def test_a_prescribed_motion_holds_its_coordinate_only_if_it_begins_at_rest() -> None:
    motion = '\n[effects.drive]\ntype = "prescribed_motion"\ncoordinate = "phi"\n'
    text = BAR + GRAVITY + RUN + "[initial]\nequilibrium = true\n" + motion
    moving = scene_from_toml(text + "constant_speed = { speed = 2.0 }\n", ".")
    assert_refused("effects.drive: it moves phi at 2 rad/s at time zero", full_model, moving)
    resting = scene_from_toml(text + "spin_up = { speed = 2.0, time = 0.1, start = 0.5 }\n", ".")
    system = full_model(resting).batch({}, 1)
    np.testing.assert_allclose(system.settled.theta, 0.5)


def test_no_loads_leave_the_mechanism_where_it_is() -> None:
    text = BAR + RUN + '[initial]\nequilibrium = true\ncoordinates = "free"\n[simulation.initial.phi]\nposition = 0.7\n'
    system = full_model(scene_from_toml(text, ".")).batch({}, 1)
    np.testing.assert_allclose(system.settled.theta, 0.7)
    assert not system.settled.reasons and not system.settled.unstable[0]


def errors_at_the_start(text: str, coordinates: str, start: float, *overrides: str) -> tuple[dict, dict]:
    """Return estimated and true errors of outputs at time zero."""
    scene = scene_from_toml(scene_to_toml(scene_of(text, coordinates, start)), ".", (SHORT, *overrides))
    run, full = trajectory("reduced", scene), motion("full", scene)
    true = {name: values[0] - full.outputs[name][0] for name, values in run.outputs.items()}
    assert run.errors is not None, run.record.remarks
    if coordinates == "free":  # nothing moves, so what is off at the start stays off by as much
        for name, error in true.items():
            np.testing.assert_allclose(run.errors.outputs[name], error, rtol=1e-3, atol=1e-12)
    return {name: values[0] for name, values in run.errors.outputs.items()}, true


SHORT = "simulation.duration=0.005"
TIP = 'outputs.height={type="position", point="%s:tip", axis="y"}'


@pytest.mark.parametrize(
    ("text", "coordinates", "start", "overrides", "least"),
    [
        # two modes answer the weight poorly: the crank hangs 5e-6 rad beside where it would
        (LINK, "free", 0.4, ("reduction.modes=2", "reduction.static_modes=false",
                             'outputs.angle={type="angle", joint="crank_hinge"}'), 1e-6),
        # the cubic strain energy of dynamic stretching lacks what bounds it: 3 % of a sag of 7 mm
        (BAR, "held", 0.0, ("reduction.second_order=true", 'reduction.stretching="dynamic"', TIP % "arm"), 1e-4),
    ],
)  # fmt: skip
def test_the_estimate_knows_how_far_the_start_is_off(text, coordinates, start, overrides, least) -> None:
    estimated, true = errors_at_the_start(text, coordinates, start, *overrides)
    assert max(abs(error) for error in true.values()) > least
    for name, error in true.items():
        np.testing.assert_allclose(estimated[name], error, rtol=1e-3)


def test_two_free_coordinates_hang_straight_down() -> None:
    text = without_effects(DOUBLE_PENDULUM) + GRAVITY + RUN + '[initial]\nequilibrium = true\ncoordinates = "free"\n'
    start = ("simulation.initial.theta1.position=0.4", "simulation.initial.theta2.position=1.1")
    scene = scene_from_toml(text, ".", (*start, "reduction.static_modes=true", "reduction.angles=8"))
    for model in (full_model(scene), reduced_model(scene)):
        settled = model.batch({}, 1).settled
        assert not settled.reasons and not settled.unstable[0]
        turns = (settled.theta[0] - [-np.pi / 2, 0.0]) / (2 * np.pi)
        np.testing.assert_allclose(turns, np.rint(turns), atol=1e-9)


DRIVEN = (
    '\n[parameters.T]\nnominal = 1.0\ndistribution = { name = "uniform", loc = 0.0, scale = 2.0 }\n'
    '[effects.winch]\ntype = "torque"\njoint = "hinge"\ntable = [[0.0, 3.0], [1.0, 3.0]]\nscale = "T"\n'
)


@pytest.mark.parametrize("name", ["reduced", "full"])
def test_samples_without_equilibrium_are_records_and_are_not_tried_again(name: str, tmp_path: Path) -> None:
    """A torque holds a pendulum at an angle in some samples, and drives it round in the others."""
    scene = scene_of(BAR, "free", 0.0, DRIVEN)
    scene = scene.model_copy(update={"simulation": scene.simulation.model_copy(update={"duration": 0.01})})
    model = full_model(scene) if name == "full" else reduced_of(scene)
    ensemble = run_ensemble(model, Plan(4, 2, tmp_path / "e.h5", False), ONE_RANK)
    # 3 N m times T against the weight's m g L / 2, the arm a little shorter as it bends
    largest = 0.5 * STEEL["rho"] * np.pi * 5e-3**2 * 9.80665 / 3.0
    held = ensemble.parameters["T"] < largest
    assert 0 < held.sum() < 4 and np.min(np.abs(ensemble.parameters["T"] - largest)) > 1e-2
    np.testing.assert_array_equal(ensemble.status, np.where(held, Status.FINE, Status.NO_EQUILIBRIUM))
    np.testing.assert_array_equal(ensemble.steps_divided, 1)
    np.testing.assert_array_equal(ensemble.failure_time[~held], 0.0)
    assert any("no static equilibrium was found to start from" in remark.text for remark in ensemble.record.remarks)


def test_an_ensemble_says_how_many_starts_are_unstable(tmp_path: Path) -> None:
    scene = scene_of(BAR, "free", np.pi / 2, DRIVEN)
    motor = scene.effects["winch"].model_copy(update={"scale": 0.0})
    short = scene.simulation.model_copy(update={"duration": 2e-3})
    scene = scene.model_copy(update={"effects": scene.effects | {"winch": motor}, "simulation": short})
    ensemble = run_ensemble(full_model(scene), Plan(2, 2, tmp_path / "e.h5", False), ONE_RANK)
    texts = [remark.text for remark in ensemble.record.remarks if remark.kind == "warning"]
    assert any("the static equilibrium of 2 of 2 samples is unstable" in text for text in texts)


@pytest.mark.parametrize("coordinates", ["held", "free"])
def test_reduced_and_full_deformation_agree_in_space(coordinates: str) -> None:
    """Hanging free, the crank is stretched by 5e-8 m only, and what a linear deformation leaves out is 2 % of that."""
    entries = ('effects.weight={type="gravity", direction=[0.0, -1.0, 0.0]}', "reduction.static_modes=true",
               "reduction.modes=6", "reduction.angles=24", "simulation.duration=0.002", "simulation.step=1e-3",
               "simulation.initial.theta.position=0.5", TIP % "crank",
               'outputs.sag={type="deformation", point="crank:tip", axis="y"}')  # fmt: skip
    settled = ("initial.equilibrium=true", f'initial.coordinates="{coordinates}"')
    scene = scene_from_toml(spatial.SLIDER_CRANK, ".", (*entries, *settled))
    found = []
    for model in (full_model(scene), reduced_model(scene)):
        with closing(model.batch({}, 1)) as system:
            start = system.start()
            outputs = model.outputs.evaluate(model.observed(system, start))
            found.append((outputs["height"][0], outputs["sag"][0]))
    full, reduced = found
    assert full[1] != 0.0
    lengthened = 0.3 * (1.0 - np.cos(start.q[0, 0] - system.settled.theta[0, 0]))  # rigid and measured coordinate
    np.testing.assert_allclose(reduced[1] + lengthened, full[1], rtol=2e-3)
    np.testing.assert_allclose(reduced[0], full[0], atol=0.02 * abs(full[1]) + lengthened)


# light and soft: the deflection at the start changes by how much the modes turn the crank's joint
SOFT_FOUR_BAR = tables("""
scene: name = "soft_four_bar"
ground.points: d = [0.55, 0.0]
bodies.crank: line = { length = 0.2, elements = 4 }; element = "beam2d"
bodies.crank.section: shape = "coefficients"; axial = 2e6; shear = 8e5; bending = 40.0; line_density = 0.5;
    rotary_density = 1e-5
bodies.coupler: line = { length = 0.6, elements = 12 }; element = "beam2d";
    placement = { origin = [0.2, 0.0], angle = 0.84 }
bodies.coupler.section: shape = "coefficients"; axial = 1e6; shear = 4e5; bending = 6.0; line_density = 0.3;
    rotary_density = 6e-6
bodies.rocker: line = { length = 0.45, elements = 8 }; element = "beam2d";
    placement = { origin = [0.55, 0.0], angle = 1.46 }
bodies.rocker.section: shape = "coefficients"; axial = 2e6; shear = 8e5; bending = 30.0; line_density = 0.4;
    rotary_density = 1e-5
joints.crank_joint: type = "revolute"; connect = ["ground:origin", "crank:hinge"]
joints.elbow: type = "revolute"; connect = ["crank:tip", "coupler:hinge"]
joints.knee: type = "revolute"; connect = ["coupler:tip", "rocker:tip"]
joints.pivot: type = "revolute"; connect = ["ground:d", "rocker:hinge"]
coordinates.q: joint = "crank_joint"; range = [0.0, 6.283185307179586]; periodic = true
effects.load: type = "point_mass"; point = "coupler:middle"; mass = 0.3; inertia = 1e-7
effects.spring: type = "spring_damper"; points = ["coupler:middle", "ground:d"]; stiffness = 10.0; damping = 0.1;
    rest = 0.4
effects.weight: type = "gravity"
initial: equilibrium = true
reduction: modes = 6; static_modes = true; angles = 96; interpolation = "spline"
simulation: duration = 0.1
outputs.bent: type = "deformation"; point = "coupler:middle"; axis = "y"
""")


def soft_four_bar(start: float, *overrides: str) -> Scene:
    return scene_from_toml(SOFT_FOUR_BAR, ".", (f"simulation.initial.q.position={start}", *overrides))


def test_a_reduced_start_is_found_as_far_as_the_full_order_one() -> None:
    for start in (0.4, 2.0, 4.0):
        scene = soft_four_bar(start, "effects.weight.acceleration=300.0")
        for model in (reduced_model, full_model):
            model(scene).batch({}, 1).require_settled()


@pytest.mark.parametrize("start", [0.4, 3.0, 4.0])
def test_a_held_joint_is_found_where_modes_turn_it_by_more_under_the_loads(start: float) -> None:
    """Differences of the equations were taken with the slopes of the step before: 0.4, 3 and 4 rad were refused."""
    scene = soft_four_bar(start)
    reduced, full = reduced_model(scene), full_model(scene)
    frames = [settled_frames(model) for model in (reduced, full)]
    np.testing.assert_allclose(frames[0][0, 2], start, rtol=0, atol=1e-9)
    # the largest static deflection is 2 mm; what is of second order in it is left out of the reduced model
    np.testing.assert_allclose(frames[0][:, :2], frames[1][:, :2], rtol=0, atol=1e-4)


def test_a_start_that_is_not_found_says_why(monkeypatch) -> None:
    for model, weight, reached in ((full_model, "1e4", "[0-9.]+ % of"), (reduced_model, "3e5", "less than 1/64 of")):
        scene = soft_four_bar(0.4, f"effects.weight.acceleration={weight}")
        with pytest.raises(InputError, match=rf"converges with {reached} the loads and springs at time zero, and not"):
            model(scene).batch({}, 1).require_settled()
    monkeypatch.setattr(reduced_statics, "MAX_STEPS", 0)
    with pytest.raises(InputError, match=r"no rigid coordinates with which the joints stand there: [0-9.e-]+ rad rem"):
        reduced_model(soft_four_bar(0.4)).batch({}, 1).require_settled()
