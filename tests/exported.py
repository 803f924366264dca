"""Models in C: compiled, run, and what the program's own equations give with Newton's iteration at its end."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT, TIMEOUT_SECONDS

from pgmp_petsc.code.constants import constants_of
from pgmp_petsc.code.source import write_sources
from pgmp_petsc.dynamics.generalised_alpha import count_steps
from pgmp_petsc.dynamics.second_order_system import Scheme, State
from pgmp_petsc.models import ReducedModel
from pgmp_petsc.scene import Scene, load_scene

COMPILER = shutil.which("cc") or shutil.which("gcc")
needs_compiler = pytest.mark.skipif(COMPILER is None, reason="no C compiler (cc, gcc) in PATH")
OPTIONS = ("-std=c99", "-O1", "-Wall", "-Wextra", "-pedantic", "-Werror")
CORRECTIONS = 6  # twice those of the model in C


def scene_of(name: str, *overrides: str) -> Scene:
    """Return a scene of the repository with few angles and a short run."""
    small = ("reduction.angles=24", "simulation.duration=0.2", "simulation.step=5e-4")
    return load_scene(ROOT / "scenes" / f"{name}.toml", (*small, *overrides), ())


def compiled(model: ReducedModel, folder: Path) -> Path:
    """Write a model in C, compile it with all warnings as errors, and return the program."""
    write_sources(constants_of(model, "the model"), folder)
    command = [COMPILER, *OPTIONS, "-o", "run", "main.c", "model.c", "tables.c", "-lm"]
    subprocess.run(command, cwd=folder, check=True, timeout=TIMEOUT_SECONDS)
    return folder / "run"


def outputs_of(program: Path, *settings: str) -> dict[str, np.ndarray]:
    """Run a compiled model; return the columns of what it prints."""
    done = subprocess.run(
        [program, *settings], capture_output=True, text=True, check=True, timeout=TIMEOUT_SECONDS
    ).stdout.splitlines()
    rows = np.array([[float(number) for number in line.split(",")] for line in done[1:]])
    return dict(zip(done[0].split(","), rows.T))


def converged(model: ReducedModel, **given: float) -> dict[str, np.ndarray]:
    """Return outputs over time of the program's equations with `CORRECTIONS` Newton corrections in every step.

    A run of the program stops its iterations earlier, at 1e-11 of the mechanism's size.
    """
    values = {name: np.array([given.get(name, value)]) for name, value in model.scene.values.items()}
    system, simulation = model.batch(values, 1), model.scene.simulation
    n_steps = count_steps(simulation.duration, simulation.step)
    h, state = simulation.duration / n_steps, system.start()
    s, everyone, auxiliary = Scheme.of(simulation.spectral_radius, h), np.ones(1, dtype=bool), state.a.copy()
    history = [state.q[0].copy()]
    for number in range(n_steps):

        def ahead(a: np.ndarray, before: State = state, auxiliary: np.ndarray = auxiliary) -> np.ndarray:
            return ((1 - s.alpha_f) * a + s.alpha_f * before.a - s.alpha_m * auxiliary) / (1 - s.alpha_m)

        then = ahead(state.a)
        q = state.q + h * state.v + h**2 * ((0.5 - s.beta) * auxiliary + s.beta * then)
        v = state.v + h * ((1 - s.gamma) * auxiliary + s.gamma * then)
        end = State(q, v, state.a.copy(), np.zeros(0))
        for _ in range(CORRECTIONS):
            system.correct(h * (number + 1), end, s, everyone, True)
        auxiliary, state = ahead(end.a), end
        history.append(state.q[0].copy())
    return model.outputs.evaluate(model.observed_of(np.array(history), {k: float(v[0]) for k, v in values.items()}))


def assert_equal(found: dict[str, np.ndarray], wanted: dict[str, np.ndarray], share: float = 1e-9) -> None:
    """Check outputs to a share of each one's largest value."""
    for name, values in wanted.items():
        np.testing.assert_allclose(found[name], values, rtol=0.0, atol=share * np.max(np.abs(values)), err_msg=name)


class Callbacks(ctypes.Structure):
    """fmi2CallbackFunctions."""

    LOGGER = ctypes.CFUNCTYPE(None, ctypes.c_void_p, *[ctypes.c_char_p, ctypes.c_int] * 1, *[ctypes.c_char_p] * 3)
    _fields_ = [
        ("logger", LOGGER),
        *[(name, ctypes.c_void_p) for name in ("allocate", "free", "finished", "environment")],
    ]


class Unit:
    """An FMU's library, called as an importer calls it.

    Attributes
    ----------
    said
        Messages so far.
    """

    def __init__(self, library: Path, guid: str) -> None:
        self._library, self.said = ctypes.CDLL(str(library)), []
        self._library.fmi2Instantiate.restype = ctypes.c_void_p
        self._callbacks = Callbacks(Callbacks.LOGGER(lambda *a: self.said.append(a[-1].decode())))
        self._component = None
        self.guid = guid

    def instantiate(self, kind: int = 1, guid: str | None = None) -> int | None:
        """Make an instance and return it, None where that is refused."""
        found = self._library.fmi2Instantiate(
            b"unit", kind, (guid or self.guid).encode(), b"", ctypes.byref(self._callbacks), 0, 0
        )
        self._component = found if self._component is None else self._component
        return found

    def call(self, name: str, *arguments: object) -> int:
        """Call a function on the first instance."""
        return getattr(self._library, f"fmi2{name}")(ctypes.c_void_p(self._component), *arguments)

    def free(self, component: int) -> None:
        """Give an instance back."""
        self._library.fmi2FreeInstance(ctypes.c_void_p(component))

    def begin(self) -> None:
        """Go through initialisation."""
        assert self.call("EnterInitializationMode") == 0
        assert self.call("ExitInitializationMode") == 0

    def step(self, current: float, size: float) -> int:
        """Take a communication step."""
        return self.call("DoStep", ctypes.c_double(current), ctypes.c_double(size), 1)

    def set(self, kind: str, reference: int, value: float) -> int:
        """Set a variable."""
        of = ctypes.c_double if kind == "Real" else ctypes.c_int
        return self.call(f"Set{kind}", (ctypes.c_uint * 1)(reference), ctypes.c_size_t(1), (of * 1)(value))

    def get(self, kind: str, reference: int) -> float | None:
        """Return a variable, None where it is refused."""
        value = ((ctypes.c_double if kind == "Real" else ctypes.c_int) * 1)()
        done = self.call(f"Get{kind}", (ctypes.c_uint * 1)(reference), ctypes.c_size_t(1), value)
        return value[0] if done == 0 else None
