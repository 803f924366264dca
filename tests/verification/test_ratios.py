"""Ratios, radii and leads as parameters: samples of every model against closed forms, and against models that are
built with these numbers."""

from pathlib import Path

import numpy as np
import pytest
from alike import assert_alike
from coupled_scenes import GEARED, RACK, ROTORS, SCREW
from differences import differences
from exported import assert_equal, compiled, needs_compiler, outputs_of, simulated
from machine_scenes import MODELS
from mpi4py import MPI
from runs import assert_close, history, rom_of, samples
from scipy.linalg import eigh

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.bench.reference import component_model
from pgmp_petsc.estimates.own_error import why_not_of_full_order
from pgmp_petsc.gradients.differentiated import differentiate
from pgmp_petsc.mechanism.capabilities import Purpose
from pgmp_petsc.models import ReducedModel, SeparateLengths, of_samples
from pgmp_petsc.reduction.rom import ReducedOrderModel
from pgmp_petsc.scene import Scene, scene_from_toml
from pgmp_petsc.studies.inputs import with_meshes

RIGID = {
    # joint and entry, values, acceleration of the coordinate
    "gear": (ROTORS, "joints.mesh.ratio", (-0.41, 0.6), lambda r: 0.7 / (0.02 + r**2 * 0.5), "one"),
    "coupling": (ROTORS, "joints.mesh.terms.input", (0.5, -2.0), lambda r: 0.7 / (0.02 + r**2 / 4.0 * 0.5), "one"),
    "screw": (SCREW, "joints.thread.lead", (0.3, -0.7), lambda r: 4.0 / (3.0 + 0.02 * (2.0 * np.pi / r) ** 2), "x"),
}
COUPLED = "joints.mesh={type='coupling',terms={output=2.0,input=0.74}}"


@pytest.mark.parametrize("model", ["full", "components"])
@pytest.mark.parametrize("kind", list(RIGID))
def test_each_sample_has_its_own_ratio(kind: str, model: str) -> None:
    """From rest under a constant force: a path that grows with the square of time, whose factor hangs on the ratio."""
    text, entry, values, acceleration, output = RIGID[kind]
    for value in values:
        span = sorted((0.9 * value, 1.1 * value))
        given = (f"{entry}='r'", f"parameters.r={{nominal={value},bounds={span}}}", "simulation.duration=0.4")
        scene = scene_from_toml(text, ".", (*((COUPLED,) if kind == "coupling" else ()), *given))
        of_each = of_samples(MODELS[model](scene), ["r"])
        assert isinstance(of_each, SeparateLengths)
        for own in (value, 1.07 * value):
            times, found = history(of_each, samples(scene, 1, r=own), 1)
            exact = 0.5 * acceleration(own) * times**2
            # steps over 0.4 s, of directors in space: to (rate step)^2 / 12
            assert_close({output: exact[:, None]}, {output: found[output]}, **{output: 1e-3})


@pytest.mark.parametrize("model", ["full", "components"])
def test_each_sample_has_its_own_radius(model: str) -> None:
    given = ("joints.teeth.radius='r'", "parameters.r={nominal=0.05,bounds=[0.04,0.06],unit='m'}")
    scene = scene_from_toml(RACK, ".", (*given, "simulation.duration=0.3"))
    of_each = of_samples(MODELS[model](scene), ["r"])
    for own in (0.05, 0.058):
        times, found = history(of_each, samples(scene, 1, r=own), 1)
        rate = np.sqrt(200.0 * own**2 / (0.02 + 3.0 * own**2))
        exact = 40.0 / rate * np.sin(rate * times)[:, None]
        # (rate step)^2 / 12 of rate times duration
        assert_close({"phi": exact, "x": own * exact}, found, phi=1e-4, x=1e-4)


OF_RATIO = (
    "joints.mesh.ratio='ratio'", "parameters.ratio={nominal=-1.0,bounds=[-1.03,-0.96]}",
    "coordinates.phi.range=[0.0,1.2]", "coordinates.phi.periodic=false", "reduction.angles=20", "reduction.modes=4",
    "reduction.second_order=false", "reduction.length_points=6", "simulation.duration=0.15", "simulation.step=1e-3",
)  # fmt: skip
OTHER = -0.973


def geared(*overrides: str) -> Scene:
    """Return a geared five-bar whose ratio is a parameter, over a part of a turn."""
    return scene_from_toml(GEARED, ".", (*OF_RATIO, *overrides))


def numbered(*overrides: str) -> Scene:
    """Return it with the other ratio as a number."""
    return geared(f"joints.mesh.ratio={OTHER}", "parameters={}", *overrides)


@pytest.fixture(scope="module")
def rom() -> ReducedOrderModel:
    return rom_of(geared())


@pytest.mark.parametrize("model", ["full", "components"])
def test_a_sample_of_flexible_bodies_is_the_model_that_has_its_ratio(model: str) -> None:
    scene = geared()
    found = history(of_samples(MODELS[model](scene), ["ratio"]), samples(scene, 1, ratio=OTHER), 1)[1]
    exact = history(MODELS[model](numbered()), {}, 1)[1]
    assert_alike(exact, found, 1e-12)


def test_a_reduced_model_with_another_ratio_is_the_one_that_is_built_with_it(rom: ReducedOrderModel) -> None:
    scene, built = geared(), MODELS["reduced"](numbered())
    model = ReducedModel(scene, rom)
    own = model.at_lengths(scene.with_values({"ratio": OTHER}))
    tables, exact = own.rom.tables, built.rom.tables
    for place in range(0, 20, 4):
        found, wanted = (
            eigh(of.stiffness[place, 0], of.mass[place, 0][1:, 1:], eigvals_only=True) for of in (tables, exact)
        )
        np.testing.assert_allclose(found, wanted, rtol=1e-6)
    asked = (built, {}), (own, samples(own.scene, 1)), (of_samples(model, ["ratio"]), samples(scene, 1, ratio=OTHER))
    runs = [history(one, values, 1)[1] for one, values in asked]
    # stiffness between angles, in bases that are turned against each other, leaves 3e-5 of the deformation, as two
    # builds with other angles do
    for found in runs[1:]:
        assert_close(runs[0], found, input=1e-7, output=1e-7, x=1e-7, bending=1e-4)
    of_nominal = history(model, samples(scene, 1), 1)[1]
    assert np.abs(of_nominal["bending"] - runs[0]["bending"]).max() > 0.01 * np.abs(runs[0]["bending"]).max()


def test_derivatives_with_a_ratio_are_central_differences(rom: ReducedOrderModel) -> None:
    scene = geared("simulation.duration=0.05")
    lanes = of_samples(ReducedModel(scene, rom), ["ratio"])
    done = differentiate(lanes, scene.values, ["ratio"])
    for name, expected in differences(lanes, "ratio", 1e-3).items():
        size = max(np.abs(expected).max(), 1e-7 * np.abs(done.outputs[name]).max())
        assert np.abs(done.derivatives[name]["ratio"] - expected).max() < 1e-6 * size, name


@needs_compiler
def test_a_model_in_c_has_the_ratio_of_its_export(rom: ReducedOrderModel, tmp_path: Path) -> None:
    scene = geared()
    model = ReducedModel(scene.with_values({"ratio": OTHER}), rom)
    assert_equal(outputs_of(compiled(model, tmp_path)), simulated(model).outputs)
    assert '"ratio"' not in (tmp_path / "steps.c").read_text()


def test_a_ratio_that_does_not_bring_bodies_back_says_so() -> None:
    turn = ("coordinates.phi.range=[0.0,6.283185307179586]", "coordinates.phi.periodic=true")
    with pytest.raises(InputError, match="at ratio = .*joints.mesh a body moved by a part of a turn"):
        rom_of(geared(*turn, "reduction.angles=8", "reduction.length_points=2"))


def test_component_runs_of_samples_say_what_is_not_estimated() -> None:
    scene = geared()
    model = component_model(*with_meshes(scene, Purpose.COMPONENTS), MPI.COMM_SELF)
    said = [remark.text for remark in why_not_of_full_order(of_samples(model, ["ratio"]))]
    assert said[0].startswith("errors of the component modes")
