"""Records of full-order runs: outputs, coordinates and energies at every instant, and now and then all nodes."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from pgmp_petsc.full.systems import FullBatch, FullDistributed
from pgmp_petsc.mechanism.space import SPATIAL
from pgmp_petsc.models import FullModel
from pgmp_petsc.models.body_fields import Fields, FullFields
from pgmp_petsc.models.body_fields import joined as joined_fields
from pgmp_petsc.outputs.readings import Reading
from pgmp_petsc.stepping.energies import Energies, joined
from pgmp_petsc.stepping.second_order_system import State


class FullRecord:
    """Record of a run of one sample; states are evaluated as many at once as the system is quickest with.

    Parameters
    ----------
    model, system
        The model, and the system that is integrated. Collective on its communicator.
    fields
        What makes the fields of bodies.
    wanted
        Steps at which the frames of all nodes and the fields are kept.

    Attributes
    ----------
    times
        Instants so far, s.
    """

    def __init__(
        self, model: FullModel, system: FullBatch | FullDistributed, fields: FullFields, wanted: Collection[int]
    ) -> None:
        self._model, self._system, self._of_fields, self._wanted = model, system, fields, wanted
        self.times: list[float] = []
        self._pending: list[State] = []
        self._outputs: list[np.ndarray] = []
        self._coordinates: list[np.ndarray] = []
        self._energies: list[Energies] = []
        self._frames: list[np.ndarray] = []
        self._unknowns: list[np.ndarray] = []  # at frames whose fields are to come
        self._fields: list[Fields] = []

    def observe(self, step: int, time: float, state: State) -> None:
        """Take in an instant."""
        self.times.append(time)
        self._pending.append(state)
        if len(self._pending) == self._system.instants_at_once:
            self._evaluate()

    def outputs(self) -> np.ndarray:
        """Return what the outputs are made of at all instants, shape (n_observed, n_t)."""
        self._evaluate()
        return np.concatenate(self._outputs, axis=-1)

    def recorded(self) -> dict[str, np.ndarray | Energies | list[np.ndarray]]:
        """Return coordinates (n_t, n_theta), energies, and where they are wanted frames, (n_nodes, n_frame) each."""
        self._evaluate()
        return {
            "coordinates": np.concatenate(self._coordinates, axis=-1).T,
            "energies": joined(self._energies),
            "frames": self._frames,
        }

    def fields(self) -> Fields:
        """Return the fields of bodies where they are wanted."""
        self._evaluate()
        self._evaluate_fields()
        return joined_fields(self._fields)

    def _evaluate(self) -> None:
        """Evaluate the states that wait."""
        states, self._pending = self._pending, []
        if not states:
            return
        first = len(self.times) - len(states)
        with np.errstate(all="ignore"):  # a run that fails may overflow before it is given up
            every = self._system.frames_over(states)
            self._energies.append(self._system.energies_over(self.times[first:], states))
            self._outputs.append(self._model.observed_over(self._system, states, every))
        self._coordinates.append(self._measured(every))
        wanted = [k for k in range(len(states)) if first + k in self._wanted]
        self._frames += [every[..., k] for k in wanted]
        if self._of_fields.seen.points:
            for k in wanted:
                self._unknowns.append(self._system.unpack(states[k].q))
                if len(self._unknowns) == self._of_fields.at_once:
                    self._evaluate_fields()

    def _evaluate_fields(self) -> None:
        """Evaluate the fields that wait."""
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
