"""Reduced models of candidates: the latest stay, the oldest go, and what went is built again when it is wanted."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from pgmp_petsc.bench.bench import Shelf, bytes_of
from pgmp_petsc.scene.numerics import Reduction


@dataclass
class Model:
    modes: int
    table: np.ndarray


def reduction(modes: int) -> Reduction:
    return Reduction(modes=modes)


class Builder:
    def __init__(self, n_bytes: int) -> None:
        self.n_bytes, self.built = n_bytes, []

    def __call__(self, asked: Reduction) -> Model:
        self.built.append(asked.modes)
        return Model(asked.modes, np.zeros(self.n_bytes // 8))


def filled(n_bytes: int, most: int, n: int) -> tuple[Builder, Shelf]:
    builder = Builder(n_bytes)
    shelf = Shelf(builder, most)
    for modes in range(1, n + 1):
        shelf.take(reduction(modes))
    return builder, shelf


def test_the_oldest_goes_and_is_built_again() -> None:
    builder, shelf = filled(400, 1000, 3)
    assert shelf.take(reduction(3)).modes == 3 and shelf.take(reduction(2)).modes == 2
    assert builder.built == [1, 2, 3], "the last two fit"
    assert shelf.take(reduction(1)).modes == 1 and builder.built == [1, 2, 3, 1]
    shelf.take(reduction(2))
    assert builder.built == [1, 2, 3, 1], "what was wanted last stayed"
    shelf.take(reduction(3))
    assert builder.built == [1, 2, 3, 1, 3]


@pytest.mark.parametrize("most", [0, 100])
def test_the_latest_stays_however_large(most: int) -> None:
    builder, shelf = filled(400, most, 2)
    assert shelf.take(reduction(2)).modes == 2 and builder.built == [1, 2]


def test_bytes_of_all_arrays_within() -> None:
    item = {"a": (np.zeros(3), [np.zeros(2, dtype=np.int8)]), "b": Model(1, np.zeros((2, 2))), "c": "text", "d": None}
    assert bytes_of(item) == 24 + 2 + 32
