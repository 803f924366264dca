"""Records: what follows from a field that says its sizes, its unit and its meaning."""

import re
import weakref
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import file_tables
import h5py
import numpy as np
import pytest
from every_result import PARTS, RESULTS
from file_tables import described
from sealed import resealed

from pgmp_petsc.api.result import variables
from pgmp_petsc.base.errors import InputError
from pgmp_petsc.declare.records import FLAGS, Record, array, attribute, check_sizes


@dataclass(frozen=True)
class Inner(Record):
    values: np.ndarray = array("time", unit="{unit}", about="values of '{name}' at {own.level!p}", label="inner.{name}")
    level: float = attribute("@level", allowed=())


@dataclass(frozen=True)
class Row(Record):
    name: str = attribute("@names", about="names")
    lower: float = array(at="limits", part=0, about="limits")
    upper: float = array(at="limits", part=1)
    is_met: bool = array(stored=np.int8, about="whether it is met")


@dataclass(frozen=True)
class Sample(Record):
    time: np.ndarray = array("time", unit="s", about="instants", label="time", is_axis=True)
    units: dict[str, str] = attribute("@units", code=(str, eval))
    inner: dict[str, Inner] = array(ordered=True)
    rows: tuple[Row, ...] = array("row", at="")
    grid: np.ndarray = array("layer?", "time", about="a grid")
    flags: np.ndarray = array("time", about="truth values", stored=int, code=FLAGS)
    texts: tuple[str, ...] = array("row", about="texts")
    kind: str = attribute("@kind", allowed=("one", "two"), default="one")
    limit: float | None = attribute("@limit", default=None)
    late: np.ndarray | None = array("time", about="may be missing", absent=None, gaps=True)
    padded: np.ndarray | None = array("time", "dimension", about="with zeros", absent=None, padded=3, default=None)


def sample(**changes: object) -> Sample:
    inner = {name: Inner(np.arange(3.0), 0.25) for name in ("b", "a")}
    rows = (Row("x", 0.0, 1.0, True), Row("y", 2.0, 3.0, False))
    fields = {
        "time": np.arange(3.0), "units": {"a": "m", "b": "N"}, "inner": inner, "rows": rows, "grid": np.ones(3),
        "flags": np.array([True, False, True]), "texts": ("one", "two"),
    }  # fmt: skip
    return Sample(**(fields | changes))


def kept(one: Sample, path: Path) -> Sample:
    with h5py.File(path, "w") as file:
        one.put(file)
        file.flush()  # readers look at how large the file is
        return Sample.take(file)


def test_a_record_comes_back(tmp_path: Path) -> None:
    again = kept(sample(late=np.array([1.0, np.nan, 2.0]), grid=np.ones((2, 3))), tmp_path / "f.h5")
    assert list(again.inner) == ["b", "a"] and again.inner["a"].level == 0.25
    assert again.rows == sample().rows and again.texts == ("one", "two") and again.limit is None
    assert check_sizes(sample()) == {"time": 3, "row": 2, "layer": 1}
    assert again.flags.dtype == bool and again.grid.shape == (2, 3) and np.isnan(again.late[1])
    with h5py.File(tmp_path / "f.h5") as file:
        about = file["inner/a/values"].attrs
        assert (about["unit"], about["description"]) == ("m", "values of 'a' at 25 %")
        assert file["is_met"].dtype == np.int8 and file["limits"].shape == (2, 2) and "padded" not in file


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"time": np.zeros((3, 1))}, r"time has shape \(3, 1\); needed: \(time\)"),
        ({"flags": np.zeros(4, dtype=bool)}, r"flags has shape \(4,\); needed: \(time: 3\)"),
        ({"inner": {"a": Inner(np.zeros(2), 0.5)}}, r"inner 'a': values has shape \(2,\); needed: \(time: 3\)"),
        ({"grid": np.zeros((2, 4))}, r"grid has shape \(2, 4\); needed: \(layer\?, time: 3\)"),
        ({"grid": np.zeros((2, 3, 1))}, r"grid has shape \(2, 3, 1\)"),
        ({"texts": ("one",)}, r"texts has shape \(1,\); needed: \(row: 2\)"),
        ({"kind": "three"}, "kind is 'three'; allowed: one, two"),
    ],
)
def test_equal_names_are_equal_sizes(change: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        sample(**change)


def change(name: str, value: object = None) -> object:
    def changed(file: h5py.File) -> None:
        del file[name]
        if value is not None:
            file[name] = value

    return changed


def drop(path: str, key: str) -> object:
    return lambda file: file[path].attrs.__delitem__(key)


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (change("time"), "dataset '/time' is missing"),
        (change("time", [0.0, np.nan, 1.0]), "dataset '/time' holds NaN, which no number of it can be"),
        (change("time", np.zeros((3, 1))), r"dataset '/time' has shape \(3, 1\); needed: 1 dimension"),
        (change("grid", np.zeros((1, 1, 3))), r"has shape \(1, 1, 3\); needed: 2 dimension"),
        (change("inner"), "'/inner' is missing"), (change("inner", np.zeros(3)), "'/inner' is no group"),
        (change("inner/a", np.zeros(3)), "'/inner/a' is no group"), (change("limits", np.zeros((1, 2))), "zip"),
        (drop("/", "kind"), "kind"), (drop("inner/a", "level"), "level"),
    ],
)  # fmt: skip
def test_what_is_damaged_is_told(damage, message: str, tmp_path: Path) -> None:
    kept(sample(), tmp_path / "f.h5")
    with h5py.File(tmp_path / "f.h5", "r+") as file:
        damage(file)
        file.flush()
        with pytest.raises((InputError, LookupError, ValueError, TypeError), match=message):
            Sample.take(file)


class Counting(Mapping):
    """Arrays that are made when they are asked for, and how many of them there were at once."""

    def __init__(self) -> None:
        self.most, self._made = 0, []

    def __getitem__(self, name: str) -> np.ndarray:
        made = np.ones(12)
        self._made.append(weakref.ref(made))
        self.most = max(self.most, sum(one() is not None for one in self._made))
        return made

    def __iter__(self) -> Iterator[str]:
        return iter([f"x{k}" for k in range(9)])

    def __len__(self) -> int:
        return 9


def test_columns_in_a_file_are_written_one_after_the_other(tmp_path: Path) -> None:
    """The one that is written, and the one that is read meanwhile."""
    columns = Counting()
    replace(RESULTS["ensemble_bare"](), outputs=columns).write(tmp_path / "f.h5")
    assert columns.most <= 2


def test_padding_goes_again(tmp_path: Path) -> None:
    """By the name of a size that another array has, as of bodies in a plane."""
    body = RESULTS["trajectory"]().fields["bar"]
    with h5py.File(tmp_path / "f.h5", "w") as file:
        body.put(file)
        file.flush()
        assert file["points/00000"].shape == (len(body.nodes), 3)
        assert type(body).take(file).positions.shape[-1] == 2


def test_variables_have_sizes_for_axes() -> None:
    found = dict(variables(sample()))
    assert found["inner.a"].axes == ("time",) and found["inner.a"].attributes["units"] == "m"
    assert found["time"].is_axis and set(found) == {"time", "inner.a", "inner.b"}


def pattern(place: str) -> str:
    """Return the expression of the datasets of a row of the tables."""
    return re.sub(r"<[a-z_]+>", "[^/]+", re.escape(place).replace(r"\<", "<").replace(r"\>", ">"))


@pytest.mark.parametrize("name", RESULTS)
def test_every_dataset_is_declared_and_numbers_that_are_missing_are_told(name: str, tmp_path: Path) -> None:
    """One number of a whole file after the other: those are refused that docs/files.md does not let miss."""
    result, path = RESULTS[name](), tmp_path / "f.h5"
    result.write(path)
    whole, places, tried = path.read_bytes(), [], set()
    with h5py.File(path) as file:
        file.visititems(lambda place, item: places.append((place, getattr(item, "dtype", None))))
    for place, kind in places:
        rows = [row for row in described(type(result)) if re.fullmatch(pattern(row.place), place)]
        rows.sort(key=lambda row: row.place.count("<"))
        if kind is None or place.startswith("timings"):
            continue
        assert rows, place
        if kind != "f8" or rows[0].is_derived or rows[0].place in tried or name.startswith("shard"):
            continue
        tried.add(rows[0].place)
        path.write_bytes(whole)
        with resealed(path) as file:
            values = np.array(file[place][()])
            values.flat[:1] = np.nan
            file[place][...] = values
        if not values.size or rows[0].gaps:
            type(result).read(path)
            continue
        with pytest.raises(
            InputError, match=f"damaged: dataset '/{place}' holds NaN, which no number of it can be; write"
        ):
            type(result).read(path)


def test_the_page_of_files_is_that_of_the_declarations() -> None:
    assert file_tables.PAGE.read_text(encoding="utf-8") == file_tables.page(), "run: python tests/file_tables.py"
    assert {row.place for part in PARTS for row in described(type(part))} >= {"selection/errors", "effects/shares"}
