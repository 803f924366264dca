"""Pictures tell results apart and say what is left out; of energies, two coordinates, rigid bodies, and portraits."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import synthetic
from conftest import ROOT
from pictures import assert_inside, keys_of, legend_texts, texts, visible, written
from refusals import assert_refused, full_disk

from pgmp_petsc.base.errors import InputError, RunError, note, warning
from pgmp_petsc.figures.collection import draw
from pgmp_petsc.figures.ensembles import densities
from pgmp_petsc.figures.mechanism import Shapes, is_followed, mechanism, without_span
from pgmp_petsc.figures.motion import motion_of
from pgmp_petsc.figures.studies import coordinate_path, frequencies, frequency_maps
from pgmp_petsc.figures.style import distinct_colours, same_case, short_names, tell_apart
from pgmp_petsc.figures.trajectories import DECADES, Comparison, energies, labels_of, paired, trajectories
from pgmp_petsc.files.hdf5 import RunRecord
from pgmp_petsc.report import film
from pgmp_petsc.results import Balance, Frames, Trajectory
from scenes import tables
from scripts import portraits

pytestmark = pytest.mark.filterwarnings("error:::pgmp_petsc", "error::RuntimeWarning")

SCENE = tables("""
scene: name = "{name}"
parameters.r1: nominal = 5.6e-3; unit = "m"
materials.steel: E = {E}
reduction: modes = {modes}
simulation: duration = {duration}; step = {step}; frames = {frames}
simulation.initial.theta: velocity = {velocity}
""")
ENTRIES = {"name": "four_bar", "E": 210e9, "modes": 4, "duration": 1.0, "step": 1e-3, "frames": 0, "velocity": 0.0}


def record(r1: float = 5.6e-3, seed: int | None = None, more: str = "", **entries: object) -> RunRecord:
    """Return a record whose scene has other entries."""
    return RunRecord(SCENE.format(**{**ENTRIES, **entries}) + more, {"r1": r1}, seed, 1)


def run(model: str = "reduced", of: RunRecord | None = None) -> Trajectory:
    return replace(synthetic.trajectory(model, n_frames=0, n_times=51), record=of or record())


def cut(whole: Trajectory, n_times: int) -> Trajectory:
    """Return what is left of a run that ended early."""
    outputs = {name: values[:n_times] for name, values in whole.outputs.items()}
    parts = {"time": whole.time[:n_times], "outputs": outputs, "coordinates": whole.coordinates[:n_times]}
    return replace(whole, **parts, modal=None, errors=None)


@pytest.mark.parametrize(
    ("one", "other", "words"),
    [
        (record(r1=5e-3), record(r1=6e-3), ("r1 = 5 mm", "r1 = 6 mm")),
        (record(E=70e9), record(), ("materials.steel.E = 7e+10", "materials.steel.E = 2.1e+11")),
        (record(modes=7), record(), ("reduction.modes = 7", "reduction.modes = 4")),
        (record(velocity=2.0), record(),
         ("simulation.initial.theta.velocity = 2", "simulation.initial.theta.velocity = 0")),
        (record(seed=3), record(), ("seed 3", "seed none")),
        (record(more="[effects.weight]\nkind = 1"), record(), ("with effects", "without effects")),
        # what changes no run is no difference, and then files are named
        (record(frames=5), record(), ("a/run.h5", "b/run.h5")),
        (record(more=f"[other]\nlong = {list(range(40))}"), record(more=f"[other]\nlong = {list(range(41))}"),
         ("other.long = …, a/run.h5", "other.long = …, b/run.h5")),
    ],
)  # fmt: skip
def test_results_are_told_apart(one: RunRecord, other: RunRecord, words: tuple[str, str]) -> None:
    assert tuple(tell_apart([one, other], files=[Path("a/run.h5"), Path("b/run.h5")])) == words


def test_one_result_needs_no_words_and_models_are_told() -> None:
    assert tell_apart([record()]) == [""]
    assert tell_apart([record(), record()], ["full order", "reduced"]) == ["full order", "reduced"]
    assert tell_apart([record(), replace(record(), scene_toml="no TOML")]) != ["", ""]
    assert short_names([Path("x/a.h5"), Path("y/b.h5")]) == ["a.h5", "b.h5"]
    many = record(E=1.0, modes=1, step=1.0, velocity=1.0)
    told = tell_apart([many, record()], files=[Path("a"), Path("b")])
    assert [text[-1] for text in told] == ["a", "b"]


def test_runs_of_one_case_differ_in_the_model_and_its_resolution_alone() -> None:
    assert same_case(record(), record(modes=9, step=1e-4, frames=4))
    for other in (record(E=70e9), record(velocity=2.0), record(r1=5e-3), record(more="[effects.weight]\nkind = 1")):
        assert not same_case(record(), other)
    full, finer = run("full"), run("full", record(E=70e9))
    assert [len(comparison.runs) for comparison in paired([full, finer, run()])] == [2, 1]


def test_reduced_runs_share_a_full_order_one() -> None:
    full = run("full")
    comparisons = paired([run(), full, run(of=record(modes=9))])
    assert [comparison.full for comparison in comparisons] == [full, full]
    figure = trajectories(comparisons)
    assert legend_texts(figure) == ["reduction.modes = 4", "reduction.modes = 9", "full order", "reduced"]
    assert len(visible(figure)[0].lines) == 3, "the full-order run is drawn once"
    assert_inside(figure)


def test_scenes_have_pictures_of_their_own(tmp_path: Path, undrawn: None) -> None:
    four, five = record(), record(name="five bar")
    results = [run(of=four), run(of=five), replace(synthetic.modes_table(), record=five)]
    lines = draw(written(tmp_path, *results), tmp_path / "out")
    names = [Path(line).stem for line in lines if line.endswith(".png")]
    assert names == ["trajectories_four_bar", "frequencies_five_bar", "trajectories_five_bar"]
    bodies = [record(more=f"[bodies.{name}]\nmesh = 'm'") for name in ("crank", "rod")]
    lines = draw(written(tmp_path, *(run(of=of) for of in bodies)), tmp_path / "out")
    assert [Path(line).stem for line in lines[:2]] == ["trajectories_four_bar_1", "trajectories_four_bar_2"]


def test_titles_say_what_is_shown_and_of_which_scene() -> None:
    assert texts(trajectories([Comparison(None, run())])) == ["Outputs over time, reduced: four_bar"]
    assert texts(trajectories(paired([run(), run("full")]))) == ["Outputs over time, full order and reduced: four_bar"]
    assert texts(mechanism(synthetic.trajectory()))[0] == "Shape at 14 instants, full order: slider_crank"
    assert texts(frequencies([synthetic.modes_table()])) == ["Eigenfrequencies, full order and reduced: slider_crank"]
    ensemble = synthetic.ensemble(n_samples=9, n_failed=0)
    assert texts(densities([ensemble])) == ["Densities of parameters and outputs at the end: slider_crank"]


def test_a_run_that_ended_early_says_so() -> None:
    figure = trajectories(paired([run("full"), cut(run(), 20)]))
    assert "reduced: ended early, at 0.38 s of 1 s" in texts(figure) and "ended early" in legend_texts(figure)
    assert visible(figure)[0].get_xlim() == (0.0, 1.0)
    assert_inside(figure)
    alone = trajectories(paired([cut(run(), 1)]))
    assert "ended early, at 0 s of 1 s" in texts(alone)
    assert_inside(alone)


def test_every_picture_of_a_run_of_one_instant_is_drawn_and_paths_end_with_their_run() -> None:
    part, unknown = cut(run(), 1), synthetic.SCENE
    for toml in (part.record.scene_toml, unknown):
        short = replace(part, record=replace(part.record, scene_toml=toml))
        assert_inside(energies(replace(short, balance=Balance(*(np.zeros(1) for _ in range(3)), {}))))
        plane = replace(short, coordinates=np.ones((1, 2)), coordinate_units={"a": "rad", "b": "rad"})
        assert_inside(coordinate_path(plane))
        assert_inside(trajectories(paired([short])))
    whole = synthetic.trajectory(n_frames=0, n_times=999)
    plane = np.column_stack([whole.time, whole.time])
    figure = coordinate_path(replace(whole, coordinates=plane, coordinate_units={"a": "rad", "b": "rad"}))
    assert max(line.get_xdata()[0] for line in visible(figure)[0].lines) == whole.time[-1]


def test_paths_of_what_turns_between_two_frames_are_not_drawn() -> None:
    """Twenty frames of a turn are followed, three of one are a tangle; of a few there is no telling."""
    for n_turns, n, followed in ((3, 60, True), (7, 20, False), (3, 4, True)):
        angle = np.linspace(0.0, 2.0 * np.pi * n_turns, n)
        assert is_followed(np.column_stack([np.cos(angle), np.sin(angle)])) == followed


def test_warnings_of_results_are_in_their_pictures() -> None:
    of = replace(record(), remarks=(warning("the step is too long"), note("no estimate"), *map(warning, "abcd")))
    shown = texts(trajectories([Comparison(None, run(of=of))]))
    assert shown[1:] == [
        "warning: the step is too long", "warning: a", "warning: b", "and 2 more warnings: see pgmp info",
    ]  # fmt: skip
    of = replace(of, remarks=of.remarks[:-1])
    assert texts(trajectories([Comparison(None, run(of=of))]))[-1] == "and 1 more warning: see pgmp info"
    long = replace(synthetic.modes_table(), record=replace(record(), remarks=(warning("too long " * 60),)))
    figure = frequencies([long])
    assert "".join(texts(figure)).endswith("…")
    assert_inside(figure)


def test_ensembles_of_one_model_are_told_apart(tmp_path: Path, undrawn: None) -> None:
    one, other = (replace(synthetic.ensemble("reduced", 40, 0), record=record(seed=seed)) for seed in (1, 2))
    assert legend_texts(densities([one, other]))[:2] == ["reduced, 40 samples, seed 1", "reduced, 40 samples, seed 2"]
    few = [dict(values) for values in (other.outputs, other.statistics)]
    for values in few:
        del values["slider_deformation"]
    less = replace(other, outputs=few[0], statistics=few[1])
    lines = draw(written(tmp_path, one, less), tmp_path / "out")
    assert lines[-1] == "densities.png is without slider_deformation: not every file has it"
    figure = densities([synthetic.ensemble("reduced", 1, n_failed=0)])
    assert all("no deviation" in axes.texts[0].get_text() for axes in visible(figure))
    assert not any("standard deviation" in key.get_label() for key in keys_of(figure))


def test_a_picture_that_cannot_be_drawn_leaves_the_others(tmp_path: Path, undrawn: None) -> None:
    ensemble = synthetic.ensemble("full", 20)
    nothing = {name: synthetic.statistics(np.full(20, np.nan)) for name in ensemble.statistics}
    lost = replace(ensemble, status=np.full(20, 2), statistics=nothing)
    lines = draw(written(tmp_path, synthetic.modes_table(), lost), tmp_path / "out")
    assert lines[0].endswith("frequencies.png") and lines[1].startswith("no densities.png: no sample")
    with pytest.raises(InputError, match="no densities.png: no sample of the full ensemble"):
        draw(written(tmp_path / "lost", lost), tmp_path / "out")
    # of many failed samples the parameters are known
    r1 = {"r1": ensemble.statistics["r1"]}
    (drawn,) = visible(densities([replace(ensemble, statistics=nothing | r1)]))
    assert drawn.get_xlabel().startswith("r1")
    rigid = replace(synthetic.modes_table(), full_hz=np.empty((200, 0)), reduced_hz=None)
    assert_refused("every body is rigid", draw, written(tmp_path / "rigid", rigid), tmp_path / "out")
    path = written(tmp_path, synthetic.modes_table())[0]
    lines = draw([path, tmp_path / "." / path.name], tmp_path / "out")
    assert len(lines) == 2 and lines[1].endswith("is given twice and drawn once")


def test_deformations_are_called_enlarged_only_where_they_are() -> None:
    run = synthetic.trajectory(n_frames=4)
    assert "deformation enlarged 20 times" in texts(mechanism(run, exaggeration=20.0))[0]
    frames = run.frames
    away = {name: np.dstack([places, 0.3 * places[..., :1]]) for name, places in frames.positions.items()}
    space = Frames(
        frames.time, away, {name: np.zeros_like(places) for name, places in away.items()},
        {name: np.column_stack([nodes, 0 * nodes[:, 0]]) for name, nodes in frames.nodes.items()}, frames.cells,
    )  # fmt: skip
    figure = mechanism(replace(run, frames=space), exaggeration=20.0)
    title, *notes = texts(figure)
    assert "enlarged" not in title and notes[0].startswith("deformation of crank, rod as it is, not enlarged")
    assert visible(figure)[0].get_xlabel() == "x − 0.45 z (m)"
    rigid = replace(run, frames=replace(frames, rigid=frozenset(frames.nodes)))
    assert texts(mechanism(rigid, exaggeration=20.0)) == ["Shape at 4 instants, full order: slider_crank"]
    assert all(len(set(distinct_colours(n))) == n for n in (1, 7, 8, 60))


def test_a_full_disk_leaves_the_older_picture(tmp_path: Path) -> None:
    paths, out = written(tmp_path, synthetic.modes_table()), tmp_path / "out"
    draw(paths, out)
    before = (out / "frequencies.png").read_bytes()
    with full_disk(4096), pytest.raises(RunError, match=r"frequencies.png' could not be written: File too large"):
        draw(paths, out)
    assert (out / "frequencies.png").read_bytes() == before and len(list(out.iterdir())) == 1


def test_runs_on_two_meshes_are_told_apart_by_their_nodes():
    """A run whose lines `pgmp run` has cut has the scene of the others."""
    runs = synthetic.trajectory("full", n_frames=3), synthetic.trajectory("reduced", n_frames=3)
    finer = replace(runs[0], frames=synthetic.frames(runs[0].frames.time, n_elements=10))
    assert labels_of(paired([*runs, finer])) == ["12 nodes", "full order, 22 nodes"]


# what numpy and matplotlib warn of is a picture that is not right

PLANE = {"left": "rad", "right": "rad"}
RANGES = tables("""
scene: name = "five_bar"
coordinates.left: range = [-1.0, 7.0]
coordinates.right: range = [0.0, 6.283185307179586]; periodic = true
""")


def balanced(strain: float = 1e-3, n_effects: int = 2, residual: float = 1e-7):
    """Return a run with energies: a motor brings them, other effects swing."""
    run = synthetic.trajectory(n_frames=0)
    kinetic = run.time**2
    stored = kinetic + strain * run.time
    swings = {f"effect_{number}": 0.1 * np.sin(number * run.time) for number in range(1, n_effects)}
    motor = {"motor": stored - sum(swings.values()) - residual * run.time} if n_effects else {}
    return replace(run, balance=Balance(kinetic, strain * run.time, 0.0 * kinetic, motor | swings))


def planar_table(n: int = 6, n_modes: int = 3, reduced: float | None = 1.0002):
    """Return frequencies over an n by (n + 1) grid that differ along both coordinates."""
    theta = np.array(np.meshgrid(np.linspace(0, 1, n), np.linspace(2, 4, n + 1), indexing="ij")).reshape(2, -1)
    full = 100.0 * np.arange(1, n_modes + 1) + (theta[0] + 0.1 * theta[1])[:, None]
    return replace(
        synthetic.modes_table(), theta=theta, full_hz=full, coordinate_units=PLANE,
        reduced_hz=None if reduced is None else full * reduced,
    )  # fmt: skip


def planar_run():
    run = synthetic.trajectory(n_frames=3)
    return replace(
        run, coordinates=np.column_stack([run.coordinates[:, 0], np.sin(run.time)]), coordinate_units=PLANE,
        record=replace(run.record, scene_toml=RANGES),
    )  # fmt: skip


def half_rigid():
    run = synthetic.trajectory(n_frames=20)
    return replace(run, frames=replace(run.frames, rigid=frozenset({"crank"})))


def test_energies_have_panels_for_what_is_there():
    figure = energies(balanced())
    titles = [axes.get_title(loc="left") for axes in visible(figure)]
    assert titles[:3] == ["stored energy (J)", "work of the effects (J)", "strain energy (mJ)"]
    assert titles[3].startswith("residual, as a share of the ") and titles[3].endswith("at most 1.0e-07")
    # zero throughout: the potential energy has no line
    assert [len(axes.lines) for axes in visible(figure)] == [1, 2, 1, 1]
    assert_inside(figure)
    assert len(visible(energies(balanced(strain=0.0)))) == 3
    assert len(visible(energies(balanced(strain=0.0, n_effects=0)))) == 2


def test_the_residual_is_drawn_as_it_is():
    run = balanced(residual=1e-5)
    axes = visible(energies(run))[-1]
    np.testing.assert_allclose(axes.lines[0].get_ydata(), np.abs(run.balance.residual[1:]) / run.balance.exchanged)
    bottom, top = axes.get_ylim()
    assert axes.get_yscale() == "log" and np.log10(top / bottom) == pytest.approx(DECADES + np.log10(3.0))
    still = replace(run, balance=Balance(*(np.zeros_like(run.time) for _ in range(3)), {}))
    assert "at most 0.0e+00" in visible(energies(still))[0].get_title(loc="left")


def test_many_effects_are_told_apart():
    figure = energies(balanced(n_effects=11))
    lines = visible(figure)[1].lines
    assert len({(line.get_color(), line.get_linestyle()) for line in lines}) == 11
    assert_inside(figure)


WHOLE, TWENTY = synthetic.trajectory(n_frames=0), synthetic.ensemble("full", 20)
ZERO = replace(TWENTY, parameters={}, outputs={"x": np.zeros(20)}, statistics={"x": synthetic.statistics(np.zeros(20))})
REFUSED = [
    (lambda: trajectories(paired([WHOLE, replace(WHOLE, outputs={"other": WHOLE.time})])), "no output in common"),
    (lambda: densities([TWENTY, ZERO]), "ensembles have nothing in common"),
    (lambda: mechanism(WHOLE), "no frames to draw"),
    (lambda: energies(synthetic.trajectory()), "holds no energies"),
    (lambda: frequency_maps(synthetic.modes_table()), "two coordinates, the table has 1"),
    (lambda: frequencies([planar_table(n_modes=0, reduced=None)]), "no flexible modes"),
    (lambda: coordinate_path(synthetic.trajectory()), "two coordinates, the run has 1"),
    (
        lambda: portraits.portrait(synthetic.trajectory(n_frames=0), portraits.Portrait("", "crank_angle")),
        "no frames or no",
    ),
    (lambda: portraits.portrait(half_rigid(), portraits.Portrait("", "no_such")), "no frames or no output"),
]


@pytest.mark.parametrize(("picture", "said"), REFUSED)
def test_what_cannot_be_drawn_is_refused(picture, said):
    assert_refused(said, picture)


def test_maps_have_the_coordinates_on_their_axes():
    figure = frequency_maps(planar_table())
    panels = [axes for axes in visible(figure) if axes.get_title(loc="left")]
    assert [axes.get_title(loc="left") for axes in panels] == [
        f"flexible mode {mode} (Hz), reduced within 0.02 %" for mode in (1, 2, 3)
    ]
    assert panels[0].get_xlim() == (0.0, 1.0) and panels[0].get_ylim() == (2.0, 4.0)
    assert (panels[2].get_xlabel(), panels[2].get_ylabel()) == ("left (rad)", "right (rad)")
    assert_inside(figure)
    table = planar_table(n_modes=1, reduced=None)
    assert visible(frequency_maps(table))[0].get_title(loc="left") == "flexible mode 1 (Hz)"
    assert_inside(frequency_maps(replace(table, full_hz=np.full_like(table.full_hz, 50.0))))


def test_the_path_shows_the_ranges_that_end():
    figure = coordinate_path(planar_run())
    axes = visible(figure)[0]
    ends = [line.get_xdata()[0] for line in axes.lines if line.get_linestyle() == "--"]
    assert ends == [-1.0, 7.0] and legend_texts(figure) == ["ends of the ranges"]
    assert axes.get_xlim()[0] < -1.0 and axes.get_xlim()[1] > 7.0
    assert_inside(figure)


def test_rigid_bodies_are_hollow():
    figure = mechanism(half_rigid(), n_instants=3)
    axes = visible(figure)[0]
    white = [lines for lines in axes.collections if np.all(lines.get_color() == 1.0)]
    assert len(white) == 3 and len(axes.collections) == 3 * 3
    assert legend_texts(figure) == ["flexible", "rigid"]
    assert legend_texts(mechanism(synthetic.trajectory())) == []
    assert_inside(figure)


def test_a_point_mass_is_a_square_and_pins_at_rest_stand_on_the_ground():
    run = synthetic.trajectory(n_frames=5)
    frames = run.frames
    bob = {
        "positions": frames.positions["rod"][:, -1:], "rotations": frames.rotations["rod"][:, -1:],
        "nodes": np.zeros((1, 2)), "cells": np.empty((0, 2), dtype=int),
    }  # fmt: skip
    with_bob = {name: {**getattr(frames, name), "bob": value} for name, value in bob.items()}
    figure = mechanism(replace(run, frames=replace(frames, **with_bob, rigid=frozenset({"bob"}))), n_instants=4)
    markers = [line.get_marker() for line in visible(figure)[0].lines]
    assert markers.count("s") == 4
    assert sum(not isinstance(marker, str) for marker in markers) == 1  # the crank's hinge alone


SPANS = tables("""
scene: name = "pulled"
ground.points: wall = ["r1", 0.5]
bodies.crank: line = {length = 0.3, elements = 5}
bodies.rod: line = {length = 0.7, elements = 5}
joints.pin: connect = ["ground:origin", "rod:2"]
effects.rope: point = "rod:tip"; towards = "ground:wall"
effects.gas: points = ["crank:1", "rod:hinge"]
""")


def test_pins_within_a_body_are_marked_and_what_acts_between_points_is_dotted():
    """Points of lines by their numbers; of the ground at a parameter's value."""
    run = synthetic.trajectory(n_frames=5)
    run = replace(run, record=replace(run.record, scene_toml=SPANS))
    shapes, rod = Shapes.of(run.frames, record=run.record), run.frames.positions["rod"]
    assert shapes.pins["rod"].tolist() == [0, 2, 5] and shapes.pins["crank"].tolist() == [0, 5]
    rope, gas = shapes.spans
    np.testing.assert_array_equal(rope, [rod[:, 5], [[run.record.parameters["r1"], 0.5]] * 5])
    np.testing.assert_array_equal(gas, [run.frames.positions["crank"][:, 1], rod[:, 0]])
    figure = mechanism(run, n_instants=4)
    assert legend_texts(figure) == ["acts between two points"]
    assert sum(line.is_dashed() for line in visible(figure)[0].lines) == 4 * 2
    assert without_span(run.frames, run.record) == []


def test_what_acts_at_points_of_meshes_is_said_not_to_be_drawn():
    """In pictures, films and the report's film alike."""
    run = synthetic.trajectory(n_frames=5)
    meshed = SPANS.replace("line = {length = 0.3, elements = 5}", 'mesh = "crank.msh"')
    run = replace(run, record=replace(run.record, scene_toml=meshed))
    told = "gas: not drawn, as a run does not say where points of meshes are"
    assert without_span(run.frames, run.record) == [told] and told in motion_of(run, "none").notes
    figure = mechanism(run, n_instants=4)
    assert told in " ".join(" ".join(texts(figure)).split())
    assert sum(line.is_dashed() for line in visible(figure)[0].lines) == 4, "the rope alone"
    assert told in film._notes(run, [], False)


def test_the_first_run_that_has_them_gives_the_pictures(tmp_path, undrawn):
    results = [planar_table(), planar_table(), synthetic.trajectory(n_frames=0), planar_run(), balanced()]
    paths = written(tmp_path, *results)
    # the plane's tables and runs are of other scenes than the rest
    one = ["frequency_maps_1_slider_crank", "frequency_maps_2_slider_crank", "trajectories_slider_crank"]
    names = [*one, "energies_slider_crank", "trajectories_five_bar", "mechanism_five_bar", "coordinate_path_five_bar"]
    lines = draw(paths, tmp_path / "out")
    assert lines[:-1] == [str(tmp_path / "out" / f"{name}.png") for name in names]
    assert lines[-1].startswith("no mechanism_slider_crank.png: no trajectory has frames")


def test_a_portrait_shows_shapes_and_curve():
    run, shown = half_rigid(), portraits.Portrait("Half rigid", "slider_deformation", 10.0, until=0.8, n_instants=5)
    figure = portraits.portrait(run, shown)
    left, right = visible(figure)
    assert right.get_title(loc="left") == "slider_deformation (mm)"
    assert len(right.lines) == 1 + 5 and len(left.collections) == 5 * 3
    assert max(line.get_xdata()[0] for line in right.lines[1:]) <= 0.8
    assert_inside(figure)


def test_shapes_are_spaced_by_the_motion():
    run = synthetic.trajectory(n_frames=1001)
    chosen = portraits.spaced_by_motion(run, 6, None)
    turned = np.abs(np.diff(run.coordinates[chosen, 0]))
    assert len(chosen) == 6 and chosen[0] == 0 and chosen[-1] == 1000
    np.testing.assert_allclose(turned, turned.mean(), rtol=0.05)


def test_the_gallery_is_small_and_complete(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(portraits, "PORTRAITS", {"half_rigid": portraits.Portrait("Half rigid", "crank_angle")})
    half_rigid().write(tmp_path / "half_rigid.h5")
    monkeypatch.setattr("sys.argv", ["gallery", str(tmp_path), str(tmp_path / "images")])
    assert portraits.main() == 0
    assert (tmp_path / "images" / "gallery_half_rigid.png").stat().st_size < 60_000
    monkeypatch.setattr("sys.argv", ["gallery", str(tmp_path / "images"), str(tmp_path)])
    assert portraits.main() == 2 and "does not exist" in capsys.readouterr().err
    monkeypatch.setattr("sys.argv", ["gallery"])
    assert portraits.main() == 2


def test_the_readme_shows_what_the_gallery_draws():
    readme, script = (ROOT / "README.md").read_text(), (ROOT / "scripts" / "gallery").read_text()
    for scene in portraits.PORTRAITS:
        assert f"docs/images/gallery_{scene}.png" in readme and scene in script
        assert (ROOT / "scenes" / f"{scene}.toml").exists()
        assert (ROOT / "docs" / "images" / f"gallery_{scene}.png").stat().st_size < 60_000


def test_machines_that_stand_on_their_ground_are_drawn_standing() -> None:
    """What reaches less along y than along z has z upwards, and y leads into the picture; else z comes out of it."""
    for tall, names in ((1, ("x \N{MINUS SIGN} 0.45 z", "y \N{MINUS SIGN} 0.35 z")), (2, ("x + 0.45 y", "z + 0.35 y"))):
        places = np.array([[0.0, 0.0, 0.0], [0.6, 0.2, 0.2]])
        places[1, tall] = 1.0
        frames = Frames(
            time=np.zeros(1), positions={"mast": places[None]}, rotations={"mast": np.zeros((1, 2, 3))},
            nodes={"mast": places}, cells={"mast": np.array([[0, 1]])}, rigid=frozenset(),
        )  # fmt: skip
        shapes = Shapes.of(frames)
        assert shapes.axis_names == names
        assert shapes.positions["mast"][0, 1, 1] > 0.9
