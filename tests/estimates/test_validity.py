"""How far a run leaves small deformations: rotations, strains, changes of stiffness, their limits and what is said."""

import numpy as np
import pytest
from pencils import modal_problem
from runs import built_rom, paper_scene, rom_of
from solid_scenes import solid_meshes, solid_slider_crank

from pgmp_petsc.bodies.affine import evaluate_weights
from pgmp_petsc.bodies.matrices import AffineMatrices, ThirdDerivative
from pgmp_petsc.bodies.sections.section import Coefficients
from pgmp_petsc.effects import actions_of, effects_of, loads_of
from pgmp_petsc.estimates.own_error import FEW_STEPS, absence_of_estimates, few_steps, left_out_of_estimates
from pgmp_petsc.estimates.validity import BodyStrains, Kept, Places, Weights, half_height, look_at, remarks_of
from pgmp_petsc.models import ReducedModel
from pgmp_petsc.reduction.sample_grid import SampleGrid, Samples
from pgmp_petsc.reduction.sampler import TurnedLoads
from pgmp_petsc.reduction.tables import StiffnessChanges
from pgmp_petsc.results.estimates import ROTATION_LIMIT, VALIDITY, limits_of
from pgmp_petsc.scene import Scene
from scenes import four_bar, kinematics_of, mechanism_of, slider_crank


def test_a_stretched_arc() -> None:
    """A rod bent to an arc and stretched: rotation at its ends, and the strain of its outermost fibre."""
    scene = slider_crank('bodies.rod.section={shape="rectangle", width=0.01, height=0.02}')
    mechanism = mechanism_of(scene)
    rod = mechanism.bodies[1]
    along = rod.mesh.nodes[:, 0] - rod.mesh.nodes[0, 0]
    angle = 0.3 * along
    chord = np.sin(0.15 * along) / 0.15
    local = np.zeros((2, mechanism.n_nodes, 3))
    for curved in (False, True):  # rigid bodies are neither turned nor strained
        for values in BodyStrains(scene, mechanism, scene.values, curved).largest(local):
            np.testing.assert_allclose(values, 0.0, rtol=0, atol=1e-15)
    bent = np.array([chord * np.cos(angle / 2), chord * np.sin(angle / 2)]).T * 1.001
    local[1, rod.nodes, :2] = bent - (rod.mesh.nodes - rod.mesh.nodes[0])
    local[1, rod.nodes, 2] = angle
    rotation, strain = BodyStrains(scene, mechanism, scene.values, True).largest(local)
    assert rotation == pytest.approx([0.0, 0.3 * along.max()], rel=1e-12)
    # a chord is shorter than its arc by (kappa h)^2 / 24
    element = rod.mesh.lengths.max()
    assert strain[1] == pytest.approx(0.001 + 0.01 * 0.3, abs=(0.3 * element) ** 2 / 20)


def test_the_fibre_of_a_section_without_height() -> None:
    """That of a circle: E A = E pi r^2 and E I = E pi r^4 / 4 give r back; the axial entry may be a parameter."""
    r, young = 7e-3, 210e9
    area, inertia = young * np.pi * r**2, young * np.pi * r**4 / 4
    scene = slider_crank(f"parameters.EA={{nominal={area}}}")
    section = Coefficients(
        shape="coefficients", axial="EA", shear=1e6, bending=inertia, line_density=1.0, rotary_density=1e-5
    )
    rod = scene.bodies["rod"].model_copy(update={"section": section, "material": None})
    scene = scene.model_copy(update={"bodies": scene.bodies | {"rod": rod}})
    found = half_height(scene, "rod", {"EA": np.array([area, 4 * area])})
    np.testing.assert_allclose(found, [r, r / 2], rtol=1e-12)
    of_circles, radii = paper_scene(), np.array([1e-3, 2e-3])
    np.testing.assert_array_equal(half_height(of_circles, "crank", {"r1": radii}), radii)
    assert half_height(of_circles, "rod", {"r1": radii}) == 5.6e-3
    quiet = {name: 0.0 for name in VALIDITY}
    assert [remark.kind for remark in remarks_of(scene, quiet)] == ["note"]


def test_limits() -> None:
    assert ROTATION_LIMIT**2 / 2 == pytest.approx(0.01, rel=0.03)
    plain, stiffening = limits_of(False), limits_of(True)
    assert 0.1 < plain["elastic_rotation"] < 0.2 and 0.05 < plain["stiffness_lost"] < 0.2
    assert np.isinf(stiffening["stiffness_gained"]) and stiffening["stiffness_lost"] > 0.2


def test_what_is_said_of_some_samples() -> None:
    scene = slider_crank()
    quiet = {name: np.zeros(5) for name in VALIDITY}
    assert remarks_of(scene, quiet) == ()
    (remark,) = remarks_of(scene, quiet | {"stiffness_lost": np.array([0.0, -0.3, np.nan, -0.9, -0.01])})
    assert remark.kind == "warning" and remark.text.startswith("2 of 5 samples: ")
    assert "-0.9" in remark.text and "geometric_stiffening" in remark.text and "[effects]" in remark.text


OUTPUT = 'outputs={crank_angle={type="angle", joint="crank_hinge"}}'


@pytest.mark.parametrize(
    ("entry", "why"),
    [("simulation.error_indicator=false", "simulation.error_indicator = false"), ("outputs={}", "no [outputs]")],
)
def test_why_there_is_no_estimate(entry: str, why: str) -> None:
    (remark,) = absence_of_estimates(slider_crank(OUTPUT, entry))
    assert remark.kind == "note" and why in remark.text


@pytest.mark.parametrize(
    "entry",
    [
        'effects.brake={type="joint_damping", joint="crank_hinge", coefficient=0.1}',
        "bodies.crank.flexible=false",
        "simulation.step=1e-3",
    ],
)
def test_where_there_is_an_estimate(entry: str) -> None:
    assert absence_of_estimates(slider_crank(OUTPUT, entry), ensemble=True) == ()
    (remark,) = absence_of_estimates(slider_crank(OUTPUT, "ensemble.checked_share=0.0"), ensemble=True)
    assert "ensemble.checked_share = 0" in remark.text


def test_estimates_of_a_few_steps_are_said_to_be_unsure() -> None:
    assert few_steps(FEW_STEPS) == ()
    (remark,) = few_steps(FEW_STEPS - 1)
    assert remark.kind == "note" and f"the run has {FEW_STEPS - 1} steps, estimates want {FEW_STEPS}" in remark.text


@pytest.mark.parametrize(
    ("entries", "why"),
    [
        ((), None),
        (("simulation.error_indicator=false",), "built with simulation.error_indicator = false"),
        (("parameters={s={nominal=1.0}}", 'bodies.rod.section_scale="s"'), "bodies.rod (its cross-section is scaled)"),
    ],
)
def test_what_estimates_leave_out(entries: tuple[str, ...], why: str | None) -> None:
    scene = solid_slider_crank("reduction.modes=3", "reduction.angles=8", *entries)
    rom = built_rom(scene, meshes=solid_meshes(n_per_metre=10))
    told = scene.model_copy(update={"simulation": scene.simulation.model_copy(update={"error_indicator": True})})
    remarks = left_out_of_estimates(ReducedModel(told, rom))
    assert len(remarks) == (why is not None)
    assert all(why in remark.text and "--full" in remark.text for remark in remarks)
    if not scene.simulation.error_indicator:
        assert left_out_of_estimates(ReducedModel(scene, rom)) == ()


def test_the_nearest_sample() -> None:
    turn = Samples.uniform(0.0, 2 * np.pi, 8, True)
    assert turn.nearest(np.array([0.1, 6.2, -0.1, 6.3, 0.8, 4 * np.pi + 1.5])).tolist() == [0, 0, 0, 0, 1, 2]
    part = Samples.chebyshev(-1.0, 1.0, 3)
    assert part.nearest(np.array([-2.0, -0.6, -0.4, 0.4, 5.0])).tolist() == [0, 0, 1, 1, 2]


@pytest.mark.parametrize(
    "grid",
    [
        SampleGrid((Samples.uniform(-1.0, 2 * np.pi - 1.0, 12, True),)),
        SampleGrid((Samples.chebyshev(-1.0, 2.0, 9),)),
        SampleGrid((Samples.uniform(0.0, 2 * np.pi, 5, True), Samples.chebyshev(-1.0, 2.0, 4))),
    ],
)
def test_what_is_kept_of_a_run(grid: SampleGrid) -> None:
    """The most deformed state of each part and the extreme shares against numpy, whoever looks on and in what parts."""
    random, n, n_t, length, n_parts = np.random.default_rng(3), 11, 30, 7, 5
    r, m, n_terms = grid.n_coordinates, 3, 2
    half = random.normal(size=(grid.n, n_terms, m, m))
    stiffness = half @ np.swapaxes(half, 2, 3)
    influence = random.normal(size=(grid.n, 2, 1 + 1 + n_terms * (r + (r * (r + 1) // 2))))
    changes = StiffnessChanges(influence, random.uniform(1.0, 2.0, size=(grid.n, n_terms, 2)))
    weights, load_weights = random.uniform(0.5, 2.0, size=(2, n, n_terms)), random.uniform(0.5, 2.0, size=(n, 1))
    trail = random.normal(size=(n_t, 3, n, r + m))
    trail[:, 0, :, :r] = np.cumsum(0.4 * trail[:, 0, :, :r], axis=0)
    loads, forces = random.normal(size=(n_t, 1)), random.normal(size=(n_t, n, 1))
    places = Places.of(grid, stiffness, changes)

    def looked_at(samples: np.ndarray, *parts: int) -> Kept:
        kept = Kept.nothing(places, n_parts, samples.size, r + m)
        own = Weights.of(weights[0, samples], load_weights[samples], weights[1, samples])
        for some in np.split(np.arange(n_t), parts):
            seen = loads[some], np.ascontiguousarray(forces[some][:, samples])
            look_at(places, own, some[0], length, *seen, np.ascontiguousarray(trail[some][:, :, samples]), kept)
        return kept

    found = looked_at(np.arange(n))
    for sample in range(n):
        nearest = grid.nearest(trail[:, 0, sample, :r])
        q, v, a = trail[:, 0, sample, r:], trail[:, 1, sample, :r], trail[:, 2, sample, :r]
        own = np.einsum("t,ntij->nij", weights[1, sample], stiffness)[nearest]
        energies = 0.5 * np.einsum("ni,nij,nj->n", q, own, q)
        for part in range(n_parts):
            most = part * length + int(np.argmax(energies[part * length : (part + 1) * length]))
            np.testing.assert_array_equal(found.deformed(n)[part, sample], trail[most, 0, sample])
        k, j = np.tril_indices(r)
        moving = np.hstack([a, v[:, k] * v[:, j] * np.where(k == j, 1.0, 2.0)])
        inertia = [weight * moving for weight in weights[0, sample]]
        loading = np.hstack([loads * load_weights[sample], forces[:, sample], *inertia])
        shares = np.einsum("nkc,nc->nk", influence[nearest], loading)
        shares /= np.einsum("t,ntk->nk", weights[1, sample], changes.stiffness[nearest])
        gained, lost = (part[sample] for part in found.shares(n))
        assert gained == pytest.approx(max(shares.max(), 0.0), rel=1e-12)
        assert lost == pytest.approx(min(shares.min(), 0.0), rel=1e-12)
        alone = looked_at(np.array([sample]), 3, 4, 20)
        np.testing.assert_array_equal(alone.deformed(1)[:, 0], found.deformed(n)[:, sample])
        np.testing.assert_array_equal([part[0] for part in alone.shares(1)], [gained, lost])


@pytest.mark.parametrize("scene", [slider_crank('effects.weight={type="gravity"}'), four_bar()])
def test_changes_of_stiffness_are_those_of_the_static_deformation(scene: Scene) -> None:
    """The share from influences against ``psi.K3[u] psi / lambda`` of the static deformation u of all loads at once."""
    scene = scene.model_copy(update={"reduction": scene.reduction.model_copy(update={"modes": 3, "angles": 8})})
    rom = rom_of(scene)
    kinematics = kinematics_of(scene)
    mechanism = kinematics.mechanism
    loads = loads_of(effects_of(scene, mechanism), AffineMatrices(mechanism.bodies, range(mechanism.n_dofs)))
    values = {name: np.array([value]) for name, value in scene.nominal.items()}
    of_loads, of_mass, of_stiffness = (
        np.atleast_2d(evaluate_weights(weights, values).T).reshape(1, -1)
        for weights in (rom.tables.load_weights, rom.tables.mass_weights, rom.tables.stiffness_weights)
    )
    v, a, amplitudes = np.array([[31.0]]), np.array([[-400.0]]), np.arange(2.0, 2.0 + len(loads))
    third = ThirdDerivative(mechanism.bodies, range(mechanism.n_dofs))
    with modal_problem(kinematics, scene.nominal, 3) as problem:
        for number in (1, 5):
            modes = problem.solve(rom.tables.samples.theta[number])
            forces = TurnedLoads(problem, loads).at(modes.theta) @ (of_loads[0] * amplitudes)
            moving = modes.rigid[:, 0] * a[0, 0] + modes.rigid_curvature[:, 0, 0] * v[0, 0] ** 2
            forces = forces - problem.times_mass(moving[:, None])[:, 0]
            bent = problem.static_answers(modes.rigid, forces[:, None], "static deformation")
            expected = []
            for k in range(3):
                pairs = third.times(np.hstack([bent, modes.flexible[:, k : k + 1]]), (np.array([0]), np.array([1])))
                change = sum(float(w.evaluate(scene.nominal)) * part[:, 0] for w, part in pairs.items())
                expected.append(float(change @ modes.flexible[:, k]) / modes.eigenvalues[k])
            trail = np.zeros((1, 3, 1, 1 + rom.tables.n_modes))
            trail[0, :, 0, 0] = modes.theta[0], v[0, 0], a[0, 0]
            n_actions = len(actions_of(effects_of(scene, mechanism_of(scene))))
            acting = amplitudes[None], np.zeros((1, 1, n_actions))
            changes, found = rom.stiffness_changes, []
            for k in range(3):
                one = StiffnessChanges(changes.influence[:, k : k + 1], changes.stiffness[:, :, k : k + 1])
                places = Places.of(rom.tables.samples, rom.tables.stiffness, one)
                kept = Kept.nothing(places, 1, 1, trail.shape[3])
                look_at(places, Weights.of(of_mass, of_loads, of_stiffness), 0, 1, *acting, trail, kept)
                found.append(np.sum(kept.shares(1)))  # one of them is zero
            np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-9)
