"""When an ensemble has samples enough: rules, the looks at which they are tested, and a budget of time.

The text behind ``--until`` is a rule:

    rule    = figure precision
    figure  = ("mean" | "std") "(" quantity ")"  |  "P" "(" label ")"  |  "P" "(" quantity ("<" | ">") number [unit] ")"
    precision = "<" number "%"  |  ("+-" | "±") number ["%" | unit]

Rules (docs/uncertainty.md, until a figure is known) are tested on all samples so far, n, 2 n, 4 n, ...; a budget
decides on the size of the last stage from the time of the one before, so that no value of a sample does. Errors at n
and 2 n samples, Z_1 and Z_2 in deviations of their own, are jointly normal with the correlation ``1 / sqrt(2)``. Widths
at n may hang on Z_1 in any way; the share of the ensembles that stop there is log-concave in it (Prekopa, Acta
Scientiarum Mathematicarum 34 (1973) 335-343). With ``P(|Z| > z) = a`` the interval at the stop misses with at most

    a + a / 2 - P(Z_1 > z, |Z_2| > z) = alpha,

which gives the level ``1 - a`` of the intervals at every look, of every figure and for several rules.
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
import scipy

from pgmp_petsc.base.errors import InputError, Remark, gathered, nearest_name, note, warning
from pgmp_petsc.base.surroundings import Comm
from pgmp_petsc.base.units import SI, UnitSystem, UnknownUnit, number_of, times
from pgmp_petsc.ensemble.plan import Plan
from pgmp_petsc.ensemble.sampling import Sampler
from pgmp_petsc.ensemble.statistics import came_true, describe, of_event, quantity
from pgmp_petsc.results.ensemble import DESCRIBED, Ensemble, Stopping, reach_of
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.fields import LARGEST, SMALLEST
from pgmp_petsc.scene.numerics import Event
from pgmp_petsc.scene.outputs import unit_of
from pgmp_petsc.stepping.status import Status

if TYPE_CHECKING:
    from pgmp_petsc.ensemble.checkpoint import Kept


OPTION = "--until"
EXAMPLES = "rules are such as 'std(angle) < 1 %', 'mean(angle) +- 1e-4' or 'P(deformation < -1.5e-4) +- 0.002'"
MOMENTS = ("mean", "std")
TOKEN = re.compile(
    r"\s*(?:(?P<number>[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)(?![\d.]|[eE]\b)|(?P<name>[A-Za-z_][\w.-]*)"
    r"|(?P<sign>\+-|±|[()<>%]))"
)
UNIT = re.compile(r"\s*((?:1/)?[^\W\d_][^()<>±%+,]*?)\s*(?=$|[)±+])")


@dataclass(frozen=True)
class Rule:
    """When a figure is known well enough."""

    text: str  # as it was given
    kind: str  # ``mean``, ``std`` or ``P``
    quantity: str  # of a moment: name of the quantity. Of a probability: label of a scene's event, or empty.
    event: Event | None  # of a probability of the end of the run that the rule itself gives
    wanted: float  # half the width of the interval at most
    relative: bool  # whether it is a share of the figure


class Reader:
    """Takes the text of a rule, or of an event, of a scene apart, from left to right; `entry` and `examples` are for
    messages, which mark the place."""

    def __init__(self, entry: str, text: str, scene: Scene, examples: str) -> None:
        self._entry, self._examples = entry, examples
        self._text, self._scene, self._place = text, scene, 0

    def rule(self) -> Rule:
        kind = self._name("mean, std or P", (*MOMENTS, "P"))
        self._sign("(")
        if kind == "P":
            quantity, event = self.event()
        else:
            outputs = self._scene.outputs
            over_time = [f"{name}.{w}" for name in self._scene.ensemble.with_extremes(outputs) for w in DESCRIBED]
            quantity, event = self._name("the name of an output", [*outputs, *over_time]), None
        self._sign(")")
        relative = self._sign("<", "+-", "±") == "<"
        place, wanted = self._place, self._number()
        if relative or self._text[self._place :].strip() == "%":
            self._sign("%")
            relative, wanted = True, 0.01 * wanted
        elif kind != "P":
            wanted = self._of_output(wanted, quantity.partition(".")[0])
        if not wanted > 0.0:
            self._refuse("a positive precision", place)
        self.end()
        return Rule(self._text, kind, quantity, event, wanted, relative)

    def _of_output(self, number: float, output: str) -> float:
        """Return a number in SI units that is in those of the scene, or in the unit behind it."""
        wanted, unit = unit_of(self._scene, output), UNIT.match(self._text, self._place)
        if unit is None:
            return times(number, self._scene.system.size_of(wanted))
        try:
            found = number_of(f"{number!r} {unit[1]}", (wanted,), SI)
        except UnknownUnit as error:
            self._refuse(f"a unit of {output}, or none ({error})")
        self._place = unit.end(1)
        return found

    def event(self, may_be_ever: bool = False) -> tuple[str, Event | None]:
        """Read a label, or an output beyond a level; if that may be, at any time with ``ever`` before it."""
        ever = re.compile(r"\s*ever(?=\s+[A-Za-z_])").match(self._text, self._place) if may_be_ever else None
        self._place = ever.end() if ever else self._place
        labels = () if ever else self._scene.ensemble.probabilities
        expected = "an output" if ever else "an output or a label of ensemble.probabilities"
        name = self._name(expected, [*self._scene.outputs, *labels])
        if name in labels:
            return name, None
        side = "above" if self._sign("<", ">") == ">" else "below"
        if may_be_ever and (behind := re.compile(r".*\s(?=ever\s*$)").match(self._text, self._place)):
            self._refuse(f"'ever' before {name}, and nothing there", behind.end())
        return "", Event(output=name, when="ever" if ever else "end", **{side: self._of_output(self._number(), name)})

    def end(self) -> None:
        if self._text[self._place :].strip():
            self._refuse("the end")

    def _name(self, expected: str, known: list[str] | tuple[str, ...]) -> str:
        place, name = self._place, self._take("name")
        if name is None:
            self._refuse(expected)
        if name not in known:
            self._refuse(f"{expected}{nearest_name(name, known)}", place)
        return name

    def _number(self) -> float:
        place, number = self._place, self._take("number")
        if number is None:
            self._refuse("a number")
        if float(number) and not SMALLEST <= abs(float(number)) <= LARGEST:
            self._refuse(f"0 or a magnitude from {SMALLEST:g} to {LARGEST:g}", place)
        return float(number)

    def _sign(self, *allowed: str) -> str:
        place, sign = self._place, self._take("sign")
        if sign not in allowed:
            self._refuse(" or ".join(f"'{one}'" for one in allowed if one != "±"), place)
        return sign

    def _take(self, kind: str) -> str | None:
        """Return the next word where it is of a kind, and go on behind it."""
        found = TOKEN.match(self._text, self._place)
        if found is None or found[kind] is None:
            return None
        self._place = found.end()
        return found[kind]

    def _refuse(self, expected: str, place: int | None = None) -> None:
        """Raise an error that marks a place, by default the present one."""
        place = self._place if place is None else place
        place += len(self._text[place:]) - len(self._text[place:].lstrip())
        raise InputError(
            f'{self._entry} "{self._text}": expected at character {place + 1}: {expected}; {self._examples}\n'
            f"  {self._text}\n  {' ' * place}^"
        )


def read_rule(text: str, scene: Scene) -> Rule:
    """Read a rule. Raises `InputError` if it is none, with the place marked, or names what the scene does not have."""
    return Reader(OPTION, text, scene, EXAMPLES).rule()


FIRST = 64  # samples at the first look, at least


@cache
def level_of_each(confidence: float) -> float:
    """Return the level of the intervals at every look, so that the one at the stop has `confidence`."""
    alpha = 1.0 - confidence
    points, weights = np.polynomial.legendre.leggauss(64)

    def excess(a: float) -> float:
        z = -scipy.special.ndtri(0.5 * a)
        # P(|Z_1| > z, |Z_2| > z): Z_2 = (Z_1 + Z') / sqrt(2), over Z_1 from z to where nothing is left
        x = z + 5.0 * (points + 1.0)
        tails = scipy.special.ndtr(x - np.sqrt(2.0) * z) + scipy.special.ndtr(-x - np.sqrt(2.0) * z)
        both = 2.0 * 5.0 * np.sum(weights * np.exp(-0.5 * x**2) / np.sqrt(2.0 * np.pi) * tails)
        return 1.5 * a - 0.5 * both - alpha

    return 1.0 - float(scipy.optimize.brentq(excess, 0.5 * alpha, alpha, xtol=1e-14))


def looks(unit: int, most: int) -> Iterator[int]:
    """Yield the numbers of samples at which one looks, the last of them `most`, all others multiples of `unit`."""
    n = unit
    while n < FIRST:
        n *= 2
    while n < most:
        yield n
        n *= 2
    yield most


RESERVE = 0.9  # of a budget, for the samples
LEAST = 0.03  # of it, for which no further ones begin
ENDING = 0.7  # s, and no more than half of the budget, which figures and the file take behind them at least
SURE = 0.8  # of what is left for samples, which the next ones are to take: their times vary
PROBE = 8  # samples that tell what one takes
MOST = 10**9


@dataclass(frozen=True)
class Stop:
    """The end of an ensemble before its last sample: rules that are met, or a budget of wall time (s) since `start`
    (`time.monotonic`) that is spent."""

    rules: tuple[Rule, ...] = ()
    budget: float | None = None
    start: float = field(default_factory=time.monotonic)

    @property
    def left(self) -> float:
        """Rest of the budget, s."""
        if self.budget is None:
            return np.inf
        for_samples = min(RESERVE * self.budget, self.budget - min(ENDING, 0.5 * self.budget))
        return for_samples - (time.monotonic() - self.start)


@dataclass(frozen=True)
class Seen:
    """Figures of the rules after n samples: estimates (n_rules,) and intervals (n_rules, 2)."""

    n: int
    estimates: np.ndarray
    intervals: np.ndarray


def see(rules: tuple[Rule, ...], scene: Scene, sampler: Sampler, kept: Kept, n: int) -> Seen:
    if not rules:
        return Seen(n, np.zeros(0), np.zeros((0, 2)))
    level, columns = level_of_each(scene.ensemble.confidence), kept.columns()
    outputs, extremes, passages = (columns.of(kind) for kind in ("outputs", "extremes", "first_passages"))
    fine, described, replicates = columns["status"] == Status.FINE, sampler.described(n), sampler.replicates(n)
    chosen = fine & described
    estimates, ends = [], []
    for rule in rules:
        if rule.kind in MOMENTS:
            values = quantity(rule.quantity, outputs, extremes)
            known = chosen & np.isfinite(values)
            found = describe(values[known], 1, (), 0, level, None if replicates is None else replicates[known])
            estimates.append(getattr(found, rule.kind))
            ends.append(getattr(found, f"{rule.kind}_interval"))
            continue
        true = came_true(rule.event or scene.ensemble.probabilities[rule.quantity], rule.quantity, outputs, passages)
        count, n_fine, of_both = of_event(true, chosen, described & ~fine, replicates, level)
        estimates.append(count / n_fine if n_fine else np.nan)
        ends.append(of_both)
    return Seen(n, np.array(estimates), np.array(ends))


def are_met(rules: tuple[Rule, ...], seen: Seen) -> np.ndarray:
    """Return which rules are met by what is seen, (n_rules,)."""
    wanted, relative = np.array([rule.wanted for rule in rules]), np.array([rule.relative for rule in rules], bool)
    return reach_of(seen.estimates, seen.intervals, relative) <= wanted


def timed(run: Callable[[int], int], n: int) -> float | None:
    """Integrate up to sample n, and return what a sample took, s; None where all were taken up from a checkpoint."""
    start = time.monotonic()
    computed = run(n)
    return (time.monotonic() - start) / computed if computed else None


def stages(
    stop: Stop, unit: int, most: int, run: Callable[[int], int], seen: Callable[[int], Seen], comm: Comm
) -> list[Seen]:
    """Integrate stage by stage until the rules are met, the budget is spent, or there is no further sample.

    `run` integrates all samples up to a number and returns how many there were to do; `seen` looks at these, on every
    rank the same; `unit` and `most` are as of `looks`. Collective on `comm`.
    """
    found: list[Seen] = []
    done, seconds = 0, None  # samples, and what one of the last ones took

    def affordable() -> int:
        """Return how many more samples are within the budget, a multiple of `unit`: rank 0 decides for all."""
        n = None
        if comm.rank == 0:
            if stop.left < LEAST * stop.budget:
                n = 0
            elif seconds is None:
                n = -(-PROBE // unit) * unit
            else:
                n = int(min(SURE * stop.left / seconds, MOST)) // unit * unit
        return comm.bcast(n)

    for n in looks(unit, most):
        while done < n:
            target = n
            if stop.budget is not None:
                more = affordable()
                if not more and done:
                    break
                target = min(n, done + max(more, unit))
            seconds = timed(run, target) or seconds
            done = target
        found.append(seen(done))
        if done < n or stop.rules and np.all(are_met(stop.rules, found[-1])):
            break
    return found


def stopped(ensemble: Ensemble, scene: Scene, plan: Plan, stop: Stop, history: list[Seen]) -> Ensemble:
    found, record = stopping_of(stop, history, plan, ensemble.units), ensemble.record
    remarks = (*record.remarks, *stopping_remarks(found, scene.ensemble.confidence, scene.system))
    return replace(ensemble, stopping=found, record=replace(record, remarks=remarks))


def stopping_of(stop: Stop, history: list[Seen], plan: Plan, units: dict[str, str]) -> Stopping:
    """Return what is kept of the looks; `units` are those of the quantities."""
    last = history[-1]
    met = are_met(stop.rules, last)
    if stop.rules and np.all(met):
        why = "the rules are met" if len(stop.rules) > 1 else "the rule is met"
    elif last.n >= plan.n_samples:
        why = f"these are all samples (-n {plan.n_samples})"
    else:
        why = f"the budget of {stop.budget:g} s is spent"
    return Stopping(
        why,
        stop.budget,
        tuple(rule.text for rule in stop.rules),
        tuple(units.get(rule.quantity, "1") if rule.kind in MOMENTS else "1" for rule in stop.rules),
        np.array([rule.wanted for rule in stop.rules]),
        np.array([rule.relative for rule in stop.rules], dtype=bool),
        met,
        np.array([seen.n for seen in history]),
        np.array([seen.estimates for seen in history]).T.reshape(len(stop.rules), len(history)),
        np.array([seen.intervals for seen in history]).transpose(1, 0, 2),
    )


@gathered
def stopping_remarks(stopping: Stopping, confidence: float, system: UnitSystem) -> Iterator[Remark]:
    """Return what is to be said of intervals after looks, of rules that are not met, and of times that decided."""
    last = zip(stopping.rules, stopping.units, stopping.met, stopping.reached[:, -1], stopping.relative)
    for text, unit, met, reached, relative in last:
        if not met:
            reach = f"{100 * reached:.3g} %" if relative else system.text(reached, unit).removesuffix(" 1")
            shown = f"+- {reach} was reached"
            shown = shown if np.isfinite(reached) else "its figure is not known yet from so few samples"
            yield warning(
                f'--until "{text}" is not met: {stopping.why}, and {shown}; --resume with '
                "a larger -n or --budget goes on"
            )
    if stopping.rules:
        often = "once" if len(stopping.samples) == 1 else f"{len(stopping.samples)} times"
        yield note(
            f"samples were looked at {often}; each interval is taken at the level "
            f"{100 * level_of_each(confidence):.2f} %, so that at the stop it holds with {100 * confidence:g} % "
            "although one looked (whichever of two neighbouring looks it is, docs/uncertainty.md)"
        )
    if stopping.budget is not None:
        yield note(
            f"--budget {stopping.budget:g}s: the number of samples follows from measured times, and another run "
            "may have another; the samples themselves are the same. Where slow samples are others than quick ones, "
            "no bias comes of it: samples are taken in their order"
        )
