"""Continuum elements: force and tangent against the energy, rigid motion, viscous stress, mass."""

import compiled_elements
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from solids import dimension_of, jacobian_determinants, rule_of

from pgmp_petsc.bodies import elasticity
from pgmp_petsc.bodies.elasticity import Geometry, Lame
from pgmp_petsc.mesh.meshes import PLANE_KINDS, SOLID_KINDS, faces_of, reference_element, shape_gradients

KINDS = (*PLANE_KINDS, *SOLID_KINDS)
CURVED = ("triangle6", "quad8", "quad9", "tetra10", "hexahedron20", "hexahedron27")
NU, N_ELEMENTS = 0.3, 3
EDGES = np.array([[0.9, 0.2, -0.1], [-0.3, 0.7, 0.2], [0.1, -0.2, 0.8]])  # to which those of the reference cell go
# The energy is a polynomial of the fourth degree in the places, so the fourth-order difference has no error but
# round-off, whatever the step: 1e-16 over the step.
STEP = 0.1


def lame_of(kind: str) -> Lame:
    return Lame.of(NU, dimension_of(kind) == 2)


def affine(kind: str, n: int = 1) -> np.ndarray:
    """Return n equal elements, undistorted, shape (n, n_a, d)."""
    element = reference_element(kind)
    d = element.dimension
    places = 0.3 + element.nodes @ EDGES[:d, :d]
    return np.repeat(places[None], n, axis=0)


def distorted(kind: str) -> np.ndarray:
    """Return elements with every node moved by up to 5 % of an edge, shape (n_e, n_a, d)."""
    regular = affine(kind, N_ELEMENTS)
    places = regular + np.random.default_rng(3).uniform(-0.05, 0.05, regular.shape)
    for rule in (reference_element(kind).stiffness, reference_element(kind).mass):
        # a rule may have negative weights; the determinants of the Jacobian have to be positive
        assert (elasticity.volumes_of(places, rule) / rule.weights).min() > 0.0
    return places


def strained(places: np.ndarray) -> np.ndarray:
    """Return the nodes after a deformation of the order of 1."""
    return places + np.random.default_rng(4).normal(0.0, 0.2, places.shape)


def turned(places: np.ndarray, angle: float) -> np.ndarray:
    d = places.shape[2]
    axis = np.array([0.36, 0.48, 0.8]) if d == 3 else np.array([0.0, 0.0, 1.0])
    return places @ Rotation.from_rotvec(angle * axis).as_matrix()[:d, :d].T + np.array([5.0, -2.0, 1.0])[:d]


def rigid_rates(places: np.ndarray) -> np.ndarray:
    """Return the velocities of rigid motions, shape (n_rigid, n_e, n_a, d)."""
    d = places.shape[2]
    moves = [np.broadcast_to(unit, places.shape) for unit in np.eye(d)]
    for i in range(d):
        for j in range(i):
            spin = np.zeros((d, d))
            spin[i, j], spin[j, i] = 1.0, -1.0
            moves.append(places @ spin.T)
    return np.array(moves)


def difference(function: object, places: np.ndarray) -> np.ndarray:
    """Return derivatives of an element function in the nodes' places, (n_e, ..., n_a, d), to the fourth order."""
    slopes = []
    for a in range(places.shape[1]):
        for i in range(places.shape[2]):
            unit = np.zeros(places.shape[1:])
            unit[a, i] = STEP
            near, far = (function(places + k * unit) - function(places - k * unit) for k in (1, 2))
            slopes.append((8 * near - far) / (12 * STEP))
    return np.stack(slopes, axis=-1).reshape(*slopes[0].shape, *places.shape[1:])


def strains(places: np.ndarray, geometry: Geometry) -> np.ndarray:
    """Return Green's strain at the quadrature points, shape (n_e, n_q, d, d)."""
    f = np.einsum("eai,eqja->eqij", places, geometry.gradients)
    return 0.5 * (np.einsum("eqki,eqkj->eqij", f, f) - np.eye(places.shape[2]))


def energy_of(strain: np.ndarray, volumes: np.ndarray, lame: Lame) -> np.ndarray:
    """Return ``int lambda/2 (tr E)^2 + mu E:E dV``, shape (n_e,)."""
    trace, square = np.einsum("eqii->eq", strain), np.einsum("eqij,eqij->eq", strain, strain)
    return np.sum(volumes * (0.5 * lame.first * trace**2 + lame.shear * square), axis=1)


def square(tensor: np.ndarray) -> np.ndarray:
    """Return element matrices (n_e, n_a, d, n_b, d) as (n_e, m, m)."""
    m = tensor.shape[1] * tensor.shape[2]
    return tensor.reshape(-1, m, m)


@pytest.mark.parametrize("kind", KINDS)
def test_the_force_is_the_gradient_of_the_energy_and_the_tangent_its_derivative(kind: str) -> None:
    lame, places = lame_of(kind), distorted(kind)
    geometry, now = Geometry.of(places, reference_element(kind).stiffness), strained(places)
    force = compiled_elements.forces(now, geometry, lame)
    expected = difference(lambda x: compiled_elements.strain_energy(x, geometry, lame), now)
    np.testing.assert_allclose(force, expected, rtol=0, atol=1e-12 * np.abs(force).max())
    np.testing.assert_allclose(
        compiled_elements.strain_energy(now, geometry, lame),
        energy_of(strains(now, geometry), geometry.volumes, lame),
        rtol=1e-13,
    )
    tangent = compiled_elements.tangents(now, geometry, lame)
    expected = difference(lambda x: compiled_elements.forces(x, geometry, lame), now)
    np.testing.assert_allclose(tangent, expected, rtol=0, atol=1e-12 * np.abs(tangent).max())


@pytest.mark.parametrize("kind", KINDS)
def test_the_stiffness_is_the_tangent_at_rest_and_only_rigid_motions_escape_it(kind: str) -> None:
    d, lame, places = dimension_of(kind), lame_of(kind), distorted(kind)
    geometry = Geometry.of(places, reference_element(kind).stiffness)
    stiffness = elasticity.stiffness(geometry, lame)
    size = np.abs(stiffness).max()
    np.testing.assert_allclose(stiffness, compiled_elements.tangents(places, geometry, lame), rtol=0, atol=1e-14 * size)
    matrices = square(stiffness)
    rigid = rigid_rates(places).reshape(-1, *matrices.shape[:2])
    np.testing.assert_allclose(np.einsum("eij,rej->rei", matrices, rigid), 0.0, rtol=0, atol=1e-13 * size)
    values = np.linalg.eigvalsh(matrices)
    n_rigid = d * (d + 1) // 2
    assert np.abs(values[:, :n_rigid]).max() < 1e-13 * size
    # the softest true deformation of these elements has some thousandths of the largest entry; round-off 1e-16
    assert values[:, n_rigid].min() > 1e-4 * size


@pytest.mark.parametrize("kind", KINDS)
def test_large_rigid_motion_gives_no_force_and_turns_what_there_is(kind: str) -> None:
    angle, lame, places = 3.0, lame_of(kind), distorted(kind)
    geometry = Geometry.of(places, reference_element(kind).stiffness)
    stiff = np.abs(elasticity.stiffness(geometry, lame)).max()
    still = turned(places, angle)
    # the places are of the order of 5: round-off of 1e-15 times the stiffness
    np.testing.assert_allclose(compiled_elements.forces(still, geometry, lame), 0.0, rtol=0, atol=1e-13 * stiff)
    np.testing.assert_allclose(compiled_elements.strain_energy(still, geometry, lame), 0.0, rtol=0, atol=1e-25)
    now = strained(places)
    after, force = turned(now, angle), compiled_elements.forces(now, geometry, lame)
    expected = turned(force, angle) - turned(np.zeros_like(force), angle)
    np.testing.assert_allclose(
        compiled_elements.forces(after, geometry, lame), expected, rtol=0, atol=1e-12 * np.abs(force).max()
    )
    np.testing.assert_allclose(
        compiled_elements.strain_energy(after, geometry, lame),
        compiled_elements.strain_energy(now, geometry, lame),
        rtol=1e-12,
    )


@pytest.mark.parametrize("kind", KINDS)
def test_viscous_forces_are_linear_in_the_rates_and_dissipate(kind: str) -> None:
    lame, places = lame_of(kind), distorted(kind)
    geometry, now = Geometry.of(places, reference_element(kind).stiffness), strained(places)
    rates = np.random.default_rng(5).normal(0.0, 1.0, places.shape)
    force = compiled_elements.viscous_forces(now, rates, geometry, lame)
    derivative = compiled_elements.viscous_tangents(now, geometry, lame)
    # linear in the rates, so that the derivative gives the whole force; round-off of one product
    np.testing.assert_allclose(
        force, np.einsum("eaibj,ebj->eai", derivative, rates), rtol=0, atol=1e-13 * np.abs(force).max()
    )
    for a, i in ((0, 0), (1, 1), (places.shape[1] - 1, places.shape[2] - 1)):
        unit = np.zeros_like(rates)
        unit[:, a, i] = 1.0
        more = compiled_elements.viscous_forces(now, rates + unit, geometry, lame)
        np.testing.assert_allclose(more - force, derivative[:, :, :, a, i], rtol=0, atol=1e-12 * np.abs(force).max())
    # E is quadratic in the places: the central difference is its rate along the motion but for round-off
    rate = 0.5 * (strains(now + rates, geometry) - strains(now - rates, geometry))
    power = np.einsum("eai,eai->e", force, rates)
    np.testing.assert_allclose(power, 2 * energy_of(rate, geometry.volumes, lame), rtol=1e-12)
    assert power.min() > 0.0
    values = np.linalg.eigvalsh(square(derivative))
    assert values.min() > -1e-13 * values.max()


@pytest.mark.parametrize("kind", KINDS)
def test_rigid_motion_feels_no_viscous_force(kind: str) -> None:
    """Whatever the strain and wherever the element has turned to; at rest the derivative is the stiffness."""
    lame, places = lame_of(kind), distorted(kind)
    geometry, now = Geometry.of(places, reference_element(kind).stiffness), turned(strained(places), 2.0)
    for rates in rigid_rates(now):
        force = compiled_elements.viscous_forces(now, rates, geometry, lame)
        derivative = compiled_elements.viscous_tangents(now, geometry, lame)
        np.testing.assert_allclose(force, 0.0, rtol=0, atol=1e-12 * np.abs(derivative).max())
    derivative = compiled_elements.viscous_tangents(places, geometry, lame)
    stiffness = elasticity.stiffness(geometry, lame)
    np.testing.assert_allclose(derivative, stiffness, rtol=0, atol=1e-14 * np.abs(stiffness).max())


@pytest.mark.parametrize("kind", KINDS)
def test_the_mass_sums_to_the_volume_and_is_positive_definite(kind: str) -> None:
    element = reference_element(kind)
    d, rule = element.dimension, element.mass
    regular = affine(kind)
    volume = rule.weights.sum() * np.linalg.det(EDGES[:d, :d])
    mass = elasticity.mass(elasticity.volumes_of(regular, rule), rule)
    assert mass.sum() == pytest.approx(volume, rel=1e-13)
    places = distorted(kind)
    volumes = elasticity.volumes_of(places, rule)
    mass = elasticity.mass(volumes, rule)
    np.testing.assert_allclose(mass.sum(axis=(1, 2)), volumes.sum(axis=1), rtol=1e-13)
    np.testing.assert_allclose(mass, mass.swapaxes(1, 2), rtol=0, atol=1e-16)
    values = np.linalg.eigvalsh(mass)
    # fewer points than nodes would leave zero eigenvalues, 1e-16; these have at least a hundredth of the largest
    assert np.all(values[:, 0] > 1e-3 * values[:, -1])


@pytest.mark.parametrize("kind", CURVED)
def test_the_mass_of_every_sound_shape_is_positive_definite(kind: str) -> None:
    """However curved: with positive weights a positive Jacobian is enough, and meshes with another one are refused."""
    element = reference_element(kind)
    regular = affine(kind, 300)
    places = regular + np.random.default_rng(7).uniform(-0.15, 0.15, regular.shape)
    cells = np.arange(places.shape[0] * places.shape[1]).reshape(places.shape[:2])
    gradients = np.concatenate([element.mass.gradients, shape_gradients(kind, element.nodes)])
    sound = jacobian_determinants(places.reshape(-1, element.dimension), cells, gradients).min(axis=1) > 0.0
    assert sound.sum() > 20
    values = np.linalg.eigvalsh(elasticity.mass(elasticity.volumes_of(places[sound], element.mass), element.mass))
    # round-off of eigenvalues is 1e-16 of the largest
    assert np.all(values[:, 0] > 1e-13 * values[:, -1])


@pytest.mark.parametrize("kind", CURVED)
def test_the_volume_of_curved_elements(kind: str) -> None:
    """The divergence theorem over the curved faces: d times the volume is the flux of x through them."""
    element, places = reference_element(kind), distorted(kind)
    face = reference_element(element.face_kind)
    fine = rule_of(element.face_kind, 8)
    corners = places[:, faces_of(kind)]
    points = np.einsum("qa,efai->efqi", fine.values, corners)
    tangents = np.einsum("qja,efai->efqji", fine.gradients, corners)
    if face.dimension == 1:
        normals = np.stack([tangents[..., 0, 1], -tangents[..., 0, 0]], axis=-1)
    else:
        normals = np.cross(tangents[..., 0, :], tangents[..., 1, :])
    flux = np.einsum("efqi,efqi,q->e", points, normals, fine.weights)
    volumes = elasticity.volumes_of(places, element.mass).sum(axis=1)
    stiff = element.stiffness
    np.testing.assert_allclose(Geometry.of(places, stiff).volumes, elasticity.volumes_of(places, stiff), rtol=1e-15)
    # the rule of the mass is exact for the Jacobian's determinant; the flux is a polynomial within the finer rule
    np.testing.assert_allclose(volumes, flux / element.dimension, rtol=1e-13)
