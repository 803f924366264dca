"""Bad input: exit status 2, one clear message that names the entry, no traceback, no hang; on one rank and on three."""

import re
from pathlib import Path

import meshio
import numpy as np
import pytest
from conftest import run_mpi
from refusals import cases
from runs import PAPER_SCENE, PGMP, SMALL, one_message, overridden, paper_scene, pgmp, refused, rom_of
from sealed import resealed

from pgmp_petsc.results import Ensemble, Trajectory
from pgmp_petsc.stepping.status import Status

SCENES = {"SCENE": PAPER_SCENE.stem, "SOLID": "slider_crank_solid2d", "FOUR_BAR": "four_bar"}
SCENES |= {"PENDULUM": "double_pendulum", "RSSR": "rssr_beams"}
#: What words of `REFUSED` stand for.
WORDS = {name: str(PAPER_SCENE.with_name(f"{stem}.toml")) for name, stem in SCENES.items()}
WORDS |= {"ROM": "FOLDER/rom.h5", "OUT": "FOLDER/out.h5", "SMALL": " & ".join(SMALL)}
WORDS["SHORT_ROD"] = """bodies.rod.mesh="FOLDER/short.vtu" & joints.elbow.connect=["crank:tip", "rod:0"] & \
joints.slider.connect=["ground:origin", "rod:2"] & outputs.slider_position.point="rod:2" & \
outputs.slider_deformation.point="rod:2\""""
WORDS["NO_SLIDER"] = """joints={crank_hinge={type="revolute", connect=["ground:origin", "crank:hinge"]}, \
elbow={type="revolute", connect=["crank:tip", "rod:hinge"]}}"""
WORDS["BAR"] = """{line={length=0.1, elements=3}, element="beam3d", material="aluminium", \
section={shape="rectangle", width=0.008, height=0.012}}"""
WORDS["OF_COEFFICIENTS"] = """{line={length=0.9, elements=5}, element="beam2d", section={shape="coefficients", \
axial=2e7, shear=6e6, bending=160.0, line_density=0.77, rotary_density=6e-6}}"""
WORDS["STRESS"] = 'outputs.high={type="stress", body='
#: Commands, their overrides, and words of the message; * also on three ranks.
REFUSED = cases("""
# in space
* check RSSR & joints.cross.second_axis=[0.0, 2.0, 0.0] -> joints.cross.second_axis = [0.0, 2.0, 0.0]
* check RSSR & bodies.crank=BAR -> bodies.crank.orientation: missing | orientation = [x, y, z]
check RSSR & bodies.crank.orientation=[1.0, 0.0, 0.0] -> \
    bodies.crank.orientation = [1.0, 0.0, 0.0]: parallel to element 0
* check RSSR & bodies.coupler.element="beam2d" -> bodies.coupler | beam2d | beam3d
check RSSR & bodies.coupler.line.start=1e30 -> bodies.coupler.line.start = 1e+30: | lost in round-off
check RSSR & bodies.coupler.line={length=5.0, elements=8} -> joints. | cannot close at theta = 0 rad | m remains
# forces in joints
* check SCENE & outputs.f={type="joint_force", joint="elbow", component="up"} -> outputs.f.component = "up" | radial
* check SCENE & outputs.f={type="drive_torque", joint="elbow"} -> outputs.f.joint = "elbow": no prescribed motion
* check SCENE & effects.m={type="prescribed_motion", coordinate="xi", constant_speed={speed=1.0}} & \
    outputs.f={type="drive_torque", joint="elbow"} -> effects.m.coordinate = "xi": there is no such coordinate
# rigid bodies
* simulate SCENE --full -o OUT & bodies.crank={rigid={mass=2.0, inertia=0.1, points={hinge=[0.0, 0.0]}}} -> \
    joints.elbow.connect = "crank:tip": there is no such point | 'crank:hinge'
# stresses
* check SOLID & STRESS"rd", quantity="von_mises"} -> outputs.high.body = "rd" | mean 'rod'
* check SCENE & STRESS"rod", quantity="von_mises"} -> \
    outputs.high.quantity = "von_mises": a beam2d has no such quantity | axial_force, shear_force, bending_moment
check SOLID & STRESS"rod", quantity="bending_moment"} -> a solid2d has no such quantity | von_mises, principal_max
check SCENE & STRESS"rod", quantity="torsion_moment"} -> a beam2d has no such
check SOLID & STRESS"rod", quantity="von_mises", group="tip", at=[0.5, 0.0]} -> \
    outputs.high.group: at most one of at, group, region is needed; at and group are given
check SOLID & STRESS"rod", quantity="von_mises", at=[0.5, 0.0, 0.0]} -> \
    outputs.high.at = [0.5, 0.0, 0.0] | two numbers
check SCENE & STRESS"rod", quantity="axial_force", region="tip"} -> outputs.high.region = "tip" | no regions
* check SOLID & STRESS"rod", quantity="von_mises", at=[2.0, 0.0]} -> \
    outputs.high.at = [2.0, 0.0]: outside the mesh of rod, which reaches from ( | nearest node is at (1,
* build SCENE -o OUT & STRESS"rod", quantity="axial_force", at=[0.5, 0.1]} -> \
    outputs.high.at = [0.5, 0.1]: outside the mesh of rod
* simulate SOLID --full -o OUT & STRESS"rod", quantity="von_mises", group="tp"} -> \
    outputs.high.group = "tp": the mesh has no group of faces of this name; did you mean 'tip'?
check SOLID & STRESS"rod", quantity="von_mises", region="web"} -> outputs.high.region = "web": the mesh has no region
check SCENE & STRESS"rod", quantity="stress_max", group="tipp"} -> outputs.high.group = "tipp" | mean 'tip'
check SOLID & bodies.crank.flexible=false & STRESS"crank", quantity="von_mises"} -> \
    outputs.high.body = "crank": this body is rigid
check SOLID & bodies.rod.section_scale=1.0 & STRESS"rod", quantity="von_mises"} -> \
    outputs.high.body = "rod": a body with section_scale has no stress outputs
* check FOUR_BAR & bodies.coupler=OF_COEFFICIENTS & STRESS"coupler", quantity="stress_max"} -> \
    outputs.high.quantity = "stress_max": a section given by coefficients has no outermost fibre
# entries of a scene; 5 m between pivots, 0.3 + 0.9 + 0.7 m of bars
check FOUR_BAR & ground.points.pivot=[5.0, 0.0] -> joints. | cannot close at theta = 0 rad; a gap of 3.1 m remains
* check SCENE & simulation.dration=1.0 -> simulation.dration = 1.0 | did you mean 'duration'
check SCENE & simulations.step=1.0 -> simulations | did you mean 'simulation'
check SCENE & simulation.step="fast" -> simulation.step = "fast" | number is needed
check SCENE & bodies.crank.section.radius=0.0 -> bodies.crank.section.radius = 0.0 | positive
check SCENE --set r1=-1 & parameters.r1={nominal=5e-3} -> parameters.r1.value = -1.0 | positive
check SCENE & reduction.modes=31 -> reduction.modes = 31 | only 30 flexible modes
* build SCENE -o OUT & reduction.modes=31 -> reduction.modes = 31 | only 30 flexible modes
# meshes and points
* check SCENE & bodies.crank.mesh="nothing.msh" -> bodies.crank.mesh | nothing.msh | no such file
check SCENE & bodies.crank.mesh="FOLDER/triangle.vtu" -> bodies.crank.mesh | cells of type triangle
check SCENE & bodies.crank.mesh="FOLDER/words.msh" -> bodies.crank.mesh | meshio cannot read
* check SCENE & joints.slider.connect=["ground:origin", "rod:tipp"] -> \
    joints.slider.connect = "tipp" | did you mean 'tip'
# mechanisms and effects
* check SCENE & SHORT_ROD -> cannot close at theta = | joints.
build SCENE -o OUT & outputs.x={type="position", point="rod:nowhere", axis="x"} -> \
    outputs.x.point = "nowhere" | no point of this name
build SCENE -o OUT & SHORT_ROD -> cannot close at theta = | joints.
check SCENE & ground.points.pin=[0.3, 0.0] & joints.pin={type="revolute", connect=["ground:pin", "crank:tip"]} -> \
    joints: they leave the rigid mechanism 0 degrees of freedom | What bends alone | a rigid body beside it
check SCENE & NO_SLIDER -> joints: they leave the rigid mechanism 2 degrees of freedom
* check SCENE & coordinates.second={joint="elbow", range=[-1.0, 1.0]} -> \
    they leave the rigid mechanism 1 degree of freedom | theta, second
* check SCENE & effects.hold={type="prescribed_motion", coordinate="theta", constant_speed={speed=1.0}} -> \
    effects.hold.coordinate = "theta": contradicts effects.motor
check SCENE & effects.shapes={type="mode_inertia"} -> effects.shapes | geometric_stiffening | or neither
* check FOUR_BAR & bodies.crank.line.length=0.6 -> coordinates.theta: it does not control | 3.14159 rad | singular value
build PENDULUM -o OUT & reduction.tolerance=0.01 & reference.budget=1e-3 -> \
    reduction.tolerance = 0.01: no reference is within reference.budget = 0.001 s | predicted for the mesh | \
    of the component model | raise reference.budget | name reference.model ("mesh" or "components") | shorten
build SCENE -o OUT & reduction.tolerance=0.01 & reference.model="truth" -> reference.model | truth | mesh | components
build SCENE -o OUT & reduction.tolerance=0.01 & reference.budget=0.0 -> reference.budget | 0.0 | greater than 0
simulate SCENE --full -o OUT & simulation={tolerance=0.01, duration=1.0} & reference.budget=1e-3 -> \
    simulation.tolerance = 0.01: to find the step, the full-order model has to run | \
    reference.budget = 0.001 | give simulation.step
# files
* check FOLDER/slider_crnk.toml -> slider_crnk.toml | no such scene file
check FOLDER/words.msh -> words.msh | not valid TOML
check ROM -> rom.h5 | a scene is a TOML file
simulate ROM --full -o OUT -> --full | rom.h5' is a reduced model; give its scene
* simulate SCENE -o OUT -> slider_crank_paper.toml | needed: a reduced model
montecarlo SCENE -n 2 -o OUT -> slider_crank_paper.toml | needed: a reduced model
* simulate FOLDER/nothing.h5 -o OUT -> nothing.h5 | does not exist
* montecarlo FOLDER/nothing.h5 -n 2 -o OUT -> nothing.h5 | does not exist
* modes SCENE --rom FOLDER/nothing.h5 -o OUT -> nothing.h5 | does not exist
* plot FOLDER/nothing.h5 -o FOLDER/pictures -> nothing.h5 | does not exist
* export FOLDER/nothing.h5 -o FOLDER/x.xdmf -> nothing.h5 | does not exist
* info FOLDER/nothing.h5 -> nothing.h5 | does not exist
* simulate FOLDER/cut.h5 -o OUT -> cut.h5 | is damaged: it is cut off
simulate FOLDER/future.h5 -o OUT -> future.h5 | format version 99
* simulate FOLDER/older.h5 -o OUT -> older.h5 | format version 2 | build it again with pgmp build
* simulate FOLDER/nan.h5 -o OUT -> nan.h5 | /tables/stiffness | NaN | build it again
simulate FOLDER/kind.h5 -o OUT -> kind.h5 | trajectory | needed: a reduced model
simulate FOLDER/empty.h5 -o OUT -> empty.h5 | /tables/mass' is missing | build it again
* simulate ROM -o FOLDER/no/such/out.h5 -> no/such | does not exist
build SCENE -o FOLDER/no/such/out.h5 -> no/such | does not exist
montecarlo ROM -n 2 -o FOLDER -> is a directory
# the command line
* build SCENE -o OUT --ranks-per-angle 4 -> --ranks-per-angle = 4 | the number of ranks
modes SCENE -o OUT --ranks-per-angle 4 -> --ranks-per-angle = 4
* montecarlo ROM -n 0 -o OUT -> -n | 0
montecarlo ROM -n 1 --seed -1 -o OUT -> --seed | -1
run SCENE -n 0 -o OUT -> -n | 0
modes SCENE -o OUT --angles 1 -> --angles | 1
* simulate ROM -o OUT --set r2=1.0 -> --set r2=1.0 | no parameter 'r2' | known: r1
simulate ROM -o OUT --set r1 -> --set r1 | NAME=VALUE is needed
simulate ROM -o OUT --set r1=thick -> --set r1=thick | not a finite number
simulate ROM -o OUT --set r1=1.0 -> parameters.r1.value = 1.0 | bounds [0.001, 0.012]
simulate ROM -o OUT & scene.name=x y -> --override scene.name | not a TOML value
simulate ROM -o OUT & =1 -> --override =1 | dotted
simulat ROM -> no command 'simulat' | did you mean 'simulate'
simulate ROM -o OUT --stp 1 -> --stp
* build SCENE -o OUT & parameters.r1={nominal=5.6e-3} & reduction.parameter_modes=2 -> \
    reduction.parameter_modes = 2 | no parameter has a distribution
check SCENE & reduction.parameter_modes=-1 -> reduction.parameter_modes | -1
# models and what they were built from
* simulate ROM -o OUT & reduction.modes=3 -> --override reduction | pgmp build
simulate ROM -o OUT & bodies.rod.section.radius=1e-3 -> --override bodies | pgmp build
simulate ROM -o OUT & materials.steel.E=1e9 -> --override materials | pgmp build
simulate ROM -o OUT & parameters.r1.nominal=5e-3 -> --override parameters.r1.nominal | pgmp build
simulate ROM -o OUT & effects.weight={type="gravity"} -> --override effects | pgmp build
simulate ROM -o OUT & effects.motor.scale=2.0 -> --override effects.motor | pgmp build
* modes SCENE --rom ROM -o OUT & bodies.rod.section.radius=6e-3 & SMALL -> --rom | [bodies] differs
* modes SCENE --rom ROM -o OUT & parameters.more={nominal=1.0} & effects.motor.scale="more" & SMALL -> \
    --rom | other parameters: more; build it from this scene
* montecarlo ROM -n 2 -o OUT & parameters.r1={nominal=5.6e-3} -> parameters: none has a distribution
montecarlo ROM -n 2 -o OUT --set r1=5e-3 -> --set r1=5e-3 | parameters.r1.distribution | --override
montecarlo ROM -n 1 --seed 18446744073709551616 -o OUT -> --seed | 9223372036854775807
* simulate FOLDER/limited.h5 -o OUT & simulation.initial.theta.position=2.0 -> \
    simulation.initial.theta.position = 2.0 | range
export ROM -o FOLDER/x.xdmf -> rom.h5 | has no frames, a trajectory has
export ROM -o FOLDER/x.c -> x.c' | or as an FMU (-o
export SCENE -o FOLDER/x.fmu -> needed: a reduced model
export ROM -o FOLDER/m --fmi 3 -> --fmi 3 is for FMUs, and
export SCENE -o FOLDER/x.xdmf --fmi 2 -> --fmi 2 is for FMUs
export ROM -o FOLDER/m.fmu --fmi 1 -> --fmi | 1 | 2<=x<=3
export SCENE -o FOLDER/x.xdmf --set r1=5e-3 -> --set and --override are for
info ROM -- -log_view -> 'info' does not use PETSc
# the trade-off study
* tradeoff SCENE -o OUT & outputs={} -> outputs: the scene has none
* tradeoff FOLDER/slider_crnk.toml -o OUT -> no such scene file
tradeoff ROM -o OUT -> rom.h5 | a scene is a TOML file
tradeoff SCENE -o OUT & SHORT_ROD -> cannot close at theta = | joints.
tradeoff SCENE -o FOLDER/no/out.h5 -> /no' | does not exist
* tradeoff SCENE -o FOLDER -> is a directory
tradeoff SCENE -n 0 -o OUT -> -n | 0
""")


def asked_of(case: str, folder: Path) -> list[str]:
    for word, meaning in {**WORDS, "FOLDER": str(folder)}.items():
        case = re.sub(rf"\b{word}(?=\b|[\"{{])", lambda _: meaning, case)  # noqa: B023
    words, *overrides = case.removeprefix("* ").split(" & ")
    return [*words.split(), *overridden(*overrides)]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a directory with sound and spoilt files."""
    folder = tmp_path_factory.mktemp("spoilt")
    rom = folder / "rom.h5"
    rom_of(paper_scene(*SMALL)).write(rom)
    limited = ("coordinates.theta.range=[-0.2, 0.45]", "coordinates.theta.periodic=false", "simulation.duration=0.335")
    rom_of(paper_scene(*SMALL, *limited)).write(folder / "limited.h5")
    whole = rom.read_bytes()
    (folder / "cut.h5").write_bytes(whole[: len(whole) // 2])
    changes = {"future": {"format": 99}, "older": {"format": 2}, "kind": {"kind": "trajectory"}, "empty": {}, "nan": {}}
    for name, change in changes.items():
        (folder / f"{name}.h5").write_bytes(whole)
        with resealed(folder / f"{name}.h5", **change) as file:
            if name == "nan":
                file["tables/stiffness"][0] = np.nan
            elif name == "empty":
                del file["tables"]
    corners = np.array([[0.0, 0.0, 0.0], [0.3, 0.0, 0.0], [0.0, 0.1, 0.0]])
    meshio.Mesh(corners, [("triangle", np.array([[0, 1, 2]]))]).write(folder / "triangle.vtu")
    line = np.array([[0.3, 0.0, 0.0], [0.4, 0.0, 0.0], [0.5, 0.0, 0.0]])
    meshio.Mesh(line, [("line", np.array([[0, 1], [1, 2]]))]).write(folder / "short.vtu")
    (folder / "words.msh").write_text("a mechanism, in words\n")
    return folder


@pytest.mark.parametrize(("asked", "said"), REFUSED)
def test_one_clear_message(asked: str, said: str, folder: Path) -> None:
    before = sorted(folder.iterdir())
    err = one_message(*asked_of(asked, folder))
    assert all(words in err for words in said.split(" | ")), err
    assert sorted(folder.iterdir()) == before, "nothing is left behind"


def test_one_clear_message_on_three_ranks(folder: Path) -> None:
    chosen = [case for case in REFUSED if case[0].startswith("* ")]
    messages = refused(3, [asked_of(asked, folder) for asked, _ in chosen])
    for (asked, said), message in zip(chosen, messages):
        assert all(words in message for words in said.split(" | ")), asked


def test_several_wrong_entries_are_told_at_once() -> None:
    wrong = overridden("simulation.dration=1.0", "materials.steel.E=0", "reduction.modes=0")
    err = pgmp("check", PAPER_SCENE, *wrong, status=2).stderr
    for words in ("simulation.dration", "materials.steel.E", "reduction.modes"):
        assert words in err


def test_a_run_that_leaves_the_range_ends_with_its_reason(folder: Path) -> None:
    path = folder / "left_3.h5"
    done = run_mpi(3, *PGMP, "simulate", folder / "limited.h5", "-o", path, check_status=1)
    assert "pgmp: error: reduced simulation stopped at 0." in done.stderr
    assert done.stderr.count(Status.LEFT_RANGE.meaning) == 1
    assert "Traceback" not in done.stderr
    part = Trajectory.read(path)
    said = part.record.remarks[0].text
    assert part.status == Status.LEFT_RANGE and said.startswith("reduced simulation stopped at 0.")
    assert part.time.size > 1 and all(np.isfinite(values).all() for values in part.outputs.values())
    assert said in pgmp("export", path, "-o", folder / "left_3.csv").stdout  # a table is of a part too


def test_samples_that_leave_the_range_are_recorded_and_the_others_go_on(folder: Path) -> None:
    path = folder / "left.h5"
    done = pgmp("montecarlo", folder / "limited.h5", "-n", 16, "-o", path, status=1)
    found = Ensemble.read(path)
    left = found.status == Status.LEFT_RANGE
    assert 0 < left.sum() < 16
    np.testing.assert_array_equal(found.status[~left], 0)
    assert np.all((found.failure_time[left] > 0.2) & (found.failure_time[left] <= 0.335))
    np.testing.assert_array_equal(np.isnan(found.outputs["crank_angle"]), left)
    assert np.all(found.outputs["crank_angle"][~left] < 0.46)
    assert np.isfinite(found.outputs["slider_deformation"][~left]).all()
    assert f"{left.sum()} of 16 samples failed (status 3): {Status.LEFT_RANGE.meaning}" in done.stdout
