"""Five machines beside another multibody program, Exudyn 1.13.6 (doi.org/10.1007/s11044-023-09937-1).

A slider-crank in the plane on a rigid frame on springs: its geometrically exact beams of two nodes are Reissner's, as
ours are, and so is the scheme, so that runs agree to the tolerance of its iterations.

A crooked four-bar in space: the linkage of `offset_scenes` with the pin of C off, there of geometrically exact beams
in space (two nodes with Euler parameters, shear), ideal revolute joints and the same stiffness and inertia of sections,
on the same meshes. Elements interpolate rotations and masses in ways of their own, so that the programs differ by the
square of an element's length, and tend to the same.
"""

import numpy as np
import pytest
from alike import orders
from offset_scenes import offset, spatial_four_bar
from runs import motion, trajectory

from pgmp_petsc.scene import Scene, scene_from_toml
from scenes import HEADER, tables

OFF = {"turn": [float(np.radians(5.0)), 0.0, 0.0], "place": [0.0, 0.0, 2e-3]}
MESHES = (1, 2, 4)  # times 2, 4 and 2 elements of crank, coupler and rocker
ANGLES = (0.0, 1.5, 3.0, 4.5)  # of the crank, which is held there, rad
# at rest, rows of angles and, for each, of meshes: how far the coupler's tip is aside (m), angle of D (rad), torque
# that holds the crank (N m), and moment in A across its axis (N m)
AT_REST = {
    "turn": [
        [0.00368638727, 4.36146915e-05, 0.216095164, 102.062011],
        [0.00346216034, 5.55835378e-05, 0.224386123, 95.9423497],
        [0.00341054726, 5.80295039e-05, 0.2260142, 94.5404783], [0.00310346943, 0.654475069, -0.0285565127, 88.8215204],
        [0.00291966794, 0.654509397, -0.0344404743, 84.2407545],
        [0.00287737843, 0.654517139, -0.0356709654, 83.1923408], [0.00319189046, 0.680508962, -0.126885911, 102.869174],
        [0.00299416338, 0.680527452, -0.129728782, 97.2845035], [0.00294904248, 0.680531319, -0.130219485, 96.0138993],
        [0.00269580795, -0.0867306297, -0.202566158, 116.735555],
        [0.00245588876, -0.086770183, -0.204907364, 107.852517],
        [0.00240230356, -0.0867794836, -0.205118767, 105.874556],
    ],
    "place": [
        [-0.00129753722, -7.85268961e-05, -0.0275879348, 34.1948552],
        [-0.00122129352, -7.25615881e-05, -0.0241473617, 31.9916363],
        [-0.00120374341, -7.12240239e-05, -0.0233878288, 31.4844904],
        [-0.00109732876, 0.654801254, 0.0124804859, 26.329436], [-0.00103364843, 0.65480767, 0.0109160059, 24.623997],
        [-0.0010189968, 0.654809128, 0.0105708705, 24.2316086], [-0.00109015705, 0.680464797, 0.0137332903, 28.7015824],
        [-0.0010208707, 0.680471631, 0.0118525425, 26.6639432], [-0.00100505947, 0.680473147, 0.0114427538, 26.1989524],
        [-0.00139907574, -0.0874614588, 0.0327496391, 48.9722227],
        [-0.00128711653, -0.087452882, 0.0272908787, 44.7050086],
        [-0.00126211039, -0.0874510674, 0.0261396099, 43.7519246],
    ],
}  # fmt: skip
# with generalised-alpha, spectral radius 0.8, steps of 50 us, under 10 N m on the crank, which rise over 10 ms;
# rows of meshes and, for each, after 10, 20, .. 50 ms: angle of A (rad), angle of D (rad), aside (m)
IN_MOTION = np.array([
    [0.0447367876, 0.02172145561, 0.00369697547], [0.3179787945, 0.1580343768, 0.00370463939],
    [0.8826657163, 0.4291882906, 0.00344408826], [1.968758182, 0.7456199267, 0.00300398648],
    [3.677581991, 0.4336240534, 0.00321672954], [0.04463229753, 0.02165358998, 0.00347362077],
    [0.317542931, 0.1578076443, 0.0034882875], [0.8816761283, 0.4287618213, 0.00324468459],
    [1.966434711, 0.7454796516, 0.00282465274], [3.675666342, 0.4346673041, 0.00299382104],
    [0.04460945482, 0.02164731808, 0.00342218556], [0.317457553, 0.157767367, 0.00343835365],
    [0.8814793529, 0.4286818059, 0.00319860788], [1.965961872, 0.7454708259, 0.00278356076],
    [3.675275356, 0.4348834234, 0.00294345223],
])  # fmt: skip


def crooked(mesh: int, key: str, *more: str) -> Scene:
    elements = (f"bodies.{body}.line.elements={mesh * n}" for body, n in (("crank", 2), ("coupler", 4), ("rocker", 2)))
    turning = "coordinates.theta={joint='A',range=[0.0,6.283185307179586],periodic=true}"
    return spatial_four_bar(offset("C", **{key: OFF[key]}), turning, *elements, *more)


@pytest.mark.parametrize("key", OFF)
def test_what_a_crooked_linkage_has_built_in(key: str) -> None:
    found = np.zeros((len(ANGLES), len(MESHES), 4))
    for row, angle in zip(found, ANGLES):
        for k, mesh in enumerate(MESHES):
            scene = crooked(
                mesh, key, "simulation.duration=2.5e-4", 'outputs.torque={type="drive_torque",joint="A"}',
                f"effects={{hold={{type='prescribed_motion',coordinate='theta',table=[[0,{angle}],[1,{angle}]]}}}}",
                *(f'outputs.{axis}={{type="joint_torque",joint="A",component="{axis}"}}' for axis in "xy"),
            )  # fmt: skip
            first = {name: values[0] for name, values in motion("full", scene).outputs.items()}
            row[k] = first["aside"], first["angle"], first["torque"], np.hypot(first["x"], first["y"])
    expected = np.reshape(AT_REST[key], found.shape)
    errors = (np.abs(found - expected) / np.abs(expected).max(axis=(0, 1))).max(axis=0)
    # of the torque under 5 degrees 1.9e-4, 4.8e-5, 1.2e-5
    assert np.all(errors[-1] < [1e-5, 5e-6, 2e-5, 1e-5]), errors
    np.testing.assert_allclose(orders(errors)[-1], 2.0, atol=0.15)


SECOND = ("reduction.second_order=true",)


@pytest.mark.parametrize(
    ("model", "more", "allowed"),
    [
        ("full", (), (1e-6, 3e-6, 7e-6)),
        # deformations are linear in floating frames: with the offset the angles' share falls by 4 when it is halved
        ("components", (), (5e-5, 3e-4, 6e-4)),
        # centrifugal forces change no stiffness, with the square of the speed: a tenth of it, by 1 N m, leaves 8e-5
        ("reduced", (), (1.2e-4, 7e-4, 6e-3)),
        ("reduced", SECOND, (1.2e-4, 1.5e-4, 1.5e-4)),
    ],
)
def test_a_crooked_linkage_in_motion(model: str, more: tuple[str, ...], allowed: tuple[float, ...]) -> None:
    names, expected, found = ("crank", "angle", "aside"), IN_MOTION.reshape(len(MESHES), 5, 3), []
    for mesh in MESHES if model == "full" else MESHES[-1:]:
        scene = crooked(
            mesh, "turn", "effects={motor={type='torque',joint='A',table=[[0.0,0.0],[0.01,10.0]]}}",
            "reduction.angles=48", "simulation={duration=0.05,step=5e-5}",
            'outputs.crank={type="angle",joint="A"}', *more,
        )  # fmt: skip
        outputs = motion(model, scene).outputs
        found.append(np.stack([outputs[name][200::200] for name in names], axis=1))
    difference = np.abs(np.array(found) - expected[-len(found) :])
    errors = (difference / np.abs(expected).max(axis=(0, 1))).max(axis=1)
    assert np.all(errors[-1] < allowed), errors
    if model == "full":  # the scheme and its steps are the same, so that its errors are common
        np.testing.assert_allclose(orders(errors)[-1], 2.0, atol=0.1)


CRANK, ROD, START = 0.1, 0.25, 0.8  # m, m, rad
HUB = np.array([0.15, 0.1])
PIN = HUB + CRANK * np.array([np.cos(START), np.sin(START)])
ON_SPRINGS = HEADER + tables(f"""
ground.points: left = [0.0, 0.0]; right = [0.6, 0.0]
bodies.frame.rigid: mass = 8.0; centre = [0.25, 0.05]; inertia = 0.5;
    points = {{ left = [0.0, 0.0], right = [0.6, 0.0], hub = {HUB.tolist()} }}
bodies.crank: line = {{ length = {CRANK}, elements = 4 }}; element = "beam2d"; material = "steel";
    section = {{ shape = "rectangle", width = 0.01, height = 0.01 }};
    placement = {{ origin = {HUB.tolist()}, angle = {START} }}
bodies.rod: line = {{ length = {ROD}, elements = 8 }}; element = "beam2d"; material = "steel";
    section = {{ shape = "rectangle", width = 0.01, height = "height" }};
    placement = {{ origin = {PIN.tolist()}, angle = {-np.arcsin(CRANK * np.sin(START) / ROD)} }}
parameters.height: nominal = 0.006
parameters.k: nominal = 1e4
parameters.k2: nominal = 2e4
parameters.k3: nominal = 3e4
joints.left: type = "fixed"; connect = ["ground:left", "frame:left"];
    elastic = {{ reference = [[1, 0]], stiffness = ["k2", "k3"], damping = [20.0, 30.0], turning_stiffness = [0.0] }}
joints.right: type = "fixed"; connect = ["ground:right", "frame:right"];
    elastic = {{ reference = [[1, 0]], stiffness = ["k", "k2"], damping = [20.0, 30.0], turning_stiffness = [0.0] }}
joints.hub: type = "revolute"; connect = ["frame:hub", "crank:hinge"]
joints.pin: type = "revolute"; connect = ["crank:tip", "rod:hinge"]
joints.slider: type = "point_on_line"; connect = ["frame:hub", "rod:tip"]; direction = [1.0, 0.0]
coordinates.theta: joint = "hub"; range = [0.0, 6.283185307179586]; periodic = true
effects.weight: type = "gravity"; acceleration = 9.81
reduction: modes = 4; angles = 48; static_modes = true; inertia_modes = true
simulation: duration = 0.1; step = 1e-4
simulation.initial.theta: position = {START}
outputs.theta: type = "angle"; joint = "hub"
outputs.x: type = "displacement"; point = "frame:left"; axis = "x"
outputs.y: type = "displacement"; point = "frame:left"; axis = "y"
outputs.right: type = "displacement"; point = "frame:right"; axis = "y"
""")
# soft springs and 2 N m, or ten times as stiff ones, a rod of 10 mm and 0.5 N m; torques rise over 20 ms. After 20, 40,
# .. 100 ms: crank's angle (rad), left mount's x and y, right mount's y, rod's middle from its chord (m)
SOFT = [
    [0.9044764136, 0.0001397702217, -0.001540576137, -0.001662152345, 1.296858127e-07],
    [1.46572521, 0.0007862543065, -0.002789888389, -0.00355482415, 6.500223617e-05],
    [2.799111625, 0.001066627353, -0.0002154339648, -0.001704348056, 0.0001970732228],
    [5.063739267, -0.003165753778, -0.0007524140732, 0.0009172081101, -0.0003124381392],
    [7.875718827, -0.0006157364032, -0.005284104596, -0.004083971986, 0.0005892475235],
]
STIFF = [
    [0.8086936346, 1.006040599e-05, -0.0001214892019, -0.0001612864558, -2.128800909e-06],
    [0.8836164665, 3.76256785e-06, -0.0002648866034, -0.0003283186851, -3.430750435e-06],
    [1.035027785, 2.253247913e-05, -0.0002159244386, -0.0002605120169, -1.61015084e-06],
    [1.25763647, 1.073334083e-05, -7.763360039e-05, -7.836096923e-05, 1.871521842e-06],
    [1.56025304, 2.680528703e-05, -6.11467317e-05, -6.725435429e-05, 4.14970965e-06],
]
GIVEN = {"soft": ((1e4, 0.006, 2.0), SOFT), "stiff": ((1e5, 0.01, 0.5), STIFF)}
STEP = 1e-4


def on_springs(machine: str, *more: str) -> Scene:
    k, height, torque = GIVEN[machine][0]
    return scene_from_toml(ON_SPRINGS, ".", [
        f"parameters={{k={{nominal={k}}},k2={{nominal={2 * k}}},k3={{nominal={3 * k}}},height={{nominal={height}}}}}",
        f"effects.motor={{type='torque',joint='hub',table=[[0.0,0.0],[0.02,{torque}]]}}", *more,
        *(f"outputs.{point}_{axis}={{type='position',point='rod:{point}',axis='{axis}'}}"
          for point in ("hinge", "middle", "tip") for axis in "xy"),
    ])  # fmt: skip


def test_a_reduced_run_on_soft_mounts_estimates_what_it_is_off_by() -> None:
    """The whole machine turns with its frame, by 0.02 rad, and with static stretching the rod, which bends by a third
    of its radius of gyration, is known to 0.02 % in small steps.

    Estimates are of the error with what the step does wrong, so that the full-order run has an eighth of it: with equal
    steps, both runs are wrong by the same 2e-4, beside which the error of the frame in the model is small."""
    bent = "outputs.bent={type='deformation',point='rod:middle',axis='y',frame='body'}"
    fine = motion("full", on_springs("soft", bent, f"simulation.step={STEP / 8}")).outputs
    without = {"theta": 6e-5, "x": 3e-4, "y": 1.5e-3, "right": 2e-3, "bent": 0.015}
    stretched = {"theta": 1.2e-5, "x": 1e-4, "y": 7e-5, "right": 7e-5, "bent": 2e-3}
    in_small_steps = {"theta": 3e-6, "x": 1e-5, "y": 1e-5, "right": 2e-5, "bent": 4e-4}
    for more, parts, allowed in (((), 1, without), (SECOND, 1, stretched), (SECOND, 4, in_small_steps)):
        found = trajectory("reduced", on_springs("soft", bent, *more, f"simulation.step={STEP / parts}"))
        for name, share in allowed.items():
            full = fine[name][:: 8 // parts]
            true = np.max(np.abs(found.outputs[name] - full))
            assert true < share * np.max(np.abs(full)), (name, true)
            assert true / 1.5 < found.errors.maximum(name) < 1.5 * true, (name, true)


@pytest.mark.parametrize(
    ("machine", "model", "more", "allowed"),
    [
        ("soft", "full", (), 5 * (1e-6,)),
        # Exudyn begins with the accelerations at time zero: the rod's vibration is another one by 6e-6 of its bend
        ("stiff", "full", (), (*4 * (1e-6,), 1e-5)),
        # linear in frames of bodies; the step's own error is not that of Exudyn's coordinates, nor is the start
        ("soft", "components", (), (3e-5, 2e-4, 1e-4, 1e-4, 0.08)),
        ("stiff", "components", (), (3e-7, 1e-6, 1.5e-6, 1.5e-6, 2e-4)),
        # the rod's bend is that of a beam without what the forces along it do
        ("soft", "reduced", (), (1e-4, 5e-4, 1e-3, 2e-3, 0.07)),
        ("soft", "reduced", SECOND, (1e-4, 3e-4, 2e-4, 2e-4, 5e-3)),
        ("stiff", "reduced", (), (1e-6, 1e-4, 3e-5, 3e-5, 5e-3)),
        ("stiff", "reduced", SECOND, (1e-6, 3e-5, 3e-6, 3e-6, 1e-3)),
    ],
)
def test_a_slider_crank_on_a_frame_on_springs(machine: str, model: str, more: tuple, allowed: tuple) -> None:
    expected, scene = GIVEN[machine][1], on_springs(machine, *more)
    run = {name: values[200::200] for name, values in motion(model, scene).outputs.items()}
    hinge, middle, tip = (np.stack([run[f"{p}_x"], run[f"{p}_y"]]) for p in ("hinge", "middle", "tip"))
    (along, up), (x, y) = tip - hinge, middle - hinge
    found = np.stack(
        [run["theta"], run["x"], run["y"], run["right"], (along * y - up * x) / np.hypot(along, up)], axis=1
    )
    errors = np.abs(found - expected).max(axis=0) / np.abs(expected).max(axis=0)
    assert np.all(errors < allowed), errors


# A wheel drives the crank of a four-bar through gears, and the pin of its knee is loose: it falls and bounces at first,
# and rubs. Exudyn has its beams in the plane, a constraint of two rotations, and the force of the pin as a function in
# Python, which it takes to the ends of steps and not to the edge of the contact. After 20, 40, .. 100 ms: crank's angle
# (rad), way of the rocker (rad), contact and friction (N), torque of the gears on the crank (N m), coupler's middle (m)
LOOSE = HEADER + tables("""
ground.points: motor = [-0.1, 0.0]; pivot = [0.4, 0.0]
bodies.wheel: rigid = { mass = 0.5, inertia = 4e-4, points = { hub = [0.0, 0.0] } };
    placement = { origin = [-0.1, 0.0], angle = 0.0 }
bodies.crank: line = { length = 0.12, elements = 3 }; element = "beam2d"; material = "steel";
    section = { shape = "rectangle", width = 0.01, height = 0.012 };
    placement = { origin = [0.0, 0.0], angle = 1.5707963267948966 }
bodies.coupler: line = { length = 0.45, elements = 6 }; element = "beam2d"; material = "steel";
    section = { shape = "rectangle", width = 0.01, height = 0.006 }; placement = { origin = [0.0, 0.12], angle = 0.35 }
bodies.rocker: line = { length = 0.3, elements = 4 }; element = "beam2d"; material = "steel";
    section = { shape = "rectangle", width = 0.01, height = 0.006 }; placement = { origin = [0.4, 0.0], angle = 1.5 }
joints.motor: type = "revolute"; connect = ["ground:motor", "wheel:hub"]
joints.shaft: type = "revolute"; connect = ["ground:origin", "crank:hinge"]
joints.elbow: type = "revolute"; connect = ["crank:tip", "coupler:hinge"]
joints.knee: type = "revolute"; connect = ["coupler:tip", "rocker:tip"]
joints.knee.clearance: radius = 1e-4; stiffness = 5e8; restitution = 0.3; restitution_speed = 0.1;
    friction = 0.1; friction_speed = 1e-2
joints.pivot: type = "revolute"; connect = ["ground:pivot", "rocker:hinge"]
joints.mesh: type = "gear"; joints = ["motor", "shaft"]; ratio = -0.5
coordinates.theta: joint = "shaft"; range = [0.0, 6.283185307179586]; periodic = true
effects.weight: type = "gravity"; acceleration = 9.81
effects.motor: type = "torque"; joint = "motor"; table = [[0.0, 0.0], [0.1, -0.4]]
effects.load: type = "joint_damping"; joint = "shaft"; coefficient = 0.04
reduction: modes = 6; static_modes = true; second_order = true; angles = 48
simulation: duration = 0.1; step = 2e-5
simulation.initial.theta: position = 1.5707963267948966
outputs.theta: type = "angle"; joint = "shaft"
outputs.rocker: type = "angle"; joint = "pivot"
outputs.knee: type = "joint_force"; joint = "knee"
outputs.mesh: type = "joint_torque"; joint = "mesh"
outputs.x: type = "position"; point = "coupler:middle"; axis = "x"
outputs.y: type = "position"; point = "coupler:middle"; axis = "y"
""")
OF_LOOSE = [
    [1.572538485, 0.0003314555221, 2.741317983, 0.2106807799, 0.2061223469, 0.2097421649],
    [1.583431933, 0.004910201356, 2.298070163, 0.1674453324, 0.204803391, 0.2097560775],
    [1.612875167, 0.01685575586, 1.342947553, 0.449576088, 0.2012067447, 0.2098186681],
    [1.668953508, 0.04016634206, 2.000630747, 0.4764856471, 0.1943994157, 0.2095633352],
    [1.758899049, 0.07764421881, 1.409289976, 0.6506703649, 0.1834008243, 0.2087554739],
]


def beside(model: str, scene: Scene, expected: list, every: int, ways: tuple[str, ...] = ()) -> np.ndarray:
    """Return the largest differences of outputs, of some the ways from the start on, from rows that are so many steps
    apart, as shares of the largest values in these."""
    outputs = motion(model, scene).outputs
    found = (values[every::every] - (values[0] if name in ways else 0.0) for name, values in outputs.items())
    return np.abs(np.stack([*found], axis=1) - expected).max(axis=0) / np.abs(expected).max(axis=0)


# Axes that carry axes: a carriage on a rail, a slide on it that goes up and down, and a beam on that, with a tool. A
# servo with limits moves the carriage, and one the beam's tip. Exudyn has the states of both in differential equations
# of first order, in the same scheme, and their forces as functions in Python. After 60, 120, .. 300 ms: carriage (m),
# tip (m), force across the slide's rail (N), weight on the carriage's (N), moment in the flange (N m)
AXES = HEADER + tables("""
bodies.bridge: rigid = { mass = 20.0, inertia = 0.8, points = { foot = [0.0, 0.0], rail = [0.1, 0.2] } }
bodies.slide: rigid = { mass = 6.0, inertia = 0.05, points = { shoe = [0.0, 0.0], flange = [0.08, -0.05] } };
    placement = { origin = [0.1, 0.2], angle = 0.0 }
bodies.arm: line = { length = 0.6, elements = 6 }; element = "beam2d"; material = "steel";
    section = { shape = "rectangle", width = 0.02, height = 0.02 }; placement = { origin = [0.18, 0.15], angle = 0.0 }
joints.x: type = "prismatic"; connect = ["ground:origin", "bridge:foot"]; axis = [1.0, 0.0]
joints.y: type = "prismatic"; connect = ["bridge:rail", "slide:shoe"]; axis = [0.0, 1.0]
joints.flange: type = "fixed"; connect = ["slide:flange", "arm:hinge"]
coordinates.x: joint = "x"; range = [-0.1, 0.6]
coordinates.y: joint = "y"; range = [-0.1, 0.4]
effects.weight: type = "gravity"; acceleration = 9.81
effects.tool: type = "point_mass"; point = "arm:tip"; mass = 1.5
controllers.along: type = "pid"; measures = "x"; joint = "x"; limits = [-1200.0, 1200.0];
    reference = { table = [[0.0, 0.0], [0.05, 0.0], [0.25, 0.4]] };
    gains = { p = 2e5, i = 1e6, d = 3e3, filter = 2e-3 }
controllers.up: type = "pid"; measures = "tip_y"; joint = "y";
    reference = { table = [[0.0, 0.15], [0.1, 0.15], [0.35, 0.35]] };
    gains = { p = 4e3, i = 5e4, d = 1e2, filter = 5e-3 }
reduction: modes = 4; static_modes = true; inertia_modes = true; angles = 6
simulation: duration = 0.3; step = 1e-4
outputs.x: type = "displacement"; point = "bridge:foot"; axis = "x"
outputs.tip_x: type = "position"; point = "arm:tip"; axis = "x"
outputs.tip_y: type = "position"; point = "arm:tip"; axis = "y"
outputs.across: type = "joint_force"; joint = "y"; component = "x"
outputs.weight: type = "joint_force"; joint = "x"; component = "y"
outputs.flange: type = "joint_torque"; joint = "flange"; component = "z"
""")
OF_AXES = [
    [0.001966895666, 0.7819654389, 0.1368099067, 433.4195881, 296.0797748, 15.08110537],
    [0.09955778699, 0.8795518359, 0.1262921292, 381.8009362, 511.4878369, 59.13127353],
    [0.2689175329, 1.048917607, 0.1854766481, -363.9069541, 438.4517128, 25.05253567],
    [0.3810696454, 1.161069231, 0.2963093806, 9.689842745, 165.1634613, 12.73573814],
    [0.4505503823, 1.230547578, 0.3649501104, -383.8729691, 48.06474678, -46.87165514],
]

LOOSE_PIN, CARRIED_AXES = (LOOSE, OF_LOOSE, 1000, ("rocker",)), (AXES, OF_AXES, 600)


@pytest.mark.parametrize(
    ("machine", "model", "allowed"),
    [
        (LOOSE_PIN, "full", (1e-8, 1e-6, 1e-3, 1e-3, 1e-8, 1e-8)),
        (LOOSE_PIN, "components", (1e-6, 1e-4, 3e-2, 5e-3, 1e-6, 3e-6)),
        (LOOSE_PIN, "reduced", (1e-5, 1e-4, 2e-2, 6e-2, 1e-5, 3e-6)),
        (CARRIED_AXES, "full", (1e-6, 1e-6, 1e-6, 2e-4, 1e-6, 1e-5)),
        (CARRIED_AXES, "components", (1e-6, 1e-5, 5e-5, 5e-3, 5e-4, 5e-3)),
        (CARRIED_AXES, "reduced", (5e-6, 3e-5, 2e-4, 1e-2, 1e-3, 1e-2)),
    ],
    ids=[f"{machine}-{model}" for machine in ("a loose pin", "axes") for model in ("full", "components", "reduced")],
)
def test_gears_with_a_loose_pin_and_axes_under_servos(machine: tuple, model: str, allowed: tuple) -> None:
    text, *expected = machine
    errors = beside(model, scene_from_toml(text, "."), *expected)
    assert np.all(errors < allowed), errors


# A rigid column that turns, and two slender beams behind hinges, the first with a section that is askew by 30 degrees,
# so that it bends aside where it is lifted. Exudyn's beams take no coupled stiffness: its frames of nodes are askew.
# After 30, 60, .. 150 ms, for each number of elements: angles (rad), tip aside and up (m), force (N) and moment (N m)
# in the shoulder
C, S = float(np.cos(np.pi / 6)), float(np.sin(np.pi / 6))
ARM = HEADER + tables(f"""
bodies.column.rigid: mass = 3.0; centre = [0.0, 0.0, 0.15]; inertia = [0.02, 0.02, 0.01, 0.0, 0.0, 0.0];
    points = {{ foot = [0.0, 0.0, 0.0], shoulder = [0.0, 0.0, 0.3] }}
bodies.upper: line = {{ length = 0.5, elements = 2 }}; element = "beam3d"; orientation = [0.0, {-S}, {C}];
    placement = {{ origin = [0.0, 0.0, 0.3] }}
bodies.upper.section: shape = "coefficients3d"; axial = 2.1e7; shear_2 = 6e6; shear_3 = 5e6; torsion = 207.0;
    bending_2 = 175.0; bending_3 = 1575.0; line_density = 0.81; rotary_2 = 6.75e-6; rotary_3 = 6.075e-5
bodies.fore: line = {{ length = 0.4, elements = 2 }}; element = "beam3d"; orientation = [0.0, 0.0, 1.0];
    placement = {{ origin = [0.5, 0.0, 0.3] }}
bodies.fore.section: shape = "coefficients3d"; axial = 1.4e7; shear_2 = 4e6; shear_3 = 4e6; torsion = 90.0;
    bending_2 = 120.0; bending_3 = 120.0; line_density = 0.54; rotary_2 = 5e-6; rotary_3 = 5e-6
joints.waist: type = "revolute"; connect = ["ground:origin", "column:foot"]; axis = [0.0, 0.0, 1.0]
joints.shoulder: type = "revolute"; connect = ["column:shoulder", "upper:hinge"]; axis = [0.0, 1.0, 0.0]
joints.elbow: type = "revolute"; connect = ["upper:tip", "fore:hinge"]; axis = [0.0, 1.0, 0.0]
coordinates.yaw: joint = "waist"; range = [-0.1, 0.2]
coordinates.lift: joint = "shoulder"; range = [-0.2, 0.1]
coordinates.bend: joint = "elbow"; range = [-0.1, 0.3]
effects.hand: type = "point_mass"; point = "fore:tip"; mass = 1.0
effects.first: type = "torque"; joint = "waist"; table = [[0.0, 0.0], [0.06, 8.0], [0.12, 8.0], [0.2, -8.0]]
effects.second: type = "torque"; joint = "shoulder"; table = [[0.0, 0.0], [0.06, -3.0]]
effects.third: type = "torque"; joint = "elbow"; table = [[0.0, 0.0], [0.06, -1.0]]
reduction: modes = 8; static_modes = true
simulation: duration = 0.15; step = 1e-4
outputs.yaw: type = "angle"; joint = "waist"
outputs.lift: type = "angle"; joint = "shoulder"
outputs.bend: type = "angle"; joint = "elbow"
outputs.aside: type = "position"; point = "fore:tip"; axis = "y"
outputs.up: type = "position"; point = "fore:tip"; axis = "z"
outputs.force: type = "joint_force"; joint = "shoulder"
outputs.moment: type = "joint_torque"; joint = "shoulder"
""")
OF_ARM = np.array([
    [0.007296150244, -0.003135387886, -0.001219353469, 0.0002957757715, 0.3001604183, 4.448402488, 4.150840476],
    [0.01781441113, -0.01237774228, 0.0093224856, 0.003989255368, 0.3012663624, 9.834990466, 8.294190164],
    [0.0276694715, -0.03054355017, 0.04434870659, 0.01415078335, 0.3041067414, 10.80120869, 7.688708649],
    [0.0454959696, -0.06063782374, 0.1008704211, 0.03101445313, 0.3088756491, 12.54276007, 7.543609],
    [0.062309617, -0.09853799559, 0.1774854841, 0.05400111839, 0.3156753534, 7.72252725, 1.364688361],
    [0.007413856703, -0.003099979811, -0.001358270292, 0.0002797812286, 0.3001612705, 4.006584071, 4.024665486],
    [0.01776775072, -0.01229228676, 0.009180695562, 0.003980939974, 0.3012677245, 9.745274632, 8.135729995],
    [0.02735761886, -0.03052238116, 0.04437750323, 0.01417744613, 0.3041075721, 12.63040322, 7.965134794],
    [0.04535913321, -0.06058306201, 0.1008494794, 0.03101820515, 0.3088761103, 12.70419183, 7.428108136],
    [0.06302404585, -0.09866945582, 0.1771798221, 0.05396106907, 0.3156749036, 6.67345837, 1.398998867],
    [0.007454197323, -0.003098802723, -0.001406910874, 0.0002762790057, 0.3001614201, 4.050538495, 4.041655704],
    [0.01769444686, -0.01224391001, 0.009167788678, 0.003979377728, 0.3012680442, 9.525756061, 7.995452272],
    [0.02721559408, -0.03047812684, 0.04441811781, 0.01418289019, 0.3041077497, 12.60111684, 7.852094056],
    [0.04556895376, -0.06068010403, 0.1007598649, 0.03101673399, 0.3088762926, 13.42094387, 7.756346742],
    [0.06344693748, -0.09881411421, 0.177046143, 0.0539471658, 0.3156751904, 6.640097727, 1.71805939],
]).reshape(3, 5, 7)  # fmt: skip


@pytest.mark.parametrize(
    ("model", "allowed"),
    [
        ("full", (2e-6, 4e-6, 6e-6, 5e-7, 1e-7, 1e-3, 3e-5)),
        # deformations are linear in floating frames, whatever the mesh; the beams' own vibrations are in the force
        ("components", (1.5e-4, 3e-4, 3e-4, 3e-5, 5e-6, 6e-3, 2e-3)),
    ],
)
def test_an_arm_in_space_with_a_section_askew(model: str, allowed: tuple) -> None:
    errors = []
    for elements, expected in zip((2, 4, 8), OF_ARM):
        meshes = (f"bodies.{body}.line.elements={elements}" for body in ("upper", "fore"))
        errors.append(beside(model, scene_from_toml(ARM, ".", [*meshes]), expected, 300))
    assert np.all(errors[-1] < allowed), errors
    if model == "full":  # of second order in the elements' length would be 16
        assert np.all(errors[0][:5] > 10.0 * errors[-1][:5]), errors
