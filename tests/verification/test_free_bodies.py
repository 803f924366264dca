"""Bodies that nothing but hinges of massless arms and gimbals holds: momentum, and the torque-free top of Euler."""

import numpy as np
import pytest
from runs import components_model, history, samples
from scipy.integrate import solve_ivp

from benchmarks.called import Called
from pgmp_petsc.bodies.floating import first_moments, second_moments
from pgmp_petsc.models import ComponentModel
from pgmp_petsc.scene import Scene, scene_from_toml
from pgmp_petsc.stepping.generalised_alpha import integrate
from scenes import HEADER, TURN, tables

#: Of arms and gimbals, whose mass a billion times that of the bodies would be felt in the digits that are compared.
MASSLESS = {
    2: 'element = "beam2d"\nflexible = false\nsection = { shape = "coefficients", axial = 1.0, shear = 1.0, '
    "bending = 1.0, line_density = 1e-10, rotary_density = 1e-12 }",
    3: 'element = "beam3d"\nflexible = false\nsection = { shape = "coefficients3d", axial = 1.0, shear_2 = 1.0, '
    "shear_3 = 1.0, torsion = 1.0, bending_2 = 1.0, bending_3 = 1.0, line_density = 1e-10, rotary_2 = 1e-12, "
    "rotary_3 = 1e-12 }\norientation = [0.0, 1.0, 0.0]",
}


def line(name: str, length: float, rest: str, elements: int = 1) -> str:
    return f"[bodies.{name}]\nline = {{ length = {length}, elements = {elements} }}\n{rest}\n"


def hinge(name: str, connect: tuple[str, str], axis: str = "") -> str:
    """Return the tables of a revolute joint with its coordinate and the output of its angle."""
    return tables(f"""
joints.{name}: type = "revolute"; connect = ["{connect[0]}", "{connect[1]}"]
{axis}
coordinates.{name}: joint = "{name}"; {TURN}
outputs.{name}: type = "angle"; joint = "{name}"
""")


def in_the_plane(*overrides: str) -> Scene:
    """Return a slender bar in free flight, thrown with a spin at which it stretches visibly, on an arm without mass."""
    bar = 'element = "beam2d"\nmaterial = "steel"\nsection = { shape = "circle", radius = 0.05 }'
    text = HEADER.replace("210e9", "2e9") + line("upper", 0.8, MASSLESS[2]) + line("fore", 0.8, MASSLESS[2])
    text += line("bar", 1.0, bar, 6) + hinge("shoulder", ("ground:origin", "upper:hinge"))
    text += hinge("elbow", ("upper:tip", "fore:hinge")) + hinge("wrist", ("fore:tip", "bar:middle"))
    text += tables("""reduction: modes = 6
simulation: duration = 0.1; step = 2e-4; spectral_radius = 1.0
simulation.initial: shoulder = { position = 0.3, velocity = 1.0 }; elbow = { position = 1.4, velocity = -2.0 };
    wrist = { position = -0.4, velocity = 40.0 }
""")
    return scene_from_toml(text, ".", overrides)


def in_space(*overrides: str) -> Scene:
    """Return two bars welded to a cross that spins about the axis across both, in gimbals without mass."""
    bar = 'element = "beam3d"\nmaterial = "steel"\nsection = { shape = "circle", radius = 5e-3 }\n'
    text = HEADER + line("outer", 0.1, MASSLESS[3]) + line("inner", 0.1, MASSLESS[3])
    text += line("long", 1.0, bar + "placement = { origin = [-0.5, 0.0, 0.0] }", 4)
    text += line(
        "short", 0.6, bar + "placement = { origin = [0.0, -0.3, 0.0], rotation = [0.0, 0.0, 1.5707963267948966] }", 4
    )
    text += hinge("yaw", ("ground:origin", "outer:hinge"), "axis = [0.0, 0.0, 1.0]")
    text += hinge("pitch", ("outer:hinge", "inner:hinge"), "axis = [0.0, 1.0, 0.0]")
    text += hinge("roll", ("inner:hinge", "long:middle"), "axis = [1.0, 0.0, 0.0]")
    text += tables("""joints.weld: type = "fixed"; connect = ["long:middle", "short:middle"]
reduction: modes = 4
simulation: duration = 0.5; step = 1e-3; spectral_radius = 1.0
simulation.initial: yaw = { velocity = 5.0 }; pitch = { velocity = 0.6 }; roll = { velocity = 0.8 }
""")
    return scene_from_toml(text, ".", overrides)


def momenta(model: ComponentModel) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return linear and angular momentum about the origin of all flexible bodies, and the spin of the last one's frame,
    at every instant, shapes (n_t, 3), (n_t, 3) and (n_t,)."""
    system = model.batch(samples(model.scene, 1), 1)
    unknowns, nominal = system._equations.unknowns, model.scene.nominal  # noqa: SLF001
    d, linear, angular, spins = unknowns.dimension, [], [], []

    def observe(number: int, time: float, state) -> None:
        q, v, _ = (part[:, 0] for part in system.unknowns_over(state.alone))
        total, turning = np.zeros(3), np.zeros(3)
        for body in unknowns.bodies:
            if not body.n_amplitudes:
                continue
            (floating,) = body.blocks("floating")
            moments = sum(float(weight.evaluate(nominal)) * part for weight, part in floating.moments.items())
            frame = unknowns.frame(body.first_node + body.n_nodes - 1)
            xi, rates = (part[body.internal] for part in (q, v))
            p, p1, axes, axes1 = pose(q[frame], v[frame], d)
            places, fields = first_moments(moments, d)
            squares, mixed, both = second_moments(moments, d)
            s, s1 = places[1:] + fields @ xi, fields @ rates
            of_fields = mixed + np.einsum("lkij,i->lkj", both, xi)  # int rho w_l Psi_k
            j = squares + np.einsum("kli,i->lk", mixed, xi) + of_fields @ xi
            j1 = of_fields @ rates
            moved = axes1.T @ s + axes.T @ s1
            total += places[0] * p1 + moved
            turning += np.cross(p, places[0] * p1 + moved) + np.cross(axes.T @ s, p1)
            for k in range(d):
                for l in range(d):  # noqa: E741
                    turning += np.cross(axes[k], axes1[l]) * j[k, l] + np.cross(axes[k], axes[l]) * j1[k, l]
            spin = v[frame[2]] if d == 2 else 0.5 * np.sum(np.cross(axes, axes1), axis=0)[2]
        linear.append(total)
        angular.append(turning)
        spins.append(spin)

    integrate(system, model.scene.simulation, observer=Called(observe))
    return np.array(linear), np.array(angular), np.array(spins)


def pose(q: np.ndarray, v: np.ndarray, d: int) -> tuple[np.ndarray, ...]:
    """Return position, its rate, directors (d, 3) and theirs of a frame."""
    if d == 3:
        return q[:3], v[:3], q[3:].reshape(3, 3), v[3:].reshape(3, 3)
    cos, sin = np.cos(q[2]), np.sin(q[2])
    axes = np.array([[cos, sin, 0.0], [-sin, cos, 0.0]])
    return np.append(q[:2], 0.0), np.append(v[:2], 0.0), axes, v[2] * np.array([[-sin, cos, 0.0], [-cos, -sin, 0.0]])


def test_a_flexible_body_in_free_flight_keeps_its_momentum() -> None:
    """It stretches by its own spin, and turns more slowly for it; what is not kept is of order two in the step."""
    errors = []
    for step in (1e-4, 5e-5):
        linear, angular, spins = momenta(components_model(in_the_plane(f"simulation.step={step}")))
        errors.append([np.abs(part - part[0]).max() / np.abs(part[0]).max() for part in (linear, angular)])
    assert max(errors[1]) < 1e-4
    assert np.log2(np.array(errors[0]) / errors[1]) == pytest.approx(2.0, abs=0.1)
    assert np.ptp(spins) > 1e-4 * spins[0], "it would turn evenly if it were rigid"


def test_what_turns_freely_in_gimbals_keeps_its_angular_momentum() -> None:
    """The gimbals, which have no mass, hold it in the point about which it is."""
    errors = []
    for step in (1e-3, 5e-4):
        angular = momenta(components_model(in_space(f"simulation.step={step}")))[1]
        errors.append(np.linalg.norm(angular - angular[0], axis=1).max() / np.linalg.norm(angular[0]))
    assert errors[1] < 1e-4
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.1)


def test_a_stiff_cross_turns_as_eulers_top() -> None:
    """Without torque, ``J w' = -w x J w`` in the body; angles about z, y and x from the spin."""
    errors, times = [], None
    for step in (1e-3, 5e-4):
        scene = in_space("materials.steel.E=2.1e14", f"simulation.step={step}")
        times, found = history(components_model(scene), samples(scene, 1), 1)
        exact = eulers_top(times)
        errors.append(
            max(np.abs(found[name][:, 0] - exact[k]).max() for k, name in enumerate(("yaw", "pitch", "roll")))
        )
    assert errors[1] < 1e-5
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.2)


def eulers_top(times: np.ndarray) -> np.ndarray:
    """Return yaw, pitch and roll (3, n_t) of the cross, rigid, from its spin (0.8, 0.6, 5) rad/s at rest angles."""
    density, rotary = 7800.0 * np.pi * 5e-3**2, 7800.0 * np.pi * 5e-3**4 / 4.0
    across = [density * length**3 / 12.0 + rotary * length for length in (1.0, 0.6)]
    along = [2.0 * rotary * length for length in (1.0, 0.6)]
    inertia = np.array([along[0] + across[1], across[0] + along[1], across[0] + across[1]])

    def slopes(_: float, state: np.ndarray) -> np.ndarray:
        spin, (_, pitch, roll) = state[:3], state[3:]
        turning = np.sin(roll) * spin[1] + np.cos(roll) * spin[2]
        rates = (
            turning / np.cos(pitch), np.cos(roll) * spin[1] - np.sin(roll) * spin[2], spin[0] + np.tan(pitch) * turning,
        )  # fmt: skip
        return np.concatenate([-np.cross(spin, inertia * spin) / inertia, rates])

    start = np.array([0.8, 0.6, 5.0, 0.0, 0.0, 0.0])
    return solve_ivp(slopes, (0.0, times[-1]), start, "DOP853", times, rtol=1e-11, atol=1e-12).y[3:]
