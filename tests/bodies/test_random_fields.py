"""Random fields: their parameters, what is refused, and the matrices of bodies that they are over."""

from dataclasses import replace

import numpy as np
import pytest
from runs import PAPER_SCENE
from scipy.optimize import brentq
from solid_scenes import solid_meshes, solid_slider_crank
from solids import third_of
from spatial_beams import slider_crank_of_beams

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.bodies import random_fields
from pgmp_petsc.bodies.body import Body
from pgmp_petsc.bodies.framed_solid import framed_solid
from pgmp_petsc.bodies.matrices import AffineMatrices, ThirdDerivative, inertia_moments, weighted_sum
from pgmp_petsc.bodies.profile import UNIFORM
from pgmp_petsc.bodies.random_fields import checked_expansion, correlation, expansion, field_remarks, profiles_of
from pgmp_petsc.bodies.sections.section import BeamSection
from pgmp_petsc.ensemble.plan import Plan
from pgmp_petsc.ensemble.sampling import Sampler, draw_remarks
from pgmp_petsc.scene import Scene, load_scene, scene_from_toml, scene_to_toml
from scenes import mechanism_of, meshes_of, slider_crank

FIELD = 'fields.soft={body="rod", quantity="E", variation=0.1, length=0.3, terms=3}'
HEAVY = 'fields.heavy={body="rod", quantity="rho", variation=0.05, length=0.5, terms=2, distribution="uniform"}'
VALUES = {"soft_1": 1.3, "soft_2": -0.7, "soft_3": 2.0, "heavy_1": -1.2, "heavy_2": 0.4}


def of(*overrides: str) -> Scene:
    return slider_crank(FIELD, HEAVY, *overrides)


def refused(*overrides: str) -> str:
    with pytest.raises(InputError) as error:
        scene = of(*overrides)
        profiles_of(scene, "rod", meshes_of(scene)["rod"])
    return str(error.value)


def test_variables_are_parameters_of_variance_one() -> None:
    scene = of()
    assert set(VALUES) <= set(scene.parameters)
    drawn = Sampler(scene, Plan(4000, 1)).draw(0, 4000)
    for name in VALUES:
        low, high = scene.parameters[name].bounds
        assert low <= drawn[name].min() and drawn[name].max() <= high
        # the deviation of the variance of 4000 samples is 2.2 % for a normal variable, less for others
        assert drawn[name].var() == pytest.approx(1.0, abs=0.1)
    assert not any("soft" in remark.text for remark in draw_remarks(scene))


def test_the_resolved_scene_reads_back_unchanged_and_takes_values() -> None:
    scene = of()
    again = scene_from_toml(scene_to_toml(scene), ".", (), ("soft_2=0.5",))
    assert again.values["soft_2"] == 0.5
    assert scene_from_toml(scene_to_toml(scene), ".") == scene
    assert scene_from_toml(scene_to_toml(again), ".") == again


@pytest.mark.parametrize(
    ("override", "line"),
    [
        ('fields.soft.body="rud"', "fields.soft.body = \"rud\": there is no such body; did you mean 'rod'?"),
        ("bodies.rod.flexible=false", 'fields.soft.body = "rod": is rigid; a field needs a flexible body'),
        ('fields.soft.quantity="radius"', "stiffness and mass are not affine in a field of it; give fields of E and"),
        ('fields.soft.quantity="width"', 'fields.soft.quantity = "width": of a beam2d: stiffness and mass are not'),
        ('fields.soft.quantity="thickness"', 'fields.soft.quantity = "thickness": of a beam2d'),
        ('fields.soft.quantity="nu"', 'fields.soft.quantity = "nu": unknown (allowed: E, rho, width, thickness'),
        ('fields.soft.kernel="matern"', "fields.soft.smoothness: missing; needed: smoothness of the kernel matern"),
        ("fields.soft.smoothness=1.5", 'fields.soft.smoothness = 1.5: for the kernel "matern" only'),
        ("fields.soft.length=0.0", "fields.soft.length = 0.0: must be greater than 0.0"),
        ("fields.soft.terms=0", "fields.soft.terms = 0: must be at least 1"),
        ("fields.soft.terms=101", "fields.soft.terms = 101: must be at most 100"),
        ("fields.soft.terms=6", "fields.soft.terms = 6: rod has 5 cells, and no more terms; take fewer, or a finer"),
        ("fields.soft.least_share=0.95", "less than fields.soft.least_share = 0.95; take 4, or a longer correlation"),
        ("fields.soft.variation=0.4", "E of rod may fall to"),
        ('fields.heavy.quantity="E"', 'fields.heavy.quantity = "E": fields.soft is of the same body already'),
        ("parameters.soft_1.nominal=0.0", "parameters.soft_1: is variable 1 of fields.soft; leave the table out"),
        ("correlation.soft_1={heavy_1=0.5}", "soft_1 is a variable of fields.soft, all uncorrelated"),
    ],
)
def test_a_field_that_cannot_be_is_refused_with_the_cure(override: str, line: str) -> None:
    assert line in refused(override)


def test_a_scaled_section_and_a_field_are_refused_together() -> None:
    scale = "bodies.rod.section_scale=1.1"
    with pytest.raises(InputError, match="its section_scale changes the mesh that the field is over"):
        solid_slider_crank(FIELD, scale)


def test_no_variables_within_their_bounds_make_a_quantity_negative_and_the_message_says_what_may_be() -> None:
    text = refused("fields.soft.variation=0.4")
    most = float(text.partition("take at most ")[2].partition(",")[0])
    for variation, fine in ((0.999 * most, True), (1.002 * most, False)):
        scene = of(f"fields.soft.variation={variation}")
        mesh = meshes_of(scene)["rod"]
        if not fine:
            with pytest.raises(InputError, match="may fall to"):
                checked_expansion(scene, "soft", mesh)
            continue
        functions = checked_expansion(scene, "soft", mesh).functions
        reach = scene.parameters["soft_1"].bounds[1]
        least = min(
            1.0 + variation * float(reach * np.sign(functions[:, cell]) @ functions[:, cell]) * sign
            for cell in range(functions.shape[1])
            for sign in (-1.0, 1.0)
        )
        # three digits are shown of what may be
        assert least == pytest.approx(0.01, abs=2e-2)


def test_what_is_kept_and_left_out_is_said() -> None:
    scene = of()
    said = [str(remark) for remark in field_remarks(scene, meshes_of(scene))]
    assert said[0].startswith("note: fields.soft: 3 terms keep 8") and "% of the variance of E over rod" in said[0]
    coarse = of("fields.soft.length=0.1")
    said = [str(remark) for remark in field_remarks(coarse, meshes_of(coarse))]
    assert said[0].startswith("warning: fields.soft: 3 terms keep") and "take more fields.soft.terms" in said[0]
    assert said[1].startswith("warning: fields.soft.length = 0.1: cells of rod are up to 0.14 m long")


def uniform_elements(body: Body, values: dict[str, float]) -> list[Body]:
    """Return a body's elements as uniform bodies whose constants are those of the field there."""
    stiff, heavy = (
        1.0 + sum(float(weight.evaluate(values)) * part for weight, part in profile.terms.items())
        for profile in (body.profiles.modulus, body.profiles.density)
    )
    found = []
    for number, cell in enumerate(body.mesh.cells):
        section = body.section
        scaled = BeamSection(
            tuple(float(stiff[number]) * part for part in section.stiffness),
            tuple(float(heavy[number]) * part for part in section.mass),
        )
        mesh = replace(body.mesh, cells=cell[None])
        found.append(replace(body, mesh=mesh, section=scaled, profiles=UNIFORM))
    return found


def test_matrices_of_planar_beams_are_those_of_elements_with_their_own_constants() -> None:
    scene = of()
    values = scene.values | VALUES
    (body,) = (body.alone() for body in mechanism_of(scene).bodies if body.name == "rod")
    rows = range(body.dofs.size)
    whole = AffineMatrices([body], rows)
    parts = [AffineMatrices([part], rows) for part in uniform_elements(body, values)]
    for kind in ("mass", "stiffness"):
        expected = sum(weighted_sum(getattr(part, kind), values).toarray() for part in parts)
        found = weighted_sum(getattr(whole, kind), values).toarray()
        np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12 * np.abs(expected).max())
    moments = inertia_moments(body)
    for i in range(2):
        found = sum(float(weight.evaluate(values)) * part for weight, part in moments.items())[3 * i * body.dofs.size :]
        place = np.arange(i, body.dofs.size, 3)
        expected = weighted_sum(whole.mass, values).toarray()[np.ix_(place, place)]
        np.testing.assert_allclose(found.toarray()[np.ix_(place, place)], expected, rtol=1e-12, atol=1e-15)
    vectors, pairs = np.random.default_rng(1).standard_normal((body.dofs.size, 2)), (np.array([0]), np.array([1]))
    found = ThirdDerivative([body], rows).weighted(vectors, pairs, values)
    expected = sum(
        ThirdDerivative([part], rows).weighted(vectors, pairs, values) for part in uniform_elements(body, values)
    )
    np.testing.assert_allclose(found, expected, rtol=1e-10, atol=1e-10 * np.abs(expected).max())
    by_weight = ThirdDerivative([body], rows).times(vectors, pairs)
    summed = sum(float(weight.evaluate(values)) * part for weight, part in by_weight.items())
    np.testing.assert_allclose(summed, found, rtol=1e-10, atol=1e-10 * np.abs(expected).max())


def test_matrices_of_beams_in_space_are_scaled_element_by_element() -> None:
    scene = slider_crank_of_beams(FIELD.replace("0.1,", "0.15,"))
    values = scene.values | {"soft_1": 1.3, "soft_2": -0.7, "soft_3": 2.0}
    body = next(body for body in mechanism_of(scene).bodies if body.name == "rod")
    every = np.arange(len(body.mesh.cells))
    uniform = replace(body, profiles=UNIFORM)
    factor = 1.0 + sum(float(w.evaluate(values)) * part for w, part in body.profiles.modulus.terms.items())
    assert np.ptp(factor) > 0.05
    (found, expected) = (
        sum(float(weight.evaluate(values)) * part for weight, part in one.of_elements("stiffness", every).items())
        for one in (body, uniform)
    )
    np.testing.assert_allclose(found, factor[:, None, None] * expected, rtol=1e-12)
    assert set(body.weights("stiffness")) == set(body.of_elements("stiffness", every))
    assert set(body.weights("mass")) == set(uniform.weights("mass"))


def test_matrices_of_cells_are_those_of_a_mesh_with_a_region_for_every_cell() -> None:
    scene = solid_slider_crank(
        FIELD, 'fields.thin={body="rod", quantity="thickness", variation=0.1, length=1, terms=2}'
    )
    values = scene.values | {"soft_1": 1.3, "soft_2": -0.7, "soft_3": 2.0, "thin_1": 0.9, "thin_2": -1.1}
    solid = framed_solid(scene, "rod", solid_meshes("quad8", 12)["rod"]).solid
    stiff, mass = (
        1.0 + sum(float(w.evaluate(values)) * part for w, part in solid.profiles.of(kind).terms.items())
        for kind in ("stiffness", "mass")
    )
    (region,) = solid.regions
    regions = tuple(
        replace(
            region, cells=np.array([cell]), modulus=stiff[cell] * region.modulus, density=mass[cell] * region.density
        )
        for cell in region.cells
    )
    nodes = range(solid.mesh.n_nodes)
    for kind in ("stiffness", "mass"):
        found, expected = (
            sum(float(weight.evaluate(values)) * part for weight, part in getattr(one, kind)(nodes).items()).toarray()
            for one in (solid, replace(solid, regions=regions, profiles=UNIFORM))
        )
        np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12 * np.abs(expected).max())
        assert solid.weights(kind) == set(getattr(solid, kind)(nodes))
    fields = np.random.default_rng(2).standard_normal((solid.mesh.n_nodes, 2, 3))
    third, apart = (third_of(one, fields) for one in (solid, replace(solid, regions=regions, profiles=UNIFORM)))
    found = sum(float(weight.evaluate(values)) * part for weight, part in third.items())
    expected = sum(float(weight.evaluate(values)) * part for weight, part in apart.items())
    np.testing.assert_allclose(found, expected, rtol=1e-10, atol=1e-10 * np.abs(expected).max())


def test_rigid_bodies_of_a_shipped_scene_have_no_field_and_a_width_has_one() -> None:
    rectangle = 'bodies.rod.section={shape="rectangle", width=0.01, height=0.01}'
    scene = load_scene(PAPER_SCENE, (rectangle, FIELD.replace('"E"', '"width"')))
    profiles = profiles_of(scene, "rod", meshes_of(slider_crank())["rod"])
    assert profiles.stiffness.terms.keys() == profiles.mass.terms.keys() and not profiles.modulus


def closed_form(extent: float, length: float, n: int) -> np.ndarray:
    """Return eigenvalues of the exponential kernel on an interval (Ghanem and Spanos 1991, section 2.3.3)."""
    a, c = 0.5 * extent, 1.0 / length
    found = []
    for k in range(n):
        # c - w tan(w a) = 0 of even functions, w + c tan(w a) = 0 of odd ones, each in its own quarter turns
        even = k % 2 == 0
        low, high = k * np.pi / 2, (k + 1) * np.pi / 2
        equation = (
            (lambda x: c * a * np.cos(x) - x * np.sin(x)) if even else (lambda x: x * np.cos(x) + c * a * np.sin(x))
        )
        w = brentq(equation, low + 1e-12, high) / a
        found.append(2.0 * c / (w**2 + c**2))
    return np.array(found)


def on_interval(
    n_cells: int, kernel: str = "exponential", length: float = 0.4, smoothness: float = 0.5, n_terms: int = 6
):
    ends = np.linspace(0.0, 1.0, n_cells + 1)
    return expansion(0.5 * (ends[1:] + ends[:-1])[:, None], np.diff(ends), kernel, length, smoothness, n_terms)


def test_eigenvalues_of_the_exponential_kernel_are_those_of_the_closed_form_to_second_order() -> None:
    exact = closed_form(1.0, 0.4, 6)
    off = [np.abs(on_interval(n).shares / exact - 1.0).max() for n in (40, 80, 160)]
    assert off[2] < 1e-3
    assert np.log2(off[0] / off[1]) == pytest.approx(2.0, abs=0.2)
    assert np.log2(off[1] / off[2]) == pytest.approx(2.0, abs=0.2)


def test_functions_are_orthonormal_and_all_of_them_make_the_covariance() -> None:
    places, volumes = np.random.default_rng(1).random((30, 2)), np.random.default_rng(2).random(30)
    found = expansion(places, volumes, "matern", 0.5, 1.5, 30)
    apart = np.linalg.norm(places[:, None] - places, axis=2) / 0.5
    assert np.allclose(found.functions.T @ found.functions, correlation("matern", apart, 1.5), atol=1e-9)
    gram = (found.functions * volumes) @ found.functions.T
    assert np.allclose(gram, np.diag(found.shares * volumes.sum()), atol=1e-9)
    assert found.kept == pytest.approx(1.0, abs=1e-9)
    assert np.allclose(found.deviations, 1.0, atol=1e-9)


def test_a_factor_that_ends_early_has_the_eigenvalues_of_the_whole_matrix(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = on_interval(400, length=0.21, n_terms=5)
    monkeypatch.setattr(random_fields, "NUMBERS", 0)
    monkeypatch.setattr(random_fields, "OVERSAMPLING", 60)
    part = on_interval(400, length=0.2100001, n_terms=5)
    # Between the middles of the pivots' cells the exponential kernel leaves a Brownian bridge of variance h / (3 l) on
    # average and nothing else (it is Markov's): eigenvalues fall by at most the trace of a piece. Pivots halve the
    # largest gap, so that 65 of them leave none beyond a 32nd.
    assert np.all(part.shares < whole.shares)
    assert np.allclose(part.shares, whole.shares, rtol=0.0, atol=(1.0 / 32.0) ** 2 / (3.0 * 0.21))


@pytest.mark.parametrize(("counts", "most"), [((12, 12), 144), ((6, 6, 6), 216), ((9, 9), 40), ((4, 4, 20), 100)])
def test_round_off_has_no_choice_of_terms_of_one_eigenvalue(
    monkeypatch: pytest.MonkeyPatch, counts: tuple[int, ...], most: int
) -> None:
    """Of a plate's second and third term any rotation is one too. The last one here has an eigenvalue of several terms
    that are not asked for, and where the factor ends early, many cells could be its next one."""
    monkeypatch.setattr(random_fields, "NUMBERS", 0)
    monkeypatch.setattr(random_fields, "OVERSAMPLING", most)
    places = np.stack([axis.ravel() for axis in np.meshgrid(*map(np.arange, counts), indexing="ij")], axis=1) + 0.5
    volumes, random = np.ones(len(places)), np.random.default_rng(3)
    one = expansion(places, volumes, "exponential", 5.0, 0.5, 2).functions
    moved = expansion(
        places * (1.0 + 1e-15 * random.standard_normal(places.shape)), volumes, "exponential", 5.0, 0.5, 2
    )
    np.testing.assert_allclose(moved.functions, one, atol=1e-10)
    if most == len(places):
        order = random.permutation(len(places))
        other = expansion(places[order], volumes, "exponential", 5.0, 0.5, 2).functions
        signs = np.sign(np.sum(one[:, order] * other, axis=1, keepdims=True))  # that of the first cell
        np.testing.assert_allclose(signs * other, one[:, order], atol=1e-10)


def test_kernels_meet_in_their_limits() -> None:
    r = np.linspace(0.0, 3.0, 31)
    assert np.allclose(correlation("matern", r, 0.5), correlation("exponential", r))
    z = np.sqrt(3.0) * r
    assert np.allclose(correlation("matern", r, 1.5), (1.0 + z) * np.exp(-z))
    # of s = 20 the next term of the limit is of the order r^4 / (8 s)
    assert np.allclose(correlation("matern", r, 20.0), correlation("squared_exponential", r), atol=0.02)
