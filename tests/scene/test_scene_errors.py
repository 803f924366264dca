"""What a scene may not say: every refusal names the entry, what was received and what is allowed."""

from pathlib import Path

import pytest
from coupled_scenes import CAM, RACK, ROTORS, ROTORS_IN_SPACE, SCREW
from effect_scenes import BAR, BASE, CANTILEVER, scene_of
from refusals import assert_refused, cases, check_said, refusal
from runs import full_model

from pgmp_petsc.scene import load_scene, scene_from_toml
from pgmp_petsc.scene.messages import dotted_name, input_error, problem, toml_text
from scenes import HEADER, tables

SLIDER_CRANK = Path(__file__).resolve().parents[2] / "scenes" / "slider_crank.toml"
WORDS_OF_LIBRARIES = ("pydantic", "validation error", "input should", "extra_forbidden", "tagged-union")
HUGE = "1" + 400 * "0"
WAVE = "harmonic={amplitude=1, frequency_hz=1}"
DRIVE = f'{{type="prescribed_motion", coordinate="theta", {WAVE}}}'
DRUM = HEADER + tables("""
bodies.drum: rigid = { mass = 2.0, inertia = 0.03, points = { hub = [0.0, -0.1], rim = [0.3, 0.0] } }
joints.hinge: type = "revolute"; connect = ["ground:origin", "drum:hub"]
coordinates.phi: joint = "hinge"; range = [0.0, 6.283185307179586]; periodic = true
""")
DRUM_IN_SPACE = HEADER + tables("""
parameters.j: nominal = 0.03
bodies.drum: rigid = { mass = 2.0, inertia = ["j", 0.03, 0.04, 0.0, 0.0, 0.0], points = { hub = [0.0, -0.1, 0.0] } }
joints.hinge: type = "revolute"; connect = ["ground:origin", "drum:hub"]; axis = [0.0, 0.0, 1.0]
coordinates.phi: joint = "hinge"; range = [0.0, 6.283185307179586]; periodic = true
""")
#: Of scenes: entries, and how each is refused; HUGE, WAVE and DRIVE stand for the texts above.
REFUSED = {
    # entries of all kinds, of the slider-crank
    SLIDER_CRANK.read_text(): """
scene.name="" -> = "": text that is not empty is needed
scene.name=3 -> = 3: text in quotes is needed
bodies=1 -> = 1: a table is needed
bodies.crank=1 -> = 1: a table is needed
coordinates={} -> = {}: 1 or more entries are needed
materials.steel.nu="r1" -> = "r1": numbers are needed, no parameter: stiffness is no sum of products of parameters with
materials.steel.nu=0.5 -> = 0.5: must be less than 0.5
materials.steel.nu=-1 -> = -1: must be greater than -1.0
materials.steel.nu=nan -> = nan: a finite number is needed
materials.steel.E=inf -> = inf: a positive number or the name of a parameter is needed
materials.steel.rho=0 -> = 0: a positive number or the name of a parameter is needed
materials.steel.rho=HUGE -> = 10000000000000000000000000000000000000000000000000000000 ...: a positive number or the
bodies.rod.section.radius=true -> = true: a positive number or the name of a parameter is needed
effects.motor.scale=nan -> = nan: a finite number or the name of a parameter is needed
reduction.modes=1.5 -> = 1.5: an integer is needed
reduction.modes=0 -> = 0: must be at least 1
reduction.angles=3 -> = 3: must be at least 4
reduction.preload=1 -> = 1: true or false is needed
reduction.spring_modes="no" -> = "no": true or false is needed
simulation.spectral_radius=1.1 -> = 1.1: must be at most 1.0
simulation.frames=-1 -> = -1: must be at least 0
simulation.duration=0 -> = 0: must be greater than 0.0
simulation.step=2 -> = 2: must not exceed the duration, 1.0 s
simulation.duration=1e-4 -> simulation.step = 0.001: must not exceed the duration, 0.0001 s
ensemble.quantiles=[0.5, 1] -> ensemble.quantiles[1] = 1: must be less than 1.0
ensemble.quantiles=0.5 -> = 0.5: a list in brackets is needed
ensemble.batch=0 -> = 0: must be at least 1
ensemble.checked_share=1.1 -> = 1.1: must be at most 1.0
simulation.error_indicator=1 -> = 1: true or false is needed
coordinates.theta.periodic=1 -> = 1: true or false is needed
coordinates.theta.range=[0, 1] -> = [0, 1]: the range of a periodic coordinate is 2 pi = 6.283185307179586 long
coordinates.theta.range=[1, 1] -> = [1, 1]: the first number must be below the second
coordinates.theta.range=[1] -> = [1]: two finite numbers in brackets are needed, such as [0.0, 1.0]
joints.slider.direction=[0, 0] -> = [0, 0]: a direction other than [0, 0] is needed
effects.motor.table=[] -> = []: 1 or more entries are needed
effects.motor.table=[[0, 1], [1, nan]] -> effects.motor.table[1] = [1, nan]: a finite number, and one or the name of a
effects.motor.table=[[0, 1], ["r1", 1]] -> effects.motor.table[1] = ["r1", 1]: a finite number, and one or the name of a
effects.motor={type="torque",joint="crank_hinge",harmonic={amplitude="p",frequency_hz=2.0}} -> \
    effects.motor.harmonic.amplitude = "p": there is no such parameter; known: r1
effects.motor={type="torque",joint="crank_hinge",harmonic={amplitude="r1",frequency_hz=2.0},scale="r2"} -> \
    effects.motor.scale = "r2": a number is needed: values over time name r1, and loads are affine in their parameters
effects.motor={type="torque",joint="crank_hinge",harmonic={amplitude=1.0,frequency_hz="r1"}} -> \
    effects.motor.harmonic.frequency_hz = "r1": numbers are needed, no parameter: loads are affine in their parameters
effects.drive={type="prescribed_motion",coordinate="theta",table=[[0.0,0.0],[1.0,"r1"]]} -> \
    effects.drive.table = [[0.0, 0.0], [1.0, "r1"]]: numbers are needed, no parameter: a prescribed motion is a
effects.drive={type="prescribed_motion",coordinate="theta",spin_up={speed="r1",time=1.0}} -> \
    effects.drive.spin_up.speed = "r1": numbers are needed, no parameter: a prescribed motion is a constraint, one for
effects.loss={type="structural_damping",ratios=[0.1,"r1"]} -> effects.loss.ratios = [0.1, "r1"]: numbers are needed, no
simulation.initial.theta.position="r1" -> = "r1": numbers are needed, no parameter: displacements, and the turns of
effects.motor.table=[[0, 1], [0, 2]] -> = [[0, 1], [0, 2]]: times must increase strictly, but 0.0 s follows 0.0 s
foo=1 -> = 1: unknown key (allowed: scene, ground, parameters, materials, bodies, joints, coordinates, effects
bodies.crank.section.radus=0.1 -> = 0.1: unknown key; did you mean 'radius'? (allowed: shape, radius)
bodies.crank.section.circle=1 -> = 1: unknown key (allowed: shape, radius)
bodies.crank.section.flexible=true -> \
    = true: unknown key; bodies.crank has this key: write it there, above any head [bodies.crank.section] (allowed: shape, rad
simulation.initial.equilibrium=true -> = true: a table is needed, with position, velocity; [initial] has this key
simulation.initial.step=1 -> = 1: a table is needed, with position, velocity; simulation has this key: write it \
    there, above any head [simulation.initial]
effects.duration=1 -> = 1: a table is needed; [simulation] has this key
effects.motor.bands=1 -> = 1: unknown key; [ensemble] has this key (allowed: table
initial.tolerance=1 -> = 1: unknown key; [reduction] and [simulation] have this key (allowed: equilibrium, coordinates)
bodies.crank.section={shape='circle', circle=1} -> \
    bodies.crank.section.radius: missing; needed: radius || bodies.crank.section.circle = 1: unknown key (allowed:
scene={} -> scene.name: missing; needed: short name, used in reports and titles
bodies.crank.element='beam4d' -> = "beam4d": unknown; did you mean 'beam3d'? (allowed: beam2d, beam3d, solid2d, solid3d)
outputs.slider_position.axis='w' -> = "w": unknown (allowed: x, y, z)
outputs.slider_position.axis='z' -> = "z": x or y is needed in the plane
outputs.slider_position.axis=1 -> = 1: unknown (allowed: x, y, z)
outputs.speed={type="rate", of="crank_angle", order=3} -> outputs.speed.order = 3: unknown (allowed: 1, 2)
outputs.v={type="speed",point="rod:tip",axis="x",motion="turning"} -> outputs.v.motion = "turning": without effect, as \
    no joint is named; leave it out
effects.e={type="law",points=["rod:tip","ground:origin"],motion="turning",force="-s"} -> effects.e.motion = "turning": \
    without effect, as no joint is named
effects.motor=3 -> = 3: a table is needed
bodies.rod.placement=3 -> = 3: a table is needed, with origin, angle
effects.motor={} -> effects.motor.type: missing
effects.motor.type='torqe' -> = "torqe": unknown; did you mean 'torque'?
outputs.a.type='pace' -> = "pace": unknown
bodies.crank.section.shape=1 -> = 1: unknown
effects."my motor"={type="gravity"} -> : a name starts with a letter or _ and goes on with letters, digits, _ or -
ground.points."a:b"=[0,1] -> : a name starts with a letter or _ and goes on with letters, digits, _ or -
ground.points.origin=[0, 1] -> = [0, 1]: the ground's origin is always at [0, 0]; give the point another name
parameters.r1.nominal=1 -> = 1: must lie inside the parameter's bounds [0.001, 0.012] m
parameters.r1.value=1 -> = 1: must lie inside the parameter's bounds [0.001, 0.012] m
parameters.r1.bounds=[2, 1] -> = [2, 1]: the first number must be below the second
parameters.r1.distribution=3 -> = 3: a table is needed
parameters.r1.distribution.loc='a' -> = "a": a number is needed
parameters.r1.distribution.loc=inf -> = inf: a finite number is needed
parameters.r1.distribution.scale=-1 -> = -1: a positive number is needed
parameters.r1.distribution.sale=2 -> = 2: unknown argument of norm; did you mean 'scale'? (allowed: loc, scale)
parameters.r1.distribution.name='normm' -> = "normm": no continuous distribution of scipy.stats; did you mean 'norm'?
parameters.r1.distribution.name='###' -> = "###": no continuous distribution of scipy.stats; known are norm, uniform
parameters.r1.distribution={name='beta', a=1} -> parameters.r1.distribution.b: missing; beta needs the shape parameters
parameters.r1.distribution={name='beta', a=-1, b=2} -> = { name = "beta", a = -1, b = 2 }: scipy.stats refuses these
parameters.r1.distribution.loc=1 -> \
    parameters.r1.distribution = { name = "norm", loc = 1, scale = 0.00056 }: gives no samples inside the parameter's
parameters.r1.distribution={name='vonmises', kappa=2, loc=6e-3, scale=5e-4} -> \
    = { name = "vonmises", kappa = 2, loc = 0.006, scale = 0.0 ...: has -1.01 of its samples below the parameter's
joints.elbow.connect=['crank:tip'] -> = ["crank:tip"]: two points in brackets are needed, such as ["ground:origin"
joints.elbow.connect=['crank:tip', 'rod'] -> joints.elbow.connect[1] = "rod": a point is needed, written "body:point" or
joints.elbow.connect=['crank:', 'rod:tip'] -> joints.elbow.connect[0] = "crank:": a point is needed, written
joints.elbow.connect=['crank:tip', 1] -> joints.elbow.connect[1] = 1: a point is needed, written "body:point" or
bodies.crank.material='stel' -> = "stel": there is no such material; did you mean 'steel'?
bodies.crank.section.radius='r2' -> = "r2": there is no such parameter; known: r1
effects.motor.scale='gain' -> = "gain": there is no such parameter; known: r1
parameters={} -> bodies.crank.section.radius = "r1": there is no such parameter; none is defined
parameters.r1={nominal=-1} -> parameters.r1.nominal = -1.0: must be positive, because bodies.crank.section.radius uses
parameters.r1={nominal=1, value=0} -> parameters.r1.value = 0.0: must be positive, because bodies.crank.section.radius
joints.elbow.connect=['crank:tip', 'rd:hinge'] -> = "rd:hinge": there is no body 'rd'; did you mean 'rod'?
joints.elbow.connect=['ground:orign', 'rod:hinge'] -> = "ground:orign": there is no such ground point; did you mean
joints.elbow.connect=['crank:tip', 'crank:hinge'] -> = ["crank:tip", "crank:hinge"]: a joint connects two different
joints.a={type='revolute', connect=['ground:origin', 'ground:origin']} -> \
    joints.a.connect = ["ground:origin", "ground:origin"]: a joint connects two different bodies, or a body and the
coordinates.theta.joint='elbw' -> = "elbw": there is no such point_on_beam, point_on_line, prismatic or revolute
coordinates.theta.joint='slider' -> coordinates.theta.motion: missing; slider is point_on_line: "sliding" or "turning"
coordinates.theta.motion='sliding' -> = "sliding": crank_hinge is revolute: allowed is "turning"
coordinates.theta={joint='slider', motion='sliding', range=[0, 1], periodic=true} -> \
    coordinates.theta.range = [0, 1]: the range of a periodic coordinate is 2 pi
coordinates.theta={joint='slider', motion='sliding', range=[0, 6.283185307179586], periodic=true} -> \
    coordinates.theta.periodic = true: for angles; what slides has two ends
coordinates.theta={range=[0, 1]} -> coordinates.theta.joint: exactly one of joint, points is needed; none is given
coordinates.theta={joint='elbow', points=['ground:origin', 'rod:tip'], range=[0, 1]} -> \
    coordinates.theta.points = ["ground:origin", "rod:tip"]: exactly one of joint, points is needed
coordinates.theta={motion='sliding', points=['ground:origin', 'rod:tip'], range=[0.1, 1]} -> \
    coordinates.theta.motion = "sliding": a distance has one motion; leave it out
coordinates.theta={points=['ground:origin', 'rod:tip'], range=[0, 1]} -> \
    coordinates.theta.range = [0.0, 1.0]: a distance is positive
coordinates.theta={points=['ground:origin', 'ground:origin'], range=[-1, 1]} -> \
    coordinates.theta.points = ["ground:origin", "ground:origin"]: two different points are needed || \
    coordinates.theta.range = [-1.0, 1.0]: a distance is positive
coordinates.phi={joint='crank_hinge', range=[-1, 1]} -> coordinates.phi.joint = "crank_hinge": coordinates.theta has the
effects.motor.joint='motor' -> = "motor": there is no such point_on_beam, point_on_line or revolute joint; known
outputs.crank_angle.joint='slidr' -> = "slidr": there is no such point_on_beam, point_on_line or revolute joint; did
outputs.time={type="angle", joint="crank_hinge"} -> : results keep instants under this name; take another one
outputs.status={type="angle", joint="crank_hinge"} -> : results keep what became of samples under this name
ensemble.probabilities.status={output="crank_angle", above=1.0} -> : results keep what became of samples under
parameters.sample={nominal=1.0} -> : results keep the numbers of samples under this name; take another
outputs.slider_position.point='rd:tip' -> = "rd:tip": there is no body 'rd'; did you mean 'rod'?
outputs.slider_position.point='ground:origin' -> = "ground:origin": a point of a body is needed; the ground does not
simulation.initial.thet={} -> : there is no such coordinate; did you mean 'theta'?
""",
    # effects
    BASE: """
effects.e={type="torque", joint="hinge"} -> effects.e.table: exactly one of table, harmonic is needed; none is given
effects.e={type="torque", joint="hinge", table=[[0, 1]], WAVE} -> \
    effects.e.harmonic = { amplitude = 1, frequency_hz = 1 }: exactly one of table, harmonic is needed; table and
effects.e={type="force", point="rod:tip", WAVE} -> effects.e.direction: exactly one of direction, towards is needed
effects.e={type="force", point="rod:tip", direction=[1, 0], towards="ground:origin", WAVE} -> \
    effects.e.towards = "ground:origin": exactly one of direction, towards is needed; direction and towards are given
effects.e={type="force", point="rod:tip", towards="ground:origin", follows=true, WAVE} -> \
    effects.e.follows = true: a direction that turns with the body needs `direction`
effects.e={type="spring_damper", stiffness=1} -> effects.e.joint: exactly one of joint, points is needed; none is given
effects.e={type="prescribed_motion", coordinate="theta"} -> effects.e.table: exactly one of table, harmonic, spin_up
effects.e={type="prescribed_motion", coordinate="theta", table=[[0, 0]]} -> \
    effects.e.table = [[0, 0]]: a motion needs at least two rows
effects.e={type="gravity", direction=[0, 0]} -> effects.e.direction = [0, 0]: a direction other than [0, 0] is needed
effects.e={type="point_mass", point="rod:tip", mass=0} -> effects.e.mass = 0: a positive number or the name of a
effects.e={type="point_mass", point="rod:tip", mass=1, inertia=-1} -> effects.e.inertia = -1: a number that is not
effects.e={type="point_mass", point="rod:tip", mass="negative"} -> \
    parameters.negative.nominal = -1.0: must be positive, because effects.e.mass uses it
effects.e={type="joint_friction", joint="hinge", limit=-1, speed=1} -> effects.e.limit = -1: a number that is not
effects.e={type="joint_friction", joint="hinge", limit=1} -> effects.e.speed: missing; needed: rate at which 76 % of the
effects.e={type="spring_damper", joint="hinge"} -> = { type = "spring_damper", joint = "hinge" }: at least one of
effects.e={type="spring_damper", points=["ground:origin", "rod:tip"], stiffness=1} -> \
    effects.e.rest: a spring between points needs the distance without force (m)
effects.e={type="structural_damping"} -> = { type = "structural_damping" }: at least one of stiffness, mass and ratios
effects.e={type="structural_damping", ratios=[0.1, 1.0]} -> effects.e.ratios[1] = 1.0: must be less than 1.0
effects.e={type="structural_damping", mass=1, bodies=[]} -> effects.e.bodies = []: 1 or more entries are needed
effects.e={type="end_stop", joint="hinge", stiffness=1} -> \
    = { type = "end_stop", joint = "hinge", stiffness = 1 }: at least one of lower and upper is needed
effects.e={type="end_stop", joint="hinge", stiffness=1, lower=1, upper=0.5} -> \
    effects.e.lower = 1.0: must be below upper = 0.5
effects.e={type="end_stop", joint="hinge", stiffness=1, lower="p", upper=0.5} -> \
    effects.e.lower = "p": must be below upper = 0.5, not 1
effects.e={type="end_stop", joint="hinge", stiffness=1, lower=0.5, upper="p"} & parameters.p.value=0.2 -> \
    effects.e.lower = 0.5: must be below upper = 0.2
effects.e={type="end_stop", joint="hinge", stiffness=1, lower=0, upper="q"} -> \
    effects.e.upper = "q": there is no such parameter; known: negative, p
effects.e={type="joint_friction", joint="hinge", limit=1, speed="negative"} -> \
    parameters.negative.nominal = -1.0: must be positive, because effects.e.speed uses it
effects.e={type="end_stop", joint="hinge", stiffness=1, lower=0, damping="negative"} -> \
    parameters.negative.nominal = -1.0: must not be negative, because effects.e.damping uses it
effects.e={type="end_stop", joint="hinge", stiffness=0, lower=1} -> effects.e.stiffness = 0: a positive number or the
effects.e={type="prescribed_motion", coordinate="theta", spin_up={speed=1, time=0}} -> \
    effects.e.spin_up.time = 0: must be greater than 0.0
effects.e={type="gravty"} -> effects.e.type = "gravty": unknown; did you mean 'gravity'?
effects.e={type="gravity", axceleration=9} -> effects.e.axceleration = 9: unknown key; did you mean 'acceleration'?
effects.e={type="torque", joint="slidr", WAVE} -> effects.e.joint = "slidr": there is no such
effects.e={type="joint_damping", joint="weld", coefficient=1} -> \
    effects.e.joint = "weld": a point_on_beam, point_on_line, prismatic or
effects.e={type="joint_friction", joint="slidr", limit=1, speed=1} -> effects.e.joint = "slidr": there is no such
effects.e={type="end_stop", joint="elbo", stiffness=1, lower=1} -> effects.e.joint = "elbo": there is no such
effects.e={type="spring_damper", joint="weld", stiffness=1} -> \
    effects.e.joint = "weld": a point_on_beam, point_on_line, prismatic or
effects.e={type="spring_damper", joint="hinge", stiffness="q"} -> effects.e.stiffness = "q": there is no such parameter
effects.e={type="point_mass", point="rod", mass=1} -> effects.e.point = "rod": a point is needed, written "body:point"
effects.e={type="point_mass", point="rd:tip", mass=1} -> effects.e.point = "rd:tip": there is no body 'rd'; did you mean
effects.e={type="point_mass", point="ground:wall", mass=1} -> effects.e.point = "ground:wall": a point of a body is
effects.e={type="force", point="ground:wall", direction=[1, 0], WAVE} -> \
    effects.e.point = "ground:wall": a point of a body is needed; the ground does not move
effects.e={type="force", point="rod:tip", towards="ground:wal", WAVE} -> \
    effects.e.towards = "ground:wal": there is no such ground point; did you mean 'ground:wall'?
effects.e={type="spring_damper", points=["grund:wall", "rod:tip"], stiffness=1, rest=1} -> \
    effects.e.points = "grund:wall": there is no body 'grund'; did you mean 'ground'?
effects.e={type="spring_damper", points=["rod:tip", "rod:tip"], stiffness=1, rest=1} -> \
    effects.e.points = ["rod:tip", "rod:tip"]: two different points are needed
effects.e={type="spring_damper", points=["ground:wall", "ground:origin"], stiffness=1, rest=1} -> \
    effects.e.points = ["ground:wall", "ground:origin"]: a point of a body is needed; the ground does not move
effects.e={type="spring_damper", points=["crank:tip", "crank:hinge"], stiffness=1, rest=1} -> \
    effects.e.points = ["crank:tip", "crank:hinge"]: crank is rigid; the distance of its points does not change
effects.e={type="force", point="crank:tip", towards="crank:hinge", WAVE} -> \
    effects.e.towards = ["crank:tip", "crank:hinge"]: crank is rigid; the distance of its points does not change
effects.e={type="force", point="rod:tip", towards="rod:tip", WAVE} -> \
    effects.e.towards = ["rod:tip", "rod:tip"]: two different points are needed
effects.e={type="torque", joint="hinge", harmonic={amplitude=1, frequency_hz=1000}} -> \
    effects.e.harmonic.frequency_hz = 1000.0: needs a simulation.step of at most 0.000125 s, 8 a period; it is 0.001 s
effects.e={type="prescribed_motion", coordinate="theta", harmonic={amplitude=1, frequency_hz=1000}} -> \
    effects.e.harmonic.frequency_hz = 1000.0: needs a simulation.step of at most 0.000125 s, 8 a period; it is 0.001 s
effects.e={type="force", point="rod:tip", direction=[1, 0], table=[[0.5002, 0], [0.5004, 100], [0.5006, 0]]} & \
    simulation.step=1e-3 -> \
    effects.e.table: has an impulse of 0.02 N s, but 0 with a force read every 0.001 s; take a smaller simulation.step
effects.e={type="structural_damping", mass=1, bodies=["rd"]} -> effects.e.bodies = ["rd"]: there is no body 'rd'; did
effects.e={type="structural_damping", mass=1, bodies=["rod", "crank"]} -> \
    effects.e.bodies = ["rod", "crank"]: crank is rigid; only flexible bodies have structural damping; leave it out
effects.e={type="structural_damping", mass=1, bodies=["rod"]} & \
    effects.f={type="structural_damping", ratios=[0.1], bodies=["rod"]} -> \
    effects.f: effects.e damps rod too; give all the damping of a body in one effect
effects.e={type="structural_damping", mass=1} & effects.f={type="structural_damping", mass=2} -> \
    effects.f: effects.e damps rod too; give all the damping of a body in one effect
effects.e={type="prescribed_motion", coordinate="thet", WAVE} -> effects.e.coordinate = "thet": there is no such
effects.e=DRIVE & effects.f=DRIVE -> effects.f.coordinate = "theta": effects.e prescribes the same coordinate
effects.e=DRIVE & effects.f={type="torque", joint="hinge", WAVE} -> effects.e.coordinate = "theta": contradicts
effects.e=DRIVE & effects.f={type="end_stop", joint="hinge", stiffness=1, lower=-1} -> \
    effects.e.coordinate = "theta": contradicts effects.f, of type end_stop on the same joint hinge: a prescribed \
    motion takes whatever torque it needs
effects.e=DRIVE & simulation.initial.theta.position=0.1 -> simulation.initial.theta: effects.e prescribes this
effects.e={type="gyroscopic"} & effects.f={type="gyroscopic"} -> effects.f: effects.e is of the same type; a scene has
effects.e={type="geometric_stiffening"} -> : is half of what is of second order in the deformation, and wrong by itself
effects.e={type="mode_inertia"} -> : is half of what is of second order in the deformation, and wrong by itself where
effects.e={type="geometric_stiffening"} & effects.f={type="mode_inertia"} & \
    effects.g={type="gyroscopic", keep=false} -> \
    effects.g.keep = false: leaves out the forces by velocities whose stiffening effects.e asks for; keep them, or leave
effects.g={type="gyroscopic", keep=false} & reduction.second_order=true -> effects.g.keep = false: leaves out the forces
bodies.rod.material="steel" -> = "steel": a section given by coefficients has no material
bodies.rod.section={shape="circle", radius=1e-2} -> bodies.rod.material: missing; needed: name of a material
bodies.rod.mesh="rod.msh" -> \
    bodies.rod.line = { length = 0.7, elements = 2 }: exactly one of mesh, line, matrices, rigid
bodies.rod.line.elements=0 -> = 0: must be at least 1
bodies.crank.flexible=true -> \
    bodies.crank.section = { shape = "coefficients", axial = 1.0, shear = 1.0, bend ...: a flexible body needs
""",
    # couplings
    ROTORS: """
joints.mesh.ratio=0.0 -> = 0.0: a number other than 0 or the name of a parameter is needed
joints.mesh.ratio="r" -> = "r": there is no such parameter
joints.mesh.ratio=true -> = true: a number other than 0 or the name of a parameter is needed
joints.mesh.ratio="r" & parameters.r={nominal=0.5} -> \
    parameters.r.bounds: missing; joints.mesh.ratio uses it, and the reduced model is built between its ends: give \
bounds = [low, high], or a distribution
joints.mesh.ratio="r" & parameters.r={nominal=0.5, bounds=[-0.1, 0.6]} -> \
    parameters.r.bounds = [-0.1, 0.6]: must be on one side of 0, because joints.mesh.ratio uses it
joints.mesh.ratio="r" & parameters.r={nominal=0.0, bounds=[-0.1, 0.6]} -> \
    parameters.r.nominal = 0.0: must not be 0, because joints.mesh.ratio uses it || \
    parameters.r.bounds = [-0.1, 0.6]: must be on one side of 0
joints.mesh.ratio="r" & parameters.r={nominal=0.5, bounds=[0.4, 0.6], unit="m"} -> \
    parameters.r.unit = "m": joints.mesh.ratio uses it, which needs 1 (no unit)
joints.mesh.ratio="r" & parameters.r={nominal=0.5, bounds=[0.4, 0.6]} & bodies.one.rigid.mass="r" -> \
    parameters.r: joints.mesh.ratio and bodies.one.rigid.mass use it; what is a length, a place or || \
    parameters.r: joints.mesh.ratio (1) and bodies.one.rigid.mass (kg) use it, which are different quantities
joints.mesh.joints=["input"] -> = ["input"]: the names of two joints in brackets are needed
joints.mesh.joints="input" -> = "input": the names of two joints in brackets are needed
joints.mesh.joints=["input", 3] -> = ["input", 3]: the names of two joints in brackets are needed
joints.mesh={type="coupling", terms=3} -> joints.mesh.terms = 3
joints.mesh={type="coupling", terms={input="r", output=1.0}} -> joints.mesh.terms.input = "r": there is no such param
joints.mesh={type="gear", joints=["input", "output"]} -> joints.mesh.ratio: missing
joints.mesh.connect=["ground:origin", "one:hub"] -> = | unknown key
joints.mesh.joints=["input", "outptu"] -> = "outptu": there is no such joint; did you mean 'output'?
joints.mesh.joints=["input", "mesh"] -> = "mesh": a joint that has the motion turning is needed; this one is gear
joints.mesh.joints=["input", "input"] -> = "input": the same joint is named twice
joints.mesh.type="chain" -> = "chain": unknown
joints.mesh={type="belt", joints=["input", "output"]} -> joints.mesh.radii: exactly one of radii, ratio is needed; none
joints.mesh={type="belt", joints=["input", "output"], radii=[0.1, 0.2], ratio=2.0} -> \
    joints.mesh.ratio = 2.0: exactly one of radii, ratio is needed; radii and ratio are given
joints.mesh={type="belt", joints=["input", "output"], ratio=0.0} -> joints.mesh.ratio = 0.0: a number other than 0
joints.mesh={type="belt", joints=["input", "output"], ratio=2.0, crossed=true} -> \
    joints.mesh.crossed = true: a ratio says it by its sign
joints.mesh={type="belt", joints=["input", "output"], radii=[0.1, 0.0]} -> \
    joints.mesh.radii = [0.1, 0.0]: two positive numbers in brackets are needed, such as [0.05, 0.1], each a number or
joints.mesh={type="belt", joints=["input", "output"], radii=0.1} -> joints.mesh.radii = 0.1: two positive numbers
joints.mesh={type="belt", joints=["input", "output"], radii=[0.1, "5 kg"]} -> \
    joints.mesh.radii = [0.1, "5 kg"]: 'kg' is the unit of a mass; needed is a length (m)
joints.mesh={type="belt", joints=["input", "output"], radii=[0.1, "r"]} -> joints.mesh.radii = "r": there is no such
joints.mesh={type="belt", joints=["input", "output"], radii=["r", 0.1]} & parameters.r={nominal=1.0, bounds=[0, 2]} \
    -> parameters.r.bounds = [0.0, 2.0]: must be positive, because joints.mesh.radii uses it
joints.mesh={type="belt", joints=["input", "output"], radii=[0.1, 0.2], crossed=1} -> joints.mesh.crossed = 1
joints.mesh={type="belt", joints=["input", "input"], radii=[0.1, 0.2]} -> joints.mesh.joints = "input": the same joint
joints.mesh={type="screw", joint="input", lead=1.0} -> joints.mesh.type = "screw": for mechanisms in space
joints.mesh={type="rack", joints=["input", "output"], radius=1.0} -> \
    joints.mesh.joints = "output": a joint that has the motion sliding is needed; this one is revolute
joints.mesh={type="coupling", terms={input=1.0}} -> joints.mesh.terms
joints.mesh={type="coupling", terms={input=1.0, output=0.0}} -> joints.mesh.terms.output = 0.0: a number other than
joints.mesh={type="coupling", terms={input=1.0, outptu=2.0}} -> joints.mesh.terms = "outptu": there is no such joint
coordinates.phi.joint="mesh" -> = "mesh": a | joint is needed, this one is a gear
outputs.one.joint="mesh" -> = "mesh": a | joint is needed, this one is a gear
effects.motor.joint="mesh" -> = "mesh": a | joint is needed, this one is a gear
""",
    RACK: """
joints.teeth.radius=0.0 -> = 0.0: a number other than 0 or the name of a parameter is needed
joints.teeth.radius="r" & parameters.r={nominal=0.05, bounds=[0.04, 0.06], unit="kg"} -> \
    parameters.r.unit = "kg": joints.teeth.radius uses it, which needs m
joints.teeth.radius="r" & parameters.r={nominal=0.05} -> \
    parameters.r.bounds: missing; joints.teeth.radius uses it, and the reduced model is built between its ends: give \
bounds = [low, high] (m)
joints.teeth.radius="5 kg" -> = "5 kg": 'kg' is the unit of a mass; needed is a length (m)
joints.teeth={type="belt", joints=["axle", "teeth"], radii=[0.1, 0.2]} -> \
    joints.teeth.joints = "teeth": a joint that has the motion turning is needed; this one is belt
joints.teeth.joints=["rail", "teeth"] -> = "teeth": a joint that has the motion sliding is needed; this one is rack
""",
    SCREW: """
joints.thread.lead=0.0 -> = 0.0: a number other than 0 or the name of a parameter is needed
joints.thread.joint="thread" -> = "thread": a joint that has the motion sliding is needed; this one is screw || \
    joints.thread.joint = "thread": a joint that has the motion turning is needed; this one is screw
joints.thread={type="coupling", terms={shaft=1.0, thread=1.0}} -> \
    joints.thread.terms = "shaft": shaft is cylindrical, which turns and slides; couple it by a gear || \
    joints.thread.terms = "thread": a joint that turns or slides is needed; this one is coupling
""",
    ROTORS_IN_SPACE: """
coordinates.phi={points=["one:hub", "two:hub"], range=[0.1, 0.2]} & simulation.initial.phi.position=0.15 -> \
    joints.mesh.joints: in space turns are counted from the coordinates: all but one of the joints that turn must be
""",
    CAM: """
joints.lift.table=[[0.0, 0.0], [1.0, 0.1], [0.5, 0.1], [6.283185307179586, 0.0]] -> = | angles must increase; 0.5
joints.lift.table=[[0.0, 0.0], [1.0, 0.1], [3.0, 0.1], [6.0, 0.0]] -> = | must span one turn
joints.lift.table=[[0.0, 0.0], [1.0, 0.1], [3.0, 0.1], [6.283185307179586, 0.01]] -> = | must close
joints.lift.table=[[0.0, 0.0], [6.283185307179586, 0.0]] -> joints.lift.table
joints.lift.table=3 -> joints.lift.table = 3
joints.lift.table=[[0.0, "a"], [1.0, 0.1], [3.0, 0.1], [6.283185307179586, 0.0]] -> \
    joints.lift.table[0] = | two finite numbers in brackets are needed || \
    joints.lift.table = | entries are needed
""",
    # rigid bodies
    DRUM: """
bodies.drum.rigid.mass=0.0 -> = 0.0: a positive number or the name of a parameter is needed
bodies.drum.rigid.mass=-2.0 -> = -2.0: a positive number or the name of a parameter is needed
bodies.drum.rigid.mass="m" -> = "m": there is no such parameter
bodies.drum.rigid.mass="m" & parameters.m={nominal=-1.0} -> \
    parameters.m.nominal = -1.0: must be positive, because bodies.drum.rigid.mass uses it
bodies.drum.rigid.mass="m" & parameters.m={nominal=1.0, unit="m"} -> parameters.m.unit = "m": | kg
bodies.drum={rigid={inertia=0.1}} -> bodies.drum.rigid.mass: missing; needed: mass (kg)
bodies.drum.rigid.inertia=0.0 -> = 0.0: moments of inertia are positive
bodies.drum.rigid.inertia="j" & parameters.j={nominal=-1.0} -> \
    parameters.j.nominal = -1.0: must be positive, because bodies.drum.rigid.inertia.izz uses it
bodies.drum.rigid.inertia=[0.1, 0.1] -> = [0.1, 0.1]: a moment of inertia in the plane, or six entries [ixx, iyy, izz
bodies.drum.rigid.inertia=true -> = true: a moment of inertia in the plane, or six entries [ixx, iyy, izz, ixy, ixz
bodies.drum.rigid.centre=[0.1, 0.0, 0.0] -> = [0.1, 0.0, 0.0]: two numbers (x, y) are needed in the plane
bodies.drum.rigid.centre=["x", 0.0] -> = ["x", 0.0]: two finite numbers in brackets
bodies.drum.rigid.points.rim=[0.1, 0.0, 0.0] -> = [0.1, 0.0, 0.0]: two numbers (x, y) are needed in the plane
bodies.drum.rigid.points.centre=[0.1, 0.0] -> = [0.1, 0.0]: this point is the centre of mass; give its place as bodies
bodies.drum.mesh="drum.msh" -> \
    bodies.drum.rigid = { mass = 2.0, inertia = 0.03, points = { hub = [0.0, -0. ...: exactly one of mesh, line,
bodies.drum.element="beam2d" -> = "beam2d": rigid says all mass properties; leave it out
bodies.drum.material="steel" -> = "steel": rigid says all mass properties; leave it out
bodies.drum.flexible=true -> = true: a body with rigid does not deform; leave it out
bodies.drum.rigid.weight=3.0 -> = 3.0: unknown key
joints.hinge.connect=["ground:origin", "drum:hup"] -> \
    joints.hinge.connect = "drum:hup": there is no such point; did you mean 'drum:hub'?
outputs.x={type="position", point="drum:0", axis="x"} -> \
    outputs.x.point = "drum:0": there is no such point
outputs.s={type="stress", body="drum", quantity="axial_force"} -> \
    outputs.s.body = "drum": this body is rigid, so nothing is known of its stresses
effects.e={type="structural_damping", mass=1.0, bodies=["drum"]} -> \
    effects.e.bodies = ["drum"]: drum is rigid; only flexible bodies have structural damping; leave it out
fields.f={body="drum", quantity="E", variation=0.1, length=1.0, terms=1} -> \
    fields.f.body = "drum": is rigid; a field needs a flexible body
bodies.rod={material="steel", line={length=0.1, elements=2}} -> bodies.rod.element: missing; needed: beam2d, beam3d
""",
    DRUM_IN_SPACE: """
bodies.drum.rigid.inertia=[0.03, 0.03, 0.07, 0.0, 0.0, 0.0] -> \
    = [0.03, 0.03, 0.07, 0.0, 0.0, 0.0]: no body has it: of the principal moments 0.03, 0.03, 0.07 the last is
bodies.drum.rigid.inertia=[0.03, 0.03, 0.04, 0.05, 0.0, 0.0] -> \
    = [0.03, 0.03, 0.04, 0.05, 0.0, 0.0]: is not positive definite: its principal moments are -0.02, 0.04, 0.08
bodies.drum.rigid.inertia=[0.0, 0.03, 0.03, 0.0, 0.0, 0.0] -> \
    = [0.0, 0.03, 0.03, 0.0, 0.0, 0.0]: moments of inertia are positive
parameters.j.value=0.08 -> bodies.drum.rigid.inertia = ["j", 0.03, 0.04, 0.0, 0.0, 0.0]: no body has it
bodies.drum.rigid.points.hub=[0.0, -0.1] -> = [0.0, -0.1]: three numbers (x, y, z) are needed in space
bodies.two={rigid={mass=1.0, inertia=0.1}} & joints.more={type="spherical", connect=["drum:hub", "two:centre"]} -> \
    bodies.two.rigid.inertia = 0.1: is one number, for the plane, but drum (rigid) in space; there it has six entries
""",
}
CASES = [(text, *case) for text, lines in REFUSED.items() for case in cases(lines)]


@pytest.mark.parametrize(("text", "asked", "said"), CASES, ids=[asked[:50] for _, asked, _ in CASES])
def test_a_wrong_entry_is_explained(text: str, asked: str, said: str) -> None:
    given = asked.replace("HUGE", HUGE).replace("DRIVE", DRIVE).replace("WAVE", WAVE)
    message = refusal(scene_from_toml, text, ".", given.split(" & "))
    check_said(message, said, given)
    assert not any(word in message.lower() for word in WORDS_OF_LIBRARIES)


@pytest.mark.parametrize(
    ("initial", "position", "given"),
    [("", "0.0", "; a start that is not given is at zero"), ("theta = { position = 9 }", "9.0", "")],
)
def test_the_start_lies_in_a_range_that_is_not_periodic(initial: str, position: str, given: str) -> None:
    limited = ["coordinates.theta={joint='crank_hinge', range=[1, 2]}", f"simulation.initial={{{initial}}}"]
    said = f"simulation.initial.theta.position = {position}: must lie in the coordinate's range [1.0, 2.0]{given}"
    assert refusal(load_scene, SLIDER_CRANK, limited) == said
    scene = load_scene(SLIDER_CRANK, ["simulation.initial.theta.position=-7.0"])
    assert scene.initial_state("theta").position == -7.0, "a periodic coordinate starts anywhere"
    assert "parameters.r1.value = 0.5: must lie inside" in refusal(load_scene, SLIDER_CRANK, (), ["r1=0.5"])


def test_a_body_may_not_be_called_ground() -> None:
    text = SLIDER_CRANK.read_text().replace("[bodies.rod]", "[bodies.ground]").replace("rod:", "crank:")
    assert_refused("bodies.ground: this name means the points fixed in space", scene_from_toml, text, ".")


def test_an_empty_scene_is_told_which_tables_are_needed() -> None:
    assert refusal(scene_from_toml, "", ".").splitlines() == [
        "scene: missing; needed: table with the scene's name",
        "bodies: missing; needed: a table for each body, [bodies.NAME]",
        "joints: missing; needed: a table for each joint, [joints.NAME]",
        "coordinates: missing; needed: a table for each rigid coordinate, [coordinates.NAME]",
    ]


def test_many_problems_are_cut_to_eight_lines() -> None:
    lines = str(input_error([f"a{i}: wrong" for i in range(20)])).splitlines()
    assert len(lines) == 8
    assert lines[6:] == ["a6: wrong", "... and 13 more problems"]
    assert str(input_error([f"a{i}: wrong" for i in range(8)])).splitlines()[-1] == "a7: wrong"


@pytest.mark.parametrize(
    "change",
    [
        'joints.elbow.connect=["crank:tip", "NAME:hinge"]',
        'effects.e={type="structural_damping", mass=1, bodies=["NAME"]}',
        'effects.e={type="law", joint="crank_hinge", force="NAME * s"}',
        'effects.e={type="law", joint="crank_hinge", force="NAME(s)"}',
    ],
)
def test_long_names_are_cut(change: str) -> None:
    assert max(map(len, refusal(load_scene, SLIDER_CRANK, [change.replace("NAME", "n" * 2000)]).splitlines())) < 600


@pytest.mark.parametrize(
    ("value", "text"),
    [
        ('a"b', '"a\\"b"'), (True, "true"), (1e-3, "0.001"), ({"a b": [1, {}]}, '{ "a b" = [1, {}] }'),
        ("x" * 80, '"' + "x" * 55 + " ..."),
    ],
)  # fmt: skip
def test_received_values_are_shown_as_toml(value: object, text: str) -> None:
    assert toml_text(value) == text


def test_lines_and_dotted_names() -> None:
    assert dotted_name(["a", "b c", 2, "d"]) == 'a."b c"[2].d'
    assert problem("a.b", "allowed", None) == "a.b = None: allowed"
    assert problem("a.b", "allowed") == "a.b: allowed"


def test_the_base_is_sound() -> None:
    assert full_model(scene_from_toml(BASE, ".", [f"effects.e={DRIVE}"])).kinematics.mechanism.n_nodes == 5


def test_a_driven_coordinate_starts_where_its_motion_says() -> None:
    motion = 'effects.e={type="prescribed_motion", coordinate="theta", constant_speed={speed=0, start=1.5}}'
    scene = scene_from_toml(BASE, ".", ["coordinates.theta.range=[1, 2]", motion])
    assert scene.initial_state("theta").position == 0.0, "which is not looked at"


def test_rigid_bodies_alone_have_no_structural_damping() -> None:
    said = refusal(scene_of, BAR, '[effects.e]\ntype = "structural_damping"\nmass = 1.0')
    assert said == "effects.e: all bodies are rigid; only flexible bodies have structural damping; leave it out"


IN_THE_MESH = {
    "mass": ('effects.e={type="point_mass", point="crank:middel", mass=1}', "effects.e.point"),
    "force": (f'effects.e={{type="force", point="rod:midle", direction=[1, 0], {WAVE}}}', "effects.e.point"),
    "towards": (f'effects.e={{type="force", point="rod:tip", towards="crank:midle", {WAVE}}}', "effects.e.towards"),
    "spring": (
        'effects.e={type="spring_damper", points=["ground:wall", "rod:midle"], stiffness=1, rest=1}',
        "effects.e.points",
    ),
    "joint": ('joints.weld.connect=["rod:tip", "block:hing"]', "joints.weld.connect"),
}


@pytest.mark.parametrize("name", IN_THE_MESH)
def test_points_that_a_mesh_does_not_have(name: str) -> None:
    override, entry = IN_THE_MESH[name]
    message = refusal(full_model, scene_from_toml(BASE, ".", [override]))
    assert message.startswith(f"{entry} = ") and "did you mean" in message


def test_more_ratios_than_a_body_has_modes() -> None:
    ratios = [0.01] * 30
    model = full_model(scene_of(CANTILEVER, f'[effects.e]\ntype = "structural_damping"\nratios = {ratios}'))
    assert_refused(r"^effects\.e\.ratios: 30 modes of beam are asked for; its mesh has 24$", model.batch, {}, 1)


def test_lengths_of_couplings_may_be_texts_with_units() -> None:
    assert scene_from_toml(RACK, ".", ['joints.teeth.radius="50 mm"']).joints["teeth"].radius == 0.05
    assert scene_from_toml(SCREW, ".", ['joints.thread.lead="5 cm"']).joints["thread"].lead == 0.05


def test_rounded_moments_of_a_flat_body_are_taken() -> None:
    flat = "bodies.drum.rigid.inertia=[0.0333, 0.0333, 0.0667, 0.0, 0.0, 0.0]"
    assert scene_from_toml(DRUM_IN_SPACE, ".", (flat,)).bodies["drum"].rigid.dimension == 3
