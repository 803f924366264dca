"""Drivers of an integration from stop to stop: PETSc's TS, or a plain loop where there is no PETSc.

An integrator advances itself. The driver says when, and with PETSc lets its monitors see the states at the stops; both
make the same calls in the same order, so that no number depends on which of them it is.

The scene says how long a run is and how it is stepped, and the integrator is the program's own. Options of PETSc that
look on (`ts_monitor`, `ts_view`) are taken, all others refused: to PETSc they are legal, and many would end a run early
or change its steps without a word.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Protocol

import numpy as np

from pgmp_petsc.base.errors import InputError, RunError
from pgmp_petsc.base.surroundings import Comm, has_petsc
from pgmp_petsc.ranks.petsc import options_of, petsc_solver
from pgmp_petsc.stepping.second_order_system import State

if TYPE_CHECKING:
    from petsc4py import PETSc

PREFIX = "pgmp_ts_"
ERROR_PREFIX = "pgmp_error_ts_"  # of the integration of estimated errors
LOOKING_ON = ("ts_monitor", "ts_view", "ts_adapt_monitor", "ts_converged_reason")
_CURES = {
    "ts_type": "the integrator is the program's own",
    **dict.fromkeys(("ts_dt", "ts_time_step"), "set simulation.step in the scene"),
    **dict.fromkeys(
        ("ts_max_steps", "ts_run_steps", "ts_max_time", "ts_time_span"), "set simulation.duration in the scene"
    ),
    "ts_init_time": "a run starts at time 0",
    "ts_exact_final_time": "a run ends at simulation.duration exactly",
}
TIME_TOLERANCE = 1e-9  # of the duration: far above the round-off in the sum of all steps, far below one of them


def check_ts_options() -> None:
    """Refuse options with the prefix of a TS of this program, unless they only look on.

    Raises `InputError`, naming the first option that is refused; the same on all ranks, because options are.
    """
    for prefix in (PREFIX, ERROR_PREFIX):
        for name, value in sorted(options_of(prefix).items()):
            if not name.startswith(LOOKING_ON):
                shown = f"-{prefix}{name} {'' if value is None else value}".strip()
                cure = _CURES.get(name, "how a run is integrated follows from the scene's [simulation]")
                raise InputError(
                    f"option {shown}: it cannot be changed here; {cure} (allowed with this prefix: "
                    f"{', '.join(f'-{prefix}{allowed}' for allowed in LOOKING_ON)})"
                )


class Integration(Protocol):
    """Interface of an integrator for its driver; see `GeneralisedAlpha`."""

    instants: np.ndarray  # of the start and the ends of all steps, shape (n_steps + 1,), s
    stops: np.ndarray  # numbers of the steps at which the driver sees the state, 0 and the last one included
    n_done: int  # steps that are behind it

    @property
    def state(self) -> State:
        """The current state."""

    def advance(self) -> None:
        """Advance to the next stop."""


def driver_here() -> Callable[[Integration, Comm, str], None]:
    """Return the driver of this Python.

    It goes through all stops of an integration, collective on a communicator, with a prefix of the options of PETSc
    that reach it. It raises `InputError` if PETSc refuses the value of an option, and `RunError` if it ends early, with
    PETSc's reason.
    """
    return drive_by_petsc if has_petsc() else drive_in_a_loop


def drive_in_a_loop(integration: Integration, comm: Comm, prefix: str) -> None:
    """Go through all stops in a plain loop, which takes no options; see `driver_here`."""
    while integration.n_done < integration.stops[-1]:
        integration.advance()


def drive_by_petsc(integration: Integration, comm: Comm, prefix: str) -> None:
    """Go through all stops as steps of PETSc's TS; see `driver_here`."""
    from petsc4py import PETSc

    instants, n_stops = integration.instants, len(integration.stops) - 1
    solution = PETSc.Vec().createMPI((integration.state.q.size, None), comm=comm)
    solution.setArray(integration.state.q.ravel())
    ts, context = PETSc.TS().create(comm=comm), _Context(integration)
    try:
        ts.setOptionsPrefix(prefix)
        ts.setType(PETSc.TS.Type.PYTHON)
        ts.setPythonContext(context)
        ts.setTime(0.0)
        ts.setTimeStep(float(instants[integration.stops[1]]))
        # the number of steps ends the run, not round-off in their sum
        ts.setMaxTime(2 * float(instants[-1]))
        ts.setMaxSteps(n_stops)
        ts.setExactFinalTime(PETSc.TS.ExactFinalTime.STEPOVER)
        with petsc_solver(prefix, "time integration"):
            ts.setFromOptions()
        ts.solve(solution)
        if context.failure is not None:
            raise context.failure
        reason, done, time, duration = ts.getConvergedReason(), ts.getStepNumber(), ts.getTime(), float(instants[-1])
        if reason <= 0 or done != n_stops or not abs(time - duration) <= TIME_TOLERANCE * duration:
            names = {value: name for name, value in vars(type(ts).ConvergedReason).items() if isinstance(value, int)}
            raise RunError(
                f"the time integration ended at {time:.6g} s of {duration:g} s after {done} of {n_stops} steps: "
                f"PETSc's TS gives reason {reason} ({names.get(reason, 'unknown')})"
            )
    finally:
        ts.destroy()
        solution.destroy()


class _Context:
    """Context of a TS of type python, which calls it.

    What is raised in a step does not go through PETSc, whose own error after it may end the process: the TS stops, and
    `failure` is raised behind it.
    """

    def __init__(self, integration: Integration) -> None:
        self._integration = integration
        self.failure: BaseException | None = None

    def solveStep(self, ts: PETSc.TS, end: float, u: PETSc.Vec) -> None:  # noqa: N802 (PETSc's name)
        """Do a step of the TS."""
        integration = self._integration
        begin = integration.n_done
        try:
            integration.advance()
        except BaseException as failure:
            self.failure = failure
            ts.setConvergedReason(ts.ConvergedReason.CONVERGED_USER)
            return
        ts.setTimeStep(float(integration.instants[integration.n_done] - integration.instants[begin]))
        u.setArray(integration.state.q.ravel())
