"""The pieces of an ensemble: every sample once, large ones first, enough of them for all ranks."""

import pytest
from runs import paper_scene, reduced_model

from pgmp_petsc.ensemble.plan import LEAST, SHARE, Piece, checked, missing, pieces, price_of, share_of
from pgmp_petsc.estimates.reference_motion import FINER
from pgmp_petsc.lanes.vectors import LANES


def numbers(found: list[Piece], is_checked: bool) -> list[int]:
    """Return the samples of all pieces of a kind, in order."""
    parts = [part for piece in found for part in piece.parts]
    return sorted(k for part in parts if part.is_checked == is_checked for k in range(part.first, part.last))


@pytest.mark.parametrize("n_groups", [1, 2, 3, 64, 5000])
@pytest.mark.parametrize("largest", [1, 5, 16, 512])
@pytest.mark.parametrize("ranges", [[(0, 10_000)], [(0, 1)], [(3, 40), (41, 42), (700, 2000)], []])
def test_every_sample_is_in_one_piece(n_groups: int, largest: int, ranges: list) -> None:
    to_check = [(first, min(first + 7, last)) for first, last in ranges]
    found = pieces(ranges, to_check, n_groups, largest)
    assert numbers(found, False) == [k for first, last in ranges for k in range(first, last)]
    assert numbers(found, True) == [k for first, last in to_check for k in range(first, last)]
    assert all(piece.last - piece.first <= largest for piece in found)
    kinds = [piece.is_checked for piece in found]
    assert kinds == sorted(kinds, reverse=True), "the dear ones first"


def test_pieces_are_large_at_first_and_small_at_last() -> None:
    sizes = [piece.last - piece.first for piece in pieces([(0, 10_000)], [], 2, 512)]
    assert sizes[0] == 512 and sizes == sorted(sizes, reverse=True)
    assert all(size % LANES == 0 for size in sizes[:-1]) and sizes[-2] == LEAST
    of_many_ranks = pieces([(0, 10_000)], [], 64, 512)
    assert len(of_many_ranks) > 3 * 64
    half = 10_000 / 64 / 2
    assert max(piece.last - piece.first for piece in of_many_ranks) < half + LANES, "of what a rank gets"


def test_samples_whose_errors_are_estimated_are_integrated_once() -> None:
    """Unless they are there already."""
    both, alone, *others = pieces([(8, 100)], [(0, 24)], 1, 512)
    assert (both, alone) == (Piece(8, 24, True, True), Piece(0, 8, True))
    assert both.parts == (Piece(8, 24, True), Piece(8, 24)) and alone.parts == (alone,)
    assert (others[0].first, others[-1].last) == (24, 100)


def test_what_is_missing() -> None:
    assert missing([(0, 10)], []) == [(0, 10)]
    assert missing([(0, 10)], [(0, 10)]) == []
    assert missing([(0, 10)], [(0, 2), (4, 5)]) == [(2, 4), (5, 10)]
    assert missing([(0, 3), (10, 14)], [(2, 3), (10, 12)]) == [(0, 2), (12, 14)]


def test_the_first_of_every_ten_thousand_are_checked() -> None:
    assert checked(0.02, 23_000) == [(0, 200), (10_000, 10_200), (20_000, 20_060)]
    assert checked(0.02, 150) == [(0, 20)], "the share of a thousand"
    assert checked(1.0, 2500) == [(0, 2500)]
    assert checked(0.0, 2500) == []
    assert checked(1e-5, 1000) == [(0, 1)]
    assert checked(0.002, 64, 8) == [(0, 8)], "two samples side by side cost nearly as much"
    assert checked(0.002, 20_000, 8) == [(0, 24), (10_000, 10_024)]
    assert checked(0.002, 3, 8) == [(0, 3)] and checked(1e-5, 1000, 8) == [(0, 1)]


def test_a_share_is_what_a_quarter_of_the_time_buys() -> None:
    """Fewer where a step has few coordinates, and what the scene says in any case."""
    small = ("reduction.modes=4", "reduction.angles=24")
    found = {n: reduced_model(paper_scene(*small, f"simulation.step={1.0 / n!r}")) for n in (4000, 100)}
    assert 0.0 < share_of(found[4000]) < SHARE
    assert price_of(found[100]) == pytest.approx(price_of(found[4000]), rel=0.02)
    assert share_of(reduced_model(paper_scene(*small, "ensemble.checked_share=0.5"))) == 0.5
    # every step, and every half of one to compare with; of four or sixteen modes and the angle
    many = reduced_model(paper_scene("reduction.modes=16", "reduction.angles=24"))
    assert price_of(many) - FINER == pytest.approx(5 / 17 * (price_of(found[100]) - FINER), rel=0.02)
