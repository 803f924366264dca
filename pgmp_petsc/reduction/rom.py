"""The reduced-order model: the result of the offline build, all that simulations need, and how far from its nominal
parameters it serves.

A build tries the values that span its scene's distributions (`spanning_values`); docs/uncertainty.md (outside what a
reduced model was built for) says how far beyond these it serves without a word, warns, and refuses. Of parameters that
no distribution and no bounds of the build's scene say anything of, 30 % around the nominal value are taken for the
span. What tables do not depend on, loads and local effects, may be anything.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from pgmp_petsc.base.errors import InputError, Remark, gathered, warning
from pgmp_petsc.bodies.component import Component
from pgmp_petsc.bodies.matrices import AffineMatrices
from pgmp_petsc.bodies.shape import at_lengths
from pgmp_petsc.declare.records import check_finite, declared
from pgmp_petsc.files.hdf5 import BUILD_AGAIN, RunRecord, open_file, shapes_of
from pgmp_petsc.files.seal import identity
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.mesh.meshes import LineMesh
from pgmp_petsc.reduction.interpolation import Interpolant, interpolant
from pgmp_petsc.reduction.rom_file import BodyFile, LengthCheck, LengthsFile, ModelFile, RomFile, Tabulated
from pgmp_petsc.reduction.sample_grid import EACH, LengthGrid
from pgmp_petsc.reduction.tables import ReducedTables, StiffnessChanges, rigid_inertia
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.parameters import Parameter, share_below, spanning_values
from pgmp_petsc.scene.units import to_own


@dataclass(frozen=True, kw_only=True)
class ReducedOrderModel(Tabulated):
    """Reduced tables, the rigid motion, and what is needed to come back to the nodes."""

    meshes: Mapping[str, LineMesh | Component]  # the mesh of every body, or what it is condensed to
    record: RunRecord = field(repr=False)  # scene and circumstances of the build
    #: of a model at other lengths those that it lies between, with their shares. What is missed is theirs: where loads
    #: depend on each other its equations are nearly singular, and polynomials of these are nothing
    between: tuple[tuple[float, ReducedOrderModel], ...] = field(default=(), repr=False)
    #: models at other lengths, where parameters are lengths, places or ratios; the model itself has the nominal ones
    family: LengthFamily | None = field(default=None, repr=False)
    _displacements: dict[str, Interpolant] = field(default_factory=dict, init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Sizes are those of files alone: a projection may have more vectors than the tables."""

    @cached_property
    def identity(self) -> str:
        """Checksum of all that runs of the model depend on besides its scene."""
        if self.family is not None:
            return identity(*(member.identity for member in self.family.members))
        more = (part for part in (self.missed, self.gaps) if part is not None)
        return identity(self.tables, self.projection, self.meshes, self.curvature, *more)

    def displacements(self, scheme: str, dofs: np.ndarray) -> Interpolant:
        """Return displacements and rotations of some unknowns in body frames, values of shape (n_factors, dofs.size).

        Factors are the flexible coordinates and, where the model is curved, the products of their pairs. All unknowns
        are interpolated at once, and kept: outputs, fields and estimates of errors take each a part of them.
        """
        if scheme not in self._displacements:
            shapes = [self.projection] if self.curvature is None else [self.projection, self.curvature]
            table = np.ascontiguousarray(np.swapaxes(np.concatenate(shapes, axis=2), 1, 2))
            self._displacements[scheme] = interpolant(self.tables.samples, table, scheme)
        whole = self._displacements[scheme]
        if np.array_equal(dofs, np.arange(self.projection.shape[1])):
            return whole
        return replace(whole, rows=np.ascontiguousarray(whole.rows[..., dofs]))

    def at_lengths(self, scene: Scene) -> ReducedOrderModel:
        """Return the model with the lengths of a scene's run; itself where none is a parameter.

        Raises `InputError` if the mechanism cannot be closed with these lengths.
        """
        return self if self.family is None else self.family.at(scene, self)

    def write(self, path: str | Path, *parts: Callable[[h5py.File], None]) -> None:
        """Write the file ROM.h5 (one process), declared in `rom_file`; `parts` add what others want to keep there."""
        lengths = None
        if self.family is not None:
            members = {str(number): member._stored(ModelFile) for number, member in enumerate(self.family.members)}
            lengths = LengthsFile(self.family.grid, self.family.check, members)
        self._stored(RomFile, lengths=lengths, record=self.record).write(path, *parts)

    def _stored(self, kind: type[ModelFile], **more: Any) -> ModelFile:
        """Return the model without record and family as a kind of file has it."""
        return kind(**_alike(self), mesh={name: BodyFile.of(shape) for name, shape in self.meshes.items()}, **more)

    @classmethod
    def read(cls, path: str | Path) -> ReducedOrderModel:
        """Read ROM.h5 (one process).

        Raises `InputError` if the file is missing, cut off, of another kind or version, or its tables do not fit
        together.
        """
        with open_file(path, "rom") as file, shapes_of(file, BUILD_AGAIN):
            found = RomFile.take(file)
            check_finite(found)
            found.record.check_bodies(found.mesh, "mesh")
            rom, lengths = cls._of(found, found.record), found.lengths
            if lengths is None:
                return rom
            members = tuple(cls._of(member, found.record) for member in lengths.members.values())
            return replace(rom, family=LengthFamily(lengths.grid, members, lengths.check))

    @classmethod
    def _of(cls, found: ModelFile, record: RunRecord) -> ReducedOrderModel:
        return cls(**_alike(found), meshes={name: body.shape for name, body in found.mesh.items()}, record=record)


@dataclass(frozen=True, eq=False)
class LengthFamily:
    """Models at the points of a grid of lengths."""

    grid: LengthGrid
    #: a model of each point, without meshes (`bodies.shape` makes them), all in continuous bases
    members: tuple[ReducedOrderModel, ...]
    check: LengthCheck  # of the family against a model of none of these points

    @property
    def checked(self) -> dict[str, float]:
        """Lengths of that model."""
        return dict(zip(self.grid.names, self.check.values.tolist()))

    def at(self, scene: Scene, nominal: ReducedOrderModel) -> ReducedOrderModel:
        """Return the model with the lengths of a scene's run (``scene.values``), of the one at nominal lengths.

        Kinematics and rigid inertia are exact, tables and shapes polynomials of the lengths. Raises `InputError` if the
        mechanism cannot be closed with these lengths.
        """
        meshes, shares = at_lengths(scene, nominal.meshes), self.grid.shares(scene.values)
        mechanism = Mechanism.from_scene(scene, meshes)
        kinematics = RigidKinematics(mechanism)
        masses = AffineMatrices(mechanism.bodies, range(mechanism.n_dofs)).mass

        def blended(*arrays: np.ndarray) -> np.ndarray:
            return sum(share * array for share, array in zip(shares, arrays))

        first, *others = (replace(member, missed=None) for member in self.members)  # what is missed: see `between`
        return replace(
            nominal,
            **first.each(EACH, blended, *others),
            branch=kinematics.branch,
            rigid_inertia=rigid_inertia(first.tables.samples, masses, kinematics),
            frequencies_hz=blended(*(member.frequencies_hz for member in self.members)),
            between=tuple(zip(shares.tolist(), self.members)),
            meshes=meshes,
        )

    def merged(self, nominal: ReducedOrderModel) -> ReducedOrderModel:
        """Return the model whose terms are affine in monomials of the lengths besides all other parameters.

        Its tables and its rigid inertia are those of any lengths; kinematics and shapes are the nominal ones.
        """
        tables, grid, parts = nominal.tables, self.grid, [member.tables for member in self.members]
        merged = replace(
            tables,
            **parts[0].each(EACH, lambda *arrays: grid.coefficients(arrays), *parts[1:]),
            **{
                name: grid.weights(getattr(tables, name))
                for name in ("mass_weights", "stiffness_weights", "load_weights")
            },
            load_effects=tuple(name for name in tables.load_effects for _ in grid.points),
        )
        rigid = grid.coefficients([member.rigid_inertia for member in self.members])
        return replace(nominal, tables=merged, rigid_inertia=rigid, stiffness_changes=self._merged_changes(tables))

    def _merged_changes(self, tables: ReducedTables) -> StiffnessChanges | None:
        """Return the influences of terms that are affine in monomials of the lengths, of whose units these are."""
        members, grid = [member.stiffness_changes for member in self.members], self.grid
        if members[0] is None:
            return None
        influence = np.swapaxes(grid.coefficients([np.swapaxes(one.influence, 1, 2) for one in members]), 1, 2)
        r, n_mass, n_each = tables.n_coordinates, len(tables.mass_weights), len(grid.points)
        n_moving = r + r * (r + 1) // 2
        rest, inertia = np.split(influence, [influence.shape[2] - n_mass * n_moving * n_each], axis=2)
        # monomials belong to the weights of terms, motions to each of these
        inertia = np.swapaxes(inertia.reshape(*inertia.shape[:2], n_mass, n_moving, n_each), 3, 4)
        influence = np.concatenate([rest, inertia.reshape(*rest.shape[:2], n_mass * n_moving * n_each)], axis=2)
        return StiffnessChanges(influence, grid.coefficients([one.stiffness for one in members]))


def _alike(model: Tabulated) -> dict[str, Any]:
    return {one.name: getattr(model, one.name) for one in declared(Tabulated)}


WIDER, FARTHEST = 1.5, 3.0  # times the span that a build tries
UNSAID = 0.3  # of the nominal value
NOTICED = 1e-4  # share of a distribution beyond what is served
ROUND_OFF = 1e-12  # of shares of distributions
CURE = "build with distributions, or bounds, that hold them (pgmp build SCENE)"


@dataclass(frozen=True)
class Served:
    """Values of a parameter that a reduced model serves."""

    #: low, high: ends of the range that is served without a warning
    low: float
    high: float
    #: least, most: ends beyond which it is refused
    least: float
    most: float
    to_own: float = 1.0  # times which values are in the units of the scene
    unit: str = ""  # of values in the units of the scene

    def shown(self, value: float) -> str:
        """Return a value as messages have it."""
        return f"{self.to_own * value:.6g}"

    def between(self, low: float, high: float) -> str:
        """Return a range as messages have it."""
        return f"[{self.shown(low)}, {self.shown(high)}] {self.unit}".rstrip()

    @property
    def range(self) -> str:
        """The range that is served, in messages."""
        return self.between(self.low, self.high)

    @property
    def limits(self) -> str:
        """The range that is not refused, in messages."""
        return self.between(self.least, self.most)

    @property
    def is_sharp(self) -> bool:
        """Whether nothing is served outside the range at all: that of a length."""
        return (self.low, self.high) == (self.least, self.most)

    def outside(self, values: np.ndarray) -> np.ndarray:
        """Return which values are not served without a warning."""
        return (values < self.low) | (values > self.high)

    def beyond(self, values: np.ndarray) -> np.ndarray:
        """Return which values are refused."""
        return (values < self.least) | (values > self.most)


def served_ranges(built: Scene, rom: ReducedOrderModel) -> dict[str, Served]:
    """Return by name the ranges of the parameters that the tables of a reduced model, built from a scene, depend on."""
    weights = (*rom.tables.mass_weights, *rom.tables.stiffness_weights)
    found = ranges_of(built, {name for weight in weights for name, _ in weight.powers})
    return found if rom.family is None else found | ranges_of_lengths(built, rom.family.grid)


def ranges_of_lengths(built: Scene, grid: LengthGrid) -> dict[str, Served]:
    """Return by name the ranges of lengths over a grid, of the scene that a model was built from."""
    return {
        name: Served(low, high, low, high, to_own(built, name), built.system.unit(built.parameters[name].unit))
        for name, low, high in zip(grid.names, grid.lower.tolist(), grid.upper.tolist())
    }


def ranges_of(built: Scene, names: Collection[str]) -> dict[str, Served]:
    """Return the ranges of some parameters that a model serves, from the scene that it was built from."""
    found = {}
    for name in sorted(names):
        parameter = built.parameters[name]
        nominal = parameter.nominal
        low, high = (nominal - UNSAID * abs(nominal), nominal + UNSAID * abs(nominal))
        if parameter.varies:
            tried = spanning_values(built, [name])[0][name]
            low, high = float(tried.min()), float(tried.max())
        ends = [nominal + factor * (end - nominal) for factor in (WIDER, FARTHEST) for end in (low, high)]
        found[name] = Served(*ends, to_own(built, name), built.system.unit(parameter.unit))
    return found


def check_served(ranges: Mapping[str, Served], scene: Scene) -> tuple[Remark, ...]:
    """Return warnings of values of a single run, and of distributions, outside what is served.

    Raises `InputError` if a value, or the greater part of a distribution, is beyond what is served.
    """
    return tuple(warning(text) for name, served in ranges.items() for text in _of_parameter(name, served, scene))


def check_samples(ranges: Mapping[str, Served], values: Mapping[str, np.ndarray], where: str) -> tuple[Remark, ...]:
    """Return `outside_of`; raises `InputError`, naming the first of them, where samples are beyond what is served."""
    for name, served in ranges.items():
        beyond = served.beyond(values.get(name, np.zeros(0)))
        if beyond.any():
            first = int(np.argmax(beyond))
            raise InputError(
                f"{where}: {int(beyond.sum())} of {beyond.size} samples are beyond what the model serves, "
                f"number {first} with {name} = {served.shown(values[name][first])}, which must be within "
                f"{served.limits}; {CURE}"
            )
    return outside_of(ranges, values, where)


@gathered
def outside_of(ranges: Mapping[str, Served], values: Mapping[str, np.ndarray], where: str) -> Iterator[Remark]:
    """Return a warning that counts samples, values of shape (n,) each, outside what is served; nothing where all are
    inside. `where` says before the message what they are."""
    known, lines = {name: served for name, served in ranges.items() if name in values}, []
    outside = {name: served.outside(values[name]) for name, served in known.items()}
    for name, which in outside.items():
        if which.any():
            lines.append(f"{int(which.sum())} in {name} ({known[name].range})")
    if not lines:
        return
    n = int(np.any(list(outside.values()), axis=0).sum())
    count = len(next(iter(outside.values())))
    yield warning(
        f"{where}: {n} of {count} samples are outside the range that the model was built for, "
        f"{', '.join(lines)}; look at their estimated errors, or {CURE}"
    )


def _of_parameter(name: str, served: Served, scene: Scene) -> Iterator[str]:
    parameter, value = scene.parameters[name], np.array(scene.values[name])
    entry = f"parameters.{name}.value"
    if served.beyond(value):
        raise InputError(
            f"{entry} = {served.shown(value)}: beyond what the model serves, {served.limits}; "
            f"{CURE}, or take pgmp simulate SCENE --full"
        )
    if served.outside(value):
        yield (
            f"{entry} = {served.shown(value)}: outside {served.range}, the range that the model "
            f"was built for; look at the estimated errors, or {CURE}"
        )
    if parameter.distribution is None:
        return
    share, beyond = (
        1.0 - _share(parameter, *ends) for ends in ((served.low, served.high), (served.least, served.most))
    )
    shown = f"{float(f'{100 * share:.2g}'):g}"  # 100 and not 1e+02
    what = f"parameters.{name}.distribution: {shown} % of it lie outside {served.range}"
    if served.is_sharp and beyond > ROUND_OFF:
        raise InputError(f"{what}, beyond which the model serves no length, place or ratio; {CURE}")
    if beyond > 0.5:
        raise InputError(
            f"{what}, the range that the model was built for, and the greater part beyond what it serves, "
            f"{served.limits}; {CURE}"
        )
    if share > NOTICED:
        yield f"{what}, the range that the model was built for; look at the estimated errors, or {CURE}"


def _share(parameter: Parameter, low: float, high: float) -> float:
    """Return the share of a distribution, truncated to its bounds, between two numbers."""
    drawn, (least, most) = parameter.distribution.frozen, parameter.bounds or (-np.inf, np.inf)
    below = share_below(drawn)  # values at the ends are between them
    return max(float(drawn.cdf(min(high, most)) - below(max(low, least))), 0.0) / float(drawn.cdf(most) - below(least))
