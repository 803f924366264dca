"""The reduced-order model: what the offline build leaves for all simulations.

Points of the parameter space at which a basis takes further modes.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import h5py
import numpy as np

from pgmp_petsc.bodies.affine import Monomial
from pgmp_petsc.bodies.component import Component
from pgmp_petsc.mechanism.continuation import PoseBranch
from pgmp_petsc.mesh.line_mesh import LineMesh
from pgmp_petsc.reduction.branch_files import put_branch, take_branch
from pgmp_petsc.reduction.cell_products import SecondOrderTables
from pgmp_petsc.reduction.interpolation import Interpolant, interpolant
from pgmp_petsc.reduction.missed_answers import MissedAnswers
from pgmp_petsc.reduction.mode_changes import ModeChanges, StiffnessChanges
from pgmp_petsc.reduction.sample_grid import SampleGrid, Samples
from pgmp_petsc.reduction.shape_files import put_shape, take_shape
from pgmp_petsc.reduction.tables import ReducedTables, fine_grid
from pgmp_petsc.runtime.errors import InputError
from pgmp_petsc.runtime.files import BUILD_AGAIN, RunRecord, open_file, put, shapes_of, take, write_file
from pgmp_petsc.runtime.seal import identity
from pgmp_petsc.scene import Scene

if TYPE_CHECKING:
    from pgmp_petsc.reduction.length_family import LengthFamily


@dataclass(frozen=True)
class ParameterPoints:
    """The points of a greedy choice.

    Attributes
    ----------
    values
        Values of the parameters, shape (n_points,) each.
    missed
        Largest share of the energy norm that the basis misses at any candidate: before, and with each further point.
    n_vectors
        Number of vectors that the basis takes from them.
    """

    values: dict[str, np.ndarray]
    missed: np.ndarray
    n_vectors: int

    @property
    def points(self) -> list[dict[str, float]]:
        """The points one by one."""
        n_points = len(self.missed) - 1
        return [{name: float(column[k]) for name, column in self.values.items()} for k in range(n_points)]

    @classmethod
    def none(cls) -> ParameterPoints:
        """Return no points."""
        return cls({}, np.ones(1), 0)


NODE_UNITS = "m of the translations, 1 of the rotations, per unit of the modal coordinate (kg^-1/2)"
CURVATURE_UNITS = "m of the translations, 1 of the rotations, per unit of two modal coordinates (kg^-1)"


@dataclass(frozen=True)
class ReducedOrderModel:
    """Reduced tables, the rigid motion, and what is needed to come back to the nodes.

    Attributes
    ----------
    tables
        Reduced matrices and loads at the samples.
    branch
        Poses of the rigid mechanism over its range.
    rigid_inertia
        That of the rigid motion on the fine grid, as from `tables.rigid_inertia`.
    projection
        Flexible modes in body frames at the samples, shape (n, n_dofs, n_modes); empty along the second axis where
        only the tables were read.
    frequencies_hz
        Full-order frequencies at the nominal parameters, shape (n_sampled, n_modes).
    cosines
        Cosine of the largest angle of any group of modes to the sample before, shape (n_sampled,).
    meshes
        The mesh of every body, or what it is condensed to.
    n_redundant
        Number of redundant constraints that were dropped.
    record
        Scene and circumstances of the build.
    curvature
        chi of the quadratic manifold in body frames, shape (n, n_dofs, n_modes (n_modes + 1) / 2): pairs i >= j in the
        order of ``np.tril_indices``, each once (see `second_order`); None where the scene does not ask for it.
    points
        Parameter points whose modes the basis takes up.
    indefinite
        Where interpolated mass or stiffness is indefinite between samples; empty where it is nowhere.
    stiffness_changes
        How loads change the stiffness of the modes; None with continuum bodies.
    missed
        What the basis misses of the forces in bodies with stress outputs away from the nominal parameters; None where
        no parameter changes them, or lengths are parameters.
    family
        Models at other lengths, where parameters are lengths or places; the model itself is that at the nominal ones.
    """

    tables: ReducedTables
    branch: PoseBranch
    rigid_inertia: np.ndarray
    projection: np.ndarray
    frequencies_hz: np.ndarray
    cosines: np.ndarray
    meshes: Mapping[str, LineMesh | Component]
    n_redundant: int
    record: RunRecord = field(repr=False)
    curvature: np.ndarray | None = None
    points: ParameterPoints = field(default_factory=ParameterPoints.none)
    indefinite: str = ""
    stiffness_changes: StiffnessChanges | None = None
    missed: MissedAnswers | None = None
    family: LengthFamily | None = field(default=None, repr=False)
    _displacements: dict[str, Interpolant] = field(default_factory=dict, init=False, repr=False, compare=False)

    @cached_property
    def identity(self) -> str:
        """Checksum of all that runs of the model depend on besides its scene."""
        if self.family is not None:
            return identity(*(member.identity for member in self.family.members))
        missed = () if self.missed is None else (self.missed,)
        return identity(self.tables, self.projection, self.meshes, self.curvature, *missed)

    @property
    def n_parameter(self) -> int:
        """Number of vectors from other parameter values."""
        return self.points.n_vectors

    def displacements(self, scheme: str, dofs: np.ndarray) -> Interpolant:
        """Return displacements and rotations of some unknowns in body frames, values of shape (n_factors, dofs.size).

        Factors are the flexible coordinates and, where the model is curved, their `pair_products`. All unknowns are
        interpolated at once, and kept: outputs, fields and estimates of errors take each a part of them.
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

        Raises
        ------
        InputError
            If the mechanism cannot be closed with these lengths.
        """
        return self if self.family is None else self.family.at(scene, self)

    def write(self, path: str | Path, *parts: Callable[[h5py.File], None]) -> None:
        """Write the file ROM.h5 (one process); `parts` add to it what others want to keep there.

        ``/theta`` holds the sampled configurations, the attributes of its coordinates `lower`, `upper` and `periodic`.
        For one coordinate it has the shape (n,). For several it has the shape (n, n_theta) and the last coordinate runs
        fastest; the attributes then have an entry for each coordinate, and there is one more, `shape`, the number of
        samples along each. All tables have the n configurations along their first axis.
        """
        with write_file(path, "rom") as file:
            self.record.write(file)
            self.write_into(file)
            if self.family is not None:
                from pgmp_petsc.reduction.length_files import put_family  # lengths are parameters in few scenes

                put_family(file.create_group("lengths"), self.family)
            for part in parts:
                part(file)

    def write_into(self, file: h5py.Group) -> None:
        """Write all but the record and the family into a group."""
        tables = self.tables
        file.attrs.update(n_redundant=self.n_redundant, indefinite=self.indefinite)
        _put_samples(file, tables.samples)
        group = file.create_group("tables")
        _put_terms(group, "mass", tables.mass, tables.mass_weights, "Psi^T M_i Psi, eq. (13)")
        _put_terms(group, "inertia", tables.inertia, tables.mass_weights, "(d2 rho/d theta2)^T M_i Psi")
        _put_terms(group, "stiffness", tables.stiffness, tables.stiffness_weights, "Psi^T K_i Psi, eq. (14)")
        _put_terms(group, "load", tables.load, tables.load_weights, "Psi^T f_j")
        group["load"].attrs["effects"] = list(tables.load_effects)
        if tables.second_order is not None:
            _put_second_order(group.create_group("second_order"), tables)
        about = "(d rho/d theta_k)^T M_i (d rho/d theta_l), k >= l"
        _put_terms(group, "rigid", self.rigid_inertia, tables.mass_weights, about, "theta on a fine grid")
        put_branch(file.create_group("kinematics"), self.branch)
        about = "flexible modes in body frames, (theta, unknown, mode)"
        put(file, "projection", self.projection, NODE_UNITS, about)
        if self.curvature is not None:
            about = "their second derivatives chi, (theta, unknown, pair of modes i >= j, each once)"
            put(file, "curvature", self.curvature, CURVATURE_UNITS, about)
        put(file, "frequencies_hz", self.frequencies_hz, "Hz", "full-order, nominal parameters, (theta, mode)")
        if self.stiffness_changes is not None:
            changes, group = self.stiffness_changes, file.create_group("stiffness_changes")
            about = "change of the modes' stiffness by unit loads and motions, (theta, mode, load)"
            put(group, "influence", changes.influence, "SI", about)
            put(group, "stiffness", changes.stiffness, "SI, weight taken out", "(theta, term, mode)")
        if self.missed is not None:
            _put_missed(file.create_group("missed"), self.missed)
        if self.points.values:
            points = file.create_group("parameter_points")
            about = "share of the energy missed at the worst parameters tried: at first, with each point more"
            points.attrs["n_vectors"] = self.points.n_vectors
            put(points, "missed", self.points.missed, "1", about)
            for name, column in self.points.values.items():
                put(points.require_group("values"), name, column, "SI", "value at every point")
        put(file, "cosines", self.cosines, "1", "cosine between neighbouring spaces of modes, 1 = the same space")
        meshes = file.create_group("mesh", track_order=True)
        for name, shape in self.meshes.items():
            put_shape(meshes.create_group(name), shape)

    @classmethod
    def read(cls, path: str | Path, with_projection: bool = True) -> ReducedOrderModel:
        """Read ROM.h5 (one process).

        Raises
        ------
        InputError
            If the file is missing, cut off, of another kind or version, or its tables do not fit together.
        """
        with open_file(path, "rom") as file, shapes_of(file, BUILD_AGAIN):
            found = cls.read_from(file, RunRecord.read(file), with_projection)
            bodies = tomllib.loads(found.record.scene_toml).get("bodies", {})
            missing = [name for name in bodies if name not in found.meshes]
            if missing:
                raise InputError(f"file '{path}' has no mesh/{missing[0]}, a body of its scene; build it again")
            if "lengths" not in file:
                return found
            from pgmp_petsc.reduction.length_files import take_family  # as above

            family = take_family(file["lengths"], lambda group: cls.read_from(group, found.record, with_projection))
            return replace(found, family=family)

    @classmethod
    def read_from(cls, file: h5py.Group, record: RunRecord, with_projection: bool) -> ReducedOrderModel:
        """Read what `write_into` wrote. Raises as `read`."""
        filename = file.file.filename
        samples = _samples(file)
        group = file["tables"]
        tables = ReducedTables(
            samples=samples,
            mass_weights=_weights(group["mass"]),
            stiffness_weights=_weights(group["stiffness"]),
            load_weights=_weights(group["load"]),
            load_effects=tuple(str(name) for name in group["load"].attrs["effects"]),
            mass=take(group, "mass", 4),
            inertia=take(group, "inertia", 5),
            stiffness=take(group, "stiffness", 4),
            load=take(group, "load", 3),
            second_order=_second_order(group["second_order"]) if "second_order" in group else None,
            changes=_changes(group["second_order"]) if "second_order" in group else None,
        )
        rigid, branch = take(group, "rigid", 3), take_branch(file["kinematics"])
        _check_tables(tables, rigid, filename)
        kinematics = {"poses": branch.poses, "rates": branch.rates, "curvatures": branch.curvatures}
        _check_finite({f"kinematics/{name}": values for name, values in kinematics.items()}, filename)
        meshes = {name: take_shape(body) for name, body in file["mesh"].items()}
        n_modes, curvature = tables.n_modes, None
        projection = take(file, "projection", 3) if with_projection else np.empty((samples.n, 0, n_modes))
        if tables.second_order is not None:
            n_pairs = n_modes * (n_modes + 1) // 2
            curvature = take(file, "curvature", 3) if with_projection else np.empty((samples.n, 0, n_pairs))
            if curvature.shape != (*projection.shape[:2], n_pairs):
                raise InputError(f"file '{filename}': curvature has shape {curvature.shape}; build it again")
            _check_finite({"curvature": curvature}, filename)
        _check_finite({"projection": projection}, filename)
        return cls(
            tables=tables,
            branch=branch,
            rigid_inertia=rigid,
            projection=projection,
            frequencies_hz=take(file, "frequencies_hz", 2),
            cosines=take(file, "cosines", 1),
            meshes=meshes,
            n_redundant=int(file.attrs["n_redundant"]),
            record=record,
            curvature=curvature,
            points=_points(file),
            indefinite=str(file.attrs.get("indefinite", "")),
            stiffness_changes=_stiffness_changes(file, samples.n),
            missed=_missed(file["missed"], tables) if with_projection and "missed" in file else None,
        )


def _put_samples(file, samples: SampleGrid) -> None:
    about = "sampled configurations"
    if samples.n_coordinates == 1:
        (axis,) = samples
        theta = put(file, "theta", axis.theta, "rad", about)
        theta.attrs.update(lower=axis.lower, upper=axis.upper, periodic=axis.periodic)
        return
    theta = put(file, "theta", samples.theta, "rad", f"{about}, (configuration, coordinate), last coordinate fastest")
    theta.attrs.update(
        lower=[axis.lower for axis in samples],
        upper=[axis.upper for axis in samples],
        periodic=samples.periodic,
        shape=samples.shape,
    )


def _samples(file) -> SampleGrid:
    about, several = file["theta"].attrs, file["theta"].ndim == 2
    theta = take(file, "theta", 2 if several else 1)
    shape = tuple(about["shape"]) if several else theta.shape
    places = theta.reshape(*shape, len(shape))
    lines = [np.take(places, k, -1)[(0,) * k + (slice(None),) + (0,) * (len(shape) - k - 1)] for k in range(len(shape))]
    ranges = (np.atleast_1d(about[name]) for name in ("lower", "upper", "periodic"))
    axes = (Samples(line, float(low), float(high), bool(turns)) for line, low, high, turns in zip(lines, *ranges))
    return SampleGrid(tuple(axes))


def _points(file) -> ParameterPoints:
    if "parameter_points" not in file:
        return ParameterPoints.none()
    group = file["parameter_points"]
    values = {name: take(group["values"], name, 1) for name in group["values"]}
    return ParameterPoints(values, take(group, "missed", 1), int(group.attrs["n_vectors"]))


def _stiffness_changes(file, n: int) -> StiffnessChanges | None:
    if "stiffness_changes" not in file:
        return None
    group = file["stiffness_changes"]
    changes = StiffnessChanges(take(group, "influence", 3), take(group, "stiffness", 3))
    if len(changes.influence) != n or len(changes.stiffness) != n:
        raise InputError(f"file '{file.file.filename}': stiffness_changes are not those of {n} samples; build it again")
    return changes


def _check_tables(tables: ReducedTables, rigid: np.ndarray, filename: str) -> None:
    """Raise `InputError` unless the tables fit together and are finite."""
    n, n_eta, n_delta, r = tables.samples.n, tables.mass.shape[-1], tables.n_modes, tables.n_coordinates
    n_mass, n_stiffness, n_load = map(len, (tables.mass_weights, tables.stiffness_weights, tables.load_weights))
    found = {name: getattr(tables, name) for name in ("mass", "inertia", "stiffness", "load")} | {"rigid": rigid}
    wanted = {
        "mass": (n, n_mass, n_eta, n_eta),
        "inertia": (n, n_mass, n_eta - n_delta, n_eta - n_delta, n_delta),
        "stiffness": (n, n_stiffness, n_delta, n_delta),
        "load": (n, n_load, n_eta),
        "rigid": (fine_grid(tables.samples).n, n_mass, r * (r + 1) // 2),
    }
    if tables.second_order is not None:
        found |= {name: getattr(tables.second_order, name) for name in ("cubic", "curved_load", "curved_inertia")}
        found |= {name: getattr(tables.changes, name) for name in ("gyroscopic", "spread")}
        wanted |= {
            "cubic": (n, n_stiffness, n_delta, n_delta, n_delta),
            "curved_load": (n, n_load, n_delta, n_delta),
            "curved_inertia": (n, n_mass, r * (r + 1) // 2, n_delta, n_delta),
            "gyroscopic": (n, n_mass, r, n_delta, n_delta),
            "spread": (n, n_mass, r * (r + 1) // 2, n_delta, n_delta),
        }
    for name, shape in wanted.items():
        if found[name].shape != shape or len(tables.load_effects) != n_load:
            raise InputError(
                f"file '{filename}': table {name} has shape {found[name].shape}, not {shape}; {BUILD_AGAIN}"
            )
    _check_finite(found, filename)


def _check_finite(arrays: Mapping[str, np.ndarray], filename: str) -> None:
    for name, values in arrays.items():
        if not np.isfinite(values).all():
            raise InputError(f"file '{filename}': {name} holds numbers that are not finite; {BUILD_AGAIN}")


def _put_second_order(group, tables: ReducedTables) -> None:
    curved = tables.second_order
    about = "third derivative of the strain energy along the curved modes"
    _put_terms(group, "cubic", curved.cubic, tables.stiffness_weights, about)
    _put_terms(group, "curved_load", curved.curved_load, tables.load_weights, "f_j.chi")
    _put_terms(
        group,
        "curved_inertia",
        curved.curved_inertia,
        tables.mass_weights,
        "(d2 rho/d theta_k d theta_l)^T M_i chi, k >= l",
    )
    _put_terms(group, "gyroscopic", tables.changes.gyroscopic, tables.mass_weights, "skew part of D_k^T M_i Psi")
    _put_terms(
        group, "spread", tables.changes.spread, tables.mass_weights, "D_k^T M_i D_l, k >= l, D_k = d(R Psi)/d theta_k"
    )


def _second_order(group) -> SecondOrderTables:
    return SecondOrderTables(take(group, "cubic", 5), take(group, "curved_load", 4), take(group, "curved_inertia", 5))


def _put_missed(group, missed: MissedAnswers) -> None:
    _put_terms(group, "forces", missed.forces, missed.weights, "[d rho/d theta, Psi]^T L_i, L the loads answered")
    put(group, "answers", missed.answers, "SI, weight taken out", "K^-1 [L_i, K_i Psi], (theta, vector, unknown)")
    put(group, "unknowns", missed.dofs, "1", "numbers of the unknowns among those of the projection")


def _missed(group, tables: ReducedTables) -> MissedAnswers:
    forces, answers = take(group, "forces", 4), take(group, "answers", 3)
    found = MissedAnswers(_weights(group["forces"]), take(group, "unknowns", 1), forces, answers)
    n, m, (_, n_w, q, _) = tables.samples.n, tables.n_modes, forces.shape
    shape = (n, n_w * q + tables.stiffness.shape[1] * m, found.dofs.size)
    if found.forces.shape != (n, len(found.weights), q, q) or q < m or found.answers.shape != shape:
        raise InputError(f"file '{group.file.filename}': the tables of missed answers do not fit; build it again")
    _check_finite({"missed/forces": found.forces, "missed/answers": found.answers}, group.file.filename)
    return found


def _changes(group) -> ModeChanges:
    return ModeChanges(take(group, "gyroscopic", 5), take(group, "spread", 5))


def _put_terms(
    group, name: str, data: np.ndarray, weights: tuple[Monomial, ...], description: str, places: str = "theta"
) -> None:
    dataset = put(group, name, data, "SI, weight taken out", f"{description}, ({places}, term, ...)")
    dataset.attrs["weights"] = [str(weight) for weight in weights]


def _weights(dataset) -> tuple[Monomial, ...]:
    return tuple(Monomial.parse(str(text)) for text in dataset.attrs["weights"])
