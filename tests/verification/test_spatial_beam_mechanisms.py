"""Mechanisms of beams in space: energy and momentum, inertia forces of their sections, rigid ones, bad input."""

import os

import numpy as np
import pytest
from alike import balances, orders, shares_left
from equations import evaluated
from mpi4py import MPI
from runs import full_model, motion, watched
from spatial import ARM, DENSITY
from spatial_beams import HEIGHT, RECTANGLE, SLIDER_CRANK, WIDTH, pendulum_in_space, slider_crank_of_beams

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.bodies.beam3d import at_rest, natural_mass
from pgmp_petsc.bodies.matrices import AffineMatrices, weighted_sum
from pgmp_petsc.estimates.validity import BodyStrains, half_height
from pgmp_petsc.mechanism.capabilities import Purpose, check_capabilities
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.mesh import LineMesh
from pgmp_petsc.scene import scene_from_toml
from scenes import kinematics_of, mechanism_of, meshes_of, of_text

N_STEPS = int(os.environ.get("PGMP_STEPS", "1000"))  # of 1e-4 s without forces; 10,000 take a minute
# two beams with two coordinates, hinged about axes that are not parallel
arm = of_text(ARM.replace('element = "solid3d"', f'element = "beam3d"\n{RECTANGLE}'))


def test_energy_and_momentum_of_free_motion() -> None:
    """Two steel beams thrown about, spectral radius 1: energy and the momentum about the fixed axis stay."""
    step = 1e-4
    scene = arm(
        f"simulation.duration={N_STEPS * step}", f"simulation.step={step}", "simulation.spectral_radius=1.0",
        "simulation.initial={theta1={velocity=6.0}, theta2={velocity=-9.0}}",
    )  # fmt: skip
    model = full_model(scene)
    with model.distributed({}, MPI.COMM_SELF) as system:
        equations = system._equations  # noqa: SLF001
        mass = evaluated(equations, *equations.start, (0.0, 1.0, 0.0))[1]
    with model.batch({}, 1) as system:

        def energy_and_momentum(time: float, state) -> tuple[float, float]:
            now = system.energies(time, state)
            vectors, v = system.unpack(state.q)[:, 0].reshape(-1, 3), system.unpack(state.v)[:, 0]
            turned = np.cross([0.0, 0.0, 1.0], vectors).ravel()  # positions and directors alike
            return float(np.sum(now.kinetic + now.strain)), float(turned @ (mass @ v))

        run, kept = watched(system, scene.simulation, energy_and_momentum, 20)
    assert run.status[0] == 0
    assert np.all(np.abs(np.array(kept) / kept[0] - 1.0).max(axis=0) < [1e-6, 3e-7])


DAMPED = (
    "effects.weight={type='gravity', direction=[0.0, -0.6, 0.8]}",
    "effects.knob={type='point_mass', point='rod:3', mass=0.1, inertia=1e-4}",
    "effects.friction={type='structural_damping', stiffness=1e-4, mass=1.0}",
)


def test_energy_is_balanced_with_the_square_of_the_step() -> None:
    """With gravity out of the plane, a point mass on a node, both dampings and a torque."""
    found = balances("full", lambda step: slider_crank_of_beams(*DAMPED, "simulation.duration=0.06", step), 1e-3, 5e-4)
    assert all(balance.work["friction"][-1] < 0.0 for balance in found)
    assert orders(shares_left(found))[0] > 1.7


def test_sections_have_the_inertia_forces_of_their_fibres() -> None:
    """Any linear field of accelerations, through the directors' masses and through the field's rotations."""
    scene = pendulum_in_space('bodies.arm.mesh="0.0:1.0:3"', "bodies.arm.orientation=[0.0, 0.6, 0.8]")
    (body,) = mechanism_of(scene).bodies
    mass = weighted_sum(AffineMatrices([body], range(body.dofs.size)).mass, {}).toarray()
    inertia = sum(np.array(terms) for terms in body.section.terms("mass").values())
    gradient = np.random.default_rng(5).standard_normal((3, 3))
    field = body.linear_fields() @ np.concatenate([np.zeros(3), gradient.ravel()])
    wanted = np.zeros(body.dofs.size)
    for element, axes, length in zip(body.mesh.cells, body.axes, body.mesh.lengths):
        frames = [np.concatenate([gradient @ body.mesh.nodes[node], gradient.T.ravel()]) for node in element]
        force = natural_mass(np.array([length]), axes[None], inertia)[0] @ np.concatenate(frames)
        np.add.at(wanted, (6 * element[:, None] + np.arange(6)).ravel(), at_rest().T @ force)
    np.testing.assert_allclose(mass @ field, wanted, atol=1e-14 * np.abs(wanted).max())


def test_a_rigid_beam_has_the_inertia_of_its_line() -> None:
    """About its centre of mass, against the flexible body's mass in rigid motion."""
    scene = pendulum_in_space("bodies.arm.orientation=[0.0, 0.6, 0.8]")
    rigid = pendulum_in_space("bodies.arm.orientation=[0.0, 0.6, 0.8]", "bodies.arm.flexible=false")
    (body,), (stiff,) = (mechanism_of(made).bodies for made in (scene, rigid))
    mass = weighted_sum(AffineMatrices([body], range(body.dofs.size)).mass, {}).toarray()
    unit = body.linear_fields()
    motion = np.column_stack([*unit[:, :3].T, unit[:, 3:] @ [0, 0, 0, 0, 0, -1, 0, 1, 0],
                              unit[:, 3:] @ [0, 0, 1, 0, 0, 0, -1, 0, 0],
                              unit[:, 3:] @ [0, -1, 0, 1, 0, 0, 0, 0, 0]])  # fmt: skip
    motion[:, 4] += 0.5 * motion[:, 2]  # rotations about the middle of the line
    motion[:, 5] -= 0.5 * motion[:, 1]
    (matrix,) = stiff.component.mass.values()
    np.testing.assert_allclose(matrix, motion.T @ mass @ motion, atol=1e-13 * matrix.max())
    assert matrix[0, 0] == pytest.approx(DENSITY * WIDTH * HEIGHT)
    np.testing.assert_allclose(stiff.mesh.nodes, [[0.5, 0.0, 0.0]])


def test_a_parameter_of_the_section_changes_modes_as_the_section_does() -> None:
    """Affine terms at another radius against a scene with that radius."""
    scene, other = slider_crank_of_beams(), slider_crank_of_beams("parameters.r1.nominal=7e-3")
    found = []
    for made, values in ((scene, {"r1": 7e-3}), (other, {"r1": 7e-3})):
        mechanism = kinematics_of(made).mechanism
        matrices = AffineMatrices(mechanism.bodies, range(mechanism.n_dofs))
        found.append([weighted_sum(terms, values).toarray() for terms in (matrices.mass, matrices.stiffness)])
    for one, two in zip(*found):
        np.testing.assert_allclose(one, two, atol=1e-13 * np.abs(two).max())


def test_the_reduced_run_follows_the_full_order_one_out_of_the_plane() -> None:
    """A slider-crank of which the weight bends the beams across its plane. Measured: 3e-6 and
    5e-4."""
    outputs = 'outputs={angle={type="angle", joint="crank_hinge"}, across={type="position", point="rod:3", axis="z"}}'
    made = slider_crank_of_beams(
        *DAMPED, outputs, "simulation.duration=0.1", "reduction.modes=8", "reduction.angles=48",
        "reduction.static_modes=true", "reduction.inertia_modes=true", 'reduction.interpolation="spline"',
    )  # fmt: skip
    meshes = meshes_of(made)
    full = motion("full", made, meshes)
    reduced = motion("reduced", made, meshes)
    for name, limit in (("angle", 1e-5), ("across", 2e-3)):
        values = full.outputs[name]
        share = np.abs(reduced.outputs[name] - values).max() / np.abs(values).max()
        assert share < limit, f"{name}: {share:.2e}"
    assert not any("change of stiffness" in remark.text for remark in reduced.record.remarks)
    assert 0.0 < reduced.validity["stiffness_gained"] < 0.1


@pytest.mark.parametrize("strain", ["extension", "bending"])
def test_strains_of_reduced_runs(strain: str) -> None:
    """A stretched beam, and one bent about both axes of its section: the curvature times half the diagonal."""
    scene = pendulum_in_space()
    kinematics = kinematics_of(scene)
    places = kinematics.mechanism.bodies[0].mesh.nodes[:, 0]
    local = np.zeros((1, places.size, 6))
    if strain == "extension":
        local[0, :, 0] = 1e-3 * places
        wanted = 1e-3
    else:
        local[0, :, 4], local[0, :, 5] = 0.3 * places, 0.4 * places
        local[0, :, 2], local[0, :, 1] = -0.15 * places**2, 0.2 * places**2
        wanted = 0.5 * 0.5 * np.hypot(WIDTH, HEIGHT)
    rotation, found = BodyStrains(scene, kinematics.mechanism, {}, False).largest(local)
    assert found[0] == pytest.approx(wanted) and rotation[0] == pytest.approx(0.0 if strain == "extension" else 0.5)


def test_a_section_by_coefficients_has_the_height_of_its_larger_bending() -> None:
    scene = slider_crank_of_beams(
        f'bodies.rod={{mesh="0.3:1.0:5", element="beam3d", orientation=[0, 1, 0], {COEFFICIENTS}}}',
        "bodies.rod.section.bending_3=640.0",
    )
    assert half_height(scene, "rod", {}) == pytest.approx(2.0 * np.sqrt(640.0 / 2e7))


SQUARE = 'section={shape="rectangle", width=0.01, height=0.01}'
COEFFICIENTS = (
    'section={shape="coefficients3d", axial=2e7, shear_2=6e6, shear_3=6e6, torsion=120.0, bending_2=160.0, '
    "bending_3=160.0, line_density=0.77, rotary_2=6e-6, rotary_3=6e-6}"
)
WRONG = {
    f'bodies.rod={{mesh="0.3:1.0:5", element="beam3d", material="steel", {SQUARE}}}':
        r"bodies\.rod\.orientation: missing; needed in space for every section but a circle: orientation = \[x, y, z\]",
    f'bodies.rod={{mesh="0.3:1.0:5", element="beam3d", {COEFFICIENTS}}}': r"bodies\.rod\.orientation: missing; needed",
    "bodies.rod.orientation=[0.0, 0.0, 0.0]":
        r"bodies\.rod\.orientation = \[0\.0, 0\.0, 0\.0\]: a direction other than \[0, 0, 0\] is needed",
    "bodies.rod.orientation=[1.0, 0.0]": r"bodies\.rod\.orientation = \[1\.0, 0\.0\]: three",
    "bodies.rod.orientation=[-2.0, 0.0, 0.0]":
        r"bodies\.rod\.orientation = \[-2\.0, 0\.0, 0\.0\]: parallel to element 0 .* needed: orientation = \[x, y, z\]",
    'bodies.rod.section={shape="coefficients", axial=1.0, shear=1.0, bending=1.0, line_density=1.0}':
        r'bodies\.rod\.section = .*: a beam3d has the shape "coefficients3d"',
    "bodies.rod.thickness=0.01": r"bodies\.rod\.thickness = 0\.01: for solid2d and solid3d only",
    f'bodies.rod={{mesh="0.3:1.0:5", element="beam2d", material="steel", {SQUARE}}}':
        r'bodies\.rod\.element = "beam2d": in the plane, but crank \(beam3d\) in space; all bodies are',
    "bodies.crank.flexible=false":
        r"bodies\.crank\.flexible = false, of a mass with the factors r1\^2, r1\^4: .*; give the section without",
}  # fmt: skip


@pytest.mark.parametrize(("override", "message"), WRONG.items(), ids=[key[:45] for key in WRONG])
def test_a_wrong_entry_is_refused_by_name(override: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        made = slider_crank_of_beams(override)
        check_capabilities(made, Purpose.FULL)
        mechanism_of(made)


def test_entries_of_space_are_refused_in_the_plane() -> None:
    plane = SLIDER_CRANK.replace("beam3d", "beam2d").replace("axis = [0.0, 0.0, 1.0]\n", "")
    plane = plane.replace("direction = [1.0, 0.0, 0.0]", "direction = [1.0, 0.0]")
    scene_from_toml(plane, ".")
    with pytest.raises(InputError, match=r"bodies\.rod\.orientation = .*: for beam3d only"):
        scene_from_toml(plane, ".", ["bodies.rod.orientation=[0.0, 1.0, 0.0]"])
    with pytest.raises(InputError, match=r'bodies\.rod\.section = .*: a beam2d has the shape "coefficients"'):
        scene_from_toml(plane, ".", [f"bodies.rod.{COEFFICIENTS}", "bodies.rod.orientation=[0.0, 1.0, 0.0]"])


def test_a_bent_line_may_be_along_the_orientation_somewhere() -> None:
    scene = pendulum_in_space()
    nodes = np.array([[0.0, 0.0, 0.0], [0.5, 0.0, 0.0], [0.5, 0.5, 0.0]])
    with pytest.raises(InputError, match=r"parallel to element 1 of the body, along \[0\.0, 1\.0, 0\.0\]"):
        Mechanism.from_scene(scene, {"arm": LineMesh(nodes, np.array([[0, 1], [1, 2]]), {"hinge": 0, "tip": 2})})


def test_a_section_by_coefficients_is_the_section() -> None:
    """A rectangle's own coefficients give its matrices."""
    area, about_2, about_3 = WIDTH * HEIGHT, HEIGHT * WIDTH**3 / 12, WIDTH * HEIGHT**3 / 12
    rectangle = pendulum_in_space()
    (body,) = mechanism_of(rectangle).bodies
    terms = sum(np.array(terms) for terms in body.section.terms("stiffness").values())
    keys = ("axial", "shear_2", "shear_3", "torsion", "bending_2", "bending_3")
    given = ", ".join(f"{key}={value!r}" for key, value in zip(keys, terms.tolist()))
    given += f", line_density={DENSITY * area!r}, rotary_2={DENSITY * about_2!r}, rotary_3={DENSITY * about_3!r}"
    section = f'section={{shape="coefficients3d", {given}}}'
    other = pendulum_in_space(f'bodies.arm={{mesh="0.0:1.0:10", element="beam3d", orientation=[0, 1, 0], {section}}}')
    (twin,) = mechanism_of(other).bodies
    for kind in ("mass", "stiffness"):
        one, two = (sum(each.of_elements(kind, np.arange(10)).values()) for each in (body, twin))
        np.testing.assert_allclose(two, one, rtol=1e-12)
