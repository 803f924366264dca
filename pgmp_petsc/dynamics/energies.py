"""Energies and powers of a model at one instant, from which the balance of a run is drawn up."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np


@dataclass
class Energies:
    """Energies of a system at one instant, for n samples.

    Attributes
    ----------
    kinetic, strain
        Shape (n,), J.
    potential
        Potential energy of each effect that has one, by its name, shape (n,), J.
    powers
        Power of each effect but for what is in its potential energy, by its name, shape (n,), W.
    """

    kinetic: np.ndarray
    strain: np.ndarray
    potential: dict[str, np.ndarray] = field(default_factory=dict)
    powers: dict[str, np.ndarray] = field(default_factory=dict)

    def add_potential(self, effect: str, energy: np.ndarray) -> None:
        """Add to the potential energy of an effect."""
        self.potential[effect] = self.potential.get(effect, 0.0) + energy

    def add_power(self, effect: str, power: np.ndarray) -> None:
        """Add to the power of an effect."""
        self.powers[effect] = self.powers.get(effect, 0.0) + power
