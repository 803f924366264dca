"""Pictures: what is drawn is what the data say, and nothing overlaps the edge."""

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import matplotlib
import numpy as np
import pytest
import synthetic
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from pictures import assert_inside, keys_of, legend_texts, looks, texts, visible, written
from refusals import assert_refused
from scipy.stats import expon, norm, uniform
from sealed import resealed
from solids import box_mesh, rectangle_mesh, straightened

from pgmp_petsc.base.errors import note
from pgmp_petsc.figures.collection import draw, draw_result
from pgmp_petsc.figures.ensembles import bands, densities, kernel_density, repeated, sobol
from pgmp_petsc.figures.mechanism import mechanism, shown_positions
from pgmp_petsc.figures.motion import drawn_faces, normals, outlines, triangles
from pgmp_petsc.figures.studies import frequencies, mesh_costs, online_costs, total_costs
from pgmp_petsc.figures.style import labels_by_parameters, save
from pgmp_petsc.figures.trajectories import Comparison, design, fit, paired, sensitivities, trajectories
from pgmp_petsc.mesh.meshes import PLANE_KINDS, SOLID_KINDS
from pgmp_petsc.results import Balance, Derivatives, Ensemble, Tradeoff
from pgmp_petsc.results.gradients import DEVIATION
from pgmp_petsc.results.tradeoff import MeshErrors
from pgmp_petsc.results.trajectory import RESTS
from pgmp_petsc.scene import scene_to_toml
from pgmp_petsc.texts.studies import design_lines, lines_of
from scenes import slider_crank

# what numpy and matplotlib warn of is a picture that is not right
pytestmark = pytest.mark.filterwarnings("error:::pgmp_petsc", "error::RuntimeWarning")

RADII = (5.04e-3, 5.6e-3, 6.16e-3)


def test_frequencies_show_every_table_in_every_panel():
    figure = frequencies([synthetic.modes_table(r1) for r1 in RADII])
    assert len(visible(figure)) == 4
    assert all(len(axes.lines) == 6 for axes in visible(figure))
    assert legend_texts(figure) == ["r1 = 5.04 mm", "r1 = 5.6 mm", "r1 = 6.16 mm", "full order", "reduced"]
    assert_inside(figure)


ALONE = synthetic.trajectory("full", n_frames=0)
FOUR = replace(ALONE, outputs={f"output_{number}": ALONE.time for number in range(4)}, units={})
THREE = replace(synthetic.modes_table(n_theta=12), theta=np.zeros((3, 12)), coordinate_units=dict.fromkeys("xyz", "m"))


def constant(value: float) -> Ensemble:
    """Return an ensemble whose only output does not vary."""
    same = np.full(20, value)
    known = {"crank_angle": synthetic.statistics(same)}
    return replace(synthetic.ensemble("full", 20, n_failed=0), outputs={"crank_angle": same}, statistics=known)


#: Pictures of little, or of more than a row has, and how many panels they have.
FEW = {
    "three modes": (lambda: frequencies([synthetic.modes_table(n_modes=3, reduced=False)]), 3),
    "three coordinates": (lambda: frequencies([THREE]), 4),
    "one mode": (lambda: frequencies([synthetic.modes_table(n_modes=1)]), 1),
    "one run": (lambda: trajectories(paired([ALONE])), 3),
    "four outputs": (lambda: trajectories(paired([FOUR])), 4),
    "one frame": (lambda: mechanism(synthetic.trajectory(n_frames=1)), 2),
    "one sample": (lambda: densities([synthetic.ensemble("reduced", 1, n_failed=0)]), 3),
    "two samples": (lambda: densities([synthetic.ensemble("reduced", 2, n_failed=0)]), 3),
    "thirty samples": (lambda: densities([synthetic.ensemble("reduced", 30, n_failed=0)]), 3),
    "three ensembles": (lambda: densities([synthetic.ensemble("reduced", n) for n in (100, 200, 300)]), None),
    "zeros": (lambda: densities([constant(0.0)]), None),
    "threes": (lambda: densities([constant(3.0)]), None),
    "zeros and threes": (lambda: densities([constant(0.0), constant(3.0)]), None),
}


@pytest.mark.parametrize("name", FEW)
def test_little_is_drawn_within_the_picture(name):
    draw_it, n_panels = FEW[name]
    with np.errstate(divide="raise", invalid="raise"):
        figure = draw_it()
    assert n_panels is None or len(visible(figure)) == n_panels
    assert name != "three modes" or legend_texts(figure) == []
    assert name != "three coordinates" or visible(figure)[-1].get_xlabel() == "configuration"
    assert name != "three ensembles" or len({p.get_edgecolor() for p in figure.legends[0].get_patches()[:3]}) == 3
    assert_inside(figure)


def test_runs_are_paired_by_their_parameters():
    runs = [synthetic.trajectory(model, r1, 0, 50) for model in ("full", "reduced") for r1 in RADII]
    comparisons = paired([*runs, synthetic.trajectory("full", 7e-3, 0, 50)])
    assert [comparison.runs[0].record.parameters["r1"] for comparison in comparisons] == [*RADII, 7e-3]
    assert [len(comparison.runs) for comparison in comparisons] == [2, 2, 2, 1]


def test_pictures_name_the_model_that_reduced_runs_are_compared_with():
    runs = [synthetic.trajectory(model, n_frames=0) for model in ("components", "reduced")]
    figure = trajectories(paired(runs))
    assert legend_texts(figure)[:2] == ["component modes", "reduced"]
    assert all("full" not in text for text in texts(figure))


def test_the_error_is_in_per_cent_of_the_full_order_maximum():
    full, reduced = synthetic.trajectory("full"), synthetic.trajectory("reduced")
    shifted = replace(reduced, outputs={**full.outputs, "crank_angle": full.outputs["crank_angle"] + 0.01})
    time, error = Comparison(full, shifted).error_percent("crank_angle")
    np.testing.assert_allclose(error, 1.0 / np.max(full.outputs["crank_angle"]), rtol=1e-9)
    assert len(time) == len(full.time)
    # a force in a joint is compared after the start, where it hangs on the mesh
    shifted.outputs["crank_angle"][0] = 99.0
    force, formula = "outputs.load={type='joint_force', joint='elbow'}", "{type='formula', formula='2 * load'}"
    for scene, first in (
        (slider_crank("outputs.crank_angle={type='joint_force', joint='elbow'}"), 1),
        (slider_crank(force, f"outputs.crank_angle={formula}"), 1),  # or what is made of it
        (slider_crank("outputs.crank_angle={type='angle', joint='crank_hinge'}"), 0),
    ):
        carried = replace(full, record=replace(full.record, scene_toml=scene_to_toml(scene)))
        assert len(Comparison(carried, shifted).error_percent("crank_angle")[1]) == len(error) - first


def test_the_error_needs_two_runs_and_a_signal():
    full = synthetic.trajectory("full", n_frames=0)
    zero = replace(full, outputs={"crank_angle": np.zeros(1001)})
    assert Comparison(full, None).error_percent("crank_angle") is None
    assert Comparison(zero, synthetic.trajectory("reduced")).error_percent("crank_angle") is None
    # a fixed point: round-off beside a position in the same unit, once "differs by at most 100 %"
    still = replace(full, outputs=full.outputs | {"slider_deformation": np.full(1001, 1e-25)})
    assert Comparison(still, synthetic.trajectory("reduced")).error_percent("slider_deformation") is None
    # and one that no other output of its unit stands beside: round-off of the bodies' lengths, or of a turn
    for name, reduced in (("slider_deformation", synthetic.trajectory("reduced")), ("crank_angle", full)):
        alone = replace(full, outputs={name: np.full(1001, 1e-16)})
        assert Comparison(alone, reduced).error_percent(name) is None


def test_the_error_is_known_only_where_both_runs_are():
    full, reduced = synthetic.trajectory("full"), synthetic.trajectory("reduced")
    outputs = {name: values[:501] for name, values in reduced.outputs.items()}
    short = replace(
        reduced, time=reduced.time[:501], outputs=outputs, coordinates=reduced.coordinates[:501], modal=None
    )
    assert len(Comparison(full, short).error_percent("crank_angle")[0]) == 501
    # the run that stopped is named alone, and how far it was to go
    said = Comparison(full, short).part
    assert "over the first 0.5 s of 1 s" in said and "reduced run stopped" in said and "full" not in said


def test_trajectories_have_a_column_an_output_and_errors_below():
    runs = [synthetic.trajectory(model, r1, 0) for r1 in RADII for model in ("full", "reduced")]
    figure = trajectories(paired(runs))
    assert len(visible(figure)) == 6
    assert [axes.get_title(loc="left") for axes in visible(figure)[:3]] == [
        "crank_angle (rad)", "slider_position (m)", "slider_deformation (mm)",
    ]  # fmt: skip
    assert "at most 3.5 %" in visible(figure)[5].get_title(loc="left")
    assert_inside(figure)


def test_densities_compare_two_ensembles():
    figure = densities([synthetic.ensemble("full", 1000), synthetic.ensemble("reduced", 1000)])
    assert len(visible(figure)) == 6
    assert legend_texts(figure) == [
        "full order, 997 fine of 1000 samples", "reduced, 997 fine of 1000 samples", "mean",
        "a standard deviation of the first to both sides", "[ ]: 95 % interval",
    ]  # fmt: skip
    assert [text for text in texts(figure) if "may bias" in text]
    shown = [text.get_text() for text in visible(figure)[0].texts]
    # parameters of all samples, as in the statistics of the file; outputs of those that are fine
    assert all("N = 1000" in text and "mm" in text for text in shown) and len(shown) == 2
    assert all("N = 997" in text.get_text() for axes in visible(figure)[1:3] for text in axes.texts)
    assert_inside(figure)


@pytest.mark.parametrize("law", [uniform(2.0, 3.0), norm(5.0, 0.1), expon(1.0)], ids=["uniform", "norm", "expon"])
def test_densities_are_those_of_the_law(law):
    """Also at the ends of its range, where kernels alone would fall to half; one in all, whatever it is of."""
    values = law.rvs(40_000, random_state=3)
    places = np.linspace(values.min(), values.max(), 301)
    found = kernel_density(values, places)
    assert np.trapz(found, places) == pytest.approx(1.0, abs=2e-3)
    # kernels of width h smooth the law: h^2 / 2 of its curvature, 0.04 of the largest density here, and chance as much
    assert np.abs(found - law.pdf(places)).max() < 0.15 * law.pdf(places).max()
    assert not kernel_density(np.full(5, 2.0), places).any()
    many = np.append(values, np.zeros(60_000))  # a contact that is open in six of ten samples
    np.testing.assert_allclose(kernel_density(many, places), 0.4 * found, rtol=1e-9)
    (said,) = visible(densities([constant(0.0), constant(3.0)]))[1].texts
    assert said.get_text() == "no density to compare with"
    assert repeated(many) == [(0.0, 0.6)] and not repeated(values) and not repeated(np.full(9, 0.1) + 1e-17)


@pytest.mark.parametrize("shares", [[(0.2, 0.6), (0.2, 0.65)], [(0.1, 0.1, 0.12, 0.1, 0.14, 0.1)] * 2, [(0.3, 0.3)]])
def test_words_at_bars_do_not_lie_on_each_other(shares):
    """Bars of values that come again and again: of several ensembles, and of laws of a few values."""
    samples = [np.repeat(np.linspace(1.0, 1.2, len(own)), (100 * np.array(own)).astype(int)) for own in shares]
    samples = [np.append(own, np.linspace(1.0, 1.2, 100 - len(own))) for own in samples]
    plain = synthetic.ensemble(n_samples=100, n_failed=0)
    found = [
        replace(plain, outputs={"crank_angle": own}, statistics={"crank_angle": synthetic.statistics(own)})
        for own in samples
    ]
    figure = densities(found)
    figure.canvas.draw()
    words = [text for text in visible(figure)[0].texts if " % at " in text.get_text()]
    assert len(words) == sum(map(len, shares))
    boxes = [text.get_window_extent().shrunk(0.98, 0.8) for text in words]
    laid = [(a, b) for k, a in enumerate(boxes) for b in boxes[:k] if a.overlaps(b)]
    assert not laid


def test_brackets_hold_the_intervals_of_the_file():
    ensemble = synthetic.ensemble(n_failed=0)
    figure = densities([ensemble])
    panel = next(axes for axes in visible(figure) if axes.get_title(loc="left") == "crank_angle")
    found, (text,) = ensemble.statistics["crank_angle"], panel.texts
    mean, deviation = text.get_text().split("\n")
    low, high = found.mean_interval
    assert mean == f"mean {found.mean:.3f} [{low:.3f}, {high:.3f}] rad"
    low, high = found.std_interval
    assert deviation == f"deviation {found.std:.3f} [{low:.3f}, {high:.3f}] rad, N = 2000"
    assert "[ ]: 95 % interval" in legend_texts(figure)


@pytest.mark.parametrize("probabilities", [(0.5,), (0.1, 0.9), (0.975, 0.025, 0.5, 0.25, 0.75)])
def test_bands_lie_between_pairs_of_quantiles(probabilities):
    ensemble = synthetic.ensemble("reduced")
    known = {name: synthetic.band(probabilities) for name in ensemble.outputs}
    figure = bands(replace(ensemble, bands=known))
    panels = visible(figure)
    assert len(panels) == 2 and all(len(axes.collections) == len(probabilities) // 2 for axes in panels)
    band = known["crank_angle"]
    np.testing.assert_allclose(panels[0].lines[-1].get_ydata(), band.mean, rtol=1e-12)
    if len(probabilities) > 1:
        outermost = panels[0].collections[0].get_paths()[0].vertices[:, 1]
        assert (outermost.min(), outermost.max()) == (band.quantiles.min(), band.quantiles.max())
    assert_inside(figure)


@pytest.mark.parametrize("total", [False, True])
def test_sobol_indices_are_bars_with_their_intervals(total):
    ensemble = synthetic.ensemble()
    figure = sobol(replace(ensemble, sobol={name: synthetic.sensitivity(total) for name in ensemble.outputs}))
    for axes in visible(figure):
        widths = [bar.get_width() for bar in axes.patches]
        np.testing.assert_allclose(widths, [0.7, 0.2, 0.75, 0.3][: 4 if total else 2])
        assert [text.get_text() for text in axes.get_yticklabels()] == ["r1", "push"]
    assert len(visible(figure)) == 2
    assert_inside(figure)


def test_a_file_of_an_ensemble_has_all_its_pictures(tmp_path, undrawn):
    ensemble = synthetic.ensemble()
    known = {name: synthetic.band((0.1, 0.5, 0.9)) for name in ensemble.outputs}
    indices = {name: synthetic.sensitivity(True) for name in ensemble.outputs}
    paths = written(tmp_path, replace(ensemble, bands=known, sobol=indices), synthetic.ensemble("reduced"))
    lines = draw(paths, tmp_path / "out")
    assert [Path(line).name for line in lines] == ["densities.png", "bands.png", "sobol.png"]


def test_moments_of_a_long_unit_end_within_the_picture():
    ensemble = synthetic.ensemble("reduced", 64)
    figure = densities([replace(ensemble, units=dict.fromkeys(ensemble.units, "N m s/rad"))])
    figure.canvas.draw()
    width = figure.canvas.get_width_height()[0]
    notes = [text for axes in visible(figure) for text in axes.texts]
    assert len(notes) == 3 and all("N m s/rad, N = " in text.get_text() for text in notes)
    assert all(text.get_window_extent(figure.canvas.get_renderer()).x1 <= width for text in notes)


def test_the_mechanism_is_drawn_at_the_asked_instants():
    figure = mechanism(synthetic.trajectory(), n_instants=5)
    assert len(visible(figure)[0].collections) == 5 * 2
    assert_inside(figure)


def test_exaggeration_moves_nodes_between_the_ends_only():
    frames = synthetic.trajectory().frames
    plain, enlarged = frames.positions["rod"], shown_positions(frames, "rod", 10.0)
    np.testing.assert_allclose(enlarged[:, [0, -1]], plain[:, [0, -1]], atol=1e-15)
    rigid = shown_positions(frames, "rod", 0.0)
    np.testing.assert_allclose(enlarged - rigid, 10.0 * (plain - rigid), atol=1e-14)
    # The rod's chord is as long as the rod: half a sine between the ends is all that is left.
    largest = np.max(np.linalg.norm(plain - rigid, axis=-1))
    assert largest == pytest.approx(2e-3 * np.sin(0.4 * np.pi), rel=1e-2)
    np.testing.assert_array_equal(shown_positions(frames, "rod", 1.0), plain)


def test_labels_name_only_what_differs():
    records = [synthetic.record(r1) for r1 in RADII[:2]]
    for record in records:
        record.parameters["r2"] = 1.0
    assert labels_by_parameters(records) == ["r1 = 5.04 mm", "r1 = 5.6 mm"]
    assert labels_by_parameters(records[:1]) == [""]
    without_units = [replace(record, scene_toml="no TOML") for record in records]
    assert labels_by_parameters(without_units)[0] == "r1 = 0.00504"


def test_settings_of_the_process_are_left_alone(tmp_path):
    before = dict(matplotlib.rcParams)
    path = save(frequencies([synthetic.modes_table()]), tmp_path / "f.png")
    assert path.stat().st_size > 10_000
    assert dict(matplotlib.rcParams) == before


def test_files_are_grouped_into_pictures(tmp_path, undrawn):
    runs = synthetic.trajectory("full", n_frames=3), synthetic.trajectory("reduced", n_frames=0)
    many = (synthetic.ensemble(model, 50) for model in ("reduced", "full"))
    paths = written(tmp_path, synthetic.modes_table(), *runs, *many)
    target = tmp_path / "deep" / "pictures"
    names = ["frequencies.png", "trajectories.png", "mechanism.png", "densities.png"]
    assert draw(paths, target) == [str(target / name) for name in names]
    assert sorted(path.name for path in target.iterdir()) == sorted(names)
    lines = draw(paths[2:3], target)
    assert lines[0].endswith("trajectories.png") and "no mechanism.png" in lines[1]
    # options that nothing in the pictures follows
    without = "without effect, as there is no trajectory"
    assert draw(paths[:1], target, 5.0, 0.1)[1:] == [f"--at: {without}", f"--exaggerate: {without}"]
    assert draw(paths[1:2], target, at=0.1)[-1].startswith("--at 0.1: without effect, as no trajectory has bodies")


def test_files_and_folders_that_cannot_be_used(tmp_path, monkeypatch):
    synthetic.modes_table().write(tmp_path / "m.h5")
    assert_refused("does not exist", draw, [tmp_path / "m.h5", tmp_path / "no.h5"], tmp_path / "out")
    assert not (tmp_path / "out").exists(), "a bad file is told before anything is drawn"
    (tmp_path / "taken").write_text("")
    assert_refused("cannot be made", draw, [tmp_path / "m.h5"], tmp_path / "taken")
    monkeypatch.setattr("pgmp_petsc.figures.style.os.access", lambda path, mode: mode == 4)
    assert_refused("no permission to write", draw, [tmp_path / "m.h5"], tmp_path / "out")


def test_sensitivities_show_outputs_and_changes() -> None:
    figure = sensitivities(synthetic.derivatives())
    assert len(visible(figure)) == 4
    assert legend_texts(figure) == ["r1 + 0.56 mm, one standard deviation", "c + 0.0002, 1 % of its value"]
    np.testing.assert_allclose(visible(figure)[1].lines[0].get_ydata(), -300.0 * synthetic.INSTANTS * 0.56e-3)
    assert_inside(figure)


def test_a_fit_shows_what_was_measured_and_what_is_left() -> None:
    figure = fit(synthetic.fitted())
    assert len(visible(figure)) == 4
    assert "fitted, r1 = 6.001 ± 0.005 mm, c = 0.03, not identifiable" in legend_texts(figure)
    np.testing.assert_allclose(visible(figure)[1].lines[0].get_ydata(), 1.0, rtol=1e-9)  # mrad
    assert_inside(figure)


def test_a_design_shows_its_search_and_both_ends() -> None:
    figure = design(synthetic.designed())
    assert len(visible(figure)) == 3
    assert legend_texts(figure) == ["at the start, r1 = 5.6 mm", "design, r1 = 6.2 mm"]
    np.testing.assert_array_equal(visible(figure)[0].lines[0].get_ydata(), [1e-4, 4e-5, 5e-5])
    assert_inside(figure)


def test_energies_of_round_off_and_letters_without_a_font_are_said(tmp_path: Path) -> None:
    run = synthetic.trajectory("full", n_frames=3)
    nothing = Balance(*np.full((3, run.time.size), 1e-50), {})
    rests = note(f"{RESTS}nothing of it moves")
    scene = re.sub(r'name = "\w+"', 'name = "\u6f22\u5b57"', run.record.scene_toml, count=1)
    record = replace(run.record, scene_toml=scene, remarks=(rests,))
    paths = written(tmp_path, replace(run, balance=nothing), replace(run, balance=nothing, record=record))
    assert (tmp_path / "out" / "energies.png").as_posix() in draw(paths[:1], tmp_path / "out")
    lines = draw(paths[1:], tmp_path / "rests")
    assert lines[-2:] == [
        "no energies.png: the mechanism rests, and energies are of round-off alone",
        "the font of pictures has no \u6f22, \u5b57: boxes are in their place",
    ]
    assert not (tmp_path / "rests" / "energies.png").exists()


def test_a_result_is_drawn_into_a_folder(tmp_path: Path) -> None:
    result = synthetic.designed()
    path = Path(draw_result(result, tmp_path / "pictures"))
    assert path.is_file() and path.parent == tmp_path / "pictures"
    (tmp_path / "file").write_text("", encoding="utf-8")
    assert_refused("output directory .* cannot be made", draw_result, result, tmp_path / "file" / "pictures")


def test_the_largest_value_of_a_history_and_its_derivative() -> None:
    largest = list(synthetic.derivatives().figures("slider_deformation"))[1]
    assert largest.time == synthetic.INSTANTS[np.argmax(synthetic.BEND)]
    # a sine's, with itself for derivative, of which the instants miss 8e-4
    assert largest.derivatives[0] == pytest.approx(1e-4, rel=1e-5)


def test_round_off_beside_outputs_is_said_to_be_nothing() -> None:
    one = synthetic.derivatives()
    none = {name: slopes * (1e-14 if name == "c" else 1.0) for name, slopes in one.derivatives["crank_angle"].items()}
    other = replace(one, derivatives=one.derivatives | {"crank_angle": none}, extremes={})
    said, before = ([line for line in lines_of(found) if line.endswith("nothing with c")] for found in (other, one))
    assert (len(said), len(before)) == (5, 3)  # the angle begins with nothing anyway
    small = replace(one, outputs=one.outputs | {"crank_angle": 1e-15 * one.outputs["crank_angle"]}, extremes={})
    assert any(line.split()[:6] == ["crank_angle", "at", "the", "end", "0", "rad"] for line in lines_of(small))


def test_units_of_derivatives_are_written_as_fractions() -> None:
    one = synthetic.derivatives()
    units = one.units | {"r1": "N m/rad"}
    other = Derivatives(one.record, one.time, one.outputs, one.derivatives, units, one.changes, one.correlation)
    assert (one.unit("crank_angle", "r1"), one.unit("crank_angle", "c")) == ("rad/m", "rad")
    assert other.unit("crank_angle", "r1") == "rad/(N m/rad)"


def test_the_deviation_of_a_figure_is_that_of_all_distributions_together() -> None:
    one = synthetic.derivatives()
    both = {"r1": (0.56e-3, DEVIATION), "c": (0.1, DEVIATION)}
    effects = np.array([-300.0 * 0.56e-3, 2.0 * 0.1])
    for coefficient in (0.0, 0.5, -0.9):
        correlation = np.array([[1.0, coefficient], [coefficient, 1.0]])
        found = Derivatives(one.record, one.time, one.outputs, one.derivatives, one.units, both, correlation)
        figure = next(found.figures("crank_angle"))
        expected = np.sqrt(np.sum(effects**2) + 2.0 * coefficient * effects.prod())
        assert found.deviation(figure) == pytest.approx(expected, rel=1e-12)
        assert sum("together" in line for line in lines_of(found)) == 5  # a sine of whole turns ends at 0
    assert not any("together" in line for line in lines_of(one))


def test_derivatives_of_no_scene_are_damaged(tmp_path: Path) -> None:
    synthetic.derivatives().write(path := tmp_path / "s.h5")
    with resealed(path) as file:
        file.attrs["scene"] = "[scene"
    assert_refused("is damaged: its scene is no TOML: ", Derivatives.read, path)


def test_what_is_just_met_is_missed_by_nothing() -> None:
    """Round-off of a constraint at its limit is no figure; a miss is one, and so is room to spare."""
    found = synthetic.designed()
    for value, active, said in (
        (2.082e-17, True, " 0  just met"), (0.1, False, "+0.1  missed"), (-0.05, False, "-0.05  met"),
    ):  # fmt: skip
        constraint = replace(found.constraints[0], value=value, active=active)
        lines = design_lines(replace(found, constraints=(constraint,)))
        (line,) = (line for line in lines if "crank_angle) >=" in line)
        assert said in line


NO_MESHES = MeshErrors(np.zeros(0, dtype=int), np.zeros(0, dtype=int), np.zeros((0, 2)))


def points(figure: Figure, column: int = 0) -> set[tuple[float, float]]:
    """Return the positions of single points in a panel, rounded."""
    lines = (line for line in visible(figure)[column].lines if line.get_linestyle() == "None")
    return {(round(float(x), 9), round(float(y), 9)) for line in lines for x, y in zip(*line.get_data())}


def expected(study: Tradeoff, cost: np.ndarray, column: int) -> set[tuple[float, float]]:
    refined = (study.columns["refinement"] > 1) & np.array([family == "reduced" for family in study.families])
    shown = np.isfinite(study.errors[:, column]) & ~refined
    return {(round(x, 9), round(y, 9)) for x, y in zip(cost[shown], 100 * study.errors[shown, column])}


@pytest.mark.parametrize("column", [0, 1])
def test_online_costs_are_those_of_a_sample_in_a_batch(column: int) -> None:
    study = synthetic.tradeoff()
    figure = online_costs(study)
    assert points(figure, column) == expected(study, 1e3 * study.times.batch, column)
    assert visible(figure)[column].get_xlabel() == "time of a sample, 128 together (ms)"
    assert_inside(figure)


def test_total_costs_count_the_build() -> None:
    study = replace(synthetic.tradeoff(), samples=250)
    figure = total_costs(study)
    assert points(figure, 1) == expected(study, study.total_seconds(250), 1)
    assert visible(figure)[0].get_xlabel() == "time of 250 samples, build included (s)"
    assert_inside(figure)


def test_keys_name_what_is_there() -> None:
    everything = legend_texts(online_costs(synthetic.tradeoff(components=True)))
    assert everything == [
        "the scene as it is", "reduced", "static modes", "component modes", "full order", "full order, more cells",
        "response surface (runs)", "best for the time, reduced", "best for the time, component modes",
        "best for the time, full order", "error of the mesh itself",
    ]  # fmt: skip
    study = synthetic.tradeoff(surfaces=False, refined=False)
    second = np.arange(len(study.families)) == 1
    keys = legend_texts(online_costs(replace(study, columns=study.columns | {"second_order": second})))
    assert "second order, static modes" in keys and "static modes" in keys
    assert "response surface (runs)" not in keys and "full order, more cells" not in keys


def second_order(study: Tradeoff) -> Tradeoff:
    """Return a study in which the scene itself failed, and every setting with static modes is of second order."""
    errors = study.errors.copy()
    errors[0] = np.nan
    return replace(study, errors=errors, columns=study.columns | {"second_order": study.columns["static_modes"]})


@pytest.mark.parametrize("picture", [online_costs, total_costs])
@pytest.mark.parametrize(
    "study",
    [
        synthetic.tradeoff(), synthetic.tradeoff(components=True), synthetic.tradeoff(surfaces=False, refined=False),
        second_order(synthetic.tradeoff()), replace(synthetic.tradeoff(), errors=np.full((11, 2), np.nan)),
    ],
    ids=["all kinds", "component modes", "few kinds", "second order", "all failed"],
)  # fmt: skip
def test_every_mark_has_a_key_and_every_key_a_mark(study: Tradeoff, picture: Callable[[Tradeoff], Figure]) -> None:
    figure = picture(study)
    keys = [key for key in keys_of(figure) if isinstance(key, Line2D)]
    drawn = [line for axes in visible(figure) for line in axes.lines]
    # points and the lines between them are two artists in the panels, one in the keys
    marks = {(colour, marker, face) for colour, _, marker, face in looks(drawn) if marker != "None"}
    assert marks == {(colour, marker, face) for colour, _, marker, face in looks(keys) if marker != "None"}
    lines = {(colour, line) for colour, line, *_ in looks(line for line in drawn if len(line.get_xdata()) > 1)}
    assert lines == {(colour, line) for colour, line, *_ in looks(keys) if line != "None"}


def test_what_is_below_the_references_own_error_is_shaded() -> None:
    study = synthetic.tradeoff()
    moved = np.array([[1e-9, 0.01], [1.0, 1.0]])
    figure = online_costs(replace(study, references=replace(study.references, moved=moved)))
    assert "reference not settled" in legend_texts(figure)
    assert [len(axes.patches) for axes in visible(figure)] == [0, 1]
    busy = visible(online_costs(replace(study, waiting=3.0)))[0]
    assert busy.get_xlabel().startswith("processor time of a sample")


def test_meshes_have_errors_and_times() -> None:
    study = synthetic.tradeoff()
    errors, costs = visible(mesh_costs(study))
    np.testing.assert_allclose(errors.lines[0].get_data(), [[10, 20], [2e-3, 5e-4]])
    np.testing.assert_allclose(costs.lines[0].get_data(), [[10, 20], [5.0, 8.0]], err_msg="full order, in a batch")
    np.testing.assert_allclose(costs.lines[2].get_data(), [[10, 20], [2.0, 2.0]], err_msg="the same reduced setting")
    assert_inside(mesh_costs(study))


@pytest.mark.parametrize(
    "study",
    [
        synthetic.tradeoff(n_outputs=1, surfaces=False, refined=False),
        replace(synthetic.tradeoff(refined=False), mesh=NO_MESHES),
        replace(synthetic.tradeoff(), errors=np.full((11, 2), np.nan)),
        replace(synthetic.tradeoff(), errors=np.zeros((11, 2))),
    ],
    ids=["one output", "no meshes", "all failed", "no errors"],
)
def test_little_to_draw_is_drawn(study: Tradeoff) -> None:
    for picture in (online_costs, total_costs, mesh_costs):
        assert_inside(picture(study))


def test_studies_are_drawn_one_by_one(tmp_path: Path, undrawn: None) -> None:
    paths = written(tmp_path, *2 * [synthetic.tradeoff()])
    names = ["tradeoff.png", "tradeoff_total.png", "tradeoff_mesh.png"]
    assert draw(paths[:1], tmp_path / "one") == [str(tmp_path / "one" / name) for name in names]
    assert [Path(line).name for line in draw(paths, tmp_path / "two")][::3] == ["tradeoff_1.png", "tradeoff_2.png"]


LENGTHS = (2.0, 1.0, 0.5)


def areas(nodes: np.ndarray, found: np.ndarray) -> np.ndarray:
    """Return the vector areas of triangles, shape (n, 3)."""
    places = np.zeros((len(nodes), 3))
    places[:, : nodes.shape[1]] = nodes
    a, b, c = (places[found[:, k]] for k in range(3))
    return 0.5 * np.cross(b - a, c - a)


def length(nodes: np.ndarray, edges: np.ndarray) -> float:
    return float(np.linalg.norm(nodes[edges[:, 1]] - nodes[edges[:, 0]], axis=1).sum())


@pytest.mark.parametrize("kind", SOLID_KINDS)
def test_the_surface_of_a_box(kind: str) -> None:
    mesh = straightened(box_mesh(kind, (3, 2, 2), LENGTHS))
    faces = drawn_faces(mesh.kind, mesh.cells)
    found = areas(mesh.nodes, triangles(faces))
    x, y, z = LENGTHS
    assert np.linalg.norm(found, axis=1).sum() == pytest.approx(2.0 * (x * y + y * z + z * x), rel=1e-12)
    # closed, and turned outwards: by the divergence of the position it encloses three times the volume
    middles = mesh.nodes[triangles(faces)].mean(axis=1)
    assert np.abs(found.sum(axis=0)).max() < 1e-12
    assert np.sum(middles * found) == pytest.approx(3.0 * x * y * z, rel=1e-12)
    assert np.abs(np.abs(normals(faces, mesh.nodes)).max(axis=1) - 1.0).max() < 1e-12
    assert length(mesh.nodes, outlines(faces, mesh.nodes)) == pytest.approx(4.0 * (x + y + z), rel=1e-12)


@pytest.mark.parametrize("kind", PLANE_KINDS)
def test_cells_in_the_plane(kind: str) -> None:
    mesh = straightened(rectangle_mesh(kind, (3, 2), LENGTHS[:2]))
    faces = drawn_faces(mesh.kind, mesh.cells)
    found = areas(mesh.nodes, triangles(faces))
    assert found[:, 2].min() > 0.0 and found[:, 2].sum() == pytest.approx(2.0, rel=1e-12)
    assert length(mesh.nodes, outlines(faces, mesh.nodes)) == pytest.approx(6.0, rel=1e-12)


def test_nodes_between_corners_are_drawn_where_they_are() -> None:
    """A curved edge has two straight pieces: the area is that of the polygon through all nodes."""
    mesh = rectangle_mesh("quad8", (1, 1), (1.0, 1.0))
    nodes = mesh.nodes.copy()
    top = np.flatnonzero((nodes[:, 1] == 1.0) & (nodes[:, 0] == 0.5))
    nodes[top, 1] += 0.2
    found = areas(nodes, triangles(drawn_faces(mesh.kind, mesh.cells)))
    assert found[:, 2].sum() == pytest.approx(1.0 + 0.5 * 0.2, rel=1e-12)
