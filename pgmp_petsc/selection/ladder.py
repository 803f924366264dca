"""Candidate bases in the order of what they cost online, and the search for the cheapest that is good enough.

A family is a way to make a basis bigger; its rungs differ in the number of modes alone, so that errors fall and costs
rise along it. There are two: with terms of second order and without, both with static modes where loads act (one static
mode does the work of many others). A further way to enlarge the basis, such as modes at other parameter values, is one
more family in `families_of`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from pgmp_petsc.bodies.matrices import assemble
from pgmp_petsc.effects import effects_of, patterns_of
from pgmp_petsc.mechanism.constraints import constraint_jacobian
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.null_space import null_space
from pgmp_petsc.scene import Scene

MODES = (1, 2, 3, 4, 5, 7, 10, 14, 18, 22, 28, 36)
MIDDLE = 7  # modes to begin with
ANGLES = (16, 24, 32, 48, 64, 96, 128, 192, 256, 384, 512, 768)
SCHEMES = ("spectral", "spline")


@dataclass(frozen=True)
class Limits:
    """What a scene allows.

    Attributes
    ----------
    n_modes
        Flexible modes that the meshes have.
    n_static
        Load patterns that static modes can answer.
    n_terms
        Affine terms of mass and stiffness together.
    """

    n_modes: int
    n_static: int
    n_terms: int

    @classmethod
    def of(cls, scene: Scene, kinematics: RigidKinematics) -> Limits:
        """Count."""
        mechanism = kinematics.mechanism
        pose = kinematics.poses([kinematics.coordinate.lower])[..., 0]
        n_free = null_space(constraint_jacobian(mechanism, pose)).independent.size
        matrices = assemble(mechanism.bodies, range(mechanism.n_dofs))
        n_static = patterns_of(effects_of(scene, mechanism), matrices).shape[1]
        n_terms = len({*mechanism.mass_weights, *mechanism.stiffness_weights})
        return cls(n_free - kinematics.n_coordinates, n_static, n_terms)


@dataclass(frozen=True)
class Rung:
    """A candidate basis.

    Attributes
    ----------
    entries
        Entries of the table ``reduction``.
    cost
        Multiplications a sample and Newton correction, roughly; see `operations`.
    """

    entries: dict[str, Any]
    cost: float


def operations(n_flexible: int, n_terms: int, second_order: bool) -> float:
    """Return the multiplications of one correction of one sample: cubic polynomials of the tables, and factorising.

    Parameters
    ----------
    n_flexible
        Flexible coordinates.
    n_terms
        Affine terms.
    """
    n = n_flexible
    entries = (n + 1) * (n + 2) / 2 + n * (n + 1) / 2 + n
    if second_order:
        entries += n * (n + 1) * (n + 2) / 6 + n * n
    return 3 * n_terms * entries + n**3 / 6


def families_of(given: dict[str, Any], limits: Limits) -> list[list[Rung]]:
    """Return the families, the cheapest first, rungs in the order of their cost.

    Parameters
    ----------
    given
        Entries of the table ``reduction`` that are kept.
    limits
        What the scene allows.
    """
    static = given.get("static_modes", limits.n_static > 0)
    n_static = limits.n_static if static else 0
    most = limits.n_modes - n_static
    modes = tuple(n for n in MODES if n < most) + ((most,) if 1 <= most <= MODES[-1] else ())
    if "modes" in given:
        modes = (given["modes"],)
    orders = (given["second_order"],) if "second_order" in given else (False, True)
    return [
        [
            Rung(
                {"modes": n, "static_modes": static, "second_order": second},
                operations(n + n_static, limits.n_terms, second),
            )
            for n in modes
        ]
        for second in orders
    ]


def first_passing(
    n: int, passes: Callable[[int], bool], start: int, hopeless: Callable[[int, int], bool] = lambda before, now: False
) -> int | None:
    """Return the first of n candidates that passes, if all after a passing one pass too; None if none was found.

    The search begins at `start`, gallops in the direction that the answer tells and then halves the interval.

    Parameters
    ----------
    n
        Number of candidates.
    passes
        Tells of a candidate whether it is good enough.
    start
        Candidate to begin with.
    hopeless
        Tells of a failing candidate and a later one that fails whether there is no use in going on; two times in a row
        end the search.
    """
    start = min(start, n - 1)
    if passes(start):
        low, high, taken = -1, start, 0
        while high - low > 1:
            stride = min(2 ** (taken // 2), high - low - 1)  # 1, 1, 2, 2, 4: the answer is often near
            if not passes(high - stride):
                low = high - stride
                break
            high, taken = high - stride, taken + 1
    else:
        low, high, stride, stalled = start, n, 1, 0
        while low < n - 1 and stalled < 2:
            probe = min(low + stride, n - 1)
            if passes(probe):
                high = probe
                break
            stalled = stalled + 1 if hopeless(low, probe) else 0
            low, stride = probe, 2 * stride
        if high == n:
            return None
    while high - low > 1:
        middle = (low + high) // 2
        if passes(middle):
            high = middle
        else:
            low = middle
    return high


def nearest(values: Sequence[float], value: float) -> int:
    """Return the place of the value that is nearest."""
    return min(range(len(values)), key=lambda k: abs(values[k] - value))
