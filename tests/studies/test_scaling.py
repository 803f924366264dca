"""The scaling study: what it measures on small meshes, its records, tables and pictures, and what it refuses."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT
from mpi4py import MPI
from pictures import assert_inside, legend_texts, visible
from refusals import assert_refused
from runs import ONE_RANK

from benchmarks.scaling import build, figures, fine_beams, report
from benchmarks.scaling import case as phases
from benchmarks.scaling.case import ScalingCase
from pgmp_petsc.base.errors import RunError
from pgmp_petsc.components.condensing import condensed
from pgmp_petsc.mechanism.capabilities import Purpose
from pgmp_petsc.reduction.rom import ReducedOrderModel
from pgmp_petsc.studies.inputs import read_scene

SOLIDS = ROOT / "scenes" / "slider_crank_solid2d.toml"
BEAMS = ROOT / "scenes" / "slider_crank.toml"
SMALL = ("reduction.modes=4", "reduction.angles=6")
OF_CONDENSING = (phases.ASSEMBLY, phases.MODES, phases.ANSWERS, phases.PROJECTION)


def case(unknowns: int = 1000, ranks: int = 1, together: int = 1, **changes: object) -> ScalingCase:
    """Return a record whose factorisations take unknowns^1.5, and everything else unknowns."""
    n, power = unknowns / 1000, (unknowns / 1000) ** 1.5
    times = {phases.FACTORISATION: 0.8 * power, phases.EIGENSOLVER: 0.2 * n, phases.ASSEMBLY: 0.1 * n}
    times |= {phases.MODES: 0.8 * power + 0.2 * n, phases.ANSWERS: 0.1 * n, phases.PROJECTION: 0.1 * n}
    times |= {phases.READING: 0.01 * n, phases.CONDENSING: power, phases.BUILDING: 3.0, phases.WRITING: 0.01}
    times |= {phases.KINEMATICS: 2.0, phases.ANGLES: 0.96 / ranks, phases.TABLES: 0.04}
    wall = {name: 2.0 * seconds / (ranks if name == phases.CONDENSING else 1) for name, seconds in times.items()}
    given = {"scene": "rods", "dimension": 3, "bodies": 2, "modes": 16, "angles": 48, "load": 1.5, "blas": "libblas"}
    made = ScalingCase(
        unknowns=unknowns, ranks=ranks, ranks_per_angle=together, wall=wall, processor=times, factorisations=4,
        idle=[10**8] * ranks, peak=[10**8 + 1000 * unknowns] * ranks, **given,
    )  # fmt: skip
    return replace(made, **changes)


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> tuple[ScalingCase, Path]:
    """Return the record of the plane slider-crank on the meshes of the repository, and its reduced model's file."""
    path = tmp_path_factory.mktemp("scaling") / "case_small.h5"
    # the first condensing of a process imports and compiles, which is of no phase
    build.measure(SOLIDS, SMALL, ONE_RANK, path.with_name("first.h5"), fresh_up_to=10**4)
    return build.measure(SOLIDS, SMALL, ONE_RANK, path, fresh_up_to=10**4), path


def test_a_build_is_measured_phase_by_phase(measured: tuple[ScalingCase, Path]) -> None:
    found, path = measured
    _, meshes = read_scene(SOLIDS, (), (), MPI.COMM_SELF, Purpose.BUILD)
    assert found.unknowns == sum(2 * mesh.n_nodes for mesh in meshes.values())
    assert (found.dimension, found.bodies, found.modes, found.angles, found.ranks) == (2, 2, 4, 6, 1)
    for times in (found.wall, found.processor):
        assert all(seconds >= 0.0 for seconds in times.values())
        assert 0.5 * times[phases.CONDENSING] < sum(times[part] for part in OF_CONDENSING) <= times[phases.CONDENSING]
        assert times[phases.FACTORISATION] + times[phases.EIGENSOLVER] == pytest.approx(times[phases.MODES])
        assert times[phases.FRESH] > 0.0
    # the second one counts eigenvalues
    assert found.factorisations == 2 * found.bodies
    assert 0.0 < found.bodies_at_least < found.bodies_alone
    assert 0 < found.idle[0] <= found.peak[0] and len(found.peak) == 1
    assert found.angle == pytest.approx(found.processor[phases.ANGLES] / 6)
    assert ReducedOrderModel.read(path).frequencies_hz.shape == (6, 4)


def test_a_fresh_solve_has_the_condensed_frequencies() -> None:
    scene, meshes = read_scene(SOLIDS, SMALL, (), MPI.COMM_SELF, Purpose.BUILD)
    components = condensed(scene, meshes, ONE_RANK)
    fresh = build.fresh_solve(scene, meshes, MPI.COMM_SELF)
    # condensing leaves 1e-10 of the compliances; round-off of the mesh's stiffness stands above
    np.testing.assert_allclose(fresh, build.fresh_solve(scene, components, MPI.COMM_SELF), rtol=1e-7)


def test_a_full_solve_that_fails_is_a_record(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Failing:
        def __init__(self, *_: object) -> None:
            raise RunError("too fine")

    monkeypatch.setattr(build, "ModalProblem", Failing)
    found = build.measure(SOLIDS, SMALL, ONE_RANK, tmp_path / "rom.h5", fresh_up_to=10**4)
    assert found.refusal == "too fine" and phases.FRESH not in {**found.wall, **found.processor}
    assert "| refused: too fine |" in report.angle_table([found]).markdown()


@pytest.mark.parametrize("text", [None, "", "[]", '{"format": 0}', '{"format": 1, "ranks": 1}'])
def test_what_is_no_record_is_refused(tmp_path: Path, text: str | None) -> None:
    path = tmp_path / "case_1.json"
    if text is not None:
        path.write_text(text)
    assert_refused("no record of a scaling study", ScalingCase.read, path)


def test_the_summary_says_what_was_measured(tmp_path: Path) -> None:
    fresh = case(10**3).processor | {phases.FRESH: 4.0}
    cases = [replace(case(10**3), processor=fresh), case(10**5), case(10**5, ranks=2), case(10**5, ranks=2, together=2)]
    for number, found in enumerate(cases):
        found.write(tmp_path / f"case_{number}.json")
    text = report.summarise(tmp_path)
    assert "power 1.50 of the unknowns, over a factor of 100 (1.5 is allowed)" in text.replace("too much: ", "")
    assert "2 a body" in text and "The machine was shared" in text
    # 20 ms an angle: 4 s are 200 of them
    assert "| 1000 | 20 ms | 0.7 s, 35 | 1.1 s, 55 | 4 s, 200 |" in text
    assert "| 100000 | 2 | 1 |" in text and "s, 2.00 |" in text
    assert "Reduced simulation" not in text and "nan" not in text
    dear = {**case().processor, phases.CONDENSING: 1e-2}
    replace(case(10**3), processor=dear).write(tmp_path / "case_0.json")
    assert "too much: 1.5 is allowed" in report.summarise(tmp_path)


def test_pictures_show_the_records(tmp_path: Path, undrawn: None) -> None:
    fresh = case(10**3).processor | {phases.FRESH: 4.0}
    alone = [replace(case(10**3), processor=fresh), case(10**5)]
    parallel = [case(10**5, ranks=2), case(10**5, ranks=2, together=2)]
    drawn = figures.costs(alone)
    assert_inside(drawn)
    assert "condensing in all" in legend_texts(drawn)
    time = visible(drawn)[0]
    assert "power 1.50" in time.get_title(loc="left")
    np.testing.assert_allclose(time.lines[5].get_data(), [[1e3, 1e5], [1.0, 1e3]])
    speed = figures.ranks([*alone, *parallel])
    assert_inside(speed)
    np.testing.assert_allclose(visible(speed)[0].lines[1].get_data(), [[1, 2], [1.0, 2.0]])
    for number, found in enumerate([*alone, *parallel]):
        found.write(tmp_path / f"case_{number}.json")
    assert [path.name for path in figures.draw(tmp_path)] == ["scaling_3d.png", "scaling_ranks.png"]


def test_fine_beams_converge_to_the_extrapolation() -> None:
    beams = fine_beams.measure(BEAMS, (320,), (20, 40, 80), MPI.COMM_SELF)
    # the error of 320 elements: a sixteenth of that of 80, which is 8e-4 for the second frequency
    assert 1e-6 < np.max(np.abs(beams.differences[0])) < 1e-4
    assert 0.0 < beams.uncertain < 1e-4
    assert "not a word" in beams.verdict(0)
    assert replace(beams, differences=[[1e-6, -2e-6]]).verdict(0) == "ok"


def test_a_refusal_of_the_program_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    def frequencies(path: Path, n: int, comm: MPI.Comm) -> tuple[np.ndarray, np.ndarray]:
        if n == 10000:
            raise RunError("too fine for double precision")
        return np.array([0.7]), np.array([1.0, 2.0]) * (1.0 + n**-2.0)

    monkeypatch.setattr(fine_beams, "frequencies", frequencies)
    beams = fine_beams.measure(BEAMS, (1000, 10000), (40, 80, 160), MPI.COMM_SELF)
    np.testing.assert_allclose(beams.differences[0], 1e-6, rtol=1e-6)
    assert beams.verdict(0) == "ok" and beams.verdict(1) == "refused: too fine for double precision"
    text = report.beam_table(beams).markdown()
    assert "| 10000 |  | refused" in text and "| 1000 | 1.0e-06, 1.0e-06 | ok |" in text


def test_programs_say_how_they_are_called_and_what_they_need(capsys, monkeypatch, tmp_path: Path) -> None:
    monkeypatch.setattr("sys.argv", ["scaling"])
    assert report.main() == figures.main() == 2
    assert capsys.readouterr().err.count("usage: python -m") == 2
    for work in (report.summarise, figures.draw):
        assert_refused("scripts/bench_scaling", work, tmp_path)
    assert_refused("no body of continuum elements", build.measure, BEAMS, (), ONE_RANK, tmp_path / "rom.h5")
    assert_refused("bodies.crank: a beam along the x axis is needed", fine_beams.frequencies, SOLIDS, 10, MPI.COMM_SELF)
