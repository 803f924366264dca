"""Derivatives of runs by central differences, of runs whose iterations are carried to round-off."""

from typing import Any

import numpy as np

from pgmp_petsc.gradients.differentiated import differentiate
from pgmp_petsc.models import ReducedModel
from pgmp_petsc.outputs.rainflow import counted_after
from pgmp_petsc.reduced.system import ReducedSystem
from pgmp_petsc.stepping.generalised_alpha import integrate
from pgmp_petsc.stepping.second_order_system import SecondOrderSystem, State

# what the issue asks for; differences of runs carried to round-off are good to some 1e-8 of the largest value
RELATIVE = 1e-6
SHARES = (1e-3, 1e-4)
CORRECTIONS = 5  # in place of one


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


def outputs_of(model: ReducedModel, values: dict[str, float]) -> dict[str, np.ndarray]:
    """Return the outputs of a run, each of shape (n_t,)."""
    system = model.batch({name: np.array([value]) for name, value in values.items()}, 1)
    times, rows = [], []

    def keep(number: int, time: float, state: State) -> None:
        times.append(time)
        rows.append((state.q[0].copy(), state.v[0].copy(), state.a[0].copy()))

    integrate(ToRoundOff(system), model.scene.simulation, observer=keep)
    states = State(*np.array(rows).swapaxes(0, 1), np.zeros(0))
    found = model.outputs.evaluate(model.observed_of(np.array(times), states, values))
    return counted_after(model.outputs.counts, np.array(times), found, values)


def differences(model: ReducedModel, name: str, share: float) -> dict[str, np.ndarray]:
    """Return the derivatives of all outputs with a parameter, of fourth order in the share of its value."""
    value = model.scene.values[name]
    runs = [outputs_of(model, model.scene.values | {name: value * (1.0 + k * share)}) for k in (-2, -1, 1, 2)]
    far, near, ahead, further = runs
    return {
        output: (far[output] - 8.0 * near[output] + 8.0 * ahead[output] - further[output]) / (12.0 * share * value)
        for output in far
    }


def compare(model: ReducedModel, shares: tuple[float, ...] = SHARES, *names: str) -> None:
    """Compare every output's derivative with every parameter, or some, over the run."""
    names = names or tuple(model.scene.parameters)
    run = differentiate(model, model.scene.values, names)
    for name in names:
        off: dict[str, list[float]] = {}
        for share in shares:
            for output, expected in differences(model, name, share).items():
                # what does not depend on the parameter still has the rounding of its own values
                least = 1e-7 * np.abs(run.outputs[output]).max() / abs(model.scene.values[name])
                error = np.abs(run.derivatives[output][name] - expected).max()
                off.setdefault(output, []).append(error / max(np.abs(expected).max(), least))
        # the better of both: truncation grows with the share, rounding as it falls
        worst = {output: min(errors) for output, errors in off.items()}
        assert max(worst.values()) < RELATIVE, f"{name}: {worst}"
