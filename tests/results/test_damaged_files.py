"""Random damage to results and pieces: one message, never a traceback, a hang, a crash, or wrong numbers.

PGMP_FUZZ=10 .venv/bin/python -m pytest tests/results/test_damaged_files.py        ten times as many cases
"""

import json
import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import h5py
import numpy as np
import pytest
import synthetic
from conftest import ROOT
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mpi4py import MPI
from runs import paper_scene, rom_of
from sealed import resealed

from pgmp_petsc.api.files import contents, describe
from pgmp_petsc.base.errors import InputError
from pgmp_petsc.ensemble.checkpoint import Checkpoint, Shards
from pgmp_petsc.ensemble.plan import Batch, Piece, Plan
from pgmp_petsc.mechanism.capabilities import Purpose
from pgmp_petsc.models.component_file import ComponentsFile
from pgmp_petsc.reduction.rom import ReducedOrderModel
from pgmp_petsc.results import Derivatives, Design, Ensemble, Fit, ModesTable, Tradeoff, Trajectory
from pgmp_petsc.results.ensemble import RareEvent, read_shard
from pgmp_petsc.results.trajectory import write_xdmf
from pgmp_petsc.scene import load_scene
from pgmp_petsc.studies.building import build_components
from pgmp_petsc.studies.inputs import with_meshes


def described(path: Path) -> str:
    """Return what ``pgmp info`` says of a file."""
    return describe(contents(path))


def whole_shard(path: Path) -> None:
    with read_shard(path) as found:
        for arrays in (found.columns, found.bands):
            assert all(values.ndim for values in arrays.values())


FACTOR = float(os.environ.get("PGMP_FUZZ", "1"))
READERS: dict[str, Callable[[Path], object]] = {
    "rom": ReducedOrderModel.read, "components": ComponentsFile.read, "trajectory": Trajectory.read,
    "ensemble": Ensemble.read, "modes": ModesTable.read, "tradeoff": Tradeoff.read, "sensitivities": Derivatives.read,
    "fit": Fit.read, "design": Design.read, "rare_event": RareEvent.read, "shard": whole_shard,
}  # fmt: skip


def cases(n: int) -> Callable:
    """Return the settings of a test with ``n`` random cases, the same in every run."""
    unlimited = {"deadline": None, "derandomize": True, "database": None, "suppress_health_check": list(HealthCheck)}
    return settings(max_examples=max(1, int(FACTOR * n)), **unlimited)


@lru_cache(maxsize=1)
def rom() -> ReducedOrderModel:
    return rom_of(paper_scene("reduction.modes=3", "reduction.angles=6", "reduction.second_order=true"))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Return a directory with a sound file of every kind."""
    folder = tmp_path_factory.mktemp("sound")
    mixed = load_scene(ROOT / "scenes" / "spatial_mixed.toml")  # rigid and flexible bodies of cells, and of beams
    components = build_components(*with_meshes(mixed, Purpose.COMPONENTS), MPI.COMM_SELF)
    sound = {
        "rom": rom(), "components": components, "trajectory": synthetic.trajectory(n_frames=2),
        "ensemble": synthetic.ensemble("reduced", n_samples=12), "modes": synthetic.modes_table(n_theta=5),
        "tradeoff": synthetic.tradeoff(), "sensitivities": synthetic.derivatives(), "fit": synthetic.fitted(),
        "design": synthetic.designed(), "rare_event": synthetic.rare_event(), "shard": synthetic.shard(),
    }  # fmt: skip
    for kind, result in sound.items():
        result.write(folder / f"{kind}.h5")
    yield folder


kinds = st.sampled_from(sorted(READERS))
share = st.floats(0.0, 1.0, exclude_max=True)
byte_changes = st.one_of(
    st.tuples(st.just("cut"), share),
    st.tuples(st.just("flip"), st.lists(st.tuples(share, st.integers(0, 7)), min_size=1, max_size=4)),
    st.tuples(st.just("overwrite"), share, st.binary(min_size=1, max_size=64)),
    st.tuples(st.just("insert"), share, st.binary(min_size=1, max_size=64)),
    st.tuples(st.just("remove"), share, st.integers(1, 2000)),
    st.tuples(st.just("append"), st.binary(min_size=1, max_size=64)),
    st.tuples(st.just("zero"), share, st.integers(1, 5000)),
)


def damaged(whole: bytes, change: tuple) -> bytes:
    what, *details = change
    content = bytearray(whole)
    if what == "append":
        return whole + details[0]
    if what == "flip":
        for place, bit in details[0]:
            content[int(place * len(whole))] ^= 1 << bit
        return bytes(content)
    place = int(details[0] * len(whole))
    if what == "cut":
        return whole[:place]
    if what == "overwrite":
        content[place : place + len(details[1])] = details[1]
        return bytes(content[: len(whole)])
    if what == "insert":
        return whole[:place] + details[1] + whole[place:]
    if what == "remove":
        return whole[:place] + whole[place + details[1] :]
    end = min(len(whole), place + details[1])
    return whole[:place] + bytes(end - place) + whole[end:]


@cases(40)
@given(kind=kinds, change=byte_changes)
def test_bytes_that_changed_are_told(folder: Path, kind: str, change: tuple) -> None:
    whole = (folder / f"{kind}.h5").read_bytes()
    path = folder / "damaged.h5"
    path.write_bytes(damaged(whole, change))
    if path.read_bytes() == whole:
        READERS[kind](path)
        return
    for read in (READERS[kind], described):
        with pytest.raises(InputError, match="damaged.h5' (is damaged: .*again|is not an HDF5|was not written by)"):
            read(path)


VALUES = (
    np.float64(np.nan), np.int64(-1), 10**9, "", "text", "null", "[", "[1]", '{"a": {}}', "x" * 70_000, b"\xff\xfe", [],
    np.zeros((0, 3)), np.zeros(5), np.zeros((2, 2)), np.zeros((1, 1, 1, 1)), np.full(3, np.inf), np.array([1 + 2j]),
    np.array([True, False]), ["a", "b"], np.array([b"a", b"bc"]), h5py.Empty("f8"), np.zeros(2, dtype="i4,f8"),
    np.array([2**63], dtype="u8"), np.arange(3, dtype="i1"), [[1.0]], "1.0",
)  # fmt: skip
structure_changes = st.tuples(
    st.sampled_from(("remove", "replace", "group", "huge", "attribute", "no attribute", "rename")),
    st.integers(0, 10**6), st.integers(0, 10**6), st.sampled_from(range(len(VALUES))),
)  # fmt: skip


def restructure(file: h5py.File, change: tuple) -> None:
    """Change one entry of a file: its content, its attributes, or whether it is there."""
    what, number, other, value = change
    names: list[str] = []
    file.visit(names.append)
    name = names[number % len(names)]
    if "attribute" in what:
        holders = [item for item in (file, *(file[name] for name in names)) if len(item.attrs)]
        holder = holders[number % len(holders)] if number % 3 else file
        attribute = sorted(holder.attrs)[other % len(holder.attrs)]
        del holder.attrs[attribute]
        if what == "attribute":
            holder.attrs[attribute] = VALUES[value]
        return
    if what == "rename":
        file.move(name, f"{name}_")
        return
    kept = dict(file[name].attrs)
    del file[name]
    if what == "group":
        file.create_group(name)
    elif what == "huge":
        file.create_dataset(name, shape=(2**40,) * (1 + other % 3), dtype="f8", chunks=(1,) * (1 + other % 3))
    elif what == "replace":
        file[name] = VALUES[value]
    if what != "remove" and other % 2:
        file[name].attrs.update(kept)


@cases(120)
@given(kind=kinds, changes=st.lists(structure_changes, min_size=1, max_size=2))
def test_a_structure_that_changed_is_told_or_does_not_matter(folder: Path, kind: str, changes: list[tuple]) -> None:
    """With a seal that fits: the readers check what they read."""
    path = folder / "changed.h5"
    shutil.copy(folder / f"{kind}.h5", path)
    with resealed(path) as file:
        for change in changes:
            restructure(file, change)
    uses: list[Callable[[Path], object]] = [READERS[kind], described]
    uses += [lambda path: write_xdmf(path, path.with_suffix(".xdmf"))] if kind == "trajectory" else []
    for use in uses:
        try:
            use(path)
        except InputError as error:
            assert "changed.h5'" in str(error)


def test_a_shard_that_changed_is_told(folder: Path) -> None:
    """What no other shard fits: other lengths, missing numbers, another kind of units."""
    cases = {
        "columns 'parameters.r1' has shape": ("columns/parameters.r1", np.ones(3)),
        "bands are of 9 samples; needed: at most the 4": ("bands/crank_angle", np.ones((9, 3))),
        "dataset '/columns/parameters.r1' holds NaN": ("columns/parameters.r1", np.full(4, np.nan)),
        "outputs.crank_angle is NaN of fine samples": ("columns/outputs.crank_angle", np.full(4, np.nan)),
        "bands at 2 instants, not 3": ("bands/crank_angle", np.ones((4, 2))),
    }
    both = [folder / "shard.h5", folder / "other_shard.h5"]
    for message, (name, values) in cases.items():
        place = replace(synthetic.shard().place, number=2, first=4)
        replace(synthetic.shard(), place=place).write(both[1])
        with resealed(both[1]) as file:
            del file[name]
            file[name] = values
        said = f"other_shard.h5' is damaged: {message}.*; write it again"
        with pytest.raises(InputError, match=said), ExitStack() as s:
            shards = Shards(both, [s.enter_context(read_shard(path)) for path in both], folder)
            shards.columns()


def piece_of(first: int) -> Batch:
    numbers = first + np.arange(4.0)
    named, status = {"angle": -numbers, "x": numbers / 7}, np.zeros(4, dtype=int)
    return Batch(first, {"r1": numbers}, named, status, np.full(4, np.nan), named, named, {"bent": numbers})


@cases(100)
@given(change=byte_changes, first=st.sampled_from((0, 4, 8)))
def test_a_damaged_piece_is_named_and_the_others_stay(folder: Path, change: tuple, first: int) -> None:
    plan = Plan(12, 3, folder / "e.h5", False)
    checkpoint = Checkpoint(plan, "scene", "reduced", "tables", ("random", ""))
    checkpoint.open()
    for number in (0, 4, 8):
        checkpoint.add(Piece(number, number + 4), piece_of(number))
    path = checkpoint.folder / f"samples_{first:09d}.npz"
    whole = path.read_bytes()
    path.write_bytes(damaged(whole, change))
    same = path.read_bytes() == whole
    again = Checkpoint(Plan(12, 3, folder / "e.h5", True), "scene", "reduced", "tables", ("random", ""))
    assert {begin for begin, _ in again.open().samples} == {0, 4, 8} - (set() if same else {first})
    assert len(again.remarks) == (0 if same else 1) and all(path.name in str(remark) for remark in again.remarks)


@cases(50)
@given(change=byte_changes)
def test_a_damaged_label_is_a_message(folder: Path, change: tuple) -> None:
    plan = Plan(12, 3, folder / "l.h5", False)
    checkpoint = Checkpoint(plan, "scene", "reduced", "tables", ("random", ""))
    shutil.rmtree(checkpoint.folder, ignore_errors=True)
    checkpoint.open()
    checkpoint.add(Piece(0, 4), piece_of(0))
    label = checkpoint.folder / "run.json"
    before = label.read_bytes()
    label.write_bytes(damaged(before, change))
    again = Checkpoint(Plan(12, 3, folder / "l.h5", True), "scene", "reduced", "tables", ("random", ""))
    try:
        assert again.open().samples == ((0, 4),)
        assert json.loads(label.read_bytes()) == json.loads(before)
    except InputError as error:
        assert "l.h5.partial'" in str(error)
