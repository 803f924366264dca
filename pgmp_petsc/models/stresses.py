"""Stresses as the models know them.

The full-order model has the strains of its meshes themselves. A body that is condensed has strains ``S y`` linear in
its coordinates y, with a constant matrix S: those of the displacements T y. In the component model y are the
amplitudes of its fields; in the reduced model they follow from the modes, ``y = Psi(theta) delta`` (Naets et al. 2015,
eq. (4)). What modes leave out of the static answers to loads and inertia forces is in S as far as the basis has it:
`reduction.static_modes` and `reduction.inertia_modes`, on bodies that are condensed with the answers to their own
inertia forces.

Away from the nominal parameters a basis misses of the forces what hardly bends; `reduction.missed_answers` has what is
added to the strains.

Of second order in them, bodies of cells have the strains that `Recovery.curved` stands for besides. Linear strains of
what a body that bends is shorter by are none of it: of a rod of 0.3 m they were 0.4 % of its largest stress.

A reduced model of second order has beams with ``u = Psi delta + 1/2 chi delta delta``; their strains are taken in full
there, as those of the same order cancel in an extension: ``u' + 1/2 w'^2``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace

import numpy as np

from pgmp_petsc.bodies.beam_strains import BeamStrains
from pgmp_petsc.bodies.body import Body
from pgmp_petsc.bodies.recovery import products
from pgmp_petsc.bodies.stresses import BeamLaw, SolidLaw, Strains, Values
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.unknowns import Unknowns
from pgmp_petsc.outputs.outputs import OutputSet
from pgmp_petsc.outputs.stress import StressOutput
from pgmp_petsc.reduction.interpolation import interpolant
from pgmp_petsc.reduction.missed_answers import Missed
from pgmp_petsc.reduction.rom import ReducedOrderModel
from pgmp_petsc.scene import Scene

AT_ONCE = 2**22  # strains that are evaluated together: 32 MB


class FullStresses:
    """Stresses from the unknowns of a full-order or a component model.

    Parameters
    ----------
    scene, outputs
        The scene and its outputs.
    unknowns
        The numbering.
    """

    def __init__(self, scene: Scene, outputs: OutputSet, unknowns: Unknowns) -> None:
        self._stresses, self._unknowns = outputs.stresses, unknowns
        self._linear = {
            stress.name: linear_map(stress, unknowns.bodies[stress.body].by_node)
            for stress in outputs.stresses
            if unknowns.bodies[stress.body].n_amplitudes
        }

    def of(self, q: np.ndarray, values: Values) -> np.ndarray:
        """Return the stresses, shape (n_stresses, n), for unknowns (n_dofs, n); values are numbers or of shape (n,)."""
        rows = [self._of(stress, q, values) for stress in self._stresses]
        return np.array(rows).reshape(len(rows), q.shape[1])

    def _of(self, stress: StressOutput, q: np.ndarray, values: Values) -> np.ndarray:
        body = self._unknowns.bodies[stress.body]
        if body.n_amplitudes:
            return in_blocks(stress, lambda part: _times(self._linear[stress.name], q[body.internal, part]), q, values)
        return in_blocks(stress, lambda part: _of_unknowns(stress, body, self._unknowns, q[:, part]), q, values)


class ReducedStresses:
    """Stresses from reduced coordinates.

    Parameters
    ----------
    scene, outputs
        The scene and its outputs.
    kinematics
        Of the mechanism.
    rom
        The reduced model with its projection.
    """

    def __init__(self, scene: Scene, outputs: OutputSet, kinematics: RigidKinematics, rom: ReducedOrderModel) -> None:
        self._stresses, self._bodies = outputs.stresses, kinematics.mechanism.bodies
        self._amplitudes = {
            number: Amplitudes(rom, self._bodies[number], scene.reduction.interpolation)
            for number in {stress.body for stress in outputs.stresses}
        }
        self._linear = {s.name: linear_map(s, self._bodies[s.body].by_node) for s in outputs.stresses}
        self._missed = MissedStrains(kinematics, rom, scene.reduction.interpolation)

    def of(self, eta: np.ndarray, values: Values) -> np.ndarray:
        """Return the stresses, shape (n_stresses, n), for eta (n, n_eta); values are numbers, or of shape (n,)."""
        amplitudes = {number: shapes.strained(eta) for number, shapes in self._amplitudes.items()}
        missed = self._missed.amplitudes(eta, values)
        rows = [self._of(stress, amplitudes[stress.body], missed.get(stress.body), values) for stress in self._stresses]
        return np.array(rows).reshape(len(rows), len(eta))

    def _of(self, stress: StressOutput, y: np.ndarray, missed: np.ndarray | None, values: Values) -> np.ndarray:
        body, linear = self._bodies[stress.body], self._linear[stress.name]
        curved = self._amplitudes[stress.body].curved and body.strains_follow_frames

        def strains(part: slice) -> np.ndarray:
            found = strains_of_beams(body, stress.points, y[:, part]) if curved else _times(linear, y[:, part])
            if missed is None:
                return found
            softening = self._missed.softening(stress.law, stress.points, values_of(values, part))
            return found + softening * _times(linear, missed[:, part])

        return in_blocks(stress, strains, y, values)


class MissedStrains:
    """Strains of bodies that reduced states miss away from the nominal parameters.

    Parameters
    ----------
    kinematics, rom, scheme
        The mechanism's kinematics, the reduced model with its projection, and its interpolation.
    """

    def __init__(self, kinematics: RigidKinematics, rom: ReducedOrderModel, scheme: str) -> None:
        self._nominal, self._missed, self._rows = rom.record.parameters, None, {}
        if rom.missed is not None:
            self._missed = Missed(rom.missed, rom.tables, scheme)
            for number, body in enumerate(kinematics.mechanism.bodies):
                if np.isin(body.dofs, rom.missed.dofs).all():
                    self._rows[number] = np.searchsorted(rom.missed.dofs, body.dofs)

    def amplitudes(self, eta: np.ndarray, values: Values) -> dict[int, np.ndarray]:
        """Return the unknowns of bodies that are missed, shape (n_dofs, n), by the number of the body, with the nominal
        stiffness; nothing of bodies without stress outputs when the model was built."""
        if self._missed is None:
            return {}
        found = self._missed.of(eta, values)
        return {number: found[rows] for number, rows in self._rows.items()}

    def softening(self, law: SolidLaw | BeamLaw, points: Strains, values: Values) -> np.ndarray:
        """Return what makes of strains of points with the nominal stiffness those of the same forces at the values."""
        return law.softening(points, self._nominal, values)


class Amplitudes:
    """The unknowns of a body in its frame, from reduced coordinates, and those that have its strains.

    Parameters
    ----------
    rom, body, scheme
        The reduced model with its projection, the body, and the interpolation over the configurations.

    Attributes
    ----------
    curved
        Whether they are of second order in the flexible coordinates.
    """

    def __init__(self, rom: ReducedOrderModel, body: Body, scheme: str) -> None:
        self.curved, self._n_theta = rom.curvature is not None, rom.tables.n_coordinates
        self._shapes = self._strained = rom.displacements(scheme, body.dofs)
        of_pairs = body.curved_strains if self.curved else None
        self.has_own_strains = of_pairs is not None
        if self.has_own_strains:
            found = _curved_strains(of_pairs, rom.projection[:, body.dofs])
            rows = self._shapes.rows.copy()
            rows[..., rom.projection.shape[2] :, :] += interpolant(rom.tables.samples, found, scheme).rows
            self._strained = replace(self._shapes, rows=rows)

    def of(self, eta: np.ndarray) -> np.ndarray:
        """Return them, shape (n_dofs, n), for reduced coordinates (n, n_eta)."""
        return self._shapes.product(eta[:, : self._n_theta], eta[:, self._n_theta :]).T

    def strained(self, eta: np.ndarray) -> np.ndarray:
        """Return those whose linear strains are the body's, shape (n_dofs, n): see `Recovery.curved`."""
        return self._strained.product(eta[:, : self._n_theta], eta[:, self._n_theta :]).T


def _curved_strains(of_pairs: np.ndarray, projection: np.ndarray) -> np.ndarray:
    """Return `Recovery.curved` of pairs of modes, shape (n, n_pairs, n_dofs), of a projection (n, n_dofs, m)."""
    (n, n_dofs, m), packed = projection.shape, np.tril_indices(projection.shape[1])
    whole = np.empty((n_dofs, n_dofs, n_dofs))
    whole[packed] = whole[packed[::-1]] = of_pairs
    found, pairs = np.empty((n, m * (m + 1) // 2, n_dofs)), np.tril_indices(m)
    for modes, own in zip(projection, found):
        half = np.tensordot(modes.T, whole, 1)
        own[:] = np.einsum("maj,an->mnj", half, modes, optimize=True)[pairs]
    return found


def strains_of_beams(body: Body, points: BeamStrains, y: np.ndarray) -> np.ndarray:
    """Return the strains of planar beams, those of second order in the deformation among them, for unknowns (n_dofs, n)
    in the body's frame."""
    frames = y.reshape(body.n_nodes, body.node_dofs, -1).copy()
    frames[:, :2] += body.mesh.nodes[:, :, None]
    return points.of_places(frames)


def linear_map(stress: StressOutput, by_node: np.ndarray) -> np.ndarray:
    """Return S, shape (n_points, n_strains, n), of displacements of the nodes (n_nodes, n_of_a_node, n)."""
    parts = (stress.points.of_displacements(by_node[..., part]) for part in _blocks(stress, by_node.shape[2]))
    return np.concatenate(list(parts), axis=2)


def in_blocks(
    stress: StressOutput, strains: Callable[[slice], np.ndarray], motion: np.ndarray, values: Values
) -> np.ndarray:
    """Return a stress output, shape (n,), from strains of some instants at a time; `motion` has n as its last axis."""
    found = np.empty(motion.shape[-1])
    for part in _blocks(stress, found.size):
        found[part] = stress.value(strains(part), values_of(values, part))
    return found


def _blocks(stress: StressOutput, n: int) -> Iterator[slice]:
    """Yield parts of n columns that are evaluated together."""
    step = max(1, AT_ONCE // max(1, stress.points.width))
    for first in range(0, n, step):
        yield slice(first, min(first + step, n))


def values_of(values: Mapping[str, np.ndarray | float], part: slice) -> dict[str, np.ndarray | float]:
    """Return the parameter values of some samples; numbers are those of all."""
    return {name: value[part] if np.ndim(value) and np.size(value) > 1 else value for name, value in values.items()}


def _times(linear: np.ndarray, y: np.ndarray) -> np.ndarray:
    return products(linear.reshape(1, -1, linear.shape[2]), y[None]).reshape(*linear.shape[:2], y.shape[1])


def _of_unknowns(stress: StressOutput, body: Body, unknowns: Unknowns, q: np.ndarray) -> np.ndarray:
    return stress.points.of_places(body.moving_nodes(q, unknowns.frames(q)))
