"""Controllers by formulas: rates of states and a force, of a measure, its rate, a reference and the time.

Motors with inductance, bristles of friction and filters are such, as well as control laws. Formulas are parsed and
never evaluated (`declare.formulas`), and written anew as a `ControlLaw`. A comparison is 1 where it holds, else 0;
slopes leave out its jump, and steps do not end there.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from functools import cache
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from pgmp_petsc.controllers.acting import JointController
from pgmp_petsc.controllers.law import ControlLaw
from pgmp_petsc.declare.formulas import FUNCTIONS, FormulaError, declared
from pgmp_petsc.scene.fields import NumberOrParameter, Unit, refusal
from pgmp_petsc.scene.uses import Use

#: Names of what is measured in a formula, and what they are in a law.
GIVEN = {"y": "y", "v": "rate", "r": "r", "t": "t"}
WORDS = f"{', '.join(GIVEN)}, the names of `states` and `constants`"


@cache
def law_of(
    states: tuple[tuple[str, str], ...], force: str, constants: tuple[str, ...], starts: tuple[str, ...]
) -> ControlLaw:
    """Return the law of formulas in the language of declarations; one for all controllers with the same."""
    mark = hashlib.sha256(repr((states, force, constants, starts)).encode()).hexdigest()[:12]
    begins = {_own(state): _start(state) for state in starts}
    return ControlLaw(f"formula_{mark}", (*map(_own, constants), *begins.values()), dict(states), force, begins)


def _own(name: str) -> str:
    """Return what a state or constant is called in a law."""
    return f"of_{name}"


def _start(state: str) -> str:
    return f"start_of_{state}"


class FormulaController(JointController):
    """What acts in a joint by formulas, with states of its own: a motor, a bristle of friction, a control law."""

    type: Literal["formula"]
    states: dict[str, str] = Field(
        {},
        description="names of states, with formulas of their rates: of the measure y, its rate v, the reference r, the "
        "time t (s), states and `constants`; + - * / **, comparisons (1 or 0), sin cos tan exp log sqrt abs tanh sign "
        "min max atan2 where",
    )
    output: str = Field(description="formula of the torque (N m) or force (N), of the same")
    constants: dict[str, Annotated[NumberOrParameter, Unit()]] = Field(
        {}, description="names in the formulas, each a number or a parameter's name"
    )
    initial: dict[str, Annotated[NumberOrParameter, Unit()]] = Field(
        {}, description="states at the start, each a number or a parameter's name; 0 where they are not given"
    )

    @model_validator(mode="after")
    def _are_formulas(self) -> Self:
        for key, names in (("states", self.states), ("constants", self.constants)):
            for name in names:
                if not (name.isidentifier() and name.isascii()) or name in GIVEN or name in FUNCTIONS:
                    raise refusal(
                        f"'{name}' cannot be a name in a formula: take letters, digits and _, and no name that it has",
                        key,
                    )
        both = sorted({*self.states} & {*self.constants})
        if both:
            raise refusal(f"'{both[0]}' is a state and a constant; take another name", "constants")
        strange = [name for name in self.initial if name not in self.states]
        if strange:
            raise refusal(f"there is no state '{strange[0]}'; known: {', '.join(self.states) or 'none'}", "initial")
        used: set[str] = set()
        for key, what, text in (
            *(("states", f"{k}: ", v) for k, v in self.states.items()),
            ("output", "", self.output),
        ):
            try:
                used |= declared(text, self._known, WORDS)[1]
            except FormulaError as error:
                raise refusal(f"{what}{error}", key) from None
        unused = [name for name in self.constants if name not in used]
        if unused:
            raise refusal(f"no formula names '{unused[0]}'; leave it out", "constants")
        return self

    @property
    def _known(self) -> dict[str, str]:
        """The names of the formulas, and what they are in the law."""
        return GIVEN | {name: _own(name) for name in (*self.states, *self.constants)}

    @property
    def needs_rate(self) -> bool:
        """Whether a formula names the rate of the measure."""
        return any("v" in declared(text, self._known, WORDS)[1] for text in (*self.states.values(), self.output))

    def law(self) -> ControlLaw:
        """Return its law."""
        states = tuple((_own(name), declared(text, self._known, WORDS)[0]) for name, text in self.states.items())
        return law_of(states, declared(self.output, self._known, WORDS)[0], (*self.constants,), (*self.initial,))

    def parameters(self) -> dict[str, float | str]:
        """Return the constants, and what states begin with."""
        begins = {_start(name): value for name, value in self.initial.items()}
        return {_own(name): value for name, value in self.constants.items()} | begins

    def uses(self, entry: str) -> Iterator[Use]:
        """Yield constants and first states, which may be of any unit, and what all controllers have."""
        yield from super().uses(entry)
        for key in ("constants", "initial"):
            for name, value in getattr(self, key).items():
                yield Use(f"{entry}.{key}.{name}", value, "any", ())
