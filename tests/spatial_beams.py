"""Mechanisms of beams in space made in memory.

As in `scenes`, the entry ``mesh`` of a body is ``"first:last:n"``, a straight line of n cells on the x axis of the
body's frame. Solids of the same scene are bars of `spatial`.
"""

from spatial import TURN

from scenes import HEADER, of_text, tables

WIDTH, HEIGHT = 0.008, 0.012  # of the rectangular sections, m
RECTANGLE = f'section = {{ shape = "rectangle", width = {WIDTH}, height = {HEIGHT} }}\norientation = [0.0, 1.0, 0.0]'
CIRCLE = 'section = { shape = "circle", radius = 5.6e-3 }'


def beam(name: str, mesh: str, section: str = RECTANGLE, more: str = "") -> str:
    return f'[bodies.{name}]\nmesh = "{mesh}"\nelement = "beam3d"\nmaterial = "steel"\n{section}\n{more}\n'


# the slider-crank of `scenes`, crank 0.3 m and rod 0.7 m, with beams in space
SLIDER_CRANK = HEADER + tables(f"""
parameters.r1: nominal = 5.6e-3; unit = "m"
{beam("crank", "0.0:0.3:5", 'section = { shape = "circle", radius = "r1" }')}
{beam("rod", "0.3:1.0:5", CIRCLE)}
joints.crank_hinge: type = "revolute"; connect = ["ground:origin", "crank:hinge"]; axis = [0.0, 0.0, 1.0]
joints.elbow: type = "revolute"; connect = ["crank:tip", "rod:hinge"]; axis = [0.0, 0.0, 1.0]
joints.slider: type = "point_on_line"; connect = ["ground:origin", "rod:tip"]; direction = [1.0, 0.0, 0.0]
coordinates.theta: joint = "crank_hinge"; {TURN}
effects.motor: type = "torque"; joint = "crank_hinge"; table = [[0.0, 0.0], [0.25, 0.5], [1.0, 0.5]]
reduction: modes = 5; angles = 24
""")
slider_crank_of_beams = of_text(SLIDER_CRANK)

# one beam on a hinge about the y axis of a section's height
PENDULUM = (
    HEADER
    + beam("arm", "0.0:1.0:10")
    + tables(f"""
joints.hinge: type = "revolute"; connect = ["ground:origin", "arm:hinge"]; axis = [0.0, 0.0, 1.0]
coordinates.phi: joint = "hinge"; {TURN}
reduction: modes = 4; angles = 6
""")
)
pendulum_in_space = of_text(PENDULUM)
