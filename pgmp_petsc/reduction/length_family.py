"""The build of models of one scene at the points of a grid of lengths, in bases that are continuous over these too.

The bases of models built at the points l_p are expressed in that of the model at the nominal lengths,

    Psi_p R_p,    R_p(theta) = (Psi_p^T M Psi_p)^-1 Psi_p^T M Psi_nominal

(docs/method.md, lengths and places as parameters); answers to joints that are off, behind these, are smooth as they
are. In between, tables are polynomials of l (`sample_grid`). The kinematics of one run are exact: the mechanism is made
anew with its lengths.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from operator import attrgetter

import numpy as np
import scipy.sparse as sp

from pgmp_petsc.base.errors import InputError, Remark, RunError, gathered, note, warning
from pgmp_petsc.base.resources import Timings
from pgmp_petsc.base.surroundings import Comm
from pgmp_petsc.bodies.matrices import AffineMatrices, weighted_sum
from pgmp_petsc.bodies.shape import BodyShape, at_lengths
from pgmp_petsc.files.seal import identity
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.modes.continuity import POOR_COSINE
from pgmp_petsc.ranks.agreement import agreed, on_root
from pgmp_petsc.reduction.cell_products import pair_rotations
from pgmp_petsc.reduction.rom import LengthFamily, ReducedOrderModel, ranges_of_lengths
from pgmp_petsc.reduction.rom_file import LengthCheck
from pgmp_petsc.reduction.sample_grid import LengthGrid, ParameterPoints, SampleGrid, Samples
from pgmp_petsc.reduction.tables import indefinite_between, mode_changes
from pgmp_petsc.scene import Scene, scene_to_toml
from pgmp_petsc.scene.parameters import spanning_values
from pgmp_petsc.scene.units import own_values, values_text
from pgmp_petsc.scene.uses import extremes, held, length_names

Build = Callable[[Scene, Mapping[str, BodyShape], SampleGrid | None, ParameterPoints | None], ReducedOrderModel | None]

HIGH = 0.5  # |T_n| where the family is checked; at points of the grid, where it vanishes, nothing could be seen
LARGE = 1e-4  # share by which frequencies between the points may be off without a warning
FOLLOWED = 0.9  # between spaces of modes of neighbouring angles; below, more angles are the likelier cure
MORE = "take more reduction.length_points, or a narrower range"
_ANSWERS: dict[str, str] = {}  # of `why_no_family`, which commands ask at several places


@contextmanager
def _at(scene: Scene, lengths: Mapping[str, float]) -> Iterator[None]:
    """Say at which lengths a model of the family is refused."""
    try:
        yield
    except (InputError, RunError) as error:
        cure = f". The model spans the whole range of {' and '.join(lengths)}: narrow the bounds, or take --full"
        cure = "" if _same(lengths, {name: scene.nominal[name] for name in lengths}) else cure
        error.args = (f"at {values_text(scene, lengths)}: {error}{cure}", *error.args[1:])
        raise


def why_no_family(scene: Scene, meshes: Mapping[str, BodyShape]) -> str:
    """Return at which of the lengths of a build the mechanism cannot be put together or turned, and why; empty where it
    can at all of them, and without lengths."""
    if not length_names(scene):
        return ""
    asked = identity(scene_to_toml(scene), dict(scene.nominal), dict(meshes))
    if asked not in _ANSWERS:
        _ANSWERS[asked] = _why_no_family(scene, meshes)
    return _ANSWERS[asked]


def _why_no_family(scene: Scene, meshes: Mapping[str, BodyShape]) -> str:
    grid = LengthGrid.of(scene)
    try:
        for values in ({name: scene.nominal[name] for name in grid.names}, *grid.points):
            own = held(scene, values)
            with _at(scene, values):
                RigidKinematics(Mechanism.from_scene(own, at_lengths(own, meshes)), over_range=True)
    except (InputError, RunError) as error:
        return str(error)
    return ""


def build_over_lengths(
    scene: Scene, meshes: Mapping[str, BodyShape], build: Build, comm: Comm
) -> ReducedOrderModel | None:
    """Build the model at the nominal lengths with its family, on the first rank, None elsewhere. Collective on `comm`.

    The scene has parameters that are lengths, places or ratios, and meshes are at any lengths. `build` builds the model
    of a scene whose lengths are those of its run, at given configurations and with vectors from given parameter values,
    or those that the scene asks for; it is collective, too. Raises `InputError` and `RunError` on all ranks, with the
    lengths at which a build failed, or if models of different lengths do not fit together.
    """
    grid = LengthGrid.of(scene)
    nominal_lengths = {name: scene.nominal[name] for name in grid.names}

    def built(own: Scene, values: Mapping[str, float]) -> ReducedOrderModel | None:
        own, there = held(own, values), points
        if points is not None and points.values:
            n = len(points.missed) - 1
            there = replace(points, values=points.values | {name: np.full(n, value) for name, value in values.items()})
        with _at(scene, values):
            return build(own, at_lengths(own, meshes), samples, there)

    everywhere, samples, points, said = scene, None, None, ()
    if scene.reduction.sampling_tolerance is not None:
        asked = [built(scene, values) for values in (nominal_lengths, *extremes(scene))]
        samples, said = on_root(comm, _common_samples, scene, asked)
        everywhere = scene.with_entries(reduction={"sampling_tolerance": None})

    def at(values: Mapping[str, float]) -> ReducedOrderModel | None:
        return built(everywhere, values)

    nominal = at(nominal_lengths)
    # vectors of other parameter values are of the same values at all lengths, at as many angles as they asked for
    points = on_root(comm, attrgetter("points"), nominal)
    if samples is None:
        samples, _ = on_root(comm, _common_samples, scene, [nominal])
    members = [nominal if _same(values, nominal_lengths) else at(values) for values in grid.points]
    between = nominal_lengths
    if grid.height(between) < HIGH:
        first, second = grid.nodes[:2]
        between = grid.values_at([0.5 * (first + second)] * len(grid.names))
    checked = nominal if between is nominal_lengths else at(between)
    found = None
    timings = Timings()
    with agreed(comm, "joining the models of all lengths"):
        if nominal is not None:
            with timings.phase("lengths"):
                gauge = _Gauge.of(held(scene, nominal_lengths), nominal)
                gauge.check(held(scene, between), checked)
                turned = [gauge.turned(held(scene, values), member) for values, member in zip(grid.points, members)]
            everyone = (nominal, *(member for member in (*members, checked) if member is not nominal))
            found = _joined(scene, grid, everyone, turned, (between, checked), timings.as_dict())
            found = replace(found, record=replace(found.record, remarks=(*found.record.remarks, *said)))
    return found


def _common_samples(scene: Scene, asked: Sequence[ReducedOrderModel]) -> tuple[SampleGrid, tuple[Remark, ...]]:
    """Return a grid of all angles that any of some models asked for, and what is said of them.

    Each begins with the same and halves distances, so that they have most in common. The tables of a mode that changes
    its sign in a turn go over two, with the same angles in both.
    """
    first, axes, counts = asked[0].tables.samples, [], np.ones(len(asked), dtype=int)
    for k, (axis, coordinate) in enumerate(zip(first, scene.coordinates.values())):
        turn = coordinate.range[1] - coordinate.range[0]
        end = axis.lower + turn if axis.periodic else np.inf
        each = [theta[theta < end] for theta in (model.tables.samples.axes[k].theta for model in asked)]
        axes.append(Samples(np.unique(np.concatenate(each)), axis.lower, axis.lower + turn, axis.periodic))
        counts *= [part.size for part in each]
    found, what = SampleGrid(tuple(axes)), "angles" if len(axes) == 1 else "configurations"
    said = note(
        f"reduction.sampling_tolerance: {found.n} {what}, all that the nominal lengths and the ends of their ranges "
        f"ask for ({', '.join(map(str, counts))}); models at other lengths have the same"
    )
    return found, (said,)


def _same(one: Mapping[str, float], other: Mapping[str, float]) -> bool:
    """Return whether lengths are equal to round-off."""
    return all(math.isclose(value, other[name], rel_tol=1e-12, abs_tol=1e-12) for name, value in one.items())


@dataclass(frozen=True, eq=False)
class _Gauge:
    """The basis that all others are expressed in."""

    model: ReducedOrderModel  # that it is of
    mass: sp.csr_matrix  # m at the nominal lengths and parameters, shape (n_dofs, n_dofs)

    @classmethod
    def of(cls, scene: Scene, model: ReducedOrderModel) -> _Gauge:
        mechanism = Mechanism.from_scene(scene, model.meshes)
        return cls(model, weighted_sum(AffineMatrices(mechanism.bodies, range(mechanism.n_dofs)).mass, scene.nominal))

    def check(self, scene: Scene, member: ReducedOrderModel) -> None:
        """Raise `RunError` if the basis of a model of other lengths, whose scene is given, has another number of
        vectors, or covers another number of turns."""
        own, wanted = member.projection, self.model.projection
        if own.shape != wanted.shape:
            lengths = values_text(scene, {name: scene.values[name] for name in length_names(scene)})
            cosine = min(member.cosines.min(), self.model.cosines.min())
            few = "the angles are too few to follow the modes from one to the next"
            crossed = "modes cross between these lengths"
            more, other = "more reduction.angles", "another number of reduction.modes"
            causes = (few, crossed, more, other) if cosine < FOLLOWED else (crossed, few, other, more)
            raise RunError(
                "at {}: {} vectors over {} configurations, {} over {} at the nominal lengths (least cosine between "
                "neighbouring angles {:.2g}): {}, or {}; take {}, or {}, or a narrower range".format(
                    lengths, own.shape[2], len(own), wanted.shape[2], len(wanted), cosine, *causes
                )
            )

    def turned(self, scene: Scene, member: ReducedOrderModel) -> tuple[ReducedOrderModel, float]:
        """Return a model of other lengths, whose scene is given, in this basis, and the least cosine to it.

        Raises what `check` raises.
        """
        self.check(scene, member)
        own, wanted = member.projection, self.model.projection
        n_given = member.tables.n_given
        n = own.shape[2] - n_given
        own, wanted = own[..., :n], wanted[..., :n]
        weighted = np.array([self.mass @ shape for shape in own])
        gram, crossed = np.swapaxes(own, 1, 2) @ weighted, np.swapaxes(weighted, 1, 2) @ wanted
        square = np.array([shape.T @ (self.mass @ shape) for shape in wanted])
        rotations = np.tile(np.eye(n + n_given), (len(own), 1, 1))
        rotations[:, :n, :n] = np.linalg.solve(gram, crossed)
        released = self.model.tables.unstrained
        if released.size:
            # what joints release stays without strain, so that it can be told from what bends
            own = np.ix_(range(len(gram)), released, released)
            rotations[:, :, released] = 0.0
            rotations[own] = np.linalg.solve(gram[own], crossed[own])
        projection = member.projection @ rotations
        tables, curvature = member.tables.turned(rotations), member.curvature
        gaps, scheme = member.gaps and member.gaps.turned(rotations), scene.interpolation
        if curvature is not None or gaps is not None:
            kinematics = RigidKinematics(Mechanism.from_scene(scene, member.meshes), member.branch)
            masses = AffineMatrices(kinematics.mechanism.bodies, range(kinematics.mechanism.n_dofs)).mass
        if curvature is not None:
            curvature = curvature @ pair_rotations(rotations)
            changes = mode_changes(kinematics, masses, tables.samples, projection, scheme, n_given)
            tables = replace(tables, changes=changes)
        if gaps is not None:
            gaps = gaps.changing(kinematics, masses, tables.samples, projection, scheme)
        missed = None if member.missed is None else member.missed.turned(rotations)
        arrays = {"tables": tables, "projection": projection, "curvature": curvature, "missed": missed, "gaps": gaps}
        return replace(member, **arrays, meshes={}), _least_cosine(gram, crossed, square)


def _least_cosine(one: np.ndarray, crossed: np.ndarray, other: np.ndarray) -> float:
    """Return the least cosine between two spaces, from Gram matrices of their vectors, (n, m, m) each."""
    left, right = np.linalg.cholesky(one), np.linalg.cholesky(other)
    between = np.linalg.solve(left, crossed) @ np.swapaxes(np.linalg.inv(right), 1, 2)
    return float(np.linalg.svd(between, compute_uv=False).min())


def _joined(
    scene: Scene,
    grid: LengthGrid,
    built: Sequence[ReducedOrderModel],
    turned: Sequence[tuple[ReducedOrderModel, float]],
    between: tuple[dict[str, float], ReducedOrderModel],
    seconds: Mapping[str, float],
) -> ReducedOrderModel:
    """Return the nominal model, the first that was built, with its family and what is to be said of it."""
    nominal, cosine = built[0], min(cosine for _, cosine in turned)
    values, exact = between  # the family is compared with a model that was built between its points
    at = np.array([values[name] for name in grid.names])
    family = LengthFamily(grid, tuple(member for member, _ in turned), LengthCheck(at, 0.0, 0.0))
    own, n_modes = family.at(scene.with_values(values), nominal), nominal.frequencies_hz.shape[1]
    ours, theirs = (model.tables.frequencies_hz(scene.nominal)[:, :n_modes] for model in (own, exact))
    blended = sum(share * member.rigid_inertia for share, member in zip(grid.shares(values), family.members))
    off, largest = (np.abs(part).max(axis=0) for part in (blended - exact.rigid_inertia, exact.rigid_inertia))
    # what couples two coordinates is at most the geometric mean of their own, and may vanish
    rows, columns = np.tril_indices(nominal.tables.n_coordinates)
    own_inertia = np.sqrt(largest[:, rows == columns])
    most = own_inertia[:, rows] * own_inertia[:, columns]
    inertia = np.divide(off, most, out=np.zeros(off.shape), where=most > 0.0)
    check = LengthCheck(at, float(np.max(np.abs(ours / theirs - 1.0))), float(np.max(inertia)))
    family = replace(family, check=check)
    indefinite = indefinite_between(family.merged(nominal).tables, scene, *spanning_values(scene))
    timings = dict(seconds)
    for model in built:
        for phase, time in model.record.timings.items():
            timings[phase] = timings.get(phase, 0.0) + time
    remarks = (*nominal.record.remarks, *_remarks(scene, family, len(built), cosine, indefinite))
    text, values = scene_to_toml(scene), own_values(scene, scene.nominal)
    record = replace(nominal.record, scene_toml=text, parameters=values, timings=timings, remarks=remarks)
    return replace(nominal, record=record, family=family, indefinite=nominal.indefinite or indefinite)


@gathered
def _remarks(scene: Scene, family: LengthFamily, n_builds: int, cosine: float, indefinite: str) -> Iterator[Remark]:
    grid, check = family.grid, family.check
    ranges = ", ".join(
        f"{name} from {one.shown(one.low)} to {one.shown(one.high)} {one.unit}".rstrip()
        for name, one in ranges_of_lengths(scene, grid).items()
    )
    said = (
        f"lengths: {ranges} are served by polynomials through models at {len(grid.points)} points ({n_builds} "
        f"builds); at {values_text(scene, family.checked)}, between them, frequencies are within "
        f"{check.frequencies:.2g} and the rigid inertia of ensembles within {check.inertia:.2g} of a model built there"
    )
    poor = max(check.frequencies, check.inertia) > LARGE
    yield warning(f"{said}; {MORE}") if poor else note(said)
    if cosine < POOR_COSINE:
        yield warning(
            f"the space of modes turns away between lengths (least cosine {cosine:.2g} to that of the nominal "
            "ones); take another number of reduction.modes, or a narrower range"
        )
    if indefinite:
        yield warning(f"between lengths: {indefinite}")
