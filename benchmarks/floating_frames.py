"""Component models beside Exudyn's floating-frame bodies (CMS) of the same meshes, modes in number, steps and scheme.

    python -m benchmarks.floating_frames --exudyn PYTHON      that imports exudyn

Two machines of `scenes/slider_crank_solid3d.toml` on a coarse mesh over 0.1 s in 400 steps: its slider-crank under
0.5 N m on the crank, and crank and rod as a pendulum that falls from lying along x. Exudyn has Hurty-Craig-Bampton
modes of the same mass and stiffness matrices, with the faces' mean motions (RBE3) as static ones; reduction.modes here
says how many amplitudes a body has in both. Printed are, by amplitudes of crank and rod, largest differences from the
mesh at a quarter of the step as shares of the largest value, and processor time of a run without start-up.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sp
from mpi4py import MPI

import pgmp_petsc as pgmp
from pgmp_petsc.bench.reference import component_model
from pgmp_petsc.bodies.framed_solid import FramedSolid, framed_solid
from pgmp_petsc.mechanism.capabilities import Purpose
from pgmp_petsc.scene import Scene
from pgmp_petsc.studies.inputs import read_scene

ROOT = Path(__file__).parents[1] / "scenes"
END, STEP, FINER, RADIUS = 0.1, 2.5e-4, 4, 0.8
WEIGHT, TORQUE, DAMPING = 9.81, 0.5, 1e-3  # m/s2, N m, s
COARSE = ("-k", "hexahedron20", "-s", "0.1", "-a", "1")

# what runs in Exudyn: its only argument names a file of what is given
EXUDYN = """
import json, sys, time
import numpy as np
import scipy.sparse as sp
import exudyn as exu
from exudyn.itemInterface import *
from exudyn.FEM import FEMinterface, ObjectFFRFreducedOrderInterface, HCBstaticModeSelection
from exudyn.FEM import CSRtoScipySparseCSR, ScipySparseCSRtoCSR

given = json.load(open(sys.argv[1]))
mbs = exu.SystemContainer().AddSystem()
ground = mbs.AddObject(ObjectGround())
markers = {"ground": mbs.AddMarker(MarkerBodyRigid(bodyNumber=ground))}
began = time.process_time()
for name, body in given["bodies"].items():
    fem, data = FEMinterface(), np.load(body["file"])
    fem.nodes = {"Position": data["nodes"]}
    for kind in ("mass", "stiffness"):
        parts = (data[f"{kind}_data"], data[f"{kind}_indices"], data[f"{kind}_indptr"])
        setattr(fem, kind + "Matrix", sp.csr_matrix(parts))
    faces = {point: (data[f"{point}_nodes"], data[f"{point}_weights"]) for point in ("hinge", "tip")}
    fem.ComputeHurtyCraigBamptonModes(
        [nodes.tolist() for nodes, _ in faces.values()], nEigenModes=body["n"] - 6, useSparseSolver=True,
        computationMode=HCBstaticModeSelection.RBE3, boundaryNodesWeights=[weights for _, weights in faces.values()],
    )
    made = ObjectFFRFreducedOrderInterface(fem).AddObjectFFRFreducedOrder(
        mbs, gravity=given["gravity"], stiffnessProportionalDamping=given["damping"])
    for point, (nodes, weights) in faces.items():
        markers[f"{name}:{point}"] = mbs.AddMarker(MarkerSuperElementRigid(
            bodyNumber=made["oFFRFreducedOrder"], meshNodeNumbers=nodes.tolist(), weightingFactors=weights.tolist()))
for one, other, axes in given["joints"]:
    mbs.AddObject(GenericJoint(markerNumbers=[markers[one], markers[other]], constrainedAxes=axes))
if given["torque"]:
    mbs.AddLoad(LoadTorqueVector(markerNumber=markers["crank:hinge"], loadVector=[0.0, 0.0, given["torque"]]))
def sensor(point, kind):
    return mbs.AddSensor(SensorMarker(markerNumber=markers[point], storeInternal=True, outputVariableType=kind))
kinds = exu.OutputVariableType
seen = {"tip": sensor("rod:tip", kinds.Position)}
for point in ("crank:hinge", "crank:tip", "rod:hinge"):
    seen[point] = sensor(point, kinds.Rotation)
mbs.Assemble()
built = time.process_time() - began
settings = exu.SimulationSettings()
of_time = settings.timeIntegration
of_time.numberOfSteps, of_time.endTime, of_time.verboseMode = given["steps"], given["end"], 0
of_time.generalizedAlpha.spectralRadius, of_time.newton.useModifiedNewton = given["radius"], True
settings.solutionSettings.writeSolutionToFile = False
settings.solutionSettings.sensorsWritePeriod = given["end"] / given["steps"]
began = time.process_time()
mbs.SolveDynamic(settings)
took = time.process_time() - began
found = {name: np.array(mbs.GetSensorStoredData(one))[:, 1:].tolist() for name, one in seen.items()}
print(json.dumps({"took": took, "built": built, **found}))
"""


def tables(pendulum: bool, folder: Path) -> dict[str, Any]:
    """Return the tables of one of the machines."""
    found = tomllib.loads((ROOT / "slider_crank_solid3d.toml").read_text())
    angle = {"joint": "elbow", "range": [0.0, 2.0 * np.pi], "periodic": True}
    positions = {axis: {"type": "position", "point": "rod:tip", "axis": axis} for axis in "xy"}
    for name in ("crank", "rod"):
        found["bodies"][name]["mesh"] = str(folder / f"{name}_solid3d.msh")
    found["outputs"] = {**positions, "crank": {"type": "angle", "joint": "crank_hinge"}}
    if pendulum:
        del found["joints"]["slider"]
        found["coordinates"]["elbow"] = angle
        found["outputs"]["elbow"] = {"type": "angle", "joint": "elbow"}
        found["effects"] = {"weight": {"type": "gravity", "acceleration": WEIGHT, "direction": [0.0, -1.0, 0.0]}}
    else:
        found["effects"]["motor"]["table"] = [[0.0, TORQUE], [1.0, TORQUE]]
    found["effects"]["damping"] = {"type": "structural_damping", "stiffness": DAMPING}
    found["simulation"] = {"duration": END, "step": STEP, "spectral_radius": RADIUS, "error_indicator": False}
    return found


def bend(x: np.ndarray, y: np.ndarray, crank: np.ndarray, elbow: np.ndarray | None, lengths: tuple[float, float]):
    """Return how far the rod's tip is from where rigid bodies at the same angles have it, m: along x, or of a pendulum
    across."""
    a, b = lengths
    if elbow is None:
        return x - (a * np.cos(crank) + np.sqrt(b**2 - (a * np.sin(crank)) ** 2))
    return y - (a * np.sin(crank) + b * np.sin(crank + elbow))


def body_file(meshed: FramedSolid, scene: Scene, folder: Path) -> str:
    """Write the matrices and faces of a body; return the file's name."""
    solid, arrays = meshed.solid, {"nodes": meshed.solid.mesh.nodes}
    for kind in ("mass", "stiffness"):
        terms = getattr(solid, kind)(range(solid.mesh.n_nodes))
        whole = sp.csr_matrix(sum(float(weight.evaluate(scene.values)) * part for weight, part in terms.items()))
        arrays |= {f"{kind}_{name}": getattr(whole, name) for name in ("data", "indices", "indptr")}
    for point, frame in meshed.frames.items():
        arrays |= {f"{point}_nodes": frame.nodes, f"{point}_weights": frame.weights}
    file = folder / f"{solid.name}.npz"
    np.savez(file, **arrays)
    return str(file)


def compare(pendulum: bool, counts: list[int], python: str, folder: Path) -> None:
    """Print a line for each number of modes."""
    entries = tables(pendulum, folder)
    fine = {**entries, "simulation": {**entries["simulation"], "step": STEP / FINER}}
    began = time.process_time()
    exact = pgmp.simulate(pgmp.compose(fine, ROOT), model="full").outputs
    title = "pendulum" if pendulum else "slider-crank"
    print(f"{title}: the mesh at {STEP / FINER:g} s, {time.process_time() - began:.0f} s")
    print(
        "| amplitudes | program | tip | deformation | a run | what comes before |\n|---|---|---|---|---|---|",
        flush=True,
    )
    for count in counts:
        source = pgmp.compose({**entries, "reduction": {**entries["reduction"], "modes": count}}, ROOT)
        scene, shapes = read_scene(source, (), (), MPI.COMM_SELF, Purpose.COMPONENTS)
        meshed = {name: framed_solid(scene, name, shapes[name]) for name in ("crank", "rod")}
        places = {name: {p: f.centre for p, f in one.frames.items()} for name, one in meshed.items()}
        lengths = tuple(float(np.linalg.norm(one["tip"] - one["hinge"])) for one in places.values())
        amplitudes = component_model(scene, shapes, MPI.COMM_SELF).n_amplitudes

        def off(x, y, crank, elbow, lengths=lengths):
            steps = slice(None, None, FINER)
            wanted = exact["x"][steps], exact["y"][steps], exact["crank"][steps]
            bent = bend(*wanted, exact["elbow"][steps] if pendulum else None, lengths)
            tip = np.hypot(x - wanted[0], y - wanted[1]).max() / np.hypot(*wanted[:2]).max()
            return tip, np.abs(bend(x, y, crank, elbow, lengths) - bent).max() / np.abs(bent).max()

        def line(program, errors, run, before, n=tuple(amplitudes.values())):
            print(
                f"| {n[0]}, {n[1]} | {program} | {errors[0]:.1e} | {errors[1]:.2%} | {run:.3f} s | {before:.1f} s |",
                flush=True,
            )

        began = time.process_time()
        built = pgmp.build(source, components=True)
        before = time.process_time() - began
        times = []
        for _ in range(3):  # the first loads compiled code
            began = time.process_time()
            run = pgmp.simulate(built)
            times.append(time.process_time() - began)
        own = run.outputs
        line("here", off(own["x"], own["y"], own["crank"], own.get("elbow")), min(times), before)
        held, free = [1, 1, 1, 1, 1, 0], [0, 1, 1, 0, 0, 0]
        joints = [("ground", "crank:hinge", held), ("crank:tip", "rod:hinge", held)]
        given = {
            "bodies": {
                name: {"file": body_file(one, scene, folder), "n": amplitudes[name]} for name, one in meshed.items()
            },
            "joints": joints if pendulum else [*joints, ("ground", "rod:tip", free)],
            "gravity": [0.0, -WEIGHT if pendulum else 0.0, 0.0], "torque": 0.0 if pendulum else TORQUE,
            "steps": round(END / STEP), "end": END, "radius": RADIUS, "damping": DAMPING,
        }  # fmt: skip
        file = folder / "given.json"
        file.write_text(json.dumps(given))
        done = subprocess.run([python, "-c", EXUDYN, str(file)], capture_output=True, text=True, check=False)
        if done.returncode:
            raise SystemExit(done.stdout[-2000:] + done.stderr[-3000:])
        theirs = json.loads(done.stdout.splitlines()[-1])
        tip, crank, end, rod = (np.array(theirs[name]) for name in ("tip", "crank:hinge", "crank:tip", "rod:hinge"))
        elbow = rod[:, 2] - end[:, 2] if pendulum else None
        line("Exudyn", off(tip[:, 0], tip[:, 1], crank[:, 2], elbow), theirs["took"], theirs["built"])


def main() -> None:
    """Print a table for each machine."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.floating_frames", description=__doc__.splitlines()[0])
    parser.add_argument("--exudyn", metavar="PYTHON", required=True, help="an interpreter that imports exudyn")
    parser.add_argument("--modes", type=int, nargs="+", default=[2, 10], help="reduction.modes to try")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        maker = ROOT.parent / "scripts" / "make_solid_meshes"
        subprocess.run([sys.executable, maker, *COARSE, "-o", folder], check=True, capture_output=True)
        for pendulum in (False, True):
            compare(pendulum, given.modes, given.exudyn, Path(folder))


if __name__ == "__main__":
    main()
