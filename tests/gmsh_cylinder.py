"""Write a curved mesh of a cylinder, radius 0.5 m, length 2 m: ``gmsh_cylinder.py kind path [save_all] [binary]``.

A program of its own, because gmsh takes over signals and brings its own copy of some of the libraries that PETSc uses.
The axis is x, from 0 to the length. Physical groups: left and right, both of them reversed as ends, mantle, and body;
with save_all, body only and the cells of everything else untagged. MSH 4.1.
"""

import math
import sys

import gmsh

RADIUS, LENGTH = 0.5, 2.0
LAYERS = 6


def tetrahedra() -> tuple[list[int], list[int]]:
    """Make the cylinder for tetrahedra; return volumes and outer sides."""
    volume = gmsh.model.occ.addCylinder(0, 0, 0, LENGTH, 0, 0, RADIUS)
    gmsh.model.occ.synchronize()
    gmsh.option.setNumber("Mesh.CharacteristicLengthMax", 0.25)
    return [volume], [tag for _, tag in gmsh.model.getBoundary([(3, volume)], oriented=False)]


def hexahedra() -> tuple[list[int], list[int]]:
    """Make the cylinder of a square bar and four blocks around it, swept along x; return volumes and outer sides."""
    geo = gmsh.model.geo
    centre = geo.addPoint(0, 0, 0)
    angles = [math.pi * (0.25 + 0.5 * i) for i in range(4)]
    inner, outer = ([geo.addPoint(0, r * math.cos(a), r * math.sin(a)) for a in angles] for r in (0.5 * RADIUS, RADIUS))
    following = [1, 2, 3, 0]
    square = [geo.addLine(inner[i], inner[following[i]]) for i in range(4)]
    arcs = [geo.addCircleArc(outer[i], centre, outer[following[i]]) for i in range(4)]
    rays = [geo.addLine(inner[i], outer[i]) for i in range(4)]
    loops = [square, *([rays[i], arcs[i], -rays[following[i]], -square[i]] for i in range(4))]
    discs = [geo.addPlaneSurface([geo.addCurveLoop(loop)]) for loop in loops]
    for curve in (*square, *arcs, *rays):
        geo.mesh.setTransfiniteCurve(curve, 4)
    for disc in discs:
        geo.mesh.setTransfiniteSurface(disc)
        geo.mesh.setRecombine(2, disc)
    swept = geo.extrude([(2, disc) for disc in discs], LENGTH, 0, 0, numElements=[LAYERS], recombine=True)
    geo.synchronize()
    volumes = [tag for dimension, tag in swept if dimension == 3]
    sides = gmsh.model.getBoundary([(3, tag) for tag in volumes], combined=True, oriented=False)
    return volumes, [tag for _, tag in sides]


def write(kind: str, path: str, save_all: bool, binary: bool) -> None:
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.option.setNumber("Mesh.MshFileVersion", 4.1)
    gmsh.option.setNumber("Mesh.SaveAll", save_all)
    gmsh.option.setNumber("Mesh.Binary", binary)
    gmsh.option.setNumber("Mesh.SecondOrderIncomplete", kind == "hexahedron20")
    gmsh.model.add("cylinder")
    volumes, sides = tetrahedra() if kind.startswith("tetra") else hexahedra()
    named = {"left": [], "right": [], "mantle": []}
    for side in sides:
        x_min, _, _, x_max, _, _ = gmsh.model.getBoundingBox(2, side)
        place = "mantle" if x_max - x_min > 0.5 * LENGTH else "left" if x_max < 0.5 * LENGTH else "right"
        named[place].append(side)
    named["ends"] = [-tag for tag in named["left"] + named["right"]]
    for name, tags in ({} if save_all else named).items():
        gmsh.model.setPhysicalName(2, gmsh.model.addPhysicalGroup(2, tags), name)
    gmsh.model.setPhysicalName(3, gmsh.model.addPhysicalGroup(3, volumes), "body")
    gmsh.model.mesh.generate(3)
    gmsh.model.mesh.setOrder(2)
    gmsh.write(path)


if __name__ == "__main__":
    gmsh.initialize([sys.argv[0]], False)
    try:
        write(*sys.argv[1:3], "save_all" in sys.argv[3:], "binary" in sys.argv[3:])
    finally:
        gmsh.finalize()
