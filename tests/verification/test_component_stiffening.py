"""Component modes that follow their foreshortening: beams stiffened by their spin, against theory and mesh."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import ROOT
from effect_scenes import CANTILEVER, line_meshes, scene_of
from mpi4py import MPI
from runs import history, samples

from pgmp_petsc.experiments.reference import component_model
from pgmp_petsc.mechanism.capabilities import Purpose, check_capabilities
from pgmp_petsc.models import FullModel
from pgmp_petsc.runtime.errors import InputError
from pgmp_petsc.scene import Scene, load_scene
from pgmp_petsc.studies.simulate import simulate_full

# the fundamental frequency in the plane of rotation over the spin, in units of sqrt(EI / rho A L^4); published
PUBLISHED = [(0.0, 3.516), (4.0, 3.898), (10.0, 5.049)]
STIFFENING = """
[effects.stiffening]
type = "geometric_stiffening"
[effects.shapes]
type = "mode_inertia"
"""
SPIN_UP = ROOT / "scenes" / "spinning_beam.toml"
STRETCHED = 1.2 * 6.0**2 * 10.0**3 / (3 * 2.8e7)  # rho A Omega^2 L^3 / 3 EA, m


def spinning(spin: float, stiffened: bool) -> Scene:
    """Return a cantilever that spins at a constant speed and is pushed across for half a period of its bending."""
    push = 0.5 * np.pi / 3.5
    return scene_of(
        CANTILEVER,
        f"""
{STIFFENING if stiffened else ""}
[effects.push]
type = "force"
point = "beam:tip"
direction = [0.0, 1.0]
follows = true
table = [[0.0, 0.0], [{push}, 1e-3], [{2 * push}, 0.0], [100.0, 0.0]]
[outputs.tip]
type = "deformation"
point = "beam:tip"
axis = "y"
frame = "body"
[reduction]
modes = 4
[simulation]
duration = 20.0
step = 5e-3
""",
        "bodies.beam.line.elements=16",
        f"effects.hold.constant_speed.speed={spin}",
    )


def fundamental(spin: float, stiffened: bool = True) -> float:
    """Return the angular frequency of the component model's bending after the push, from where it crosses zero."""
    scene = spinning(spin, stiffened)
    times, found = history(component_model(scene, line_meshes(scene), MPI.COMM_SELF), samples(scene, 1), 1)
    tip = found["tip"][times > 5.0, 0]
    times = times[times > 5.0]
    tip = tip - 0.5 * (tip.max() + tip.min())
    k = np.flatnonzero((tip[:-1] < 0.0) & (tip[1:] >= 0.0))
    crossings = times[k] - tip[k] * (times[k + 1] - times[k]) / (tip[k + 1] - tip[k])
    return 2.0 * np.pi * (crossings.size - 1) / (crossings[-1] - crossings[0])


@pytest.mark.parametrize(("spin", "published"), PUBLISHED)
def test_the_frequency_of_a_rotating_beam(spin: float, published: float) -> None:
    # 16 elements: 4e-4, the step's (omega h)^2 / 12: 5e-5
    assert fundamental(spin) == pytest.approx(published, rel=2e-3)


def test_without_stiffening_a_beam_gets_softer_as_it_spins() -> None:
    """Why the effect is there: 4.263 is right, and at rest it is 3.516."""
    assert fundamental(6.0, stiffened=False) < 3.0


def test_a_spin_up_is_that_of_the_mesh() -> None:
    """Simo and Vu-Quoc's beam lags behind by more than half a metre, swings forward and ends straight, stretched."""
    scene = load_scene(SPIN_UP, ["simulation.step=1e-2"])
    meshes = line_meshes(scene)
    exact = simulate_full(FullModel(scene, meshes), MPI.COMM_SELF)
    found = simulate_full(component_model(scene, meshes, MPI.COMM_SELF), MPI.COMM_SELF)
    deflection = exact.outputs["tip_deflection"]
    assert deflection.min() == pytest.approx(-0.574, abs=1e-3)
    # the reduced model with the same effect: 0.13 %
    np.testing.assert_allclose(
        found.outputs["tip_deflection"], deflection, rtol=0, atol=4e-3 * np.abs(deflection).max()
    )
    extension = found.outputs["tip_extension"][found.time > 16.0]
    assert extension.mean() == pytest.approx(STRETCHED, rel=2e-3)
    assert any("but for the foreshortening" in remark.text for remark in found.record.remarks)


def test_energy_is_kept() -> None:
    """Released from a sudden start with a spin that stiffens the beam by half: what is left is of order two."""
    scene, kept = spinning(6.0, True), []
    scene = scene.model_copy(update={"effects": {name: scene.effects[name] for name in ("stiffening", "shapes")}})
    for step in (1e-3, 5e-4):
        start = {"theta": scene.initial_state("theta").model_copy(update={"velocity": 6.0})}
        run = {"duration": 0.3, "step": step, "spectral_radius": 1.0, "initial": start}
        scene = scene.model_copy(update={"simulation": scene.simulation.model_copy(update=run)})
        balance = simulate_full(component_model(scene, line_meshes(scene), MPI.COMM_SELF), MPI.COMM_SELF).balance
        kept.append(np.ptp(balance.kinetic + balance.strain) / balance.kinetic[0])
    assert kept[1] < 1e-5
    assert np.log2(kept[0] / kept[1]) == pytest.approx(2.0, abs=0.2)


def test_stretching_with_its_inertia_is_refused() -> None:
    scene = load_scene(SPIN_UP, ['effects.stiffening.stretching="dynamic"'])
    check_capabilities(scene, Purpose.REDUCED)
    message = (
        'effects.stiffening.stretching = "dynamic": bodies in floating frames follow their shortening at once; take'
    )
    with pytest.raises(InputError, match=message):
        check_capabilities(scene, Purpose.COMPONENTS)
