"""What a scene says that cannot be meant, which is refused, and what probably is not, which is warned of."""

from pgmp_petsc.studies.plausibility.check import plausibility

__all__ = ["plausibility"]
