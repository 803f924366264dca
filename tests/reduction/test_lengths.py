"""Parameters that are lengths or places: what is refused, polynomials over them, and one gauge for all their builds."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cantilevers import BEAM_IN_SPACE, IN_SPACE, cantilever
from conftest import ROOT
from length_scenes import CRANK, GUIDE, HIGH, LOW, SMALL, long_crank
from mpi4py import MPI
from refusals import assert_refused, cases, refusal
from runs import built_rom, full_model, rom_of, samples, still
from sealed import resealed

from pgmp_petsc.base.errors import InputError, RunError
from pgmp_petsc.bench.prices import prospects, step_of_samples, step_seconds
from pgmp_petsc.bench.reference import component_model
from pgmp_petsc.bodies.affine import Monomial, Place, evaluate_weights
from pgmp_petsc.ensemble.description import failure_remarks
from pgmp_petsc.ensemble.integration import run_batch
from pgmp_petsc.ensemble.plan import price_of, share_of
from pgmp_petsc.estimates.validity import BodyStrains
from pgmp_petsc.lanes.vectors import LANES
from pgmp_petsc.mechanism.capabilities import Purpose, check_capabilities
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.models import LengthLanes, ReducedModel, SeparateLengths, of_samples
from pgmp_petsc.reduction import length_family
from pgmp_petsc.reduction.rom import ReducedOrderModel, check_samples, check_served, served_ranges
from pgmp_petsc.reduction.rom_file import LengthCheck
from pgmp_petsc.reduction.sample_grid import LengthGrid
from pgmp_petsc.scene.uses import length_names
from pgmp_petsc.stepping.status import Status
from pgmp_petsc.studies import building
from pgmp_petsc.studies.check import describe_scene
from pgmp_petsc.studies.inputs import read_scene, with_meshes
from scenes import mechanism_of, meshes_of

TWO = LengthGrid(("a", "b"), np.array([0.6, -1.0]), np.array([0.8, 2.0]), 4)


@pytest.fixture(scope="module")
def rom() -> ReducedOrderModel:
    return rom_of(long_crank(*SMALL))


def test_monomials_of_places_are_written_read_and_differentiated() -> None:
    weight = Monomial((("E", 1), ("a", 2))) * Monomial((), ((Place("a", 0.7, 0.1), 3),))
    assert Monomial.parse(str(weight)) == weight and weight * Monomial() == weight and weight**0 == Monomial()
    assert weight**2 == weight * weight
    values, h = {"E": 2.0, "a": 0.74, "b": 1.0}, 1e-6
    assert weight.evaluate(values) == pytest.approx(2.0 * 0.74**2 * 0.4**3)
    more, less = (weight.evaluate(values | {"a": 0.74 + side * h}) for side in (1, -1))
    assert weight.derivative("a", values) == pytest.approx((more - less) / (2 * h), rel=1e-8)
    assert weight.derivative("b", values) == 0.0


def test_polynomials_through_the_points_are_exact_for_their_degree_in_both_forms() -> None:
    def table(values: dict[str, float]) -> np.ndarray:
        a, b = values["a"], values["b"]
        return np.array([[[a**3 * b**2 - b, 1.0 + a], [b**3, a * b]]])  # (n, n_terms, ...)

    known, own = [table(point) for point in TWO.points], (Monomial((("E", 1),)), Monomial())
    values = {"a": np.array([0.61, 0.7, 0.93]), "b": np.array([-1.0, 0.3, 1.0]), "E": np.array([2.0, 3.0, 4.0])}
    shares, weights = TWO.shares(values), evaluate_weights(TWO.weights(own), values)
    coefficients = TWO.coefficients(known)[0]
    for k in range(3):
        exact = table({name: float(column[k]) for name, column in values.items()})
        np.testing.assert_allclose(np.tensordot(shares[:, k], np.array(known), 1), exact, rtol=1e-12, atol=1e-12)
        terms = (weights[:, k, None] * coefficients).reshape(2, -1, 2).sum(axis=1)
        np.testing.assert_allclose(terms, exact[0] * np.array([[values["E"][k]], [1.0]]), rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(shares.sum(axis=0), 1.0, rtol=1e-13)
    assert TWO.height(TWO.points[5]) < 1e-12 < TWO.height({"a": 0.7, "b": 0.5}) <= 1.0
    values, h = {"a": 0.74, "b": 0.3}, 1e-4
    more, less = (TWO.shares(values | {"a": 0.74 + side * h}) for side in (1, -1))
    np.testing.assert_allclose(TWO.shares(values, "a"), (more - less) / (2 * h), atol=1e-4)  # of cubics, h^2 / half^3
    assert abs(TWO.shares(values, "b").sum()) < 1e-12 and not TWO.shares(values, "E").any()


def test_the_range_of_a_length_is_what_bounds_and_distribution_have_in_common() -> None:
    scene = long_crank("parameters.rod_length.bounds=[0.6, 0.72]")
    assert length_names(scene) == ("rod_length",)
    assert scene.parameters["rod_length"].range == pytest.approx((LOW, 0.72))
    beta = 'parameters.rod_length={nominal=0.7, distribution={name="beta", a=2.0, b=2.0, loc=0.65, scale=0.1}}'
    assert long_crank(beta).parameters["rod_length"].range == pytest.approx((0.65, 0.75))


@pytest.mark.parametrize(
    ("overrides", "line"),
    cases("""
parameters.rod_length={nominal=0.7, distribution={name="norm", loc=0.7, scale=0.01}} ->
    parameters.rod_length.bounds: missing; bodies.rod.line.length uses it
parameters.rod_length={nominal=0.7} -> parameters.rod_length.bounds: missing
parameters.rod_length={nominal=0.7, bounds=[-0.1, 0.8]} ->
    parameters.rod_length.bounds = [-0.1, 0.8]: must be positive, because bodies.rod.line.length uses it
parameters.rod_length={nominal=0.8, distribution={name="uniform", loc=0.6, scale=0.1}} ->
    parameters.rod_length.nominal = 0.8: must lie inside [0.6, 0.7]
parameters.r1.bounds=[1e-3, 12e-3] & bodies.crank.line.length="r1" ->
    parameters.r1: bodies.crank.line.length and bodies.crank.section.radius use it
reduction.length_points=8 & OF_GUIDE & bodies.crank.line.length="height" -> bodies.crank.line.length uses it
fields.stiff={body="rod", quantity="E", variation=0.1, length=0.3, terms=2} -> its length is the parameter rod_length
bodies.rod.line.length="rod" -> there is no such parameter
bodies.rod.line.start="rod_length" -> numbers are needed, no parameter: it moves the axes
ground.points.guide=[0.0, true] -> two finite numbers in brackets (three in space) are needed
parameters.rod_length.unit="kg" -> bodies.rod.line.length uses it
reduction.length_points=1 -> reduction.length_points = 1:
reduction.length_points=9 -> reduction.length_points = 9: must be at most 8
"""),
)
def test_a_length_that_cannot_be_a_parameter_is_refused(overrides: str, line: str) -> None:
    assert line in refusal(long_crank, *overrides.replace("OF_GUIDE", " & ".join(GUIDE[1:3])).split(" & "))


@pytest.mark.parametrize(
    ("override", "purpose", "line"),
    [
        ("simulation.tolerance=0.01", Purpose.FULL, "simulation.tolerance finds the step of one mechanism"),
        ("simulation.tolerance=0.01", Purpose.REDUCED, "pgmp build finds one for the extreme lengths too"),
        ('reduction.effects="auto"', Purpose.BUILD, "effects are chosen for one mechanism"),
    ],
)
def test_what_needs_one_mechanism_is_refused_by_name(override: str, purpose: Purpose, line: str) -> None:
    scene = long_crank(override)
    message = refusal(check_capabilities, scene, purpose)
    assert message.startswith('bodies.rod.line.length = "rod_length": ') and line in message
    check_capabilities(long_crank(), Purpose.BUILD)


def test_component_ensembles_and_more_builds_than_are_made_are_refused() -> None:
    components = component_model(*with_meshes(long_crank(*SMALL), Purpose.COMPONENTS), MPI.COMM_SELF)
    assert_refused("parameters.rod_length: .* component modes are of one mesh", of_samples, components, ["rod_length"])
    law = "parameters.rod_length.distribution={name='norm',loc=0.7,scale=0.01}"
    scene, meshes = with_meshes(long_crank(*SMALL, law), Purpose.CHECK)
    mechanism = Mechanism.from_scene(scene, meshes)
    mesh, refused, _ = prospects(scene, meshes, mechanism, 6, 0)
    assert "component modes are of one mesh" in refused.refused and mesh.step > step_seconds(mechanism)
    spans = [f"parameters.{name}={{nominal=0.0, bounds=[-0.1, 0.1]}}" for name in "xyz"]
    assert re.search(
        "reduction.length_points = 5: of 4 lengths, places and ratios .* make 625 builds; at most",
        refusal(long_crank, 'ground.points={guide=["x", "y"], a=["z", 0.0]}', *spans),
    )


def test_samples_of_lengths_take_several_times_a_batch_s_but_those_on_cells() -> None:
    place = 'parameters.height={nominal=0.0,unit="m",bounds=[-0.01,0.01],distribution={name="norm",loc=0.0,scale=1e-3}}'
    for name, least, most in (("slider_crank", 3.0, 8.0), ("slider_crank_solid2d", 0.9, 1.6)):
        given = (place, "ground.points.guide=[0.0,'height']", "joints.slider.connect=['ground:guide','rod:tip']")
        scene, meshes = read_scene(ROOT / "scenes" / f"{name}.toml", given, (), MPI.COMM_SELF, Purpose.CHECK)
        bodies = Mechanism.from_scene(scene, meshes).bodies
        assert least < step_of_samples(scene, 1.0, bodies) < most


def test_nothing_is_served_outside_the_range_of_a_length(rom: ReducedOrderModel) -> None:
    built = long_crank(*SMALL)
    served = served_ranges(built, rom)
    assert (served["rod_length"].least, served["rod_length"].high) == pytest.approx((LOW, HIGH))
    assert check_served(served, long_crank(*SMALL, settings=(f"rod_length={LOW}",))) == ()
    wider = "parameters.rod_length.bounds=[0.6, 0.8]"
    with pytest.raises(InputError, match="parameters.rod_length.value = 0.66: beyond what the model serves"):
        check_served(served, long_crank(wider, "parameters.rod_length.distribution={name='uniform', loc=0.6, "
                                        "scale=0.2}", settings=("rod_length=0.66",)))  # fmt: skip
    ends = f"{{nominal=0.7, unit='m', distribution={{name='discrete', values=[{LOW}, 0.7, {HIGH}]}}}}"
    assert check_served(served, long_crank(*SMALL, f"parameters.rod_length={ends}")) == ()
    shifted = 'parameters.rod_length.distribution={name="uniform", loc=0.66, scale=0.07}'
    assert_refused("serves no length, place or ratio", check_served, served, long_crank(wider, shifted))
    with pytest.raises(InputError, match="samples are beyond what the model serves"):
        check_samples(served, {"rod_length": np.array([0.7, 0.74])}, "--samples")


def test_the_kinematics_of_a_length_are_exact_and_the_file_keeps_the_family(
    rom: ReducedOrderModel, tmp_path: Path
) -> None:
    rom.write(tmp_path / "rom.h5")
    again = ReducedOrderModel.read(tmp_path / "rom.h5")
    assert again.identity == rom.identity and again.family.grid.points == rom.family.grid.points
    assert vars(again.family.check) == vars(rom.family.check)
    scene = long_crank(*SMALL, settings=("rod_length=0.6732",))
    for found in (rom, again):
        model = ReducedModel(scene, found)
        theta = np.linspace(0.0, 6.0, 7)
        eta = np.zeros((7, model.rom.tables.n_modes + 1))
        eta[:, 0] = theta
        outputs = model.outputs.evaluate(model.observed_of(0.0, still(eta), scene.values))
        exact = CRANK * np.cos(theta) + np.sqrt(0.6732**2 - (CRANK * np.sin(theta)) ** 2)
        # the loops are closed to 1e-12 of the mechanism's size
        np.testing.assert_allclose(outputs["slider_position"], exact, rtol=1e-11)
        np.testing.assert_allclose(outputs["slider_deformation"], 0.0, atol=1e-11)


@pytest.fixture(scope="module")
def gauge(rom: ReducedOrderModel) -> length_family._Gauge:
    return length_family._Gauge.of(long_crank(*SMALL), rom)


def test_the_basis_that_a_build_came_with_has_no_part_in_the_tables(
    rom: ReducedOrderModel, gauge: length_family._Gauge
) -> None:
    member, point = rom.family.members[0], rom.family.grid.points[0]
    m = member.tables.n_modes
    mixed = np.linalg.qr(np.random.default_rng(5).normal(size=(m, m)))[0] @ np.diag(np.linspace(1.0, 2.0, m))
    rotations = np.broadcast_to(mixed, (member.tables.samples.n, m, m))
    other = replace(member, tables=member.tables.turned(rotations), projection=member.projection @ rotations)
    found, cosine = gauge.turned(long_crank(*SMALL).with_values(point), other)
    assert 0.9 < cosine <= 1.0
    # of matrices with a condition of 2 and less, and the Gram matrix of a basis
    for name in ("mass", "inertia", "stiffness", "load"):
        expected = getattr(member.tables, name)
        np.testing.assert_allclose(getattr(found.tables, name), expected, atol=1e-9 * np.abs(expected).max())
    np.testing.assert_allclose(found.projection, member.projection, atol=1e-9 * np.abs(member.projection).max())


def test_models_that_do_not_fit_together_are_refused_with_the_length(
    rom: ReducedOrderModel, gauge: length_family._Gauge, tmp_path: Path
) -> None:
    member = rom.family.members[0]
    fewer = replace(member, projection=member.projection[:, :, 1:])
    line = "^at rod_length = 0.7 m: 7 vectors over 12 configurations, 8 over 12 at the nominal lengths"
    modes, angles = "another number of reduction.modes", "more reduction.angles"
    # the likelier first: neighbouring angles tell whether modes were followed from one to the next
    for cosine, first, second in ((0.7, angles, modes), (0.99, modes, angles)):
        with pytest.raises(RunError, match=f"{line}.*take {first}, or {second}, or a narrower range$"):
            told = replace(gauge, model=replace(gauge.model, cosines=np.array([cosine])))
            told.turned(long_crank(*SMALL), replace(fewer, cosines=np.array([1.0])))
    # the one between the points, which is compared alone, too
    whole, scene = replace(member, meshes=rom.meshes), long_crank(*SMALL)
    built = iter([whole, whole, whole, replace(fewer, meshes=rom.meshes)])
    with pytest.raises(RunError, match="at rod_length = 0.684.*: 7 vectors over 12 configurations"):
        length_family.build_over_lengths(scene, meshes_of(scene), lambda *_: next(built), MPI.COMM_SELF)
    rom.write(path := tmp_path / "rom.h5")
    with resealed(path) as file:
        shorter = file["lengths/1/projection"][:, 3:]
        del file["lengths/1/projection"]
        file["lengths/1/projection"] = shorter
    assert_refused("lengths: members '1': projection has shape .*build it again", ReducedOrderModel.read, path)


def test_spaces_and_matrices_that_are_poor_between_lengths_are_warned_of(rom: ReducedOrderModel) -> None:
    scene = long_crank(*SMALL)
    said = length_family._remarks(scene, rom.family, 4, 0.3, "the interpolated mass matrix is not positive definite")
    assert [remark.kind for remark in said[1:]] == ["warning", "warning"]
    assert "turns away between lengths (least cosine 0.3" in said[1].text
    assert said[2].text.startswith("between lengths: the interpolated mass matrix")
    ratio = long_crank(*SMALL, 'parameters.rod_length.unit=""')
    assert "rod_length from 0.665 to 0.735 are" in length_family._remarks(ratio, rom.family, 4, 0.9, "")[0].text
    (poor,) = length_family._remarks(
        scene, replace(rom.family, check=LengthCheck(np.array([0.68]), 2e-3, 1e-9)), 4, 0.9, ""
    )
    assert poor.kind == "warning" and "frequencies are within 0.002" in poor.text
    assert poor.text.endswith("take more reduction.length_points, or a narrower range")


def test_a_mechanism_that_does_not_close_at_a_length_is_refused_with_it() -> None:
    scene = long_crank(*SMALL, "parameters.rod_length={nominal=0.7, bounds=[0.2, 1.2]}")
    with pytest.raises(InputError, match=r"^at rod_length = 0.266987 m: joints.slider: .* cannot close") as refused:
        built_rom(scene)
    assert "The model spans the whole range of rod_length: narrow the bounds, or take --full" in str(refused.value)
    meshes = meshes_of(scene)
    *_, reduced = prospects(scene, meshes, Mechanism.from_scene(scene, meshes), 4, 1)
    assert reduced.refused == str(refused.value) and not reduced.build, "what is refused has no price"
    with pytest.raises(InputError, match=re.escape(reduced.refused)):  # before anything is solved
        building._check_ahead(scene, meshes)
    scene = long_crank(*SMALL, "parameters.rod_length={nominal=0.25, bounds=[0.2, 1.2]}")
    with pytest.raises(InputError, match=r"^at rod_length = 0.25 m: joints.slider: .* cannot close") as refused:
        built_rom(scene)
    assert "whole range" not in str(refused.value)


def test_whether_a_mechanism_closes_at_all_lengths_is_found_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """However often a command asks, of scenes that it reads again too; a scene with other entries is another."""
    closed, close = [], length_family.RigidKinematics
    monkeypatch.setattr(length_family, "RigidKinematics", lambda *own, **how: closed.append(own) or close(*own, **how))
    for length, n in ((0.71, 1), (0.71, 1), (0.72, 2)):
        scene = long_crank(*SMALL, f"parameters.rod_length={{nominal={length}, bounds=[0.6, 0.8]}}")
        assert not length_family.why_no_family(scene, meshes_of(scene))
        assert len(closed) == n * (1 + len(LengthGrid.of(scene).points))


def test_a_sample_that_does_not_close_is_a_record_and_not_the_end_of_the_others() -> None:
    """Of full-order samples, each of its own lengths; what an ensemble says of them names the length."""
    model = of_samples(full_model(long_crank("simulation={duration=2e-3,step=1e-3}")), ["rod_length"])
    values = {name: np.full(1, value) for name, value in model.scene.nominal.items()}
    for length, status in ((0.7, Status.FINE), (0.2, Status.UNPHYSICAL), (0.71, Status.FINE)):
        assert run_batch(model, values | {"rod_length": np.full(1, length)}).status == [status]
    said = failure_remarks(np.array([Status.UNPHYSICAL, 0]), {}, {}, model.name, lengths=model.lengths)[0].text
    assert "a mechanism of its rod_length cannot be put together over its range, as pgmp check SCENE --set" in said
    for low, told in ((0.1, True), (0.69, False)):  # at a fifth of what is drawn
        law = f"parameters.rod_length={{nominal=0.7,distribution={{name='uniform',loc={low},scale={0.75 - low}}}}}"
        described = describe_scene(*with_meshes(long_crank(*SMALL, law), Purpose.CHECK))
        assert ("samples fail whose mechanism cannot be put together, as with rod_length = 0.23" in described) == told


def test_a_model_of_other_lengths_than_its_own_is_not_run(rom: ReducedOrderModel) -> None:
    scene = long_crank(*SMALL)
    for model in (full_model(scene), ReducedModel(scene, rom)):
        with pytest.raises(ValueError, match="the model is that of 0.7"):
            model.batch(samples(scene, 1, rod_length=0.68), 1)
    model = full_model(scene)
    assert isinstance(of_samples(model, ["rod_length"]), SeparateLengths)
    assert type(of_samples(model, ["r1"])) is type(model)


def test_reduced_samples_lie_in_lanes_and_a_quarter_of_their_time_buys_fewer_estimates(rom: ReducedOrderModel) -> None:
    model = ReducedModel(long_crank(*SMALL, "simulation.duration=1.0"), rom)
    lanes = of_samples(model, ["rod_length"])
    assert isinstance(lanes, LengthLanes) and of_samples(model, ["r1"]) is model
    # one in a vector of samples, and a mechanism that is placed anew
    assert 0.0 < share_of(lanes) < share_of(model) and price_of(lanes) > LANES * price_of(model)


def test_a_stress_where_a_shorter_body_has_none_is_refused_with_the_length(rom: ReducedOrderModel) -> None:
    beyond = 'outputs.tip={type="stress", body="rod", quantity="bending_moment", at=[0.695, 0.0]}'
    model = ReducedModel(long_crank(*SMALL, beyond), rom)
    with pytest.raises(
        InputError, match=r"^at rod_length = 0.66\d* m, where the models of all lengths begin: outputs.tip"
    ):
        of_samples(model, ["rod_length"])


BEAMS = {
    "in the plane": (long_crank(), "rod", "rod_length"),
    "in space": (
        cantilever(
            BEAM_IN_SPACE.replace("length = 1.0", 'length = "l"'),
            "[parameters.l]\nnominal = 1.0\nbounds = [0.9, 1.1]\n",
            IN_SPACE,
        ),
        "beam",
        "l",
    ),
}


@pytest.mark.parametrize("curved", [False, True])
@pytest.mark.parametrize("kind", list(BEAMS))
def test_strains_of_samples_are_those_of_elements_of_their_own_lengths(kind: str, curved: bool) -> None:
    scene, body, name = BEAMS[kind]
    lengths = scene.values[name] * np.array([0.96, 1.0, 1.04])
    mechanism = mechanism_of(scene)
    shape = (2 * lengths.size, mechanism.n_nodes, mechanism.space.n_dofs)  # two states of each
    local = 1e-3 * np.random.default_rng(3).normal(size=shape)
    values = samples(scene, lengths.size, **{name: lengths})
    rotation, strain = BodyStrains(scene, mechanism, values, curved).largest(local)
    for k, length in enumerate(lengths):
        own = scene.with_values({name: float(length)})
        strains = BodyStrains(own, mechanism_of(own), own.values, curved)
        for found, exact in zip((rotation, strain), strains.largest(local[k :: lengths.size])):
            np.testing.assert_allclose(found[k :: lengths.size], exact, rtol=1e-12)
    assert mechanism.bodies[-1].name == body and np.all(strain > 0.0)


def test_vectors_of_other_parameters_are_of_the_same_values_at_all_lengths() -> None:
    """At 0.652 m a search of its own takes two radii and 768 angles, which fitted no other length."""
    wide = "parameters.rod_length={nominal=0.7, bounds=[0.6327, 0.7673]}"
    few = "reduction.length_points=2", "reduction.second_order=false"
    rom = rom_of(long_crank(wide, "reduction.parameter_modes=2", *few))
    low, high = rom.family.members
    assert low.points.n_vectors == high.points.n_vectors == rom.points.n_vectors == 2
    for member in (low, high):
        np.testing.assert_array_equal(member.points.values["r1"], rom.points.values["r1"])
        np.testing.assert_array_equal(member.tables.samples.theta, rom.tables.samples.theta)
    lengths = [np.unique(member.points.values["rod_length"]) for member in (low, rom, high)]
    np.testing.assert_allclose(np.concatenate(lengths), [0.652411, 0.7, 0.747589], atol=1e-6)


def test_angles_are_doubled_until_the_stiffness_is_definite_between_them() -> None:
    """With 96 angles a crank one deviation thinner ran away at 0.067 s: vectors of other radii turn at dead centres."""
    shorter = ("bodies.rod.line.length=0.66", "reduction.parameter_modes=2", "reduction.second_order=false")
    shorter += ("reduction.modes=2",)
    rom = rom_of(long_crank(*shorter))
    assert not rom.indefinite and rom.tables.samples.n == 192
    few = long_crank(*shorter, "reduction.max_angles=96")
    assert "stiffness matrix is not positive definite" in rom_of(few).indefinite
