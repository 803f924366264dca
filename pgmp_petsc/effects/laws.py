"""The force laws of the program: objects `Law` that this module has; that of a plugin is another such object.

Friction is regularised, so that the force is smooth. A stop never pulls. Its damping is that of Hunt and Crossley
(1975): its force begins at zero, so that it is continuous at contact; side is 1 for an upper stop, -1 for a lower one.
"""

from __future__ import annotations

from pgmp_petsc.effects.law import Law

SOURCE = Law("source", ("scale",), force="amplitude * scale")

SPRING_DAMPER = Law(
    "spring_damper",
    ("k", "c", "rest"),
    potential="k * (s - rest)**2 / 2",
    force="elastic - c * rate",
    left_out="it is a damper, and modes are those of undamped vibrations",
)

FRICTION = Law(
    "friction",
    ("limit", "speed"),
    force="-limit * tanh(rate / speed)",
    about_zero="speed",
    left_out="it is friction, not linear and without stiffness",
)

CARRIED_FRICTION = Law(
    "carried_friction",
    ("load", "coefficient", "radius", "speed"),
    force="-coefficient * radius * (load + amplitude) * tanh(rate / speed)",
    about_zero="speed",
    left_out=FRICTION.left_out,
)

STOP = Law(
    "stop",
    ("k", "c", "place", "side"),
    potential="k * (side * (s - place))**2 / 2 if side * (s - place) > 0 else 0",
    force="elastic * max(0, 1 + c * side * rate)",
    edges=("side * (s - place)",),
    left_out="it is one-sided, not linear",
)
