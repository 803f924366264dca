"""A slider-crank whose rod is a parameter long, for tests of lengths and places."""

from pgmp_petsc.scene import Scene, scene_from_toml
from scenes import HEADER, tables

CRANK = 0.3
LOW, HIGH = 0.665, 0.735
SLIDER_CRANK = HEADER + tables(f"""
parameters.r1: nominal = 5.6e-3; distribution = {{ name = "norm", loc = 5.6e-3, scale = 0.56e-3 }}
parameters.rod_length: nominal = 0.7; unit = "m"; distribution = {{ name = "uniform", loc = {LOW}, scale = 0.07 }};
    bounds = [{LOW}, {HIGH}]
ground.points: guide = [0.0, 0.0]
bodies.crank: line = {{ length = {CRANK}, elements = 5 }}; element = "beam2d"; material = "steel";
    section = {{ shape = "circle", radius = "r1" }}
bodies.rod: line = {{ length = "rod_length", elements = 5 }}; element = "beam2d"; material = "steel";
    section = {{ shape = "circle", radius = 5.6e-3 }}
joints.crank_hinge: type = "revolute"; connect = ["ground:origin", "crank:hinge"]
joints.elbow: type = "revolute"; connect = ["crank:tip", "rod:hinge"]
joints.slider: type = "point_on_line"; connect = ["ground:guide", "rod:tip"]; direction = [1.0, 0.0]
coordinates.theta: joint = "crank_hinge"; range = [0.0, 6.283185307179586]; periodic = true
effects.motor: type = "torque"; joint = "crank_hinge"; table = [[0.0, 0.0], [0.05, 0.5], [1.0, 0.5]]
effects.weight: type = "gravity"
reduction: modes = 3; static_modes = true; inertia_modes = true; second_order = true; angles = 48;
    interpolation = "spline"
simulation: duration = 0.2; step = 1e-3
outputs.crank_angle: type = "angle"; joint = "crank_hinge"
outputs.slider_position: type = "position"; point = "rod:tip"; axis = "x"
outputs.slider_deformation: type = "deformation"; point = "rod:tip"; axis = "x"
""")
# few modes and angles, a short run: enough for everything but accuracy
SMALL = (
    "reduction.second_order=false", "reduction.modes=2", "reduction.angles=12", "reduction.length_points=3",
    "reduction.max_angles=24", "simulation.duration=0.02",
)  # fmt: skip
#: As far as short runs go, with angles as near each other in a fifth of the time.
PART = 'coordinates.theta={joint="crank_hinge", range=[-0.6, 0.7]}'
BRIEF = (*SMALL, PART, "reduction.angles=5", "reduction.max_angles=5")
#: The place of the guide in place of the length of the rod.
GUIDE = (
    "bodies.rod.line.length=0.7",
    'ground.points.guide=[0.0, "height"]',
    'parameters.height={nominal=0.02, bounds=[0.0, 0.04], distribution={name="uniform", loc=0.0, scale=0.04}}',
    "parameters.rod_length={nominal=0.7}",
)


def long_crank(*overrides: str, settings: tuple[str, ...] = ()) -> Scene:
    return scene_from_toml(SLIDER_CRANK, ".", overrides, settings)


def numbered(length: float, *overrides: str) -> Scene:
    """Return the slider-crank whose rod has a length that is a number."""
    return long_crank(f"bodies.rod.line.length={length!r}", *overrides)
