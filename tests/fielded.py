"""Made-up runs with fields: a plane bar that moves, and blocks in space, with a stress that is known everywhere."""

from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import meshio
import numpy as np
import synthetic
from solids import box_mesh, rectangle_mesh

from pgmp_petsc.results import BodyField, Trajectory


def field_of(mesh, moves: np.ndarray, deformation: float, stress: float) -> BodyField:
    """Return a body that moves by `moves` (n_f, d), with a stress that grows along x and over time."""
    rigid = mesh.nodes + moves[:, None, :]
    strength = stress * np.linspace(0.0, 1.0, len(moves))[:, None]
    along = mesh.nodes[:, 0] / mesh.nodes[:, 0].max()
    bent = np.zeros_like(rigid)
    bent[..., 1] = deformation * along**2
    nodal = {"von_mises": strength * along}
    inner = {"von_mises": strength * along[mesh.cells].mean(axis=1)}
    return BodyField(mesh.kind, mesh.nodes, mesh.cells, rigid + bent, bent, nodal, inner, {"von_mises": "Pa"})


def run_of(n_frames: int = 4, **fields: BodyField) -> Trajectory:
    run = synthetic.trajectory(n_frames=n_frames, n_times=101)
    empty = {name: {} for name in ("positions", "rotations", "nodes", "cells")}
    d = next(iter(fields.values())).nodes.shape[1]
    for name, own in fields.items():
        empty["positions"][name] = own.positions[:, :1]
        empty["rotations"][name] = np.zeros((n_frames, 1) if d == 2 else (n_frames, 1, 3))
        empty["nodes"][name] = own.nodes[:1]
        empty["cells"][name] = np.zeros((0, 2), dtype=int)
    frames = replace(run.frames, **empty)
    return replace(run, frames=frames, fields=fields)


def flat_run(deformation: float = 1e-4, cells: tuple[int, int] = (6, 2), n_frames: int = 4) -> Trajectory:
    """Return a bar of plane cells that moves to the right by its length."""
    mesh = rectangle_mesh("quad8", cells, (1.0, 0.2))
    moves = np.linspace([0.0, 0.0], [1.0, 0.0], n_frames)
    return run_of(n_frames, bar=field_of(mesh, moves, deformation, 3e6))


def block_run() -> Trajectory:
    """Return a block of solid cells that stays, beside a rigid one."""
    mesh = box_mesh("hexahedron20", (3, 1, 1), (1.0, 0.3, 0.3))
    block = field_of(mesh, np.zeros((4, 3)), 1e-4, 3e6)
    moved = block.positions - block.deformation + [1.5, 0.0, 0.0]
    base = BodyField(mesh.kind, mesh.nodes, mesh.cells, moved, 0.0 * moved, rigid=True)
    return run_of(block=block, base=base)


def rod_run(pressed: float, **more: float) -> Trajectory:
    """Return a beam at rest whose fibres are pulled by 1 to 2 MPa along it, and pressed by a stress (Pa)."""
    nodes = np.column_stack([np.linspace(0.0, 1.0, 6), np.zeros(6)])
    cells = np.column_stack([np.arange(5), np.arange(1, 6)])
    places = np.repeat(nodes[None], 4, axis=0)
    extremes = {"stress_max": np.tile(np.linspace(1e6, 2e6, 6), (4, 1)), "stress_min": np.full((4, 6), -pressed)}
    inner = {name: values[:, :5] for name, values in extremes.items()}
    units = dict.fromkeys(extremes, "Pa")
    return run_of(rod=BodyField("line", nodes, cells, places, 0.0 * places, extremes, inner, units, **more))


def last_grid(xdmf: Path, body: str) -> meshio.Mesh:
    """Return the last frame of a body, as another program reads it."""
    tree = ElementTree.parse(xdmf)
    domain = tree.getroot().find("Domain")
    last = next(grid for grid in domain.findall("Grid") if grid.get("Name") == body).findall("Grid")[-1]
    last.remove(last.find("Time"))
    for grid in list(domain):
        domain.remove(grid)
    domain.append(last)
    tree.write(xdmf.with_name("last.xdmf"))
    return meshio.read(xdmf.with_name("last.xdmf"))
