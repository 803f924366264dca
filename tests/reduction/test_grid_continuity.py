"""Continuity of bases over a grid of two coordinates: groups, holonomies, reflections, and what cannot be followed."""

from collections.abc import Callable
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from runs import built_rom

from pgmp_petsc.base.errors import RunError
from pgmp_petsc.modes import continuity
from pgmp_petsc.modes.continuity import GridBasis, GridNeighbours
from pgmp_petsc.reduction.sample_grid import SampleGrid, Samples
from pgmp_petsc.scene import scene_from_toml, scene_to_toml
from scenes import HEADER, tables

N_ROWS = 8
RANDOM = np.random.default_rng(5)
FRAME = np.linalg.qr(RANDOM.normal(size=(N_ROWS, N_ROWS)))[0]
DRIFT = 0.12 * RANDOM.normal(size=(4, N_ROWS, 3))
Space = Callable[[float, float], np.ndarray]


def drifting(first: float, second: float) -> np.ndarray:
    """Return three vectors (N_ROWS, 3), of period 2 pi in both coordinates, whose space turns."""
    waves = (np.cos(first), np.sin(first + second), np.cos(second), np.sin(2 * second - first))
    return FRAME[:, :3] + sum(wave * part for wave, part in zip(waves, DRIFT))


def half_turn(angle: float, k: int) -> np.ndarray:
    """Return a vector that has the opposite sign after a revolution."""
    return np.cos(angle / 2) * FRAME[:, k] + np.sin(angle / 2) * FRAME[:, k + 1]


def flipping(first: float, second: float) -> np.ndarray:
    """Return three vectors, one with the opposite sign after a revolution of the second coordinate."""
    vectors = drifting(first, second)
    vectors[:, 1] = half_turn(second, 4) + 0.3 * np.cos(first) * FRAME[:, 6] * np.cos(second / 2)
    return vectors


def flipping_both(first: float, second: float) -> np.ndarray:
    """Return two vectors, the first one flipped by the first coordinate and the other one by the second."""
    return np.column_stack([half_turn(first, 0), half_turn(second, 4)])


def flipping_together(first: float, second: float) -> np.ndarray:
    """Return one vector that either coordinate flips."""
    return half_turn(first + second, 2)[:, None]


def grid(shape: tuple[int, int], periodic: tuple[bool, bool] = (True, True)) -> SampleGrid:
    """Return a grid over a revolution of each coordinate."""
    axes = (Samples.uniform(0.0, 2 * np.pi, n, turns) for n, turns in zip(shape, periodic))
    return SampleGrid(tuple(axes))


def sampled(space: Space, samples: SampleGrid, apart: bool = False) -> tuple[np.ndarray, GridNeighbours]:
    """Return orthonormal vectors (n, N_ROWS, m) as a solver may, and how neighbours see them.

    Eigenvalues are equal, so that any basis may come, or `apart`, with random signs.
    """
    random, vectors = np.random.default_rng(1), []
    for theta in samples.theta:
        basis, triangle = np.linalg.qr(space(*theta))
        basis *= np.sign(np.diag(triangle))
        m = basis.shape[1]
        turn = np.diag(random.choice([-1.0, 1.0], m)) if apart else np.linalg.qr(random.normal(size=(m, m)))[0]
        vectors.append(basis @ turn)
    vectors = np.array(vectors)
    overlaps = np.array([np.swapaxes(vectors, 1, 2) @ vectors[samples.before(axis)] for axis in range(2)])
    values = np.tile(np.arange(1.0, m + 1) if apart else 1.0 + 1e-9 * np.arange(m), (samples.n, 1))
    return vectors, GridNeighbours(samples.shape, samples.periodic, values, overlaps, np.ones(m, dtype=bool))


def jumps(samples: SampleGrid, bases: np.ndarray, flipped: np.ndarray) -> list[float]:
    """Return the largest difference of neighbours along each axis, also where a revolution ends."""
    largest = []
    for axis in range(2):
        before = samples.before(axis)
        signs = np.ones((samples.n, 1, bases.shape[2]))
        signs[before > np.arange(samples.n)] = np.where(flipped[axis], -1.0, 1.0)
        step = np.linalg.norm(bases - signs * bases[before], axis=(1, 2))
        largest.append(step[before >= 0].max())
    return largest


@pytest.mark.parametrize(
    ("space", "flips"), [(drifting, (0, 0)), (flipping, (0, 1)), (flipping_both, (1, 1)), (flipping_together, (1, 1))]
)
def test_neighbours_come_close_as_the_grid_is_refined(space: Space, flips: tuple[int, int]) -> None:
    found = []
    for n in (12, 24, 48):
        samples = grid((n, n + 2))
        vectors, neighbours = sampled(space, samples, apart=space is flipping_both)
        basis = GridBasis.of(neighbours, np.eye(vectors.shape[2]))
        assert tuple(basis.flipped.sum(axis=1)) == flips
        bases = vectors @ basis.rotations
        lengths = np.swapaxes(basis.rotations, 1, 2) @ basis.rotations
        np.testing.assert_allclose(lengths - np.eye(vectors.shape[2]), 0.0, rtol=0, atol=1e-12)
        found.append(jumps(samples, bases, basis.flipped))
    coarse, middle, fine = np.array(found)
    # continuous with bounded slopes: half the step, half the jump
    np.testing.assert_allclose(fine / middle, 0.5, rtol=0, atol=0.06)
    assert np.all(middle < 0.65 * coarse)


@pytest.mark.parametrize("periodic", product([True, False], repeat=2))
def test_open_ends_are_not_joined(periodic: tuple[bool, bool]) -> None:
    samples = grid((25, 28), periodic)
    vectors, neighbours = sampled(drifting, samples)
    # what stands where there is no neighbour has no part in it
    for axis in range(2):
        neighbours.overlaps[axis][samples.before(axis) < 0] = np.nan
    basis = GridBasis.of(neighbours, np.eye(3))
    largest = jumps(samples, vectors @ basis.rotations, basis.flipped)
    assert max(largest) < 0.4 and basis.cosines.min() > 0.9
    if not any(periodic):
        assert basis.cosines[0] == 1.0


def test_one_axis_is_a_line() -> None:
    """A second coordinate with nothing to change changes nothing."""
    line = SampleGrid((Samples.uniform(0.0, 2 * np.pi, 20, True),))
    vectors = np.array([np.linalg.qr(drifting(theta, 0.0))[0] for theta in line.theta[:, 0]])
    overlaps = np.swapaxes(vectors, 1, 2) @ vectors[line.before(0)]
    values = np.tile(1.0 + 1e-9 * np.arange(3), (20, 1))
    one = GridBasis.of(GridNeighbours((20,), (True,), values, overlaps[None], np.ones(3, dtype=bool)), np.eye(3))
    same = np.swapaxes(vectors, 1, 2) @ vectors
    both = np.stack([np.repeat(overlaps, 5, axis=0), np.repeat(same, 5, axis=0)])
    grid_of = GridNeighbours((20, 5), (True, True), np.repeat(values, 5, axis=0), both, np.ones(3, dtype=bool))
    two = GridBasis.of(grid_of, np.eye(3))
    np.testing.assert_allclose(two.rotations, np.repeat(one.rotations, 5, axis=0), rtol=0, atol=1e-12)


def test_a_mode_that_meets_one_that_is_not_kept_cannot_be_followed() -> None:
    """Around a conical intersection a mode changes its sign: on the circle, between lines, and over a revolution."""

    def lowest(first: float, second: float) -> np.ndarray:
        across, along = np.cos(first + 0.1) + np.cos(second + 0.1), np.sin(first + 0.1)
        return FRAME[:, :2] @ np.linalg.eigh([[across, along], [along, -across]])[1][:, :1]

    for periodic in ((True, True), (True, False), (False, False)):
        _, neighbours = sampled(lowest, grid((16, 17), periodic))
        with pytest.raises(RunError, match="a mode that is kept meets one that is not"):
            GridBasis.of(neighbours, np.eye(1))


def test_modes_that_can_be_followed_are_told_from_the_answer_or_mode_that_cannot(monkeypatch) -> None:
    """A mode keeps apart; what is beside it changes its sign around a configuration, whatever the grid. Of numbers of
    modes that can be followed those are told that turn little between neighbours."""

    def answered(first: float, second: float) -> np.ndarray:
        across, along = np.cos(first + 0.1) + np.cos(second + 0.1), np.sin(first + 0.1)
        answer = FRAME[:, :2] @ np.linalg.eigh([[across, along], [along, -across]])[1][:, :1]
        mode = drifting(first, second)[:, 2:]
        return np.column_stack([mode - FRAME[:, :2] @ (FRAME[:, :2].T @ mode), answer])

    for shape in ((16, 17), (32, 34)):
        vectors, neighbours = sampled(answered, grid(shape, (False, False)), apart=True)
        alone = neighbours.of_first(1)
        np.testing.assert_array_equal(alone.overlaps, neighbours.overlaps[..., :1, :1])
        assert GridBasis.of(alone, np.eye(1)).cosines.min() > 0.5
        with pytest.raises(RunError, match="cannot be followed .*; with reduction.modes = 1 they can"):
            GridBasis.of(neighbours, np.eye(2))
        beside = replace(neighbours, eigenvalues=neighbours.eigenvalues[:, :1])
        with pytest.raises(RunError, match=r"static answers .* though its 1 mode.s. alone can.*reduction.spring_modes"):
            GridBasis.of(beside, np.eye(2))
        for cosines, told in (({4: 0.1, 3: 0.6, 1: 0.9}, 3), ({4: 0.1, 3: 0.4}, 4)):
            monkeypatch.setattr(continuity, "_followed_modes", lambda *_: cosines)
            with pytest.raises(RunError, match=f"with reduction.modes = {told} they can$"):
                GridBasis.of(neighbours, np.eye(2))
            with pytest.raises(RunError, match=f"= {told} they can, where no static answers are beside them"):
                GridBasis.of(beside, np.eye(2))
        monkeypatch.undo()


@pytest.mark.parametrize("axis", [0, 1])
def test_tables_over_two_turns(axis: int) -> None:
    samples = grid((3, 4))
    table = np.arange(12.0)[:, None] * [1.0, 100.0]
    twice = samples.over_two_turns(axis)
    both = samples.twice(axis, table, -table).reshape(*twice.shape, 2)
    parts = np.split(both, 2, axis=axis)
    np.testing.assert_array_equal(parts[0].reshape(12, 2), table)
    np.testing.assert_array_equal(parts[1].reshape(12, 2), -table)
    assert twice.axes[axis].upper == pytest.approx(4 * np.pi) and twice.axes[1 - axis] is samples.axes[1 - axis]


def test_a_grid_is_told_from_its_configurations_in_any_order() -> None:
    samples = grid((3, 4))
    shuffled = np.random.default_rng(0).permutation(samples.theta)
    found = samples.tabulated(shuffled)
    np.testing.assert_array_equal(found.theta, samples.theta)
    assert found.periodic == samples.periodic
    samples = grid((3, 4), (False, True))
    assert samples.before(0).tolist() == [-1, -1, -1, -1, 0, 1, 2, 3, 4, 5, 6, 7]
    assert samples.before(1).tolist() == [3, 0, 1, 2, 7, 4, 5, 6, 11, 8, 9, 10]


def test_a_periodic_range_leaves_out_its_end() -> None:
    periodic, limited = Samples.uniform(1.0, 3.0, 4, True), Samples.uniform(1.0, 3.0, 5, False)
    np.testing.assert_allclose(periodic.theta, [1.0, 1.5, 2.0, 2.5], atol=1e-15)
    np.testing.assert_allclose(limited.theta, [1.0, 1.5, 2.0, 2.5, 3.0], atol=1e-15)
    assert (periodic.n, limited.n) == (4, 5)
    for samples in (periodic, limited):
        assert (samples.lower, samples.upper) == (1.0, 3.0)
    assert periodic.periodic and not limited.periodic


@pytest.mark.parametrize("n", [2, 3, 4, 33])
def test_chebyshev_points_have_equal_angles_on_the_circle_and_contain_the_ends(n: int) -> None:
    samples = Samples.chebyshev(-1.0, 3.0, n)
    assert (samples.n, samples.lower, samples.upper, samples.periodic) == (n, -1.0, 3.0, False)
    assert (samples.theta[0], samples.theta[-1]) == (-1.0, 3.0)
    assert np.all(np.diff(samples.theta) > 0)
    np.testing.assert_allclose(samples.theta + samples.theta[::-1], 2.0, rtol=0, atol=1e-14)
    circle = np.arccos(np.clip((1.0 - samples.theta) / 2, -1.0, 1.0))
    np.testing.assert_allclose(np.diff(circle), np.pi / (n - 1), rtol=0, atol=1e-6)


@pytest.mark.parametrize("periodic", [True, False])
def test_equal_distances_are_those_of_the_range(periodic: bool) -> None:
    uniform = Samples.uniform(-2.0, 5.0, 20, periodic)
    assert uniform.is_uniform
    for samples in (
        Samples(uniform.theta + 1e-9 * np.sin(uniform.theta), -2.0, 5.0, periodic),
        # equal distances that do not fill the range
        Samples(uniform.theta + 0.1, -2.0, 5.0, periodic),
        Samples(uniform.theta, -2.0, 5.0, not periodic),
    ):
        assert not samples.is_uniform
    assert Samples(uniform.theta + 1e-13, -2.0, 5.0, periodic).is_uniform
    assert not Samples.chebyshev(0.0, 1.0, 5).is_uniform


def test_what_lies_in_a_range() -> None:
    theta = np.array([-1e9, 0.5 - 1e-12, 0.5, 1.0, 2.5, 2.5 + 1e-12, 1e9])
    limited, periodic = Samples.uniform(0.5, 2.5, 4, False), Samples.uniform(0.5, 2.5, 4, True)
    np.testing.assert_array_equal(limited.contains(theta), [False, False, True, True, True, False, False])
    np.testing.assert_array_equal(periodic.contains(theta), True)
    for value, inside in zip(theta, limited.contains(theta)):
        assert limited.contains(float(value)) == inside
        assert periodic.contains(float(value))


def test_a_place_is_told_within_the_coordinates_range() -> None:
    """Bases that come back with other signs are tabulated over two turns, which the scene does not know of."""
    two = Samples.uniform(-1.0, 2.0 * np.pi - 1.0, 16, periodic=True).over_two_turns()
    assert (two.n, two.turns) == (32, 2) and two.is_uniform
    assert two.in_first_turn(10.8) == pytest.approx(10.8 - 2.0 * np.pi) and two.in_first_turn(-0.5) == -0.5
    limited = Samples.uniform(0.0, 9.0, 4, periodic=False)
    assert limited.turns == 1 and limited.in_first_turn(8.0) == 8.0


#: A head that belts move along a bridge and with it: the belts' vibrations cross the bridge's.
_GANTRY = HEADER + tables("""
bodies.bridge: line = { length = 0.5, elements = 8, start = -0.25 }; element = "beam2d"; material = "steel";
    section = { shape = "circle", radius = 0.008 }
bodies.head: rigid = { mass = 0.3, inertia = 1e-4, points = { c = [0.0, 0.0], nozzle = [0.0, -0.03] } }
bodies.motor1: rigid = { mass = 0.1, inertia = 5e-6, points = { hub = [0.0, 0.0] } };
    placement = { origin = [-0.3, 0.5] }
bodies.motor2: rigid = { mass = 0.1, inertia = 5e-6, points = { hub = [0.0, 0.0] } };
    placement = { origin = [0.3, 0.5] }
ground.points: left = [-0.3, 0.5]; right = [0.3, 0.5]
joints.y: type = "prismatic"; connect = ["ground:origin", "bridge:middle"]; axis = [0.0, 1.0]
joints.x: type = "prismatic"; connect = ["bridge:middle", "head:c"]; axis = [1.0, 0.0]
joints.m1: type = "revolute"; connect = ["ground:left", "motor1:hub"]
joints.m2: type = "revolute"; connect = ["ground:right", "motor2:hub"]
joints.belt1: type = "coupling"; terms = { x = 1.0, y = 1.0, m1 = -0.0064 }; elastic = { stiffness = 4e4 }
joints.belt2: type = "coupling"; terms = { x = 1.0, y = -1.0, m2 = -0.0064 }; elastic = { stiffness = 4e4 }
coordinates.x: joint = "x"; range = [-0.2, 0.2]
coordinates.y: joint = "y"; range = [-0.2, 0.2]
reduction: angles = 5
""")


@pytest.mark.parametrize("drawn", (False, True))
def test_fewer_modes_are_taken_where_the_default_cannot_be_followed(drawn: bool) -> None:
    """The number is said, and the file is that of the scene; a number that is given is refused with one that can. So
    where a length has a distribution."""
    toml = _GANTRY
    if drawn:
        law = '{ name = "uniform", loc = 0.49, scale = 0.02 }'
        toml += f"length_points = 2\n[parameters.span]\nnominal = 0.5\ndistribution = {law}\n"
        toml = toml.replace("length = 0.5, elements = 8, start = -0.25", 'length = "span", elements = 8, start = -0.25')
    scene, asked = (scene_from_toml(toml, ".", changes) for changes in ((), ["reduction.modes=15"]))
    fewer, found = built_rom(scene_from_toml(toml, ".", ["reduction.modes=14"])), built_rom(scene)
    np.testing.assert_array_equal(found.frequencies_hz, fewer.frequencies_hz)
    np.testing.assert_array_equal(found.tables.stiffness, fewer.tables.stiffness)
    assert found.record.scene_toml == scene_to_toml(scene)
    (said,) = (remark.text for remark in found.record.remarks if remark not in fewer.record.remarks)
    assert said.startswith("reduction.modes = 14 were taken: the 15 of a scene that gives no number cannot be followed")
    with pytest.raises(RunError, match="with reduction.modes = 14 they can, where no static answers"):
        built_rom(asked)
