"""Parts of the full-order equations on one rank: elements and masses that touch its unknowns.

Every function returns a part as compiled functions take it, numbered as all unknowns are, and the rows and columns of
the entries of the matrix that its ``positions`` refer to.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from pgmp_petsc.bodies import elasticity
from pgmp_petsc.bodies.affine import Monomial
from pgmp_petsc.bodies.beam2d import PACKED_COLUMNS, PACKED_ROWS
from pgmp_petsc.bodies.body import Body, element_dofs
from pgmp_petsc.bodies.elasticity import Geometry, Lame
from pgmp_petsc.bodies.solid import Region, Solid
from pgmp_petsc.effects.effect import Effect
from pgmp_petsc.full.damping import BodyDampings
from pgmp_petsc.full.elements import N_SECTION, N_VECTORS, Beams, Masses, Solids
from pgmp_petsc.full.kernel import Elements, FullProblem, Lumps
from pgmp_petsc.full.layout import FloatingBodies, body_tables, entries_of, n_pose_of, places_of
from pgmp_petsc.full.rank_solver import Layout
from pgmp_petsc.lanes.lane_items import SampleBlocks
from pgmp_petsc.mechanism.mechanism import N_POSE, Unknowns
from pgmp_petsc.mesh.meshes import reference_element

N_PLANAR = 6  # unknowns of a beam element in the plane
Pattern = tuple[np.ndarray, np.ndarray]


class Share(NamedTuple):
    """A rank's share of a mechanism."""

    bodies: Sequence[Body]  # with unknowns numbered as all are
    rows: range  # the unknowns that the rank owns
    #: values, blocks: parameter values of the samples, each of shape (n_samples,), and how samples lie in arrays
    values: Mapping[str, np.ndarray]
    blocks: SampleBlocks
    damping: BodyDampings  # structural damping

    def blocks_of(self, kernel: str) -> Iterator[tuple[int, Any]]:
        """Yield what a kernel of elements takes of every body, with the body's number; see `Body.blocks`."""
        return ((number, block) for number, body in enumerate(self.bodies) for block in body.blocks(kernel))

    def touches(self, dofs: np.ndarray) -> np.ndarray:
        """Return which elements with unknowns (n_e, m) have one that is owned."""
        return self.owns(dofs).any(axis=1)

    def owns(self, dofs: np.ndarray) -> np.ndarray:
        """Return which unknowns are owned."""
        return (dofs >= self.rows.start) & (dofs < self.rows.stop)

    def evaluate(self, terms: Mapping[Monomial, Sequence[float] | np.ndarray]) -> np.ndarray:
        """Return sums of weighted coefficients of any shape for all samples, shape (..., n_samples)."""
        ones = np.ones(self.blocks.n_samples)
        return sum(np.multiply.outer(np.array(p), weight.evaluate(self.values) * ones) for weight, p in terms.items())


def placed(part, pattern: Pattern, layout: Layout):
    """Return a part in the numbering of a layout."""
    return part._replace(dofs=layout.unknowns(part.dofs), positions=layout.positions(*pattern))


def contiguous(part):
    """Return a part, nested tuples of arrays, with contiguous arrays: one compiled function serves all scenes."""
    if isinstance(part, np.ndarray):
        return np.ascontiguousarray(part)
    if isinstance(part, tuple):
        parts = map(contiguous, part)
        return type(part)(*parts) if hasattr(part, "_fields") else tuple(parts)
    return part


def section_owners(bodies: Sequence[Body]) -> np.ndarray:
    """Return the body of every row of sections, shape (n_sections,): one of each body, and behind these one of each
    element of bodies whose elements have sections of their own."""
    numbers = np.arange(len(bodies))
    return np.concatenate([numbers, np.repeat(numbers, [body.n_own_sections for body in bodies])])


def _sections_of(bodies: Sequence[Body], number: int) -> np.ndarray:
    """Return the rows of sections of a body's elements, shape (n_elements,)."""
    n, own = len(bodies[number].mesh.cells), bodies[number].n_own_sections
    first = len(bodies) + sum(body.n_own_sections for body in bodies[:number])
    return np.arange(first, first + n) if own else np.full(n, number)


def _coefficients(share: Share, body: Body, kind: str) -> np.ndarray:
    """Return the coefficients of the sections of a body's rows, shape (n_rows, n_coefficients, n_samples)."""
    rows = slice(None if body.profiles else 1)  # all elements of a uniform body have those of the first
    return share.evaluate({weight: values[rows] for weight, values in body.sections(kind).items()})


def sections(share: Share) -> np.ndarray:
    """Evaluate ``(EA, k_s GA, EI, rho A, rho I, beta, alpha)``, (n_blocks, n_sections, 7, n_lanes): of every body,
    and of elements with sections of their own (`section_owners`)."""
    owners = section_owners(share.bodies)
    table = np.zeros((owners.size, 7, share.blocks.n_samples))
    table[:, 5:] = share.damping.rayleigh[owners, :, None]
    for number, body in enumerate(share.bodies):
        if body.blocks("beam2d"):
            rows = np.unique(_sections_of(share.bodies, number))
            table[rows, :3], table[rows, 3:5] = (_coefficients(share, body, kind) for kind in ("stiffness", "mass"))
    return share.blocks.pack(table)


def planar_beams(share: Share) -> tuple[Elements, Pattern]:
    """Return the beam elements in the plane."""
    parts = [(np.zeros((0, N_PLANAR), dtype=int), np.zeros(0), np.zeros(0), np.zeros(0, dtype=int))]
    for number, beam in share.blocks_of("beam2d"):
        dofs = element_dofs(beam.elements)
        here = share.touches(dofs)
        own = _sections_of(share.bodies, number)
        parts.append((dofs[here], beam.mesh.lengths[here], beam.directions[here], own[here]))
    dofs, lengths, directions, owners = map(np.concatenate, zip(*parts))
    pattern = dofs[:, PACKED_ROWS], dofs[:, PACKED_COLUMNS]
    damped, nowhere = bool(share.damping.rayleigh.any()), np.zeros(0, dtype=int)
    return Elements(dofs, lengths, directions, owners, nowhere, share.owns(dofs[:, 0]), damped), pattern


def planar_masses(share: Share) -> tuple[Lumps, Pattern]:
    """Return the masses of nodes in the plane."""
    parts = [(np.zeros(0, dtype=int), np.zeros(0, dtype=int), np.zeros((0, share.blocks.n_samples)))]
    for number, body in enumerate(share.bodies):
        if body.lumps and body.dimension == 2:
            dofs, entries = body.lumped_entries()
            here = share.owns(dofs)
            parts.append((dofs[here], np.full(here.sum(), number), share.evaluate(entries)[here]))
    dofs, owners, masses = map(np.concatenate, zip(*parts))
    return Lumps(dofs, owners, dofs[:0], share.owns(dofs), share.blocks.pack(masses)), (dofs, dofs)


def spatial_beams(share: Share) -> tuple[Beams, Pattern]:
    """Return the beam elements in space."""
    n = 2 * N_POSE
    parts = [(np.zeros((0, n), dtype=int), np.zeros(0), np.zeros((0, 3, 3)), np.zeros(0, dtype=int))]
    table = np.zeros((section_owners(share.bodies).size, N_SECTION + 3, share.blocks.n_samples))
    for number, beam in share.blocks_of("beam3d"):
        dofs = element_dofs(beam.elements, N_POSE)
        here = share.touches(dofs)
        own = _sections_of(share.bodies, number)
        parts.append((dofs[here], beam.mesh.lengths[here], beam.axes[here], own[here]))
        table[np.unique(own), :N_SECTION] = _coefficients(share, beam, "stiffness")
        table[np.unique(own), N_SECTION:] = _coefficients(share, beam, "mass")
    dofs, lengths, axes, owners = map(np.concatenate, zip(*parts))
    low = np.tril_indices(n)
    beams = Beams(dofs, lengths, axes, owners, share.blocks.pack(table), np.zeros(0, dtype=int), share.owns(dofs[:, 0]))
    return beams, (dofs[:, low[0]], dofs[:, low[1]])


def spatial_masses(share: Share, unknowns: Unknowns) -> tuple[Masses, Pattern]:
    """Return the masses of frames in space: rigid bodies, and point masses on flexible ones."""
    none = np.zeros(0, dtype=int)
    parts = [(np.zeros((0, N_POSE), dtype=int), none, np.zeros((0, N_VECTORS, N_VECTORS, share.blocks.n_samples)))]
    for number, body in enumerate(share.bodies):
        for node, terms in body.node_masses() if unknowns.dimension == 3 else ():
            own = unknowns.frame(body.first_node + node)[None]
            if share.touches(own)[0]:
                density = share.evaluate({w: _density(*mass) for w, mass in terms.items()})
                parts.append((own, [number], density[None]))
    dofs, owners, density = map(np.concatenate, zip(*parts))
    vectors = dofs.reshape(-1, N_VECTORS, 3)
    shape = (len(dofs), N_VECTORS, N_VECTORS, 3)
    pattern = np.broadcast_to(vectors[:, :, None], shape), np.broadcast_to(vectors[:, None], shape)
    return Masses(dofs, owners, share.blocks.pack(density), none, share.owns(dofs[:, 0])), pattern


def _density(mass: float, inertia: np.ndarray) -> np.ndarray:
    """Return m and J of a mass (kg) with a tensor of inertia (3, 3), kg m2, about its position."""
    density = np.zeros((N_VECTORS, N_VECTORS))
    density[0, 0] = mass
    density[1:, 1:] = 0.5 * np.trace(inertia) * np.eye(3) - inertia
    return density


def solids(share: Share, dimension: int) -> tuple[Solids, Pattern]:
    """Return the continuum elements, material by material."""
    found, moduli, constants, rayleigh = [], [], [], []
    for number, solid in share.blocks_of("cells"):
        for region in solid.regions:
            mesh, body = solid.mesh, share.bodies[number]
            cells, rule = mesh.cells[region.cells], reference_element(mesh.kind)
            dofs = body.first_internal + dimension * cells[:, :, None] + np.arange(dimension)
            here = share.touches(dofs.reshape(len(dofs), -1))
            places = mesh.nodes[cells[here]]
            geometry = Geometry.of(places, rule.stiffness)
            mass = elasticity.mass(elasticity.volumes_of(places, rule.mass), rule.mass)
            own = _of_cells(share, solid, region)
            rows = len(moduli) + (np.arange(len(cells)) if len(own) > 1 else np.zeros(len(cells), dtype=int))
            owner = rows[here], np.full(here.sum(), number)
            found.append((dofs[here], geometry.gradients.swapaxes(2, 3), geometry.volumes, mass, *owner))
            lame = Lame.of(region.nu, dimension == 2)
            constants += [(lame.first, lame.shear)] * len(own)
            rayleigh += [share.damping.rayleigh[number]] * len(own)
            moduli += own
    n_nodes = max((part[0].shape[1] for part in found), default=1)
    n_points = max((part[2].shape[1] for part in found), default=1)
    empty, d = np.zeros(0, dtype=int), dimension
    shapes = (n_nodes, d), (n_points, n_nodes, d), (n_points,), (n_nodes, n_nodes), (), ()
    columns = list(zip(*found)) or [()] * len(shapes)
    dofs, gradients, volumes, mass, region, owners = (
        np.concatenate([np.zeros((0, *shape)), *(_filled(part, shape, -1.0 if k == 0 else 0.0) for part in column)])
        for k, (shape, column) in enumerate(zip(shapes, columns))
    )
    dofs = dofs.astype(int)
    flat, low = dofs.reshape(len(dofs), n_nodes * d), np.tril_indices(n_nodes * d)
    n = len(moduli)
    table = share.blocks.pack(np.array(moduli).reshape(n, 2, share.blocks.n_samples))
    part = Solids(
        dofs, gradients, volumes, mass, region.astype(int), owners.astype(int), np.array(constants).reshape(n, 2),
        np.array(rayleigh).reshape(n, 2), table, empty, share.owns(flat[:, 0]),
    )  # fmt: skip
    here = np.maximum(flat, 0)  # of a node that an element has not, some entry on the diagonal that nothing is added to
    rows, columns = here[:, low[0]], here[:, low[1]]
    absent = flat[:, low[0]] < 0
    return part, (np.where(absent, flat[:, :1], rows), np.where(absent, flat[:, :1], columns))


def _of_cells(share: Share, solid: Solid, region: Region) -> list[np.ndarray]:
    """Return modulus and density of a region, shape (2, n_samples): once, or cell by cell where they differ."""
    cells = region.cells if solid.profiles else region.cells[:1]
    constants = zip((region.modulus, region.density), (solid.profiles.stiffness, solid.profiles.mass))
    found = [
        share.evaluate(profile.over({constant.monomial: np.full(cells.size, constant.coefficient)}, cells))
        for constant, profile in constants
    ]
    return list(np.stack(found, axis=1))


def floating_bodies(
    share: Share, unknowns: Unknowns, gravity: Sequence[tuple[int, Effect]]
) -> tuple[FloatingBodies, Pattern]:
    """Return the flexible bodies in floating frames; `gravity` are fields with the numbers of their loads."""
    d, n_samples = unknowns.dimension, share.blocks.n_samples
    none, numbers = np.zeros(0, dtype=int), []
    parts = [(none, np.zeros((0, n_samples)), none, none, none, none, np.zeros(0))]
    for number, floating in share.blocks_of("floating"):
        body = share.bodies[number]
        frame = unknowns.frame(body.first_node + body.n_nodes - 1)
        own = np.concatenate([frame, body.first_internal + np.arange(floating.n)])[None]
        if not share.touches(own)[0]:
            continue
        moments, stiffness = share.evaluate(floating.moments), share.evaluate(floating.stiffness)
        curved = share.evaluate(floating.curved) if floating.curved else np.zeros((0, floating.n, n_samples))
        braking = share.evaluate({Monomial(): share.damping.amplitudes.get(number, np.zeros(floating.n))})
        *entries, both, mass, bends = entries_of(floating.moments, floating.stiffness, floating.curved, d)
        table = body_tables(moments, stiffness, braking, curved, d, (both, mass, bends))
        numbers.append(number)
        first = places_of.py_func(d, floating.n, entries[0]).both
        common = table[first : first + both.size] if both.all() and n_samples > 1 else table[:0]
        common = common[:, 0] if np.all(common == common[:, :1]) else common[:0, 0]
        parts.append((own[0], table, *(own[0, part] for part in np.tril_indices(own.size)), *entries, common))
    dofs, tables, rows, columns, starts, chosen, common = map(np.concatenate, zip(*parts))
    firsts = np.cumsum([[len(part[k]) for k in (0, 1, 2, 4, 5, 6)] for part in parts], axis=0)
    fields = (effect.field for _, effect in gravity)
    falls = [np.multiply.outer(way, share.evaluate({size.monomial: size.coefficient})) for way, size in fields]
    part = FloatingBodies(
        dofs, firsts, np.array(numbers, dtype=int), share.blocks.pack(tables),
        share.blocks.pack(np.array(falls).reshape(len(falls), d, n_samples)),
        np.array([load for load, _ in gravity], dtype=int), none, share.owns(dofs[firsts[:-1, 0]]), starts, chosen,
        common,
    )  # fmt: skip
    return part, (rows, columns)


def mass_on_diagonal(problem: FullProblem, size: float) -> np.ndarray:
    """Return the sum of the mass matrix's diagonal that is counted on this rank, kg, shape (n_blocks, n_lanes).

    Inertia (kg m2) is over the square of the mechanism's `size`, so that the sum is the same in all units.
    """
    turned = size**-2
    elements, lumps, cells = problem.elements, problem.lumps, problem.solids
    beams, masses = problem.beams, problem.masses
    d = cells.dofs.shape[2]
    line = problem.section[:, elements.body[elements.counted]]
    total = _summed(4 / 3 * line[:, :, 3] + 2 / 3 * turned * line[:, :, 4], elements.length[elements.counted])
    total += _summed(lumps.mass[:, lumps.counted], (problem.units[lumps.dofs[lumps.counted]] * size) ** -2)
    volumes = d * np.trace(cells.mass[cells.counted], axis1=1, axis2=2)
    total += _summed(cells.moduli[:, cells.region[cells.counted], 1], volumes)
    mass, *inertia = np.moveaxis(beams.section[:, beams.body[beams.counted], N_SECTION:], 2, 0)
    total += _summed(mass + turned * sum(inertia), 2.0 * beams.length[beams.counted])
    mass, *inertia = np.moveaxis(np.diagonal(masses.density[:, masses.counted], axis1=2, axis2=3), -1, 0)
    total += _summed(mass + turned * sum(inertia), np.full(mass.shape[1], 3.0))
    for k in np.flatnonzero(problem.floating.counted):
        total += _mass_of_floating(problem, k, turned)
    return total


def _summed(parts: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return the sums of parts (n_blocks, n, n_lanes), each times a weight, in their order: numpy adds those of one
    lane in another one, and a sample would differ alone and beside others."""
    return np.cumsum(np.pad(parts * weights[:, None], ((0, 0), (1, 0), (0, 0))), axis=1)[:, -1]


def _mass_of_floating(problem: FullProblem, k: int, turned: float) -> np.ndarray:
    """Return the sum of the diagonal of the mass matrix of a body in a floating frame, shape (n_blocks, n_lanes);
    inertia is taken times `turned`."""
    d, (first, last) = problem.dimension, problem.floating.firsts[k : k + 2]
    table = problem.floating.table[:, first[1] : last[1]]
    n = last[0] - first[0] - n_pose_of.py_func(d)
    rows = problem.floating.rows[first[3] : last[3]]
    at, of_mass = places_of.py_func(d, n, rows), rows[d * d * n : d * d * n + n + 1]
    columns = problem.floating.columns[first[4] : last[4]][of_mass[0] : of_mass[-1]]
    diagonal = columns == np.repeat(np.arange(n), np.diff(of_mass))
    turning = _summed(table[:, at.squares : at.fields : d + 1], np.full(d, turned if d == 2 else 3.0 * turned))
    own = table[:, at.both + of_mass[0] + np.flatnonzero(diagonal)]
    return d * table[:, 0] + turning + _summed(own, np.ones(own.shape[1]))


def _filled(part: np.ndarray, shape: tuple[int, ...], value: float) -> np.ndarray:
    """Fill an array (n_e, ...) up to a shape (n_e, *shape)."""
    result = np.full((len(part), *shape), value)
    result[tuple(slice(n) for n in part.shape)] = part
    return result
