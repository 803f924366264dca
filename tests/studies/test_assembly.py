"""The picture of an assembled mechanism: everything has its name, and no name hides another."""

from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT
from matplotlib.text import Annotation
from mpi4py import MPI
from pictures import assert_inside, legend_texts, texts
from runs import one_message, pgmp

from pgmp_petsc.figures.mechanism import assembly
from pgmp_petsc.figures.solids import meshed_part
from pgmp_petsc.mechanism.capabilities import Purpose
from pgmp_petsc.results.selection import Assembly
from pgmp_petsc.studies.field_frames import assembly_of
from pgmp_petsc.studies.inputs import read_scene

SCENES = {
    "plane": "slider_crank", "close points": "crank_press", "many bodies": "platform_3rrr", "space": "six_joint_arm",
    "solids": "spatial_mixed",
}  # fmt: skip


def assembled(name: str, *overrides: str) -> Assembly:
    return assembly_of(*read_scene(ROOT / "scenes" / f"{name}.toml", overrides, (), MPI.COMM_SELF, Purpose.CHECK))


@pytest.mark.parametrize("name", SCENES.values(), ids=SCENES.keys())
def test_everything_has_its_name_and_none_hides_another(name: str) -> None:
    shown = assembled(name)
    figure = assembly(shown)
    assert_inside(figure)
    notes = [item for item in figure.axes[0].texts if isinstance(item, Annotation)]
    written = {word for note in notes for line in note.get_text().splitlines() for word in line.split(", ")}
    named = {point for point in shown.points if point != "ground:origin"}
    assert written >= {*shown.frames.nodes, *shown.joints, *named}
    renderer = figure.canvas.get_renderer()
    boxes = [super(Annotation, note).get_window_extent(renderer) for note in notes]
    marks = [figure.axes[0].transData.transform(note.xy) for note in notes if note.get_text() not in shown.frames.nodes]
    assert not any(box.contains(*mark) for box in boxes for mark in marks)
    for number, box in enumerate(boxes):
        for other in boxes[:number]:
            apart = box.x0 >= other.x1 or other.x0 >= box.x1 or box.y0 >= other.y1 or other.y0 >= box.y1
            assert apart, [note.get_text() for note in notes]


def test_bodies_stand_where_their_joints_hold_them() -> None:
    shown = assembled("slider_crank", "simulation.initial.theta.position=0.5")
    crank, rod = (shown.frames.positions[body][0] for body in ("crank", "rod"))
    elbow = 0.3 * np.array([np.cos(0.5), np.sin(0.5)])
    slider = np.array([elbow[0] + np.sqrt(0.7**2 - elbow[1] ** 2), 0.0])
    # the loop is closed to round-off of metres
    for found, wanted in ((crank[0], [0.0, 0.0]), (crank[-1], elbow), (rod[0], elbow), (rod[-1], slider)):
        np.testing.assert_allclose(found, wanted, atol=1e-9)
    np.testing.assert_allclose(shown.joints["slider"], slider, atol=1e-9)  # of what slides the point that moves
    np.testing.assert_allclose(shown.points["rod:tip"], slider, atol=1e-9)
    assert texts(assembly(shown))[0] == "slider_crank: assembled at theta = 0.5 rad"


def test_what_acts_between_points_is_drawn_with_its_name() -> None:
    """A spring to the ground and a point that only it names; a rope, which a force pulls."""
    spring = 'effects.stay={type="spring_damper",points=["ground:origin","rod:3"],stiffness=10.0,rest=0.5}'
    rope = 'effects.rope={type="force",point="rod:tip",towards="ground:origin",table=[[0.0,0.0],[1.0,1.0]]}'
    shown = assembled("slider_crank", spring, rope)
    assert {*shown.spans} == {"stay", "rope"}
    np.testing.assert_allclose(shown.spans["stay"][1], shown.frames.positions["rod"][0, 3], atol=1e-12)
    np.testing.assert_allclose(shown.spans["rope"], [shown.points["rod:tip"], [0.0, 0.0]], atol=1e-12)
    figure = assembly(shown)
    assert {"stay", "rope"} <= {note.get_text() for note in figure.axes[0].texts}
    assert "acts between two points" in legend_texts(figure)


def test_too_many_points_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pgmp_petsc.figures.mechanism.MOST_POINTS", 1)
    lines = texts(assembly(assembled("crank_press")))
    assert any("more names of points are left out" in line for line in lines)


@pytest.mark.parametrize("scene", ["slider_crank_solid2d", "slider_crank_solid3d"])
def test_parts_of_cells_are_drawn_with_their_named_faces(scene: str, tmp_path: Path) -> None:
    """Every named face has its colour, and its name beside it."""
    out = pgmp("check", ROOT / "scenes" / f"{scene}.toml", "--plot", tmp_path / "m.png").stdout
    for body in ("crank", "rod"):
        assert f"  faces         {tmp_path / f'm_{body}.png'}" in out
        assert (tmp_path / f"m_{body}.png").read_bytes().startswith(b"\x89PNG")
    assert f"  picture       {tmp_path / 'm.png'}" in out and (tmp_path / "m.png").read_bytes().startswith(b"\x89PNG")
    refused = one_message("check", ROOT / "scenes" / f"{scene}.toml", "--plot", tmp_path / "mechanism.pdf")
    assert "a picture is written as PNG" in refused
    meshes = read_scene(ROOT / "scenes" / f"{scene}.toml", (), (), MPI.COMM_SELF, Purpose.CHECK)[1]
    figure = meshed_part(meshes["rod"], "rod", "m")
    figure.canvas.draw()
    (axes,) = figure.axes
    colours = {text.get_text(): text.get_color() for text in axes.texts}
    assert colours.keys() == {"hinge", "tip"} and len(set(colours.values())) == 2
    cells, *edges = axes.collections
    if scene.endswith("2d"):
        assert len(cells.get_paths()) == len(meshes["rod"].cells) and len(edges) == 2
    else:  # of the faces on the surface those that are no steel
        found = np.array(cells.get_facecolor())[:, :3]
        grey = np.ptp(found / found.max(axis=1, keepdims=True), axis=1) < 0.1
        assert np.count_nonzero(~grey) == sum(len(faces) for faces in meshes["rod"].groups.values())
