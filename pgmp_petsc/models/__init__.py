"""The full-order, the component and the reduced model of a scene behind one interface; simulations and ensembles use
no other. A module is imported when a name of it is asked for: full-order runs do without reduced models."""

from pgmp_petsc.base import given_by

__getattr__ = given_by(
    __name__,
    {
        "full": ("ComponentModel", "FullModel", "SeparateLengths"),
        "lengths": ("LengthLanes", "Reduced", "of_samples"),
        "model": ("Model", "OutputRecord"),
        "reduced": ("Observing", "ReducedModel"),
    },
)
