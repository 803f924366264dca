"""Proportional, integral and derivative control, with a filter and limits.

With the error e = r - y, ``u = p e + i int e dt + d e_f'``, where e_f follows e with the time constant of the filter,
``filter e_f' = e - e_f``, and begins with e: the error is as if it had been there before the run. Without a filter the
derivative is that of the error itself, from the rate of the measure. Beyond the limits the integral is led back
(back-calculation, Astrom and Hagglund 1995, section 3.5): its rate is ``i e + (u_limited - u) / tracking``.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import Annotated, Literal

from pydantic import Field

from pgmp_petsc.controllers.acting import JointController
from pgmp_petsc.controllers.law import ControlLaw
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.fields import NotNegativeOrParameter, NumberOrParameter, PositiveOrParameter, Table, Unit
from pgmp_petsc.scene.messages import problem
from pgmp_petsc.scene.outputs import unit_of
from pgmp_petsc.scene.uses import Use

#: How the integral is led back from limits, by what leads it.
BACK = {"nothing": "", "ratio": " + (limited - free) * i / p", "tracking": " + (limited - free) / tracking"}


@cache
def law_of(filtered: bool, back: str) -> ControlLaw:
    """Return the law with or without a filter, by what leads the integral back (`BACK`)."""
    parameters, states = ("p", "i", "d"), {"sum": f"i * (r - y){BACK[back]}"}
    parameters += ("tracking",) if back == "tracking" else ()
    if not filtered:
        return ControlLaw(f"pid_{back}", parameters, states, force="p * (r - y) + sum + d * (reference_rate - rate)")
    return ControlLaw(
        f"pid_filtered_{back}",
        (*parameters, "filter"),
        states | {"smooth": "(r - y - smooth) / filter"},
        force="p * (r - y) + sum + d * (r - y - smooth) / filter",
        starts={"smooth": "r - y"},
    )


class Gains(Table):
    """Factors of the parts of the error, each a number or a parameter's name."""

    p: NumberOrParameter = Field(0.0, description="force by the error")
    i: NumberOrParameter = Field(0.0, description="force by the integral of the error over time")
    d: NumberOrParameter = Field(0.0, description="force by the rate of the error")
    filter: Annotated[NotNegativeOrParameter, Unit("s")] = Field(
        0.0, description="time constant (s) of the filter of the rate; 0 is none"
    )


class Pid(JointController):
    """A controller with a part by the error, one by its integral and one by its rate."""

    type: Literal["pid"]
    gains: Gains = Field(description="{ p, i, d, filter }, each a number or a parameter's name")
    tracking: Annotated[PositiveOrParameter | None, Unit("s")] = Field(
        None,
        description="with limits: time (s) in which the integral is led back to them (back-calculation); p / i if it "
        "is left out",
    )

    @property
    def filtered(self) -> bool:
        return self.gains.filter != 0.0

    @property
    def needs_rate(self) -> bool:
        return not self.filtered and self.gains.d != 0.0

    def law(self) -> ControlLaw:
        limited = self.limits is not None and self.gains.i != 0.0
        return law_of(self.filtered, ("ratio" if self.tracking is None else "tracking") if limited else "nothing")

    def parameters(self) -> dict[str, float | str]:
        return self.gains.model_dump() | ({} if self.tracking is None else {"tracking": self.tracking})

    def problems(self, scene: Scene, name: str) -> Iterator[str]:
        """Yield a line for gains that are none, and for an integral that nothing leads back from limits."""
        entry, gains = f"controllers.{name}", self.gains
        if not any((gains.p, gains.i, gains.d)):
            yield problem(f"{entry}.gains", "one of p, i and d other than 0 is needed", gains.model_dump())
        if self.tracking is not None and self.limits is None:
            yield problem(f"{entry}.tracking", "without limits there is nothing to be led back from; leave it out")
        named = [one for one in (gains.p, gains.i) if isinstance(one, str)]
        known = all(one in scene.parameters for one in named)
        if self.limits is None or self.tracking is not None or gains.i == 0.0 or not known:
            return
        for values in (scene.nominal, scene.values):
            p, i = scene.number(gains.p, values), scene.number(gains.i, values)
            if not p * i > 0.0 and not (p and not i):
                words = f"missing: without it p / i leads the integral back, and p is {p:g}, i {i:g}; give a time"
                yield problem(f"{entry}.tracking", words)
                return

    def references(self, scene: Scene, entry: str) -> Iterator[Use]:
        """Yield that a value of its reference is one of what it measures."""
        if unit := unit_of(scene, self.measures):
            yield Use(entry, units=(unit,))

    def uses(self, entry: str) -> Iterator[Use]:
        yield from super().uses(entry)
        for key in ("p", "i", "d"):
            yield Use(f"{entry}.gains.{key}", getattr(self.gains, key))
        yield Use(f"{entry}.gains.filter", self.gains.filter, "positive" if self.filtered else "not negative", ("s",))
        if self.tracking is not None:
            yield Use(f"{entry}.tracking", self.tracking, "positive", ("s",))
