"""Eigenfrequencies over the configurations, of the full-order model and of the reduced one beside it.

Frequencies rise along the last axis. Rigid motion is left out, but for what linear springs resist anywhere: that
vibrates, and is 0 at dead centres. Frequencies f below zero are motions that grow as ``exp(2 pi |f| t)``. With more
than one coordinate the configurations are a grid over all of them, the last running fastest.

One mode of vibration of a mechanism at a configuration, as it can be seen.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pgmp_petsc.declare.records import Result, array, columns_of, run_record
from pgmp_petsc.results.trajectory import BodyField
from pgmp_petsc.runtime.files import RunRecord

ABOUT = "flexible eigenfrequencies, rising; rigid motion left out"


@dataclass(frozen=True)
class ModesTable(Result):
    """Eigenfrequencies over the configurations; the reduced model may have another number of them."""

    kind = "modes"
    record: RunRecord = run_record()
    theta: np.ndarray = array(
        "coordinate?", "configuration", columns="coordinate_units", about="configurations",
        label="theta.{column}", is_axis=True,
    )  # fmt: skip
    full_hz: np.ndarray = array(
        "configuration", "full_mode", at="full/frequencies_hz", unit="Hz", about=f"full-order {ABOUT}", gaps=True,
        label="frequency.full",
    )  # fmt: skip
    reduced_hz: np.ndarray | None = array(
        "configuration", "reduced_mode", at="reduced/frequencies_hz", unit="Hz", about=f"reduced {ABOUT}", gaps=True,
        absent=None, label="frequency.reduced",
    )  # fmt: skip
    coordinate_units: dict[str, str] = columns_of("theta", "coordinate")


@dataclass(frozen=True)
class ModeShape:
    """A mode.

    Parameters
    ----------
    frequency_hz : float
    """

    record: RunRecord  # of the reduced model that it is of
    number: int  # from 1, rigid motion left out
    frequency_hz: float
    configuration: str  # in words: ``theta = 0 rad``
    #: one frame: ``positions`` are those of the undeformed body, ``deformation`` is the displacement of the mode, 1 m
    #: at its largest, and quantities are those of that displacement
    fields: dict[str, BodyField]
    notes: tuple[str, ...] = ()  # what is left out
