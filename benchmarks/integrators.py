"""What steps of generalised-alpha and of a prototype that is exact for oscillators leave and cost, by load and step.

    python -m benchmarks.integrators ROM.h5 -n 8

For models of one coordinate without local effects and damping, with a torque called 'motor'. The prototype and its
variants are those of `exact_oscillators`.

Errors are the largest over a run's instants, as a share of the output's largest value, against the same reduced
equations integrated by scipy's DOP853 from corner to corner of the torque's table: an explicit method of order 8 that
has nothing in common with the steppers but the residual, from which it takes the inertia too. It is checked against
generalised-alpha with `FINE` steps, which come close to it but for a sudden step, after which the fastest vibrations
keep no phase with as many.

Costs of the program's steps are processor times of the engine with outputs left out. The prototype's are counted: a
correction is an evaluation of the residual, which the engine does too, without matrix and factors; the modes of a step
are charged like one of the engine's corrections, of as many operations or more.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import process_time

import numpy as np
from scipy.integrate import solve_ivp

from benchmarks.called import Called
from benchmarks.effectivity import MOTOR, TORQUES
from benchmarks.exact_oscillators import ExactOscillators, Variant, sinc
from benchmarks.on_model import main
from benchmarks.programs import reduced_model
from benchmarks.tables import Table, number
from pgmp_petsc.base.errors import InputError
from pgmp_petsc.bench.history import Load
from pgmp_petsc.ensemble.sampling import draw
from pgmp_petsc.models import ReducedModel
from pgmp_petsc.reduced.system import ReducedSystem
from pgmp_petsc.scene.numerics import count_steps
from pgmp_petsc.stepping.generalised_alpha import instants, integrate
from pgmp_petsc.stepping.second_order_system import Scheme, State

LOADS = ("ramp", "half sine", "reversal", "sudden step")
STEPS = (0.25e-3, 0.5e-3, 1e-3, 2e-3, 5e-3, 10e-3)
SMALLER = (0.125e-3, 31.25e-6, 7.8125e-6)  # for generalised-alpha alone, where equal errors are compared
FINE = (512_000, 2_048_000)  # steps of the check
VARIANTS = (
    Variant("linear", 50),
    Variant("linear, sinc", 50, sinc),
    Variant("linear, projected", 50, held_from=np.pi, projected=True),
    Variant("curved", 50, curved=True),
    Variant("curved, held", 3, curved=True, held_from=2.5),
)
COARSE = 1e-3  # s; the step from which all variants are run, not the last one alone
ALPHA = "generalised-alpha"
TOLERANCES = (5e-3, 2e-3, 1e-3, 5e-4)
RTOL = 1e-9
LONGEST = 2e-4  # s; the reference's own steps: the first one, at rest, would be guessed too long
RATE = 400.0  # rad/s by which velocities are larger than coordinates, for the reference's tolerances
N_TIMED, REPEATS = 512, 5

Outputs = dict[str, np.ndarray]  # over time, shape (n_t, n)


@dataclass(frozen=True)
class Result:
    """What steps of one length leave.

    Attributes
    ----------
    load, scheme, step
        What was run, s.
    errors
        Of every output and sample, shape (n,); infinite where a sample was lost.
    corrections
        Of a step and sample.
    """

    load: str
    scheme: str
    step: float
    errors: dict[str, np.ndarray]
    corrections: float


@dataclass(frozen=True)
class Prices:
    """Processor times (us) in the engine: of a step's corrections, and of residuals, each of one sample."""

    correction: float
    residual: float

    def of(self, result: Result) -> float:
        """Return what a step costs."""
        if result.scheme == ALPHA:
            return result.corrections * self.correction
        return result.corrections * self.residual + self.correction


def under(model: ReducedModel, load: str) -> ReducedModel:
    """Return the model under one of the torques of `effectivity`."""
    table = tuple((float(time), float(value)) for time, value in json.loads(TORQUES[load]))
    motor = model.scene.plain_effects[MOTOR].model_copy(update={"table": table, "harmonic": None})
    return model.with_loads(Load(load, "", {MOTOR: motor}, True).of(model.scene))


def outputs_of(model: ReducedModel, eta: np.ndarray) -> Outputs:
    """Return the outputs of reduced coordinates (n_t, n, n_eta)."""
    q = eta.reshape(-1, eta.shape[-1])
    still = State(q, np.zeros_like(q), np.zeros_like(q), np.zeros(0))
    found = model.outputs.evaluate(model.observed_of(0.0, still, model.scene.values))
    return {name: values.reshape(eta.shape[:2]) for name, values in found.items()}


def accelerations(system: ReducedSystem, time: float, q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return what the residual gives, linear in the accelerations, shape (n, n_eta).

    `system` has ``n_eta + 1`` copies of every sample, one after the other: without acceleration and with each unit one.
    """
    n, p = q.shape
    units = np.vstack([np.zeros(p), np.eye(p)])
    state = State(np.repeat(q, p + 1, axis=0), np.repeat(v, p + 1, axis=0), np.tile(units, (n, 1)), np.zeros(0))
    found = system.residual(time, state).reshape(n, p + 1, p)
    # the inertia is symmetric: its columns are rows here
    return np.linalg.solve(found[:, 1:] - found[:, :1], -found[:, 0, :, None])[..., 0]


def reference(model: ReducedModel, values: Mapping[str, np.ndarray], n: int, n_kept: int, rtol: float) -> Outputs:
    """Integrate by DOP853 and return the outputs at the start and the ends of `n_kept` equal parts of the run."""
    p, duration = model.terms.layout.n_eta, model.scene.simulation.duration
    system = model.batch({name: np.repeat(value, p + 1) for name, value in values.items()}, n * (p + 1))
    start = system.start()
    y = np.concatenate([part[:: p + 1].ravel() for part in (start.q, start.v)])

    def rates(time: float, y: np.ndarray) -> np.ndarray:
        q, v = y.reshape(2, n, p)
        return np.concatenate([v.ravel(), accelerations(system, time, q, v).ravel()])

    atol = np.tile(1e-2 * rtol / model.terms.scale, n)
    atol = np.concatenate([atol, atol * np.tile(np.where(np.arange(p) > 0, RATE, 1.0), n)])
    times, rows = instants(duration, n_kept), [y]
    corners = [time for time, _ in model.scene.effects[MOTOR].table if 0.0 < time < duration]
    for begin, end in zip([0.0, *corners], [*corners, duration]):
        at = times[(times > begin + 1e-12) & (times < end + 1e-12)]
        inner = at[at < end - 1e-12]
        solution = solve_ivp(
            rates, (begin, end), y, "DOP853", t_eval=np.append(inner, end), rtol=rtol, atol=atol,
            first_step=1e-7, max_step=LONGEST,
        )  # fmt: skip
        rows += list(solution.y.T[: at.size])
        y = solution.y[:, -1]
    return outputs_of(model, np.array(rows).reshape(-1, 2, n, p)[:, 0])


def by_alpha(
    model: ReducedModel, values: Mapping[str, np.ndarray], n: int, n_steps: int, every: int = 1
) -> tuple[Outputs, float]:
    """Integrate as the program does; return outputs at every n-th step, and corrections of a step and sample."""
    rows = []

    def record(number: int, time: float, state: State) -> None:
        if number % every == 0:
            rows.append(state.q.copy())

    run = integrate(model.batch(values, n), model.scene.simulation.in_steps(n_steps), observer=Called(record))
    return outputs_of(model, np.array(rows)), run.counted[0] / (n * run.n_steps)


def by_prototype(
    model: ReducedModel, values: Mapping[str, np.ndarray], n: int, n_steps: int, variant: Variant
) -> tuple[Outputs, float]:
    """Integrate by the prototype; outputs are infinite where a sample ran away."""
    times = instants(model.scene.simulation.duration, n_steps)
    with np.errstate(all="ignore"):
        stepper = ExactOscillators(model.batch(values, n), model.terms, values, float(times[1]), variant)
        rows = [stepper.state.z]
        for time in times[1:]:
            stepper.advance(float(time))
            rows.append(stepper.state.z)
    found = outputs_of(model, np.array(rows))
    return {k: np.where(stepper.lost, np.inf, v) for k, v in found.items()}, stepper.n_corrections / (n * n_steps)


def errors_of(found: Outputs, exact: Outputs) -> dict[str, np.ndarray]:
    """Return the largest error over the instants of a run, among which or around which those of `exact` are."""
    errors = {}
    for name, values in exact.items():
        coarse, fine = len(found[name]) - 1, len(values) - 1
        mine, theirs = found[name][:: max(coarse // fine, 1)], values[:: max(fine // coarse, 1)]
        errors[name] = np.max(np.abs(mine - theirs), axis=0) / np.max(np.abs(values), axis=0)
    return errors


def measure(model: ReducedModel, load: str, values: Mapping[str, np.ndarray], n: int) -> list[Result]:
    """Run one load with all schemes and steps; print how sure the reference is."""
    model, duration = under(model, load), model.scene.simulation.duration
    n_kept = count_steps(duration, min(STEPS))
    exact = reference(model, values, n, n_kept, RTOL)
    for n_steps in FINE:
        errors = errors_of(by_alpha(model, values, n, n_steps, n_steps // n_kept)[0], exact)
        apart = ", ".join(f"{name} {number(error.max(), 2)}" for name, error in errors.items())
        print(f"{load}: {n_steps} steps of {ALPHA} are apart from the reference by {apart}", flush=True)
    results = []
    for step in (*SMALLER, *STEPS):
        n_steps = count_steps(duration, step)
        found, corrections = by_alpha(model, values, n, n_steps)
        results.append(Result(load, ALPHA, step, errors_of(found, exact), corrections))
        for variant in () if step not in STEPS else VARIANTS if step >= COARSE else VARIANTS[-1:]:
            found, corrections = by_prototype(model, values, n, n_steps, variant)
            results.append(Result(load, variant.name, step, errors_of(found, exact), corrections))
    return results


def prices(model: ReducedModel) -> Prices:
    """Time corrections and residuals of many samples in turns; the least of some."""
    values = draw(model.scene, 0, 0, N_TIMED)
    system, alive = model.batch(values, N_TIMED), np.ones(N_TIMED, dtype=bool)
    state, scheme, times = system.start(), Scheme.of(model.scene.simulation.spectral_radius, 1e-3), []
    for _ in range(2 + REPEATS):
        at, begin = state.copy(), process_time()
        for _ in range(20):
            system.correct(1e-3, at, scheme, alive, True)
        middle = process_time()
        for _ in range(20):
            system.residual(1e-3, at)
        times.append((middle - begin, process_time() - middle))
    return Prices(*(1e6 * np.min(times[2:], axis=0) / (20 * N_TIMED)))


def cheapest(results: Sequence[Result], output: str, tolerance: float, cost: Prices) -> tuple[float, Result] | None:
    """Return the least cost of a second of motion (us a sample) with which no sample is worse, and its steps."""
    good = [item for item in results if np.max(item.errors[output]) <= tolerance]
    return min(((cost.of(item) / item.step, item) for item in good), key=lambda pair: pair[0], default=None)


def error_table(results: Sequence[Result], cost: Prices) -> Table:
    """Show medians and largest errors over the samples, and costs."""
    rows = []
    for item in results:
        errors = [f"{100 * np.median(e):.2g}, {100 * np.max(e):.2g}" for e in item.errors.values()]
        figures = [f"{item.corrections:.2f}", f"{cost.of(item):.2f}"]
        rows.append([item.load, f"{1e3 * item.step:g}", item.scheme, *errors, *figures])
    header = ["torque", "step, ms", "scheme", *results[0].errors, "corrections", "us a step"]
    words = "Errors in % of the output's largest value, median and largest of the samples."
    return Table("Steps of a reduced model", header, rows, words)


def equal_table(results: Sequence[Result], cost: Prices) -> Table:
    """Show what equal errors of every output cost with generalised-alpha and with the last variant."""
    rows, schemes = [], (ALPHA, VARIANTS[-1].name)
    for load in dict.fromkeys(item.load for item in results):
        for output in results[0].errors:
            for tolerance in TOLERANCES if "deformation" in output else [1e-3 * t for t in TOLERANCES]:
                of_load = [item for item in results if item.load == load]
                found = [cheapest([r for r in of_load if r.scheme == s], output, tolerance, cost) for s in schemes]
                cells = ["-" if f is None else f"{f[0]:.0f} ({1e3 * f[1].step:.4g} ms)" for f in found]
                gain = "-" if None in found else f"{found[0][0] / found[1][0]:.2g}"
                rows.append([load, output, f"{100 * tolerance:.2g} %", *cells, gain])
    words = "us of a second of motion and a sample, and the step; '-': with none of the steps that were tried."
    return Table("Equal errors of the worst sample", ["torque", "output", "error", *schemes, "gain"], rows, words)


def run(path: Path, n_samples: int) -> None:
    """Measure a reduced model, and print both tables."""
    model = reduced_model(path)
    scene, layout = model.scene, model.terms.layout
    if len(layout.rigid) != 1 or layout.damping < layout.end or MOTOR not in scene.effects:
        raise InputError(f"{path}: needed are one coordinate, no damping and a torque '{MOTOR}'")
    values, cost = draw(scene, 0, 0, n_samples), prices(model)
    print(f"a correction takes {cost.correction:.3f} us, a residual {cost.residual:.3f} us")
    results = [item for load in LOADS for item in measure(model, load, values, n_samples)]
    for table in (error_table(results, cost), equal_table(results, cost)):
        print(table.markdown(), end="\n\n")


if __name__ == "__main__":
    main(__doc__, run, 8)
