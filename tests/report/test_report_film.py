"""The film of a page: bodies are where the run has them, in the colours of its stress, with the file's figures."""

import base64
import io
import json
import re
from dataclasses import replace
from pathlib import Path

import h5py
import html5lib
import matplotlib
import numpy as np
import pytest
import synthetic
from fielded import block_run, field_of, flat_run, rod_run, run_of
from PIL import Image
from solids import box_mesh

from pgmp_petsc.figures.motion import coarsened, drawn_faces, motion_of, triangles
from pgmp_petsc.figures.style import scene_of
from pgmp_petsc.report import film as module_of_films
from pgmp_petsc.report.film import SHADES, SIZE, Film, bodies_of
from pgmp_petsc.report.page import film_words, write_report
from pgmp_petsc.report.sources import Source
from pgmp_petsc.results import Trajectory
from pgmp_petsc.results.trajectory import BodyField
from scenes import tables

pytestmark = pytest.mark.filterwarnings("error:::pgmp_petsc", "error::RuntimeWarning")

SCENE = tables("""
scene: name = "block"
parameters.r1: nominal = 5.6e-3; unit = "m"
bodies.bar: element = "solid2d"
""")


def taken(entry: dict, name: str, kind: str) -> np.ndarray:
    return np.frombuffer(base64.b64decode(entry[name]), kind)


def drawn(film: Film, number: int, factor: float = 1.0) -> np.ndarray:
    """Return where the page's script has a body's nodes, shape (n_f, n, 3)."""
    entry, n_frames = film.data["bodies"][number], len(film.data["time"])
    nodes = taken(entry, "nodes", "<f4").reshape(entry["n"], -1)
    motion = taken(entry, "motion", "<f4").reshape(n_frames, 3, -1)
    places = motion[:, None, :, 0] + np.einsum("frk,nk->fnr", motion[:, :, 1:], nodes)
    if "bend" in entry:
        gains = np.full(n_frames, factor)
        gains[entry["as_it_is"]] = 1.0
        bend = taken(entry, "bend", "<i2").reshape(n_frames, entry["n"], -1)
        places[..., : bend.shape[2]] += entry["step"] * gains[:, None, None] * bend
    return places


def on_surface(own: BodyField) -> np.ndarray:
    return np.unique(drawn_faces(own.kind, own.cells))


def test_lines_have_the_shapes_of_the_run() -> None:
    run = synthetic.trajectory("full", n_frames=20)
    film = Film(run, "")
    assert film.data["time"] == run.frames.time.tolist() and film.legend is None and film.still == ""
    assert [body["name"] for body in film.lines] == ["crank", "rod"] == [name for _, _, name in film.keys]
    unit = None
    for number, positions in enumerate(run.frames.positions.values()):
        at, twice = drawn(film, number), drawn(film, number, 2.0)
        length = np.linalg.norm(positions[:, -1] - positions[:, 0], axis=1)
        scale = np.linalg.norm(at[:, -1] - at[:, 0], axis=1)[:, None] / length[:, None]
        unit = scale[0] if unit is None else unit
        np.testing.assert_allclose(scale[:, 0], unit[0], rtol=1e-5)
        # whole numbers of steps are off by half of one, floats by 1e-7 of the picture
        step = film.data["bodies"][number]["step"] + 1e-6 * SIZE
        moved = unit * (positions - positions[:1, :1])
        np.testing.assert_allclose(at[..., 0] - at[:1, :1, 0], moved[..., 0], atol=2 * step)
        np.testing.assert_allclose(at[..., 1] - at[:1, :1, 1], -moved[..., 1], atol=2 * step)
        across = (twice - at)[..., :2]
        assert np.abs(across[:, [0, -1]]).max() < step  # ends stay where they are
        bend = 2e-3 * np.abs(np.sin(12.0 * run.frames.time)).max() * np.sin(np.pi * 0.4)
        assert np.linalg.norm(across, axis=-1).max() == pytest.approx(bend * unit[0], rel=0.02)
    assert film.data["factors"][0] == 1 and len(film.data["factors"]) > 1


SPRING = tables("""
scene: name = "sprung"
ground.points: wall = [0.1, 0.5]
bodies.rod: line = {length = 0.7, elements = 5}
effects.spring: points = ["ground:wall", "rod:2"]
""")


def test_what_acts_between_points_goes_from_the_ground_to_where_a_body_is_moved_to() -> None:
    run = synthetic.trajectory("full", n_frames=20)
    run = replace(run, record=replace(run.record, scene_toml=SPRING))
    film, (_, rod, spring) = Film(run, ""), bodies_of(run)[0]
    assert [body["name"] for body in film.lines] == ["crank", "rod", "spring"]
    np.testing.assert_array_equal(spring.points[:, 0], [[0.1, 0.5, 0.0]] * 20)
    np.testing.assert_array_equal(spring.points[:, 1], rod.points[:, 2])
    np.testing.assert_allclose(spring.deformation[:, 1], rod.deformation[:, 2], atol=1e-15)  # round-off of metres
    assert not spring.deformation[:, 0].any()
    skin = motion_of(run, "none").skins[-1]
    assert skin.name == "spring"
    np.testing.assert_array_equal(skin.points, spring.points)


@pytest.mark.parametrize("run", [flat_run(), block_run()], ids=["plane", "space"])
def test_surfaces_are_where_the_run_has_them(run: Trajectory) -> None:
    film = Film(run, "")
    d = next(iter(run.fields.values())).nodes.shape[1]
    view = None
    for factor in (1.0, 100.0):
        found = np.concatenate([drawn(film, number, factor) for number in range(len(run.fields))], axis=1)
        enlarged = {id(own): own.positions + (factor - 1.0) * own.deformation for own in run.fields.values()}
        wanted = np.concatenate([enlarged[id(own)][:, on_surface(own)] for own in run.fields.values()], axis=1)
        # seen by parallel projection: one linear map for all bodies and frames, the same for both factors
        known = np.column_stack([np.ones(wanted[..., 0].size), wanted.reshape(-1, d)])
        view = np.linalg.lstsq(known, found.reshape(-1, 3), rcond=None)[0] if view is None else view
        steps = 1.0 + sum(factor * entry.get("step", 0.0) for entry in film.data["bodies"])
        np.testing.assert_allclose((known @ view)[:, :2], found.reshape(-1, 3)[:, :2], atol=steps)
    turned = view[1:] / np.linalg.norm(view[1:], axis=1)[:, None]
    # as long and as square as it is, the plane in the picture and space towards the eye
    # but for the depth, which is that of the rigid body: deformations are 1e-4 of its length
    np.testing.assert_allclose(turned @ turned.T, np.eye(d), atol=1e-4)
    low, high = found[..., :2].min(axis=(0, 1)), found[..., :2].max(axis=(0, 1))
    assert (low >= 0).all() and (high <= [film.width, film.height]).all()


def test_shades_are_the_stresses_of_the_file(tmp_path: Path) -> None:
    run = flat_run()
    film = Film(run, "")
    values = run.fields["bar"].at_nodes["von_mises"][:, on_surface(run.fields["bar"])]
    shades = taken(film.data["bodies"][0], "shades", "<u1").reshape(4, -1)
    np.testing.assert_allclose(shades / SHADES * 3e6, values, atol=0.5 / SHADES * 3e6)
    assert film.start == 3 and film.data["stress"] == pytest.approx(values.max(axis=1) / 1e6) and film.keys == []


def test_a_peak_between_frames_is_that_of_an_output() -> None:
    """Frames know 3 MPa at most; an output of the body peaks at 4.33 between two, one of another body higher."""
    run = block_run()
    before = Film(run, "")
    scene = run.record.scene_toml + tables("""
outputs.squeezed: type = "stress"; body = "block"; quantity = "von_mises"
outputs.other: type = "stress"; body = "elsewhere"; quantity = "von_mises"
""")
    squeezed = np.zeros(run.time.size)
    squeezed[1] = 4.33e6
    outputs = run.outputs | {"squeezed": squeezed, "other": 3.0 * squeezed}
    film = Film(replace(run, outputs=outputs, record=replace(run.record, scene_toml=scene)), "run.h5")
    largest = film.legend.largest
    assert (largest.value, largest.path, largest.index) == (4.33e6, "/outputs/squeezed", "1") and largest.text == "4.33"
    assert film.legend.where == f"block at {run.time[1]:.4g} s, of all steps (squeezed)"
    assert film.start == before.start and film.data["stress"] == before.data["stress"]
    shades = [taken(one.data["bodies"][0], "shades", "<u1").max() for one in (film, before)]
    assert shades == [round(SHADES * 3.0 / 4.33), SHADES]


def test_the_legend_has_the_largest_stress_of_the_file(tmp_path: Path) -> None:
    block_run().write(tmp_path / "run.h5")
    write_report([tmp_path / "run.h5"], tmp_path / "report.html")
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    html5lib.HTMLParser(strict=True).parse(page)
    legend = page[page.index('<div class="legend">') :]
    largest = r'<data value="([^"]+)" data-file="run.h5" data-path="([^"]+)" data-index="(\d+)">3</data> MPa'
    found = re.search(largest, legend)
    with h5py.File(tmp_path / "run.h5") as file:
        largest = max(np.max(values[()]) for values in file["fields/block/at_nodes/von_mises"].values())
        assert float(found[1]) == file[found[2]][int(found[3])] == largest
    assert "largest: in block at 1 s, of the 4 frames kept" in legend and "Largest von Mises stress <data" in page
    assert page.count("base, rigid") == 1  # what is grey has a key
    assert "http:" not in page and "https:" not in page
    # the page's tables of numbers are within its content policy
    assert re.search(r'<img alt="[^"]*" src="data:image/png;base64,', page)


def test_without_a_script_a_still_is_there() -> None:
    with Image.open(io.BytesIO(base64.b64decode(Film(flat_run(), "").still.partition(",")[2]))) as image:
        picture = np.asarray(image.convert("RGBA")).astype(int)
    rows, columns = np.nonzero(picture[..., 3] > 128)
    height, width = picture.shape[:2]
    # the bar, five times as long as it is high, at its last place: half the picture but for the margins
    assert np.ptp(columns) == pytest.approx(5 * np.ptp(rows), rel=0.03) and columns.min() > 0.48 * width
    colours = 255.0 * matplotlib.colormaps["viridis"]([0.03, 0.5, 0.93])
    middle = round(rows.mean())
    shown = picture[middle - 3, [columns.min() + round(share * np.ptp(columns)) for share in (0.03, 0.5, 0.93)]]
    np.testing.assert_allclose(shown, colours, atol=12)


def test_the_bar_of_the_scale_is_in_the_unit_of_the_scene() -> None:
    run = flat_run()
    text = run.record.scene_toml.lstrip().replace("[scene]", '[scene]\nunits = "mm"', 1)
    in_mm = replace(run, record=replace(run.record, scene_toml=text))
    for one, metre in ((run, "m"), (in_mm, "mm")):
        film = Film(one, "")
        assert film.data["metre"] == metre and film.data["bar"] == Film(run, "").data["bar"]
    assert film.scale[1].endswith(" mm")


def test_unknown_deformations_and_stresses_are_drawn_as_they_are() -> None:
    own = flat_run(1e-3).fields["bar"]
    bent, stress = own.deformation.copy(), own.at_nodes["von_mises"].copy()
    bent[1], stress[2, 0] = np.nan, np.nan
    film = Film(run_of(bar=replace(own, deformation=bent, at_nodes={"von_mises": stress})), "")
    assert film.data["bodies"][0]["as_it_is"] == [1] and film.data["factors"][-1] > 1
    assert any("not enlarged where the deformation is not known" in note for note in film.notes)
    np.testing.assert_array_equal(drawn(film, 0)[1], drawn(film, 0, 100.0)[1])
    shades = taken(film.data["bodies"][0], "shades", "<u1").reshape(4, -1)
    assert (shades == SHADES + 1).sum() == 1 and shades[2, 0] == SHADES + 1


def test_beams_are_coloured_by_their_fibre_stress() -> None:
    film = Film(rod_run(1.5e6), "run.h5")
    assert film.legend.largest.value == 2e6 and film.legend.largest.path == "" and film.still == ""
    assert any("outermost fibres" in note for note in film.notes)
    (casing, *pieces) = film.lines[0]["paths"]
    assert casing[0] == "casing" and len(pieces) == 5 and pieces[-1][1] == film.legend.stops[-1]
    # both ends of the first piece are pressed by 1.5 MPa
    assert pieces[0][1] == pieces[1][1] == film.legend.stops[round(0.75 * 32)]


def test_solids_without_fields_are_lines_and_the_cure_is_named(tmp_path: Path) -> None:
    runs = synthetic.trajectory("full", n_frames=5), flat_run()
    bare, seen = (replace(run, record=replace(run.record, scene_toml=SCENE)) for run in runs)
    said = "the film draws bar as lines: run.h5 has no displacements and stresses of it; simulate it again with frames"
    assert Film(bare, "run.h5").left_out[0].startswith(said) and Film(seen, "run.h5").left_out == []
    bare.write(tmp_path / "run.h5")
    write_report([tmp_path / "run.h5"], tmp_path / "report.html")
    assert said in (tmp_path / "report.html").read_text(encoding="utf-8")


def test_fewer_frames_keep_that_of_the_largest_stress() -> None:
    """A page with more numbers than it may have: frames are left out, which is said."""
    run = flat_run(cells=(40, 20), n_frames=130)
    own = run.fields["bar"]
    stress = own.at_nodes["von_mises"][::-1].copy()
    stress[77, 5] = 9e6
    run = replace(run, fields={"bar": replace(own, at_nodes={"von_mises": stress})})
    film = Film(run, "")
    shown = len(film.data["time"])
    assert shown < 130 and film.data["time"][film.start] == run.frames.time[77] and film.legend.largest.value == 9e6
    assert film.left_out == [f"the film shows {shown} of 130 frames; the file has all"]
    assert len(json.dumps(film.data)) + len(film.still) < 2.5e6


def test_large_surfaces_are_coarsened(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module_of_films, "MOST_NODES", 120)
    mesh = box_mesh("hexahedron20", (12, 4, 4), (1.0, 0.3, 0.3))
    film = Film(run_of(2, block=field_of(mesh, np.zeros((2, 3)), 1e-4, 3e6)), "")
    entry = film.data["bodies"][0]
    assert 60 < entry["n"] <= 120 and film.left_out[0].startswith(f"the surface of block has {entry['n']} of its ")
    assert taken(entry, "shades", "<u1").max() == SHADES  # the largest one remains
    pieces = triangles(drawn_faces(mesh.kind, mesh.cells))
    used, pieces = np.unique(pieces, return_inverse=True)
    kept, fewer = coarsened(mesh.nodes[used], pieces.reshape(-1, 3), np.zeros(len(used)), 400)
    corners = mesh.nodes[used][kept][fewer]
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum()
    # edges lie within a cube of where they are, whose side is some 0.06 of a height of 0.3
    assert len(kept) <= 400 < len(used) and area == pytest.approx(2 * (0.3 * 0.3 + 2 * 0.3 * 1.0), rel=0.2)


def test_the_film_says_of_which_run_it_is(tmp_path: Path) -> None:
    at = ", at r1 = 6 mm (nominally 5.6 mm)"
    for r1, place, other in ((5.6e-3, "", ", at the nominal parameters"), (6e-3, at, at)):
        run = synthetic.trajectory("full", r1, n_frames=3, n_times=11)
        told = [film_words(Source("run.h5", run, "1", tmp_path), scene_of(run.record), many) for many in (False, True)]
        single = f"{other}: a single run, none of the samples"
        assert told == [f"Full-order model, run.h5{words}" for words in (place, single)]
