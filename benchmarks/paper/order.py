"""Observed order of the time integration: the full-order model with three steps against a much finer one."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from mpi4py import MPI

from benchmarks.called import Called
from benchmarks.tables import Table
from pgmp_petsc.base.errors import RunError
from pgmp_petsc.mechanism.capabilities import Purpose
from pgmp_petsc.models import FullModel
from pgmp_petsc.scene.numerics import count_steps
from pgmp_petsc.stepping.generalised_alpha import integrate
from pgmp_petsc.stepping.second_order_system import State
from pgmp_petsc.studies.inputs import read_scene

SPECTRAL_RADII = (0.5, 0.8, 1.0)
OUTPUTS = ("crank_angle", "slider_position")
FINENESS = 8  # the comparison's step divides the smallest step by this: its own error is 1/64
FINE_RADIUS = 0.8
WANTED, TOLERANCE = 2.0, 0.1
SUDDEN = ("effects={}", "simulation.initial={theta={velocity=10.0}}")


@dataclass(frozen=True)
class Case:
    """A start, and the steps it is integrated with.

    Attributes
    ----------
    words
        What starts.
    overrides
        Of the scene.
    duration
        s.
    steps
        Each half of the one before, s.
    if_not
        What is said where the order is not the expected one.
    """

    words: str
    overrides: tuple[str, ...]
    duration: float
    steps: tuple[float, ...]
    if_not: str = "differs"

    @property
    def fine_step(self) -> float:
        """The step of the comparison, s."""
        return self.steps[-1] / FINENESS

    @property
    def shown_steps(self) -> str:
        """The steps in words."""
        factor, unit = (1e3, "ms") if self.steps[-1] >= 1e-4 else (1e6, "\N{MICRO SIGN}s")
        return f"{', '.join(f'{factor * step:g}' for step in self.steps)} {unit}"

    def model(self, scene: Path) -> FullModel:
        """Return the model of the case."""
        overrides = [*self.overrides, f"simulation.duration={self.duration}"]
        return FullModel(*read_scene(scene, overrides, (), MPI.COMM_SELF, Purpose.FULL))


AT_REST = Case("at rest, ramped torque, 1 s", (), 1.0, (1e-3, 5e-4, 2.5e-4))
CASES = (
    AT_REST,
    Case(
        "10 rad/s without load, no equilibrium, 1 s",
        SUDDEN,
        1.0,
        (1e-3, 5e-4, 2.5e-4),
        "differs, because the sudden start sets off vibrations faster than these steps, which turn the hinge's node; "
        "the next case resolves them",
    ),
    Case("the same, 5 ms with steps that resolve all vibrations", SUDDEN, 5e-3, (4e-6, 2e-6, 1e-6)),
)


def exact_run(case: Case, scene: Path) -> dict[str, np.ndarray]:
    """Return the outputs over time with the comparison's step."""
    return history(case.model(scene), case, case.fine_step, FINE_RADIUS)


def order_table(scene: Path, at_rest: dict[str, np.ndarray]) -> Table:
    """Measure the order for all cases and spectral radii; `at_rest` is the first case's exact run."""
    rows = []
    for case in CASES:
        model = case.model(scene)
        exact = at_rest if case is AT_REST else exact_run(case, scene)
        for radius in SPECTRAL_RADII:
            runs = [history(model, case, step, radius) for step in case.steps]
            for output in OUTPUTS:
                errors = np.array([rms_error(run[output], exact[output]) for run in runs])
                rows.append(_row(case, radius, output, errors))
    header = ("start", "spectral radius", "output", "steps", "rms errors", "observed orders", "verdict")
    after = (
        f"Error: root mean square over time (rad, m) against a step {FINENESS} times smaller than the smallest. Order: "
        f"log2 of the ratio of the errors of two successive steps. ok: the last one is within {TOLERANCE:g} of the "
        f"order {WANTED:g} of generalised-alpha."
    )
    return Table("Observed order of the time integration", header, rows, after=after)


def history(model: FullModel, case: Case, step: float, spectral_radius: float) -> dict[str, np.ndarray]:
    """Integrate and return every output at the multiples of the case's largest step, each of shape (n_t,).

    Raises
    ------
    RunError
        If the integration fails.
    """
    simulation = model.scene.simulation.model_copy(update={"step": step, "spectral_radius": spectral_radius})
    every = count_steps(case.duration, step) // count_steps(case.duration, case.steps[0])
    system = model.batch({name: np.array([value]) for name, value in model.scene.values.items()}, 1)
    frames = []

    def record(number: int, time: float, state: State) -> None:
        if number % every == 0:
            frames.append(model.observed(system, state))

    run = integrate(system, simulation, observer=Called(record))
    if run.status[0]:
        raise RunError(f"{case.words}: the run with a step of {step:g} s failed at {run.failure_time[0]:g} s")
    return model.outputs.evaluate(np.concatenate(frames, axis=-1))


def rms_error(found: np.ndarray, exact: np.ndarray) -> float:
    """Return the root mean square over time of the difference."""
    return float(np.sqrt(np.mean((found - exact) ** 2)))


def orders(errors: np.ndarray) -> np.ndarray:
    """Return the orders between successive steps, each half of the one before."""
    return np.log2(errors[:-1] / errors[1:])


def _row(case: Case, radius: float, output: str, errors: np.ndarray) -> list[str]:
    found = orders(errors)
    return [
        case.words,
        f"{radius:g}",
        output.replace("_", " "),
        case.shown_steps,
        ", ".join(f"{error:.1e}" for error in errors),
        ", ".join(f"{order:.2f}" for order in found),
        "ok" if abs(found[-1] - WANTED) < TOLERANCE else case.if_not,
    ]
