"""Candidate bases in the order of what they cost online, and the search for the cheapest that is good enough.

A family is a way to make a basis bigger; its rungs differ in the number of modes alone, so that errors fall and costs
rise along it (docs/method.md, order). Static stretching holds for larger deflections, but leaves out the vibrations
that stretch bodies: where the deformation is small beside them, dynamic stretching goes further. Times are predicted
from sizes alone (docs/method.md, price of the candidates), and candidates that are too costly are not tried.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product
from math import log
from typing import Any

from pgmp_petsc.bench.prices import (
    MODEL,
    coefficients,
    configuration_seconds,
    duration_text,
    n_local,
    reduced_step,
    tells_forces,
)
from pgmp_petsc.bench.reference import takes_second_order
from pgmp_petsc.bodies.matrices import AffineMatrices
from pgmp_petsc.bodies.shape import has_long_axis
from pgmp_petsc.effects import effects_of, patterns_of, start_of
from pgmp_petsc.mechanism.capabilities import why_no_grid
from pgmp_petsc.mechanism.constraint_set import null_space
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import constraint_jacobian
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.parameters import uncertain_names

# s, of a configuration and an unknown: each pair of terms of second order, for which an eigenproblem is taken as often
# again, as for modes at other parameter values
PAIR_OF_UNKNOWN = 1.0e-6
SHARE = 0.2  # of the budget, that one candidate may take
MOST_BYTES = 2**30  # that its tables may have


@dataclass(frozen=True)
class CandidatePrices:
    """Figures common to all candidates."""

    limits: Limits
    n_steps: int  # steps of all samples and loads together
    angles: int  # most along each coordinate that the first candidates are built at

    def seconds(self, rung: Rung, angles: int | None = None) -> float:
        """Return the processor time to build a candidate and to run it under all loads, s; at the most angles, or at
        others."""
        m, n = rung.n_flexible, (angles or self.angles) ** self.limits.n_coordinates
        second, others = (bool(rung.entries[key]) for key in ("second_order", "parameter_modes"))
        pairs = m * (m + 1) / 2 if second else 0
        n_unknowns = self.limits.n_unknowns
        each = configuration_seconds(n_unknowns, rung.entries["modes"], self.limits.tells_forces)
        build = MODEL + n * (each * (1 + second + others) + n_unknowns * PAIR_OF_UNKNOWN * pairs)
        return build + self.n_steps * reduced_step(m, self.limits.n_coordinates, second, self.limits.n_local)

    def bytes(self, rung: Rung) -> float:
        """Return the size of its tables; over two turns of a coordinate they are twice as many."""
        m, n, n_terms = rung.n_flexible, self.angles**self.limits.n_coordinates, self.limits.n_terms
        entries = 2.0 * n_terms * m**2
        if rung.entries["second_order"]:
            entries += 2.0 * n_terms * m**3 + self.limits.n_unknowns * m**2
        return 8.0 * n * entries

    def within(self, rung: Rung, budget: float) -> bool:
        """Return whether a candidate is within the budget; see `affordable`."""
        return self.seconds(rung) <= SHARE * budget and self.bytes(rung) <= MOST_BYTES

    def affordable(self, families: Sequence[list[Rung]], budget: float) -> tuple[list[list[Rung]], str]:
        """Return the rungs of every family within a budget, s, the cheapest in any case, and a text on the others."""
        kept, dear = [], []
        for family in families:
            kept.append([rung for rung in family if self.within(rung, budget)] or family[:1])
            dear += [rung for rung in family if rung not in kept[-1]]
        if not dear:
            return kept, ""
        least = min(dear, key=self.seconds)
        curved = " with terms of second order" if least.entries["second_order"] else ""
        what = f"bases of {least.n_flexible} flexible coordinates{curved} and what is dearer were not tried"
        return kept, f"{what}: {self.dear(least, budget)}, or give reduction.modes"

    def dear(self, rung: Rung, budget: float) -> str:
        """Return the predicted time and memory of a candidate beyond the budget, and the cure, in words."""
        return (
            f"to build and run such a basis is predicted to take {duration_text(self.seconds(rung))} of processor time "
            f"and {self.bytes(rung) / 1e6:.0f} MB; allowed are {SHARE:g} of reference.budget = {budget:g} s and "
            f"{MOST_BYTES / 1e6:.0f} MB; raise the budget or shorten simulation.duration"
        )

    def text(self, families: Sequence[Sequence[Rung]]) -> str:
        """Return the number of candidates and their predicted times, in words."""
        rungs = [rung for family in families for rung in family]
        dearest = duration_text(max(map(self.seconds, rungs)))
        return (
            f"candidates: {len(rungs)} bases, of which a search tries some; predicted to take "
            f"{duration_text(min(map(self.seconds, rungs)))} to {dearest} of processor time each, built and run"
        )


MODES = (1, 2, 3, 4, 5, 7, 10, 14, 18, 22, 28, 36)
PATIENCE = 3  # rungs that did not help
MIDDLE = 7  # flexible coordinates to begin with
PARAMETER_MODES = 2  # of an extended basis
MOST_CONDENSED = 22  # modes that continuum bodies are condensed for: their fields grow with it, and every eigenproblem
# along each coordinate, and where the search begins, by the number of coordinates: of two it is their square that costs
ANGLES = {
    1: (16, 24, 32, 48, 64, 96, 128, 192, 256, 384, 512, 768),
    2: (6, 8, 10, 12, 16, 20, 24, 32, 48, 64, 96),
    3: (5, 6, 8, 10, 12, 14, 16, 20, 24),
}
FIRST_ANGLES = {1: 48, 2: 12, 3: 6}
# the spectral scheme of several coordinates keeps a fine grid of tables, however few samples it has
SCHEMES = {1: ("spectral", "spline"), 2: ("spline",), 3: ("spline",)}


@dataclass(frozen=True)
class Limits:
    """Largest sizes that a scene allows."""

    n_modes: int  # flexible modes that the mechanism has, bodies of cells condensed
    n_static: int  # load patterns that static modes can answer
    n_terms: int  # affine terms of mass and stiffness together
    uncertain: bool = False  # whether a parameter has a distribution
    n_coordinates: int = 1  # n_coordinates, n_inertia: rigid coordinates, and the inertia forces of their motion
    n_inertia: int = 1
    second_order: bool = True  # whether a reduced model of the scene may have terms of second order, or be without them
    # modes that bodies of cells are condensed for; other vectors come on top of them. None where it is the meshes that
    # end the modes
    n_condensed: int | None = None
    # whether all flexible bodies have a long axis: terms of second order are then tried with static stretching too
    slender: bool = True
    n_unknowns: int = 0  # n_unknowns, n_local: of the mechanism, bodies of cells condensed, and local effects
    n_local: int = 0
    tells_forces: bool = False  # whether joints tell their forces
    gridded: bool = True  # whether reduced models go over the coordinates on a grid
    refinable: bool = True  # whether meshes can be cut into finer ones and run as the reference: those of lines

    def most_modes(self, beside: int) -> int:
        """Return the most modes that a basis may have beside other vectors."""
        most = self.n_modes - beside
        return most if self.n_condensed is None else min(most, self.n_condensed)

    @property
    def last_mode(self) -> str:
        """Explanation, in words, of why a basis with all modes cannot have more."""
        if self.n_condensed is not None:
            return f"bodies of cells are condensed for {self.n_condensed} modes; give reduction.modes to have more"
        return "these are all flexible modes that the meshes have; finer ones have more"

    @classmethod
    def of(cls, scene: Scene, kinematics: RigidKinematics, n_condensed: int = MODES[-1]) -> Limits:
        """Count, with the kinematics of beams and of bodies that are condensed for so many modes."""
        mechanism, coordinates = kinematics.mechanism, kinematics.coordinates
        start = start_of(scene, mechanism)[0]
        pose, n_released = kinematics.poses(start[None])[..., 0], kinematics.motion(start).released.shape[-1]
        clamped = [coordinate for coordinate in coordinates if coordinate.prescribed]
        n_free = null_space(constraint_jacobian(mechanism, pose, clamped)).independent.size
        n_modes = n_free - (len(coordinates) - len(clamped)) - n_released
        served = n_condensed if any(body.dense for body in mechanism.bodies) and n_modes > n_condensed else None
        matrices = AffineMatrices(mechanism.bodies, range(mechanism.n_dofs))
        n_static = patterns_of(effects_of(scene, mechanism), matrices).n
        n_terms = len({*mechanism.mass_weights, *mechanism.stiffness_weights})
        n = len(coordinates)
        # where effects add terms of second order, there is nothing to choose
        n_inertia, curved = n * (n + 1) // 2 + len(clamped), not scene.second_order and takes_second_order(scene)
        slender = all(map(has_long_axis, mechanism.shapes.values()))
        uncertain, gridded = bool(uncertain_names(scene)), not why_no_grid(scene, mechanism)
        sizes = mechanism.n_dofs, n_local(scene), tells_forces(scene)
        return cls(n_modes, n_static, n_terms, uncertain, n, n_inertia, curved, served, slender, *sizes, gridded)


@dataclass(frozen=True)
class Rung:
    """A candidate basis."""

    entries: dict[str, Any]  # entries of the table ``reduction``
    n_flexible: int  # flexible coordinates
    cost: float  # multiplications a sample and Newton correction, roughly; see `operations`


def operations(n_flexible: int, n_rigid: int, second_order: bool) -> float:
    """Return the multiplications of one correction of one sample: cubic polynomials of the tables, and factorising."""
    return coefficients(n_flexible, n_rigid, second_order) + n_flexible**3 / 6


def families_of(given: dict[str, Any], limits: Limits) -> list[list[Rung]]:
    """Return the families, the cheapest first, rungs in the order of their cost; entries of the table ``reduction``
    that are `given` are kept."""
    static = given.get("static_modes", limits.n_static > 0)
    orders = (False, True) if limits.second_order else (False,)
    orders = (given["second_order"],) if "second_order" in given else orders
    extensions: list[dict[str, Any]] = []
    for inertia, n_parameter in ((False, 0), (True, PARAMETER_MODES if limits.uncertain else 0)):
        proposed = {"inertia_modes": inertia, "parameter_modes": n_parameter}
        extension = {key: given.get(key, value) for key, value in proposed.items()}
        if extension not in extensions:
            extensions.append(extension)
    families = []
    for second in orders:  # without terms of second order nothing is followed, and there is one kind of stretching
        kinds = ("static", "dynamic") if second and limits.slender else ("dynamic",)
        for kind, extension in product((given["stretching"],) if "stretching" in given else kinds, extensions):
            entries = {"static_modes": static, **extension, "second_order": second, "stretching": kind}
            families.append(_family(entries, given, limits))
    # with given modes there may be no room for an extension
    fitting = [[rung for rung in family if rung.n_flexible <= limits.n_modes] for family in families]
    return [family for family in fitting if family] or families[:1]


def by_distance_from_middle(family: Sequence[Rung]) -> list[Rung]:
    """Return the rungs, those of medium size first, by how many times larger or smaller they are."""
    return sorted(reversed(family), key=lambda rung: abs(log(rung.n_flexible / MIDDLE)))


def _family(entries: dict[str, Any], given: dict[str, Any], limits: Limits) -> list[Rung]:
    """Return the rungs with these entries and more and more modes."""
    beside = limits.n_static * entries["static_modes"] + limits.n_inertia * entries["inertia_modes"]
    beside += entries["parameter_modes"]
    most = limits.most_modes(beside)
    modes = tuple(n for n in MODES if n < most) + ((most,) if 1 <= most <= MODES[-1] else ())
    if "modes" in given:
        modes = (given["modes"],)
    return [
        Rung({"modes": n} | entries, n + beside, operations(n + beside, limits.n_coordinates, entries["second_order"]))
        for n in modes
    ]


def first_passing(
    n: int, passes: Callable[[int], bool], start: int, hopeless: Callable[[int, int], bool] = lambda before, now: False
) -> int | None:
    """Return the first of n candidates that passes, if all after a passing one pass too; None if none was found.

    The search begins at `start`, gallops in the direction that the answer tells and then halves the interval.
    `hopeless` tells of a failing candidate and a later one that fails whether all between were no use; as many as
    `PATIENCE` in a row end the search.
    """
    if n == 0:
        return None
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
        while low < n - 1 and stalled < PATIENCE:
            probe = min(low + stride, n - 1)
            if passes(probe):
                high = probe
                break
            stalled = stalled + probe - low if hopeless(low, probe) else 0
            low, stride = probe, 2 * stride
        if high == n:
            return None
    return bisect_left(range(high), True, low + 1, key=passes)
