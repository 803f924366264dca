"""Outputs over time of some samples, at instants that runs with different steps have in common, and their errors.

Steps are the duration over a number of steps; the scene's number times or divided by powers of two. A run with finer
steps is kept at the scene's instants, one with coarser steps at its own, which are among those.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from pgmp_petsc.dynamics.generalised_alpha import count_steps, integrate
from pgmp_petsc.dynamics.second_order_system import State
from pgmp_petsc.dynamics.status import Status
from pgmp_petsc.models import Model, ReducedModel
from pgmp_petsc.runtime.errors import RunError
from pgmp_petsc.scene.numerics import Simulation

MOST_INSTANTS = 2000  # kept of a run: enough for a largest value over time, and little to send
MOST_MISSING = 0.1  # share of the instants of an output at which it may be no number without being a failure

History = dict[str, np.ndarray]  # output -> values, shape (n_kept + 1, n_samples), the start included


def n_instants(simulation: Simulation) -> int:
    """Return the number of instants after the start that are compared: the scene's steps, or an even share."""
    n = count_steps(simulation.duration, simulation.step)
    while n > MOST_INSTANTS and n % 2 == 0:
        n //= 2
    return n


def step_of(duration: float, n_steps: int) -> float:
    """Return the step with the fewest digits (s) that gives so many steps."""
    for digits in range(17):
        step = float(f"{duration / n_steps:.{digits}e}")
        if step > 0.0 and count_steps(duration, step) == n_steps:
            return step
    return duration / n_steps


def with_steps(simulation: Simulation, n_steps: int) -> Simulation:
    """Return the simulation with so many steps."""
    return simulation.model_copy(update={"step": step_of(simulation.duration, n_steps)})


def history_of(model: Model, values: Mapping[str, np.ndarray], simulation: Simulation, kept: int) -> History:
    """Integrate samples on this rank and return their outputs over time.

    Parameters
    ----------
    model
        Either model.
    values
        Parameter values, each of shape (n_samples,); without parameters there is one sample.
    simulation
        Duration, step and spectral radius; may differ from the model's scene in these.
    kept
        Number of instants to keep at most; divides the number of steps, or is a multiple of it.

    Raises
    ------
    RunError
        If a sample fails.
    """
    n_samples = next((len(column) for column in values.values()), 1)
    every = max(1, count_steps(simulation.duration, simulation.step) // kept)
    system = model.batch(values, n_samples)
    reduced = isinstance(model, ReducedModel)
    kept_states: list[np.ndarray] = []

    def record(step: int, time: float, state: State) -> None:
        if step % every == 0:
            # what is observed of reduced samples is cheap only for many at once
            kept_states.append(state.q.copy() if reduced else model.observed(system, state))

    run = integrate(system, simulation, observer=record)
    failed = np.flatnonzero(run.status != Status.FINE)
    if failed.size:
        first = failed[0]
        where = ", ".join(f"{name} = {column[first]:.4g}" for name, column in values.items())
        raise RunError(
            f"{failed.size} of {n_samples} samples failed, the first{f' ({where})' if where else ''} at "
            f"{run.failure_time[first]:.4g} s: {Status(run.status[first]).meaning}"
        )
    # time after time, the samples of each side by side
    if reduced:
        every_time = {name: np.tile(value, len(kept_states)) for name, value in values.items()}
        in_time = model.observed_of(np.concatenate(kept_states), every_time)
    else:
        in_time = np.concatenate(kept_states, axis=-1)
    return {name: values.reshape(-1, n_samples) for name, values in model.outputs.evaluate(in_time).items()}


def largest_errors(found: Mapping[str, np.ndarray], exact: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return the largest error of every output over time and samples, shape (n_outputs,).

    The error of a sample is a share of its own output's largest value over time; where that is zero, of the largest
    value of all samples, and where all are zero, the error is in the output's unit. Instants at which one of the two is
    no number (a deformation outside a limited range) do not count; the error is NaN where these are many, but for those
    at which the exact output is none.

    Parameters
    ----------
    found, exact
        As `history_of` returns them; `exact` has a multiple of the instants of `found`.
    """
    return np.array([_largest_error(found[name], exact[name]) for name in exact])


def _largest_error(found: np.ndarray, exact: np.ndarray) -> float:
    every = (len(exact) - 1) // (len(found) - 1)
    if every * (len(found) - 1) != len(exact) - 1:
        raise ValueError(f"{len(found)} instants are not among {len(exact)}")
    scale = np.max(np.abs(exact), axis=0, initial=0.0, where=np.isfinite(exact))
    scale = np.where(scale > 0.0, scale, scale.max() if scale.max() > 0.0 else 1.0)
    exact = exact[::every]
    both = np.isfinite(exact) & np.isfinite(found)
    # one of them may be at the end of the range a little before the other
    if not both.any() or np.sum(both) < (1.0 - MOST_MISSING) * np.sum(np.isfinite(exact)):
        return float("nan")
    difference = np.subtract(found, exact, out=np.zeros(exact.shape), where=both)
    return float(np.max(np.abs(difference) / scale))
