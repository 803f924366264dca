"""Arguments of the Python interface drawn at random: each is taken, or refused with an error that says why."""

import inspect
from pathlib import Path

import numpy as np
import pandas
import pytest
from result_files import QUICK
from runs import PAPER_SCENE

import pgmp_petsc as pgmp
from pgmp_petsc.api.arguments import _KINDS, kinds_of

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
