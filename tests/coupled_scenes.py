"""Scenes whose joints are coupled: rotors, a rack, a screw, a cam, and geared linkages that bend."""

from scenes import HEADER, tables

ROTORS = HEADER + tables("""
ground.points: right = [0.3, 0.0]
bodies.one: rigid = { mass = 1.0, inertia = 0.02, points = { hub = [0.0, 0.0] } }
bodies.two: rigid = { mass = 2.0, inertia = 0.5, points = { hub = [0.0, 0.0] } };
    placement = { angle = 0.4, origin = [0.3, 0.0] }
joints.input: type = "revolute"; connect = ["ground:origin", "one:hub"]
joints.output: type = "revolute"; connect = ["ground:right", "two:hub"]
joints.mesh: type = "gear"; joints = ["input", "output"]; ratio = -0.37
coordinates.phi: joint = "input"; range = [-1.0, 19.0]
effects.motor: type = "torque"; joint = "input"; table = [[0.0, 0.7], [2.0, 0.7]]
simulation: duration = 2.0; step = 2e-3
outputs.one: type = "angle"; joint = "input"
outputs.two: type = "angle"; joint = "output"
""")
ROTORS_IN_SPACE = HEADER + tables("""
ground.points: right = [0.3, 0.0, 0.0]
bodies.one: rigid = { mass = 1.0, inertia = [0.05, 0.05, 0.02, 0.0, 0.0, 0.0], points = { hub = [0.0, 0.0, 0.0] } }
bodies.two: rigid = { mass = 2.0, inertia = [0.5, 0.7, 0.7, 0.0, 0.0, 0.0], points = { hub = [0.0, 0.0, 0.0] } }
joints.input: type = "revolute"; connect = ["ground:origin", "one:hub"]; axis = [0.0, 0.0, 1.0]
joints.output: type = "revolute"; connect = ["ground:right", "two:hub"]; axis = [1.0, 0.0, 0.0]
joints.mesh: type = "gear"; joints = ["input", "output"]; ratio = -0.37
coordinates.phi: joint = "input"; range = [-1.0, 19.0]
effects.motor: type = "torque"; joint = "input"; table = [[0.0, 0.7], [2.0, 0.7]]
simulation: duration = 2.0; step = 2e-3
outputs.one: type = "angle"; joint = "input"
outputs.two: type = "angle"; joint = "output"
""")
# with a third rotor behind the second one, which no coordinate is of
ROW_IN_SPACE = ROTORS_IN_SPACE.replace("0.7], [2.0, 0.7]", "3.5], [2.0, 3.5]") + tables("""
bodies.three: rigid = { mass = 2.0, inertia = [0.5, 0.5, 0.9, 0.0, 0.0, 0.0], points = { hub = [0.0, 0.0, 0.0] } }
joints.last: type = "revolute"; connect = ["ground:origin", "three:hub"]; axis = [0.0, 0.0, 1.0]
joints.again: type = "gear"; joints = ["output", "last"]; ratio = -1.7
outputs.three: type = "angle"; joint = "last"
""")
RACK = HEADER + tables("""
bodies.pinion: rigid = { mass = 1.0, inertia = 0.02, points = { hub = [0.0, 0.0] } }
bodies.carriage: rigid = { mass = 3.0, inertia = 0.1, points = { left = [0.0, 0.0], right = [0.1, 0.0] } }
joints.axle: type = "revolute"; connect = ["ground:origin", "pinion:hub"]
joints.rail: type = "point_on_line"; connect = ["ground:origin", "carriage:left"]; direction = [1.0, 0.0]
joints.rail2: type = "point_on_line"; connect = ["ground:origin", "carriage:right"]; direction = [1.0, 0.0]
joints.teeth: type = "rack"; joints = ["axle", "rail"]; radius = 0.05
coordinates.phi: joint = "axle"; range = [-12.0, 12.0]
effects.spring: type = "spring_damper"; joint = "rail"; motion = "sliding"; stiffness = 200.0
simulation: duration = 1.0; step = 1e-3; initial = { phi = { velocity = 40.0 } }
outputs.x: type = "sliding"; joint = "rail"
outputs.phi: type = "angle"; joint = "axle"
""")
SCREW = HEADER + tables("""
bodies.nut: rigid = { mass = 3.0, inertia = [0.05, 0.06, 0.02, 0.0, 0.0, 0.0], points = { hub = [0.0, 0.0, 0.0] } }
joints.shaft: type = "cylindrical"; connect = ["ground:origin", "nut:hub"]; axis = [0.0, 0.0, 1.0]
joints.thread: type = "screw"; joint = "shaft"; lead = 0.5
coordinates.x: joint = "shaft"; motion = "sliding"; range = [-1.0, 2.5]
effects.push: type = "force"; joint = "shaft"; table = [[0.0, 4.0], [2.0, 4.0]]
simulation: duration = 2.0; step = 2e-3
outputs.x: type = "sliding"; joint = "shaft"
outputs.phi: type = "angle"; joint = "shaft"
""")
# a bridge on a spindle of 10 mm lead, which turns 20 times for 0.2 m, and a cart across it on another one
_ONE_SPINDLE = HEADER + tables("""
bodies.bridge: rigid = { mass = 3.0, inertia = [0.05, 0.06, 0.02, 0.0, 0.0, 0.0], points = { a = [0.0, 0.0, 0.0] } };
    placement = { origin = [0.007, 0.0, 0.0] }
bodies.long: rigid = { mass = 1.0, inertia = [1e-4, 0.02, 0.02, 0.0, 0.0, 0.0], points = { b = [1.0, 0.0, 0.0] } };
    placement = { origin = [-1.0, 0.0, 0.0] }
joints.x: type = "prismatic"; connect = ["ground:origin", "bridge:a"]; axis = [1.0, 0.0, 0.0]
joints.bearing: type = "revolute"; connect = ["ground:origin", "long:b"]; axis = [1.0, 0.0, 0.0]
joints.nut: type = "cylindrical"; connect = ["long:b", "bridge:a"]; axis = [1.0, 0.0, 0.0]
joints.thread: type = "screw"; joint = "nut"; lead = -0.01
coordinates.x: joint = "x"; range = [-0.2, 0.2]
effects.one: type = "torque"; joint = "bearing"; table = [[0.0, 0.5], [1.0, 0.5]]
simulation: duration = 0.1; step = 5e-4
outputs.x: type = "sliding"; joint = "x"
""")
SPINDLES = (
    _ONE_SPINDLE,
    _ONE_SPINDLE
    + tables("""
bodies.cart: rigid = { mass = 1.0, inertia = [0.05, 0.06, 0.02, 0.0, 0.0, 0.0], points = { a = [0.0, 0.0, 0.0] } }
bodies.across: rigid = { mass = 1.0, inertia = [0.02, 1e-4, 0.02, 0.0, 0.0, 0.0], points = { a = [0.0, 0.0, 0.0] } }
joints.y: type = "prismatic"; connect = ["bridge:a", "cart:a"]; axis = [0.0, 1.0, 0.0]
joints.bearing2: type = "revolute"; connect = ["bridge:a", "across:a"]; axis = [0.0, 1.0, 0.0]
joints.nut2: type = "cylindrical"; connect = ["across:a", "cart:a"]; axis = [0.0, 1.0, 0.0]
joints.thread2: type = "screw"; joint = "nut2"; lead = -0.01
coordinates.y: joint = "y"; range = [-0.2, 0.2]
effects.two: type = "torque"; joint = "bearing2"; table = [[0.0, -0.3], [1.0, -0.3]]
outputs.y: type = "sliding"; joint = "y"
"""),
)
CAM = HEADER + tables("""
bodies.cam: rigid = { mass = 1.0, inertia = 0.02, points = { hub = [0.0, 0.0] } }
bodies.follower: rigid = { mass = 2.0, inertia = 0.1, points = { foot = [0.0, 0.0], top = [0.0, 0.1] } }
joints.axle: type = "revolute"; connect = ["ground:origin", "cam:hub"]
joints.rail: type = "point_on_line"; connect = ["ground:origin", "follower:foot"]; direction = [0.0, 1.0]
joints.rail2: type = "point_on_line"; connect = ["ground:origin", "follower:top"]; direction = [0.0, 1.0]
joints.lift: type = "cam"; joints = ["axle", "rail"]; motion = "sliding";
    table = [[-1.0, 0.02], [0.5, 0.05], [1.5, 0.12], [2.5, 0.1], [4.0, 0.03], [5.283185307179586, 0.02]]
coordinates.phi: joint = "axle"; range = [0.0, 6.283185307179586]; periodic = true
effects.spring: type = "spring_damper"; joint = "rail"; motion = "sliding"; stiffness = 300.0
simulation: duration = 1.0; step = 1e-3; initial = { phi = { position = 0.3, velocity = 20.0 } }
outputs.x: type = "sliding"; joint = "rail"
outputs.phi: type = "angle"; joint = "axle"
""")
CAM_TABLE = [[-1.0, 0.02], [0.5, 0.05], [1.5, 0.12], [2.5, 0.1], [4.0, 0.03], [5.283185307179586, 0.02]]
# a five-bar whose two cranks are geared: one coordinate
GEARED = HEADER + tables("""
ground.points: right = [0.4, 0.0]
bodies.crank: line = { length = 0.15, elements = 3 }; element = "beam2d"; material = "steel";
    section = { shape = "rectangle", width = 0.01, height = 0.012 }
bodies.left: line = { length = 0.5, elements = 6 }; element = "beam2d"; material = "steel";
    section = { shape = "rectangle", width = 0.01, height = 0.006 }; placement = { origin = [0.15, 0.0], angle = 1.2 }
bodies.right: line = { length = 0.5, elements = 6 }; element = "beam2d"; material = "steel";
    section = { shape = "rectangle", width = 0.01, height = 0.006 }; placement = { origin = [0.5, 0.0], angle = 2.0 }
bodies.second: line = { length = 0.1, elements = 3 }; element = "beam2d"; material = "steel";
    section = { shape = "rectangle", width = 0.01, height = 0.012 }; placement = { origin = [0.4, 0.0], angle = 0.5 }
joints.input: type = "revolute"; connect = ["ground:origin", "crank:hinge"]
joints.output: type = "revolute"; connect = ["ground:right", "second:hinge"]
joints.elbow: type = "revolute"; connect = ["crank:tip", "left:hinge"]
joints.knee: type = "revolute"; connect = ["second:tip", "right:hinge"]
joints.tool: type = "revolute"; connect = ["left:tip", "right:tip"]
joints.mesh: type = "gear"; joints = ["input", "output"]; ratio = -1.0
coordinates.phi: joint = "input"; range = [0.0, 6.283185307179586]; periodic = true
effects.motor: type = "torque"; joint = "input"; table = [[0.0, 0.0], [0.2, 0.9], [1.0, 0.9]]
effects.load: type = "joint_damping"; joint = "output"; coefficient = 0.02
effects.material: type = "structural_damping"; stiffness = 2e-4
reduction: modes = 6; angles = 48; static_modes = true; interpolation = "spline"; second_order = true
simulation: duration = 0.6; step = 2.5e-4
outputs.input: type = "angle"; joint = "input"
outputs.output: type = "angle"; joint = "output"
outputs.x: type = "position"; point = "left:tip"; axis = "x"
outputs.bending: type = "deformation"; point = "left:middle"; axis = "y"
""")
# two shafts that are geared, each with a disc at its far end; in space, so that they can twist
SHAFTS = HEADER + tables("""
ground.points: side = [0.0, 0.1, 0.0]
bodies.shaft: line = { length = 0.5, elements = 8 }; element = "beam3d"; material = "steel";
    orientation = [0.0, 1.0, 0.0]; section = { shape = "circle", radius = 0.005 }
bodies.disc: rigid = { mass = 1.0, inertia = [0.01, 0.01, 0.01, 0.0, 0.0, 0.0], points = { hub = [0.0, 0.0, 0.0] } };
    placement = { origin = [0.5, 0.0, 0.0] }
bodies.wheel: rigid = { mass = 1.0, inertia = [0.02, 0.02, 0.02, 0.0, 0.0, 0.0], points = { hub = [0.0, 0.0, 0.0] } }
joints.input: type = "revolute"; connect = ["ground:origin", "shaft:hinge"]; axis = [1.0, 0.0, 0.0]
joints.clamp: type = "fixed"; connect = ["shaft:tip", "disc:hub"]
joints.output: type = "revolute"; connect = ["ground:side", "wheel:hub"]; axis = [1.0, 0.0, 0.0]
joints.mesh: type = "gear"; joints = ["input", "output"]; ratio = -2.0
coordinates.phi: joint = "input"; range = [0.0, 6.283185307179586]; periodic = true
reduction: modes = 3; angles = 8
""")
