"""A slider-crank whose rod is a parameter long, for tests of lengths and places."""

from pgmp_petsc.scene import Scene, scene_from_toml
from scenes import HEADER, WEIGHT, beam, joint, output, reduction, slide, torque, turning

CRANK = 0.3
LOW, HIGH = 0.665, 0.735
SLIDER_CRANK = f"""{HEADER}
[parameters.r1]
nominal = 5.6e-3
distribution = {{ name = "norm", loc = 5.6e-3, scale = 0.56e-3 }}
[parameters.rod_length]
nominal = 0.7
unit = "m"
distribution = {{ name = "uniform", loc = {LOW}, scale = 0.07 }}
bounds = [{LOW}, {HIGH}]
[ground.points]
guide = [0.0, 0.0]
{beam("crank", "", '"r1"').replace('mesh = ""', f"line = {{ length = {CRANK}, elements = 5 }}")}
{beam("rod", "", "5.6e-3").replace('mesh = ""', 'line = { length = "rod_length", elements = 5 }')}
{joint("crank_hinge", "ground:origin", "crank:hinge")}
{joint("elbow", "crank:tip", "rod:hinge")}
{slide("slider", "ground:guide", "rod:tip")}
{turning("theta", "crank_hinge")}
{torque("crank_hinge", "[[0.0, 0.0], [0.05, 0.5], [1.0, 0.5]]")}
{WEIGHT}
{reduction(3, 48)}
static_modes = true
inertia_modes = true
second_order = true
interpolation = "spline"
[simulation]
duration = 0.2
step = 1e-3
{output("crank_angle", "angle", joint="crank_hinge")}
{output("slider_position", "position", point="rod:tip", axis="x")}
{output("slider_deformation", "deformation", point="rod:tip", axis="x")}
"""
# few modes and angles, a short run: enough for everything but accuracy
SMALL = (
    "reduction.second_order=false",
    "reduction.modes=2",
    "reduction.angles=12",
    "reduction.length_points=3",
    "simulation.duration=0.02",
)
#: The place of the guide in place of the length of the rod.
GUIDE = (
    "bodies.rod.line.length=0.7",
    'ground.points.guide=[0.0, "height"]',
    'parameters.height={nominal=0.02, bounds=[0.0, 0.04], distribution={name="uniform", loc=0.0, scale=0.04}}',
    "parameters.rod_length={nominal=0.7}",
)


def long_crank(*overrides: str, settings: tuple[str, ...] = ()) -> Scene:
    """Return the slider-crank."""
    return scene_from_toml(SLIDER_CRANK, ".", overrides, settings)


def numbered(length: float, *overrides: str) -> Scene:
    """Return the slider-crank whose rod has a length that is a number."""
    return long_crank(f"bodies.rod.line.length={length!r}", *overrides)
