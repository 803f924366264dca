"""What a build took on one mesh: the record that a scaling study keeps of every run, as a JSON file.

Times are in s, memory in bytes. Processor time is that of the ranks' own work, whatever else the machine had to do;
with several ranks it holds their waiting too, because MPI waits busily.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.files.claims import replacing

FORMAT = 1
READING, CONDENSING, BUILDING, WRITING, FRESH = "reading", "condensing", "building", "writing", "fresh"
ASSEMBLY, MODES, ANSWERS, PROJECTION = "assembly", "modes", "answers", "projection"  # of condensing
FACTORISATION, EIGENSOLVER = "factorisation", "eigensolver"  # of the modes
KINEMATICS, ANGLES, TABLES = "kinematics", "angles", "tables"  # of building


@dataclass(frozen=True)
class ScalingCase:
    """One run.

    Attributes
    ----------
    scene
        Name of the scene.
    dimension
        Of its bodies, 2 or 3.
    unknowns
        Of the meshes of all bodies.
    bodies, modes, angles
        Numbers of them.
    ranks, ranks_per_angle
        Of the run.
    wall, processor
        Seconds of every phase, the largest of all ranks. `BUILDING` has no part that depends on the mesh.
    factorisations
        How often a rank factorised a matrix while condensing, the largest of all ranks.
    idle, peak
        Resident memory of every rank before and after, bytes.
    load
        Load average of the machine before the run.
    blas
        Libraries of basic linear algebra that the process has loaded.
    refusal
        What the program said if it could not solve the full meshes (`FRESH` has no time then), else empty.
    """

    scene: str
    dimension: int
    unknowns: int
    bodies: int
    modes: int
    angles: int
    ranks: int
    ranks_per_angle: int
    wall: dict[str, float]
    processor: dict[str, float]
    factorisations: int
    idle: list[int]
    peak: list[int]
    load: float
    blas: str
    refusal: str = ""

    @property
    def angle(self) -> float:
        """Processor time of one angle of the build."""
        return self.processor[ANGLES] * self.ranks / self.ranks_per_angle / self.angles

    @property
    def bodies_alone(self) -> float:
        """Processor time to assemble every body anew and to find its own modes, as condensing does."""
        return self.processor[ASSEMBLY] + self.processor[MODES]

    @property
    def bodies_at_least(self) -> float:
        """What is left of `bodies_alone` with one factorisation a body: without the one that counts eigenvalues."""
        once = self.bodies * self.processor[FACTORISATION] / max(self.factorisations, self.bodies)
        return self.processor[ASSEMBLY] + once + self.processor[EIGENSOLVER]

    @property
    def share(self) -> float:
        """Share of a processor that the run had while condensing; far below 1, wall times are those of others too."""
        return self.processor[CONDENSING] / self.wall[CONDENSING]

    def write(self, path: Path) -> None:
        """Write the file."""
        with replacing(path) as waiting:
            waiting.write_text(json.dumps({"format": FORMAT, **asdict(self)}, indent=1) + "\n", encoding="utf-8")

    @classmethod
    def read(cls, path: Path) -> ScalingCase:
        """Read a file.

        Raises
        ------
        InputError
            If it is missing or no whole record of this format.
        """
        try:
            data = json.loads(path.read_text(encoding="utf-8"))
            if data.pop("format") != FORMAT:
                raise ValueError(f"its format is not {FORMAT}")
            return cls(**data)
        except (OSError, ValueError, TypeError, KeyError, AttributeError) as error:
            raise InputError(f"'{path}' is no record of a scaling study ({error}); measure it again") from error


def exponent(unknowns: Sequence[float], costs: Sequence[float]) -> float:
    """Return p of ``cost = c unknowns^p`` by least squares on logarithms; NaN where fewer than two costs are known."""
    x, y = np.array(unknowns, dtype=float), np.array(costs, dtype=float)
    known = np.isfinite(y) & (y > 0.0)
    if np.unique(x[known]).size < 2:
        return float("nan")
    return float(np.polyfit(np.log(x[known]), np.log(y[known]), 1)[0])


def over_unknowns(cases: Sequence[ScalingCase], dimension: int) -> list[ScalingCase]:
    """Return the runs on one rank with bodies of this dimension, by ascending unknowns."""
    chosen = [case for case in cases if case.ranks == 1 and case.dimension == dimension]
    return sorted(chosen, key=lambda case: case.unknowns)
