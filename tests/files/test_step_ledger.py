"""The ledger of a job of several steps: what counts as finished, begun, or failed."""

import os
from pathlib import Path

import pytest
import synthetic

from pgmp_petsc.base.errors import InputError, RunError
from pgmp_petsc.files import claims
from pgmp_petsc.files.checkpoint_folder import LEDGER, Steps


@pytest.fixture
def steps(tmp_path: Path) -> Steps:
    """Return the ledger of a folder with one finished file."""
    steps = Steps(tmp_path / "job")
    steps.make()
    steps.begin("run.h5", "key")
    synthetic.trajectory(n_frames=0, n_times=5).write(steps.folder / "run.h5")
    steps.finish("run.h5", "key", "it stopped early")
    return steps


def test_a_file_is_finished_with_its_own_key_alone(steps: Steps) -> None:
    assert steps.is_finished("run.h5", "key") and not steps.is_finished("run.h5", "other")
    assert not steps.is_finished("none.h5", "key")
    assert steps.failure("run.h5") == "it stopped early"
    Steps(steps.folder).make()  # a later job keeps what is known
    assert steps.is_finished("run.h5", "key")


def test_a_file_that_is_another_or_damaged_is_not_finished(steps: Steps) -> None:
    path = steps.folder / "run.h5"
    whole = path.read_bytes()
    path.write_bytes(whole[:-7])
    assert not steps.is_finished("run.h5", "key")
    synthetic.trajectory("reduced", n_frames=0, n_times=5).write(steps.folder / "other.h5")
    os.replace(steps.folder / "other.h5", path)
    assert not steps.is_finished("run.h5", "key")
    path.write_bytes(whole)
    assert steps.is_finished("run.h5", "key")
    path.unlink()
    assert not steps.is_finished("run.h5", "key")


def test_what_was_begun_is_taken_up_where_pieces_are_left(steps: Steps) -> None:
    steps.begin("rom.h5", "key")
    assert not steps.was_begun("rom.h5", "key")
    (steps.folder / "rom.h5.partial").mkdir()
    assert steps.was_begun("rom.h5", "key") and not steps.was_begun("rom.h5", "other")


@pytest.mark.parametrize("text", ["", '{"format": 99, "files": {"run.h5": {"key": "key"}}}'])
def test_an_empty_ledger_and_one_of_another_version_know_nothing(steps: Steps, text: str) -> None:
    (steps.folder / LEDGER).write_text(text)
    assert not steps.is_finished("run.h5", "key")
    steps.make()
    assert not steps.is_finished("run.h5", "key")


def test_folders_of_others_and_impossible_ones_are_refused(tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("mine")
    with pytest.raises(InputError, match="holds files and is none of pgmp run"):
        Steps(tmp_path).make()
    for folder in (tmp_path / "mine.txt", tmp_path / "none" / "job"):
        with pytest.raises(InputError, match="cannot be made: .*; give another with -o"):
            Steps(folder).make()
    assert (tmp_path / "mine.txt").read_text() == "mine"


@pytest.mark.parametrize("text", ["no JSON", "[]", '{"steps": [1]}', '{"format": 1, "files": {"a": 3}}', "[" * 10**5])
def test_a_ledger_of_somebody_else_is_left_alone(tmp_path: Path, text: str) -> None:
    (tmp_path / LEDGER).write_text(text)
    with pytest.raises(InputError, match="its steps.json is none of pgmp run; give another folder with -o, or move"):
        with Steps(tmp_path).held():
            raise AssertionError("held")
    assert (tmp_path / LEDGER).read_text() == text and len(list(tmp_path.iterdir())) == 1


def test_one_job_holds_a_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(claims, "PATIENCE", 0.1)
    holder = Steps(tmp_path / "job")
    with holder.held():
        said = rf"folder '.*job' is being written by another job \(process {os.getpid()} on .*\); wait for its end, or"
        with pytest.raises(InputError, match=said), Steps(tmp_path / "job").held():
            raise AssertionError("held twice")
        holder.begin("run.h5", "key", "--set a=1")
    with Steps(tmp_path / "job").held():
        assert holder.replaced("run.h5") is None  # begun, not finished
    with Steps(tmp_path / "other").held():
        pass
    assert not (tmp_path / "other").exists()


def test_whose_file_is_replaced(steps: Steps) -> None:
    assert steps.replaced("run.h5") == "" and steps.replaced("rom.h5") is None
    steps.begin("run.h5", "other", "--set a=1")
    assert steps.replaced("run.h5") is None
    steps.finish("run.h5", "other", "")
    assert steps.replaced("run.h5") == "--set a=1"


def test_files_of_another_program_do_not_get_into_the_report(steps: Steps) -> None:
    steps.check_files(["run.h5"])
    synthetic.trajectory("reduced", n_frames=0, n_times=5).write(steps.folder / "run.h5")
    with pytest.raises(RunError, match="run.h5' was changed or removed by another program while this job worked"):
        steps.check_files(["run.h5"])
    (steps.folder / LEDGER).unlink()
    with pytest.raises(RunError, match="steps.json' was changed or removed by another program"):
        steps.checksum("run.h5")
