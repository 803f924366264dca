"""Agreement between ranks: the same failure everywhere, and no rank left waiting."""

import pytest

RANKS = (1, 3)


def outcomes(mpirun, parallel_scripts, n: int, case: str) -> tuple[list[str], str]:
    """Return the line of every rank, and stderr."""
    done = mpirun(n, parallel_scripts / "agreement.py", case)
    lines = done.stdout.splitlines()
    assert len(lines) == n
    return lines, done.stderr


@pytest.mark.parametrize("n", RANKS)
def test_nothing_is_raised_where_no_rank_fails(mpirun, parallel_scripts, n):
    assert outcomes(mpirun, parallel_scripts, n, "fine")[0] == ["returned fine"] * n


@pytest.mark.parametrize("n", RANKS)
def test_an_error_of_one_rank_is_raised_on_all(mpirun, parallel_scripts, n):
    lines, _ = outcomes(mpirun, parallel_scripts, n, "one")
    assert lines == ["raised InputError 2: bodies.rod.mesh: no such file"] * n


@pytest.mark.parametrize("n", RANKS)
def test_the_lowest_failing_rank_decides(mpirun, parallel_scripts, n):
    lines, _ = outcomes(mpirun, parallel_scripts, n, "several")
    assert lines == [f"raised RunError 1: failed on {min(1, n - 1)}"] * n


@pytest.mark.parametrize("n", RANKS)
def test_an_unexpected_exception_names_activity_type_and_rank(mpirun, parallel_scripts, n):
    lines, stderr = outcomes(mpirun, parallel_scripts, n, "unexpected")
    message = f"raised RunError 1: eigenproblem 7 failed on rank {n - 1}: ZeroDivisionError: oops"
    assert lines == [message] * n
    assert stderr.count("Traceback") == 1
    assert "fail_with" in stderr and f"rank {n - 1}, eigenproblem 7" in stderr


@pytest.mark.parametrize("n", RANKS)
def test_an_error_that_cannot_be_pickled_keeps_its_message(mpirun, parallel_scripts, n):
    lines, _ = outcomes(mpirun, parallel_scripts, n, "unpicklable")
    assert {line.split(": ")[1] for line in lines} == {"diverged at 0.5"}
    assert all(line.split()[2] == "1:" for line in lines)


@pytest.mark.parametrize("n", RANKS)
def test_a_result_of_the_root_reaches_all(mpirun, parallel_scripts, n):
    assert outcomes(mpirun, parallel_scripts, n, "root")[0] == ["returned [1, 2, 3]"] * n


@pytest.mark.parametrize("n", RANKS)
def test_a_failure_of_the_root_reaches_all(mpirun, parallel_scripts, n):
    assert outcomes(mpirun, parallel_scripts, n, "root_fails")[0] == ["raised InputError 2: missing"] * n


def test_a_result_of_the_root_that_cannot_be_pickled_is_a_failure_of_all(mpirun, parallel_scripts):
    lines, _ = outcomes(mpirun, parallel_scripts, 3, "root_unpicklable")
    assert len(set(lines)) == 1 and "failed on rank 0" in lines[0]


def test_timings_are_the_maximum_over_ranks_of_every_phase(mpirun, parallel_scripts):
    lines, _ = outcomes(mpirun, parallel_scripts, 3, "timings")
    expected = [("all", 3.0), ("only 0", 0.5), ("only 1", 0.5), ("only 2", 0.5)]
    assert lines == [f"returned {expected}"] * 3
