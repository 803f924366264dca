"""``pgmp diff``: differences that are known, at their places; what cannot be compared, and the exit status."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import synthetic
from click.testing import CliRunner
from mpi4py import MPI
from refusals import refusal

import pgmp_petsc as pgmp
from pgmp_petsc.cli.declared import Session
from pgmp_petsc.cli.main import COMMANDS, load
from pgmp_petsc.scene import scene_to_toml
from scenes import slider_crank


def diff(*words: object) -> tuple[int, str]:
    done = CliRunner().invoke(load(COMMANDS["diff"]), [str(word) for word in words], obj=Session(MPI.COMM_SELF))
    return done.exit_code, f"{done.output}{'' if done.exception is None else done.exception}"


def held(data: object, kind: str = "trajectory") -> pgmp.Result:
    return pgmp.Result(kind, data, MPI.COMM_SELF, Path())


def test_the_largest_difference_of_a_run_is_found_where_it_is(tmp_path: Path) -> None:
    """Beside a run with a bump of 4 cm in the middle of an output that goes from 1 to 2 m."""
    run = synthetic.trajectory("reduced", n_frames=4)
    name, middle = "slider_deformation", len(run.time) // 2
    line = {one: np.linspace(1.0, 2.0, len(run.time)) for one in run.outputs}
    bump = line | {name: line[name] + 0.04 * (np.arange(len(run.time)) == middle)}
    replace(run, outputs=line).write(tmp_path / "a.h5")
    replace(run, outputs=bump).write(tmp_path / "b.h5")
    found = pgmp.diff(tmp_path / "a.h5", tmp_path / "b.h5")
    one = found.outputs[name]
    assert one.largest == pytest.approx(0.04, rel=1e-12) and one.share == pytest.approx(0.02, rel=1e-12)
    assert one.place == run.time[middle] and one.unit == "m" and found.is_within
    assert found.outputs["crank_angle"].largest == 0.0 and found.compared == len(run.time)
    backwards = pgmp.diff(pgmp.read(tmp_path / "b.h5"), pgmp.read(tmp_path / "a.h5"), tolerance=0.03)
    assert backwards.outputs[name].largest == -one.largest and backwards.is_within
    assert diff(tmp_path / "a.h5", tmp_path / "b.h5", "--tolerance", "0.03")[0] == 0
    status, text = diff(tmp_path / "a.h5", tmp_path / "b.h5", "--tolerance", "0.01")
    assert status == 1 and "slider_deformation" in text and "(2 % of its largest value)" in text
    status, text = diff(tmp_path / "a.h5", tmp_path / "b.h5", "--json")
    assert status == 0 and json.loads(text)["outputs"][name]["place"] == run.time[middle]


@pytest.mark.parametrize("size, share", [(1e-13, 0.0), (1e-4, 1.0)])
def test_what_vanishes_in_both_runs_does_not_differ(size: float, share: float) -> None:
    """Round-off beside an output of the same unit of 1 m: a symmetric machine's sway."""
    runs = [synthetic.trajectory("reduced", n_frames=0) for _ in range(2)]
    outputs = (run.outputs | {"slider_deformation": np.full(len(run.time), k * size)} for k, run in enumerate(runs, 1))
    found = pgmp.diff(*(held(replace(run, outputs=own)) for run, own in zip(runs, outputs)), tolerance=1e-2)
    one = found.outputs["slider_deformation"]
    assert one.largest == pytest.approx(size) and one.share == pytest.approx(share) and found.is_within == (not share)


def test_runs_of_other_steps_are_compared_where_both_are() -> None:
    runs = [synthetic.trajectory("reduced", n_frames=4, n_times=n) for n in (1001, 335)]
    lines = (replace(run, outputs={one: 1.0 + run.time for one in run.outputs}) for run in runs)
    found = pgmp.diff(*map(held, lines))
    # a straight line is interpolated to round-off of its values of 1 to 2
    assert found.compared == 335 and max(abs(one.largest) for one in found.outputs.values()) < 1e-14


def test_other_units_are_those_of_the_first_and_other_quantities_are_refused() -> None:
    run, name = synthetic.trajectory("reduced", n_frames=0), "slider_deformation"
    units = run.units | {name: "mm"}
    shown = replace(run, units=units, outputs=run.outputs | {name: 1e3 * run.outputs[name]})
    one = pgmp.diff(held(run), held(shown)).outputs[name]
    assert one.unit == "m" and one.share < 1e-14
    words = f"output {name} is in m in one of the two and in Pa in the other"
    assert words in refusal(pgmp.diff, held(run), held(replace(run, units=run.units | {name: "Pa"})))


def test_ensembles_are_compared_by_sample() -> None:
    data = synthetic.ensemble("full", 20)
    outputs = {name: np.nan_to_num(values) for name, values in data.outputs.items()}
    moved = {name: values.copy() for name, values in outputs.items()}
    status = np.zeros(20, dtype=np.asarray(data.status).dtype)
    name = next(iter(moved))
    moved[name][7] += 1.0
    moved[name][3] = np.nan
    failed = status.copy()
    failed[3] = 2
    both = (replace(data, outputs=columns, status=codes) for columns, codes in ((outputs, status), (moved, failed)))
    found = pgmp.diff(*(held(one, "ensemble") for one in both), tolerance=1e3)
    assert found.outputs[name].place == 7.0 and found.outputs[name].largest == pytest.approx(1.0)
    # one sample failed in one of the two, whatever the others are
    assert (found.compared, found.lacking, found.is_within) == (19, ("1 sample failed in one of the two",), False)


def test_an_output_that_one_of_the_two_lacks_is_named() -> None:
    run = synthetic.trajectory("reduced", n_frames=4)
    few = replace(run, outputs={"crank_angle": run.outputs["crank_angle"]})
    found = pgmp.diff(held(run), held(few), tolerance=1.0)
    assert "output slider_deformation is in one of the two" in found.lacking
    assert not found.is_within and list(found.outputs) == ["crank_angle"]


@pytest.mark.parametrize("nothing", [np.nan, np.inf])
@pytest.mark.parametrize("name", ["crank_angle", "slider_position"])
def test_what_is_no_number_in_one_of_the_two_is_counted(name: str, nothing: float) -> None:
    """Beside it the largest difference is still found; what is no number in both does not differ."""
    run = synthetic.trajectory("reduced", n_frames=4)
    gone, moved = run.outputs[name].copy(), run.outputs[name].copy()
    gone[600:] = nothing
    moved[500] += 3.0
    lost, other = (replace(run, outputs=run.outputs | {name: values}) for values in (gone, moved))
    found = pgmp.diff(held(lost), held(other), tolerance=1e3)
    assert found.lacking == (f"output {name} is no number 401 times in one of the two alone",) and not found.is_within
    assert found.outputs[name].largest == pytest.approx(3.0) and found.outputs[name].place == run.time[500]
    same = pgmp.diff(held(lost), held(lost), tolerance=0.0)
    assert same.is_within and not same.lacking


def test_a_run_that_ends_before_the_other_is_not_within(tmp_path: Path) -> None:
    run = synthetic.trajectory("reduced", n_frames=4)
    run.write(tmp_path / "a.h5")
    # the same steps, in half the time
    replace(run, time=0.5 * run.time).write(tmp_path / "b.h5")
    status, text = diff(tmp_path / "a.h5", tmp_path / "b.h5", "--tolerance", "1e9")
    assert status == 1 and "  one of the two ends at 0.5 s, the other at 1 s\n" in text


def test_samples_that_went_through_other_units_are_the_same(tmp_path: Path) -> None:
    """`--samples` of an ensemble in mm: its values are those to the last bit but one."""
    one = synthetic.ensemble("full", 20)
    one.write(tmp_path / "one.h5")
    for share in (3e-16, 1e-9):
        moved = {name: values * (1.0 + share) for name, values in one.parameters.items()}
        replace(one, parameters=moved).write(tmp_path / f"{share}.h5")
    assert pgmp.diff(tmp_path / "one.h5", tmp_path / "3e-16.h5", tolerance=0.0).is_within
    assert "same values of parameters" in refusal(pgmp.diff, tmp_path / "one.h5", tmp_path / "1e-09.h5")


def test_what_cannot_be_compared_is_refused(tmp_path: Path) -> None:
    synthetic.trajectory("reduced", n_frames=4).write(tmp_path / "run.h5")
    synthetic.ensemble("full", 20).write(tmp_path / "twenty.h5")
    synthetic.ensemble("full", 10).write(tmp_path / "ten.h5")
    synthetic.modes_table().write(tmp_path / "modes.h5")
    synthetic.derivatives().write(tmp_path / "slopes.h5")
    synthetic.fitted().write(tmp_path / "fit.h5")
    run = pgmp.read(tmp_path / "run.h5")
    other = replace(run.data, outputs={"other": run.outputs["crank_angle"]})
    for pair, message in {
        ("run.h5", "modes.h5"): "modes.h5': a table of modes; two runs or two ensembles can be compared; pgmp export",
        ("slopes.h5", "slopes.h5"): "slopes.h5': a table of sensitivities; two runs or two ensembles can",
        ("fit.h5", "fit.h5"): "a fit of parameters; two runs or two ensembles can be compared; in Python pgmp.read has",
        ("run.h5", "twenty.h5"): "twenty.h5'): two kinds; take two runs, or two ensembles; pgmp simulate",
        ("twenty.h5", "ten.h5"): "ensembles of 20 and 10 samples: they are not of the same values",
    }.items():
        assert message in refusal(pgmp.diff, *(tmp_path / name for name in pair))
    later = replace(run.data, time=run.time + 1e3)
    assert "have no output in common" in refusal(pgmp.diff, run, held(other))
    assert "have no instant, or no fine sample, in common" in refusal(pgmp.diff, run, held(later))
    with pytest.raises(pgmp.InputError, match="tolerance = -1: allowed are numbers from 0"):
        pgmp.diff(run, run, tolerance=-1)


def test_what_joints_carry_as_undeformed_bodies_start_is_compared_from_the_next_instant_on() -> None:
    """At time 0 it hangs on the mesh alone; that of a spring in the joint does not."""
    for entry, place in (("", 1e-3), ("joints.crank_hinge.elastic={reference=[[1,0]],stiffness=[1e6,1e6]}", 0.0)):
        scene = slider_crank('outputs={F={type="joint_force",joint="crank_hinge"}}', *filter(None, [entry]))
        run = synthetic.trajectory("reduced", n_frames=0)
        record = replace(run.record, scene_toml=scene_to_toml(scene))
        time = 1e-3 * np.arange(len(run.time))
        second = np.ones(len(time))
        second[:2] += 5.0, 0.01
        first, second = {"F": np.ones(len(time))}, {"F": second}
        runs = (replace(run, record=record, time=time, outputs=one, units={"F": "N"}) for one in (first, second))
        one = pgmp.diff(*map(held, runs)).outputs["F"]
        assert one.place == pytest.approx(place) and one.largest == pytest.approx(0.01 if place else 5.0)
