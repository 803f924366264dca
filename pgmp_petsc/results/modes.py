"""Eigenfrequencies over the configurations, of the full-order model and of the reduced one beside it.

Layout of the file (kind ``modes``); frequencies rise along the last axis. Rigid motion is left out, but for what linear
springs resist anywhere: that vibrates, and is 0 at dead centres. Frequencies f below zero are motions that grow as
``exp(2 pi |f| t)``:

=============================== ====================== =======================================================
dataset                         shape                  content
=============================== ====================== =======================================================
``/theta``                      (n_theta)              configurations; attribute ``names`` (JSON). With more
                                                       than one coordinate (n_coordinates, n_theta): a
                                                       grid over all of them, the last running fastest
``/full/frequencies_hz``        (n_theta, n_modes)     full-order model
``/reduced/frequencies_hz``     (n_theta, n_modes)     reduced model, where given; its n_modes may differ
=============================== ====================== =======================================================

One mode of vibration of a mechanism at a configuration, as it can be seen.
"""

from __future__ import annotations

import json
import os
from dataclasses import dataclass, field

import numpy as np

from pgmp_petsc.results.body_fields import BodyField
from pgmp_petsc.results.layout import check_shape
from pgmp_petsc.runtime.files import RunRecord, open_file, put, shapes_of, take, write_file


@dataclass(frozen=True)
class ModesTable:
    """Eigenfrequencies over the configurations.

    Parameters
    ----------
    record : RunRecord
    theta : ndarray, shape (n_theta,), or (n_coordinates, n_theta) with more than one coordinate
    full_hz : ndarray, shape (n_theta, n_modes)
        Eigenfrequencies of the full-order model on its linear springs, Hz.
    reduced_hz : ndarray, shape (n_theta, n_modes), optional
        Those of the reduced model.
    coordinate_units : dict of str to str
        Name and unit of each coordinate.
    """

    record: RunRecord
    theta: np.ndarray
    full_hz: np.ndarray
    reduced_hz: np.ndarray | None = None
    coordinate_units: dict[str, str] = field(default_factory=lambda: {"theta": "rad"})

    def __post_init__(self) -> None:
        n_coordinates = len(self.coordinate_units)
        check_shape("theta", self.theta, (None,) if n_coordinates == 1 else (n_coordinates, None))
        n_theta = self.theta.shape[-1]
        check_shape("full-order frequencies", self.full_hz, (n_theta, None))
        if self.reduced_hz is not None:
            check_shape("reduced frequencies", self.reduced_hz, (n_theta, None))

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write the file; by one process only. Raises as :func:`~pgmp_petsc.runtime.files.write_file`."""
        with write_file(path, "modes") as file:
            self.record.write(file)
            unit = ", ".join(self.coordinate_units.values())
            theta = put(file, "theta", self.theta, unit, "configurations")
            theta.attrs["names"] = json.dumps(list(self.coordinate_units))
            about = "flexible eigenfrequencies, rising; rigid motion left out"
            put(file, "full/frequencies_hz", self.full_hz, "Hz", f"full-order {about}")
            if self.reduced_hz is not None:
                put(file, "reduced/frequencies_hz", self.reduced_hz, "Hz", f"reduced {about}")

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> ModesTable:
        """Read a file; raises `InputError` where it is not a whole table of modes."""
        with open_file(path, "modes") as file, shapes_of(file):
            attributes = file["theta"].attrs
            coordinate_units = dict(zip(json.loads(attributes["names"]), attributes["unit"].split(", ")))
            reduced = "reduced/frequencies_hz"
            return cls(
                record=RunRecord.read(file),
                theta=take(file, "theta", 1 if len(coordinate_units) == 1 else 2),
                full_hz=take(file, "full/frequencies_hz", 2),
                reduced_hz=take(file, reduced, 2) if reduced in file else None,
                coordinate_units=coordinate_units,
            )


@dataclass(frozen=True)
class ModeShape:
    """A mode.

    Parameters
    ----------
    record : RunRecord
        Of the reduced model that it is of.
    number : int
        From 1, rigid motion left out.
    frequency_hz : float
    configuration : str
        In words: ``theta = 0 rad``.
    fields : dict of str to BodyField
        One frame: ``positions`` are those of the undeformed body, ``deformation`` is the displacement of the mode, 1 m
        at its largest, and quantities are those of that displacement.
    notes : tuple of str
        What is left out.
    """

    record: RunRecord
    number: int
    frequency_hz: float
    configuration: str
    fields: dict[str, BodyField]
    notes: tuple[str, ...] = ()
