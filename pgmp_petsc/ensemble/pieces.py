"""The pieces that an ensemble is dealt out in: neighbouring samples that one rank, or a group, takes through together.

Most samples cost least in large batches, but the last pieces decide how long ranks wait for each other: pieces get
smaller as fewer samples are left (guided self-scheduling, Polychronopoulos and Kuck 1987). The samples whose errors are
estimated are in pieces of their own: an estimate takes ten times as long as a run, and a piece of them costs as much as
fifteen samples before there is any in it. They are dealt out first, as few as there are ranks. A sample's numbers
depend on none of this.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from pgmp_petsc.runtime.vectors import LANES

SHARES = 2  # pieces that a rank would have of what is left, if all were equal
LEAST = 32
LEAST_CHECKED, MOST_CHECKED = 8, 128

Ranges = Sequence[tuple[int, int]]


@dataclass(frozen=True)
class Piece:
    """Samples first to last - 1, whether it is their errors that are estimated, and then whether the samples themselves
    are wanted too, or are there already."""

    first: int
    last: int
    is_checked: bool = False
    is_both: bool = False

    @property
    def parts(self) -> tuple[Piece, ...]:
        """What it gives: samples, their errors, or both."""
        if not self.is_both:
            return (self,)
        return Piece(self.first, self.last, True), Piece(self.first, self.last)


def pieces(samples: Ranges, to_check: Ranges, n_groups: int, largest: int) -> list[Piece]:
    """Return the pieces of an ensemble, or of what is left of it, in the order in which they are dealt out.

    Parameters
    ----------
    samples, to_check
        Ranges (first, last) of the samples to be integrated, and of those whose errors are to be estimated.
    n_groups
        Number of ranks, or of groups of ranks that share a sample.
    largest
        Most samples of a piece.
    """
    a_rank = -(-sum(last - first for first, last in to_check) // n_groups)
    even = min(max(_whole_lanes(a_rank), LEAST_CHECKED), MOST_CHECKED, largest)
    both = [ends for wanted in to_check for ends in within(samples, *wanted)]
    found = [Piece(*ends, True, True) for ends in _cut(both, n_groups, even, even)]
    found += [Piece(*ends, True) for ends in _cut(missing(to_check, both), n_groups, even, even)]
    others = missing(samples, both)
    return found + [Piece(*ends) for ends in _cut(others, n_groups, min(LEAST, largest), largest)]


def _cut(ranges: Ranges, n_groups: int, least: int, most: int) -> Iterator[tuple[int, int]]:
    """Yield parts of ranges, shrinking with what is left."""
    left = sum(last - first for first, last in ranges)
    for first, last in ranges:
        while first < last:
            share = _whole_lanes(-(-left // (SHARES * n_groups)))
            size = min(max(share, least), most, last - first)
            yield first, first + size
            first, left = first + size, left - size


def _whole_lanes(n: int) -> int:
    """Return a number of samples that fills lanes, at least n."""
    return -(-n // LANES) * LANES


def within(ranges: Ranges, first: int, last: int) -> list[tuple[int, int]]:
    """Return what of some ranges lies between two numbers, first to last - 1."""
    cut = [(max(begin, first), min(end, last)) for begin, end in ranges]
    return [(begin, end) for begin, end in cut if begin < end]


def missing(wanted: Ranges, there: Ranges) -> list[tuple[int, int]]:
    """Return what of some ranges is not there; both are sorted and do not overlap."""
    found = []
    for first, last in wanted:
        for begin, end in there:
            if begin < last and first < end:
                found.append((first, begin))
                first = end
        found.append((first, last))
    return [(first, last) for first, last in found if first < last]
