"""Condensed bodies against their meshes: frequencies, rigid motion, linear fields, the interface's answers, ranks."""

from collections.abc import Callable, Mapping
from functools import lru_cache

import numpy as np
import petsc4py
import pytest
from conftest import SCRIPTS, run_mpi
from scipy.linalg import eigh
from scipy.sparse.linalg import eigsh, splu
from solids import body_of, matrices_of, mesh_of, rod

petsc4py.init([])

from mpi4py import MPI  # noqa: E402

from pgmp_petsc.base.errors import RunError  # noqa: E402
from pgmp_petsc.bodies.affine import Monomial, total_at  # noqa: E402
from pgmp_petsc.bodies.component import Component, linear_fields  # noqa: E402
from pgmp_petsc.bodies.matrices import weighted_sum  # noqa: E402
from pgmp_petsc.bodies.solid import FaceFrame  # noqa: E402
from pgmp_petsc.components import component_modes  # noqa: E402
from pgmp_petsc.components.component_modes import condense  # noqa: E402
from pgmp_petsc.mesh.meshes import reference_element  # noqa: E402

KINDS, LENGTHS, DENSITY, N_MODES = ("quad8", "hexahedron20"), (0.6, 0.06, 0.04), 7800.0, 6
OTHER = (1.3e11, 2.65e11)  # Pa, where the subspace of two materials was not made


@lru_cache
def condensed(kind: str, two_materials: bool = False) -> tuple[Component, np.ndarray]:
    solid, frames, points = rod(kind, two_materials)
    return condense(solid, frames, points, N_MODES, MPI.COMM_SELF)


class Both:
    """The matrices of a rod at some parameter values, on its mesh and condensed."""

    def __init__(self, kind: str, values: Mapping[str, float] | None = None) -> None:
        solid, frames, _ = rod(kind, values is not None)
        self.component, self.recovery = condensed(kind, values is not None)
        n_nodes, values = solid.mesh.n_nodes, values or {}
        self.places, self.d = solid.mesh.nodes, solid.mesh.dimension
        self.n_rigid = self.d * (self.d + 1) // 2
        self.stiffness = weighted_sum(solid.stiffness(range(n_nodes)), values)
        self.mass = weighted_sum(solid.mass(range(n_nodes)), values)
        self.means = np.vstack([frame.functionals(n_nodes).toarray() for frame in frames.values()])
        self.small_stiffness = total_at(self.component.stiffness, values)
        self.small_mass = total_at(self.component.mass, values)

    def eigenvalues(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the eigenvalues of the modes asked for, rigid ones first: of the mesh and condensed."""
        n = self.n_rigid + N_MODES
        full = np.sort(eigsh(self.stiffness, n, self.mass, sigma=-1e5, return_eigenvectors=False))
        return full, eigh(self.small_stiffness, self.small_mass, eigvals_only=True)[:n]

    def missed_compliance(self, value: float) -> float:
        """Return how far ``P (K - value M)^-1 P^T`` is off, over what its entries on the diagonal give each entry."""
        full = self.means @ splu((self.stiffness - value * self.mass).tocsc()).solve(self.means.T)
        n = len(full)
        found = np.linalg.inv(self.small_stiffness - value * self.small_mass)[:n, :n]
        size = np.sqrt(np.abs(np.outer(np.diag(full), np.diag(full))))
        return float(np.max(np.abs(found - full) / size))

    def rigid(self) -> np.ndarray:
        """Return the condensed rigid motions, shape (n, n_rigid)."""
        fields, d = self.component.fields, self.d
        spins = [fields[:, d * (1 + i) + j] - fields[:, d * (1 + j) + i] for i in range(d) for j in range(i)]
        return np.column_stack([fields[:, :d], *spins])


def between(values: np.ndarray) -> np.ndarray:
    """Return places below and between eigenvalues; the middles, where the subspace was tried, are not among them."""
    gaps = np.diff(values)
    return np.concatenate([[-values[0], 0.05 * values[0]], values[:-1] + 0.2 * gaps, values[:-1] + 0.7 * gaps])


@pytest.mark.parametrize("kind", KINDS)
def test_free_frequencies_are_those_of_the_mesh(kind: str) -> None:
    full, found = Both(kind).eigenvalues()
    n_rigid = full.size - N_MODES
    assert np.abs(found[:n_rigid]).max() < 1e-9 * found[n_rigid]
    # the subspace answers to 1e-10, an eigenvalue errs by no more, and round-off is 1e-16 of the largest one
    np.testing.assert_allclose(found[n_rigid:], full[n_rigid:], rtol=1e-8)


@pytest.mark.parametrize("kind", KINDS)
def test_the_condensed_matrices_are_those_of_the_mesh_for_the_recovered_displacements(kind: str) -> None:
    both = Both(kind)
    component, recovery = both.component, both.recovery
    n_frame = component.n_frame_dofs
    assert component.n_mesh_dofs == len(recovery) == both.places.size
    assert (component.n, component.n_internal) == (recovery.shape[1], recovery.shape[1] - n_frame)
    assert component.n < 0.3 * component.n_mesh_dofs
    assert 0.0 < component.error < component_modes.TOLERANCE
    assert component.extent == pytest.approx(LENGTHS[0], rel=1e-12)  # of a bar with the same radius of gyration
    np.testing.assert_array_equal(list(component.frames.items()), [("left", 0), ("right", 1)])
    middle = np.array(LENGTHS[1 : both.d]) / 2
    np.testing.assert_allclose(component.centres, [[0.0, *middle], [LENGTHS[0], *middle]], rtol=0, atol=1e-15)
    for matrix, small in ((both.mass, both.small_mass), (both.stiffness, both.small_stiffness)):
        # round-off of the products
        np.testing.assert_allclose(recovery.T @ (matrix @ recovery), small, rtol=0, atol=1e-12 * np.abs(small).max())
    # the first unknowns are the frames' own displacements, and internal coordinates do not move frames
    np.testing.assert_allclose(both.means @ recovery, np.eye(n_frame, component.n), rtol=0, atol=1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_linear_fields_have_the_mass_and_the_energy_of_a_box(kind: str) -> None:
    both = Both(kind)
    d, fields = both.d, both.component.fields
    np.testing.assert_allclose(both.recovery @ fields, linear_fields(both.places), rtol=0, atol=1e-13)
    lengths = np.array(LENGTHS[:d])
    mass = DENSITY * lengths.prod()
    first, second = mass * lengths / 2, mass * np.outer(lengths, lengths) / 4
    second[np.diag_indices(d)] = mass * lengths**2 / 3
    moments = np.block([[np.array([[mass]]), first[None]], [first[:, None], second]])
    order = [[i, *(d * (1 + i) + np.arange(d))] for i in range(d)]
    for i in range(d):
        for j in range(d):
            found = fields[:, order[i]].T @ both.small_mass @ fields[:, order[j]]
            expected = moments if i == j else np.zeros_like(moments)
            np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12 * mass)
    # the energy of a strain of 1 along x alone
    nu = 0.3
    modulus = 210e9 / (1 - nu**2) if d == 2 else 210e9 * (1 - nu) / ((1 + nu) * (1 - 2 * nu))
    stretch = fields[:, d]
    assert stretch @ both.small_stiffness @ stretch == pytest.approx(modulus * lengths.prod(), rel=1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_the_interface_answers_as_the_mesh_does_at_any_frequency(kind: str) -> None:
    both = Both(kind)
    values, _ = both.eigenvalues()
    elastic = values[both.n_rigid :]
    # 1e-10 is asked for where the subspace is tried
    assert max(both.missed_compliance(value) for value in between(elastic)) < 1e-8
    # 2 % from a resonance, the last one wanted among them, an answer is up to 50 times as large
    assert max(both.missed_compliance(0.98 * value) for value in elastic) < 1e-8


@pytest.mark.parametrize("modulus", OTHER)
@pytest.mark.parametrize("kind", KINDS)
def test_two_materials_at_parameter_values_between_those_served(kind: str, modulus: float) -> None:
    both = Both(kind, {"E": modulus})
    assert set(both.component.stiffness) == {Monomial((("E", 1),)), Monomial()}
    assert set(both.component.mass) == {Monomial()}
    full, found = both.eigenvalues()
    np.testing.assert_allclose(found[both.n_rigid :], full[both.n_rigid :], rtol=1e-8)
    rigid = both.rigid()
    for matrix in both.component.stiffness.values():
        np.testing.assert_allclose(matrix @ rigid, 0.0, rtol=0, atol=1e-13 * np.abs(matrix).max())
    assert max(both.missed_compliance(value) for value in between(full[both.n_rigid :])) < 1e-8


@pytest.mark.parametrize("kind", KINDS)
def test_modes_that_no_frame_feels_are_kept(kind: str) -> None:
    """The one frame has both ends of the rod, and does not move where they go apart, as in the first mode along it."""
    solid, frames, points = rod(kind)
    faces = np.vstack([solid.mesh.groups[name] for name in frames])
    frame = FaceFrame.of(solid.mesh.nodes, faces, reference_element(kind).face_kind)
    component, recovery = condense(solid, {"ends": frame}, points, 10, MPI.COMM_SELF)
    full, _ = Both(kind).eigenvalues()
    n_rigid = full.size - N_MODES
    found, modes = eigh(component.stiffness[Monomial()], component.mass[Monomial()])
    np.testing.assert_allclose(found[n_rigid : n_rigid + N_MODES], full[n_rigid:], rtol=1e-8)
    # sqrt(E / rho) / (2 L): the sides' contraction takes some thousandths off it
    along = np.argmin(np.abs(np.sqrt(np.abs(found)) / (2 * np.pi) - np.sqrt(210e9 / DENSITY) / (2 * LENGTHS[0])))
    assert n_rigid < along < n_rigid + 10
    moved = frame.functionals(solid.mesh.n_nodes) @ (recovery @ modes[:, along])
    assert np.abs(moved).max() < 1e-6 * np.abs(recovery @ modes[:, along]).max()


@pytest.mark.parametrize(("counts", "lengths", "n_modes"), [((1, 1), (0.3, 0.05), 50), ((6, 6), (0.1, 0.1), 25)])
def test_many_modes_settle_and_a_mesh_with_fewer_is_kept_whole(
    counts: tuple[int, int], lengths: tuple[float, float], n_modes: int
) -> None:
    """A square plate's highest eigenvalues are close: several values of lambda take rounds, together more than one of
    them may."""
    mesh = mesh_of("quad8", counts, lengths)
    frames = {name: FaceFrame.of(mesh.nodes, mesh.groups[name], "line3") for name in ("left", "right")}
    solid = body_of(mesh, 210e9, DENSITY)
    component, _ = condense(solid, frames, [{}], n_modes, MPI.COMM_SELF)
    assert component.n == component.n_mesh_dofs == 16 if counts == (1, 1) else component.n < component.n_mesh_dofs
    stiffness, mass = matrices_of(solid)
    full = eigh(stiffness.toarray(), mass.toarray(), eigvals_only=True)[3 : 3 + n_modes]
    found = eigh(component.stiffness[Monomial()], component.mass[Monomial()], eigvals_only=True)[3 : 3 + n_modes]
    np.testing.assert_allclose(found, full, rtol=1e-8 if n_modes == 25 else 1e-9)


def test_answers_that_do_not_settle_are_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(component_modes, "TOLERANCE", 1e-30)
    solid, frames, points = rod("quad8")
    with pytest.raises(RunError, match="bodies.body: the answers of its frames are still .* off with .* vectors"):
        condense(solid, frames, points, N_MODES, MPI.COMM_SELF)


@pytest.fixture(scope="module")
def on_ranks(tmp_path_factory: pytest.TempPathFactory) -> Callable:
    """Return a function that gives the arrays of a body condensed on n ranks."""
    directory = tmp_path_factory.mktemp("components")
    done = set()

    def read(kind: str, n: int) -> dict[str, np.ndarray]:
        if n not in done:
            run_mpi(n, SCRIPTS / "components.py", directory, *KINDS)
            done.add(n)
        with np.load(directory / f"{kind}_{n}.npz") as data:
            return dict(data)

    return read


def invariants(arrays: Mapping[str, np.ndarray], modulus: float, n_frame: int) -> dict[str, np.ndarray]:
    """Return what does not depend on the choice of internal coordinates."""
    mass, stiffness = arrays["mass_1"], arrays["stiffness_1"] + modulus * arrays["stiffness_E"]
    fields, probes = arrays["fields"], arrays["probes"]
    values, modes = eigh(stiffness, mass)
    n_rigid = fields.shape[1] // 2
    lowest, elastic = values[n_rigid], slice(n_rigid, n_rigid + N_MODES)
    shifted = stiffness + lowest * mass
    answers = np.linalg.solve(shifted, np.hstack([fields, np.eye(len(mass), n_frame)]))
    return {
        "eigenvalues": values[elastic] / lowest, "frames' mass": mass[:n_frame, :n_frame],
        "frames' stiffness": stiffness[:n_frame, :n_frame], "frames' shapes": arrays["recovery"][:, :n_frame],
        "fields' mass": fields.T @ mass @ fields, "fields' stiffness": fields.T @ stiffness @ fields,
        "fields' probes": probes.T @ fields, "probes of answers": lowest * probes.T @ answers,
        "probes of modes": np.abs(probes.T @ modes[:, elastic]),
    }  # fmt: skip


@pytest.mark.parametrize("n", [2, 3])
@pytest.mark.parametrize("kind", KINDS)
def test_a_component_does_not_depend_on_ranks_but_for_its_internal_coordinates(
    on_ranks: Callable, kind: str, n: int
) -> None:
    alone, shared = on_ranks(kind, 1), on_ranks(kind, n)
    component, _ = condensed(kind, True)
    n_frame = component.n_frame_dofs
    assert shared["difference"] == 0.0, "not the same on all ranks"
    assert component.n == len(alone["fields"]) == len(shared["fields"])
    for modulus in (2e11, 2.65e11):
        expected, found = (invariants(arrays, modulus, n_frame) for arrays in (alone, shared))
        for name, values in expected.items():
            # what the solver's tolerance of 1e-13 leaves of the modes, and round-off in the answers, 1e-10 at most
            np.testing.assert_allclose(found[name], values, rtol=0, atol=1e-8 * np.abs(values).max(), err_msg=name)
    # the directions added last are known to round-off over what was new in them, and so to 1e-5: no answer needs them
    products = [one["probes"].T @ np.linalg.solve(one["mass_1"], one["probes"]) for one in (alone, shared)]
    np.testing.assert_allclose(products[1], products[0], rtol=0, atol=1e-4 * np.abs(products[0]).max())
