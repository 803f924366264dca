"""Commands on a scene with two rigid coordinates: check, build, info, modes, and what they refuse."""

import re
from pathlib import Path

import pytest
from conftest import ROOT
from runs import overridden, pgmp
from two_coordinates import DOUBLE_PENDULUM, LOWER, UPPER

from pgmp_petsc.reduction.rom import ReducedOrderModel
from pgmp_petsc.results import ModesTable

THIRD = overridden(
    'bodies.hand={mesh="crank_5.msh",element="beam2d",material="steel",section={shape="circle",radius=4e-3}}',
    'joints.wrist={type="revolute",connect=["lower:tip","hand:hinge"]}',
    'coordinates.theta3={joint="wrist",range=[0.0,1.0]}', "reduction.angles=400",
)  # fmt: skip


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a double pendulum of the paper's two bars."""
    folder = tmp_path_factory.mktemp("two")
    text = DOUBLE_PENDULUM.replace(f"0.0:{UPPER}:4", "crank_5.msh").replace(f"0.0:{LOWER}:4", "rod_5.msh")
    for name in ("crank_5.msh", "rod_5.msh"):
        (folder / name).write_bytes((ROOT / "meshes" / name).read_bytes())
    path = folder / "two.toml"
    path.write_text(text)
    return path


def test_check_build_info_and_modes(scene: Path) -> None:
    said = pgmp("check", scene).stdout
    assert "coordinate    theta1: 0 to 6.28319 rad, periodic" in said and "coordinate    theta2: " in said
    assert "2 rigid + 3 flexible reduced" in said and "modes at 64 configurations" in said
    rom, table = scene.parent / "rom.h5", scene.parent / "modes.h5"
    assert "64 configurations, 3 modes" in pgmp("build", scene, "-o", rom).stdout
    assert ReducedOrderModel.read(rom).tables.samples.shape == (8, 8)
    assert re.search(r"/theta +64 x 2", pgmp("info", rom).stdout)
    assert "16 configurations" in pgmp("modes", scene, "--rom", rom, "--angles", 4, "-o", table).stdout
    found = ModesTable.read(table)
    assert found.theta.shape == (2, 16) and found.reduced_hz.shape == (16, 3)
    assert (found.full_hz > 0).all()


@pytest.mark.parametrize("command", ["build", "modes"])
def test_a_third_one_is_refused_where_its_grid_is_dear(scene: Path, command: str) -> None:
    done = pgmp(command, scene, "-o", scene.parent / "none.h5", *THIRD, status=2)
    assert "400 along each would make 400^3 = 6.4e+07 configurations" in done.stderr and "Traceback" not in done.stderr
    assert not (scene.parent / "none.h5").exists()
