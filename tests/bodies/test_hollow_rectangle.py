"""The section `hollow_rectangle`: closed forms, torsion against finite differences, and a cantilever of it."""

from itertools import product

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.bodies.affine import Quantity
from pgmp_petsc.bodies.beam3d import section_axes
from pgmp_petsc.bodies.beam_strains import BeamStrains
from pgmp_petsc.bodies.kinds.beam import Beam
from pgmp_petsc.bodies.sections.hollow_rectangle import HollowRectangle
from pgmp_petsc.bodies.stresses import BeamLaw
from pgmp_petsc.mesh.line_mesh import straight_beam
from pgmp_petsc.scene.bodies import Material
from scenes import slider_crank

NU, YOUNG, RHO = 0.3, 2.1e11, 7800.0
STEEL = Material(E=YOUNG, nu=NU, rho=RHO)
SHEAR = YOUNG / (2.0 * (1.0 + NU))
B, H, T = 0.04, 0.06, 0.004
AREA = B * H - (B - 2 * T) * (H - 2 * T)
I_2, I_3 = ((b * h**3 - (b - 2 * T) * (h - 2 * T) ** 3) / 12 for b, h in ((H, B), (B, H)))


def tube(width: float | str = B, height: float | str = H, wall: float | str = T) -> HollowRectangle:
    return HollowRectangle(shape="hollow_rectangle", width=width, height=height, wall=wall)


def test_closed_forms() -> None:
    section = tube().coefficients(3, STEEL, {}, dict)
    axial, *sheared, _, about_2, about_3 = (float(part.at({})) for part in section.stiffness)
    np.testing.assert_allclose([axial, about_2, about_3], np.array([AREA, I_2, I_3]) * YOUNG, rtol=1e-14)
    np.testing.assert_allclose([float(part.at({})) for part in section.mass], np.array([AREA, I_2, I_3]) * RHO)
    assert 0.3 < sheared[1] / (SHEAR * AREA) < sheared[0] / (SHEAR * AREA) < 0.7
    flat = tube().coefficients(2, STEEL, {}, dict)
    np.testing.assert_allclose([float(part.at({})) for part in flat.stiffness], [axial, sheared[0], about_3])
    webs = tube(width=2.01e-6, height=0.06, wall=1e-6).sheared(NU, {}, dict)[0]  # two webs and hardly a flange
    assert float(webs.at({})) == pytest.approx(10 * (1 + NU) / (12 + 11 * NU) * 2.01e-6 * 0.06, rel=1e-2)


@pytest.mark.parametrize(("width", "height", "wall"), [(0.04, 0.04, 0.01), (0.04, 0.06, 0.004), (0.02, 0.08, 0.005)])
def test_torsion_is_that_of_prandtls_function(width: float, height: float, wall: float) -> None:
    found = float(tube(width, height, wall).torsion({}, dict).at({}))
    assert found == pytest.approx(by_differences(width, height, wall, 16), rel=3e-3)


def by_differences(width: float, height: float, wall: float, n: int) -> float:
    """Return the torsion constant: twice the integral of f, ``-laplace f = 2`` in the walls, 0 outside, of zero
    gradient in the hole; on a quarter, with n steps over a wall."""
    step = wall / n
    shape = round(0.5 * width / step) + 1, round(0.5 * height / step) + 1
    x, y = step * np.indices(shape)
    hole = (x < 0.5 * width - wall + 0.1 * step) & (y < 0.5 * height - wall + 0.1 * step)
    numbers, inner = np.arange(x.size).reshape(shape), np.ones(shape)
    inner[0], inner[:, 0] = 0.5 * inner[0], 0.5 * inner[:, 0]  # edges on the axes belong to two quarters
    pairs = [(numbers[:-1], numbers[1:], inner[-1]), (numbers[:, :-1], numbers[:, 1:], inner[:, -1:])]
    stiffness = sp.csr_matrix((x.size, x.size))
    for one, other, weights in pairs:
        one, other, weights = one.ravel(), other.ravel(), np.broadcast_to(weights, one.shape).ravel()
        entries = np.concatenate([weights, weights, -weights, -weights])
        rows, columns = np.concatenate([one, other, one, other]), np.concatenate([one, other, other, one])
        stiffness = stiffness + sp.csr_matrix((entries, (rows, columns)), shape=stiffness.shape)
    inside = np.ones(shape, dtype=bool)
    inside[-1], inside[:, -1] = False, False
    walls = (inside & ~hole).ravel()
    place = np.full(x.size, -1)
    place[walls], place[hole.ravel()] = np.arange(walls.sum()), walls.sum()
    kept = place >= 0
    tied = sp.csr_matrix((np.ones(kept.sum()), (np.flatnonzero(kept), place[kept])), shape=(x.size, walls.sum() + 1))
    areas = step**2 * inner.ravel()
    f = tied @ splu((tied.T @ stiffness @ tied).tocsc()).solve(tied.T @ (2.0 * areas))
    return float(4.0 * 2.0 * areas @ f)


@pytest.mark.parametrize("entries", [(B, H, "t"), ("b", H, "t"), ("b", "b", "t"), ("b", "h", "t")])
def test_parameters(entries: tuple[float | str, ...]) -> None:
    """Area and second moments are exact at all values, torsion and shear at the nominal ones, and near it elsewhere."""
    nominal = {"b": B, "h": H, "t": T}
    spans = {name: (0.9 * value, 1.1 * value) for name, value in nominal.items()}
    affine = tube(*entries).coefficients(3, STEEL, nominal, lambda: spans)
    for factors in product((0.9, 1.0, 1.07), repeat=3):
        values = {name: factor * value for factor, (name, value) in zip(factors, nominal.items())}
        numbers = tube(*(values.get(entry, entry) for entry in entries)).coefficients(3, STEEL, {}, dict)
        found, exact = (
            np.array([float(part.at(values)) for part in (*section.stiffness, *section.mass)])
            for section in (affine, numbers)
        )
        fitted = [1, 2, 3]
        np.testing.assert_allclose(np.delete(found, fitted), np.delete(exact, fitted), rtol=1e-11)
        np.testing.assert_allclose(found[fitted], exact[fitted], rtol=1e-11 if set(factors) == {1.0} else 6e-3)


def test_a_cantilever_has_the_deflection_and_the_stress_of_beam_theory() -> None:
    """``F L^3 / 3 E I + F L / k G A`` along the height at the tip, but for 1 / 4 n^2; ``F (L - x) h / 2 I``."""
    n, length, force = 40, 1.2, 100.0
    mesh, section = straight_beam(length, n, 0.0, 3), tube().coefficients(3, STEEL, {}, dict)
    axes = section_axes(np.diff(mesh.nodes[mesh.cells], axis=1)[:, 0], np.array([0.0, 1.0, 0.0]))
    body = Beam("beam", mesh, mesh, section=section, axes=axes)
    size = 6 * (n + 1)
    stiffness, loads, u = np.zeros((size, size)), np.zeros(size), np.zeros(size)
    for entries in body.of_elements("stiffness", np.arange(n)).values():
        for (one, _), entry in zip(mesh.cells, entries):
            stiffness[6 * one : 6 * one + 12, 6 * one : 6 * one + 12] += entry
    loads[-5] = force
    u[6:] = np.linalg.solve(stiffness[6:, 6:], loads[6:])
    expected = force * length**3 / (3 * YOUNG * I_3) + force * length / float(section.stiffness[1].at({}))
    assert u[-5] == pytest.approx(expected, rel=1.0 / (4 * n**2))
    points = BeamStrains.at_ends(body, (), np.array([0]))
    law = BeamLaw(Quantity(YOUNG), tube().reach, tube().round)
    found = law.values(["stress_max"], points, points.of_displacements(u.reshape(-1, 6, 1)), {})
    assert float(found["stress_max"].max()) == pytest.approx(force * length * 0.5 * H / I_3, rel=1e-9)


def test_walls_that_leave_no_hole_are_refused() -> None:
    given = 'bodies.rod.section={shape="hollow_rectangle", width=0.01, height=0.02, wall=0.005}'
    with pytest.raises(InputError, match=r"bodies\.rod\.section\.wall = 0\.005: must be below 0\.5 width = 0\.005"):
        slider_crank(given)
