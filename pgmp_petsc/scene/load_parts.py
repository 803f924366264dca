"""Loads whose values over time name parameters, as several loads: numbers, and one for each parameter.

A function of time whose values are numbers or parameters is affine in the parameters,

    f(t, p) = f_0(t) + sum_k p_k f_k(t),

where f_0 has the numbers with zeros in place of the names, and f_k ones where p_k is named and zeros elsewhere. Each
is a load of its own with a function that holds numbers alone, and p_k for its `scale`: what models, samples and
derivatives know of loads holds for it as it is.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from pgmp_petsc.scene.effects import Effect, Force, Torque
from pgmp_petsc.scene.messages import problem

if TYPE_CHECKING:
    from pgmp_petsc.scene.schema import Scene

HARMONIC = ("amplitude", "mean")


def parts_of(name: str, effect: Effect) -> dict[str, Effect]:
    """Return the loads that an effect is made of; any other effect as it is.

    Several are named after the effect and their parameters, ``NAME_PARAMETER``; the one of numbers has the effect's
    name, and so has one that is alone.
    """
    if not isinstance(effect, (Torque, Force)):
        return {name: effect}
    parameters = effect.parameters_over_time
    if not parameters:
        return {name: effect}
    parts: dict[str, Effect] = {} if _is_zero(effect) else {name: _part(effect, None)}
    for parameter in parameters:
        parts[_own_name(name, parameter)] = _part(effect, parameter)
    return parts if len(parts) > 1 else {name: next(iter(parts.values()))}


def part_problems(scene: Scene) -> Iterator[str]:
    """Yield a line for each effect that has the name of a part of another one."""
    for name, effect in scene.effects.items():
        for part in parts_of(name, effect):
            if part != name and part in scene.effects:
                yield problem(f"effects.{part}", f"a part of effects.{name} has this name; give it another one")


def _own_name(name: str, parameter: str) -> str:
    return f"{name}_{parameter}"


def _is_zero(effect: Torque | Force) -> bool:
    """Return whether all values that are numbers are zero."""
    return not any(value for _, value in effect.values_over_time if not isinstance(value, str))


def _part(effect: Torque | Force, parameter: str | None) -> Torque | Force:
    """Return the load of one parameter, or of the numbers."""

    def value_of(value: float | str) -> float:
        if parameter is None:
            return 0.0 if isinstance(value, str) else value
        return effect.scale if value == parameter else 0.0

    if effect.harmonic is not None:
        values = {key: value_of(getattr(effect.harmonic, key)) for key in HARMONIC}
        changed = {"harmonic": effect.harmonic.model_copy(update=values)}
    else:
        changed = {"table": tuple((time, value_of(value)) for time, value in effect.table)}
    return effect.model_copy(update=changed | ({} if parameter is None else {"scale": parameter}))
