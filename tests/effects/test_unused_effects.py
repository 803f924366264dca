"""A scene without an effect pays nothing for it: no action, no load, no evaluation."""

from collections import Counter
from pathlib import Path

import pytest
from counting import count_calls
from effect_scenes import BAR, CANTILEVER, run_batch, run_distributed, scene_of
from mpi4py import MPI
from runs import full_model

from benchmarks import effect_cost
from pgmp_petsc.effects import Effect, Motion, effects_of
from pgmp_petsc.effects.loads import Weights
from pgmp_petsc.full.distributed import FullDistributed
from pgmp_petsc.full.systems import FullBatch
from pgmp_petsc.scene import Scene
from pgmp_petsc.stepping.edge_search import EventLocation
from scenes import meshes_of

SHORT = "[simulation]\nduration = 5e-3\nstep = 1e-3\n"
BEAM = CANTILEVER.split("[effects.hold]")[0]
WEIGHT = '[effects.weight]\ntype = "gravity"\n'
MOTOR = '[effects.motor]\ntype = "torque"\njoint = "hub"\nharmonic = { amplitude = 1.0, frequency_hz = 1.0 }\n'


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> Counter:
    """Count the evaluations of everything that effects are made of."""
    watched = [
        (FullBatch, "depths"), (FullDistributed, "depths"), (Motion, "at"), (EventLocation, "repeat_steps"),
        (Effect, "amplitude"), (Weights, "loads"),
    ]  # fmt: skip
    return count_calls(monkeypatch, watched)


def run_both(scene: Scene) -> None:
    run_distributed(scene)
    run_batch(scene)


def test_a_load_is_no_action(calls: Counter) -> None:
    scene = scene_of(BEAM, SHORT)
    assert effects_of(scene, full_model(scene).kinematics.mechanism) == ()
    run_both(scene)
    assert not calls, "without effects nothing of them is evaluated"
    run_both(scene_of(BEAM, SHORT + WEIGHT))
    assert set(calls) == {"Weights.loads", "Effect.amplitude"}
    calls.clear()
    run_both(scene_of(BEAM, SHORT + MOTOR))
    assert set(calls) == {"Effect.amplitude"}


def test_only_what_is_there_is_built() -> None:
    bare, damped = (
        full_model(scene_of(BEAM, SHORT + text))
        for text in ("", '[effects.e]\ntype = "structural_damping"\nstiffness = 1e-3\nmass = 1.0\n')
    )
    for model, any_damping in ((bare, False), (damped, True)):
        batch = model.batch({}, 1)
        problem = batch._equations.problem  # noqa: SLF001
        assert problem.elements.damped == any_damping
        assert problem.actions.counted.size == 0 and problem.actions.positions.size == 0
        assert problem.loads.dofs.size == 0 and problem.lumps.dofs.size == 0
        with model.distributed({}, MPI.COMM_SELF) as single:
            shared = single._problem  # noqa: SLF001
        assert shared.elements.damped == any_damping and shared.modal.kinds.size == 0
        assert shared.actions.counted.size == shared.loads.dofs.size == shared.solids.region.size == 0


def test_the_cost_of_effects_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(effect_cost, "N_SAMPLES", 2)
    monkeypatch.setattr(effect_cost, "N_STEPS", 3)
    monkeypatch.setattr(effect_cost, "N_REPEATS", 1)
    scene = scene_of(BEAM, SHORT)
    costs = effect_cost.measure(scene, meshes_of(scene), full_model)
    assert [cost.effects for cost in costs][:3] == ["none", "torque", "force"] and costs[-1].effects == "all"
    assert len(costs) == 12
    assert all(cost.seconds > 0.0 and cost.corrections >= 1.0 for cost in costs)
    text = effect_cost.table(costs)
    assert len(text.splitlines()) == 13 and text.splitlines()[1].split()[2] == "1.00"
    scene = scene_of(BAR)
    assert "structural_damping" not in effect_cost.one_of_each(scene, meshes_of(scene)), "of rigid bodies"


def test_the_script_asks_for_a_scene(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr("sys.argv", ["effect_cost"])
    assert effect_cost.main() == 2
    assert "usage: python -m benchmarks.effect_cost SCENE" in capsys.readouterr().err
    monkeypatch.setattr("sys.argv", ["effect_cost", str(tmp_path / "nothing.toml")])
    assert effect_cost.main() == 2
    assert "no such scene file" in capsys.readouterr().err
