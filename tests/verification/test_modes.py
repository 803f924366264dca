"""Modes of mechanisms, with one coordinate and two, driven ones too: frequencies, solvers, and what is noticed."""

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
import scipy.sparse as sp
from pencils import constraints_at, dense_of, dense_pencil, modal_problem
from petsc4py import PETSc
from refusals import refusal
from two_coordinates import double_pendulum, five_bar

from pgmp_petsc.base.errors import InputError, RunError
from pgmp_petsc.mechanism.constraint_set import null_space
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.mesh import LineMesh
from pgmp_petsc.modes import problem as problem_module
from pgmp_petsc.modes.pencils import DensePencil, SparsePencil
from pgmp_petsc.modes.problem import ModalProblem
from pgmp_petsc.scene import Scene
from pgmp_petsc.solvers.shift_invert import ShiftInvertSolver
from scenes import RADIUS, four_bar, kinematics_of, mechanism_of, pendulum, slider_crank, trammel

VALUES = {"r1": RADIUS}
# Independent full-order reference of the paper's slider-crank, 5 elements a body, r1 = 5.6 mm (slider_crank_5el.json of
# the project's reference data: explicit Runge-Kutta code on the constraint-eliminated equations, checked against a
# second code); Hz
REFERENCE_HZ = {
    0.0: [64.0669736526, 238.871521006, 356.890061625, 750.444260939, 1299.71476299, 1373.69562087],
    np.pi / 2: [52.4629361603, 229.164262909, 278.2741278, 699.848741912, 1247.10614961, 2109.54195867],
}


def petsc_matrix(dense: np.ndarray) -> object:
    """Return a sequential sparse matrix that stores every entry."""
    n = len(dense)
    starts, columns = np.arange(0, n * n + 1, n), np.tile(np.arange(n), n)
    csr = (starts.astype(PETSc.IntType), columns.astype(PETSc.IntType), dense.ravel())
    matrix = PETSc.Mat().createAIJ((n, n), csr=csr, comm=PETSc.COMM_SELF)
    matrix.assemble()
    return matrix


@pytest.fixture
def options() -> Iterator[object]:
    """Return PETSc's options, and take the test's own away again."""
    before = PETSc.Options().getAll()
    yield PETSc.Options()
    for name in set(PETSc.Options().getAll()) - set(before):
        PETSc.Options().delValue(name)


@pytest.fixture
def pencil() -> tuple[object, object, np.ndarray]:
    """Return a random pencil of 40 unknowns with one zero eigenvalue, and its eigenvalues."""
    random = np.random.default_rng(0)
    mass = random.normal(size=(40, 40))
    mass = mass @ mass.T + 40 * np.eye(40)
    half = random.normal(size=(40, 39))
    stiffness = half @ half.T
    return petsc_matrix(stiffness), petsc_matrix(mass), scipy.linalg.eigvalsh(stiffness, mass)


@pytest.fixture
def solver() -> Iterator[ShiftInvertSolver]:
    solver = ShiftInvertSolver(PETSc.COMM_SELF, -1e-3, "pgmp_modes_")
    yield solver
    solver.close()


@pytest.mark.parametrize("theta", REFERENCE_HZ)
def test_the_frequencies_of_the_independent_reference(theta: float) -> None:
    with modal_problem(kinematics_of(slider_crank()), VALUES, 6) as problem:
        # the reference has 8 digits or more
        np.testing.assert_allclose(problem.solve(theta).frequencies_hz, REFERENCE_HZ[theta], rtol=1e-6)


def test_the_bands_of_the_paper_over_a_revolution() -> None:
    # f2 to f5 over a revolution, as an independent full-order code gives them to the digits shown
    bands = [(49.0, 64.1), (229.2, 238.9), (277.0, 357.0), (694.4, 750.4)]
    with modal_problem(kinematics_of(slider_crank()), VALUES, 4) as problem:
        frequencies = np.array([problem.solve(theta).frequencies_hz for theta in np.linspace(0.0, 2 * np.pi, 73)])
    for mode, (low, high) in enumerate(bands):
        assert frequencies[:, mode].min() == pytest.approx(low, abs=0.6)
        assert frequencies[:, mode].max() == pytest.approx(high, abs=0.6)


@pytest.fixture(params=["LAPACK", "SLEPc"])
def solved_by(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """Solve small problems with either; the name of which."""
    if request.param == "SLEPc":
        monkeypatch.setattr(problem_module, "MOST_UNKNOWNS", 0)
    return request.param


def test_counting_by_inertia_agrees_at_all_configurations(solved_by: str) -> None:
    """The pattern of N changes with the configuration, and what is kept from one to the next must not count."""
    kinematics = kinematics_of(slider_crank())
    with modal_problem(kinematics, VALUES, 5) as problem:
        for theta in (0.0, 0.7, np.pi / 2, np.pi, 4.0, 0.0):
            problem.solve(theta)
            exact = scipy.linalg.eigvalsh(*dense_pencil(kinematics, theta, VALUES))
            for k in range(2, 16):
                tau = 0.5 * (exact[k - 1] + exact[k])
                assert problem._pencil.count_below(tau) == k


@pytest.mark.parametrize("n_modes", [1, 4, 9, 15])
def test_any_number_of_modes_is_found_at_all_configurations(n_modes: int, solved_by: str) -> None:
    kinematics = kinematics_of(slider_crank())
    with modal_problem(kinematics, VALUES, n_modes) as problem:
        assert isinstance(problem._pencil, DensePencil if solved_by == "LAPACK" else SparsePencil)
        for theta in np.arange(12) * np.pi / 6:
            exact = scipy.linalg.eigvalsh(*dense_pencil(kinematics, theta, VALUES))[1 : 1 + n_modes]
            np.testing.assert_allclose(problem.solve(theta).eigenvalues, exact, rtol=1e-7)  # the exact ones' own error


def rotor(n_blades: int, n_cells: int) -> RigidKinematics:
    """Return a hub with equal blades: every mode in which their root moments cancel is (n_blades - 1)-fold."""
    angles = 0.1 + 2 * np.pi / n_blades * np.arange(n_blades)
    radii = np.arange(1, n_cells + 1) / n_cells
    blades = [radii[:, None] * [np.cos(angle), np.sin(angle)] for angle in angles]
    cells = [[0 if i == 0 else k * n_cells + i, k * n_cells + i + 1] for k in range(n_blades) for i in range(n_cells)]
    mesh = LineMesh(np.vstack([np.zeros((1, 2)), *blades]), np.array(cells), {"hinge": 0, "tip": n_cells})
    return RigidKinematics(Mechanism.from_scene(pendulum("bodies.arm.section.radius=5e-3"), {"arm": mesh}))


@pytest.mark.parametrize(("n_blades", "n_cells"), [(3, 4), (5, 8)])
def test_the_equal_frequencies_of_equal_blades_are_all_found(n_blades: int, n_cells: int) -> None:
    kinematics = rotor(n_blades, n_cells)
    exact = scipy.linalg.eigvalsh(*dense_pencil(kinematics, 0.3, VALUES))[1:]
    for n_modes in range(1, 13):
        with modal_problem(kinematics, VALUES, n_modes) as problem:
            np.testing.assert_allclose(problem.solve(0.3).eigenvalues, exact[:n_modes], rtol=1e-7)


@pytest.mark.parametrize(("scene", "prescribed"), [(slider_crank, ()), (pendulum, ("phi",))])
def test_more_modes_than_the_mesh_has_are_refused(scene: Callable[..., Scene], prescribed: tuple[str, ...]) -> None:
    with driven(scene(), 31, *prescribed) as problem:
        assert problem.n_modes == 30  # 12 nodes of 3 unknowns, less 5 constraints and the rigid motion
        assert refusal(problem.keep, scene("reduction.modes=31").reduction) == (
            "reduction.modes = 31: the mesh has only 30 flexible modes; take fewer modes or a finer mesh"
        )
    with driven(slider_crank(), 30) as problem:
        assert problem.solve(1.0).frequencies_hz.shape == (30,)


Pairs = tuple[np.ndarray, np.ndarray]


def fetched(change: Callable[[np.ndarray, np.ndarray], Pairs], monkeypatch: pytest.MonkeyPatch) -> None:
    """Change the eigenvalues and vectors that a solver finds."""
    fetch = ShiftInvertSolver._fetch
    monkeypatch.setattr(ShiftInvertSolver, "_fetch", lambda *given: change(*fetch(*given)))


def test_a_missing_eigenvalue_is_noticed(pencil: tuple, solver: ShiftInvertSolver, monkeypatch) -> None:
    fetched(lambda values, vectors: (np.delete(values, 3), np.delete(vectors, 3, axis=1)), monkeypatch)
    message = refusal(solver.solve, *pencil[:2], 1, 5, "theta = 0.3 rad", error=RunError)
    assert message.startswith("eigenproblem at theta = 0.3 rad: ")
    below, found = (int(word) for word in message.split() if word.isdigit())
    assert below == found + 1
    assert "eps_ncv may help" in message


def test_a_large_residual_is_noticed(pencil: tuple, solver: ShiftInvertSolver, monkeypatch: pytest.MonkeyPatch) -> None:
    def spoilt(values: np.ndarray, vectors: np.ndarray) -> Pairs:
        vectors[:, 2] += 1e-3 * vectors[:, 3]
        return values, vectors

    fetched(spoilt, monkeypatch)
    with pytest.raises(RunError, match=r"at here: eigenvalue .* has the relative residual .*, above 1e-06; the mesh"):
        solver.solve(*pencil[:2], 1, 5, "here")


#: Options of the solver's prefix, what is raised of solving or of applying the factor, and its words.
FAILING = {
    "no convergence": (
        {"eps_tol": 1e-40, "eps_max_it": 2, "eps_ncv": 25},
        RunError, r"at here: \d+ of 6 eigenpairs converged in \d+ iterations \(reason -1\)",
    ),
    # read at the factorisation, which knows its prefix
    "refused by PETSc": (
        {"count_mat_mumps_icntl_14": "x"},
        InputError, "^PETSc options -pgmp_modes_count_mat_mumps_icntl_14 x: Input string x has no",
    ),
    "Krylov method stops early": (
        {"st_ksp_type": "cg", "st_ksp_max_it": 1, "st_pc_type": "none", "st_ksp_error_if_not_converged": 0},
        RunError, "with the shift -0.001: .*DIVERGED_ITS|stopped after 1 iterations with the resid",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", FAILING)
def test_what_a_solver_fails_of_is_said(pencil: tuple, options: object, name: str) -> None:
    given, kind, words = FAILING[name]
    for key, value in given.items():
        options[f"pgmp_modes_{key}"] = value
    solver = ShiftInvertSolver(PETSc.COMM_SELF, -1e-3, "pgmp_modes_")
    with pytest.raises(kind, match=words):
        if "st_ksp_type" in given:
            solver.factor(*pencil[:2])
            solver.apply_inverse(np.ones((40, 1)))
        else:
            solver.solve(*pencil[:2], 1, 5, "here")
    solver.close()


def test_the_cure_that_messages_name_has_an_effect(pencil: tuple, options: object) -> None:
    options["pgmp_modes_eps_ncv"] = 37
    solver = ShiftInvertSolver(PETSc.COMM_SELF, -1e-3, "pgmp_modes_")
    solver.solve(*pencil[:2], 1, 5, "here")
    assert solver._eps.getDimensions()[1] == 37
    solver.close()


def test_solvers_leave_the_options_alone_and_have_their_own(pencil: tuple, options: object) -> None:
    before = PETSc.Options().getAll()
    options["other_eps_tol"] = 1e-40  # of another problem
    solver = ShiftInvertSolver(PETSc.COMM_SELF, -1e-3, "pgmp_modes_")
    solver.solve(*pencil[:2], 1, 5, "here")
    solver.close()
    assert PETSc.Options().getAll() == before | {"other_eps_tol": "1e-40"}


def test_a_factor_of_a_singular_matrix_is_noticed(pencil: tuple) -> None:
    """Without a shift, and rows that are empty: nothing that comes out may be used."""
    empty = petsc_matrix(np.zeros((40, 40)))
    solver = ShiftInvertSolver(PETSc.COMM_SELF, 0.0, "pgmp_modes_")
    with pytest.raises(RunError, match="with the shift 0: "):
        solver.factor(empty, pencil[1])
        solver.apply_inverse(np.ones((40, 1)))
    solver.close()


def test_a_rigid_motion_that_is_none_is_noticed(solved_by: str, monkeypatch: pytest.MonkeyPatch) -> None:
    with modal_problem(kinematics_of(slider_crank()), VALUES, 3) as problem:
        true = problem_module.linear_motion
        monkeypatch.setattr(problem_module, "linear_motion", lambda *a: true(*a) + 0.01)
        with pytest.raises(RunError, match="the modes of frequency zero are not the mechanism's rigid motion"):
            problem.solve(1.0)


def test_a_mechanism_that_does_not_move_freely_is_noticed(solved_by: str) -> None:
    with modal_problem(kinematics_of(slider_crank()), VALUES, 3) as problem:
        stiffness = problem._sum(problem.matrices.stiffness)
        stiffness.setdiag(stiffness.diagonal() + 1.0)  # springs to the ground
        problem._pencil.set_stiffness(stiffness)
        with pytest.raises(RunError, match=r"at theta = 1 rad: 1 eigenvalues should vanish, but the largest is"):
            problem.solve(1.0)


@pytest.mark.parametrize("kept", ["rigid motion", "rigid motion and modes"])
def test_static_answers_are_those_of_the_whole_equations(kept: str, solved_by: str) -> None:
    """K x + C^T mu = f less inertia forces of what is deflated, C x = 0, x M-orthogonal to it: one linear system."""
    kinematics, theta = kinematics_of(slider_crank()), 0.7
    stiffness, mass = dense_of(kinematics.mechanism, VALUES)
    constraints = constraints_at(kinematics, theta)
    loads = np.random.default_rng(4).normal(size=(len(mass), 3))
    with modal_problem(kinematics, VALUES, 5) as problem:
        modes = problem.solve(theta)
        deflated = modes.rigid if kept == "rigid motion" else modes.eigenvectors
        answers = problem.static_answers(deflated, loads)
    border = np.hstack([constraints.T, mass @ deflated])
    n, m = border.shape
    whole = np.block([[stiffness, border], [border.T, np.zeros((m, m))]])
    scale = 1.0 / np.sqrt(np.abs(whole).max(axis=1))  # of stiffness and constraints, for round-off's sake
    right = np.vstack([loads, np.zeros((m, 3))])
    expected = (scale[:, None] * np.linalg.solve(scale[:, None] * whole * scale, scale[:, None] * right))[:n]
    np.testing.assert_allclose(answers, expected, rtol=0, atol=1e-8 * np.abs(expected).max())


def test_with_options_for_slepc_it_is_slepc_that_solves(options: object) -> None:
    options["pgmp_modes_eps_ncv"] = 25
    with modal_problem(kinematics_of(slider_crank()), VALUES, 3) as problem:
        assert isinstance(problem._pencil, SparsePencil)


DENSE = {
    "too few": ([1.0, 1.0, 0.0], [1.0, 2.0, 3.0], 3, 0.0, r": 2 of 3 eigenvalues are finite; the other unknowns have"),
    "below": ([1.0, 1.0, 1.0], [-1.0, 2.0, 3.0], 2, 0.0, " with the shift -0.5: the matrix is not positive"),
    "residual": ([1.0, 1.0, 1.0], [1.0, 2.0, 3.0], 2, 0.1, ": eigenvalue .* residual .*, above 1e-06; the mesh"),
}


@pytest.mark.parametrize("name", DENSE)
def test_what_a_dense_pencil_fails_of_is_said(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    mass, stiffness, n, off, words = DENSE[name]
    pencil = DensePencil(*(sp.csr_matrix(np.diag(part)) for part in (mass, stiffness)))
    pencil.move_to(null_space(sp.csr_matrix((0, 3))))
    pencil.shift_to(-0.5, "")
    if off:
        monkeypatch.setattr(pencil, "shifted_answers", lambda b: b + [[0.0, off], [0.0, 0.0], [off, 0.0]])
    elif stiffness[0] > 0.0:  # unknowns without mass are left out
        np.testing.assert_allclose(pencil.solve(0, 2, "here").values, [1.0, 2.0], rtol=1e-14)
    with pytest.raises(RunError, match=f"at here{words}"):
        pencil.solve(0, n, "here")


CONFIGURATIONS = np.array([[0.0, 0.0], [0.3, 1.7], [4.0, -2.5], [2.0, np.pi]])


def driven(scene: Scene, n_modes: int, *prescribed: str) -> ModalProblem:
    mechanism = mechanism_of(scene)
    coordinates = (replace(c, prescribed=c.name in prescribed) for c in mechanism.coordinates)
    kinematics = RigidKinematics(replace(mechanism, coordinates=tuple(coordinates)))
    return modal_problem(kinematics, scene.nominal, n_modes)


def dense(problem: ModalProblem, theta: np.ndarray) -> np.ndarray:
    """Return the eigenvalues of the constrained eigenproblem by dense algebra."""
    rows = [constraints_at(problem.kinematics, theta)]
    for coordinate in problem.mechanism.coordinates:
        if coordinate.prescribed:
            row = np.zeros((1, problem.mechanism.n_dofs))
            for sign, side in ((-1.0, coordinate.connection.a), (1.0, coordinate.connection.b)):
                if not side.on_ground:
                    row[0, 3 * side.node + 2] = sign
            rows.append(row)
    n = scipy.linalg.null_space(np.concatenate(rows))
    return scipy.linalg.eigvalsh(*(n.T @ part @ n for part in dense_of(problem.mechanism, problem.values)))


ANGLES = np.array([[0.0], [0.7], [np.pi / 2], [np.pi], [4.0]])
TWO = [(), ("theta1",), ("theta2",), ("theta1", "theta2")]
#: A scene, how many modes, and which coordinates are driven.
WHOLE = [
    (slider_crank, 15, ()), (four_bar, 8, ()), (trammel, 6, ()), (pendulum, 5, ()),
    *((scene, 4, prescribed) for scene in (double_pendulum, five_bar) for prescribed in TWO),
]  # fmt: skip


@pytest.mark.parametrize(("scene", "n_modes", "prescribed"), WHOLE)
def test_modes_are_those_of_a_dense_eigenproblem(
    scene: Callable[[], Scene], n_modes: int, prescribed: tuple[str, ...]
) -> None:
    with driven(scene(), n_modes, *prescribed) as problem:
        names = [coordinate.name for coordinate in problem.mechanism.coordinates]
        assert problem.free.tolist() == [k for k, name in enumerate(names) if name not in prescribed]
        n_free, stiffness = problem.free.size, problem._sum(problem.matrices.stiffness)
        for theta in ANGLES if len(names) == 1 else CONFIGURATIONS:
            modes, exact = problem.solve(theta), dense(problem, theta)
            # the dense solver's round-off is that of its largest eigenvalue
            assert np.all(np.abs(exact[:n_free]) < 1e-7 * exact[n_free] + 1e-14 * exact[-1])
            found = exact[n_free : n_free + n_modes]
            np.testing.assert_allclose(modes.eigenvalues, found, rtol=1e-9, atol=1e-14 * exact[-1])
            assert modes.rigid.shape[1] == len(names) and modes.rigid_curvature.shape[1:] == 2 * (len(names),)
            free, flexible = modes.rigid[:, problem.free], modes.flexible
            m_flexible = problem.times_mass(flexible)
            np.testing.assert_allclose(flexible.T @ m_flexible, np.eye(n_modes), rtol=0, atol=1e-9)
            size = np.sqrt(np.einsum("ij,ij->j", free, problem.times_mass(free)))
            np.testing.assert_allclose((free / size).T @ m_flexible, 0.0, rtol=0, atol=1e-12)
            np.testing.assert_allclose(constraints_at(problem.kinematics, theta) @ flexible, 0.0, rtol=0, atol=1e-11)
            projected, largest = flexible.T @ stiffness @ flexible, modes.eigenvalues[-1]
            np.testing.assert_allclose(projected, np.diag(modes.eigenvalues), rtol=1e-8, atol=1e-8 * largest)


@pytest.mark.parametrize("prescribed", [("theta1",), ("theta2",), ("theta1", "theta2")])
def test_a_flexible_vector_turns_no_driven_joint(prescribed: tuple[str, ...]) -> None:
    scene = double_pendulum()
    with driven(scene, 4, *prescribed) as problem:
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
    with driven(scene, 4, "theta") as problem:
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
    with driven(scene, 4, "theta") as problem:
        node = problem.mechanism.attachment("crank:hinge", "test").node
        loads = np.zeros((problem.mechanism.n_dofs, 2))
        loads[3 * node + 2, 0] = loads[3 * node + 5, 1] = 2.0
        assert problem.independent(loads).shape[1] == 1
