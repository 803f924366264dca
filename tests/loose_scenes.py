"""Scenes with clearance in joints: a ball in a bore, a slider-crank with a worn pin."""

from scenes import HEADER, of_text, tables

# a rigid ball in a bore, which falls from the middle to the side and bounces
BALL = HEADER + tables("""
parameters.K: nominal = 1e8
bodies.ball: rigid = { mass = 0.5, centre = [0, 0], inertia = 2e-4, points = { far = [0.1, 0] } }
joints.bore: type = "revolute"; connect = ["ground:origin", "ball:centre"];
    clearance = { radius = 1e-3, stiffness = "K", exponent = 1.5, restitution = 0.7, restitution_speed = 0.2 }
coordinates.theta: joint = "bore"; range = [-3.0, 3.0]
effects.weight: type = "gravity"; direction = [0.4, -1.0]; acceleration = 20.0
simulation: duration = 0.03; step = 1e-4
outputs.x: type = "position"; point = "ball:centre"; axis = "x"
outputs.y: type = "position"; point = "ball:centre"; axis = "y"
""")
ball = of_text(BALL)

# a flexible slider-crank whose pin has room
CRANK = HEADER + tables("""
parameters.radius: nominal = 1e-4; distribution = { name = "uniform", loc = 8e-5, scale = 6e-5 }
parameters.K: nominal = 5e8
bodies.crank: line = { length = 0.1, elements = 2 }; element = "beam2d"; material = "steel";
    section = { shape = "circle", radius = 0.01 }
bodies.rod: line = { length = 0.3, elements = 4 }; element = "beam2d"; material = "steel";
    section = { shape = "circle", radius = 0.008 }
joints.main: type = "revolute"; connect = ["ground:origin", "crank:hinge"]
joints.pin: type = "revolute"; connect = ["crank:tip", "rod:hinge"];
    clearance = { radius = "radius", stiffness = "K", exponent = 1.5, restitution = 0.9, restitution_speed = 0.1 }
joints.guide: type = "point_on_line"; connect = ["ground:origin", "rod:tip"]; direction = [1.0, 0.0]
coordinates.theta: joint = "main"; range = [0.0, 6.283185307179586]; periodic = true
effects.slider: type = "point_mass"; point = "rod:tip"; mass = 0.5
reduction: modes = 4; angles = 24; static_modes = true
simulation: duration = 0.02; step = 2e-5; initial = { theta = { position = 0.5, velocity = 30.0 } }
outputs.theta: type = "angle"; joint = "main"
outputs.x: type = "position"; point = "rod:tip"; axis = "x"
""")
worn = of_text(CRANK)

# two rigid wheels in mesh with backlash, driven forth and back
GEARS = HEADER + tables("""
ground.points: other = [0.3, 0.0]
bodies.one: rigid = { mass = 1.0, centre = [0, 0], inertia = 0.01, points = { far = [0.1, 0] } }
bodies.two: rigid = { mass = 1.0, centre = [0, 0], inertia = 0.03, points = { far = [0.2, 0] } };
    placement = { origin = [0.3, 0.0] }
joints.input: type = "revolute"; connect = ["ground:origin", "one:centre"]
joints.output: type = "revolute"; connect = ["ground:other", "two:centre"]
joints.mesh: type = "gear"; joints = ["input", "output"]; ratio = -0.5
joints.mesh.clearance: radius = 2e-3; stiffness = 1e5; restitution = 0.8; restitution_speed = 0.2
coordinates.theta: joint = "input"; range = [-6.0, 6.0]
effects.motor: type = "torque"; joint = "input"; table = [[0.0, 0.5], [0.2, -0.5]]
simulation: duration = 0.2; step = 4e-4
outputs.one: type = "angle"; joint = "input"
outputs.two: type = "angle"; joint = "output"
""")
gears = of_text(GEARS)

# a cam's follower at rest, on which a sprung arm falls by the room of a pin
FOLLOWER = HEADER + tables("""
ground.points: pivot = [-0.15, 0.235]; spring = [0.15, 0.0]
materials.aluminium: E = 70e9; nu = 0.33; rho = 2700.0
bodies.shaft: rigid = { mass = 3.0, inertia = 4e-3, points = { axis = [0.0, 0.0] } }
bodies.follower: rigid = { mass = 0.25, inertia = 2e-4, points = { foot = [0.0, 0.0], pin = [0.0, 0.1] } };
    placement = { origin = [0.0, 0.05] }
bodies.link: rigid = { mass = 0.06, inertia = 4e-5, centre = [0.0, 0.04], points = { low = [0, 0], top = [0, 0.08] } };
    placement = { origin = [0.0, 0.15] }
bodies.arm: line = { length = 0.3, elements = 6 }; element = "beam2d"; material = "aluminium";
    section = { shape = "rectangle", width = 0.02, height = 0.01306946 };
    placement = { origin = [-0.15, 0.235], angle = -0.033 }
joints.shaft: type = "revolute"; connect = ["ground:origin", "shaft:axis"]
joints.guide: type = "prismatic"; connect = ["ground:origin", "follower:foot"]; axis = [0.0, 1.0]
joints.cam: type = "cam"; joints = ["shaft", "guide"]; elastic = { stiffness = 2336402.1, damping = 150.0 };
    table = [[0.0, 0.05], [2.0, 0.05], [3.0, 0.06], [4.28, 0.05], [6.283185307179586, 0.05]]
joints.pin: type = "revolute"; connect = ["follower:pin", "link:low"];
    clearance = { radius = 1.19e-4, stiffness = 2e9, exponent = 1.5, restitution = 0.5, restitution_speed = 0.05 }
joints.eye: type = "revolute"; connect = ["link:top", "arm:middle"]
joints.pivot: type = "revolute"; connect = ["ground:pivot", "arm:hinge"]
coordinates.theta: joint = "shaft"; range = [0.0, 6.283185307179586]; periodic = true
effects.still: type = "prescribed_motion"; coordinate = "theta"; table = [[0.0, 0.0], [1.0, 0.0]]
effects.weight: type = "gravity"
effects.head: type = "point_mass"; point = "arm:tip"; mass = 0.7481783
effects.spring: type = "spring_damper"; points = ["ground:spring", "arm:tip"]; stiffness = 889.4175562434032;
    damping = 2.0; rest = 0.16
effects.structure: type = "structural_damping"; stiffness = 5e-5
reduction: angles = 128
simulation: duration = 0.006; step = 2e-4
outputs.y: type = "position"; point = "arm:tip"; axis = "y"
outputs.force: type = "joint_force"; joint = "pin"
""")
follower = of_text(FOLLOWER)
