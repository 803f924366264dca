"""Parametric Global Modal Parameterization of flexible mechanisms on PETSc and SLEPc.

The Python interface is here, ``import pgmp_petsc as pgmp``; see docs/python.md. Its names are imported when they are
asked for: importing the package loads neither MPI nor PETSc.
"""

from importlib import import_module
from typing import Any

__version__ = "0.1.0"

#: Names of the interface, and the modules that have them.
_NAMES = {
    "Scene": "scene",
    "load": "api.scenes",
    "compose": "api.scenes",
    "use": "api.scenes",
    "check": "api.checks",
    "build": "api.modes",
    "read": "api.files",
    "contents": "api.contents",
    "run": "api.jobs",
    "simulate": "api.runs",
    "sensitivities": "api.runs",
    "montecarlo": "api.ensembles",
    "retry_failed": "api.ensembles",
    "rare_event": "api.ensembles",
    "merge": "api.ensembles",
    "Shard": "ensemble.allotment",
    "Correction": "api.better",
    "Stopping": "api.requests",
    "fit": "api.designs",
    "optimize": "api.designs",
    "Robust": "api.designs",
    "tradeoff": "api.tradeoffs",
    "frequencies": "api.modes",
    "fields": "api.fields",
    "export_model": "api.exports",
    "export_result": "api.exports",
    "animate": "api.films",
    "write_report": "api.films",
    "Result": "api.result",
    "Rom": "api.result",
    "StoppedRun": "api.result",
    "PgmpError": "runtime.errors",
    "InputError": "runtime.errors",
    "RunError": "runtime.errors",
}
__all__ = ["__version__", *_NAMES]


def __getattr__(name: str) -> Any:
    if name not in _NAMES:
        raise AttributeError(f"module 'pgmp_petsc' has no attribute '{name}'; its interface: {', '.join(_NAMES)}")
    if _NAMES[name].startswith("api."):
        import_module("pgmp_petsc.runtime.surroundings").check_variables()
    return getattr(import_module(f"pgmp_petsc.{_NAMES[name]}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *_NAMES})
