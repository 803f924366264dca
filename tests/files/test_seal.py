"""Seals: everything that is not as it was written is noticed; identities of data."""

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from pgmp_petsc.files.seal import SIZE, BrokenSeal, Seal, check_seal, identity, seal, seal_of, sealed

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
