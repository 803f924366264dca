"""A law as a plugin declares it: a spring with free play, which has two edges."""

from __future__ import annotations

from pgmp_petsc.effects.law import Law

#: It takes the place of an upper stop, whose parameters it has, with 1 for the last one, the width: it plays between
#: place - width / 10 and place, as between two stops.
GAP_SPRING = Law(
    "gap_spring",
    ("k", "c", "place", "width"),
    potential="k * (max(0, s - place)**2 + max(0, place - width / 10 - s)**2) / 2",
    force="elastic * max(0, 1 + c * (rate if s > place else -rate))",
    edges=("s - place", "place - width / 10 - s"),
    left_out="it has free play, not linear",
)
