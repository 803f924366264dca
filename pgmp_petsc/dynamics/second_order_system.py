"""What the integrator asks of a model: a second-order system, its state, and the scheme that ties the two in a step."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol

import numpy as np

if TYPE_CHECKING:
    from mpi4py import MPI

    from pgmp_petsc.dynamics.static_equilibrium import Settled


@dataclass
class State:
    """State at one time; the arrays have the system's own shapes, all samples together.

    Attributes
    ----------
    q, v, a
        Coordinates, velocities, accelerations.
    multipliers
        Lagrange multipliers; of size zero for a system without constraints.
    turns
        Angles (rad) that unknowns do not count beyond half a revolution, at this instant, or of an iterate at the one
        before; of size zero where there are none.
    """

    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    multipliers: np.ndarray
    turns: np.ndarray = field(default_factory=lambda: np.zeros(0))

    def copy(self) -> State:
        """Return a deep copy."""
        return State(self.q.copy(), self.v.copy(), self.a.copy(), self.multipliers.copy(), self.turns.copy())

    def at(self, number: int | slice) -> State:
        """Return one or some of states whose arrays have a leading axis of instants, sharing memory."""
        return State(self.q[number], self.v[number], self.a[number], self.multipliers[number], self.turns[number])


@dataclass(frozen=True)
class Scheme:
    """Coefficients for a spectral radius and a step; `gain_v` and `gain_a` are dv/dq and da/dq within a step."""

    alpha_m: float
    alpha_f: float
    beta: float
    gamma: float
    gain_v: float
    gain_a: float

    @classmethod
    def of(cls, spectral_radius: float, step: float) -> Scheme:
        """Return the coefficients of second order with the given spectral radius at infinite frequency."""
        alpha_m = (2 * spectral_radius - 1) / (spectral_radius + 1)
        alpha_f = spectral_radius / (spectral_radius + 1)
        gamma = 0.5 + alpha_f - alpha_m
        beta = 0.25 * (gamma + 0.5) ** 2
        return cls(
            alpha_m,
            alpha_f,
            beta,
            gamma,
            gain_v=gamma / (beta * step),
            gain_a=(1 - alpha_m) / ((1 - alpha_f) * beta * step**2),
        )


class SecondOrderSystem(Protocol):
    """What the integrator asks of a model; a batch of samples is one system.

    Samples are numbered 0 to n_samples - 1 whatever the shapes of the state's arrays.
    """

    comm: MPI.Comm
    n_samples: int
    settled: Settled | None  # static equilibria that the samples start from
    n_events: int  # edges of laws whose crossing is to be found in time; 0 where there are none

    def start(self) -> State:
        """Return the consistent state at time 0."""

    def correct(self, time: float, state: State, scheme: Scheme, active: np.ndarray, fresh: bool) -> np.ndarray:
        """Do one Newton correction of the active samples, in place.

        Parameters
        ----------
        time
            End of the step, s.
        state
            Iterate; ``q``, ``v``, ``a`` and multipliers are corrected consistently with the scheme.
        scheme
            Gains of the step.
        active
            Samples to correct, shape (n_samples,).
        fresh
            Whether the iteration matrix is to be evaluated anew.

        Returns
        -------
        ndarray, shape (n_samples,)
            Size of the correction, in units of the mechanism's size or of 1 rad; not finite where it failed.
        """

    def close(self) -> None:
        """Give back what the system holds outside Python."""

    def restore(self, state: State, previous: State, samples: np.ndarray) -> None:
        """Put the given samples (a mask) of `state` back to `previous`."""

    def outside(self, state: State) -> np.ndarray:
        """Return a mask of the samples that left the model's range of validity."""

    def reasons(self, time: float, state: State, samples: np.ndarray) -> np.ndarray:
        """Return why samples failed in a step.

        Parameters
        ----------
        time, state
            End of the step, and the state at its beginning.
        samples
            Mask of the n samples that failed, shape (n_samples,).

        Returns
        -------
        ndarray, shape (n,)
            Numbers of a `Status`.
        """

    def depths(self, time: float, state: State) -> np.ndarray:
        """Return how far each edge is crossed (negative: not), shape (n_events, n_samples); asked only if any exist."""
