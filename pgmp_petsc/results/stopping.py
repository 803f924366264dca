"""Why an ensemble has as many samples as it has: rules, looks at it and a budget of time."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

import h5py
import numpy as np

from pgmp_petsc.results.layout import check_shape
from pgmp_petsc.runtime.files import put, take

if TYPE_CHECKING:
    from collections.abc import Mapping


@dataclass(frozen=True)
class Stopping:
    """What was seen at every look, and why the last one was the last.

    Parameters
    ----------
    why : str
        In words.
    budget : float or None
        Wall time for the samples, s.
    rules, units : tuple of str
        Texts of the rules, and units of their figures; none where a budget alone decided.
    wanted : ndarray, shape (n_rules,)
        Half the width of the interval that is wanted, in the figure's unit, or as a share of it.
    relative, met : ndarray of bool, shape (n_rules,)
        Whether it is a share, and whether it was reached at the last look.
    samples : ndarray of int, shape (n_looks,)
        Number of samples at each look.
    estimates : ndarray, shape (n_rules, n_looks)
    intervals : ndarray, shape (n_rules, n_looks, 2)
        NaN where too little was known.
    """

    why: str
    budget: float | None
    rules: tuple[str, ...]
    units: tuple[str, ...]
    wanted: np.ndarray
    relative: np.ndarray
    met: np.ndarray
    samples: np.ndarray
    estimates: np.ndarray
    intervals: np.ndarray

    def __post_init__(self) -> None:
        n_rules, n_looks = len(self.rules), len(self.samples)
        for name in ("wanted", "relative", "met"):
            check_shape(name, getattr(self, name), (n_rules,))
        check_shape("estimates", self.estimates, (n_rules, n_looks))
        check_shape("intervals", self.intervals, (n_rules, n_looks, 2))

    @property
    def is_met(self) -> bool:
        """Whether all rules are."""
        return bool(np.all(self.met))

    @property
    def reached(self) -> np.ndarray:
        """Half the widths of the intervals, as `wanted` has them, shape (n_rules, n_looks); infinite where unknown."""
        return reach_of(self.estimates, self.intervals, self.relative[:, None])

    def lines(self) -> Iterator[str]:
        """Yield what is to be said on the screen."""
        yield f"  stopped after {int(self.samples[-1])} samples, look {len(self.samples)}: {self.why}"
        for text, unit, estimate, ends, share, relative, met in zip(
            self.rules, self.units, self.estimates[:, -1], self.intervals[:, -1], self.reached[:, -1], self.relative,
            self.met,
        ):  # fmt: skip
            unit = "" if unit == "1" else f" {unit}"
            reached = f"{100 * share:.3g} %" if relative else f"{share:.3g}{unit}"
            known = f"{estimate:.6g}{unit} [{ends[0]:.6g}, {ends[1]:.6g}], +- {reached}"
            yield f"  {text:40s} {'met' if met else 'NOT MET':8s}{known if np.isfinite(share) else 'not known yet'}"

    def write(self, file: h5py.File) -> None:
        """Write it into a group of its own."""
        group = file.create_group("stopping")
        group.attrs["why"] = self.why
        group.attrs["budget"] = h5py.Empty("f8") if self.budget is None else self.budget
        for name in ("rules", "units"):
            group.attrs.create(name, list(getattr(self, name)), dtype=h5py.string_dtype())
        put(group, "samples", self.samples, "1", "number of samples at each look")
        about = "half the width of its interval that each rule wants, a share of the figure where relative is 1"
        put(group, "wanted", self.wanted, "as attribute units", about)
        put(group, "relative", self.relative.astype(np.int32), "1", "whether that is a share of the figure")
        put(group, "met", self.met.astype(np.int32), "1", "whether each rule was met at the last look")
        put(group, "estimates", self.estimates, "as attribute units", "figure of each rule at each look")
        about = "confidence interval of each rule's figure at each look"
        put(group, "intervals", self.intervals, "as attribute units", about)

    @classmethod
    def read(cls, group: h5py.Group) -> Self:
        """Read what `write` wrote."""
        budget = group.attrs["budget"]
        texts = {name: tuple(str(text) for text in group.attrs[name]) for name in ("rules", "units")}
        flags = {name: take(group, name, 1).astype(bool) for name in ("relative", "met")}
        return cls(
            why=str(group.attrs["why"]),
            budget=None if isinstance(budget, h5py.Empty) else float(budget),
            **texts,
            **flags,
            wanted=take(group, "wanted", 1),
            samples=take(group, "samples", 1),
            estimates=take(group, "estimates", 2),
            intervals=take(group, "intervals", 3),
        )


def reach_of(estimates: np.ndarray, intervals: np.ndarray, relative: np.ndarray | bool) -> np.ndarray:
    """Return half the widths of intervals (..., 2), as a share of the size of their figures (...) where relative."""
    with np.errstate(all="ignore"):
        half = 0.5 * (intervals[..., 1] - intervals[..., 0])
        reach = np.where(relative, half / np.abs(estimates), half)
    return np.where(np.isfinite(reach), reach, np.inf)


def read_stopping(file: Mapping) -> Stopping | None:
    """Return what a file says; None where its ensemble had as many samples as were asked for."""
    return Stopping.read(file["stopping"]) if "stopping" in file else None
