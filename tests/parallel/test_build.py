"""The offline build is the same for any number of ranks and groups, and whatever signs and order the solver returns."""

from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from pgmp_petsc.reduction.cell_products import pair_rotations
from pgmp_petsc.reduction.rom import ReducedOrderModel

# all cases of one number of ranks in one run: "name:ranks_per_group:seed of the scrambling"
RUNS = {
    1: "plain:1:0 plain:1:1 weight:1:0 few:1:0 reflected:1:0 reflected:1:1 static_reflected:1:0 curved:1:0 curved:1:1 "
    "curved_turning:1:0 extended:1:0 extended:1:1 extended_adaptive:1:0 two:1:0 two:1:1 two_static:1:0 "
    "two_crossing:1:0",
    2: "plain:1:0 plain:2:0 static_reflected:1:0 curved:2:0 curved_turning:2:0 extended:2:0 extended_adaptive:1:0 "
    "two:1:0 two_static:2:0 two_crossing:1:2",
    # of what two ranks have tried already, what a third one changes
    3: "few:3:3 weight:2:2",
    5: "plain:2:5 few:5:0 reflected:1:4 curved:3:2 extended:2:3 two:3:0",
}  # fmt: skip
RUNS = {n: cases.split() for n, cases in RUNS.items()}
CASES = [(n, case) for n, cases in RUNS.items() for case in cases if (n, case.split(":")[1:]) != (1, ["1", "0"])]
TABLES = ("mass", "inertia", "stiffness", "load")


@pytest.fixture(scope="module")
def model(mpirun: Callable, parallel_scripts: Path, folder: Path) -> Callable[[int, str], ReducedOrderModel]:
    """Return a function that gives the model of a case; the first one asked for builds all those of its ranks."""
    return cache(lambda n, case: built(mpirun, parallel_scripts / "build.py", folder, RUNS, n, case))


def built(mpirun: Callable, script: Path, folder: Path, runs: dict, n: int, case: str) -> ReducedOrderModel:
    name, ranks_per_group, seed = case.split(":")
    printed, path = folder / f"{n}.txt", folder / f"{name}_{n}_{ranks_per_group}_{seed}.h5"
    if not printed.exists():
        printed.write_text(mpirun(n, script, folder, *runs[n]).stdout)
    assert path.exists(), printed.read_text()
    return ReducedOrderModel.read(path)


@pytest.mark.parametrize(("n", "case"), CASES)
def test_frequencies_do_not_depend_on_ranks_and_signs(model: Callable, n: int, case: str) -> None:
    expected, rom = model(1, f"{case.split(':')[0]}:1:0"), model(n, case)
    # the solver's own tolerance is 1e-13 of the largest of the shifted and inverted values
    np.testing.assert_allclose(rom.frequencies_hz, expected.frequencies_hz, rtol=1e-9)
    np.testing.assert_allclose(rom.cosines, expected.cosines, rtol=0, atol=1e-8)
    one, other = rom.tables.samples, expected.tables.samples
    np.testing.assert_array_equal(one.theta, other.theta)
    for axis, like in zip(one, other, strict=True):
        assert (axis.lower, axis.upper, axis.periodic) == (like.lower, like.upper, like.periodic)
    assert rom.n_redundant == expected.n_redundant
    assert rom.record.ranks == n


@pytest.mark.parametrize(("n", "case"), CASES)
def test_tables_are_the_same_but_for_one_constant_rotation(model: Callable, n: int, case: str) -> None:
    expected, rom = model(1, f"{case.split(':')[0]}:1:0"), model(n, case)
    for name in ("mass_weights", "stiffness_weights", "load_weights", "load_effects"):
        assert getattr(rom.tables, name) == getattr(expected.tables, name)
    rotation = np.linalg.lstsq(rom.projection[0], expected.projection[0], rcond=None)[0]
    m = rom.tables.n_modes
    np.testing.assert_allclose(rotation.T @ rotation, np.eye(m), rtol=0, atol=1e-8)
    tables = rom.tables.turned(np.broadcast_to(rotation, (rom.tables.samples.n, m, m)))
    for name in TABLES:
        one = getattr(expected.tables, name)
        size = np.abs(one).max(initial=0.0)
        np.testing.assert_allclose(getattr(tables, name), one, rtol=0, atol=1e-8 * size, err_msg=name)
    assert rom.points.points == expected.points.points
    np.testing.assert_allclose(rom.points.missed, expected.points.missed, rtol=0, atol=2e-6)
    np.testing.assert_allclose(
        rom.projection @ rotation, expected.projection, rtol=0, atol=1e-7 * np.abs(expected.projection).max()
    )
    assert (rom.curvature is None) == (tables.second_order is None) == (not case.startswith("curved"))
    if rom.curvature is None:
        return
    for name in ("cubic", "curved_load", "curved_inertia"):
        one, other = getattr(expected.tables.second_order, name), getattr(tables.second_order, name)
        np.testing.assert_allclose(other, one, rtol=0, atol=1e-9 * np.abs(one).max(initial=0.0), err_msg=name)
    curvature = rom.curvature @ pair_rotations(rotation[None])[0]
    np.testing.assert_allclose(curvature, expected.curvature, rtol=0, atol=1e-9 * np.abs(expected.curvature).max())


@pytest.mark.parametrize(("n", "case"), [(n, case) for n, case in CASES if case.startswith("plain")])
def test_even_the_constant_rotation_is_the_identity_without_a_reflection(model: Callable, n: int, case: str) -> None:
    expected, rom = model(1, "plain:1:0"), model(n, case)
    for name in TABLES:
        one = getattr(expected.tables, name)
        size = np.abs(one).max(initial=0.0)
        np.testing.assert_allclose(getattr(rom.tables, name), one, rtol=0, atol=1e-8 * size, err_msg=name)


def test_a_scene_with_a_reflection_has_two_turns(model: Callable) -> None:
    rom = model(1, "reflected:1:0")
    half = len(rom.projection) // 2
    assert (rom.tables.samples.n, rom.frequencies_hz.shape[0]) == (24, 12)
    signs = np.sum(rom.projection[:half] * rom.projection[half:], axis=(0, 1))
    assert np.sum(signs < 0) == 1
    np.testing.assert_array_equal(np.abs(rom.projection[:half]), np.abs(rom.projection[half:]))


@pytest.mark.parametrize(("n", "ranks_per_group"), [(3, 1), (4, 2)])
def test_a_failure_of_one_group_is_that_of_all_ranks(mpirun, parallel_scripts, folder, n, ranks_per_group) -> None:
    case = f"fails:{ranks_per_group}:0"
    lines = mpirun(n, parallel_scripts / "build.py", folder, case).stdout.splitlines()
    assert lines == [f"{case} RunError: eigenproblem at theta = 4.71239 rad: spoilt by the test"] * n


def test_bad_input_is_refused_on_all_ranks(mpirun: Callable, parallel_scripts: Path, folder: Path) -> None:
    cases = ("refused:1:0", "refused:3:0", "plain:4:0")
    lines = mpirun(3, parallel_scripts / "build.py", folder, *cases).stdout.splitlines()
    for case in cases[:2]:
        assert sum(line.startswith(f"{case} InputError: reduction.modes = 31") for line in lines) == 3
    assert sum(line.startswith("plain:4:0 InputError: --ranks-per-angle = 4") for line in lines) == 3
