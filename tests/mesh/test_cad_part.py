"""Parts of CAD: what gmsh makes of a STEP file, its units, bores and names, the scene that is made of one, refusals."""

import re
import subprocess
import sys
from hashlib import sha256
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT
from pencils import free_hz
from refusals import cases, check_said, refusal
from runs import in_turn, one_message, overridden, refused, said
from solids import body_of, box_mesh, matrices_of

from pgmp_petsc.figures.solids import part_picture
from pgmp_petsc.mechanism.capabilities import Purpose
from pgmp_petsc.mesh import solid_mesh_reading
from pgmp_petsc.mesh.solid_mesh_reading import CadPart, read_part
from pgmp_petsc.scene import load_scene
from pgmp_petsc.studies.inputs import with_meshes
from scenes import tables

pytestmark = pytest.mark.skipif(find_spec("gmsh") is None, reason="gmsh is not installed")
MM = 1e-3


@pytest.fixture(scope="module")
def parts(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("parts")
    program = ROOT / "tests" / "gmsh_parts.py"
    subprocess.run([sys.executable, program, folder], check=True, stdout=subprocess.DEVNULL)
    text = (folder / "bar.step").read_text()
    (folder / "metres.step").write_text(text.replace(".MILLI.,.METRE.", "$,.METRE."))
    inch = "( CONVERSION_BASED_UNIT('INCH',#9002) LENGTH_UNIT() NAMED_UNIT(#9001) );"
    sizes = (
        "#9001 = DIMENSIONAL_EXPONENTS(1.,0.,0.,0.,0.,0.,0.);\n#9002 = LENGTH_MEASURE_WITH_UNIT(LENGTH_MEASURE(25.4),"
    )
    known = "( LENGTH_UNIT() NAMED_UNIT(*) SI_UNIT(.MILLI.,.METRE.) );"
    (folder / "inches.step").write_text(text.replace(known, f"{inch}\n{sizes}#9003);\n#9003 = {known}"))
    (folder / "mesh.step").write_text("$MeshFormat\n4.1 0 8\n$EndMeshFormat\n")
    (folder / "cut.step").write_text(text[: len(text) // 2])
    return folder


def read(parts: Path, name: str, unit: float = MM, size: float | None = None) -> CadPart:
    return read_part(parts / f"{name}.step", f"received {name}", unit, size)


def moments(part: CadPart) -> np.ndarray:
    """Return ``int (x, 1) (x, 1)^T dV`` of the mesh."""
    (found,) = body_of(part.mesh, 1.0, 1.0).second_moments().values()
    return found


def test_mass_properties_are_those_of_the_solid(parts: Path) -> None:
    """The block minus its bore and what is rounded off, in closed form; the mesh by cubes of its size."""
    part, r = read(parts, "block"), 5.0
    pieces = [  # volume, place
        (60.0 * 40.0 * 20.0, (30.0, 20.0, 10.0)),
        (-np.pi * 6.0**2 * 40.0, (30.0, 20.0, 10.0)),
        (-(1.0 - np.pi / 4.0) * r**2 * 40.0, (_corner(r), 20.0, 20.0 - _corner(r))),
    ]
    volume = sum(v for v, _ in pieces)
    assert part.volume == pytest.approx(volume, rel=1e-9)
    centre = sum(v * np.array(place) for v, place in pieces) / volume
    np.testing.assert_allclose(part.centre, centre, rtol=1e-9)
    of_mesh = moments(part)
    assert of_mesh[3, 3] == pytest.approx(volume, rel=1e-4)  # curved faces of second order
    np.testing.assert_allclose(of_mesh[:3, 3] / of_mesh[3, 3], centre, rtol=1e-4)
    second = of_mesh[:3, :3] - np.outer(of_mesh[:3, 3], of_mesh[:3, 3]) / of_mesh[3, 3]
    np.testing.assert_allclose(np.trace(second) * np.eye(3) - second, part.inertia, atol=2e-4 * part.inertia.max())


def _corner(r: float) -> float:
    """Return how far the centre of what rounding takes off a square corner is from its sides."""
    square, quarter = r**2, np.pi * r**2 / 4.0
    return (square * r / 2.0 - quarter * (r - 4.0 * r / (3.0 * np.pi))) / (square - quarter)


def test_bores_and_pins_are_found_with_axis_radius_and_place(parts: Path) -> None:
    part = read(parts, "rod")
    found = {one.name: (one.inner, one.radius, *one.centre, one.length) for one in part.cylinders}
    known = {"bore1": (1, 15, 0), "bore2": (1, 8, 150), "pin1": (0, 25, 0), "pin2": (0, 16, 150)}
    assert set(found) == set(known)
    for name, (inner, radius, x) in known.items():
        np.testing.assert_allclose(found[name], (inner, radius, x, 0.0, 0.0, 20.0), atol=1e-9)
        faces, one = part.mesh.groups[name], next(one for one in part.cylinders if one.name == name)
        np.testing.assert_allclose(one.axis, (0.0, 0.0, 1.0), atol=1e-9)
        distances = np.linalg.norm((part.mesh.nodes[np.unique(faces)] - one.centre)[:, :2], axis=1)
        np.testing.assert_allclose(distances, radius, rtol=1e-9)  # also nodes in the middle of edges
    # a rounded edge is no whole cylinder
    assert [one.name for one in read(parts, "block").cylinders] == ["bore1"]
    every = np.concatenate([part.mesh.groups[f"face{k}"] for k in range(1, part.n_faces + 1)])
    assert len(every) == len({tuple(sorted(face)) for face in every.tolist()})


def test_units_of_the_file_and_of_the_scene(parts: Path) -> None:
    """10,000 mm3: in a file that says metres, the same numbers are a billion times that, in inches 25.4^3 times."""
    known = (("bar", MM, 1e4), ("bar", 1.0, 1e-5), ("metres", 1.0, 1e4), ("metres", MM, 1e13))
    for name, unit, volume in (*known, ("inches", MM, 1e4 * 25.4**3)):
        part = read(parts, name, unit)
        assert part.volume == pytest.approx(volume, rel=1e-9) == moments(part)[3, 3]
        np.testing.assert_allclose(np.ptp(part.mesh.nodes, axis=0), np.cbrt(volume / 1e4) * np.array([100, 10, 10]))


def first_frequencies(mesh, n: int = 4) -> np.ndarray:
    return free_hz(*matrices_of(body_of(mesh, 210e9, 7800.0)), n)


def test_cells_by_the_walls_are_fine_enough_and_finer_ones_converge(parts: Path) -> None:
    """Against hexahedra of second order, 30 by 3 by 3: a bar of 10 mm has two cells across by default."""
    known = first_frequencies(box_mesh("hexahedron20", (30, 3, 3), (0.1, 0.01, 0.01)))
    own, fine = (first_frequencies(read(parts, "bar", 1.0, size).mesh) for size in (None, 2.5e-3))
    assert np.abs(own / known - 1.0).max() < 3e-3
    assert np.abs(fine / known - 1.0).max() < 0.3 * np.abs(own / known - 1.0).max()


PART = tables("""
scene: name = "part"; units = "mm"
materials.steel: E = 210e3; nu = 0.3; rho = 7.8e-9
bodies.rod: mesh = "PART.step"; element = "solid3d"; material = "steel"
joints.hinge: type = "revolute"; connect = ["ground:origin", "rod:POINT"]; axis = [0.0, 0.0, 1.0]
coordinates.angle: joint = "hinge"; range = [-1.0, 1.0]
""")


def scene_of(parts: Path, name: str = "rod", point: str = "bore1") -> Path:
    path = parts / f"{name}_{point}.toml"
    path.write_text(PART.replace("PART", name).replace("POINT", point))
    return path


OTHERS = cases("""
bodies.rod.mesh_size=0.0 -> = 0.0: must be greater than 0
bodies.rod.mesh_size=0.01 -> bodies.rod.mesh = | mesh_size = 0.01 mm would take about | a larger mesh_size is needed
bodies.rod.element="beam3d" -> bodies.rod.element = "beam3d": a part of CAD is a solid
bodies.rod.element="solid2d" -> bodies.rod.element = "solid2d": a part of CAD is a solid
bodies.rod.faces={eye="bore7"} -> bodies.rod.faces.eye = "bore7": the mesh has no group of faces | did you mean 'bore
bodies.rod.faces={bore1="bore2"} -> bodies.rod.faces.bore1: the mesh has a group of this name already
bodies.rod.faces={eye=[]} -> = []: the name of a group of faces, or several in brackets, is needed
bodies.rod.faces={eye=3} -> = 3: the name of a group of faces, or several in brackets, is needed
""")


@pytest.mark.parametrize(("entry", "message"), OTHERS)
def test_entries_that_do_not_fit_a_part(entry: str, message: str, parts: Path) -> None:
    def reading() -> None:
        with_meshes(load_scene(scene_of(parts), (entry,)), Purpose.CHECK)

    check_said(refusal(reading), message, entry.replace("={eye", ".eye"))


def test_faces_have_names_of_ones_own_and_a_size_is_for_parts_of_cad_alone(parts: Path) -> None:
    scene = load_scene(scene_of(parts, point="eye"), ('bodies.rod.faces={eye="bore1", ends=["face2", "face3"]}',))
    mesh = with_meshes(scene, Purpose.CHECK)[1]["rod"]
    np.testing.assert_array_equal(mesh.groups["eye"], mesh.groups["bore1"])
    assert len(mesh.groups["ends"]) == len(mesh.groups["face2"]) + len(mesh.groups["face3"])
    entries = ('bodies.rod.mesh="rod.msh"', "bodies.rod.mesh_size=3.0")
    assert 'for a part of CAD, mesh = "PART.step"' in refusal(load_scene, scene_of(parts), entries)


def test_what_is_no_part_is_refused_in_one_message_on_any_number_of_ranks(parts: Path, monkeypatch) -> None:
    known = {
        "shell": "it has no solid, but an open shell of 5 faces with 4 free edges; close it to a solid in CAD",
        "face": "it has no solid, but one face; close it to a solid in CAD",
        "two": "it has 2 solids: ", "wire": "it has no solid; export the part", "mesh": "this is no STEP file",
        "cut": "the file breaks off: END-ISO-10303-21", "none": "no such file; a STEP file of one solid is needed",
    }  # fmt: skip
    commands = [("check", scene_of(parts, name)) for name in known]
    for message, (name, words) in zip(refused(1, commands), known.items()):
        assert message.startswith('bodies.rod.mesh = "') and f"{name}.step" in message and words in message
    assert "export each to a file of its own" in refusal(read, parts, "two")
    # a Python that has no gmsh, or one whose libraries are missing
    (parts / "absent").mkdir()
    (parts / "absent" / "gmsh.py").write_text("raise OSError('libGLU.so.1: cannot open shared object file')")
    monkeypatch.setenv("PYTHONPATH", str(parts / "absent"))
    mesh, message = refused(2, [commands[4], ("check", scene_of(parts, "bar", "face1"))])
    assert known["mesh"] in mesh and "libGLU.so.1" in message and "pip install gmsh" in message


def test_a_face_may_have_the_name_of_its_own_cylinder_and_of_no_other(parts: Path, monkeypatch) -> None:
    bore = read(parts, "rod").cylinders[0]
    found = dict(
        solid_mesh_reading._by_gmsh(sha256((parts / "rod.step").read_bytes()).hexdigest(), parts / "rod.step", 0.0, 1.0)
    )
    monkeypatch.setattr(solid_mesh_reading, "_by_gmsh", lambda *_: found)
    found[f"named{bore.faces[0][4:]}"] = np.array(bore.name)
    assert read(parts, "rod").cylinders[0].name == bore.name
    found["named2"] = np.array(bore.name)
    assert f"received rod: face1, face2 has the name {bore.name}, also" in refusal(read, parts, "rod")


def test_a_part_is_the_same_on_any_number_of_ranks(parts: Path) -> None:
    scene = scene_of(parts)
    texts = []
    for n in (1, 3):
        statuses, done = in_turn(n, [("check", scene)])
        assert statuses == [n * [0]]
        texts.append([line for line in done.stdout.splitlines() if not line.startswith("[")])
    assert texts[0] == texts[1] and "frames bore1 (" in "".join(texts[0])


def test_a_coarser_mesh_tells_the_share_of_the_mesh(parts: Path, tmp_path: Path, monkeypatch) -> None:
    """The better model of a part is run again with larger cells; a mesh of a file is not cut."""
    monkeypatch.setattr("pgmp_petsc.report.page.write_report", lambda files, page: [])  # which takes as long again
    said("new", tmp_path / "bar.toml", "--from", parts / "bar.step")
    short = overridden("bodies.bar.mesh_size=10.0", "simulation.duration=8e-4", "simulation.frames=3")
    out, _ = said("run", tmp_path / "bar.toml", "-n", "2", *short)
    (line,) = re.findall("^mesh .*", out, re.MULTILINE)
    found = re.search(
        r"at most ([\d.]+) % of the largest .* \((\d+) nodes against (\d+), component modes; of the c.*of at most", line
    )
    assert found and int(found[2]) < 0.7 * int(found[3]) and 0.0 < float(found[1]) < 20.0, line
    short = overridden("simulation.duration=5e-3", "reduction.angles=4", "simulation.frames=3", "reference.budget=1e-9")
    out, _ = said("run", ROOT / "scenes/slider_crank_solid2d.toml", "-n", "1", "-o", tmp_path / "out", *short)
    assert (
        "mesh       left out: cells of a file are not cut: crank, rod; simulate with --override bodies.crank.m" in out
    )


def test_a_scene_is_made_of_a_part(parts: Path, tmp_path: Path) -> None:
    out, _ = said("new", tmp_path / "mine", "--from", parts / "rod.step")
    assert "of steel      0.4303 kg, centre of mass (58.608, 0, 0) mm" in out
    assert "bore1: radius 15, 20 long, middle [0.0, 0.0, 0.0], axis [0.0, 0.0, 1.0]" in out
    assert "held at bore1, loaded at bore2" in out and (tmp_path / "mine.png").stat().st_size > 20_000
    scene, meshes = with_meshes(load_scene(tmp_path / "mine.toml"), Purpose.BUILD)
    assert scene.remarks == () and set(meshes["rod"].groups) >= {"bore1", "bore2"}
    said("check", tmp_path / "mine.toml", "--strict")
    assert "exists; give another name" in one_message("new", tmp_path / "mine", "--from", parts / "rod.step")
    said("new", tmp_path / "mine", "--from", parts / "rod.step", "--force")
    # without bores, from end to end
    out, _ = said("new", tmp_path / "bar.toml", "--from", parts / "bar.step")
    assert "0 bores, 0 pins" in out and "held at face1, loaded at face2" in out
    said("check", tmp_path / "bar.toml", "--strict")
    said("new", tmp_path / "inches.toml", "--from", parts / "inches.step")  # its axis had round-off, and was refused
    assert load_scene(tmp_path / "inches.toml").joints["hold"].axis == (0.0, 0.0, 1.0)
    assert "with --from one name is needed" in one_message(
        "new", "bar", tmp_path / "x.toml", "--from", parts / "bar.step"
    )
    assert "a part of CAD as STEP (.step, .stp" in one_message("new", tmp_path / "y", "--from", parts / "bar.iges")
    assert "xacro arm.urdf.xacro -o arm.urdf" in one_message("new", tmp_path / "y", "--from", parts / "arm.urdf.xacro")


def test_names_in_the_picture_of_a_part_stand_out_from_what_is_coloured_like_them(parts: Path) -> None:
    part = read(parts, "rod")
    figure = part_picture(part.mesh, {one.name: one.centre for one in part.cylinders}, "rod", "mm")
    named = [text for text in figure.axes[0].texts if text.get_text().startswith(("bore", "pin"))]
    assert len(named) == len(part.cylinders) and all(text.get_path_effects() for text in named)
