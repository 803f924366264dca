"""The variables of a functional mock-up unit, whichever version of FMI describes them."""

from __future__ import annotations

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
    """

    name: str
    reference: int
    kind: str
    causality: str
    variability: str
    about: str
    start: str = ""
    derivative_of: int | None = None

    @property
    def is_state(self) -> bool:
        """Whether it is a continuous state."""
        return STATES <= self.reference < DERIVATIVES


def variables_of(constants: Constants) -> list[Variable]:
    """Return the variables of a model, the independent one left out."""
    # values are in SI units; a scene's own unit is one of its numbers only
    found = [
        Variable(f"parameters.{name}", PARAMETERS + k, REAL, "parameter", "tunable", "SI units", repr(float(value)))
        for k, (name, value) in enumerate(constants.parameters.items())
    ]
    for k, name in enumerate(constants.strengths):
        about = "strength at the end of a step, N or N m, where it does not follow the scene"
        found.append(Variable(f"effects.{name}", STRENGTHS + k, REAL, "input", "continuous", about, "0.0"))
        about = "whether the strength is the scene's over time, and the input is not looked at"
        found.append(
            Variable(f"effects.{name}_follows_scene", FOLLOWS + k, BOOLEAN, "parameter", "tunable", about, "true")
        )
    for k, name in enumerate(constants.outputs):
        about = f"in {constants.output_units[name]}"
        found.append(Variable(f"outputs.{name}", OUTPUTS + k, REAL, "output", "continuous", about))
    about = "largest rotation of a node less that of its rigid body, rad"
    found.append(Variable("elastic_rotation", ELASTIC_ROTATION, REAL, "output", "continuous", about))
    about = (
        "what Newton's iteration left in the last step, estimated, in units of the mechanism's size or of 1 rad; 0 in "
        "model exchange"
    )
    found.append(Variable("correction", CORRECTION, REAL, "output", "continuous", about))
    found.append(Variable("validity", VALIDITY, WHOLE, "output", "discrete", FLAGS))
    found.append(Variable("valid", VALID, BOOLEAN, "output", "discrete", "whether validity is 0"))
    return [*found, *_states(constants)]


def _states(constants: Constants) -> list[Variable]:
    """Return the states of model exchange, positions and rates of what is free, and their derivatives."""
    free, found = constants.free, []
    names = [*(f"states.{name}" for name in free), *(f"rates.{name}" for name in free)]
    for k, name in enumerate(names):
        about = "rad or a modal coordinate" if k < len(free) else "rate of a state"
        found.append(Variable(name, STATES + k, REAL, "local", "continuous", about))
    for k, name in enumerate(names):
        about, state = "derivative of a state", STATES + k
        found.append(Variable(f"der({name})", DERIVATIVES + k, REAL, "local", "continuous", about, derivative_of=state))
    return found
