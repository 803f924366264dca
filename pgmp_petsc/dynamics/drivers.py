"""What drives an integration from stop to stop: PETSc's TS, or a plain loop where there is no PETSc.

An integrator advances itself. The driver says when, and with PETSc lets its monitors see the states at the stops; both
make the same calls in the same order, so that no number depends on which of them it is.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

import numpy as np

from pgmp_petsc.dynamics.ts_options import check_end
from pgmp_petsc.runtime.installed import has_petsc
from pgmp_petsc.runtime.petsc import as_raised, petsc_solver

if TYPE_CHECKING:
    from mpi4py import MPI
    from petsc4py import PETSc

    from pgmp_petsc.dynamics.second_order_system import State


class Driven(Protocol):
    """An integration.

    Attributes
    ----------
    state
        The current state.
    instants
        Of the start and the ends of all steps, shape (n_steps + 1,), s.
    stops
        Numbers of the steps that it stops at, 0 and the last one included.
    n_done
        Steps that are behind it.
    """

    state: State
    instants: np.ndarray
    stops: np.ndarray
    n_done: int

    def advance(self) -> None:
        """Go on to the next stop."""


def driver_here() -> Driver:
    """Return the driver of this Python."""
    return PetscDriver() if has_petsc() else LoopDriver()


class Driver(Protocol):
    """Drives an integration to its end."""

    def drive(self, integration: Driven, comm: MPI.Comm, prefix: str) -> None:
        """Go through all stops. Collective on `comm`.

        Parameters
        ----------
        prefix
            Of the options of PETSc that reach this integration.

        Raises
        ------
        InputError
            If PETSc refuses the value of an option.
        RunError
            If it ends early, with PETSc's reason.
        """


class LoopDriver:
    """A plain loop; takes no options."""

    def drive(self, integration: Driven, comm: MPI.Comm, prefix: str) -> None:
        """Go through all stops; see `Driver`."""
        while integration.n_done < integration.stops[-1]:
            integration.advance()


class PetscDriver:
    """PETSc's TS, whose steps are those from stop to stop."""

    def drive(self, integration: Driven, comm: MPI.Comm, prefix: str) -> None:
        """Go through all stops; see `Driver`."""
        from petsc4py import PETSc

        instants, n_stops = integration.instants, len(integration.stops) - 1
        solution = PETSc.Vec().createMPI((integration.state.q.size, None), comm=comm)
        solution.setArray(integration.state.q.ravel())
        ts = PETSc.TS().create(comm=comm)
        try:
            ts.setOptionsPrefix(prefix)
            ts.setType(PETSc.TS.Type.PYTHON)
            ts.setPythonContext(_Context(integration))
            ts.setTime(0.0)
            ts.setTimeStep(float(instants[integration.stops[1]]))
            # the number of steps ends the run, not round-off in their sum
            ts.setMaxTime(2 * float(instants[-1]))
            ts.setMaxSteps(n_stops)
            ts.setExactFinalTime(PETSc.TS.ExactFinalTime.STEPOVER)
            with petsc_solver(prefix, "time integration"):
                ts.setFromOptions()
            with as_raised():
                ts.solve(solution)
            check_end(ts, n_stops, float(instants[-1]))
        finally:
            ts.destroy()
            solution.destroy()


class _Context:
    """What a TS of type python calls."""

    def __init__(self, integration: Driven) -> None:
        self._integration = integration

    def solveStep(self, ts: PETSc.TS, end: float, u: PETSc.Vec) -> None:  # noqa: N802 (PETSc's name)
        """Do a step of the TS."""
        integration = self._integration
        begin = integration.n_done
        integration.advance()
        ts.setTimeStep(float(integration.instants[integration.n_done] - integration.instants[begin]))
        u.setArray(integration.state.q.ravel())
