"""Vibrations that the start of a reduced run sets off, where loads at time zero meet undeformed bodies.

The equations of motion at the start, ``M a = F`` with ``delta = 0``, give accelerations of the flexible coordinates.
Had the bodies been given time, they would have the quasi-static deformation delta_0 under the same loads and the
inertia forces of the rigid motion that these make. With the rigid accelerations eliminated,

    K delta_0 = (M_dd - M_dr M_rr^-1 M_rd) a_d,

d the flexible and r the rigid coordinates that are not prescribed. Without damping the bodies swing about delta_0 from
nothing to twice of it: a mass on a spring to which a weight is added. By strain energy the swing is the share

    2 sqrt(U(delta_0) / largest U of the run)

of the largest deformation; above 1 where modes do not reach their crests together. A start from static deformation
with coordinates held, delta_h, leaves a swing by ``delta_0 - delta_h``: none where motions are prescribed, more than
before where the mechanism is let go and what held it was a large torque.
"""

from __future__ import annotations

import numpy as np

from pgmp_petsc.dynamics.reduced_system import ReducedSystem
from pgmp_petsc.dynamics.second_order_system import State
from pgmp_petsc.dynamics.static_equilibrium import settle
from pgmp_petsc.models import ReducedModel
from pgmp_petsc.models.model import AT_REST, search_of
from pgmp_petsc.models.reduced_statics import ReducedStatics
from pgmp_petsc.runtime.errors import InputError
from pgmp_petsc.runtime.remarks import Remark, note, warning
from pgmp_petsc.scene.effects import StructuralDamping
from pgmp_petsc.scene.load_parts import parts_of

LARGE = 0.5  # share of the largest deformation from which on a run is about its start
CURED = 0.25  # share of the swing that a start from static deformation may leave


def jump_remarks(model: ReducedModel, system: ReducedSystem, start: State, strain: np.ndarray) -> tuple[Remark, ...]:
    """Return that most of the deformation of a run is the swing that its start sets off, and the cure.

    A warning where a start from static deformation cures it: then the mechanism is held or driven from the start, and
    would not have been undeformed. Otherwise a note: it may be let go, or loads may set in, as the scene says.

    Parameters
    ----------
    model, system, start
        Of the run.
    strain
        Strain energy over the run, shape (n_t,), J.
    """
    largest = float(np.max(strain, initial=0.0))
    if model.scene.initial.equilibrium or not largest > 0.0:
        return ()
    swing = _quasi_static(model, system, start)
    energy = _strain_energy(system, start, swing)
    share = 2.0 * np.sqrt(max(energy, 0.0) / largest)
    if not share >= LARGE:
        return ()
    at_once = ", ".join(_acting(model, system, start)) or "inertia forces of its speed"
    what = (
        f"the run starts undeformed, with {at_once} at once: the vibration that this sets off makes "
        f"{min(100.0 * share, 100.0):.0f} % of its largest deformation"
    )
    damped = any(isinstance(effect, StructuralDamping) for effect in model.scene.effects.values())
    lasts = "" if damped else "; nothing in the bodies damps it: it falls out of step with that of a better model"
    if _is_cured(model, system, start, swing, energy):
        return (warning(f"{what}; initial.equilibrium = true starts with the static one{lasts}"),)
    cure = "let loads grow from zero, or add structural_damping"
    return (note(f"{what}; where that is not meant, {cure} (initial.equilibrium = true does not help here){lasts}"),)


def _quasi_static(model: ReducedModel, system: ReducedSystem, state: State) -> np.ndarray:
    """Return the quasi-static deformation at the start of one sample, shape (n_modes,)."""
    r = system.tables.n_coordinates
    stiffness, inertia = (matrix[0] for matrix in system.stiffness_and_inertia(0.0, state))
    free = [k for k in range(r) if k not in model.motions]
    moved = np.linalg.solve(inertia[np.ix_(free, free)], inertia[free, r:])
    return np.linalg.solve(stiffness[r:, r:], (inertia[r:, r:] - inertia[r:, free] @ moved) @ state.a[0, r:])


def _strain_energy(system: ReducedSystem, state: State, deformation: np.ndarray) -> float:
    """Return the strain energy of one sample at the start with another deformation, J."""
    bent = state.q.copy()
    bent[0, system.tables.n_coordinates :] = deformation
    return float(system.strain_energy(bent)[0])


def _acting(model: ReducedModel, system: ReducedSystem, state: State) -> list[str]:
    """Return the effects whose forces are not zero at the start of one sample, by their entries."""
    at = np.zeros(1)
    names = set(model.terms.tables.load_effects)
    found = {effect.name for effect in model.effects if effect.name in names and np.any(effect.amplitude(at))}
    if actions := model.actions.actions:
        forces = system.action_forces(at, np.array([[state.q, state.v, state.a]])).reshape(len(actions), -1)
        found |= {action.effect for action, own in zip(actions, forces) if np.any(own)}
    named = model.scene.effects.items()
    return [f"effects.{name}" for name, effect in named if not found.isdisjoint(parts_of(name, effect))]


def _is_cured(model: ReducedModel, system: ReducedSystem, state: State, swing: np.ndarray, energy: float) -> bool:
    """Return whether a start from static deformation, with coordinates held, leaves little of the swing."""
    if np.max(np.abs(model.start[1])) * model.scene.simulation.duration > AT_REST:
        return False  # it starts at rest alone
    statics, search = ReducedStatics(system, model.joint_angles), search_of(model.scene, model.kinematics.mechanism)
    try:
        held = settle(statics, model.start[0][None], search)
    except InputError:  # under large loads the search may end where the mechanism cannot close
        return False
    if held.reasons:
        return False
    left = swing - held.unknowns[system.tables.n_coordinates :, 0]
    return _strain_energy(system, state, left) <= CURED**2 * energy
