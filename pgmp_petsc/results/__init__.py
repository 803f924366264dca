"""Results as data: trajectories, ensembles, tables of modes and trade-off studies, and HDF5 files that hold them.

A kind of result is imported when it is first asked for: a command has use for one or two of them.
"""

from importlib import import_module
from typing import Any

_NAMES = {
    "ensemble": ("Ensemble",),
    "estimates": ("Balance", "EstimatedErrors"),
    "gradients": ("Derivatives", "Design", "Fit"),
    "selection": ("Attempt", "EffectSizes", "Selection"),
    "statistics": ("Band", "Chance", "RareEvent", "Sensitivity", "Statistics"),
    "tradeoff": ("MeshErrors", "References", "Times", "Tradeoff"),
    "trajectory": ("BodyField", "Frames", "ModesTable", "Trajectory"),
}
_MODULES = {name: module for module, names in _NAMES.items() for name in names}
#: Results of files of their own, whose kind is what reads them; reduced models and shards have readers of their own.
_OF_FILES = ("ModesTable", "Trajectory", "Ensemble", "Tradeoff", "Derivatives", "Fit", "Design", "RareEvent")
__all__ = [*_MODULES]


def __getattr__(name: str) -> Any:
    """Import what is asked for by its name; ``READERS`` are all results that have files of their own, by their kind."""
    if name == "READERS":
        return {kind.kind: kind for kind in map(__getattr__, _OF_FILES)}
    if name not in _MODULES:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
