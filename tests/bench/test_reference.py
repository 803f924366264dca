"""What errors are measured against: the mesh, or the component model where it is too dear; its price and distance."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from combinations import meshes_for, scene_of
from conftest import ROOT
from elastic_scenes import MACHINE
from mpi4py import MPI
from refusals import refusal
from runs import full_model, reduced_model

from pgmp_petsc.api.jobs import _Job
from pgmp_petsc.base.errors import InputError
from pgmp_petsc.bench import reference
from pgmp_petsc.bench.history import errors_between, floors_of, run_history
from pgmp_petsc.bench.prices import (
    FORCES,
    FORCES_IN_LANES,
    OUTPUT,
    POSE,
    PULLED,
    STRAIN,
    Price,
    Prospect,
    build_seconds,
    coefficients,
    duration_text,
    n_strains,
    prospects,
    quicker,
    step_seconds,
)
from pgmp_petsc.bench.reference import (
    CHECK_SHARE,
    FEWEST_STEPS,
    Demand,
    Reference,
    choose_reference,
    component_model,
    distance_from_mesh,
    first_period,
    period_of,
)
from pgmp_petsc.mechanism.capabilities import Purpose
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.models import ComponentModel, FullModel
from pgmp_petsc.scene import Scene, scene_from_toml, scene_to_toml
from pgmp_petsc.studies.inputs import read_scene
from scenes import meshes_of, slider_crank

SELF = MPI.COMM_SELF
STEPS = 1e5
DEMAND = Demand("reduction.tolerance = 0.01", STEPS, "5 samples under 3 loads", "shorten simulation.duration", 4)


def changed(scene: Scene, *overrides: str) -> Scene:
    return scene_from_toml(scene_to_toml(scene), ".", overrides)


def cells(*overrides: str) -> Scene:
    return changed(scene_of("cells in the plane", "torque"), *overrides)


def chosen(scene: Scene) -> Reference:
    meshes = meshes_for(scene)
    return choose_reference(scene, meshes, RigidKinematics(Mechanism.from_scene(scene, meshes)), DEMAND, SELF)


def prices() -> tuple[float, float]:
    """Return what the runs of mesh and component model are predicted to take, s."""
    scene = cells()
    models = FullModel(scene, meshes_for(scene)), component_model(scene, meshes_for(scene), SELF, DEMAND.n_modes)
    return tuple(STEPS * step_seconds(model.kinematics.mechanism) for model in models)


def test_bodies_from_matrices_have_the_component_model_alone() -> None:
    scene = scene_of("matrices", "torque")
    found = chosen(scene)
    assert not found.is_mesh and "there is no full-order model with bodies.rod.matrices" in found.why
    values = {name: np.array([value]) for name, value in scene.values.items()}
    told = distance_from_mesh(found, meshes_for(scene), values, 1, 20, SELF)
    assert told.from_mesh == {} and "how far it is from one is not known" in told.why
    with pytest.raises(InputError, match='reference.model = "mesh": there is no full-order model .* take "components"'):
        chosen(changed(scene, 'reference.model="mesh"'))
    with pytest.raises(InputError, match="there is no full-order model with bodies.rod.matrices, of the component"):
        chosen(changed(scene, "reference.budget=1e-9"))


def test_component_runs_with_bodies_from_matrices_have_no_better_model() -> None:
    scene, said = scene_of("matrices", "torque"), []
    job = SimpleNamespace(scene=scene, model="components", n_steps=10, comm=SELF)
    job._made_from, job._is_finished, job._better = lambda: "", lambda name, known: False, lambda: _Job._better(job)
    job._say, job._of = lambda *words: said.append(words), lambda name: None
    _Job.compare(job)
    assert said == [("compare", "left out: there is no full-order model with bodies.rod.matrices")]


def test_the_mesh_where_it_is_within_the_budget() -> None:
    found = chosen(cells())
    assert found.is_mesh and found.model.name == "full" and found.from_mesh == {}
    assert found.price.seconds == pytest.approx(prices()[0])
    assert "reference: the mesh" in found.why and "within reference.budget = 600 s" in found.why
    assert replace(found, from_mesh={"x": 1.0}).about["from_mesh"] == {"x": 1.0}
    scene = cells()  # it has no distance from itself
    assert distance_from_mesh(found, meshes_for(scene), points(scene, 1), 1, 20, SELF) is found
    texts = {0.5: "0.5 s", 600.0: "10 min", 7000.0: "120 min", 7200.0 * 3: "6 h", 86400.0 * 10: "10 days"}
    assert {seconds: duration_text(seconds) for seconds in texts} == texts


def test_the_component_model_where_the_mesh_is_too_dear() -> None:
    mesh, components = prices()
    assert components < mesh
    found = chosen(cells(f"reference.budget={0.5 * (mesh + components)}"))
    assert not found.is_mesh and isinstance(found.model, ComponentModel)
    assert found.about["model"] == "components" and found.about["predicted_seconds"] == pytest.approx(components)
    assert "runs of the mesh would take" in found.why and "modes: crank" in found.why


def test_neither_is_one_message_with_prices_and_cures() -> None:
    message = refusal(chosen, cells("reference.budget=1e-6"))
    for words in (
        "reduction.tolerance = 0.01: no reference is within reference.budget = 1e-06 s",
        "5 samples under 3 loads take 1e+05 steps",
        "predicted for the mesh",
        "of the component model",
        "raise reference.budget",
        "shorten simulation.duration",
    ):
        assert words in message, message


@pytest.mark.parametrize(("model", "name"), [("mesh", "full"), ("components", "components")])
def test_a_model_that_is_named_is_taken_at_its_price(model: str, name: str) -> None:
    found = chosen(cells("reference.budget=1e-6", f'reference.model="{model}"'))
    assert found.model.name == name and "as reference.model says" in found.why


def test_a_scene_without_component_model_says_why(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise InputError("bodies.rod: no frame")

    monkeypatch.setattr(reference, "component_model", refuse)
    dear = cells("reference.budget=1e-6")
    with pytest.raises(InputError, match="there is no component model in its place: bodies.rod: no frame"):
        chosen(dear)
    with pytest.raises(InputError, match='reference.model = "components": bodies.rod: no frame'):
        chosen(changed(dear, 'reference.model="components"'))


@pytest.mark.parametrize("feature", ["torque", "stiffening"])
@pytest.mark.parametrize("kind", ["beams", "two coordinates", "beams in space"])
def test_coefficients_are_counted_as_the_tables_have_them(kind: str, feature: str) -> None:
    scene = changed(scene_of(kind, feature), 'effects.damped={type="structural_damping",stiffness=1e-5}')
    model = reduced_model(scene, meshes_for(scene))
    tables, layout = model.rom.tables, model.terms.layout
    n = coefficients(tables.n_modes, tables.n_coordinates, layout.second_order)
    assert layout.second_order == (feature == "stiffening") and n == layout.end * 4**tables.n_coordinates


def test_a_build_says_which_model_is_much_quicker() -> None:
    mesh, reduced = Prospect("mesh", step=2e-6), Prospect("reduced", step=7e-6)
    parts = Prospect("components", step=1e-6), Prospect("components", "it has none")
    model, why = quicker([mesh, parts[0], reduced], "reduced")
    assert model == "components" and why.endswith("is predicted to take 7 us, of component modes 1 us")
    model, why = quicker([mesh, parts[1], reduced], "reduced")
    assert model == "full" and why.endswith("of the mesh 2 us")
    slower = replace(parts[0], step=6e-6)
    assert quicker([mesh, slower, replace(reduced, step=1e-9)], "components")[0] == "full"
    near, refused = replace(reduced, step=5e-6), replace(reduced, refused="so")
    for models, own in (([mesh, near], "reduced"), ([mesh, refused], "reduced"), ([mesh, *parts[:1]], "components")):
        assert quicker(models, own) == ("", "")


def test_contacts_and_searches_are_said_beside_a_price() -> None:
    """How often steps are divided, and which candidates are tried, is not known before."""
    plain = scene_of("beams", "torque")
    stopped = changed(plain, 'effects.stop={type="end_stop", joint="crank_hinge", upper=0.5, stiffness=1e3}')
    texts = [str(Price.of(Mechanism.from_scene(scene, meshes_for(scene)), 1e6)) for scene in (plain, stopped)]
    assert "contact" not in texts[0] and texts[1].endswith("(and 4 ms for each contact that begins or ends; only runs "
                                                           "tell how many these are)")  # fmt: skip
    open_one = changed(plain, "reduction.tolerance=0.01", "reference.budget=90")
    for scene, searched in ((plain, False), (open_one, True)):
        meshes = meshes_for(scene)
        *_, reduced = prospects(scene, meshes, Mechanism.from_scene(scene, meshes), 6, 1)
        said = "before that a search by its tolerance, whose candidates may take 90 s (reference.budget)"
        assert (said in reduced.text) == searched


def points(scene: Scene, n: int) -> dict[str, np.ndarray]:
    shares = 1.0 + 0.02 * np.array([0.0, -1.0, 1.0, 0.5])[:n]
    return {name: value * shares for name, value in scene.values.items()}


def test_the_distance_is_that_of_two_runs() -> None:
    scene = cells('reference.model="components"')
    found, values = chosen(scene), points(scene, 3)
    told = distance_from_mesh(found, meshes_for(scene), values, 3, 20, SELF)
    runs = [run_history(model, values, 3, 20) for model in (found.model, FullModel(scene, meshes_for(scene)))]
    expected = errors_between(*runs, floors_of(found.model)).max(axis=1)
    np.testing.assert_allclose(list(told.from_mesh.values()), expected, rtol=1e-6, atol=1e-12)
    assert "away from the mesh at" in told.why and "20 steps" in told.why and "over the first" not in told.why
    assert 0.0 < max(told.from_mesh.values()) < 0.05


def test_a_dear_mesh_is_compared_over_a_part_of_the_run_or_not_at_all() -> None:
    scene = cells('reference.model="components"')
    step = step_seconds(FullModel(scene, meshes_for(scene)).kinematics.mechanism)
    for steps, words in ((20.5, "over the first 0.0012 s of 0.003 s, 20 steps"), (1.0, "is not known: 16 steps")):
        poor = changed(scene, f"reference.budget={steps * step / CHECK_SHARE}")
        told = distance_from_mesh(chosen(poor), meshes_for(poor), points(poor, 1), 1, 50, SELF)
        assert words in told.why, told.why
        assert bool(told.from_mesh) == (steps >= FEWEST_STEPS)


def test_models_agree_on_the_first_period_where_joints_give_way() -> None:
    """What joints give way to without bending a body is no vibration of its own."""
    scene = scene_from_toml(MACHINE, ".")
    expected = period_of(full_model(scene), SELF)
    for model in (reduced_model(scene), component_model(scene, meshes_of(scene), SELF)):
        assert period_of(model, SELF) == pytest.approx(expected, rel=1e-8)


@pytest.mark.parametrize("kind", ["beams", "cells in the plane"])
def test_models_agree_on_the_first_period(kind: str) -> None:
    """By the eigenproblem of modes, from bodies in floating frames, and from a reduced model's tables."""
    scene = changed(scene_of(kind, "gravity"), "reduction.modes=6", "reduction.angles=8")
    meshes = meshes_for(scene)
    expected = first_period(scene, RigidKinematics(Mechanism.from_scene(scene, meshes)), SELF, SELF)
    components = period_of(component_model(scene, meshes, SELF), SELF)
    assert components == pytest.approx(expected, rel=1e-4)
    if kind == "beams":
        assert period_of(FullModel(scene, meshes), SELF) == expected
        of_tables = slider_crank("reduction.angles=24", "reduction.modes=4")
        found, expected = (period_of(make(of_tables), SELF) for make in (reduced_model, full_model))
        assert found == pytest.approx(expected, rel=1e-8)


def test_stresses_of_bodies_of_cells_are_in_what_a_step_is_predicted_to_take() -> None:
    """Three strains of each node of the rod; at a place those of one point."""
    output = 'outputs.stress={type="stress", body="rod", quantity="von_mises"PLACE}'
    of_scene = ROOT / "scenes" / "slider_crank_solid2d.toml"
    found = []
    for place in ("", ", at=[0.35, 0.0]"):
        scene, meshes = read_scene(of_scene, (output.replace("PLACE", place),), (), SELF, Purpose.CHECK)
        mechanism = Mechanism.from_scene(scene, meshes)
        found.append(n_strains(scene, mechanism))
        _, components, reduced = prospects(scene, meshes, mechanism, 6, 0)
        assert min(components.step, reduced.step) > STRAIN * found[-1]
    assert found == [3 * meshes["rod"].n_nodes, 3]


FORCE = 'outputs.force={type="joint_force", joint="elbow"}'
GIVES = "joints.elbow.elastic={reference=[[1.0, 0.0]], stiffness=[1e8, 1e8]}"
STUFF = 'fields.stuff={{body="rod", quantity="E", variation=0.1, length=0.2, kernel="exponential", terms={}}}'


@pytest.mark.parametrize(
    ("name", "angles", "overrides", "least", "most"),
    [
        # answers to gaps take three times what the eigenproblems of fifteen modes do; joints that give way have none
        ("slider_crank", 1000, (FORCE,), 3.6, 4.4),
        ("slider_crank", 1000, (FORCE, GIVES), 0.9, 1.1),
        # a body of cells with a field keeps some fields for each of its terms, and eigenproblems take their cube: with
        # four terms a build took 168 s where one without took 5 s
        ("slider_crank_solid2d", 629, (STUFF.format(1),), 1.5, 4.0),
        ("slider_crank_solid2d", 629, (STUFF.format(4),), 15.0, 60.0),
    ],
)
def test_what_builds_are_predicted_to_take(name: str, angles: int, overrides: tuple[str, ...], least, most) -> None:
    """By what takes how many times as long as a build without it."""

    def seconds(*more: str) -> float:
        given = ("reduction.modes=15", f"reduction.angles={angles}", *more)
        scene, meshes = read_scene(ROOT / "scenes" / f"{name}.toml", given, (), SELF, Purpose.CHECK)
        return build_seconds(scene, Mechanism.from_scene(scene, meshes))

    assert least < seconds(*overrides) / seconds() < most


def test_forces_in_joints_are_in_what_steps_are_predicted_to_take() -> None:
    """And what outputs take that are found after every step: forces and, of joints that give way and speeds, rates."""
    steps, force = [], 'outputs.force={type="joint_force", joint="crank_hinge"}'
    gives = "joints.crank_hinge.elastic={reference=[[1.0, 0.0]], stiffness=[1e8, 1e8]}"
    every = force, "ensemble.extremes=true"
    event = 'ensemble.probabilities.far={output="crank_angle", above=1.0, when="ever"}'
    speed = 'outputs.w={type="speed", joint="crank_hinge"}'
    for overrides in ((), (force,), every, (*every, speed), (*every, gives), (force, event)):
        scene, meshes = read_scene(ROOT / "scenes" / "slider_crank.toml", overrides, (), SELF, Purpose.CHECK)
        found = prospects(scene, meshes, Mechanism.from_scene(scene, meshes), 6, 0)
        steps.append([one.step for one in found])
    more = np.array(steps)[1:4] - steps[:3]
    np.testing.assert_allclose(more[0], [FORCES[2], FORCES[2], FORCES_IN_LANES[2]], rtol=1e-9)
    np.testing.assert_allclose(more[1:, :2], np.repeat([[2.5e-6], [3e-6]], 2, axis=1), rtol=1e-9)
    assert steps[5] == steps[2], "an event at any time has all outputs found after every step"
    # of the reduced model by sizes: one more output, whose rate is that of the poses of two bodies
    assert more[2, 2] == pytest.approx(OUTPUT + 2 * POSE[2], rel=1e-6)
    assert steps[4][2] - steps[2][2] > PULLED
