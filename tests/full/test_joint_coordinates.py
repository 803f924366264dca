"""Component models in joint coordinates: the tree, the map to all frames, the matrix, and what follows from them."""

import numpy as np
import pytest
from conftest import ROOT
from runs import components_model, run_model, samples, watched
from spatial_beams import slider_crank_of_beams

from pgmp_petsc.full.joint_systems import JointBatch
from pgmp_petsc.full.joint_tree import BY_AXES
from pgmp_petsc.full.kernel import count_turns
from pgmp_petsc.models import ComponentModel
from pgmp_petsc.scene import load_scene
from pgmp_petsc.stepping.second_order_system import State
from pgmp_petsc.stepping.status import Status
from scenes import four_bar, meshes_of, slider_crank, trammel

STIFFENING = ('effects.stiffening={type="geometric_stiffening"}', 'effects.shapes={type="mode_inertia"}')
# of joints that turn, slide, are balls and close loops, in the plane and in space
MECHANISMS = {
    "four-bar": lambda: components_model(four_bar()),
    "free body": lambda: components_model(trammel()),
    "slider-crank, stiffened": lambda: _of_beams(*STIFFENING),
    "ball": lambda: _of_beams(
        'joints.elbow={type="universal", connect=["crank:tip", "rod:hinge"], axis=[0.0, 0.0, 1.0], '
        "second_axis=[0.0, 1.0, 0.0]}"
    ),
    "elastic about a second axis": lambda: components_model(load_scene(ROOT / "scenes/payload_arm.toml")),
}


def _of_beams(*overrides: str) -> ComponentModel:
    scene = slider_crank_of_beams(*overrides)
    return components_model(scene)


def moved(system: JointBatch, size: float = 1e-3) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return coordinates about the start, and rates and accelerations that let directors that are coordinates be."""
    rng, begun = np.random.default_rng(0), system.unpack(system.start().q)
    q, v, a = begun + size * rng.standard_normal(begun.shape), *rng.standard_normal((2, *begun.shape))
    still = directors_of(system)
    q[still], v[still], a[still] = begun[still], 0.0, 0.0
    return q, v, a


def directors_of(system: JointBatch) -> np.ndarray:
    """Return the coordinates that are places and directors, shape (n_directors,)."""
    tree = system.own.joints.tree
    each = [np.arange(*tree.firsts[k, 2:4]) for k in np.flatnonzero(tree.kinds != BY_AXES)]
    return np.concatenate([*each, np.zeros(0, dtype=int)])


def state_of(system: JointBatch, *parts: np.ndarray) -> State:
    begun = system.start()
    return State(*(system.pack(part) for part in parts), np.zeros_like(begun.multipliers), begun.turns)


@pytest.mark.parametrize("name", MECHANISMS)
def test_rates_and_accelerations_are_those_of_the_frames(name: str) -> None:
    """By differences over time; what the tree's joints hold is held to round-off."""
    model, h = MECHANISMS[name](), 1e-5
    system = model.batch(samples(model.scene, 1), 1)
    q, v, a = moved(system)

    def at(t: float) -> list[np.ndarray]:
        return system.unknowns_over(state_of(system, q + t * v + 0.5 * t * t * a, v + t * a, a).alone)

    before, now, after = at(-h), at(0.0), at(h)
    for order in range(2):
        scale = np.abs(now[order + 1]).max()
        found = (after[order] - before[order]) / (2.0 * h)
        np.testing.assert_allclose(found, now[order + 1], rtol=0, atol=1e-7 * scale)  # h^2 and round-off over h
    constraints = system._equations.constraints  # noqa: SLF001
    off = constraints.residual(now[0], np.zeros(constraints.n_driven))[:, 0]
    own = constraints.of_ties | constraints.of_directors
    assert np.abs(off[own]).max() < 1e-14
    assert (np.abs(off[~own]) > 1e-8).sum() <= system.n_constraints


@pytest.mark.parametrize("name", ["slider-crank, stiffened", "ball", "elastic about a second axis"])
def test_coordinates_count_turns_as_frames_do(name: str) -> None:
    """From two revolutions on, of joints that are in the tree and of others."""
    model = MECHANISMS[name]()
    system = model.batch(samples(model.scene, 2), 2)
    state, angles = state_of(system, *moved(system, 0.02)), system.own.joints.counted[:, 0] != -2
    state = State(*state.parts()[:4], state.turns + 4.0 * np.pi)
    in_unknowns = State(*system._in_unknowns(state.alone).at(0).parts()[:4], state.turns.copy())  # noqa: SLF001
    for q, turns in zip(in_unknowns.q, in_unknowns.turns):
        count_turns(system._of_unknowns, q, turns)  # noqa: SLF001
    system.count_turns(state)
    found, expected = (system.unpack(one.turns)[angles] for one in (state, in_unknowns))
    assert np.all(np.abs(expected - 4.0 * np.pi) < np.pi + 1.0)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-14 * 4.0 * np.pi)


@pytest.mark.parametrize("name", MECHANISMS)
def test_the_matrix_is_the_mass_of_the_energy(name: str) -> None:
    """``1/2 y'.A y'`` is the kinetic energy of all frames, whatever y'; the matrix is taken from its factors."""
    model = MECHANISMS[name]()
    system = model.batch(samples(model.scene, 1), 1)
    q, v, _ = moved(system)
    state = state_of(system, q, v, np.zeros_like(q))
    every = np.ones(1, dtype=bool)
    system._correct(0.0, state.copy(), (0.0, 1.0, 0.0), np.zeros_like(state.multipliers), every, True)  # noqa: SLF001
    n, n_all = system.n_dofs, system.n_dofs + system.n_constraints
    lower = np.zeros((n_all, n_all))
    columns, rows = np.triu_indices(n_all)
    lower[rows, columns] = system._factors.matrix[0, :, 0]  # noqa: SLF001
    d = 1.0 / np.diagonal(lower)
    np.fill_diagonal(lower, d)
    matrix = (lower / d) @ lower.T
    mass, borders = matrix[:n, :n], matrix[n:, :n]
    scale = float(system._typical_mass[0, 0])  # noqa: SLF001
    mass = mass - borders.T @ (system.own.joints.weights[:, None] * borders) / scale
    for rates in np.random.default_rng(1).standard_normal((5, n)):
        rates[directors_of(system)] = 0.0
        moving = state_of(system, q, rates[:, None], 0.0 * q)
        energy = float(system.energies(0.0, moving).kinetic[0])
        assert 0.5 * rates @ mass @ rates == pytest.approx(energy, rel=1e-9)


@pytest.mark.parametrize("make", [slider_crank, slider_crank_of_beams], ids=["plane", "space"])
def test_the_limit_is_that_of_all_unknowns_with_multipliers(make, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two discretisations of the same equations, of second order each."""
    meshes, apart = meshes_of if make is slider_crank else meshes_of, []
    for step in (2e-4, 1e-4):
        run, found = (f"simulation.step={step}", "simulation.duration=0.02"), []
        for joints in (True, False):
            monkeypatch.setattr(ComponentModel, "in_joints", joints)
            scene = make(*run, "reduction.modes=3", "simulation.initial={theta={velocity=3.0}}")
            model = components_model(scene, meshes(scene))
            system = model.batch(samples(scene, 1), 1)
            assert isinstance(system, JointBatch) == joints
            _, states = watched(system, scene.simulation, lambda _, state: state.copy(), 1 if step > 1.5e-4 else 2)
            found.append(np.array([system.frames(state)[..., 0] for state in states]))
        apart.append(np.abs(found[0] - found[1]).max())
    assert np.log2(apart[0] / apart[1]) == pytest.approx(2.0, abs=0.35)


def test_a_loop_that_is_driven_beyond_straight_ends_with_a_status() -> None:
    """The crank of a four-bar takes it out of reach: the sample ends there."""
    drive = 'effects.drive={type="prescribed_motion", coordinate="theta", table=[[0.0, 0.0], [0.1, 3.0], [1.0, 3.0]]}'
    rigid = (f"bodies.{name}.flexible=false" for name in ("crank", "coupler", "rocker"))
    # straight at 1.59 rad: 0.3, 1 and 0.6 + 0.45 m
    short = 'bodies.rocker.mesh="0.0:0.45:2"', 'bodies.coupler.mesh="0.0:0.6:2"'
    narrow = "coordinates.theta.range=[0.0, 1.5]", "coordinates.theta.periodic=false"
    scene = four_bar(drive, "simulation={duration=0.1, step=1e-3}", *rigid, *short, *narrow)
    model = components_model(scene)
    run = run_model(model)[1]
    assert run.status[0] != Status.FINE
    reached = model._motions[0].at(np.array([run.failure_time[0] - 2e-3, run.failure_time[0]]))[0]  # noqa: SLF001
    assert reached[0] < np.arccos((1.09 - 1.05**2) / 0.6) < reached[1] + 1e-9, reached
