"""Results as data: trajectories, ensembles, tables of modes and trade-off studies, and HDF5 files that hold them.

A kind of result is imported when it is first asked for: a command has use for one or two of them.
"""

from typing import Any

from pgmp_petsc.base import given_by

_named = given_by(
    __name__,
    {
        "ensemble": ("Band", "Chance", "Ensemble", "RareEvent", "Sensitivity", "Statistics"),
        "estimates": ("Balance", "EstimatedErrors"),
        "gradients": ("Derivatives", "Design", "Fit"),
        "selection": ("Attempt", "EffectSizes", "Selection"),
        "tradeoff": ("MeshErrors", "References", "Times", "Tradeoff"),
        "trajectory": ("BodyField", "Frames", "ModesTable", "Trajectory"),
    },
)
#: Results of files of their own, whose kind is what reads them; reduced models and shards have readers of their own.
_OF_FILES = ("ModesTable", "Trajectory", "Ensemble", "Tradeoff", "Derivatives", "Fit", "Design", "RareEvent")


def __getattr__(name: str) -> Any:
    """Import what is asked for by its name; ``READERS`` are all results that have files of their own, by their kind."""
    return {kind.kind: kind for kind in map(_named, _OF_FILES)} if name == "READERS" else _named(name)
