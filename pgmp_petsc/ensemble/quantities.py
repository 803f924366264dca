"""What figures of an ensemble are of: outputs at the end and their extremes, and whether events came true."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from pgmp_petsc.results.ensemble import DESCRIBED
from pgmp_petsc.results.numbers import with_unit
from pgmp_petsc.scene.ensemble import Event

Columns = Mapping[str, np.ndarray]


def quantities(outputs: Columns, extremes: Columns) -> Iterator[tuple[str, np.ndarray]]:
    """Yield outputs at the end, and over time where their extremes are known; one in memory at a time."""
    yield from outputs.items()
    for key in extremes:
        name, _, which = key.rpartition("/")
        if which in DESCRIBED:
            yield f"{name}.{which}", extremes[key]


def quantity(name: str, outputs: Columns, extremes: Columns) -> np.ndarray:
    """Return one of these."""
    return outputs[name] if name in outputs else extremes["/".join(name.rsplit(".", 1))]


def came_true(event: Event, label: str, outputs: Columns, passages: Columns) -> np.ndarray:
    """Return in which samples an event came true, bool (N,); those that failed have none."""
    if event.when == "ever":
        return np.isfinite(passages[label])
    values = outputs[event.output]
    return values > event.level if event.above is not None else values < event.level


def in_words(event: Event, unit: str) -> str:
    """Return what comes true: ``angle above 3 rad at the end``."""
    side = "above" if event.above is not None else "below"
    when = "at the end" if event.when == "end" else "at any time"
    return f"{event.output} {side} {with_unit(event.level, unit, 6)} {when}"
