"""Parameters' names in place of numbers of stops, friction, springs, masses and starts: runs are those with the number,
samples those of single runs, and derivatives central differences."""

from pathlib import Path

import differences
import numpy as np
import pytest
from differences import compare
from exported import assert_equal, compiled, needs_compiler, outputs_of
from mpi4py import MPI
from runs import components_model, full_model, history, motion, reduced_model, rom_of, samples
from spatial_beams import SLIDER_CRANK

from pgmp_petsc.ensemble.integration import run_batch
from pgmp_petsc.ensemble.watchers import watch_errors
from pgmp_petsc.estimates.error_indicator import indicator_of
from pgmp_petsc.gradients.differentiated import differentiate
from pgmp_petsc.models import Model, ReducedModel
from pgmp_petsc.scene import Scene, scene_from_toml
from pgmp_petsc.stepping.status import Status
from scenes import slider_crank

#: Entries with two values each; the first one is nominal.
NUMBERS = {
    "low": (0.39, 0.395), "up": (0.44, 0.45), "loss": (0.05, 0.5), "slow": (4.0, 2.0), "length": (0.43, 0.4),
    "lump": (0.02, 0.03), "throw": (6.0, 5.5),
}  # fmt: skip
ENTRIES = (
    "simulation.initial.theta={{position=0.4,velocity={throw}}}", "simulation.step=1e-3", "simulation.duration=0.045",
    "reduction.modes=3", "reduction.static_modes=true", "reduction.inertia_modes=true", "reduction.angles=16",
    'reduction.interpolation="spline"',
    'outputs.x={{type="position",point="rod:tip",axis="x"}}',
    'outputs.bend={{type="deformation",point="rod:tip",axis="x"}}',
    'effects.stop={{type="end_stop",joint="crank_hinge",lower={low},upper={up},stiffness=6000.0,damping={loss}}}',
    'effects.rub={{type="joint_friction",joint="elbow",limit=1.0,speed={slow}}}',
    'effects.coil={{type="spring_damper",points=["ground:origin","rod:1"],stiffness=300.0,damping=2.0,rest={length}}}',
    'effects.disc={{type="point_mass",point="rod:tip",mass=0.1,inertia={lump}}}',
)  # fmt: skip
FIRST, SECOND = ({name: both[k] for name, both in NUMBERS.items()} for k in (0, 1))


def scene_with(entries: dict[str, object], *overrides: str) -> Scene:
    """Return the slider-crank between two ends, thrown against one; `entries` are numbers or parameters' names."""
    plain = (entry.format(**entries) if "{{" in entry else entry for entry in ENTRIES)
    parameters = [f"parameters.{name}={{nominal={first}}}" for name, (first, _) in NUMBERS.items()]
    return slider_crank(*parameters, *plain, *overrides)


def named(*overrides: str) -> Scene:
    """Return the scene with a parameter's name in every entry."""
    return scene_with({name: f'"{name}"' for name in NUMBERS}, *overrides)


def made(kind: str, scene: Scene) -> Model:
    """Return a model of the scene; reduced ones have the basis of the scene with names."""
    if kind == "reduced":
        return ReducedModel(scene, rom_of(named()))
    full = full_model(scene)
    return full if kind == "full" else components_model(scene, full.meshes)


def assert_alone(together: dict[str, np.ndarray], k: int, model: Model) -> None:
    """Check the outputs of a sample beside others against those of its own model."""
    _, alone = history(model, samples(model.scene, 1), 1)
    for name, expected in alone.items():
        # what iterations leave, 1e-12 of the size a step, and contacts multiply
        np.testing.assert_allclose(together[name][:, k], expected[:, 0], rtol=0, atol=1e-8 * np.abs(expected).max())


@pytest.mark.parametrize("kind", ["full", "components", "reduced"])
def test_samples_are_runs_with_their_numbers(kind: str) -> None:
    """The mass of a basis is affine in an inertia, and one of a number is part of another term: it stays first."""
    second = SECOND | ({"lump": FIRST["lump"]} if kind == "reduced" else {})
    scene, numbers = named(), {name: np.array([value, second[name]]) for name, value in FIRST.items()}
    _, together = history(made(kind, scene), samples(scene, 2, **numbers), 2)
    assert max(np.ptp(values, axis=1).max() for values in together.values()) > 1e-3
    for k, values in enumerate((FIRST, second)):
        assert_alone(together, k, made(kind, scene_with(values)))


def test_derivatives_are_central_differences(monkeypatch: pytest.MonkeyPatch) -> None:
    """Stop, spring and friction together are iterated slowly: five corrections leave 2e-4 of a derivative."""
    monkeypatch.setattr(differences, "CORRECTIONS", 12)
    model = reduced_model(named())
    assert len(differentiate(model, model.scene.values, ()).contacts) >= 3  # at both ends
    compare(model, (1e-5,), *NUMBERS)


#: Loads whose values over time are named, with two values of each; the first one is nominal.
OVER_TIME = {"turn": (2.0, -3.0), "stay": (1.5, 4.0), "push": (2.0, -3.0), "weight": (0.5, 0.2)}
LOADS = (
    'effects.motor={{type="torque",joint="crank_hinge",table=[[0.0,0.0],[0.01,{turn}],[0.02,0.3],[0.03,{stay}]]}}',
    'effects.shake={{type="force",point="rod:1",direction=[0.0,1.0],scale=2.0,'
    'harmonic={{amplitude={push},frequency_hz=20.0,mean={weight},phase=0.3}}}}',
    'effects.drag={{type="force",point="rod:1",towards="ground:origin",harmonic={{amplitude=1.0,frequency_hz=8.0,'
    'mean={weight}}}}}',
    "simulation.step=1e-3", "simulation.duration=0.04", "reduction.modes=3", "reduction.angles=16",
    "reduction.static_modes=true", 'reduction.interpolation="spline"',
    'outputs.x={{type="position",point="rod:tip",axis="x"}}',
    'outputs.bend={{type="deformation",point="rod:tip",axis="x"}}',
)  # fmt: skip


def loaded_with(entries: dict[str, object]) -> Scene:
    """Return the slider-crank under loads over time; `entries` are numbers or parameters' names."""
    parameters = [f"parameters.{name}={{nominal={first}}}" for name, (first, _) in OVER_TIME.items()]
    return slider_crank(*parameters, *(entry.format(**entries) for entry in LOADS))


@pytest.mark.parametrize("kind", ["full", "components", "reduced"])
def test_samples_of_loads_are_runs_with_their_numbers(kind: str) -> None:
    scene = loaded_with({name: f'"{name}"' for name in OVER_TIME})
    values = {name: np.array(both) for name, both in OVER_TIME.items()}

    def made_of(one: Scene) -> Model:
        return reduced_model(one) if kind == "reduced" else made(kind, one)

    _, together = history(made_of(scene), samples(scene, 2, **values), 2)
    assert all(np.ptp(found, axis=1).max() > 1e-6 for found in together.values())
    for k in (0, 1):
        assert_alone(together, k, made_of(loaded_with({name: both[k] for name, both in OVER_TIME.items()})))


def test_derivatives_with_values_over_time_are_central_differences() -> None:
    """The run is nearly linear in loads: larger steps than elsewhere, whose rounding is less."""
    compare(reduced_model(loaded_with({name: f'"{name}"' for name in OVER_TIME})), (1e-1, 1e-2), *OVER_TIME)


THROWN_IN_SPACE = ("parameters.throw={nominal=6.0}", 'simulation.initial.theta={velocity="throw"}')


def test_samples_start_with_their_velocities() -> None:
    """In lanes and with PETSc's matrices, in the plane and in space."""
    space = scene_from_toml(SLIDER_CRANK, ".", THROWN_IN_SPACE)
    for model in (full_model(named()), full_model(space)):
        both = {name: np.array([value, value]) for name, value in model.scene.values.items()}
        system = model.batch({**both, "throw": np.array([6.0, -3.0])}, 2)
        state = system.start()
        v, a = system.unpack(state.v), system.unpack(state.a)
        np.testing.assert_allclose(v[:, 1], -0.5 * v[:, 0], rtol=0, atol=1e-14 * np.abs(v).max())
        for k, throw in enumerate((6.0, -3.0)):
            values = model.scene.values | {"throw": throw}
            with model.distributed(values, MPI.COMM_SELF) as alone:
                # the accelerations are solved for in two ways
                for found, expected in ((v, alone.start().v), (a, alone.start().a)):
                    np.testing.assert_allclose(found[:, k], expected, rtol=0, atol=1e-8 * np.abs(expected).max())


def test_errors_of_samples_with_a_velocity_are_those_of_runs_with_the_number() -> None:
    scene, short = named(), "simulation.duration=0.005"
    found = []
    numbers = SECOND | {"lump": FIRST["lump"]}
    for own, values in ((named(short), numbers), (scene_with(numbers, short), {})):
        model = ReducedModel(own, rom_of(scene))
        watcher = watch_errors(indicator_of(model))
        found.append(run_batch(model, samples(own, 1, **values), 0, [watcher]).errors)
    assert found[0].keys() == found[1].keys() and found[0]
    for name, values in found[0].items():
        assert np.isfinite(values).all()
        np.testing.assert_allclose(values, found[1][name], rtol=1e-4)


def test_a_sample_whose_ends_cross_is_not_integrated() -> None:
    scene = named()
    values = samples(scene, 2, low=np.array([0.39, 0.45]))
    batch = run_batch(reduced_model(scene), values)
    assert batch.status.tolist() == [Status.FINE, Status.UNPHYSICAL]


@needs_compiler
def test_a_model_in_c_takes_the_numbers(tmp_path: Path) -> None:
    """Stops, which it cannot have, left out; the velocity at the start is that of its run."""
    without = "effects.stop={type='joint_damping',joint='crank_hinge',coefficient=0.01}"
    scene = named(without, "parameters.lump.bounds=[0.01, 0.04]", "parameters.slow.bounds=[1.0, 5.0]")
    program = compiled(reduced_model(scene), tmp_path)
    assert "throw" not in (tmp_path / "steps.c").read_text()
    changed = scene.with_values({name: SECOND[name] for name in ("slow", "length", "lump")})
    model = ReducedModel(changed, rom_of(scene))
    found = outputs_of(program, *(f"{name}={SECOND[name]}" for name in ("slow", "length", "lump")))
    # what the iterations of both leave of the deformation
    assert_equal(found, motion(model).outputs, 1e-5)
    outside = outputs_of(program, "slow=6.0")["validity"].astype(int)  # beyond the bounds of what no table depends on
    assert (outside & 16).all() and not (found["validity"].astype(int) & 16).any()
