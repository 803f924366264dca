"""How far impacts carry a small difference of the start, from a second run of a reduced model.

Where joints have room, each impact makes differences larger, and many of them leave nothing of what a run began with. A
run from coordinates that are off by `OFF` of the range in which each of them moves says by how much: with G(t) the
largest difference of an output up to t, as a share of its range, over `OFF`, a start that is known to the share p is
lost where ``p G`` is one. Speeds, accelerations and forces do not count: they jump with an impact, and are off by as
much as that where it is a little earlier.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from pgmp_petsc.base.errors import Remark, gathered, warning
from pgmp_petsc.base.errors import note as said
from pgmp_petsc.models import ReducedModel
from pgmp_petsc.scene.controllers import derivatives_read
from pgmp_petsc.scene.numerics import Simulation
from pgmp_petsc.scene.outputs import models_alone
from pgmp_petsc.stepping.generalised_alpha import StateRecord, integrate
from pgmp_petsc.stepping.status import Status

STILL = 1e-6  # of the mechanism's size, or of 1 rad: what moves by less has no range
OFF = 1e-9  # of the range of each coordinate
KNOWN = 1e-3  # to which a start is known, as a rule


def growth_of(
    model: ReducedModel, simulation: Simulation, eta: np.ndarray, outputs: Mapping[str, np.ndarray]
) -> np.ndarray | None:
    """Return G (n_t,) of a run with coordinates (n_t, n_eta) and outputs; None where a run from beside its start does
    not end, or nothing moves."""
    scene = model.scene
    smooth = [name for name in scene.outputs if not models_alone(scene, name) and not derivatives_read(scene, name)]
    size = model.kinematics.size
    values = {name: np.array([value]) for name, value in model.scene.values.items()}
    system = model.batch(values, 1)
    start = system.start()
    q = start.q.copy()
    q[:, : system.n_moving] += OFF * np.ptp(eta, axis=0)[: system.n_moving]
    system.begin_at(q, start.v)
    record = StateRecord(lambda n_steps: None)
    done = integrate(system, simulation, observer=record)
    if done.status[0] != Status.FINE:
        return None
    beside = model.outputs.evaluate(model.observed_of(*record.states(), model.scene.values))
    shares = [
        np.maximum.accumulate(np.abs(beside[name] - own)) / np.ptp(own)
        for name, own in outputs.items()
        if name in smooth and np.ptp(own) > STILL * (1.0 if model.outputs.units[name] == "rad" else size)
    ]
    return np.max(shares, axis=0) / OFF if shares else None


@gathered
def spread_remarks(times: np.ndarray, growth: np.ndarray | None) -> Iterator[Remark]:
    """Return by how much differences of the start grow over a run, and that it is chaotic where they take all."""
    if growth is None:
        return
    grown = f"a small difference of the start becomes {growth[-1]:.2g} times as large over the run, by its impacts"
    lost = growth * KNOWN >= 1.0
    if not lost.any():
        yield said(grown)
        return
    yield warning(
        f"chaotic: {grown}. Of a start that is known to {KNOWN:g} nothing is left from {times[np.argmax(lost)]:.3g} s "
        "on: a single history is one of many there, and statistics of samples (pgmp montecarlo) are what is known"
    )
