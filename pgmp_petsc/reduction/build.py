"""The offline build: modes at the sampled configurations, joined into one continuous basis, and the reduced tables.

The configurations are dealt to groups of ranks in contiguous arcs. Each group solves its own eigenproblems and compares
neighbouring modes, also over the borders of the arcs; the rotations that make the basis continuous follow from these
comparisons on the first rank, so that the number of groups has no part in them. With a tolerance for the sampling,
rounds of further configurations follow where the interpolated tables differ from the fresh samples. What is of second
order, the curvature of the basis at its samples and the tables that follow from it, is found of the finished basis.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, TypeVar

import numpy as np

from pgmp_petsc.base.errors import NotFollowed, Remark, gathered, note, warning
from pgmp_petsc.base.progress import progress
from pgmp_petsc.base.resources import Timings
from pgmp_petsc.bodies.matrices import AffineMatrices, owned_rows
from pgmp_petsc.bodies.shape import BodyShape
from pgmp_petsc.components.condensing import angle_group, condensed
from pgmp_petsc.effects import Load, actions_of, effects_of, loads_of, patterns_of, start_of
from pgmp_petsc.effects.damping import check_ratios
from pgmp_petsc.effects.effect import Effect
from pgmp_petsc.effects.springs import spring_remarks
from pgmp_petsc.files.hdf5 import RunRecord
from pgmp_petsc.mechanism.capabilities import Purpose, check_capabilities
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.modes.built_in import BuiltIn, Closing
from pgmp_petsc.modes.continuity import POOR_COSINE
from pgmp_petsc.modes.curvature import CurvatureProblem
from pgmp_petsc.modes.problem import ModalProblem, ModeSet
from pgmp_petsc.outputs.multipliers import carried_forces
from pgmp_petsc.outputs.outputs import OutputSet
from pgmp_petsc.ranks.agreement import agreed, on_root
from pgmp_petsc.ranks.groups import RankGroup
from pgmp_petsc.reduction.angles import AngleRounds
from pgmp_petsc.reduction.cell_products import symmetric, unpacked
from pgmp_petsc.reduction.checkpoint import BuildCheckpoint
from pgmp_petsc.reduction.continuous_basis import ContinuousBasis, JoinedSamples, SampleStore, compression_of, in_order
from pgmp_petsc.reduction.interpolation import samples_for
from pgmp_petsc.reduction.joint_gaps import JointGaps, gap_answers_at, rows_of
from pgmp_petsc.reduction.length_family import build_over_lengths
from pgmp_petsc.reduction.missed_answers import MissedAnswers, missed_answers_at
from pgmp_petsc.reduction.rom import ReducedOrderModel
from pgmp_petsc.reduction.sample_grid import EACH, ParameterPoints, SampleGrid
from pgmp_petsc.reduction.sampler import Sample, Sampler, TurnedLoads
from pgmp_petsc.reduction.snapshots import Compression, ParameterSnapshots, choose_points
from pgmp_petsc.reduction.static_loads import InfluenceProbe, StaticLoads
from pgmp_petsc.reduction.tables import (
    SecondOrderTables,
    StiffnessChanges,
    acted_bodies,
    grid_of_places,
    indefinite_between,
    mode_changes,
    rigid_inertia,
)
from pgmp_petsc.scene import Scene, scene_to_toml
from pgmp_petsc.scene.parameters import spanning_values
from pgmp_petsc.scene.references import stressed_bodies
from pgmp_petsc.scene.units import own_values
from pgmp_petsc.scene.uses import length_names

OverSamples = TypeVar("OverSamples", MissedAnswers, JointGaps)
MISPLACED = 1e-4  # share by which forces may be off without a warning
FEW_VECTORS = (
    "reduction.parameter_modes: no more of the modes and static modes at other parameter values are independent at "
    "every configuration"
)
CROSSED = 0.1  # below it modes have changed places: an exact crossing has no angle between


def build_rom(
    scene: Scene,
    meshes: Mapping[str, BodyShape],
    group: RankGroup,
    scramble: Callable[[ModeSet], ModeSet] = lambda modes: modes,
    checkpoint: BuildCheckpoint | None = None,
) -> ReducedOrderModel | None:
    """Build the reduced-order model of a scene, on the first rank, None elsewhere. Collective on ``group.world``.

    Modes are taken at the scene's nominal parameters, of the mesh of every body, by groups of ranks that share an
    eigenproblem. `scramble` is applied to every mode set as it leaves the eigensolver; it lets tests spoil signs and
    order. The checkpoint has what is finished already, and keeps finished parts.
    Where the scene gives no number of modes, and its default cannot be followed, fewer are taken. Raises `InputError`
    and `RunError` on all ranks, whichever rank met it.
    """
    check_capabilities(scene, Purpose.BUILD, meshes)

    def built(own: Scene, shapes: Mapping[str, BodyShape], *of_lengths: Any) -> ReducedOrderModel | None:
        timings, part = Timings(), None if checkpoint is None else checkpoint.of(own)
        with timings.phase("components"):
            shapes = condensed(own, shapes, group, part)
        with angle_group(shapes, group) as angles:
            with timings.phase("kinematics"), agreed(group.world, "rigid kinematics"):
                build = _Build(own, shapes, angles, _Way(scramble, part, *of_lengths))
            found = build.found(timings)
            timings = timings.maximum(group.world)
            return None if found.joined is None else build.model(found, timings)

    over_lengths, tried = bool(length_names(scene)), scene
    while True:
        try:
            found = build_over_lengths(tried, meshes, built, group.world) if over_lengths else built(tried, meshes)
            break
        except NotFollowed as error:
            _, n_modes = error.args
            if "modes" in scene.reduction.model_fields_set or not 0 < n_modes < tried.reduction.modes:
                raise
        fewer = note(
            f"reduction.modes = {n_modes} were taken: the {scene.reduction.modes} of a scene that gives no number "
            "cannot be followed over the configurations; more reduction.angles may let them"
        )
        tried = scene.with_entries(reduction={"modes": n_modes}).with_remarks((*scene.remarks, fewer))
    if found is None or tried is scene:
        return found
    return replace(found, record=replace(found.record, scene_toml=scene_to_toml(scene)))


@dataclass(frozen=True)
class _Way:
    """How the build of one mechanism goes."""

    #: scramble, checkpoint: as of `build_rom`
    scramble: Callable[[ModeSet], ModeSet]
    checkpoint: BuildCheckpoint | None
    samples: SampleGrid | None = None  # its configurations, or the first of them; None leaves them to the scene
    points: ParameterPoints | None = None  # parameter values whose vectors extend the basis; None searches them


@dataclass(frozen=True, eq=False)
class _Found:
    """Result of the build of one mechanism; joined samples and basis on the first rank, None elsewhere."""

    samples: SampleGrid
    joined: JoinedSamples | None
    basis: ContinuousBasis | None
    rounds: AngleRounds
    points: ParameterPoints
    n_redundant: int  # constraints that say the same as others
    missed: MissedAnswers | None
    gaps: JointGaps | None


class _Build:
    """The build of one mechanism, with condensed bodies."""

    def __init__(self, scene: Scene, meshes: Mapping[str, BodyShape], group: RankGroup, way: _Way) -> None:
        self._scene, self._meshes, self._group, self._way = scene, meshes, group, way
        mechanism = self._mechanism = Mechanism.from_scene(scene, meshes).straight
        self._kinematics = RigidKinematics(mechanism, over_range=True)
        rows = owned_rows(mechanism.n_dofs, group.comm.rank, group.comm.size)
        self._matrices, self._effects = AffineMatrices(mechanism.bodies, rows), effects_of(scene, mechanism)
        check_ratios(self._effects, mechanism.bodies, scene.nominal)
        self._loads = loads_of(self._effects, self._matrices)
        carried = carried_forces(scene, self._kinematics, start_of(scene, mechanism)[0])
        self._opened_rows = rows_of((*OutputSet.of(scene, self._kinematics).forces, *carried), mechanism.n_held)
        self._actions = actions_of(self._effects)

    def found(self, timings: Timings) -> _Found:
        """Solve the eigenproblems and join them; what hangs on the basis follows. Collective on ``group.world``."""
        scene, group, loads, way = self._scene, self._group, self._loads, self._way
        store = SampleStore(group, way.samples or _samples(scene, self._kinematics))
        with ExitStack() as opened:
            with timings.phase("eigenproblems"), agreed(group.world, "eigenproblems"):
                n_modes, matrices = scene.reduction.modes, self._matrices
                problem = ModalProblem(self._kinematics, scene.nominal, n_modes, group.comm, matrices)
                opened.enter_context(problem)
                static_loads = StaticLoads.of(problem, patterns_of(self._effects, matrices), scene.reduction)
            with timings.phase("points"):
                points = way.points or choose_points(scene, problem, static_loads, group)
            with timings.phase("eigenproblems"), agreed(group.world, "eigenproblems"):
                snapshots = opened.enter_context(ParameterSnapshots(problem, static_loads, points.points))
                built_in = BuiltIn(problem, scene, self._meshes)
                known = all(body.third_derivative_known for body in problem.mechanism.bodies)
                probe = InfluenceProbe(problem, self._actions) if known else None
                sampler = Sampler(problem, loads, static_loads, snapshots, probe, built_in)
            joined, basis, rounds = self._joined(store, sampler, timings)
            manifold = missed = gaps = None
            curves = scene.second_order
            if what := ", ".join([*["second order"] * curves, *["joint forces"] * bool(self._opened_rows.size)]):
                with timings.phase(what):
                    if curves or known and not built_in.n:
                        stretching = scene.static_stretching or not curves
                        manifold = Manifold(problem, loads, static_loads, stretching, built_in)
                    basis, gaps = self._beyond(store, basis, problem, manifold, what)
            weights = (*self._mechanism.mass_weights, *self._mechanism.stiffness_weights)
            if stressed_bodies(scene) and any(weight.powers for weight in weights):
                with timings.phase("section forces"):
                    missed = self._missed(store, basis, problem, static_loads)
        return _Found(store.samples, joined, basis, rounds, points, problem.n_redundant, missed, gaps)

    def _joined(
        self, store: SampleStore, sampler: Sampler, timings: Timings
    ) -> tuple[JoinedSamples | None, ContinuousBasis | None, AngleRounds]:
        """Compute samples, round by round, and join them; on the first rank, None elsewhere. Collective."""
        scene, world, mechanism = self._scene, self._group.world, self._mechanism
        joined, basis, rounds = None, None, AngleRounds(scene, mechanism, store.samples, self._way.samples is None)
        first_static = sampler.problem.n_modes + sampler.problem.n_released
        compression: Compression | None = None
        while True:
            with timings.phase("eigenproblems"), agreed(world, "eigenproblems"):
                self._compute(store, sampler)
            with timings.phase("continuity"):
                previous = basis
                with agreed(world, "continuity"):
                    joined = store.join()
                with agreed(world, "compression"):
                    if joined is not None:
                        found = compression_of(
                            mechanism, scene.nominal, joined, scene.reduction.parameter_modes, compression
                        )
                        if found is not compression:  # other vectors have other tables: nothing to compare
                            previous, compression = None, found
                        basis = ContinuousBasis.of(
                            mechanism, store.samples, self._loads, joined, compression,
                            scene.nominal if scene.second_order else None,
                        )  # fmt: skip
                        if self._actions:  # static modes answer their forces
                            rounds.static = range(first_static, joined.n_kept)
                wanted = on_root(world, lambda: rounds.wanted(store.samples, previous, basis))
            if wanted.size == 0:
                return joined, basis, rounds
            store.request(wanted)

    def _compute(self, store: SampleStore, sampler: Sampler) -> None:
        """Compute this group's missing samples, but for those of the checkpoint."""
        missing, checkpoint = store.missing(), self._way.checkpoint
        if not missing:
            return
        sampler.problem.kinematics.follow(np.array(list(missing.values())))
        with progress(len(missing), "eigenproblems", self._group.world) as bar:
            try:
                for number, theta in missing.items():
                    sample = None if checkpoint is None else checkpoint.sample(theta, sampler.problem)
                    if sample is None:
                        sample = sampler.sample(theta, self._way.scramble)
                        if checkpoint is not None:
                            checkpoint.add_sample(theta, sample, sampler.problem)
                    store.put(number, sample)
                    bar.update()
            finally:
                if checkpoint is not None:
                    checkpoint.flush()

    def _missed(
        self, store: SampleStore, basis: ContinuousBasis | None, problem: ModalProblem, static_loads: StaticLoads
    ) -> MissedAnswers | None:
        """Return what the finished basis misses of the answers to its loads; None but on the first rank. Collective."""
        stressed = stressed_bodies(self._scene)
        dofs = np.sort(np.concatenate([body.dofs for body in problem.mechanism.bodies if body.name in stressed]))

        def at(modes: ModeSet, sample: Sample, combination: np.ndarray) -> tuple[np.ndarray, ...]:
            weights, forces, answers = missed_answers_at(problem, static_loads, modes, sample, combination)
            return answers.T, weights, forces

        gathered = self._at_samples(store, basis, problem, "section forces", at)
        if gathered is None or basis is None:
            return None
        answers = np.array([columns[dofs].T for columns, _, _ in gathered])
        found = MissedAnswers(gathered[0][1], dofs, np.array([forces for _, _, forces in gathered]), answers)
        return _over_turns(found, store.samples, basis)

    def _beyond(
        self, store: SampleStore, basis: ContinuousBasis | None, problem: ModalProblem, manifold: Manifold | None,
        what: str,
    ) -> tuple[ContinuousBasis | None, JointGaps | None]:  # fmt: skip
        """Return the finished basis with what is of second order, where the scene has it, and products with it of
        static answers to unit gaps in some constraints, of second order too where there is a manifold (first rank; None
        elsewhere, and without constraints). Collective."""
        rows, g = self._opened_rows, self._opened_rows.size
        turned, closing = TurnedLoads(problem, self._loads), Closing(problem)

        def at(modes: ModeSet, sample: Sample, combination: np.ndarray) -> tuple:
            answers, products = sample.shape[:, :0], ()
            if g:
                shape = np.hstack([sample.shape, sample.built_in]) @ combination
                answers, *products = gap_answers_at(problem, turned, closing, rows, modes, shape)
            if manifold is None:
                return answers, None, products
            opened = answers[:, : 0 if sample.built_in.shape[1] else g]
            chi, tables, curved = manifold.at(modes, sample, combination, opened)
            return np.hstack([chi, answers]), tables, (*products, *(curved if opened.shape[1] else ()))

        gathered = self._at_samples(store, basis, problem, what, at)
        if gathered is None or basis is None:
            return None, None
        (columns, seconds, products), gaps, m = zip(*gathered), None, basis.tables.n_modes
        n_own = 0 if manifold is None else m * (m + 1) // 2
        chi, crossed, answers = np.split(np.array(columns), [n_own, columns[0].shape[1] - g], axis=-1)
        if g:
            tables = [np.array(parts) for parts in zip(*products)]
            curvature = [crossed.reshape(*crossed.shape[:2], -1, m)] * (len(tables) > 4)
            gaps = JointGaps(rows, *tables[:4], answers, *tables[4:], *curvature)
            gaps = _over_turns(gaps, store.samples, basis)
        if self._scene.second_order:
            first, *others = seconds
            joined = first.each(EACH, lambda *parts: np.concatenate(parts), *others)
            basis = basis.curved(store.samples, chi, SecondOrderTables(**joined))
        return basis, gaps

    def _at_samples(
        self, store: SampleStore, basis: ContinuousBasis | None, problem: ModalProblem, what: str,
        at: Callable[[ModeSet, Sample, np.ndarray], tuple],
    ) -> list[tuple] | None:  # fmt: skip
        """Return what is found at all samples of a finished basis, the rows of the first part of all ranks (first rank;
        None elsewhere). Collective."""
        world, own, found = self._group.world, store.own(), {}
        combinations = world.bcast(None if basis is None else basis.combinations)
        with agreed(world, what), progress(len(own), what, world) as bar:
            for place, sample in own.items():
                modes = problem.resume(
                    store.samples.theta[place], sample.eigenvalues, sample.shape[:, : sample.n_modes]
                )
                rows, *others = at(modes, sample, combinations[place])
                found[place] = problem.all_rows(rows), *others
                bar.update()
        return in_order(self._group, found)

    def model(self, found: _Found, timings: Timings) -> ReducedOrderModel:
        """Return the model that was found; on the first rank."""
        scene, kinematics, joined, basis = self._scene, self._kinematics, found.joined, found.basis
        tables, mass, gaps = basis.tables, self._matrices.mass, found.gaps
        n_ranks, bodies, scheme = self._group.world.size, self._mechanism.bodies, scene.interpolation
        if self._group.comm.size > 1:
            mass = AffineMatrices(bodies, range(self._mechanism.n_dofs)).mass
        if scene.second_order:
            changes = mode_changes(kinematics, mass, tables.samples, basis.projection, scheme, tables.n_given)
            tables = replace(tables, changes=changes)
        if gaps is not None:
            gaps = gaps.changing(kinematics, mass, tables.samples, basis.projection, scheme)
        n_parameter = tables.n_modes - tables.n_given - joined.n_kept
        indefinite = indefinite_between(tables, scene, *spanning_values(scene))
        remarks = (
            *scene.remarks,
            *(() if self._way.checkpoint is None else self._way.checkpoint.remarks),
            *kinematics.remarks,
            *spring_remarks(self._effects, scene.reduction),
            *_doubts(float(joined.cosines.min()), basis.tables.unstrained.size > 0, found.n_redundant, indefinite),
            *_quick_places(self._effects, kinematics, tables.samples),
            *found.rounds.remarks(found.samples, basis),
            *_few_vectors(n_parameter, scene.reduction.parameter_modes),
        )
        toml, nominal = scene_to_toml(scene), own_values(scene, scene.nominal)
        return ReducedOrderModel(
            tables=tables,
            branch=kinematics.branch,
            rigid_inertia=rigid_inertia(tables.samples, mass, kinematics),
            projection=basis.projection,
            frequencies_hz=np.sqrt(joined.tables["eigenvalues"]) / (2 * np.pi),
            cosines=joined.cosines,
            meshes=dict(self._meshes),
            n_redundant=found.n_redundant,
            record=RunRecord(toml, nominal, None, n_ranks, timings.as_dict(), remarks),
            curvature=basis.curvature,
            points=replace(found.points, n_vectors=n_parameter),
            indefinite=indefinite,
            stiffness_changes=_stiffness_changes(found.samples, joined, basis),
            missed=found.missed,
            gaps=gaps,
        )


@gathered
def _doubts(cosine: float, is_loose: bool, n_redundant: int, indefinite: str) -> Iterator[Remark]:
    """Return what is doubtful about a basis and its tables, and which constraints are not in it."""
    if cosine < POOR_COSINE:
        cure = "take more reduction.angles, or another number of reduction.modes if the last mode crosses the next one"
        if cosine < CROSSED and is_loose:
            cure = (
                "outputs may be wrong by all of their size: take more reduction.angles, as bodies turn far between "
                "these, or one more of reduction.modes, or one less, as the last mode crosses the next one, until this "
                "is not said"
            )
        elif cosine < CROSSED:
            cure = (
                "the last mode crosses the next one, and outputs may be wrong by all of their size: take one more of "
                "reduction.modes, or one less, until this is not said; more angles do not help"
            )
        yield warning(f"the space of modes turns away between neighbouring angles (least cosine {cosine:.2g}); {cure}")
    if indefinite:
        yield warning(indefinite)
    if n_redundant:
        yield note(f"{n_redundant} redundant constraints were dropped: others say the same")


@gathered
def _quick_places(effects: Sequence[Effect], kinematics: RigidKinematics, samples: SampleGrid) -> Iterator[Remark]:
    """Warn of effects at bodies that turn, as motors behind gears do, too far from one place to the next of the table
    by whose splines forces know where they stand (`grid_of_places`): directors err by h^4 / 384 over h rad."""
    _, turns = grid_of_places(samples, kinematics, actions_of(effects))
    for effect in effects:
        bodies = acted_bodies(effect.actions())
        far, name = max(((turns[body], kinematics.mechanism.bodies[body].name) for body in bodies), default=(0.0, ""))
        if far**4 / 384.0 > MISPLACED:
            share = f"{100.0 * far**4 / 384.0:.2g} %" if far < 1.0 else "a percent and more"
            yield warning(
                f"{effect.entry}: body '{name}' turns by {far:.2g} rad from one place to the next of the table by "
                f"which reduced models know where it stands: its forces may be off by {share}; let it act on the "
                "slow side of the gear, or take a smaller range of the coordinates, --components or --full"
            )


@gathered
def _few_vectors(found: int, asked: int) -> Iterator[Remark]:
    """Warn of fewer vectors of other parameter values than asked for."""
    if found < asked:
        yield warning(
            f"{FEW_VECTORS}: {found} in place of {asked}; outputs at other parameter values may be served less"
        )


def _over_turns(found: OverSamples, samples: SampleGrid, basis: ContinuousBasis) -> OverSamples:
    for grid, axis, signs in samples.turns(basis.flipped):
        found = grid.doubled(axis, found, signs)
    return found


def _stiffness_changes(samples: SampleGrid, joined: JoinedSamples, basis: ContinuousBasis) -> StiffnessChanges | None:
    influence = joined.tables["influence"]
    if not influence.size:
        return None
    stiffness = np.diagonal(joined.tables["stiffness"], axis1=2, axis2=3)[..., : influence.shape[1]]
    found = StiffnessChanges(influence, np.array(stiffness))
    for grid, axis, _ in samples.turns(basis.flipped):  # on the second revolution they are the same
        found = replace(found, **found.each(EACH, partial(grid.twice, axis), found))
    return found


def _samples(scene: Scene, kinematics: RigidKinematics) -> SampleGrid:
    reduction, coordinates = scene.reduction, kinematics.coordinates
    angles = np.broadcast_to(reduction.angles, len(coordinates))
    return SampleGrid(
        tuple(
            samples_for(scene.interpolation, c.lower, c.upper, int(n), c.periodic) for c, n in zip(coordinates, angles)
        )
    )


class Manifold:
    """Curvature at any sampled configuration. Collective on the problem's communicator.

    The problem is at the nominal parameters, load terms of the scene are local rows in the inertial frame, static loads
    those whose answers the basis holds, and `built_in` offsets, of which samples have the answers, or None; for
    `static_stretching` see `CurvatureProblem`.
    """

    def __init__(
        self,
        problem: ModalProblem,
        loads: Sequence[Load],
        static_loads: StaticLoads,
        static_stretching: bool = False,
        built_in: BuiltIn | None = None,
    ) -> None:
        self._problem, self._loads, self._static_loads = problem, TurnedLoads(problem, loads), static_loads
        self._curvature = CurvatureProblem(problem, static_stretching, built_in)

    def at(
        self, modes: ModeSet, sample: Sample, combination: np.ndarray, opened: np.ndarray | None = None
    ) -> tuple[np.ndarray, SecondOrderTables, tuple[np.ndarray, ...]]:
        """Return chi in body frames, pairs packed, local rows, shape (n_local, n_pairs), and the tables of one sample,
        at the configuration that the problem is at.

        The basis is a combination of the vectors found there, shape (n_vectors, m). Further pairs are of answers to
        unit gaps in constraints, `opened`, local rows, shape (n_local, g), and the basis, (g, m): behind the others in
        chi, and of their own as the last part, in the order of `JointGaps`. Raises `RunError` if the refinement of an
        answer does not converge.
        """
        problem, theta = self._problem, modes.theta
        first, last = sample.n_modes, sample.n_modes + problem.n_released
        answered = self._curvature.answered_loads(modes, sample.kept[:, last:], self._static_loads.at(problem, modes))
        # motions without strain answer no load
        answered = np.insert(answered, [first] * (last - first), 0.0, axis=1)
        shape, loose = np.hstack([sample.shape, sample.built_in]) @ combination, combination[first:last].any(axis=0)
        answered, g = answered @ combination[: sample.n_kept], 0 if opened is None else opened.shape[1]
        m = loose.size
        if g:
            shape, answered = np.hstack([shape, opened]), np.pad(answered, ((0, 0), (0, g)))
            loose = np.pad(loose, (0, g))
        curvature = self._curvature.solve(modes, shape, answered, loose, g)
        everywhere = problem.all_rows(curvature.chi)
        mass = [problem.matrices.mass[weight] for weight in problem.mechanism.mass_weights]
        # (k, pair of i, j): a third of K3, which comes three times, and psi_k.K_t chi_ij
        thirds = np.array([
            problem.inner(shape, curvature.third[weight] / 3.0 + problem.matrices.stiffness[weight] @ everywhere)
            for weight in problem.mechanism.stiffness_weights
        ])  # fmt: skip
        k, j = np.tril_indices(modes.rigid.shape[1])
        accelerations = modes.rigid_curvature[:, k, j]
        inertia = np.array([problem.inner(accelerations, term @ everywhere) for term in mass])
        motion = problem.kinematics.motion(theta)
        vectors, pairs = problem.all_rows(shape), curvature.pairs
        # chi has no momentum along coordinates that are free, at the nominal parameters
        given = np.setdiff1d(np.arange(modes.rigid.shape[1]), modes.free)
        momenta = np.zeros((len(mass), modes.rigid.shape[1] if given.size else 0, pairs[0].size))
        if given.size:
            momenta[:, given] = [problem.inner(modes.rigid[:, given], term @ everywhere) for term in mass]
        lost = problem.lost_inertia(theta)
        for t, weight in enumerate(problem.mechanism.mass_weights):
            inertia[t] += self._curvature.rotary.work(motion.accelerations[:, :, k, j], vectors, pairs, weight)
            if weight in lost:
                inertia[t] += problem.inner(lost[weight][:, k, j], curvature.chi)
            if given.size:
                momenta[t, given] += self._curvature.rotary.work(motion.velocities[..., given], vectors, pairs, weight)
        both = thirds, problem.inner(self._loads.at(theta), curvature.chi), inertia, momenta
        n_own = m * (m + 1) // 2
        cubic, *own = (unpacked(table[..., :n_own]) for table in both)
        mixed, *crossed = (table[..., n_own:].reshape(*table.shape[:-1], g, m) for table in both)
        # those of two vectors and a gap: it is the first or one of the pair
        mixed = np.moveaxis(mixed[:, :m], 1, -1)
        mixed = cubic[:, m:] + mixed + np.swapaxes(mixed, -1, -2)
        tables = SecondOrderTables(symmetric(3.0 * cubic[:, :m])[None], *(table[None] for table in own))
        return curvature.chi, tables, (mixed, *crossed)
