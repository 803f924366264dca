"""The search for a step, on errors that are known: smooth ones, and vibrations that keep no phase."""

from collections.abc import Callable

import numpy as np
import pytest

from pgmp_petsc.bench.step_choice import AHEAD, FEWEST, SEEN, StepSearch, fine_enough, first_steps, rounded_step
from pgmp_petsc.scene.numerics import count_steps
from pgmp_petsc.stepping.second_order_system import Scheme
from scenes import slider_crank

DURATION, SHARE = 1.0, 2e-3
INSTANTS = np.linspace(0.0, DURATION, 257)


def smooth(n_steps: int) -> np.ndarray:
    """Return a motion with an error of second order, 3 / n^2 of its size at the end."""
    return np.sin(INSTANTS) * (1 + 3.0 * INSTANTS / n_steps**2)


def vibrating(n_steps: int) -> np.ndarray:
    """Return a motion on which a 300 Hz vibration lies, as generalised-alpha integrates it: damped, late in phase."""
    omega, step = 2 * np.pi * 300.0, DURATION / n_steps
    # eigenvalue of one step of the scheme for x'' = -omega^2 x, state (x, h x', h^2 a, h^2 A)
    s, w = Scheme.of(0.8, 1.0), (omega * step) ** 2
    left = np.array([[1, 0, 0, -s.beta], [0, 1, 0, -s.gamma], [w, 0, 1, 0], [0, 0, s.alpha_f - 1, 1 - s.alpha_m]])
    right = np.array([[1, 1, 0, 0.5 - s.beta], [0, 1, 0, 1 - s.gamma], [0, 0, 0, 0], [0, 0, s.alpha_f, -s.alpha_m]])
    root = max(np.linalg.eigvals(np.linalg.solve(left, right)), key=lambda value: (abs(value), value.imag))
    return smooth(n_steps) + SHARE * np.real(
        np.abs(root) ** (INSTANTS / step) * np.exp(1j * np.abs(np.angle(root)) * INSTANTS / step)
    )


def searched(
    motion: Callable[[int], np.ndarray], allowed: float, most: int, first: int = 32, coarsest: int = 32
) -> StepSearch:
    """Return the search after it ran."""
    search = StepSearch(lambda n, m: np.array([np.max(np.abs(motion(n) - motion(m)))]), first, allowed, coarsest)
    search.advance(most)
    return search


@pytest.mark.parametrize("allowed", [1e-3, 1e-4, 1e-5, 1e-6])
def test_a_smooth_motion_gets_the_step_that_its_order_allows(allowed: float) -> None:
    search = searched(smooth, allowed, 65536)
    true = 3.0 * np.sin(1.0) / search.chosen**2
    assert true <= 1.02 * allowed, "of 64 parts, one is not seen by a comparison with steps eight times as fine"
    # not smaller than the next halving would have been good for, or than the first run
    assert search.chosen == 32 or true > 0.2 * allowed
    assert search.error == pytest.approx(true, rel=0.4)


def exact() -> np.ndarray:
    return vibrating(2**20)


@pytest.mark.parametrize("allowed", [4e-3, 2.5e-3, 1e-3, 5e-4])
def test_a_vibration_is_seen_with_every_step(allowed: float) -> None:
    """It is seen as large as it is, up to what two phases may make of it."""
    search = searched(vibrating, allowed, 2**17)
    true = np.max(np.abs(vibrating(search.chosen) - exact()))
    assert true <= 1.25 * allowed
    assert search.error == pytest.approx(true, rel=0.6)


@pytest.mark.parametrize(("allowed", "chosen"), [(4e-2, 8), (1e-2, 16), (4e-3, 32), (1e-3, 64)])
def test_a_step_may_be_longer_than_those_that_are_halved(allowed: float, chosen: int) -> None:
    """Runs with 8 and 16 steps have errors of 3.9 and 0.99 %; halving begins with 32."""
    search = searched(smooth, allowed, 65536, coarsest=8)
    assert search.chosen == chosen
    assert search.finest == 32 * SEEN, "errors are seen against the run that sees the vibrations"


def test_a_long_step_is_not_good_by_chance() -> None:
    """At few instants a vibration is seen smaller than it is: 16 steps see less of it than 32 do."""
    seen = {16: 1e-4, 32: 3e-3, 64: 2e-3}
    search = StepSearch(lambda n, m: np.array([seen.get(n, 1e-5)]), 32, 1e-3, 8)
    search.advance(65536)
    assert search.chosen == 128


@pytest.mark.parametrize("duration", [0.05, 0.7, 1.0, 3.0, 40.0])
def test_the_search_begins_with_four_steps_a_period_and_may_take_one(duration: float) -> None:
    scene = slider_crank(f"simulation.duration={duration}")
    coarsest, first = first_steps(scene, 1.0 / 64.0)
    assert coarsest == max(np.ceil(64.0 * duration), FEWEST)
    assert first % coarsest == 0 and 4 * 64.0 * duration <= first <= max(8 * 64.0 * duration, FEWEST)
    assert fine_enough(coarsest, first) == SEEN * first and fine_enough(4 * first, first) == AHEAD * 4 * first


def test_steps_of_sampled_controllers_have_samplings_at_their_ends() -> None:
    """Two controllers, sampled every 3 and 2 ms in 0.9 s: multiples of 300 and of 450 steps, also extrapolated."""
    pid = 'controllers.{}={{type="pid",joint="crank_hinge",measures="crank_angle",gains={{p=1.0}},sample_time={}}}'
    measured = 'outputs.crank_angle={type="angle",joint="crank_hinge"}'
    settings = "simulation={duration=0.9,tolerance=1e-3}", measured, pid.format("a", 3e-3), pid.format("b", 2e-3)
    coarsest, first = first_steps(slider_crank(*settings), 0.9 / 200.0)
    assert (coarsest, first) == (900, 900)
    search = StepSearch(lambda n, m: np.array([np.max(np.abs(smooth(n) - smooth(m)))]), 900, 1e-8, 900, 900)
    search.advance(65536)
    assert search.chosen % 900 == 0 and search.chosen != 900 and search.error < 1e-8


def test_it_gives_up_where_no_step_is_small_enough() -> None:
    search = searched(vibrating, 1e-5, 4096)
    assert search.chosen is None and search.finest == 4096


@pytest.mark.parametrize(("last", "chosen"), [(4e-4, 2048), (6e-4, None), (9e-4, None)])
def test_the_finest_run_is_taken_where_its_halving_moved_less_than_half(last: float, chosen: int | None) -> None:
    """The allowed error is 7e-4; 6e-4 after 1e-3 may go on for ever."""

    def compare(n: int, m: int) -> np.ndarray:
        return np.array([last if m == 2048 and m == 2 * n else 1e-3])

    search = StepSearch(compare, 32, 7e-4, 32)
    search.advance(2048)
    search.settle_for_finest()
    assert search.chosen == chosen
    assert chosen is None or search.error == last


def test_it_goes_on_where_it_stopped() -> None:
    search = StepSearch(lambda n, m: np.array([np.max(np.abs(smooth(n) - smooth(m)))]), 32, 1e-5, 32)
    search.advance(256)
    assert search.chosen is None
    search.advance(65536)
    assert search.chosen == searched(smooth, 1e-5, 65536).chosen


def test_a_failed_run_is_no_reason_to_stop() -> None:
    """Runs with fewer than 300 steps fail: their difference from others is infinite."""

    def compare(n: int, m: int) -> np.ndarray:
        return np.array([np.inf if n < 300 else np.max(np.abs(smooth(n) - smooth(m)))])

    search = StepSearch(compare, 32, 1e-2, 32)
    search.advance(65536)
    assert search.chosen == 512


def test_all_outputs_count() -> None:
    def compare(n: int, m: int) -> np.ndarray:
        return np.array([np.max(np.abs(motion(n) - motion(m))) for motion in (smooth, vibrating)])

    search = StepSearch(compare, 32, 5e-4, 32)
    search.advance(2**17)
    assert search.chosen == searched(vibrating, 5e-4, 2**17).chosen


@pytest.mark.parametrize("duration", [1.0, 0.3, 7.0, 1e-6])
@pytest.mark.parametrize("n_steps", [1, 64, 257, 1028, 72173])
def test_a_step_has_three_digits_and_makes_hardly_more_steps(duration: float, n_steps: int) -> None:
    step = rounded_step(duration, n_steps)
    assert float(f"{step:.3g}") == step
    assert n_steps <= count_steps(duration, step) <= 1.01 * n_steps + 1
