"""A spring with free play, whose law has two edges: against closed forms, and as two stops, in every model and in C."""

import re
from pathlib import Path

import numpy as np
import pytest
from alike import assert_alike
from conftest import ROOT
from differences import differences
from effect_scenes import BAR_INERTIA, bar, recorded
from exported import Unit, assert_equal, assert_same_in_c, needs_compiler
from runs import FEW_MODES, MODELS, history, motion, reduced_model, samples
from test_effects_reduced import INERTIA, run_of

import pgmp_petsc as pgmp
from pgmp_petsc.c_export.constants import constants_of
from pgmp_petsc.c_export.fmu import OUTPUTS, VERSIONS, write_fmu
from pgmp_petsc.gradients.differentiated import differentiate
from pgmp_petsc.models import ReducedModel
from pgmp_petsc.scene import scene_from_toml, scene_to_toml
from scenes import slider_crank

SETTINGS = (
    *FEW_MODES, "simulation.step=1e-3", "simulation.duration=0.06",
    "simulation.initial.theta={position=0.4,velocity=9.0}", "parameters.k={nominal=8000.0}",
    'outputs.x={type="position",point="rod:tip",axis="x"}',
    'outputs.turning={type="speed",joint="crank_hinge"}', 'outputs.v={type="speed",point="rod:tip",axis="x"}',
)  # fmt: skip
SPRING = 'effects.stop={{type="{}",joint="crank_hinge",lower=0.35,upper=0.45,stiffness="k",damping=0.05}}'
TWO_STOPS, FREE_PLAY = (slider_crank(*SETTINGS, SPRING.format(kind)) for kind in ("end_stop", "free_play"))


@pytest.fixture(scope="module")
def with_play() -> ReducedModel:
    return reduced_model(FREE_PLAY)


STIFFNESS, LOWER, UPPER, SPEED = 100.0, -0.1, 0.15, 1.0
PLAY = f'[effects.play]\ntype = "free_play"\njoint = "hinge"\nlower = {LOWER}\nupper = {UPPER}\nstiffness = {STIFFNESS}'


def oscillation(time: np.ndarray, inertia: float) -> np.ndarray:
    """Return the angle of a bar that is free between both ends, and swings by half a period of the spring at each."""
    omega = np.sqrt(STIFFNESS / inertia)
    half, across = np.pi / omega, (UPPER - LOWER) / SPEED
    t = (time - UPPER / SPEED) % (2.0 * (half + across))  # from where it meets the upper end on
    above, below = SPEED / omega * np.sin(omega * t), SPEED / omega * np.sin(omega * (t - half - across))
    cases = [t < half, t < half + across, t < 2.0 * half + across]
    return np.select(
        cases, [UPPER + above, UPPER - SPEED * (t - half), LOWER - below], LOWER + SPEED * (t - 2.0 * half - across)
    )


@pytest.mark.parametrize("model", ["full", "reduced"])
def test_the_period_of_an_oscillator_through_a_gap(model: str) -> None:
    if model == "full":
        run = recorded(bar(PLAY, 0.9, velocity=SPEED))
        time, angle, inertia = run.time, run.angle, BAR_INERTIA
    else:
        found = run_of(PLAY, 0.9, velocity=SPEED)
        time, angle, inertia = found.time, found.outputs["angle"], INERTIA
    # a period is 0.86 s; (omega h)^2 / 12 of omega t, omega = 17 / s
    np.testing.assert_allclose(angle, oscillation(time, inertia), rtol=0, atol=4e-4)


@pytest.mark.parametrize("name", MODELS)
def test_one_law_with_two_edges_is_two_stops(name: str) -> None:
    found = []
    for scene in (FREE_PLAY, TWO_STOPS):
        model, values = MODELS[name](scene), samples(scene, 9, k=np.linspace(6000.0, 1e4, 9))
        assert model.batch(values, 9).n_events == 2
        found.append(history(model, values, 9)[1])
    # both stop at both ends; instants of edges are found to 1e-9 of a step
    assert min(np.ptp(expected, axis=0).min() for expected in found[1].values()) > 1e-4
    assert_alike(found[1], found[0], 1e-9)


def test_derivatives_through_both_edges_are_central_differences(with_play: ReducedModel) -> None:
    run = differentiate(with_play, FREE_PLAY.values, ["k"])
    assert len(run.contacts) > 2
    wanted = differences(with_play, "k", 1e-4)
    for output in ("x", "turning", "v"):
        # edges are found to 1e-9 of a step; and accelerations jump with the stiffness, of which speeds see more
        largest = np.abs(wanted[output]).max()
        np.testing.assert_allclose(run.derivatives[output]["k"], wanted[output], rtol=0, atol=1e-5 * largest)


@needs_compiler
def test_a_model_in_c_finds_edges(tmp_path: Path) -> None:
    """A step that meets none does what it did; one that does is taken in the parts of the program."""
    assert_same_in_c(reduced_model(TWO_STOPS), tmp_path)


OWN = {"effects/free_play.py": "free_play", "outputs/of_frames.py": "speed"}


@needs_compiler
@pytest.mark.usefixtures("quickly_compiled")
def test_the_program_s_own_files_as_plugins_run_as_units(tmp_path: Path, no_plugins: None) -> None:
    """An effect and an output that the program does not have, under other names: as the program's, in its own runs, in
    C and as an FMU that is run."""
    for file, name in OWN.items():
        text = (ROOT / "pgmp_petsc" / file).read_text(encoding="utf-8")
        (tmp_path / f"mine_{name}.py").write_text(
            re.sub(r'Literal\["(\w+)"\]', r'Literal["my_\1"]', text).replace(f'"{name}"', f'"my_{name}"')
        )
        pgmp.use(tmp_path / f"mine_{name}.py")
    text = scene_to_toml(FREE_PLAY)
    for name in OWN.values():
        text = text.replace(f'type = "{name}"', f'type = "my_{name}"')
    mine = scene_from_toml(text, ".")
    assert [effect.type for effect in mine.effects.values()].count("my_free_play") == 1
    model = reduced_model(mine)
    wanted = motion(model).outputs
    for name, values in motion(reduced_model(FREE_PLAY)).outputs.items():
        np.testing.assert_allclose(wanted[name], values, rtol=1e-12, atol=1e-14)
    write_fmu(constants_of(model, "it"), tmp_path / "m.fmu", VERSIONS[-1])
    unit = Unit(tmp_path / "m.fmu", tmp_path / "there")
    assert unit.instantiate() and unit.begin() == 0
    names, rows = list(wanted), []
    for step in range(61):
        rows.append([unit.get("Real", OUTPUTS + k) for k in range(len(names))])
        assert step == 60 or unit.step(1e-3 * step, 1e-3) == 0
    assert_equal(dict(zip(names, np.array(rows).T)), wanted)
    assert not unit.said
