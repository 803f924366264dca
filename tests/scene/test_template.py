"""Scenes to begin with: each is written with its mesh, is sound without a warning, is built, and runs."""

import re
import shlex
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI
from runs import one_message, said, trajectory

from pgmp_petsc.mechanism.capabilities import Purpose
from pgmp_petsc.scene.loading import template_names, write_template
from pgmp_petsc.stepping.status import Status
from pgmp_petsc.studies.inputs import read_scene

NAMES = ("arm", "four_bar", "gantry", "press", "rotor", "servo", "slider_crank", "solid_link", "spatial")
# a shortened run of a coarse model: 12 configurations of one coordinate, 4 x 4 of two
SHORT = ("simulation.duration=0.02", "simulation.step=1e-3", "reduction.modes=2")


@pytest.mark.parametrize("name", NAMES)
def test_a_template_is_sound_and_runs(name: str, tmp_path: Path) -> None:
    written = write_template(name, tmp_path / "mine.toml")
    assert set(tmp_path.iterdir()) == set(written)
    whole, _ = read_scene(written[0], (), (), MPI.COMM_SELF, Purpose.BUILD)
    assert whole.remarks == () and whole.name == name and whole.ensemble.probabilities
    assert all(parameter.distribution is not None for parameter in whole.parameters.values())
    # lines with numbers that are no counts and no shares say in which unit they are
    text = written[0].read_text()
    for line in text.splitlines():
        if re.match(r"(E|rho|duration|step|range|above|below|table|stiffness|pivot) = [^\"]", line):
            assert "#" in line, line
    assert "pgmp run mine.toml" in text and f"{name}.toml" not in text
    angles = 12 if len(whole.coordinates) == 1 else 4
    overrides = (*SHORT, f"reduction.angles={angles}")
    scene, meshes = read_scene(written[0], overrides, (), MPI.COMM_SELF, Purpose.BUILD)
    run = trajectory("reduced", scene, meshes)
    assert run.status == Status.FINE and run.time[-1] == pytest.approx(0.02)
    assert all(np.isfinite(values).all() for values in run.outputs.values())
    assert any(np.ptp(values) > 0.0 for values in run.outputs.values())


def test_files_are_replaced_with_force_alone(tmp_path: Path) -> None:
    scene, mesh = write_template("solid_link", tmp_path / "mine.toml")
    mesh.write_text("my own mesh")
    # neither of the two is written where one cannot be
    assert f"file '{mesh}' exists; give another name, or replace it with --force" in one_message(
        "new", "solid_link", tmp_path / "other.toml"
    )
    assert not (tmp_path / "other.toml").exists() and mesh.read_text() == "my own mesh"
    scene.write_text("mine")
    assert f"file '{scene}' exists" in one_message("new", "arm", scene)
    write_template("solid_link", scene, force=True)
    assert "[bodies.rod]" in scene.read_text() and "$MeshFormat" in mesh.read_text()


def test_what_to_try_next_can_be_pasted_into_a_shell(tmp_path: Path) -> None:
    file = tmp_path / "my o'arm.toml"
    out, _ = said("new", "arm", file)
    assert shlex.split(out.splitlines()[-1]) == ["try:", "pgmp", "run", str(file)]


def test_an_unknown_template_names_those_that_are_there_and_the_help_what_they_show(tmp_path: Path) -> None:
    assert tuple(template_names()) == NAMES
    known = ", ".join(NAMES)
    said_of = one_message("new", "xyzzy", tmp_path / "x.toml")
    assert said_of.endswith(f"template 'xyzzy': there is none; known: {known}\n")
    assert f"did you mean 'four_bar'?; known: {known}" in one_message("new", "four_bra", tmp_path / "x.toml")
    assert not list(tmp_path.iterdir())
    out, _ = said("new", "--help")
    assert all(re.search(rf"^  {name} +\w", out, re.MULTILINE) for name in NAMES)


@pytest.mark.parametrize(
    ("path", "expected"),
    [
        ("mine.txt", "scenes are TOML; name it '"),
        ("none/mine.toml", "does not exist; create it first"),
        ("folder.toml", "is a directory; give the name of a file in it, FILE.toml"),
    ],
)
def test_places_where_no_scene_can_be(path: str, expected: str, tmp_path: Path) -> None:
    (tmp_path / "folder.toml").mkdir()
    assert expected in one_message("new", "arm", tmp_path / path)
