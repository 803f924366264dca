"""Build reduced-order models of solid bodies on several ranks and write them. Used by test_build.py.

Arguments as those of `build`, with the scenes of `CASES` here.
"""

import sys
from pathlib import Path

import build  # starts PETSc
from spatial import slider_crank_in_space

from pgmp_petsc.scene import Scene
from scenes import meshes_of

SMALL = (
    "reduction.modes=3", "reduction.static_modes=true", "reduction.inertia_modes=true", "reduction.second_order=true",
)  # fmt: skip
# the kinematics of a part of a revolution, which every rank follows, takes less time than that of a whole one
PART = ("coordinates.theta.range=[0.0,0.8]", "coordinates.theta.periodic=false", "reduction.angles=5")


def plane() -> Scene:
    """Return the slider-crank of plane-stress elements; the crank has two weights, and so has the gravity on it."""
    bodies = [f'bodies.{name}.element="solid2d"' for name in ("crank", "rod")]
    axes = ['joints.crank_hinge={type="revolute",connect=["ground:origin","crank:hinge"]}',
            'joints.elbow={type="revolute",connect=["crank:tip","rod:hinge"]}',
            "joints.slider.direction=[1.0,0.0]"]  # fmt: skip
    sizes = ("parameters.t1.nominal=0.01", 'bodies.crank.thickness="t1"', "bodies.rod.thickness=0.01")
    return slider_crank_in_space(
        *bodies, *axes, *sizes, 'effects.weight={type="gravity"}', "reduction.angles=12", *SMALL
    )


def space() -> Scene:
    """Return the slider-crank in space, with weight in all directions and a modulus that is a parameter."""
    modulus = (
        "parameters.E1.nominal=210e9", 'materials.soft={E="E1",nu=0.3,rho=7800.0}', 'bodies.crank.material="soft"',
    )  # fmt: skip
    return slider_crank_in_space(*modulus, 'effects.weight={type="gravity",direction=[0.3,-1.0,0.6]}', *PART, *SMALL)


CASES = {"plane": plane, "space": space}

if __name__ == "__main__":
    for argument in sys.argv[2:]:
        build.run(Path(sys.argv[1]), argument, CASES, meshes_of)
