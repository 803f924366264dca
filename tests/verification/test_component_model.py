"""The component model against the full-order model, its own energies, and what floating frames promise."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from alike import assert_samples_are_those_alone
from runs import (
    assert_close,
    components_model,
    full_model,
    history,
    largest_errors,
    motion,
    paper_scene,
    samples,
    trajectory,
    with_step,
)
from slopes import slopes
from solid_scenes import GRAVITY, solid_meshes, solid_slider_crank
from spatial import LOWER, UPPER, arm, bar
from spatial_beams import slider_crank_of_beams

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.bodies.floating import first_moments, second_moments
from pgmp_petsc.components import condensing
from pgmp_petsc.full.floating import add_floating
from pgmp_petsc.full.part_reference import Reference
from pgmp_petsc.lanes.compiled import njit
from pgmp_petsc.mesh import SolidMesh
from pgmp_petsc.models import ComponentModel, FullModel
from pgmp_petsc.scene import Scene
from pgmp_petsc.studies.check import describe_scene
from scenes import meshes_of

ANGLE, DEFORMATION = 1e-4, 5e-3  # shares of the largest values over a run
SHORT = ("simulation.duration=0.25", "simulation.step=1e-3")
BEAMS = ("reduction.modes=4", *SHORT)
OUTPUTS = (
    'outputs.crank_angle={type="angle", joint="crank_hinge"}',
    'outputs.slider_deformation={type="deformation", point="rod:tip", axis="x"}',
)
FALLING = 'effects.weight={type="gravity", direction=[0.0, -1.0, 0.0]}'
DAMPING = 'effects.inner={type="structural_damping", stiffness=2e-4, mass=0.5}'
MODAL = 'effects.inner={type="structural_damping", ratios=[0.05, 0.05, 0.02, 0.02]}'
STIFFENING = ('effects.stiffening={type="geometric_stiffening"}', 'effects.shapes={type="mode_inertia"}')


def beams(*overrides: str) -> tuple[Scene, None]:
    """Return the slider-crank of beams in the plane, whose scene has its meshes."""
    return paper_scene(*BEAMS, *overrides), None


def solids(*overrides: str) -> tuple[Scene, dict]:
    """Return the slider-crank of plane-stress elements, and its meshes."""
    return solid_slider_crank("reduction.modes=4", *SHORT, *overrides), solid_meshes()


def space(*overrides: str) -> tuple[Scene, None]:
    overrides = [entry.replace(GRAVITY, FALLING) for entry in overrides]
    return slider_crank_of_beams("reduction.modes=6", *OUTPUTS, *SHORT, *overrides), None


@cache
def models(make: Callable, *overrides: str) -> tuple[FullModel, ComponentModel]:
    scene, meshes = make(*overrides)
    return full_model(scene, meshes), components_model(scene, meshes)


every_kind = pytest.mark.parametrize("make", [beams, solids, space])


def outputs_of(make: Callable, *overrides: str) -> list[dict[str, np.ndarray]]:
    return [history(model, samples(model.scene, 1), 1)[1] for model in models(make, *overrides)]


@every_kind
@pytest.mark.parametrize("damping", [DAMPING, MODAL], ids=["damping", "modal damping"])
def test_it_moves_as_the_full_order_model(make, damping: str) -> None:
    """Under a torque and its weight. Rotations and velocities are exact, deformation is linear: what is left is of
    second order in it, and modes. Ratios are of bodies without the masses that they carry."""
    tool = 'effects.tool={type="point_mass", point="crank:tip", mass=0.2}'
    carried = (tool,) if damping == MODAL and make is not solids else ()
    assert_close(*outputs_of(make, GRAVITY, damping, *carried), crank_angle=ANGLE, slider_deformation=DEFORMATION)


def test_cells_have_few_fields_and_move_as_with_all(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a mode's frequency the rest would change a share of the square of what a static answer misses of it."""
    few = models(solids)[1]
    monkeypatch.setattr(condensing, "_fewest", lambda component, *_: np.eye(len(component.fields)))
    scene, meshes = solids()
    whole = components_model(scene, meshes)
    counts = [[body.blocks("floating")[0].n for body in model.kinematics.mechanism.bodies] for model in (few, whole)]
    # 4 modes, one more of the closed loop, and 3 forces at each of 2 frames, of which rigid motion takes off 3
    assert max(counts[0]) <= 5 + 6 and min(counts[1]) > 20, counts
    one, other = (history(model, samples(model.scene, 1), 1)[1] for model in (few, whole))
    assert_close(one, other, crank_angle=1e-8, slider_deformation=1e-6)  # found 4e-10 and 5e-9 of scenes that ship


def test_stresses_beside_a_random_field_take_few_fields() -> None:
    """What answers at several parameter values hardly moves; it stays orthonormal in the mass."""
    stress = 'outputs.stress={type="stress", body="rod", quantity="von_mises"}'
    scene, meshes = solids('fields.soft={body="rod", quantity="E", variation=0.1, length=0.3, terms=2}', stress)
    values = samples(scene, 1) | {"soft_1": np.array([2.0]), "soft_2": np.array([-1.5])}
    one, other = (history(make(scene, meshes), values, 1)[1] for make in (components_model, full_model))
    assert_close(one, other, crank_angle=ANGLE, stress=1e-3)  # found 5e-7 and 2.4e-4


def test_it_converges_with_the_modes() -> None:
    """From a sudden start a vibration that modes alone have; the frames' static answers do for slow loads."""
    sudden = ("effects={}", "simulation={initial={theta={velocity=2.0}},duration=0.01,step=1e-5}")
    runs = (outputs_of(beams, *sudden, f"reduction.modes={n}") for n in (1, 2, 4, 9))
    errors = [largest_errors(*both)["slider_deformation"] for both in runs]
    # what four modes lack is the vibration along the bars, which the steps resolve
    assert max(errors) < 0.03 and errors[3] < 0.01 * min(errors[:3]), errors


@every_kind
def test_inertia_at_rest_is_that_of_the_mesh(make) -> None:
    """Kinetic energy of the rigid motion, undeformed: moments are exact for the mesh."""
    energies = []
    for model in models(make, "simulation.initial={theta={position=0.7, velocity=5.0}}"):
        system = model.batch(samples(model.scene, 1), 1)
        energies.append(float(system.energies(0.0, system.start()).kinetic[0]))
    assert energies[1] == pytest.approx(energies[0], rel=1e-11)


@every_kind
def test_frames_are_mean_axes(make) -> None:
    """No field of a body moves its centre of mass or has moment of momentum: Tisserand's frame."""
    model = models(make)[1]
    for body in model.kinematics.mechanism.bodies:
        (floating,) = body.blocks("floating")
        moments = sum(float(weight.evaluate(model.scene.nominal)) * part for weight, part in floating.moments.items())
        d = len(body.mesh.nodes[0])
        mass, fields = first_moments(moments, d)
        _, mixed, _ = second_moments(moments, d)
        assert np.abs(fields).max() < 1e-9 * mass[0]
        assert np.abs(mixed - mixed.swapaxes(0, 1)).max() < 1e-9 * mass[0] * body.extent


# Python's own calls, and those with another type of a problem than the kernels have, would be compiled: half a minute
@njit(cache=True, entry=True)
def add_forces(reference, *of):
    add_floating(reference.dimension, reference.floating, reference.width, reference.rayleigh, *of)


@pytest.mark.parametrize("effects", [(), STIFFENING], ids=["linear", "stiffened"])
@pytest.mark.parametrize("make", [beams, space])
def test_forces_are_those_of_lagrange(make, effects: tuple[str, ...], monkeypatch: pytest.MonkeyPatch) -> None:
    """d/dt dT/dv - dT/dq + dU/dq by differences of the energies, in a deformed state with all velocities."""
    monkeypatch.setattr(ComponentModel, "in_joints", False)
    system = (model := models(make, *effects)[1]).batch(samples(model.scene, 1), 1)
    problem, d = system._equations.problem, system._equations.problem.dimension
    reference, floating, n, n_pose = Reference(problem), problem.floating, system.n_dofs, 3 if d == 2 else 12
    rng, dofs, state = np.random.default_rng(1), floating.dofs, system.start()
    bodies = [floating.dofs[first:last] for first, last in zip(floating.firsts[:-1, 0], floating.firsts[1:, 0])]
    q, v, a = system._equations.start[0], np.zeros(n), np.zeros(n)
    for own in bodies:
        q[own[n_pose:]] += 1e-3 * rng.standard_normal(own.size - n_pose)
        v[own], a[own] = rng.standard_normal((2, own.size))
        for k in range(3 if d == 3 else 0):  # velocities that keep the directors a rotation
            axis, spin = q[own[3 + 3 * k : 6 + 3 * k]], np.array([1.0, -2.0, 0.5])
            v[own[3 + 3 * k : 6 + 3 * k]] = np.cross(spin, axis)
            a[own[3 + 3 * k : 6 + 3 * k]] = np.cross(spin, np.cross(spin, axis))

    def lagrangian(q: np.ndarray, v: np.ndarray) -> float:
        state.q[0, :, 0], state.v[0, :, 0] = q, v
        energies = system.energies(0.0, state)
        return (energies.kinetic - energies.strain)[0]

    def momentum(t: float) -> np.ndarray:
        place = q + t * v + 0.5 * t * t * a
        return slopes(lambda rates: lagrangian(place, rates), v + t * a, 1e-4)

    # off the rotations the energies are not those of the equations: there what the frames' constraints take is left out
    chosen = dofs if d == 2 else np.concatenate([np.r_[own[:3], own[n_pose:]] for own in bodies])
    forces = np.zeros((n + system.n_constraints, 1))
    add_forces(
        reference, 0, np.zeros(1), 1.0, q[:, None].copy(), v[:, None].copy(), a[:, None].copy(), (0.0, 0.0, 0.0),
        False, forces, np.arange(len(forces)), np.zeros((len(forces), 1)),
        np.zeros((system._equations.layout.n_lower, 1)),
    )  # fmt: skip
    expected = (momentum(1e-3) - momentum(-1e-3)) / 2e-3 - slopes(lambda place: lagrangian(place, v), q, 1e-4)
    # differences of energies of about 1e2 J leave 1e-12 of these over h^2
    np.testing.assert_allclose(forces[chosen, 0], expected[chosen], rtol=1e-7, atol=2e-5)


def test_the_order_of_the_integration_is_two() -> None:
    """From a sudden start, with steps that resolve all vibrations."""
    start, run = "simulation.initial={theta={velocity=10.0}}", "simulation={duration=1e-3, step=2e-6}"
    model, runs = models(beams, "effects={}", run, start)[1], []
    for step in (2e-6, 1e-6, 5e-7):
        scene = with_step(model.scene, step)
        runs.append(history(model.with_loads(scene), samples(scene, 1), 1)[1]["slider_position"][-1, 0])
    assert np.log2((runs[0] - runs[1]) / (runs[1] - runs[2])) == pytest.approx(2.0, abs=0.1)


@pytest.mark.parametrize("radius", [0.99, 1.0])
def test_energy_is_kept(radius: float) -> None:
    """Without loads from a sudden start; what is left is the integrator's error, with order 2."""
    kept = []
    for step in (5e-4, 2.5e-4):
        scene, _ = beams(
            "effects={}", "simulation.initial={theta={velocity=6.0}}", f"simulation.spectral_radius={radius}",
            "simulation.duration=0.3", f"simulation.step={step}",
        )  # fmt: skip
        balance = trajectory("components", scene).balance
        kept.append(np.ptp(balance.kinetic + balance.strain) / balance.kinetic[0])
        assert np.abs(balance.residual).max() < 1.1 * kept[-1] * balance.kinetic[0]
    assert kept[1] < 1e-5
    assert np.log2(kept[0] / kept[1]) == pytest.approx(2.0, abs=0.3)


@pytest.mark.thorough
def test_energy_is_kept_over_a_hundred_turns() -> None:
    """From rest by a torque that rises and falls, then without loads: 7.4e-6 in all quarters, of order two in the step,
    0.25 ms here; from a sudden start vibrations would count too."""
    push = 'effects={push={type="torque", joint="crank_hinge", table=[[0, 0], [0.1, 0.5], [0.9, 0.5], [1.0, 0]]}}'
    scene, _ = beams(push, "simulation.spectral_radius=1.0", "simulation.duration=53.0", "simulation.step=2.5e-4")
    run = motion("components", scene)
    free = run.time > 1.0
    assert np.ptp(run.outputs["crank_angle"][free]) > 98.0 * 2.0 * np.pi
    energy = (run.balance.kinetic + run.balance.strain)[free]
    quarters = np.array([np.ptp(part) for part in np.array_split(energy, 4)]) / energy.max()
    assert quarters.max() < 1e-5
    assert quarters.max() < 1.05 * quarters.min()  # it swings, and does not grow


def test_a_sample_is_the_same_alone_and_in_a_batch() -> None:
    model = models(beams, "simulation.duration=0.02")[1]
    assert_samples_are_those_alone(model, (0, 3), r1=np.linspace(4.5e-3, 6.5e-3, 5))


def crooked(end: float) -> SolidMesh:
    """Return a bar in space from 0 to an end, which bends when it is stretched: its moments have no gaps."""
    mesh = bar(0.0, end, 2)
    x, y, z = mesh.nodes.T
    away = x * (x - end)
    return replace(mesh, nodes=np.stack([x, y + 0.3 * away + 0.1 * z, z + 0.2 * x * away], axis=1))


@pytest.mark.parametrize(("name", "size", "is_common"), [("E", 210e9, True), ("rho", 7800.0, False)])
def test_samples_have_moments_in_common_where_masses_are_the_same(name: str, size: float, is_common: bool) -> None:
    tip = 'outputs.tip={type="displacement",point="lower:tip",axis="z"}'
    given = f"parameters.p={{nominal={size}}}", f'materials.steel.{name}="p"'
    scene = arm(*given, tip, "simulation={duration=0.01,step=1e-3}", "simulation.initial.theta1.velocity=3.0")
    model = components_model(scene, {"upper": crooked(UPPER), "lower": crooked(LOWER)})
    values = np.linspace(0.8, 1.2, 5) * size
    common = model.batch(samples(scene, 5, p=values), 5)._equations.problem.floating.common  # noqa: SLF001
    assert bool(common.size) == is_common
    assert_samples_are_those_alone(model, (0, 3), p=values)


@every_kind
def test_masses_that_constraints_are_scaled_to_are_the_same_alone_and_in_a_batch(make) -> None:
    """To the last bit, of thirty samples: numpy sums one column in another order than several."""
    radii = np.linspace(4.1e-3, 6.9e-3, 30)
    for model in models(make):
        together = model.batch(samples(model.scene, 30, r1=radii), 30).typical_mass
        alone = [model.batch(samples(model.scene, 1, r1=radii[[k]]), 1).typical_mass[0] for k in range(30)]
        np.testing.assert_array_equal(together, alone)


@every_kind
def test_modal_damping_takes_what_a_ratio_says(make, monkeypatch: pytest.MonkeyPatch) -> None:
    """Power of the first amplitude alone, ``2 zeta omega m x'^2``, and none where the frame alone moves."""
    model = models(make, 'effects.inner={type="structural_damping", bodies=["rod"], ratios=[0.03]}')[1]
    monkeypatch.setattr(ComponentModel, "in_joints", False)  # states are those of all frames
    system = model.batch(samples(model.scene, 1), 1)
    state, unknowns = system.start(), system._equations.unknowns
    body = next(body for body in unknowns.bodies if body.name == "rod")
    mass, stiffness = body.blocks("floating")[0].modal(model.scene.nominal)
    v = np.random.default_rng(0).standard_normal(system.n_dofs)
    v[body.first_internal + 1 : body.internal.stop] = 0.0
    state.v[0, :, 0] = v
    found = system.energies(0.0, state).powers["inner"][0]
    rate = v[body.first_internal]
    assert found == pytest.approx(-2.0 * 0.03 * np.sqrt(stiffness[0] * mass[0]) * rate**2, rel=1e-12)


def test_modes_of_one_frequency_have_one_ratio() -> None:
    """A round beam bends in two planes with one frequency: which of them a solver finds first is round-off."""
    damping = 'effects.inner={{type="structural_damping", ratios={}}}'.format
    ratios, last_of_two = ([0.05, 0.05, 0.02, 0.02], [0.05, 0.05, 0.02])
    for one, other in zip(models(space, damping(ratios)), models(space, damping(last_of_two))):
        values = samples(one.scene, 1)
        found = (history(model, values, 1)[1] for model in (one, other))
        assert_close(*found, crank_angle=1e-12, slider_deformation=1e-12)
    said = r"effects\.inner\.ratios: modes 1 and 2 of crank have one frequency, 605\.6 Hz, .* not 0\.05 and 0\.02"
    for model in models(space, damping([0.05, 0.02])):
        with pytest.raises(InputError, match=said):
            model.batch(samples(model.scene, 1), 1)
    with pytest.raises(InputError, match=said):
        describe_scene(model.scene, meshes_of(model.scene))


def test_more_ratios_than_component_modes_are_refused() -> None:
    with pytest.raises(InputError, match="effects.inner.ratios: 90 modes of crank are asked for; it has"):
        models(beams, f'effects.inner={{type="structural_damping", ratios={[0.02] * 90}}}')[1].batch({}, 1)


@pytest.mark.parametrize("scale", [0.8, 1.3])
def test_cross_sections_that_scale_are_those_of_the_scaled_mesh(scale: float) -> None:
    """Energies of a rigid motion are exact, the motion of a thinner or thicker crank is that on its mesh."""
    scaled = (
        f"parameters.s={{nominal=1.0, value={scale}, unit='', bounds=[0.7, 1.4]}}", 'bodies.crank.section_scale="s"',
    )  # fmt: skip
    starts = [model.batch(samples(model.scene, 1), 1) for model in models(solids, *scaled)]
    energies = [float(system.energies(0.0, system.start()).kinetic[0]) for system in starts]
    assert energies[1] == pytest.approx(energies[0], rel=1e-11)
    assert_close(*outputs_of(solids, *scaled), crank_angle=ANGLE, slider_deformation=DEFORMATION)
