"""A clearance in a joint: a pin in a bore that is larger, a ball in its socket, a slider in a guide with play.

With e the way of the pin's middle from that of the bore, in the plane across the joint's axis, and in the frame of the
first body, the parts touch where ``d = |e| - radius`` is positive. On the pin acts, along -e / |e|, Hunt and Crossley's
normal force (1975, J. Appl. Mech. 42, 440-445)

    N = K d^n (1 + c d'),    not below zero,

which begins at zero, so that it is continuous in contact. All of it is a law of one scalar that is smooth everywhere,
``s = |e|^2``, in the middle too: the frames feel ``F ds`` with ``F = -N / (2 |e|)``.

Restitution. By separation of ``m x dx / (1 + c x) = -K d^n dd`` from x = v to -e v the restitution e of an impact at
the speed v follows from ``a = c v``, whatever K, n and m are,

    (1 + e) a = log((1 + a) / (1 - e a)).

`RESTITUTION` is the polynomial ``e a / (1 - e)`` of e, within 6e-5 of e. As c is constant, an impact at another speed
v' has ``a' = a v' / v`` and the restitution of that: ``1 - 2 a' / 3`` of slow ones, ``1 / a'`` of fast ones.

With ``damping = "hysteresis"`` the force has in place of (1 + c d') a factor that is 1 where the contact sinks in and
e^2 where it comes out,

    N = K d^n (1 + e^2 + (1 - e^2) tanh(d' / w)) / 2,    w = v / 20.

It gives back the share e^2 of the energy at all speeds that are much larger than w (docs/scenes.md has figures). The
turn takes some 3 % of a contact, and no step ends there.

Friction of a pin is ``friction N tanh(v_t / friction_speed)`` against the speed v_t of its middle across e: the joint
knows no radius of the pin, and takes it for one that is small. What turning in the joint rubs is an effect of type
joint_friction. It acts along ``w = e_1 de_2 - e_2 de_1``, whose rate is |e| v_t and which is smooth in the middle too.
Friction in a guide is the same against the speed along it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, Self

import numpy as np

from pgmp_petsc.bodies.affine import Quantity
from pgmp_petsc.effects.action import SOURCE, Action
from pgmp_petsc.effects.effect import ActionEffect
from pgmp_petsc.effects.law import Law
from pgmp_petsc.mechanism.joints import Coupling
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.mechanism.statements import Combination, Function, U, sweeping
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.joints import IMPACT_SPEED, Contact

RESTITUTION = (
    1.00492702, 0.72557631, 5.55295772, -26.68819243, 55.68048401, -64.97565655, 42.75255961, -14.28554436, 1.73280757,
)  # fmt: skip
SLOW = 1e-3  # of a, below which the limit holds to 1e-6
# what is beside the room's edge is evaluated too: no roots of zero, and no powers of what is negative
FAR = "sqrt(s + 1e-30)"  # |e|
DEPTH = f"(({FAR} - radius)**2 + 1e-40)"  # d^2


def _horner(coefficients: tuple[float, ...]) -> str:
    """Return a polynomial of the restitution as an expression."""
    text = repr(coefficients[-1])
    for one in coefficients[-2::-1]:
        text = f"({one!r} + restitution * {text})"
    return text


SLOPE = f"(1 - restitution) * {_horner(RESTITUTION)} / (restitution * speed)"  # c of the module's equation


class OfSquare(Law):
    """A law of a measure that is not negative: others that a law is tried at are none of it."""

    def _check_finite(self, code: Any) -> None:
        """It is finite everywhere from zero on, with a positive radius."""


#: Restitution speed over the width of the hysteresis' turn: from that speed on it is what was asked for.
HYSTERESIS = 20.0
FACTORS = {
    "hunt_crossley": f"max(0, 1 + {SLOPE} * ({{rate}}))",
    "hysteresis": f"(1 + restitution**2 + (1 - restitution**2) * tanh({HYSTERESIS:g} * ({{rate}}) / speed)) / 2",
}


class ContactLaws(NamedTuple):
    """The laws of one kind of contact."""

    touching: Law  # of the square of the distance
    rubbing: Law  # of a pin along its bore
    sliding: Law  # of a guide along itself
    backlash: Law  # of a coupling

    @classmethod
    def of(cls, factor: str, suffix: str) -> Self:
        """Return those of which the elastic force has a factor, an expression of ``{rate}``, how fast it sinks in."""
        numbers = ("k", "radius", "exponent", "restitution", "speed")
        rubs = *numbers, "friction", "friction_speed"
        sinking = factor.format(rate=f"amplitude / (2 * {FAR})")
        normal = f"k * {DEPTH} ** (exponent / 2) * {sinking}"  # N of the module's equation
        return cls(
            OfSquare(
                f"contact{suffix}",
                numbers,
                potential=f"k * {DEPTH} ** (exponent / 2 + 0.5) / (exponent + 1) if s > radius**2 else 0",
                force=f"elastic * {factor.format(rate=f'rate / (2 * {FAR})')}",
                edges=("(s - radius**2) / (2 * radius)",),
                left_out="it is a contact beyond a clearance, not linear",
            ),
            OfSquare(
                f"rubbing{suffix}",
                rubs,
                force=f"-friction * {normal} / {FAR} * tanh(rate / ({FAR} * friction_speed)) if s > radius**2 else 0",
            ),
            OfSquare(
                f"sliding{suffix}",
                rubs,
                force=f"-friction * {normal} * tanh(rate / friction_speed) if s > radius**2 else 0",
            ),
            Law(
                f"backlash{suffix}",
                (*numbers, "value"),
                potential="k * ((abs(s - value) - radius)**2 + 1e-40) ** (exponent / 2 + 0.5) / (exponent + 1) "
                "if abs(s - value) > radius else 0",
                force=f"elastic * {factor.format(rate='rate if s > value else -rate')}",
                edges=("s - value - radius", "value - radius - s"),
                left_out="it has backlash, not linear",
            ),
        )


LAWS = {name: ContactLaws.of(factor, "" if name == "hunt_crossley" else f"_{name}") for name, factor in FACTORS.items()}


class LooseEffect(ActionEffect):
    """Contact and friction in a joint, or a coupling, with a clearance.

    In the middle of a joint's room no force has a direction: static answers are to unit forces along all directions in
    which there is room.
    """

    units: Sequence[Action] = ()  # these forces

    @property
    def entry(self) -> str:
        return f"joints.{self.name}.clearance"

    def turning_patterns(self) -> list[Action]:
        return [*self.units] or super().turning_patterns()


def loose_joint(name: str, scene: Scene, mechanism: Mechanism) -> LooseEffect:
    """Return what acts in a joint by a name that has a clearance."""
    connection, entry = mechanism.connection(name), scene.joints[name].clearance
    parameters = _contact(entry, _impact_speed(scene))
    distance = Combination(tuple((part.statement, Function.square()) for part in connection.released))
    sides = [side for _ in connection.released for side in connection.sides]
    laws = LAWS[entry.damping]
    actions = [Action(name, distance, *sides[:2], laws.touching, parameters, further=tuple(sides[2:]))]
    if entry.friction:
        if "sliding" in scene.joints[name].motions_in(scene.dimension):
            law, way = laws.sliding, connection.measure("sliding")
        else:
            law, way = laws.rubbing, sweeping(*(part.statement.axes[U] for part in connection.released))
        rubbing = *parameters, Quantity.of(entry.friction), Quantity.of(entry.friction_speed)
        actions.append(Action(name, way, *connection.sides, law, rubbing, by_load=True))
    effect, unit = LooseEffect(name, actions, mechanism), (Quantity(1.0),)
    effect.units = [Action(name, part.statement, *connection.sides, SOURCE, unit) for part in connection.released]
    return effect


def loose_coupling(coupling: Coupling, scene: Scene, mechanism: Mechanism) -> LooseEffect:
    """Return what acts between the teeth of a coupling that has a clearance."""
    entry, (a, b, *further) = scene.joints[coupling.name].clearance, coupling.sides
    parameters = *_contact(entry, _impact_speed(scene, coupling.combination.is_length)), Quantity(coupling.value)
    law = LAWS[entry.damping].backlash
    action = Action(coupling.name, coupling.combination, a, b, law, parameters, further=tuple(further))
    return LooseEffect(coupling.name, [action], mechanism)


def restitution_at(restitution: float, ratio: float) -> float:
    """Return the restitution of impacts at `ratio` times the speed at which it is `restitution`.

    With ``y = 1 - e a`` the module's equation is ``y exp(-y) = (1 + a) exp(-1 - a)``, which Lambert's W solves.
    """
    a = ratio * (1.0 - restitution) / restitution * float(np.polynomial.Polynomial(RESTITUTION)(restitution))
    if a < SLOW:
        return 1.0 - 2.0 * a / 3.0
    from scipy.special import lambertw  # a noticeable time, and few scenes have clearance

    return float(1.0 + lambertw(-(1.0 + a) * np.exp(-1.0 - a)).real) / a


def hysteresis_at(restitution: float, ratio: float) -> float:
    """Return the same of a hysteresis."""
    from scipy.integrate import quad  # a noticeable time, and few scenes have one
    from scipy.optimize import brentq

    square, width = restitution**2, 1.0 / HYSTERESIS

    def left(e: float) -> float:
        ends = (-e * ratio, *(x for x in (-3.0 * width, 0.0, 3.0 * width) if -e * ratio < x < ratio), ratio)
        parts = (
            quad(lambda x: 2.0 * x / (1.0 + square + (1.0 - square) * np.tanh(x / width)), *pair)[0]
            for pair in zip(ends, ends[1:])
        )
        return sum(parts)

    return 1.0 if restitution == 1.0 else float(brentq(left, 0.0, 1.0))


def impacts(scene: Scene, mechanism: Mechanism) -> list[tuple[str, str]]:
    """Return joints and couplings with a clearance, and in words at which speed of impacts their restitution is."""
    found = [(c.name, True) for c in mechanism.connections if c.released]
    found += [(c.name, c.combination.is_length) for c in mechanism.couplings if c.elastic]
    said = []
    for name, is_length in found:
        entry = scene.joints[name].clearance
        if entry is not None:
            e, given = scene.number(entry.restitution), entry.restitution_speed
            speed = _impact_speed(scene, is_length) if given is None else scene.number(given)
            shown = scene.system.text(speed, "m/s" if is_length else "rad/s", ".4g")
            held = entry.damping == "hysteresis"
            slow, fast = (f"{(hysteresis_at if held else restitution_at)(e, ratio):.2g}" for ratio in (0.1, 10.0))
            words = f"restitution {e:.4g} at impacts of {shown}{' and faster ones' if held else ''}"
            words += "" if given is not None else ", as restitution_speed is left out"
            said.append((name, f"{words}; {slow} at a tenth of it, {fast} at ten times"))
    return said


def _impact_speed(scene: Scene, is_length: bool = True) -> float:
    """Return the speed of impacts where a scene says none, in the units of its numbers."""
    return IMPACT_SPEED / (scene.number_units.speed if is_length else 1.0)


def _contact(entry: Contact, speed: float) -> tuple[Quantity, ...]:
    """Return the parameters of the law of a contact, with the speed of the impact where the scene says none."""
    given = entry.stiffness, entry.radius, entry.exponent, entry.restitution, entry.restitution_speed or speed
    return tuple(map(Quantity.of, given))
