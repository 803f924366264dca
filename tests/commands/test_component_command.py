"""``--components`` of simulate and montecarlo, and commands on a scene with two rigid coordinates, as users type."""

import json
import re
from pathlib import Path

import pytest
from conftest import ROOT, run_mpi
from runs import PAPER_SCENE, PGMP, overridden, pgmp
from two_coordinates import DOUBLE_PENDULUM, LOWER, THIRD, UPPER

from pgmp_petsc.reduction.rom import ReducedOrderModel
from pgmp_petsc.results import ModesTable, Trajectory
from pgmp_petsc.results.tradeoff import Tradeoff

QUICK = overridden("reduction.modes=3", "simulation.duration=0.02", "simulation.frames=6")


def test_a_run_and_its_picture(tmp_path: Path, undrawn: None) -> None:
    found, full = tmp_path / "components.h5", tmp_path / "full.h5"
    said = pgmp("simulate", PAPER_SCENE, "--components", *QUICK, "-o", found).stdout
    assert "components model" in said
    assert "errors of the component modes (" in said and "left out: what is of second order" in said
    pgmp("simulate", PAPER_SCENE, "--full", *QUICK, "-o", full)
    one, other = Trajectory.read(found), Trajectory.read(full)
    assert one.model == "components"
    assert one.outputs["crank_angle"][-1] == pytest.approx(other.outputs["crank_angle"][-1], rel=1e-4)
    assert "of the components model" in pgmp("info", found).stdout
    pgmp("plot", found, full, "-o", tmp_path / "pictures")
    assert (tmp_path / "pictures" / "trajectories.png").exists()


LOOSE = """bodies.loose={line={length=0.1, elements=1}, element="beam2d", material="steel", \
section={shape="circle", radius=5e-3}, placement={origin=[2.0, 0.0]}}"""
PLATFORM, ARM, SOLID, PALLETIZER, DELTA = (
    ROOT / f"scenes/{name}.toml"
    for name in ("platform_3rrr", "six_joint_arm", "slider_crank_solid2d", "palletizer", "delta_robot")
)
FOURTH = 'coordinates.fourth={joint="first_elbow", range=[-3.0, 3.0]}'
FREEDOM = "joints: they leave the rigid mechanism 3 degrees of freedom"


@pytest.mark.parametrize(
    "arguments, message",
    [
        (("simulate", PAPER_SCENE, "--components", "--full"), "--full and --components: two models; give one of them"),
        (("montecarlo", PAPER_SCENE, "--components", "-n", 2, "--ranks-per-sample", 2), "--ranks-per-sample = 2"),
        (("simulate", PAPER_SCENE, "--components", *overridden(LOOSE)), "bodies.loose: no joint connects it with"),
        (
            ("simulate", SOLID, "--components", *overridden('joints.elbow.connect=["crank:side", "rod:hinge"]')),
            'joints.elbow.connect = "side": the mesh has no group of faces of this name; known: hinge, tip',
        ),
        (
            ("simulate", PLATFORM, "--components", *overridden(FOURTH)),
            f"{FREEDOM} (30 of its 10 bodies less 27 independent constraints), but 4 coordinates were named",
        ),
        (("build", ARM), "6 independent coordinates were given; at most 3 are taken"),
        (("build", PALLETIZER), "16^4 = 6.55e+04 configurations: about 0.144 hours of eigenproblems on one rank"),
        (
            ("build", DELTA, *overridden("reduction.angles=200")),
            "are the most for a grid. Take fewer reduction.angles or reduction.modes, or pgmp simulate SCENE",
        ),
    ],
)
def test_what_is_refused(arguments: tuple, message: str, tmp_path: Path) -> None:
    output = tmp_path / "out.h5"
    done = pgmp(*arguments, "-o", output, status=2)
    assert message in done.stderr and "Traceback" not in done.stderr
    assert not output.exists()


def test_sizes_of_effects_over_many_coordinates_are_refused_with_what_helps() -> None:
    done = pgmp("check", ARM, "--effects", status=2)
    assert "6 independent coordinates were given, waist, shoulder" in done.stderr
    assert "hand; at most 3 are taken; take pgmp check without --effects" in done.stderr
    pgmp("check", ARM)


def test_which_model_to_take_is_predicted_and_measured(tmp_path: Path) -> None:
    """By sizes for scenes of one, three and six coordinates; measured without a reduced model where no grid goes."""
    for scene, taken in (
        (ROOT / "scenes/slider_crank.toml", "take          mesh, reduced from"),
        (DELTA, "take          mesh; 10000"),  # fewer unknowns than component modes and what its loops leave
    ):
        said = pgmp("check", scene).stdout
        assert taken in said and all(f"  model         {name}: " in said for name in ("mesh", "components", "reduced"))
    assert "reduced is left out by its error" in said and "contact that begins" not in said
    # truncated modes leave 5 % in the deformation of this one, and 4e-5 in the motion
    paper = ROOT / "scenes/slider_crank_paper.toml"
    for output, left_out in (("position", False), ("deformation", True), ("displacement", True)):
        said = pgmp("check", paper, *overridden(f'outputs.slider_deformation.type="{output}"')).stdout
        assert ("reduced is left out by its error" in said) == left_out and ("mesh, reduced from" in said) != left_out
    worn = pgmp("check", ROOT / "scenes/worn_slider_crank.toml").stdout
    assert "(and 0.15 ms for each contact that begins or ends; only runs tell how many these are) with reduced" in worn
    # 28 amplitudes; 7 motors and gearboxes, and 9 directors of a bearing that tilts; 6 constraints of these, one of
    # the bearing and 5 motors
    found = json.loads(pgmp("check", ROOT / "scenes/payload_arm.toml", "--json").stdout)
    assert found["models"]["components"]["unknowns"] == 28 + 7 + 9 + 12 and found["take"].startswith("components; ")
    quick = overridden(
        "simulation.duration=0.01", "simulation.step=1e-3", "reduction.modes=1", "initial={}", "ensemble.batch=4"
    )
    said = pgmp("tradeoff", ARM, "--quick", *quick, "-o", tmp_path / "costs.h5").stdout
    assert "no reduced model is compared: coordinates: waist, shoulder, elbow, wrist_roll, wrist_bend, hand" in said
    assert "Which model, for 1 % in every output: component modes" in said
    assert set(Tradeoff.read(tmp_path / "costs.h5").families) == {"components", "full", "surface"}


def test_fewer_coordinates_than_degrees_of_freedom(tmp_path: Path) -> None:
    """Refused by name, on two ranks as on one."""
    text = PLATFORM.read_text()
    for table in ("coordinates.third", "simulation.initial.third"):
        start = text.index(f"[{table}]")
        text = text[:start] + text[text.index("\n[", start) + 1 :]
    few = tmp_path / "few.toml"
    few.write_text(text)
    done = pgmp("simulate", few, "--components", "-o", tmp_path / "out.h5", status=2)
    assert FREEDOM in done.stderr and "but 2 coordinates were named: first, second" in done.stderr
    assert "Motions that go on while these rest: " in done.stderr and ", third_motor (turning), " in done.stderr
    assert "Traceback" not in done.stderr


def test_what_ranks_did_not_share_is_said(tmp_path: Path) -> None:
    said = run_mpi(3, *PGMP, "simulate", PAPER_SCENE, "--components", *QUICK, "-o", tmp_path / "run.h5").stdout
    told = "each of the 2 flexible bodies was condensed by one rank in its own memory, and 1 of 3 ranks had none"
    assert told in said


@pytest.mark.parametrize("name", ["six_joint_arm", "payload_arm", "palletizer"])
def test_the_scenes_run_as_they_are(name: str, tmp_path: Path) -> None:
    said = pgmp("simulate", ROOT / "scenes" / f"{name}.toml", "--components", "-o", tmp_path / "run.h5").stdout
    assert "warning" not in said
    assert Trajectory.read(tmp_path / "run.h5").status == 0


WITH_THIRD = overridden(*THIRD, 'bodies.hand.mesh="crank_5.msh"', "reduction.angles=400")


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
    done = pgmp(command, scene, "-o", scene.parent / "none.h5", *WITH_THIRD, status=2)
    assert "400 along each would make 400^3 = 6.4e+07 configurations" in done.stderr and "Traceback" not in done.stderr
    assert not (scene.parent / "none.h5").exists()
