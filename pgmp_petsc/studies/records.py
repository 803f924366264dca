"""Records of full-order runs: outputs, coordinates and energies at every instant, and now and then all nodes.

The balance of energy of a run, drawn up from what its model knew at every step.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from dataclasses import replace

import numpy as np

from pgmp_petsc.base.errors import Remark, gathered, warning
from pgmp_petsc.base.units import SI, UnitSystem
from pgmp_petsc.bodies.matrices import assemble
from pgmp_petsc.effects import loads_of
from pgmp_petsc.full.distributed import FullDistributed
from pgmp_petsc.full.systems import FullBatch
from pgmp_petsc.mechanism.body_frames import rigid_positions, to_body
from pgmp_petsc.mechanism.space import SPATIAL
from pgmp_petsc.models import FullModel, ReducedModel
from pgmp_petsc.models.body_fields import Fields, FullFields
from pgmp_petsc.models.body_fields import joined as joined_fields
from pgmp_petsc.outputs.readings import Reading
from pgmp_petsc.reduced.lagrangian_terms import load_powers
from pgmp_petsc.results.estimates import Balance
from pgmp_petsc.stepping.second_order_system import Energies, PooledObserver, State, joined


class FullRecord(PooledObserver):
    """Record of a run of one sample.

    It is of a model and the system that is integrated, collective on its communicator. The frames of all nodes, and
    fields of bodies, are kept at the steps that are `wanted`.
    """

    def __init__(
        self,
        model: FullModel,
        system: FullBatch | FullDistributed,
        fields: FullFields,
        wanted: Collection[int],
        pulse: Callable[[int], object],
    ) -> None:
        super().__init__(system.instants_at_once, pulse)
        self._model, self._system, self._of_fields, self._wanted = model, system, fields, wanted
        self._outputs: list[np.ndarray] = []
        self._coordinates: list[np.ndarray] = []
        self._energies: list[Energies] = []
        self._frames: list[np.ndarray] = []
        self._unknowns: list[np.ndarray] = []  # at frames whose fields are to come
        self._fields: list[Fields] = []

    def outputs(self) -> np.ndarray:
        """Return what the outputs are made of at all instants, shape (n_observed, n_t)."""
        self.finish()
        return np.concatenate(self._outputs, axis=-1)

    def recorded(self) -> dict[str, np.ndarray | Energies | list[np.ndarray]]:
        """Return coordinates (n_t, n_theta), energies, and where they are wanted frames, (n_nodes, n_frame) each."""
        self.finish()
        return {
            "coordinates": np.concatenate(self._coordinates, axis=-1).T,
            "energies": joined(self._energies),
            "frames": self._frames,
        }

    def fields(self) -> Fields:
        """Return the fields of bodies where they are wanted."""
        self.finish()
        self._evaluate_fields()
        return joined_fields(self._fields)

    def see(self, first: int, states: State) -> None:
        """Evaluate states."""
        times = self.times[first:]
        every = self._system.frames_over(states)
        self._energies.append(self._system.energies_over(times, states))
        self._outputs.append(self._model.observed_over(self._system, states, times, every))
        self._coordinates.append(self._measured(every))
        wanted = [k for k in range(len(times)) if first + k in self._wanted]
        self._frames += [every[..., k] for k in wanted]
        if self._of_fields.seen.points and wanted:
            unknowns = self._system.unknowns_over(states)[0]
            for k in wanted:
                self._unknowns.append(unknowns[:, k : k + 1])
                if len(self._unknowns) == self._of_fields.at_once:
                    self._evaluate_fields()

    def _evaluate_fields(self) -> None:
        waiting, self._unknowns = self._unknowns, []
        if waiting:
            values = {name: float(np.ravel(value)[0]) for name, value in self._system.values.items()}
            with np.errstate(all="ignore"):
                self._fields.append(self._of_fields.of(np.concatenate(waiting, axis=1), values))

    def _measured(self, every: np.ndarray) -> np.ndarray:
        """Return the measured coordinates, shape (n_theta, n), from the frames of all nodes (n_nodes, n_frame, n)."""
        kinematics = self._model.kinematics
        if kinematics.mechanism.space is SPATIAL:
            return every[0, SPATIAL.n_pose :]
        readings = [Reading.of_coordinate(coordinate, kinematics) for coordinate in kinematics.coordinates]
        return np.array([one.value({node: every[node] for node in one.nodes}) for one in readings])


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


@gathered
def balance_remarks(balance: Balance, step: float, system: UnitSystem = SI) -> Iterator[Remark]:
    """Return a warning, in units of a system, where the energies of a run with steps of this length, s, are far from
    balance."""
    residual, exchanged = np.abs(balance.residual), balance.exchanged
    largest = float(residual.max())
    stored = max(float(np.abs(part).max()) for part in (balance.kinetic, balance.strain, balance.potential))
    allowed = np.minimum(LARGEST_RESIDUAL * np.sqrt(1.0 + balance.swings), LARGEST_EVER) * exchanged
    if not np.any(residual > np.maximum(allowed, ROUND_OFF * stored)):
        return
    yield warning(
        f"energies are out of balance by up to {system.text(largest, 'J')}, of {system.text(exchanged, 'J')} that were "
        f"moved around: steps of {step:.3g} s do not resolve what goes on, such as the vibration of light nodes in a "
        "joint on which a load sets in at once; stresses and deformations, and the motion too, may be far off; let "
        "such loads rise from zero over ten steps or more, or take a smaller simulation.step"
    )


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
