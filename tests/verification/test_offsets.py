"""Joints that are off: built-in stress against closed forms, limits, energy, and both full-order and component runs."""

from collections.abc import Sequence
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from alike import assert_alike
from conftest import run_mpi
from machine_scenes import MODELS
from mpi4py import MPI
from offset_scenes import CLAMPED, SHEAR, E, G, clamped_beam, clamped_stiffness, offset, pivot_off, spatial_four_bar
from refusals import cases, check_said, refusal
from runs import PGMP, full_model, motion, overridden, trajectory

from pgmp_petsc.full.distributed import FullStatics
from pgmp_petsc.models import of_samples
from pgmp_petsc.results import Ensemble, Trajectory
from pgmp_petsc.scene import Scene

TILT = float(np.radians(5.0))
FREE = ("effects={}", "simulation.initial.theta.velocity=20.0", "simulation.spectral_radius=1.0")


def built_in(scene: Scene) -> tuple[float, np.ndarray, np.ndarray]:
    """Return strain energy, multipliers and accelerations at the start of a full-order run."""
    system = full_model(scene).batch({}, 1)
    state = system.start()
    energy = float(system.energies(0.0, state).strain[0])
    return energy, system.unpack(state.multipliers)[:, 0], system.unpack(state.a)[:, 0]


def extrapolated(values: Sequence[float]) -> float:
    """Return the limit of values on meshes each twice as fine as the one before, of second order; hold the order."""
    first, second, third = values
    # elements of the first order: 4 from one to the next, where terms of fourth order are small
    assert (first - second) / (second - third) == pytest.approx(4.0, rel=0.05)
    return third + (third - second) / 3.0


@pytest.mark.parametrize(("d", "phi"), [(1e-5, 0.0), (0.0, 1e-5), (1e-5, 2e-5)])
def test_forces_and_energy_of_a_clamped_beam_with_its_end_off(d: float, phi: float) -> None:
    off, found = np.array([d, phi]), []
    for n in (8, 16, 32):
        scene = clamped_beam(offset("right", place=[0.0, d], turn=[phi]), f"bodies.beam.line.elements={n}")
        energy, multipliers, accelerations = built_in(scene)
        found.append([energy, *multipliers[4:6]])
        # it is at rest: of 1e-5 m at 2e3 rad/s, the lowest frequency, 40 m/s2 would be there if it were not
        assert np.max(np.abs(accelerations)) < 1e-4
    stiffness = clamped_stiffness()
    expected = np.array([0.5 * off @ stiffness @ off, *np.abs(stiffness @ off)])
    limits = [extrapolated([abs(one[k]) for one in found]) for k in range(3)]
    # what is left of fourth order; and of geometry, the sine of the tilt and the axial force
    np.testing.assert_allclose(limits, expected, rtol=3e-4, atol=1e-12)


def test_the_energy_goes_to_zero_with_the_square_of_the_offset() -> None:
    sizes = np.array([4e-4, 2e-4, 1e-4])
    shares = np.array([built_in(clamped_beam(offset("right", place=[0.0, d])))[0] / d**2 for d in sizes])
    # stretching of the axis is of fourth order in the offset: the change of the share is of second order
    order = np.log2((shares[0] - shares[1]) / (shares[1] - shares[2]))
    assert order == pytest.approx(2.0, abs=0.05)
    assert built_in(clamped_beam(offset("right", place=[0.0, 0.0], turn=[0.0])))[0] < 1e-25


def flexibility() -> np.ndarray:
    """Return what (f_z, m_x, m_y) at the joint C of the four-bar do to (w, phi_x, phi_y) of its bodies there.

    Cut there, it is two chains of beams that their hinges clamp against motions out of the plane: by Castigliano, with
    bending, torsion and shear.
    """
    placed = {name: spatial_four_bar().bodies[name].placement for name in ("crank", "coupler", "rocker")}
    lengths = {"crank": 0.08, "coupler": 0.24, "rocker": 0.16}
    sides = {"crank": 0.016, "coupler": 0.016, "rocker": 0.008}
    joint, found = np.array(placed["rocker"].origin[:2]), np.zeros((3, 3))
    for name, place in placed.items():
        side, angle = sides[name], place.rotation[2]
        along, across = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
        x, weights = np.polynomial.legendre.leggauss(4)
        for s, weight in zip(0.5 * lengths[name] * (1.0 + x), 0.5 * lengths[name] * weights):
            arm = joint - (np.array(place.origin[:2]) + s * along)
            # moments (m_x, m_y) at the section of a unit f_z, m_x, m_y at the joint: arm x f
            moments = np.array([[arm[1], 1.0, 0.0], [-arm[0], 0.0, 1.0]])
            twist, bend, force = along @ moments, across @ moments, np.array([1.0, 0.0, 0.0])
            found += weight * np.outer(twist, twist) / (G * 0.1405770 * side**4)  # Timoshenko and Goodier, of a square
            found += weight * np.outer(bend, bend) / (E * side**4 / 12.0)
            found += weight * np.outer(force, force) / (SHEAR * G * side**2)
    return found


@pytest.mark.parametrize(
    ("given", "gap"), [({"place": [0.0, 0.0, 1e-5]}, [1e-5, 0.0, 0.0]), ({"turn": [1e-4, 0.0, 0.0]}, None)]
)
def test_the_stress_built_into_a_four_bar_in_space(given: dict, gap: list | None) -> None:
    if gap is None:  # the turn is in the coupler's frame
        angle = spatial_four_bar().bodies["coupler"].placement.rotation[2]
        gap = [0.0, 1e-4 * np.cos(angle), 1e-4 * np.sin(angle)]
    energies = []
    for n in (1, 2, 4):
        elements = (f"bodies.{name}.line.elements={n * k}" for name, k in (("crank", 4), ("coupler", 8), ("rocker", 4)))
        energies.append(built_in(spatial_four_bar(offset("C", **given), *elements))[0])
    expected = 0.5 * np.array(gap) @ np.linalg.solve(flexibility(), gap)
    # bending between elements of first order converges with second order
    assert extrapolated(energies) == pytest.approx(expected, rel=1e-3)


@cache
def crooked(model: str, off: str) -> Trajectory:
    """Return the run of a linkage that turns freely."""
    return trajectory(model, spatial_four_bar(off, *FREE, "simulation.step=5e-5"))


TILTED = offset("C", turn=[TILT, 0.0, 0.0])


@pytest.mark.parametrize(
    ("model", "off", "share"),
    [("full", TILTED, 3.8), ("components", TILTED, 3.8), ("full", offset("C", place=[0.0, 0.0, 1e-4]), 5e-4)],
)
def test_a_crooked_linkage_keeps_its_energy(model: str, off: str, share: float) -> None:
    found = crooked(model, off)
    total = found.balance.kinetic + found.balance.strain
    # it takes energy to turn it: what is stored is of this size beside the motion's, and changes with the angle
    assert found.balance.strain[0] / found.balance.kinetic[0] == pytest.approx(share, rel=0.05)
    assert np.ptp(found.balance.strain) > 1e-3 * found.balance.strain[0]
    # the trapezoidal rule with 5e-5 s, of motions of 20 rad/s: (20 * 5e-5)^2 = 1e-6
    assert np.ptp(total) < 1e-6 * total[0]


@pytest.mark.parametrize("command", [["simulate"], ["montecarlo", "-n", "2", "--seed", "1"]])
def test_runs_say_that_stress_is_built_in(command: list[str], tmp_path: Path) -> None:
    scene = tmp_path / "clamped.toml"
    scene.write_text(
        CLAMPED + "[parameters.d]\nnominal=1e-5\nunit='m'\ndistribution={name='norm',loc=1e-5,scale=1e-6}\n"
    )
    asked = overridden("joints.right.offset={place=[0.0,'d']}")
    done = run_mpi(1, *PGMP, command[0], scene, "--full", *asked, *command[1:], "-o", tmp_path / "out.h5")
    assert "starts with the stress that joints that are off build in, without loads" in " ".join(done.stdout.split())
    if command[0] == "montecarlo":  # in the middle half of the end's offset, each sample its own
        found = Ensemble.read(tmp_path / "out.h5")
        np.testing.assert_allclose(found.outputs["middle"], 0.5 * found.parameters["d"], rtol=1e-3)


@pytest.mark.parametrize("model", ["full", "components"])
@pytest.mark.parametrize("way", ["driven", "held", "rounded"])
def test_every_way_to_start(model: str, way: str) -> None:
    """Driven at a speed, from static equilibrium under loads, and with points that are rounded and driven."""
    off = pivot_off(1e-9) if way == "rounded" else offset("C", turn=[0.02, 0.0, 0.0])
    drive = 'effects={drive={type="prescribed_motion",coordinate="theta",constant_speed={speed=-0.6}}}'
    given = ["initial.equilibrium=true"] if way == "held" else [drive]
    found = trajectory(model, spatial_four_bar(off, *given))
    assert found.status == 0
    # built in at the start as later: the coupler does not jump out of the plane
    aside = found.outputs["aside"]
    assert np.ptp(aside) < 0.02 * np.max(np.abs(aside))


def test_the_torque_that_holds_a_crooked_linkage_is_the_slope_of_its_energy() -> None:
    given = (offset("C", turn=[0.01, 0.0, 0.0]), "effects={}")
    at = {
        k: built_in(spatial_four_bar(*given, f"simulation.initial.theta.position={0.2 + k}"))[0] for k in (-1e-3, 1e-3)
    }
    model = full_model(spatial_four_bar(*given, "simulation.initial.theta.position=0.2", "initial.equilibrium=true"))
    theta, held = np.array([0.2]), model.kinematics.held()
    equations = model._equations(held, {}, (theta, np.zeros(1)), MPI.COMM_SELF)
    with FullStatics(equations, MPI.COMM_SELF) as statics:
        torques, lost = statics.hold(theta[None], np.ones(1, dtype=bool))
    # what the linkage itself leaves over on the coordinate is against the slope; differences are of second order
    assert not lost[0] and torques[0, 0] == pytest.approx(-(at[1e-3] - at[-1e-3]) / 2e-3, rel=1e-4)


def test_ranks_start_as_one_process_does() -> None:
    model = full_model(spatial_four_bar(offset("C", turn=[0.02, 0.0, 0.0]), *FREE))
    one = model.batch({}, 1)
    start = one.start()
    with model.distributed({}, MPI.COMM_SELF) as other:
        again = other.start()
        # static answers to 1e-12 of the size, and differences of theirs over 1e-5 rad at 20 rad/s
        np.testing.assert_allclose(other.unpack(again.q), one.unpack(start.q), rtol=0, atol=1e-11)
        np.testing.assert_allclose(other.unpack(again.v), one.unpack(start.v), rtol=0, atol=1e-5)
        rates = other._equations.constraints.rates(one.unpack(start.q), one.unpack(start.v))
    # velocities obey the joints where they are: to that, and to the second order of the step
    assert np.max(np.abs(rates)) < 1e-6 * np.max(np.abs(one.unpack(start.v)))


def test_components_follow_the_full_order_run_with_an_axis_five_degrees_off() -> None:
    full, components = (crooked(model, TILTED) for model in ("full", "components"))
    assert components.balance.strain[0] == pytest.approx(full.balance.strain[0], rel=1e-3)
    # deformations of 5 degrees, of which floating frames leave out the second order: 0.09^2 / 6
    assert_alike(full.outputs, components.outputs, 2e-3)


def test_velocities_at_the_start_are_those_of_the_linkage() -> None:
    """Differences of static answers over 1e-5 rad: these are to converge to the last digits, whatever is factorised."""
    straight, crooked = (
        full_model(spatial_four_bar(*given, *FREE)).batch({}, 1)
        for given in ((), (offset("C", turn=[1e-3, 0.0, 0.0]),))
    )
    kinetic = [float(system.energies(0.0, system.start()).kinetic[0]) for system in (straight, crooked)]
    # static answers to 1e-12 of 0.24 m over 1e-5 rad; what is built in moves with the square of 1e-3
    assert kinetic[1] == pytest.approx(kinetic[0], rel=1e-6)


@pytest.mark.parametrize("distance", [1e-9, 1e-6, 1e-3])
def test_bearings_off_by_anything(distance: float) -> None:
    """From a nanometre to a millimetre the energy is that of the flexibility."""
    energy = built_in(spatial_four_bar(offset("C", place=[0.0, 0.0, distance])))[0]
    unit = built_in(spatial_four_bar(offset("C", place=[0.0, 0.0, 1e-5])))[0] / 1e-10
    # geometry: (1 mm / 0.08 m)^2
    assert energy == pytest.approx(unit * distance**2, rel=1e-3)


@pytest.mark.parametrize("law", ["", ",distribution={name='norm',loc=0.0,scale=1e-4}"], ids=["given", "drawn"])
@pytest.mark.parametrize("model", ["full", "components"])
def test_offsets_are_parameters(model: str, law: str) -> None:
    """Samples with offsets of their own start as scenes with these numbers do, drawn, or given as a file has them."""
    parameter = f"parameters.tilt={{nominal=0.0,unit='rad'{law}}}"
    scene = spatial_four_bar(parameter, "joints.C.offset={turn=['tilt',0.0,0.0]}")
    one = of_samples(MODELS[model](scene), ["tilt"])
    assert one.largest_batch == 1 and (of_samples(MODELS[model](scene), ()).largest_batch == 1) is bool(law)
    system = one.batch({"tilt": np.array([2e-4])}, 1)
    alone = MODELS[model](spatial_four_bar(offset("C", turn=[2e-4, 0.0, 0.0]))).batch({}, 1)
    energies = [float(of.energies(0.0, of.start()).strain[0]) for of in (system, alone)]
    assert energies[0] == pytest.approx(energies[1], rel=1e-9) and energies[0] > 0.0


REFUSED = cases("""
joints.right.offset={} -> joints.right.offset = {}: place or turn is needed
joints.right.offset={place=[0.0]} -> joints.right.offset.place = [0.0]: 2 numbers are needed in the plane
joints.right.offset={place=[0.0,1.0,2.0]} -> joints.right.offset.place = [0.0, 1.0, 2.0]: 2 numbers are needed
joints.right.offset={turn=[0.0,0.0]} -> joints.right.offset.turn = [0.0, 0.0]: one number is needed in the plane
joints.right.offset={place=["gap",0.0]} -> joints.right.offset.place = "gap": there is no such parameter
joints.right.offset={place=[true,0.0]} -> joints.right.offset.place[0] = true: a finite number or the name
joints.right.offset={turn=[nan]} -> joints.right.offset.turn[0] = nan: a finite number or the name
joints.right.offset={plaec=[0.0,0.0]} -> joints.right.offset.plaec = [0.0, 0.0]: unknown key; did you mean 'place'
""")


@pytest.mark.parametrize(("asked", "said"), REFUSED)
def test_refused_with_the_scene(asked: str, said: str) -> None:
    check_said(refusal(clamped_beam, asked), said, asked)


@pytest.mark.parametrize("kind", ["full", "components"])
def test_springs_of_elastic_joints_give_way_to_offsets(kind: str) -> None:
    """A clamped beam whose left end stands on a spring across it: both have one force, and share the offset."""
    d, k, stiffness = 1e-5, 3e5, float(clamped_stiffness()[0, 0])
    soft = f"joints.left.elastic={{reference=[[1.0,0.0]],stiffness=[inf,{k}]}}"
    given = offset("right", place=[0.0, d]), soft, "bodies.beam.line.elements=32"
    system, loaded = (
        MODELS[kind](clamped_beam(*given, effects)).batch({}, 1)
        for effects in ("effects={}", "effects={weight={type='gravity'}}")  # which begins to act with the run
    )
    energies = system.energies(0.0, system.start())
    np.testing.assert_allclose(system.unpack(system.start().q), loaded.unpack(loaded.start().q), rtol=0, atol=1e-13)
    own = d * k / (stiffness + k)  # of the beam; elements of the first order, 32 of them
    assert float(energies.strain[0]) == pytest.approx(0.5 * stiffness * own**2, rel=2e-3)
    assert float(energies.potential["left"][0]) == pytest.approx(0.5 * (stiffness * own) ** 2 / k, rel=2e-3)


def sprung_end(kind: str, k: float) -> np.ndarray:
    """Return force and moment on the end of a clamped beam, off and on springs, rigid ones where k is infinite."""
    acts = "{f={type='joint_force',joint='right',component='y'},m={type='joint_torque',joint='right'}}"
    given = offset("right", place=[0.0, OFF[0]], turn=[OFF[1]]), "bodies.beam.line.elements=32", f"outputs={acts}"
    elastic = f"joints.right.elastic={{reference=[[1.0,0.0]],stiffness=[inf,{k}],turning_stiffness=[{TURNING * k}]}}"
    found = motion(kind, clamped_beam(*given, elastic)).outputs
    return np.abs([found["f"][0], found["m"][0]])


OFF, TURNING = np.array([1e-5, 2e-5]), 1e-2  # m and rad; N m/rad for 1 N/m


@pytest.mark.parametrize("kind", list(MODELS))
def test_the_spring_of_a_joint_that_is_off_itself_is_in_series_with_the_beam(kind: str) -> None:
    """Both have one force, and the rigid joint's with stiffness to infinity, first order in 1 / k."""
    found = {k: sprung_end(kind, k) for k in (3e5, 1e9, 1e10, np.inf)}
    for k, forces in found.items():
        series = np.linalg.inv(clamped_stiffness()) + np.diag([1.0, 1.0 / TURNING]) / k
        exact = np.abs(np.linalg.solve(series, OFF))
        np.testing.assert_allclose(forces, exact, rtol=2e-3)  # 32 elements, of first order
    ratios = (found[1e9] - found[np.inf]) / (found[1e10] - found[np.inf])
    np.testing.assert_allclose(ratios, 10.0, rtol=0.01)
