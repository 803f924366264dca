"""Named outputs from the frames of nodes."""

from collections.abc import Callable
from typing import ClassVar

import numpy as np
import pytest

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.mechanism.kinematics import REACH, RigidKinematics
from pgmp_petsc.mechanism.mechanism import Unknowns
from pgmp_petsc.outputs.outputs import OutputSet
from pgmp_petsc.outputs.readings import Rate
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.outputs import OutputEntry
from scenes import CRANK, ROD, kinematics_of, slider_crank

OUTPUTS = (
    'outputs.crank={type="angle", joint="crank_hinge"}',
    'outputs.elbow={type="angle", joint="elbow"}',
    'outputs.tilt={type="rotation", point="rod:tip"}',
    'outputs.x={type="position", point="rod:tip", axis="x"}',
    'outputs.y={type="position", point="crank:2", axis="y"}',
    'outputs.moved={type="displacement", point="rod:tip", axis="x"}',
    'outputs.bent={type="deformation", point="rod:tip", axis="x"}',
    'outputs.bent_y={type="deformation", point="crank:tip", axis="y"}',
)
START = 0.3
LIMITED = ("coordinates.theta.range=[0.1, 1.5]", "coordinates.theta.periodic=false")


def prepared(*overrides: str) -> tuple[Scene, RigidKinematics, OutputSet]:
    scene = slider_crank(*OUTPUTS, f"simulation.initial.theta.position={START}", *overrides)
    kinematics = kinematics_of(scene)
    return scene, kinematics, OutputSet.of(scene, kinematics)


def rigid_frames(kinematics: RigidKinematics, outputs: OutputSet, theta: np.ndarray) -> np.ndarray:
    q = Unknowns(kinematics.mechanism).place(kinematics.poses(theta))
    return q.reshape(-1, 3, theta.size)[list(outputs.nodes)]


def seen(outputs: OutputSet, frames: np.ndarray) -> dict[str, np.ndarray]:
    """Return the outputs for frames of their nodes, where there are no stresses."""
    return outputs.evaluate(outputs.observed([frames], np.empty((0, frames.shape[2]))))


def slider(theta: np.ndarray) -> np.ndarray:
    """Return the rigid slider's position, from the triangle of crank, rod and line."""
    return CRANK * np.cos(theta) + np.sqrt(ROD**2 - (CRANK * np.sin(theta)) ** 2)


def test_a_rigid_mechanism_gives_the_closed_forms_over_several_turns() -> None:
    _, kinematics, outputs = prepared()
    theta = np.array([0.0, 0.7, 2.0, 4.0, 6.9, 14.0, -1.0])
    found = seen(outputs, rigid_frames(kinematics, outputs, theta))
    tilt = -np.arcsin(CRANK / ROD * np.sin(theta))
    expected = {
        "crank": theta, "elbow": tilt - theta, "tilt": tilt, "x": slider(theta), "y": 0.4 * CRANK * np.sin(theta),
        "moved": slider(theta) - slider(np.array([START])), "bent": 0 * theta, "bent_y": 0 * theta,
    }  # fmt: skip
    assert list(found) == list(expected)
    for name, values in expected.items():
        # the closure's tolerance is 1e-12 of the rod's length
        np.testing.assert_allclose(found[name], values, rtol=0, atol=5e-12, err_msg=name)


def test_units_and_nodes() -> None:
    _, kinematics, outputs = prepared()
    assert outputs.units == dict.fromkeys(("crank", "elbow", "tilt"), "rad") | dict.fromkeys(
        ("x", "y", "moved", "bent", "bent_y"), "m"
    )
    mechanism = kinematics.mechanism
    needed = {
        mechanism.attachment(point, "").node
        for point in ("crank:hinge", "crank:2", "crank:tip", "rod:hinge", "rod:tip")
    }
    assert outputs.nodes == tuple(sorted(needed))
    scene = slider_crank()  # without outputs
    outputs = OutputSet.of(scene, kinematics_of(scene))
    assert (outputs.nodes, outputs.units, seen(outputs, np.empty((0, 3, 4)))) == ((), {}, {})


def test_a_deformation_is_measured_at_the_same_rotation_of_the_hinge_node() -> None:
    _, kinematics, outputs = prepared()
    theta = np.array([0.5, 1.0])
    frames = rigid_frames(kinematics, outputs, theta)
    hinge = outputs.nodes.index(kinematics.mechanism.attachment("crank:hinge", "").node)
    frames[hinge, 2] += 0.01
    bent = seen(outputs, frames)["bent"]
    np.testing.assert_allclose(bent, slider(theta) - slider(theta + 0.01), rtol=0, atol=5e-12)
    tip = outputs.nodes.index(kinematics.mechanism.attachment("rod:tip", "").node)
    frames[tip, 0] += 1e-4
    bent = seen(outputs, frames)["bent"]
    np.testing.assert_allclose(bent, slider(theta) - slider(theta + 0.01) + 1e-4, rtol=0, atol=5e-12)


def test_a_deformation_far_outside_a_limited_range_is_no_number() -> None:
    _, kinematics, outputs = prepared(*LIMITED)
    inside = np.array([0.1, 0.8, 1.5])
    frames = rigid_frames(kinematics, outputs, np.array([0.1, 0.8, 1.5, 1.5, 0.1]))
    hinge = outputs.nodes.index(kinematics.mechanism.attachment("crank:hinge", "").node)
    frames[hinge, 2] = [*inside, 1.5 + 1.1 * REACH, 0.1 - 1.1 * REACH]
    found = seen(outputs, frames)
    np.testing.assert_array_equal(np.isnan(found["bent"]), [False, False, False, True, True])
    assert not any(np.isnan(found[name]).any() for name in ("crank", "x", "moved"))
    frames[hinge, 2] = [0.1 - 0.5 * REACH, 0.8, 1.5 + 0.5 * REACH, 1.0, np.nan]
    np.testing.assert_array_equal(np.isnan(seen(outputs, frames)["bent"]), [False] * 4 + [True])


def test_outputs_next_to_known_ones_have_the_same_slopes() -> None:
    """Of a mechanism whose loops a table closes, within its range and a little outside; far outside there are none."""
    for beyond in (0.0, 0.5 * REACH, 1.1 * REACH):
        _, kinematics, outputs = prepared(*LIMITED)
        theta, step = np.array([0.1, 0.8, 1.5]), 1e-5
        hinge = outputs.nodes.index(kinematics.mechanism.attachment("crank:hinge", "").node)

        def moved(by: float) -> np.ndarray:
            frames = rigid_frames(kinematics, outputs, theta)
            frames[hinge, 2] += [-beyond + by, by, beyond + by]
            return outputs.observed([frames], np.empty((0, theta.size)))

        near = outputs.near(moved(0.0))
        np.testing.assert_equal(near(moved(0.0)), outputs.evaluate(moved(0.0)))
        known = slice(1, 2) if beyond > REACH else slice(None)
        ahead, behind = (near(moved(by))["bent"] for by in (step, -step))
        angle = (theta + [-beyond, 0.0, beyond])[known]
        h = 1e-4
        expected = -(slider(angle + h) - slider(angle - h)) / (2.0 * h)
        # closed to 1e-12, over the step; and differences of the closed form
        np.testing.assert_allclose(((ahead - behind) / (2.0 * step))[known], expected, rtol=0, atol=1e-6)
        assert np.isnan(ahead).sum() == (2 if beyond > REACH else 0)


class Rates(OutputEntry):
    """A derivative of what another output reads; taken into no family, as it has no type."""

    def __init__(self, of: OutputEntry, order: int) -> None:
        super().__init__()
        object.__setattr__(self, "of", of)
        object.__setattr__(self, "order", order)
        object.__setattr__(self, "unit", of.unit_in(None))

    reads: ClassVar[tuple[str, ...]] = ("frames",)

    def reading(self, name: str, start: np.ndarray, kinematics: RigidKinematics) -> Rate:
        return Rate(self.of.reading(name, start, kinematics), self.order)


@pytest.mark.parametrize("order", [1, 2])
def test_rates_are_how_fast_readings_change(order: int) -> None:
    """Of all readings, against differences of fourth order on a curved way on which nodes move by themselves too."""
    scene, kinematics, outputs = prepared('outputs.along={type="deformation", point="rod:tip", axis="x", frame="body"}')
    entries = {name: Rates(one, order) for name, one in scene.outputs.items()}
    of_rates = OutputSet.of(scene.model_copy(update={"outputs": entries}), kinematics)
    theta, h, still = np.array([0.3, 1.1, 2.5, 7.0]), 2e-3, np.empty((0, 4))
    away = np.random.default_rng(1).normal(scale=0.02, size=(3, len(of_rates.nodes), 3, 4))

    def frames(t: float) -> np.ndarray:
        return rigid_frames(kinematics, of_rates, theta + t + t**2) + away[0] + t * away[1] + t**2 * away[2]

    def changes(of: Callable[[float], np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        at = [of(k * h) for k in (-2, -1, 0, 1, 2)]
        first = (at[0] - 8.0 * at[1] + 8.0 * at[3] - at[4]) / (12.0 * h)
        return first, (-at[0] + 16.0 * at[1] - 30.0 * at[2] + 16.0 * at[3] - at[4]) / (12.0 * h**2)

    found = of_rates.evaluate(of_rates.observed([frames(0.0), *changes(frames)[:order]], still))
    for name, values in found.items():
        wanted = changes(lambda t: seen(outputs, frames(t))[name])[order - 1]
        # closure to 1e-12 over the step or its square, and its fourth power
        np.testing.assert_allclose(values, wanted, rtol=0, atol=1e-8 if order == 1 else 3e-6, err_msg=name)
    with pytest.raises(InputError, match="its rate is asked for after accelerations"):
        Rate(of_rates.functions["x"]).depth(3 - order)


@pytest.mark.parametrize("kind", ["rotation", "position", "displacement", "deformation"])
def test_an_unknown_point_is_refused_with_the_nearest_name(kind: str) -> None:
    axis = "" if kind == "rotation" else ', axis="x"'
    scene = slider_crank(f'outputs.wrong={{type="{kind}", point="rod:tipp"{axis}}}')
    with pytest.raises(InputError, match=r'outputs\.wrong\.point = "tipp": .* did you mean \'tip\'') as raised:
        OutputSet.of(scene, kinematics_of(scene))
    assert "\n" not in str(raised.value)
