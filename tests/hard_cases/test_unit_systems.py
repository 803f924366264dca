"""The same mechanism in metres, kilograms and newtons, and in millimetres, tonnes, newtons and megapascals."""

import numpy as np
import pytest
from mechanisms import GRAVITY, accurate, both, modal_problem, run_for, start
from runs import quick_return

from pgmp_petsc.scene import Scene
from scenes import kinematics_of

THOUSAND = 1e3  # mm in a metre
MATERIAL = ("materials.steel.E=210e3", "materials.steel.rho=7.8e-9")  # MPa, t/mm3
HEAVY = 'effects.weight={type="gravity", acceleration=9806.65}'  # mm/s2
MOVING = (*run_for(0.1, 1e-3), *start(0.3, 4.0))


def in_metres() -> dict[str, Scene]:
    """Return a slider-crank, and a quick-return whose line turns with a flexible body."""
    return {"slider_crank": accurate(GRAVITY, *MOVING, angles=48), "quick_return": turning(*MOVING)}


def turning(*overrides: str) -> Scene:
    return quick_return(
        "reduction.modes=6", "reduction.static_modes=true", "reduction.angles=48", 'reduction.interpolation="spline"',
        'outputs.angle={type="angle", joint="crank_hinge"}', *overrides,
        'outputs.bent={type="deformation", point="rocker:tip", axis="x"}',
        'outputs.slider={type="position", point="rocker:tip", axis="x"}',
    )  # fmt: skip


def in_millimetres() -> dict[str, Scene]:
    """Return the same: lengths are a thousand times as many mm, torques a thousand times as many N mm."""
    crank = accurate(
        *MATERIAL, HEAVY, *MOVING, "parameters.r1.nominal=5.6", "bodies.rod.section.radius=5.6",
        'bodies.crank.mesh="0.0:300.0:5"', 'bodies.rod.mesh="300.0:1000.0:5"',
        "effects.motor.table=[[0.0, 0.0], [0.25, 500.0], [1.0, 500.0]]", angles=48,
    )  # fmt: skip
    rocker = turning(
        *MATERIAL, HEAVY, *MOVING, "parameters.r1.nominal=5.6", "bodies.rocker.section.radius=4.0",
        'bodies.crank.mesh="0.0:200.0:3"', 'bodies.rocker.mesh="0.0:800.0:4"', "ground.points.pivot=[0.0, -400.0]",
        "bodies.rocker.placement.origin=[0.0, -400.0]",
        "effects.motor.table=[[0.0, 0.0], [0.05, 2000.0], [1.0, 2000.0]]",
    )  # fmt: skip
    return {"slider_crank": crank, "quick_return": rocker}


@pytest.mark.parametrize("name", ["slider_crank", "quick_return"])
def test_frequencies_are_the_same_in_millimetres(name: str) -> None:
    found = []
    for scene in (in_metres()[name], in_millimetres()[name]):
        with modal_problem(kinematics_of(scene), scene.nominal, 8) as problem:
            found.append([problem.solve(theta).frequencies_hz for theta in (0.0, 0.7, 2.0)])
    # round-off of K over the lowest eigenvalue, see `test_conditioning`; measured 7e-13
    np.testing.assert_allclose(found[1], found[0], rtol=1e-10)


@pytest.mark.parametrize("name", ["slider_crank", "quick_return"])
def test_motions_are_the_same_in_millimetres(name: str) -> None:
    metres, millimetres = (both(scenes[name]) for scenes in (in_metres(), in_millimetres()))
    for one, other in zip(metres, millimetres):
        np.testing.assert_allclose(other["angle"], one["angle"], rtol=0, atol=1e-10)
        for output in ("slider", "bent"):
            # Newton's iteration stops at 1e-12 of the mechanism's size, measured 3e-11 of the deformation
            allowed = 1e-9 * np.ptp(one[output])
            np.testing.assert_allclose(other[output] / THOUSAND, one[output], rtol=0, atol=allowed, err_msg=output)
