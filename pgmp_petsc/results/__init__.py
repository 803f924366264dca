"""Results as data: trajectories, ensembles and tables of modes, and the HDF5 files that hold them."""

from pgmp_petsc.results.ensemble import Ensemble, Statistics
from pgmp_petsc.results.modes import ModesTable
from pgmp_petsc.results.trajectory import Frames, Trajectory

__all__ = ["Ensemble", "Frames", "ModesTable", "Statistics", "Trajectory"]
