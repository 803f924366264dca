"""The probability of a rare event, and the samples that it follows from.

============================ ============ ============================================================================
dataset                      shape        meaning
============================ ============ ============================================================================
``/probability/estimate``    scalar       NaN where the event was not reached
``/probability/interval``    (2)          confidence interval; failed samples are outside the event at its lower end,
                                           and in it at the upper one; from 0 to a bound where the event was not reached
``/probability/variation``   scalar       coefficient of variation of the estimate
``/probability/at_most``     scalar       the estimate if all failed samples had been in the event
``/probability/n_effective`` scalar       number of equally weighted samples in the event that would be as good
``/most_likely/beta``        (n_points)   distance of each design point from the origin in normal variables (FORM); the
                                          group is absent where none was found; attributes ``is_exact``, ``n_runs``
``/most_likely/normal``      (.., d)      the design points, in normal variables
``/most_likely/shares``      (.., d)      importance shares of the parameters there: alpha^2
``/most_likely/parameters/`` (n_points)   values of the parameters there
``/levels/threshold``        (n_levels)   of the output, of every level of subset simulation
``/levels/share``            (n_levels)   of the samples before that pass it
``/levels/accepted``         (n_levels)   share of the steps of its chains that were accepted
``/curve/value``             (n_curve)    values of the output, the probability of beyond these falling
``/curve/probability``       (n_curve)    as the levels know it
``/samples/value``           (N)          of the output at the end, or the furthest in the run; NaN of failed ones
``/samples/weight``          (N)          of importance sampling; 0 of what only leads there, which comes first
``/samples/normal``          (N, d)       standard normal variables, in the order of attribute ``parameters``
``/parameters/<name>``       (N)          values of the parameters
``/status``                  (N)          0 = fine
============================ ============ ============================================================================
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

import numpy as np

from pgmp_petsc.results.layout import check_model, check_shape, put_named, take_known, take_named
from pgmp_petsc.runtime.files import RunRecord, open_file, put, shapes_of, take, write_file

if TYPE_CHECKING:
    import h5py

KIND = "rare_event"


@dataclass(frozen=True, eq=False)
class MostLikely:
    """Where an event is most likely: its design points, the most likely one first.

    Attributes
    ----------
    beta
        Distances from the origin in the space of normal variables, shape (n_points,).
    normal
        The points there, shape (n_points, d), d of the parameters that are drawn.
    shares
        Of the parameters in what makes the event, alpha^2, shape (n_points, d).
    parameters
        Values of the parameters, each (n_points,).
    is_exact
        Whether they follow from exact derivatives, not from differences.
    n_runs
        Runs that were taken.
    """

    beta: np.ndarray
    normal: np.ndarray
    shares: np.ndarray
    parameters: dict[str, np.ndarray]
    is_exact: bool
    n_runs: int

    @property
    def probability(self) -> np.ndarray:
        """Of the planes that touch the event's border there, ``Phi(-beta)`` (FORM), shape (n_points,)."""
        from scipy.special import ndtr

        return ndtr(-self.beta)


@dataclass(frozen=True, eq=False)
class RareEvent:
    """A rare event; arrays are those of the file (see the module).

    Attributes
    ----------
    model
        ``full``, ``components`` or ``reduced``.
    event, output, unit
        What comes true, in words; the output that it is of, and the output's unit.
    names
        Parameters, in the order of `normal`.
    text
        The event as ``--rare`` takes it; empty in files of earlier versions.
    asked
        Samples that it might take; those of exact derivatives are not among its samples.
    """

    model: str
    record: RunRecord
    event: str
    output: str
    unit: str
    confidence: float
    estimate: float
    interval: np.ndarray
    variation: float
    at_most: float
    n_effective: float
    threshold: np.ndarray
    share: np.ndarray
    accepted: np.ndarray
    curve: tuple[np.ndarray, np.ndarray]
    names: tuple[str, ...]
    normal: np.ndarray
    value: np.ndarray
    weight: np.ndarray
    parameters: dict[str, np.ndarray]
    status: np.ndarray
    most_likely: MostLikely | None = None
    asked: int = 0
    text: str = ""

    def __post_init__(self) -> None:
        check_model(self.model)
        n = len(self.value)
        check_shape("normal", self.normal, (n, len(self.names)))
        for name in ("weight", "status"):
            check_shape(name, getattr(self, name), (n,))
        check_shape("interval", self.interval, (2,))
        for name in ("share", "accepted"):
            check_shape(name, getattr(self, name), (len(self.threshold),))
        if self.most_likely is not None:
            for name in ("normal", "shares"):
                check_shape(name, getattr(self.most_likely, name), (len(self.most_likely.beta), len(self.names)))

    @property
    def reached(self) -> bool:
        """Whether the event was reached."""
        return bool(np.isfinite(self.estimate))

    @property
    def n_failed(self) -> int:
        """Number of samples that failed."""
        return int(np.count_nonzero(self.status))

    def write(self, path: str | os.PathLike[str], *parts: Callable[[h5py.File], None]) -> None:
        """Write the file; by one process only. Raises as :func:`~pgmp_petsc.runtime.files.write_file`."""
        attributes = {name: getattr(self, name) for name in ("model", "event", "output", "confidence", "asked", "text")}
        with write_file(path, KIND, attributes | {"parameters_drawn": list(self.names)}) as file:
            self.record.write(file)
            of_event = f"probability of '{self.event}'"
            group = file.create_group("probability")
            put(group, "estimate", self.estimate, "1", f"{of_event}; NaN where it was not reached")
            put(group, "interval", self.interval, "1", f"{100 * self.confidence:g} % confidence interval")
            put(group, "variation", self.variation, "1", "coefficient of variation of the estimate")
            put(group, "at_most", self.at_most, "1", "the estimate if all failed samples had been in the event")
            about = "number of equally weighted samples in the event that would be as good"
            put(group, "n_effective", self.n_effective, "1", about)
            group = file.create_group("levels")
            put(group, "threshold", self.threshold, self.unit, f"of '{self.output}', of every level")
            put(group, "share", self.share, "1", "of the samples before that pass it")
            put(group, "accepted", self.accepted, "1", "share of the steps of its chains that were accepted")
            group = file.create_group("curve")
            put(group, "value", self.curve[0], self.unit, f"of '{self.output}'")
            put(group, "probability", self.curve[1], "1", "of beyond these values, as the levels know it")
            group = file.create_group("samples")
            put(group, "value", self.value, self.unit, f"of '{self.output}', NaN of failed samples")
            put(group, "weight", self.weight, "1", "of importance sampling; 0 of what only leads there")
            put(group, "normal", self.normal, "1", "standard normal variables, in the order of parameters_drawn")
            if self.most_likely is not None:
                _put(file.create_group("most_likely"), self.most_likely)
            put_named(file, "parameters", self.parameters, {}, "values of '{name}', SI units")
            put(file, "status", self.status.astype(np.int32), "1", "how each sample ended, 0 = fine")
            for part in parts:
                part(file)

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> Self:
        """Read a file; raises as :func:`~pgmp_petsc.runtime.files.open_file`."""
        with open_file(path, KIND) as file, shapes_of(file):
            chance, levels, samples = (file[name] for name in ("probability", "levels", "samples"))
            scalars = ("estimate", "variation", "at_most", "n_effective")
            return cls(
                record=RunRecord.read(file),
                confidence=float(file.attrs["confidence"]),
                asked=int(file.attrs.get("asked", samples["value"].size)),
                text=str(file.attrs.get("text", "")),
                unit=str(samples["value"].attrs["unit"]),
                interval=take(chance, "interval", 1),
                curve=(take(file["curve"], "value", 1), take(file["curve"], "probability", 1)),
                names=tuple(str(name) for name in file.attrs["parameters_drawn"]),
                normal=take_known(samples, "normal", 2),
                parameters=take_named(file, "parameters", 1, take_known),
                status=take(file, "status", 1),
                **{name: str(file.attrs[name]) for name in ("model", "event", "output")},
                **{name: float(take(chance, name, 0)) for name in scalars},
                **{name: take_known(levels, name, 1) for name in ("threshold", "share")},
                accepted=take(levels, "accepted", 1),
                value=take(samples, "value", 1),
                weight=take_known(samples, "weight", 1),
                most_likely=_taken(file["most_likely"]) if "most_likely" in file else None,
            )


def _put(group: h5py.Group, found: MostLikely) -> None:
    put(group, "beta", found.beta, "1", "distance of each design point from the origin in normal variables")
    put(group, "normal", found.normal, "1", "design points in normal variables, in the order of parameters_drawn")
    put(group, "shares", found.shares, "1", "importance shares of the parameters, alpha^2")
    put_named(group, "parameters", found.parameters, {}, "values of '{name}' at the design points, SI units")
    group.attrs["is_exact"], group.attrs["n_runs"] = found.is_exact, found.n_runs


def _taken(group: h5py.Group) -> MostLikely:
    arrays = (take_known(group, name, n) for name, n in (("beta", 1), ("normal", 2), ("shares", 2)))
    parameters = take_named(group, "parameters", 1, take_known)
    return MostLikely(*arrays, parameters, bool(group.attrs["is_exact"]), int(group.attrs["n_runs"]))
