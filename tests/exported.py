"""Models in C: compiled and run, and their libraries as functional mock-up units, called as importers call them."""

import ctypes
import os
import re
import shutil
import subprocess
import zipfile
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT, TIMEOUT_SECONDS
from runs import motion

from pgmp_petsc.c_export.constants import constants_of
from pgmp_petsc.c_export.source import compiled_of, write_sources
from pgmp_petsc.c_export.tree import tree_constants_of
from pgmp_petsc.models import ComponentModel, ReducedModel
from pgmp_petsc.scene import Scene, load_scene

COMPILER = shutil.which("cc") or shutil.which("gcc")
# an interpreter that has FMPy, which takes a newer numpy than this program: that of scripts/setup --tests, or another
FMPY = os.environ.get("PGMP_FMPY_PYTHON", str(ROOT / ".venv/fmpy/bin/python"))
needs_compiler = pytest.mark.skipif(COMPILER is None, reason="no C compiler (cc, gcc) in PATH")
# without optimisation, which takes half of the time of compiling: how a program is compiled changes round-off alone
OPTIONS = ("-std=c99", "-O0", "-Wall", "-Wextra", "-pedantic", "-Werror", "-fsanitize=bounds",
           "-fsanitize-undefined-trap-on-error")  # fmt: skip
SMALL = (
    "reduction.modes=4", "reduction.angles=12", "reduction.max_angles=12", "simulation.duration=0.2",
    "simulation.step=5e-4",
)  # fmt: skip


def scene_of(name: str, *overrides: str, settings: tuple[str, ...] = ()) -> Scene:
    """Return a scene of the repository with few angles and a short run."""
    return load_scene(ROOT / "scenes" / f"{name}.toml", (*SMALL, *overrides), settings)


def with_scene(model: ReducedModel, scene: Scene) -> ReducedModel:
    return ReducedModel(scene, model.rom, model.kinematics)


def compile_in(folder: Path, *words: str, text: str = "") -> Path:
    """Call the compiler with all warnings as errors, and a text to read; return what a program is called."""
    command = [COMPILER, *OPTIONS, *words]
    subprocess.run(command, cwd=folder, check=True, input=text, text=True, timeout=TIMEOUT_SECONDS)
    return folder / "run"


def as_one(folder: Path, kind: str, *options: str) -> Path:
    """Compile the files of a model as one, which takes two thirds of the time: those with macros come last."""
    names = sorted(["main.c", *compiled_of(kind)], key=lambda name: name in ("main.c", "statements.c", "lagrangian.c"))
    text = "".join(f'#include "{name}"\n' for name in names)
    return compile_in(folder, *options, "-o", "run", "-x", "c", "-", "-x", "none", "-lm", text=text)


def compiled(model: ReducedModel | ComponentModel, folder: Path, *options: str) -> Path:
    """Write a model in C, compile it, and return the program."""
    constants = (tree_constants_of if isinstance(model, ComponentModel) else constants_of)(model, "the model")
    write_sources(constants, folder)
    return as_one(folder, constants.kind, *options)


def outputs_of(program: Path, *settings: str, check: bool = True) -> dict[str, np.ndarray]:
    """Run a compiled model to its end, or as far as it comes; return the columns of what it prints."""
    done = subprocess.run(
        [program, *settings], capture_output=True, text=True, check=check, timeout=TIMEOUT_SECONDS
    ).stdout.splitlines()
    rows = np.array([[float(number) for number in line.split(",")] for line in done[1:]])
    return dict(zip(done[0].split(","), rows.T))


def assert_equal(
    found: dict[str, np.ndarray], wanted: dict[str, np.ndarray], share: float = 1e-9, least: float = 0.0
) -> None:
    """Check outputs to a share of each one's largest value, but no less than `least`."""
    for name, values in wanted.items():
        allowed = max(share * np.max(np.abs(values)), least)
        np.testing.assert_allclose(found[name], values, rtol=0.0, atol=allowed, err_msg=name)


def assert_same_in_c(model: ReducedModel | ComponentModel, folder: Path, share: float = 1e-9) -> dict[str, np.ndarray]:
    """Check that the model in C gives what ``pgmp simulate`` gives; return what it gives."""
    found = outputs_of(compiled(model, folder))
    units, system, run = model.outputs.units, model.scene.system, motion(model)  # in which the model in C is
    round_off = 1e-15 * system.shown(model.kinematics.size, "m")  # of places, of which a deformation is a difference
    assert_equal(found, {name: system.shown(one, units[name]) for name, one in run.outputs.items()}, share, round_off)
    # the program looks at some states, of which the largest is one of these or more
    rotation = found.get("elastic_rotation", np.inf)
    assert run.validity.get("elastic_rotation", 0.0) <= np.max(rotation) * (1 + 1e-6)
    return found


class Callbacks(ctypes.Structure):
    """fmi2CallbackFunctions."""

    LOGGER = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_char_p, ctypes.c_int, *[ctypes.c_char_p] * 3)
    _fields_ = [
        ("logger", LOGGER),
        *[(name, ctypes.c_void_p) for name in ("allocate", "free", "finished", "environment")],
    ]


class EventInfo(ctypes.Structure):
    """fmi2EventInfo."""

    _fields_ = [
        *[(name, ctypes.c_int) for name in ("needed", "terminate", "nominals", "values", "defined")],
        ("time", ctypes.c_double),
    ]


KINDS = {
    2: {"Real": ("Real", ctypes.c_double), "Whole": ("Integer", ctypes.c_int), "Boolean": ("Boolean", ctypes.c_int)},
    3: {"Real": ("Float64", ctypes.c_double), "Whole": ("Int32", ctypes.c_int), "Boolean": ("Boolean", ctypes.c_bool)},
}


class Unit:
    """An FMU's library of version 2 or 3 of FMI; `said` are its messages so far."""

    MESSAGE = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_int, ctypes.c_char_p, ctypes.c_char_p)

    def __init__(self, fmu: Path, folder: Path) -> None:
        with zipfile.ZipFile(fmu) as archive:
            archive.extractall(folder)
        text = (folder / "modelDescription.xml").read_text()
        self.token = re.search(r'(?:guid|instantiationToken)="(\w+)"', text)[1]
        self.version = int(re.search(r'fmiVersion="(\d)', text)[1])
        (library,) = (folder / "binaries").rglob("*.so")
        self._library, self.said, self._component = ctypes.CDLL(str(library)), [], None
        self._two = Callbacks(Callbacks.LOGGER(lambda *a: self.said.append(a[-1].decode())))
        self._three = self.MESSAGE(lambda *a: self.said.append(a[-1].decode()))

    def instantiate(self, exchange: bool = False, token: str | None = None) -> int | None:
        """Make an instance and return it, None where that is refused."""
        token = (token or self.token).encode()
        if self.version == 2:
            make = self._library.fmi2Instantiate
            arguments = b"unit", int(not exchange), token, b"", ctypes.byref(self._two), 0, 0
        else:
            make = getattr(self._library, f"fmi3Instantiate{'ModelExchange' if exchange else 'CoSimulation'}")
            between = () if exchange else (False, False, None, ctypes.c_size_t(0))
            after = () if exchange else (None,)
            arguments = b"unit", token, b"", False, False, *between, None, self._three, *after
        make.restype = ctypes.c_void_p
        found = make(*arguments)
        self._component = found if self._component is None else self._component
        return found

    def call(self, name: str, *arguments: object) -> int:
        return getattr(self._library, f"fmi{self.version}{name}")(ctypes.c_void_p(self._component), *arguments)

    def free(self, component: int) -> None:
        """Give an instance back."""
        getattr(self._library, f"fmi{self.version}FreeInstance")(ctypes.c_void_p(component))

    def begin(self, start: float = 0.0) -> int:
        """Go through initialisation; return the first status that is not fine."""
        times = 0, ctypes.c_double(0.0), ctypes.c_double(start), 0, ctypes.c_double(1.0)
        calls = [("SetupExperiment", times), ("EnterInitializationMode", ())]
        if self.version == 3:
            calls = [("EnterInitializationMode", times)]
        return next((s for name, of in (*calls, ("ExitInitializationMode", ())) if (s := self.call(name, *of))), 0)

    def step(self, current: float, size: float) -> int:
        times = ctypes.c_double(current), ctypes.c_double(size), 1
        if self.version == 2:
            return self.call("DoStep", *times)
        flags, self.reached = [ctypes.c_bool(True) for _ in range(3)], ctypes.c_double()
        status = self.call("DoStep", *times, *map(ctypes.byref, flags), ctypes.byref(self.reached))
        assert not any(flag.value for flag in flags)
        return status

    def set(self, kind: str, reference: int, value: float) -> int:
        name, of = KINDS[self.version][kind]
        return self.call(f"Set{name}", *self._one(reference), (of * 1)(value), *self._count(1))

    def get(self, kind: str, reference: int) -> float | None:
        """Return a variable, None where it is refused."""
        name, of = KINDS[self.version][kind]
        value = (of * 1)()
        return value[0] if self.call(f"Get{name}", *self._one(reference), value, *self._count(1)) == 0 else None

    def _one(self, reference: int) -> tuple[object, object]:
        return (ctypes.c_uint * 1)(reference), ctypes.c_size_t(1)

    def _count(self, n: int) -> tuple[object, ...]:
        return () if self.version == 2 else (ctypes.c_size_t(n),)

    def states(self, n: int, values: np.ndarray | None = None) -> np.ndarray:
        """Return the n continuous states, or set them."""
        x = (ctypes.c_double * n)(*([] if values is None else values))
        assert self.call("GetContinuousStates" if values is None else "SetContinuousStates", x, ctypes.c_size_t(n)) == 0
        return np.array(x)

    def derivatives(self, time: float, values: np.ndarray) -> np.ndarray:
        n = len(values)
        assert self.call("SetTime", ctypes.c_double(time)) == 0
        self.states(n, values)
        x = (ctypes.c_double * n)()
        name = "GetDerivatives" if self.version == 2 else "GetContinuousStateDerivatives"
        assert self.call(name, x, ctypes.c_size_t(n)) == 0
        return np.array(x)

    def event(self) -> float | None:
        """Handle an event, and return when the next one is."""
        assert self.call("EnterEventMode") == 0
        if self.version == 2:
            info = EventInfo()
            assert self.call("NewDiscreteStates", ctypes.byref(info)) == 0
            defined, time = info.defined, info.time
        else:
            flags, found = [ctypes.c_bool() for _ in range(5)], ctypes.c_double()
            assert self.call("UpdateDiscreteStates", *map(ctypes.byref, flags), ctypes.byref(found)) == 0
            defined, time = flags[4].value, found.value
        assert self.call("EnterContinuousTimeMode") == 0
        return time if defined else None

    def end_step(self) -> None:
        of = ctypes.c_int if self.version == 2 else ctypes.c_bool
        flags = [of(1), of(1)]
        assert self.call("CompletedIntegratorStep", 1, *map(ctypes.byref, flags)) == 0
        assert not any(flag.value for flag in flags)
