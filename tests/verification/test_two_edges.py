"""A law with two edges that is no part of the program: a spring with free play is as two stops, in every model."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from differences import ToRoundOff, differences
from exported import assert_equal, compiled, needs_compiler, outputs_of, simulated
from gap_spring import GAP_SPRING
from mpi4py import MPI
from runs import full_model, history, reduced_model, samples

from pgmp_petsc.bench.reference import component_model
from pgmp_petsc.dynamics.generalised_alpha import Run, integrate
from pgmp_petsc.effects.laws import STOP
from pgmp_petsc.gradients import differentiated
from pgmp_petsc.gradients.differentiated import differentiate
from pgmp_petsc.models import Model
from pgmp_petsc.scene import Scene
from scenes import meshes_of, slider_crank

SETTINGS = (
    "reduction.modes=3", "reduction.static_modes=true", "reduction.inertia_modes=true", "reduction.angles=32",
    'reduction.interpolation="spline"', "simulation.step=1e-3", "simulation.duration=0.06",
    "simulation.initial.theta={position=0.4,velocity=9.0}", "parameters.k={nominal=8000.0}",
    'outputs.x={type="position",point="rod:tip",axis="x"}',
)  # fmt: skip
END_STOP = 'effects.stop={{type="end_stop",joint="crank_hinge",{}upper=0.45,stiffness="k",damping=0.05}}'
TWO_STOPS = slider_crank(*SETTINGS, END_STOP.format("lower=0.35,"))
ONE_LAW = slider_crank(*SETTINGS, END_STOP.format(""))
MODELS: dict[str, Callable[[Scene], Model]] = {
    "reduced": reduced_model,
    "full": full_model,
    "components": lambda scene: component_model(scene, meshes_of(scene), MPI.COMM_SELF),
}


@pytest.fixture
def with_play(monkeypatch: pytest.MonkeyPatch) -> Callable[[], None]:
    """Let a stop be declared as the spring with play from now on."""

    def put() -> None:
        assert GAP_SPRING.code and GAP_SPRING.address and GAP_SPRING.address_of_slopes
        for name, value in vars(GAP_SPRING).items():
            monkeypatch.setitem(vars(STOP), name, value)

    return put


@pytest.mark.parametrize("name", MODELS)
def test_one_law_with_two_edges_is_two_stops(name: str, with_play: Callable[[], None]) -> None:
    two = MODELS[name](TWO_STOPS)
    values = samples(TWO_STOPS, 9, k=np.linspace(6000.0, 1e4, 9))
    wanted = history(two, values, 9)[1]
    assert two.batch(values, 9).n_events == 2
    with_play()
    one = MODELS[name](ONE_LAW)
    assert one.batch(values, 9).n_events == 2
    found = history(one, values, 9)[1]
    for output, expected in wanted.items():
        # both stop at both ends; instants of edges are found to 1e-9 of a step
        assert np.ptp(expected, axis=0).min() > 1e-4
        np.testing.assert_allclose(found[output], expected, rtol=0, atol=1e-9 * np.abs(expected).max())


def test_derivatives_through_both_edges_are_central_differences(
    with_play: Callable[[], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of runs carried to round-off, as what iterations leave grows from contact to contact."""

    def carefully(system: Any, *arguments: Any, **named: Any) -> Run:
        return integrate(ToRoundOff(system), *arguments, **named)

    monkeypatch.setattr(differentiated, "integrate", carefully)
    two = differentiate(reduced_model(TWO_STOPS), TWO_STOPS.values, ["k"])
    with_play()
    model = reduced_model(ONE_LAW)
    run = differentiate(model, ONE_LAW.values, ["k"])
    assert [contact.met for contact in run.contacts] == [contact.met for contact in two.contacts]
    assert len(run.contacts) > 2
    np.testing.assert_allclose([c.time for c in run.contacts], [c.time for c in two.contacts], rtol=1e-9)
    found, of_stops = (each.derivatives["x"]["k"] for each in (run, two))
    largest = np.abs(of_stops).max()
    np.testing.assert_allclose(found, of_stops, rtol=0, atol=1e-8 * largest)
    # 1.6e-6 are left, of two stops too, whatever the step of the differences: the edges are found to 1e-9 of a step
    np.testing.assert_allclose(found, differences(model, "k", 1e-4)["x"], rtol=0, atol=1e-5 * largest)


@needs_compiler
def test_a_model_in_c_finds_the_edges_of_laws(tmp_path: Path) -> None:
    """A step that meets none does what it did; one that does is taken in the parts of the program."""
    model = reduced_model(TWO_STOPS)
    assert_equal(outputs_of(compiled(model, tmp_path)), simulated(model).outputs)
