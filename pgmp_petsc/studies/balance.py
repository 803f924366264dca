"""The balance of energy of a run, drawn up from what its model knew at every step."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pgmp_petsc.base.errors import Remark, warning
from pgmp_petsc.bodies.matrices import assemble
from pgmp_petsc.effects import loads_of
from pgmp_petsc.mechanism.body_frames import rigid_positions, to_body
from pgmp_petsc.models import ReducedModel
from pgmp_petsc.reduced.energy import load_powers
from pgmp_petsc.results.estimates import Balance
from pgmp_petsc.stepping.energies import Energies

# Of the most energy that was moved around: runs whose steps resolve what goes on stay below a hundredth while it is
# turned over once. What is left over adds up with every time that it is, as errors do; half of it is never right.
LARGEST_RESIDUAL, LARGEST_EVER = 0.05, 0.5
ROUND_OFF = 1e-9  # of the energies themselves: less is no residual of a mechanism that rests


def balance_of(time: np.ndarray, energies: Energies) -> Balance:
    """Draw up the balance of a run from its energies at all times, each of shape (n_t,), s."""
    work: dict[str, np.ndarray] = {}
    potential = np.zeros(len(time))
    for name, stored in energies.potential.items():
        potential += stored
        work[name] = stored[0] - stored
    for name, power in energies.powers.items():
        done = np.cumsum(0.5 * (power[1:] + power[:-1]) * np.diff(time))
        work[name] = work.get(name, 0.0) + np.concatenate([[0.0], done])
    return Balance(energies.kinetic, energies.strain, potential, work)


def balance_remarks(balance: Balance, step: float, joule: str = "J") -> list[Remark]:
    """Return a warning where the energies of a run with steps of this length, s, are far from balance; `joule` is
    their unit."""
    residual, exchanged = np.abs(balance.residual), balance.exchanged
    largest = float(residual.max())
    stored = max(float(np.abs(part).max()) for part in (balance.kinetic, balance.strain, balance.potential))
    allowed = np.minimum(LARGEST_RESIDUAL * np.sqrt(1.0 + balance.swings), LARGEST_EVER) * exchanged
    if not np.any(residual > np.maximum(allowed, ROUND_OFF * stored)):
        return []
    return [
        warning(
            f"energies are out of balance by up to {largest:.3g} {joule}, of {exchanged:.3g} {joule} that were moved "
            f"around: steps of {step:.3g} s do not resolve what goes on, such as the vibration of light nodes in a "
            "joint on which a load sets in at once; stresses and deformations, and the motion too, may be far off; let "
            "such loads rise from zero over ten steps or more, or take a smaller simulation.step"
        )
    ]


def with_weights(balance: Balance, model: ReducedModel, start: np.ndarray) -> Balance:
    """Add the potential energy of weights to the balance of a reduced run, which knows their work alone.

    It is that at the start, reduced coordinates of shape (n_eta,), less the work done since: the same integral as in
    the residual, which does not change.
    """
    effects = [effect for effect in model.effects if effect.conservative]
    if not effects:
        return balance
    mechanism = model.kinematics.mechanism
    r, values = model.kinematics.n_coordinates, {k: np.array([v]) for k, v in model.scene.values.items()}
    poses = model.kinematics.poses(start[:r])[..., 0]
    # from the undeformed bodies to the start, halfway: the work is of second degree in the deformation
    deformed = np.where(np.arange(start.size) < r, 0.0, start)
    bent = load_powers(model.terms, values, (start - 0.5 * deformed)[None], deformed[None])
    places = rigid_positions(mechanism, poses)
    matrices = assemble(mechanism.bodies, range(mechanism.n_dofs))
    potential = balance.potential
    for effect in effects:
        lifted = 0.0
        for load in loads_of([effect], matrices):
            weight, field = load.body_force
            force = matrices.mass[weight] @ to_body(mechanism, poses, field)
            lifted += float(load.weight.evaluate(model.scene.values)) * float(force @ places)
        lifted += float(bent[effect.name][0])
        potential = potential - float(effect.amplitude(0.0)) * lifted - balance.work[effect.name]
    return replace(balance, potential=potential)
