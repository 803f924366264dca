"""The XDMF file: other readers accept it, and what cannot be written is refused."""

from dataclasses import replace
from xml.etree import ElementTree

import h5py
import meshio
import numpy as np
import pytest
import synthetic
from fielded import last_grid
from refusals import assert_refused
from sealed import resealed
from solids import box_mesh, rectangle_mesh

from pgmp_petsc.base.errors import RunError
from pgmp_petsc.results.trajectory import BodyField, Trajectory, write_xdmf


@pytest.fixture
def exported(tmp_path):
    """Return the trajectory's file and the XDMF file, in different directories."""
    (tmp_path / "runs").mkdir()
    (tmp_path / "paraview").mkdir()
    run, xdmf = tmp_path / "runs" / "t.h5", tmp_path / "paraview" / "t.xdmf"
    synthetic.trajectory(n_frames=5).write(run)
    assert write_xdmf(run, xdmf) == 5
    return run, xdmf


def test_an_independent_reader_sees_the_mechanism(exported):
    run, xdmf = exported
    tree = ElementTree.parse(xdmf)
    domain = tree.getroot().find("Domain")
    series = domain.find("Grid")
    last = series.findall("Grid")[-1]
    # meshio reads single grids only.
    domain.remove(series)
    last.remove(last.find("Time"))
    domain.append(last)
    tree.write(xdmf.parent / "last.xdmf")
    mesh = meshio.read(xdmf.parent / "last.xdmf")
    frames = synthetic.trajectory(n_frames=5).frames
    positions = np.concatenate([frames.positions[body] for body in frames.positions], axis=1)
    np.testing.assert_array_equal(mesh.points[:, :2], positions[-1])
    np.testing.assert_array_equal(mesh.point_data["displacement"][:, :2], positions[-1] - positions[0])
    assert (mesh.cells[0].type, mesh.cells[0].data.shape) == ("line", (10, 2))
    np.testing.assert_array_equal(np.unique(mesh.cells[0].data), np.arange(12))
    np.testing.assert_array_equal(mesh.point_data["body"], np.repeat([0, 1], 6))


def test_frames_may_be_left_unread_and_say_alike_what_they_are(exported):
    run, _ = exported
    whole, bare = Trajectory.read(run), Trajectory.read(run, frame=2)
    assert len(whole.frames.time) == 5 and np.array_equal(bare.frames.time, whole.frames.time[:2])
    assert all(np.array_equal(bare.frames.positions[body], own[:2]) for body, own in whole.frames.positions.items())
    assert (
        np.array_equal(bare.time, whole.time)
        and Trajectory.read(run, frame=0).frames.nodes.keys() == whole.frames.nodes.keys()
    )
    with h5py.File(run) as file:
        attributes = [dict(one.attrs) for one in file["frames/rotation"].values()]
    assert len(attributes) == 5 and all(one["unit"] == "rad" for one in attributes)
    assert [one["description"].split()[-2] for one in attributes] == [f"{time:g}" for time in whole.frames.time]


def test_the_trajectory_is_not_touched_and_read_whole(exported):
    run, xdmf = exported
    before = run.read_bytes()
    write_xdmf(run, run.with_suffix(".xdmf"))
    assert_refused("is what the command reads", write_xdmf, run, run)
    assert run.read_bytes() == before
    with resealed(run) as file:
        del file["frames/rotation/00002"]
    assert_refused("damaged", write_xdmf, run, xdmf)


@pytest.mark.parametrize(
    ("result", "said"),
    [
        (synthetic.trajectory(n_frames=0), "--override simulation.frames="),
        (synthetic.modes_table(), "needed: a trajectory"),
    ],
)
def test_results_without_frames_are_refused_with_the_cure(tmp_path, result, said):
    result.write(tmp_path / "t.h5")
    assert_refused(said, write_xdmf, tmp_path / "t.h5", tmp_path / "t.xdmf")


def test_a_system_that_fails_to_write(exported, monkeypatch):
    def fail(*_):
        raise OSError("no space left on device")

    monkeypatch.setattr("pgmp_petsc.files.hdf5.os.replace", fail)
    assert_refused("no space left", write_xdmf, exported[0], exported[1], error=RunError)
    assert [path.name for path in exported[1].parent.iterdir()] == ["t.xdmf"]


@pytest.mark.parametrize("name", ["a b/run 1.h5", "Größe/läuft.h5", 'a&b/<run>\'s "x".h5'])
def test_paths_with_spaces_and_signs(tmp_path, monkeypatch, name):
    (tmp_path / name).parent.mkdir()
    (tmp_path / "for paraview").mkdir()
    monkeypatch.chdir(tmp_path)
    synthetic.trajectory(n_frames=2).write(name)
    assert write_xdmf(name, "for paraview/my run.xdmf") == 2
    for item in ElementTree.parse(tmp_path / "for paraview" / "my run.xdmf").getroot().findall(".//DataItem"):
        file, dataset = item.text.split(":")
        with h5py.File(tmp_path / "for paraview" / file) as stored:
            assert dataset in stored


@pytest.mark.parametrize("name", ["at 12:30.h5", "a|b.h5", "line\nbreak.h5", " space.h5"])
def test_paths_that_xdmf_cannot_hold(tmp_path, name):
    synthetic.trajectory(n_frames=2).write(tmp_path / name)
    assert_refused("XDMF cannot refer to the path .*; rename it", write_xdmf, tmp_path / name, tmp_path / "t.xdmf")
    assert not (tmp_path / "t.xdmf").exists()


def with_fields(n_frames: int = 3):
    """Return a run with two bodies of cells, and their fields."""
    run, fields = synthetic.trajectory(n_frames=n_frames), {}
    meshes = {"bar": rectangle_mesh("quad8", (2, 1), (1.0, 0.5))}
    meshes["block"] = box_mesh("hexahedron20", (1, 1, 1), (1.0, 1.0, 1.0))
    for body, mesh in meshes.items():
        places = np.array([mesh.nodes + shift for shift in range(n_frames)])
        inner = places[:, mesh.cells].mean(axis=2)[..., 0]
        nodal = {"von_mises": places[..., 0] ** 2}
        fields[body] = BodyField(
            mesh.kind, mesh.nodes, mesh.cells, places, 0.1 * places, nodal, {"von_mises": inner}, {"von_mises": "Pa"}
        )
    return replace(run, fields=fields), fields


def test_bodies_are_series_beside_that_of_the_mechanism(tmp_path):
    """Readers that do not know this program find times, cells, places and values of every kind of cell."""
    run, fields = with_fields()
    run.write(tmp_path / "t.h5")
    assert write_xdmf(tmp_path / "t.h5", tmp_path / "t.xdmf") == 3
    domain = ElementTree.parse(tmp_path / "t.xdmf").getroot().find("Domain")
    assert [grid.get("Name") for grid in domain.findall("Grid")] == ["mechanism", "bar", "block"]
    import pyvista  # a second of every process that looks for tests

    reader = pyvista.get_reader(tmp_path / "t.xdmf")
    assert reader.time_values == list(run.frames.time)
    reader.set_active_time_value(run.frames.time[-1])
    of_vtk = reader.read()
    assert of_vtk.keys() == ["mechanism", "bar", "block"]
    for body, field in fields.items():
        mesh, d = last_grid(tmp_path / "t.xdmf", body), field.nodes.shape[1]
        assert mesh.cells[0].type == field.kind
        np.testing.assert_array_equal(mesh.cells[0].data, field.cells)
        np.testing.assert_array_equal(mesh.point_data["displacement"][:, :d], field.displacement[-1])
        np.testing.assert_array_equal(mesh.point_data["deformation"][:, :d], field.deformation[-1])
        np.testing.assert_array_equal(mesh.cell_data["von_mises"][0], field.at_cells["von_mises"][-1])
        np.testing.assert_array_equal(of_vtk[body].cell_data["von_mises"], field.at_cells["von_mises"][-1])
        for read in (mesh, of_vtk[body]):
            np.testing.assert_array_equal(read.points[:, :d], field.positions[-1])
            np.testing.assert_array_equal(read.point_data["von_mises"], field.at_nodes["von_mises"][-1])
