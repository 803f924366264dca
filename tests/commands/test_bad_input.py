"""Bad input: exit status 2, one clear message that names the entry, no traceback, no hang; on one rank and on three."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import meshio
import numpy as np
import pytest
from runs import IN_TURN, PAPER_SCENE, PGMP, SMALL, overridden, paper_scene, pgmp, rom_of
from sealed import resealed

from pgmp_petsc.cli.main import main
from pgmp_petsc.results import Ensemble, Trajectory
from pgmp_petsc.stepping.status import Status


@dataclass(frozen=True)
class Case:
    """A command and words of its message; ``{folder}`` is the directory of prepared files."""

    arguments: tuple[str, ...]
    words: tuple[str, ...]


SCENE = str(PAPER_SCENE)
FOUR_BAR, PENDULUM = PAPER_SCENE.with_name("four_bar.toml"), PAPER_SCENE.with_name("double_pendulum.toml")
RSSR = PAPER_SCENE.with_name("rssr_beams.toml")
ROM, OUT = "{folder}/rom.h5", "{folder}/out.h5"


def check(*overrides: str, words: tuple[str, ...]) -> Case:
    """Return the check of the scene with overrides."""
    return Case(("check", SCENE, *overridden(*overrides)), words)


def build(*overrides: str, words: tuple[str, ...]) -> Case:
    return Case(("build", SCENE, "-o", OUT, *overridden(*overrides)), words)


def with_rom(*arguments: str, words: tuple[str, ...]) -> Case:
    return Case(("simulate", ROM, "-o", OUT, *arguments), words)


SHORT_ROD = (
    'bodies.rod.mesh="{folder}/short.vtu"',
    'joints.elbow.connect=["crank:tip", "rod:0"]',
    'joints.slider.connect=["ground:origin", "rod:2"]',
    'outputs.slider_position.point="rod:2"',
    'outputs.slider_deformation.point="rod:2"',
)
NO_SLIDER = (
    'joints={{crank_hinge={{type="revolute", connect=["ground:origin", "crank:hinge"]}}, '
    'elbow={{type="revolute", connect=["crank:tip", "rod:hinge"]}}}}'
)

BAR = 'line={{length=0.1, elements=3}}, element="beam3d", material="aluminium"'
MOUNT = 'effects.mount={{type="bushing", points=["ground:pivot", "coupler:tip"], stiffness=[1.0, 1.0, 1.0]'


def in_space(override: str, *words: str) -> Case:
    """Return the check of the spatial four-bar with an override."""
    return Case(("check", str(RSSR), "--override", override), words)


IN_SPACE = {
    "hinge without an axis": in_space(
        'joints.crank_hinge={{type="revolute", connect=["ground:origin", "crank:hinge"]}}',
        "joints.crank_hinge.axis: missing",
        "axis (x, y, z)",
    ),
    "axis of no length": in_space(
        "joints.crank_hinge.axis=[0.0, 0.0, 0.0]", "joints.crank_hinge.axis = [0.0, 0.0, 0.0]"
    ),
    "parallel axes": in_space("joints.cross.second_axis=[0.0, 2.0, 0.0]", "joints.cross.second_axis = [0.0, 2.0, 0.0]"),
    "section without an orientation": in_space(
        f'bodies.crank={{{{{BAR}, section={{{{shape="rectangle", width=0.008, height=0.012}}}}}}}}',
        "bodies.crank.orientation: missing",
        "orientation = [x, y, z]",
    ),
    "orientation along the beam": in_space(
        "bodies.crank.orientation=[1.0, 0.0, 0.0]",
        "bodies.crank.orientation = [1.0, 0.0, 0.0]: parallel to element 0",
    ),
    "a beam of the plane in space": in_space('bodies.coupler.element="beam2d"', "bodies.coupler", "beam2d", "beam3d"),
    "bushing without a reference": in_space(f"{MOUNT}}}}}", "effects.mount.reference: missing"),
    "bushing of parallel axes": in_space(
        f"{MOUNT}, reference=[[1.0, 0.0, 0.0], [2.0, 0.0, 0.0]]}}}}",
        "effects.mount.reference",
        "parallel",
    ),
    "bushing with half a reference": in_space(
        f"{MOUNT}, reference=[[1.0, 0.0, 0.0]]}}}}",
        "effects.mount.reference = [[1.0, 0.0, 0.0]]",
        "two axes",
    ),
    "force without a direction": in_space(
        'effects.pull={{type="force", point="coupler:tip", direction=[0.0, 0.0, 0.0], table=[[0.0, 1.0], [1.0, 1.0]]}}',
        "effects.pull.direction = [0.0, 0.0, 0.0]",
    ),
    # the coupler is 5 m long, and no more than 0.1 + 0.25 m and the distance of the pivots are between its ends
    "joints that contradict each other": in_space(
        "bodies.coupler.line={{length=5.0, elements=8}}",
        "joints.",
        "cannot close at theta = 0 rad",
        "m remains",
    ),
}

SOLID = PAPER_SCENE.with_name("slider_crank_solid2d.toml")


def stress(scene: Path, entries: str, *words: str, command: tuple[str, ...] = ("check",)) -> Case:
    """Return a command with a stress output of the scene."""
    override = f'outputs.high={{{{type="stress", {entries}}}}}'
    return Case((command[0], str(scene), *command[1:], "--override", override), words)


STRESSES = {
    "stress of no body": stress(SOLID, 'body="rd", quantity="von_mises"', 'outputs.high.body = "rd"', "mean 'rod'"),
    "stress of a beam's cells": stress(
        PAPER_SCENE,
        'body="rod", quantity="von_mises"',
        'outputs.high.quantity = "von_mises": a beam2d has no such quantity',
        "axial_force, shear_force, bending_moment, stress_max, stress_min",
    ),
    "moment of a solid": stress(
        SOLID, 'body="rod", quantity="bending_moment"', "a solid2d has no such quantity", "von_mises, principal_max"
    ),
    "torsion in the plane": stress(PAPER_SCENE, 'body="rod", quantity="torsion_moment"', "a beam2d has no such"),
    "two places of a stress": stress(
        SOLID,
        'body="rod", quantity="von_mises", group="tip", at=[0.5, 0.0]',
        "outputs.high.group: at most one of at, group, region is needed; at and group are given",
    ),
    "place of a stress in space": stress(
        SOLID,
        'body="rod", quantity="von_mises", at=[0.5, 0.0, 0.0]',
        "outputs.high.at = [0.5, 0.0, 0.0]",
        "two numbers",
    ),
    "region of a beam": stress(
        PAPER_SCENE, 'body="rod", quantity="axial_force", region="tip"', 'outputs.high.region = "tip"', "no regions"
    ),
    "stress outside the mesh": stress(
        SOLID,
        'body="rod", quantity="von_mises", at=[2.0, 0.0]',
        "outputs.high.at = [2.0, 0.0]: outside the mesh of rod, which reaches from (",
        "its nearest node is at (1, ",
    ),
    "stress beside a beam": stress(
        PAPER_SCENE,
        'body="rod", quantity="axial_force", at=[0.5, 0.1]',
        "outputs.high.at = [0.5, 0.1]: outside the mesh of rod",
        command=("build", "-o", OUT),
    ),
    "stress of an unknown group": stress(
        SOLID,
        'body="rod", quantity="von_mises", group="tp"',
        "outputs.high.group = \"tp\": the mesh has no group of faces of this name; did you mean 'tip'?",
        command=("simulate", "--full", "-o", OUT),
    ),
    "stress of an unknown region": stress(
        SOLID, 'body="rod", quantity="von_mises", region="web"', 'outputs.high.region = "web": the mesh has no region'
    ),
    "stress at an unknown point of a beam": stress(
        PAPER_SCENE, 'body="rod", quantity="stress_max", group="tipp"', 'outputs.high.group = "tipp"', "mean 'tip'"
    ),
    "stress of a rigid body": Case(
        (
            "check",
            str(SOLID),
            *overridden(
                "bodies.crank.flexible=false", 'outputs.high={{type="stress", body="crank", quantity="von_mises"}}'
            ),
        ),
        ('outputs.high.body = "crank": this body is rigid',),
    ),
    "stress of a scaled section": Case(
        (
            "check",
            str(SOLID),
            *overridden(
                "bodies.rod.section_scale=1.0", 'outputs.high={{type="stress", body="rod", quantity="von_mises"}}'
            ),
        ),
        ('outputs.high.body = "rod": a body with section_scale has no stress outputs',),
    ),
    "fibre of a section by coefficients": Case(
        (
            "check",
            str(FOUR_BAR),
            *overridden(
                'bodies.coupler={{line={{length=0.9, elements=5}}, element="beam2d", section={{shape="coefficients", '
                "axial=2e7, shear=6e6, bending=160.0, line_density=0.77, rotary_density=6e-6}}}}",
                'outputs.high={{type="stress", body="coupler", quantity="stress_max"}}',
            ),
        ),
        ('outputs.high.quantity = "stress_max": a section given by coefficients has no outermost fibre',),
    ),
}

CASES = {
    **IN_SPACE,
    **STRESSES,
    # 5 m between the pivots, 0.3 + 0.9 + 0.7 m of bars
    "bars too short for their pivots": Case(
        ("check", str(FOUR_BAR), "--override", "ground.points.pivot=[5.0, 0.0]"),
        ("joints.", "cannot close at theta = 0 rad; a gap of 3.1 m remains"),
    ),
    # entries of a scene
    "unknown key": check("simulation.dration=1.0", words=("simulation.dration = 1.0", "did you mean 'duration'")),
    "unknown table": check("simulations.step=1.0", words=("simulations", "did you mean 'simulation'")),
    "wrong type": check('simulation.step="fast"', words=('simulation.step = "fast"', "number is needed")),
    "step beyond the end": check(
        "simulation.step=2.0",
        words=("simulation.step = 2.0", "must not exceed the duration"),
    ),
    "radius of zero": check("bodies.crank.section.radius=0.0", words=("bodies.crank.section.radius = 0.0", "positive")),
    "negative radius": check(
        "bodies.rod.section.radius=-1e-3",
        words=("bodies.rod.section.radius = -0.001", "positive"),
    ),
    "nominal radius of zero": check("parameters.r1={{nominal=0.0}}", words=("parameters.r1.nominal = 0.0", "positive")),
    "set radius": Case(
        ("check", SCENE, "--override", "parameters.r1={{nominal=5e-3}}", "--set", "r1=-1"),
        ("parameters.r1.value = -1.0", "positive"),
    ),
    "E of zero": check("materials.steel.E=0", words=("materials.steel.E = 0", "positive")),
    "negative rho": check("materials.steel.rho=-7800.0", words=("materials.steel.rho = -7800.0", "positive")),
    "nu": check("materials.steel.nu=0.5", words=("materials.steel.nu = 0.5", "less than 0.5")),
    "unknown material": check('bodies.rod.material="stel"', words=("bodies.rod.material", "did you mean 'steel'")),
    "unknown effect": check('effects.motor.type="tork"', words=("effects.motor.type", "torque")),
    "unknown distribution": check(
        'parameters.r1.distribution.name="nrom"', words=("parameters.r1.distribution.name", "nrom")
    ),
    "too many modes": check("reduction.modes=31", words=("reduction.modes = 31", "only 30 flexible modes")),
    "too many modes, build": build("reduction.modes=31", words=("reduction.modes = 31", "only 30 flexible modes")),
    # meshes and points
    "missing mesh": check(
        'bodies.crank.mesh="nothing.msh"',
        words=("bodies.crank.mesh", "nothing.msh", "no such file"),
    ),
    "triangles": check(
        'bodies.crank.mesh="{folder}/triangle.vtu"',
        words=("bodies.crank.mesh", "cells of type triangle"),
    ),
    "not a mesh": check('bodies.crank.mesh="{folder}/words.msh"', words=("bodies.crank.mesh", "meshio cannot read")),
    "unknown point": check(
        'joints.slider.connect=["ground:origin", "rod:tipp"]',
        words=('joints.slider.connect = "tipp"', "did you mean 'tip'"),
    ),
    "unknown body": check(
        'joints.slider.connect=["ground:origin", "rd:tip"]', words=("joints.slider.connect", "did you mean 'rod'")
    ),
    "unknown ground point": check(
        'joints.slider.connect=["ground:orign", "rod:tip"]',
        words=("joints.slider.connect", "did you mean 'ground:origin'"),
    ),
    "unknown output point": check(
        'outputs.slider_position.point="rod:top"', words=("outputs.slider_position.point", "did you mean 'tip'")
    ),
    # mechanisms
    "too short a rod": check(*SHORT_ROD, words=("cannot close at theta = ", "joints.")),
    "an output nowhere, build": build(
        'outputs.x={{type="position", point="rod:nowhere", axis="x"}}',
        words=('outputs.x.point = "nowhere"', "no point of this name"),
    ),
    "too short a rod, build": build(*SHORT_ROD, words=("cannot close at theta = ", "joints.")),
    "no freedom": check(
        "ground.points.pin=[0.3, 0.0]",
        'joints.pin={{type="revolute", connect=["ground:pin", "crank:tip"]}}',
        words=("joints: they leave the rigid mechanism 0 degrees of freedom",),
    ),
    "two degrees of freedom": check(NO_SLIDER, words=("joints: they leave the rigid mechanism 2 degrees of freedom",)),
    "two coordinates": check(
        'coordinates.second={{joint="elbow", range=[-1.0, 1.0]}}',
        words=("they leave the rigid mechanism 1 degrees of freedom", "theta, second"),
    ),
    # effects
    "unknown effect that is like another": check(
        'effects.guide={{type="joint_frction"}}', words=("effects.guide.type", "joint_friction")
    ),
    "effect on the wrong joint": check(
        'effects.push={{type="torque", joint="slider", table=[[0.0, 1.0]]}}',
        words=('effects.push.joint = "slider"', "a revolute joint is needed"),
    ),
    "contradictory effects": check(
        'effects.hold={{type="prescribed_motion", coordinate="theta", constant_speed={{speed=1.0}}}}',
        words=('effects.hold.coordinate = "theta": contradicts effects.motor',),
    ),
    "half of second order": check(
        'effects.shapes={{type="mode_inertia"}}', words=("effects.shapes", "geometric_stiffening", "or neither")
    ),
    "change point": Case(
        ("check", str(FOUR_BAR), *overridden("bodies.crank.line.length=0.6")),
        ("coordinates.theta: it does not control", "3.14159 rad", "singular value"),
    ),
    "no reference within the budget": Case(
        ("build", str(PENDULUM), "-o", OUT, *overridden("reduction.tolerance=0.01", "reference.budget=1e-3")),
        (
            "reduction.tolerance = 0.01: no reference is within reference.budget = 0.001 s",
            "predicted for the mesh",
            "of the component model",
            "raise reference.budget",
            'name reference.model ("mesh" or "components")',
            "shorten simulation.duration",
        ),
    ),
    "a reference that there is not": Case(
        ("build", SCENE, "-o", OUT, *overridden("reduction.tolerance=0.01", 'reference.model="truth"')),
        ("reference.model", "truth", "mesh", "components"),
    ),
    "no budget": Case(
        ("build", SCENE, "-o", OUT, *overridden("reduction.tolerance=0.01", "reference.budget=0.0")),
        ("reference.budget", "0.0", "greater than 0"),
    ),
    "a step too dear to find": Case(
        (
            "simulate",
            SCENE,
            "--full",
            "-o",
            OUT,
            *overridden("simulation={{tolerance=0.01, duration=1.0}}", "reference.budget=1e-3"),
        ),
        (
            "simulation.tolerance = 0.01: to find the step, the full-order model has to run",
            "reference.budget = 0.001",
            "give simulation.step",
        ),
    ),
    # files
    "no scene": Case(("check", "{folder}/slider_crnk.toml"), ("slider_crnk.toml", "no such scene file")),
    "no TOML": Case(("check", "{folder}/words.msh"), ("words.msh", "not valid TOML")),
    "a model for a scene": Case(("check", ROM), ("rom.h5", "a scene is a TOML file")),
    "a model for a scene, full": Case(("simulate", ROM, "--full", "-o", OUT), ("rom.h5", "a scene is a TOML file")),
    "a scene for a model": Case(("simulate", SCENE, "-o", OUT), ("slider_crank_paper.toml", "needed: a reduced model")),
    "a scene for a model, ensemble": Case(
        ("montecarlo", SCENE, "-n", "2", "-o", OUT), ("slider_crank_paper.toml", "needed: a reduced model")
    ),
    "no model": Case(("simulate", "{folder}/nothing.h5", "-o", OUT), ("nothing.h5", "does not exist")),
    "cut off": Case(("simulate", "{folder}/cut.h5", "-o", OUT), ("cut.h5", "is damaged: it is cut off")),
    "other version": Case(("simulate", "{folder}/future.h5", "-o", OUT), ("future.h5", "format version 99")),
    "older version": Case(
        ("simulate", "{folder}/older.h5", "-o", OUT), ("older.h5", "format version 2", "build it again with pgmp build")
    ),
    "not finite": Case(("simulate", "{folder}/nan.h5", "-o", OUT), ("nan.h5", "/tables/stiffness", "NaN", "build it again")),
    "other kind": Case(
        ("simulate", "{folder}/kind.h5", "-o", OUT),
        ("kind.h5", "trajectory", "needed: a reduced model"),
    ),
    "without tables": Case(("simulate", "{folder}/empty.h5", "-o", OUT), ("empty.h5", "/tables/mass' is missing", "build it again")),
    "no directory": Case(("simulate", ROM, "-o", "{folder}/no/such/out.h5"), ("no/such", "does not exist")),
    "no directory, build": Case(("build", SCENE, "-o", "{folder}/no/such/out.h5"), ("no/such", "does not exist")),
    "directory for a file": Case(("montecarlo", ROM, "-n", "2", "-o", "{folder}"), ("is a directory",)),
    # the command line
    "ranks per angle": Case(
        ("build", SCENE, "-o", OUT, "--ranks-per-angle", "4"), ("--ranks-per-angle = 4", "the number of ranks")
    ),
    "ranks per angle, modes": Case(("modes", SCENE, "-o", OUT, "--ranks-per-angle", "4"), ("--ranks-per-angle = 4",)),
    "no samples": Case(("montecarlo", ROM, "-n", "0", "-o", OUT), ("-n", "0")),
    "negative seed": Case(("montecarlo", ROM, "-n", "1", "--seed", "-1", "-o", OUT), ("--seed", "-1")),
    "one angle": Case(("modes", SCENE, "-o", OUT, "--angles", "1"), ("--angles", "1")),
    "unknown parameter": with_rom("--set", "r2=1.0", words=("--set r2=1.0", "no parameter 'r2'", "known: r1")),
    "no value": with_rom("--set", "r1", words=("--set r1", "NAME=VALUE is needed")),
    "no number": with_rom("--set", "r1=thick", words=("--set r1=thick", "not a finite number")),
    "out of bounds": with_rom("--set", "r1=1.0", words=("parameters.r1.value = 1.0", "bounds [0.001, 0.012]")),
    "no TOML value": with_rom("--override", "scene.name=x y", words=("--override scene.name", "not a TOML value")),
    "no key": with_rom("--override", "=1", words=("--override =1", "dotted")),
    "no output": Case(("simulate", ROM), ("-o",)),
    "no such command": Case(("simulat", ROM), ("no command 'simulat'", "did you mean 'simulate'")),
    "no such option": with_rom("--stp", "1", words=("--stp",)),
    "nowhere to take modes": Case(
        ("build", SCENE, "-o", OUT, *overridden("parameters.r1={{nominal=5.6e-3}}", "reduction.parameter_modes=2")),
        ("reduction.parameter_modes = 2", "no parameter has a distribution"),
    ),
    "too many parameter modes": Case(
        ("build", SCENE, "-o", OUT, *overridden("reduction.parameter_modes=9", *SMALL)),
        ("reduction.parameter_modes = 9", "independent at every configuration"),
    ),
    "negative parameter modes": Case(
        ("check", SCENE, *overridden("reduction.parameter_modes=-1")), ("reduction.parameter_modes", "-1")
    ),
    # models and what they were built from
    "modes of a model": with_rom("--override", "reduction.modes=3", words=("--override reduction", "pgmp build")),
    "section of a model": with_rom(
        "--override",
        "bodies.rod.section.radius=1e-3",
        words=("--override bodies", "pgmp build"),
    ),
    "material of a model": with_rom(
        "--override",
        "materials.steel.E=1e9",
        words=("--override materials", "pgmp build"),
    ),
    "nominal of a model": with_rom(
        "--override", "parameters.r1.nominal=5e-3", words=("--override parameters.r1.nominal", "pgmp build")
    ),
    "effect of a model": with_rom(
        "--override",
        'effects.weight={{type="gravity"}}',
        words=("--override effects", "pgmp build"),
    ),
    "scale of a model": with_rom(
        "--override",
        "effects.motor.scale=2.0",
        words=("--override effects.motor", "pgmp build"),
    ),
    "model of another scene": Case(
        ("modes", SCENE, "--rom", ROM, "-o", OUT, *overridden("bodies.rod.section.radius=6e-3", *SMALL)),
        ("--rom", "[bodies] differs"),
    ),
    "nothing to draw": Case(
        ("montecarlo", ROM, "-n", "2", "-o", OUT, *overridden("parameters.r1={{nominal=5.6e-3}}")),
        ("parameters: none has a distribution",),
    ),
    "value of a drawn parameter": Case(
        ("montecarlo", ROM, "-n", "2", "-o", OUT, "--set", "r1=5e-3"),
        ("--set r1=5e-3", "parameters.r1.distribution", "--override"),
    ),
    "seed that no file can hold": Case(
        ("montecarlo", ROM, "-n", "1", "--seed", "18446744073709551616", "-o", OUT),
        ("--seed", "9223372036854775807"),
    ),
    "start outside the range": Case(
        ("simulate", "{folder}/limited.h5", "-o", OUT, "--override", "simulation.initial.theta.position=2.0"),
        ("simulation.initial.theta.position = 2.0", "range"),
    ),
    "export of a model": Case(("export", ROM, "-o", "{folder}/x.xdmf"), ("rom.h5", "has no frames, a trajectory has")),
    "a model and an ending": Case(("export", ROM, "-o", "{folder}/x.c"), ("x.c'", "or as an FMU (-o ")),
    "an FMU of a trajectory": Case(("export", SCENE, "-o", "{folder}/x.fmu"), ("needed: a reduced model",)),
    "a version of FMI for C99": Case(("export", ROM, "-o", "{folder}/m", "--fmi", "3"), ("--fmi 3 is for FMUs, and",)),
    "a version of FMI for XDMF": Case(
        ("export", SCENE, "-o", "{folder}/x.xdmf", "--fmi", "2"), ("--fmi 2 is for FMUs",)
    ),
    "a version of FMI that is none": Case(
        ("export", ROM, "-o", "{folder}/m.fmu", "--fmi", "1"), ("--fmi", "1", "2<=x<=3")
    ),
    "parameters of a trajectory": Case(
        ("export", SCENE, "-o", "{folder}/x.xdmf", "--set", "r1=5e-3"), ("--set and --override are for",)
    ),
    "options for PETSc": Case(("info", ROM, "--", "-log_view"), ("'info' does not use PETSc",)),
    # the trade-off study
    "no outputs": Case(("tradeoff", SCENE, "-o", OUT, *overridden("outputs={{}}")), ("outputs: the scene has none",)),
    "no scene, trade-off": Case(("tradeoff", "{folder}/slider_crnk.toml", "-o", OUT), ("no such scene file",)),
    "a model for a scene, trade-off": Case(("tradeoff", ROM, "-o", OUT), ("rom.h5", "a scene is a TOML file")),
    "too short a rod, trade-off": Case(
        ("tradeoff", SCENE, "-o", OUT, *overridden(*SHORT_ROD)), ("cannot close at theta = ", "joints.")
    ),
    "no directory, trade-off": Case(("tradeoff", SCENE, "-o", "{folder}/no/out.h5"), ("/no'", "does not exist")),
    "directory, trade-off": Case(("tradeoff", SCENE, "-o", "{folder}"), ("is a directory",)),
    "no samples, trade-off": Case(("tradeoff", SCENE, "-n", "0", "-o", OUT), ("-n", "0")),
}
ON_THREE_RANKS = (
    *IN_SPACE,
    *STRESSES,
    "unknown key",
    "missing mesh",
    "unknown point",
    "too short a rod",
    "too short a rod, build",
    "two coordinates",
    "unknown effect",
    "contradictory effects",
    "change point",
    "older version",
    "not finite",
    "too many modes, build",
    "cut off",
    "a scene for a model",
    "no directory",
    "ranks per angle",
    "no samples",
    "unknown parameter",
    "modes of a model",
    "nothing to draw",
    "start outside the range",
    "model of another scene",
    "no outputs",
    "directory, trade-off",
    "nowhere to take modes",
    "too many parameter modes",
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a directory with sound and spoilt files."""
    folder = tmp_path_factory.mktemp("spoilt")
    rom = folder / "rom.h5"
    rom_of(paper_scene(*SMALL)).write(rom)
    rom_of(
        paper_scene(
            *SMALL,
            "coordinates.theta.range=[-0.2, 0.45]",
            "coordinates.theta.periodic=false",
            "simulation.duration=0.335",
        )
    ).write(folder / "limited.h5")
    whole = rom.read_bytes()
    (folder / "cut.h5").write_bytes(whole[: len(whole) // 2])
    for name in ("future", "older", "kind", "empty", "nan"):
        (folder / f"{name}.h5").write_bytes(whole)
    with resealed(folder / "nan.h5") as file:
        file["tables/stiffness"][0] = np.nan
    for name, change in (("future", {"format": 99}), ("older", {"format": 2}), ("kind", {"kind": "trajectory"})):
        with resealed(folder / f"{name}.h5", **change):
            pass
    with resealed(folder / "empty.h5") as file:
        del file["tables"]
    corners = np.array([[0.0, 0.0, 0.0], [0.3, 0.0, 0.0], [0.0, 0.1, 0.0]])
    meshio.Mesh(corners, [("triangle", np.array([[0, 1, 2]]))]).write(folder / "triangle.vtu")
    line = np.array([[0.3, 0.0, 0.0], [0.4, 0.0, 0.0], [0.5, 0.0, 0.0]])
    meshio.Mesh(line, [("line", np.array([[0, 1], [1, 2]]))]).write(folder / "short.vtu")
    (folder / "words.msh").write_text("a mechanism, in words\n")
    return folder


def arguments_of(name: str, folder: Path) -> list[str]:
    return [argument.format(folder=folder) for argument in CASES[name].arguments]


@pytest.mark.parametrize("name", CASES)
def test_one_clear_message(name: str, folder: Path, capfd: pytest.CaptureFixture[str]) -> None:
    before = sorted(folder.iterdir())
    with pytest.raises(SystemExit) as end:
        main(arguments_of(name, folder))
    out, err = capfd.readouterr()
    assert end.value.code == 2, err
    assert err.startswith("pgmp: error: ")
    assert err.count("\n") == 1, "one line"
    for words in CASES[name].words:
        assert words in err
    assert "Traceback" not in out + err
    assert out == ""
    assert sorted(folder.iterdir()) == before, "nothing is left behind"


def test_one_clear_message_on_three_ranks(mpirun: Callable, folder: Path) -> None:
    commands = [arguments_of(name, folder) for name in ON_THREE_RANKS]
    done = mpirun(3, "-c", IN_TURN, json.dumps(commands))
    assert [json.loads(line) for line in done.stdout.splitlines()] == [[2, 2, 2]] * len(commands)
    messages = [line for line in done.stderr.splitlines() if line.startswith("pgmp: ")]
    assert len(messages) == len(commands), done.stderr
    for name, message in zip(ON_THREE_RANKS, messages):
        for words in CASES[name].words:
            assert words in message, name
    assert "Traceback" not in done.stderr


def test_the_exit_status_comes_through_mpirun(mpirun: Callable, folder: Path) -> None:
    done = mpirun(3, *PGMP, "simulate", folder / "cut.h5", "-o", folder / "out.h5", check_status=2)
    assert done.stderr.count("pgmp: error: ") == 1


def test_as_a_user_sees_it(folder: Path) -> None:
    done = pgmp("simulate", folder / "cut.h5", "-o", folder / "out.h5", status=2)
    assert done.stdout == ""
    assert done.stderr.startswith("pgmp: error: file '") and done.stderr.count("\n") == 1


def test_several_wrong_entries_are_told_at_once(capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main(["check", SCENE, *overridden("simulation.dration=1.0", "materials.steel.E=0", "reduction.modes=0")])
    err = capfd.readouterr().err
    assert end.value.code == 2
    for words in ("simulation.dration", "materials.steel.E", "reduction.modes"):
        assert words in err


@pytest.mark.parametrize("n_ranks", [1, 3])
def test_a_run_that_leaves_the_range_ends_with_its_reason(mpirun: Callable, folder: Path, n_ranks: int) -> None:
    path = folder / f"left_{n_ranks}.h5"
    done = mpirun(n_ranks, *PGMP, "simulate", folder / "limited.h5", "-o", path, check_status=1)
    assert "pgmp: error: reduced simulation stopped at 0." in done.stderr
    assert done.stderr.count(Status.LEFT_RANGE.meaning) == 1
    assert "Traceback" not in done.stderr
    part = Trajectory.read(path)
    assert part.status == Status.LEFT_RANGE and part.record.remarks[0].text.startswith(
        "reduced simulation stopped at 0."
    )
    assert part.time.size > 1 and all(np.isfinite(values).all() for values in part.outputs.values())


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
