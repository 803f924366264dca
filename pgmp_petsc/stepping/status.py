"""Status of a sample at its end."""

from __future__ import annotations

from enum import IntEnum


class Status(IntEnum):
    """Status of a sample; everything but FINE is a failure with the reason in its name."""

    FINE = 0
    UNPHYSICAL = 1
    NOT_CONVERGED = 2
    LEFT_RANGE = 3
    NOT_FINITE = 4
    SOLVER_FAILED = 5
    BROKE_DOWN = 6
    NO_EQUILIBRIUM = 7
    UNSTABLE = 8

    @property
    def meaning(self) -> str:
        """Return the reason in words."""
        return _MEANINGS[self]

    def cure(self, model: str, beyond_steps: str = "") -> str:
        """Return what helps against it in runs of a model (its name), empty where it is fine.

        `beyond_steps` is what helps where smaller steps do not (`Scene.beyond_steps`).
        """
        beyond = _BEYOND_THE_REDUCED.get(self, "") if model == "reduced" else ""
        return _CURES[self] + beyond + (beyond_steps if self == Status.NOT_CONVERGED else "")


class Outcome(IntEnum):
    """How far a sample went that was taken through several steps: to their end, or why it stopped earlier."""

    DONE = 0
    LOST = 1  # Newton's iteration failed
    OUTSIDE = 2  # it would have left the model's range
    CROSSED = 3  # it crosses the edge of a law, and a part of the step up to there fails


_MEANINGS = {
    Status.FINE: "fine",
    Status.UNPHYSICAL: "a parameter has no physical value (no finite number, outside its bounds, not positive, or "
    "negative, where that makes no sense, or the lower end of a stop not below the upper one); not integrated",
    Status.NOT_CONVERGED: "Newton's iteration did not converge within a time step",
    Status.LEFT_RANGE: "a coordinate left the range, beyond which neither the reduced model nor a deformation is known",
    Status.NOT_FINITE: "its motion or an output is no finite number",
    Status.SOLVER_FAILED: "the linear solver failed within a time step",
    Status.BROKE_DOWN: "its deformation left what the reduced model holds for: stiffness or inertia are no longer "
    "positive there, and the motion ran away",
    Status.NO_EQUILIBRIUM: "no static equilibrium was found to start from",
    Status.UNSTABLE: "its velocities have left what joints allow, as bodies turn by too much in a time step",
}
_CURES = {
    Status.FINE: "",
    Status.UNPHYSICAL: "give the parameter bounds, which truncate its distribution",
    Status.NOT_CONVERGED: "take a smaller simulation.step",
    Status.LEFT_RANGE: "widen the coordinate's range",
    Status.NOT_FINITE: "take a smaller simulation.step, or look at the loads and the start; a deformation is no number "
    "where the rigid mechanism cannot close",
    Status.SOLVER_FAILED: "see -pgmp_full_ksp_converged_reason",
    Status.BROKE_DOWN: "no step helps, and leaving geometric_stiffening out only hides it; build with stretching = "
    '"static" where it is "dynamic", with more reduction.angles or fewer reduction.modes where the build warned of a '
    "matrix that is not positive definite, or loads and parameters that bend less",
    Status.NO_EQUILIBRIUM: 'hold the coordinates (initial.coordinates = "held"), or look at the loads at time zero',
    Status.UNSTABLE: "take a smaller simulation.step, or a smaller simulation.spectral_radius",
}
_BEYOND_THE_REDUCED = {
    Status.LEFT_RANGE: ", and build a reduced model again; full-order and component runs go on beyond it where no "
    "output is a deformation",
    Status.BROKE_DOWN: ", or take the full-order model (pgmp simulate SCENE --full, pgmp montecarlo SCENE --full)",
}
