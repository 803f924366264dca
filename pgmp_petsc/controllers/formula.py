"""Controllers by formulas: rates of states and a force, of measures, a reference and the time.

Motors with inductance, bristles of friction and filters are such, as well as control laws. Formulas are parsed and
never evaluated (`declare.formulas`), and written anew as a `ControlLaw`. A comparison is 1 where it holds, else 0;
slopes leave out its jump, and steps do not end there.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from functools import cache
from typing import Annotated, Literal

from pydantic import Field

from pgmp_petsc.controllers.acting import JointController
from pgmp_petsc.controllers.law import ControlLaw
from pgmp_petsc.declare.formulas import ALLOWED, FormulaError, declared, jumps_with, why_no_name
from pgmp_petsc.outputs.readings import OfMotion
from pgmp_petsc.scene.controllers import OWN
from pgmp_petsc.scene.fields import NumberOrParameter, Unit, refusal
from pgmp_petsc.scene.uses import Use

#: Names in a formula, and what they are in a law: of any, and of the measure where there is one without a name.
GIVEN = {"r": "r", "t": "t"}
OF_ONE = {"y": "y", "v": "rate"}


@cache
def law_of(
    states: tuple[tuple[str, str], ...], force: str, constants: tuple[str, ...], starts: tuple[str, ...],
    measures: tuple[str, ...],
) -> ControlLaw:  # fmt: skip
    """Return the law of formulas in the language of declarations; one for all controllers with the same."""
    mark = hashlib.sha256(repr((states, force, constants, starts, measures)).encode()).hexdigest()[:12]
    begins = {_own(state): _start(state) for state in starts}
    measured = tuple((name, OfMotion(k)) for k, name in enumerate(measures))
    return ControlLaw(
        f"formula_{mark}", (*map(_own, constants), *begins.values()), dict(states), force, begins, measured,
        "y" if measures == ("y",) else "", len(measures),
    )  # fmt: skip


def _own(name: str) -> str:
    """Return what a state or constant is called in a law."""
    return f"{OWN}{name}"


def _start(state: str) -> str:
    return f"start_of_{state}"


class FormulaController(JointController):
    """A torque or force in a joint by formulas, with states of its own: a motor, a bristle of friction, a control
    law."""

    type: Literal["formula"]
    measures: str | dict[str, str] = Field(
        description="name of the output that it measures, y in the formulas; or { name = output } for several, each by "
        "a name of its own"
    )
    states: dict[str, str] = Field(
        {},
        description="names of states, with formulas of their rates: of the measure y and its rate v, or of measures by "
        f"their names, of the reference r, the time t, states and `constants`; {ALLOWED}",
    )
    output: str = Field(description="formula of the torque (N m) or force (N), of the same")
    constants: dict[str, Annotated[NumberOrParameter, Unit()]] = Field(
        {}, description="names in the formulas, each a number or a parameter's name"
    )
    initial: dict[str, Annotated[NumberOrParameter, Unit()]] = Field(
        {}, description="states at the start, each a number or a parameter's name; 0 where they are not given"
    )

    def check_entries(self) -> None:
        named, taken = self._named, set()
        if not isinstance(self.measures, str) and not named:
            raise refusal("give the name of an output, or { name = output }", "measures")
        for key, names in (("measures", named), ("states", self.states), ("constants", self.constants)):
            for name in names:
                if why := why_no_name(name, self._given):
                    raise refusal(why, key)
                if name in taken:
                    raise refusal(f"'{name}' is the name of something else here already; take another one", key)
                taken.add(name)
        strange = [name for name in self.initial if name not in self.states]
        if strange:
            raise refusal(f"there is no state '{strange[0]}'; known: {', '.join(self.states) or 'none'}", "initial")
        used: set[str] = set()
        for key, what, text in (
            *(("states", f"{k}: ", v) for k, v in self.states.items()),
            ("output", "", self.output),
        ):
            try:
                used |= self._declared(text)[1]
            except FormulaError as error:
                raise refusal(f"{what}{error}", key) from None
        for key, names in (("measures", named), ("constants", self.constants)):
            unused = [name for name in names if name not in used]
            if unused:
                raise refusal(f"no formula names '{unused[0]}'; leave it out", key)

    def jumps_within(self, step: float) -> bool:
        """Return whether its reference does, or a formula has a comparison or a sign."""
        formulas = not self.sample_time and any(map(jumps_with, (*self.states.values(), self.output)))
        return formulas or super().jumps_within(step)

    @property
    def _named(self) -> dict[str, str]:
        """Outputs by the names that the scene gives them here."""
        return {} if isinstance(self.measures, str) else self.measures

    @property
    def measured(self) -> dict[str, str]:
        """The outputs that it measures, by their names in the law."""
        return {_own(name): output for name, output in self._named.items()} or {"y": self.measures}

    @property
    def _given(self) -> dict[str, str]:
        """The names that formulas have by themselves, and what they are in the law."""
        return GIVEN if self._named else OF_ONE | GIVEN

    def _declared(self, text: str) -> tuple[str, set[str]]:
        """Return a formula as the law has it, and the names in it."""
        known = self._given | {name: _own(name) for name in (*self._named, *self.states, *self.constants)}
        words = f"{', '.join((*self._given, *self._named))}, the names of `states` and `constants`"
        return declared(text, known, words)

    def law(self) -> ControlLaw:
        states = tuple((_own(name), self._declared(text)[0]) for name, text in self.states.items())
        force, constants, starts = self._declared(self.output)[0], (*self.constants,), (*self.initial,)
        return law_of(states, force, constants, starts, (*self.measured,))

    def parameters(self) -> dict[str, float | str]:
        begins = {_start(name): value for name, value in self.initial.items()}
        return {_own(name): value for name, value in self.constants.items()} | begins

    def uses(self, entry: str) -> Iterator[Use]:
        """Yield constants and first states, which may be of any unit, and what all controllers have."""
        yield from super().uses(entry)
        for key in ("constants", "initial"):
            for name, value in getattr(self, key).items():
                yield Use(f"{entry}.{key}.{name}", value)
