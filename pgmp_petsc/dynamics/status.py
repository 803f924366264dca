"""What became of a sample."""

from __future__ import annotations

from enum import IntEnum


class Status(IntEnum):
    """Status of a sample; everything but FINE is a failure with the reason in its name."""

    FINE = 0
    OUT_OF_BOUNDS = 1
    NOT_CONVERGED = 2
    LEFT_RANGE = 3
    NO_EQUILIBRIUM = 4

    @property
    def meaning(self) -> str:
        """Return the reason in words."""
        return _MEANINGS[self]


_MEANINGS = {
    Status.FINE: "fine",
    Status.OUT_OF_BOUNDS: "a parameter lies outside its bounds; not integrated",
    Status.NOT_CONVERGED: "Newton's iteration did not converge within a time step",
    Status.LEFT_RANGE: "a coordinate left the range that the reduced model was sampled over",
    Status.NO_EQUILIBRIUM: "no static equilibrium was found to start from",
}
