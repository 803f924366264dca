"""Random mechanisms, arguments and mutated scenes: each works within its estimate, or is refused by its entry."""

import inspect
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from mpi4py import MPI
from mutated_scenes import run
from random_mechanisms import random_scene
from result_files import QUICK
from runs import PAPER_SCENE, trajectory

import pgmp_petsc as pgmp
from pgmp_petsc.api.arguments import _KINDS, kinds_of
from pgmp_petsc.base.progress import without_progress
from pgmp_petsc.mesh.meshes import straight_beam
from pgmp_petsc.models import FullModel, ReducedModel
from pgmp_petsc.ranks.groups import RankGroup
from pgmp_petsc.reduction.build import build_rom
from pgmp_petsc.results import Trajectory
from pgmp_petsc.scene import Scene, scene_from_toml

# in the suite; PGMP_FUZZ=100 tries a hundred times as many
CASES = 4 * int(os.environ.get("PGMP_FUZZ", "1"))
# what an estimate promises (docs/method.md): within a factor of 3 of the true error
FACTOR = 3.0
# Without an estimate and without a warning: errors of the deformations that the limits of the warnings leave, a tenth
# of the stiffness (`results.estimates`), and what a basis of a few modes truncates, as the paper's 8 %.
UNWARNED = 0.2


@dataclass(frozen=True)
class Verdict:
    """How far the reduced run of one scene is from the full-order one."""

    reduced: Trajectory
    full: Trajectory

    @property
    def warned(self) -> bool:
        """Whether the reduced run, or the model it came from, says that its figures may be wrong."""
        return any(remark.kind == "warning" for remark in self.reduced.record.remarks)

    def excess(self, output: str) -> float:
        n = min(len(self.reduced.time), len(self.full.time))
        exact = self.full.outputs[output][:n]
        error = float(np.max(np.abs(self.reduced.outputs[output][:n] - exact)))
        size = float(np.max(np.abs(exact)))
        if self.reduced.errors is not None and np.isfinite(self.reduced.errors.maximum(output)):
            # an estimate far below what matters is not held to its factor
            return error / max(FACTOR * self.reduced.errors.maximum(output), 1e-3 * size)
        return error / (UNWARNED * size)


def verdict_on(scene: Scene) -> Verdict:
    meshes = {name: straight_beam(b.line.length, b.line.elements, b.line.start) for name, b in scene.bodies.items()}
    with without_progress(), RankGroup.split(MPI.COMM_SELF, 1) as group:
        rom = build_rom(scene, meshes, group)
        warned = scene.with_remarks((*scene.remarks, *rom.record.remarks))
        reduced = trajectory(ReducedModel(warned, rom))
        full = trajectory(FullModel(scene, meshes))
    return Verdict(reduced, full)


@settings(
    max_examples=CASES, deadline=None, derandomize=True, phases=[Phase.generate],
    suppress_health_check=list(HealthCheck),
)  # fmt: skip
@given(st.integers(0, 2**32 - 1))
def test_a_reduced_model_is_within_its_estimate_or_warns(seed: int) -> None:
    scene = scene_from_toml(random_scene(seed), ".")
    verdict = verdict_on(scene)
    if verdict.reduced.status or verdict.full.status:
        # a run that stops says so, with its reason, and ends with status 1
        stopped = [run for run in (verdict.reduced, verdict.full) if run.status]
        assert all("stopped at" in run.record.remarks[0].text for run in stopped)
        return
    excess = {name: verdict.excess(name) for name in verdict.reduced.outputs}
    assert verdict.warned or max(excess.values()) <= 1.0, f"seed {seed}: {excess}"


FUNCTIONS = {name: found for name in pgmp.__all__ if inspect.isfunction(found := getattr(pgmp, name))}
SHORT = {"simulation.duration": 2e-3, "ensemble.checked_share": 0.0}
# what runs on a model in memory; of the others files are missing, and whatever is taken ends there
RUNS = ("simulate", "montecarlo", "rare_event", "sensitivities", "fields")
MISSING = {
    "PathLike[str]": "none.h5", "Scene": "none.toml", "int": 2, "str": "none", "event": "crank_angle > 1",
    "goal": "minimise r1", "Sequence[str | PathLike[str]]": ["none.h5"],
    "Sequence[Result | str | PathLike[str]]": ["none.h5"], "Mapping[str, Any]": {}, "Sequence[float]": [0.0],
}  # fmt: skip


def odd(rom: pgmp.Rom, folder: Path) -> list[object]:
    """Return what an argument may be by mistake."""
    return [
        None, True, -1, 0, 3, 10**30, 1.5, float("nan"), float("inf"), "", "x", "x" * 9999, "\0", "\ud800", b"x", [],
        [3], ["x"], ["\0"], (), {}, {"x": 1}, {3: 1}, {"x": object()}, {"r1": float("nan")}, object(), object, print,
        np.zeros(2), np.float64(2), np.int64(2), np.array("x"), rom.scene, rom, pandas.DataFrame(),
        pandas.DataFrame({"r1": ["a"]}), {"r1": [1.0, "a"]}, {"r1": [[5e-3]]}, range(3), {1, 2}, iter([1]), 1j,
        Path("x"), pgmp.Stopping(3), pgmp.Stopping([3]), pgmp.Stopping(budget="x"),
        pgmp.Stopping(["P(crank_angle > 1e999) +- 1"]),
        pgmp.Shard("a", None), pgmp.Shard(0, 0), pgmp.Robust("x"), pgmp.Robust(1, "x"), pgmp.Robust(1, 2, None),
        [pgmp.Correction(3, 4)], [pgmp.Correction("full", 40, 2, 7)], [pgmp.Correction("full", "x")], folder,
    ]  # fmt: skip


def test_every_function_is_checked_by_annotations_that_are_known() -> None:
    for name, function in FUNCTIONS.items():
        assert hasattr(function, "__wrapped__"), name
        for entry in inspect.signature(function).parameters.values():
            unknown = [kind for kind in kinds_of(entry.annotation) if kind not in _KINDS]
            assert unknown in ([], ["Comm"]), (name, entry)


@pytest.fixture(scope="module")
def rom() -> pgmp.Rom:
    return pgmp.build(pgmp.load(PAPER_SCENE, QUICK))


@pytest.mark.parametrize("name", FUNCTIONS)
def test_arguments_of_all_kinds_are_taken_or_refused(name: str, rom: pgmp.Rom, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    parameters, values = inspect.signature(FUNCTIONS[name]).parameters, odd(rom, tmp_path)
    in_memory = {"source": rom, "rom": rom, "run": rom} if name in RUNS else {}
    first = {key: next(kind for kind in kinds_of(entry.annotation)) for key, entry in parameters.items()}
    known = {key: MISSING.get(key, MISSING.get(kind, "none.h5")) for key, kind in first.items()} | in_memory
    numbers = np.random.default_rng(len(name)).permutation(len(values))
    for wrong in parameters:
        for number in numbers if name not in RUNS else numbers[:12]:
            if name == "tradeoff" and isinstance(values[number], pgmp.Scene):
                continue  # taken, and a study takes long
            needed = [key for key, entry in parameters.items() if entry.default is entry.empty]
            given = {key: known[key] for key in needed}
            given |= {"overrides": SHORT} if "overrides" in parameters and name in RUNS else {}
            given[wrong] = values[number]
            try:
                FUNCTIONS[name](**given)
            except pgmp.PgmpError as error:
                assert "\0" not in str(error) and " failed on rank" not in str(error), (wrong, values[number], error)


N_CASES = int(os.environ.get("PGMP_FUZZ_SCENES", "200"))


def test_mutated_scenes() -> None:
    said: list[str] = []
    counts = run(N_CASES, seed=2026, say=said.append)
    assert not said, "\n".join(said)
    # the generator makes all kinds of scenes
    assert min(counts["accepted"] + counts["warned of"], counts["refused"]) > N_CASES // 20
