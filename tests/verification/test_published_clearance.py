"""Published mechanisms with clearance: a slider-crank with a loose guide, and a four-bar with three loose pins.

The slider-crank is that of Flores, Leine and Glocker (2010, Multibody Syst. Dyn. 23, 165-190), table 1.

Rigid bodies, and a block of four corners in a guide with 1 mm above and below, restitution 0.4 and friction 0.01. Here
the block's ends are two joints with clearance. There contact is rigid, by Newton's and Coulomb's laws for measures, and
steps are Moreau's. Two histories are at hand:

- what ships with the tutorials of Siconos (`examples/mechanics/SliderCrank`, projected steps of 0.1 ms), of which
  `PUBLISHED` is a part. Its energy grows, by 1 % in the free flight before the first impact and by 15 % over the run,
  although nothing drives it: it is compared as far as that matters little;
- `moreau`, the midpoint rule of the paper, written here from its equations with steps of 2 us, whose energy falls.

What differs then is the contact. It lasts some 0.1 ms here, and the restitution hangs on the speed of the impact: the
block rebounds to other heights, and where restitution is small to almost none.
"""

from functools import cache

import numpy as np
import pytest
from machine_scenes import run
from numba import njit
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicHermiteSpline

from pgmp_petsc.scene import Scene, scene_from_toml
from scenes import tables

NUMBERS = 'radius = 1e-3, stiffness = 1e10, restitution = "e", restitution_speed = 0.5, friction = 0.01'
LOOSE = f"clearance = {{ {NUMBERS}, friction_speed = 0.1 }}"
SCENE = tables(f"""
scene: name = "loose_guide"
parameters.e: nominal = 0.4
bodies.crank.rigid: mass = 0.038; centre = [0.0765, 0.0]; inertia = 7.4e-5
bodies.crank.rigid.points: hub = [0.0, 0.0]; tip = [0.153, 0.0]
bodies.rod: placement = {{ origin = [0.153, 0.0] }}
bodies.rod.rigid: mass = 0.038; centre = [0.153, 0.0]; inertia = 5.9e-4
bodies.rod.rigid.points: hub = [0.0, 0.0]; tip = [0.306, 0.0]
bodies.slider: placement = {{ origin = [0.459, 0.0] }}
bodies.slider.rigid: mass = 0.076; centre = [0.0, 0.0]; inertia = 2.7e-6
bodies.slider.rigid.points: pin = [0.0, 0.0]; left = [-0.05, 0.0]; right = [0.05, 0.0]
joints.main: type = "revolute"; connect = ["ground:origin", "crank:hub"]
joints.knee: type = "revolute"; connect = ["crank:tip", "rod:hub"]
joints.wrist: type = "revolute"; connect = ["rod:tip", "slider:pin"]
joints.left: type = "point_on_line"; connect = ["ground:origin", "slider:left"]; direction = [1.0, 0.0]; {LOOSE}
joints.right: type = "point_on_line"; connect = ["ground:origin", "slider:right"]; direction = [1.0, 0.0]; {LOOSE}
coordinates.theta: joint = "main"; range = [0.0, 6.283185307179586]; periodic = true
effects.weight: type = "gravity"; acceleration = 9.81
simulation: duration = 0.12; step = 5e-6; initial = {{ theta = {{ position = 0.0, velocity = 150.0 }} }}
outputs.speed: type = "speed"; joint = "main"
outputs.y: type = "position"; point = "slider:pin"; axis = "y"
outputs.left: type = "position"; point = "slider:left"; axis = "y"
""")
ROOM = 1e-3
# time (s), height of the slider's middle over its room, speed of the crank (rad/s): until it is about to impact twice
PUBLISHED = np.array([
    (0.0, 0.0, 150.0), (0.0005, 0.0102, 146.89), (0.001, 0.0771, 139.23), (0.0015, 0.2337, 129.9),
    (0.002, 0.4871, 120.82), (0.0025, 0.8302, 112.79), (0.0027, 0.9901, 109.92), (0.0033, 0.8845, 101.19),
    (0.0043, 0.7606, 91.29), (0.0053, 0.8204, 84.21), (0.0062, 0.9919, 79.48),
])  # fmt: skip


def loose(*overrides: str) -> Scene:
    """Return the slider-crank."""
    return scene_from_toml(SCENE, ".", overrides)


L1, L2, M1, M2, M3, J1, J2, J3, G = 0.153, 0.306, 0.038, 0.038, 0.076, 7.4e-5, 5.9e-4, 2.7e-6, 9.81
COUPLED, LENGTH, HEIGHT = (M2 / 2 + M3) * L1 * L2, 0.05, 0.025


def inertia(q):
    """Return what couples the speeds of crank and rod, (first, both, second); the slider turns by itself."""
    first, second = J1 + (M1 / 4 + M2 + M3) * L1**2, J2 + (M2 / 4 + M3) * L2**2
    return first, COUPLED * np.cos(q[1] - q[0]), second


def force(q, v):
    skew = COUPLED * np.sin(q[0] - q[1])
    first = -skew * v[1] ** 2 - (M1 / 2 + M2 + M3) * G * L1 * np.cos(q[0])
    return first, skew * v[0] ** 2 - (M2 / 2 + M3) * G * L2 * np.cos(q[1])


compiled_inertia, compiled_force = njit(cache=True)(inertia), njit(cache=True)(force)


@njit(cache=True)
def answer(masses, one, other, third):
    """Return the velocities that an impulse makes."""
    first, both, second = masses
    share = first * second - both**2
    return (second * one - both * other) / share, (first * other - both * one) / share, third / J3


@njit(cache=True)
def along(row, velocity):
    return row[0] * velocity[0] + row[1] * velocity[1] + row[2] * velocity[2]


@njit(cache=True)
def moreau(step, duration, restitution, friction, every):
    """Return angles of crank, rod and slider and their speeds, (n, 6), after every so many steps of the midpoint rule.

    In the middle of a step corners are closed or not; impulses of those that are closed follow by Gauss and Seidel's
    iteration of the inclusions. Numbers one by one: products of small matrices take seconds to compile."""
    n = int(round(duration / step))
    found = np.empty(((n - 1) // every + 1, 6))
    q, v = (0.0, 0.0, 0.0), (150.0, -75.0, 0.0)
    w, answers, delassus = np.zeros((8, 3)), np.zeros((8, 3)), np.zeros((8, 8))
    impulses, before, without = np.zeros(8), np.zeros(8), np.zeros(8)
    for number in range(n):
        if number % every == 0:
            row = found[number // every]
            row[0], row[1], row[2], row[3], row[4], row[5] = q[0], q[1], q[2], v[0], v[1], v[2]
        middle = q[0] + step / 2 * v[0], q[1] + step / 2 * v[1], q[2] + step / 2 * v[2]
        masses, free = compiled_inertia(middle), v
        for _ in range(4):  # forces at the mean of both velocities
            one, other = compiled_force(middle, ((v[0] + free[0]) / 2, (v[1] + free[1]) / 2))
            rate = answer(masses, one, other, 0.0)
            free = v[0] + step * rate[0], v[1] + step * rate[1], v[2]
        y, m = L1 * np.sin(middle[0]) + L2 * np.sin(middle[1]), 0
        s, c = np.sin(middle[2]), np.cos(middle[2])
        for corner in range(4):
            x, side = (-LENGTH, LENGTH)[corner % 2], 1.0 if corner < 2 else -1.0
            up = side * HEIGHT
            if ROOM + HEIGHT - side * (y + x * s + up * c) <= 0.0:
                across, rubs = w[2 * m], w[2 * m + 1]
                across[0], across[1] = -side * L1 * np.cos(middle[0]), -side * L2 * np.cos(middle[1])
                across[2] = -side * (x * c - up * s)
                rubs[0], rubs[1] = -L1 * np.sin(middle[0]), -L2 * np.sin(middle[1])
                rubs[2] = -x * s - up * c
                m += 1
        for i in range(2 * m):
            impulses[i], before[i], without[i] = 0.0, along(w[i], v), along(w[i], free)
            answers[i, 0], answers[i, 1], answers[i, 2] = answer(masses, w[i, 0], w[i, 1], w[i, 2])
            for j in range(2 * m):
                delassus[i, j] = along(w[j], answers[i])
        for _ in range(1000):
            changed, largest = 0.0, 0.0
            for i in range(2 * m):
                last, approach = impulses[i], without[i]
                for j in range(2 * m):
                    approach += delassus[i, j] * impulses[j]
                if i % 2 == 0:
                    impulses[i] = max(0.0, last - (approach + restitution * before[i]) / delassus[i, i])
                else:
                    most = friction * impulses[i - 1]
                    impulses[i] = min(max(last - approach / delassus[i, i], -most), most)
                changed, largest = changed + abs(impulses[i] - last), largest + abs(impulses[i])
            if changed <= 1e-12 * largest:
                break
        v = free
        for i in range(2 * m):
            own, of = impulses[i], answers[i]
            v = v[0] + own * of[0], v[1] + own * of[1], v[2] + own * of[2]
        q = middle[0] + step / 2 * v[0], middle[1] + step / 2 * v[1], middle[2] + step / 2 * v[2]
    return found


@cache
def moreaus_history(restitution: float) -> np.ndarray:
    """Return angles and their speeds, (6, n), every 0.1 ms."""
    return moreau(2e-6, 0.12, restitution, 0.01, 50).T


def height(q: np.ndarray) -> np.ndarray:
    """Return that of the slider's middle over its room."""
    return (L1 * np.sin(q[0]) + L2 * np.sin(q[1])) / ROOM


def energy(q: np.ndarray, v: np.ndarray) -> float:
    potential = (M1 / 2 + M2 + M3) * G * L1 * np.sin(q[0]) + (M2 / 2 + M3) * G * L2 * np.sin(q[1])
    first, both, second = inertia(q)
    return 0.5 * (first * v[0] ** 2 + second * v[1] ** 2 + J3 * v[2] ** 2) + both * v[0] * v[1] + potential


def test_before_the_first_impact_it_is_free():
    """Against scipy's integrator: the slider rises to its room in 2.7 ms."""
    times, found = run(loose("simulation.duration=2.7e-3"), "full")

    def rates(t, state):
        first, both, second = inertia(state)
        return [*state[2:], *np.linalg.solve([[first, both], [both, second]], force(state, state[2:]))]

    exact = solve_ivp(rates, (0, times[-1]), [0, 0, 150, -75], "DOP853", times, rtol=1e-11, atol=1e-13).y
    free = found["y"] / ROOM < 0.999
    assert np.abs(found["y"] / ROOM - height(exact[:2]))[free].max() < 1e-4
    assert np.abs(found["speed"] - exact[2])[free].max() < 1e-4 * 150.0 and 0.98 < found["y"].max() / ROOM


def test_the_history_of_siconos_up_to_the_second_impact():
    """Until the first impact within 0.02 of the room, by the energy that the published run gains. Then by when in a
    step of 0.1 ms its impact is, (0.86 + 0.34) m/s times that: 0.12 of the room. The crank's speed by that energy, of
    which 1.3 % are gained in the end, and by where the crank is then."""
    fast = [f"joints.{side}.clearance.restitution_speed=0.86" for side in ("left", "right")]  # that of the impact
    times, found = run(loose("simulation.duration=6.2e-3", *fast), "full")
    y, speed = (np.interp(PUBLISHED[:, 0], times, values) for values in (found["y"] / ROOM, found["speed"]))
    off, before = np.abs(y - PUBLISHED[:, 1]), PUBLISHED[:, 0] <= 2.7e-3
    assert off[before].max() < 0.02 and off.max() < 0.12
    np.testing.assert_allclose(speed, PUBLISHED[:, 2], rtol=0.02)


@pytest.mark.parametrize(("restitution", "damping", "most", "mean", "speed"), [
    (0.05, "hunt_crossley", 0.04, 0.015, 2.5), (0.4, "hysteresis", 0.15, 0.04, 5.0),
    pytest.param(0.4, "hunt_crossley", 0.8, 0.2, 5.0, marks=pytest.mark.thorough),
])  # fmt: skip
def test_histories_of_moreaus_rule_over_revolutions(restitution, damping, most, mean, speed):
    """With a small restitution, whose rebounds nobody sees, heights are the same but for how deep contact is (0.02 of
    the room); with 0.4 rebounds of other speeds differ, by a part of their height, unless impacts of all speeds lose
    alike. The crank's speed is off by what a jump of some 0.1 ms is late, and by what rebounds lose."""
    exact = moreaus_history(restitution)
    step = 5e-6 if damping == "hunt_crossley" else 2e-6  # of which the turn of a hysteresis at 0.2 m/s takes some
    held = [f"joints.{side}.clearance.damping='hysteresis'" for side in ("left", "right")]
    held += [f"joints.{side}.clearance.restitution_speed=0.2" for side in ("left", "right")]
    more = held if damping == "hysteresis" else []
    every = int(round(1e-4 / step))  # both every 0.1 ms
    _, found = run(loose(f"parameters.e.nominal={restitution}", f"simulation.step={step}", *more), "full", every)
    off = np.abs(found["y"][:-1] / ROOM - height(exact[:2]))
    assert off.max() < most and np.sqrt(np.mean(off**2)) < mean, (off.max(), np.sqrt(np.mean(off**2)))
    assert np.abs(found["speed"][:-1] - exact[3]).max() < speed < 0.04 * 150.0
    np.testing.assert_array_equal(found["left"], found["y"])  # both corners touch at once, it does not tilt
    energies = [energy(row[:3], row[3:]) for row in exact[:, ::100].T]
    assert np.all(np.diff(energies) < 1e-6) and energies[-1] < 0.97 * energies[0]


# The four-bar of the tutorials of Siconos (`examples/mechanics/FourBarLinkageWith3clearance`, as it ships), with room
# of 5 mm in three pins, restitution 0 and friction 0.1: time (s), crank (rad) and its speed, coupler, rocker, and where
# the coupler's pin is in the crank's bore and the rocker's from that of the ground (m)
FOUR_BAR = np.array([
    (0.00, 1.570824, 0.000000, 0.353284, 1.26487, -0.00000, 0.00000, 0.00000, 0.00000),
    (0.05, 1.667922, 4.395042, 0.359791, 1.30537, 0.00490, 0.00102, 0.00012, -0.00500),
    (0.10, 1.985175, 7.926076, 0.400993, 1.45645, 0.00443, 0.00231, 0.00398, -0.00302),
    (0.15, 2.431353, 9.923161, 0.479953, 1.65737, -0.00489, 0.00103, -0.00110, 0.00488),
    (0.20, 2.944229, 10.490447, 0.589950, 1.83865, -0.00489, -0.00106, -0.00161, 0.00473),
    (0.25, 3.469429, 10.432475, 0.722471, 1.96019, -0.00436, -0.00245, -0.00376, 0.00330),
    (0.30, 3.979969, 9.922315, 0.855959, 2.00357, -0.00355, -0.00352, -0.00499, 0.00038),
    (0.35, 4.455763, 9.065955, 0.962198, 1.96826, -0.00283, -0.00412, -0.00487, 0.00115),
    (0.40, 4.882151, 7.953754, 1.013001, 1.86084, -0.00233, -0.00442, -0.00344, 0.00363),
    (0.45, 5.248881, 6.672115, 0.994595, 1.69551, -0.00117, -0.00486, -0.00181, 0.00466),
    (0.50, 5.545613, 5.285016, 0.915803, 1.49966, 0.00454, 0.00209, -0.00031, 0.00499),
    (0.55, 5.776244, 3.887876, 0.807024, 1.30865, 0.00469, 0.00173, -0.00231, -0.00444),
    (0.60, 5.928751, 2.187756, 0.724861, 1.18524, 0.00418, 0.00274, -0.00042, -0.00498),
    (0.65, 5.997105, 0.544061, 0.685947, 1.13147, 0.00425, 0.00263, -0.00101, -0.00490),
    (0.70, 5.982561, -1.115951, 0.693877, 1.14219, 0.00358, 0.00349, -0.00191, -0.00462),
    (0.75, 5.885876, -2.748911, 0.748229, 1.21907, 0.00363, 0.00343, -0.00140, -0.00480),
    (0.80, 5.707564, -4.378236, 0.839538, 1.36285, 0.00348, 0.00359, -0.00063, -0.00496),
    (0.85, 5.448762, -5.952993, 0.938970, 1.55559, 0.00394, 0.00308, 0.00114, -0.00487),
    (0.90, 5.116799, -7.324504, 1.006560, 1.76107, 0.00309, -0.00393, 0.00371, 0.00335),
    (0.95, 4.707143, -8.766845, 0.999644, 1.91413, -0.00168, -0.00471, -0.00472, 0.00165),
    (1.00, 4.238456, -9.985307, 0.918991, 1.99555, -0.00238, -0.00440, -0.00380, 0.00326),
])  # fmt: skip
PINS = "clearance = { radius = 5e-3, stiffness = 1e9, restitution = 0.05, restitution_speed = 0.05, friction = 0.1, "
PINS += "friction_speed = 0.01 }"
CRANK = CubicHermiteSpline(*FOUR_BAR[:, :3].T)
TABLE = [[float(t), float(CRANK(t))] for t in np.linspace(0.0, 1.0, 101)]


def four_bar(pins: str) -> Scene:
    """Return the four-bar, whose crank moves as published: there a controller drives it."""
    crank, coupler, rocker = FOUR_BAR[0, [1, 3, 4]]
    lines = [
        f"bodies.{name}: placement = {{ origin = [{x}, {y}], angle = {angle} }}; rigid = {{ mass = 1.0, centre = "
        f"[{length / 2}, 0.0], inertia = {length**2 / 12}, points = {{ hub = [0.0, 0.0], tip = [{length}, 0.0] }} }}"
        for name, x, y, angle, length in (
            ("crank", 0.0, 0.0, crank, 1.0),
            ("coupler", np.cos(crank), np.sin(crank), coupler, 4.0),
            ("rocker", 3.0, 0.0, rocker, 2.5),
        )
    ]
    ends = {"one": ("crank:tip", "coupler:hub"), "two": ("rocker:tip", "coupler:tip")}
    ends["three"] = ("ground:right", "rocker:hub")
    lines += [f'joints.{name}: type = "revolute"; connect = ["{a}", "{b}"]; {pins}' for name, (a, b) in ends.items()]
    lines += [
        f'outputs.{axis}_{name}: type = "position"; point = "{end.replace("_", ":")}"; axis = "{axis}"'
        for name, end in {"hub": "coupler_hub", "tip": "coupler_tip", "low": "rocker_hub", "top": "rocker_tip"}.items()
        for axis in "xy"
    ]
    text = """
scene: name = "four_bar"
ground.points: right = [3.0, 0.0]
joints.main: type = "revolute"; connect = ["ground:origin", "crank:hub"]
coordinates.theta: joint = "main"; range = [0.0, 6.283185307179586]; periodic = true
effects.weight: type = "gravity"; acceleration = 9.81
simulation: duration = 0.9; step = 5e-5
"""
    text += "\n".join([*lines, f'effects.drive: type = "prescribed_motion"; coordinate = "theta"; table = {TABLE}'])
    return scene_from_toml(tables(text), ".")


def test_the_history_of_a_four_bar_with_three_loose_pins():
    """Up to 0.9 s, when a pin is about to cross its bore: bars are off by a tenth of what room makes of them, and pins
    lean on their bores within a fifth of the room of where they do there, and within 30 degrees as they go round: by
    Coulomb's law for the pins' middles here and for their surfaces there, and by a crank that is known every 50 ms."""
    angles, pins = [], []
    for loose_pins in ("", PINS):
        times, found = run(four_bar(loose_pins), "full")
        at = {name: values[np.minimum(np.searchsorted(times, FOUR_BAR[:, 0] - 1e-9), times.size - 1)]
              for name, values in found.items()}  # fmt: skip
        hub, tip, low, top = (np.array([at[f"x_{name}"], at[f"y_{name}"]]) for name in ("hub", "tip", "low", "top"))
        crank = FOUR_BAR[:, 1]
        pins = [hub - [np.cos(crank), np.sin(crank)], low - [[3.0], [0.0]]]
        angles.append([np.arctan2(*(b - a)[::-1]) for a, b in ((hub, tip), (low, top))])
    known = FOUR_BAR[:, 0] < 0.92
    off = np.abs(np.array(angles) - FOUR_BAR[:, 3:5].T)[:, :, known].max(axis=2)
    assert np.all(off[1] < 0.15 * off[0]) and np.all(off[0] > 8e-3), off
    for pin, own in zip(pins, (FOUR_BAR[:, 5:7].T, FOUR_BAR[:, 7:9].T)):
        apart = np.hypot(*(pin - own))[known]
        assert apart.max() < 2.0 * 5e-3 * np.sin(np.radians(15.0)) and apart.mean() < 0.2 * 5e-3, apart
