"""A continuum body from its scene: frames, materials of regions, shares of rows, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp
from solids import body_of, mesh_of, rod

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.bodies import solid as solid_module
from pgmp_petsc.bodies.affine import Monomial
from pgmp_petsc.bodies.framed_solid import FramedSolid
from pgmp_petsc.mesh import SolidMesh
from pgmp_petsc.scene.bodies import Body, Material

MATERIALS = {
    "steel": Material(E="E", nu=0.3, rho=7800.0), "brass": Material(E=1e11, nu=0.35, rho="rho"),
    "cork": Material(E=2e7, nu=0.0, rho=200.0),
}  # fmt: skip
POINTS = {"left": "joints.hinge.connect", "right": "outputs.tip.point"}


def plate(**lengths: float) -> SolidMesh:
    """Return a plate of 4 by 2 quads with overlapping regions: middle, right half and all cells."""
    mesh = mesh_of("quad", (4, 2), (lengths.get("x", 2.0), lengths.get("y", 1.0)))
    x = mesh.nodes[mesh.cells].mean(axis=1)[:, 0] / mesh.nodes[:, 0].max()
    parts = {"middle": np.flatnonzero(np.abs(x - 0.5) < 0.25), "end": np.flatnonzero(x > 0.5), "all": np.arange(8)}
    return replace(mesh, regions=parts)


def framed(mesh: SolidMesh, **regions: str) -> FramedSolid:
    entry = Body(mesh="none", element="solid2d", material="steel", thickness="t", regions=regions)
    return FramedSolid.of("plate", entry, MATERIALS, mesh, POINTS)


def test_every_cell_has_the_material_of_its_region() -> None:
    body = framed(plate(), end="brass")
    steel, brass = body.solid.regions
    assert sorted([*steel.cells, *brass.cells]) == list(range(8))
    np.testing.assert_array_equal(brass.cells, plate().regions["end"])
    assert (steel.nu, brass.nu) == (0.3, 0.35)
    e, t, rho = (Monomial(((name, 1),)) for name in ("E", "t", "rho"))
    assert (steel.modulus.monomial, steel.modulus.coefficient) == (e * t, 1.0)
    assert (brass.modulus.monomial, brass.modulus.coefficient) == (t, 1e11)
    assert body.solid.weights("stiffness") == {e * t, t}
    assert body.solid.weights("mass") == {t, rho * t}
    assert list(body.frames) == ["left", "right"]
    np.testing.assert_allclose(body.frames["right"].centre, [2.0, 0.5], rtol=1e-14)
    (only,) = framed(plate(), all="cork").solid.regions
    assert (only.cells.size, only.nu, only.modulus.coefficient) == (8, 0.0, 2e7)
    (empty,) = body_of(plate()).stiffness(range(3, 3)).values()
    assert empty.shape == (0, 30)


@pytest.mark.parametrize(
    ("mesh", "regions", "message"),
    [
        (plate(), {"middle": "brass", "end": "cork"}, "regions.end: 2 of its 4 cells are in region middle"),
        (plate(), {"nowhere": "brass"}, "bodies.plate.regions.nowhere"),
        (plate(y=1e-6), {}, r'hinge.connect = "left": its 2 faces have a radius of gyration of 1.44e-07 of the body'),
    ],
    ids=["overlapping regions", "unknown region", "too small a group"],
)
def test_bodies_that_are_refused(mesh: SolidMesh, regions: dict[str, str], message: str) -> None:
    with pytest.raises(InputError, match=message):
        framed(mesh, **regions)


@pytest.mark.parametrize("kind", ["triangle6", "hexahedron20"])
@pytest.mark.parametrize("n_shares", [2, 5])
def test_shares_of_rows_make_the_whole_matrix(kind: str, n_shares: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """However many elements are taken at once; all terms have one pattern, symmetric, with rows in order."""
    solid, _, _ = rod(kind, two_materials=True)
    n = solid.mesh.n_nodes
    for name in ("stiffness", "mass"):
        whole = getattr(solid, name)(range(n))
        with monkeypatch.context() as context:
            context.setattr(solid_module, "ENTRIES_AT_ONCE", 8000)
            ends = np.linspace(0, n, n_shares + 1).astype(int)
            shares = [getattr(solid, name)(range(first, last)) for first, last in zip(ends, ends[1:])]
        assert all(share.keys() == whole.keys() for share in shares)
        for weight, matrix in whole.items():
            parts = sp.vstack([share[weight] for share in shares]).tocsr()
            # sums in another order
            assert abs(parts - matrix).max() < 1e-14 * abs(matrix).max()
            assert abs(matrix - matrix.T).max() < 1e-14 * abs(matrix).max()
            np.testing.assert_array_equal(parts.indptr, matrix.indptr)
            np.testing.assert_array_equal(parts.indices, next(iter(whole.values())).indices)
