"""Result files: whole or not there, and every reason to refuse one."""

import os
import resource
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np
import pytest
from sealed import resealed

from pgmp_petsc import __version__
from pgmp_petsc.base.errors import InputError, RunError
from pgmp_petsc.base.resources import Timings
from pgmp_petsc.files import hdf5
from pgmp_petsc.files.hdf5 import BUILD_AGAIN, FORMAT_VERSION, RunRecord, open_file, put, shapes_of, take, write_file

RECORD = RunRecord('[scene]\nname = "x"\n', {"r1": 5.6e-3}, 7, 3, {"write": 0.5, "assemble": 1.0})


@pytest.fixture
def good(tmp_path):
    """Return the path of a small whole file."""
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
    before = good.read_bytes()
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, limits[1]))
    try:
        with pytest.raises(RunError, match="could not be written"), write_file(good, "modes") as file:
            RECORD.write(file)
            put(file, "theta", np.arange(1e5), "rad", "too much")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
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
    with pytest.raises(InputError, match="no permission to read"):
        open_file(good, "modes")


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
    with pytest.raises(InputError, match=said):
        open_file(good, kind)


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
