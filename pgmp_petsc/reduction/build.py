"""The offline build: modes at the sampled configurations, joined into one continuous basis, and the reduced tables.

The configurations are dealt to groups of ranks in contiguous arcs. Each group solves its own eigenproblems and compares
neighbouring modes, also over the borders of the arcs; the rotations that make the basis continuous follow from these
comparisons on the first rank, so that the number of groups has no part in them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from pgmp_petsc.bodies.matrices import assemble, owned_rows
from pgmp_petsc.effects import Load, effects_of, loads_of
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.mesh.line_mesh import LineMesh
from pgmp_petsc.modes.problem import ModalProblem, ModeSet
from pgmp_petsc.reduction.interpolation import samples_for
from pgmp_petsc.reduction.joining import JoinedSamples, join_samples
from pgmp_petsc.reduction.rom import ReducedOrderModel
from pgmp_petsc.reduction.sampler import Sampler
from pgmp_petsc.reduction.samples import Samples
from pgmp_petsc.reduction.tables import ReducedTables
from pgmp_petsc.runtime.agreement import agreed
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
        samples = _samples(scene, kinematics)
        rows = owned_rows(mechanism.n_dofs, group.comm.rank, group.comm.size)
        loads = loads_of(effects_of(scene, mechanism), assemble(mechanism.bodies, rows))
    arc = group.arc(samples.n)
    own, n_redundant = {}, 0
    with timings.phase("eigenproblems"), agreed(group.world, "eigenproblems"), progress(
        len(arc), "eigenproblems", group.world
    ) as bar:
        if arc:
            with ModalProblem(kinematics, scene.nominal, scene.reduction.modes, group.comm) as problem:
                n_redundant = problem.n_redundant
                sampler = Sampler(problem, loads, scene.reduction.static_modes)
                for k in arc:
                    own[k] = sampler.sample(samples.theta[k], scramble)
                    bar.update()
    with timings.phase("continuity"):
        shares = [len(share) for share in group.arcs(samples.n)]
        owners = np.repeat(np.arange(len(shares)), shares)
        joined = join_samples(group, owners, own, samples.periodic)
    timings = timings.maximum(group.world)
    if joined is None:
        return None
    tables, projection = _continuous_tables(mechanism, samples, loads, joined)
    return ReducedOrderModel(
        tables=tables,
        projection=projection,
        frequencies_hz=np.sqrt(joined.tables["eigenvalues"]) / (2 * np.pi),
        cosines=joined.cosines,
        meshes=dict(meshes),
        n_redundant=n_redundant,
        record=RunRecord(scene_to_toml(scene), scene.nominal, None, group.world.size, timings.as_dict()),
    )


def _continuous_tables(
    mechanism: Mechanism, samples: Samples, loads: tuple[Load, ...], joined: JoinedSamples
) -> tuple[ReducedTables, np.ndarray]:
    """Return tables and projection in the continuous basis."""
    tables = ReducedTables(
        samples=samples,
        mass_weights=mechanism.mass_weights,
        stiffness_weights=mechanism.stiffness_weights,
        load_weights=tuple(load.weight for load in loads),
        load_effects=tuple(load.effect for load in loads),
        **{name: joined.tables[name] for name in ("mass", "inertia", "stiffness", "load")},
    ).turned(joined.rotations)
    projection = joined.shapes @ joined.rotations
    if not joined.flipped.size:
        return tables, projection
    signs = np.ones(tables.n_modes)
    signs[joined.flipped] = -1.0
    return tables.over_two_turns(joined.flipped), np.concatenate([projection, projection * signs])


def _samples(scene: Scene, kinematics: RigidKinematics) -> Samples:
    coordinate, reduction = kinematics.coordinate, scene.reduction
    return samples_for(
        reduction.interpolation, coordinate.lower, coordinate.upper, reduction.angles, coordinate.periodic
    )
