"""Reduced models with joints that are off: closed forms, full order, samples, and refusals."""

import json
import re
from pathlib import Path

import exported
import numpy as np
import pytest
from alike import assert_alike
from conftest import ROOT
from differences import compare
from length_scenes import BRIEF, long_crank
from machine_scenes import MODELS
from mpi4py import MPI
from offset_scenes import (
    CLAMPED,
    FOUR_BAR,
    HEIGHT,
    LENGTH,
    WIDTH,
    E,
    clamped_beam,
    clamped_stiffness,
    offset,
    spatial_four_bar,
)
from runs import built_rom, full_model, in_turn, motion, overridden, pgmp, reduced_model, refused, samples, trajectory
from scipy.optimize import brentq
from scipy.stats import norm
from solid_scenes import solid_meshes, solid_slider_crank

from pgmp_petsc.c_export.constants import constants_of
from pgmp_petsc.c_export.fmu import OUTPUTS, VERSIONS, write_fmu
from pgmp_petsc.design.fitting import MeasuredHistory, fit
from pgmp_petsc.estimates.error_indicator import indicator_of
from pgmp_petsc.models import Model, ReducedModel
from pgmp_petsc.ranks.groups import RankGroup
from pgmp_petsc.reduced.lagrangian import least_stiffness
from pgmp_petsc.results import Ensemble
from pgmp_petsc.scene import load_scene
from pgmp_petsc.stepping.generalised_alpha import integrate
from pgmp_petsc.studies.building import estimate_effects
from pgmp_petsc.studies.field_frames import mode_shape
from pgmp_petsc.studies.modes_table import tabulate_modes
from scenes import meshes_of

TILT = float(np.radians(5.0))
SMOOTH = ("reduction.interpolation='spectral'", "effects={}")
TURNING = (
    "coordinates.theta={joint='A',range=[0.0,6.283185307179586],periodic=true}",
    "effects={drive={type='prescribed_motion',coordinate='theta',constant_speed={speed=20.0}}}",
    "reduction.angles=48", "simulation.duration=0.3", "simulation.step=1e-3",
)  # fmt: skip
DRAWN = (
    "parameters.tilt={nominal=0.0,unit='rad',distribution={name='norm',loc=0.0,scale=1e-3}}",
    "parameters.bore={nominal=0.0,unit='m',distribution={name='norm',loc=0.0,scale=1e-4}}",
    "joints.C.offset={turn=['tilt',0.0,0.0]}", "joints.D.offset={place=[0.0,0.0,'bore']}",
)  # fmt: skip


def begun(model: Model) -> tuple[float, dict[str, float]]:
    """Return strain energy and outputs at the start of a run."""
    system = model.batch(samples(model.scene, 1), 1)
    state = system.start()
    outputs = model.outputs.evaluate(model.observed(system, state))
    return float(system.energies(0.0, state).strain[0]), {name: float(value[0]) for name, value in outputs.items()}


def test_a_clamped_beam_is_bent_as_its_mesh_is() -> None:
    # within the plane of the beam, whose elements are linear: what differs is of second order in 1e-5 m over 0.5 m
    scene = clamped_beam(offset("right", place=[0.0, 1e-5], turn=[2e-5]))
    (energy, outputs), (expected, others) = begun(reduced_model(scene)), begun(full_model(scene))
    assert energy == pytest.approx(expected, rel=2e-6)
    assert outputs["middle"] == pytest.approx(others["middle"], rel=1e-6)


def test_section_forces_of_a_clamped_beam_are_those_of_the_closed_form() -> None:
    d, entries = 1e-5, ("bending_moment", "shear_force")
    asked = (f"outputs.{name}={{type='stress',body='beam',at=[0.0,0.0],quantity='{name}'}}" for name in entries)
    scene = clamped_beam(offset("right", place=[0.0, d]), *asked, "bodies.beam.line.elements=32")
    found = begun(reduced_model(scene))[1]
    # the force 12 E I d / L^3 and moments of half of it times L, made smaller by shear
    force = float(clamped_stiffness()[0, 0]) * d
    # elements of first order: 1e-3 with 32 of them; the moment in the middle of the first one, 1 - 1 / 32
    assert abs(found["shear_force"]) == pytest.approx(force, rel=2e-3)
    assert abs(found["bending_moment"]) == pytest.approx(0.5 * force * LENGTH, rel=0.035)


def test_modes_to_see_are_of_what_is_free_to_move() -> None:
    model = reduced_model(clamped_beam(offset("right", place=[0.0, 1e-5], turn=[2e-5])))
    assert mode_shape(model, 1, {}).frequency_hz == pytest.approx(model.rom.frequencies_hz[0, 0], rel=1e-9)


@pytest.mark.parametrize("off", [offset("C", turn=[TILT, 0.0, 0.0]), offset("C", place=[0.0, 0.0, 2e-3])])
def test_the_energy_of_a_crooked_linkage_over_a_revolution(off: str) -> None:
    reduced, full = (trajectory(name, spatial_four_bar(off, *TURNING)) for name in ("reduced", "full"))
    strain, expected = reduced.balance.strain, full.balance.strain
    # it takes a torque to turn it, the slope of this energy: it changes by a fifth and more
    assert np.ptp(expected) > 0.2 * expected.max()
    # second order in 5 degrees, 2e-4 at the start, and vibrations, of which few modes are kept: 3e-6 J of 2.7 J, 0.15 J
    np.testing.assert_allclose(strain, expected, rtol=0, atol=6e-4 * expected.max())
    for name, values in full.outputs.items():
        np.testing.assert_allclose(reduced.outputs[name], values, rtol=0, atol=2e-3 * np.abs(values).max())
        error = np.abs(reduced.errors.outputs[name]).max()
        true = np.abs(reduced.outputs[name] - values).max()
        # both have errors of the step in common, which the estimate counts
        assert 0.8 * true < error < 1.25 * true + 1e-3 * np.abs(values).max(), name


@pytest.mark.parametrize(
    ("key", "direction", "sizes"),
    [("turn", (0.0, 1.0, 0.0), TILT * 0.5 ** np.arange(3)), ("place", (0.0, 0.0, 1.0), 8e-3 * 0.5 ** np.arange(3))],
)
def test_what_is_left_out_is_of_second_order_in_the_offset(key: str, direction: tuple, sizes: np.ndarray) -> None:
    errors = []
    for size in sizes:
        scene = spatial_four_bar(offset("C", **{key: [float(size * x) for x in direction]}), *SMOOTH)
        (energy, outputs), (expected, others) = begun(reduced_model(scene)), begun(full_model(scene))
        errors.append(
            [energy / expected - 1.0, outputs["aside"] / others["aside"] - 1.0, outputs["angle"] - others["angle"]]
        )
    orders = np.log2(np.abs(np.array(errors[:-1]) / np.array(errors[1:])))
    np.testing.assert_allclose(orders, 2.0, atol=0.1)


def test_without_an_offset_it_is_the_model_of_the_rigid_joint() -> None:
    straight, none = (
        trajectory("reduced", spatial_four_bar(*given))
        for given in ((), (offset("C", place=[0.0, 0.0, 0.0], turn=[0.0, 0.0, 0.0]),))
    )
    nominal = trajectory("reduced", spatial_four_bar(*DRAWN))
    for found in (none, nominal):
        for name, values in straight.outputs.items():  # sums with zeros in another order
            np.testing.assert_allclose(found.outputs[name], values, rtol=0, atol=1e-12)


def test_springs_act_on_what_is_built_in() -> None:
    spring = "effects={pull={type='spring_damper',points=['ground:high','coupler:tip'],stiffness=2e5,rest=0.5}}"
    given = offset("C", turn=[0.02, 0.0, 0.0]), spring, "ground.points.high=[0.22647580015448898,0.159427400463467,0.5]"
    full, reduced = (
        begun(MODELS[name](spatial_four_bar(*given, "initial.equilibrium=true", "reduction.angles=24")))
        for name in ("full", "reduced")
    )
    alone = begun(full_model(spatial_four_bar(given[0], "effects={}")))
    # the spring undoes a part of it
    assert abs(full[1]["aside"]) < 0.95 * abs(alone[1]["aside"])
    assert reduced[1]["aside"] == pytest.approx(full[1]["aside"], rel=2e-3)
    assert reduced[0] == pytest.approx(full[0], rel=2e-3)


def test_every_sample_has_its_own_offsets_and_its_own_error() -> None:
    scene = spatial_four_bar(*DRAWN, "effects={}", "simulation.initial.theta.velocity=20.0", "simulation.step=1e-4")
    model, values = reduced_model(scene), {"tilt": np.array([0.0, TILT]), "bore": np.array([1e-4, 0.0])}
    system = model.batch(values, 2)
    watched = indicator_of(model).watch(system, np.arange(2))
    estimate = watched.estimate(integrate(system, scene.simulation, observer=watched).status)
    energies = system.energies(0.0, system.start()).strain
    for k in range(2):
        own = scene.with_values({name: float(value[k]) for name, value in values.items()})
        reduced, full = (trajectory(name, own) for name in ("reduced", "full"))
        assert energies[k] == pytest.approx(reduced.balance.strain[0], rel=1e-9)
        for name, expected in full.outputs.items():
            true = np.abs(reduced.outputs[name] - expected).max()
            # both have errors of the step in common, which the estimate counts: 1e-4 of the angle
            assert 0.8 * true < estimate.largest[name][k] < 1.25 * true + 1e-4 * np.abs(expected).max(), (k, name)


def test_machines_of_the_scene_are_those_of_their_meshes() -> None:
    scene = load_scene(ROOT / "scenes" / "crooked_four_bar.toml")
    model, random = reduced_model(scene), np.random.default_rng(1)
    values = {name: random.normal(0.0, one.distribution.scale, 3) for name, one in scene.parameters.items()}
    system = model.batch(values, 3)
    found = model.outputs.evaluate(model.observed(system, system.start()))
    each = [begun(full_model(scene.with_values({n: float(v[k]) for n, v in values.items()})))[1] for k in range(3)]
    # a spring reads the torque, which is the slope of an energy between 48 angles: 4e-5; the rest is of first order
    for name, limit in (("angle", 2e-4), ("aside", 1e-5), ("moment", 1e-5)):
        expected = np.array([one[name] for one in each])
        np.testing.assert_allclose(found[name], expected, rtol=0, atol=limit * np.abs(expected).max(), err_msg=name)


def test_bodies_of_cells_follow_an_offset_in_their_plane() -> None:
    asked = ("simulation.duration=0.05", "simulation.step=1e-3", "reduction.modes=4", "reduction.angles=48")
    scene = solid_slider_crank(*asked, "joints.elbow.offset={place=[1e-4,0.0]}")
    found, expected = (motion(kind, scene, solid_meshes()) for kind in ("reduced", "full"))
    # the slider is 0.1 mm further on, and nothing is built in
    assert expected.outputs["slider_position"][0] == pytest.approx(1.0001, abs=1e-8)
    assert_alike(expected.outputs, found.outputs, 1e-4)


UNCERTAIN = CLAMPED + "[parameters.d]\nnominal=1e-5\nunit='m'\ndistribution={name='norm',loc=1e-5,scale=1e-6}\n"
ASKED = overridden("joints.right.offset={place=[0.0,'d']}")


def test_commands(tmp_path: Path) -> None:
    """Build and samples on two ranks, and the probability of an event on one."""
    scene, rom, found = tmp_path / "clamped.toml", tmp_path / "rom.h5", tmp_path / "samples.h5"
    scene.write_text(UNCERTAIN)
    samples_of = ["montecarlo", rom, "-n", "16", "--seed", "1", "-o", found]
    statuses, done = in_turn(2, [["build", scene, *ASKED, "-o", rom], samples_of])
    assert statuses == [[0] * 2] * 2 and "1 of joints that are off" in done.stdout
    assert "starts with the stress that joints that are off build in" in " ".join(done.stdout.split())
    samples = Ensemble.read(found)
    # the middle of the beam follows half of its end; the estimates are of every sample's own mesh
    np.testing.assert_allclose(samples.outputs["middle"], 0.5 * samples.parameters["d"], rtol=1e-6)
    assert np.nanmax(samples.errors["middle"]) < 1e-6 * np.max(samples.outputs["middle"])
    asked = ("--rare", "middle > 6.5e-6", "-n", "2000", "--seed", "1")
    done = pgmp("montecarlo", rom, *asked, "--json", "-o", tmp_path / "rare.h5")
    assert json.loads(done.stdout)["estimate"] == pytest.approx(norm.sf(3.0), rel=0.1)


BESIDE = {
    "second order": ("reduction.second_order=true",),
    "angles by a tolerance": ("reduction={sampling_tolerance=1e-3,interpolation='spline',modes=4,angles=9}",),
    "modes of other parameters": (
        "reduction.parameter_modes=1",
        "parameters.r={nominal=8e-3,unit='m',distribution={name='uniform',loc=7e-3,scale=2e-3}}",
        "bodies.rocker.section.height='r'",
    ),
    "effects by their sizes": ("reduction.effects='auto'",),
    "stiffening at once": (
        "effects={stiff={type='geometric_stiffening',stretching='static'},swing={type='mode_inertia'}}",
    ),
    "a length": ("bodies.rocker.line.length='reach'", "parameters.reach={nominal=0.16,unit='m',bounds=[0.155,0.165]}"),
}  # fmt: skip


@pytest.mark.parametrize("beside", list(BESIDE))
def test_beside_what_reduced_models_have(beside: str) -> None:
    scene = spatial_four_bar(offset("C", turn=[0.02, 0.0, 0.0], place=[0.0, 0.0, 1e-3]), *BESIDE[beside])
    rom = built_rom(scene)
    assert rom.tables.n_given == 1
    other = scene.with_values({name: 1.02 * value for name, value in scene.values.items()})
    for own in (scene, other):
        (energy, outputs), (expected, others) = begun(ReducedModel(own, rom)), begun(full_model(own))
        # of second order in 0.02 rad, and in 2 % of a section or a length
        assert energy == pytest.approx(expected, rel=1e-3)
        assert outputs["aside"] == pytest.approx(others["aside"], rel=1e-3)


#: An offset of a slider-crank's elbow, which its rigid motion takes.
LOOSE = ("joints.elbow.offset={place=[0.0,'d']}", "parameters.d={nominal=1e-4,unit='m',bounds=[0.0,2e-4]}")


@pytest.mark.parametrize(
    "beside",
    [
        ("bodies.rod.line.length=0.7", "reduction={sampling_tolerance=1e-2,interpolation='spline',modes=2,angles=5}"),
        ("bodies.rod.line.length=0.7", "reduction.parameter_modes=1", "reduction.angles=20", "reduction.max_angles=80"),
        ("reduction.angles=20",),
    ],
)
def test_offsets_that_strain_nothing_have_no_part_in_the_angles(beside: tuple[str, ...]) -> None:
    """Their stiffness is round-off: a build said that it is indefinite, and took angles for that."""
    scene = long_crank(*BRIEF, *LOOSE, *beside)
    rom, without = built_rom(scene), built_rom(long_crank(*BRIEF, *beside))
    assert rom.tables.n_given == 1 and rom.tables.samples.shape == without.tables.samples.shape
    assert not any("positive definite" in remark.text for remark in rom.record.remarks)
    model = ReducedModel(scene, rom)
    share = least_stiffness(model.terms, scene.values, np.zeros((1, model.terms.layout.n_eta)))
    np.testing.assert_allclose(share, 1.0, rtol=1e-12)


@pytest.mark.parametrize("part", [{"turn": (0.0, TILT, 0.0)}, {"place": (0.0, 0.0, 8e-3)}])
def test_terms_of_second_order_have_what_is_of_second_order_in_offsets(part: dict) -> None:
    """The angle of a joint, which an offset changes by its square; what is left is of fourth order."""
    errors = []
    for share in (1.0, 0.5):
        off = offset("C", **{key: [share * x for x in direction] for key, direction in part.items()})
        scene = spatial_four_bar(
            off, "reduction.second_order=true", "reduction.interpolation='spectral'", "effects={}",
            "initial.equilibrium=true", "reduction.static_modes=true", "reduction.modes=8",
        )  # fmt: skip
        (_, outputs), (_, expected) = begun(reduced_model(scene)), begun(full_model(scene))
        errors.append(outputs["angle"] / expected["angle"] - 1.0)
    assert abs(errors[0]) < 1e-3
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.1)


TENSION = ("bodies.beam.line.elements=40", "reduction.modes=3", "reduction.second_order=true")


@pytest.mark.parametrize("stretch", [1e-4, -2e-5])
def test_built_in_stress_tunes_a_beam_as_a_string(stretch: float) -> None:
    """By what the closed form of a clamped Euler-Bernoulli beam under a force has."""
    scene, group = clamped_beam(offset("right", place=[stretch, 0.0]), *TENSION), RankGroup.split(MPI.COMM_SELF, 1)
    rom = built_rom(scene)
    straight, pulled = (
        tabulate_modes(own, meshes_of(own), model, 2, group)
        for own, model in ((clamped_beam(*TENSION), None), (scene, rom))
    )
    assert any("under the stress that joints that are off build in" in remark.text for remark in pulled.record.remarks)
    np.testing.assert_allclose(pulled.reduced_hz, pulled.full_hz, rtol=1e-9)
    bending, mass = E * WIDTH * HEIGHT**3 / 12.0, 7800.0 * WIDTH * HEIGHT

    def characteristic(omega: float, force: float) -> float:
        half, both = force / (2.0 * bending), mass * omega**2 / bending
        s, q = (np.sqrt(np.sqrt(half**2 + both) + sign * half) for sign in (1.0, -1.0))
        hyperbolic, circular = s * LENGTH, q * LENGTH
        return (s**2 - q**2) * np.sinh(hyperbolic) * np.sin(circular) + 2.0 * s * q * (
            1.0 - np.cosh(hyperbolic) * np.cos(circular)
        )

    omega = 2.0 * np.pi * straight.full_hz[0, 0]
    free, loaded = (
        brentq(characteristic, 0.8 * omega, 1.3 * omega, args=(force,))
        for force in (0.0, E * WIDTH * HEIGHT * stretch / LENGTH)
    )
    # of first order in the offset, and shear and mesh change the beam itself by 1 %
    change = (pulled.full_hz[0, 0] / straight.full_hz[0, 0]) ** 2 - 1.0
    assert change == pytest.approx((loaded / free) ** 2 - 1.0, rel=5e-3)


def test_modes_without_terms_of_second_order_say_that_stress_has_no_part() -> None:
    scene, group = clamped_beam(offset("right", place=[1e-4, 0.0])), RankGroup.split(MPI.COMM_SELF, 1)
    off, straight = (tabulate_modes(own, meshes_of(own), None, 2, group) for own in (scene, clamped_beam()))
    np.testing.assert_array_equal(off.full_hz, straight.full_hz)
    assert any("has no part in the frequencies" in remark.text for remark in off.record.remarks)


def test_sizes_of_effects_have_the_stress_that_is_built_in() -> None:
    scene = clamped_beam(offset("right", place=[1e-4, 0.0]), *TENSION[:2])
    sizes = {size.kind: size.share for size in estimate_effects(scene, meshes_of(scene)).sizes}
    assert sizes["geometric_stiffening"] == pytest.approx(0.147, rel=0.01)  # as of the string above


def test_forces_at_other_parameters_are_those_of_the_mesh() -> None:
    given = (
        "parameters.E={nominal=210e9,unit='Pa'}", "materials.steel.E='E'", "parameters.h={nominal=0.01,unit='m'}",
        "bodies.beam.section.height='h'", offset("right", place=[1e-6, 1e-5], turn=[2e-5]),
        "outputs.root={type='stress',body='beam',at=[0.0,0.0],quantity='bending_moment'}",
        "outputs.axial={type='stress',body='beam',at=[0.2,0.0],quantity='axial_force'}",
    )  # fmt: skip
    scene = clamped_beam(*given)
    for values in ({}, {"E": 100e9}, {"h": 0.012}):
        own = scene.with_values(values)
        found, expected = (
            trajectory(model).outputs for model in (ReducedModel(own, reduced_model(scene).rom), full_model(own))
        )
        for name in ("root", "axial"):  # of second order in 2e-5, and in a fifth of the height
            assert found[name][0] == pytest.approx(expected[name][0], rel=3e-3), (values, name)


CROOKED = (
    "parameters.tilt={nominal=0.02,unit='rad'}", "parameters.bore={nominal=1e-3,unit='m'}",
    "parameters.r={nominal=8e-3,unit='m'}", "bodies.rocker.section.height='r'",
    "joints.C.offset={turn=['tilt',0.0,0.0],place=[0.0,0.0,5e-4]}", "joints.D.offset={place=[0.0,0.0,'bore']}",
)  # fmt: skip
PULLED = (
    "effects.pull={type='spring_damper',points=['ground:high','coupler:tip'],stiffness=2e5,rest=0.5}",
    "ground.points.high=[0.22647580015448898,0.159427400463467,0.5]", "initial.equilibrium=true",
)  # fmt: skip
RUNS = {
    "as they are built": (),
    "held at first": PULLED,
    "settled": (
        *PULLED, "initial.coordinates='free'", "effects.hold={type='spring_damper',joint='A',stiffness=5.0}",
    ),
    "of second order": ("reduction.second_order=true",),
    "over a stop": (
        "effects.stop={type='end_stop',joint='A',lower=-0.3,upper=0.004,stiffness=1e3,damping=0.1}",
        "effects.motor.table=[[0.0,40.0],[0.01,40.0]]",
    ),
}  # fmt: skip


@pytest.mark.parametrize("run", list(RUNS))
def test_derivatives_are_central_differences(run: str) -> None:
    # equilibria are found to their own rounding, which larger changes stand out from
    compare(reduced_model(spatial_four_bar(*CROOKED, *RUNS[run])), (1e-2, 1e-3))


def test_an_offset_is_recovered_from_a_full_order_history() -> None:
    scene = spatial_four_bar(*CROOKED, "parameters.bore.bounds=[-2e-3,2e-3]")
    run = trajectory("full", scene.with_values({"bore": -5e-4}))
    # of the angle the reduced model has what is of first order in the offsets, which is nothing
    history = MeasuredHistory(run.time, {"aside": run.outputs["aside"]})
    (found,) = fit(reduced_model(scene), history, ["bore"], {}, MPI.COMM_SELF).parameters
    assert found.estimate == pytest.approx(-5e-4, rel=1e-3)


@pytest.mark.usefixtures("quickly_compiled")
def test_models_in_c_and_units(tmp_path: Path) -> None:
    """Other offsets too, which are constants of a state, and no states of model exchange."""
    model = reduced_model(spatial_four_bar(*CROOKED, *RUNS["over a stop"]))
    other = {"tilt": -0.01, "bore": 2e-4, "r": 8.5e-3}
    changed = ReducedModel(model.scene.with_values(other), model.rom)
    exported.assert_same_in_c(model, tmp_path)
    wanted = exported.motion(changed).outputs
    exported.assert_equal(exported.outputs_of(tmp_path / "run", "tilt=-0.01", "bore=2e-4", "r=8.5e-3"), wanted)
    constants = constants_of(model, "it")
    assert constants.free == ["theta", "mode[1]", "mode[2]", "mode[3]", "mode[4]"]
    write_fmu(constants, tmp_path / "it.fmu", VERSIONS[-1])
    unit = exported.Unit(tmp_path / "it.fmu", tmp_path / "unit")
    assert unit.instantiate()
    for number, name in enumerate(model.scene.parameters):
        assert unit.set("Real", number, other[name]) == 0
    assert unit.begin() == 0
    for number in range(len(wanted["aside"]) - 1):
        assert unit.step(number * 2.5e-4, 2.5e-4) == 0
    for number, (name, values) in enumerate(wanted.items()):
        exported.assert_equal({name: unit.get("Real", OUTPUTS + number)}, {name: values[-1:]})
    exchanged = exported.Unit(tmp_path / "it.fmu", tmp_path / "exchanged")
    assert exchanged.instantiate(exchange=True) and exchanged.begin() == 0
    assert exchanged.states(10).shape == (10,)


RIGID = overridden(
    "bodies.crank.flexible=false", "bodies.coupler.flexible=false", "bodies.rocker.flexible=false", "outputs={}",
    "bodies.arm={line={length=0.1,elements=2},element='beam3d',material='steel',orientation=[0.0,1.0,0.0],"
    "section={shape='rectangle',width=0.01,height=0.01},placement={origin=[0.0,0.0,0.0],rotation=[0.0,0.0,0.0]}}",
    "joints.weld={type='fixed',connect=['ground:origin','arm:hinge']}",
)  # fmt: skip


def test_an_offset_that_nothing_takes_is_refused(tmp_path: Path) -> None:
    scene = tmp_path / "rigid.toml"
    scene.write_text(FOUR_BAR + "[parameters.tilt]\nnominal=0.0\n")
    said = {
        "place=[0.0,0.0,1e-3]": r"a gap of 0.000\d+ m remains at theta = ",
        "turn=['tilt',0.0,0.0]": r"an angle of 0\.\d+ rad for 1 of tilt remains at theta = ",
    }
    asked = [overridden(f"joints.C.offset={{{given}}}") for given in said]
    commands = [("build", scene, *RIGID, *own, "-o", tmp_path / "rom.h5") for own in asked]
    for message, words in zip(refused(2, commands), said.values()):
        message = " ".join(message.split())
        assert "joints are off by what no redundancy explains and no elasticity takes" in message
        assert re.search(r"joints\.[A-D]: " + words, message), message
