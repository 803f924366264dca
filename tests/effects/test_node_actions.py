"""Actions on the unknowns of nodes, in the plane and in natural coordinates: tangents against differences, power."""

import numpy as np
import pytest

from pgmp_petsc.bodies.affine import Quantity
from pgmp_petsc.effects.action import FRICTION, SOURCE, SPRING_DAMPER, Action, compile_actions
from pgmp_petsc.full.forces import Acted, BlockActions, act
from pgmp_petsc.full.part_reference import Reference
from pgmp_petsc.full.problem import pairs_of
from pgmp_petsc.mechanism import statements
from pgmp_petsc.mechanism.joints import Attachment

RANDOM = np.random.default_rng(8)
STEP, ATOL = 1e-6, 1e-7  # central differences: round-off of values of order 10 over the step
LAWS = {"source": (SOURCE, (2.0,)), "spring": (SPRING_DAMPER, (3.0, 0.4, 0.2)), "friction": (FRICTION, (2.0, 0.5))}
SIDES = ("nodes", "arms", "from the ground")


def statement(kind: str, d: int) -> statements.Statement:
    u, w = RANDOM.normal(size=(2, d))
    return {
        "angle": lambda: statements.angle(np.eye(d), np.eye(d)),
        "along": lambda: statements.along(u),
        "perpendicular": lambda: statements.perpendicular(u, w),
        "distance": lambda: statements.distance(d),
        "following": lambda: statements.following(w),
    }[kind]()


class LocalForces:
    """One action on two nodes or more, and its angles at the instant before."""

    def __init__(self, action: Action, d: int) -> None:
        n = 3 if d == 2 else 12
        self._dofs, entries, self.pattern = pairs_of([action], lambda node: n * node + np.arange(n))
        compiled = compile_actions([action], {}, 1, d)
        self.turns = np.zeros((len(self._dofs), 1))
        actions = BlockActions(
            compiled.statements, compiled.laws, compiled.parameters[None], compiled.roles, compiled.firsts, self._dofs,
            entries, self.pattern[0], np.ones(1, dtype=bool),
        )  # fmt: skip
        self._actions = Reference(actions)

    def evaluate(self, q: np.ndarray, v: np.ndarray, gain_v: float) -> Acted:
        """Evaluate it."""
        return act(self._actions, (0.0,), 0, np.array([1.5]), q, v, self.turns, gain_v, True)

    def add_forces(self, now: Acted, total: np.ndarray) -> None:
        """Add the forces to those on all unknowns."""
        moving = self._dofs >= 0
        np.add.at(total, self._dofs[moving], now.forces[moving])


def forces_of(kind: str, law: str, sides: str, d: int) -> LocalForces:
    arms = RANDOM.normal(size=(2, d)) * (0.0 if sides == "nodes" else 0.4)
    place = RANDOM.normal(size=d)
    a = Attachment.on_ground_at(place) if sides == "from the ground" else Attachment(0, 0, np.zeros(d), arms[0])
    which, numbers = LAWS[law]
    action = Action("effect", statement(kind, d), a, Attachment(1, 1, np.zeros(d), arms[1]), which,
                    tuple(map(Quantity, numbers)), lambda time: 1.5)  # fmt: skip
    return LocalForces(action, d)


@pytest.mark.parametrize("d", [2, 3])
def test_the_tangent_of_a_force_on_a_sum_is_minus_its_derivative(d: int) -> None:
    """Of two statements about three nodes, one of which is in both: pairs of its unknowns are there twice."""
    parts = (statement("angle", d), statements.Function(1.7)), (statement("along", d), statements.Function(-0.6))
    sides = [Attachment(k, k, np.zeros(d), 0.4 * RANDOM.normal(size=d)) for k in (0, 1, 1, 2)]
    spring, numbers = LAWS["spring"]
    action = Action("effect", statements.Combination(parts), *sides[:2], spring, tuple(map(Quantity, numbers)),
                    further=tuple(sides[2:]))  # fmt: skip
    local, q = LocalForces(action, d), RANDOM.normal(size=(9 if d == 2 else 36, 1))

    def total(q: np.ndarray) -> np.ndarray:
        found = np.zeros_like(q)
        local.add_forces(local.evaluate(q, np.zeros_like(q), 0.0), found)
        return found[:, 0]

    expected = np.array([-(total(q + h) - total(q - h)) / (2 * STEP) for h in STEP * np.eye(q.size)[..., None]])
    found, now = np.zeros((q.size, q.size)), local.evaluate(q, np.zeros_like(q), 0.0)
    (rows, columns), values = local.pattern, now.tangents[:, 0]
    np.add.at(found, (rows, columns), values)
    apart = rows != columns
    np.add.at(found, (columns[apart], rows[apart]), values[apart])
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=10 * ATOL)


def state(d: int) -> tuple[np.ndarray, np.ndarray]:
    q, v = RANDOM.normal(size=(2, 6 if d == 2 else 24, 1))
    return q, v


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("sides", SIDES)
@pytest.mark.parametrize("kind", ["angle", "along", "perpendicular", "distance", "following"])
def test_the_tangent_is_minus_the_derivative_of_the_force(kind: str, sides: str, d: int) -> None:
    gain_v = 3.0
    for law in ("source",) if kind == "following" else LAWS:
        local = forces_of(kind, law, sides, d)
        q, v = state(d)

        def total(q: np.ndarray, v: np.ndarray) -> np.ndarray:
            found = np.zeros_like(q)
            local.add_forces(local.evaluate(q, v, gain_v), found)
            return found[:, 0]

        # at rest the change of the gradient does not change the rate, which the tangent leaves out
        rest = np.zeros_like(q)
        expected = np.zeros((q.size, q.size))
        for j, unit in enumerate(np.eye(q.size)[..., None]):
            ahead, behind = (total(q + h * unit, gain_v * h * unit) for h in (STEP, -STEP))
            expected[:, j] = -(ahead - behind) / (2 * STEP)
        rows, columns = local.pattern
        mean = 0.5 * (expected + expected.T)
        found = local.evaluate(q, rest, gain_v).tangents[:, 0]
        np.testing.assert_allclose(found, mean[rows, columns], rtol=1e-6, atol=10 * ATOL)
        outside = np.ones_like(mean, dtype=bool)
        outside[rows, columns] = outside[columns, rows] = False
        assert not mean[outside].any(), "nothing but the pattern"


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("sides", SIDES)
@pytest.mark.parametrize("kind", ["angle", "along", "perpendicular", "distance"])
def test_the_force_is_the_gradient_of_the_energy_and_does_the_power(kind: str, sides: str, d: int) -> None:
    local = forces_of(kind, "spring", sides, d)
    q, v = state(d)

    def at(dt: float) -> Acted:
        return local.evaluate(q + dt * v, v, 0.0)

    now, force = at(0.0), np.zeros_like(q)
    local.add_forces(now, force)
    elastic = -(at(STEP).stored - at(-STEP).stored) / (2 * STEP)
    assert float((force * v).sum()) == pytest.approx(float(elastic + now.powers), rel=0, abs=10 * ATOL)
    assert now.powers <= 0.0


def test_turns_in_space_are_counted_from_where_they_begin() -> None:
    local = forces_of("angle", "spring", "from the ground", 3)

    def turned(angle: float) -> np.ndarray:
        cos, sin = np.cos(angle), np.sin(angle)
        own = np.array([0, 0, 0, 1, 0, 0, 0, cos, sin, 0, -sin, cos], dtype=float)
        return np.concatenate([np.zeros(12), own])[:, None]

    for angle in np.linspace(0.0, 17.0, 20):
        # a wild trial of an iteration does no harm
        for trial in (angle + 2.5, angle):
            found = local.evaluate(turned(trial), np.zeros((24, 1)), 0.0)
        local.turns[:] = angle
        # 1/2 k (s - rest)^2
        assert found.stored[0, 0] == pytest.approx(1.5 * (angle - 0.2) ** 2)
