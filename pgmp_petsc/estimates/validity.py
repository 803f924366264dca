"""How far a reduced run leaves what a linear reduced basis assumes; looked at in every run and every sample.

Every second step is looked at. Changes of stiffness are followed there; rotations and strains are evaluated in the most
deformed states only, one of every twentieth part of the run: those with the largest strain energy, and that in which
elastic joints give way most.

**Elastic rotation**: the largest rotation of a node, or of a frame of a continuum body, less that of its rigid body.
What elastic joints give way is in it: their motion is linear in the model, and has to be as small. Without terms of
second order forces do not turn with it, so that a rotation phi is a share phi of what they do: said from 2 % on.

**Elastic strain**: the largest strain along the outermost fibre of a beam, ``|eps| + c |kappa|`` with c half its
height; of a section given by coefficients, which has no height, c is that of the circle with the same radius of
gyration. Not known of continuum bodies.

**Stiffness gained and lost**: the largest and the least share by which the forces in the bodies change the stiffness of
a mode (`reduction.tables.StiffnessChanges`), from loads, local forces and the inertia forces of the rigid motion at
that instant: what geometric stiffening does, or would do where the model has none. -1 is buckling. Of continuum bodies
it is known where the model has terms of second order.

`remarks_of` says in words what is beyond its limit, and what to do.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import reduce

import numpy as np

from pgmp_petsc.base.errors import Remark, gathered, note, warning
from pgmp_petsc.bodies.affine import evaluate_weights
from pgmp_petsc.bodies.beam3d import rest_strains, strains_of
from pgmp_petsc.bodies.body import Body
from pgmp_petsc.bodies.sections.section import BeamSection
from pgmp_petsc.bodies.shape import length_share
from pgmp_petsc.estimates.validity_kernel import Kept, Places, Weights, look_at, look_at_planar_beam
from pgmp_petsc.mechanism.capabilities import comparing
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.mechanism.space import SPATIAL
from pgmp_petsc.models import LengthLanes, ReducedModel
from pgmp_petsc.reduced.system import ReducedSystem
from pgmp_petsc.results.estimates import ROTATION_LIMIT, VALIDITY, beyond_limit, limits_of
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.numerics import Simulation, count_steps
from pgmp_petsc.stepping.second_order_system import Observer, State

EVERY = 2  # a motion that the steps resolve has ten and more a period: every second one misses its peak by 5 % at most
N_PARTS = 20  # evaluating a state costs about as much as a step of a single run, less in a batch
SHORTEST = 10  # looks of which one state is evaluated
TURNED = 0.02  # rad, beyond which a rotation is a share of what forces that do not turn with it do
LARGEST = 2**17  # displacements that are evaluated together, no more than stay in the cache


class Validity(Observer):
    """The observer of a batch that keeps the largest values of every sample, one of `every` so many steps.

    The model is reduced, of one mechanism or of lanes of lengths; parameter values of the batch have shape
    (n_samples,).
    """

    every = EVERY

    def __init__(
        self,
        model: ReducedModel | LengthLanes,
        system: ReducedSystem,
        values: Mapping[str, np.ndarray],
        simulation: Simulation,
    ) -> None:
        self._model, self._system, self._values = model, system, values
        n_steps = self._n_steps = count_steps(simulation.duration, simulation.step)
        self._part = max(SHORTEST, -(-n_steps // (EVERY * N_PARTS)))
        n_looks = n_steps // EVERY + 1 + (n_steps % EVERY > 0)
        self._strains = BodyStrains(model.scene, model.kinematics.mechanism, values, model.terms.layout.second_order)
        n, tables = system.n_samples, model.terms.tables
        of_mass, of_stiffness = (
            np.broadcast_to(evaluate_weights(weights, values).T, (n, len(weights)))
            for weights in (tables.mass_weights, tables.stiffness_weights)
        )
        self._weights = Weights.of(of_mass, system.load_weights, of_stiffness)
        self._places = Places.of(tables.samples, tables.stiffness, model.stiffness_changes)
        self._kept = Kept.nothing(self._places, -(-n_looks // self._part), n, system.n_eta)
        self._released = tables.n_coordinates + tables.unstrained
        self._turning = _turning(model, tables.unstrained) if tables.unstrained.size else np.zeros(0)
        self._furthest, self._released_most = np.full(n, -1.0), np.zeros((n, system.n_eta))
        self._n_looks = 0
        self._deformed = {name: np.full(n, np.nan) for name in ("elastic_rotation", "elastic_strain")}

    @property
    def extremes(self) -> dict[str, np.ndarray]:
        """By the names of `VALIDITY`, each of shape (n_samples,): NaN where nothing is known."""
        gained, lost = self._kept.shares(self._system.n_samples)
        found = self._deformed | {"stiffness_gained": gained, "stiffness_lost": lost}
        return {name: found[name] for name in VALIDITY}

    def __call__(self, number: int, time: float, state: State) -> None:
        self.over(np.array([number]), np.array([time]), np.array([[state.q, state.v, state.a]]))

    def over(self, numbers: np.ndarray, times: np.ndarray, trail: np.ndarray) -> None:
        """Look at those of many states whose turn it is; see `Observer`."""
        looked_at = np.flatnonzero((numbers % EVERY == 0) | (numbers == self._n_steps))
        # a sample that fails may overflow here before it is given up
        with np.errstate(all="ignore"):
            if looked_at.size:
                self._look(times[looked_at], trail if looked_at.size == times.size else trail[looked_at])
            if numbers[-1] == self._n_steps:
                self._strain()

    def _look(self, times: np.ndarray, trail: np.ndarray) -> None:
        """Follow the stiffness over states (n_t, 3, n, n_eta), and keep the most deformed ones."""
        # one layout, one compiled function
        loads = np.ascontiguousarray(self._system.load_amplitudes(times))
        forces = self._system.action_forces(times, trail)
        look_at(self._places, self._weights, self._n_looks, self._part, loads, forces, trail, self._kept)
        self._n_looks += times.size
        if self._released.size:
            self._follow_released(trail[:, 0])

    def _follow_released(self, states: np.ndarray) -> None:
        """Keep the states, of (n_t, n, n_eta), in which elastic joints give way most by a bound of rotations."""
        sizes = np.nan_to_num(np.abs(states[..., self._released]) @ self._turning, nan=-1.0)
        largest, each = np.argmax(sizes, axis=0), np.arange(sizes.shape[1])
        further = sizes[largest, each] > self._furthest
        self._furthest[further] = sizes[largest, each][further]
        self._released_most[further] = states[largest, each][further]

    def _strain(self) -> None:
        """Evaluate rotations and strains of the most deformed states, as many parts of the run together as fit."""
        states = self._kept.deformed(self._system.n_samples)
        if self._released.size:
            states = np.concatenate([states, self._released_most[None]])
        n_together = max(1, LARGEST // (states.shape[1] * self._model.kinematics.mechanism.n_dofs))
        for first in range(0, len(states), n_together):
            some = states[first : first + n_together]
            together = {
                name: np.tile(np.broadcast_to(own, some.shape[1]), len(some)) for name, own in self._values.items()
            }
            found = self._strains.largest(self._model.local_displacements(some.reshape(-1, states.shape[2]), together))
            for name, values in zip(self._deformed, found):
                values = np.where(np.isfinite(values), values, np.nan).reshape(some.shape[:2])
                self._deformed[name] = np.fmax(self._deformed[name], np.fmax.reduce(values, axis=0))


def _turning(model: ReducedModel | LengthLanes, coordinates: np.ndarray) -> np.ndarray:
    """Return the largest rotations of nodes at any sample for a unit of some flexible coordinates, shape (n,), rad."""
    mechanism = model.kinematics.mechanism
    moved = mechanism.by_node(np.moveaxis(model.rom.projection[:, :, coordinates], 0, -1))
    return np.linalg.norm(moved[:, mechanism.space.dimension :], axis=1).max(axis=(0, 2))


class BodyStrains:
    """Elastic rotations and strains from displacements in body frames, at parameter values that are numbers or of shape
    (n,).

    `curved` tells whether displacements are of second order in the deformation, so that bending shortens a beam:
    strains are then geometrically exact, in space to second order. Without, the linear ones are what the model has.
    """

    def __init__(
        self, scene: Scene, mechanism: Mechanism, values: Mapping[str, np.ndarray | float], curved: bool
    ) -> None:
        self._curved = curved
        self._spatial = mechanism.space is SPATIAL
        self._flexible = [body for body in mechanism.bodies if body.flexible]
        self._half_heights = {
            body.name: np.reshape(np.asarray(half_height(scene, body.name, values), dtype=float), -1)
            for body in self._flexible
            if body.fibred
        }
        self._longer = {name: np.reshape(length_share(scene, name, values), -1) for name in self._half_heights}

    def largest(self, local: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the largest rotation (rad), and strain of n states, each of shape (n,); NaN where there is no beam.

        Displacements and rotations of all nodes in body frames have shape (n, n_nodes, 3), in space (n, n_nodes, 6);
        all samples are in the order of the parameter values, as often as there are states of each.
        """
        rotation, strain = np.zeros(len(local)), np.full(len(local), np.nan)
        for body in self._flexible:
            if body.name in self._half_heights and not self._spatial:
                strain = np.fmax(strain, self._of_planar_beam(body, local, rotation))
                continue
            moved = local[:, body.nodes]
            turned = np.linalg.norm(moved[..., 3:], axis=2) if self._spatial else np.abs(moved[..., 2])
            rotation = np.maximum(rotation, np.max(turned, axis=1))
            if body.name in self._half_heights:
                strain = np.fmax(strain, self._of_spatial_beam(body, moved))
        return rotation, strain

    def _of_planar_beam(self, body: Body, local: np.ndarray, rotation: np.ndarray) -> np.ndarray:
        """Return the largest strain of a beam from displacements of all nodes (n, n_nodes, 3), shape (n,); enlarge the
        rotation."""
        strain, angles = np.empty(len(local)), np.asarray(body.directions, dtype=float)
        look_at_planar_beam(
            np.ascontiguousarray(local), (body.nodes.start, body.nodes.stop), body.mesh.cells, body.mesh.lengths,
            self._longer[body.name], angles, self._half_heights[body.name], self._curved, rotation, strain,
        )  # fmt: skip
        return strain

    def _of_spatial_beam(self, body: Body, moved: np.ndarray) -> np.ndarray:
        """Return the largest strain of a beam from its nodes' displacements (n, n_nodes, 6), shape (n,)."""
        half_heights, longer = self._half_heights[body.name], self._longer[body.name]
        ends = moved[:, body.mesh.cells]  # (n, n_elements, 2, n_dofs)
        rows = rest_strains(body.mesh.lengths, body.axes)
        rest = np.einsum("esi,nei->sne", rows, ends.reshape(*ends.shape[:2], -1))
        rest[[0, 1, 2, 6, 7, 8]] /= np.resize(longer, (len(moved), 1))  # what is over the length of an element
        strains = strains_of(rest, self._curved)
        bending = np.resize(half_heights, (len(moved), 1)) * np.linalg.norm(strains[4:], axis=0)
        return np.max(np.abs(strains[0]) + bending, axis=1)


def half_height(scene: Scene, body: str, values: Mapping[str, np.ndarray | float]) -> np.ndarray | float:
    """Return the distance of a beam's outermost fibre from its axis, m.

    A section given by coefficients has none; ``2 sqrt(EI / EA)`` is that of a circle with its radius of gyration. In
    space a section bends both ways, and the distance is half its diagonal.
    """
    section = scene.bodies[body].section
    if section.reach is None:
        resists = BeamSection.of(scene, body)
        bending = reduce(np.maximum, (part.at(values) for part in resists.bending))
        return 2.0 * np.sqrt(bending / resists.axial.at(values))
    along_2, along_3 = (reach.at(values) for reach in section.reach)
    return along_2 if scene.dimension == 2 or section.round else np.hypot(along_2, along_3)


@gathered
def remarks_of(scene: Scene, validity: Mapping[str, np.ndarray | float]) -> Iterator[Remark]:
    """Return warnings of what is beyond its limit in a run or in some samples, and notes on what is not known.

    What is looked at comes by the names of `VALIDITY`, each a number or of shape (n,).
    """
    for name, text in _beyond(scene).items():
        values = np.atleast_1d(validity[name])
        too_far = beyond_limit(name, values, scene.second_order)
        if too_far.any():
            whose = "" if values.size == 1 else f"{int(too_far.sum())} of {values.size} samples: "
            worst = values[too_far][np.argmax(np.abs(values[too_far]))]
            yield warning(whose + text.format(f"{worst:.2g}"))
    yield from _given_way(scene, np.atleast_1d(validity["elastic_rotation"]))
    continuum = [name for name, body in scene.bodies.items() if body.continuum and body.flexible]
    given = [name for name in continuum if scene.bodies[name].matrices is not None]
    meshed = [name for name in continuum if name not in given]
    if meshed:
        yield note(
            f"strain is not computed of continuum bodies ({', '.join(meshed)}): a stress output has the "
            "stresses of a body; rotations are those of their frames only"
        )
    if given:
        yield note(
            f"strain and change of stiffness are not computed: matrices ({', '.join(given)}) do not tell them, and "
            f"rotations are those of their frames only; {comparing(scene)}"
        )
    elif meshed and np.isnan(validity["stiffness_gained"]).all():
        yield note(
            f"change of stiffness is not computed with continuum bodies ({', '.join(meshed)}) in a model "
            "without terms of second order; take pgmp check --effects, or geometric_stiffening in the build"
        )
    beams = {name: body for name, body in scene.bodies.items() if body.flexible and body.section is not None}
    by_coefficients = [name for name, body in beams.items() if body.section.reach is None]
    if by_coefficients:
        yield note(
            f"strain of {', '.join(by_coefficients)}: sections given by coefficients have no height; that of a "
            "circle with the same EI/EA is taken"
        )


def _given_way(scene: Scene, rotations: np.ndarray) -> Iterator[Remark]:
    """Say where elastic joints turn bodies by so much that it is a share of what a model of first order has."""
    elastic = [f"joints.{name}" for name, joint in scene.joints.items() if joint.elastic is not None]
    largest = np.nanmax(rotations, initial=0.0)
    if elastic and not scene.second_order and TURNED < largest <= ROTATION_LIMIT:
        yield warning(
            f"rotations of {largest:.2g} rad with what {', '.join(elastic)} give way: a model without terms of second "
            f"order turns neither lengths nor forces by them, so that deformations, and places of what gives way, may "
            f"be off by {100.0 * largest:.2g} to {300.0 * largest:.2g} %; estimated errors have that. Take terms of "
            f"second order where bending is small (reduction.second_order), or {comparing(scene)}"
        )


def _beyond(scene: Scene) -> dict[str, str]:
    """Return what to say where a value is beyond its limit, by name."""
    full = comparing(scene)
    limits = limits_of(scene.second_order)
    rotation, strain, share = (limits[name] for name in ("elastic_rotation", "elastic_strain", "stiffness_lost"))
    elastic = [f"joints.{name}" for name, joint in scene.joints.items() if joint.gives_way]
    given = f", with what {', '.join(elastic)} give way, which is taken as small" if elastic else ""
    texts = {
        "elastic_rotation": f"elastic rotations of {{}} rad{given}, beyond {rotation}: linear strains are wrong by "
        f"more than 1 %; {full}",
        "elastic_strain": f"elastic strains of {{}}, beyond {strain}: few materials are linear there; {full}",
    }
    if scene.second_order:
        texts["stiffness_lost"] = (
            f"forces in the bodies change the stiffness of a mode by {{}} times itself, beyond {share}: close to "
            "buckling or beyond it (-1), where geometric_stiffening, of first order in these forces, does not hold; "
            f"{full}"
        )
        return texts
    cure = f"name it in [effects], with mode_inertia, and build again, or {full}"
    what = "geometric_stiffening, which the model leaves out, changes the stiffness of a mode by {} times itself"
    texts["stiffness_gained"] = f"{what}: {cure}"
    texts["stiffness_lost"] = f"{what} (-1 is buckling): {cure}"
    return texts
