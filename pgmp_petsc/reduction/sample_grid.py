"""Sampled configurations of a mechanism, a tensor grid with an axis for each rigid coordinate; and points of the
parameter space: those at which a basis takes further modes, and a grid of lengths.

Lengths are sampled at Chebyshev points, n along each, between which a quantity f is, in two forms,

    f(l) = sum_p L_p(l) f_p = sum_k c_k prod_i x_i^k_i,    x_i = (l_i - middle_i) / half_i

(docs/method.md, lengths and places as parameters): with the first one value is contracted; the second is affine in
monomials of places (`bodies.affine.Place`), so that tables of many samples are too.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product, zip_longest
from typing import Any, TypeVar

import h5py
import numpy as np

from pgmp_petsc.bodies.affine import Monomial, Place
from pgmp_petsc.declare.records import Record, array, attribute, derived
from pgmp_petsc.mechanism.continuation import tensor_grid
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.uses import length_names

Tables = TypeVar("Tables", bound=Record)
EACH = "configuration"  # size of arrays with an entry for each


@dataclass(frozen=True, eq=False)
class Samples:
    """Sampled values of a coordinate."""

    theta: np.ndarray  # increasing, shape (n,), rad
    #: lower, upper: the range, rad; a periodic one is closed: its upper end is its lower end again and is no sample
    lower: float
    upper: float
    periodic: bool  # whether the coordinate is periodic

    @classmethod
    def uniform(cls, lower: float, upper: float, n: int, periodic: bool) -> Samples:
        """Sample a range with n points at equal distances."""
        return cls(np.linspace(lower, upper, n, endpoint=not periodic), lower, upper, periodic)

    @classmethod
    def chebyshev(cls, lower: float, upper: float, n: int) -> Samples:
        """Sample a limited range with the n Chebyshev points of the second kind, ends included."""
        points = -np.cos(np.pi * np.arange(n) / (n - 1))
        return cls(lower + (upper - lower) * (points + 1) / 2, lower, upper, False)

    @property
    def n(self) -> int:
        """Number of samples."""
        return self.theta.size

    @property
    def is_uniform(self) -> bool:
        """Whether all distances are equal to round-off."""
        ideal = np.linspace(self.lower, self.upper, self.n, endpoint=not self.periodic)
        return bool(np.max(np.abs(self.theta - ideal)) <= 1e-12 * (self.upper - self.lower))

    @property
    def turns(self) -> int:
        """How often the coordinate's range is in it: twice in that of `over_two_turns`."""
        return round((self.upper - self.lower) / (2.0 * np.pi)) if self.periodic else 1

    def in_first_turn(self, theta: float) -> float:
        """Return the value within the coordinate's range of the same configuration."""
        return self.lower + (theta - self.lower) % (2.0 * np.pi) if self.periodic else theta

    def over_two_turns(self) -> Samples:
        """Return the samples of two revolutions."""
        turn = self.upper - self.lower
        return Samples(np.concatenate([self.theta, self.theta + turn]), self.lower, self.upper + turn, True)

    def between(self, *shares: float) -> np.ndarray:
        """Return the values at shares of all intervals between samples, of one share after the other, shape (n,)."""
        ends = np.append(self.theta[1:], self.upper) if self.periodic else self.theta[1:]
        return np.concatenate([(1.0 - share) * self.theta[: ends.size] + share * ends for share in shares])

    def contains(self, theta: np.ndarray | float) -> np.ndarray | bool:
        """Return whether values lie in the range; always, if it is periodic."""
        return self.periodic | ((theta >= self.lower) & (theta <= self.upper))

    def nearest(self, theta: np.ndarray) -> np.ndarray:
        """Return the numbers of the samples next to values, of their shape."""
        turn = self.upper - self.lower
        known, numbers = self.theta, np.arange(self.n)
        if self.periodic:
            theta = self.lower + np.mod(theta - self.lower, turn)
            known, numbers = np.append(known, known[0] + turn), np.append(numbers, 0)
        return numbers[np.searchsorted(0.5 * (known[1:] + known[:-1]), theta)]


@dataclass(frozen=True)
class GridFile(Record):
    """Sampled configurations as files have them."""

    theta: np.ndarray = array("configuration", "coordinate?", unit="rad or m", about="sampled configurations")
    lower: np.ndarray = attribute("theta@lower", "coordinate?", about="lower end of the range")
    upper: np.ndarray = attribute("theta@upper", "coordinate?", about="upper end; of a revolution no sample")
    periodic: np.ndarray = attribute("theta@periodic", "coordinate?", about="whether it is periodic")
    shape: np.ndarray | None = attribute(
        "theta@shape", "coordinate?", absent=None, about="of several: samples along each, the last one fastest"
    )


@dataclass(frozen=True, eq=False)
class SampleGrid(Record):
    """Sampled configurations; the last coordinate runs fastest."""

    axes: tuple[Samples, ...]  # samples of every coordinate, in the order of the mechanism's coordinates
    STORED = GridFile

    def stored(self) -> GridFile:
        """Return the grid as files have it: of one coordinate without an axis for coordinates."""
        own = {name: np.array([getattr(axis, name) for axis in self]) for name in ("lower", "upper", "periodic")}
        own["theta"] = self.theta
        if self.n_coordinates > 1:
            return GridFile(**own, shape=np.array(self.shape))
        return GridFile(**{name: values[..., 0] for name, values in own.items()}, shape=None)

    @classmethod
    def take(cls, group: h5py.Group, *how: Any) -> SampleGrid:
        found = GridFile.take(group, *how)
        shape = tuple(np.atleast_1d(len(found.theta) if found.shape is None else found.shape))
        places = found.theta.reshape(*shape, len(shape))
        lines = (np.moveaxis(places[..., k], k, 0).reshape(n, -1)[:, 0] for k, n in enumerate(shape))
        ends = zip(lines, *map(np.atleast_1d, (found.lower, found.upper, found.periodic)))
        return cls(tuple(Samples(line, float(low), float(high), bool(turns)) for line, low, high, turns in ends))

    def __iter__(self) -> Iterator[Samples]:
        return iter(self.axes)

    @property
    def n_coordinates(self) -> int:
        """Number of rigid coordinates n_theta."""
        return len(self.axes)

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of samples along each axis."""
        return tuple(axis.n for axis in self.axes)

    @property
    def n(self) -> int:
        """Number of configurations."""
        return int(np.prod(self.shape))

    @property
    def theta(self) -> np.ndarray:
        """All configurations, shape (n, n_theta), rad."""
        return tensor_grid([axis.theta for axis in self.axes])

    def contains(self, theta: np.ndarray) -> np.ndarray:
        """Return whether configurations (..., n_theta) lie in the range, shape (...)."""
        inside = [axis.contains(theta[..., k]) for k, axis in enumerate(self.axes)]
        return np.logical_and.reduce([np.broadcast_to(part, theta.shape[:-1]) for part in inside])

    def nearest(self, theta: np.ndarray) -> np.ndarray:
        """Return the numbers of the samples next to configurations (n, n_theta), shape (n,)."""
        return np.ravel_multi_index([axis.nearest(part) for axis, part in zip(self.axes, theta.T)], self.shape)

    @property
    def periodic(self) -> tuple[bool, ...]:
        """Whether each coordinate is periodic."""
        return tuple(axis.periodic for axis in self.axes)

    def before(self, axis: int) -> np.ndarray:
        """Return the number of the configuration before each one along an axis, shape (n,).

        Before the first one of a periodic axis comes the last; before that of a limited one none, which is -1.
        """
        before = np.roll(np.arange(self.n).reshape(self.shape), 1, axis)
        if not self.axes[axis].periodic:
            before[(slice(None),) * axis + (0,)] = -1
        return before.ravel()

    def over_two_turns(self, axis: int) -> SampleGrid:
        """Return the grid with two revolutions along an axis."""
        return replace(self, axes=(*self.axes[:axis], self.axes[axis].over_two_turns(), *self.axes[axis + 1 :]))

    def turns(self, flipped: np.ndarray) -> Iterator[tuple[SampleGrid, int, np.ndarray]]:
        """Yield each axis over whose revolution some flexible coordinates are `flipped`, bool (n_theta, m), the grid
        with two revolutions of those before, and the signs (m,) of the coordinates on the second one."""
        grid = self
        for axis in np.flatnonzero(flipped.any(axis=1)):
            yield grid, int(axis), np.where(flipped[axis], -1.0, 1.0)
            grid = grid.over_two_turns(axis)

    def twice(self, axis: int, first: np.ndarray, second: np.ndarray) -> np.ndarray:
        """Join tables (n, ...) of the first and the second revolution along an axis, shape (2 n, ...)."""
        parts = [table.reshape(*self.shape, *table.shape[1:]) for table in (first, second)]
        return np.concatenate(parts, axis=axis).reshape(2 * self.n, *first.shape[1:])

    def doubled(self, axis: int, tables: Tables, signs: np.ndarray, **more: Any) -> Tables:
        """Append a second revolution along an axis, on which flexible coordinates have signs (m,), to the arrays of
        tables that can be `turned`; `more` are fields of the result."""
        second = tables.turned(np.broadcast_to(np.diag(signs), (self.n, signs.size, signs.size)))
        return replace(tables, **tables.each(EACH, partial(self.twice, axis), second) | more)

    def further(self, angles: Sequence[np.ndarray]) -> np.ndarray:
        """Return the configurations that the grid is without and has with further angles (n,) of the first coordinates,
        shape (n, n_theta)."""
        parts = zip_longest(self.axes, angles, fillvalue=np.zeros(0))
        more = SampleGrid(tuple(replace(a, theta=np.union1d(a.theta, added)) for a, added in parts))
        known = [np.isin(axis.theta, own.theta) for axis, own in zip(more, self)]
        return more.theta[~np.logical_and.reduce(np.meshgrid(*known, indexing="ij")).ravel()]

    def tabulated(self, configurations: np.ndarray) -> SampleGrid:
        """Return a grid of these configurations (n, n_theta), in any order, over the same ranges."""
        axes = (replace(axis, theta=np.unique(part)) for axis, part in zip(self.axes, configurations.T))
        return SampleGrid(tuple(axes))


@dataclass(frozen=True)
class ParameterPoints(Record):
    """Parameter points whose modes the basis takes up, by a greedy choice."""

    n_vectors: int = attribute("@n_vectors", about="vectors that the basis takes from them")
    missed: np.ndarray = array(
        "basis",
        gaps=True,
        about="share of the energy missed at the worst parameters tried: at first, with each point more",
    )
    values: dict[str, np.ndarray] = array("point", unit="SI", about="value of '{name}' at every point", ordered=True)

    @property
    def points(self) -> list[dict[str, float]]:
        """The points one by one."""
        n_points = len(self.missed) - 1
        return [{name: float(column[k]) for name, column in self.values.items()} for k in range(n_points)]

    @classmethod
    def none(cls) -> ParameterPoints:
        """Return no points."""
        return cls(0, np.ones(1), {})


@dataclass(frozen=True, eq=False)
class LengthGrid(Record):
    """A tensor grid of Chebyshev points (of the first kind); names are sorted."""

    names: tuple[str, ...] = attribute(
        "@parameters", "parameter", about="parameters that are lengths, places or ratios"
    )
    lower: np.ndarray = attribute("@lower", "parameter", about="smallest value of each, in its unit")
    upper: np.ndarray = attribute("@upper", "parameter", about="largest value of each, in its unit")
    n_points: int = attribute("@n_points", about="points along each")

    FURTHER = (
        derived(
            np.ndarray, lambda own, _: np.array([list(point.values()) for point in own.points]), "values",
            "model", "parameter", unit="m or 1", about="lengths of every model",
        ),
    )  # fmt: skip

    @classmethod
    def of(cls, scene: Scene) -> LengthGrid:
        """Return the grid of a scene's lengths."""
        names = length_names(scene)
        lower, upper = zip(*(scene.parameters[name].range for name in names))
        return cls(names, np.array(lower), np.array(upper), scene.reduction.length_points)

    @property
    def nodes(self) -> np.ndarray:
        """Places of the points, -1 to 1, shape (n_points,), increasing."""
        return -np.cos(np.pi * (np.arange(self.n_points) + 0.5) / self.n_points)

    @property
    def places(self) -> tuple[Place, ...]:
        """The place of each length in its range."""
        ends = zip(self.names, self.lower.tolist(), self.upper.tolist())
        return tuple(Place(name, 0.5 * (low + high), 0.5 * (high - low)) for name, low, high in ends)

    @property
    def points(self) -> list[dict[str, float]]:
        """Values of the lengths at every point, the last one fastest."""
        return [self.values_at(nodes) for nodes in product(self.nodes, repeat=len(self.names))]

    def values_at(self, places: Sequence[float]) -> dict[str, float]:
        """Return the lengths (m) at places from -1 to 1."""
        return {own.name: float(own.middle + own.half * x) for own, x in zip(self.places, places)}

    def shares(self, values: Mapping[str, np.ndarray | float], by: str = "") -> np.ndarray:
        """Return L_p at values (numbers, or of shape (n,)), shape (n_p,) or (n_p, n); their sum is 1.

        With the name of a parameter their derivatives by it, whose sum is 0.
        """
        shape = np.shape(values[self.names[0]])
        found = np.ones((1, *shape)) if not by or by in self.names else np.zeros((1, *shape))
        for place in self.places:
            at, exponents = place.at(values), range(self.n_points)
            powers = np.array([at**k for k in exponents])
            if place.name == by:
                powers = np.array([k * at ** max(k - 1, 0) for k in exponents]) / place.half
            found = (found[:, None] * np.tensordot(self._inverse.T, powers, 1)).reshape(-1, *found.shape[1:])
        return found

    def height(self, values: Mapping[str, float]) -> float:
        """Return the least |T_n| of the places of values: 0 at points of the grid, 1 farthest from these."""
        angles = [np.arccos(np.clip(place.at(values), -1.0, 1.0)) for place in self.places]
        return float(min(abs(np.cos(self.n_points * angle)) for angle in angles))

    def weights(self, own: Sequence[Monomial]) -> tuple[Monomial, ...]:
        """Return the weights of `coefficients` of terms with weights of their own, (term, monomial) in this order."""
        powers = product(range(self.n_points), repeat=len(self.names))
        monomials = [
            Monomial((), tuple(sorted((place, k) for place, k in zip(self.places, exponents) if k)))
            for exponents in powers
        ]
        return tuple(weight * monomial for weight in own for monomial in monomials)

    def coefficients(self, tables: Sequence[np.ndarray]) -> np.ndarray:
        """Return c_k of tables (n, n_terms, ...) at every point, shape (n, n_terms * n_p, ...); see `weights`."""
        inverse = np.ones((1, 1))
        for _ in self.names:
            inverse = np.kron(inverse, self._inverse)
        found = np.moveaxis(np.tensordot(inverse, np.stack(tables), 1), 0, 2)
        return np.ascontiguousarray(found).reshape(found.shape[0], found.shape[1] * found.shape[2], *found.shape[3:])

    @property
    def _inverse(self) -> np.ndarray:
        """From values at the points to coefficients of powers, shape (n_points, n_points)."""
        return np.linalg.inv(np.vander(self.nodes, increasing=True))
