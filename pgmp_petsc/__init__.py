"""Parametric Global Modal Parameterization of flexible mechanisms on PETSc and SLEPc.

The Python interface is here, ``import pgmp_petsc as pgmp``; see docs/python.md. Its names are imported when they are
asked for: importing the package loads neither MPI nor PETSc.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from pgmp_petsc.base import __version__  # noqa: F401 (a name of the interface)

if TYPE_CHECKING:  # the names that `__getattr__` gives, for editors and checkers of types
    from pgmp_petsc.api.checks import check as check
    from pgmp_petsc.api.designs import Robust as Robust
    from pgmp_petsc.api.designs import fit as fit
    from pgmp_petsc.api.designs import optimize as optimize
    from pgmp_petsc.api.designs import sensitivities as sensitivities
    from pgmp_petsc.api.ensembles import Correction as Correction
    from pgmp_petsc.api.ensembles import Stopping as Stopping
    from pgmp_petsc.api.ensembles import merge as merge
    from pgmp_petsc.api.ensembles import montecarlo as montecarlo
    from pgmp_petsc.api.ensembles import rare_event as rare_event
    from pgmp_petsc.api.ensembles import retry_failed as retry_failed
    from pgmp_petsc.api.exports import export_model as export_model
    from pgmp_petsc.api.exports import export_result as export_result
    from pgmp_petsc.api.files import animate as animate
    from pgmp_petsc.api.files import contents as contents
    from pgmp_petsc.api.files import diff as diff
    from pgmp_petsc.api.files import plot as plot
    from pgmp_petsc.api.files import read as read
    from pgmp_petsc.api.files import write_report as write_report
    from pgmp_petsc.api.jobs import run as run
    from pgmp_petsc.api.modes import build as build
    from pgmp_petsc.api.modes import frequencies as frequencies
    from pgmp_petsc.api.modes import tradeoff as tradeoff
    from pgmp_petsc.api.result import Result as Result
    from pgmp_petsc.api.result import Rom as Rom
    from pgmp_petsc.api.result import StoppedRun as StoppedRun
    from pgmp_petsc.api.runs import fields as fields
    from pgmp_petsc.api.runs import simulate as simulate
    from pgmp_petsc.api.scenes import compose as compose
    from pgmp_petsc.api.scenes import load as load
    from pgmp_petsc.api.scenes import new as new
    from pgmp_petsc.api.scenes import schema as schema
    from pgmp_petsc.api.scenes import use as use
    from pgmp_petsc.api.sweeps import histories as histories
    from pgmp_petsc.base.errors import InputError as InputError
    from pgmp_petsc.base.errors import PgmpError as PgmpError
    from pgmp_petsc.base.errors import RunError as RunError
    from pgmp_petsc.ensemble.plan import Shard as Shard
    from pgmp_petsc.scene import Scene as Scene

#: Classes of the interface, and the modules that have them; its functions are found (`api`).
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
    functions = import_module("pgmp_petsc.api").found()
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
