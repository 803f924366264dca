"""A scaled cross-section against the mesh that has it: exact terms, condensed matrices, and groups that cannot be
scaled."""

from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache

import numpy as np
import petsc4py
import pytest
from scipy.linalg import eigh
from scipy.sparse.linalg import splu
from solids import rod

petsc4py.init([])

from mpi4py import MPI  # noqa: E402

from pgmp_petsc.base.errors import InputError  # noqa: E402
from pgmp_petsc.bodies.affine import Monomial, Quantity, total_at  # noqa: E402
from pgmp_petsc.bodies.component import Component, linear_fields  # noqa: E402
from pgmp_petsc.bodies.framed_solid import FramedSolid, _check_section  # noqa: E402
from pgmp_petsc.bodies.matrices import weighted_sum  # noqa: E402
from pgmp_petsc.bodies.profile import SectionScale  # noqa: E402
from pgmp_petsc.bodies.solid import FaceFrame  # noqa: E402
from pgmp_petsc.components.component_modes import condense  # noqa: E402
from pgmp_petsc.mesh.meshes import reference_element  # noqa: E402

KINDS, N_MODES = ("quad8", "hexahedron20"), 6
SERVED = (1.0, 0.6, 0.8, 1.2, 1.4)  # as of a distribution: nominal, outermost and half-way
TRIED = (0.65, 1.33)


def centred(kind: str) -> FramedSolid:
    """Return a rod about the x axis whose cross-section a parameter scales, of which its mesh has 1."""
    solid, _, _ = rod(kind)
    mesh = solid.mesh
    shift = np.array([0.0, *(-0.5 * np.ptp(mesh.nodes, axis=0)[1:])])
    mesh = replace(mesh, nodes=mesh.nodes + shift)
    face_kind = reference_element(kind).face_kind
    frames = {name: FaceFrame.of(mesh.nodes, mesh.groups[name], face_kind) for name in ("left", "right")}
    scaled = replace(solid, mesh=mesh, section_scale=SectionScale(Quantity.of("s")))
    return FramedSolid(scaled, frames)


@lru_cache
def condensed(kind: str) -> Component:
    body = centred(kind)
    return condense(body.solid, body.frames, [{"s": s} for s in SERVED], N_MODES, MPI.COMM_SELF)[0]


def small(component: Component, values: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
    return total_at(component.stiffness, values), total_at(component.mass, values)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("s", [0.3, 1.0, 2.5])
def test_the_terms_are_those_of_the_scaled_mesh(kind: str, s: float) -> None:
    body = centred(kind)
    other, nodes = body.at({"s": s}).solid, range(body.solid.mesh.n_nodes)
    power = [str(weight) for weight in sorted(body.solid.weights("stiffness"))]
    assert power == ["1", "s", "s^2"] and body.solid.weights("mass") == {Monomial((("s", 2),))}
    for name in ("stiffness", "mass"):
        terms, alone = getattr(body.solid, name)(nodes), getattr(other, name)(nodes)
        assert set(terms) == body.solid.weights(name) and other.weights(name) == {Monomial()}
        expected = alone[Monomial()]
        found = weighted_sum(terms, {"s": s})
        assert abs(found - expected).max() < 1e-13 * abs(expected).max()


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("s", TRIED)
def test_the_condensed_body_is_that_of_the_scaled_mesh(kind: str, s: float) -> None:
    """Eigenvalues and compliances between the values that the subspace was made for; the mesh's own are exact."""
    body = centred(kind).at({"s": s})
    stiffness, mass = small(condensed(kind), {"s": s})
    alone, _ = condense(body.solid, body.frames, [{}], N_MODES, MPI.COMM_SELF)
    n_rigid = 3 if kind == "quad8" else 6
    chosen = slice(n_rigid, n_rigid + N_MODES)
    expected, found = (eigh(k, m, eigvals_only=True) for k, m in (small(alone, {}), (stiffness, mass)))
    np.testing.assert_allclose(found[chosen], expected[chosen], rtol=1e-8)
    assert np.abs(found[:n_rigid]).max() < 1e-9 * expected[n_rigid]
    n_nodes, d = body.solid.mesh.n_nodes, body.solid.mesh.dimension
    value = 0.7 * expected[n_rigid]
    full_k, full_m = (terms(range(n_nodes))[Monomial()] for terms in (body.solid.stiffness, body.solid.mass))
    means = np.vstack([frame.functionals(n_nodes).toarray() for frame in body.frames.values()])
    full = means @ splu((full_k - value * full_m).tocsc()).solve(means.T)
    reduced = np.linalg.inv(stiffness - value * mass)[: len(full), : len(full)]
    sizes = np.sqrt(np.abs(np.outer(np.diag(full), np.diag(full))))
    assert np.max(np.abs(reduced - full) / sizes) < 1e-8
    # the same coordinates hold the linear fields of every scale
    fields = linear_fields(body.solid.mesh.nodes)
    momenta = fields.T @ (full_m @ fields)
    constant = condensed(kind).fields
    np.testing.assert_allclose(constant.T @ mass @ constant, momenta, rtol=1e-9, atol=1e-12 * np.abs(momenta).max())
    np.testing.assert_allclose(constant[: len(full)], means @ fields, atol=1e-9)
    assert np.abs(stiffness @ constant[:, :d]).max() < 1e-8 * np.abs(stiffness).max()


def test_a_scaled_body_moves_as_a_rigid_one_at_every_scale() -> None:
    """No rigid motion strains it, to the last bit of its largest entry, and its mass is that of the scaled section."""
    for kind in KINDS:
        component, d = condensed(kind), 2 if kind == "quad8" else 3
        assert {str(weight) for weight in component.stiffness} == {"1", "s", "s^2", "s^3", "s^4"}
        assert {str(weight) for weight in component.mass} == {"s^2", "s^3", "s^4"}
        fields = component.fields
        spins = [fields[:, d * (1 + i) + j] - fields[:, d * (1 + j) + i] for i in range(d) for j in range(i)]
        rigid = np.column_stack([fields[:, :d], *spins])
        for matrix in component.stiffness.values():
            assert np.abs(matrix @ rigid).max() < 1e-14 * np.abs(matrix).max() * np.abs(rigid).max() * len(matrix)
        assert component.extent == pytest.approx(0.6, rel=1e-9)
        section = 0.06 if d == 2 else 0.06 * 0.04
        for s in TRIED:
            _, mass = small(component, {"s": s})
            assert rigid[:, 0] @ mass @ rigid[:, 0] == pytest.approx(7800.0 * 0.6 * section * s**2, rel=1e-12)


@pytest.mark.parametrize(
    "point, move, message",
    [
        ("left", (0.0, 0.02, 0.0), r'body.section_scale: the faces of "left" have their centre 0.0333 of the extent'),
        ("top", (0.0, 0.0, -0.02), r'the faces of "top" extend over 1 of the mesh along its x axis'),
    ],
)
def test_groups_that_are_no_sections_are_refused(point: str, move: tuple[float, ...], message: str) -> None:
    mesh = centred("hexahedron20").solid.mesh
    moved = replace(mesh, nodes=mesh.nodes + np.array(move))
    frame = FaceFrame.of(moved.nodes, moved.groups[point], reference_element(mesh.kind).face_kind)
    with pytest.raises(InputError, match=message):
        _check_section("bodies.body.section_scale", moved, point, frame)
