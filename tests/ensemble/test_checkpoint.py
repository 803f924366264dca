"""The checkpoint of an ensemble: what is kept, what is refused."""

import shutil
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from refusals import assert_refused, full_disk

from pgmp_petsc.base.errors import InputError, RunError
from pgmp_petsc.ensemble.checkpoint import Checkpoint, Columns, Finished, remove_checkpoint
from pgmp_petsc.ensemble.plan import Batch, Piece, Plan, Shard
from pgmp_petsc.files import checkpoint_folder, claims
from pgmp_petsc.files.seal import SIZE as SEAL

SCENE = "[scene]\nname = 'a'\n"
TABLES = "0123"
DESIGN = "random", 64 * "a"


@pytest.fixture
def plan(tmp_path: Path) -> Plan:
    return Plan(n_samples=12, seed=3, output=tmp_path / "e.h5", resume=False)


def batch(first: int, n: int = 4) -> Batch:
    numbers = first + np.arange(float(n))
    status = np.where(numbers % 3 == 0, 2, 0)
    outputs = {"angle": -numbers, "x.y": numbers / 7}
    estimates = {name: np.where(numbers < 3, 1e-3 * values, np.nan) for name, values in outputs.items()}
    failure_time = np.where(status, 0.5, np.nan)
    return Batch(first, {"r1": numbers}, outputs, status, failure_time, estimates, dict(estimates), {"bent": numbers})


def started(plan: Plan, *firsts: int) -> Checkpoint:
    checkpoint = Checkpoint(plan, SCENE, "reduced", TABLES, DESIGN)
    assert checkpoint.open() == Finished((), ())
    for first in firsts:
        add(checkpoint, first)
    return checkpoint


def add(checkpoint: Checkpoint, first: int, n: int = 4, is_checked: bool = False) -> None:
    checkpoint.add(Piece(first, first + n, is_checked), batch(first, n))


def taken_up(
    plan: Plan, scene: str = SCENE, model: str = "reduced", tables: str = TABLES, design=DESIGN, **changes: object
) -> Checkpoint:
    return Checkpoint(replace(plan, resume=True, **changes), scene, model, tables, design)


def again(plan: Plan, **changes: object) -> set[int]:
    return firsts(taken_up(plan, **changes))


def firsts(checkpoint: Checkpoint) -> set[int]:
    return {first for first, _ in checkpoint.open().samples}


def piece(checkpoint: Checkpoint, first: int) -> Path:
    return checkpoint.folder / f"samples_{first:09d}.npz"


@pytest.mark.parametrize("sizes", [{8: 4, 0: 4, 4: 4}, {0: 1, 1: 7, 8: 4}])
def test_batches_of_any_size_come_back_in_order_and_unchanged(plan: Plan, sizes: dict[int, int]) -> None:
    """As those of runs on other numbers of ranks."""
    checkpoint, order = started(plan), sorted(sizes.items())
    for first, n in sizes.items():
        add(checkpoint, first, n)
    assert taken_up(plan).open() == Finished(tuple((first, first + n) for first, n in order), ())
    at_hand, read = list(checkpoint.batches()), list(taken_up(plan).batches())
    for one, (first, n) in zip((*at_hand, *read), 2 * order, strict=True):
        expected = batch(first, n)
        assert one.first == first and len(one.status) == n
        for name in ("parameters", "outputs", "errors", "errors_at_end", "validity", "status", "failure_time"):
            np.testing.assert_equal(getattr(one, name), getattr(expected, name))


def test_it_stands_beside_the_result_until_it_is_removed(plan: Plan) -> None:
    checkpoint = started(plan, 0)
    assert checkpoint.folder == plan.output.with_name("e.h5.partial")
    assert checkpoint.folder.is_dir()
    remove_checkpoint(plan)
    assert not checkpoint.folder.exists()
    remove_checkpoint(plan)
    # what a job leaves that was killed before it had written its label, and what a user put there
    checkpoint.folder.mkdir()
    (checkpoint.folder / ".run.json.77.partial").touch()
    started(plan, 0)
    (checkpoint.folder / ".samples_000000004.npz.123.partial").write_bytes(b"half")  # of one that was not finished
    assert again(plan) == {0}
    (checkpoint.folder / "notes.txt").write_text("mine")
    remove_checkpoint(plan)
    assert [path.name for path in checkpoint.folder.iterdir()] == ["notes.txt"]


def test_without_resume_it_starts_anew_and_says_so(plan: Plan) -> None:
    assert started(plan, 0, 4).remarks == ()
    checkpoint = started(plan)
    assert not list(checkpoint.folder.glob("*.npz"))
    assert "held 2 finished piece(s) of a stopped run, which were removed: --resume" in str(*checkpoint.remarks)


def test_resuming_without_a_finished_piece_starts_anew_and_says_so(plan: Plan) -> None:
    for _ in ("no folder", "an empty one"):
        checkpoint = taken_up(plan)
        assert firsts(checkpoint) == set()
        assert "--resume: no finished piece of a stopped run is in" in str(*checkpoint.remarks)
    started(replace(plan, output=plan.output.with_name("f.h5")), 0)
    checkpoint = taken_up(replace(plan, output=plan.output.with_name("f.h5")))
    assert firsts(checkpoint) == {0} and checkpoint.remarks == ()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"n_samples": 11},
            r"its number of samples differs \(12 there, 11 here\), and only a larger number may be given",
        ),
        ({"seed": 4}, r"its seed differs \(3 there, 4 here\)"),
        ({"model": "full"}, r"its model differs \(reduced there, full here\)"),
        ({"scene": SCENE + "\n"}, r"its scene differs;"),
        ({"tables": "4567"}, r"its reduced model differs"),
        ({"design": ("sobol of 8 replicates", DESIGN[1])}, r"its sampler differs \(random there, sobol of 8"),
        ({"design": (DESIGN[0], 64 * "b")}, r"its design of samples differs;"),
    ],
)
def test_the_checkpoint_of_another_run_is_refused_and_kept(plan: Plan, change: dict, message: str) -> None:
    started(plan, 0)
    assert_refused(r"--resume: '.*e\.h5\.partial' belongs to another run: " + message, again, plan, **change)
    assert again(plan) == {0}
    assert again(plan, n_samples=20) == {0}  # longer
    assert_refused(r"its number of samples differs \(20 there, 12 here\)", again, plan)


@pytest.mark.parametrize(
    ("entry", "instead", "said"),
    [
        # as older versions wrote it, whose designs may have been others
        ('"sampler": "random", ', "", r"its sampler differs \(not named there, random here\)"),
        ('"samples": 12', '"samples": "x"', r"its number of samples differs \(x there, 12 here\)"),
    ],
)
def test_a_label_of_something_else_is_refused(plan: Plan, entry: str, instead: str, said: str) -> None:
    label = started(plan, 0).folder / "run.json"
    label.write_text(label.read_text().replace(entry, instead))
    assert_refused(said, again, plan)


def test_samples_that_depend_on_their_number_are_taken_up_by_as_many_alone(plan: Plan) -> None:
    assert Checkpoint(plan, SCENE, "reduced", TABLES, DESIGN, extends=False).open() == Finished((), ())
    other = replace(plan, resume=True, n_samples=20)
    message = r"every sample of a Latin hypercube depends, differs \(12 there, 20 here\)"
    assert_refused(message, Checkpoint(other, SCENE, "reduced", TABLES, DESIGN, extends=False).open)
    Checkpoint(replace(plan, resume=True), SCENE, "reduced", TABLES, DESIGN, extends=False).open()


def test_bands_are_those_of_the_first_samples_in_their_order(plan: Plan) -> None:
    checkpoint = started(plan)
    for first in (8, 0, 4):
        over_time = {"angle": (first + np.arange(4.0))[:, None] + [0.0, 0.5]} if first < 8 else {}
        checkpoint.add(Piece(first, first + 4), replace(batch(first), bands=over_time))
    np.testing.assert_array_equal(checkpoint.bands(6)["angle"], np.arange(6.0)[:, None] + [0.0, 0.5])
    assert list(checkpoint.columns().of("bands")) == []


def test_a_batch_of_another_run_is_not_taken_up(plan: Plan, tmp_path: Path) -> None:
    """As left by a job that went on when another had started with the same output."""
    stranger = started(replace(plan, output=tmp_path / "other.h5", seed=4), 4)
    checkpoint = started(plan, 0)
    shutil.copy(piece(stranger, 4), piece(checkpoint, 4))
    checkpoint = taken_up(plan)
    assert firsts(checkpoint) == {0}
    assert "it belongs to another run" in str(*checkpoint.remarks)


@pytest.mark.parametrize(("first", "n"), [(2, 4), (8, 5), (12, 4), (16, 0)])
def test_a_batch_in_no_place_of_the_run_is_not_taken_up(plan: Plan, first: int, n: int) -> None:
    checkpoint = started(plan, 0)
    add(checkpoint, first, n)
    checkpoint = taken_up(plan)
    assert firsts(checkpoint) == {0}
    why = "of which others are there already" if first == 2 else "which are none of this run"
    assert f"it holds samples {first} to {first + n - 1}, {why}" in str(*checkpoint.remarks)


def test_estimates_of_errors_are_pieces_of_their_own(plan: Plan) -> None:
    checkpoint = started(plan, 0)
    add(checkpoint, 2, 3, is_checked=True)
    assert taken_up(plan).open() == Finished(((0, 4),), ((2, 5),))
    assert [one.first for one in checkpoint.estimates()] == [2]


def test_samples_that_are_missing_or_damaged_at_the_end_are_no_result(plan: Plan) -> None:
    assert_refused("samples 0 to 3 are missing", list, started(plan, 4, 8).batches(), error=RunError)
    assert_refused("holds 8 of 12 samples", list, started(plan, 0, 4).batches(), error=RunError)
    checkpoint = started(plan, 0, 4, 8)
    add(checkpoint, 2)
    assert_refused("samples are there twice", list, checkpoint.batches(), error=RunError)
    checkpoint = started(plan, 0, 4)
    add(checkpoint, 8, 5)
    with pytest.raises(RunError, match="damaged during the run: it holds samples 8 to 12, which are none of this run"):
        list(checkpoint.batches())
    checkpoint = started(plan, 0, 4, 8)
    piece(checkpoint, 4).write_bytes(b"x")
    assert_refused("damaged during the run: it has no seal", list, checkpoint.batches(), error=RunError)


def test_what_a_process_has_just_written_it_need_not_read(plan: Plan, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same batches, and the files all the same; a piece that was written to is read, whatever is at hand."""

    def refuse(path: Path) -> None:
        raise AssertionError(f"{path} was read")

    size = piece(started(plan, 0), 0).stat().st_size
    monkeypatch.setattr(checkpoint_folder, "AT_HAND", int(1.5 * size))  # the first piece
    checkpoint = started(plan, 0, 4, 8)
    for one, other in zip(checkpoint.batches(), list(taken_up(plan).batches()), strict=True):
        assert one.first == other.first
        np.testing.assert_array_equal(one.status, other.status)
        np.testing.assert_equal(one.outputs, other.outputs)
    monkeypatch.setattr(checkpoint_folder, "check_seal", refuse)
    assert next(checkpoint.batches()).first == 0
    with pytest.raises(AssertionError, match="samples_000000004.npz was read"):
        list(checkpoint.batches())
    with pytest.raises(ValueError, match="read-only"):
        next(checkpoint.batches()).outputs["angle"][0] = 1.0


def test_pieces_are_pushed_to_the_disk_now_and_then(plan: Plan, monkeypatch: pytest.MonkeyPatch) -> None:
    """A piece that took long always is; the time between two is not the machine's."""
    clock, pushed = [0.0], []
    monkeypatch.setattr(checkpoint_folder.time, "monotonic", lambda: clock[0])
    checkpoint = started(plan)
    monkeypatch.setattr(
        claims, "synchronise_file", lambda path: path.is_file() and pushed.append((clock[0], path.name.split(".")[1]))
    )
    for first in range(12):
        add(checkpoint, first, 1)
        clock[0] += 0.4 if first < 8 else 1.5
    pushed_at = [(round(time, 9), int(name.rpartition("_")[2])) for time, name in pushed]
    assert pushed_at == [(1.2, 3), (2.4, 6), (4.7, 9), (6.2, 10), (7.7, 11)]
    assert [one.first for one in taken_up(plan).batches()] == list(range(12))


def test_a_piece_is_an_archive_that_others_can_read(plan: Plan) -> None:
    path = piece(started(plan, 0), 0)
    with zipfile.ZipFile(path) as archive:
        assert "status.npy" in archive.namelist() and archive.testzip() is None
    with open(path, "rb") as stream:
        stream.seek(SEAL)
        np.testing.assert_array_equal(np.load(stream)["status"], batch(0).status)


def test_a_folder_that_was_removed_during_the_run(plan: Plan) -> None:
    checkpoint = started(plan, 0)
    shutil.rmtree(checkpoint.folder)
    assert_refused("could not be written: No such file or directory", add, checkpoint, 4, error=RunError)
    assert_refused("holds 0 of 12 samples", list, checkpoint.batches(), error=RunError)


def test_a_shard_keeps_its_own_samples(plan: Plan) -> None:
    shard = replace(plan, shard=Shard(2, 3))
    assert shard.samples == (4, 8) and [replace(plan, shard=Shard(k, 3)).samples[0] for k in (1, 3)] == [0, 8]
    checkpoint = started(shard, 4)
    np.testing.assert_array_equal(checkpoint.columns()["status"], batch(4).status)
    assert firsts(taken_up(shard)) == {4}
    stranger = started(replace(shard, output=plan.output.with_name("whole.h5")), 4)
    shutil.copy(piece(stranger, 4), piece(checkpoint, 4).with_name("samples_000000000.npz"))
    checkpoint = taken_up(shard)
    assert firsts(checkpoint) == {4} and "which are none of this run" in str(*checkpoint.remarks)
    for other in (Shard(1, 3), Shard(2, 4), None):
        with pytest.raises(InputError, match="belongs to another run: its (shard|number of samples) differs"):
            again(replace(plan, shard=other))


def test_a_column_is_what_was_put_in_and_nan_elsewhere(tmp_path: Path) -> None:
    columns = Columns(tmp_path, 5)
    columns.put(3, {"outputs.x": np.array([3.0, 4.0]), "status": np.array([0, 2])})
    columns.put(0, {"outputs.x": np.array([0.5]), "outputs.y.z": np.array([True])})
    assert list(columns) == ["outputs.x", "status", "outputs.y.z"] and len(columns) == 3
    np.testing.assert_array_equal(columns["outputs.x"], [0.5, np.nan, np.nan, 3.0, 4.0])
    np.testing.assert_array_equal(columns["status"], [np.nan, np.nan, np.nan, 0.0, 2.0])
    outputs = columns.of("outputs")
    assert list(outputs) == ["x", "y.z"] and len(outputs) == 2 and not columns.of("errors")
    np.testing.assert_array_equal(outputs["y.z"], [1.0, np.nan, np.nan, np.nan, np.nan])
    with pytest.raises(KeyError):
        outputs["z"]


def test_it_leaves_no_file_and_lasts_longer_than_its_folder(tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    columns = Columns(tmp_path / "folder", 100_000)
    columns.put(1, {"a": np.arange(99_999.0)})
    (tmp_path / "folder").rmdir()
    np.testing.assert_array_equal(columns["a"], [np.nan, *range(99_999)])


def test_a_full_disk_is_said(tmp_path: Path) -> None:
    columns = Columns(tmp_path, 1000)
    said = "samples could not be put together in .*: File too large; what is"
    with full_disk(1000), pytest.raises(RunError, match=said):
        columns.put(0, {"a": np.zeros(1000)})
    with pytest.raises(RunError, match="samples could not be put together in .*gone': No such file"):
        Columns(tmp_path / "gone", 2)
