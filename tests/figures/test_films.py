"""Pictures of surfaces and films: bodies are where they are said to be, in the colours of their values."""

import ctypes
import sys
from collections.abc import Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import imageio_ffmpeg
import matplotlib
import numpy as np
import pytest
import synthetic
from click.testing import CliRunner, Result
from fielded import block_run, flat_run, rod_run
from mpi4py import MPI
from pictures import legend_texts
from PIL import Image
from refusals import assert_refused
from runs import reduced_model, rom_of

from pgmp_petsc.base.errors import InputError, Remark
from pgmp_petsc.cli.declared import Session
from pgmp_petsc.cli.main import COMMANDS, load
from pgmp_petsc.figures.collection import draw
from pgmp_petsc.figures.motion import motion_of, scale_of, vibration_of
from pgmp_petsc.figures.solids import Pace, Stage, Surround, drawing, solids, view_of
from pgmp_petsc.files.claims import check_output
from pgmp_petsc.studies.field_frames import mode_shape
from scenes import slider_crank

WIDE, HIGH = 240, 160


def coloured(picture: np.ndarray) -> np.ndarray:
    """Return where a picture is neither white nor grey, (height, width)."""
    return np.ptp(picture.astype(int), axis=2) > 40


def command(*arguments: object) -> Result:
    """Run ``pgmp animate`` in this process."""
    return CliRunner().invoke(load(COMMANDS["animate"]), [str(word) for word in arguments], obj=Session(MPI.COMM_SELF))


def refused(*arguments: object) -> str:
    done = command(*arguments)
    assert isinstance(done.exception, InputError), done
    return str(done.exception)


def test_what_is_drawn_of_a_run() -> None:
    run = flat_run()
    motion = motion_of(run, scale=100.0)
    (skin,) = motion.skins
    own = run.fields["bar"]
    np.testing.assert_allclose(skin.points[..., :2], own.positions + 99.0 * own.deformation, rtol=1e-15)
    assert motion.quantity == "von Mises stress (MPa)" and motion.largest == pytest.approx(3.0) and motion.peak == 3
    assert "deformation enlarged 100 times" in motion.title and motion.captions[1] == "t = 0.3333 s"
    plain = motion_of(run, "none", 1.0)
    assert plain.skins[0].values is None and not plain.quantity and "enlarged" not in plain.title
    assert motion_of(run, "displacement").largest == pytest.approx(1.0)
    assert motion_of(run, "deformation").quantity == "deformation (mm)"


def test_stresses_of_modes_alone_are_said() -> None:
    run = flat_run()
    reduced = replace(run, model="reduced")
    assert not any("modes alone" in note for note in motion_of(run).notes)
    (said,) = motion_of(reduced).notes
    assert said.startswith("stresses of the modes alone, without the static answers to loads and inertia forces")
    answered = f"{run.record.scene_toml}[reduction]\nstatic_modes = true\n"
    reduced = replace(reduced, record=replace(run.record, scene_toml=answered))
    assert "answers to inertia forces (reduction.inertia_modes)" in motion_of(reduced).notes[0]
    both = replace(run.record, scene_toml=f"{answered}inertia_modes = true\n")
    assert motion_of(replace(reduced, record=both)).notes == []
    assert motion_of(replace(run, model="reduced"), "deformation").notes == []


@pytest.mark.parametrize(("deformation", "scale"), [(1e-4, 1000.0), (3.1e-4, 200.0), (0.5, 1.0), (0.0, 1.0)])
def test_the_scale_is_round_and_shows_a_twentieth(deformation: float, scale: float) -> None:
    """The bar and its way are 2 m long: 0.1 m is shown at most."""
    assert scale_of(flat_run(deformation).fields) == scale


def test_a_run_without_what_is_asked_for() -> None:
    run = synthetic.trajectory(n_frames=4)
    assert_refused("nothing of this run is known in von Mises stress", motion_of, run)
    assert "drawn as lines" in motion_of(run, "none").notes[0]
    assert_refused("no frames to draw", motion_of, synthetic.trajectory(n_frames=0))
    assert_refused("--at 7: outside the run, which goes from 0 to 1 s", solids, flat_run(), 7.0)


def test_a_flat_body_is_where_it_is_in_its_colours() -> None:
    with closing(Stage(motion_of(flat_run(), scale=1.0), WIDE, HIGH)) as stage:
        first, last = stage.picture(0), stage.picture(3)
        metre = stage.metre
    rows, columns = np.nonzero(coloured(last))
    # a bar of 1 m by 0.2 m, without the lines around it
    assert np.ptp(columns) == pytest.approx(metre, abs=4) and np.ptp(rows) == pytest.approx(0.2 * metre, abs=4)
    # it moved to the right by its length
    moved = columns.min() - np.nonzero(coloured(first))[1].min()
    assert moved == pytest.approx(metre, abs=4)
    # nothing is stressed at first; at the end stress grows from the left to the right
    colours = 255.0 * matplotlib.colormaps["viridis"](np.array([0.0, 0.5, 0.93]))[:, :3]
    middle = rows.mean().astype(int) - 2
    at = [columns.min() + round(share * np.ptp(columns)) for share in (0.03, 0.5, 0.93)]
    np.testing.assert_allclose(last[middle, at], colours, atol=16)
    np.testing.assert_allclose(first[coloured(first)].mean(axis=0), colours[0], atol=25)


def test_a_solid_is_lit_and_a_rigid_one_grey() -> None:
    motion = motion_of(block_run(), scale=1.0)
    assert [skin.values is None for skin in motion.skins] == [False, True]
    with closing(Stage(motion, WIDE, HIGH)) as stage:
        picture = stage.picture(3)
    shown = coloured(picture)
    grey = (np.ptp(picture.astype(int), axis=2) < 25) & (picture.max(axis=2) < 235)
    assert shown.sum() > 0.03 * shown.size and grey.sum() > 0.03 * shown.size
    assert np.nonzero(shown)[1].mean() < np.nonzero(grey)[1].mean()
    # nothing touches the edge: the camera sees all
    edge = np.concatenate([picture[0], picture[-1], picture[:, 0], picture[:, -1]])
    assert (edge == 255).all()


def test_what_acts_between_points_is_no_body_without_colours() -> None:
    run = rod_run(0.0)
    spring = '[bodies.rod.line]\nlength = 1.0\nelements = 5\n[effects.gas]\npoints = ["rod:tip", "ground:origin"]\n'
    held = replace(run, record=replace(run.record, scene_toml=spring))
    assert legend_texts(Surround(motion_of(run), "").figure) == []
    assert legend_texts(Surround(motion_of(held), "").figure) == ["acts between two points"]


def test_beams_are_tubes_of_their_section() -> None:
    motion = motion_of(rod_run(2e6, radius=0.05))
    assert motion.largest == pytest.approx(2.0) and "outermost fibres" in motion.notes[-1]
    with closing(Stage(motion, WIDE, HIGH)) as stage:
        shown = coloured(stage.picture(0))
    assert np.ptp(np.nonzero(shown)[0]) == pytest.approx(0.1 * stage.metre, abs=5)


@pytest.mark.parametrize("thin", [0, 1, 2])
def test_a_mechanism_in_space_is_seen_across_its_least_extent(thin: int) -> None:
    points = np.array([[1.0, 1.0, 1.0], [-1.0, -1.0, -1.0]])
    points[:, thin] *= 0.1
    view = view_of(points, False)
    np.testing.assert_allclose(view @ view.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(view) == pytest.approx(1.0) and np.argmax(np.abs(view[2])) == thin


def test_pictures_of_a_run_with_solids(tmp_path: Path) -> None:
    block_run().write(tmp_path / "run.h5")
    lines = draw([tmp_path / "run.h5"], tmp_path / "pictures")
    assert str(tmp_path / "pictures" / "solids.png") in lines
    with Image.open(tmp_path / "pictures" / "solids.png") as image:
        assert coloured(np.asarray(image.convert("RGB"))).mean() > 0.03
    assert_refused("--at 7: outside the run, which goes from 0 to 1 s", draw, [tmp_path / "run.h5"], tmp_path, at=7.0)
    figure = solids(block_run(), 0.3)
    assert figure.axes[0].get_xlabel() == "t = 0.3333 s" and figure.axes[1].get_ylabel() == "von Mises stress (MPa)"


def test_films(tmp_path: Path) -> None:
    """A GIF and an MP4 of the same run: their pictures are those of its frames, all of one size."""
    flat_run().write(tmp_path / "run.h5")
    for name in ("film.gif", "film.mp4"):
        done = command(tmp_path / "run.h5", "-o", tmp_path / name, "--fps", 10)
        assert done.exit_code == 0 and "4 pictures, 0.4 s, deformation enlarged 1000 times" in done.output, done
        assert check_output(tmp_path / name, "film") == tmp_path / name, "ours to replace"
    with Image.open(tmp_path / "film.gif") as gif:
        assert gif.n_frames == 4 and gif.info["duration"] == 100
        pictures = []
        for number in range(4):
            gif.seek(number)
            pictures.append(np.asarray(gif.convert("RGB")))
    moved = [np.nonzero(coloured(picture)[:, : picture.shape[1] * 4 // 5])[1].max() for picture in pictures[:3]]
    assert moved == sorted(moved) and moved[2] > moved[0] + 50
    reader = imageio_ffmpeg.read_frames(str(tmp_path / "film.mp4"))
    about = next(reader)
    frames = [np.frombuffer(frame, np.uint8) for frame in reader]
    assert len(frames) == 4 and about["fps"] == 10 and all(length % 2 == 0 for length in about["size"])
    assert frames[0].std() > 10 and np.abs(frames[3].astype(int) - frames[0]).max() > 100


def test_a_mode_is_drawn_as_large_in_a_scene_in_mm() -> None:
    si = mode_shape(reduced_model(slider_crank("simulation.frames=1")), 1, {"theta": 0.5})
    record = replace(si.record, scene_toml=si.record.scene_toml.replace("[scene]", '[scene]\nunits = "mm"', 1))
    fields = {name: own.converted(record.system.converting) for name, own in si.fields.items()}
    metres, millimetres = (vibration_of(one, "none", None) for one in (si, replace(si, record=record, fields=fields)))
    for one, other in zip(metres.skins, millimetres.skins, strict=True):
        np.testing.assert_allclose(other.points, 1e3 * one.points, rtol=1e-12)


def test_the_film_of_a_mode(tmp_path: Path) -> None:
    """A mode of beams goes to both sides of where it rests."""
    rom_of(slider_crank()).write(tmp_path / "rom.h5")
    done = command(tmp_path / "rom.h5", "--mode", 1, "--at", "theta=0.5", "--seconds", 0.4, "-o", tmp_path / "mode.gif")
    assert done.exit_code == 0 and "8 of 24 instants, 0.4 s" in done.output, done
    with Image.open(tmp_path / "mode.gif") as gif:
        assert gif.n_frames == 7  # two neighbours are the same: one picture for twice the time
        shown = []
        for number in (2, 5):
            gif.seek(number)
            shown.append(coloured(np.asarray(gif.convert("RGB"))))
    assert shown[0].sum() > 100 and (shown[0] != shown[1]).sum() > 100
    for words, message in {
        "--mode 1 --at theta": "--at theta:",
        "--mode 1 --at theta=nan": "--at theta=nan: needed is NAME=VALUE",
        "--mode 1 --at theta=1e9": "--at theta=1e+09: allowed is up to 1e+06 rad",
        "--mode 1 --at theta=1 --at theta=2": "--at theta=2: 'theta' is there twice; give it once",
        "--mode 99": "--mode 99",
        "": "is a reduced model; give --mode K",
    }.items():
        assert message in refused(tmp_path / "rom.h5", *words.split(), "-o", tmp_path / "m.gif")


@pytest.mark.parametrize(
    ("name", "more", "message"),
    [
        ("run.h5", ("-o", "film.avi"), "a film is named .mp4 or .gif"),
        ("run.h5", ("-o", "notes.gif"), "exists and is not a film of this program"),
        ("run.h5", ("-o", "film.gif", "--mode", "1"), "--mode 1: for reduced models"),
        ("run.h5", ("-o", "film.gif", "--at", "theta=0"), "--at: for modes"),
        ("run.h5", ("-o", "film.gif", "--field", "none", "--seconds", "3000"), "a GIF shows one picture for 655 s"),
        ("modes.h5", ("-o", "film.gif", "--mode", "1"), "a table of modes holds frequencies alone"),
        ("none.h5", ("-o", "film.gif"), "none.h5"),
    ],
)
def test_what_cannot_become_a_film(name: str, more: Sequence[str], message: str, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    synthetic.trajectory(n_frames=2, n_times=11).write("run.h5")
    synthetic.modes_table(n_theta=5).write("modes.h5")
    Path("notes.gif").write_text("mine")
    assert message in refused(name, *more)
    assert Path("notes.gif").read_text() == "mine" and not Path("film.gif").exists()


def test_a_warning_of_the_run_is_no_note(tmp_path: Path) -> None:
    run = synthetic.trajectory("reduced", n_frames=3)
    warned = replace(run.record, remarks=(Remark("warning", "the rod bends far"),))
    replace(run, record=warned).write(tmp_path / "run.h5")
    done = command(tmp_path / "run.h5", "-o", tmp_path / "run.gif", "--seconds", 1, "--field", "none")
    assert done.exit_code == 0, done.exception
    said = done.output
    assert "\n  warning: the rod bends far\n" in said and "note: warning" not in said


@pytest.mark.parametrize(
    ("seconds", "numbers", "rate"),
    [(None, [*range(5)], 20.0), (0.15, [0, 2, 4], 20.0), (0.25, [*range(5)], 20.0), (2.5, [*range(5)], 2.0)],
)
def test_the_pace_of_a_film(seconds: float | None, numbers: list[int], rate: float) -> None:
    pace = Pace.of(5, 20.0, seconds)
    assert pace.numbers.tolist() == numbers and pace.rate == pytest.approx(rate)
    assert seconds is None or pace.seconds == pytest.approx(seconds)


def test_without_what_draws_the_cure_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    block_run().write(tmp_path / "run.h5")
    monkeypatch.setitem(sys.modules, "pyvista", None)
    assert_refused(r"pip install 'pyvista<0.47'", drawing)
    lines = draw([tmp_path / "run.h5"], tmp_path / "pictures")
    assert (tmp_path / "pictures" / "mechanism.png").exists()  # what matplotlib draws remains
    assert any(line.startswith("no solids.png: surfaces are drawn by pyvista") for line in lines)


def test_without_a_library_for_drawing_without_a_display_and_what_writes_mp4(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    flat_run().write(tmp_path / "run.h5")
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    said = refused(tmp_path / "run.h5", "-o", tmp_path / "film.mp4")
    assert "pip install imageio-ffmpeg, or name the film .gif" in said and not (tmp_path / "film.mp4").exists()

    def absent(name: str) -> None:
        raise OSError(name)

    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.setattr(ctypes, "CDLL", absent)
    assert_refused("apt-get install libegl1", drawing)
