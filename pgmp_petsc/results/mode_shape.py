"""One mode of vibration of a mechanism at a configuration, as it can be seen."""

from __future__ import annotations

from dataclasses import dataclass

from pgmp_petsc.results.body_fields import BodyField
from pgmp_petsc.runtime.files import RunRecord


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
