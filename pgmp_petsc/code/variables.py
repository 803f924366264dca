"""The variables of a functional mock-up unit, whichever version of FMI describes them."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from pgmp_petsc.code.constants import Constants

# value references, as in unit.h
BLOCK = 1_000_000
PARAMETERS, STRENGTHS, OUTPUTS, FOLLOWS, STATES, DERIVATIVES = (k * BLOCK for k in (0, 1, 2, 4, 5, 6))
ELASTIC_ROTATION, CORRECTION, VALIDITY, VALID, TIME = range(3 * BLOCK, 3 * BLOCK + 5)
REAL, WHOLE, BOOLEAN = "real", "whole", "Boolean"
FLAGS = (
    "0 is fine, else a sum: 1 elastic rotation beyond its limit, 2 a coordinate outside the tables, 4 a step that "
    "failed and was not taken, 8 no finite number, 16 a parameter outside what the model was built for"
)


@dataclass(frozen=True)
class Variable:
    """A variable: name, value reference, kind (`REAL`, `WHOLE`, `BOOLEAN`), what FMI says of it, and a description.

    Attributes
    ----------
    start
        Value at the start, of what can be set.
    derivative_of
        Reference of the state whose derivative it is.
    unit
        SI unit, empty where there is none.
    low, high
        Ends of the range that it is in, or that the model was built for; infinite where there are none.
    """

    name: str
    reference: int
    kind: str
    causality: str
    variability: str
    about: str
    start: str = ""
    derivative_of: int | None = None
    unit: str = ""
    low: float = -math.inf
    high: float = math.inf

    @property
    def is_state(self) -> bool:
        """Whether it is a continuous state."""
        return STATES <= self.reference < DERIVATIVES


def quoted(name: str) -> str:
    """Return a name as structured names of FMI have it: one that is no identifier in quotes."""
    return name if re.fullmatch(r"[A-Za-z_]\w*", name, flags=re.ASCII) else f"'{name}'"


def variables_of(constants: Constants) -> list[Variable]:
    """Return the variables of a model, the independent one left out."""
    # values are in SI units; a scene's own unit is one of its numbers only
    found = []
    for k, (name, value) in enumerate(constants.parameters.items()):
        served, unit = constants.served.get(name), constants.parameter_units[name]
        low, high = (-math.inf, math.inf) if served is None else (min(served.low, value), max(served.high, value))
        about = "SI units" if served is None else "SI units; from min to max the model was built for"
        setting = "parameter", "tunable", about, repr(float(value)), None
        found.append(Variable(f"parameters.{quoted(name)}", PARAMETERS + k, REAL, *setting, unit, low, high))
    for k, (name, unit) in enumerate(constants.strength_units.items()):
        about = "strength at the end of a step, where it does not follow the scene"
        setting = "input", "continuous", about, "0.0", None
        found.append(Variable(f"effects.{quoted(name)}", STRENGTHS + k, REAL, *setting, unit))
        about = "whether the strength is the scene's over time, and the input is not looked at"
        follows = f"effects.{quoted(f'{name}_follows_scene')}"
        found.append(Variable(follows, FOLLOWS + k, BOOLEAN, "parameter", "tunable", about, "true"))
    for k, name in enumerate(constants.outputs):
        unit = constants.output_units[name]
        found.append(
            Variable(f"outputs.{quoted(name)}", OUTPUTS + k, REAL, "output", "continuous", f"in {unit}", unit=unit)
        )
    about = "largest rotation of a node less that of its rigid body"
    found.append(
        Variable("elastic_rotation", ELASTIC_ROTATION, REAL, "output", "continuous", about, unit="rad", low=0.0)
    )
    about = (
        "what Newton's iteration left in the last step, estimated, in units of the mechanism's size or of 1 rad; 0 in "
        "model exchange"
    )
    found.append(Variable("correction", CORRECTION, REAL, "output", "continuous", about, unit="1", low=0.0))
    found.append(Variable("validity", VALIDITY, WHOLE, "output", "discrete", FLAGS, low=0, high=31))
    found.append(Variable("valid", VALID, BOOLEAN, "output", "discrete", "whether validity is 0"))
    return [*found, *_states(constants)]


def _states(constants: Constants) -> list[Variable]:
    """Return the states of model exchange, positions and rates of what is free, and their derivatives."""
    free, found = constants.free, []
    n_rigid = len(free) - constants.settings["M"]
    inside = [*map(quoted, free[:n_rigid]), *free[n_rigid:]]
    names = [*(f"states.{name}" for name in inside), *(f"rates.{name}" for name in inside)]
    # modal coordinates have units of their own
    units = [unit if k < n_rigid else "" for unit in ("rad", "rad/s", "rad/s2") for k in range(len(free))]
    for k, name in enumerate(names):
        about = "rad or a modal coordinate" if k < len(free) else "rate of a state"
        found.append(Variable(name, STATES + k, REAL, "local", "continuous", about, unit=units[k]))
    for k, name in enumerate(names):
        about, setting = "derivative of a state", (REAL, "local", "continuous")
        unit = units[k + len(free)]
        found.append(Variable(f"der({name})", DERIVATIVES + k, *setting, about, "", STATES + k, unit))
    return found
