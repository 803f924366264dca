"""Derivatives of runs by central differences, of runs whose iterations are carried to round-off."""

from types import ModuleType
from typing import Any

import numpy as np
import pytest

from benchmarks.called import Called
from pgmp_petsc.base.errors import RunError
from pgmp_petsc.gradients.differentiated import DifferentiatedRun, differentiate
from pgmp_petsc.models import ReducedModel
from pgmp_petsc.outputs.rainflow import counted_after
from pgmp_petsc.reduced.system import ReducedSystem
from pgmp_petsc.stepping.generalised_alpha import integrate
from pgmp_petsc.stepping.second_order_system import SecondOrderSystem, State

# what the issue asks for; differences of runs carried to round-off are good to some 1e-8 of the largest value
RELATIVE = 1e-6
SHARES = (1e-3, 1e-4)
CORRECTIONS = 5  # in place of one


def failing_at(number: int, module: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the run of this number stop that a module differentiates."""
    runs = []

    def once(*given: object) -> DifferentiatedRun:
        runs.append(given)
        if len(runs) == number:
            raise RunError("the run stopped at 1 ms")
        return differentiate(*given)

    monkeypatch.setattr(module, "differentiate", once)


class ToRoundOff:
    """A reduced system whose every correction is several, and which takes one step at a time."""

    def __init__(self, system: ReducedSystem) -> None:
        self._system = system

    def __getattr__(self, name: str) -> Any:
        return getattr(self._system, name)

    steps_at_once, advance, take_steps = 1, SecondOrderSystem.advance, SecondOrderSystem.take_steps

    def correct(self, *arguments: Any) -> np.ndarray:
        """Correct a state, always with a new matrix."""
        for _ in range(CORRECTIONS):
            size = self._system.correct(*arguments[:-1], True)
        return size


def outputs_of(model: ReducedModel, values: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return the outputs of runs side by side, each of shape (n_t, n), for values of shape (n,)."""
    n = next(iter(values.values())).size
    times, rows = [], []

    def keep(number: int, time: float, state: State) -> None:
        times.append(time)
        rows.append((state.q.copy(), state.v.copy(), state.a.copy()))

    integrate(ToRoundOff(model.batch(values, n)), model.scene.simulation, observer=Called(keep))
    states = State(*(np.concatenate(part) for part in zip(*rows)), np.zeros(0))
    each = {name: np.tile(value, len(times)) for name, value in values.items()}
    found = model.outputs.evaluate(model.observed_of(np.repeat(times, n), states, each))
    found = {name: row.reshape(len(times), n) for name, row in found.items()}
    return counted_after(model.outputs.counts, np.array(times), found, values)


def differences(model: ReducedModel, name: str, *shares: float) -> dict[str, np.ndarray]:
    """Return the derivatives of all outputs with a parameter, of fourth order in shares of its value, for one share or
    side by side for several."""
    value, given = model.scene.values[name], np.array(shares)
    shifts = np.multiply.outer(given, (-2, -1, 1, 2)).ravel()
    values = {other: np.full(shifts.size, number) for other, number in model.scene.values.items()}
    found = {}
    for output, rows in outputs_of(model, values | {name: value * (1.0 + shifts)}).items():
        far, near, ahead, further = np.moveaxis(rows.reshape(-1, given.size, 4), -1, 0)
        slopes = (far - 8.0 * near + 8.0 * ahead - further) / (12.0 * given * value)
        found[output] = slopes if len(shares) > 1 else slopes[:, 0]
    return found


def compare(model: ReducedModel, shares: tuple[float, ...] = SHARES, *names: str) -> None:
    """Compare every output's derivative with every parameter, or some, over the run."""
    names = names or tuple(model.scene.parameters)
    run = differentiate(model, model.scene.values, names)
    for name in names:
        worst = {}
        for output, expected in differences(model, name, *shares).items():
            # what does not depend on the parameter still has the rounding of its own values
            least = 1e-7 * np.abs(run.outputs[output]).max() / abs(model.scene.values[name])
            off = np.abs(run.derivatives[output][name] - expected.T).max(axis=-1)
            # the better of all: truncation grows with the share, rounding as it falls
            worst[output] = np.min(off / np.maximum(np.abs(expected).max(axis=0), least))
        assert max(worst.values()) < RELATIVE, f"{name}: {worst}"
