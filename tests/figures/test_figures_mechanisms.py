"""Pictures of what mechanisms of any kind add: balances of energy, two coordinates, rigid bodies, the portraits."""

from dataclasses import replace

import numpy as np
import pytest
import synthetic
from conftest import ROOT
from pictures import assert_inside, legend_texts, visible, written

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.figures.collection import draw
from pgmp_petsc.figures.frequencies import coordinate_path, frequency_maps
from pgmp_petsc.figures.mechanism import Shapes, mechanism
from pgmp_petsc.figures.trajectories import DECADES, energies
from pgmp_petsc.results import Balance, Frames
from scenes import tables
from scripts import portraits

# what numpy and matplotlib warn of is a picture that is not right
pytestmark = pytest.mark.filterwarnings("error:::pgmp_petsc", "error::RuntimeWarning")

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
    """Return a run over two coordinates."""
    run = synthetic.trajectory(n_frames=3)
    return replace(
        run, coordinates=np.column_stack([run.coordinates[:, 0], np.sin(run.time)]), coordinate_units=PLANE,
        record=replace(run.record, scene_toml=RANGES),
    )  # fmt: skip


def half_rigid():
    """Return a run whose crank is rigid."""
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


REFUSED = [
    (lambda: energies(synthetic.trajectory()), "holds no energies"),
    (lambda: frequency_maps(synthetic.modes_table()), "two coordinates, the table has 1"),
    (lambda: coordinate_path(synthetic.trajectory()), "two coordinates, the run has 1"),
    (
        lambda: portraits.portrait(synthetic.trajectory(n_frames=0), portraits.Portrait("", "crank_angle")),
        "no frames or no",
    ),
    (lambda: portraits.portrait(half_rigid(), portraits.Portrait("", "no_such")), "no frames or no output"),
]


@pytest.mark.parametrize(("picture", "said"), REFUSED)
def test_what_cannot_be_drawn_is_refused(picture, said):
    with pytest.raises(InputError, match=said):
        picture()


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
