"""``pgmp check --effects`` and ``effects = "auto"``: sizes against hand-worked figures, and the choice that follows."""

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
from cantilevers import BAR, BEAM_IN_SPACE, IN_SPACE, PLATE, bar_mesh, cantilever, ends, plate_mesh
from conftest import ROOT, run_mpi
from mpi4py import MPI
from runs import ONE_RANK, PGMP, overridden, pgmp
from solids import rectangle_mesh

from pgmp_petsc.base.errors import RunError
from pgmp_petsc.components.condensing import condensed
from pgmp_petsc.files.hdf5 import open_file
from pgmp_petsc.mechanism.capabilities import Purpose
from pgmp_petsc.mesh.meshes import straight_beam
from pgmp_petsc.results import EffectSizes
from pgmp_petsc.scene import Scene, load_scene, scene_to_toml
from pgmp_petsc.studies import building
from pgmp_petsc.studies.building import choose_effects, estimate_effects, remarks_on_sizes
from pgmp_petsc.studies.inputs import read_scene

FOUR_BAR, BEAM, FIVE_BAR = (ROOT / "scenes" / f"{name}.toml" for name in ("four_bar", "spinning_beam", "five_bar"))
QUICK = overridden("reduction.angles=12", "reduction.modes=2", "simulation.duration=0.2")
TINY = 'effects.tiny={type="joint_damping",joint="elbow",coefficient=1e-9}'


def read(path: Path, *overrides: str) -> tuple[Scene, dict]:
    return read_scene(path, overrides, [], MPI.COMM_SELF, Purpose.BUILD)


def sizes_of(path: Path, *overrides: str) -> EffectSizes:
    return estimate_effects(*read(path, *overrides))


def shares(sizes: EffectSizes) -> dict[str, float]:
    return {size.kind: size.share for size in sizes.sizes}


def test_of_a_mechanism_at_rest_nothing_is_judged_by_its_work() -> None:
    """What holds it still deforms it, whatever its work is beside round-off."""
    held = 'hold={type="prescribed_motion",coordinate="theta",table=[[0.0,0.3],[1.0,0.3]]}'
    load = 'load={type="torque",joint="elbow",table=[[0.0,1.0],[1.0,1.0]]}'
    found = sizes_of(FOUR_BAR, f"effects={{{held},{load}}}")
    assert found.exchanged == 0.0 and np.isnan([shares(found)[kind] for kind in ("torque", "gravity")]).all()
    assert [size.kind for size in found.sizes if size.name and size.keeps] == ["prescribed_motion", "torque"]
    assert not any(size.kind in ("joint_damping", "spring_damper") for size in found.sizes)
    text = "\n".join(found.lines())
    assert "0 J moved around" in text and "not known: the mechanism rests, so that no energy is moved around" in text


def test_the_shares_of_a_spinning_beam_are_those_of_the_closed_form() -> None:
    # clamped: omega_1 = 3.516 sqrt(EI / (rho A L^4)); its stiffness grows by 1.193 Omega^2 with the spin Omega (the
    # flapwise frequency's), which is 6 rad/s at most
    found, first = shares(sizes_of(BEAM)), 3.516 * np.sqrt(1.4e4 / (1.2 * 10.0**4))
    assert found["mode_inertia"] == pytest.approx(6.0 / first, rel=0.01)
    assert found["geometric_stiffening"] == pytest.approx(1.193 * 36.0 / first**2, rel=0.03)
    assert found["prescribed_motion"] == pytest.approx(1.0, abs=0.05)


SPIN = 4.0  # rad/s
CANTILEVERS = {
    "cells": (PLATE, (), plate_mesh),
    "solids": (BAR, (IN_SPACE,), bar_mesh),
    "beam in space": (BEAM_IN_SPACE, (IN_SPACE,), lambda: straight_beam(1.0, 16, 0.0, 3)),
}


@pytest.mark.parametrize("body", CANTILEVERS.values(), ids=CANTILEVERS)
def test_the_shares_of_other_spinning_bodies_are_those_of_the_closed_form(body: tuple) -> None:
    tables, more, mesh = body
    driven = ("simulation.duration=1.0", "simulation.step=1e-2", f"effects.hold.constant_speed.speed={SPIN}")
    sizes = estimate_effects(cantilever(tables, "", *more, *driven), {"beam": mesh()})
    found = shares(sizes)
    assert found["mode_inertia"] == pytest.approx(SPIN / 3.516, rel=5e-3)
    assert found["geometric_stiffening"] == pytest.approx(1.193 * SPIN**2 / 3.516**2, rel=0.01)
    # the square of the angle in a step of the rigid run
    assert sizes.largest_speed["theta"] == pytest.approx(SPIN, rel=2e-3)
    # the bar's centre of mass goes round a circle of half its length, with a mass of 1
    about = next(size for size in sizes.sizes if size.kind == "gravity").measure
    assert about.startswith("work of weights along -y" if not more else "work of weights along -x")


@pytest.mark.parametrize(("counts", "stretching"), [((12, 1), "static"), ((4, 2), "dynamic")])
def test_the_choice_follows_stretching_as_the_bodies_can(counts: tuple[int, int], stretching: str) -> None:
    """What bends like a plate has no long axis, along which its stretching could be told from bending."""
    driven = ("simulation.duration=0.5", "simulation.step=1e-2", f"effects.hold.constant_speed.speed={SPIN}")
    scene = cantilever(PLATE, "", *driven, "reduction.modes=3")
    height = 0.02 if stretching == "static" else 0.5
    meshes = {"beam": ends(rectangle_mesh("quad8", counts, (1.0, height)))}
    shapes = condensed(scene, meshes, ONE_RANK, large=True)
    chosen, _ = choose_effects(scene, meshes, shapes)
    assert chosen.effects["geometric_stiffening"].stretching == stretching
    assert chosen.second_order and chosen.static_stretching == (stretching == "static")


def test_the_choice_adds_terms_for_two_coordinates() -> None:
    scene, meshes = read(FIVE_BAR, "simulation.duration=0.2", "reduction.modes=2")
    chosen, sizes = choose_effects(scene, meshes, meshes)
    assert shares(sizes)["mode_inertia"] > sizes.tolerance
    assert chosen.second_order and chosen.static_stretching


def test_what_is_no_part_of_the_change_of_stiffness_is_named() -> None:
    def measure(*overrides: str) -> str:
        sizes = sizes_of(FOUR_BAR, "simulation.duration=0.05", *overrides).sizes
        return next(size.measure for size in sizes if size.kind == "geometric_stiffening")

    assert measure().endswith("by the forces in the bodies; forces of bearing are no part of it")
    damping = 'effects={motor={type="torque",joint="crank_hinge",table=[[0.0,0.1],[1.0,0.1]]}}'
    assert measure(damping).endswith("by the forces in the bodies")


def test_what_goes_with_another_term_is_said_so() -> None:
    """A share below the tolerance is not said to exceed it, by the check or by a build."""
    path, short = FIVE_BAR, "simulation.duration=0.2"
    sizes = sizes_of(path, short)
    assert shares(sizes)["geometric_stiffening"] < sizes.tolerance < shares(sizes)["mode_inertia"]
    (warned,) = (text for text in sizes.warnings if "geometric_stiffening" in text)
    assert warned.endswith("without which another term that it leaves out is not taken")
    beyond, beside = (remark.text for remark in remarks_on_sizes(*read(path, short)))
    assert "effects with shares beyond" in beyond and "mode_inertia" in beyond and "stiffening" not in beyond
    assert beside == warned


def test_several_ranks_condense_for_a_check() -> None:
    scene, short = ROOT / "scenes" / "slider_crank_solid2d.toml", "simulation.duration=0.1"
    printed = run_mpi(2, *PGMP, "check", scene, "--effects", "--override", short).stdout
    for line in sizes_of(scene, short).lines():
        assert re.sub(r"\S*e-\d\d+", "", line) in re.sub(r"\S*e-\d\d+", "", printed), line  # an angle of 1e-35 rad


@pytest.mark.parametrize(
    ("scene", "undamped", "threshold_of"),
    [
        ("four_bar", 'effects.bearing={type="gravity",acceleration=1e-6}', r"from (\S+) N m s/rad on \((\w+)\)"),
        ("spatial_mixed", "simulation.duration=0.05", r"(\S+) N s/m on \((guide)\)"),
    ],
)
def test_the_work_of_a_damper_is_its_share_and_its_threshold(scene: str, undamped: str, threshold_of: str) -> None:
    """What would matter from c on has, with c, a share of just the tolerance. Joints that slide have theirs; those
    about several axes have one, with the word that no effect can be on them."""
    path = ROOT / "scenes" / f"{scene}.toml"
    line = next(line for line in sizes_of(path, undamped).lines() if "(joint_damping)" in line)
    threshold, joint = re.search(threshold_of, line).groups()
    damper = f'effects.bearing={{type="joint_damping",joint="{joint}",coefficient={threshold}}}'
    found = {size.name: size for size in sizes_of(path, undamped, damper).sizes}
    assert found["bearing"].share == pytest.approx(1e-3, rel=0.1)
    several = "(ball, spherical)" in line or "(cross, universal)" in line
    assert several is (scene != "four_bar") is ("none can be on joints that turn about several axes" in line)


def test_a_cylindrical_joint_turns_and_slides() -> None:
    """A rod that is hinged to its slider turns it about the guide."""
    joints = ('joints.guide={type="cylindrical",connect=["ground:origin","slider:tip"],axis=[1.0,0.0,0.0]}',
              'joints.cross={type="revolute",connect=["slider:hinge","rod:tip"],axis=[0.0,0.0,1.0]}')  # fmt: skip
    sizes = sizes_of(ROOT / "scenes" / "spatial_mixed.toml", "simulation.duration=0.05", *joints)
    line = next(line for line in sizes.lines() if "(joint_friction)" in line)
    assert re.search(r" N on \(guide, sliding\)", line)


def test_a_slow_motion_leaves_the_terms_of_second_order_out() -> None:
    slow = "effects.motor.table=[[0.0,0.0],[1.0,1e-6]]"
    scene, meshes = read(FOUR_BAR, slow, TINY, "simulation.step=2e-3")
    chosen, sizes = choose_effects(scene, meshes, meshes)
    assert not chosen.second_order and not chosen.gyroscopic
    assert "motor" in chosen.effects and tomllib.loads(scene_to_toml(chosen))["reduction"]["second_order"] is False
    scene, meshes = read(FOUR_BAR, TINY, "simulation.step=2e-3")
    fast, _ = choose_effects(scene, meshes, meshes)
    assert fast.second_order and fast.gyroscopic
    assert list(fast.effects) == ["motor", "bearing", "material_damping", "stiffening", "shapes"]  # tiny is left out


def test_an_effect_that_samples_have_is_not_left_out() -> None:
    """One whose nominal strength is 0 is as large as in its largest sample; one that is small in all is named."""
    gust = 'effects.gust={type="law",joint="crank_hinge",force="-q * sin(s)",constants={q="wind"}}'
    for spread, is_kept in ((0.02, True), (2e-12, False)):
        drawn = f'parameters.wind={{nominal=0.0,distribution={{name="norm",loc=0.0,scale={spread}}}}}'
        scene, meshes = read(FOUR_BAR, TINY, gust, drawn, "simulation.step=2e-3")
        chosen, sizes = choose_effects(scene, meshes, meshes)
        (found,) = (size for size in sizes.sizes if size.name == "gust")
        assert ("gust" in chosen.effects) is found.keeps is is_kept, found
        assert re.search(r"its work, of the energy moved around, at wind = ", found.measure)
        (told,) = (remark.text for remark in chosen.remarks if "leaves out" in remark.text)
        assert told.startswith('reduction.effects = "auto" leaves out') and ("gust (share" in told) is not is_kept


def test_an_effect_whose_size_in_samples_is_not_known_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    """The rigid mechanism's run stops at either end of the wind's samples."""
    gust = 'effects.gust={type="law",joint="crank_hinge",force="-q * sin(s)",constants={q="wind"}}'
    drawn = 'parameters.wind={nominal=0.0,distribution={name="norm",loc=0.0,scale=0.02}}'
    scene, meshes = read(FOUR_BAR, TINY, gust, drawn, "simulation.step=2e-3")
    run = building.run_rigid

    def stopping(own: Scene, *given: object) -> building.RigidRun:
        if own.values["wind"] != 0.0:
            raise RunError("the rigid mechanism's run stopped at 1 ms")
        return run(own, *given)

    monkeypatch.setattr(building, "run_rigid", stopping)
    chosen, sizes = choose_effects(scene, meshes, meshes)
    (found,) = (size for size in sizes.sizes if size.name == "gust")
    assert "gust" in chosen.effects and found.keeps
    assert re.fullmatch(r"not known: the rigid mechanism's run stopped at 1 ms, at wind = -0.059\d+", found.measure)


def test_of_what_moves_out_of_the_range_no_sizes_are_known() -> None:
    """The motion is prescribed from 0 to 0.1 rad, and the model goes from 0.45 to 0.55 rad."""
    moved = 'effects={drive={type="prescribed_motion",coordinate="theta",table=[[0.0,0.0],[0.2,0.1]]}}'
    scene = read(
        FOUR_BAR, moved, "coordinates.theta={joint='crank_hinge',range=[0.45,0.55]}", "simulation.duration=0.2"
    )
    (remark,) = remarks_on_sizes(*scene)
    assert "nowhere within coordinates.theta.range" in remark.text


def test_check_prints_sizes_and_warns() -> None:
    done = pgmp("check", FOUR_BAR, "--effects", *QUICK)
    assert re.search(r"motor \(torque\) +1  keep", done.stdout)
    assert "warning: the scene leaves out gravity" in done.stdout
    assert "sizes of effects" not in pgmp("check", FOUR_BAR).stdout
    scene = load_scene(FOUR_BAR, ['effects="auto"'])
    assert (scene.effects, scene.reduction.effects) == ({}, "auto")


def test_a_build_prints_the_choice_and_keeps_it(tmp_path: Path) -> None:
    rom = tmp_path / "rom.h5"
    options = (*QUICK, *overridden('reduction.effects="auto"', TINY))
    done = run_mpi(2, *PGMP, "build", FOUR_BAR, "-o", rom, *options)
    assert re.search(r"tiny \(joint_damping\) .* leave", done.stdout)
    with open_file(rom, "rom") as file:
        sizes, scene = EffectSizes.found_in(file), tomllib.loads(file.attrs["scene"])
    assert {size.name for size in sizes.sizes if size.name and not size.keeps} == {"tiny"}
    assert list(scene["effects"]) == ["motor", "bearing", "material_damping", "stiffening", "shapes"]
    assert re.search(r"effects, chosen by their size\n.*rad/s", pgmp("info", rom).stdout)
