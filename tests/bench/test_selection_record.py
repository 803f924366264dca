"""What was chosen, in the file and in words; entries of the scene."""

from types import SimpleNamespace

import numpy as np
import pytest

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.bench.choice import cost_text, leaves_open, mesh_remark
from pgmp_petsc.bench.history import BASIS, INTERPOLATION, STEP, shares_of
from pgmp_petsc.results import Attempt, Selection
from pgmp_petsc.scene import scene_from_toml, scene_to_toml
from scenes import slider_crank

SELECTION = Selection(
    tolerances={"reduction": 1e-2, "simulation": 2e-2},
    allowed={"basis": 3.5e-3, "step": 1e-2},
    chosen={"reduction.modes": 7, "reduction.static_modes": True, "simulation.step": 2e-3},
    reasons={"reduction.modes": "leave 0.002"},
    kept={"reduction.interpolation": "spline"},
    attempts=(
        Attempt("basis", {"modes": 4}, 100, np.array([1e-4, np.inf]), np.inf, "x", 55.0, 0.1, "no convergence"),
        Attempt("basis", {"modes": 7}, 100, np.array([1e-4, 2e-3]), 2e-3, "x, load 'own', r = 1", 99.0, 0.2),
        Attempt("step", {"step": 2e-3}, 500, np.array([1e-5, 3e-3]), 3e-3, "x, load 'own', r = 1"),
    ),
    outputs=("angle", "x"),
    values={"r": np.array([1.0, 2.0])},
    loads={"own": "the scene's own loads"},
    remarks=("no torque acts",),
)


def test_in_words() -> None:
    lines = SELECTION.lines()
    assert lines[0] == "chosen for reduction.tolerance = 0.01 and simulation.tolerance = 0.02"
    for words in (
        "  reduction.modes = 7: leave 0.002",
        "  reduction.static_modes = true",
        '  kept as given: reduction.interpolation = "spline"',
        "    modes = 4: no convergence",
        "    modes = 7: 0.002 (x, load 'own', r = 1)",
        "  trained on r = 1, 2",
        "  no torque acts",
    ):
        assert words in lines
    assert not any("modes = 4" in line for line in SELECTION.lines(attempts=False))


def test_the_parts_share_the_tolerance() -> None:
    assert BASIS + INTERPOLATION == STEP == 0.5
    assert sum(shares_of(True).values()) == pytest.approx(sum(shares_of(False).values()))


@pytest.mark.parametrize("table", ["reduction", "simulation"])
def test_a_tolerance_leaves_a_scene_open(table: str) -> None:
    scene = slider_crank(f"{table}.tolerance=1e-3")
    assert leaves_open(scene) and not leaves_open(slider_crank())
    again = scene_from_toml(scene_to_toml(scene), ".")
    assert getattr(again, table).tolerance == 1e-3
    for value in ("0.0", "1.0", "-1e-3", '"small"'):
        with pytest.raises(InputError, match=rf"{table}\.tolerance"):
            slider_crank(f"{table}.tolerance={value}")


def test_a_step_that_is_still_to_be_chosen_is_not_too_long() -> None:
    assert slider_crank("simulation={duration=1e-4, tolerance=1e-3}").simulation.duration == 1e-4
    with pytest.raises(InputError, match="must not exceed the duration"):
        slider_crank("simulation={duration=1e-4}")
    with pytest.raises(InputError, match="must not exceed the duration"):
        slider_crank("simulation={duration=1e-4, step=1e-3, tolerance=1e-3}")


@pytest.mark.parametrize(("apart", "words"), [(6e-3, "0.006 away from the mesh in x"), (4e-3, "was not measured")])
def test_a_reference_that_is_off_by_more_than_there_is_to_spare_is_named(apart: float, words: str) -> None:
    bench = SimpleNamespace(
        finer_meshes=lambda n_steps: None, reference=SimpleNamespace(from_mesh={"angle": 1e-5, "x": apart}),
        scene=slider_crank("reduction.tolerance=1e-2"),
    )  # fmt: skip
    (said,) = mesh_remark(bench, 100)
    assert words in said


def test_where_a_reduced_sample_is_no_cheaper_the_reduction_is_said_not_to_pay() -> None:
    cheap, dear = (cost_text(reduced, 100, 1e-3, 400, "full-order") for reduced in (2e-4, 9e-4))
    assert cheap == "processor time of a sample: 0.2 ms with 100 steps; of the full-order model 1 ms with 400 steps"
    assert "0.9 ms with 100 steps" in dear and "the reduction does not pay here" in dear and "--full" in dear
