"""Kernels written once for numbers and for vectors, and the references by which they are given their arrays."""

import math
from typing import NamedTuple

import numpy as np
import pytest

from pgmp_petsc.full.part_reference import Reference, loaded
from pgmp_petsc.lanes.compiled import njit
from pgmp_petsc.lanes.lane_items import aligned, items, sine_cosine, width_of
from pgmp_petsc.lanes.vectors import CACHE_LINE, LANES


class Inner(NamedTuple):
    table: np.ndarray
    count: int
    factor: float
    wanted: bool


class Outer(NamedTuple):
    width: tuple[float, ...]
    inner: Inner
    pair: tuple[np.ndarray, np.ndarray]


class Optional(NamedTuple):
    inner: Inner | None
    table: np.ndarray


@njit(error_model="numpy")
def sines(x, width, sine, cosine):
    x, sine, cosine = items(x, width), items(sine, width), items(cosine, width)
    for k in range(x.size):
        sine[k], cosine[k] = sine_cosine(x[k])


@njit(error_model="numpy")
def by_value(inner):
    return inner.table[1, 2] * inner.count


@njit(error_model="numpy")
def read(outer):
    inner = outer.inner
    factor = inner.factor if inner.wanted else 0.0
    return inner.table[1, 2] * factor, inner.table.shape[1], outer.pair[1][3], len(outer.width), by_value(loaded(inner))


@njit(error_model="numpy")
def count_of(inner):
    if inner is None:
        return 0
    return inner.count


@njit(error_model="numpy")
def counted(outer):
    return outer.table.sum() + count_of(outer.inner)


@pytest.mark.parametrize("n_lanes", [1, LANES])
def test_sine_and_cosine_are_those_of_the_library(n_lanes: int) -> None:
    x = np.concatenate([np.linspace(-20.0, 20.0, 800), np.arange(-400, 400) * np.pi / 2, np.linspace(-1e6, 1e6, 800)])
    x = x.reshape(-1, n_lanes)
    sine, cosine = np.empty_like(x), np.empty_like(x)
    sines(x, width_of(n_lanes), sine, cosine)
    # the C library's; numpy's own are less exact on machines with AVX-512
    np.testing.assert_allclose(sine, np.vectorize(math.sin)(x), rtol=0, atol=3e-16)
    np.testing.assert_allclose(cosine, np.vectorize(math.cos)(x), rtol=0, atol=3e-16)


def test_numbers_are_the_same_alone_and_in_every_lane() -> None:
    x = np.random.default_rng(1).normal(0.0, 30.0, (50, LANES))
    together, alone = np.empty((2, *x.shape)), np.empty((2, x.size, 1))
    sines(x, width_of(LANES), *together)
    sines(x.reshape(-1, 1), width_of(1), *alone)
    np.testing.assert_array_equal(alone.reshape(together.shape), together)
    assert all(aligned((n, LANES)).ctypes.data % CACHE_LINE == 0 for n in range(1, 9))


def test_what_is_no_number_stays_in_its_lane() -> None:
    x = np.zeros((1, LANES))
    x[0, 2], x[0, 5] = np.nan, np.inf
    sine, cosine = np.empty_like(x), np.empty_like(x)
    sines(x, width_of(LANES), sine, cosine)
    np.testing.assert_array_equal(np.isnan(cosine), ~np.isfinite(x))
    np.testing.assert_array_equal(cosine[np.isfinite(x)], 1.0)


@pytest.mark.parametrize("wanted", [False, True])
def test_a_reference_gives_what_the_named_tuple_has(wanted: bool) -> None:
    table, pair = np.arange(6.0).reshape(2, 3), (np.arange(2), np.arange(4.0))
    outer = Outer(width_of(LANES), Inner(table, 7, 0.5, wanted), pair)
    assert read(Reference(outer)) == (2.5 if wanted else 0.0, 3, 3.0, LANES, 35.0)
    table[1, 2] = 9.0  # it is the array, no copy
    assert read(Reference(outer))[4] == 63.0


def test_nothing_is_compiled_for_what_is_not_there() -> None:
    """None has no count: compiling `count_of` for it would fail if the branch were not left out."""
    table = np.arange(6.0)
    assert counted(Reference(Optional(None, table))) == 15.0
    assert counted(Reference(Optional(Inner(table.reshape(2, 3), 7, 0.5, True), table))) == 22.0
