"""Two machines beside another multibody program, Exudyn 1.13.6 (doi.org/10.1007/s11044-023-09937-1).

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
