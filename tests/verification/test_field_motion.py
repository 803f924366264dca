"""Motions of bodies with random fields: closed forms, energies, and the models against each other."""

import tracemalloc
from contextlib import closing

import numpy as np
import pytest
from runs import components_model, full_model, history, reduced_model, rom_of, samples, watched
from spatial_beams import SLIDER_CRANK as IN_SPACE

from pgmp_petsc.bodies.random_fields import checked_expansion, correlation
from pgmp_petsc.ensemble.plan import Plan
from pgmp_petsc.ensemble.sampling import Sampler
from pgmp_petsc.models import FullModel
from pgmp_petsc.scene import Scene, scene_from_toml
from scenes import PENDULUM, meshes_of, slider_crank

N = 20  # elements
BAR = (
    PENDULUM.replace("radius = 2e-4", "radius = 5e-3").replace(":10", f":{N}")
    + '\n[effects.weight]\ntype = "gravity"\n[initial]\nequilibrium = true\ncoordinates = "held"\n'
)
FIELD = "quantity = 'E'\nvariation = 0.1\nlength = 0.5\nterms = 4"
MOVING = (
    'fields.soft={body="rod", quantity="E", variation=0.12, length=0.4, terms=3}',
    'fields.heavy={body="crank", quantity="rho", variation=0.1, length=0.5, terms=1}',
    'effects.damped={type="structural_damping", stiffness=1e-5, mass=0.2}',
    'outputs.push={type="deformation", point="rod:tip", axis="x"}', 'effects.weight={type="gravity"}',
    "simulation.initial.theta={position=0.5, velocity=15.0}", "simulation.duration=0.1", "simulation.step=1e-3",
)  # fmt: skip
VALUES = {"soft_1": -2.0, "soft_2": 1.5, "soft_3": 1.0, "heavy_1": 1.8}


def bar(field: str, *overrides: str) -> Scene:
    (name,) = scene_from_toml(BAR, ".").bodies
    return scene_from_toml(f'{BAR}\n[fields.soft]\nbody = "{name}"\n{field}\n', ".", overrides)


def tips(model: FullModel, values: dict[str, np.ndarray]) -> np.ndarray:
    """Return how far the tip hangs down in samples."""
    with closing(model.batch(values, len(next(iter(values.values()))))) as system:
        return system.frames(system.start())[-1, 1]


def test_fields_of_many_terms_take_little_memory() -> None:
    """Products of all candidates with each other took 600 MB of 20 terms, in proportion to their square."""
    field = FIELD.replace("0.1", "0.05").replace("length = 0.5", "length = 0.2").replace("terms = 4", "terms = 12")
    scene = bar(field, "reduction.modes=4", "reduction.parameter_modes=2")
    tracemalloc.start()
    rom = rom_of(scene)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert rom.points.missed[-1] < rom.points.missed[0] and most < 60e6


def test_a_held_bar_hangs_as_the_integral_of_its_curvature_says_and_scatters_as_the_kernel_says() -> None:
    scene = bar(FIELD)
    mesh = next(iter(meshes_of(scene).values()))
    x = mesh.nodes[mesh.cells].mean(axis=1)[:, 0]
    field = scene.fields["soft"]
    found = checked_expansion(scene, "soft", mesh)
    n = 200
    values = Sampler(scene, Plan(n, 3)).draw(0, n)
    xi = np.array([values[name] for name in field.names("soft")])
    factor = 1.0 + field.variation * found.functions.T @ xi
    # M kappa over the length: w = int q (L - x)^3 / (2 E I) dx, with E I of every element
    shares = (1.0 - x) ** 3
    hanging = tips(full_model(scene), values)
    even = tips(full_model(scene), {name: np.zeros(1) for name in values})
    expected = shares @ (1.0 / factor) / shares.sum()
    # one-point elements and the distributed weight: 1 / n^2 of what differs, 0.1; large deflections the square of 0.7 %
    np.testing.assert_allclose(hanging / even, expected, rtol=5e-4)
    # to first order in the variation the variance is the double integral of the kernel, of which the terms keep a part
    weights = shares / shares.sum()
    whole = weights @ correlation("exponential", np.abs(x[:, None] - x) / field.length) @ weights
    kept = np.sum((found.functions @ weights) ** 2)
    assert 0.98 < kept / whole <= 1.0
    # 5 % is the deviation of the deviation of 200 samples, and 1 % the second order
    assert np.std(hanging / even) == pytest.approx(field.variation * np.sqrt(whole), rel=0.15)


RADII = np.array([5e-3, 3e-3, 8e-3])


@pytest.mark.parametrize(("changed", "given", "weight"), [
    ((), {"soft_1": np.array([0.0, 2.0, -1.0]), "soft_4": np.array([0.0, -2.5, 2.0])}, 1.0),
    (("parameters.r={nominal=5e-3}", 'bodies.arm.section.radius="r"'), {"r": RADII}, (RADII / RADII[0]) ** 2),
], ids=["from place to place", "by the radius"])  # fmt: skip
def test_sections_of_component_models_carry_the_weight_whatever_the_stiffness(
    changed: tuple[str, ...], given: dict[str, np.ndarray], weight: np.ndarray | float
) -> None:
    moment, force = (
        f'outputs.{quantity}={{type="stress", body="arm", quantity="{quantity}", at=[{x}, 0.0]}}'
        for quantity, x in (("bending_moment", 0.0), ("shear_force", 0.3))
    )
    asked = moment, force, *changed, "reduction.modes=2", "simulation.duration=0.01"
    scene = scene_from_toml(BAR, ".", asked) if changed else bar(FIELD, *asked)
    found = history(components_model(scene), samples(scene, 3, **given), 3)[1]
    # fields are right to first order in a variation of a tenth, what is left is orthogonal to them: 4e-5 of moments,
    # which do most of the work, and 1 % of forces; by the radius there is no more than two ways
    for name, allowed in (("bending_moment", 2e-4), ("shear_force", 2e-4 if changed else 2e-2)):
        start = found[name][0] / weight  # held
        np.testing.assert_allclose(start / start[0], 1.0, atol=allowed, err_msg=name)


def moving(values: dict[str, float] = VALUES) -> tuple[Scene, dict[str, np.ndarray]]:
    scene = slider_crank(*MOVING, "reduction.static_modes=true", "reduction.inertia_modes=true", "reduction.modes=6")
    return scene, samples(scene, 2, **{name: np.array([0.0, value]) for name, value in values.items()})


@pytest.fixture(scope="module")
def full() -> dict[str, np.ndarray]:
    scene, values = moving()
    return history(full_model(scene), values, 2)[1]


def test_the_reduced_model_moves_as_the_full_order_one_does(full: dict[str, np.ndarray]) -> None:
    scene, values = moving()
    found = history(reduced_model(scene), values, 2)[1]
    push, exact = found["push"], full["push"]
    scale = np.abs(exact).max()
    changed = np.abs(exact[:, 1] - exact[:, 0]).max()
    assert changed > 0.1 * scale  # what the field does
    # what the basis leaves out without the field, of the nominal parameters, it leaves out with it too
    left_out = np.abs(push - exact).max(axis=0)
    assert left_out[1] < 2.0 * left_out[0] < 0.3 * changed


def test_beams_in_space_move_as_those_in_the_plane(full: dict[str, np.ndarray]) -> None:
    _, values = moving()
    down = 'effects.weight={type="gravity", direction=[0.0, -1.0, 0.0]}'
    scene = scene_from_toml(IN_SPACE, ".", (*MOVING, down))
    found = history(full_model(scene), {name: values[name] for name in scene.values}, 2)[1]
    scale = np.abs(full["push"]).max()
    np.testing.assert_allclose(found["push"], full["push"], atol=2e-3 * scale)


def test_the_energy_of_a_damped_motion_is_balanced() -> None:
    scene, values = moving()
    model = full_model(scene)
    with closing(model.batch(values, 2)) as system:
        run, energies = watched(system, scene.simulation, system.energies)
    assert not run.status.any()
    total = np.array([one.kinetic + one.strain + sum(one.potential.values()) for one in energies])
    power = np.array([sum(one.powers.values()) for one in energies])
    work = np.concatenate([np.zeros((1, 2)), np.cumsum(0.5 * (power[1:] + power[:-1]) * 1e-3, axis=0)])
    # the trapezoidal rule over steps that resolve the motion, and the scheme's own damping of the highest modes
    np.testing.assert_allclose(total - total[0], work, atol=2e-2 * np.abs(work).max())
    assert all("damped" in one.powers for one in energies) and any(one.powers["damped"].min() < 0 for one in energies)
