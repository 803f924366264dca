"""Rigid bodies that cannot be: every refusal, with the entry's name."""

import pytest
from refusals import cases, check_said, refusal

from pgmp_petsc.scene import scene_from_toml
from scenes import HEADER, tables

PLANE = HEADER + tables("""
bodies.drum: rigid = { mass = 2.0, inertia = 0.03, points = { hub = [0.0, -0.1], rim = [0.3, 0.0] } }
joints.hinge: type = "revolute"; connect = ["ground:origin", "drum:hub"]
coordinates.phi: joint = "hinge"; range = [0.0, 6.283185307179586]; periodic = true
""")
SPACE = HEADER + tables("""
parameters.j: nominal = 0.03
bodies.drum: rigid = { mass = 2.0, inertia = ["j", 0.03, 0.04, 0.0, 0.0, 0.0], points = { hub = [0.0, -0.1, 0.0] } }
joints.hinge: type = "revolute"; connect = ["ground:origin", "drum:hub"]; axis = [0.0, 0.0, 1.0]
coordinates.phi: joint = "hinge"; range = [0.0, 6.283185307179586]; periodic = true
""")
REFUSED = {
    PLANE: """
bodies.drum.rigid.mass=0.0 -> = 0.0: a positive number or the name of a parameter is needed
bodies.drum.rigid.mass=-2.0 -> = -2.0: a positive number or the name of a parameter is needed
bodies.drum.rigid.mass="m" -> = "m": there is no such parameter
bodies.drum.rigid.mass="m" & parameters.m={nominal=-1.0} -> \
    parameters.m.nominal = -1.0: must be positive, because bodies.drum.rigid.mass uses it
bodies.drum.rigid.mass="m" & parameters.m={nominal=1.0, unit="m"} -> parameters.m.unit = "m": | kg
bodies.drum={rigid={inertia=0.1}} -> bodies.drum.rigid.mass: missing; needed: mass (kg)
bodies.drum.rigid.inertia=0.0 -> = 0.0: moments of inertia are positive
bodies.drum.rigid.inertia="j" & parameters.j={nominal=-1.0} -> \
    parameters.j.nominal = -1.0: must be positive, because bodies.drum.rigid.inertia.izz uses it
bodies.drum.rigid.inertia=[0.1, 0.1] -> = [0.1, 0.1]: a moment of inertia in the plane, or six entries [ixx, iyy, izz
bodies.drum.rigid.inertia=true -> = true: a moment of inertia in the plane, or six entries [ixx, iyy, izz, ixy, ixz
bodies.drum.rigid.centre=[0.1, 0.0, 0.0] -> = [0.1, 0.0, 0.0]: two numbers (x, y) are needed in the plane
bodies.drum.rigid.centre=["x", 0.0] -> = ["x", 0.0]: two finite numbers in brackets
bodies.drum.rigid.points.rim=[0.1, 0.0, 0.0] -> = [0.1, 0.0, 0.0]: two numbers (x, y) are needed in the plane
bodies.drum.rigid.points.centre=[0.1, 0.0] -> = [0.1, 0.0]: this point is the centre of mass; give its place as bodies
bodies.drum.mesh="drum.msh" -> \
    bodies.drum.rigid = { mass = 2.0, inertia = 0.03, points = { hub = [0.0, -0. ...: exactly one of mesh, line,
bodies.drum.element="beam2d" -> = "beam2d": rigid says all mass properties; leave it out
bodies.drum.material="steel" -> = "steel": rigid says all mass properties; leave it out
bodies.drum.flexible=true -> = true: a body with rigid does not deform; leave it out
bodies.drum.rigid.weight=3.0 -> = 3.0: unknown key
joints.hinge.connect=["ground:origin", "drum:hup"] -> \
    joints.hinge.connect = "drum:hup": there is no such point; did you mean 'drum:hub'?
outputs.x={type="position", point="drum:0", axis="x"} -> \
    outputs.x.point = "drum:0": there is no such point
outputs.s={type="stress", body="drum", quantity="axial_force"} -> \
    outputs.s.body = "drum": this body is rigid, so nothing is known of its stresses
effects.e={type="structural_damping", mass=1.0, bodies=["drum"]} -> \
    effects.e.bodies = ["drum"]: drum is rigid; only flexible bodies have structural damping
fields.f={body="drum", quantity="E", variation=0.1, length=1.0, terms=1} -> \
    fields.f.body = "drum": is rigid; a field needs a flexible body
bodies.rod={material="steel", line={length=0.1, elements=2}} -> bodies.rod.element: missing; needed: beam2d, beam3d
""",
    SPACE: """
bodies.drum.rigid.inertia=[0.03, 0.03, 0.07, 0.0, 0.0, 0.0] -> \
    = [0.03, 0.03, 0.07, 0.0, 0.0, 0.0]: no body has it: of the principal moments 0.03, 0.03, 0.07 the last is
bodies.drum.rigid.inertia=[0.03, 0.03, 0.04, 0.05, 0.0, 0.0] -> \
    = [0.03, 0.03, 0.04, 0.05, 0.0, 0.0]: is not positive definite: its principal moments are -0.02, 0.04, 0.08
bodies.drum.rigid.inertia=[0.0, 0.03, 0.03, 0.0, 0.0, 0.0] -> \
    = [0.0, 0.03, 0.03, 0.0, 0.0, 0.0]: moments of inertia are positive
parameters.j.value=0.08 -> bodies.drum.rigid.inertia = ["j", 0.03, 0.04, 0.0, 0.0, 0.0]: no body has it
bodies.drum.rigid.points.hub=[0.0, -0.1] -> = [0.0, -0.1]: three numbers (x, y, z) are needed in space
bodies.two={rigid={mass=1.0, inertia=0.1}} & joints.more={type="spherical", connect=["drum:hub", "two:centre"]} -> \
    bodies.two.rigid.inertia = 0.1: is one number, for the plane, but drum (rigid) in space; there it has six entries
""",
}


@pytest.mark.parametrize(
    ("text", "asked", "said"), [(text, *case) for text, table in REFUSED.items() for case in cases(table)]
)
def test_what_cannot_be_is_refused(text: str, asked: str, said: str) -> None:
    check_said(refusal(scene_from_toml, text, ".", asked.split(" & ")), said, asked)


def test_rounded_moments_of_a_flat_body_are_taken() -> None:
    flat = "bodies.drum.rigid.inertia=[0.0333, 0.0333, 0.0667, 0.0, 0.0, 0.0]"
    assert scene_from_toml(SPACE, ".", (flat,)).bodies["drum"].rigid.dimension == 3
