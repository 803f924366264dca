"""Rates, speeds and formulas of outputs: against closed forms, differences of runs, and in every model."""

import json
from pathlib import Path

import numpy as np
import pytest
from differences import SHARES, compare
from exported import assert_same_in_c, needs_compiler
from machine_scenes import MODELS, RAIL_MASS, cart, rail, run
from refusals import cases, check_said, refusal
from runs import pgmp, reduced_model, still

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.declare.formulas import FUNCTIONS, Series, SeriesAlgebra, declared, evaluated
from pgmp_petsc.gradients.differentiated import differentiate
from pgmp_petsc.results import Design, Fit, Trajectory
from pgmp_petsc.scene import scene_to_toml
from pgmp_petsc.stepping.second_order_system import State
from pgmp_petsc.studies.check import describe_scene
from pgmp_petsc.studies.plausibility.check import plausibility
from scenes import meshes_of

OSCILLATOR = (
    'effects.held={type="spring_damper",joint="rail",stiffness=400.0}', "materials.steel.E=2e13",
    'effects.base={{type="base_motion",direction={},table=[[0.0,-3.0]]}}', "simulation.duration=0.2",
    'outputs.a={type="rate",of="x",order=2}', 'outputs.b={type="rate",of="v"}', 'outputs.c={type="rate",of="x"}',
    'parameters.k={nominal=400.0,unit="N/m"}', 'parameters.mass={nominal=%r,unit="kg"}' % RAIL_MASS,
    'parameters.force={nominal=%r,unit="N"}' % (3.0 * RAIL_MASS),
    'outputs.energy={type="formula",formula="0.5 * mass * c**2 + 0.5 * k * x**2 - force * x"}',
    'outputs.power={type="rate",of="energy"}', 'outputs.left={type="formula",formula="mass * a + k * x - force"}',
    'outputs.late={type="formula",formula="where(t > 0.1, x, 0)"}',
)  # fmt: skip


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("model", MODELS)
def test_an_oscillator_s_accelerations_and_energy(model: str, dimension: int) -> None:
    """x = g m / k (1 - cos w t) in a field g: its second derivative, its energy, which stays, and its balance of
    forces; errors fall with the square of the step."""
    w, off = np.sqrt(400.0 / RAIL_MASS), []
    for step in (4e-3, 2e-3):
        entries = [one.format([0.0, 1.0, 0.0][:dimension]) if "{{" in one else one for one in OSCILLATOR]
        times, found = run(rail(*entries, f"simulation.step={step}", dimension=dimension), model)
        exact = 3.0 * np.cos(w * times)
        off.append([np.abs(found["a"] - exact).max() / exact[0], np.abs(found["energy"]).max()])
    np.testing.assert_array_equal(found["a"], found["b"])
    np.testing.assert_array_equal(found["c"], found["v"])
    assert off[1][0] < 2e-3 and off[1][1] < 5e-3 * (3.0 * RAIL_MASS) ** 2 / 400.0
    assert off[1][0] < 0.3 * off[0][0]
    # the equation of motion holds at the ends of steps, but for what the iteration leaves over the square of the step
    np.testing.assert_allclose(found["left"], 0.0, atol=1e-4 * 3.0)
    np.testing.assert_allclose(found["power"], found["left"] * found["v"], rtol=0, atol=1e-12)
    np.testing.assert_array_equal(found["late"], np.where(times > 0.1, found["x"], 0.0))


CHAIN = (
    'outputs.place={type="position",point="pole:tip",axis="x"}', 'outputs.a={type="rate",of="place",order=2}',
    'outputs.v={type="rate",of="place"}', 'outputs.shakes={type="rate",of="bent"}',
    'outputs.jolts={type="rate",of="bent",order=2}', 'outputs.turns={type="rate",of="swing",order=2}',
    'parameters.m={nominal=2.0,unit="kg"}', 'parameters.c={nominal=0.3,unit="m/s"}',
    'outputs.mix={type="formula",formula="sin(swing) * place / max(place, c * t + 1) * atan2(place, 1 - 0.5 * place)"}',
    'outputs.of_mix={type="rate",of="mix"}', 'outputs.twice={type="rate",of="of_mix"}',
    'outputs.e={type="formula",formula="0.5 * m * v**2 + tanh(mix) * m * a * place",unit="J"}',
    'outputs.given={type="formula",formula="m * a * v"}',
    'outputs.stroke={type="formula",formula="where(abs(swing) > 0.1, v * bent, 0)"}',
)  # fmt: skip


def test_chains_are_derivatives_along_the_motion_of_a_reduced_model() -> None:
    """In any state, of places that are differenced on a parabola within a cell of the tables."""
    model = reduced_model(cart(*CHAIN, "reduction.angles=6"))
    assert [model.outputs.units[name] for name in ("a", "turns", "mix", "of_mix", "e", "given")] == [
        "m/s2", "rad/s2", "1", "1/s", "J", "W",
    ]  # fmt: skip
    random, n = np.random.default_rng(2), model.terms.layout.n_eta
    eta, v, a = (scale * random.normal(size=(5, n)) for scale in (1e-3, 0.02, 0.5))
    eta[:, 1] = random.uniform(-2.0, 0.0, 5)
    values, h = model.scene.values, 1e-3

    def outputs(t: float) -> dict[str, np.ndarray]:
        states = State(eta + t * v + 0.5 * t**2 * a, v + t * a, a, np.zeros(0))
        return model.outputs.evaluate(model.observed_of(0.4 + t, states, values, eta))

    at = [outputs(k * h) for k in (-2, -1, 0, 1, 2)]
    for name, of, order in (
        ("v", "place", 1), ("a", "place", 2), ("shakes", "bent", 1), ("jolts", "bent", 2), ("turns", "swing", 2),
        ("of_mix", "mix", 1), ("twice", "mix", 2),
    ):  # fmt: skip
        y = [one[of] for one in at]
        wanted = (y[0] - 8.0 * y[1] + 8.0 * y[3] - y[4]) / (12.0 * h)
        if order == 2:
            wanted = (-y[0] + 16.0 * y[1] - 30.0 * y[2] + 16.0 * y[3] - y[4]) / (12.0 * h**2)
        # round-off and closure to 1e-12 over the step or its square
        np.testing.assert_allclose(at[2][name], wanted, rtol=0, atol=1e-8 if order == 1 else 3e-5, err_msg=name)


def test_accelerations_jump_with_forces_whatever_they_are_made_of() -> None:
    sampled = 'controllers.c={type="pid",joint="rail",measures="swing",gains={p=1.0},sample_time=2e-3}'
    scene = cart(*CHAIN, sampled, "simulation.step=1e-3", "simulation.duration=0.02", 'outputs.f={type="rate",of="e"}')
    found = {name for name, output in scene.outputs.items() if output.jumps_in(scene)}
    assert found == {"a", "jolts", "turns", "twice", "e", "given", "f"}
    assert not any(output.jumps_in(cart(*CHAIN)) for output in cart(*CHAIN).outputs.values())


@needs_compiler
@pytest.mark.usefixtures("short_tables")
def test_chains_in_c(tmp_path: Path) -> None:
    """Rates and accelerations are differenced along the motion there, and as good as places."""
    assert_same_in_c(reduced_model(cart(*CHAIN, "reduction.angles=6")), tmp_path)


def test_derivatives_of_chains_are_central_differences() -> None:
    model = reduced_model(cart(
        *CHAIN, "parameters.E={nominal=210e9}", 'materials.steel.E="E"', "simulation.duration=0.03",
        "reduction.angles=6", "simulation.initial.swing={position=-0.4,velocity=1.0}",
    ))  # fmt: skip
    compare(model, SHARES, "E")
    # formulas alone hang on the others: e is linear in m
    run = differentiate(model, model.scene.values, ["m", "c"])
    exact = run.outputs["e"] / model.scene.values["m"]
    np.testing.assert_allclose(run.derivatives["e"]["m"], exact, rtol=0, atol=1e-11 * np.abs(exact).max())
    assert not run.derivatives["a"]["m"].any() and np.abs(run.derivatives["twice"]["c"]).max() > 0.0


def test_formulas_of_small_outputs_have_the_chain_rule() -> None:
    """Differences along a ten-thousandth of the mechanism's size lose what bends by a hundred thousandth."""
    size = 'outputs.size={type="formula",formula="sqrt(bent**2)"}'
    more = ("parameters.E={nominal=210e9}", 'materials.steel.E="E"', "simulation.duration=0.03", "reduction.angles=6")
    model = reduced_model(cart(*CHAIN, *more, size, "simulation.initial.swing={position=-0.4,velocity=1.0}"))
    run = differentiate(model, model.scene.values, ["E"])
    bent, change, found = run.outputs["bent"], run.derivatives["bent"]["E"], run.derivatives["size"]["E"]
    assert 0.0 < np.abs(bent).max() < 1e-4
    np.testing.assert_allclose(found, np.sign(bent) * change, rtol=0, atol=1e-12 * np.abs(change).max())


@pytest.mark.parametrize("text", [
    *(f"{name}({', '.join(['u * w', 'w + 0.3 * u', 'u - w'][:n])})" for name, (n, _) in FUNCTIONS.items()),
    "u ** 3 / w", "u ** -2", "u ** 0.5", "u ** w", "-u + 2 * (u > w) - t", "(u + t) ** 2",
])  # fmt: skip
def test_derivatives_of_formulas(text: str) -> None:
    """Of every function, against differences of fourth order."""
    h, names = 1e-3, {"u": "of_u", "w": "of_w", "t": "time"}

    def at(t: float, order: int) -> list[np.ndarray]:
        u = Series([np.array([1.3 + 0.4 * t - 0.7 * t**2]), np.array([0.4 - 1.4 * t]), np.array([-1.4])][: order + 1])
        w = Series([np.array([0.6 - 0.2 * t + t**2]), np.array([2.0 * t - 0.2]), np.array([2.0])][: order + 1])
        time = Series([np.array([t]), np.ones(1), np.zeros(1)][: order + 1])
        found = evaluated(declared(text, names, "")[0], {"of_u": u, "of_w": w, "time": time}, SeriesAlgebra(order))
        return [np.broadcast_to(part, 1)[0] for part in found.parts]

    y = [at(k * h, 0)[0] for k in (-2, -1, 0, 1, 2)]
    wanted = [y[2], (y[0] - 8.0 * y[1] + 8.0 * y[3] - y[4]) / (12.0 * h)]
    wanted.append((-y[0] + 16.0 * y[1] - 30.0 * y[2] + 16.0 * y[3] - y[4]) / (12.0 * h**2))
    np.testing.assert_allclose(at(0.0, 2), wanted, rtol=1e-9, atol=1e-8)


REFUSED = """
outputs.o={type="rate",of="swimg"} -> outputs.o.of = "swimg": there is no such output | did you mean 'swing'
outputs.o={type="rate",of="swing",order=3} -> outputs.o.order = 3:
outputs.o={type="rate"} -> outputs.o.of: missing
outputs.o={type="rate",of="o"} -> outputs.o.of = "o": a circle: o is made of o
outputs={o={type="rate",of="q"},q={type="formula",formula="2 * o"}} -> \
    outputs.o.of = "q": a circle: o is made of q is made of o || \
    outputs.q.formula = "2 * o": a circle: q is made of o is made of q
outputs.o={type="formula",formula="x + bemt"} -> outputs.o.formula = "x + bemt": names 'bemt' | did you mean 'bent'
outputs.o={type="formula",formula="sine(x)"} -> outputs.o.formula = "sine(x)": calls 'sine' | did you mean 'sin'
outputs.o={type="formula",formula="swing +"} -> outputs.o.formula = "swing +": is no formula
outputs.o={type="formula",formula="x + swing"} -> \
    outputs.o.formula = "x + swing": adds or compares m and rad | is a parameter
outputs.o={type="formula",formula="sin(x)"} -> outputs.o.formula = "sin(x)": gives sin m, which takes numbers and angles
outputs.o={type="formula",formula="x ** swing"} -> outputs.o.formula = "x ** swing": raises m to a power
outputs.o={type="formula",formula="x * swing",unit="N"} -> outputs.o.unit = "N": the formula is in m
outputs.o={type="formula",formula="x * swing",unit="nonsense"} -> outputs.o.unit = "nonsense": no such unit
outputs.o={type="formula",formula="2 * x",unit="km"} -> outputs.o.unit = "km": outputs are in the units of the scene
outputs.o={type="speed"} -> outputs.o | exactly one of point, joint is needed
outputs.o={type="speed",joint="pivot",axis="x"} -> outputs.o.axis
outputs.o={type="speed",point="pole:tip"} -> outputs.o.axis
outputs.o={type="speed",point="pole:tip",axis="z"} -> outputs.o.axis | in the plane
outputs.o={type="speed",joint="none"} -> outputs.o.joint = "none"
outputs.o={type="speed",joint="pivot",motion="sliding"} -> outputs.o.motion
"""


@pytest.mark.parametrize(("override", "said"), cases(REFUSED))
def test_what_is_refused(override: str, said: str) -> None:
    check_said(refusal(cart, override), said, override)


AT_START = {
    "third derivative": (
        ('outputs.o={type="rate",of="q",order=2}', 'outputs.q={type="rate",of="x"}'),
        "outputs.o: its rate is asked for",
    ),
    "rate of a stress": (
        ('outputs.o={type="rate",of="s"}', 'outputs.s={type="stress",body="pole",quantity="stress_max"}'),
        "outputs.o: the rate of s is asked for",
    ),
    "division by zero": (
        ('outputs.o={type="formula",formula="x / t"}',),
        r"outputs.o.formula: it has no finite value at the start .*",
    ),
    "root of zero": (
        ('outputs.o={type="rate",of="r"}', 'outputs.r={type="formula",formula="sqrt(t)"}'),
        r"outputs.o.of: it has no finite",
    ),
}  # fmt: skip


@pytest.mark.parametrize(("overrides", "words"), AT_START.values(), ids=AT_START)
def test_what_is_refused_at_the_start(overrides: tuple[str, ...], words: str) -> None:
    scene = cart(*overrides)
    with pytest.raises(InputError, match=words):
        describe_scene(scene, meshes_of(scene))
        plausibility(scene, meshes_of(scene))


def test_a_parameter_without_a_unit_needs_that_of_the_formula() -> None:
    with pytest.raises(InputError, match=r"outputs\.o\.unit: missing; that of q is not known"):
        cart("parameters.q={nominal=1.0}", 'outputs.o={type="formula",formula="q * x"}')
    scene = cart("parameters.q={nominal=1.0}", 'outputs.o={type="formula",formula="q * x",unit="N"}')
    model = reduced_model(scene)
    assert model.outputs.units["o"] == "N"
    eta = np.zeros((2, model.terms.layout.n_eta))
    eta[:, 0] = 0.1
    assert model.outputs.evaluate(model.observed_of(0.0, still(eta), {"q": 3.0}))["o"] == pytest.approx(0.3)


def test_every_command_takes_outputs_of_outputs(tmp_path: Path) -> None:
    """A rate, a formula, a force and a damage: of samples, derivatives, a fit that finds the push, a design at its
    limit."""
    scene = cart(
        'effects.push={type="force",joint="rail",scale="pull",table=[[0.0,0.0],[0.1,8.0]]}', "simulation.duration=0.1",
        "reduction.angles=6",
        'parameters.pull={nominal=1.0,bounds=[0.5,2.0],distribution={name="uniform",loc=0.8,scale=0.4}}',
        'outputs={v={type="rate",of="x"},x={type="sliding",joint="rail"},'
        'squared={type="formula",formula="v * abs(v) * pull",unit="m2/s2"},'
        'pin={type="joint_force",joint="pivot",component="x"},s={type="stress",body="pole",quantity="stress_max",'
        'at=[0.1,0.0]},damage={type="rainflow",of="s",curve={exponent=3.0,reference=1e6,cycles=1e6}}}',
    )  # fmt: skip
    (tmp_path / "scene.toml").write_text(scene_to_toml(scene))
    rom, names = tmp_path / "rom.h5", ("v", "squared", "pin", "damage")
    pgmp("build", tmp_path / "scene.toml", "-o", rom)
    found = json.loads(pgmp("montecarlo", rom, "-n", 16, "--seed", 1, "-o", tmp_path / "e.h5", "--json").stdout)
    assert set(names) <= found["statistics"].keys()
    slopes = json.loads(pgmp("sensitivities", rom, "-o", tmp_path / "g.h5", "--json").stdout)
    assert set(names) <= slopes["outputs"].keys()
    pgmp("simulate", rom, "--override", "parameters.pull={nominal=1.0,value=1.1}", "-o", tmp_path / "r.h5")
    run = Trajectory.read(tmp_path / "r.h5")
    rows = np.column_stack([run.time, *(run.outputs[name] for name in names)])
    np.savetxt(tmp_path / "m.csv", rows, delimiter=",", header=",".join(("time", *names)), comments="", fmt="%.17g")
    pgmp("fit", rom, tmp_path / "m.csv", "-o", tmp_path / "f.h5")
    assert Fit.read(tmp_path / "f.h5").parameters[0].estimate == pytest.approx(1.1, rel=1e-4)
    limit = ("--subject-to", "max(abs(pin)) <= 3.0", "--subject-to", "end(damage) <= 1.0")
    pgmp("optimize", rom, "maximise end(v)", *limit, "-o", tmp_path / "d.h5", status=None)
    design = Design.read(tmp_path / "d.h5")
    largest = np.abs(design.designed["pin"]).max()
    assert largest == pytest.approx(3.0, rel=1e-3) or largest < 3.0 and design.record.parameters["pull"] > 1.99
