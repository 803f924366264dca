"""The page of results: its figures are those of the files, it needs no network, and says what is not known."""

import base64
import csv
import io
import json
import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from xml.etree.ElementTree import Element

import h5py
import html5lib
import numpy as np
import pytest
import synthetic
from coupled_scenes import ROTORS
from runs import one_message, trajectory

from pgmp_petsc.base.errors import InputError, note, warning
from pgmp_petsc.ensemble.statistics import describe, quantile_bounds
from pgmp_petsc.figures.collection import draw
from pgmp_petsc.files.hdf5 import write_file
from pgmp_petsc.report import budget, charts
from pgmp_petsc.report.budget import (
    error_budget,
    headline_of_comparison,
    headline_of_ensemble,
    headline_of_meshes,
    headline_of_run,
)
from pgmp_petsc.report.charts import Curve, Level, distribution, output_over_time
from pgmp_petsc.report.page import _commands, _largest_of_units, downloads_of, write_report
from pgmp_petsc.report.sources import Source, read_sources
from pgmp_petsc.results import Attempt, Balance, Ensemble, Selection, Trajectory
from pgmp_petsc.results.ensemble import EXTREMES, OF_TIME_STEP, Joined
from pgmp_petsc.results.estimates import OF_STEP, EstimatedErrors
from pgmp_petsc.results.numbers import one_unit_each
from pgmp_petsc.results.summary import summary_of
from pgmp_petsc.scene import scene_from_toml
from pgmp_petsc.texts.ensemble_table import lines_of
from scenes import tables

# pictures are drawn in the page of all results and where tests are about them
pytestmark = [
    pytest.mark.filterwarnings("error:::pgmp_petsc", "error::RuntimeWarning"), pytest.mark.usefixtures("undrawn"),
]  # fmt: skip

EVENT = tables("""
parameters.push: nominal = 1.0
ensemble.probabilities.late: output = "crank_angle"; above = 5.0; when = "ever"
""")


def parsed(text: str) -> Element:
    """Return the page's tree; raises where the page is not well-formed HTML."""
    return html5lib.HTMLParser(strict=True, namespaceHTMLElements=False).parse(text)


def page_of(*files: Path) -> Element:
    write_report(files, files[0].with_name("page.html"))
    return parsed(files[0].with_name("page.html").read_text(encoding="utf-8"))


def page_with(folder: Path, **results: object) -> Element:
    """Return the tree of the page of some results, which are written into files of their names."""
    for name, result in results.items():
        result.write(folder / f"{name}.h5")
    return page_of(*(folder / f"{name}.h5" for name in results))


def words(element: Element) -> str:
    """Return what is read in an element, with single blanks."""
    return " ".join("".join(element.itertext()).split())


def with_class(tree: Element, name: str) -> Iterator[Element]:
    return (item for item in tree.iter() if isinstance(item.tag, str) and name in item.get("class", "").split())


def stored(folder: Path, item: Element) -> float:
    """Return the number of a file that a figure of the page claims to be."""
    path, _, attribute = item.get("data-path").partition("@")
    with h5py.File(folder / item.get("data-file")) as file:
        if attribute.startswith("parameters/"):
            return json.loads(file.attrs["parameters"])[attribute.partition("/")[2]]
        if attribute:
            return float(file[path].attrs[attribute])
        index = item.get("data-index")
        return float(file[path][tuple(int(k) for k in index.split(","))] if index else file[path][()])


def verdict_of(tree: Element) -> Element:
    return next(with_class(tree, "verdict"))


def shown(tree: Element) -> list[Element]:
    return [item for item in tree.iter("data") if item.get("data-path")]


def assert_stored(folder: Path, tree: Element) -> None:
    for item in shown(tree):
        np.testing.assert_array_equal(float(item.get("value")), stored(folder, item), err_msg=str(item.attrib))


def csv_of(tree: Element, name: str) -> dict[str, list[str]]:
    """Return the columns of a table that the page hands out."""
    link = next(item for item in tree.iter("a") if item.get("download") == name)
    head, *rows = csv.reader(io.StringIO(base64.b64decode(link.get("href").partition("base64,")[2]).decode()))
    return dict(zip(head, zip(*rows)))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a directory with results of one scene, and of another one."""
    folder = tmp_path_factory.mktemp("report")
    run = synthetic.trajectory("reduced")
    stored_energy = np.linspace(0.0, 2.0, run.time.size)
    balance = Balance(stored_energy, 0.01 * stored_energy, 0.0 * stored_energy, {"motor": 1.0099 * stored_energy})
    of_run = replace(run.record, remarks=(warning("the rod bends <far>"), note("nothing else")))
    replace(run, record=of_run, balance=balance, validity={"elastic_rotation": 0.02}).write(folder / "run.h5")
    synthetic.trajectory("full").write(folder / "full.h5")
    synthetic.described().write(folder / "many.h5")
    synthetic.tradeoff().write(folder / "study.h5")
    other = synthetic.SCENE.replace("slider_crank", "x<script>alert(1)</script>")
    replace(run, record=replace(run.record, scene_toml=other), frames=None).write(folder / "other.h5")
    return folder


@pytest.fixture(scope="module")
def page(folder: Path) -> str:
    files = [folder / name for name in ("run.h5", "full.h5", "many.h5", "study.h5")]
    lines = write_report(files, folder / "report.html")
    assert lines[0].startswith(f"{folder / 'report.html'}: 4 files, ") and lines[0].endswith(" MB")
    return (folder / "report.html").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def tree(page: str) -> Element:
    return parsed(page)


def test_every_figure_is_that_of_its_file(folder: Path, tree: Element) -> None:
    paths = {item.get("data-path") for item in shown(tree)}
    kinds = {path.split("/")[1] for path in paths if not path.startswith("@")}
    assert kinds >= {"statistics", "probabilities", "errors", "mesh", "timings", "parameters", "validity"}
    assert_stored(folder, tree)


def with_event(result: Ensemble | Trajectory) -> Ensemble | Trajectory:
    """Return a result of the scene with the event, of an ensemble without what needs more pictures."""
    record = replace(result.record, scene_toml=result.record.scene_toml + EVENT)
    if isinstance(result, Trajectory):
        return replace(result, record=record)
    at_end = {name: found for name, found in result.statistics.items() if "." not in name}
    return replace(result, record=record, statistics=at_end, extremes={}, bands={}, sobol={})


def test_a_mean_of_no_samples_is_not_known(tmp_path: Path) -> None:
    found = synthetic.described()
    last = list(found.outputs)[-1]
    nothing = replace(found.statistics[last], mean=np.nan, mean_interval=np.full(2, np.nan))
    replace(found, probabilities={}, statistics=found.statistics | {last: nothing}).write(tmp_path / "many.h5")
    assert f"; mean {last} is not known" in headline_of_ensemble(tmp_path / "many.h5")


def test_a_probability_within_the_model_error_has_no_figure_in_the_verdict(tmp_path: Path) -> None:
    """The error of the angle is measured against the full-order run, and known to the ensemble in one case."""
    for model in ("reduced", "full"):
        with_event(synthetic.trajectory(model)).write(tmp_path / f"{model}.h5")
    found = with_event(synthetic.described())
    late = found.probabilities["late"]
    assert late.is_decided()
    alone, beside = ("many",), ("reduced", "full", "many")
    for error, limit, names, size, decided in (
        (np.nan, 1e-9, beside, 1.0, False), (np.nan, 10.0, beside, 1.0, True),
        (0.9, 0.8, alone, 1.0, False), (0.7, 0.8, alone, 1.0, True),
        # next to nothing in the runs, but not in samples: a share of it says nothing of theirs
        (1e-10, 1e-9, beside, 1.0, False), (1e-10, 1e-9, beside, 1e3, True),
    ):  # fmt: skip
        chance = replace(late, holds_to=limit, model_error=error)
        outputs = found.outputs | {"crank_angle": size * found.outputs["crank_angle"]}
        replace(found, probabilities={"late": chance}, outputs=outputs).write(tmp_path / "many.h5")
        files = [tmp_path / f"{name}.h5" for name in names]
        verdict = verdict_of(page_of(*files))
        first, second, *_ = [words(item) for item in verdict.iter("p")]
        figures = [item for item in verdict.iter("data") if "probabilities" in (item.get("data-path") or "")]
        assert ("is not decided by this model" in first) == (not decided) == (not figures), first
        assert decided or ("pgmp montecarlo SCENE --full -n 57" in first and "5.26 % [1, 20]" in second)
    # the better run stopped half-way: what it measured is of that half, and nothing else is known
    full = with_event(synthetic.trajectory("full"))
    half = {name: values[:500] for name, values in full.outputs.items()}
    full = replace(full, time=full.time[:500], outputs=half, coordinates=full.coordinates[:500])
    full.write(tmp_path / "full.h5")
    with_event(replace(synthetic.trajectory("reduced"), errors=None)).write(tmp_path / "reduced.h5")
    runs = [tmp_path / f"{name}.h5" for name in ("reduced", "full")]
    for error, decided in ((np.nan, False), (0.7, True)):
        chance = replace(late, holds_to=0.8, model_error=error)
        replace(found, probabilities={"late": chance}).write(tmp_path / "many.h5")
        said = headline_of_ensemble(tmp_path / "many.h5", *runs)
        assert ("= 5.26 % [1, 20]" in said) == decided == ("its error is not known" not in said), said
    # nor do samples of a model that stops say more
    of_stopped = replace(full.record, remarks=(warning("full simulation stopped"), *full.record.remarks))
    replace(full, status=1, record=of_stopped).write(tmp_path / "full.h5")
    replace(found, probabilities={"late": replace(late, holds_to=0.8, model_error=np.nan)}).write(tmp_path / "many.h5")
    assert "known; nor by the full-order model, whose run stops" in headline_of_ensemble(tmp_path / "many.h5", *runs)
    chance = replace(late, model_error=2.0, holds_to=1.0, n_failed=3)
    replace(found, probabilities={"late": chance}).write(tmp_path / "many.h5")
    said = headline_of_ensemble(tmp_path / "many.h5")
    assert "is not decided by this model" in said and "--full -n 60" in said
    lines = "\n".join(lines_of(Ensemble.read(tmp_path / "many.h5")))
    assert "3 of 57 samples, 3 more failed and count both ways" in lines and "not decided by this model" in lines
    of_event = summary_of(Ensemble.read(tmp_path / "many.h5"))["probabilities"]["late"]
    assert (of_event["decided"], of_event["failed"]) == (False, 3)
    assert of_event["decided_by"].startswith("pgmp montecarlo")


@pytest.mark.parametrize(("of_mesh", "cure"), [(0.02, "a finer mesh does"), (0.001, "montecarlo SCENE --full")])
def test_what_the_mesh_leaves_no_other_model_decides(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, of_mesh: float, cure: str
) -> None:
    """Of a four-bar 1.6 % was the mesh's, and full-order samples of the same mesh were to decide."""
    late = replace((found := with_event(synthetic.described())).probabilities["late"], holds_to=0.01)
    replace(found, probabilities={"late": late}).write(path := tmp_path / "many.h5")
    monkeypatch.setattr(budget, "_of_runs", lambda *_: (0.03, of_mesh))
    by = "with this mesh" if of_mesh == 0.02 else "by this model"
    assert f"is not decided {by}" in (said := headline_of_ensemble(path)) and cure in said
    sources = [source for scene in read_sources([path], frame=0)[0] for source in scene]
    assert budget.decision(sources, None).title == f"Not decided {by}"


@pytest.mark.parametrize(
    ("model", "of_mesh", "title"),
    [("full", 0.009, "Not decided with this time step"), ("full", 0.02, "Not decided with this mesh"),
     ("full", 0.001, "Decided"), ("components", 0.001, "Not decided by this model")],
)  # fmt: skip
def test_samples_of_the_mesh_have_its_error_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, model: str, of_mesh: float, title: str
) -> None:
    """Errors of component modes are not known, whatever the mesh is off by."""
    found = with_event(synthetic.described())
    step = {"whose": OF_TIME_STEP} if model == "full" else {"model_error": np.nan}
    late = replace(found.probabilities["late"], holds_to=0.01, **({"model_error": 0.002} | step))
    replace(found, model=model, probabilities={"late": late}).write(path := tmp_path / "many.h5")
    monkeypatch.setattr(budget, "own_of_mesh", lambda sources: {"crank_angle": of_mesh})
    sources = [source for scene in read_sources([path], frame=0)[0] for source in scene]
    assert budget.decision(sources, None).title == title
    assert ("= 5.26 % [1, 20]" in headline_of_ensemble(path)) == (title == "Decided")


SIZED = tables("""
joints.pin: type = "revolute"; connect = ["crank:tip", "rod:hinge"]
coordinates.theta: joint = "pin"
coordinates.reach: points = ["ground:origin", "rod:tip"]
effects.out: type = "prescribed_motion"; coordinate = "reach"
effects.drive: type = "prescribed_motion"; coordinate = "theta"
outputs.pin_x: type = "joint_force"; joint = "pin"; component = "x"
outputs.pin_y: type = "joint_force"; joint = "pin"; component = "y"
outputs.motor: type = "drive_torque"; coordinate = "theta"
outputs.hold: type = "drive_torque"; joint = "pin"
outputs.stress: type = "stress"; body = "rod"
outputs.damage: type = "rainflow"; of = "stress"
ensemble.probabilities.late: output = "pin_x"; above = 5.0; when = "ever"
""")


def test_what_parts_are_sized_by(tmp_path: Path) -> None:
    """Forces as polar diagrams, torque over speed, cycles, and which joint carries how much, decided by what."""
    run = synthetic.trajectory("reduced")
    wave = np.sin(3.0 * run.time)
    forces = {"pin_x": 3e3 * wave, "pin_y": -4e3 * wave**2, "motor": 7.0 * wave, "stress": 1e6 * wave, "hold": wave}
    units = run.units | {
        "pin_x": "N",
        "pin_y": "N",
        "motor": "N m",
        "hold": "N m",
        "stress": "Pa",
        "damage": "1",
        "theta": "rad",
    }
    record = replace(run.record, scene_toml=run.record.scene_toml + SIZED)
    outputs = run.outputs | forces | {"damage": run.time}
    run = replace(run, record=record, outputs=outputs, units=units, coordinate_units={"theta": "rad"})
    run.write(tmp_path / "run.h5")
    alone = words(page_of(tmp_path / "run.h5"))
    assert "Samples of an ensemble with extremes = true add probabilities" in alone

    many = synthetic.described()
    names, n = ("pin_x.max", "pin_y.min", "motor.max"), len(many.status)
    samples = np.linspace(2.9e3, 3.1e3, n)
    of_all = {name: synthetic.statistics(samples) for name in names}
    indices = synthetic.sensitivity(False)
    replace(
        many,
        record=replace(record, seed=1),
        outputs=many.outputs | {name: samples for name in ("pin_x", "pin_y", "motor")},
        units=many.units | units | dict.fromkeys(("pin_x.max", "pin_y.min"), "N") | {"motor.max": "N m"},
        extremes=many.extremes | {f"{name}/{which}": samples for name in tuple(forces)[:3] for which in EXTREMES},
        statistics=many.statistics | of_all,
        sobol=many.sobol | {"pin_x.max": indices, "pin_y.min": replace(indices, first_interval=np.zeros((2, 2)))},
    ).write(tmp_path / "many.h5")
    tree = page_of(tmp_path / "run.h5", tmp_path / "many.h5")
    titles = [words(item) for item in tree.iter("figcaption")]
    assert {"pin (kN), polar", "motor over speed", "hold over speed", "stress, rainflow matrix"} <= set(titles)
    heads = next([words(cell) for cell in row] for row in tree.iter("tr") if "largest in the run" in words(row))
    assert heads[3:] == ["largest in samples, mean", "exceeded in 5 %", "probability", "which parameter decides it"]
    rows = {words(row[0]): [words(cell) for cell in row] for row in tree.iter("tr") if len(row) == len(heads)}
    x, y, motor = rows["pin_x"], rows["pin_y"], rows["motor"]
    assert x[1] == "pin" and x[2].startswith("3 kN at ") and x[3].startswith("3 kN [") and x[4].startswith("3.09 kN [")
    assert x[5] == "P(late) = 5.26 % [1, 20]" and x[6] == "r1 70 %, push 20 %"
    assert y[2].startswith("-4 kN at ") and y[4].startswith("2.91 kN [") and y[5:] == ["", "none by itself"]
    assert motor[1] == "theta" and motor[5:] == ["", "not known"]
    assert_stored(tmp_path, tree)

    # an ensemble that was asked for no quantiles
    read = Ensemble.read(tmp_path / "many.h5")
    cut = ("probabilities", "quantiles", "quantile_intervals", "quantile_bounds")
    bare = {name: replace(s, **{of: getattr(s, of)[:0] for of in cut}) for name, s in read.statistics.items()}
    known = {name: of for name, of in read.outputs.items() if name in bare}
    few = replace(read, statistics=bare, probabilities={})
    few.write(tmp_path / "few.h5")
    tree = page_of(tmp_path / "run.h5", tmp_path / "few.h5")
    rows = {words(row[0]): [words(cell) for cell in row] for row in tree.iter("tr") if len(row) == len(heads)}
    assert rows["output"][4] == "no quantile" and rows["pin_x"][3:5] == [x[3], ""]
    assert "crank_angle at the end has the mean " in words(verdict_of(tree))
    assert not any("quantiles at the end" in line for line in lines_of(replace(few, outputs=known)))
    assert_stored(tmp_path, tree)


def test_what_is_constant_has_no_deviation_and_no_density(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.undo()
    found = synthetic.described()
    same = replace(found.statistics["crank_angle"], constant=True, std=0.0, std_interval=np.zeros(2))
    tree = page_with(tmp_path, many=replace(found, statistics=found.statistics | {"crank_angle": same}))
    read = Ensemble.read(tmp_path / "many.h5")
    assert read.statistics["crank_angle"].constant and not read.statistics["slider_deformation"].constant
    row = next([words(cell) for cell in row] for row in tree.iter("tr") if words(row).startswith("crank_angle"))
    assert row[2] == "constant" and not any(cell.split("{")[0] for cell in row[4:])
    assert any("crank_angle" in line and line.split()[2] == "constant" for line in lines_of(read))
    assert summary_of(read)["statistics"]["crank_angle"]["constant"] is True


def test_what_is_read_is_what_is_stored(tree: Element) -> None:
    """Texts have the values' leading digits, in per cent or with a prefix of the unit."""
    for item in shown(tree):
        value, text = float(item.get("value")), "".join(item.itertext())
        number = re.search(r"-?\d+\.?\d*(e[+-]?\d+)?", text)
        if number is None or value == 0.0:
            assert text in ("nan", "infinite", "-infinite", "not known", "0", "0 %", "0.0"), (text, value)
            continue
        power = np.log10(abs(float(number[0]) / value))
        scaled = power - (2.0 if abs(power - 2.0) < 0.1 else 3.0 * round(power / 3.0))
        # two digits are off by 5 % at most
        assert abs(scaled) < np.log10(1.05) and (float(number[0]) < 0.0) == (value < 0.0), (text, value)


def test_the_verdict_says_how_sure_and_how_far_off(tree: Element) -> None:
    first, *others = [words(item) for item in verdict_of(tree).iter("p")]
    assert first == "P(crank_angle above 5 rad at any time) = 5.26 % [1, 20], 90 % interval of 57 samples."
    # the made-up error is 4 % cos(9 t) of the deformation, measured against the full-order one
    assert any(re.match(r"Model error 3\.4 % of the largest slider_deformation, .* measured", text) for text in others)
    fate = "count both ways in intervals of probabilities; all other figures of outputs are without them"
    assert f"many.h5: 3 of 60 samples failed, and {fate}." in others
    assert "1 warning" in others


def test_a_light_says_whether_it_is_decided(tmp_path: Path) -> None:
    """By the interval and the model's error; not where a run or all samples failed, nor where nothing was asked."""
    many, run = with_event(synthetic.described()), with_event(synthetic.trajectory("reduced"))
    late = replace(many.probabilities["late"], model_error=0.001, holds_to=0.2)
    scene = run.record.scene_toml + tables("simulation: duration = 2.0")
    early = replace(run, status=3, record=replace(run.record, scene_toml=scene))
    for kind, result in {
        "decided": replace(many, probabilities={"late": late}),
        "undecided": replace(many, probabilities={"late": replace(late, model_error=0.3)}),
        "undecided lost": replace(many, probabilities={"late": replace(late, estimate=np.nan)}),
        "unasked": replace(many, probabilities={}),
        "failed": early,
    }.items():
        tree = page_with(tmp_path, **{kind: result})
        assert kind.split()[0] in verdict_of(tree).get("class").split(), kind
        told = {
            "decided": "Decided late: the model's error is 0.1 %, and the answer holds up to 20 %",
            "undecided lost": "Not decided by this model late (too many samples failed)",
        }
        light = words(next(with_class(tree, "light")))
        assert light == told.get(kind, light)


def test_two_designs_stand_beside_each_other(tmp_path: Path) -> None:
    """The difference of independent means has the root of the sum of squares of both half widths (Welch)."""
    rng, names = np.random.default_rng(4), ("thin", "thick")
    samples = {name: rng.normal(mean, 0.1, 400) for name, mean in zip(names, (1.0, 1.1))}
    first = synthetic.ensemble("reduced", 400, 0)
    for name, values in samples.items():
        same = synthetic.statistics(np.full(400, 0.4))
        known = {"crank_angle": synthetic.statistics(values), "slider_position": same}
        replace(first, outputs=first.outputs | {"crank_angle": values}, statistics=known).write(tmp_path / f"{name}.h5")
    tree = page_of(*[tmp_path / f"{name}.h5" for name in names])
    rows = {row[0]: row[1:] for row in rows_of(tree, "Beside each other")}
    change, half = map(float, re.match(r"\+([\d.]+) ± ([\d.]+) rad: differs", rows["crank_angle, mean"][2]).groups())
    assert change == pytest.approx(samples["thick"].mean() - samples["thin"].mean(), rel=5e-3)
    # normal quantile of synthetic's level, two digits; the half widths are of t with 399 degrees of freedom
    halves = [0.5 * np.ptp(synthetic.statistics(values).mean_interval) for values in samples.values()]
    assert half == pytest.approx(np.hypot(*halves), rel=0.05)
    assert rows["slider_position, mean"][2] == "equal"
    # runs of one model, of which nothing is known but what they are; a run and its better model are no two designs
    for name, factor in zip(names, (1.0, 1.2)):
        run = synthetic.trajectory("reduced")
        replace(run, outputs={key: factor * own for key, own in run.outputs.items()}).write(tmp_path / f"run_{name}.h5")
    tree = page_of(*[tmp_path / f"run_{name}.h5" for name in names])
    values = {row[0]: [float(text.split()[0]) for text in row[1:]] for row in rows_of(tree, "Beside each other")}
    for one, other, change in values.values():
        assert change == pytest.approx(other - one, abs=2e-3 * abs(other))
        assert other == pytest.approx(1.2 * one, rel=1e-3)
    synthetic.trajectory("full").write(tmp_path / "full.h5")
    assert "Beside each other" not in words(page_of(tmp_path / "run_thin.h5", tmp_path / "full.h5"))


def test_another_mesh_tells_the_share_of_the_mesh(tmp_path: Path) -> None:
    """Runs of one model and case with other numbers of nodes; the share counts beside the model's error."""
    full = with_event(synthetic.trajectory("full"))
    fine = replace(full, outputs={name: 1.02 * values for name, values in full.outputs.items()})
    nodes = {name: np.linspace(places[0], places[-1], 40) for name, places in full.frames.nodes.items()}
    cells = {name: np.column_stack([np.arange(39), np.arange(1, 40)]) for name in nodes}
    of = {name: np.repeat(at[:, :1], 40, axis=1) for name, at in full.frames.positions.items()}
    turns = {name: np.repeat(at[:, :1], 40, axis=1) for name, at in full.frames.rotations.items()}
    frames = replace(full.frames, nodes=nodes, cells=cells, positions=of, rotations=turns)
    fine = replace(fine, frames=frames, fields={})
    files = [tmp_path / f"{name}.h5" for name in ("run", "full", "fine", "many")]
    many = with_event(synthetic.described())
    late = replace(many.probabilities["late"], model_error=0.001, holds_to=0.2)
    results = with_event(synthetic.trajectory("reduced")), full, fine, replace(many, probabilities={"late": late})
    page_with(tmp_path, **{path.stem: result for path, result in zip(files, results)})
    share = 0.02 / 1.02
    for chosen in (files, [*files[:2], files[3]]):
        tree = page_of(*chosen)
        assert "decided" in verdict_of(tree).get("class").split()
        budget = {row[0]: row[1:] for row in rows_of(tree, "Error budget")}
        if files[2] in chosen:
            assert budget["mesh: crank_angle"][0] == f"{100 * share:.2g} %"
            assert "against 80, full order" in budget["mesh: crank_angle"][1]
            assert "Mesh: 2 % of the largest" in words(verdict_of(tree))
        else:
            assert budget["mesh"][0] == "not known"
    # what the event bears is less than model and mesh together
    replace(many, probabilities={"late": replace(late, holds_to=0.5 * share)}).write(files[3])
    tree = page_of(*files)
    assert "undecided" in verdict_of(tree).get("class").split()
    assert "All runs are full-order: nothing was reduced." in words(page_of(*files[1:3]))


def test_a_fit_has_its_picture_and_parameters(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.undo()
    found = synthetic.fitted()
    tree = page_with(tmp_path, fit=found)
    titles = {words(item) for item in tree.iter("figcaption")}
    assert {f"{name}: {what}" for name in found.outputs for what in ("fit", "residuals")} <= titles
    assert [row[0] for row in rows_of(tree, "Fit")] == [p.name for p in found.parameters]
    assert_stored(tmp_path, tree)


def test_nothing_comes_from_outside(page: str, tree: Element) -> None:
    assert "http:" not in page and "https:" not in page and "@import" not in page and "url(" not in re.sub(
        r'url\(#[\w-]+\)', "", page)  # fmt: skip
    for item in tree.iter():
        for name in ("src", "href", "action", "data"):
            target = item.get(name) if isinstance(item.tag, str) else None
            assert target is None or target.startswith(("#", "data:")), target
    policy = next(item for item in tree.iter("meta") if item.get("http-equiv") == "Content-Security-Policy")
    assert policy.get("content").startswith("default-src 'none'")


def test_ids_are_unique_and_references_hold(tree: Element) -> None:
    ids = [item.get("id") for item in tree.iter() if isinstance(item.tag, str) and item.get("id")]
    within = re.findall(r'(?:href="#|url\(#)([^")]+)', html5lib.serialize(tree, quote_attr_values="always"))
    assert set(within) <= set(ids)
    outside_of_charts = [name for name in ids if name.startswith(("scene-", "remarks-"))]
    assert len(outside_of_charts) == len(set(outside_of_charts))


def test_texts_of_files_are_no_markup(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.undo()
    tree = page_of(folder / "other.h5")
    assert words(next(tree.iter("h1"))) == "x<script>alert(1)</script>"
    assert all("alert" not in words(script) for script in tree.iter("script"))
    assert "no picture of the mechanism" in words(tree) and "no probabilities and no intervals" in words(tree)
    named = folder / "\x1b[31m\r\x9b.h5"
    named.write_bytes((folder / "other.h5").read_bytes())
    write_report([named], folder / "other.html")
    page = (folder / "other.html").read_bytes().decode()
    assert "\\x1b[31m\\x0d\\x9b.h5" in page and not set(page) & set("\x1b\r\x9b")


def test_sizes_of_parameters_do_not_choose_the_units_of_outputs(tmp_path: Path) -> None:
    """A radius of 5.6 m would have made a thousandth of it, the largest deformation, 0.0002 m."""
    drawn = synthetic.described()
    quantities = replace(drawn.statistics["r1"], quantiles=1e3 * drawn.statistics["r1"].quantiles)
    sizes = _largest_of_units([replace(drawn, statistics=drawn.statistics | {"r1": quantities})])
    assert sizes["m"] == np.abs(drawn.statistics["slider_deformation"].quantiles).max()


def test_scenes_have_sections_of_their_own(folder: Path) -> None:
    synthetic.modes_table().write(folder / "modes.h5")
    files = [folder / name for name in ("run.h5", "other.h5", "run.h5", "modes.h5")]
    lines = write_report(files, folder / "two.html")
    assert "2 files of 2 scenes, each in a section of its own" in lines[0]
    assert lines[1] == f"{folder / 'run.h5'} is given twice and shown once"
    assert lines[2] == f"{folder / 'modes.h5'} holds a table of modes and is not shown: see pgmp info"
    rom = folder / "not_drawn.h5"
    with write_file(rom, "rom") as file:
        synthetic.record().write(file)
    assert f"{rom} holds a reduced model and is not drawn: see pgmp info" in draw([rom, files[0]], folder / "drawn")
    tree = parsed((folder / "two.html").read_text(encoding="utf-8"))
    sections = list(with_class(tree, "scene"))
    assert [words(item) for item in tree.iter("h2") if "scene" in item.get("class", "")] == [
        "slider_crank", "x<script>alert(1)</script>"]  # fmt: skip
    assert len([item for item in sections if item.tag == "section"]) == 2
    assert {item.get("data-file") for item in shown(sections[0])} == {"run.h5"}


def test_data_are_handed_out_with_all_digits(folder: Path, tree: Element) -> None:
    table = csv_of(tree, "run.csv")
    with h5py.File(folder / "run.h5") as file:
        assert [float(v) for v in table["time (s)"]] == file["time"][()].tolist()
        assert [float(v) for v in table["slider_deformation (m)"]] == file["outputs/slider_deformation"][()].tolist()
    table = csv_of(tree, "many.csv")
    with h5py.File(folder / "many.h5") as file:
        np.testing.assert_array_equal([float(v) for v in table["r1 (m)"]], file["parameters/r1"][()])
        largest = [float(v) for v in table["crank_angle.max (rad)"]]
        np.testing.assert_array_equal(largest, file["extremes/crank_angle/max"][()])
    assert {"many_crank_angle.csv", "study.csv", "run.toml"} <= {item.get("download") for item in tree.iter("a")}


def test_tables_that_are_cut_say_so(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pgmp_petsc.report.page.MOST_NUMBERS", 400)
    [[source]], _ = read_sources([folder / "run.h5"])
    table = downloads_of(source)[0]
    assert table.about == "outputs over time, the first 100 of 1001 rows: the file has all"
    assert base64.b64decode(table.address.partition("base64,")[2]).count(b"\n") == 101


def rows_of(tree: Element, title: str) -> list[list[str]]:
    section = next(item for item in tree.iter("section") if any(words(h) == title for h in item.findall("h2")))
    return [[words(cell) for cell in row] for row in next(section.iter("tbody"))]


def test_the_error_budget_and_samples_that_failed(tree: Element) -> None:
    budget = {row[0]: row[1:] for row in rows_of(tree, "Error budget")}
    assert budget["basis, interpolation, time step"][0] == "not known"
    assert "reduction.tolerance" in budget["basis, interpolation, time step"][1]
    assert budget["mesh: slider_deformation"] == ["1 %", "measured: 10 cells against 40"]
    assert budget["model: slider_deformation"][1].startswith("measured: reduced against full order")
    assert budget["sampling: P(late)"] == ["± 9.5 percentage points", "90 % interval of 57 samples"]
    assert budget["small deformations: elastic rotation"][0] == "0.02 rad"
    rows = rows_of(tree, "Samples that failed")
    assert [row[0] for row in rows] == ["57", "58", "59"]
    assert all(row[-1] == "Newton's method did not converge" for row in rows)


def test_bodies_that_are_rigid_have_no_errors_of_basis_and_mesh(tmp_path: Path) -> None:
    for step, named in ((2e-3, "time step, full order: one"), (0.2, "time step")):  # too few of the latter to estimate
        scene = scene_from_toml(ROTORS, ".", ["simulation.duration=0.4", f"simulation.step={step}"])
        trajectory("full", scene).write(tmp_path / "run.h5")
        [sources], _ = read_sources([tmp_path / "run.h5"])
        found = {line.what: (line.size, line.how) for line in error_budget(sources, None)}
        assert found["mesh"] == (["none"], "no body deforms") and found["model"][0] == ["none"]
        assert named in found and not any("basis" in what or "interpolation" in what for what in found)
    assert found["time step"][0] == []


def test_a_build_with_a_tolerance_tells_the_parts_of_the_error(folder: Path) -> None:
    attempts = tuple(
        Attempt(part, {"modes": 4}, 100, np.array([share]), share, "crank_angle at r1 = 5 mm")
        for part, share in (("basis", 4e-3), ("interpolation", 2e-3), ("step", 0.5), ("step", 1e-3))
    )
    allowed = {"basis": 5e-3, "interpolation": 5e-3, "step": 2e-3}
    selection = Selection({}, allowed, {"reduction.modes": 4}, {}, {}, attempts, ("crank_angle",), {}, {}, ())
    with write_file(folder / "rom.h5", "rom") as file:
        synthetic.record().write(file)
        selection.put(file)
    [sources], _ = read_sources([folder / "run.h5", folder / "rom.h5"])
    budget = {line.what: line for line in error_budget(sources, None)}
    assert [part.text for part in budget["basis"].size] == ["0.4 %"]
    assert budget["basis"].how == "measured at the build, allowed 0.5 %: crank_angle at r1 = 5 mm"
    # the last attempt that keeps what is allowed
    assert [part.value for part in budget["time step"].size] == [1e-3]


def test_a_reduced_model_alone_is_no_report(folder: Path) -> None:
    with write_file(folder / "alone.h5", "rom") as file:
        synthetic.record().write(file)
    with pytest.raises(InputError, match="holds a reduced model, and no results of its scene are here: add a traj"):
        write_report([folder / "alone.h5"], folder / "alone.html")
    assert not (folder / "alone.html").exists()


def test_results_with_little_in_them_are_shown(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No samples that are fine, no errors, no frames: the page says so instead of failing."""
    monkeypatch.undo()
    lost = synthetic.ensemble("reduced", 10, 10)
    short = synthetic.trajectory("reduced", n_frames=0, n_times=2)
    lost = replace(lost, errors={}, errors_at_end={}, validity={})
    tree = page_with(folder, lost=lost, short=replace(short, errors=None, status=3))
    verdict = words(verdict_of(tree))
    assert "lost.h5: 10 of 10 samples failed" in verdict and "Model error: not known" in verdict
    assert "not known: no sample tells" in words(tree)


def test_the_page_and_the_terminal_bound_quantiles_where_samples_failed(folder: Path) -> None:
    """Also where so many failed that the outputs have no statistics, and in no quantile of a parameter."""
    many, name = synthetic.ensemble("reduced", 60, 3), "crank_angle"
    values = many.outputs[name][:-3]
    for known in (values, np.empty(0)):
        found = describe(known, 10, np.array([0.1, 0.5]), 3, 0.95)
        bounds = quantile_bounds(values, found.probabilities, 3)
        found = replace(found, quantile_bounds=bounds)
        lost = replace(many, statistics=many.statistics | {name: found})
        rows = {words(row[0]): words(row) for row in page_with(folder, lost=lost).iter("tr") if len(row)}
        table = "\n".join(lines_of(lost))
        braces = re.findall(r"\{(\S+), (\S+)\}", rows[f"{name} (rad)"])
        np.testing.assert_allclose(np.array(braces, dtype=float), bounds, rtol=1e-3)
        assert "{" not in rows["r1 (mm)"] and ("not known" in rows[f"{name} (rad)"]) == (known.size == 0)
        for low, high in bounds:
            assert f"at least {low:.6g}, at most {high:.6g}" in table


@pytest.mark.parametrize(
    ("passed", "n_failed", "told"), [(0, 3, "none"), (20, 45, "unknown"), (0, 60, "unknown")],
)  # fmt: skip
def test_first_passages_that_are_not_described_are_not_none(
    folder: Path, passed: int, n_failed: int, told: str
) -> None:
    """Where too many samples failed they have no statistics, whether there are passages or not."""
    many = synthetic.ensemble("reduced", 60, n_failed)
    none = describe(np.empty(0), 10, np.array([0.1, 0.5]), n_failed, 0.95)
    at = np.where((np.arange(60) < passed) & (many.status == 0), 0.5, np.nan)
    units = many.units | {"late": "s"}
    lost = replace(many, units=units, first_passages={"late": at}, statistics=many.statistics | {"late": none})
    (line,) = (line for line in lines_of(lost) if "late: first passage" in line)
    assert line.split()[3] == told
    assert ("no sample has one" in words(page_with(folder, lost=lost))) is (told == "none")


@pytest.mark.parametrize(
    ("files", "output", "message"),
    [
        (["none.h5"], "x.html", "none.h5' does not exist; needed: a trajectory, an ensemble, a trade-off study"),
        (["damaged.h5"], "x.html", "is damaged"),
        (["foreign.h5"], "x.html", "is not an HDF5 file"),
        (["modes.h5"], "x.html", "holds a table of modes; needed: a trajectory, an ensemble"),
        (["run.h5"], "run.h5", "is what the command reads"),
        (["run.h5"], "x.pdf", "a report is written as HTML: name it"),
        (["run.h5"], "mine.html", "exists and is not a report of this program"),
        (["run.h5"], "none/x.html", "does not exist; create it first"),
    ],
)
def test_refusals(folder: Path, files: Sequence[str], output: str, message: str) -> None:
    (folder / "foreign.h5").write_text("no result")
    (folder / "mine.html").write_text("<p>mine</p>")
    (folder / "damaged.h5").write_bytes((folder / "run.h5").read_bytes()[:-100])
    synthetic.modes_table().write(folder / "modes.h5")
    assert message in one_message("report", *(folder / name for name in files), "-o", folder / output)
    assert not (folder / "x.html").exists() and (folder / "mine.html").read_text() == "<p>mine</p>"


def test_charts_show_the_level_of_an_event(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.undo()
    many = synthetic.described()
    crank = synthetic.SCENE + EVENT
    many = replace(many, sobol={}, statistics={}, record=replace(many.record, scene_toml=crank))
    tree = page_with(folder, event=many)
    charts = {item.get("data-output"): words(item) for item in tree.iter("figure")}
    verdict = words(verdict_of(tree))
    assert re.search(r"Estimated model error at most [\d.]+ mrad \(crank_angle\), ", verdict)
    assert "late" in charts["crank_angle"] and "late" not in charts["slider_deformation"]
    with one_unit_each({"m": 1e-9}):  # the prefix of what is drawn is none for a level far beyond
        far = output_over_time("x", "m", [Curve("run", "full", np.arange(3), 1e-9 * np.arange(3))], None, "full",
                               Level("far", 1.15e-3, True, "ever"))  # fmt: skip
    assert far.caption == "The level of far, 1.15 mm, is far beyond this picture." and far.unit == "nm"


def test_outputs_that_are_not_known_are_no_figures(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A deformation is no number far outside a coordinate's range: it has neither an error nor a largest value."""
    monkeypatch.undo()
    runs = [synthetic.trajectory(model, n_frames=0, n_times=11) for model in ("reduced", "full")]
    files = [folder / f"unknown_{run.model}.h5" for run in runs]
    for run, path in zip(runs, files):
        known = {"slider_position": run.outputs["slider_position"], "crank_angle": np.full(11, -0.0)}
        unknown = {"slider_deformation": np.full(11, np.nan), **known}
        scene = synthetic.SCENE + EVENT.replace("crank_angle", "slider_deformation")
        replace(run, outputs=unknown, errors=None, record=replace(run.record, scene_toml=scene)).write(path)
    tree = page_of(*files)
    verdict = words(verdict_of(tree))
    assert "slider_deformation is not known at any instant." in verdict and "nan" not in verdict
    assert "crank_angle is furthest from zero at 0 s: 0 rad" in verdict
    budget = {row[0]: row[1] for row in rows_of(tree, "Error budget")}
    assert budget["model: slider_deformation"] == "not known" and budget["model: slider_position"] == "0 %"
    told = "differs from full order, with the same time step, by at most 0 % of the largest slider_position, at 0 s"
    assert headline_of_comparison(*files) == told


def test_an_ensemble_is_dots_and_bars_where_a_run_swings_between_its_instants() -> None:
    time, band = np.linspace(0.0, 1.0, 401), synthetic.band((0.025, 0.975))
    for frequency, swings in ((1.0, False), (15.0, True)):
        run = Curve("run", "reduced", time, np.sin(2.0 * np.pi * frequency * time))
        chart = output_over_time("x", "m", [run], band, "reduced", None)
        told = "at 21 instants"
        told += "; ".join([", between which the run goes to and fro", "a larger"] if swings else ["."])
        assert told in chart.caption


def test_an_error_that_two_runs_with_the_same_step_share_is_said(folder: Path) -> None:
    """The estimate knows of the time step, a comparison with the same step does not."""
    run, full = (synthetic.trajectory(model) for model in ("reduced", "full"))
    times = np.linspace(0.0, 1.0, 11)
    largest = {name: float(np.max(np.abs(values))) for name, values in run.outputs.items()}
    files = [folder / "coarse_run.h5", folder / "coarse_full.h5", folder / "fine_full.h5"]
    errors = {name: np.full(11, 0.8 * size) for name, size in largest.items()}
    replace(run, errors=EstimatedErrors(times, errors, largest)).write(files[0])
    full.write(files[1])
    fine = {name: np.interp(np.linspace(0, 1, 401), full.time, values) for name, values in full.outputs.items()}
    replace(synthetic.trajectory("full", n_frames=0, n_times=401), outputs=fine).write(files[2])

    def of(*chosen: Path) -> tuple[str, dict[str, list[str]]]:
        tree = page_of(*chosen)
        return words(verdict_of(tree)), {row[0]: row[1:] for row in rows_of(tree, "Error budget")}

    verdict, budget = of(*files[:2])
    said = r"Model error 3\.4 % .* at the same time step; the time-step error is not included\."
    assert re.search(said, verdict)
    synthetic.ensemble("components", 20, 0).write(folder / "of_components.h5")
    with_samples, _ = of(*files[:2], folder / "of_components.h5")
    assert "The samples are of component modes, whose error in them is" in with_samples
    assert "With the error of the time step it is estimated to be 80 % of the largest" in verdict
    assert verdict.count("off by up to 80 % of that.") == len(run.outputs)
    assert budget["model: slider_deformation"][0] == "3.4 %"
    assert budget["model and time step: slider_deformation"][0] == "80 %"
    # a full-order run with smaller steps measures both at once
    verdict, budget = of(files[0], files[2])
    assert not any(said in verdict for said in ("same time step", "estimated", "off by up to"))
    assert not any(what.startswith("model and time step") for what in budget)
    # a reduced run without the vibrations of the full-order one has less of the step's error
    errors = {name: np.full(11, 0.01 * size) for name, size in largest.items()}
    replace(run, errors=EstimatedErrors(times, errors, largest)).write(files[0])
    verdict, _ = of(*files[:2])
    assert "itself is estimated to be off by 1 % of it; the rest should be the time step's error" in verdict
    told = "; 1 % is estimated to be the reduced run's, the rest the time step's in the other"
    assert headline_of_comparison(*files[:2]).endswith(told)
    assert "estimated" not in headline_of_comparison(files[0], files[2])
    # of a run that ended early the part that both cover
    cut = {name: values[: len(full.time) // 2] for name, values in full.outputs.items()}
    replace(
        full, time=full.time[: len(full.time) // 2], outputs=cut, coordinates=full.coordinates[:500], frames=None
    ).write(files[1])
    assert "; compared over the first 0.4" in headline_of_comparison(*files[:2])
    # nothing moves in the better run
    replace(full, outputs={name: 0.0 * values for name, values in full.outputs.items()}).write(files[1])
    assert (
        headline_of_comparison(*files[:2]) == "full order: its outputs are zero or not known, so no share can be given"
    )
    # nor on another mesh
    still = synthetic.trajectory("full", n_frames=0)
    for path, n_elements in zip(files, (5, 10)):
        frames = synthetic.frames(np.linspace(0.0, 1.0, 3), n_elements=n_elements)
        replace(still, outputs={name: 0.0 * still.time for name in still.outputs}, frames=frames).write(path)
    assert headline_of_meshes(*files[:2]) == "outputs are zero or not known, so no share of the mesh can be given"


@pytest.mark.parametrize(
    ("model", "last", "of_step", "known", "told"),
    [
        ("reduced", 1000, None, False, "reduced, 1000 steps to 1 s; errors were not estimated"),
        ("full", 1000, None, False, "full order, 1000 steps to 1 s; nothing was reduced"),
        ("reduced", 1000, False, False, "reduced, 1000 steps to 1 s; errors were not estimated"),
        ("reduced", 1000, False, True,
         "reduced, 1000 steps to 1 s; estimated error over the first 0.2 s at most 20 % (slider_deformation)"),
        ("full", 400, True, True,
         "full order, 400 steps to 0.4 s of 1 s; estimated error of the time step over the first 0.2 s at most 20 % "
         "(slider_deformation)"),
    ],
)  # fmt: skip
def test_a_run_in_one_line(tmp_path: Path, model: str, last: int, of_step: bool | None, known: bool, told: str) -> None:
    """How far it came and of how far, the largest share of an error that is known, its kind and the part it covers."""
    run, end = synthetic.trajectory(model, n_frames=0), last + 1
    outputs = {name: values[:end] for name, values in run.outputs.items()}
    largest = {name: float(np.max(np.abs(values))) for name, values in outputs.items()}
    shares = {"crank_angle": 0.1, "slider_position": np.nan, "slider_deformation": 0.2}
    errors = {name: np.full(3, (share if known else np.nan) * largest[name]) for name, share in shares.items()}
    times = np.array([0.0, 0.1, 0.2])
    estimates = {} if not of_step else {"what": OF_STEP}
    found = None if of_step is None else EstimatedErrors(times, errors, largest, **estimates)
    modal, coordinates = run.modal if run.modal is None else run.modal[:end], run.coordinates[:end]
    scene = synthetic.SCENE + "[simulation]\nduration = 1.0\n"
    record = replace(run.record, remarks=(warning("far off"), note("nothing else")), scene_toml=scene)
    cut = {"time": run.time[:end], "outputs": outputs, "modal": modal, "coordinates": coordinates}
    replace(run, record=record, errors=found, **cut).write(tmp_path / "run.h5")
    assert headline_of_run(tmp_path / "run.h5") == f"{told}; 1 warning, see the report"


def test_marks_of_samples_that_failed_are_counted() -> None:
    values = np.linspace(0.0, 1.0, 50)
    event = Level("far", 40.0, True, "end")
    found = distribution("r1", "m", values, "reduced", event, np.linspace(0.0, 1.0, 5000), True)
    said = "The level of far, 40 m, is far beyond this picture. 300 of 5000 samples that failed are marked."
    assert found.caption == said


def test_values_that_hardly_differ_are_told_apart(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Samples that lie within a millionth of their mean have digits enough, in words and on the axis."""
    monkeypatch.undo()
    plain = synthetic.ensemble("reduced", 60)
    values = 5.286 * (1.0 + 1e-6 * np.linspace(-1.0, 1.0, 60))
    statistics = plain.statistics | {"crank_angle": synthetic.statistics(values)}
    near = replace(plain, outputs=plain.outputs | {"crank_angle": values}, statistics=statistics)
    tree = page_with(tmp_path, near=near)
    text = next(t for t in map(words, verdict_of(tree).iter("p")) if t.startswith("crank_angle"))
    low, high = map(float, re.search(r"lie between ([\d.]+) and ([\d.]+) rad", text).groups())
    assert high - low == pytest.approx(np.diff(np.quantile(values, [0.05, 0.95]))[0], rel=0.1)
    charts = (item for item in tree.iter() if item.get("class") == "chart")
    chart = next(item for item in charts if item.get("aria-label") == "crank_angle")
    ticks = [words(item) for item in chart.iter() if item.tag.endswith("text") and words(item).startswith("5.28")]
    assert len(ticks) >= 2 and len(set(ticks)) == len(ticks)


@pytest.mark.parametrize(("spread", "drawn"), [(1e-6, False), (1e-3, True)])
def test_extremes_that_hardly_differ_have_no_picture(
    tmp_path: Path, spread: float, drawn: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.undo()
    plain = synthetic.ensemble("reduced", 60)
    least = spread * np.linspace(-1.0, 0.0, 60)
    statistics = plain.statistics | {"crank_angle.min": synthetic.statistics(least)}
    zeros = dict.fromkeys(("max", "time_of_max", "time_of_min"), np.zeros(60))
    extremes = plain.extremes | {f"crank_angle/{one}": values for one, values in (zeros | {"min": least}).items()}
    tree = page_with(tmp_path, least=replace(plain, extremes=extremes, statistics=statistics))
    titles = [item.get("aria-label") for item in tree.iter() if item.get("class") == "chart"]
    assert "crank_angle" in titles and ("crank_angle.min" in titles) is drawn


def test_steps_of_a_run_on_another_mesh_are_not_said_once_more(monkeypatch: pytest.MonkeyPatch) -> None:
    run = synthetic.trajectory("full")
    errors = EstimatedErrors(run.time, {"crank_angle": 1e-6 * run.time}, {"crank_angle": 2.0}, OF_STEP)
    run = replace(run, errors=errors)
    own, other = (Source(name, replace(run), "", Path(name)) for name in ("own.h5", "other.h5"))
    assert [source for source, _ in budget.step_errors([own, other])] == [own, other]  # the same mesh twice
    monkeypatch.setattr(budget, "n_nodes", lambda one: 28 if one is other.result else 15)
    assert [source for source, _ in budget.step_errors([own, other])] == [own]
    _, simulate, run_again = _commands([own, other])
    assert simulate.startswith("pgmp simulate scene.toml --full") and run_again.endswith("another mesh, here other.h5")


@pytest.mark.parametrize(("seed", "asked"), [(3, "-n 20 --seed 3"), (None, "--samples SAMPLES.csv")])
def test_commands_draw_the_same_samples(seed: int | None, asked: str) -> None:
    """Those of a file have no seed, and those of a better model are taken again too."""
    many = synthetic.ensemble("full", 20)
    joined = Joined(("full/2", "full"), 0.95, {}, {"full/2": {}}, {"full/2": np.zeros(8, dtype=int)})
    for better, option in ((None, ""), (joined, " --correct full/2=8")):
        result = replace(many, record=replace(many.record, seed=seed), joined=better)
        said = _commands([Source("many.h5", result, "", Path("many.h5"))])[1]
        assert said == f"pgmp montecarlo scene.toml --full {asked}{option} -o many.h5"


def test_commands_begin_with_the_scene_of_each_result() -> None:
    """Runs with other entries are of other scenes."""
    full, reduced = synthetic.trajectory("full"), synthetic.trajectory("reduced")
    other = replace(reduced.record, scene_toml=reduced.record.scene_toml + "\n[more]\n")
    runs = {"a.h5": full, "b.h5": reduced, "c.h5": replace(reduced, record=other)}
    said = _commands([Source(name, run, "", Path(name)) for name, run in runs.items()])
    first, *_, fourth, fifth, last = said
    assert (first, len(said)) == ("pgmp info a.h5 --scene > scene.toml", 7)
    assert (fourth, fifth) == ("pgmp info c.h5 --scene > scene_2.toml", "pgmp build scene_2.toml -o rom_2.h5")
    assert last.startswith("pgmp simulate rom_2.h5 ") and last.endswith(" -o c.h5")


def test_commands_build_the_model_of_a_fit() -> None:
    build, again = _commands([Source("fit.h5", synthetic.fitted(), "", Path("fit.h5"))])[1:]
    assert (build, again) == ("pgmp build scene.toml -o rom.h5", "pgmp fit rom.h5 MEASURED.csv -o fit.h5")


@pytest.mark.parametrize("told", ["", ", ".join(f"without effects.{name}" for name in ("gust", "drag", "play"))])
def test_keys_of_a_chart_stay_in_the_picture_beside_long_numbers(told: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Numbers that differ in the seventh digit take a quarter of the width, and move the axes to the right."""
    monkeypatch.undo()
    figures, create, time = [], charts.new_figure, np.linspace(0.0, 1.0, 21)
    monkeypatch.setattr(charts, "new_figure", lambda *size: figures.append(create(*size)) or figures[-1])
    named = {f"full order{told}": "full", "reduced, other.h5": "reduced", "components": "components"}
    curves = [Curve(words, model, time, 0.5 + 1e-6 * time) for words, model in named.items()]
    output_over_time("x", "m", curves, None, "reduced", None)
    keys, page = figures[0].axes[0].get_legend().get_window_extent(), figures[0].bbox
    assert figures[0].axes[0].get_position().x0 > 0.2
    assert page.x0 <= keys.x0 and keys.x1 <= page.x1
