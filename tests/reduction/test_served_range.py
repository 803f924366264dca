"""Parameters outside what a reduced model was built for: counted, warned of, refused."""

import numpy as np
import pytest
from refusals import refusal
from runs import SMALL, paper_scene, rom_of

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.models import ReducedModel
from pgmp_petsc.reduction.rom import Served, check_samples, check_served, outside_of

DRAWN = (
    *SMALL,
    'parameters.push={nominal=1.0, distribution={name="norm", loc=1.0, scale=0.1}}',
    'effects.motor.scale="push"',
)
RADIUS, DEVIATION = 5.6e-3, 0.56e-3


@pytest.fixture(scope="module")
def served() -> dict[str, Served]:
    scene = paper_scene(*DRAWN)
    return ReducedModel(scene, rom_of(scene)).served


def test_what_a_build_tries_is_served_and_loads_may_be_anything(served: dict[str, Served]) -> None:
    assert list(served) == ["r1"]
    # quantiles at three standard deviations, half as far again, and three times as far
    ends = [served["r1"].low, served["r1"].high, served["r1"].least, served["r1"].most]
    np.testing.assert_allclose(ends, RADIUS + DEVIATION * np.array([-4.5, 4.5, -9.0, 9.0]), rtol=1e-4)
    assert check_served(served, paper_scene(*DRAWN)) == ()
    assert check_served(served, paper_scene(*DRAWN, settings=("push=50.0",))) == ()


@pytest.mark.parametrize(
    ("change", "line", "far"),
    [
        ("parameters.r1.value=2.9e-3", "parameters.r1.value = 0.0029: outside [0.00308", False),
        ('parameters.r1.distribution={name="norm", loc=7.5e-3, scale=0.5e-3}', "r1.distribution: 11 % of", False),
        ("parameters.r1.value=11e-3", "0.011: beyond what the model serves, [0.000560039, 0.01064] m", True),
        ('parameters.r1.distribution={name="uniform", loc=10e-3, scale=1.9e-3}', "the greater part beyond what", True),
    ],
)
def test_what_is_outside_is_warned_of_and_far_beyond_refused(served, change: str, line: str, far: bool) -> None:
    if far:
        assert line in refusal(check_served, served, paper_scene(*DRAWN, change))
        return
    (said,) = check_served(served, paper_scene(*DRAWN, change))
    assert said.kind == "warning" and line in said.text and "build with distributions, or bounds" in said.text


def test_samples_are_counted_and_refused_where_they_are_far_beyond(served: dict[str, Served]) -> None:
    values = {"r1": np.array([5e-3, 2.9e-3, 8.5e-3, 6e-3]), "push": np.array([1.0, 9.0, -9.0, 0.0])}
    (said,) = outside_of(served, values, "--samples table.csv")
    assert "--samples table.csv: 2 of 4 samples are outside the range" in said.text and "2 in r1 ([0.00308" in said.text
    check_samples(served, values, "--samples table.csv")
    assert outside_of(served, {"r1": np.array([5e-3])}, "") == () == outside_of(served, {"push": np.zeros(2)}, "")
    with pytest.raises(InputError, match="1 of 2 samples are beyond what the model serves, number 1 with r1 = 0.0115"):
        check_samples(served, {"r1": np.array([5e-3, 11.5e-3])}, "--samples table.csv")


def test_parameters_that_no_range_is_known_of_are_served_near_their_nominal_value() -> None:
    scene = paper_scene(*SMALL, "parameters.r1={nominal=5.6e-3}")
    served = ReducedModel(scene, rom_of(scene)).served["r1"]
    np.testing.assert_allclose([served.low, served.most], [RADIUS * (1 - 0.45), RADIUS * 1.9])
