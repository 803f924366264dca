"""Results as data: trajectories, ensembles, tables of modes and trade-off studies, and HDF5 files that hold them.

A kind of result is imported when it is first asked for: a command has use for one or two of them.
"""

from importlib import import_module
from typing import Any

_MODULES = {
    "Attempt": "selection",
    "Balance": "balance",
    "Band": "statistics",
    "Chance": "statistics",
    "Derivatives": "derivatives",
    "Design": "designs",
    "EffectSizes": "effect_sizes",
    "Ensemble": "ensemble",
    "EstimatedErrors": "errors",
    "Fit": "fit",
    "Frames": "trajectory",
    "MeshErrors": "tradeoff",
    "ModesTable": "modes",
    "References": "tradeoff",
    "Selection": "selection",
    "Sensitivity": "statistics",
    "Statistics": "statistics",
    "Times": "tradeoff",
    "Tradeoff": "tradeoff",
    "Trajectory": "trajectory",
}
__all__ = [*_MODULES]


def __getattr__(name: str) -> Any:
    """Import what is asked for by its name."""
    if name not in _MODULES:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
