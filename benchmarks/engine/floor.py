"""How far the steps of a reduced model are from a bare C loop of the same arithmetic (`floor.c`).

    python -m benchmarks.engine.floor ROM.h5 -n 512

For models of one coordinate without local effects and damping. The loop is compiled for the model's sizes, for
registers of several widths, and the fastest counts; it does one correction a step. The program's steps are timed in the
same process, in turns with it, with all that they are: refilled cells, fates of samples, PETSc's TS, states for whoever
looks on. Their time is compared with that of as many corrections in C.
"""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time

import numpy as np

from benchmarks.on_model import main
from benchmarks.programs import reduced_model
from pgmp_petsc.base.errors import InputError
from pgmp_petsc.ensemble.sampling import draw
from pgmp_petsc.lanes.vectors import CACHE_LINE, N_POWERS, N_POWERS_OF_RIGID
from pgmp_petsc.stepping.generalised_alpha import integrate

WIDTHS = (4, 8)
OPTIONS = ("-O3", "-march=native", "-ffp-contract=fast", "-fno-math-errno", "-Wno-psabi", "-shared", "-fPIC")
N_BLOCKS, N_STEPS, REPEATS = 8, 1000, 5
STEP, SCHEME = 1e-3, (0.3, 0.4, 0.3, 0.6, 2e3, 4e6)  # alpha_m, alpha_f, beta, gamma, gains: any do


class Floor:
    """The C loop, for m flexible coordinates and a number of lanes."""

    def __init__(self, m: int, second_order: bool, lanes: int, folder: Path) -> None:
        library = folder / f"floor_{lanes}.so"
        sizes = (f"-DM={m}", f"-DLANES={lanes}", f"-DSECOND_ORDER={int(second_order)}")
        source = Path(__file__).with_name("floor.c")
        subprocess.run([compiler(), *OPTIONS, *sizes, "-o", str(library), str(source), "-lm"], check=True)
        self._loop, self.lanes = ctypes.CDLL(str(library)), lanes
        self._loop.advance.restype = ctypes.c_double
        size = self._loop.block_size()
        buffer = np.zeros(N_BLOCKS * size + CACHE_LINE, dtype=np.uint8)
        first = -buffer.ctypes.data % CACHE_LINE
        self._blocks = buffer[first : first + N_BLOCKS * size]
        rows = self._blocks.view(float).reshape(N_BLOCKS, -1, lanes)
        # unit inertia and stiffness: what the numbers are has no part in the time
        entry = np.arange(m + 1)
        diagonal = entry * (entry + 3) // 2
        rows[:, 0] = 1.0
        rows[:, N_POWERS_OF_RIGID + N_POWERS * diagonal] = 1.0
        stiffness = (m + 1) * (m + 2) // 2 + m
        rows[:, N_POWERS_OF_RIGID + N_POWERS * (stiffness + diagonal[:m])] = 1.0

    def time(self) -> float:
        """Return the processor time of a step of one sample, us."""
        scheme, step = (ctypes.c_double * len(SCHEME))(*SCHEME), ctypes.c_double(STEP)
        blocks, one = ctypes.c_void_p(self._blocks.ctypes.data), ctypes.c_double(1.0)
        start = process_time()
        self._loop.advance(blocks, N_BLOCKS, N_STEPS, step, scheme, one, ctypes.c_double(0.0))
        return 1e6 * (process_time() - start) / (N_BLOCKS * self.lanes * N_STEPS)


def compiler() -> str:
    """Return a C compiler."""
    found = shutil.which("cc") or shutil.which("gcc")
    if found is None:
        raise InputError("no C compiler (cc, gcc) in PATH")
    return found


def run(path: Path, n_samples: int) -> None:
    """Time a reduced model beside the C loop, and print both."""
    model = reduced_model(path)
    scene = model.scene
    values, layout = draw(scene, 0, 0, n_samples), model.terms.layout
    m = layout.n_eta - 1
    if len(layout.rigid) != 1 or layout.damping < layout.end:
        raise InputError(f"{path}: the C loop is for models of one coordinate without damping")
    ours, floors = [], {lanes: [] for lanes in WIDTHS}
    with TemporaryDirectory() as folder:
        loops = [Floor(m, layout.second_order, lanes, Path(folder)) for lanes in WIDTHS]
        for _ in range(REPEATS):
            system = model.batch(values, n_samples)
            start = process_time()
            done = integrate(system, scene.simulation)
            ours.append(1e6 * (process_time() - start) / (n_samples * done.n_steps))
            for loop in loops:
                floors[loop.lanes].append(loop.time())
    corrections = done.counted[0] / (n_samples * done.n_steps)
    for lanes, times in floors.items():
        print(f"C, {lanes} lanes, one correction: {min(times):.3f} us a step and sample")
    least = corrections * min(min(times) for times in floors.values())
    print(f"{m} flexible coordinates, {corrections:.2f} corrections a step: {min(ours):.3f} us")
    print(f"{corrections:.2f} corrections in C take {least:.3f} us: {least / min(ours):.2f} of the time is arithmetic")


if __name__ == "__main__":
    main(__doc__, run, 512)
