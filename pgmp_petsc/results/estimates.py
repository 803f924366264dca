"""Estimated errors of one run; and limits of what says how far a run left small deformations.

An error is, of a reduced run, its output less that of the full-order equations, with what the time step does wrong; of
full-order and component runs what the time step does wrong. NaN where there is no estimate.

The balance of energy of a run.

    kinetic + strain = (kinetic + strain at the start) + sum over effects of their work + residual

An effect's work is the loss of its potential energy, if it has one, and the integral over time of its other power,
taken by the trapezoidal rule over the steps: the residual falls with the square of the step, and so does the scheme's
numerical damping, which is part of it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pgmp_petsc.declare.records import Record, array, attribute, derived

OF_REDUCED, OF_STEP = "reduced less full-order", "of the time step"
#: Static answers that a reduction may be without, and stresses with it, by its entries.
ANSWERS = {"static_modes": "loads", "inertia_modes": "inertia forces"}
LARGE = 0.05  # error as a share of an output's largest value, from which on a run warns of it
# rad. Displacements linear in the deformation turn a length by phi and make it longer by phi^2 / 2 of itself, which is
# the relative error of a linear strain measure: one per cent here.
ROTATION_LIMIT = 0.14
# Metals yield at 0.002 to 0.007 and glass fibre breaks at about 0.02: beyond this none but rubber is linear.
STRAIN_LIMIT = 0.01
# A share of a mode's stiffness: static deflections change by as much, frequencies by half of it.
SHARE_LIMIT = 0.1
# With geometric stiffening, of first order in the forces: what it leaves out is about the square of the share.
SHARE_LIMIT_WITH_STIFFENING = 0.5
#: What says how far a run left small deformations, as results have it (`declare.records`).
VALIDITY = {
    "elastic_rotation": {"unit": "rad", "about": "largest rotation of a node less that of its rigid body"},
    "elastic_strain": {"unit": "1", "about": "largest strain along an outermost fibre"},
    "stiffness_gained": {"unit": "1", "about": "largest share by which forces in the bodies stiffen a mode"},
    "stiffness_lost": {
        "unit": "1", "about": "largest share by which forces in the bodies soften a mode, negative; -1 is buckling",
    },
}  # fmt: skip


def limits_of(second_order: bool) -> dict[str, float]:
    """Return the largest size of every value of `VALIDITY` that is not worth a warning, in a model with geometric
    stiffening or without."""
    return {
        "elastic_rotation": ROTATION_LIMIT,
        "elastic_strain": STRAIN_LIMIT,
        "stiffness_gained": float("inf") if second_order else SHARE_LIMIT,
        "stiffness_lost": SHARE_LIMIT_WITH_STIFFENING if second_order else SHARE_LIMIT,
    }


@dataclass(frozen=True)
class EstimatedErrors(Record):
    """Estimated errors of a run."""

    time: np.ndarray = array(
        "error_time", unit="s", about="instants at which the errors are estimated", label="error_time", is_axis=True
    )
    outputs: dict[str, np.ndarray] = array(
        "error_time", at="", unit="{unit}", about="estimated error of output '{name}', {own.what}", gaps=True,
        label="error.{name}",
    )  # fmt: skip
    largest: dict[str, float] = attribute(
        "{key}@largest", names=lambda _, taken: taken["outputs"], unit="{unit}",
        about="largest size of the output over the run",
    )  # fmt: skip
    what: str = attribute("@what", absent=OF_REDUCED, about="what the errors are of")
    absent: dict[str, str] = attribute(
        "{key}@not_estimated", absent={}, names=lambda _, taken: taken["outputs"], about="why there is no estimate"
    )
    FURTHER = (
        derived(
            dict[str, float], lambda own, _: {name: own.maximum(name) for name in own.outputs}, "{key}@maximum",
            about="its largest size",
        ),
        derived(
            dict[str, float], lambda own, _: {name: own.share(name) for name in own.outputs}, "{key}@share",
            about="that as a share of the output's largest size over the run",
        ),
    )  # fmt: skip

    def end_before(self, time: float) -> bool:
        """Return whether they are known up to an instant before a time alone, s, as those of a run that stopped."""
        return bool(self.time[-1] < time * (1.0 - 1e-9))

    def maximum(self, output: str) -> float:
        """Return the largest size of an output's error, in its unit; NaN where there is no estimate."""
        return float(np.max(np.abs(self.outputs[output])))

    def share(self, output: str) -> float:
        """Return the largest error as a share of the output's largest size; NaN where that is zero."""
        largest = self.largest[output]
        return self.maximum(output) / largest if largest > 0.0 else float("nan")

    def of_one_run(self) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
        """Return the largest error and the largest size of every output, as of an ensemble of one sample, (1,) each."""
        maxima, sizes = (
            {name: np.array([of(name)]) for name in self.outputs} for of in (self.maximum, self.largest.get)
        )
        return maxima, sizes


#: What an ensemble keeps of the balance of every sample.
BALANCE = {
    "residual": {"unit": "J", "about": "largest residual of the balance of energy over the run"},
    "exchanged": {"unit": "J", "about": "the most energy that was moved around at any time"},
}
FREE = 1e-12  # of the kinetic energy: works and strain energies that are no larger are round-off
RESOLVED = 8  # steps that a change of energy takes at least; faster ones are what a balance is to show


def _energy(name: str, about: str) -> np.ndarray:
    return array("time", unit="J", about=about, at=f"energy/{name}", gaps=True, label=f"energy.{name}")


def moved_around(changed: np.ndarray, handed: np.ndarray, kinetic: np.ndarray) -> np.ndarray:
    """Return the most energy, J, that was moved around over runs, shape (n,) as the arguments: half of all changes and
    works by their amounts.

    Where no effect works and nothing deforms, that would be half the residual itself. Bodies hand one another kinetic
    energy alone then, and what of it they have is what is moved around.

    Parameters
    ----------
    changed, handed, kinetic
        The largest, over a run, of the changes and works, of those but for the kinetic energy's, and of the kinetic
        energy, J
    """
    return np.where(handed > FREE * kinetic, 0.5 * changed, kinetic)


@dataclass(frozen=True)
class Balance(Record):
    """The balance of energy of one run."""

    kinetic: np.ndarray = _energy("kinetic", "kinetic energy")
    strain: np.ndarray = _energy("strain", "strain energy")
    potential: np.ndarray = _energy("potential", "potential energy of weights, springs and stops")
    work: dict[str, np.ndarray] = array(
        "time", unit="J", about="work of effect '{name}' since the start", gaps=True, label="work.{name}"
    )
    FURTHER = (
        derived(
            np.ndarray, lambda own, _: own.residual, "energy/residual", "time", unit="J",
            about="gain of kinetic and strain energy less the effects' work", label="energy.residual", gaps=True,
        ),
        derived(
            float, lambda own, _: own.exchanged, "energy/residual@exchanged", unit="J",
            about="the most energy that was moved around at any time",
        ),
    )  # fmt: skip

    @property
    def residual(self) -> np.ndarray:
        """Energy gained that no effect brought, shape (n_t,), J."""
        stored = self.kinetic + self.strain
        return stored - stored[0] - sum(self.work.values(), np.zeros_like(stored))

    @property
    def exchanged(self) -> float:
        """The most energy that had been moved around at any time, J; see `moved_around`."""
        handed = sum((np.abs(done) for done in self.work.values()), np.abs(self.strain - self.strain[0]))
        changed = np.abs(self.kinetic - self.kinetic[0]) + handed
        return float(moved_around(changed.max(), handed.max(), self.kinetic.max()))

    @property
    def swings(self) -> np.ndarray:
        """How often energy had been turned over at each time, shape (n_t,): changes of the kinetic energy between the
        lowest and the highest quarter of its range, `RESOLVED` steps or more after each other."""
        low, high = np.quantile(self.kinetic, (0.0, 1.0)) @ [[0.75, 0.25], [0.25, 0.75]]
        side = np.where(self.kinetic > high, 1, np.where(self.kinetic < low, -1, 0))
        outer = np.flatnonzero(side)
        changes, last = np.zeros(self.kinetic.size, dtype=int), -RESOLVED
        for k in outer[1:][np.diff(side[outer]) != 0]:
            changes[k], last = k - last >= RESOLVED, k
        return np.cumsum(changes)
