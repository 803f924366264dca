"""Tables that interpolation makes indefinite are noticed, with the place and what helps."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from runs import rom_of

from pgmp_petsc.reduction.rom import ReducedOrderModel
from pgmp_petsc.reduction.tables import indefinite_between
from pgmp_petsc.texts.models import report
from scenes import RADIUS, slider_crank

SPLINE = 'reduction.interpolation="spline"'
FEW = "reduction.angles=24", "reduction.max_angles=24"  # and no more where these do not do
UNCERTAIN = 'parameters.r1={nominal=5.6e-3, distribution={name="norm", loc=5.6e-3, scale=5.6e-4}}'
EXTENDED = (
    "reduction.modes=3",
    "reduction.static_modes=true",
    "reduction.inertia_modes=true",
    "reduction.parameter_modes=2",
)


def test_a_basis_that_turns_faster_than_the_angles_follow_is_warned_of(tmp_path: Path) -> None:
    rom = rom_of(slider_crank(UNCERTAIN, *EXTENDED, SPLINE, *FEW))
    assert rom.indefinite.startswith("with 24 angles the interpolated mass matrix is not positive definite at ")
    rom.write(tmp_path / "rom.h5")
    assert ReducedOrderModel.read(tmp_path / "rom.h5").indefinite == rom.indefinite
    assert f"  warning: {rom.indefinite}" in report(rom, tmp_path / "rom.h5")
    sound = rom_of(slider_crank(UNCERTAIN, *EXTENDED, SPLINE, "reduction.angles=48"))
    assert sound.indefinite == "" and "warning" not in report(sound, tmp_path)


@pytest.mark.parametrize("name", ["mass", "stiffness"])
def test_the_matrix_and_the_parameters_are_named(name: str) -> None:
    tables = rom_of(slider_crank(SPLINE)).tables
    table = getattr(tables, name).copy()
    # one sample out of the way: the spline overshoots beside it
    table[5, :, -1, -1] *= 1e3
    spoilt = replace(tables, **{name: table})
    values = {"r1": np.array([RADIUS, 0.7 * RADIUS])}
    assert indefinite_between(tables, slider_crank(SPLINE), values, 2) == ""
    said = indefinite_between(spoilt, slider_crank(SPLINE), values, 2)
    assert f"the interpolated {name} matrix is not positive definite" in said and "r1 = 0.0056" in said
    assert said.endswith("take more reduction.angles or fewer reduction.modes"), "it is a spline already"
    other = indefinite_between(spoilt, slider_crank('reduction.interpolation="spectral"'), values, 2)
    assert name in other and other.endswith('or reduction.interpolation = "spline"')
