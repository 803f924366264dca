"""A law as a plugin declares it: a spring with free play, which has two edges."""

from __future__ import annotations

from pgmp_petsc.effects.laws import Law

#: Parameters as those of a stop, whose place it can take: it plays between ``side - place`` and place.
GAP_SPRING = Law(
    "gap_spring",
    ("k", "c", "place", "side"),
    potential="k * (max(0, s - place)**2 + max(0, side - place - s)**2) / 2",
    force="elastic * max(0, 1 + c * (rate if s > 0 else -rate))",
    edges=("s - place", "side - place - s"),
    left_out="it has free play, not linear",
)
