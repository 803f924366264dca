"""The flexible slider-crank of SLIDE (Manzl, Humer, Khadim and Gerstmayr, arXiv 2409.18272): errors, and time of a run.

    python -m benchmarks.slide
    python -m benchmarks.slide --exudyn PYTHON      that imports exudyn, to run the same there

The machine is that of their program, https://github.com/peter-manzl/SLIDE: crank 0.5 m, its angle prescribed, at most
8 rad/s and 20 rad/s2 on paths drawn at random; rod 1 m, 4 kg, EI = 13.8 N m2, EA = 414 kN, damped in proportion to its
stiffness; slider 1 kg; 4 s in 2,560 steps. What is compared is the deflection of the rod's middle from the line between
its ends. Printed are differences as shares of the largest deflection, and processor time of a run, without start-up.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import time
from collections.abc import Callable
from typing import Any

import numpy as np

import pgmp_petsc as pgmp
from pgmp_petsc.base.errors import PgmpError

END, STEPS, ROWS = 4.0, 2560, 129
MOST_SPEED, MOST_ACCELERATION = 8.0, 20.0  # rad/s, rad/s2
AXIAL, BENDING, LINE_DENSITY = 4.14e5, 13.8, 4.0  # N, N m2, kg/m
BULKY = (
    1e3  # by which a beam of Bernoulli has more shear stiffness and less rotary inertia: practically rigid, massless
)
DAMPING = 15e-3  # s
POINTS = ("hinge", "middle", "tip")
#: What a reduced model takes of second order in the deformation; see docs/effects.md.
SECOND_ORDER = {"stiffening": {"type": "geometric_stiffening"}, "mode_inertia": {"type": "mode_inertia"}}

# what runs in Exudyn: standard input has the crank's places (m) at the ends of all steps
EXUDYN = """
import json, sys, time
import numpy as np
import exudyn as exu
from exudyn.beams import GenerateStraightLineANCFCable2D
from exudyn.itemInterface import *

given = json.load(sys.stdin)
crank, end, n = np.array(given["crank"]), given["end"], given["elements"]
mbs = exu.SystemContainer().AddSystem()
slide = crank[0, 0] + np.sqrt(1.0 - crank[0, 1] ** 2)
ground = mbs.AddMarker(MarkerNodeCoordinate(nodeNumber=mbs.AddNode(NodePointGround()), coordinate=0))
cable = Cable2D(
    physicsMassPerLength=given["density"], physicsBendingStiffness=given["EI"], physicsAxialStiffness=given["EA"],
    physicsBendingDamping=given["damping"] * given["EI"], physicsAxialDamping=given["damping"] * given["EA"],
)
nodes = GenerateStraightLineANCFCable2D(mbs, [*crank[0], 0.0], [slide, 0.0, 0.0], n, cable)[0]
slider = mbs.AddNode(Point2D(referenceCoordinates=[slide, 0.0]))
mbs.AddObject(MassPoint2D(physicsMass=1.0, nodeNumber=slider))

def marker(node, axis):
    return mbs.AddMarker(MarkerNodeCoordinate(nodeNumber=node, coordinate=axis))

def moved(axis):
    return lambda mbs, t, item, offset: np.interp(t, times, crank[:, axis]) - crank[0, axis]

times = np.linspace(0.0, end, len(crank))
for axis in (0, 1):
    mbs.AddObject(CoordinateConstraint(markerNumbers=[ground, marker(nodes[0], axis)], offsetUserFunction=moved(axis)))
    mbs.AddObject(CoordinateConstraint(markerNumbers=[marker(nodes[-1], axis), marker(slider, axis)]))
mbs.AddObject(CoordinateConstraint(markerNumbers=[ground, marker(slider, 1)]))
seen = [
    mbs.AddSensor(SensorNode(nodeNumber=k, storeInternal=True, outputVariableType=exu.OutputVariableType.Position))
    for k in (nodes[0], nodes[n // 2], nodes[-1])
]
mbs.Assemble()
settings = exu.SimulationSettings()
of_time = settings.timeIntegration
of_time.numberOfSteps, of_time.endTime, of_time.verboseMode = len(crank) - 1, end, 0
of_time.newton.useModifiedNewton, of_time.generalizedAlpha.spectralRadius = True, 0.5
settings.solutionSettings.writeSolutionToFile = False
settings.solutionSettings.sensorsWritePeriod = end / (len(crank) - 1)
began = time.process_time()
mbs.SolveDynamic(settings)
took = time.process_time() - began
found = [mbs.GetSensorStoredData(sensor)[:, 1:3].T.tolist() for sensor in seen]
print(json.dumps({"took": took, "places": found}))
"""


def path(rng: np.random.Generator) -> np.ndarray:
    """Return rows (ROWS, 2) of time (s) and angle (rad): constant speeds, and constant accelerations between them."""
    corners, time_, speed = [(0.0, 0.0)], 0.0, 0.0
    while time_ < END:
        new, rest = rng.uniform(-MOST_SPEED, MOST_SPEED), rng.uniform(0.0, 0.6)
        begins = time_ + abs(new - speed) / (rng.uniform(0.25, 1.0) * MOST_ACCELERATION)
        corners += [(begins, new), (begins + rest, new)]
        time_, speed = begins + rest, new
    fine = np.linspace(0.0, END, 16 * ROWS)
    rates = np.interp(fine, *np.array(corners).T)
    angles = np.concatenate([[0.0], np.cumsum(0.5 * (rates[1:] + rates[:-1])) * fine[1]])
    times = np.linspace(0.0, END, ROWS)
    return np.column_stack([times, 0.7 + np.interp(times, fine, angles)])


def scene(rows: np.ndarray, elements: int = 20, finer: int = 1, shear: float = 1.0, **effects: Any) -> dict[str, Any]:
    """Return the tables of a scene, with the crank turned along a path; `shear` multiplies the stiffness in shear of a
    square section and divides its rotary inertia."""
    section = {
        "shape": "coefficients", "axial": AXIAL, "bending": BENDING, "line_density": LINE_DENSITY,
        "shear": shear * AXIAL / 2.6 * 5.0 / 6.0, "rotary_density": LINE_DENSITY * BENDING / AXIAL / shear,
    }  # fmt: skip
    bend = "((tip_x - hinge_x)*(middle_y - hinge_y) - (tip_y - hinge_y)*(middle_x - hinge_x))"
    positions = {f"{p}_{a}": {"type": "position", "point": f"rod:{p}", "axis": a} for p in POINTS for a in "xy"}
    length = "sqrt((tip_x - hinge_x)**2 + (tip_y - hinge_y)**2)"
    return {
        "scene": {"name": "slide"},
        "bodies": {
            "crank": {
                "rigid": {
                    "mass": 2.0,
                    "centre": [0.25, 0.0],
                    "inertia": 1.0 / 24.0,
                    "points": {"hinge": [0.0, 0.0], "pin": [0.5, 0.0]},
                }
            },
            "rod": {"line": {"length": 1.0, "elements": elements}, "element": "beam2d", "section": section},
        },
        "joints": {
            "main": {"type": "revolute", "connect": ["ground:origin", "crank:hinge"]},
            "pin": {"type": "revolute", "connect": ["crank:pin", "rod:hinge"]},
            "guide": {"type": "point_on_line", "connect": ["ground:origin", "rod:tip"], "direction": [1.0, 0.0]},
        },
        "coordinates": {"theta": {"joint": "main", "range": [0.0, 2.0 * np.pi], "periodic": True}},
        "effects": {
            "drive": {"type": "prescribed_motion", "coordinate": "theta", "table": rows.tolist()},
            "slider": {"type": "point_mass", "point": "rod:tip", "mass": 1.0},
            "damping": {"type": "structural_damping", "stiffness": DAMPING},
            **effects,
        },
        "outputs": {**positions, "deflection": {"type": "formula", "formula": f"{bend} / {length}"}},
        "reduction": {"modes": 4, "angles": 64, "interpolation": "spline", "static_modes": True, "inertia_modes": True},
        "simulation": {"duration": END, "step": END / STEPS / finer, "spectral_radius": 0.5, "error_indicator": False},
    }


def timed(run: Callable[[], Any]) -> tuple[pgmp.Result | None, float, str]:
    """Return a run, None where it stopped, with its processor time (s), and why it stopped."""
    began = time.process_time()
    try:
        found, why = run(), ""
    except PgmpError as error:
        found, why = None, str(error)
    return found, time.process_time() - began, why


def in_exudyn(python: str, full: pgmp.Result, rows: np.ndarray, elements: int) -> tuple[np.ndarray, float]:
    """Return the deflections at the ends of steps, and the processor time, of the same machine in Exudyn."""
    crank = np.column_stack([full.outputs["hinge_x"], full.outputs["hinge_y"]])
    given = {
        "crank": crank.tolist(), "end": END, "elements": elements, "density": LINE_DENSITY, "EI": BENDING,
        "EA": AXIAL, "damping": DAMPING,
    }  # fmt: skip
    done = subprocess.run([python, "-c", EXUDYN], input=json.dumps(given), capture_output=True, text=True, check=True)
    found = json.loads(done.stdout.splitlines()[-1])
    hinge, middle, tip = (np.array(place) for place in found["places"])
    way, arm = tip - hinge, middle - hinge
    return (way[0] * arm[1] - way[1] * arm[0]) / np.hypot(*way), found["took"]


def main() -> None:
    """Print a line for each path."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.slide", description=__doc__.splitlines()[0])
    parser.add_argument("-n", type=int, default=8, help="how many paths")
    parser.add_argument("--exudyn", metavar="PYTHON", help="an interpreter that imports exudyn")
    given = parser.parse_args()
    rng = np.random.default_rng(1)
    paths = [path(rng) for _ in range(given.n)]
    began = time.process_time()
    rom = pgmp.build(pgmp.compose(scene(paths[0], **SECOND_ORDER)))
    print(f"build {time.process_time() - began:.1f} s; the first path's runs load compiled code")
    for rows in paths:
        exact, _, _ = timed(lambda: pgmp.simulate(pgmp.compose(scene(rows, 40, 4)), model="full"))
        full, took, _ = timed(lambda: pgmp.simulate(pgmp.compose(scene(rows)), model="full"))
        deflection = exact.outputs["deflection"][::4]
        largest = np.abs(deflection).max()

        def off(found: np.ndarray, from_what: np.ndarray) -> str:
            return f"{100.0 * np.abs(found - from_what).max() / np.abs(from_what).max():.2g} %"

        line = f"largest {1e3 * largest:.3g} mm; full order, 20 elements: {off(full.outputs['deflection'], deflection)}"
        reduced, its, why = timed(lambda: pgmp.simulate(rom, overrides={"effects.drive.table": rows.tolist()}))
        ended = why if reduced is None else off(reduced.outputs["deflection"], deflection)
        print(f"{line}, {took:.2g} s; reduced: {ended}, {its:.2g} s", flush=True)
        if given.exudyn:
            for elements, finer in ((20, 1), (40, 4)):
                slender = pgmp.simulate(pgmp.compose(scene(rows, elements, finer, BULKY)), model="full")
                other, its = in_exudyn(given.exudyn, slender, rows, elements)
                print(f"  Exudyn, {elements} elements, {finer * STEPS} steps: {its:.2g} s; full order of a beam of "
                      f"Bernoulli from it: {off(slender.outputs['deflection'], other)}", flush=True)  # fmt: skip


if __name__ == "__main__":
    main()
