"""The full-order, the component and the reduced model of a scene behind one interface; simulations and ensembles use
no other."""

from pgmp_petsc.models.full import ComponentModel, FullModel
from pgmp_petsc.models.lengths import LengthLanes, SeparateLengths, of_samples
from pgmp_petsc.models.model import Model, OutputRecord
from pgmp_petsc.models.reduced import Observing, ReducedModel

#: Models over interpolated tables: terms, outputs and displacements follow from reduced coordinates and parameters.
Reduced = ReducedModel | LengthLanes

__all__ = [
    "ComponentModel",
    "FullModel",
    "LengthLanes",
    "Model",
    "Observing",
    "OutputRecord",
    "Reduced",
    "ReducedModel",
    "SeparateLengths",
    "of_samples",
]
