"""What is checked of assembled matrices where no file is needed: round-off that is allowed, and Lanczos' limits."""

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.sparse.linalg import ArpackNoConvergence
from solids import body_of, matrices_of, mesh_of

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.base.units import SI
from pgmp_petsc.bodies import assembled_reading
from pgmp_petsc.bodies.assembled import Assembled, MassProperties
from pgmp_petsc.bodies.assembled_reading import check_free, check_mass, check_places, check_stated, made_symmetric
from pgmp_petsc.scene.bodies import Stated

MESH = mesh_of("hexahedron", (40, 2, 2), (1.0, 0.02, 0.02))


def body(stiffness: sp.spmatrix | None = None, mass: sp.spmatrix | None = None) -> Assembled:
    k, m = matrices_of(body_of(MESH, 210e9, 7800.0))
    labels = np.arange(1, MESH.n_nodes + 1)
    return Assembled.of(
        MESH.nodes, labels, {}, None, k if stiffness is None else stiffness, m if mass is None else mass
    )


def test_a_slender_body_with_round_off_in_every_entry_is_free() -> None:
    stiffness = matrices_of(body_of(MESH, 210e9, 7800.0))[0]
    rough = stiffness.copy()
    rough.data *= 1.0 + 1e-15 * np.random.default_rng(1).standard_normal(rough.nnz)
    whole = made_symmetric(rough.tocoo(), np.arange(MESH.n_nodes), 3, "stiffness")
    check_free(body(whole), "stiffness")
    assert abs(whole - whole.T).max() == 0.0


@pytest.mark.parametrize("digits", [5, 8])
def test_digits_that_are_cut_off_are_told(digits: int) -> None:
    stiffness = matrices_of(body_of(MESH, 210e9, 7800.0))[0]
    stiffness.data = np.array([float(f"{value:.{digits - 1}e}") for value in stiffness.data])
    with pytest.raises(InputError, match="^stiffness: .*, (and )?with all (its|their) digits"):
        check_free(body(stiffness), "stiffness")


@pytest.mark.parametrize("away", [0.0, 1e3])
@pytest.mark.parametrize(
    ("axes", "words"), [((), "in one place"), ((0,), "on a line"), ((0, 1), "in a plane"), ((0, 1, 2), None)]
)
def test_nodes_have_to_span_space(axes: tuple[int, ...], words: str | None, away: float) -> None:
    nodes = np.zeros((20, 3))
    nodes[:, axes] = np.random.default_rng(1).standard_normal((20, len(axes)))
    turned = away + nodes @ np.linalg.qr(np.arange(9.0).reshape(3, 3) ** 2 + np.eye(3))[0]
    if words is None:
        check_places(turned, "nodes")
        return
    with pytest.raises(InputError, match=f"^nodes: all 20 nodes lie {words}; those of a solid3d body span space"):
        check_places(turned, "nodes")


def test_lumped_masses_are_positive() -> None:
    mass = matrices_of(body_of(MESH, 210e9, 7800.0))[1]
    lumped = sp.diags(np.asarray(mass.sum(axis=1)).ravel())
    assert MESH.n_nodes > assembled_reading.DENSE
    check_mass(body(mass=lumped), "mass")


def test_a_mass_that_lanczos_cannot_tell_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    def never(*arguments: object, **options: object) -> None:
        raise ArpackNoConvergence("none", np.zeros(0), np.zeros((0, 0)))

    monkeypatch.setattr(assembled_reading, "eigsh", never)
    with pytest.raises(InputError, match="^mass: whether it is positive definite cannot be told"):
        check_mass(body(), "mass")


def test_stated_properties_may_differ_by_their_share() -> None:
    found = MassProperties(2.0, np.array([0.5, 0.0, 0.0]), np.diag([0.3, 0.2, 0.1]))
    near = Stated(mass=2.001, centre=(0.5001, 0.0, 0.0), inertia=(0.3001, 0.4, 0.5), within=1e-3)
    check_stated(found, near, "stated", SI)
    for key, value in (("mass", 2.01), ("centre", (0.51, 0.0, 0.0)), ("inertia", (0.31, 0.4, 0.5))):
        with pytest.raises(InputError, match=rf"^stated\.{key} = .* differs by more than stated\.within = 0\.001"):
            check_stated(found, near.model_copy(update={key: value}), "stated", SI)
