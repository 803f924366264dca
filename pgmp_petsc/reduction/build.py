"""The offline build: modes at the sampled configurations, joined into one continuous basis, and the reduced tables.

The configurations are dealt to groups of ranks in contiguous arcs. Each group solves its own eigenproblems and compares
neighbouring modes, also over the borders of the arcs; the rotations that make the basis continuous follow from these
comparisons on the first rank, so that the number of groups has no part in them. With a tolerance for the sampling,
rounds of further configurations follow where the interpolated tables differ from the fresh samples.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from pgmp_petsc.bodies.matrices import assemble, owned_rows
from pgmp_petsc.effects import Load, effects_of, loads_of, patterns_of
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.mesh.line_mesh import LineMesh
from pgmp_petsc.modes.problem import ModalProblem, ModeSet
from pgmp_petsc.reduction.interpolation import samples_for
from pgmp_petsc.reduction.joining import JoinedSamples
from pgmp_petsc.reduction.mode_changes import mode_changes
from pgmp_petsc.reduction.refinement import ContinuousBasis, interpolation_errors, midpoints
from pgmp_petsc.reduction.rom import ReducedOrderModel
from pgmp_petsc.reduction.sampler import Sampler
from pgmp_petsc.reduction.samples import Samples
from pgmp_petsc.reduction.second_order import pair_rotations
from pgmp_petsc.reduction.store import SampleStore
from pgmp_petsc.reduction.tables import ReducedTables
from pgmp_petsc.runtime.agreement import agreed, on_root
from pgmp_petsc.runtime.errors import RunError
from pgmp_petsc.runtime.files import RunRecord
from pgmp_petsc.runtime.groups import RankGroup
from pgmp_petsc.runtime.progress import progress
from pgmp_petsc.runtime.timings import Timings
from pgmp_petsc.scene import Scene, scene_to_toml


def build_rom(
    scene: Scene,
    meshes: Mapping[str, LineMesh],
    group: RankGroup,
    scramble: Callable[[ModeSet], ModeSet] = lambda modes: modes,
) -> ReducedOrderModel | None:
    """Build the reduced-order model of a scene. Collective on ``group.world``.

    Parameters
    ----------
    scene
        The scene; modes are taken at its nominal parameters.
    meshes
        The mesh of every body.
    group
        Ranks that share an eigenproblem.
    scramble
        Applied to every mode set as it leaves the eigensolver; lets tests spoil signs and order.

    Returns
    -------
    ReducedOrderModel or None
        The model on the first rank, None elsewhere.

    Raises
    ------
    InputError, RunError
        On all ranks, whichever rank met it.
    """
    timings = Timings()
    with timings.phase("kinematics"), agreed(group.world, "rigid kinematics"):
        mechanism = Mechanism.from_scene(scene, meshes)
        kinematics = RigidKinematics(mechanism)
        rows = owned_rows(mechanism.n_dofs, group.comm.rank, group.comm.size)
        matrices, effects = assemble(mechanism.bodies, rows), effects_of(scene, mechanism)
        loads = loads_of(effects, matrices)
        patterns = patterns_of(effects if scene.reduction.static_modes else (), matrices)
    store = SampleStore(group, _samples(scene, kinematics))
    setting = _Setting(scene, kinematics, loads, patterns, group, scramble)
    n_redundant, joined, previous = 0, None, None
    while True:
        with timings.phase("eigenproblems"), agreed(group.world, "eigenproblems"):
            n_redundant = max(n_redundant, setting.compute(store))
        with timings.phase("continuity"):
            joined = store.join()
            current = None if joined is None else _continuous_tables(mechanism, store.samples, loads, joined)
            wanted = on_root(group.world, lambda: _wanted(scene, store, previous, current))
        if wanted.size == 0:
            break
        previous = current
        store.request(wanted)
    timings = timings.maximum(group.world)
    if joined is None:
        return None
    tables = current.tables
    if scene.reduction.second_order:
        changes = mode_changes(kinematics, tables.samples, current.projection, scene.reduction.interpolation)
        tables = replace(tables, changes=changes)
    return ReducedOrderModel(
        tables=tables,
        projection=current.projection,
        frequencies_hz=np.sqrt(joined.tables["eigenvalues"]) / (2 * np.pi),
        cosines=joined.cosines,
        meshes=dict(meshes),
        n_redundant=n_redundant,
        record=RunRecord(scene_to_toml(scene), scene.nominal, None, group.world.size, timings.as_dict()),
        curvature=current.curvature,
    )


@dataclass(frozen=True)
class _Setting:
    """What the samples of one build have in common."""

    scene: Scene
    kinematics: RigidKinematics
    loads: tuple[Load, ...]
    patterns: np.ndarray
    group: RankGroup
    scramble: Callable[[ModeSet], ModeSet]

    def compute(self, store: SampleStore) -> int:
        """Compute this group's missing samples; return the number of redundant constraints, 0 if there were none."""
        missing = store.missing()
        if not missing:
            return 0
        reduction = self.scene.reduction
        with (
            progress(len(missing), "eigenproblems", self.group.world) as bar,
            ModalProblem(self.kinematics, self.scene.nominal, reduction.modes, self.group.comm) as problem,
        ):
            sampler = Sampler(problem, self.loads, self.patterns, reduction.second_order)
            for number, theta in missing.items():
                store.put(number, sampler.sample(theta, self.scramble))
                bar.update()
            return problem.n_redundant


def _wanted(
    scene: Scene, store: SampleStore, previous: ContinuousBasis | None, current: ContinuousBasis | None
) -> np.ndarray:
    """Return the configurations of the next round (first rank); none where the tolerance holds or none is given."""
    tolerance = scene.reduction.sampling_tolerance
    if current is None or tolerance is None:
        return np.empty(0)
    samples = store.samples
    if previous is None:
        return midpoints(samples)
    new = np.setdiff1d(samples.theta, previous.tables.samples.theta)
    errors = interpolation_errors(previous, current, new, scene.nominal)
    poor = new[errors > tolerance]
    if samples.n > scene.reduction.max_angles and poor.size:
        raise RunError(
            f"reduction.sampling_tolerance = {tolerance:g}: with {samples.n} angles the tables still differ by "
            f"{errors.max():.2g} near {new[np.argmax(errors)]:.4g} rad; raise reduction.max_angles "
            f"({scene.reduction.max_angles}) or the tolerance"
        )
    # both halves of the interval that a poor sample has split
    theta = np.append(samples.theta, samples.upper) if samples.periodic else samples.theta
    left = np.searchsorted(theta, poor)
    chosen = np.zeros(theta.size - 1, dtype=bool)
    chosen[left - 1] = chosen[left] = True
    return midpoints(samples, chosen)


def _continuous_tables(
    mechanism: Mechanism, samples: Samples, loads: tuple[Load, ...], joined: JoinedSamples
) -> ContinuousBasis:
    """Return the tables of all samples in the continuous basis."""
    tables = ReducedTables(
        samples=samples,
        mass_weights=mechanism.mass_weights,
        stiffness_weights=mechanism.stiffness_weights,
        load_weights=tuple(load.weight for load in loads),
        load_effects=tuple(load.effect for load in loads),
        **{name: joined.tables[name] for name in ("mass", "inertia", "stiffness", "load")},
        second_order=joined.second_order,
    ).turned(joined.rotations)
    projection, curvature = joined.shapes @ joined.rotations, joined.curvatures
    if curvature is not None:
        curvature = curvature @ pair_rotations(joined.rotations)
    if not joined.flipped.size:
        return ContinuousBasis(tables, projection, joined.groups, curvature)
    signs = np.ones(tables.n_modes)
    signs[joined.flipped] = -1.0
    projection = np.concatenate([projection, projection * signs])
    if curvature is not None:
        i, j = np.tril_indices(tables.n_modes)
        curvature = np.concatenate([curvature, curvature * (signs[i] * signs[j])])
    return ContinuousBasis(tables.over_two_turns(joined.flipped), projection, joined.groups, curvature)


def _samples(scene: Scene, kinematics: RigidKinematics) -> Samples:
    coordinate, reduction = kinematics.coordinate, scene.reduction
    return samples_for(
        reduction.interpolation, coordinate.lower, coordinate.upper, reduction.angles, coordinate.periodic
    )
