"""Families of ideas: what is read in the text of their rooms is what there is, and nothing else is imported."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from pgmp_petsc.declare.ideas import FAMILIES, JOINTS, PACKAGE, Family
from pgmp_petsc.scene.joints import JointEntry, try_statements

SCENES = Path(__file__).parents[2] / "scenes"


@pytest.mark.parametrize("family", FAMILIES, ids=lambda family: family.what)
def test_names_in_the_text_of_a_room_are_those_of_its_classes(family: Family) -> None:
    own = {
        name: cls.__module__ for name, cls in zip(family.names, family.found()) if cls.__module__.startswith(PACKAGE)
    }
    assert own == family.modules
    assert all(family.named(name).model_fields[family.key].annotation.__args__ == (name,) for name in own)


def test_the_joints_of_the_package_are_whole() -> None:
    # those of plugins are looked at where they are taken
    joints = [cls for cls in JOINTS.found() if issubclass(cls, JointEntry)]
    assert len(joints) > 5
    for cls in joints:
        try_statements(cls)


@pytest.mark.parametrize(
    ("scene", "waited_for", "left_alone"),
    [
        ("slider_crank", {"outputs.of_frames"}, {"outputs.joint_forces", "outputs.rainflow", "joints.coupled"}),
        ("geared_five_bar", {"joints.coupled"}, {"outputs.stress", "controllers.pid"}),
    ],
)
def test_a_scene_waits_for_the_ideas_that_it_names(scene: str, waited_for: set[str], left_alone: set[str]) -> None:
    lines = f"import sys, pgmp_petsc as pgmp; pgmp.load({str(SCENES / scene)!r} + '.toml'); print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", lines], capture_output=True, text=True, check=True)
    imported = set(done.stdout.split())
    assert {PACKAGE + one for one in waited_for} <= imported
    assert imported.isdisjoint(PACKAGE + one for one in left_alone)


def test_the_law_of_a_plugin_has_no_name_of_one_that_nobody_asked_for(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(
        "from pgmp_petsc.effects.law import Law\n\n"
        "mine = Law('free_play', ('k',), force='-k * s', left_out='it is a test')\n"
    )
    lines = f"import pgmp_petsc as pgmp; pgmp.use({str(tmp_path / 'mine.py')!r})"
    done = subprocess.run([sys.executable, "-c", lines], capture_output=True, text=True)
    assert re.search(r"mine.py:3: the name 'free_play' is taken by .*free_play.py; take another one", done.stderr)
