"""Outputs over time of the training samples, and errors between two histories of the same samples."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pgmp_petsc.dynamics.generalised_alpha import integrate
from pgmp_petsc.dynamics.second_order_system import SecondOrderSystem, State
from pgmp_petsc.dynamics.status import Status
from pgmp_petsc.models import FullModel, ReducedModel
from pgmp_petsc.scene import Scene

MOST_INSTANTS = 1024  # kept of a run: enough for the largest value over time
# an output below this share of the mechanism's size, of 1 rad, or of the stress of a strain of 1, is taken for zero
ROUND_OFF = 1e-10
MARGIN = 0.02  # of a limited range: what the flexible bodies may add to the coordinate


@dataclass(frozen=True)
class History:
    """What a run of n samples leaves.

    Attributes
    ----------
    n_steps
        Steps of the run.
    every
        Steps between two kept instants.
    outputs
        Shape (n_outputs, n_kept, n_samples); NaN where a sample failed.
    status
        Of every sample, shape (n_samples,).
    inside
        Samples that stayed in the range of their coordinate, shape (n_samples,).
    """

    n_steps: int
    every: int
    outputs: np.ndarray
    status: np.ndarray
    inside: np.ndarray


def with_steps(scene: Scene, n_steps: int) -> Scene:
    """Return the scene with so many steps."""
    step = {"step": scene.simulation.duration / n_steps}
    return scene.model_copy(update={"simulation": scene.simulation.model_copy(update=step)})


def spacing(n_steps: int) -> int:
    """Return the steps between kept instants: a power of two, so that runs with doubled steps share instants."""
    every = 1
    while n_steps > MOST_INSTANTS * every:
        every *= 2
    return every


def run_history(
    model: FullModel | ReducedModel,
    values: Mapping[str, np.ndarray],
    n_samples: int,
    n_steps: int,
    system: SecondOrderSystem | None = None,
) -> History:
    """Integrate samples on this rank, as a batch, or on the ranks of a given system."""
    system = model.batch(values, n_samples) if system is None else system
    every, kept, angles = spacing(n_steps), [], []
    reduced, coordinate = isinstance(model, ReducedModel), model.kinematics.coordinate
    sides = (coordinate.connection.a, coordinate.connection.b)

    def record(step: int, time: float, state: State) -> None:
        if step % every:
            return
        if reduced:  # what is observed of reduced samples is cheap only for many at once
            kept.append(state.q.copy())
            return
        frames = model.frames(system, state)
        kept.append(model.observed_over(system, [state], frames))
        if not coordinate.periodic:
            a, b = (0.0 if side.on_ground else frames[side.node, 2] for side in sides)
            angles.append(b - a)

    run = integrate(system, with_steps(model.scene, n_steps).simulation, observer=record)
    if reduced:
        every_time = {name: np.tile(value, len(kept)) for name, value in values.items()}
        observed = model.observed_of(np.concatenate(kept), every_time)
    else:
        observed = np.concatenate(kept, axis=-1)
    outputs = np.array([row.reshape(-1, n_samples) for row in model.outputs.evaluate(observed).values()])
    outputs[..., run.status != Status.FINE] = np.nan
    return History(n_steps, every, outputs, run.status, _inside(angles, coordinate, n_samples))


def _inside(angles: list[np.ndarray], coordinate, n_samples: int) -> np.ndarray:
    if not angles:
        return np.ones(n_samples, dtype=bool)
    margin = MARGIN * (coordinate.upper - coordinate.lower)
    kept = (np.array(angles) > coordinate.lower + margin) & (np.array(angles) < coordinate.upper - margin)
    # a start near the end of the range is none of the run's doing
    return np.all(kept | (np.array(angles) == angles[0]), axis=0)


def floors_of(model: FullModel | ReducedModel) -> np.ndarray:
    """Return below which every output is taken for zero, in its unit, shape (n_outputs,)."""
    sizes = {stress.name: stress.size for stress in model.outputs.stresses}
    units = model.outputs.units.items()
    return np.array(
        [ROUND_OFF * sizes.get(name, 1.0 if unit == "rad" else model.kinematics.size) for name, unit in units]
    )


def errors_between(found: History, exact: History, floors: np.ndarray) -> np.ndarray:
    """Return the largest error over time of every output and sample, shape (n_outputs, n_samples).

    The error is a share of the largest value of the exact output over time, or of `floors` where that is larger. It is
    infinite where only `found` failed, and NaN where the exact run failed or has no number (a deformation outside a
    limited range) at any instant.

    Parameters
    ----------
    found, exact
        Histories of the same samples; one's number of steps divides the other's.
    floors
        In the outputs' units, shape (n_outputs,).
    """
    one, other = _common(found, exact)
    known = np.isfinite(other)
    scale = np.max(np.abs(exact.outputs), axis=1, initial=0.0, where=np.isfinite(exact.outputs))
    difference = np.where(known & np.isfinite(one), np.abs(one - np.where(known, other, 0.0)), 0.0)
    errors = difference.max(axis=1) / np.maximum(scale, floors[:, None])
    errors[:, found.status != Status.FINE] = np.inf
    errors[~known.any(axis=1)] = np.nan
    return errors


def round_off_of(exact: History, floors: np.ndarray) -> np.ndarray:
    """Return below which share of its largest value an output's error is round-off, shape (n_outputs, n_samples)."""
    scale = np.max(np.abs(exact.outputs), axis=1, initial=0.0, where=np.isfinite(exact.outputs))
    return floors[:, None] / np.maximum(scale, floors[:, None])


def _common(one: History, other: History) -> tuple[np.ndarray, np.ndarray]:
    """Return the outputs of both at the instants that both kept."""
    finest = max(one.n_steps, other.n_steps)
    strides = [item.every * (finest // item.n_steps) for item in (one, other)]
    shared = int(np.lcm(*strides))
    return tuple(item.outputs[:, :: shared // stride] for item, stride in zip((one, other), strides))
