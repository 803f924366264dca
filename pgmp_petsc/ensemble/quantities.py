"""What figures of an ensemble are of: outputs at the end and their extremes, whether events came true, and by how much
they did or did not."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from pgmp_petsc.results.ensemble import DESCRIBED
from pgmp_petsc.results.numbers import sizes_of, with_unit
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


@dataclass(frozen=True, eq=False)
class Peaks:
    """How far outputs go in each sample.

    Attributes
    ----------
    outputs
        At the end, (N,).
    extremes
        Over time, ``<output>/max`` and ``min``, (N,), where these are known.
    ends
        Smallest and largest values at the instants of the bands, (2, n_known), of the first samples.
    """

    outputs: Columns
    extremes: Columns
    ends: Mapping[str, np.ndarray]

    def over_time(self, output: str, which: str) -> np.ndarray:
        """Return ``max`` or ``min`` of an output over time, (N,); NaN where it is not known."""
        if f"{output}/{which}" in self.extremes:
            return self.extremes[f"{output}/{which}"]
        found = np.full(self.outputs[output].size, np.nan)
        if output in self.ends:
            of_bands = self.ends[output][int(which == "max")]
            found[: of_bands.size] = of_bands
        return found

    def largest(self, output: str) -> np.ndarray:
        """Return the largest size of an output in each sample, (N,); of those of which it is not known the median of
        the others, and where it is of none, the largest size at the end."""
        found = np.fmax(np.abs(self.over_time(output, "max")), np.abs(self.over_time(output, "min")))
        known = np.isfinite(found)
        others = found[known] if known.any() else np.abs(self.outputs[output])
        others = others[np.isfinite(others)]
        stand_in = np.nan if not others.size else np.median(others) if known.any() else others.max()
        return np.where(known, found, stand_in)

    def sizes(self, units: Mapping[str, str], fine: np.ndarray) -> dict[str, float]:
        """Return beside what each quantity may vary by round-off: `sizes_of` the outputs."""
        sizes = sizes_of({output: self.largest(output)[fine] for output in self.outputs}, units)
        return sizes | {f"{output}.{which}": size for output, size in sizes.items() for which in DESCRIBED}

    def excess(self, event: Event) -> np.ndarray:
        """Return how far the output of an event is beyond its level, (N,): negative where it is not."""
        above = event.above is not None
        values = self.outputs[event.output]
        if event.when == "ever":
            values = self.over_time(event.output, "max" if above else "min")
        return values - event.level if above else event.level - values
