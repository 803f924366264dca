"""The component model against the full-order model, its own energies, and what floating frames promise."""

from collections.abc import Mapping

import numpy as np
import pytest
from mpi4py import MPI
from runs import full_model, history, paper_scene, samples
from solid_scenes import GRAVITY, solid_meshes, solid_slider_crank
from spatial_beams import SLIDER_CRANK, lines_of

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.bench.reference import component_model
from pgmp_petsc.bodies.floating import first_moments, second_moments
from pgmp_petsc.full.floating import add_energies_of_floating, add_floating
from pgmp_petsc.models import ComponentModel, FullModel
from pgmp_petsc.scene import Scene, scene_from_toml
from pgmp_petsc.studies.simulate import simulate_full

ANGLE, DEFORMATION = 1e-4, 5e-3  # shares of the largest values over a run
SHORT = ("simulation.duration=0.25", "simulation.step=1e-3")
BEAMS = ("reduction.modes=4", *SHORT)
OUTPUTS = (
    'outputs.crank_angle={type="angle", joint="crank_hinge"}',
    'outputs.slider_deformation={type="deformation", point="rod:tip", axis="x"}',
)
FALLING = 'effects.weight={type="gravity", direction=[0.0, -1.0, 0.0]}'
DAMPING = 'effects.inner={type="structural_damping", stiffness=2e-4, mass=0.5}'
MODAL = 'effects.inner={type="structural_damping", ratios=[0.05, 0.02, 0.02]}'
STIFFENING = ('effects.stiffening={type="geometric_stiffening"}', 'effects.shapes={type="mode_inertia"}')


def models(scene: Scene, meshes: Mapping) -> tuple[FullModel, ComponentModel]:
    """Return the full-order and the component model of a scene."""
    return FullModel(scene, meshes), component_model(scene, meshes, MPI.COMM_SELF)


def beams(*overrides: str) -> tuple[FullModel, ComponentModel]:
    """Return both models of the slider-crank of beams in the plane."""
    scene = paper_scene(*BEAMS, *overrides)
    full = full_model(scene)
    return full, component_model(scene, full.meshes, MPI.COMM_SELF)


def solids(*overrides: str) -> tuple[FullModel, ComponentModel]:
    """Return both models of the slider-crank of plane-stress elements."""
    return models(solid_slider_crank("reduction.modes=4", *SHORT, *overrides), solid_meshes())


def space(*overrides: str) -> tuple[FullModel, ComponentModel]:
    """Return both models of the slider-crank of beams in space."""
    overrides = [entry.replace(GRAVITY, FALLING) for entry in overrides]
    scene = scene_from_toml(SLIDER_CRANK, ".", ("reduction.modes=6", *OUTPUTS, *SHORT, *overrides))
    return models(scene, lines_of(scene))


def distances(models: tuple[FullModel, ComponentModel]) -> dict[str, float]:
    """Return how far the component model's outputs are from the full-order ones, shares of their largest values."""
    (_, exact), (_, found) = (history(model, samples(model.scene, 1), 1) for model in models)
    return {name: float(np.max(np.abs(found[name] - exact[name])) / np.max(np.abs(exact[name]))) for name in exact}


@pytest.mark.parametrize("make", [beams, solids, space])
@pytest.mark.parametrize(
    "effects", [(), (GRAVITY,), (DAMPING,), (MODAL,)], ids=["torque", "weight", "damping", "modal damping"]
)
def test_it_moves_as_the_full_order_model(make, effects: tuple[str, ...]) -> None:
    """Rotations and velocities are exact, deformation is linear: what is left is of second order in it, and modes."""
    found = distances(make(*effects))
    assert found["crank_angle"] < ANGLE
    assert found["slider_deformation"] < DEFORMATION, found


def test_it_converges_with_the_modes() -> None:
    """From a sudden start a vibration that modes alone have; the frames' static answers do for slow loads."""
    sudden = ("effects={}", "simulation.initial={theta={velocity=2.0}}", "simulation.duration=0.05")
    errors = [distances(beams(*sudden, f"reduction.modes={n}"))["slider_deformation"] for n in (1, 2, 4, 9)]
    assert errors[0] > errors[1] > errors[2] > errors[3], errors
    assert errors[3] < 0.02


@pytest.mark.parametrize("make", [beams, solids, space])
def test_inertia_at_rest_is_that_of_the_mesh(make) -> None:
    """Kinetic energy of the rigid motion, undeformed: moments are exact for the mesh."""
    energies = []
    for model in make("simulation.initial={theta={position=0.7, velocity=5.0}}"):
        system = model.batch(samples(model.scene, 1), 1)
        energies.append(float(system.energies_over([0.0], [system.start()]).kinetic[0]))
    assert energies[1] == pytest.approx(energies[0], rel=1e-11)


@pytest.mark.parametrize("make", [beams, solids, space])
def test_frames_are_mean_axes(make) -> None:
    """No field of a body moves its centre of mass or has moment of momentum: Tisserand's frame."""
    for body in make()[1].kinematics.mechanism.bodies:
        nominal = make()[1].scene.nominal
        (floating,) = body.blocks("floating")
        moments = sum(float(weight.evaluate(nominal)) * part for weight, part in floating.moments.items())
        d = len(body.mesh.nodes[0])
        mass, fields = first_moments(moments, d)
        _, mixed, _ = second_moments(moments, d)
        assert np.abs(fields).max() < 1e-9 * mass[0]
        assert np.abs(mixed - mixed.swapaxes(0, 1)).max() < 1e-9 * mass[0] * body.extent


def stiffened() -> tuple[FullModel, ComponentModel]:
    """Return both models of the slider-crank of beams in the plane, component modes with their foreshortening."""
    return beams(*STIFFENING)


def stiffened_in_space() -> tuple[FullModel, ComponentModel]:
    """Return both models of the slider-crank of beams in space, component modes with their foreshortening."""
    return space(*STIFFENING)


@pytest.mark.parametrize("make", [beams, space, stiffened, stiffened_in_space])
def test_forces_are_those_of_lagrange(make) -> None:
    """d/dt dT/dv - dT/dq + dU/dq by differences of the energies, in a deformed state with all velocities."""
    system = (model := make()[1]).batch(samples(model.scene, 1), 1)
    problem, d = system._equations.problem, system._equations.problem.dimension
    floating, n, n_pose = problem.floating, system.n_dofs, 3 if d == 2 else 12
    rng, dofs = np.random.default_rng(1), floating.dofs
    bodies = [floating.dofs[first:last] for first, last in zip(floating.firsts[:-1, 0], floating.firsts[1:, 0])]
    q, v, a = system._equations.start()[0], np.zeros(n), np.zeros(n)
    for own in bodies:
        q[own[n_pose:]] += 1e-3 * rng.standard_normal(own.size - n_pose)
        v[own], a[own] = rng.standard_normal((2, own.size))
        for k in range(3 if d == 3 else 0):  # velocities that keep the directors a rotation
            axis, spin = q[own[3 + 3 * k : 6 + 3 * k]], np.array([1.0, -2.0, 0.5])
            v[own[3 + 3 * k : 6 + 3 * k]] = np.cross(spin, axis)
            a[own[3 + 3 * k : 6 + 3 * k]] = np.cross(spin, np.cross(spin, axis))

    def lagrangian(q: np.ndarray, v: np.ndarray) -> float:
        found, powers, weights = np.zeros((2, 1)), np.zeros((len(problem.rayleigh), 1)), np.zeros((1, 1))
        add_energies_of_floating(
            floating, problem.width, d, problem.rayleigh, 0, np.zeros(1), q[:, None].copy(), v[:, None].copy(), found,
            powers, weights,
        )  # fmt: skip
        return found[0, 0] - found[1, 0]

    def gradient(of, at: np.ndarray, h: float = 1e-4) -> np.ndarray:
        steps = h * np.eye(n)[chosen]
        return np.array([(of(at + step) - of(at - step)) / (2.0 * h) for step in steps])

    def momentum(t: float) -> np.ndarray:
        place = q + t * v + 0.5 * t * t * a
        return gradient(lambda rates: lagrangian(place, rates), v + t * a)

    # off the rotations the energies are not those of the equations: there what the frames' constraints take is left out
    chosen = dofs if d == 2 else np.concatenate([np.r_[own[:3], own[n_pose:]] for own in bodies])
    forces = np.zeros((n + system.n_constraints, 1))
    add_floating(
        floating, problem.width, d, problem.rayleigh, 0, np.zeros(1), 1.0, q[:, None].copy(), v[:, None].copy(),
        a[:, None].copy(), (0.0, 0.0, 0.0), False, forces, np.arange(len(forces)), np.zeros((len(forces), 1)),
        np.zeros((system._equations.layout.n_lower, 1)),
    )  # fmt: skip
    expected = (momentum(1e-3) - momentum(-1e-3)) / 2e-3 - gradient(lambda place: lagrangian(place, v), q)
    # differences of energies of about 1e2 J leave 1e-12 of these over h^2
    np.testing.assert_allclose(forces[chosen, 0], expected, rtol=1e-7, atol=2e-5)


def test_the_order_of_the_integration_is_two() -> None:
    """From a sudden start, with steps that resolve all vibrations."""
    model = beams("effects={}", "simulation.initial={theta={velocity=10.0}}", "simulation.duration=1e-3")[1]
    runs = []
    for step in (4e-6, 2e-6, 1e-6, 1.25e-7):
        simulation = model.scene.simulation.model_copy(update={"step": step})
        scene = model.scene.model_copy(update={"simulation": simulation})
        runs.append(history(model.with_loads(scene), samples(scene, 1), 1)[1]["slider_position"][-1, 0])
    errors = np.abs(np.array(runs[:-1]) - runs[-1])
    assert np.log2(errors[:-1] / errors[1:]) == pytest.approx(2.0, abs=0.1)


@pytest.mark.parametrize("radius", [0.99, 1.0])
def test_energy_is_kept(radius: float) -> None:
    """Without loads from a sudden start; what is left is the integrator's error, with order 2."""
    kept = []
    for step in (5e-4, 2.5e-4):
        model = beams(
            "effects={}", "simulation.initial={theta={velocity=6.0}}", f"simulation.spectral_radius={radius}",
            "simulation.duration=0.3", f"simulation.step={step}",
        )[1]  # fmt: skip
        balance = simulate_full(model, MPI.COMM_SELF).balance
        kept.append(np.ptp(balance.kinetic + balance.strain) / balance.kinetic[0])
        assert np.abs(balance.residual).max() < 1.1 * kept[-1] * balance.kinetic[0]
    assert kept[1] < 1e-5
    assert np.log2(kept[0] / kept[1]) == pytest.approx(2.0, abs=0.3)


def test_a_sample_is_the_same_alone_and_in_a_batch() -> None:
    model = beams("simulation.duration=0.02")[1]
    radii = np.linspace(4.5e-3, 6.5e-3, 5)
    _, together = history(model, samples(model.scene, 5, r1=radii), 5)
    for k in (0, 3):
        _, alone = history(model, samples(model.scene, 1, r1=radii[k]), 1)
        for name, values in alone.items():
            np.testing.assert_array_equal(together[name][:, k], values[:, 0])


@pytest.mark.parametrize("make", [beams, solids, space])
def test_modal_damping_takes_what_a_ratio_says(make) -> None:
    """Power of the first amplitude alone, ``2 zeta omega m x'^2``, and none where the frame alone moves."""
    model = make('effects.inner={type="structural_damping", bodies=["rod"], ratios=[0.03]}')[1]
    system = model.batch(samples(model.scene, 1), 1)
    state, unknowns = system.start(), system._equations.unknowns
    body = next(body for body in unknowns.bodies if body.name == "rod")
    mass, stiffness = body.blocks("floating")[0].modal(model.scene.nominal)
    v = np.random.default_rng(0).standard_normal(system.n_dofs)
    v[body.first_internal + 1 : body.internal.stop] = 0.0
    state.v[0, :, 0] = v
    found = system.energies_over([0.0], [state]).powers["inner"][0]
    rate = v[body.first_internal]
    assert found == pytest.approx(-2.0 * 0.03 * np.sqrt(stiffness[0] * mass[0]) * rate**2, rel=1e-12)


def test_more_ratios_than_component_modes_are_refused() -> None:
    with pytest.raises(InputError, match="effects.inner.ratios: 90 modes of crank are asked for; it has"):
        beams(f'effects.inner={{type="structural_damping", ratios={[0.02] * 90}}}')[1].batch({}, 1)


@pytest.mark.parametrize("scale", [0.8, 1.3])
def test_cross_sections_that_scale_are_those_of_the_scaled_mesh(scale: float) -> None:
    """Energies of a rigid motion are exact, the motion of a thinner or thicker crank is that on its mesh."""
    scaled = (
        f"parameters.s={{nominal=1.0, value={scale}, unit='', bounds=[0.7, 1.4]}}",
        'bodies.crank.section_scale="s"',
    )
    scene = solid_slider_crank("reduction.modes=4", *SHORT, *scaled)
    pair = models(scene, solid_meshes())
    starts = [model.batch(samples(scene, 1), 1) for model in pair]
    energies = [float(system.energies_over([0.0], [system.start()]).kinetic[0]) for system in starts]
    assert energies[1] == pytest.approx(energies[0], rel=1e-11)
    found = distances(pair)
    assert found["crank_angle"] < ANGLE and found["slider_deformation"] < DEFORMATION, found
