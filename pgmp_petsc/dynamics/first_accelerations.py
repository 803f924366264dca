"""The auxiliary accelerations that a run of the generalised-alpha scheme begins with.

The scheme may begin with any A_0 within O(h) of q''_0, and keeps its order (Arnold and Bruls 2007). With q''_0 itself a
load that sets in at once on a light and stiff node, such as a joint's, gives the first step velocities of the size
h q''_0: those of a vibration with the frequency omega are h omega times too large, its energy (h omega)^2 times (the
overshoot of dissipative schemes, Hilber and Hughes 1978), and it takes many steps until they are damped. A_0 is
therefore taken of steps that cannot overshoot,

    q_1 = q_0 + h q'_0 + h^2 / 2 q''_1,    q'_1 = q'_0 + h q''_1

(Newmark's with beta = 1/2, gamma = 1). Where they resolve a motion, q''_1 = q''_0 + h q'''_0 + O(h^2); where not,
it is q''_0 / (1 + (h omega)^2 / 2) from rest. Twice that of a step of half the length, less that of a whole one, is
q''_0 + O(h^2) of what is resolved, and next to nothing of the rest.

So begin systems that say ``has_light_nodes``: those of all nodes. Modes of a reduced model hardly have such vibrations;
it begins with q''_0, as its derivatives and its model in C do.
"""

from __future__ import annotations

import numpy as np

from pgmp_petsc.dynamics.alpha_step import AlphaStep
from pgmp_petsc.dynamics.second_order_system import Scheme, SecondOrderSystem, State

LENGTHS = (0.5, 1.0)  # of a run's step


class _ImplicitStep(AlphaStep):
    """Steps whose displacements and velocities follow from the accelerations at their ends alone."""

    def scheme(self, step: float) -> Scheme:
        """Return the coefficients for a step."""
        self._scheme, self._step = Scheme(0.0, 0.0, 0.5, 1.0, gain_v=2.0 / step, gain_a=2.0 / step**2), step
        return self._scheme


def n_first_steps(system: SecondOrderSystem) -> int:
    """Return the number of steps that the first accelerations of a system are taken of, beside those of a run."""
    return len(LENGTHS) if getattr(system, "has_light_nodes", False) else 0


def first_accelerations(
    system: SecondOrderSystem, start: State, step: float, samples: np.ndarray
) -> tuple[np.ndarray, int]:
    """Return the auxiliary accelerations to begin with. Collective on ``system.comm``.

    Parameters
    ----------
    system, start
        The system, and its state at time 0.
    step
        Length of the steps of the run, s.
    samples
        Mask of the samples to advance, shape (n_samples,). Others, and those that such a step is too much for, begin
        with their accelerations.

    Returns
    -------
    accelerations
        Of the shape of ``start.a``.
    n_iterations
        Newton corrections that they took, all samples together.
    """
    stepper, found, lost, ends = _ImplicitStep(system, 0.0), start.copy(), ~samples, []
    for length in (share * step for share in LENGTHS):
        end, _, failed = stepper.advance(start, start.a, length, length, samples, for_good=False)
        ends.append(end.a)
        lost |= failed
    found.a = 2.0 * ends[0] - ends[1]
    system.restore(found, start, lost)
    return found.a, stepper.n_iterations
