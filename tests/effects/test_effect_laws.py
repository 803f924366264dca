"""Functions of time, laws and actions of effects."""

import ctypes
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT, TIMEOUT_SECONDS

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.bodies.affine import Quantity
from pgmp_petsc.effects import action
from pgmp_petsc.effects.action import FRICTION, SOURCE, SPRING_DAMPER, Action, compile_actions
from pgmp_petsc.effects.free_play import FREE_PLAY
from pgmp_petsc.effects.joint_effects import CARRIED_FRICTION, STOP
from pgmp_petsc.effects.law import Law, differentiate, obey
from pgmp_petsc.full.forces import Acted, BlockActions, act
from pgmp_petsc.full.part_reference import Reference
from pgmp_petsc.full.problem import pairs_of
from pgmp_petsc.lanes.compiled import njit
from pgmp_petsc.mechanism import statements
from pgmp_petsc.mechanism.joints import Attachment
from pgmp_petsc.mechanism.statements import distance

STEP = 1e-6  # central differences of functions of order 1: 1e-12 by truncation, 1e-10 by round-off
ATOL = 1e-9
FOUND = [one for one in vars(action).values() if isinstance(one, Law) and one is not action.NOTHING]
FOUND += [FREE_PLAY, CARRIED_FRICTION, STOP]
UPPER, LOWER = (50.0, 0.3, 0.5, 1.0), (50.0, 0.3, -0.5, -1.0)
# law, parameters, amplitude, measure, rate
STATES = {
    "source": (SOURCE, (2.0,), 1.5, 0.3, 0.7), "spring": (SPRING_DAMPER, (3.0, 0.4, 0.2), 0.0, 0.9, -0.7),
    "friction": (FRICTION, (2.0, 0.5), 0.0, 0.3, 0.2),
    "friction by a load": (CARRIED_FRICTION, (1.3, 0.2, 0.7, 0.5), 0.6, 0.3, 0.2),
    "upper stop, going in": (STOP, UPPER, 0.0, 0.6, 0.9), "upper stop, coming out": (STOP, UPPER, 0.0, 0.6, -0.9),
    "upper stop, not reached": (STOP, UPPER, 0.0, 0.4, 0.9), "lower stop, going in": (STOP, LOWER, 0.0, -0.6, -0.9),
    "lower stop, torn out": (STOP, LOWER, 0.0, -0.6, 9.0),
    "gap, above": (FREE_PLAY, (50.0, 0.3, 0.4, 0.5), 0.0, 0.6, 0.9),
    "gap, below": (FREE_PLAY, (50.0, 0.3, 0.4, 0.5), 0.0, -0.6, 0.9),
    "gap, within": (FREE_PLAY, (50.0, 0.3, 0.4, 0.5), 0.0, 0.45, 0.9),
}  # fmt: skip


def as_friction(law: Law, p: tuple[float, ...], amplitude: float) -> tuple[float, ...]:
    return tuple(p) if law is FRICTION else (p[1] * p[2] * (p[0] + amplitude), p[3])


def closed_form(law: Law, p: tuple[float, ...], amplitude: float, s: float, rate: float) -> tuple[float, ...]:
    """Return F, -dF/ds, -dF/ds', the elastic force and its energy, written by hand."""
    if law is SOURCE:
        return amplitude * p[0], 0.0, 0.0, 0.0, 0.0
    if law is SPRING_DAMPER:
        x = s - p[2]
        return -p[0] * x - p[1] * rate, p[0], p[1], -p[0] * x, 0.5 * p[0] * x * x
    if law is FRICTION:
        bent = np.tanh(rate / p[1])
        return -p[0] * bent, 0.0, p[0] * (1.0 - bent * bent) / p[1], 0.0, 0.0
    if law is CARRIED_FRICTION:
        return closed_form(FRICTION, as_friction(law, p, amplitude), 0.0, s, rate)
    k, c, place, side = p
    if law is FREE_PLAY:
        place, side = (p[3], 1.0) if s > p[3] else (p[2], -1.0)
    depth, braking = side * (s - place), 1.0 + c * side * rate
    if depth <= 0.0:
        return 0.0, 0.0, 0.0, 0.0, 0.0
    elastic, stored = -side * k * depth, 0.5 * k * depth**2
    if braking <= 0.0:
        return 0.0, 0.0, 0.0, elastic, stored
    return elastic * braking, k * braking, k * c * depth, elastic, stored


@njit(error_model="numpy")
def compiled(address, p, amplitude, s, rate, about, depths):
    return obey(address, p, amplitude, s, rate, about, depths)


@njit(error_model="numpy")
def compiled_slopes(address, p, amplitude, s, rate, found):
    return differentiate(address, p, amplitude, s, rate, found)


@pytest.fixture(scope="module")
def in_c(tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    """All laws as they are printed in C."""
    source = tmp_path_factory.mktemp("laws") / "laws.c"
    text = "\n".join(law.code.C.replace("static ", "") for law in FOUND)
    source.write_text(f"#include <math.h>\n{text}\n")
    flags = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-O2", "-shared", "-fPIC"]
    subprocess.run(["cc", *flags, "-o", source.with_suffix(".so"), source, "-lm"], check=True, timeout=TIMEOUT_SECONDS)
    return ctypes.CDLL(str(source.with_suffix(".so")))


def evaluated_in_c(
    library: ctypes.CDLL, law: Law, p: np.ndarray, amplitude: float, s: float, rate: float, about: float
) -> np.ndarray:
    """Return force, stiffness, damping, about and how far edges are crossed."""
    found, pointer = np.zeros(4 + len(law.edges)), ctypes.POINTER(ctypes.c_double)
    function = getattr(library, f"law_{law.name}")
    function.argtypes, function.restype = [pointer, *[ctypes.c_double] * 4, pointer], None
    function(p.ctypes.data_as(pointer), amplitude, s, rate, about, found.ctypes.data_as(pointer))
    return found


@pytest.mark.parametrize("law", FOUND, ids=lambda law: law.name)
def test_laws_are_their_closed_forms_in_all_languages(law: Law, in_c: ctypes.CDLL) -> None:
    """At random points; both sides round some ten operations on numbers of order 10."""
    random = np.random.default_rng(5)
    for _ in range(500):
        p = random.uniform(0.1, 2.0, size=len(law.parameters))
        if law is STOP:
            p[3] = random.choice([-1.0, 1.0])
        if law is FREE_PLAY:
            p[2:] = np.sort(p[2:])
        amplitude, s, rate, about = random.normal(size=4)
        if law is CARRIED_FRICTION:  # which brakes
            amplitude = abs(amplitude)
        wanted = closed_form(law, tuple(p), amplitude, s, rate)
        limit, speed = as_friction(law, p, amplitude) if law in (FRICTION, CARRIED_FRICTION) else (0.0, np.inf)
        there = closed_form(law, tuple(p), amplitude, s, about)[2]
        if about * rate < 0.0 and limit / speed > 2.0 * max(abs(wanted[2]), abs(there)):
            wanted, left = (-limit / speed * rate, 0.0, limit / speed, 0.0, 0.0), np.inf
        else:
            left = rate
        depths = np.zeros(len(law.edges))
        found = compiled(law.address, p, amplitude, s, rate, about, depths)
        np.testing.assert_allclose(found, [*wanted, left], rtol=1e-13, atol=1e-14)
        np.testing.assert_allclose(law.evaluate(p, s, rate, amplitude, about), found, rtol=1e-15, atol=1e-15)
        np.testing.assert_array_equal(law.depths(p, s), depths)
        of_c = evaluated_in_c(in_c, law, p, amplitude, s, rate, about)
        np.testing.assert_allclose(of_c, [*found[:3], found[5], *depths], rtol=1e-13, atol=1e-14)


@pytest.mark.parametrize("name", STATES)
def test_derivatives_with_parameters_and_of_edges(name: str) -> None:
    law, parameters, amplitude, s, rate = STATES[name]

    def slope(at: Callable[[float], float]) -> float:
        return (at(STEP) - at(-STEP)) / (2 * STEP)

    # the stop's stiffness of 50 times the round-off over the step
    close = {"rel": 0, "abs": 50 * ATOL}
    slopes, p = np.zeros(len(parameters) + 1), np.array(parameters)
    compiled_slopes(law.address_of_slopes, p, amplitude, s, rate, slopes)
    for k, unit in enumerate(np.eye(p.size)):
        assert slopes[k] == pytest.approx(slope(lambda h: law.evaluate(p + h * unit, s, rate, amplitude)[0]), **close)
    assert slopes[-1] == pytest.approx(slope(lambda h: law.evaluate(p, s, rate, amplitude + h)[0]), **close)
    for number in range(len(law.edges)):
        first, second, own = law.edge_slopes(number, parameters, s)
        assert first == pytest.approx(slope(lambda h: law.depths(p, s + h)[number]), **close) and second == 0.0
        for k, unit in enumerate(np.eye(p.size)):
            assert own[k] == pytest.approx(slope(lambda h: law.depths(p + h * unit, s)[number]), **close)


def test_the_table_of_laws_in_the_docs() -> None:
    lines = (ROOT / "docs" / "effects.md").read_text(encoding="utf-8").splitlines()
    for law in (one for one in FOUND if one is not FREE_PLAY):
        edges = "".join(f" `{edge}`" for edge in law.edges)
        parts = f"| `{law.name}` | {', '.join(law.parameters)} | `{law.force}` | `{law.potential}` |{edges} |"
        assert parts in lines


def test_which_laws_are_springs() -> None:
    """Linear with a stiffness that is one of their parameters: that follows from the expression."""
    assert [law.name for law in FOUND if law.linear_stiffness] == ["spring_damper"]
    assert Law("line", ("a", "b"), "elastic", potential="b * s**2 / 2 + a * s").linear_stiffness == "b"
    assert not Law("cubic", ("a",), "-a * (s + s**3)").linear_stiffness


def test_edges_of_any_form_are_differentiated_twice() -> None:
    bent = Law("bent", ("k", "r"), "elastic", "k * max(0, s**2 - r**2)**2", edges=("s**2 - r**2",))
    first, second, own = bent.edge_slopes(0, (3.0, 0.5), 0.7)
    assert (first, second) == pytest.approx((1.4, 2.0)) and own == pytest.approx([0.0, -1.0])


def test_functions_and_cases() -> None:
    law = Law("all", ("a",), "-a * (tanh(s) + atan(rate) + exp(-abs(s)) + sqrt(1 + s**2) + log(1 + s**2) + sin(s)"
              " + cos(s) + min(s, rate) + max(s, rate)) if not (s > 0 and rate > 0 or s < -1) else 0")  # fmt: skip
    s, rate = -0.4, 0.3
    parts = np.tanh(s), np.arctan(rate), np.exp(s), np.sqrt(1 + s**2), np.log(1 + s**2), np.sin(s), np.cos(s), s, rate
    assert law.evaluate((2.0,), s, rate).force == pytest.approx(-2.0 * sum(parts), rel=1e-14)
    assert law.evaluate((2.0,), s=0.4, rate=0.3).force == law.evaluate((2.0,), s=-1.4, rate=0.3).force == 0.0
    assert law.code.C.count("tanh") and "Heaviside" not in law.code.C


BAD = {
    "an undeclared name": ({"force": "-k * x"}, "'x', which is not declared"),
    "no sentence": ({"force": "-k *"}, "is no expression"),
    "no text": ({"edges": (lambda s: s,)}, r"edges\[0\].*is no expression \(write it as a text\)"),
    "a statement": ({"force": "k = 3"}, "is no expression"),
    "an attribute": ({"force": "s.real"}, r"has 's\.real'"),
    "a call of what is no function": ({"force": "-k * open(s)"}, r"has 'open\(s\)'"),
    "too many arguments": ({"force": "tanh(s, k)"}, r"has 'tanh\(s, k\)'"),
    "a text in it": ({"force": "'k'"}, "has"),
    "an edge with the rate": ({"edges": ("s - rate",)}, "'rate', which is not declared"),
    "a potential with the rate": ({"potential": "rate"}, "'rate', which is not declared"),
    "a name that is taken": ({"parameters": ("k", "s")}, "'s' is taken"),
    "a name twice": ({"parameters": ("k", "k")}, "'k' is taken"),
    "a word of C": ({"parameters": ("k", "short")}, "'short' is taken"),
    "no name": ({"parameters": ("k", "2c")}, "'2c' is no name"),
    "no name of a law": ({"name": "odd: law"}, "'odd: law' is no name"),
}


@pytest.mark.parametrize("name", BAD)
def test_a_declaration_that_fails_is_named_with_its_file_and_line(name: str) -> None:
    parts, message = BAD[name]
    with pytest.raises(InputError, match=rf"test_effect_laws\.py:\d+: law odd: .*{message}"):
        Law(**{"name": "odd", "parameters": ("k",), "force": "-k * s", **parts})


@pytest.mark.parametrize(
    "force", ["-k / s", "-k * log(rate)", "-k * exp(1000 * s)", "-k * sqrt(abs(s))", "-k * sqrt(abs(s - r))"]
)
def test_a_law_has_to_be_finite_with_its_derivatives(force: str) -> None:
    with pytest.raises(InputError, match=r"test_effect_laws\.py:\d+: law odd: .* not finite at s = .*write cases"):
        Law("odd", ("k", "r"), force).code  # noqa: B018


def test_places_that_are_divided_by_what_is_between_them_are_tried_apart() -> None:
    law = Law("between", ("a", "b"), "(s - a) / (b - a)")
    assert law.evaluate([0.5, 2.5], 1.5).force == 0.5


def test_names_of_parameters_do_not_matter() -> None:
    """Those of sympy's for what expressions share among them."""

    def found(*names: str) -> np.ndarray:
        k, rest, cubic = names
        away = f"(s - {rest})"
        potential = f"{k} * {away}**2 / 2 + {cubic} * {away}**4 / 4 if s > {rest} else 0"
        edges = (f"{cubic} * {away}**2 - {away}",)
        law = Law(f"tie_{k}", names, "elastic * (1 + cos(s)) / 2", potential, edges)
        p, slopes = np.array([3.0, 0.5, 7.0]), np.zeros(4)
        compiled_slopes(law.address_of_slopes, p, 0.0, 1.2, 0.1, slopes)
        return np.hstack([law.evaluate(p, 1.2, 0.1), slopes, law.depths(p, 1.2), *law.edge_slopes(0, p, 1.2)])

    np.testing.assert_allclose(found("x0", "x1", "x2"), found("k", "rest", "cubic"), rtol=1e-14)


def test_a_case_that_is_not_taken_may_divide_by_zero() -> None:
    """Quotients and logarithms that a force and its derivatives share are evaluated before the cases are told apart."""
    law = Law("own_gas", ("k", "n"), "k * (1 / s)**n if s > 0.1 else k * 10**n")
    assert law.evaluate([2.0, 1.3], 0.0).force == law.evaluate([2.0, 1.3], -1.0).force == 2.0 * 10.0**1.3
    assert law.evaluate([2.0, 1.3], 0.5).force == pytest.approx(2.0 * 2.0**1.3, rel=1e-15)
    assert law.forces(np.array([[2.0, 1.3]] * 2), np.array([0.0, -1.0])).tolist() == [2.0 * 10.0**1.3] * 2


def test_an_action_gives_its_law_all_parameters() -> None:
    ground = Attachment.on_ground_at(np.zeros(2))
    with pytest.raises(InputError, match=r"effects\.rope: law stop .*k, c, place, side, and is given 1"):
        Action("rope", distance(2), ground, ground, STOP, (Quantity(1.0),))


PRINTED = """
import sys
from pgmp_petsc.effects.law import Law
print(Law("kept", ("k",), "-k * s").code.__file__, "sympy" in sys.modules)
"""


def printing(folder: Path, kept_in: Path) -> subprocess.Popen:
    """Print a law that is declared in a folder, with another one for what is compiled."""
    environment = {"NUMBA_CACHE_DIR": str(kept_in), "PATH": "", "PYTHONPATH": ":".join(sys.path)}
    command = [sys.executable, "-c", PRINTED]
    return subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True, cwd=folder)


def test_what_is_printed_is_kept_by_several_processes_and_printed_anew_if_damaged(tmp_path: Path) -> None:
    def said(n_processes: int, kept_in: Path) -> list[list[str]]:
        started = [printing(tmp_path, kept_in) for _ in range(n_processes)]
        return [one.communicate(timeout=TIMEOUT_SECONDS)[0].split() for one in started]

    [[name, _]] = said(1, tmp_path)
    path = Path(name)
    path.write_text(path.read_text()[:200])
    both = said(2, tmp_path)
    assert all(one[0] == str(path) for one in both) and [str(path), "True"] in both
    assert [*tmp_path.glob("pgmp_printed_kept*.py")] == [path]
    assert said(1, tmp_path) == [[str(path), "False"]], "sympy is for printing alone"
    beside = tmp_path / "__pycache__" / path.name
    beside.parent.mkdir(exist_ok=True)
    path.rename(beside)
    assert said(1, tmp_path / "another") == [[str(beside), "False"]], "what set-up left is taken"


RANDOM = np.random.default_rng(8)
STEP_OF_NODES, ATOL_OF_NODES = 1e-6, 1e-7  # central differences: round-off of values of order 10 over the step
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
        return act(self._actions, (0.0,), 0, np.array([1.5]), q, v, self.turns, gain_v, True)

    def add_forces(self, now: Acted, total: np.ndarray) -> None:
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

    expected = np.array(
        [-(total(q + h) - total(q - h)) / (2 * STEP_OF_NODES) for h in STEP_OF_NODES * np.eye(q.size)[..., None]]
    )
    found, now = np.zeros((q.size, q.size)), local.evaluate(q, np.zeros_like(q), 0.0)
    (rows, columns), values = local.pattern, now.tangents[:, 0]
    np.add.at(found, (rows, columns), values)
    apart = rows != columns
    np.add.at(found, (columns[apart], rows[apart]), values[apart])
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=10 * ATOL_OF_NODES)


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
            ahead, behind = (total(q + h * unit, gain_v * h * unit) for h in (STEP_OF_NODES, -STEP_OF_NODES))
            expected[:, j] = -(ahead - behind) / (2 * STEP_OF_NODES)
        rows, columns = local.pattern
        mean = 0.5 * (expected + expected.T)
        found = local.evaluate(q, rest, gain_v).tangents[:, 0]
        np.testing.assert_allclose(found, mean[rows, columns], rtol=1e-6, atol=10 * ATOL_OF_NODES)
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
    elastic = -(at(STEP_OF_NODES).stored - at(-STEP_OF_NODES).stored) / (2 * STEP_OF_NODES)
    assert float((force * v).sum()) == pytest.approx(float(elastic + now.powers), rel=0, abs=10 * ATOL_OF_NODES)
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
