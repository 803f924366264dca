"""Results as data: trajectories, ensembles, tables of modes and trade-off studies, and HDF5 files that hold them.

A kind of result is imported when it is first asked for: a command has use for one or two of them.
"""

from importlib import import_module
from typing import Any

_MODULES = {
    "Attempt": "selection",
    "Balance": "estimates",
    "Band": "statistics",
    "BodyField": "trajectory",
    "Chance": "statistics",
    "Derivatives": "gradients",
    "Design": "gradients",
    "EffectSizes": "selection",
    "Ensemble": "ensemble",
    "EstimatedErrors": "estimates",
    "Fit": "gradients",
    "Frames": "trajectory",
    "MeshErrors": "tradeoff",
    "ModesTable": "trajectory",
    "RareEvent": "statistics",
    "References": "tradeoff",
    "Selection": "selection",
    "Sensitivity": "statistics",
    "Statistics": "statistics",
    "Times": "tradeoff",
    "Tradeoff": "tradeoff",
    "Trajectory": "trajectory",
}
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
