"""Estimated errors of mechanisms that users met, with friction on light hinges, stops, springs and frames in space."""

import re
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT
from mpi4py import MPI
from runs import history, samples, trajectory

from pgmp_petsc.estimates.error_indicator import ErrorIndicator
from pgmp_petsc.mechanism.capabilities import Purpose
from pgmp_petsc.models import FullModel, ReducedModel
from pgmp_petsc.ranks.groups import RankGroup
from pgmp_petsc.reduction.build import build_rom
from pgmp_petsc.stepping.generalised_alpha import integrate
from pgmp_petsc.studies.inputs import read_scene

FOLDER, FACTOR = ROOT / "tests" / "hard_cases" / "estimates", 3.0
# overrides that make it short, steps of the reference in one, and outputs with their true error in per cent
CASES = {
    "friction_on_a_hinge": ((), 8, {"q": 0.9, "r": 0.3, "mid": 56.0, "mx": 64.0, "s": 53.0}),
    "press_with_a_stop": (("simulation.duration=0.5",), 4, {"q": 4.9, "x": 1.1, "mid": 104.0, "tip": 131.0}),
    "frame_in_space": ((), 4, {"q": 1.7, "z": 1.0, "dz": 14.0, "dx": 20.0}),
    "spinning_arm": (("simulation.duration=1.0",), 8, {"q": 0.04, "tip": 3.0, "F": 1.7}),
    "rod_with_a_spring": ((), 4, {"q": 0.004, "x": 0.0002, "mid": 10.0, "F": 24.0}),
}
FEWER = "reduction.angles=96"  # than by default, which do not change what is estimated


def model_of(path: Path, *overrides: str) -> ReducedModel:
    """Build a reduced model of a scene."""
    scene, meshes = read_scene(path, (FEWER, *overrides), (), MPI.COMM_SELF, Purpose.BUILD)
    with RankGroup.split(MPI.COMM_SELF, 1) as group:
        return ReducedModel(scene, build_rom(scene, meshes, group))


@pytest.mark.parametrize("case", CASES)
def test_estimates_see_friction_stops_and_the_step(case: str) -> None:
    overrides, refinement, errors = CASES[case]
    path = FOLDER / f"{case}.toml"
    model = model_of(path, *overrides)
    step, values = model.scene.simulation.step, samples(model.scene, 1)
    smaller = (FEWER, *overrides, f"simulation.step={step / refinement!r}")
    exact = history(FullModel(*read_scene(path, smaller, (), MPI.COMM_SELF, Purpose.FULL)), values, 1, refinement)[1]
    found = history(model, values, 1)[1]
    system = model.batch(values, 1)
    watched = ErrorIndicator(model).watch(system, np.arange(1))
    run = integrate(system, model.scene.simulation, observer=watched)
    estimate = watched.estimate(run.status)
    assert found.keys() == errors.keys() and not any("".join(why) for why in estimate.absent.values())
    for name, one in found.items():
        true = np.abs(one - exact[name]).max()
        ratio = estimate.largest[name][0] / true
        assert 1.0 / FACTOR < ratio < FACTOR, (name, ratio)
        assert 100.0 * true / np.abs(exact[name]).max() == pytest.approx(errors[name], rel=0.5), name


def test_every_output_that_is_five_per_cent_off_is_warned_of() -> None:
    """And no other: the angle and the displacement are known to 0.004 %."""
    run = trajectory(model_of(FOLDER / "rod_with_a_spring.toml"))
    (warned,) = (remark for remark in run.record.remarks if remark.text.startswith("large estimated errors"))
    assert warned.kind == "warning"
    assert re.search(r"over the run: mid \d+ %, F \d+ %; ", warned.text), warned.text
