"""A table of the summary, and how numbers are written in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Table:
    """A Markdown section: title, some words, rows of cells.

    Attributes
    ----------
    title
        Heading of the section.
    header
        Names of the columns.
    rows
        Cells; each row has as many as the header.
    before, after
        Words above and below the table.
    """

    title: str
    header: Sequence[str]
    rows: Sequence[Sequence[str]] = field(default_factory=list)
    before: str = ""
    after: str = ""

    def __post_init__(self) -> None:
        for row in self.rows:
            if len(row) != len(self.header):
                raise ValueError(f"table '{self.title}': a row has {len(row)} cells; needed: {len(self.header)}")

    def markdown(self) -> str:
        """Return the section as Markdown."""
        lines = [self.header, ["---"] * len(self.header), *self.rows]
        table = "\n".join(f"| {' | '.join(cells)} |" for cells in lines)
        return "\n\n".join(part for part in (f"## {self.title}", self.before, table, self.after) if part)


def number(value: float, digits: int = 4) -> str:
    """Return a number with so many significant digits, and all digits before the point."""
    return f"{value:.0f}" if abs(value) >= 10**digits else f"{value:.{digits}g}"


def with_error(value: float, error: float, factor: float = 1.0) -> str:
    """Return ``5.2833 ± 0.0017``: decimals so that the error has two digits; both times `factor`."""
    value, error = value * factor, error * factor
    if not error > 0.0:
        return f"{value:.6g}"
    decimals = 0
    while error * 10**decimals < 9.95 and decimals < 12:
        decimals += 1
    return f"{value:.{decimals}f} ± {error:.{decimals}f}"


def span(low: float, high: float, digits: int = 4) -> str:
    """Return ``49 to 64.1``."""
    return f"{number(low, digits)} to {number(high, digits)}"


def percent(ratio: float, digits: int = 2) -> str:
    """Return a ratio in %."""
    return f"{number(100.0 * ratio, digits)} %"
