"""What a model in C does not have is refused by its name; what stands in the way of files is said."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from exported import scene_of
from refusals import assert_refused
from runs import QUICK_RETURN, quick_return, reduced_model

from pgmp_petsc.base.errors import InputError, RunError
from pgmp_petsc.c_export import constants, fmu
from pgmp_petsc.c_export.constants import checked_scene, constants_of, left_out
from pgmp_petsc.c_export.fmu import write_fmu
from pgmp_petsc.c_export.source import write_sources
from pgmp_petsc.models import ReducedModel
from pgmp_petsc.scene import Scene, scene_from_toml

STRESS = '[outputs.stress]\ntype = "stress"\nbody = "rocker"\nquantity = "stress_max"\n'


@pytest.fixture(scope="module")
def model() -> ReducedModel:
    return reduced_model(quick_return())


@pytest.mark.parametrize(
    ("scene", "entry"),
    [
        (lambda: scene_of("slider_crank", "simulation.tolerance=0.01"), "simulation.tolerance: the step"),
        (lambda: with_field(), "fields.stiff: a model in C has no random fields"),
    ],
)
def test_what_a_scene_asks_for(scene, entry) -> None:
    assert_refused(f"{entry}.*; it cannot be written", checked_scene, scene(), "it")


def test_a_stress_is_left_out_with_a_note(model) -> None:
    scene = scene_from_toml(QUICK_RETURN + STRESS, ".")
    assert left_out(scene).startswith("note: outputs.stress (stress) left out: a model in C has angle, ")
    counted = 'outputs.damage={type="rainflow",of="stress",curve={exponent=5.0,reference=1e8,cycles=1e6}}'
    both = left_out(scene_from_toml(QUICK_RETURN + STRESS, ".", (counted,)))
    assert "outputs.damage (rainflow) left out" in both and "rainflow of these; pgmp simulate" in both
    assert left_out(model.scene) == "" and checked_scene(model.scene, "it") is model.scene
    with_stress = ReducedModel(scene, model.rom, model.kinematics)
    assert list(with_stress.scene.outputs) == [*model.scene.outputs, "stress"]
    found, plain = constants_of(with_stress, "it"), constants_of(model, "it")
    assert found.output_units == plain.output_units and found.settings == plain.settings


def with_field() -> Scene:
    field = '[fields.stiff]\nbody = "rocker"\nquantity = "E"\nvariation = 0.1\nlength = 0.3\nterms = 2\n'
    return scene_from_toml(QUICK_RETURN + field, ".")


def test_tables_too_large(model, monkeypatch) -> None:
    monkeypatch.setattr(constants, "MOST_NUMBERS", 10)
    with pytest.raises(InputError, match=r"it: the tables have \d+ numbers; at most 10 are written\. Build with fewer"):
        constants_of(model, "it")
    with pytest.raises(InputError, match=r"12 numbers; at most 10 are written\. Most say where the rigid mechanism is"):
        constants.check_size({"terms_table": ("4", np.zeros(4)), "branch_table": ("8", np.zeros(8))}, "it")


@pytest.mark.parametrize("version", fmu.VERSIONS)
def test_an_fmu_without_a_compiler_has_sources(model, tmp_path, monkeypatch, version) -> None:
    monkeypatch.setattr(fmu.shutil, "which", lambda name: None)
    assert write_fmu(constants_of(model, "it"), tmp_path / "m.fmu", version) == ""
    with fmu.zipfile.ZipFile(tmp_path / "m.fmu") as archive:
        names = set(archive.namelist())
    assert {"modelDescription.xml", f"sources/fmi{version}.c", "sources/fmu.h", "sources/tables.c"} <= names
    assert ("sources/buildDescription.xml" in names) == (version == 3)
    assert not any(name.startswith("binaries") for name in names)


def test_names_of_variables_and_columns(model, tmp_path) -> None:
    found = constants_of(model, "it")
    (name, unit), *_ = found.strength_units.items()
    clash = {name: unit, f"{name}_follows_scene": unit}
    with pytest.raises(InputError, match=f"effects.{name}_follows_scene: .* for effects.{name}; give the effect"):
        write_fmu(replace(found, strength_units=clash), tmp_path / "m.fmu", compiler="true")
    with pytest.raises(InputError, match="outputs.validity: main.c prints a column of this name; give the output"):
        write_sources(replace(found, output_units={"validity": "m"}), tmp_path / "c")


def test_a_compiler_that_fails(model, tmp_path) -> None:
    with pytest.raises(RunError, match="C compiler false ended with status 1: no word"):
        write_fmu(constants_of(model, "it"), tmp_path / "m.fmu", compiler="false")
    assert not list(tmp_path.iterdir())


def test_folders(model, tmp_path) -> None:
    """A folder is written again; a file of others in it, or in its place, is not touched."""
    found = constants_of(model, "it")
    for _ in range(2):
        write_sources(found, tmp_path / "model")
    (tmp_path / "model" / "main.c").write_text("int main(void) { return 0; }\n")
    assert_refused(r"main\.c' exists and is not a model in C of this program", write_sources, found, tmp_path / "model")
    (tmp_path / "file").touch()
    assert_refused("is a file; give the name of a folder", write_sources, found, tmp_path / "file")
    assert_refused("cannot be made: No such file", write_sources, found, tmp_path / "none" / "model")


def test_what_an_older_version_called_otherwise_goes(model, tmp_path) -> None:
    """With it `cc *.c` would link everything twice; what is of others stays and is said."""
    write_sources(constants_of(model, "it"), tmp_path)
    older = tmp_path / "model.c"
    older.write_text((tmp_path / "steps.c").read_text())
    write_sources(constants_of(model, "it"), tmp_path)
    assert not older.exists()
    older.write_text("int mine;\n")
    assert_refused("model.c' exists and is not", write_sources, constants_of(model, "it"), tmp_path)


def test_an_fmu_takes_the_place_of_an_fmu_only(model, tmp_path) -> None:
    path = Path(tmp_path / "m.fmu")
    path.write_text("of others")
    assert_refused("is not a functional mock-up unit of this program", write_fmu, constants_of(model, "it"), path)
