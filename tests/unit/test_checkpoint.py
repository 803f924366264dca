"""The checkpoint of an ensemble: what is kept, what is refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pgmp_petsc.ensemble.batch import Batch, Plan
from pgmp_petsc.ensemble.checkpoint import Checkpoint
from pgmp_petsc.runtime.errors import InputError, PgmpError

SCENE = "[scene]\nname = 'a'\n"


@pytest.fixture
def plan(tmp_path: Path) -> Plan:
    return Plan(n_samples=10, seed=3, output=tmp_path / "e.h5", resume=False)


def batch(first: int, n: int = 4) -> Batch:
    numbers = first + np.arange(float(n))
    status = np.where(numbers % 3 == 0, 2, 0)
    outputs = {"angle": -numbers, "x.y": numbers / 7}
    estimates = {name: np.where(numbers < 3, 1e-3 * values, np.nan) for name, values in outputs.items()}
    return Batch(
        first,
        {"r1": numbers},
        outputs,
        status,
        np.where(status, 0.5, np.nan),
        estimates,
        dict(estimates),
        {"bent": numbers},
    )


def started(plan: Plan, *firsts: int) -> Checkpoint:
    checkpoint = Checkpoint(plan, SCENE, "reduced", TABLES, SIZE)
    assert checkpoint.open() == set()
    for first in firsts:
        checkpoint.add(batch(first))
    return checkpoint


def again(plan: Plan, scene: str = SCENE, model: str = "reduced", **changes: object) -> set[int]:
    return Checkpoint(replace(plan, resume=True, **changes), scene, model).open()


def test_batches_come_back_in_order_and_unchanged(plan: Plan) -> None:
    checkpoint = started(plan, 8, 0, 4)
    found = checkpoint.batches()
    assert [one.first for one in found] == [0, 4, 8]
    for one in found:
        expected = batch(one.first)
        for name in ("parameters", "outputs", "errors", "errors_at_end", "validity"):
            assert getattr(one, name).keys() == getattr(expected, name).keys()
            for key, values in getattr(expected, name).items():
                np.testing.assert_array_equal(getattr(one, name)[key], values)
        np.testing.assert_array_equal(one.status, expected.status)
        np.testing.assert_array_equal(one.failure_time, expected.failure_time)


def test_it_stands_beside_the_result_until_it_is_removed(plan: Plan) -> None:
    checkpoint = started(plan, 0)
    assert checkpoint.folder == plan.output.with_name("e.h5.partial")
    assert checkpoint.folder.is_dir()
    checkpoint.remove()
    assert not checkpoint.folder.exists()
    checkpoint.remove()


def test_a_resumed_run_takes_up_finished_batches(plan: Plan) -> None:
    started(plan, 0, 8)
    assert again(plan) == {0, 8}


def test_a_batch_that_was_not_finished_does_not_count(plan: Plan) -> None:
    checkpoint = started(plan, 0)
    (checkpoint.folder / "000000004.writing").write_bytes(b"half")
    assert again(plan) == {0}
    assert [one.first for one in checkpoint.batches()] == [0]


def test_without_resume_it_starts_anew(plan: Plan) -> None:
    started(plan, 0, 4)
    assert started(plan).batches() == []


def test_resuming_without_a_checkpoint_starts_anew(plan: Plan) -> None:
    assert again(plan) == set()
    assert again(plan) == set()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"n_samples": 11}, r"its samples differs \(10 there, 11 here\)"),
        ({"seed": 4}, r"its seed differs \(3 there, 4 here\)"),
        ({"model": "full"}, r"its model differs \(reduced there, full here\)"),
        ({"scene": SCENE + "\n"}, r"its scene differs;"),
    ],
)
def test_the_checkpoint_of_another_run_is_refused_and_kept(plan: Plan, change: dict, message: str) -> None:
    started(plan, 0)
    with pytest.raises(InputError, match=r"--resume: '.*e\.h5\.partial' belongs to another run: " + message):
        again(plan, **change)
    assert again(plan) == {0}


def test_a_label_that_was_cut_off_is_one_clear_message(plan: Plan) -> None:
    checkpoint = started(plan, 0)
    label = checkpoint.folder / "run.json"
    label.write_text(label.read_text()[:20])
    with pytest.raises(PgmpError, match="--resume"):
        again(plan)
