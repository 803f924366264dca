"""Derivatives of a run with parameters of the scene: sensitivities of its outputs, and goals and constraints of a
design, as users write them.

    goal        = ("minimise" | "maximise") sum              ("minimize", "maximize" as well)
    constraint  = sum ("<=" | ">=") sum
    figure      = ("max" | "min" | "mean" | "rms" | "start" | "end") "(" history ")"
    history     = output | "abs" "(" output ")"

A sum is a formula (:mod:`~pgmp_petsc.declare.formulas`) of numbers, parameters and figures, in which ``^`` is ``**``
too.

A figure is that of an output over a run: its largest and smallest value, by parabolas through the ends of steps
(`results/gradients.py`: no jump of the slope where another end of a step comes to be nearest), the mean and the root of
the mean square over time (trapezoids), and its values at time zero and at the end. Numbers are in the scene's units;
searches are in SI units (:mod:`~pgmp_petsc.declare.formulas`), so that the design is the same to the last digit in
whichever units the scene is written.

A search turns back from places on its way whose runs stop before their end, and says so.
"""

from __future__ import annotations

import re
from bisect import bisect_right
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import reduce
from itertools import accumulate
from operator import add
from types import MappingProxyType
from typing import NamedTuple, NoReturn

import numpy as np

from pgmp_petsc.base.errors import InputError, PgmpError, Remark, gathered, nearest_name, note, warning
from pgmp_petsc.base.progress import progress
from pgmp_petsc.base.resources import Timings
from pgmp_petsc.base.surroundings import Comm
from pgmp_petsc.base.units import (
    IN_TURNS,
    SI,
    UNITS,
    Units,
    UnitSystem,
    UnknownUnit,
    dimension_of,
    has_angles,
    is_hertz,
    measure,
    si_name,
    times,
)
from pgmp_petsc.declare import formulas
from pgmp_petsc.declare.formulas import in_si, shifted
from pgmp_petsc.estimates.own_error import largest_at_start, of_figures, polynomials_of_lengths
from pgmp_petsc.estimates.runs_at_points import RunsAtPoints
from pgmp_petsc.files.hdf5 import RunRecord
from pgmp_petsc.gradients.contacts import Contact
from pgmp_petsc.gradients.differences import NEAR, Off, announce_runs, why_differences
from pgmp_petsc.gradients.differentiated import DifferentiatedRun, differentiate
from pgmp_petsc.models import LengthLanes, Model, Observing, ReducedModel, of_samples
from pgmp_petsc.ranks.agreement import agreed
from pgmp_petsc.results.gradients import DEVIATION, PERCENT, Derivatives, Instants, Vertex, is_sharp, vertex
from pgmp_petsc.results.numbers import nothing, share_text
from pgmp_petsc.scene import Scene, scene_to_toml
from pgmp_petsc.scene.parameters import correlation_matrix
from pgmp_petsc.scene.units import own_values, result_units

SHARE = 0.01  # of the value of a parameter without a distribution
LEAST = 0.05  # of an output's largest effect: smaller ones are nothing beside it
DOUBTFUL = 0.01  # of the largest derivative: what differences may be off by from there on is warned of


def chosen_parameters(scene: Scene, asked: Sequence[str], known: Iterable[str], without: str) -> tuple[str, ...]:
    """Return the parameters that are asked for, each once, all that are known where none is; raises `InputError` if
    there is no parameter, with what is to be done `without`, or none of a name."""
    for name in asked:
        if name not in scene.parameters:
            raise InputError(f"--parameter {name}: there is no such parameter{nearest_name(name, scene.parameters)}")
    names = tuple(dict.fromkeys(asked)) or tuple(known)
    if not names:
        raise InputError(f"parameters: {without}")
    return names


def sensitivities(model: ReducedModel, asked: Sequence[str], comm: Comm) -> Derivatives | None:
    """Run a sample, and differentiate it with the parameters of these names, all where there are none; one rank does,
    the others wait, and have None. Collective on `comm`. Raises `InputError` and `RunError` as `differentiate` and
    `chosen_parameters`."""
    with agreed(comm, "sensitivities"):
        names = chosen_parameters(
            model.scene, asked, model.scene.parameters, "the scene has none; give a number a name, such as "
            "[parameters.r1] nominal = 5.6e-3, and the name in its place",
        )  # fmt: skip
        return _on_one_rank(model, names, comm) if comm.rank == 0 else None


def _on_one_rank(model: ReducedModel, names: Sequence[str], comm: Comm) -> Derivatives:
    scene, timings, model = model.scene, Timings(), of_samples(model, names)
    n_steps = scene.simulation.n_steps
    announce_runs(model, names, "this run with its derivatives", comm)
    with timings.phase("run and derivatives"), progress(n_steps, model.title, comm) as bar:
        run = differentiate(model, scene.values, names, bar.update)
    with timings.phase("errors"):
        own = _of_own_error(model, run, names)
    units = {name: result_units(scene)[name] for name in names} | dict(model.outputs.units)
    changes = {name: _change(scene, name) for name in names}
    idle = [name for name in names if not any(found[name].any() for found in run.derivatives.values())]
    without = [note(f"no output depends on {', '.join(idle)} in this run")] if idle else []
    corners = corner_remarks(run, np.array([[change] for change, _ in changes.values()]))
    # zero where one has no distribution
    matrix = correlation_matrix(scene, names)
    uncertain = np.array([scene.parameters[name].distribution is not None for name in names], dtype=float)
    return Derivatives(
        RunRecord(
            scene_to_toml(scene), own_values(scene), None, comm.size, timings.as_dict(),
            (*run_remarks(model, run), *corners, *own, *without, *scene.remarks),
        ),
        run.time,
        run.outputs,
        run.derivatives,
        units,
        changes,
        (np.eye(len(names)) if matrix is None else matrix) * np.outer(uncertain, uncertain),
        run.steps_divided,
        _instants(run.contacts),
    )  # fmt: skip


def _instants(contacts: Sequence[Contact]) -> Instants | None:
    if not contacts:
        return None
    met, time, turning = (np.array([getattr(c, name) for c in contacts]) for name in ("met", "time", "turning"))
    return Instants(tuple(c.effect for c in contacts), met, time, turning, np.array([c.derivatives for c in contacts]))


def _change(scene: Scene, name: str) -> tuple[float, str]:
    """Return the change of a parameter to which effects refer, and what it is."""
    parameter = scene.parameters[name]
    if parameter.distribution is not None:
        return parameter.deviation, DEVIATION
    return SHARE * abs(scene.values[name]), PERCENT


def _of_own_error(model: Observing, run: DifferentiatedRun, names: Sequence[str]) -> tuple[Remark, ...]:
    """Return what errors of the model do to the effects at the end: they change from here to the next value of each
    parameter."""
    scene, what, units = model.scene, "derivatives", model.outputs.units
    moved = [_moved(scene, name) for name in names]
    points = [scene.values, *(scene.values | {name: value} for name, value in zip(names, moved))]
    runs = RunsAtPoints.of(model, points)
    errors, beyond = runs.errors, runs.beyond("runs (as given, and with each parameter changed)")
    if errors is None:
        return (runs.not_known(what), *beyond)
    effects, lost = [], [output for output, at_end in errors.at_end.items() if not np.isfinite(at_end).all()]
    none = nothing(run.outputs, units, model.kinematics.size)
    for output, at_end in errors.at_end.items():
        if output in lost:
            continue
        slopes = run.derivatives[output]
        size = max(abs(slopes[name][-1] * (new - scene.values[name])) for name, new in zip(names, moved))
        for name, new, error in zip(names, moved, at_end[1:]):
            change = new - scene.values[name]
            slope = float(slopes[name][-1])
            # an effect that is nothing beside the largest one, or beside outputs, is not worth a word
            if abs(slope * change) > max(LEAST * size, none[output]):
                without = slope - (error - at_end[0]) / change
                text = f"d {output} / d {name} at the end"
                unit = scene.system.size_of(scene.parameters[name].unit or "1") / scene.system.size_of(units[output])
                effects.append((text, unit * slope, unit * float(without), abs(unit * slope)))
    unknown = (runs.not_known(f"{what} of {', '.join(lost)}", lost),) if lost else ()
    return (*(of_figures(effects) if effects else ()), *unknown, *beyond)


def _moved(scene: Scene, name: str) -> float:
    """Return the changed value of a parameter for its effects, within its bounds, on where that is far enough."""
    value, change = scene.values[name], _change(scene, name)[0] or SHARE
    low, high = scene.parameters[name].bounds or (-np.inf, np.inf)
    back, on = max(value - change, low), min(value + change, high)
    return on if on == value + change or on - value > value - back else back


def step_remarks(model: Observing, run: DifferentiatedRun) -> list[Remark]:
    """Return that a run took smaller steps than the scene's, where it did, and what is largest at its start."""
    told = list(largest_at_start(model.scene, run.outputs, model.outputs.units))
    if run.steps_divided > 1:
        step = f"simulation.step = {model.scene.simulation.step:g} s"
        told.append(note(f"{step} is large for this run: it was integrated with 1/{run.steps_divided} of it"))
    return told


@gathered
def difference_remarks(model: Model, off: Off) -> Iterator[Remark]:
    """Return that derivatives are differences of runs, where they are, and how far these may be off."""
    why = why_differences(model)
    if why:
        apart = f"derivatives are differences of runs, {NEAR:g} of a parameter's size apart, because of {why}"
        if not off.share:
            yield note(apart)
            return
        where = f"d {off.output} / d {off.parameter}"
        said = f"{apart}; they are estimated to be off by up to {share_text(off.share)} of the largest ({where})"
        yield note(said) if off.share < DOUBTFUL else warning(f"{said}: compare runs (--set)")
        return
    if model.scene.jumping:
        yield warning(
            f"{', '.join(model.scene.jumping)}: derivatives leave out what a force jumps by where a comparison or a "
            "sign changes; where such a place moves with a parameter they are wrong: write it without a jump (max, "
            "min, tanh), or compare runs (--set)"
        )


@gathered
def run_remarks(model: Model, run: DifferentiatedRun) -> Iterator[Remark]:
    """Return what is to be said of the derivatives of a run."""
    yield note(
        f"derivatives are those of the {model.title} model with its time step; errors of the run are estimated by pgmp "
        "simulate"
    )
    yield from difference_remarks(model, run.off)
    yield from step_remarks(model, run)
    if isinstance(model, LengthLanes):
        yield polynomials_of_lengths(model, False)
    if not why_differences(model) and model.stresses is not None:
        names = ", ".join(stress.name for stress in model.stresses.stresses)
        yield note(
            f"derivatives of stresses ({names}) follow from central differences along the exact derivatives of the "
            "motion; where a largest value changes its place they have a corner"
        )
    yield from contact_remarks(run)


@gathered
def corner_remarks(run: DifferentiatedRun, changes: np.ndarray) -> Iterator[Remark]:
    """Return which largest and smallest values the step does not resolve, where changes of the parameters (n, 1) do
    something else an instant before than an instant after."""
    told = []
    for output, values in run.outputs.items():
        rows = np.array(list(run.derivatives[output].values())) * changes
        for what, sign in (("largest", 1.0), ("smallest", -1.0)):
            at = vertex(values, sign).at
            near = rows[:, max(at - 1, 0) : at + 2]
            if is_sharp(values, at) and np.ptp(near, axis=1).max() > LEAST * np.abs(rows[:, at]).max():
                told.append(f"the {what} {output} at {run.time[at]:.4g} s")
    if told:
        yield warning(
            f"derivatives of {', '.join(told)} are unsure: there is a corner, or a vibration of fewer than 8 steps; "
            "take a smaller simulation.step, or compare runs (--set)"
        )


@gathered
def contact_remarks(run: DifferentiatedRun) -> Iterator[Remark]:
    """Return what is to be said of the end stops that a run meets and leaves."""
    for entry in dict.fromkeys(contact.entry for contact in run.contacts):
        own = [contact for contact in run.contacts if contact.entry == entry]
        nearest = min(own, key=lambda contact: contact.turning)
        times = "once" if len(own) == 1 else f"{len(own)} times"
        yield note(
            f"{entry} is met or left {times}, first at {own[0].time:.5g} s: these instants move with the "
            "parameters, and derivatives hold for changes that leave their number and order as they are; nearest "
            f"to grazing is that at {nearest.time:.5g} s, where the path would turn back within "
            f"{nearest.turning:.2g} s"
        )


SENSES = {"minimise": 1.0, "minimize": 1.0, "maximise": -1.0, "maximize": -1.0}
SENSE = r"\s*(\w*)\s*"  # what a goal begins with, one of these
WORDS = "parameters, figures of outputs (max, min, mean, rms, start and end of OUTPUT or of abs(OUTPUT))"


class Dual(NamedTuple):
    """A number and its derivatives with the parameters, shape (n_parameters,); inf or nan where there is none."""

    value: float
    slope: np.ndarray


@dataclass(frozen=True, eq=False)
class Outcome:
    """Source of an expression's value: a run and the values of the parameters that it is differentiated with."""

    run: DifferentiatedRun
    values: Mapping[str, float]
    names: tuple[str, ...]

    def slopes(self, output: str) -> np.ndarray:
        """Return the derivatives of an output, shape (n_parameters, n_t)."""
        rows = [self.run.derivatives[output][name] for name in self.names]
        return np.array(rows).reshape(len(rows), self.run.time.size)


@dataclass(frozen=True, eq=False)
class Expression:
    """A sum of a goal or a constraint, in SI units."""

    text: str  # in the language of declarations
    parts: Mapping[str, Callable[[Outcome], Dual]]  # what it names: figures and parameters
    outputs: frozenset[str]  # of which these figures are

    def __call__(self, outcome: Outcome) -> Dual:
        parts = {name: formulas.Series([np.array(one) for one in part(outcome)]) for name, part in self.parts.items()}
        with np.errstate(all="ignore"):  # what has no value, such as 1 / 0, is refused by whoever evaluates
            value, slope = formulas.evaluated(self.text, parts, formulas.SeriesAlgebra(1)).parts
        return Dual(float(value), np.broadcast_to(slope, len(outcome.names)))


#: Makes a figure of times, values and their derivatives.
Figure = Callable[[np.ndarray, np.ndarray, np.ndarray], Dual]


def _at(place: Callable[[np.ndarray], Vertex]) -> Figure:
    def figure(time: np.ndarray, values: np.ndarray, slopes: np.ndarray) -> Dual:
        at = place(values)
        return Dual(float(at.of(values)), at.of(slopes))

    return figure


def _mean(time: np.ndarray, values: np.ndarray, slopes: np.ndarray) -> Dual:
    weights = np.gradient(time)  # of trapezoids, but at the ends
    weights[[0, -1]] *= 0.5
    weights /= weights.sum()
    return Dual(float(values @ weights), slopes @ weights)


def _rms(time: np.ndarray, values: np.ndarray, slopes: np.ndarray) -> Dual:
    square = _mean(time, values**2, 2.0 * values * slopes)
    root = np.sqrt(square.value)
    return Dual(float(root), square.slope / (2.0 * root) if root > 0.0 else np.zeros_like(square.slope))


FIGURES = {
    "max": _at(lambda values: vertex(values, 1.0)),
    "min": _at(lambda values: vertex(values, -1.0)),
    "mean": _mean,
    "rms": _rms,
    "start": _at(lambda values: Vertex(0, 0.0)),
    "end": _at(lambda values: Vertex(-1, 0.0)),
}
_NAME = "[A-Za-z_][A-Za-z0-9_-]*"
_WORD = f"[\N{MICRO SIGN}\N{GREEK SMALL LETTER MU}]?{_NAME}|\N{DEGREE SIGN}"  # a name, or a unit
_TOKEN = re.compile(
    rf"(?P<figure>{'|'.join(FIGURES)})\s*\(\s*(?P<abs>abs\s*\(\s*)?(?P<output>{_NAME})\s*\)(?(abs)\s*\))"
    rf"|(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)|(?P<name>{_WORD})|(?P<relation>[<>]=?)|(?P<sign>\*\*|[-+*/^(),])|\S"
)


@dataclass(frozen=True, eq=False)
class Goal:
    """A goal: what is made as small as it becomes is ``sense`` times the expression."""

    text: str  # as it was written
    sense: float  # 1, or -1 of what is maximised
    expression: Expression
    size: float  # times which it is in the units of the scene
    unit: str  # among these; 1 where it is not known


@dataclass(frozen=True, eq=False)
class Constraint:
    """A constraint: ``sense (left - right) <= 0``."""

    text: str  # as it was written
    sense: float  # 1 of ``<=``, -1 of ``>=``
    left: Expression
    right: Expression
    size: float  # times which both sides are in the units of the scene
    unit: str  # among these; 1 where it is not known


#: SI units of outputs, and of parameters behind ``parameters.``; empty of those of any unit, 1 where none is given.
_NO_UNITS: Units = MappingProxyType({})


def read_goal(
    text: str, outputs: Collection[str], parameters: Collection[str], units: Units = _NO_UNITS, system: UnitSystem = SI
) -> Goal:
    """Read a goal in the units of a system; raises `InputError` with the position marked."""
    reader = _Reader("goal", text, outputs, parameters, units, system)
    word = re.match(SENSE, text)
    if word[1] not in SENSES:
        reader.refuse("a goal begins with minimise or maximise", word.start(1))
    (tokens, *_), relations = reader.sums(word.end())
    for relation in relations:
        reader.refuse(f"'{relation[0]}' is too much; an operator or the end is needed", relation.start())
    read = reader.expression(tokens, len(text))
    found = in_si({"goal": read.text}, reader.powers)
    size = shifted(1.0, found.of_texts["goal"])
    return Goal(text, SENSES[word[1]], replace(read, text=found.texts["goal"]), size, reader.unit_of(read))


def read_constraint(
    text: str, outputs: Collection[str], parameters: Collection[str], units: Units = _NO_UNITS, system: UnitSystem = SI
) -> Constraint:
    """Read a constraint; as `read_goal`."""
    reader = _Reader("--subject-to", text, outputs, parameters, units, system)
    sums, relations = reader.sums()
    signs = [relation[0] for relation in relations]
    if signs not in (["<="], [">="]):
        reader.refuse("<= or >= is needed, once", relations[-1].start() if relations else len(text))
    left, right = map(reader.expression, sums, (relations[0].start(), len(text)))
    found = in_si({"left": left.text, "right": right.text}, reader.powers, {"left": "both", "right": "both"})
    sides = replace(left, text=found.texts["left"]), replace(right, text=found.texts["right"])
    size = shifted(1.0, found.powers.get("both", 0))
    return Constraint(text, 1.0 if signs == ["<="] else -1.0, *sides, size, reader.unit_of(left, right))


class _Reader:
    """Reads the sums of one text, and writes them in the language of declarations."""

    def __init__(
        self, entry: str, text: str, outputs: Collection[str], parameters: Collection[str], units: Units,
        system: UnitSystem,
    ) -> None:  # fmt: skip
        if len(text) > formulas.LONGEST:  # as of formulas: no line could mark a position
            raise InputError(
                f"{entry}: {len(text)} characters; at most {formulas.LONGEST} are read. Use parameters for numbers"
            )
        self._given, self._system = units, system
        self._units: dict[str, str] = {}  # SI units of what sums name
        self._quantity: re.Match[str] | None = None  # the first number that has a unit
        self._entry, self._text, self._outputs, self._parameters = entry, text, outputs, parameters

    def refuse(self, reason: str, place: int) -> NoReturn:
        raise InputError(f"{self._entry}: {reason}\n  {self._text}\n  {' ' * place}^")

    @property
    def powers(self) -> dict[str, int | None]:
        """By which powers of ten what sums name is larger in the units of the scene; None of what is of any unit."""
        return {name: self._system.power_of(unit) if unit else None for name, unit in self._units.items()}

    def unit_of(self, *sums: Expression) -> str:
        """Return the unit of sums that are added or compared; 1 where they do not fit, or it is not known. Where a
        number has a unit, they are to fit."""
        names = {
            name: formulas.Measured(dimension_of(unit), unit) if unit else formulas.Measured()
            for name, unit in self._units.items()
        }
        try:
            found = reduce(add, (formulas.evaluated(one.text, names, formulas.Dimensions()) for one in sums))
        except formulas.DimensionError as error:
            if self._quantity:
                self.refuse(f"with the unit of this number it {error}", self._quantity.start())
            return "1"
        return "1" if found.dimension is None else self._system.unit(found.unit or si_name(found.dimension))

    def sums(self, begin: int = 0) -> tuple[list[list[re.Match[str]]], list[re.Match[str]]]:
        """Return the tokens of the sums from a character on, and the relations between them."""
        sums, relations, depth = [[]], [], 0
        for token in _TOKEN.finditer(self._text, begin):
            depth += (token[0] == "(") - (token[0] == ")")
            if token["relation"] and depth == 0:
                relations.append(token)
                sums.append([])
            else:
                sums[-1].append(token)
        return sums, relations

    def expression(self, tokens: Sequence[re.Match[str]], end: int) -> Expression:
        """Return a sum that ends before a character, its text in the units of the scene."""
        if not tokens:
            self.refuse(f"a sum is missing there, of numbers, {WORDS}", end)
        parts: dict[str, Callable[[Outcome], Dual]] = {}
        tokens, written = list(tokens), []
        for place, token in enumerate(tokens):  # what a unit is made of leaves them
            unit = self._take_unit(tokens, place + 1) if token["number"] else ""
            written.append(self._measured(token, unit, parts) if unit else self._written(token, parts))
        try:
            text, _ = formulas.declared(" ".join(written), {name: name for name in parts}, WORDS)
        except formulas.FormulaError as error:
            begins = [*accumulate((len(one) + 1 for one in written), initial=0)]
            places = [*(token.start() for token in tokens), tokens[-1].end()]
            self.refuse(f"it {error}", places[bisect_right(begins, error.at) - 1])
        return Expression(text, parts, frozenset(token["output"] for token in tokens if token["output"]))

    def _take_unit(self, tokens: list[re.Match[str]], begin: int) -> str:
        """Take the longest unit away that begins with a token, and return it; empty where there is none."""
        named = {*self._parameters, *self._outputs, *FIGURES, *formulas.FUNCTIONS}
        end = begin
        while end < len(tokens) and (tokens[end]["sign"] or tokens[end]["number"] or tokens[end]["name"]):
            if tokens[end]["name"] in named or (end == begin and not tokens[end]["name"]):
                break
            end += 1
        for last in range(end, begin, -1):
            if tokens[last - 1]["sign"]:
                continue
            unit = self._text[tokens[begin].start() : tokens[last - 1].end()]
            with suppress(UnknownUnit):
                measure(unit)
                del tokens[begin:last]
                return unit
        return ""

    def _measured(self, token: re.Match[str], unit: str, parts: dict[str, Callable[[Outcome], Dual]]) -> str:
        """Return a number with a unit in the language of formulas; add it to the parts."""
        if is_hertz(unit):
            self.refuse(IN_TURNS, token.end())
        self._quantity = self._quantity or token
        factor, dimension = measure(unit)
        value = times(float(token["number"]), factor)
        alike = (one for one, of in UNITS.items() if of == dimension and has_angles(one) == has_angles(unit))
        shown = next(alike, si_name(dimension))
        return self._part(parts, shown, lambda outcome: Dual(value, np.zeros(len(outcome.names))))

    def _written(self, token: re.Match[str], parts: dict[str, Callable[[Outcome], Dual]]) -> str:
        """Return a token in the language of formulas; add what it names to the parts."""
        text, name, output = token[0], token["name"], token["output"]
        if token["number"]:
            if not np.isfinite(float(text)):
                self.refuse(f"{text} is no finite number", token.start())
            return repr(float(text))
        if output:
            if output not in self._outputs:
                self.refuse(f"there is no such output{nearest_name(output, self._outputs)}", token.start("output"))
            figure = _figure_of(output, FIGURES[token["figure"]], bool(token["abs"]))
            return self._part(parts, self._given.get(output, "1"), figure)
        is_called = name in formulas.FUNCTIONS and re.match(r"\s*\(", self._text[token.end() :])
        if token["sign"] or token["relation"] or is_called:
            return "**" if text == "^" else text
        if not name:
            self.refuse(f"'{text}' has no place in a formula", token.start())
        if name in self._outputs:
            needed = f"take a figure of it, such as max({name}) or end({name})"
            self.refuse(f"{name} is an output over time; {needed}", token.start())
        if name in FIGURES and name not in self._parameters:
            needed = f"{name}(OUTPUT) or {name}(abs(OUTPUT)); of more declare an output of type formula"
            self.refuse(f"{name} is a figure of one output or of its abs: {needed}", token.start())
        if name not in self._parameters:
            hint = nearest_name(name, dict.fromkeys((*self._parameters, *FIGURES, *formulas.FUNCTIONS)))
            apart = "; for a difference leave spaces around -, which names may have in them" if "-" in name else ""
            self.refuse(
                f"there is no parameter, figure, function or unit of a number '{name}'{apart}{hint}", token.start()
            )
        return self._part(
            parts, self._given.get(f"parameters.{name}", "1"),
            lambda outcome: Dual(outcome.values[name], np.array([float(name == one) for one in outcome.names])),
        )  # fmt: skip

    def _part(self, parts: dict[str, Callable[[Outcome], Dual]], unit: str, part: Callable[[Outcome], Dual]) -> str:
        """Return what a sum calls what it names, which has an SI unit."""
        own = f"part_{len(self._units)}"
        parts[own], self._units[own] = part, unit
        return own


def _figure_of(output: str, figure: Figure, absolute: bool) -> Callable[[Outcome], Dual]:
    def of(outcome: Outcome) -> Dual:
        values, slopes = outcome.run.outputs[output], outcome.slopes(output)
        if absolute:
            values, slopes = np.abs(values), np.sign(values) * slopes
        return figure(outcome.run.time, values, slopes)

    return of


@dataclass
class TurnedBack:
    """Places from which a search turned back."""

    count: int = 0  # how often
    first: str = ""  # the first place and the reason, in words

    def add(self, error: PgmpError) -> None:
        self.count, self.first = self.count + 1, self.first or str(error)

    @property
    @gathered
    def remarks(self) -> Iterator[Remark]:
        if not self.count:
            return
        often = "once" if self.count == 1 else f"{self.count} times"
        yield warning(
            f"the search turned back {often} from where no run comes to its end, first {self.first}; what lies "
            "beyond was not searched, and what was found may stand at its edge: begin there (--set), or let bounds "
            "leave such places out"
        )
