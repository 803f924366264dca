"""The error of a reduced motion from its residual in the full-order equations.

With a motion ``q_r(t)`` of the unknowns, its velocities and its accelerations, ``q = q_r + e`` solves the full-order
equations if

    M(q) q'' + g(q, q') + C^T lambda = g_ext,     c(q) = 0,     e' = 0 at the start,

with all that the model has in g: inner forces, those of velocities, damping and local effects.
Runs start undeformed with e = 0. From static equilibrium each model starts in its own, and e is the difference.

At e = 0 that is the residual of the motion; the error is what it sets off. The residual varies slowly, as the motion
does, and so does e: its rigid part follows the residual's force on the mechanism over time, its flexible part follows
by its static answer and vibrates where it is driven at its own frequencies. Both come out of a time integration with
the run's own steps, or longer ones (generalised-alpha, `schedule`). For the integrator the unknown is e.
"""

from __future__ import annotations

import numpy as np

from pgmp_petsc.dynamics.alpha_step import StepsAsked, StepsTaken
from pgmp_petsc.dynamics.full_systems import FullBatch
from pgmp_petsc.dynamics.second_order_system import Scheme, SecondOrderSystem, State
from pgmp_petsc.indicator.reference_motion import ReferenceMotion


class ErrorSystem(SecondOrderSystem):
    """Full-order equations about a reference motion; see `SecondOrderSystem`.

    Parameters
    ----------
    full
        Full-order model of the same samples, with its loads at the instants of the motion.
    motion
        Reference motion; its instant number k is that of the time ``k interval``.
    interval
        Step of the integration, s.
    theta
        Rigid coordinates at the start, from which turns are counted, shape (n_theta, n_samples), rad.
    equilibrium
        Unknowns of the full-order static equilibrium that samples start from, shape (n_dofs, n_samples), NaN for those
        that are never advanced; None where runs start undeformed.
    """

    def __init__(
        self,
        full: FullBatch,
        motion: ReferenceMotion,
        interval: float,
        theta: np.ndarray,
        equilibrium: np.ndarray | None = None,
    ) -> None:
        self.comm = full.comm
        self.n_samples = full.n_samples
        self._full = full
        self._motion = motion
        self._interval = interval
        self._turns = full.pack(full.turns(theta))
        self._equilibrium = equilibrium
        self._number = -1
        self.steps_at_once = full.steps_at_once

    def start(self) -> State:
        """Return the error of a start at equilibrium, or none.

        The motion starts as the full-order model does, so there is no acceleration to speak of.
        """
        first = self._motion.at(0).q
        rest = np.zeros_like(self._full.pack(first))
        error = rest.copy()
        if self._equilibrium is not None:
            error = self._full.pack(np.nan_to_num(self._equilibrium - first))
        multipliers = self._full.pack(np.zeros((self._full.n_constraints, self.n_samples)))
        return State(error, rest, rest.copy(), multipliers, self._turns.copy())

    def correct(self, time: float, state: State, scheme: Scheme, active: np.ndarray, fresh: bool) -> np.ndarray:
        """Do one Newton correction of the error; see `SecondOrderSystem.correct`."""
        q, v, a = self._reference(time)
        moved = State(q + state.q, v + state.v, a + state.a, state.multipliers, state.turns)
        before = moved.q.copy(), moved.v.copy(), moved.a.copy()
        size = self._full.correct(time, moved, scheme, active, fresh)
        # by its change, so that a sample which is not active stays what it is to the last digit
        state.q += moved.q - before[0]
        state.v += moved.v - before[1]
        state.a += moved.a - before[2]
        return size

    def begin_iteration(self) -> None:
        """Take note that an iteration begins."""
        self._full.begin_iteration()

    def limited(self) -> np.ndarray:
        """Return the samples of which a law was limited."""
        return self._full.limited()

    def take_steps(self, asked: StepsAsked) -> StepsTaken:
        """Take steps of the error; see `FullBatch.take_steps`."""
        first = round(asked.ends[0] / self._interval)
        return self._full.take_steps(asked, self._motion.over(first, asked.ends.size))

    def count_turns(self, state: State) -> None:
        """Take note of the angles at the instant that was corrected last; see `FullBatch.count_turns`."""
        self._full.count_turns(State(self._parts[0] + state.q, state.v, state.a, state.multipliers, state.turns))

    def _reference(self, time: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        number = round(time / self._interval)
        if number != self._number:
            instant = self._motion.at(number)
            self._number, self._parts = number, tuple(self._full.pack(p) for p in (instant.q, instant.v, instant.a))
        return self._parts

    def restore(self, state: State, previous: State, samples: np.ndarray) -> None:
        """Put samples back."""
        self._full.restore(state, previous, samples)

    restore_all = restore

    def reasons(self, time: float, state: State, samples: np.ndarray) -> np.ndarray:
        """Return why samples fail; see `SecondOrderSystem.reasons`."""
        return self._full.reasons(time, state, samples)

    def unpack(self, array: np.ndarray) -> np.ndarray:
        """Return a state's array as (n, n_samples)."""
        return self._full.unpack(array)
