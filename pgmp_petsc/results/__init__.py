"""Results as data: trajectories, ensembles, tables of modes and trade-off studies, and HDF5 files that hold them."""

from pgmp_petsc.results.balance import Balance
from pgmp_petsc.results.derivatives import Derivatives
from pgmp_petsc.results.design import Design
from pgmp_petsc.results.effect_sizes import EffectSizes
from pgmp_petsc.results.ensemble import Ensemble
from pgmp_petsc.results.errors import EstimatedErrors
from pgmp_petsc.results.fit import Fit
from pgmp_petsc.results.modes import ModesTable
from pgmp_petsc.results.selection import Attempt, Selection
from pgmp_petsc.results.sensitivity import Sensitivity
from pgmp_petsc.results.statistics import Band, Chance, Statistics
from pgmp_petsc.results.tradeoff import MeshErrors, References, Times, Tradeoff
from pgmp_petsc.results.trajectory import Frames, Trajectory

__all__ = [
    "Attempt",
    "Balance",
    "Band",
    "Chance",
    "Derivatives",
    "Design",
    "EffectSizes",
    "Ensemble",
    "EstimatedErrors",
    "Fit",
    "Frames",
    "MeshErrors",
    "ModesTable",
    "References",
    "Selection",
    "Sensitivity",
    "Statistics",
    "Times",
    "Tradeoff",
    "Trajectory",
]
