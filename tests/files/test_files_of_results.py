"""Files of results and of jobs: written whole or not at all, sealed, known as finished by their own key."""

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np
import pytest
import synthetic
from refusals import assert_refused, full_disk
from sealed import resealed

from pgmp_petsc import __version__
from pgmp_petsc.base.errors import InputError, RunError
from pgmp_petsc.base.resources import Timings
from pgmp_petsc.files import claims, hdf5
from pgmp_petsc.files.checkpoint_folder import LEDGER, Steps
from pgmp_petsc.files.hdf5 import BUILD_AGAIN, FORMAT_VERSION, RunRecord, open_file, put, shapes_of, take, write_file
from pgmp_petsc.files.seal import SIZE, BrokenSeal, Seal, check_seal, identity, seal, seal_of, sealed

RECORD = RunRecord('[scene]\nname = "x"\n', {"r1": 5.6e-3}, 7, 3, {"write": 0.5, "assemble": 1.0})


@pytest.fixture
def good(tmp_path):
    path = tmp_path / "good.h5"
    with write_file(path, "modes", {"colour": "red"}) as file:
        RECORD.write(file)
        put(file, "theta", np.arange(3.0), "rad", "angles")
    return path


def test_record_and_attributes_come_back(good):
    with open_file(good, "modes") as file:
        assert file.attrs["format_version"] == FORMAT_VERSION
        assert file.attrs["program_version"] == __version__
        assert (file.attrs["kind"], file.attrs["colour"]) == ("modes", "red")
        assert file["timings/write"].attrs["unit"] == "s"
        assert (file["theta"].attrs["unit"], file["theta"].attrs["description"]) == ("rad", "angles")
        record = RunRecord.read(file)
    assert record == RECORD
    assert list(record.timings) == ["write", "assemble"]


def test_no_seed_is_a_null_attribute_and_scenes_may_be_long(tmp_path):
    scene = "# a long torque table\n" * 20_000  # more than 64 KiB
    with write_file(tmp_path / "f.h5", "rom") as file:
        RunRecord(scene, {}, None, 1).write(file)
    with open_file(tmp_path / "f.h5", ["rom"]) as file:
        assert isinstance(file.attrs["seed"], h5py.Empty)
        assert RunRecord.read(file) == RunRecord(scene, {}, None, 1, {})


def test_an_error_while_writing_keeps_the_old_file_and_leaves_nothing_else(good):
    before = good.read_bytes()
    with pytest.raises(ZeroDivisionError), write_file(good, "modes"):
        1 / 0
    assert good.read_bytes() == before
    assert os.listdir(good.parent) == [good.name]


def test_the_file_appears_when_it_is_complete(tmp_path):
    path = tmp_path / "f.h5"
    with write_file(path, "modes") as file:
        RECORD.write(file)
        put(file, "a", np.arange(1e5), "1", "numbers")
        file.flush()
        np.testing.assert_array_equal(file["a"][...], np.arange(1e5))
        assert not path.exists()
    assert os.listdir(tmp_path) == ["f.h5"]


def test_a_symbolic_link_is_written_through(good):
    link = good.parent / "link.h5"
    link.symlink_to(good)
    with write_file(link, "modes", {"colour": "blue"}) as file:
        RECORD.write(file)
    assert link.is_symlink()
    with open_file(good, "modes") as file:
        assert file.attrs["colour"] == "blue"


def test_a_full_disk_is_a_run_error_and_keeps_the_old_file(good):
    before, said = good.read_bytes(), "could not be written"
    with full_disk(20_000), pytest.raises(RunError, match=said), write_file(good, "modes") as file:
        RECORD.write(file)
        put(file, "theta", np.arange(1e5), "rad", "too much")
    assert good.read_bytes() == before
    assert os.listdir(good.parent) == [good.name]


def test_what_is_raised_of_what_could_not_be_written_is_a_full_disk():
    """HDF5 reads back what it wrote, and calls it damaged."""
    with pytest.raises(OSError, match="No space left"), hdf5.GuardedStream(Path("/dev/full")) as stream:
        stream.write(b"data")
        stream.flush()
        raise RuntimeError("incorrect metadata checksum after all read attempts")


def test_an_unknown_kind_is_a_mistake_of_the_caller(tmp_path):
    with pytest.raises(ValueError, match="allowed: rom"), write_file(tmp_path / "f.h5", "picture"):
        pass


def test_a_file_without_permission(good, monkeypatch):
    monkeypatch.setattr(hdf5.os, "access", lambda path, mode: False)
    assert_refused("no permission to read", open_file, good, "modes")


def with_attributes(**values: object) -> Callable[[Path], None]:
    """Return what gives a file other attributes, none of a value that is None, under a seal that fits."""

    def change(path: Path) -> None:
        with resealed(path) as file:
            for name, value in values.items():
                if value is None:
                    del file.attrs[name]
                else:
                    file.attrs[name] = value

    return change


def another_version(path: Path) -> None:
    with resealed(path, format=99):
        pass


UNREADABLE = {
    "none": (Path.unlink, ["trajectory", "ensemble"], "does not exist; needed: a trajectory or an ensemble"),
    "begun": (
        lambda path: (path.unlink(), path.with_name(f"{path.name}.partial").mkdir()), "rom",
        r"does not exist; '.*\.h5\.partial' has what a run has finished of it; needed: a reduced model",
    ),
    "a directory": (lambda path: (path.unlink(), path.mkdir()), "rom", "is a directory"),
    "text": (lambda path: path.write_text("[scene]\n"), "rom", "is not an HDF5 file"),
    "cut off": (
        lambda path: os.truncate(path, path.stat().st_size // 2), "modes",
        r"is damaged: it is cut off after \d+ of \d+ bytes; write it again",
    ),
    "another kind": (lambda path: None, "rom", "holds a table of modes; needed: a reduced model"),
    "another version": (another_version, "modes", f"format version 99; this pgmp .* reads version {FORMAT_VERSION}"),
    "of another program": (lambda path: h5py.File(path, "w").close(), "modes", "was not written by this pgmp"),
    "without attributes": (with_attributes(scene=None, seed=None), "modes", "lacks the attribute.s. scene, seed"),
    # which the seal does not know
    **{
        f"with {name} {value}": (with_attributes(**{name: value}), "modes", "is damaged: ")
        for name, value in (("format_version", 1), ("kind", "rom"), ("kind", [1, 2]), ("kind", 3.0))
    },
}  # fmt: skip


@pytest.mark.parametrize("name", UNREADABLE)
def test_what_cannot_be_read_is_refused(good, name):
    change, kind, said = UNREADABLE[name]
    change(good)
    assert_refused(said, open_file, good, kind)


def test_datasets_that_are_missing_or_of_another_shape(good):
    with open_file(good, "modes") as file:
        with (
            pytest.raises(InputError, match="is damaged: dataset '/time' is missing; build"),
            shapes_of(file, BUILD_AGAIN),
        ):
            take(file, "time", 1)
        with pytest.raises(InputError, match=r"'/theta' has shape \(3,\); needed: 2 .*; write"), shapes_of(file):
            take(file, "theta", 2)


def test_timings_accumulate_also_where_a_phase_fails():
    timings = Timings()
    for _ in range(2):
        with pytest.raises(ZeroDivisionError), timings.phase("tables"):
            1 / 0
    with timings.phase("modes"):
        pass
    seconds = timings.as_dict()
    assert list(seconds) == ["tables", "modes"] and all(value >= 0.0 for value in seconds.values())
    assert timings.maximum(SimpleNamespace(size=1, rank=0)).as_dict() == seconds
    assert Timings({"tables": 1.25}).table() == "tables       1.250 s"
    assert Timings().table() == ""


CONTENT = bytes(range(256)) * 3


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "sealed"
    path.write_bytes(bytes(SIZE) + CONTENT)
    seal(path, "rom", 2, "a run")
    return path


def test_a_seal_says_what_it_was_given(path: Path) -> None:
    found = check_seal(path)
    assert (found.kind, found.format, found.run, found.bytes) == ("rom", 2, "a run", SIZE + len(CONTENT))
    assert seal_of(path) == found
    assert path.read_bytes()[SIZE:] == CONTENT and path.read_bytes().startswith(b"pgmp_petsc\n{")
    # content in memory gets the same
    seal(path, "rom", 3, "run")
    whole = path.read_bytes()
    assert sealed(memoryview(whole)[SIZE:], "rom", 3, "run") == whole


def test_every_flipped_bit_is_noticed(path: Path) -> None:
    """All of the 1,280 bytes, a different bit each."""
    whole = path.read_bytes()
    for place in range(len(whole)):
        changed = bytearray(whole)
        changed[place] ^= 1 << place % 8
        path.write_bytes(changed)
        with pytest.raises(BrokenSeal):
            check_seal(path)


def test_every_cut_and_what_was_added_is_noticed(path: Path) -> None:
    whole = path.read_bytes()
    path.write_bytes(whole + b"x")
    with pytest.raises(BrokenSeal, match="1281 bytes instead of 1280"):
        check_seal(path)
    for length in range(0, len(whole), 7):
        path.write_bytes(whole[:length])
        with pytest.raises(BrokenSeal, match="cut off|no seal"):
            check_seal(path)


def test_a_pipe_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.h5")
    with pytest.raises(BrokenSeal, match="no regular file"):
        seal_of(tmp_path / "pipe.h5")


@pytest.mark.parametrize("text", [b"{}", b"null", b"[1, 2]", b'{"kind": 1}', b"[" * 400, b"\xff\xfe"])
def test_a_head_that_is_no_seal(path: Path, text: bytes) -> None:
    path.write_bytes((b"pgmp_petsc\n" + text).ljust(SIZE - 1) + b"\n" + CONTENT)
    with pytest.raises(BrokenSeal, match="first bytes have changed"):
        check_seal(path)


def test_a_seal_that_does_not_fit_is_a_mistake_of_the_caller() -> None:
    with pytest.raises(ValueError, match="allowed: 511"):
        Seal("x" * 600, 1).packed()


@dataclass(frozen=True)
class Pair:
    one: np.ndarray
    other: dict[str, float]


def test_equal_data_alone_have_the_same_identity() -> None:
    data = [Pair(np.arange(6.0).reshape(2, 3), {"a": 1.0, "b": np.nan}) for _ in range(2)]
    assert identity(data[0], None, "x") == identity(data[1], None, "x")
    turned = np.asfortranarray(data[0].one)
    assert identity(turned) == identity(data[0].one)
    a = np.arange(6.0)
    different = [
        a, a.reshape(2, 3), a.reshape(3, 2), a.astype("f4"), a.astype(int), np.nextafter(a, 9.0), a[:5], a[:0],
        a[:0].reshape(0, 3), np.array(["a", "b"]), np.array(["ab"]), "ab", b"ab", ("a", "b"), ("ab",), {"a": "b"}, None,
        "None", 1, 1.0, True, "1", (), {}, Pair(a, {}), Pair(a, {"x": 1.0}), {"one": a, "other": {}},
    ]  # fmt: skip
    assert len({identity(value) for value in different}) == len(different)
    with pytest.raises(TypeError, match="no identity of object"):
        identity({"a": object()})
    with pytest.raises(TypeError, match="no identity of ndarray"):
        identity(np.array([object()]))


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
    assert_refused("holds files and is none of pgmp run", Steps(tmp_path).make)
    for folder in (tmp_path / "mine.txt", tmp_path / "none" / "job"):
        assert_refused("cannot be made: .*; give another with -o", Steps(folder).make)
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
    assert_refused("steps.json' was changed or removed by another program", steps.checksum, "run.h5", error=RunError)
