"""Every feature with every kind of mechanism and every command, on tiny scenes: it works, or is refused by name.

``python tests/combinations.py [KIND] [FEATURE]`` tries all of them and prints what each came to.
"""

import sys
import tempfile
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path

import numpy as np
from mpi4py import MPI
from solids import body_of, matrices_of
from spatial import SLIDER_CRANK as IN_SPACE
from spatial import bar
from two_coordinates import DOUBLE_PENDULUM

from pgmp_petsc.base.errors import InputError, RunError
from pgmp_petsc.bench.reference import component_model
from pgmp_petsc.bench.step_choice import settle_step
from pgmp_petsc.bodies.assembled import Assembled
from pgmp_petsc.ensemble.integration import run_ensemble
from pgmp_petsc.ensemble.plan import Plan
from pgmp_petsc.files.hdf5 import RunRecord
from pgmp_petsc.mechanism.capabilities import Purpose, check_capabilities
from pgmp_petsc.models import ComponentModel, FullModel, ReducedModel
from pgmp_petsc.ranks.groups import RankGroup
from pgmp_petsc.reduction.build import build_rom
from pgmp_petsc.results import Trajectory
from pgmp_petsc.scene import Scene, scene_from_toml
from pgmp_petsc.studies.building import estimate_effects
from pgmp_petsc.studies.check import describe_scene
from pgmp_petsc.studies.modes_table import tabulate_modes
from pgmp_petsc.studies.simulate import simulate
from scenes import SLIDER_CRANK, meshes_of, tables

BEAM = 'element = "beam2d"\nmaterial = "steel"\nsection = { shape = "circle", radius = "r1" }'
SOLID = 'element = "solid2d"\nmaterial = "steel"\nthickness = 0.01'
COEFFICIENTS = '{shape="coefficients",axial=2e7,shear=6e6,bending=160.0,line_density=0.77,rotary_density=6e-6}'


def without_effects(text: str) -> str:
    start = text.find("[effects.")
    return text if start < 0 else text[:start] + text[text.index("[reduction]") :]


PARAMETER = '[parameters.r1]\nnominal = 5.6e-3\ndistribution = { name = "norm", loc = 5.6e-3, scale = 1e-4 }\n'
PLANE = without_effects(SLIDER_CRANK).replace('[parameters.r1]\nnominal = 5.6e-3\nunit = "m"\n', PARAMETER)
ROD = 'mesh = "0.3:1.0:5"\nelement = "beam2d"\nmaterial = "steel"\nsection = { shape = "circle", radius = 5.6e-3 }'
ROD_OF_CELLS = f'mesh = "0.3:1.0:4"\n{SOLID}'
ROD_OF_MATRICES = 'element = "solid2d"\nmatrices = { stiffness = "none", mass = "none", nodes = "0.3:1.0:4" }'
SPATIAL = PARAMETER + without_effects(IN_SPACE)
OF_CELLS = 'element = "solid3d"\nmaterial = "steel"'
IN_A_LINE = 'element = "beam3d"\nmaterial = "steel"\nsection = { shape = "circle", radius = "r1" }'

HAND = tables("""
bodies.hand: mesh = "0.0:0.3:2"; element = "beam2d"; material = "steel"; section = { shape = "circle", radius = "r1" }
joints.wrist: type = "revolute"; connect = ["lower:tip", "hand:hinge"]
coordinates.theta3: joint = "wrist"; range = [-0.3, 0.6]
""")

#: A scene of every kind of mechanism; joints crank_hinge and elbow (shoulder and elbow of two coordinates).
KINDS = {
    "beams": PLANE, "two coordinates": PARAMETER + without_effects(DOUBLE_PENDULUM),
    "cells in the plane": PLANE.replace(BEAM, SOLID).replace(ROD, ROD_OF_CELLS),
    "mixture": PLANE.replace(ROD, ROD_OF_CELLS), "matrices": PLANE.replace(ROD, ROD_OF_MATRICES),
    "solids in space": SPATIAL, "beams in space": SPATIAL.replace(OF_CELLS, IN_A_LINE),
    "beam and solid in space": SPATIAL.replace(OF_CELLS, IN_A_LINE, 1),
    "rigid crank in space": SPATIAL.replace('mesh = "0.0:0.3:2"', 'mesh = "0.0:0.3:2"\nflexible = false'),
    "all rigid in space": SPATIAL.replace('material = "steel"', 'material = "steel"\nflexible = false'),
    "all rigid in the plane": PLANE.replace('material = "steel"', 'material = "steel"\nflexible = false'),
    "three coordinates": PARAMETER + without_effects(DOUBLE_PENDULUM) + HAND,
}  # fmt: skip
WHEEL = (
    "bodies.wheel={{rigid={{mass=0.1,inertia={moments},points={{hub={origin}}}}}}}",
    'joints.sleeve={{{turns},connect=["ground:origin","wheel:hub"]}}',
)
#: What asks for every feature; {drive} is the first joint, {last} the last body, {theta} the first coordinate.
FEATURES = {
    "nothing": (),
    "torque": ('effects.x={{type="torque",joint="{drive}",table=[[0.0,0.0],[1.0,1.0]],scale="strength"}}',),
    "torque over an angle": (
        'effects.x={{type="torque",joint="{drive}",over="{drive}",table=[[-1.0,0.2],[1.0,1.0]],scale="strength"}}',
    ),  # fmt: skip
    "force": ('effects.x={{type="force",point="{last}:tip",direction={down},table=[[0.0,0.1],[1.0,1.0]]}}',),
    "force that follows": (
        'effects.x={{type="force",point="{last}:tip",direction={down},follows=true,table=[[0.0,0.1],[1.0,1.0]]}}',),
    "force towards": (
        'effects.x={{type="force",point="{last}:tip",towards="ground:origin",harmonic='
        "{{amplitude=1.0,frequency_hz=3.0}}}}",
    ),  # fmt: skip
    "gravity": ('effects.x={{type="gravity",direction={down}}}',),
    "base motion": (
        'effects.x={{type="base_motion",direction={down},harmonic={{amplitude=1.0,frequency_hz=3.0}},scale="strength"}}',
    ),  # fmt: skip
    "absolute output": (
        'effects.x={{type="base_motion",direction={down},harmonic={{amplitude=1.0,frequency_hz=3.0}},scale="strength"}}',
        'outputs.x={{type="position",point="{last}:tip",axis="y",absolute=true}}',
        'outputs.y={{type="speed",point="{last}:tip",axis="y",absolute=true}}',
    ),  # fmt: skip
    "point mass": ('effects.x={{type="point_mass",point="{first}:tip",mass=0.1,inertia=1e-4}}',),
    "damping in a joint": ('effects.x={{type="joint_damping",joint="{drive}",coefficient="strength"}}',),
    "friction": ('effects.x={{type="joint_friction",joint="{drive}",limit=0.1,speed=0.1}}',),
    "friction by the force carried": (
        'effects.x={{type="joint_friction",joint="{drive}",coefficient="strength",radius=0.01,speed=0.1}}',
    ),  # fmt: skip
    "friction of a point": (
        'effects.x={{type="point_friction",point="{last}:tip",direction={down},limit=0.1,speed=0.1}}',),
    "spring": ('effects.x={{type="spring_damper",joint="{drive}",stiffness=3.0,damping=0.1,rest=0.2}}',),
    "stop": ('effects.x={{type="end_stop",joint="{drive}",lower=-0.5,upper=0.7,stiffness=1e3,damping=0.1}}',),
    "free play": ('effects.x={{type="free_play",joint="{drive}",lower=-0.1,upper=0.1,stiffness=50.0,damping=0.1}}',),
    "formula": (
        'effects.x={{type="law",joint="{drive}",force="A * sin(3 * s) - 0.1 * v + t",constants={{A="strength"}}}}',
    ),  # fmt: skip
    "controllers": (
        'controllers.x={{type="pid",joint="{drive}",measures="angle",gains={{p="strength",i=2.0,d=0.1}}}}',
        'controllers.y={{type="formula",joint="{drive}",measures="angle",states={{z="y - z"}},output="-z"}}',
        "controllers.y.sample_time=1e-3",
    ),  # fmt: skip
    "bushing": ('effects.x={{type="bushing",points=["ground:origin","{last}:tip"],reference={axes},stiffness={along},'
        "damping={along}}}",),
    "elastic joint": ("joints.{drive}.elastic={{reference={axes},stiffness={stiff},damping={along}}}",),
    "clearance": (
        "joints.{drive}.clearance={{radius=1e-4,stiffness=1e8,restitution=0.9,restitution_speed='strength'}}",
    ),  # fmt: skip
    "gear": (*WHEEL, "joints.mesh={{type='gear',joints=['{drive}','sleeve'],ratio=-2.0}}"),
    "elastic gear": (
        *WHEEL, "joints.mesh={{type='gear',joints=['{drive}','sleeve'],ratio=-2.0,elastic={{stiffness='strength'}}}}",
    ),  # fmt: skip
    "joint that is off": ("joints.{drive}.offset={{place={small}}}",),
    "elastic joint that is off": (
        "joints.{drive}.elastic={{reference={axes},stiffness={stiff},damping={along}}}",
        "joints.{drive}.offset={{place={small}}}",
    ),  # fmt: skip
    "structural damping": ('effects.x={{type="structural_damping",stiffness=1e-5,mass=0.1}}',),
    "modal damping": ('effects.x={{type="structural_damping",ratios=[0.01,0.01]}}',),
    "prescribed motion": (
        'effects.x={{type="prescribed_motion",coordinate="{theta}",spin_up={{speed=2.0,time=0.5}}}}',),
    "stiffening": ('effects.x={{type="geometric_stiffening"}}', 'effects.y={{type="mode_inertia"}}'),
    "gyroscopic": ('effects.x={{type="gyroscopic",keep=false}}',),
    "second order": ("reduction.second_order=true",),
    "sampling tolerance": ("reduction.sampling_tolerance=0.5", 'reduction.interpolation="spline"'),
    "static modes": (
        "reduction.static_modes=true", "reduction.inertia_modes=true", 'effects.x={{type="gravity",direction={down}}}',
    ),  # fmt: skip
    "step by tolerance": ("simulation.tolerance=0.05",),
    "no error indicator": ("simulation.error_indicator=false",),
    "equilibrium": ("initial.equilibrium=true", 'effects.x={{type="gravity",direction={down}}}'),
    "free equilibrium": (
        "initial.equilibrium=true", 'initial.coordinates="free"', 'effects.x={{type="gravity",direction={down}}}',
    ),  # fmt: skip
    "coefficients": ('bodies.{first}={{mesh="{mesh}",element="beam2d",section={coefficients}}}',),
    "section scale": ('bodies.{last}.section_scale="width"',),
    "random field": ('fields.x={{body="{last}",quantity="E",variation=0.1,length=1.0,terms=1}}',
        'fields.y={{body="{last}",quantity="rho",variation=0.05,length=1.0,terms=1,distribution="uniform"}}',),
    "placement": ("bodies.{first}.placement={{origin={origin}}}",),
    "rotation": ('outputs.x={{type="rotation",point="{last}:tip"}}',),
    "distance": ('outputs.x={{type="distance",points=["ground:origin","{last}:tip"]}}',),
    "displacement": ('outputs.x={{type="displacement",point="{last}:tip",axis="y"}}',),
    "speed": (
        'outputs.x={{type="speed",point="{last}:tip",axis="y"}}',
        'outputs.y={{type="speed",joint="{drive}"}}',
    ),  # fmt: skip
    "rate": (
        'outputs.x={{type="rate",of="y",order=2}}', 'outputs.y={{type="position",point="{last}:tip",axis="y"}}',
        'outputs.z={{type="rate",of="y"}}',
    ),  # fmt: skip
    "formula of outputs": (
        'outputs.x={{type="formula",formula="sin(t * strength) * y ** 2 / max(y ** 2, 1)",unit="1"}}',
        'outputs.y={{type="speed",joint="{drive}"}}', 'outputs.z={{type="rate",of="x"}}',
    ),  # fmt: skip
    "deformation": ('outputs.x={{type="deformation",point="{last}:tip",axis="y",frame="body"}}',),
    "stress": ('outputs.x={{type="stress",body="{last}",quantity="{quantity}"}}',
        'outputs.y={{type="stress",body="{last}",quantity="{quantity}",at={inside}}}',),
    "fatigue": (
        'outputs.x={{type="rainflow",of="y",mean_stress="goodman",ultimate=5e8,'
        'curve={{exponent=5.0,reference="strength",cycles=1e6}}}}',
        'outputs.y={{type="stress",body="{last}",quantity="{quantity}",at={inside}}}',
        'outputs.z={{type="rainflow",of="y",quantity="life",run_out=1e9,curve={{table=[[1.0,1e7],[1e3,1e4]]}}}}',
    ),  # fmt: skip
    "force in a joint": ('outputs.x={{type="joint_force",joint="{drive}",component="y"}}',),
    "torque of a drive": (
        'effects.x={{type="prescribed_motion",coordinate="{theta}",spin_up={{speed=2.0,time=0.5}}}}',
        'outputs.x={{type="drive_torque",joint="{drive}"}}', 'outputs.y={{type="power",joint="{drive}"}}',
    ),  # fmt: skip
    "rigid first body": ("bodies.{first}.flexible=false",),
    "mass properties": (
        'bodies.{first}={{rigid={{mass="kilos",centre={centre},inertia={moments},points={{hinge={start},tip={end}}}}}}}',
        'parameters.kilos={{nominal=0.5,distribution={{name="uniform",loc=0.4,scale=0.2}}}}',
    ),  # fmt: skip
}  # fmt: skip
TINY = ("reduction.modes=2", "reduction.angles=8", "simulation.duration=0.003", "simulation.step=1e-3",
        "simulation.frames=2", "ensemble.checked_share=1.0")  # fmt: skip


def meshes_for(scene: Scene) -> dict:
    """Return the meshes that a scene describes, and matrices of the bars that stand for their ``nodes``."""
    of_matrices = [name for name, body in scene.bodies.items() if body.matrices is not None]
    others = {name: body for name, body in scene.bodies.items() if name not in of_matrices}
    bars = {}
    for name in of_matrices:
        first, last, n = described(scene.bodies[name]).split(":")
        bars[name] = assembled(bar(float(first), float(last), int(n), scene.dimension))
    return meshes_of(scene.model_copy(update={"bodies": others})) | bars


def described(body) -> str:
    """Return ``"first:last:n"`` of a body."""
    return body.mesh if body.matrices is None else body.matrices.nodes


def assembled(mesh) -> Assembled:
    """Return the matrices of a bar of steel, 10 mm thick in the plane."""
    thickness = 0.01 if mesh.dimension == 2 else 1.0
    matrices = matrices_of(body_of(mesh, 210e9 * thickness, 7800.0 * thickness))
    sets = {name: np.unique(faces) for name, faces in mesh.groups.items()}
    return Assembled.of(mesh.nodes, np.arange(1, mesh.n_nodes + 1), sets, mesh, *matrices)


@cache
def bare(kind: str) -> Scene:
    return scene_from_toml(KINDS[kind].replace('"r1"', "5.6e-3"), ".", TINY)


@cache
def scene_of(kind: str, feature: str) -> Scene:
    """Return the scene of a kind of mechanism with a feature; raises `InputError` where the scene refuses it."""
    plain = bare(kind)
    bodies, joints = list(plain.bodies), list(plain.joints)
    space = plain.dimension == 3
    ends = [float(x) for x in described(plain.bodies[bodies[0]]).split(":")[:2]]
    start, end, centre = ([x, *([0.0] * (2 if space else 1))] for x in (*ends, 0.5 * sum(ends)))
    words = {
        "start": start, "end": end, "centre": centre,
        "moments": "[4e-3,5e-3,6e-3,0.0,0.0,1e-3]" if space else "4e-3",
        "drive": joints[0], "first": bodies[0], "last": bodies[-1], "theta": next(iter(plain.coordinates)),
        "mesh": described(plain.bodies[bodies[0]]), "coefficients": COEFFICIENTS,
        "turns": 'type="revolute",axis=[0.0,0.0,1.0]' if space else 'type="revolute"',
        "axes": "[[1.0,0.0,0.0],[0.0,1.0,0.0]]" if space else "[[1.0,0.0]]",
        "stiff": "[1e6,2e6,3e6]" if space else "[1e6,2e6]",
        "small": "[1e-5,0.0,0.0]" if space else "[1e-5,0.0]",
        "along": "[10.0,20.0,30.0]" if space else "[10.0,20.0]",
        "down": "[0.0,-1.0,0.0]" if space else "[0.0,-1.0]", "origin": "[0.0,0.0,0.0]" if space else "[0.0,0.0]",
        "quantity": "von_mises" if plain.bodies[bodies[-1]].continuum else "axial_force",
        "inside": [float(described(plain.bodies[bodies[-1]]).split(":")[1]) - 0.05] + [0.0] * (2 if space else 1),
    }  # fmt: skip
    asked = tuple(entry.format(**words) for entry in FEATURES[feature])
    extra, n = [], len(plain.coordinates)
    if n > 2 or feature != "free equilibrium":
        extra.append(f"reduction.angles={4 if n > 2 else 5}")
    if feature != "free equilibrium":  # which may be anywhere; a short range saves nine tenths of the time
        for name in plain.coordinates:
            extra += [f"coordinates.{name}.range=[-0.3, 0.6]", f"coordinates.{name}.periodic=false"]
    if any("strength" in entry for entry in asked):
        extra.append('parameters.strength={nominal=1.0,distribution={name="uniform",loc=0.9,scale=0.2}}')
    if any('"width"' in entry for entry in asked):
        extra.append('parameters.width={nominal=1.0,distribution={name="uniform",loc=0.9,scale=0.2}}')
    outputs = (f'outputs.angle={{type="angle",joint="{joints[0]}"}}',
               f'outputs.place={{type="position",point="{bodies[-1]}:tip",axis="x"}}')  # fmt: skip
    if feature == "placement":
        outputs = ()
    elif "step" in feature:
        outputs = outputs[:1]
    return scene_from_toml(KINDS[kind], ".", (*TINY, *extra, *asked, *outputs))


def _build(scene: Scene, meshes: Mapping, cache: dict):
    check_capabilities(scene, Purpose.BUILD, meshes)
    if "rom" not in cache:
        cache["rom"] = build_rom(scene, meshes, RankGroup.split(MPI.COMM_SELF, 1))
    return cache["rom"]


def _reduced(scene: Scene, meshes: Mapping, cache: dict, ensemble: bool = False) -> ReducedModel:
    rom = _build(scene, meshes, cache)
    check_capabilities(scene, Purpose.REDUCED)
    return settle_step(ReducedModel(scene, rom), MPI.COMM_SELF, ensemble)[0]


def _full(scene: Scene, meshes: Mapping, cache: dict, ensemble: bool = False) -> FullModel:
    check_capabilities(scene, Purpose.FULL, meshes)
    if "full" not in cache:
        cache["full"] = FullModel(scene, meshes)
    return settle_step(cache["full"], MPI.COMM_SELF, ensemble)[0]


def _sizes(scene: Scene, meshes: Mapping, cache: dict) -> object:
    check_capabilities(scene, Purpose.SIZES, meshes)
    return estimate_effects(scene, meshes).lines()


def _modes(scene: Scene, meshes: Mapping, cache: dict) -> object:
    check_capabilities(scene, Purpose.MODES, meshes)
    return tabulate_modes(scene, meshes, None, 4, RankGroup.split(MPI.COMM_SELF, 1))


def _run(trajectory: Trajectory) -> None:
    assert all(np.all(np.isfinite(values)) for values in trajectory.outputs.values()), "outputs are finite"
    _says_of_errors(trajectory.model, trajectory.errors is not None, trajectory.record)


def _components(scene: Scene, meshes: Mapping, cache: dict, ensemble: bool = False) -> ComponentModel:
    check_capabilities(scene, Purpose.COMPONENTS, meshes)
    if "components" not in cache:
        cache["components"] = component_model(scene, meshes, MPI.COMM_SELF)
    return settle_step(cache["components"], MPI.COMM_SELF, ensemble)[0]


def _ensemble(model: FullModel | ReducedModel) -> None:
    with tempfile.TemporaryDirectory() as directory:
        found = run_ensemble(model, Plan(2, 1, Path(directory) / "e.h5", False), RankGroup.split(MPI.COMM_SELF, 1))
    for name, values in found.outputs.items():
        assert np.all(np.isfinite(values[found.status == 0])), name
    _says_of_errors(model.name, bool(found.errors), found.record)


def _says_of_errors(model: str, estimated: bool, record: RunRecord) -> None:
    """Check that a reduced result has an estimate of its errors, or says why not."""
    why_not = any("errors were not estimated" in remark.text for remark in record.remarks)
    assert model != "reduced" or estimated or why_not, "neither an estimate nor a reason"


#: Commands as functions of scene, meshes and what earlier ones made.
COMMANDS: dict[str, Callable] = {
    "check": lambda scene, meshes, cache: describe_scene(scene, meshes),
    "check --effects": _sizes,
    "build": _build,
    "modes": _modes,
    "simulate": lambda scene, meshes, cache: _run(simulate(_reduced(scene, meshes, cache), MPI.COMM_SELF)),
    "simulate --full": lambda scene, meshes, cache: _run(simulate(_full(scene, meshes, cache), MPI.COMM_SELF)),
    "simulate --components": lambda scene, meshes, cache: _run(
        simulate(_components(scene, meshes, cache), MPI.COMM_SELF)
    ),
    "montecarlo": lambda scene, meshes, cache: _ensemble(_reduced(scene, meshes, cache, True)),
    "montecarlo --full": lambda scene, meshes, cache: _ensemble(_full(scene, meshes, cache, True)),
    "montecarlo --components": lambda scene, meshes, cache: _ensemble(_components(scene, meshes, cache, True)),
}


def outcome(kind: str, feature: str, commands: tuple[str, ...] = tuple(COMMANDS)) -> dict[str, str]:
    """Return what every command came to: ``fine``, ``refused: ...``, ``failed: ...``, or a traceback."""
    found, cache = {}, {}
    for command in commands:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            try:
                scene = scene_of(kind, feature)
                COMMANDS[command](scene, meshes_for(scene), cache)
                found[command] = "fine"
            except InputError as error:
                found[command] = f"refused: {error}"
            except RunError as error:
                found[command] = f"failed: {error}"
            except BaseException as error:  # noqa: BLE001
                if isinstance(error, KeyboardInterrupt):
                    raise
                last = traceback.extract_tb(error.__traceback__)[-1]
                found[command] = f"TRACEBACK {type(error).__name__}: {error} ({last.filename}:{last.lineno})"
    return found


if __name__ == "__main__":
    counts: Counter[str] = Counter()
    for a_kind in KINDS if len(sys.argv) < 2 or sys.argv[1] == "all" else [sys.argv[1]]:
        for a_feature in FEATURES if len(sys.argv) < 3 else [sys.argv[2]]:
            results = outcome(a_kind, a_feature)
            counts.update(result.partition(":")[0].partition(" ")[0] for result in results.values())
            print(f"{a_kind} / {a_feature}: {sum(r == 'fine' for r in results.values())} fine", flush=True)
            for a_command, result in results.items():
                if result != "fine":
                    print(f"    {a_command}: {result}", flush=True)
    print(f"{sum(counts.values())} tried: {', '.join(f'{n} {word}' for word, n in counts.items())}")
