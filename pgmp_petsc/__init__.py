"""Parametric Global Modal Parameterization of flexible mechanisms on PETSc and SLEPc.

The Python interface is here, ``import pgmp_petsc as pgmp``; see docs/python.md. Its names are imported when they are
asked for: importing the package loads neither MPI nor PETSc.
"""

from importlib import import_module
from typing import Any

from pgmp_petsc.base import __version__  # noqa: F401 (a name of the interface)

#: Classes of the interface, and the modules that have them; its functions are found (`api.found`).
_CLASSES = {
    "Scene": "scene",
    "Shard": "ensemble.plan",
    "Correction": "api.ensembles",
    "Stopping": "api.ensembles",
    "Robust": "api.designs",
    "Result": "api.result",
    "Rom": "api.result",
    "StoppedRun": "api.result",
    "PgmpError": "base.errors",
    "InputError": "base.errors",
    "RunError": "base.errors",
}


def _modules() -> dict[str, str]:
    """Return the names of the interface, and the modules that have them."""
    functions = import_module("pgmp_petsc.api.found").found()
    return {name: f"pgmp_petsc.{module}" for name, module in _CLASSES.items()} | {
        one.function: one.module for one in functions
    }


def __getattr__(name: str) -> Any:
    if name.startswith("__") and name != "__all__":  # what Python itself looks for
        raise AttributeError(f"module 'pgmp_petsc' has no attribute '{name}'")
    modules = _modules()
    if name == "__all__":
        return ["__version__", *modules]
    if name not in modules:
        raise AttributeError(f"module 'pgmp_petsc' has no attribute '{name}'; its interface: {', '.join(modules)}")
    if modules[name].startswith("pgmp_petsc.api."):
        import_module("pgmp_petsc.base.surroundings").check_variables()
    return getattr(import_module(modules[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *_modules()})
