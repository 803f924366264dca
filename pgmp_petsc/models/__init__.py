"""The full-order, the component and the reduced model of a scene behind one interface; simulations and ensembles use
no other. A module is imported when a name of it is asked for: full-order runs do without reduced models."""

from importlib import import_module
from typing import Any

_NAMES = {
    "full": ("ComponentModel", "FullModel", "SeparateLengths"),
    "lengths": ("LengthLanes", "Reduced", "of_samples"),
    "model": ("Model", "OutputRecord"),
    "reduced": ("Observing", "ReducedModel"),
}
_MODULES = {name: module for module, names in _NAMES.items() for name in names}
__all__ = [*_MODULES]


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
