"""Eigenfrequencies over the configurations, full-order and reduced side by side."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from pgmp_petsc.bodies.affine import evaluate_weights
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.mesh.line_mesh import LineMesh
from pgmp_petsc.modes.problem import ModalProblem
from pgmp_petsc.reduction.interpolation import interpolant
from pgmp_petsc.reduction.rom import ReducedOrderModel
from pgmp_petsc.reduction.samples import Samples
from pgmp_petsc.reduction.tables import ReducedTables
from pgmp_petsc.results.modes import ModesTable
from pgmp_petsc.runtime.agreement import agreed
from pgmp_petsc.runtime.errors import InputError
from pgmp_petsc.runtime.files import RunRecord
from pgmp_petsc.runtime.groups import RankGroup
from pgmp_petsc.runtime.progress import progress
from pgmp_petsc.runtime.timings import Timings
from pgmp_petsc.scene import Scene, scene_from_toml, scene_to_toml

STRUCTURE = ("ground", "materials", "bodies", "joints", "coordinates")


def tabulate_modes(
    scene: Scene, meshes: Mapping[str, LineMesh], rom: ReducedOrderModel | None, n_angles: int, group: RankGroup
) -> ModesTable | None:
    """Compute the table at the scene's parameter values. Collective on ``group.world``.

    Parameters
    ----------
    rom
        A reduced model of the same mechanism, or None for the full-order frequencies alone.
    n_angles
        Number of configurations over the coordinate's range.

    Returns
    -------
    ModesTable or None
        On the first rank, None elsewhere.
    """
    timings = Timings()
    own = np.empty((0, scene.reduction.modes))
    with timings.phase("eigenproblems"), agreed(group.world, "eigenproblems"), progress(
        n_angles, "eigenproblems", group.world
    ) as bar:
        _check_same_mechanism(scene, rom)
        kinematics = RigidKinematics(Mechanism.from_scene(scene, meshes))
        coordinate = kinematics.coordinate
        theta = Samples.uniform(coordinate.lower, coordinate.upper, n_angles, coordinate.periodic).theta
        arc = group.arc(n_angles)
        if arc:
            with ModalProblem(kinematics, scene.values, scene.reduction.modes, group.comm) as problem:
                rows = []
                for index in arc:
                    rows.append(problem.solve(theta[index]).frequencies_hz)
                    bar.update(group.count)
                own = np.array(rows)
    timings = timings.maximum(group.world)
    if group.roots is None:
        return None
    arcs = group.roots.gather(own)
    if group.world.rank > 0:
        return None
    with timings.phase("reduced"):
        reduced = None
        if rom is not None:
            scheme = scene_from_toml(rom.record.scene_toml, scene.directory).reduction.interpolation
            reduced = reduced_frequencies(rom.tables, scheme, scene.values, theta)
    return ModesTable(
        record=RunRecord(scene_to_toml(scene), scene.values, None, group.world.size, timings.as_dict()),
        theta=theta,
        full_hz=np.concatenate(arcs),
        reduced_hz=reduced,
        coordinate_units={coordinate.name: "rad"},
    )


def reduced_frequencies(
    tables: ReducedTables, scheme: str, values: Mapping[str, float], theta: np.ndarray
) -> np.ndarray:
    """Return the frequencies of the reduced model, shape (n_theta, n_modes), Hz, at any configurations."""
    at_theta = replace(
        tables,
        mass=interpolant(tables.samples, tables.mass, scheme)(theta),
        stiffness=interpolant(tables.samples, tables.stiffness, scheme)(theta),
    )
    return at_theta.frequencies_hz(
        evaluate_weights(tables.mass_weights, values), evaluate_weights(tables.stiffness_weights, values)
    )


def _check_same_mechanism(scene: Scene, rom: ReducedOrderModel | None) -> None:
    if rom is None:
        return
    built = scene_from_toml(rom.record.scene_toml, scene.directory)
    for table in STRUCTURE:
        if getattr(built, table) != getattr(scene, table):
            raise InputError(f"--rom: it was built from another scene: [{table}] differs; build it from this one")
    missing = scene.parameters.keys() ^ built.parameters.keys()
    if missing:
        raise InputError(f"--rom: it was built with other parameters: {', '.join(sorted(missing))}")
