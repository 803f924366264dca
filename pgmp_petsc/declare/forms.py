"""Sums of products with tables in index notation: a Lagrangian's equations as loops over the entries of its tables.

A row such as ``b[kl,i] v_k v_l q_i`` is a sum over its letters of entries of a table and of coordinates q, their rates
v and accelerations a. Letters k and l count the coordinates theta that tables depend on, i, j and h all others, delta.
Tables are symmetric in letters that stand together, skew where ``^`` is between two, and packed: the second one of
such letters is never above the first. With P what an entry T is multiplied by, p_x = dP/dv_x, and d_k T = dT/dtheta_k,
d/dt dL/dv_x - dL/dq_x is

    T (p_x' - dP/dq_x) + T' p_x,   T' = sum_k v_k d_k T,   and in all rows of theta   - P d_k T.

P and what comes of it are polynomials of a few factors, so that all derivatives are those of products. A loop adds up
what the loop around it multiplies by what they have in common (`Loops`): each entry is taken up once, and few
operations are done for it.

What is printed calls `load`, `store`, `add`, `add_to_row`, `add_to_rows`, `add_product`, `dot`, `zeros` and
`load_rows` of `vectors`, with their meaning, and is translated to C, where these are macros.
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction

Polynomial = dict[tuple[str, ...], Fraction]  # factors, such as v_k, in their order, and a number
THETA = "kl"
ANY = "*"  # in place of a letter: every theta, of an entry's derivatives
COUNTS = {"k": "r", "l": "r", "i": "m", "j": "m", "h": "m"}
ARRAYS = {"q": "q", "v": "v", "a": "a", "u": "rate"}
_ROW = re.compile(r"(?:(-?[\d/]+) )?(\w)\[([\w,^]+)\] (.*)")


def at(letter: str) -> str:
    """Return where a coordinate is among all."""
    return letter if letter in THETA else f"r + {letter}"


@dataclass(frozen=True)
class Term:
    """A row of a Lagrangian: its text, the expression of its letters of where an entry is, and the name of the table.

    The kind is ``kinetic``; ``potential``, which the Lagrangian has with the other sign; ``load``, its work; ``force``,
    whose changes with theta do no work; or ``dissipation``, a function of rates u whose derivatives are forces. There
    are such terms only with a name among `Loops.conditions`; always if empty. `less` is a load that is multiplied by
    the same as this potential: it is taken off its entries.
    """

    text: str
    place: str
    table: str
    kind: str
    only: str = ""
    less: Term | None = None

    @property
    def groups(self) -> list[str]:
        """Letters of the table, those together in which it is symmetric or, with ``^``, skew."""
        return _ROW.fullmatch(self.text)[3].split(",")

    @property
    def loops(self) -> list[tuple[str, bool, bool]]:
        """Each letter, whether it follows the one before, and whether it may be equal to that."""
        found = []
        for group in self.groups:
            letters = group.replace("^", "")
            found += [(letter, number > 0, number > 0 and "^" not in group) for number, letter in enumerate(letters)]
        return found

    def factor_of(self, bound: Sequence[str]) -> Polynomial:
        """Return what an entry is multiplied by in the Lagrangian; equal letters are bound to the same one."""
        number, _, _, factors = _ROW.fullmatch(self.text).groups()
        scale = Fraction(number or 1) * (-1 if self.kind == "potential" else 1)
        letters, left = [letter for letter, *_ in self.loops], list(bound)
        orders = []
        for group in self.groups:
            own = tuple(left.pop(0) for _ in group.replace("^", ""))
            swapped = [(own, 1), (own[::-1], -1)]
            orders.append(swapped if "^" in group else [(one, 1) for one in sorted({*itertools.permutations(own)})])
        result: Polynomial = {}
        for chosen in itertools.product(*orders):
            names = dict(zip(letters, itertools.chain(*(order for order, _ in chosen))))
            key = tuple(sorted(f"{one[0]}_{names[one[2]]}" for one in factors.split()))
            result[key] = result.get(key, 0) + scale * math.prod(sign for _, sign in chosen)
        return result


@dataclass(frozen=True)
class Part:
    """What is added to a row of the equations, or to the derivative of one: a source times a factor.

    Row and column are letters, `ANY` for every theta; there is no column in the equations themselves. The source is the
    ``value`` of the entry, ``drift``, its rate T', or ``slopes``, its derivatives; the order says with which of q, v
    and a it is the derivative.
    """

    row: str
    column: str
    source: str
    factor: Polynomial
    order: str = ""


def equations(term: Term, bound: Sequence[str]) -> Iterator[Part]:
    p = term.factor_of(bound)
    for x in dict.fromkeys(bound):
        if term.kind == "dissipation":
            yield Part(x, "", "value", derivative(p, f"u_{x}"))
            continue
        momentum = derivative(p, f"v_{x}")
        yield Part(x, "", "value", total((1, in_time(momentum)), (-1, derivative(p, f"q_{x}"))))
        yield Part(x, "", "drift", momentum)
    if term.kind not in ("dissipation", "force"):
        yield Part(ANY, "", "slopes", total((-1, p)))


def tangents(term: Term, bound: Sequence[str]) -> Iterator[Part]:
    """Yield what an entry adds to the derivatives of the equations, but for its own second derivatives."""
    for part in equations(term, bound):
        for x, symbol in itertools.product(dict.fromkeys(bound), "qvau"):
            if symbol != "q" or x not in THETA:
                found = derivative(part.factor, f"{symbol}_{x}")
                yield replace(part, column=x, factor=found, order=symbol.replace("u", "v"))
        if term.kind not in ("dissipation", "force") and part.source != "slopes":
            yield replace(part, column=ANY, source="slopes", order="v" if part.source == "drift" else "q")


def derivative(p: Polynomial, factor: str) -> Polynomial:
    result: Polynomial = {}
    for factors, number in p.items():
        if factor in factors:
            first = factors.index(factor)
            rest = factors[:first] + factors[first + 1 :]
            result[rest] = result.get(rest, 0) + number * factors.count(factor)
    return result


def in_time(p: Polynomial) -> Polynomial:
    result: Polynomial = {}
    for factors, number in p.items():
        for k, one in enumerate(factors):
            later = tuple(sorted([*factors[:k], {"q": "v", "v": "a"}[one[0]] + one[1:], *factors[k + 1 :]]))
            result[later] = result.get(later, 0) + number
    return result


def total(*parts: tuple[Fraction | int, Polynomial], by: Sequence[str] = ()) -> Polynomial:
    """Return a sum of polynomials with numbers and, if given, a product of factors."""
    result: Polynomial = {}
    for scale, p in parts:
        for factors, number in p.items():
            key = tuple(sorted([*factors, *by]))
            result[key] = result.get(key, 0) + scale * number
    return {factors: number for factors, number in result.items() if number}


@dataclass(frozen=True)
class Target:
    """Where something is added: an array and a place in what is printed.

    For derivatives with all theta the place is the first one, and the stride from one to the next; empty for one
    number.
    """

    array: str
    place: str
    stride: str = ""


@dataclass(frozen=True)
class _Sum:
    """A multiple of a number or, for a target with a stride or if `drifting`, of numbers for all theta; `fresh` in a
    condition that is to hold."""

    target: Target
    source: str
    drifting: bool
    factor: Polynomial
    fresh: str


#: Gives targets, factors and the condition of what an entry adds.
Outputs = Callable[[Term, Sequence[str]], Iterable[tuple[Target, str, Polynomial, str]]]


@dataclass
class Loops:
    """Prints loops over the entries of tables.

    Outputs are what each entry adds: target, source, factor, and in which condition, of `Term.only`. Entries are texts
    by table that take up the value of an entry and its derivatives, of its place `{}`: two, or one that gives both at
    once. The first loops fill `first`, in place of adding to it; `read` takes up a coordinate, of its array and place,
    and `add`, if given, adds a number where there are no vectors.
    """

    outputs: Outputs
    entries: dict[str, tuple[str, str] | str]
    conditions: dict[str, str]
    first: str = ""
    read: str = "load({}, {})"
    add: str = ""

    def lines(self, terms: Sequence[Term]) -> Iterator[str]:
        """Yield the loops; ``let`` begins what C declares as a number, ``all`` as one for every theta."""
        for only, group in itertools.groupby(terms, lambda term: term.only):
            self._number = 0
            lines = self._level([_State(term) for term in group], "")[0]
            yield from _under(self.conditions[only] if only else "", list(lines))
            if any(f"store({self.first}," in line for line in lines):
                self.first = ""

    def _name(self, letter: str) -> str:
        self._number += 1
        return f"{letter}{self._number}"

    def _level(self, states: Sequence[_State], letter: str) -> tuple[list[str], list[_Sum]]:
        """Return what is done within the loop of a letter, and what is left to add up around it."""
        lines: list[str] = []
        found: list[_Sum] = []
        for loop, own in itertools.groupby(states, lambda state: state.loop):
            own = list(own)
            if loop is None:
                parts = [self._entry(state) for state in own]
            else:
                name, before, may_equal = loop
                parts = [self._loop([state.bind(name) for state in own], name, before or COUNTS[name])]
                if before and may_equal:
                    parts += [self._level([state.bind(before) for state in own], ANY)]
            lines += [line for part, _ in parts for line in part]
            found += [one for _, sums in parts for one in sums]
        if letter == ANY:
            return lines, found
        inside = [one for one in found if not letter or re.search(rf"\b{letter}\b", one.target.place)]
        lines += self._added(inside, letter)
        return lines, [one for one in found if one not in inside]

    def _loop(self, states: Sequence[_State], letter: str, count: str) -> tuple[list[str], list[_Sum]]:
        body, found = self._level(states, letter)
        if not body and not found:
            return [], []
        uses: dict[tuple[str, bool, tuple[str, ...]], dict] = {}
        for one in found:
            several = one.drifting or bool(one.target.stride)
            for factors, number in one.factor.items():
                inner = tuple(factor for factor in factors if factor.endswith(f"_{letter}"))
                outer = tuple(factor for factor in factors if factor not in inner)
                use = uses.setdefault((one.source, several, inner), {})
                key = one.target, one.drifting, outer, one.fresh
                use[key] = use.get(key, 0) + number
        # what is used in the same way, but for a number, is one sum
        sums: dict[tuple, list[tuple[str, tuple[str, ...], Fraction]]] = {}
        for (source, several, inner), use in uses.items():
            scale = use[min(use, key=str)]
            same = several, frozenset((key, number / scale) for key, number in use.items())
            sums.setdefault(same, []).append((source, inner, scale))
        begin, left = [], []
        for (several, use), parts in sums.items():
            name, whole = self._name("t" if several else "s"), parts[0][2]
            parts = [(source, {inner: scale / whole}) for source, inner, scale in parts]
            fresh = next(iter(conditions)) if len(conditions := {key[3] for key, _ in use}) == 1 else ""
            begin.append(f"all {name} = zeros(place)" if several else f"let {name} = spread(0.0)")
            if several:
                more = [f"{name} = add_product({name}, {source}, {_multiple(p)})" for source, p in parts]
            else:
                more = [f"{name} = {' + '.join([name, *(_product(source, p) for source, p in parts)])}"]
            body += _under(fresh, more)
            by_target: dict[tuple, Polynomial] = {}
            for (target, drifting, outer, condition), number in sorted(use, key=str):
                by_target.setdefault((target, drifting, condition), {})[outer] = number * whole
            left += [_Sum(target, name, drifting, p, own) for (target, drifting, own), p in by_target.items()]
        used = sorted({one for line in body for one in re.findall(rf"\b([qvau])_{letter}\b", line)})
        loads = [f"let {one}_{letter} = {self.read.format(ARRAYS[one], at(letter))}" for one in used]
        return [*begin, f"for {letter} in range({count}):", *indented([*loads, *body])], left

    def _entry(self, state: _State) -> tuple[list[str], list[_Sum]]:
        """Return what takes up an entry, and what it adds."""
        term, bound = state.term, state.bound
        value, slopes = self._name("x"), self._name("y")
        found = []
        for target, source, factor, fresh in self.outputs(term, bound):
            if factor:
                drifting = source == "drift"
                found.append(_Sum(target, value if source == "value" else slopes, drifting, factor, fresh))
        taken = [one for one in (value, slopes) if one in {one.source for one in found}]
        texts, both = self._taken_up(term, bound)
        if both and len(taken) == 2:
            lines = [f"{value}, {slopes} = {both}"]
        else:
            lines = [f"{'let' if one == value else 'all'} {one} = {texts[one != value]}" for one in taken]
        if term.less and any(factor for _, _, factor, _ in self.outputs(term.less, bound)):
            (own, slope), _ = self._taken_up(term.less, bound)
            off = [f"{value} = {value} - {own}", f"{slopes} = add_product({slopes}, {slope}, spread(-1.0))"]
            lines += _under(self.conditions[term.less.only], [off[one != value] for one in taken])
        return lines, found

    def _taken_up(self, term: Term, bound: Sequence[str]) -> tuple[tuple[str, str], str]:
        """Return what gives the value of an entry and its derivatives, and, if there is, what gives both at once."""
        letters = [letter for letter, *_ in term.loops]
        place = re.sub(r"\b[a-z]\b", lambda one: dict(zip(letters, bound)).get(one[0], one[0]), term.place)
        texts = self.entries[term.table]
        if isinstance(texts, str):
            both = texts.format(place)
            return (f"{both}[0]", f"{both}[1]"), both
        return (texts[0].format(place), texts[1].format(place)), ""

    def _added(self, sums: Sequence[_Sum], letter: str) -> list[str]:
        """Return what adds sums to their targets."""
        lines: dict[str, list[str]] = {}
        by_target: dict[tuple[Target, str], list[_Sum]] = {}
        for one in sums:
            by_target.setdefault((one.target, one.fresh), []).append(one)
        for (target, fresh), own in by_target.items():
            by_source: dict[tuple[str, bool], Polynomial] = {}
            for one in own:
                key = one.source, one.drifting
                by_source[key] = total((1, by_source.get(key, {})), (1, one.factor))
            into = lines.setdefault(fresh, [])
            if target.stride:
                into += [
                    f"add_to_rows({target.array}, {target.place}, {target.stride}, {source}, {_multiple(p, letter)})"
                    for (source, _), p in by_source.items()
                ]
                continue
            products = [
                (f"dot({source}, velocity)" if drifting else source, p) for (source, drifting), p in by_source.items()
            ]
            if target.array == self.first or self.add:
                text = " + ".join(_product(source, p, letter) for source, p in products)
                into.append((self.add or "store({}, {}, {})").format(target.array, target.place, text))
                continue
            for source, p in products:
                factor = _text(p, letter)
                into.append(
                    f"add({target.array}, {target.place}, {source})" if factor == "1.0"
                    else f"add_to_row({target.array}, {target.place}, {source}, {factor})"
                )  # fmt: skip
        return [line for fresh, own in sorted(lines.items()) for line in _under(fresh, own)]


@dataclass(frozen=True)
class _State:
    """A term of which some letters are bound."""

    term: Term
    bound: tuple[str, ...] = ()

    @property
    def loop(self) -> tuple[str, str, bool] | None:
        """The next letter, the one that it follows, if any, and whether it may be equal to that; None behind all."""
        if len(self.bound) == len(self.term.loops):
            return None
        letter, follows, may_equal = self.term.loops[len(self.bound)]
        return letter, self.bound[-1] if follows else "", may_equal

    def bind(self, letter: str) -> _State:
        return replace(self, bound=(*self.bound, letter))


def _product(source: str, p: Polynomial, letter: str = "") -> str:
    text = _text(p, letter)
    if text in ("1.0", "-1.0"):
        return source if text == "1.0" else f"-{source}"
    single = re.fullmatch(r"[\w.]+", text)
    return f"{source} * {text if single else f'({text})'}"


def _multiple(p: Polynomial, letter: str = "") -> str:
    """Return a polynomial of which numbers for all theta are a multiple."""
    return _text(p, letter) if any(p) else f"spread({_text(p)})"


def _text(p: Polynomial, letter: str = "") -> str:
    """Return a polynomial; what does not depend on a letter stands together, and is evaluated before its loop."""
    by_inner: dict[tuple[str, ...], Polynomial] = {}
    for factors, number in sorted(p.items()):
        inner = tuple(factor for factor in factors if factor.endswith(f"_{letter}"))
        by_inner.setdefault(inner, {})[tuple(factor for factor in factors if factor not in inner)] = number
    return " + ".join(_monomials(inner, outer) for inner, outer in by_inner.items())


def _monomials(inner: Sequence[str], outer: Polynomial) -> str:
    parts = [" * ".join([*([] if number == 1 and f else [repr(float(number))]), *f]) for f, number in outer.items()]
    text = " + ".join(parts)
    if not inner:
        return text
    if text == "1.0":
        return " * ".join(inner)
    return f"{' * '.join(inner)} * ({text})"


def _under(condition: str, lines: list[str]) -> list[str]:
    return [f"if {condition}:", *indented(lines)] if condition and lines else lines


def indented(lines: Iterable[str]) -> list[str]:
    return [f"    {line}" for line in lines]


def in_python(lines: Iterable[str]) -> Iterator[str]:
    """Return lines as `Loops.lines` has them in Python."""
    return (re.sub(r"^( *)(let|all) ", r"\1", line) for line in lines)


def in_c(lines: Iterable[str]) -> Iterator[str]:
    """Yield the same lines in C."""
    open_at: list[int] = []
    for line in [*lines, ""]:
        text = line.strip()
        depth = len(line) - len(text)
        while open_at and depth <= open_at[-1]:
            yield " " * open_at.pop() + "}"
        if loop := re.match(r"for (\w+) in range\((.*)\):$", text):
            text = f"for (int {loop[1]} = 0; {loop[1]} < {loop[2]}; {loop[1]}++) {{"
        elif text.startswith("if "):
            text = f"if ({text[3:-1].replace(' and ', ' && ')}) {{"
        elif text:
            text = re.sub(r"^let ", "double ", re.sub(r"^all ", "struct slopes ", text)) + ";"
        text = text.replace("//", "/")
        if text.endswith("{"):
            open_at.append(depth)
        if text:
            yield " " * depth + text
