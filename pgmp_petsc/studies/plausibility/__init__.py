"""Plausibility of a scene: impossible entries are refused, doubtful ones lead to a warning."""

from pgmp_petsc.studies.plausibility.check import plausibility

__all__ = ["plausibility"]
