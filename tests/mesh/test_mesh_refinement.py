"""Uniform refinement: same shape, same names, cells in equal parts."""

import numpy as np
import pytest

from pgmp_petsc.mesh import LineMesh
from pgmp_petsc.mesh.line_mesh import refined

BENT = LineMesh(
    np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 3.0]]), np.array([[0, 1], [2, 1]]), {"hinge": 0, "tip": 2}, {"both": 2}
)


@pytest.mark.parametrize("parts", [2, 3, 8])
def test_every_cell_is_cut_into_equal_parts(parts: int) -> None:
    fine = refined(BENT, parts)
    assert (fine.n_cells, fine.n_nodes) == (2 * parts, 3 + 2 * (parts - 1))
    np.testing.assert_allclose(fine.lengths, np.repeat([1.0, 3.0], parts) / parts, rtol=1e-14)
    # every node but the ends of the chain is on two cells
    assert sorted(np.bincount(fine.cells.ravel()))[:3] == [1, 1, 2]


def test_directions_of_cells_stay() -> None:
    fine = refined(BENT, 4)
    steps = np.diff(fine.nodes[fine.cells], axis=1)[:, 0]
    np.testing.assert_allclose(steps[:4], np.tile([0.25, 0.0], (4, 1)))
    np.testing.assert_allclose(steps[4:], np.tile([0.0, -0.75], (4, 1)))


def test_old_nodes_keep_their_numbers_and_names() -> None:
    fine = refined(BENT, 5)
    np.testing.assert_array_equal(fine.nodes[:3], BENT.nodes)
    assert fine.points == BENT.points and fine.groups == BENT.groups
    assert fine.point("2", "joints.elbow.connect") == 2


def test_one_part_is_the_mesh_itself() -> None:
    assert refined(BENT, 1) is BENT
    with pytest.raises(ValueError, match="at least 1"):
        refined(BENT, 0)


def test_refining_twice_is_refining_at_once() -> None:
    twice, once = refined(refined(BENT, 2), 2), refined(BENT, 4)
    np.testing.assert_allclose(np.sort(twice.nodes, axis=0), np.sort(once.nodes, axis=0), atol=1e-15)
