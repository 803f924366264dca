"""What the start of a reduced run does to all of it: vibrations that it sets off, and small differences that grow.

**Vibrations**, where loads at time zero meet undeformed bodies.

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

**Differences**, from a second run of the model.

Where joints have room, each impact makes differences larger. A run from coordinates that are off by `OFF` of the range
in which each of them moves says by how much: with G(t) the largest difference of an output up to t, as a share of its
range, over `OFF`, a start that is known to the share p is lost where ``p G`` is one. Speeds, accelerations and forces
do not count, as they jump with an impact.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from pgmp_petsc.base.errors import InputError, Remark, gathered, note, warning
from pgmp_petsc.effects import AT_REST
from pgmp_petsc.models import OutputRecord, ReducedModel
from pgmp_petsc.models.model import search_of
from pgmp_petsc.models.reduced_statics import ReducedStatics
from pgmp_petsc.reduced.system import ReducedSystem
from pgmp_petsc.results.numbers import Arrays
from pgmp_petsc.scene.numerics import Simulation
from pgmp_petsc.scene.outputs import models_alone
from pgmp_petsc.scene.references import parts_of
from pgmp_petsc.stepping.generalised_alpha import integrate
from pgmp_petsc.stepping.second_order_system import State
from pgmp_petsc.stepping.static_equilibrium import settle
from pgmp_petsc.stepping.status import Status

LARGE = 0.5  # share of the largest deformation from which on a run is about its start
CURED = 0.25  # share of the swing that a start from static deformation may leave
STILL = 1e-6  # of the mechanism's size, or of 1 rad: what moves by less has no range
OFF = 1e-9  # of the range of each coordinate
TAIL = 1e-9  # of the forces that accelerate the start, below which that of a smooth law is its tail
KNOWN = 1e-3  # to which a start is known, as a rule


def jump_remarks(model: ReducedModel, system: ReducedSystem, start: State, strain: np.ndarray) -> tuple[Remark, ...]:
    """Return that most of the deformation of a run is the swing that its start sets off, and the cure.

    A warning where a start from static deformation cures it: then the mechanism is held or driven from the start, and
    would not have been undeformed. Otherwise a note: it may be let go, or loads may set in, as the scene says. The
    strain energy is that over the run, shape (n_t,), J.
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
    damped = any(effect.on_vibrations for effect in model.scene.effects.values())
    lasts = "" if damped else "; nothing in the bodies damps it: it falls out of step with that of a better model"
    if model.scene.carried:
        lasts += (
            "; friction hangs on the forces that it makes in joints: where the step does not follow it, estimated "
            "errors may be several times too small"
        )
    if _is_cured(model, system, start, swing, energy):
        return (warning(f"{what}; initial.equilibrium = true starts with the static one{lasts}"),)
    cure = "let loads grow from zero, or add structural_damping"
    return (note(f"{what}; where that is not meant, {cure} (initial.equilibrium = true does not help here){lasts}"),)


def _quasi_static(model: ReducedModel, system: ReducedSystem, state: State) -> np.ndarray:
    """Return the quasi-static deformation at the start of one sample, without given coordinates, shape (n,)."""
    r, n = system.tables.n_coordinates, system.n_moving
    stiffness, inertia = (matrix[0, :n, :n] for matrix in system.stiffness_and_inertia(0.0, state))
    free = [k for k in range(r) if k not in model.motions]
    moved = np.linalg.solve(inertia[np.ix_(free, free)], inertia[free, r:])
    # springs may be zero, of what elastic joints release
    return np.linalg.lstsq(
        stiffness[r:, r:], (inertia[r:, r:] - inertia[r:, free] @ moved) @ state.a[0, r:n], rcond=None
    )[0]


def _strain_energy(system: ReducedSystem, state: State, deformation: np.ndarray) -> float:
    """Return the strain energy of one sample at the start with another deformation, J."""
    bent = np.zeros_like(state.q)
    bent[0, : system.tables.n_coordinates] = state.q[0, : system.tables.n_coordinates]
    bent[0, system.tables.n_coordinates : system.n_moving] = deformation
    return float(system.strain_energy(bent)[0])


def _acting(model: ReducedModel, system: ReducedSystem, state: State) -> list[str]:
    """Return the effects and controllers whose forces count at the start of one sample, by their entries."""
    at = np.zeros(1)
    names = set(model.terms.tables.load_effects)
    found = {effect.name for effect in model.effects if effect.name in names and np.any(effect.amplitude(at))}
    if actions := model.actions.actions:
        forces = system.action_forces(at, np.array([[state.q, state.v, state.a]])).reshape(len(actions), -1)
        n = system.n_moving
        moved = np.abs(system.stiffness_and_inertia(0.0, state)[1][0, :n, :n] @ state.a[0, :n]).max()
        found |= {action.effect for action, own in zip(actions, forces) if np.abs(own).max() > TAIL * moved}
    named = {f"effects.{name}": parts_of(name, effect) for name, effect in model.scene.effects.items()}
    named |= {f"controllers.{name}": (name,) for name in model.scene.controllers}
    return [entry for entry, parts in named.items() if not found.isdisjoint(parts)]


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
    left = swing - held.unknowns[system.tables.n_coordinates : system.n_moving, 0]
    return _strain_energy(system, state, left) <= CURED**2 * energy


def growth_of(model: ReducedModel, simulation: Simulation, eta: np.ndarray, outputs: Arrays) -> np.ndarray | None:
    """Return G (n_t,) of a run with coordinates (n_t, n_eta) and outputs; None where a run from beside its start does
    not end, or nothing moves."""
    scene = model.scene
    smooth = [k for k, one in scene.outputs.items() if not (models_alone(scene, k) or one.derivatives_in(scene))]
    size = model.kinematics.size
    system = model.batch({name: np.array([value]) for name, value in model.scene.values.items()}, 1)
    start = system.start()
    q = start.q.copy()
    q[:, : system.n_moving] += OFF * np.ptp(eta, axis=0)[: system.n_moving]
    system.begun = q, start.v
    record = OutputRecord(model, system)
    if integrate(system, simulation, observer=record).status[0] != Status.FINE:
        return None
    beside = record.evaluated()[1]
    shares = [
        np.maximum.accumulate(np.abs(beside[name][:, 0] - own)) / np.ptp(own)
        for name, own in outputs.items()
        if name in smooth and np.ptp(own) > STILL * (1.0 if model.outputs.units[name] == "rad" else size)
    ]
    return np.max(shares, axis=0) / OFF if shares else None


@gathered
def spread_remarks(times: np.ndarray, growth: np.ndarray | None) -> Iterator[Remark]:
    """Return by how much differences of the start grow over a run, and that it is chaotic where they take all."""
    if growth is None:
        return
    grown = f"a small difference of the start becomes {growth[-1]:.2g} times as large over the run, by its impacts"
    lost = growth * KNOWN >= 1.0
    if not lost.any():
        yield note(grown)
        return
    yield warning(
        f"chaotic: {grown}. Of a start that is known to {KNOWN:g} nothing is left from {times[np.argmax(lost)]:.3g} s "
        "on: a single history is one of many there, and statistics of samples (pgmp montecarlo) are what is known"
    )
