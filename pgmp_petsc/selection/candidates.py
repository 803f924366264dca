"""What candidates are predicted to take, from their sizes alone, and those that are too dear to be tried.

To build a basis of m flexible coordinates takes an eigenproblem at every configuration, others for modes at other
parameter values, and with terms of second order a static answer for each of the ``m (m + 1) / 2`` pairs; their tables
have m^3 entries for every affine term. To run it takes the multiplications of its corrections (`ladder.operations`).
Constants were measured on a common processor, of beams and cells in the plane and in space with 36 to 321 unknowns;
predictions are within a factor of two or three, now and then four, and the same on any number of ranks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from pgmp_petsc.experiments.price import LOCAL, LOCAL_EFFECT, duration_text
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.selection.ladder import Limits, Rung

# s, of a configuration and an unknown: the eigenproblem, as much again for modes at other parameter values and for
# terms of second order, and each of their pairs; of a step of a sample besides its tables, of a multiplication of its
# corrections
UNKNOWN, PAIR_OF_UNKNOWN, STEP, MULTIPLICATION = 8.0e-5, 1.0e-6, 5.0e-6, 1.0e-9
SHARE = 0.2  # of the budget, that one candidate may take
MOST_BYTES = 2**30  # that its tables may have


@dataclass(frozen=True)
class CandidatePrices:
    """What is common to all candidates.

    Attributes
    ----------
    n_unknowns
        Of the mechanism, bodies of cells condensed.
    n_terms, n_coordinates
        Affine terms, and rigid coordinates.
    step
        Of a sample, besides its tables, s.
    n_steps
        Steps of all samples and loads together.
    angles
        Most along each coordinate that the first candidates are built at.
    """

    n_unknowns: int
    n_terms: int
    n_coordinates: int
    step: float
    n_steps: int
    angles: int

    @classmethod
    def of(cls, mechanism: Mechanism, limits: Limits, n_steps: int, angles: int) -> CandidatePrices:
        """Take the sizes of a mechanism."""
        local = sum(effect.type in LOCAL for effect in mechanism.scene.effects.values())
        step = STEP + LOCAL_EFFECT * local
        return cls(mechanism.n_dofs, limits.n_terms, limits.n_coordinates, step, n_steps, angles)

    def seconds(self, rung: Rung, angles: int | None = None) -> float:
        """Return the processor time to build a candidate and to run it under all loads, s; at the most angles, or at
        others."""
        m, n = rung.n_flexible, (angles or self.angles) ** self.n_coordinates
        second, others = (bool(rung.entries[key]) for key in ("second_order", "parameter_modes"))
        pairs = m * (m + 1) / 2 if second else 0
        build = n * self.n_unknowns * (UNKNOWN * (1 + second + others) + PAIR_OF_UNKNOWN * pairs)
        return build + self.n_steps * (self.step + MULTIPLICATION * rung.cost)

    def bytes(self, rung: Rung) -> float:
        """Return the size of its tables; over two turns of a coordinate they are twice as many."""
        m, n = rung.n_flexible, self.angles**self.n_coordinates
        entries = 2.0 * self.n_terms * m**2
        if rung.entries["second_order"]:
            entries += 2.0 * self.n_terms * m**3 + self.n_unknowns * m**2
        return 8.0 * n * entries

    def within(self, rung: Rung, budget: float) -> bool:
        """Return whether a candidate is not too dear; see `affordable`."""
        return self.seconds(rung) <= SHARE * budget and self.bytes(rung) <= MOST_BYTES

    def affordable(self, families: Sequence[list[Rung]], budget: float) -> tuple[list[list[Rung]], str]:
        """Return of every family the rungs that are not too dear, the cheapest in any case, and what is left out.

        Parameters
        ----------
        budget
            ``reference.budget``, s; infinite where candidates may take what they take.
        """
        kept, dear = [], []
        for family in families:
            fine = [rung for rung in family if self.within(rung, budget)]
            kept.append(fine or family[:1])
            dear += [rung for rung in family if rung not in kept[-1]]
        if not dear:
            return kept, ""
        least = min(dear, key=self.seconds)
        curved = " with terms of second order" if least.entries["second_order"] else ""
        what = f"bases of {least.n_flexible} flexible coordinates{curved} and what is dearer were not tried"
        return kept, f"{what}: {self.dear(least, budget)}, or give reduction.modes"

    def dear(self, rung: Rung, budget: float) -> str:
        """Say what a candidate is predicted to take that is too dear, and the cure."""
        return (
            f"to build and run such a basis is predicted to take {duration_text(self.seconds(rung))} of processor time "
            f"and {self.bytes(rung) / 1e6:.0f} MB; allowed are {SHARE:g} of reference.budget = {budget:g} s and "
            f"{MOST_BYTES / 1e6:.0f} MB; raise the budget or shorten simulation.duration"
        )

    def text(self, families: Sequence[Sequence[Rung]]) -> str:
        """Say how many candidates there are and what the dearest is predicted to take."""
        rungs = [rung for family in families for rung in family]
        dearest = duration_text(max(map(self.seconds, rungs)))
        return (
            f"candidates: {len(rungs)} bases, of which a search tries some; predicted to take "
            f"{duration_text(min(map(self.seconds, rungs)))} to {dearest} of processor time each, built and run"
        )
