"""Elastic joints against closed forms, an own beam code, and their rigid limit."""

import exported
import numpy as np
import pytest
from alike import assert_alike, balances, residuals
from differences import compare
from elastic_scenes import (
    BEARINGS,
    DISCS,
    N_ELEMENTS,
    SHAFT,
    SIDE,
    boom,
    machine,
    machine_in_space,
    rigid_frame,
    rotor,
    tube,
    vibrations,
)
from machine_scenes import MODELS, errors_of, run
from mpi4py import MPI
from runs import assert_close, history, motion, reduced_model, rom_of, samples, trajectory
from scipy.integrate import solve_ivp
from scipy.linalg import eigh

from pgmp_petsc.api.sources import scene_of_built
from pgmp_petsc.base.errors import InputError
from pgmp_petsc.c_export.constants import started
from pgmp_petsc.models import ReducedModel
from pgmp_petsc.ranks.groups import RankGroup
from pgmp_petsc.scene import Scene
from pgmp_petsc.studies.building import build, choose_effects, estimate_effects
from pgmp_petsc.studies.check import describe_scene
from pgmp_petsc.studies.modes_table import reduced_vibrations, springs_of
from scenes import STEEL, kinematics_of, meshes_of

GRAVITY = 9.80665


@pytest.mark.parametrize("model", ["full", "components"])
def test_a_rigid_frame_sinks_onto_its_mounts(model):
    """The step's error falls as its square: 0.5 s in steps of 2, 1 and 0.5 ms, against a solution of the linearised
    equations by hand; tilting, the frame's own motion is of second order, 1e-6 of its size."""
    m, inertia, k, c = 12.0, 1.5, 4e4, (90.0, 30.0)

    def rates(_, state):
        y, tilt, vy, spin = state
        ends = [-k * (y + s * tilt) - c_end * (vy + s * spin) for s, c_end in zip((-0.5, 0.5), c)]
        return [vy, spin, sum(ends) / m - GRAVITY, 0.5 * (ends[1] - ends[0]) / inertia]

    def exact(time):
        y, tilt, *_ = solve_ivp(rates, (0.0, time[-1]), np.zeros(4), "DOP853", time, rtol=1e-10, atol=1e-14).y
        assert np.max(np.abs(y)) > 2e-3  # the mean of both mounts sinks by twice m g / 2 k
        return {"left": y - 0.5 * tilt, "x": 0.0}

    errors, along = errors_of(rigid_frame, model, exact, 2e-3, 1e-3, 5e-4).T
    assert 3.5 < errors[0] / errors[1] < 4.5 and 3.0 < errors[1] / errors[2] < 4.5
    assert errors[2] < 2e-5 * 2e-3 * 50
    assert along[2] < 1e-5  # the mounts along x are level with the centre


def _plane_of_rotor(stiffness: tuple[float, float]) -> np.ndarray:
    """Return the frequencies (Hz) of the shaft in one plane: Timoshenko elements of two nodes, one-point quadrature."""
    n, length, area, bending = N_ELEMENTS + 1, SHAFT / N_ELEMENTS, SIDE**2, SIDE**4 / 12.0
    shear = 10 * 1.3 / (12 + 11 * 0.3) * STEEL["E"] / 2.6 * area
    k, m = np.zeros((2, 2 * n, 2 * n))
    for e in range(N_ELEMENTS):
        own = np.arange(2 * e, 2 * e + 4)
        b = np.array([-1.0 / length, -0.5, 1.0 / length, -0.5])  # gamma of (w, phi) at both nodes
        kappa = np.array([0.0, -1.0, 0.0, 1.0]) / length
        k[np.ix_(own, own)] += length * (shear * np.outer(b, b) + STEEL["E"] * bending * np.outer(kappa, kappa))
        pair = np.array([[2.0, 1.0], [1.0, 2.0]]) * STEEL["rho"] * length / 6.0
        m[np.ix_(own[::2], own[::2])] += area * pair
        m[np.ix_(own[1::2], own[1::2])] += bending * pair
    for node, mass in DISCS.items():
        m[2 * int(node), 2 * int(node)] += mass
    for end, spring in zip((0, 2 * n - 2), stiffness):
        k[end, end] += spring
    return np.sqrt(eigh(k, m, eigvals_only=True)) / (2 * np.pi)


def test_a_rotor_at_rest_has_the_frequencies_of_another_code():
    """Six figures: both have the same elements, and round-off of stiff directions is left. The spin is free."""
    planes = [_plane_of_rotor(tuple(end[k] for end in BEARINGS)) for k in range(2)]
    expected = np.sort(np.concatenate(planes))[:6]
    assert vibrations(rotor()) == pytest.approx(expected, rel=1e-6)


def _on_mounts(k: str) -> Scene:
    """Return the machine with a stiffness of both mounts, N/m."""
    elastic = f"{{reference=[[1.0,0.0]],stiffness=[{k},{k}],turning_stiffness=[0.0]}}"
    return machine(*(f"joints.{name}.elastic={elastic}" for name in ("one", "two")))


def test_stiffness_to_infinity_gives_the_rigid_joint():
    """The difference falls as 1 / k, until it is the round-off of the stiff springs."""
    rigid, differences = vibrations(_on_mounts("inf")), []
    for k in ("1e10", "1e11", "1e12"):
        differences.append(np.abs(vibrations(_on_mounts(k))[:3] - rigid[:3]))
    ratios = np.array(differences[:-1]) / differences[1:]
    assert ratios == pytest.approx(10.0, rel=0.15)


def test_soft_mounts_do_not_change_the_count_of_coordinates():
    scene = machine()
    kinematics = kinematics_of(scene)
    assert kinematics.n_coordinates == 1
    motion = kinematics.motion(np.array([0.3]))
    assert motion.released.shape[-1] == 3  # of six directions of two mounts


REDUCED = ("reduction.modes=5", "reduction.static_modes=true", "simulation.step=1e-4", "simulation.duration=0.3")


@pytest.mark.parametrize("k", [5e5, 1e7])
def test_reduced_and_component_runs_are_those_of_full_order(k) -> None:
    """Of the largest deformation 1 %; the stiffness of the mounts, built with 2 N/um, is no part of the tables."""
    scene = machine(*REDUCED)
    full, reduced, components = (run(scene, model, k=k)[1] for model in IN_ORDER)
    assert_close(full, reduced, lift=0.01, bent=0.01, theta=1e-4)
    assert_close(full, components, lift=2e-3, bent=2e-3)


def test_reduced_frequencies_on_springs_are_those_of_the_mesh():
    """Support modes to round-off, as rigid motions and static answers to the springs are in the basis."""
    scene = machine(*REDUCED)
    rom = rom_of(scene)
    assert rom.tables.unstrained.size == 3
    kinematics = kinematics_of(scene)
    springs, _ = springs_of(scene, kinematics)
    theta = rom.tables.samples.theta[[3]]
    found = reduced_vibrations(rom, springs, scene.interpolation, scene.values, theta)
    assert found[0, :5] == pytest.approx(vibrations(scene, theta[0, 0])[:5], rel=1e-8)


DERIVED = ("parameters.k={nominal=2e6}", "simulation.step=5e-4", "simulation.duration=0.025", *REDUCED[:2])


def test_derivatives_by_stiffness_and_damping_are_central_differences():
    compare(reduced_model(machine(*DERIVED)))


MOVED = (
    *REDUCED[:2], "simulation={duration=0.02,step=2e-4,initial={theta={position=0.7}}}",
    "parameters.up={nominal=1e-3,unit='m'}", "parameters.aside={nominal=-5e-4,unit='m'}",
    "parameters.tilt={nominal=1e-3,unit='rad'}",
    "joints.one.offset={place=[2e-4,'up'],turn=['tilt']}", "joints.two.offset={place=['up','aside']}",
)  # fmt: skip
TURNED = (
    "joints.one.elastic={reference=[[1.0,1.0]],stiffness=[inf,'k'],turning_stiffness=[2e4]}",
    "joints.two.elastic={reference=[[1.0,1.0]],stiffness=[1e6,'k'],turning_stiffness=[inf]}",
    "joints.two.offset.turn=[1e-3]",
)  # fmt: skip
IN_ORDER = ("full", "reduced", "components")
SPUN = ("simulation.initial.theta.velocity=5.0",)


@pytest.mark.parametrize("more", [(), SPUN, (*TURNED, "reduction.second_order=true")])
def test_mounts_that_are_off_themselves(more) -> None:
    """Reduced against full-order runs, at other offsets and stiffness too; what is left halves to a quarter with the
    offset. The frame follows its mounts where these allow it, and oblique axes have sums of offsets."""
    scene, off = machine(*MOVED, *more, "effects={}"), []
    for share in (1.0, 0.5):
        values = {"up": 2e-3 * share, "aside": -1e-3 * share, "tilt": 2e-3 * share, "k": 3e6}
        if share < 1.0:
            halved = "joints.one.offset.place=[1e-4,'up']", *(["joints.two.offset.turn=[5e-4]"] * ("turn" in str(more)))
            scene = machine(*MOVED, *more, "effects={}", *halved)
        full, reduced, components = (run(scene, model, **values)[1] for model in IN_ORDER)
        assert_close(full, components, lift=2e-3, bent=2e-3)
        assert_close(full, reduced, lift=6e-3, bent=6e-3)  # of second order in 2 mm and 4 mrad
        off.append(np.array([abs(reduced[name][0] - full[name][0]) for name in ("lift", "bent")]))
    assert np.all((off[1] < 0.4 * off[0]) | (off[0] < 1e-9)), off


def test_a_frame_follows_its_mounts():
    """One is 1 mm up: its end is there, the middle half as far, whatever the springs, in every model."""
    scene = machine("joints.one.offset={place=[0.0,1e-3]}", "effects={}", *PLACED, "simulation.duration=2e-3")
    for name in MODELS:
        found = run(scene, name)[1]
        assert [found["left"][0], found["mid"][0]] == pytest.approx([1e-3, 5e-4], rel=1e-6), name


BUSHED = (
    "joints.one.elastic.stiffness=[0.0,0.0]", "joints.two.elastic.stiffness=[0.0,0.0]",
    "effects.left={type='bushing',points=['ground:left','frame:hinge'],reference=[[1.0,0.0]],stiffness=[1e6,4e4]}",
    "effects.right={type='bushing',points=['ground:right','frame:tip'],reference=[[1.0,0.0]],stiffness=[1e6,1e4]}",
)  # fmt: skip


@pytest.mark.parametrize("held", [(), BUSHED], ids=["by joints", "by bushings alone"])
def test_sizes_of_effects_have_what_joints_give_way(held):
    """The machine under its weight on soft mounts: their rotation at rest is that of the full-order run, whatever
    springs hold it. The choice of effects takes terms of second order for it."""
    sunk = *SUNK[machine], *AT_REST, "effects={weight={type='gravity'}}", *held
    scene = machine(*sunk, "outputs={turn={type='rotation',point='frame:middle'}}")
    turned = abs(run(scene, "full")[1]["turn"][0])
    found = {size.kind: size for size in estimate_effects(scene, meshes_of(scene)).sizes}
    stiffening = found["geometric_stiffening"]
    assert stiffening.keeps and stiffening.share == pytest.approx(turned, rel=0.05)
    assert stiffening.measure == "rotation of bodies by what elastic joints give way, rad"
    assert found["gravity"].measure.endswith("elastic joints locked")
    auto = machine(*sunk, "reduction.effects='auto'")
    kept, _ = choose_effects(auto, meshes_of(auto), meshes_of(auto))
    assert "weight" in kept.effects and kept.second_order


HELD = (
    "joints.two.elastic={reference=[[1.0,0.0]],stiffness=[1e6,'k'],turning_stiffness=[2e4]}",
    "simulation={duration=2e-3,step=1e-3}", "outputs.left={type='displacement',point='frame:hinge',axis='y'}",
)  # fmt: skip
LOOSE = "joints.one.elastic={reference=[[1.0,0.0]],stiffness=[1e6,0.0],turning_stiffness=[0.0]}"
UP = "joints.one.offset={place=[0.0,1e-3]}"


def test_an_offset_without_a_balance_is_refused():
    """Nothing holds the left mount upwards, and no model has a place to start from; one that turns stiffly on the other
    mount has, and so has a start under loads that its search finds."""
    scene, held = (machine(LOOSE, UP, "effects={}", *more) for more in ((), HELD))
    loose = r"no balance of springs .*nothing holds what joints.one.elastic.stiffness = \[1e\+06, 0\] releases\. A"
    for make in MODELS.values():
        with pytest.raises(InputError, match=loose):
            motion(make(scene))
    with pytest.raises(InputError, match=loose):
        describe_scene(scene, meshes_of(scene))
    with pytest.raises(InputError, match=loose), RankGroup.split(MPI.COMM_SELF, 1) as group:
        build(scene, meshes_of(scene), group, print)
    describe_scene(held, meshes_of(held))
    found = {name: run(held, name)[1]["left"][0] for name in MODELS}
    assert found == pytest.approx(dict.fromkeys(found, 0.0), abs=1e-12), "1 mm up, with no spring in that direction"


PLACED = (
    "outputs={left={type='displacement',point='frame:hinge',axis='y'},mid={type='displacement',point='frame:middle',axis='y'}}",
)


def test_derivatives_by_offsets_of_elastic_joints_are_central_differences():
    # the joint's angle is a small difference of coordinates that turn by much more, with 6e-6
    outputs = "outputs={lift={type='displacement',point='frame:tip',axis='y'}}"
    model = reduced_model(machine(*MOVED, "effects.motor.table=[[0.0,40.0],[1.0,40.0]]", outputs))
    compare(model, (1e-1, 1e-2), "k", "up", "aside")
    moving = machine(*MOVED, *SPUN)
    with pytest.raises(InputError, match="simulation.initial.theta.velocity = 5: joints are off beside elastic ones"):
        compare(ReducedModel(moving, model.rom))


CARRIED = (
    "effects.inner={type='structural_damping',stiffness=1e-5,mass=0.3}",
    *(f"outputs.{joint}={{type='joint_force',joint='{joint}',component='y'}}" for joint in ("one", "hub")),
)


@exported.needs_compiler
@pytest.mark.parametrize("start", [MOVED, ("initial.equilibrium=true", *REDUCED[:2], *CARRIED)])
def test_c_code_starts_from_the_balance_of_its_export(start, tmp_path):
    model = reduced_model(machine(*start, "effects.weight={type='gravity'}", "simulation.step=1e-3"))
    exported.assert_same_in_c(model, tmp_path)
    assert started(model).startswith("note: it starts from the state of pgmp simulate at the parameters of this export")


def test_errors_are_estimated_within_a_factor_of_three():
    """Of the reduction alone: the step of both runs is so small that it has no part."""
    scene = machine(
        "reduction.modes=2", "reduction.static_modes=false", "simulation.duration=0.1", "simulation.step=5e-5"
    )
    model = reduced_model(scene)
    found, full = trajectory(model), run(scene, "full")[1]
    for name in ("lift", "bent"):
        true = np.max(np.abs(found.outputs[name] - full[name]))
        assert true / 3.0 < found.errors.maximum(name) < 3.0 * true, name


def test_the_balance_of_energy_holds_at_second_order() -> None:
    """A damped machine falls onto its mounts: what their dampers take is in the balance."""
    fall = "effects.weight={type='gravity'}", "simulation.duration=0.1", *REDUCED[:2]
    off = residuals(balances("reduced", lambda step: machine(*fall, step), 4e-4, 2e-4))
    taken = motion("reduced", machine(*fall, "simulation.step=2e-4")).balance.work["one"]
    assert np.max(np.abs(taken)) > 10.0 * off[0] and 3.3 < off[0] / off[1] < 5.0


def test_a_run_from_equilibrium_rests_on_its_mounts() -> None:
    """With the crank hanging down, where its weight turns nothing."""
    rest = "initial.equilibrium=true", "simulation.initial.theta.position=4.71238898038469", "simulation.duration=0.02"
    scene = machine("effects={weight={type='gravity'}}", *rest)
    for name in MODELS:
        lift = run(scene, name)[1]["lift"]
        assert np.ptp(lift) < 1e-6 * np.abs(lift[0]) and lift[0] < -9e-5, name


def test_stresses_away_from_the_nominal_parameters_know_the_mounts():
    """Answers that a basis misses are those of the released structure."""
    stressed = (
        "parameters.w={nominal=0.02,distribution={name='uniform',loc=0.018,scale=0.004}}",
        "bodies.crank.section.width='w'",
        "outputs={force={type='stress',body='crank',quantity='axial_force',at=[0.1,0.0]}}",
    )
    scene = machine(*REDUCED, "reduction.inertia_modes=true", *stressed, "simulation.initial.theta.velocity=60.0")
    full, reduced = (run(scene, name, w=0.021)[1] for name in ("full", "reduced"))
    settled = slice(len(full["force"]) // 2, None)  # what the sudden start sets off has passed
    means = (np.mean(one["force"][settled]) for one in (reduced, full))
    assert np.divide(*means) == pytest.approx(1.0, abs=5e-3)


@pytest.mark.parametrize("make", [machine, machine_in_space, boom], ids=["plane", "space", "belt"])
@pytest.mark.parametrize(("second_order", "falls_by"), [("false", 4.0), ("true", 8.0)])
def test_a_machine_that_sinks_on_its_mounts_is_right_to_the_order_of_the_model(make, second_order, falls_by):
    """The frame, or the head on its belt, tilts by 0.03 and 0.015 rad under twice and once its weight: what the model
    is off by falls with the square of that, or with its cube, or faster; the way of an end along itself is of second
    order. Turned with the head, loads that stretch the boom would bend it."""
    off = []
    for g in (20.0, 10.0):
        weight = f"effects={{weight={{type='gravity',acceleration={g},direction={DOWN[make]}}}}}"
        scene = make(*SUNK[make], *AT_REST, weight, f"reduction.second_order={second_order}")
        full, reduced = (run(scene, name)[1] for name in ("full", "reduced"))
        off.append({name: abs(reduced[name][0] - full[name][0]) for name in full})
    ratios = {name: off[0][name] / off[1][name] for name in off[0] if name != "x"}
    assert all(0.65 * falls_by < ratio for ratio in ratios.values()), ratios
    assert (off[1]["x"] < 1e-3 * abs(full["x"][0])) == (second_order == "true")


AT_REST = (  # 96 configurations in a turn are as near to each other
    "coordinates.theta.range=[0.3,1.1]", "coordinates.theta.periodic=false",
    "reduction={modes=6,angles=13,static_modes=true}", "initial.equilibrium=true",
    "simulation={duration=2e-3,step=1e-3,initial={theta={position=0.7}}}",
)  # fmt: skip
DOWN = {machine: [0.0, -1.0], machine_in_space: [0.0, -1.0, -0.7], boom: [0.0, -1.0]}


def _places(*places):
    each = (f"{n}={{type='displacement',point='{point}',axis='{axis}'}}" for n, point, axis in places)
    return f"outputs={{{','.join(each)}}}"


ENDS = ("x", "frame:tip", "x"), ("tip", "crank:tip", "x")
SUNK = {
    machine: ("joints.one.elastic.stiffness=[1e6,4e4]", "joints.two.elastic.stiffness=[1e6,1e4]", _places(*ENDS)),
    machine_in_space: (_places(*ENDS, ("aside", "crank:tip", "z")),),
    boom: (_places(("x", "boom:tip", "x"), ("tip", "head:centre", "x"), ("aside", "head:centre", "y")),),
}  # fmt: skip
SINKS = (
    "outputs={left={type='displacement',point='shaft:hinge',axis='z'},mid={type='displacement',point='shaft:4',axis='z'}}",
)
#: Scenes, and shares of the largest values of outputs.
FOLLOWED = {
    # in space; a spring stretches by what the rotor's weight is, and a free spin stays free
    "a rotor in its bearings": (
        lambda: rotor(
            "effects.weight={type='gravity',direction=[0,0,-1]}", "simulation={duration=0.02,step=1e-5}", *SINKS,
        ),
        {"left": 0.01, "mid": 0.01},
    ),
    # at 80 rad/s, where the mounts give way by 0.3 mm, no terms of second order are needed: it moves with its frame
    "mounts that shake": (
        lambda: machine(
            *REDUCED[:2], "reduction.inertia_modes=true", "simulation={duration=0.05,step=2e-4}",
            "simulation.initial.theta.velocity=80.0",
        ),
        {"lift": 1e-3, "bent": 1e-3},
    ),
    # loads hold its sag where it is as its flange turns, and of what it moves aside nothing is without inertia
    "a tube that sags": (tube, {"aside": 0.02, "twist": 1e-3}),
}  # fmt: skip


@pytest.mark.parametrize("name", FOLLOWED)
def test_reduced_runs_follow_those_of_full_order(name):
    make, shares = FOLLOWED[name]
    full, reduced = (run(make(), model)[1] for model in ("full", "reduced"))
    assert_close(full, reduced, **shares)


def test_a_run_whose_mounts_give_way_far_says_so():
    """The right mount sinks by a tenth of the frame's length and more."""
    soft = ("joints.two.elastic.stiffness=[1e6,9e2]", "joints.two.elastic.damping=['c',10.0]", *REDUCED[:2])
    scene = machine("effects={weight={type='gravity'}}", *soft, "simulation={duration=0.4,step=1e-3}")
    far, near = motion(reduced_model(scene)), motion(reduced_model(machine(*REDUCED)))
    assert 0.14 < far.validity["elastic_rotation"] < 0.6 and near.validity["elastic_rotation"] < 1e-2
    words = "give way, which is taken as small, beyond 0.14"
    assert [words in str(remark) for remark in far.record.remarks].count(True) == 1
    assert not any(words in str(remark) for remark in near.record.remarks)
    lift = run(scene, "full")[1]["lift"]
    # and it is far off: linear motions of the mounts are no longer those of the mechanism
    assert np.max(np.abs(far.outputs["lift"] - lift)) > 0.1 * np.max(np.abs(lift))


def test_numbers_of_springs_may_be_changed_in_a_built_model(tmp_path):
    """Given as numbers too; what is rigid, and what nothing holds, is part of the tables."""
    entry, scene = "joints.two.elastic.stiffness", machine(*REDUCED)
    model = reduced_model(scene)
    changed = scene_of_built(model.rom, tmp_path, [f"{entry}=[2e6,'k']"], [], "rom.h5")
    found = history(reduced_model(scene).with_loads(changed), samples(changed, 1), 1)[1]
    built = machine(*REDUCED, f"{entry}=[2e6,'k']")
    assert_alike({name: own[:, None] for name, own in run(built, "reduced")[1].items()}, found, 1e-6)
    for other in ("[inf,'k']", "[0.0,'k']"):
        damping = "joints.two.elastic.damping=[0.0,'c']"
        with pytest.raises(InputError, match="--override joints: 'rom.h5' was built from this entry"):
            scene_of_built(model.rom, tmp_path, [f"{entry}={other}", damping], [], "rom.h5")
