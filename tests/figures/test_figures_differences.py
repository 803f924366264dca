"""Results in one picture are told apart, those of different scenes never share one, and what is left out is said."""

import resource
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import synthetic
from pictures import assert_inside, keys_of, legend_texts, texts, visible, written

from pgmp_petsc.base.errors import InputError, RunError, note, warning
from pgmp_petsc.figures.captions import same_case, short_names, tell_apart
from pgmp_petsc.figures.collection import draw
from pgmp_petsc.figures.ensembles import densities
from pgmp_petsc.figures.frequencies import coordinate_path, frequencies
from pgmp_petsc.figures.mechanism import is_followed, mechanism
from pgmp_petsc.figures.style import distinct_colours
from pgmp_petsc.figures.trajectories import Comparison, energies, labels_of, paired, trajectories
from pgmp_petsc.files.hdf5 import RunRecord
from pgmp_petsc.results import Balance, Frames, Trajectory
from scenes import tables

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
    rigid = replace(synthetic.modes_table(), full_hz=np.empty((200, 0)), reduced_hz=None)
    with pytest.raises(InputError, match="every body is rigid"):
        draw(written(tmp_path / "rigid", rigid), tmp_path / "out")
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


@contextmanager
def full_disk(n_bytes: int) -> Iterator[None]:
    """Let no file grow beyond a size: to a process, that is a full disk."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (n_bytes, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)


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
