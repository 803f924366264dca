"""Effects in the reduced model against closed forms, and what a scene without an effect has of it: nothing."""

from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path

import h5py
import numpy as np
import pytest
from counting import count_calls
from effect_scenes import BAR, BAR_INERTIA, STEP, G, scene_of, turning
from runs import FEW_MODES, full_model, history, motion, reduced_model, rom_of, samples, trajectory
from slopes import characteristic_roots
from test_damping_and_drives import DECAYS, MOTIONS, SPINNER
from test_effects_full import ANCHOR, TURNED

from pgmp_petsc.effects import Effect, Motion
from pgmp_petsc.models import ReducedModel
from pgmp_petsc.reduced.system import ReducedSystem
from pgmp_petsc.results import Trajectory
from pgmp_petsc.scene import Scene
from pgmp_petsc.stepping.edge_search import EventLocation
from pgmp_petsc.stepping.second_order_system import State
from scenes import slider_crank, tables

# so stiff that it is straight to 1e-5, with modes all the same; without the answer to a spring in the hinge, which is
# the vibration of the hinge's node on the bar, as in the full-order model, far faster than these steps resolve
STIFF = (
    "reduction.spring_modes=false",
    "bodies.bar.flexible=true", "bodies.bar.section.axial=1e7", "bodies.bar.section.shear=1e7",
    "bodies.bar.section.bending=1e5", "bodies.bar.section.rotary_density=1e-4",
)  # fmt: skip
INERTIA = BAR_INERTIA + 1e-4
ANGLE = tables("""
outputs.angle: type = "angle"; joint = "hinge"
reduction: modes = 2; angles = 24; interpolation = "spline"
""")


def run_of(text: str, duration: float, *overrides: str, **initial: float) -> Trajectory:
    """Run the reduced model of the stiff bar with effects."""
    start = "".join(f"{key} = {value}\n" for key, value in initial.items())
    simulation = f"[simulation]\nduration = {duration}\nstep = {STEP}\nspectral_radius = 0.9\n"
    begin = f"[simulation.initial.theta]\n{start}" if initial else ""
    scene = scene_of(BAR, f"{ANGLE}{text}\n{simulation}{begin}", *STIFF, *overrides)
    return motion(reduced_model(scene))


ONE = {"velocity": 1.0}
Closed = tuple[str, Callable[[float, float, float], float], float, float, dict[str, float]]


def joined(*rows: Sequence) -> Closed:
    """Return the effects of several rows of `TURNED` in one scene, and the sum of their torques."""
    entries, torques, further, *_ = zip(*rows)
    text = "".join(
        row.replace(ANCHOR, "").replace("effects.e:", f"effects.e{k}:").replace("effects.weight:", f"effects.w{k}:")
        + "\n"
        for k, row in enumerate(entries)
    )
    return f"{ANCHOR}\n{text}", lambda t, a, w: sum(one(t, a, w) for one in torques), sum(further), 0.5, ONE


LOADS = [row for name, row in TURNED.items() if name != "force on bar:hinge" and ("force" in name or "torque" in name)]
#: Of `TURNED` all but what is too fast for these steps, together; and what acts on bodies that deform alone.
CLOSED = {
    "loads and masses": joined(*LOADS, TURNED["point mass"]),
    "laws": joined(*(row for name, row in TURNED.items() if name.startswith("spring") or "damping" in name), (
        'effects.e: type = "joint_friction"; joint = "hinge"; limit = 0.5; speed = 0.2',
        lambda t, a, w: -0.5 * np.tanh(w / 0.2), 0.0,
    ), ('effects.e: type = "structural_damping"; mass = 1.5', lambda t, a, w: -1.5 * INERTIA * w, 0.0)),
    "end stop": (
        'effects.e: type = "end_stop"; joint = "hinge"; upper = 0.3; stiffness = 100.0; damping = 0.1',
        lambda t, a, w: -100.0 * max(0.0, a - 0.3) * max(0.0, 1.0 + 0.1 * w), 0.0, 0.5, ONE,
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", CLOSED)
def test_a_stiff_bar_turns_as_a_rigid_one(name: str) -> None:
    entries, torque, further, duration, start = CLOSED[name]
    run = run_of(tables(entries), duration, **start)
    expected = turning(torque, run.time, inertia=INERTIA + further, **start)
    # the largest rate is the stop's, sqrt(100 / J) = 17 / s: (omega h)^2 / 12 = 1e-4 of the turn; the bar bends by 1e-5
    np.testing.assert_allclose(run.outputs["angle"], expected, rtol=0, atol=1e-4 * max(1.0, np.ptp(expected)))
    assert np.abs(run.balance.residual).max() < 1e-3 * run.balance.exchanged


@pytest.mark.parametrize("name", MOTIONS)
def test_a_prescribed_motion_takes_the_torque_of_a_rigid_bar(name: str) -> None:
    drive = f'[effects.drive]\ntype = "prescribed_motion"\ncoordinate = "theta"\n{MOTIONS[name]}\n'
    run = run_of(drive + '[effects.weight]\ntype = "gravity"\n', 0.6)
    motion = scene_of(BAR, drive).effects["drive"].motion("drive")
    angles, _, accelerations = np.array([motion.at(t) for t in run.time]).T
    np.testing.assert_allclose(run.outputs["angle"], angles, rtol=0, atol=1e-12)
    torque = INERTIA * accelerations + 0.5 * G * np.cos(angles)
    work = np.concatenate([[0.0], np.cumsum(np.diff(angles) * (torque[1:] + torque[:-1]) / 2)])
    # Weight and, from a table, acceleration come suddenly: the bar swings on them, by 1e-5 but faster than it turns,
    # which takes 1.3 % of the work from a table, at steps of 2, 0.5 and 0.1 ms alike.
    np.testing.assert_allclose(run.balance.work["drive"], work, rtol=0, atol=1.5e-2 * np.abs(work).max())


DAMPED = tables("""
effects.loss: type = "structural_damping"
{damping}
reduction: modes = 3; angles = 4; interpolation = "spline"
""")


@pytest.mark.parametrize("name", ["both", "ratios"])
def test_the_decay_of_a_mode(name: str) -> None:
    """Of the second free mode, antisymmetric, by the linearised equations; a rotation decays by mass alone."""
    text, decay = DECAYS[name]
    model = reduced_model(scene_of(SPINNER, DAMPED.format(damping=text)))
    system, n = model.batch({}, 1), model.terms.layout.n_eta

    def residual(state: np.ndarray) -> np.ndarray:
        return system.residual(0.0, State(*state[:, None], np.zeros(0)))[0].copy()

    roots = characteristic_roots(residual, np.zeros((3, n)), 1e-6)
    expected = 7.8532**2  # of a free beam; 8 elements: (k h)^2 / 8
    mode = roots[np.argmin(np.abs(roots - 1j * expected))]
    omega = np.abs(mode)
    assert omega == pytest.approx(expected, rel=0.1)
    assert -mode.real == pytest.approx(decay(omega), rel=1e-5)
    rotation = sorted(np.abs(roots[np.abs(roots) < 5.0]))
    np.testing.assert_allclose(rotation, [0.0, float(name == "both")], rtol=0, atol=1e-4)


MODES = *FEW_MODES, "reduction.modes=4"
SHORT = "\n[simulation]\nduration = 2e-2\nstep = 2e-3\n"
NAMED = {
    "torque": 'type = "torque"\njoint = "hinge"\nharmonic = { amplitude = 1.0, frequency_hz = 1.0 }',
    "gravity": 'type = "gravity"',
    "point_mass": 'type = "point_mass"\npoint = "bar:tip"\nmass = 0.8\ninertia = 0.05',
    "spring_damper": 'type = "spring_damper"\njoint = "hinge"\nstiffness = 8.0',
    "structural_damping": 'type = "structural_damping"\nstiffness = 1e-5',
    "prescribed_motion": 'type = "prescribed_motion"\ncoordinate = "theta"\nconstant_speed = { speed = 1.0 }',
    "end_stop": 'type = "end_stop"\njoint = "hinge"\nupper = 0.3\nstiffness = 100.0',
    "geometric_stiffening": 'type = "geometric_stiffening"\n[effects.other]\ntype = "mode_inertia"',
}
WATCHED = [(Effect, "amplitude"), (Motion, "at"), (EventLocation, "repeat_steps")]


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> Counter:
    """Count the evaluations of everything that effects are made of outside compiled code."""
    return count_calls(monkeypatch, WATCHED)


def written(folder: Path, scene: Scene) -> dict[str, object]:
    """Write ROM and trajectories of a scene.

    Return the shapes of all datasets, timed phases among them, by ``file:path``, and the effects with loads.
    """
    found: dict[str, object] = {}
    rom = rom_of(scene)
    rom.write(folder / "rom.h5")
    trajectory(ReducedModel(scene, rom)).write(folder / "reduced.h5")
    trajectory(full_model(scene)).write(folder / "full.h5")
    for name in ("rom", "reduced", "full"):
        with h5py.File(folder / f"{name}.h5") as file:
            paths: list[str] = []
            file.visit(paths.append)
            found |= {f"{name}:{path}": file[path].shape for path in paths if isinstance(file[path], h5py.Dataset)}
            if name == "rom":
                found["loads"] = list(file["tables/load"].attrs["effects"])
    return found


@pytest.fixture(scope="module")
def bare(tmp_path_factory: pytest.TempPathFactory) -> dict[str, object]:
    """Return what the files of a scene without effects hold."""
    return written(tmp_path_factory.mktemp("bare"), scene_of(BAR, ANGLE + SHORT, *STIFF))


def test_files_without_effects_name_none(bare: dict[str, object]) -> None:
    assert bare["loads"] == [] and bare["rom:tables/load"][1] == 0
    assert not [name for name in bare if "work" in name or "second_order" in name or name == "rom:curvature"]


# errors are estimated of some effects only, at instants of the motion's own
ESTIMATE = ("reduced:errors/", "reduced:timings/errors")
# What the files of a scene with an effect have more than those without it, but for the work in trajectories.
ADDED = {
    "torque": {"rom:tables/load"},
    "gravity": {"rom:tables/load"},
    "point_mass": {"rom:tables/mass", "rom:tables/inertia", "rom:tables/rigid"},
    "geometric_stiffening": {"rom:tables/second_order", "rom:curvature", "rom:timings/second order"},
}
EVALUATED = {"torque": {"Effect.amplitude"}, "gravity": {"Effect.amplitude"}, "prescribed_motion": {"Motion.at"}}
LOCAL = ("spring_damper", "end_stop")


@pytest.mark.parametrize("kind", ["none", *NAMED])
def test_an_effect_adds_and_evaluates_only_what_is_its_own(
    bare: dict[str, object], calls: Counter, tmp_path: Path, kind: str
) -> None:
    """And a scene without it has none of that."""
    extra = f"[effects.extra]\n{NAMED[kind]}\n" if kind in NAMED else ""
    scene = scene_of(BAR, ANGLE + SHORT + extra, *STIFF)
    held = written(tmp_path, scene)
    assert "reduced:errors/time" in held and "reduced:errors/time" in bare
    bare, held = ({name: found[name] for name in found if not name.startswith(ESTIMATE)} for found in (bare, held))
    assert bare.keys() <= held.keys()
    changed = {name for name, value in held.items() if bare.get(name) != value}
    works = {f"{model}:work/extra" for model in ("reduced", "full")}
    has_work = kind not in ("none", "point_mass", "geometric_stiffening")
    assert (changed & works) == (works if has_work else set())
    # how stiffness follows from forces has a column for each that acts
    rest = changed - works - {"loads", "rom:stiffness_changes/influence"}
    assert all(any(name.startswith(part) for part in ADDED.get(kind, ())) for name in rest), sorted(rest)
    assert held["loads"] == (["extra"] if kind in ("torque", "gravity") else [])
    model = reduced_model(scene)
    calls.clear()
    system: ReducedSystem = model.batch({}, 1)
    motion(model)
    assert set(calls) == EVALUATED.get(kind, set())
    layout, equations, acts = model.terms.layout, system._equations, kind in LOCAL  # noqa: SLF001
    # what compiled code loops over, or skips because it is empty
    assert len(model.actions.actions) == equations.local.places.sides.shape[0] == acts
    assert system.n_events == (kind == "end_stop")
    assert (layout.damping < layout.end) == (kind == "structural_damping")
    assert equations.mass_damping == 0.0
    assert layout.second_order == (kind == "geometric_stiffening")
    assert equations.tables.loads.polynomials.shape[1] == (kind in ("torque", "gravity"))
    assert equations.prescribed.any() == (kind == "prescribed_motion")
    assert layout.quadratic


def bending(speed: float, keep: bool) -> tuple[np.ndarray, ReducedModel]:
    """Return the bending of a slider-crank's rod at a constant speed of the crank (rad/s) over time, and the model."""
    scene = slider_crank(
        'effects={motor={type="prescribed_motion",coordinate="theta",constant_speed={speed=%g,start=0.4}},'
        'weight={type="gravity"},velocities={type="gyroscopic",keep=%s}}' % (speed, str(keep).lower()),
        *MODES, 'outputs.bend={type="deformation",point="rod:2",axis="y"}',
        "simulation.duration=0.1", "simulation.step=1e-3",
    )  # fmt: skip
    model = reduced_model(scene)
    _, found = history(model, samples(scene, 1), 1)
    return found["bend"][:, 0], model


@pytest.mark.parametrize(("speed", "least", "most"), [(0.2, 0.0, 1e-3), (20.0, 0.5, np.inf)])
def test_slow_motions_do_without_gyroscopic_forces(speed: float, least: float, most: float) -> None:
    """Fast ones do not: the rod bends under its weight, and by its own inertia with the square of the speed."""
    kept, left = (bending(speed, keep)[0] for keep in (True, False))
    share = np.abs(left - kept).max() / np.abs(kept).max()
    assert least <= share < most, share
