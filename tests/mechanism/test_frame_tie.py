"""What ties frames to meshes: values at rest and in large rotation, and derivatives."""

from types import SimpleNamespace

import numpy as np
import pytest
from slopes import slopes
from solids import mesh_of

from pgmp_petsc.bodies.solid import FaceFrame
from pgmp_petsc.mechanism.constraint_set import FrameTies, bent_terms
from pgmp_petsc.mesh.meshes import reference_element

STEP, ATOL = 1e-6, 1e-8  # central differences: round-off of values of order 1 over the step, and the step's square
KIND = "quad8"
N_TIES = 3


def crooked(kind: str = KIND) -> tuple[np.ndarray, FaceFrame]:
    """Return the nodes of a bent rectangle and the frame of two of its sides."""
    mesh = mesh_of(kind, (3, 2), (0.8, 0.5))
    x, y = mesh.nodes.T
    places = np.column_stack([x + 0.3 * y**2 + 0.1, y - 0.4 * x * (0.8 - x) - 0.2])
    faces = np.vstack([mesh.groups["right"], mesh.groups["top"]])
    return places, FaceFrame.of(places, faces, reference_element(kind).face_kind)


def tie_of(places: np.ndarray, frame: FaceFrame) -> FrameTies:
    """Return the tie of a frame whose unknowns come before those of the nodes."""
    faces = {"faces": frame}
    body = SimpleNamespace(face_frames=faces, first_node=0, first_internal=N_TIES, blocks=lambda kind: ())
    n_dofs = N_TIES + places.size
    return FrameTies.of(
        SimpleNamespace(dimension=2, n_dofs=n_dofs, bodies=(body,), frame=lambda node: np.arange(N_TIES))
    )


def jacobian_of(tie: FrameTies, q: np.ndarray) -> np.ndarray:
    """Return the Jacobian from its entries, shape (3, n, ...)."""
    full = np.zeros((N_TIES, *q.shape))
    np.add.at(full, tie.jacobian_pattern, tie.jacobian_values(q))
    return full


def placed(places: np.ndarray, frame: FaceFrame, angle: float, shift: tuple[float, float]) -> np.ndarray:
    """Return the unknowns after a rigid motion, shape (3 + 2 n,)."""
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return np.concatenate([turn @ frame.centre + shift, [angle], (places @ turn.T + shift).ravel()])


def anywhere(n: int, *samples: int) -> np.ndarray:
    return np.random.default_rng(1).normal(0.0, 0.7, (n, *samples))


@pytest.fixture
def tie() -> FrameTies:
    return tie_of(*crooked())


@pytest.fixture
def n() -> int:
    return N_TIES + crooked()[0].size


def test_the_third_constraint_is_the_frame_s_angle_less_the_mean_rotation() -> None:
    """To first order in the deformation, whatever the angle of both."""
    places, frame = crooked()
    tie = tie_of(places, frame)
    for angle in (0.0, 1.9):
        for less in (1e-3, 1e-6):
            q = placed(places, frame, angle, (0.4, 0.2))
            q[2] += less
            assert tie.values(q)[2] == pytest.approx(np.sin(less), rel=1e-9)
        # a deformation of the nodes: the mean rotation of `FaceFrame`, turned along
        q, moved = placed(places, frame, angle, (0.0, 0.0)), np.random.default_rng(2).normal(0.0, 1e-3, places.shape)
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        q[N_TIES:] += (moved @ turn.T).ravel()
        # linear in the places of the nodes: round-off of the places over the size of the motion
        expected = -(frame.functionals(len(places)) @ moved.ravel())
        expected[:2] = turn @ expected[:2]
        np.testing.assert_allclose(tie.values(q), expected, rtol=0, atol=1e-13)


def test_the_jacobian_is_the_derivative_of_the_residual(tie: FrameTies, n: int) -> None:
    q = anywhere(n)
    np.testing.assert_allclose(jacobian_of(tie, q), slopes(tie.values, q, STEP), rtol=0, atol=ATOL)


def test_the_curvature_has_entries_in_the_row_and_the_column_of_phi_alone(tie: FrameTies) -> None:
    assert set(tie.curvature_pattern[1]) == {2} or set(tie.curvature_pattern[0]) == {2}


def test_the_drift_is_the_second_rate_of_the_residual_without_acceleration(tie: FrameTies, n: int) -> None:
    q, v = anywhere(n), np.random.default_rng(3).normal(size=n)
    steps = 1e-3 * np.arange(-2, 3)
    values = np.array([tie.values(q + step * v) for step in steps])
    second = np.array([-1.0, 16.0, -30.0, 16.0, -1.0]) @ values / (12 * steps[-2] ** 2)
    # fourth order: the step's fourth power, and round-off over its square
    np.testing.assert_allclose(tie.drift(q, v), second, rtol=0, atol=1e-8)
    assert abs(second[2]) > 0.1
    rate = (jacobian_of(tie, q + STEP * v) - jacobian_of(tie, q - STEP * v)) / (2 * STEP) @ v
    np.testing.assert_allclose(tie.drift(q, v), rate, rtol=0, atol=1e-7)


N_BENT, FIRST_ROW, N_ROWS = 3, 1, 6  # amplitudes, first row of the tie, rows of all ties


def bent_ties(d: int) -> tuple[FrameTies, np.ndarray, int]:
    """Return the tie of a frame whose unknowns come before three amplitudes, a, and the number of unknowns."""
    n_pose = 3 if d == 2 else 12
    bent = np.random.default_rng(0).normal(size=(d, N_BENT, N_BENT))
    bent += bent.swapaxes(1, 2)
    terms = bent_terms(d, FIRST_ROW, 0, n_pose + np.arange(N_BENT), bent)
    return FrameTies(terms, d, N_ROWS, n_pose + N_BENT), bent, n_pose + N_BENT


def dense(pattern: tuple[np.ndarray, np.ndarray], values: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    full = np.zeros(shape)
    np.add.at(full, pattern, values)
    return full


@pytest.mark.parametrize("d", [2, 3])
def test_derivatives_of_ties_of_second_order_are_those_of_differences(d: int) -> None:
    ties, _, n = bent_ties(d)
    rng, h = np.random.default_rng(2), 1e-6
    q, v = rng.normal(size=n), rng.normal(size=n)

    def jacobian(q: np.ndarray) -> np.ndarray:
        return dense(ties.jacobian_pattern, ties.jacobian_values(q[:, None])[:, 0], (N_ROWS, n))

    # central differences with h = 1e-6: round-off of numbers of order 10 over h, and h^2
    np.testing.assert_allclose(jacobian(q), slopes(lambda x: ties.values(x[:, None])[:, 0], q, h), rtol=0, atol=1e-7)
    curved = dense(ties.curvature_pattern, np.ones(ties.curvature_pattern[0].size), (n, n))
    bends = np.abs(slopes(jacobian, q, h)).max(axis=0)
    np.testing.assert_allclose(bends[curved + curved.T == 0.0], 0.0, rtol=0, atol=1e-7)
    drift = (jacobian(q + h * v) - jacobian(q - h * v)) @ v / (2 * h)
    np.testing.assert_allclose(ties.drift(q[:, None], v[:, None])[:, 0], drift, rtol=0, atol=1e-7)
