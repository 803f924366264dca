"""Eigenfrequencies over the configurations, full-order and reduced side by side.

Frequencies of the reduced model on the springs of its scene: what its runs would show of small vibrations.

The reduced stiffness has no springs, which act as local forces; linearised about the configuration they add

    Psi^T K_s Psi,     Psi = [d rho/d theta, Psi_flexible],

with the same blocks as in the full-order model (`modes.static_modes`), the exact rigid motion and the flexible
vectors as runs interpolate them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from scipy.linalg import eigh

from pgmp_petsc.base.errors import InputError, Remark, gathered, note, warning
from pgmp_petsc.base.progress import progress
from pgmp_petsc.base.resources import Timings
from pgmp_petsc.base.surroundings import Comm, alone
from pgmp_petsc.bodies.matrices import AffineMatrices, weighted_sum
from pgmp_petsc.bodies.shape import Shapes
from pgmp_petsc.components.condensing import angle_group, condensed
from pgmp_petsc.effects import actions_of, effects_of
from pgmp_petsc.effects.springs import linear_springs, spring_remarks
from pgmp_petsc.files.hdf5 import RunRecord
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import TABLES, Coordinate, Mechanism, rigid_velocities, words_of
from pgmp_petsc.modes.problem import ModalProblem
from pgmp_petsc.modes.static_modes import SpringStiffness, VibrationProblem, frequencies_of
from pgmp_petsc.ranks.agreement import agreed
from pgmp_petsc.ranks.groups import RankGroup
from pgmp_petsc.reduction.rom import ReducedOrderModel
from pgmp_petsc.reduction.sample_grid import SampleGrid, Samples
from pgmp_petsc.reduction.static_loads import BuiltInStress
from pgmp_petsc.reduction.tables import definite_mass
from pgmp_petsc.results.trajectory import ModesTable
from pgmp_petsc.scene import Scene, scene_from_toml, scene_to_toml
from pgmp_petsc.scene.units import own_values
from pgmp_petsc.scene.uses import offset_directions, offset_values


def reduced_vibrations(
    rom: ReducedOrderModel, springs: SpringStiffness, scheme: str, values: Mapping[str, float], theta: np.ndarray
) -> np.ndarray:
    """Return the frequencies of a reduced model at configurations (n, n_theta), rad, by one process.

    `springs` are what springs add, for its mechanism with condensed bodies; the scheme interpolates over the samples.
    Frequencies are of shape (n, n_free + n_delta - n_rigid), Hz, ascending, without the rigid motions that no spring
    resists; below zero as in `frequencies_of`.
    """
    tables, kinematics = rom.tables.moving(), springs.kinematics
    mechanism, free, there = kinematics.mechanism, kinematics.mechanism.free, tables.over(scheme, theta)
    matrices = AffineMatrices(mechanism.bodies, range(mechanism.n_dofs))
    whole_mass = weighted_sum(matrices.mass, values)
    n_rigid = free.size + tables.unstrained.size - springs.n_resisted(matrices, alone())
    mass, stiffness = tables.vibrating(values, free, there)
    dofs = np.unique(np.concatenate([np.zeros(0, dtype=int), *springs.dofs]))
    shapes = there(rom.projection[:, dofs, : tables.n_modes])
    found = np.empty((len(theta), mass.shape[1] - n_rigid))
    for number, configuration in enumerate(theta):
        poses = kinematics.poses(configuration)
        rigid = rigid_velocities(mechanism, poses[..., 0], kinematics.rates(poses)[..., 0])[:, free]
        mass[number, : free.size, : free.size] = rigid.T @ (whole_mass @ rigid)
        psi = np.hstack([rigid[dofs], shapes[number]])
        for block in springs.at(configuration, matrices, alone()):
            own = psi[np.searchsorted(dofs, block.dofs)]
            stiffness[number] += own.T @ block.matrix @ own
        # scaled to a unit diagonal of the mass: coordinates have units of their own
        scale = 1.0 / np.sqrt(np.diag(mass[number]))
        values_here = eigh(
            stiffness[number] * scale * scale[:, None], mass[number] * scale * scale[:, None], eigvals_only=True
        )
        found[number] = np.sort(values_here[np.argsort(np.abs(values_here), kind="stable")[n_rigid:]])
    return frequencies_of(found)


STRESSED = "the frequencies are of bodies under the stress that joints that are off build in, of first order in how far"
_BUT = "it has with geometric_stiffening in [effects] and without springs"
UNSTRESSED = f"the stress that joints that are off build in has no part in the frequencies; {_BUT}"
MESH_ERROR = "errors of the mesh in the frequencies were not estimated; compare with more elements a body"


def tabulate_modes(
    scene: Scene, meshes: Shapes, rom: ReducedOrderModel | None, n_angles: int, group: RankGroup
) -> ModesTable | None:
    """Compute the table at the scene's parameter values, on the first rank; None elsewhere. Collective on
    ``group.world``.

    `rom` is a reduced model of the same mechanism, or None for the full-order frequencies alone; there are `n_angles`
    configurations over the range of each coordinate.
    """
    timings, own = Timings(), None
    with timings.phase("components"):
        shapes = condensed(scene, meshes, group)
    with angle_group(shapes, group) as angles:
        with timings.phase("reduced"), agreed(group.world, "frequencies of the reduced model"):
            _check_same_mechanism(scene, rom)
            mechanism = Mechanism.from_scene(scene, shapes).straight
            kinematics = RigidKinematics(mechanism)
            springs, said = springs_of(scene, kinematics)
            stressed = False
            if offset_directions(scene):
                known = all(body.third_derivative_known for body in mechanism.bodies)
                stressed = springs is None and scene.second_order and known
                said += (note(STRESSED if stressed else UNSTRESSED),)
            coordinates = kinematics.coordinates
            along = tuple(Samples.uniform(c.lower, c.upper, n_angles, c.periodic) for c in coordinates)
            theta = SampleGrid(along).theta
            wanted = rom is not None and group.world.rank == 0
            reduced = _reduced(scene, rom, mechanism, springs, stressed, theta) if wanted else None
        with (
            timings.phase("eigenproblems"),
            agreed(group.world, "eigenproblems"),
            progress(len(theta), "eigenproblems", group.world) as bar,
        ):
            arc = angles.arc(len(theta))
            if arc:
                with _problem(scene, kinematics, springs, angles.comm) as problem:
                    problem.keep(scene.reduction)
                    rows, stress = [], BuiltInStress(problem, scene, shapes) if stressed else None
                    for index in arc:
                        rows.append(_frequencies(problem, theta[index], stress))
                        bar.update(angles.count)
                    own = np.array(rows)
        timings = timings.maximum(group.world)
        arcs = None if angles.roots is None else angles.roots.gather(own)
    if group.world.rank > 0:
        return None
    full = np.concatenate([rows for rows in arcs if rows is not None])
    remarks = (*scene.remarks, *said, *_unstable(full, theta, coordinates), note(MESH_ERROR))
    return ModesTable(
        record=RunRecord(scene_to_toml(scene), own_values(scene), None, group.world.size, timings.as_dict(), remarks),
        theta=theta[:, 0] if len(coordinates) == 1 else theta.T,
        full_hz=full,
        reduced_hz=reduced,
        coordinate_units={c.name: c.unit for c in coordinates},
    )


def _reduced(
    scene: Scene, rom: ReducedOrderModel, mechanism: Mechanism, springs: SpringStiffness | None, stressed: bool,
    theta: np.ndarray,
) -> np.ndarray:  # fmt: skip
    rom = rom.at_lengths(scene)
    scheme = scene_from_toml(rom.record.scene_toml, scene.directory).interpolation
    with definite_mass(f"--rom, at some of {len(theta)} configurations", scheme):
        if springs is not None:
            return reduced_vibrations(rom, springs, scheme, scene.values, theta)
        tables = rom.tables.moving(offset_values(scene, scene.values) if stressed else None)
        return tables.frequencies_hz(scene.values, mechanism.free, tables.over(scheme, theta))


def springs_of(scene: Scene, kinematics: RigidKinematics) -> tuple[SpringStiffness | None, tuple[Remark, ...]]:
    """Return what springs and preload add to the stiffness, None where that is nothing, and what is said of it."""
    effects = effects_of(scene, kinematics.mechanism)
    springs, preload = linear_springs(actions_of(effects)), scene.reduction.preload
    weights = tuple(effect for effect in effects if effect.conservative) if preload else None
    said = spring_remarks(effects)
    if preload:
        loads = [*dict.fromkeys(spring.effect for spring in springs), *(effect.name for effect in weights)]
        state = f"the vibrations are about the state loaded by {', '.join(loads) or 'nothing'}"
        but = "torques and forces over time, and what axial forces do to the stiffness of each body, are left out"
        said += (note(f"reduction.preload: {state}; {but}"),)
    if not springs and not weights:
        return None, said
    return SpringStiffness(kinematics, springs, scene.values, weights), said


def _problem(scene: Scene, kinematics: RigidKinematics, springs: SpringStiffness | None, comm: Comm) -> ModalProblem:
    if springs is None:
        return ModalProblem(kinematics, scene.values, scene.reduction.modes, comm)
    return VibrationProblem(springs, scene.values, scene.reduction.modes, comm)


def _frequencies(problem: ModalProblem, theta: np.ndarray, stress: BuiltInStress | None) -> np.ndarray:
    if isinstance(problem, VibrationProblem):
        return frequencies_of(problem.eigenvalues(theta))
    modes = problem.solve(theta)
    if stress is None:
        return modes.frequencies_hz
    return frequencies_of(np.linalg.eigvalsh(np.diag(modes.eigenvalues) + stress.at(modes)))


@gathered
def _unstable(full_hz: np.ndarray, theta: np.ndarray, coordinates: Sequence[Coordinate]) -> Iterator[Remark]:
    growing = np.flatnonzero((full_hz < 0.0).any(axis=1))
    if not growing.size:
        return
    worst = growing[np.argmin(full_hz[growing, 0])]
    lowest = f"lowest {full_hz[worst, 0]:.4g} Hz at {words_of(coordinates, theta[worst], 4)}"
    where = f"at {growing.size} of {len(full_hz)} configurations the mechanism is unstable on its springs"
    yield warning(f"{where}: negative frequencies f are motions that grow as exp(2 pi |f| t); {lowest}")


def _check_same_mechanism(scene: Scene, rom: ReducedOrderModel | None) -> None:
    if rom is None:
        return
    built = scene_from_toml(rom.record.scene_toml, scene.directory)
    for table in TABLES:
        if getattr(built, table) != getattr(scene, table):
            raise InputError(f"--rom: it was built from another scene: [{table}] differs; build it from this one")
    missing = scene.parameters.keys() ^ built.parameters.keys()
    if missing:
        names = ", ".join(sorted(missing))
        raise InputError(f"--rom: it was built with other parameters: {names}; build it from this scene")
