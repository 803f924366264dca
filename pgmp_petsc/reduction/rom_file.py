"""The file of a reduced-order model, declared: what `rom` writes and reads, an array a line.

Records of the model's parts, each with `of`, which makes it of a part, and a method that gives the part back. Tables
have the n configurations along their first axis, for several coordinates with the last one fastest; ``/lengths`` has
such a model for each point of a grid of lengths.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from pgmp_petsc.bodies.affine import Monomial
from pgmp_petsc.bodies.component import Component, LargeDeformation
from pgmp_petsc.bodies.floating import FloatingBody, Recovery
from pgmp_petsc.declare.records import Record, Result, array, attribute, run_record
from pgmp_petsc.files.hdf5 import RunRecord
from pgmp_petsc.mechanism.continuation import PoseBranch
from pgmp_petsc.mesh.meshes import LineMesh, SolidMesh
from pgmp_petsc.reduction.joint_gaps import JointGaps
from pgmp_petsc.reduction.missed_answers import MissedAnswers
from pgmp_petsc.reduction.sample_grid import EACH, LengthGrid, ParameterPoints
from pgmp_petsc.reduction.tables import (
    CURVATURE_UNITS,
    NODE_UNITS,
    WEIGHT_FREE,
    WEIGHTS,
    ReducedTables,
    StiffnessChanges,
    Weights,
    fine_grid,
    weights_of,
)

AMPLITUDES = "amplitudes in the floating frame"
UNKNOWNS = "frames' displacements and rotations, then internal coordinates"
Terms = dict[Monomial, np.ndarray]


def _own(*sizes: str, about: str, **how: Any) -> Any:
    """Declare a table of a body, a matrix for each weight, and its weights."""
    return array(*sizes, unit=WEIGHT_FREE, about=about, **how)


def _stacked(terms: Mapping[Monomial, np.ndarray], *shape: int) -> tuple[np.ndarray, Weights]:
    return np.array(list(terms.values())).reshape(len(terms), *shape), tuple(terms)


def _terms(table: np.ndarray, weights: Weights) -> Terms:
    return dict(zip(weights, table))


@dataclass(frozen=True)
class MeshFile(Record):
    """A mesh of cells."""

    kind: str = attribute("@kind", about="meshio's name of the cells")
    nodes: np.ndarray = array("node", "dimension", unit="m", about="coordinates in the body's frame")
    cells: np.ndarray = array("cell", "corner", about="nodes of the cells")
    group_names: tuple[str, ...] = attribute("groups@names", "group", about="names of the groups of faces")
    groups: dict[str, np.ndarray] = array("...", about="nodes of the faces", ordered=True)
    region_names: tuple[str, ...] = attribute("regions@names", "region", about="names of the regions")
    regions: dict[str, np.ndarray] = array("...", about="numbers of the cells", ordered=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.cells.size and not 0 <= self.cells.min() <= self.cells.max() < len(self.nodes):
            raise ValueError("cells have nodes beyond those of the mesh")
        if any(one.ndim != 2 for one in self.groups.values()) or any(one.ndim != 1 for one in self.regions.values()):
            raise ValueError("faces of groups have two axes, cells of regions one")

    @classmethod
    def of_mesh(cls, mesh: SolidMesh, **more: Any) -> Self:
        """Return a mesh as a file has it, with what else there is."""
        numbered = ({f"of_{k}": part for k, part in enumerate(one.values())} for one in (mesh.groups, mesh.regions))
        groups, regions = numbered
        names = tuple(mesh.groups), tuple(mesh.regions)
        return cls(mesh.kind, mesh.nodes, mesh.cells, names[0], groups, names[1], regions, **more)

    @property
    def mesh(self) -> SolidMesh:
        """The mesh."""
        groups = {name: self.groups[f"of_{k}"] for k, name in enumerate(self.group_names)}
        regions = {name: self.regions[f"of_{k}"] for k, name in enumerate(self.region_names)}
        return SolidMesh(self.kind, self.nodes, self.cells, groups=groups, regions=regions)


@dataclass(frozen=True)
class CellsFile(MeshFile):
    """The mesh of a body of cells, and its nodes' displacements per unit of the amplitudes."""

    answered: bool = attribute("@answered", about="whether the shapes answer the body's own inertia forces")
    shapes: np.ndarray = array(
        "displacement of a node", "amplitude", unit="m", about=f"displacements per unit of {AMPLITUDES}"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.shapes) != self.nodes.size:
            raise ValueError(f"recovery has shapes {self.shapes.shape}, not of {self.nodes.size} rows")

    @classmethod
    def of(cls, recovery: Recovery) -> Self:
        """Return it as a file has it."""
        return cls.of_mesh(recovery.carrier, answered=recovery.answered, shapes=np.ascontiguousarray(recovery.shapes))

    @property
    def recovery(self) -> Recovery:
        """Its origin."""
        return Recovery(self.mesh, self.shapes, self.answered)


@dataclass(frozen=True)
class RecoveryFile(CellsFile):
    """The mesh of a condensed body, and its nodes' displacements per unit of the body's unknowns."""

    shapes: np.ndarray = array(
        "displacement of a node", "own unknown", unit="m, 1", about=f"displacements per unit of {UNKNOWNS}"
    )
    curved: np.ndarray | None = array(
        "pair of unknowns", "own unknown", unit="SI", absent=None,
        about=f"what stands for strains of second order of pairs i >= j of the unknowns: {UNKNOWNS}",
    )  # fmt: skip

    def __post_init__(self) -> None:
        super().__post_init__()
        n = self.shapes.shape[1]
        if self.curved is not None and len(self.curved) != n * (n + 1) // 2:
            raise ValueError(f"recovery/curved has shape {self.curved.shape}, not of {n * (n + 1) // 2} rows")

    @classmethod
    def of(cls, recovery: Recovery) -> Self:
        return replace(super().of(recovery), curved=recovery.curved)

    @property
    def recovery(self) -> Recovery:
        return replace(super().recovery, curved=self.curved)


@dataclass(frozen=True)
class FloatingFile(Record):
    """A body in a floating frame, besides its frames."""

    shapes: np.ndarray = array(
        "frame", "component", "amplitude", unit="m, 1", about=f"displacements and rotations of the frames: {AMPLITUDES}"
    )
    bent: np.ndarray = array(
        "frame", "dimension", "amplitude", "amplitude", unit="m",
        about=f"second derivatives of the frames' displacements: {AMPLITUDES}",
    )  # fmt: skip
    stiffness: np.ndarray = _own("term of stiffness in the frame", "amplitude", "amplitude", about=AMPLITUDES)
    stiffness_weights: Weights = weights_of("stiffness", "term of stiffness in the frame")
    moments: np.ndarray = _own(
        "term of moments", "field", "field", about="1, coordinates, then the shapes' first components, second ones ..."
    )
    moments_weights: Weights = weights_of("moments", "term of moments")
    curved: np.ndarray = _own(
        "term of curved", "dimension", "dimension", "amplitude", "amplitude",
        about=f"coordinates, components of second order: {AMPLITUDES}",
    )  # fmt: skip
    curved_weights: Weights = weights_of("curved", "term of curved")

    @classmethod
    def of(cls, floating: FloatingBody, **more: np.ndarray) -> Self:
        """Return it as a file has it."""
        d, n = floating.centres.shape[1], floating.n
        m = 1 + d + d * n
        return cls(
            np.ascontiguousarray(floating.shapes), np.ascontiguousarray(floating.bent),
            *_stacked(floating.stiffness, n, n), *_stacked(floating.moments, m, m),
            *_stacked(floating.curved, d, d, n, n), **more,
        )  # fmt: skip

    def body(
        self, frames: dict[str, int], centres: np.ndarray, recovery: Recovery | None, parts: np.ndarray | None = None
    ) -> FloatingBody:
        """Return the body with its frames and what brings it back to its mesh."""
        return FloatingBody(
            frames=frames,
            centres=centres,
            shapes=self.shapes,
            moments=_terms(self.moments, self.moments_weights),
            stiffness=_terms(self.stiffness, self.stiffness_weights),
            bent=self.bent,
            curved=_terms(self.curved, self.curved_weights),
            recovery=recovery,
            parts=parts,
        )


@dataclass(frozen=True)
class FloatingComponentFile(FloatingFile):
    """A condensed body in a floating frame, besides its frames."""

    parts: np.ndarray = array(
        "own unknown", "own unknown", unit="m, 1",
        about=f"motion of the frame, then {AMPLITUDES}, of a unit of each unknown: {UNKNOWNS}",
    )  # fmt: skip

    def floating(self, component: Component) -> FloatingBody:
        """Return the floating body of a component."""
        kept = component.recovery
        if kept is not None:
            kept = replace(kept, shapes=kept.shapes @ np.linalg.inv(self.parts)[:, -self.shapes.shape[2] :])
        return self.body(component.frames, component.centres, kept, self.parts)


@dataclass(frozen=True)
class LargeFile(Record):
    """Terms of a condensed body of second order in its unknowns; in checkpoints of builds alone."""

    slenderness: float = attribute("@slenderness")
    third: np.ndarray = array("term of third", "own unknown", "own unknown", "own unknown")
    third_weights: Weights = attribute("third@weights", "term of third", code=WEIGHTS)
    stretching: np.ndarray = array("term of stretching", "own unknown", "own unknown")
    stretching_weights: Weights = attribute("stretching@weights", "term of stretching", code=WEIGHTS)


@dataclass(frozen=True)
class ComponentFile(Record):
    """A condensed body; what has no meaning here is in checkpoints of builds alone."""

    centres: np.ndarray = array("frame", "dimension", unit="m", about="of the frames, in the body's frame")
    mass: np.ndarray = _own("term of mass", "own unknown", "own unknown", about=f"mass of {UNKNOWNS}")
    mass_weights: Weights = weights_of("mass", "term of mass")
    stiffness: np.ndarray = _own("term of stiffness", "own unknown", "own unknown", about=f"stiffness of {UNKNOWNS}")
    stiffness_weights: Weights = weights_of("stiffness", "term of stiffness")
    fields: np.ndarray = array(
        "own unknown", "linear field", unit="m, 1", about=f"unknowns of the linear displacement fields: {UNKNOWNS}"
    )
    probes: np.ndarray = array("own unknown", "probe", unit="SI", about=f"what tells modes apart: {UNKNOWNS}")
    n_mesh_dofs: int = attribute("@n_mesh_dofs", about="unknowns of the mesh")
    error: float = attribute("@error", about="estimated relative error of what the interface answers")
    centre_of_mass: np.ndarray | None = array("dimension", unit="m", about="of a rigid body, in its frame", absent=None)
    recovery: RecoveryFile | None = array(absent=None)
    floating: FloatingComponentFile | None = array(absent=None)
    moments: np.ndarray | None = array(
        "term of moments", "dimension", "dimension", "own unknown", "own unknown", absent=None
    )
    moments_weights: Weights | None = attribute("moments@weights", "term of moments", code=WEIGHTS, absent=None)
    foreshortening: np.ndarray | None = array("elastic mode", "elastic mode", "elastic mode", absent=None)
    large: LargeFile | None = array(absent=None)

    @classmethod
    def of(cls, component: Component) -> Self:
        """Return a component as files of models have it."""
        n, floating, recovery = component.n, component.floating, component.recovery
        return cls(
            component.centres, *_stacked(component.mass, n, n), *_stacked(component.stiffness, n, n), component.fields,
            component.probes, component.n_mesh_dofs, component.error, component.centre_of_mass,
            None if recovery is None else RecoveryFile.of(recovery),
            None if floating is None else FloatingComponentFile.of(floating, parts=floating.parts),
        )  # fmt: skip

    @classmethod
    def unfinished(cls, component: Component) -> Self:
        """Return a component as checkpoints have it: with what is of second order, not yet in a floating frame."""
        d, n, large = component.centres.shape[1], component.n, component.large
        moments, weights = _stacked(component.moments, d, d, n, n)
        if large is not None:
            third, stretching = _stacked(large.third, n, n, n), _stacked(large.stretching, n, n)
            large = LargeFile(large.slenderness, *third, *stretching)
        return replace(
            cls.of(replace(component, floating=None)), moments=moments, moments_weights=weights,
            foreshortening=component.foreshortening, large=large,
        )  # fmt: skip

    def component(self, frames: dict[str, int]) -> Component:
        """Return the component with some frames."""
        large = self.large
        if large is not None:
            third = _terms(large.third, large.third_weights)
            large = LargeDeformation(third, _terms(large.stretching, large.stretching_weights), large.slenderness)
        found = Component(
            frames=frames,
            centres=self.centres,
            mass=_terms(self.mass, self.mass_weights),
            stiffness=_terms(self.stiffness, self.stiffness_weights),
            moments={} if self.moments is None else _terms(self.moments, self.moments_weights),
            fields=self.fields,
            probes=self.probes,
            n_mesh_dofs=self.n_mesh_dofs,
            error=self.error,
            centre_of_mass=self.centre_of_mass,
            recovery=None if self.recovery is None else self.recovery.recovery,
            large=large,
            foreshortening=self.foreshortening,
        )
        if self.moments is None and not found.rigid and self.floating is None:
            raise ValueError("'floating' of a flexible body is missing")
        return found if self.floating is None else replace(found, floating=self.floating.floating(found))


@dataclass(frozen=True)
class LineFile(Record):
    """A mesh of lines."""

    nodes: np.ndarray = array("node", "dimension", unit="m", about="of a mesh of lines, in the body's frame")
    cells: np.ndarray = array("line", 2, about="nodes of the elements")


@dataclass(frozen=True)
class BodyFile(Record):
    """Source of a body: its line mesh, or the condensed body."""

    points: tuple[str, ...] = attribute("@point_names", "point", about="names of points, or frames")
    numbers: np.ndarray = attribute("@point_nodes", "point", about="their nodes, or numbers")
    line: LineFile | None = array(at="", absent=None)
    component: ComponentFile | None = array(at="", absent=None)

    def __post_init__(self) -> None:
        super().__post_init__()
        if all(source is None for source in self._sources):
            raise ValueError("'nodes' or 'centres' of a body is missing")

    @property
    def _sources(self) -> tuple[Record | None, ...]:
        """Sources of a body, of which it has one; files of components know another."""
        return self.line, self.component

    @property
    def named(self) -> dict[str, int]:
        """Its points by name."""
        return {name: int(number) for name, number in zip(self.points, self.numbers)}

    @classmethod
    def of(cls, shape: LineMesh | Component) -> Self:
        """Return a body's mesh, or what it is condensed to, as files of models have it."""
        if isinstance(shape, Component):
            return cls._named(shape.frames, component=ComponentFile.of(shape))
        return cls._named(shape.points, line=LineFile(shape.nodes, shape.cells))

    @classmethod
    def unfinished(cls, component: Component) -> Self:
        """Return a component as checkpoints have it."""
        return cls._named(component.frames, component=ComponentFile.unfinished(component))

    @classmethod
    def _named(cls, points: dict[str, int], **what: Any) -> Self:
        return cls(tuple(points), np.array(list(points.values())), **what)

    @property
    def shape(self) -> LineMesh | Component:
        """The mesh, or the component."""
        if self.component is not None:
            return self.component.component(self.named)
        return LineMesh(self.line.nodes, self.line.cells, self.named)


@dataclass(frozen=True, kw_only=True)
class Tabulated(Record):
    """Entries that a reduced model and its file share."""

    n_redundant: int = attribute("@n_redundant", about="redundant constraints that were dropped")
    indefinite: str = attribute(
        "@indefinite", absent="", about="where interpolated mass or stiffness is indefinite, empty where nowhere"
    )
    tables: ReducedTables = array(at="")  # reduced matrices and loads at the samples
    #: as from `tables.rigid_inertia`
    rigid_inertia: np.ndarray = array(
        "fine configuration", "mass term", "pair of coordinates", at="tables/rigid", unit=WEIGHT_FREE,
        about="(d rho/d theta_k)^T M_i (d rho/d theta_l), k >= l, theta on a fine grid",
    )  # fmt: skip
    branch: PoseBranch = array(at="kinematics")  # poses of the rigid mechanism over its range
    projection: np.ndarray = array(EACH, "unknown", "mode", unit=NODE_UNITS, about="flexible modes in body frames")
    #: chi of the quadratic manifold (see `second_order`); None where the scene does not ask for it
    curvature: np.ndarray | None = array(
        EACH, "unknown", "pair of modes", unit=CURVATURE_UNITS, absent=None,
        about="their second derivatives chi, pairs of modes i >= j, each once",
    )  # fmt: skip
    frequencies_hz: np.ndarray = array(
        "sample", "frequency", unit="Hz", about="full-order, nominal parameters", gaps=True
    )
    #: how loads change the stiffness of the modes; None with continuum bodies
    stiffness_changes: StiffnessChanges | None = array(absent=None)
    #: what the basis misses of the forces in bodies with stress outputs away from the nominal parameters; None where no
    #: parameter changes them
    missed: MissedAnswers | None = array(absent=None)
    #: what forces in joints are made of, where outputs of the scene are such; None where none is
    gaps: JointGaps | None = array(at="joint_gaps", absent=None)
    #: parameter points whose modes the basis takes up
    points: ParameterPoints = array(
        at="parameter_points", absent=ParameterPoints.none(), when=lambda own: bool(own.points.values)
    )
    cosines: np.ndarray = array(
        "sample", about="cosine between neighbouring spaces of modes, 1 = the same space", gaps=True
    )


@dataclass(frozen=True, kw_only=True)
class ModelFile(Tabulated):
    """All of a reduced model but where it comes from and the models of other lengths."""

    mesh: dict[str, BodyFile] = array(ordered=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        tables, m = self.tables, self.tables.n_modes
        r, pairs = tables.n_coordinates, m * (m + 1) // 2
        shape = (fine_grid(tables.samples).n, len(tables.mass_weights), r * (r + 1) // 2)
        sizes = {"tables/rigid": (self.rigid_inertia.shape, shape)}
        if tables.second_order is not None:
            inertia = "tables/second_order/curved_inertia"
            sizes[inertia] = (tables.second_order.curved_inertia.shape[2], r * (r + 1) // 2)
            if self.curvature is None:
                raise ValueError("dataset '/curvature' is missing")
            sizes["curvature"] = (self.curvature.shape[-1], pairs)
        if self.missed is not None:
            (_, n_terms, q, _), n_stiffness = self.missed.forces.shape, len(tables.stiffness_weights)
            sizes["missed/answers"] = (self.missed.answers.shape[1], n_terms * q + n_stiffness * m)
            sizes["missed/forces"] = (q, max(q, m))
        for name, (found, wanted) in sizes.items():
            if found != wanted:
                raise ValueError(f"{name} has shape {found}; needed: {wanted}")


@dataclass(frozen=True, eq=False)
class LengthCheck(Record):
    """How far a family is from a model that was built between its points, at any angle."""

    values: np.ndarray = array("parameter", unit="m or 1", about="lengths of the model compared with")
    frequencies: float = attribute("@frequencies", about="largest difference of its frequencies, a share")
    inertia: float = attribute("@inertia", about="largest difference of its rigid inertia, a share")


@dataclass(frozen=True)
class LengthsFile(Record):
    """Models at the points of a grid of lengths."""

    grid: LengthGrid = array(at="")
    check: LengthCheck = array()
    members: dict[str, ModelFile] = array(
        at="", names=lambda _, taken: (str(k) for k in range(len(taken["grid"].points))),
        unit="", about="the model of each point, as the file's own",
    )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class RomFile(ModelFile, Result):
    """A reduced model's file."""

    kind, internal = "rom", True
    lengths: LengthsFile | None = array(absent=None)
    record: RunRecord = run_record()
