"""Outputs of one run over time with their derivatives with parameters, as ``pgmp sensitivities`` finds them.

Layout of the file (kind ``sensitivities``; root attributes ``parameters_differentiated`` (JSON, the names, in the order
of the axis n_parameters) and ``steps_divided`` as of trajectories):

==================================== ================ ================================================================
dataset                              shape            content
==================================== ================ ================================================================
``/time``                            (n_t)            s
``/outputs/<name>``                  (n_t)            the scene's outputs
``/derivatives/<output>/<parameter>`` (n_t)           derivative of the output at every instant with the parameter
``/changes/<parameter>``             ()               change of the parameter that effects are told of: one standard
                                                      deviation, or where it has no distribution 1 % of its value;
                                                      attribute ``what`` says which
``/correlation``                     (n_parameters,   of the parameters' normal variables; zero where one has no
                                     n_parameters)    distribution
``/extremes/<output>/max``, ``min``  ()               largest and smallest value over the run, at an instant of a step
``.../time_of_max``, ``time_of_min`` ()               s
``.../max_derivatives``,             (n_parameters)   their derivatives: those of the vertex of the parabola through
``.../min_derivatives``                               the values there and at the instants before and after it
``/contacts/effects``                (n_contacts)     names of the end stops that are met and left, in order of time;
                                                      the group is there if any is
``.../time``, ``.../met``            (n_contacts)     s; 1 where it is met, 0 where it is left
``.../turning``                      (n_contacts)     within which time the path would turn back there, s
``.../derivatives``                  (n_contacts,     of the instants with the parameters, s per unit
                                     n_parameters)
==================================== ================ ================================================================

The largest or smallest value of a smooth history that is known at instants, with its derivatives.

The largest of the values themselves, ``y_k``, is that of one instant, and its derivative that of the history there. But
between instants lies the true extreme, where the history has no slope: only there is the derivative of the extreme that
of the history (the envelope theorem; Danskin 1966). At an instant next to it there is ``(t_k - t*) dy'/dp`` besides,
which is of first order in the step, and may be larger than all else where a parameter shifts a vibration in time. The
vertex of the parabola through the values at three equally distant instants,

    s = (y_{k-1} - y_{k+1}) / (2 (y_{k-1} - 2 y_k + y_{k+1})),    -1/2 <= s <= 1/2,
    y* = y_k + s (y_{k+1} - y_{k-1}) / 2 + s^2 / 2 (y_{k-1} - 2 y_k + y_{k+1}),

does not move with s to first order, so that its derivative is the same expression of the derivatives: exact for y*, and
of second order in the step for the extreme of the history.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from dataclasses import dataclass

import h5py
import numpy as np

from pgmp_petsc.results.layout import check_shape, put_named, take_known, take_named, units_of
from pgmp_petsc.runtime.files import RunRecord, open_file, put, shapes_of, take, write_file

KIND = "sensitivities"
DEVIATION, PERCENT = "one standard deviation", "1 % of its value"


@dataclass(frozen=True)
class Figure:
    """A figure of an output: its value at one instant of the run, and its derivatives; of extremes see `vertex`.

    Attributes
    ----------
    name
        ``at the end``, ``largest`` or ``smallest``.
    value, time
        In the output's unit; s.
    derivatives
        With the parameters, shape (n_parameters,).
    """

    name: str
    value: float
    time: float
    derivatives: np.ndarray


@dataclass(frozen=True, eq=False)
class Instants:
    """Instants at which end stops are met and left.

    Attributes
    ----------
    effects
        Names of the stops.
    met
        Whether each is met, or left, shape (n_contacts,).
    time, turning
        When, and within which time the path would turn back there, s, shape (n_contacts,).
    derivatives
        Of the times with the parameters, shape (n_contacts, n_parameters), s per unit.
    """

    effects: tuple[str, ...]
    met: np.ndarray
    time: np.ndarray
    turning: np.ndarray
    derivatives: np.ndarray


@dataclass(frozen=True)
class Derivatives:
    """Derivatives of one run.

    Parameters
    ----------
    record : RunRecord
    time : ndarray, shape (n_t,)
        s.
    outputs : dict of str to ndarray, shape (n_t,)
    derivatives : dict of str to dict of str to ndarray, shape (n_t,)
        By output and parameter.
    units : dict of str to str
        Of outputs and parameters.
    changes : dict of str to (float, str)
        Change of each parameter that effects are told of, and whether it is `DEVIATION` or `PERCENT`.
    correlation : ndarray, shape (n_parameters, n_parameters)
        Of the parameters; zero where one has no distribution.
    steps_divided : int
        By what the scene's step was divided.
    contacts : Instants or None
        Of contacts with end stops; None where there are none.
    """

    record: RunRecord
    time: np.ndarray
    outputs: dict[str, np.ndarray]
    derivatives: dict[str, dict[str, np.ndarray]]
    units: dict[str, str]
    changes: dict[str, tuple[float, str]]
    correlation: np.ndarray
    steps_divided: int = 1
    contacts: Instants | None = None

    def __post_init__(self) -> None:
        check_shape("time", self.time, (None,))
        if not self.outputs:
            raise ValueError("there are no outputs")
        check_shape("correlation", self.correlation, (len(self.changes),) * 2)
        for output, values in self.outputs.items():
            check_shape(f"output '{output}'", values, (len(self.time),))
            if self.derivatives[output].keys() != self.changes.keys():
                raise ValueError(f"derivatives of '{output}' are not with the parameters of the run")
            for name, found in self.derivatives[output].items():
                check_shape(f"derivative of '{output}' with '{name}'", found, (len(self.time),))
        if self.contacts is not None:
            check_shape("contacts", self.contacts.derivatives, (len(self.contacts.effects), len(self.changes)))

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the parameters, in the order of n_parameters."""
        return tuple(self.changes)

    def unit(self, output: str, parameter: str) -> str:
        """Return the unit of a derivative."""
        above, below = (self.units.get(name, "1") for name in (output, parameter))
        if below == "1":
            return above
        return f"{above}/({below})" if set(below) & set("/ *") else f"{above}/{below}"

    def effects(self, figure: Figure) -> np.ndarray:
        """Return what the changes of the parameters do to a figure, to first order, shape (n_parameters,)."""
        return figure.derivatives * np.array([change for change, _ in self.changes.values()])

    def deviation(self, figure: Figure) -> float:
        """Return the standard deviation of a figure, to first order: what all distributions do together."""
        effects = self.effects(figure)
        return float(np.sqrt(max(effects @ self.correlation @ effects, 0.0)))

    def figures(self, output: str) -> Iterator[Figure]:
        """Yield the figures of an output: at the end, the largest and the smallest."""
        values, rows = self.outputs[output], np.array(list(self.derivatives[output].values()))
        places = ("at the end", Vertex(-1, 0.0)), ("largest", vertex(values, 1.0)), ("smallest", vertex(values, -1.0))
        for name, place in places:
            yield Figure(name, float(values[place.at]), float(self.time[place.at]), place.of(rows))

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write the file; by one process only. Raises as :func:`~pgmp_petsc.runtime.files.write_file`."""
        attributes = {"parameters_differentiated": json.dumps(self.parameters), "steps_divided": self.steps_divided}
        with write_file(path, KIND, attributes) as file:
            self.record.write(file)
            put(file, "time", self.time, "s", "time")
            put_named(file, "outputs", self.outputs, self.units, "output '{name}' over time")
            put(file, "correlation", self.correlation, "1", "correlation of the parameters")
            for name, (change, what) in self.changes.items():
                data = put(file, f"changes/{name}", change, self.units.get(name, "1"), f"{what} of '{name}'")
                data.attrs["what"] = what
            for output, found in self.derivatives.items():
                units = {name: self.unit(output, name) for name in found}
                put_named(file, f"derivatives/{output}", found, units, f"derivative of '{output}' with '{{name}}'")
                unit = self.units.get(output, "1")
                for key, figure in zip(("max", "min"), list(self.figures(output))[1:]):
                    of = f"{figure.name} value of '{output}'"
                    put(file, f"extremes/{output}/{key}", figure.value, unit, of)
                    put(file, f"extremes/{output}/time_of_{key}", figure.time, "s", f"when it is the {figure.name}")
                    put(
                        file, f"extremes/{output}/{key}_derivatives", figure.derivatives,
                        ", ".join(units.values()), f"derivatives of the {of} with the parameters",
                    )  # fmt: skip
            if self.contacts is not None:
                self._write_contacts(file.create_group("contacts"), self.contacts)

    def _write_contacts(self, group: h5py.Group, contacts: Instants) -> None:
        put(group, "effects", list(contacts.effects), "1", "end stops that are met and left")
        put(group, "met", contacts.met.astype(int), "1", "1 where it is met, 0 where it is left")
        put(group, "time", contacts.time, "s", "when")
        put(group, "turning", contacts.turning, "s", "within which time the path would turn back there")
        units = ", ".join(f"s/({self.units.get(name, '1')})" for name in self.parameters)
        put(group, "derivatives", contacts.derivatives, units, "of the instants with the parameters")

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> Derivatives:
        """Read a file; raises `InputError` where it is not a whole one."""
        with open_file(path, KIND) as file, shapes_of(file):
            outputs = take_named(file, "outputs", 1, take_known)
            names = json.loads(file.attrs["parameters_differentiated"])
            changes = {}
            for name in names:
                what = str(file[f"changes/{name}"].attrs["what"])
                changes[name] = float(take_known(file, f"changes/{name}", 0)), what
            found = {output: take_named(file, f"derivatives/{output}", 1, take_known) for output in outputs}
            return cls(
                RunRecord.read(file),
                take_known(file, "time", 1),
                outputs,
                {output: {name: found[output][name] for name in names} for output in outputs},
                units_of(file, "outputs", "changes"),
                changes,
                take_known(file, "correlation", 2),
                int(file.attrs["steps_divided"]),
                _contacts_of(file["contacts"]) if "contacts" in file else None,
            )


def _contacts_of(group: h5py.Group) -> Instants:
    """Read the contacts of a file."""
    return Instants(
        tuple(name.decode() for name in take(group, "effects", 1, texts=True)),
        take(group, "met", 1).astype(bool),
        take_known(group, "time", 1),
        take_known(group, "turning", 1),
        take_known(group, "derivatives", 2),
    )


@dataclass(frozen=True)
class Vertex:
    """The vertex of the parabola through a value and those before and after it.

    Attributes
    ----------
    at
        Number of the instant.
    offset
        By how much of a step the vertex is later, from -1/2 to 1/2; 0 at both ends of a history.
    """

    at: int
    offset: float

    def of(self, histories: np.ndarray) -> np.ndarray:
        """Return what the parabolas through histories have there, shape (...) for histories of shape (..., n_t)."""
        here = histories[..., self.at]
        if self.offset == 0.0:
            return here
        before, after = histories[..., self.at - 1], histories[..., self.at + 1]
        return here + 0.5 * self.offset * (after - before) + 0.5 * self.offset**2 * (before - 2.0 * here + after)


def vertex(values: np.ndarray, sign: float) -> Vertex:
    """Return where a history of equally distant instants, shape (n_t,), has its largest value, or its smallest.

    Parameters
    ----------
    sign
        1 for the largest, -1 for the smallest.
    """
    at = int(np.argmax(sign * values))
    if not 0 < at < len(values) - 1:
        return Vertex(at, 0.0)
    before, here, after = values[at - 1 : at + 2]
    bend = before - 2.0 * here + after
    return Vertex(at, float(0.5 * (before - after) / bend) if bend != 0.0 else 0.0)
