"""What a user may tell PETSc's TS, and whether it did what the scene asks for.

The scene says how long a run is and how it is stepped, and the integrator is the program's own. Options that look on
(`ts_monitor`, `ts_view`) are taken, all others refused: to PETSc they are legal, and many would end a run early or
change its steps without a word.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pgmp_petsc.runtime.errors import InputError, RunError
from pgmp_petsc.runtime.petsc import options_of

if TYPE_CHECKING:
    from petsc4py import PETSc

PREFIX = "pgmp_ts_"
ERROR_PREFIX = "pgmp_error_ts_"  # of the integration of estimated errors
LOOKING_ON = ("ts_monitor", "ts_view", "ts_adapt_monitor", "ts_converged_reason")
_CURES = {
    "ts_type": "the integrator is the program's own",
    "ts_dt": "set simulation.step in the scene",
    "ts_time_step": "set simulation.step in the scene",
    "ts_max_steps": "set simulation.duration in the scene",
    "ts_run_steps": "set simulation.duration in the scene",
    "ts_max_time": "set simulation.duration in the scene",
    "ts_time_span": "set simulation.duration in the scene",
    "ts_init_time": "a run starts at time 0",
    "ts_exact_final_time": "a run ends at simulation.duration exactly",
}
TIME_TOLERANCE = 1e-9  # of the duration: far above the round-off in the sum of all steps, far below one of them


def check_ts_options() -> None:
    """Refuse options with the prefix of a TS of this program, unless they only look on.

    Raises
    ------
    InputError
        Naming the first option that is refused; the same on all ranks, because options are.
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


def check_end(ts: PETSc.TS, n_steps: int, duration: float) -> None:
    """Check that a TS has done all its steps.

    Raises
    ------
    RunError
        If it stopped early or went on, with PETSc's reason.
    """
    reason, done, time = ts.getConvergedReason(), ts.getStepNumber(), ts.getTime()
    if reason <= 0 or done != n_steps or not abs(time - duration) <= TIME_TOLERANCE * duration:
        raise RunError(
            f"the time integration ended at {time:.6g} s of {duration:g} s after {done} of {n_steps} steps: PETSc's TS "
            f"gives reason {reason} ({_name(ts, reason)})"
        )


def _name(ts: PETSc.TS, reason: int) -> str:
    """Return PETSc's name of a reason."""
    names = {value: name for name, value in vars(type(ts).ConvergedReason).items() if isinstance(value, int)}
    return names.get(reason, "unknown")
