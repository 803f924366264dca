"""Write STEP files of small parts into a folder: ``gmsh_parts.py folder``. A program of its own, as gmsh_cylinder.py.

rod.step      a connecting rod: bores of 15 and 8 mm in eyes of 25 and 16 mm at x = 0 and 150 mm, along z
block.step    a block of 60 x 40 x 20 mm with one bore of 6 mm along y through its middle, and a rounded edge
bar.step      a bar of 100 x 10 x 10 mm from the origin on
shell.step    the same bar without one face; two.step: two bars apart; wire.step: a line; face.step: one face
"""

import sys
from pathlib import Path

import gmsh


def rod() -> None:
    occ = gmsh.model.occ
    eyes = [(3, occ.addCylinder(x, 0, -10, 0, 0, 20, radius)) for x, radius in ((0, 25), (150, 16))]
    whole, _ = occ.fuse(eyes, [(3, occ.addBox(15, -8, -5, 130, 16, 10))])
    occ.cut(whole, [(3, occ.addCylinder(x, 0, -11, 0, 0, 22, radius)) for x, radius in ((0, 15), (150, 8))])


def block() -> None:
    occ = gmsh.model.occ
    solid = occ.addBox(0, 0, 0, 60, 40, 20)
    occ.cut([(3, solid)], [(3, occ.addCylinder(30, -1, 10, 0, 42, 0, 6))])
    occ.synchronize()
    edges = gmsh.model.getEntitiesInBoundingBox(-1, -1, 19, 1, 41, 21, 1)
    occ.fillet([solid], [edges[0][1]], [5.0])


def bar(x: float = 0.0) -> None:
    gmsh.model.occ.addBox(x, 0, 0, 100, 10, 10)


def face() -> None:
    gmsh.model.occ.addRectangle(0.0, 0.0, 0.0, 10.0, 10.0)


def shell() -> None:
    bar()
    gmsh.model.occ.remove([(3, 1)])
    gmsh.model.occ.remove([(2, 1)])


def two() -> None:
    bar()
    bar(200.0)


def wire() -> None:
    occ = gmsh.model.occ
    occ.addLine(occ.addPoint(0, 0, 0), occ.addPoint(10, 0, 0))


if __name__ == "__main__":
    gmsh.initialize(sys.argv[:1])
    gmsh.option.setNumber("General.Terminal", 0)
    for make in (rod, block, bar, shell, two, wire, face):
        gmsh.clear()
        make()
        gmsh.model.occ.synchronize()
        gmsh.write(str(Path(sys.argv[1]) / f"{make.__name__}.step"))
    gmsh.finalize()
