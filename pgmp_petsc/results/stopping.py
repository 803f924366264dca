"""Why an ensemble has as many samples as it has: rules, looks at it and a budget of time."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from pgmp_petsc.declare.records import FLAGS, Record, array, attribute

_UNIT = "as attribute units"


@dataclass(frozen=True)
class Stopping(Record):
    """What was seen at every look, and why the last one was the last; without rules a budget alone decided."""

    why: str = attribute("@why", about="why it ended, in words")
    budget: float | None = attribute("@budget", about="wall time for the samples, s; empty where there was none")
    rules: tuple[str, ...] = attribute("@rules", "rule", about="texts of the rules")
    units: tuple[str, ...] = attribute("@units", "rule", about="units of their figures")
    wanted: np.ndarray = array(
        "rule", unit=_UNIT, gaps=True,
        about="half the width of its interval that each rule wants, a share of the figure where relative is 1",
    )  # fmt: skip
    relative: np.ndarray = array("rule", about="whether that is a share of the figure", stored=np.int32, code=FLAGS)
    met: np.ndarray = array("rule", about="whether each rule was met at the last look", stored=np.int32, code=FLAGS)
    samples: np.ndarray = array("look", about="number of samples at each look")
    estimates: np.ndarray = array("rule", "look", unit=_UNIT, about="figure of each rule at each look", gaps=True)
    intervals: np.ndarray = array(
        "rule", "look", 2, unit=_UNIT, about="confidence interval of each rule's figure at each look", gaps=True
    )

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


def reach_of(estimates: np.ndarray, intervals: np.ndarray, relative: np.ndarray | bool) -> np.ndarray:
    """Return half the widths of intervals (..., 2), as a share of the size of their figures (...) where relative."""
    with np.errstate(all="ignore"):
        half = 0.5 * (intervals[..., 1] - intervals[..., 0])
        reach = np.where(relative, half / np.abs(estimates), half)
    return np.where(np.isfinite(reach), reach, np.inf)
