"""Nonsense: entries that cannot be meant are refused, entries that probably are not get a warning; each by its name."""

import tomllib
from pathlib import Path

import meshio
import numpy as np
import pytest
from mpi4py import MPI
from refusals import cases, refusal

import pgmp_petsc as pgmp
from pgmp_petsc.base.errors import InputError
from pgmp_petsc.base.units import OTHERS, SI
from pgmp_petsc.mechanism.capabilities import Purpose
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.outputs.outputs import OutputSet
from pgmp_petsc.studies.inputs import read_scene
from pgmp_petsc.studies.plausibility import plausibility
from pgmp_petsc.studies.plausibility.bodies import bending_excess

ROOT = Path(__file__).resolve().parents[2]
SCENE = ROOT / "scenes" / "slider_crank.toml"
EFFECTS = ROOT / "scenes" / "slider_crank_effects.toml"
SOLID = ROOT / "scenes" / "slider_crank_solid2d.toml"
DRIVEN = ROOT / "scenes" / "spinning_beam.toml"
CRANE = ROOT / "scenes" / "bridge_crane.toml"
GEARED = ROOT / "scenes" / "geared_four_bar.toml"
FREELY = 'effects.drive={type="joint_damping", joint="rear", motion="sliding", coefficient=1.0}'
BEGUN = "simulation.initial.x.position=1.0"

#: Of scenes: overrides, the entry that is named, and words of the reason; each is refused.
REFUSED = {
    SCENE: """
parameters.r1={nominal=5.6} -> parameters.r1.nominal | longer than thick
bodies.rod.section.radius=11 -> bodies.rod.section.radius | 22 m thick and 0.7 m long
bodies.rod.section={shape="rectangle", width=0.01, height=2.0} -> bodies.rod.section.height | longer than thick
bodies.rod.section.radius=1e100 -> bodies.rod.section.radius | 1e+30
bodies.rod.section.radius=1e-200 -> bodies.rod.section.radius | 1e-30
coordinates.theta={joint="crank_hinge", range=[0, 90]} ->
    coordinates.theta.range | looks like degrees: it is in rad, and 14.32 turns long; write [0, 1.5708]
coordinates.theta={joint="crank_hinge", range=[0, 180]} -> coordinates.theta.range | write [0, 3.1416], or take 100 rad
coordinates.theta={joint="crank_hinge", range=[-50, 50]} -> coordinates.theta.range | of 5: [-50, 49.9]
coordinates.theta={joint="crank_hinge", range=[0, 360], periodic=true} -> coordinates.theta.range | not in degrees
simulation.step=1.0 -> simulation.step | one step for the whole run
simulation.step=1e-9 -> simulation.step | 1e+09 steps
simulation.duration=1e18 -> simulation.step | simulation.duration = 1e+18
effects.motor.table=[[0.0, 0.0], [1.0, 1e12]] -> effects.motor.table | faster than light
effects.motor.scale=1e12 -> effects.motor.table | faster than light
effects.f={type="force", point="rod:tip", direction=[1, 0], harmonic={amplitude=1e13, frequency_hz=1.0}} ->
    effects.f.harmonic | faster than light
simulation.initial.theta.velocity=1e10 -> simulation.initial.theta.velocity | faster than light
simulation.initial.theta.position=1e300 -> simulation.initial.theta.position | 1e+30
simulation.initial.theta.position=1e9 -> simulation.initial.theta.position | within 1,000,000 rad
effects.d={type="joint_damping", joint="elbow", coefficient=-1.0} -> effects.d.coefficient | not negative
effects.d={type="joint_damping", joint="elbow", coefficient="q"} & parameters.q={nominal=-1.0} ->
    parameters.q.nominal | must not be negative
effects.d={type="spring_damper", joint="elbow", damping=-1.0} -> effects.d.damping | not negative
effects.stop={type="end_stop", joint="crank_hinge", stiffness=100.0, lower=99.0} -> effects.stop.lower | 99 rad beyond
reduction.angles=1000000000000000000 -> reduction.angles | at most 1,000,000
bodies.rod={line={length=0.7, elements=1000000000000000000}, element="beam2d", material="steel",
    section={shape="circle", radius=5e-3}} -> bodies.rod.line.elements | at most 100,000
reduction.modes=1000000000000000000 -> reduction.modes | at most 10,000
ensemble.bins=100000000000 -> ensemble.bins | at most 1,000,000
ensemble.batch=1000000000000 -> ensemble.batch | at most 1,000,000
simulation.frames=1000000000 -> simulation.frames | at most 1,000,000
reduction.angles=1000000 & reduction.modes=5000 -> reduction.angles | GB
coordinates.theta={joint='crank_hinge', range=[0.0, 1000.0]} -> coordinates.theta.range | 159.2 turns
bodies.spare={line={length=1.0, elements=2}, element='beam2d', material='steel', section={shape='circle', radius=0.01}}
    -> bodies.spare | no joint connects it
materials.steel.E="q" & parameters.q={nominal=210, unit="Pa", distribution={name="norm", loc=210e9, scale=10e9}} ->
    parameters.q.nominal | is one of them in another unit
materials.steel.E="q" & parameters.q={nominal=210, unit="GPa", distribution={name="norm", loc=210e9, scale=10e9}} ->
    parameters.q.nominal | unit
parameters.r1.unit="Pa" -> parameters.r1.unit | needs m
materials.steel.E="r1" -> parameters.r1 | different quantities
""",
    EFFECTS: """
parameters.friction={nominal=-1.0, unit="N"} -> parameters.friction.nominal | not be negative
effects.buffer.rest=-0.6 -> effects.buffer.rest | not negative
effects.bumper.upper=-99 -> effects.bumper.upper | m beyond this stop
""",
}

#: Likewise; each gives a warning.
WARNED = {
    SCENE: """
reduction.interpolation="overhauser" & joints.elbow.elastic={reference=[[1.0, 0.0]], stiffness=[1e7, 1e7],
    damping=[1.0, 1.0]} -> reduction.interpolation | joints.elbow is elastic
materials.steel.E=210 -> materials.steel.E | waves run through steel
materials.steel.E=210e12 -> materials.steel.E | waves run
materials.steel.E="q" & parameters.q={nominal=210.0} -> parameters.q.nominal | waves run
materials.steel.rho=7.8 -> materials.steel.rho | steel has 7800
materials.steel.rho=7.8e6 -> materials.steel.rho | 25,000 kg/m3
materials.steel.nu=-0.3 -> materials.steel.nu | negative
parameters.r1={nominal=0.05} -> parameters.r1.nominal | 3 times as long as thick
effects.d={type="joint_damping", joint="elbow", coefficient="q"} & parameters.q={nominal=2e-3, value=2.0,
    distribution={name="norm", loc=2e-3, scale=1e-4}} -> parameters.q.value | 1e+03 times the median
parameters.r1={nominal=0.3} & bodies.crank.flexible=false -> parameters.r1.nominal | 0.6 m thick and 0.3 m long
bodies.rod={line={length=0.7, elements=1001}, element="beam2d", material="steel", section={shape="circle",
    radius=5.6e-3}} -> bodies.rod.line.elements | digits
bodies.rod={line={length=0.7, elements=1}, element="beam2d", material="steel", section={shape="circle", radius=5.6e-3}}
    -> bodies.rod.line.elements | does not bend between hinged ends
bodies.rod={line={length=0.7, elements=2}, element="beam2d", material="steel", section={shape="circle", radius=5.6e-3}}
    -> bodies.rod.line.elements | frequency is 40 % too high
parameters.r1.distribution.scale=0.1 -> parameters.r1.bounds | % of its distribution lies beyond
parameters.r1={nominal=5.6e-3, distribution={name='norm', loc=5.6e-3, scale=5e-3}} ->
    parameters.r1.distribution | below 0
parameters.r1={nominal=5.6e-3, distribution={name='norm', loc=8e-3, scale=1e-4}} ->
    parameters.r1.nominal | lies outside its distribution
parameters.r1={nominal=5.6e-3, distribution={name='discrete', values=[0.0, 5.6e-3]}} ->
    parameters.r1.distribution | 50 % of it is at or below 0
effects.f={type="joint_friction", joint="elbow", limit="q", speed=1.0} & effects.z={type="torque", joint="crank_hinge",
    table=[[0.0, 0.0], [1.0, 1.0]], scale="q"} & parameters.q={nominal=2e-3, unit="N m", distribution={name="norm",
    loc=2e-3, scale=2e-3}} -> parameters.q.distribution | % of it is below 0
parameters.q={nominal=1.0} -> parameters.q | nothing uses it
materials.wood={E=1e10, nu=0.3, rho=600.0} -> materials.wood | no body is made of it
ground.points.far=[1.0, 2.0] -> ground.points.far | nothing is attached
outputs={} -> outputs | reports nothing
effects.a={type="gravity"} & effects.b={type="gravity", direction=[1, 0]} -> effects.b | second gravity
effects.a={type="gravity", acceleration=-9.81} -> effects.a.acceleration | negative
effects.a={type="gravity", acceleration=9810} -> effects.a.acceleration | ten times
effects.a={type="joint_damping", joint="elbow", coefficient=0} -> effects.a.coefficient | leave it out
effects.a={type="joint_friction", joint="elbow", limit=0.0, speed=1.0} -> effects.a.limit | leave it out
effects.a={type="spring_damper", joint="elbow", damping=1e-3, rest=0.2} -> effects.a.rest | there is no stiffness
reduction.stretching="dynamic" & reduction.second_order=false -> reduction.stretching | reduction.second_order is false
reduction.max_angles=99 & reduction.parameter_modes=0 -> reduction.max_angles | as there is no
reduction.length_points=4 -> reduction.length_points | no parameter is a leng
outputs.seen={type="speed", point="rod:tip", axis="x", absolute=true} -> outputs.seen.absolute | no base_motion
ensemble.replicates=16 -> ensemble.replicates | it is for "sobol"
ensemble.copula_freedom=9.0 -> ensemble.copula_freedom | as ensemble.copula = "gaussian"
ensemble.bands=0 & ensemble.band_samples=99 -> ensemble.band_samples | as ensemble.bands = 0
effects.a={type="gravity", acceleration=0.0} -> effects.a.acceleration | leave it out
effects.again={type="torque", joint="crank_hinge", table=[[0.0, 0.0], [0.25, 0.5], [1.0, 0.5]]} ->
    effects.again | the same as effects.motor
effects.motor.table=[[5.0, 0.0], [6.0, 1.0]] -> effects.motor.table | after the run's end
effects.motor.table=[[-2.0, 0.0], [-1.0, 1.0]] -> effects.motor.table | before
effects.motor.table=[[0.0, 0.0], [2.0, 0.0], [3.0, 1.0]] -> effects.motor.table | never acts
effects.motor.table=[[-2.0, 1.0], [-1.0, 0.0], [2.0, 0.0]] -> effects.motor.table | zero from 0 s to the run's end
effects.motor.table=[[0.0, 0.0], [1.0, 0.0]] -> effects.motor.table | zero in all
effects.motor.scale=0.0 -> effects.motor.scale | zero
effects.motor.scale=1e4 -> effects.motor.table | if nothing holds it
effects.m={type="point_mass", point="rod:tip", mass=1e6} -> effects.m.mass | 1,000 times
effects.s={type="spring_damper", joint="elbow", stiffness=-1.0} -> effects.s.stiffness | away from its rest
effects.s={type="spring_damper", joint="elbow", stiffness=1e20} -> effects.s.stiffness | so stiff
effects.d={type="structural_damping", stiffness=1.0} -> effects.d.stiffness | critical
effects.d={type="structural_damping", mass=1e6} -> effects.d.mass | critical
effects.stop={type="end_stop", joint="crank_hinge", stiffness=100.0, lower=0.1} -> effects.stop.lower | 0.1 rad beyond
simulation.step=0.2 -> simulation.step | only 5 steps
coordinates.theta={joint="crank_hinge", range=[0, 20]} -> coordinates.theta.range | is it in degrees?
bodies.rod.placement={origin=[0.3, 0.0], angle=-10} -> bodies.rod.placement.angle | is it in degrees?
simulation.initial.theta.position=45.0 -> simulation.initial.theta.position | is it in degrees?
simulation.step=0.02 -> simulation.step | the first mode of the mechanism has
simulation.step=1.1e-8 -> simulation.step | steps to simulation.duration
simulation.initial.theta.velocity=1e5 -> simulation.initial.theta.velocity | rad/s
simulation.initial.theta.position=10000.0 -> simulation.initial.theta.position | 1,000 turns
coordinates.theta={joint='crank_hinge', range=[0.0, 1e-6]} -> coordinates.theta.range | hardly a range
reduction.angles=100000 & reduction.modes=29 & reduction.second_order=true -> reduction.angles | GB
""",
    CRANE: """
effects.drive={type="joint_damping", joint="rear", motion="sliding", coefficient=1.0} &
    simulation.initial.x.position=1.0 -> joints.rear.type | the slope of the bent beam drives it
""",
    GEARED: """
bodies.coupler.placement.angle=0.7 -> joints.mesh | counts from where bodies are placed
""",
    DRIVEN: """
coordinates.theta.range=[0.0, 6.0] & coordinates.theta.periodic=false ->
    effects.motor | beyond coordinates.theta.range = [0, 6], where reduced runs end
effects.motor={type="prescribed_motion", coordinate="theta", table=[[0.0, 0.0], [1.0, 1.0], [2.0, 1.0], [3.0, 0.0]]} ->
    effects.motor.table | from 1 to 2 s the spline moves by
effects.road={type="base_motion", direction=[1.0, 0.0], of="displacement",
    table=[[0.0, 0.0], [0.2, 0.0], [0.25, 0.05], [0.3, 0.1], [0.35, 0.05], [0.4, 0.0], [1.5, 0.0]]} ->
    effects.road.table | from 0 to 0.2 s the spline moves by 20 % of its whole way
effects.motor.spin_up.speed=1e4 -> effects.motor.spin_up.speed | speeds are in rad/s
""",
    SOLID: """
materials.steel.nu=0.4999 -> materials.steel.nu | too stiff
bodies.rod.thickness=10.0 -> bodies.rod.thickness | thicker than its length
simulation.step=0.02 -> simulation.step | between hinged ends
""",
}


def rows(tables: dict[Path, str]) -> list[tuple[Path, list[str], str, str]]:
    """Return scene, overrides, entry and words of every case."""
    found = [(scene, *case) for scene, lines in tables.items() for case in cases(lines)]
    return [(scene, asked.split(" & "), *said.split(" | ", 1)) for scene, asked, said in found]


@pytest.mark.parametrize("n", [2, 3, 8])
def test_how_much_too_stiffly_few_elements_bend(n: int) -> None:
    """Beside an eigenproblem of such elements; shear lowers the frequency by ``pi^2 EI / (2 GA L^2)`` = 5e-6."""
    h, shear = 1.0 / n, 1e6  # of length, EI and rho A 1
    bent, sheared = np.array([0.0, -1.0, 0.0, 1.0]) / h, np.array([-1.0 / h, -0.5, 1.0 / h, -0.5])
    stiffness = h * (np.outer(bent, bent) + shear * np.outer(sheared, sheared))
    mass = np.kron(h / 6.0 * np.array([[2.0, 1.0], [1.0, 2.0]]), np.diag([1.0, 0.0]))
    whole = np.zeros((2, 2 * n + 2, 2 * n + 2))
    for k in range(n):
        whole[:, 2 * k : 2 * k + 4, 2 * k : 2 * k + 4] += stiffness, mass
    free = np.setdiff1d(np.arange(2 * n + 2), [0, 2 * n])
    stiffness, mass = whole[:, free][:, :, free]
    first = 1.0 / np.linalg.eigvals(np.linalg.solve(stiffness, mass)).real.max()
    np.testing.assert_allclose(np.sqrt(first) / np.pi**2, bending_excess(n), rtol=5e-5)


def test_there_are_many() -> None:
    assert len(rows(REFUSED)) + len(rows(WARNED)) >= 55


@pytest.mark.parametrize(("scene", "overrides", "entry", "words"), rows(REFUSED))
def test_refused(scene: Path, overrides: list[str], entry: str, words: str) -> None:
    message = refusal(read_scene, scene, overrides, (), MPI.COMM_SELF, Purpose.CHECK)
    lines = [line for line in message.splitlines() if line.startswith((f"{entry} = ", f"{entry}: "))]
    assert lines and words in lines[0], message


@pytest.mark.parametrize(("scene", "overrides", "entry", "words"), rows(WARNED))
def test_warned(scene: Path, overrides: list[str], entry: str, words: str) -> None:
    remarks = read_scene(scene, overrides, (), MPI.COMM_SELF, Purpose.CHECK)[0].remarks
    lines = [r.text for r in remarks if r.text.startswith((f"{entry} = ", f"{entry}: "))]
    assert lines and words in lines[0], remarks
    assert all(remark.kind == "warning" for remark in remarks)


@pytest.mark.parametrize(
    ("law", "ends"),
    [
        ('{name="discrete", values=[0.0, 2.0]}', (0.0, 2.0)),
        ('{name="uniform", loc=1e-3, scale=2.0}', (1e-3, 2.001)),  # wear from next to nothing: no other unit
        ('{name="expon", loc=1e-3, scale=2.0}', (1e-3,)),
    ],
)
def test_values_at_ends_of_distributions_are_meant(law: str, ends: tuple[float, ...]) -> None:
    damping = 'effects.d={type="joint_damping", joint="elbow", coefficient="q"}'
    for nominal in ends:
        asked = f"parameters.q={{nominal={nominal}, bounds=[0.0, 1000.0], distribution={law}}}"
        assert not [text for text in warnings_of(SCENE, [damping, asked]) if "parameters.q" in text]


def test_a_mesh_in_millimetres_is_asked_about(tmp_path: Path) -> None:
    mesh = meshio.read(ROOT / "meshes" / "rod_solid2d.msh")
    mesh.points *= 1e3
    mesh.write(tmp_path / "rod.msh", file_format="gmsh22")
    asked = [f'bodies.rod.mesh="{tmp_path}/rod.msh"', "bodies.rod.thickness=10.0"]
    remarks = read_scene(SOLID, asked, (), MPI.COMM_SELF, Purpose.CHECK)[0].remarks
    assert any(r.text.startswith("bodies.rod.mesh = ") and "if this mesh is in mm" in r.text for r in remarks), remarks


def test_what_rides_freely_is_not_named_with_terms_of_second_order() -> None:
    asked = [FREELY, BEGUN, "reduction.second_order=true"]
    remarks = read_scene(CRANE, asked, (), MPI.COMM_SELF, Purpose.CHECK)[0].remarks
    assert not any("drives it" in remark.text for remark in remarks)


def test_a_start_elsewhere_than_bodies_are_placed_is_said() -> None:
    placed = "bodies.crank.placement={origin=[0.0, 0.0], angle=0.8}"
    for asked, said in (([placed], True), ([placed, "simulation.initial.theta.position=0.0"], False), ([], False)):
        assert ("placed at 0.8 rad, runs start at 0 (simulation" in pgmp.check(SCENE, overrides=asked).text) == said


@pytest.mark.parametrize("path", sorted((ROOT / "scenes").glob("*.toml")), ids=lambda path: path.stem)
def test_shipped_scenes_make_sense(path: Path) -> None:
    assert tomllib.loads(path.read_text(encoding="utf-8"))
    assert read_scene(path, (), (), MPI.COMM_SELF, Purpose.CHECK)[0].remarks == ()


#: Steel, how long a rod of 0.7 m is, and the Earth's acceleration, in units that programs are fed with.
SYSTEMS = {
    "mm, t and s": (7.8e-9, 2.1e5, 700.0, 9810.0), "mm, kg and ms": (7.8e-6, 210.0, 700.0, 9.81e-3),
    "mm, kg and s": (7.8e-6, 2.1e8, 700.0, 9810.0), "mm, g and ms": (7.8e-3, 2.1e5, 700.0, 9.81e-3),
    "cm, g and s": (7.8, 2.1e12, 70.0, 981.0), "in, lbf s2/in and s": (7.3e-4, 30e6, 27.6, 386.2),
}  # fmt: skip


def test_how_wide_a_beam_is_across_the_plane_does_not_count() -> None:
    wide = 'bodies.rod.section={shape="rectangle", width=2.0, height=0.01}'  # a rod of 0.7 m
    assert not any("thick" in text for text in warnings_of(SCENE, [wide]))


def test_what_is_said_of_many_bodies_is_said_once() -> None:
    """Fifteen short bodies of a rigid assembly are one warning, with their count; two are two."""
    piece = (
        'bodies.piece{}={{line={{length={}, elements=1}}, element="beam2d", material="steel", flexible=false, '
        'section={{shape="circle", radius=0.02}}}}'
    )
    weld = 'joints.weld{}={{type="fixed", connect=["rod:tip", "piece{}:hinge"]}}'
    for n, warned in ((15, 1), (2, 2)):
        pieces = [piece.format(k, 0.01 + 1e-3 * k) for k in range(n)] + [weld.format(k, k) for k in range(n)]
        said = [text for text in warnings_of(SCENE, pieces) if "thick and" in text]
        assert len(said) == warned
        assert ("The same of 14 others: bodies.piece1.section.radius" in said[0]) == (n == 15)


def warnings_of(path: Path, changes: list[str]) -> list[str]:
    scene, meshes = read_scene(path, changes, [], MPI.COMM_SELF, Purpose.CHECK)
    return [remark.text for remark in plausibility(scene, meshes)]


def in_units(system: str) -> list[str]:
    """Return what makes a pendulum of steel of the slider-crank's scene in other units; without gravity."""
    density, modulus, length, _ = SYSTEMS[system]
    rod = f'bodies={{rod={{line={{length={length}, elements=8}}, element="beam2d", material="steel", '
    return [
        f"materials={{steel={{E={modulus}, nu=0.3, rho={density}}}}}", "parameters={}", "outputs={}",
        f'{rod}section={{shape="circle", radius={length / 100}}}}}}}',
        'joints={pin={type="revolute", connect=["ground:origin", "rod:hinge"]}}',
        'coordinates={theta={joint="pin", range=[-3.0, 3.0]}}',
    ]  # fmt: skip


@pytest.mark.parametrize("system", SYSTEMS)
def test_gravity_that_is_not_said_is_refused_in_other_units_than_si(system: str) -> None:
    changes, earth = in_units(system), SYSTEMS[system][3]
    with pytest.raises(InputError, match=r"^effects\.g\.acceleration: missing") as refused:
        warnings_of(SCENE, [*changes, 'effects={g={type="gravity"}}'])
    assert system in str(refused.value)
    said = float(str(refused.value).split("say acceleration = ")[1].split(" ")[0])
    assert said == pytest.approx(earth, rel=2e-3)
    remarks = warnings_of(SCENE, [*changes, f'effects={{g={{type="gravity", acceleration={earth}}}}}'])
    assert not any(text.startswith(("effects.g", "materials.")) for text in remarks)
    assert sum(text.startswith("materials: they are in ") for text in remarks) == 1
    # the value of SI units is not that of these
    wrong = warnings_of(SCENE, [*changes, 'effects={g={type="gravity", acceleration=9.81}}'])
    if not 0.05 < earth / 9.81 < 10.0:
        assert any(text.startswith("effects.g.acceleration") for text in wrong)


def test_numbers_with_a_unit_do_not_fit_materials_in_mm() -> None:
    changes = in_units("mm, t and s")
    changes[1] = 'parameters={c={nominal=7.0, unit="mm"}}'
    changes.append('effects={d={type="joint_damping", joint="pin", coefficient=0.1}}')
    changes[3] = changes[3].replace("radius=7.0", 'radius="c"')
    assert any(text.startswith("parameters.c.unit") and "leave the unit out" in text
               for text in warnings_of(SCENE, changes))  # fmt: skip


def test_strange_materials_in_no_units_are_named_as_before() -> None:
    remarks = warnings_of(SCENE, ["materials.steel.rho=1e12", 'effects.g={type="gravity"}'])
    assert any(text.startswith("materials.steel.rho") for text in remarks)


def test_a_frequency_that_is_said_is_that_of_the_mechanism(tmp_path: Path) -> None:
    """A blade held at one end bends 2.8 times as slowly as between hinges; with a mass at its tip, far slower."""
    radius, length, step = 5e-3, 0.5, 0.05
    rod = (
        f'bodies={{rod={{line={{length={length}, elements=8}}, element="beam2d", material="steel", '
        f'section={{shape="circle", radius={radius}}}}}}}'
    )
    blade = [
        rod, 'materials={steel={E=210e9, nu=0.3, rho=7800.0}}', "parameters={}", "outputs={}",
        'joints={pin={type="revolute", connect=["ground:origin", "rod:hinge"]}}',
        'coordinates={theta={joint="pin", range=[-3.0, 3.0]}}', f"simulation.step={step}",
    ]  # fmt: skip
    drive = 'drive={type="prescribed_motion", coordinate="theta", constant_speed={speed=1.0}}'
    mass = 7800.0 * np.pi * radius**2 * length
    stiffness = 3.0 * 210e9 * np.pi / 4.0 * radius**4 / length**3
    for effects, expected in (
        (drive, 3.516 / np.sqrt(3.0) * np.sqrt(stiffness / mass) / (2.0 * np.pi)),
        (f'{drive}, end={{type="point_mass", point="rod:tip", mass={mass}}}',
         np.sqrt(stiffness / (1.2427 * mass)) / (2.0 * np.pi)),
    ):  # fmt: skip
        texts = warnings_of(SCENE, [*blade, f"effects={{{effects}}}"])
        (said,) = (text for text in texts if text.startswith("simulation.step"))
        assert float(said.split("the first mode of the mechanism has ")[1].split(" ")[0]) == pytest.approx(
            expected, rel=0.02
        )
        scene, _ = read_scene(SCENE, [*blade, f"effects={{{effects}}}"], [], MPI.COMM_SELF, Purpose.CHECK)
        assert said in [remark.text for remark in plausibility(scene)]  # of a reduced model, which has no meshes


def test_outputs_of_a_scene_in_other_units_have_these() -> None:
    """In mm and t a stress is in MPa; a prefix on the name of an SI unit would be a thousand times off."""
    changes = in_units("mm, t and s")
    changes[changes.index("outputs={}")] = (
        'outputs={tip={type="deformation", point="rod:tip", axis="y"}, '
        'most={type="stress", body="rod", quantity="stress_max"}, q={type="angle", joint="pin"}}'
    )
    scene, meshes = read_scene(SCENE, [*changes, "effects={}"], [], MPI.COMM_SELF, Purpose.CHECK)
    outputs = OutputSet.of(scene, RigidKinematics(Mechanism.from_scene(scene, meshes)))
    assert outputs.units == {"tip": "mm", "most": "MPa", "q": "rad"}
    assert OTHERS[0].unit("N m") == "N mm" and OTHERS[0].unit("m/s2") == "mm/s2" and SI.unit("N m") == "N m"


def test_a_load_on_what_a_point_carries_is_measured_by_its_mass() -> None:
    carried = 'effects.load={type="point_mass", point="rod:tip", mass=50.0}'
    for asked, said in (([], True), ([carried], False)):
        found = warnings_of(SCENE, ["effects.motor.scale=1e4", *asked])
        assert any("if nothing holds it" in text for text in found) == said, found
