"""Models whose samples have lengths and places of their own: a mechanism, a mesh and outputs for each.

What these models observe of a sample are its outputs: a deformation is against the rigid mechanism of its own lengths.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING
from weakref import WeakKeyDictionary

import numpy as np

from pgmp_petsc.dynamics.reduced_damping import ReducedDamping
from pgmp_petsc.dynamics.reduced_system import ReducedSystem
from pgmp_petsc.dynamics.reduced_terms import ReducedTerms
from pgmp_petsc.dynamics.second_order_system import SecondOrderSystem, State
from pgmp_petsc.models.components import ComponentModel
from pgmp_petsc.models.full import FullModel
from pgmp_petsc.models.model import Model
from pgmp_petsc.models.reduced import ReducedModel
from pgmp_petsc.outputs.outputs import OutputSet
from pgmp_petsc.reduction.reconstruction import Reconstruction
from pgmp_petsc.runtime.errors import InputError
from pgmp_petsc.scene.lengths import length_names

if TYPE_CHECKING:
    from mpi4py import MPI


@dataclass(frozen=True)
class EvaluatedOutputs:
    """Outputs that a model observes as they are; see `OutputSet`.

    Attributes
    ----------
    units
        Unit of every output.
    """

    units: dict[str, str]

    @property
    def functions(self) -> dict[str, None]:
        """The outputs' names: nothing is to be done for any."""
        return dict.fromkeys(self.units)

    def evaluate(self, observed: np.ndarray) -> dict[str, np.ndarray]:
        """Return the outputs, each of shape (n,), for what a model observes, shape (n_outputs, n)."""
        return dict(zip(self.units, observed))


def of_samples(model: Model, drawn: Iterable[str]) -> Model:
    """Return the model of samples with some parameters drawn: itself, unless some of these are lengths or places.

    Raises
    ------
    InputError
        If the model is of components, whose modes are those of one mesh.
    """
    lengths = [name for name in length_names(model.scene) if name in set(drawn)]
    if not lengths:
        return model
    if isinstance(model, ComponentModel):
        raise InputError(
            f"parameters.{lengths[0]}: a length or a place that is drawn; component modes are of one mesh, so take the "
            "reduced model (pgmp build) or --full, or give the length with --set or a number"
        )
    if isinstance(model, ReducedModel) and not LengthLanes.left_to(model):
        return LengthLanes(model)
    return SeparateLengths(model)


class _OfLengths:
    """What a model of samples has of the model of the scene's own lengths."""

    def __init__(self, model: FullModel | ReducedModel) -> None:
        self._model = model
        self.name, self.title, self.identity = model.name, model.title, model.identity
        self.scene, self.kinematics = model.scene, model.kinematics
        self.outputs = EvaluatedOutputs(model.outputs.units)
        self.lengths = length_names(model.scene)


class SeparateLengths(_OfLengths):
    """Samples one by one, each with a model of its own lengths; see `Model`."""

    largest_batch = 1

    def __init__(self, model: FullModel | ReducedModel) -> None:
        super().__init__(model)
        self._models: WeakKeyDictionary[SecondOrderSystem, Model] = WeakKeyDictionary()

    def batch(self, values: Mapping[str, np.ndarray], n_samples: int) -> SecondOrderSystem:
        """Return a system of one sample on this rank."""
        own = self._at({name: float(values[name][0]) for name in self.lengths})
        system = own.batch(values, n_samples)
        self._models[system] = own
        return system

    def single(self, values: Mapping[str, float], comm: MPI.Comm) -> SecondOrderSystem:
        """Return one full-order sample on all ranks of `comm`; to be closed. Collective on `comm`."""
        own = self._at({name: float(values[name]) for name in self.lengths})
        system = own.single(values, comm)
        self._models[system] = own
        return system

    def observed(self, system: SecondOrderSystem, state: State) -> np.ndarray:
        """Return the outputs, shape (n_outputs, n_samples). Collective on the system's communicator."""
        own = self._models[system]
        return _stacked(own.outputs.evaluate(own.observed(system, state)), system.n_samples)

    def _at(self, lengths: Mapping[str, float]) -> FullModel | ReducedModel:
        return self._model.at_lengths(self.scene.with_values(lengths))


class LengthLanes(_OfLengths):
    """Reduced samples side by side: terms are affine in monomials of the lengths, as in other parameters; see `Model`.

    Outputs are interpolated as the tables are (`reduction.length_grid`): they are evaluated with the kinematics of each
    point of the grid.
    """

    def __init__(self, model: ReducedModel) -> None:
        super().__init__(model)
        scene, family = model.scene, model.rom.family
        self._family, scheme = family, scene.reduction.interpolation
        merged = family.merged(model.rom)
        self._points, dampings = [], []
        for number, member in enumerate(family.members):
            kinematics = family.kinematics(scene, model.rom, number)
            outputs = OutputSet.of(scene, kinematics, model.start[0])
            self._points.append((outputs, Reconstruction(kinematics, member, scheme, outputs.nodes)))
            dampings.append(ReducedDamping.of(model.effects, kinematics, member))
        damping = dampings[0]
        if damping is not None:
            tables = family.grid.coefficients([one.table for one in dampings])
            damping = replace(damping, weights=family.grid.weights(damping.weights), table=tables)
        self._terms = ReducedTerms.of(
            merged.tables, merged.rigid_inertia, model.kinematics, merged.projection, scheme, damping, scene.gyroscopic
        )

    @staticmethod
    def left_to(model: ReducedModel) -> str:
        """Return what of a scene is left to `SeparateLengths`; empty if nothing is."""
        if model.actions.actions:
            return f"effects.{model.actions.actions[0].effect}"
        if model.stresses is not None:
            return f"outputs.{model.outputs.stresses[0].name}"
        return "initial.equilibrium" if model.scene.initial.equilibrium else ""

    @property
    def largest_batch(self) -> int:
        """Most samples that a batch has."""
        return self._model.largest_batch

    def batch(self, values: Mapping[str, np.ndarray], n_samples: int) -> ReducedSystem:
        """Return a batch of samples on this rank."""
        model = self._model
        return ReducedSystem(self._terms, model.effects, values, model.start, n_samples, model.motions)

    def observed(self, system: ReducedSystem, state: State) -> np.ndarray:
        """Return the outputs, shape (n_outputs, n_samples)."""
        return self.observed_of(state.q, system.values)

    def observed_of(self, eta: np.ndarray, values: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return the outputs for reduced coordinates (n, n_eta) and parameters (n,), shape (n_outputs, n)."""
        shares = self._family.grid.shares({name: np.broadcast_to(values[name], len(eta)) for name in self.lengths})
        found = np.zeros((len(self.outputs.units), len(eta)))
        for share, (outputs, nodes) in zip(shares, self._points):
            observed = outputs.observed(nodes.frames(eta), np.empty((0, len(eta))))
            found += share * _stacked(outputs.evaluate(observed), len(eta))
        return found


def _stacked(outputs: Mapping[str, np.ndarray], n: int) -> np.ndarray:
    """Return outputs (n,) as rows."""
    return np.array(list(outputs.values())).reshape(len(outputs), n)
