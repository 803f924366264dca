"""What is strange about an entry of a scene."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from pgmp_petsc.scene.messages import problem

if TYPE_CHECKING:
    from pgmp_petsc.scene.schema import Scene


@dataclass(frozen=True)
class Finding:
    """One strange entry.

    Attributes
    ----------
    text
        Name of the entry, its value, what is strange about it and the cure.
    refused
        Whether it cannot be meant; otherwise it may be, and the scene is computed with a warning.
    """

    text: str
    refused: bool = False


def doubt(entry: str, reason: str, *received: object) -> Finding:
    """Return what probably is not meant; `received` is the entry's value, if it has one to show."""
    return Finding(problem(entry, reason, *received))


def refusal(entry: str, reason: str, *received: object) -> Finding:
    """Return what cannot be meant; `received` is the entry's value, if it has one to show."""
    return Finding(problem(entry, reason, *received), refused=True)


def named(scene: Scene, entry: str, value: float | str) -> tuple[str, float]:
    """Return the entry that a number is in, and the number: of a parameter's name, the parameter's own entry."""
    if not isinstance(value, str):
        return entry, value
    parameter = scene.parameters[value]
    return f"parameters.{value}.{'nominal' if parameter.value is None else 'value'}", parameter.current
