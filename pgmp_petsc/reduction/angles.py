"""Angles that a build adds to those it begins with, and errors of stress outputs by interpolation between them.

With a tolerance, each coordinate has further angles: after each round the tables that were interpolated before are
compared with the samples that came since, and where they differ by more, both halves of the interval are sampled in the
next round. Differences are relative to what they act beside: mass to the modes' unit mass, stiffness entry (i, j) to
the geometric mean of the diagonal ones, loads and inertia forces to their own largest values. Tables of second order in
the deformation follow, but are not compared: they correct the others by small amounts, and may vanish but for
round-off.

Without a tolerance, a single coordinate has further angles, if it may, where vectors of other parameter values turn too
quickly between them (the basis is too uneven), and half the distances where interpolated matrices are indefinite at
some values, and where stresses ``R = D S Psi K_r^-1 Psi^T L`` under the loads L are interpolated badly (D and S as in
`missed_answers`; docs/method.md, section forces at other parameters): every other sample is predicted from those beside
it, and `GAIN` leads from the difference to the error of the samples as they are. Inertia forces of one coordinate alone
are judged together: those of its acceleration, and those of its speed where it swings by a tenth of its range with that
acceleration. What hardly stresses a body beside the other does not count.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from pgmp_petsc.base.errors import Remark, RunError, gathered, note, warning
from pgmp_petsc.bodies.affine import evaluate_weights
from pgmp_petsc.bodies.body import Body
from pgmp_petsc.bodies.stresses import BeamLaw, SolidLaw, Strains
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.modes.continuity import by_groups
from pgmp_petsc.outputs.stress import StressOutput
from pgmp_petsc.reduction.continuous_basis import ContinuousBasis
from pgmp_petsc.reduction.interpolation import interpolant
from pgmp_petsc.reduction.sample_grid import SampleGrid, Samples
from pgmp_petsc.reduction.tables import ReducedTables, indefinite_between, weighted, with_units
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.parameters import spanning_values
from pgmp_petsc.scene.references import stressed_bodies
from pgmp_petsc.scene.uses import slides

#: What may be left. Full-order runs of slider-cranks are met within 1 % from there on (`test_stress_outputs.py`).
TARGET = 0.01
#: By which half the distances are better: third order is the least that any scheme has. Of axial and shear forces of a
#: slider-crank, runs were off by 1/7 to 1/46 of the predictions' errors, by splines.
GAIN = 8.0
# From one angle to the next; with 2.3 the slider-crank's deformation errs by 4 %, with 1.8 and 1.6 by 2.1 and 1.7 %, as
# with vectors as they are
UNEVEN = 2.0
STALLED = 0.5  # of the error of stress outputs: what two rounds must leave less than
SMALL = 1e-3  # of the largest value in the body that has the same unit: of what is less, no share is asked for
NOTHING = 1e-9  # of a load, beside the rigid motion's: round-off
# of values at displacements as large without any order: what a body has that moves without bending, or not at all where
# a load moves others
ROUND_OFF = 1e-12
FEWEST = 8  # samples of an axis that can be predicted by half of them
SWING = 0.1  # of the range of a coordinate: amplitude, so that the square of the speed is that times the acceleration
REFERENCES = 8  # configurations at which the largest values in the body, and displacements, are looked for
AT_ONCE = 2**22  # strains that are evaluated together: 32 MB


UNEVEN_VECTORS = "vectors of other parameter values (reduction.parameter_modes) turn quickly where they are small"
QUICK_STRESSES = "stress outputs change quickly between them: "


class AngleRounds:
    """Rounds of the build of one mechanism, each with further angles (first rank).

    The samples are those of the first round, and `refinable` tells whether angles may be added where no tolerance asks
    for them. Raises `RunError` where a tolerance would be compared with more than there may be.
    """

    def __init__(self, scene: Scene, mechanism: Mechanism, samples: SampleGrid, refinable: bool) -> None:
        self._scene, self._mechanism = scene, mechanism
        self._refinable = refinable and len(scene.coordinates) == 1 and scene.reduction.sampling_tolerance is None
        self.static = range(0)  # numbers of the static modes that answer forces of actions
        self._errors: dict[str, float] = {}  # of stress outputs by interpolation over the last angles
        self._before: list[float] = []  # the largest of these in each round
        #: why there are angles besides those asked for: by what turns quickly, the names of outputs where it is these
        self._reasons: dict[str, dict[str, None]] = {}
        tolerance = scene.reduction.sampling_tolerance
        if tolerance is not None:  # before anything is computed
            _beyond_tolerance(scene, samples, None, None)
        self._cure = (
            "take more reduction.angles" if tolerance is None else "take a smaller reduction.sampling_tolerance"
        )

    def wanted(self, samples: SampleGrid, previous: ContinuousBasis | None, current: ContinuousBasis) -> np.ndarray:
        """Return the configurations of the next round, shape (n, n_theta); none where these are enough."""
        scene, axis = self._scene, samples.axes[0]
        found, others = np.zeros(0), ()
        if scene.reduction.sampling_tolerance is not None:
            found, *others = _beyond_tolerance(scene, samples, previous, current)
        elif self._refinable:
            found = _for_uneven_vectors(scene, axis, current)
            if axis.n + found.size > scene.reduction.max_angles:
                found = np.zeros(0)
            elif found.size:
                self._reasons.setdefault(UNEVEN_VECTORS, {})
        if not any(part.size for part in (found, *others)) and stressed_bodies(scene):
            found = self._for_stresses(axis, current)
        return samples.further((found, *others))

    def _for_stresses(self, axis: Samples, basis: ContinuousBasis) -> np.ndarray:
        """Return the angles, shape (n,), that stress outputs need."""
        self._errors = stress_errors(self._scene, self._mechanism, basis.tables.moving(), basis.projection, self.static)
        self._before.append(max(self._errors.values()))
        poor, most = [name for name, error in self._errors.items() if error > TARGET], self._scene.reduction.max_angles
        if not (poor and self._refinable):
            return np.zeros(0)
        if 2 * axis.n > most:
            self._cure = f"raise reduction.max_angles ({most})"
        elif len(self._before) > 2 and not self._before[-1] < STALLED * self._before[-3]:
            left = _share(self._before[-1] / self._before[-3])
            self._cure = f"four times the angles left {left} of that, so that no more were tried"
        else:
            self._reasons.setdefault(QUICK_STRESSES, {}).update(dict.fromkeys(poor))
            return _between(axis, self._scene.interpolation)
        return np.zeros(0)

    @gathered
    def remarks(self, samples: SampleGrid, basis: ContinuousBasis) -> Iterator[Remark]:
        """Return what is said of the angles."""
        (asked, *_) = np.broadcast_to(self._scene.reduction.angles, samples.n_coordinates)
        uneven = basis.uneven.max(initial=1.0)
        if uneven > UNEVEN:
            more = f"their size changes by {uneven:.2g} times between angles; take more reduction.angles"
            yield warning(f"{UNEVEN_VECTORS}: {more}")
        if self._reasons:
            why = ", and as ".join(reason + ", ".join(names) for reason, names in self._reasons.items())
            yield note(f"reduction.angles: {samples.n} in place of {asked}, as {why}")
        poor = {name: error for name, error in self._errors.items() if error > TARGET}
        if poor:
            which = ", ".join(f"{name} {_share(error)}" for name, error in poor.items())
            yield warning(
                f"stress outputs are off by interpolation between {samples.n} configurations, as shares of their "
                f"largest values under a load: {which}; {self._cure}"
            )


def _share(error: float) -> str:
    return f"{100.0 * error:.3g} %" if error <= 1.0 else "more than all of it" if np.isfinite(error) else "not known"


def _for_uneven_vectors(scene: Scene, samples: Samples, basis: ContinuousBasis) -> np.ndarray:
    """Return the angles, shape (n,), without which vectors of other parameter values turn too quickly: in the middle of
    intervals over which they do and of those beside them; of all where matrices are indefinite, or the scheme wants
    equal distances."""
    if not scene.reduction.parameter_modes:
        return np.zeros(0)
    halves, quick = _between(samples, scene.interpolation), np.flatnonzero(basis.uneven > UNEVEN)
    if indefinite_between(basis.tables, scene, *spanning_values(scene)):
        return halves
    if scene.interpolation != "spline":
        return halves if quick.size else np.zeros(0)
    beside = quick[:, None] + np.arange(-1, 2)
    return halves[np.unique(beside % halves.size if samples.periodic else beside.clip(0, halves.size - 1))]


def _between(samples: Samples, scheme: str) -> np.ndarray:
    """Return the angles, shape (n,), that halve the distances between those that a scheme wants."""
    if scheme == "spectral" and not samples.periodic:
        return Samples.chebyshev(samples.lower, samples.upper, 2 * samples.n - 1).theta[1::2]
    return samples.between(0.5)


def _beyond_tolerance(
    scene: Scene, grid: SampleGrid, previous: ContinuousBasis | None, current: ContinuousBasis | None
) -> list[np.ndarray]:
    """Return the angles of the next round of adaptive sampling along each coordinate, shape (n,); none where the
    tolerance holds. Raises `RunError` if a build may not take as many.

    What an angle along one coordinate brought is seen where the others have angles of the round before.
    """
    if previous is None:
        return _allowed(scene, grid, [axis.between(0.5) for axis in grid], "it is not known how much they miss")
    tolerance, wanted, poorest, why = scene.reduction.sampling_tolerance, [], 0.0, ""
    # over one turn, whatever vectors changed their signs after it in the round before
    known = [np.intersect1d(axis.theta, old.theta) for axis, old in zip(grid, previous.tables.samples)]
    before = SampleGrid(tuple(replace(axis, theta=theta) for axis, theta in zip(grid, known)))
    for k, (name, samples, old) in enumerate(zip(scene.coordinates, grid, before)):
        new = np.setdiff1d(samples.theta, old.theta)
        if not new.size:
            wanted.append(new)
            continue
        beside = SampleGrid((*before.axes[:k], replace(old, theta=new), *before.axes[k + 1 :]))
        errors = interpolation_errors(previous, current, beside.theta, scene.nominal).reshape(beside.shape)
        errors = np.moveaxis(errors, k, 0).reshape(new.size, -1).max(axis=1)
        if errors.max() > poorest:
            unit, poorest = "m" if slides(scene, scene.coordinates[name]) else "rad", float(errors.max())
            where = scene.system.text(float(new[np.argmax(errors)]), unit, ".4g")
            why = f"the tables still differ by {poorest:.2g} near {name} = {where}"
        # both halves of the interval that a poor sample has split
        theta = np.append(samples.theta, samples.upper) if samples.periodic else samples.theta
        left = np.searchsorted(theta, new[errors > tolerance])
        chosen = np.zeros(theta.size - 1, dtype=bool)
        chosen[left - 1] = chosen[left] = True
        wanted.append(samples.between(0.5)[chosen])
    return _allowed(scene, grid, wanted, why)


def _allowed(scene: Scene, grid: SampleGrid, wanted: list[np.ndarray], why: str) -> list[np.ndarray]:
    """Return the angles that are wanted, unless they are too many with those that are there."""
    n, reduction = math.prod(axis.n + own.size for axis, own in zip(grid, wanted)), scene.reduction
    if grid.n < n > reduction.max_angles:
        what = "angles" if grid.n_coordinates == 1 else "configurations"
        raise RunError(
            f"reduction.sampling_tolerance = {reduction.sampling_tolerance:g}: with {grid.n} {what} {why}, and the "
            f"next are {n}; raise reduction.max_angles ({reduction.max_angles}) or the tolerance, or begin with fewer "
            "reduction.angles"
        )
    return wanted


def stress_errors(
    scene: Scene, mechanism: Mechanism, tables: ReducedTables, projection: np.ndarray, static: range
) -> dict[str, float]:
    """Return by stress output how far interpolation is off, as a share of its largest value; infinity where angles are
    too few to tell.

    The projection has flexible vectors, shape (n, n_dofs, n_delta), and any behind them; loads of the vectors whose
    numbers are `static` count, too.
    """
    numbers = {body.name: number for number, body in enumerate(mechanism.bodies)}
    outputs = [
        StressOutput.of(name, scene, numbers[entry.body], mechanism.bodies[numbers[entry.body]])
        for name, entry in scene.outputs.items()
        if "stresses" in entry.reads
    ]
    stiffness, loads, kin = _stiffness_and_loads(scene, tables, static)
    answers, found = np.linalg.solve(stiffness, loads), {output.name: 0.0 for output in outputs}
    if not loads.size:
        return found
    halves = [_Halves.of(tables.samples, axis, scene.interpolation) for axis in range(tables.n_coordinates)]
    if None in halves:
        return dict.fromkeys(found, np.inf)
    predicted = [np.linalg.solve(half.predicted(stiffness), half.predicted(loads)) for half in halves]
    random = np.random.default_rng(0)
    few = slice(None, None, max(1, len(projection) // REFERENCES))
    far = np.abs(projection[few, :, : tables.n_modes] @ answers[few]).max(axis=(0, 1))  # in all bodies
    for output in outputs:
        body = mechanism.bodies[output.body]
        shapes = projection[:, body.dofs, : tables.n_modes]
        moves = shapes @ answers
        largest = np.maximum(_largest(output, body, moves, scene), SMALL * _reference(output, body, moves, scene))
        for k in range(tables.n_coordinates):
            largest[kin == k] = largest[kin == k].max(initial=0.0)
        disorder = random.normal(size=(1, body.dofs.size, 1))
        felt = largest > ROUND_OFF * _largest(output, body, disorder, scene) * far
        for half, own in zip(halves, predicted):
            off = half.predicted(shapes) @ own - half.known(moves)
            errors = np.divide(_largest(output, body, off, scene), largest, out=np.zeros(largest.size), where=felt)
            found[output.name] = max(found[output.name], float(errors.max(initial=0.0)) / GAIN)
    return found


@dataclass(frozen=True, eq=False)
class _Halves:
    """Samples of one axis of a grid, and those in their middles."""

    grid: SampleGrid
    axis: int
    samples: Samples  # the former
    scheme: str  # interpolation over them
    kept: np.ndarray  # their numbers
    #: of the others: numbers, and places among the former
    left: np.ndarray
    theta: np.ndarray

    @classmethod
    def of(cls, grid: SampleGrid, axis: int, scheme: str) -> _Halves | None:
        """Part the samples along an axis; None where there are too few."""
        samples = grid.axes[axis]
        numbers = np.arange(samples.n)
        if samples.n < FEWEST:
            return None
        if samples.periodic and samples.n % 2:
            samples, numbers = samples.over_two_turns(), np.tile(numbers, 2)  # every other one of two turns
        elif not samples.periodic and samples.n % 2 == 0:
            numbers = numbers[:-1]
            if scheme == "spectral":
                scheme = "spline"  # these are no Chebyshev points
        theta = samples.theta[: numbers.size]
        upper = samples.upper if samples.periodic else float(theta[-1])
        half = Samples(theta[::2], samples.lower, upper, samples.periodic)
        return cls(grid, axis, half, scheme, numbers[::2], numbers[1::2], theta[1::2])

    def predicted(self, table: np.ndarray) -> np.ndarray:
        """Return a table (n, ...) at the others, shape (n_left, ...), from those that are kept."""
        kept = np.ascontiguousarray(self._along(table)[self.kept])
        return interpolant(self.samples, kept, self.scheme)(self.theta).reshape(-1, *table.shape[1:])

    def known(self, table: np.ndarray) -> np.ndarray:
        """Return the table itself there."""
        return self._along(table)[self.left].reshape(-1, *table.shape[1:])

    def _along(self, table: np.ndarray) -> np.ndarray:
        """Return a table (n, ...) with an axis per coordinate, that of the halves first."""
        return np.moveaxis(table.reshape(*self.grid.shape, *table.shape[1:]), self.axis, 0)


def _stiffness_and_loads(
    scene: Scene, tables: ReducedTables, static: range
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the stiffness (n, m, m) and the loads (n, m, n_loads) of the flexible coordinates, and the coordinate that
    each load is an inertia force of alone, shape (n_loads,); -1 of others."""
    r, values = tables.n_coordinates, scene.nominal
    stiffness = weighted(tables.stiffness, tables.stiffness_weights, values)
    mass, inertia = (weighted(table, tables.mass_weights, values) for table in (tables.mass, tables.inertia))
    terms = evaluate_weights(tables.load_weights, values)[:, None] * tables.load
    columns = []
    for effect in dict.fromkeys(tables.load_effects):
        whole = terms[:, [name == effect for name in tables.load_effects]].sum(axis=1)
        columns += _unless_nothing(whole[:, r:], np.abs(whole).max())
    moving = np.sqrt(np.abs(mass[:, :r, :r]).max())
    kin, swing = [-1] * len(columns), [np.sqrt(SWING * (axis.upper - axis.lower)) for axis in tables.samples]
    for k in range(r):
        columns += _unless_nothing(mass[:, k, r:], moving)
        kin += [k] * (len(columns) - len(kin))
        for j in range(k + 1):
            columns += [swing[k] * swing[j] * part for part in _unless_nothing(inertia[:, k, j], moving)]
            kin += [k if j == k else -1] * (len(columns) - len(kin))
    columns += [stiffness[:, :, j] for j in static]
    kin += [-1] * len(static)
    shape = (*stiffness.shape[:2], len(columns))
    return with_units(stiffness), np.stack(columns, axis=2) if columns else np.zeros(shape), np.array(kin)


def _unless_nothing(load: np.ndarray, size: float) -> Iterator[np.ndarray]:
    """Yield a load (n, m) that is not small beside a size."""
    if np.abs(load).max(initial=0.0) > NOTHING * size:
        yield load


def _largest(output: StressOutput, body: Body, moves: np.ndarray, scene: Scene) -> np.ndarray:
    """Return the largest size of an output under each load, shape (n_loads,), for coordinates (n, n_dofs, n_loads).

    Of what is no linear form of the stresses it is a bound of differences: von Mises' stress of these, for one.
    """
    sizes = [np.zeros(0)]
    for forces in _forces(output.law, output.points, body, moves, scene):
        sizes.append(np.maximum(*[np.abs(output.value(sign * forces, scene.nominal)) for sign in (1.0, -1.0)]))
    return np.concatenate(sizes).reshape(len(moves), -1).max(axis=0, initial=0.0)


def _reference(output: StressOutput, body: Body, moves: np.ndarray, scene: Scene) -> np.ndarray:
    """Return the largest size of what has the output's unit anywhere in the body, under each load, shape (n_loads,)."""
    of_body = body.stresses(scene)
    law, points = of_body.law, of_body.everywhere()
    alike = [key for key, unit in of_body.units.items() if unit == output.entry.unit_of_quantity]
    some, sizes = moves[:: max(1, len(moves) // REFERENCES)], [np.zeros(0)]
    for forces in _forces(law, points, body, some, scene):
        values: Mapping[str, np.ndarray] = law.values(alike, points, forces, scene.nominal)
        sizes.append(np.max([np.abs(one).max(axis=0) for one in values.values()], axis=0))
    return np.concatenate(sizes).reshape(len(some), -1).max(axis=0, initial=0.0)


def _forces(
    law: SolidLaw | BeamLaw, points: Strains, body: Body, moves: np.ndarray, scene: Scene
) -> Iterator[np.ndarray]:
    """Yield what a law makes of linear strains of points, shape (n_points, n_forces, n), of some columns after the
    other."""
    columns = np.moveaxis(moves, 1, 0).reshape(moves.shape[1], -1)
    step = max(1, AT_ONCE // max(1, points.width))
    for first in range(0, columns.shape[1], step):
        strains = points.of_displacements(body.displacements(columns[:, first : first + step]))
        yield law.forces(points, strains, scene.nominal)


def interpolation_errors(
    before: ContinuousBasis, now: ContinuousBasis, theta: np.ndarray, values: Mapping[str, float]
) -> np.ndarray:
    """Return the largest relative difference, shape (n_new,), between the tables of the round before and what was found
    since at new samples, shape (n_new, n_theta).

    A new sample is turned to the interpolated basis first, within the groups of the round before: more samples resolve
    more, so that groups can only become smaller. Terms are weighted by nominal parameters. Given coordinates, whose
    units are any, are left out.
    """
    old = before.tables.moving()
    rows = now.tables.samples.nearest(theta)
    at = old.over("spline", theta)
    overlaps = np.swapaxes(now.projection[rows], 1, 2) @ at(before.projection)
    fresh = now.tables.at(rows).turned(by_groups(overlaps, before.groups)[0]).moving()
    errors, r = np.zeros(len(theta)), old.n_coordinates
    for name, weights in (("mass", old.mass_weights), ("inertia", old.mass_weights), ("load", old.load_weights)):
        known = 1.0 if name == "mass" else weighted(getattr(old, name), weights, values)
        scale = max(float(np.max(np.abs(known), initial=0.0)), 1e-300)
        missed = at(getattr(old, name)) - getattr(fresh, name)
        if name == "mass":
            missed[:, :, :r, :r] = 0.0  # the rigid inertia comes from the kinematics and is not interpolated
        difference = np.abs(weighted(missed, weights, values)).reshape(len(theta), -1)
        errors = np.maximum(errors, difference.max(axis=1, initial=0.0) / scale)
    stiffness, guess = (
        with_units(weighted(table, old.stiffness_weights, values)) for table in (fresh.stiffness, at(old.stiffness))
    )
    diagonal = np.sqrt(np.einsum("nii->ni", np.abs(stiffness)))
    relative = np.abs(stiffness - guess) / (diagonal[:, :, None] * diagonal[:, None, :])
    return np.maximum(errors, relative.max(axis=(1, 2), initial=0.0))
