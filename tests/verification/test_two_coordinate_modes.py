"""Modes of mechanisms with two coordinates, and of clamped ones, against dense eigenproblems."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI
from scipy.linalg import eigh, null_space
from two_coordinates import double_pendulum, five_bar

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.mechanism.body_frames import constraint_jacobian
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.modes.problem import ModalProblem
from pgmp_petsc.scene import Scene
from scenes import mechanism_of, pendulum, slider_crank

CONFIGURATIONS = np.array([[0.0, 0.0], [0.3, 1.7], [4.0, -2.5], [2.0, np.pi]])


def driven(scene: Scene, *prescribed: str) -> Mechanism:
    """Return the mechanism of a scene with some coordinates prescribed."""
    mechanism = mechanism_of(scene)
    coordinates = (replace(c, prescribed=c.name in prescribed) for c in mechanism.coordinates)
    return replace(mechanism, coordinates=tuple(coordinates))


@contextmanager
def problem_of(mechanism: Mechanism, scene: Scene, n_modes: int) -> Iterator[ModalProblem]:
    with ModalProblem(RigidKinematics(mechanism), scene.nominal, n_modes, MPI.COMM_SELF) as problem:
        yield problem


def dense(problem: ModalProblem, theta: np.ndarray) -> np.ndarray:
    """Return the eigenvalues of the constrained eigenproblem by dense algebra."""
    mechanism = problem.mechanism
    pose = problem.kinematics.poses(theta)[..., 0]
    rows = [constraint_jacobian(mechanism, pose).toarray()]
    for coordinate in mechanism.coordinates:
        if coordinate.prescribed:
            row = np.zeros((1, mechanism.n_dofs))
            for sign, side in ((-1.0, coordinate.connection.a), (1.0, coordinate.connection.b)):
                if not side.on_ground:
                    row[0, 3 * side.node + 2] = sign
            rows.append(row)
    n = null_space(np.concatenate(rows))
    eye = np.eye(mechanism.n_dofs)
    mass, stiffness = (
        problem.times_mass(eye),
        sum(weight.evaluate(problem.values) * term.toarray() for weight, term in problem.matrices.stiffness.items()),
    )
    return eigh(n.T @ stiffness @ n, n.T @ mass @ n, eigvals_only=True)


@pytest.mark.parametrize("prescribed", [(), ("theta1",), ("theta2",), ("theta1", "theta2")])
@pytest.mark.parametrize("name", ["double_pendulum", "five_bar"])
def test_modes_are_those_of_a_dense_eigenproblem(name: str, prescribed: tuple[str, ...]) -> None:
    scene = {"double_pendulum": double_pendulum, "five_bar": five_bar}[name]()
    with problem_of(driven(scene, *prescribed), scene, 4) as problem:
        n_free = 2 - len(prescribed)
        assert problem.free.tolist() == [k for k, c in enumerate(("theta1", "theta2")) if c not in prescribed]
        for theta in CONFIGURATIONS:
            modes = problem.solve(theta)
            exact = dense(problem, theta)
            assert np.all(np.abs(exact[:n_free]) < 1e-7 * exact[n_free])
            # the dense solver's round-off is that of its largest eigenvalue
            np.testing.assert_allclose(modes.eigenvalues, exact[n_free : n_free + 4], rtol=1e-9, atol=1e-14 * exact[-1])
            assert modes.rigid.shape[1] == 2 and modes.rigid_curvature.shape[1:] == (2, 2)
            free = modes.rigid[:, problem.free]
            m_flexible = problem.times_mass(modes.flexible)
            np.testing.assert_allclose(modes.flexible.T @ m_flexible, np.eye(4), rtol=0, atol=1e-10)
            np.testing.assert_allclose(free.T @ m_flexible, 0.0, rtol=0, atol=1e-10)


@pytest.mark.parametrize("prescribed", [("theta1",), ("theta2",), ("theta1", "theta2")])
def test_a_flexible_vector_turns_no_driven_joint(prescribed: tuple[str, ...]) -> None:
    scene = double_pendulum()
    with problem_of(driven(scene, *prescribed), scene, 4) as problem:
        modes = problem.solve(np.array([0.3, 1.7]))
        for k, coordinate in enumerate(problem.kinematics.coordinates):
            sides = ((-1.0, coordinate.connection.a), (1.0, coordinate.connection.b))
            columns = np.hstack([modes.rigid, modes.flexible])
            turn = sum(sign * columns[3 * side.node + 2] for sign, side in sides if not side.on_ground)
            np.testing.assert_allclose(turn[:2], np.eye(2)[k], rtol=0, atol=1e-12)
            turns = np.abs(turn[2:]).max()
            assert turns < 1e-12 if coordinate.prescribed else turns > 1e-2
        # the driven motion shakes the flexible vectors
        coupling = modes.rigid.T @ problem.times_mass(modes.flexible)
        for k in range(2):
            assert (np.abs(coupling[k]).max() < 1e-12) == (k in problem.free)


def test_static_answers_of_a_mechanism_that_is_driven_altogether() -> None:
    scene = slider_crank("reduction.modes=4")
    with problem_of(driven(scene, "theta"), scene, 4) as problem:
        modes = problem.solve(0.9)
        assert modes.free.size == 0 and modes.eigenvectors.shape[1] == 4
        load = problem.times_mass(modes.rigid)
        answer = problem.static_answers(modes.eigenvectors, load)
        # K x = f up to the constraints and what is deflated, so x^T K x = x^T f
        stiffness = sum(w.evaluate(problem.values) * term for w, term in problem.matrices.stiffness.items())
        energy = (answer.T @ (stiffness @ answer)).item()
        assert energy == pytest.approx((answer.T @ load).item(), rel=1e-8) and energy > 0.0
        np.testing.assert_allclose(modes.flexible.T @ problem.times_mass(answer), 0.0, rtol=0, atol=1e-12)


def test_a_torque_on_a_driven_joint_has_no_static_answer() -> None:
    scene = slider_crank("reduction.modes=4")
    with problem_of(driven(scene, "theta"), scene, 4) as problem:
        node = problem.mechanism.attachment("crank:hinge", "test").node
        loads = np.zeros((problem.mechanism.n_dofs, 2))
        loads[3 * node + 2, 0] = loads[3 * node + 5, 1] = 2.0
        assert problem.independent(loads).shape[1] == 1


def test_more_modes_than_a_driven_mesh_has() -> None:
    scene = pendulum("reduction.modes=31")
    with (
        problem_of(driven(scene, "phi"), scene, 31) as problem,
        pytest.raises(InputError, match="the mesh has only 30 flexible modes"),
    ):
        problem.keep(scene.reduction)
