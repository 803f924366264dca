"""Samples that fail with the scene's step are integrated again, from the start, with smaller ones.

Only they are: a sample that is fine keeps its numbers to the last bit, and a sample that is tried again has nobody's
but its own, so that neither batch nor number of ranks plays a part.

A sample whose reduced model broke down with two steps in turn is not tried further: it is the model that ends there,
not the integration.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pgmp_petsc.dynamics.generalised_alpha import Run, count_steps
from pgmp_petsc.dynamics.status import Status
from pgmp_petsc.scene.numerics import Simulation

DIVISORS = (1, 2, 4, 8)  # of the scene's step; the last is as far as a first try may be from a good step
RETRIED = (Status.NOT_CONVERGED, Status.NOT_FINITE, Status.SOLVER_FAILED, Status.BROKE_DOWN)


@dataclass(frozen=True)
class Attempt:
    """What is to be integrated, from time 0.

    Attributes
    ----------
    samples
        Numbers of the samples in the batch, shape (n,).
    alive
        Which of these are to be integrated at all, shape (n,).
    simulation
        The scene's, with the step of this attempt.
    divisor
        By which the scene's step is divided.
    """

    samples: np.ndarray
    alive: np.ndarray
    simulation: Simulation
    divisor: int


@dataclass(frozen=True)
class Outcome:
    """What became of a batch.

    Attributes
    ----------
    status, failure_time
        Of every sample in its last attempt, shape (n_samples,).
    divisors
        By what the scene's step was divided in that attempt, shape (n_samples,).
    """

    status: np.ndarray
    failure_time: np.ndarray
    divisors: np.ndarray


def integrate_with_smaller_steps(
    run: Callable[[Attempt], Run], simulation: Simulation, alive: np.ndarray, divisors: tuple[int, ...] = DIVISORS
) -> Outcome:
    """Integrate a batch, and those of its samples that fail again with smaller steps.

    Parameters
    ----------
    run
        Integrates an attempt and keeps what it wants of the samples that are fine; what it kept of an earlier attempt
        of the same sample is void.
    simulation
        The scene's.
    alive
        Samples to integrate at all, shape (n_samples,).
    divisors
        Of the scene's step, one after the other; the first is 1.
    """
    n_steps = count_steps(simulation.duration, simulation.step)
    status = np.full(alive.size, Status.UNPHYSICAL, dtype=int)
    failure_time, divided = np.zeros(alive.size), np.ones(alive.size, dtype=int)
    samples = np.arange(alive.size)
    for divisor in divisors:
        # the first step as it is: a quotient of a product may differ in the last bit
        step = simulation.step if divisor == 1 else simulation.duration / (n_steps * divisor)
        attempt = Attempt(samples, alive[samples], simulation.model_copy(update={"step": step}), divisor)
        done = run(attempt)
        before = status[samples]
        status[samples], failure_time[samples], divided[samples] = done.status, done.failure_time, divisor
        unchanged = (done.status == Status.BROKE_DOWN) & (before == Status.BROKE_DOWN)
        samples = samples[np.isin(done.status, RETRIED) & ~unchanged]
        if not samples.size:
            break
    return Outcome(status, failure_time, divided)
