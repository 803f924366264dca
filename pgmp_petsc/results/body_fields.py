"""Bodies as they can be seen at the instants of a trajectory's frames: displacements and stresses over all of them.

Of every body whose mesh the model knows. Where a node has several values, of materials or of beams that meet there, it
has what an output with `at` reports there. Where the rigid mechanism does not exist, deformation is not a number.
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass

import numpy as np

from pgmp_petsc.declare.records import Record, array, attribute, derived, units_of

GROUP = "fields"
PLACES = ("at_nodes", "at_cells")
ANSWERS = {"static_modes": "loads", "inertia_modes": "inertia forces"}
_VECTOR = ("frame", "node", "dimension")


def _quantities(size: str, words: str) -> dict[str, np.ndarray]:
    return array(
        "frame", size, unit="{unit}", about=f"{{quantity}} {words}", each="frame", gaps=True, absent={},
        words=lambda own, name, _: {"quantity": name.replace("_", " ")},
    )  # fmt: skip


@dataclass(frozen=True)
class BodyField(Record):
    """One body over the frames."""

    kind: str = attribute("cells@kind", about="meshio's name of the cells; line of beams")
    nodes: np.ndarray = array("node", "dimension", unit="m", about="undeformed nodes in the frame of the body")
    cells: np.ndarray = array("cell", "corner", about="nodes of the cells", stored=np.int32)
    positions: np.ndarray = array(
        *_VECTOR, at="points", unit="m", about="positions of the nodes, ground frame", each="frame", padded=3, gaps=True
    )
    deformation: np.ndarray = array(
        *_VECTOR, unit="m", about="positions minus those of the rigid mechanism, ground frame", each="frame", padded=3,
        gaps=True,
    )  # fmt: skip
    at_nodes: dict[str, np.ndarray] = _quantities("node", "at the nodes")
    at_cells: dict[str, np.ndarray] = _quantities("cell", "in the middles of the cells")
    units: dict[str, str] = units_of("at_nodes", default={})
    rigid: bool = attribute("cells@rigid", default=False)
    radius: float | None = attribute(
        "cells@radius", absent=None, unit="m", about="of beams: of the circle with the section's radius of gyration"
    )
    FURTHER = (
        derived(
            np.ndarray, lambda own, _: own.displacement, "displacement", *_VECTOR, unit="m", each="frame", padded=3,
            gaps=True, about="positions minus those of frame 00000",
        ),
    )  # fmt: skip

    def __post_init__(self) -> None:
        if not self.units.keys() == self.at_nodes.keys() == self.at_cells.keys():
            raise ValueError("quantities at nodes, in cells and units of a body are not the same")
        super().__post_init__()

    @property
    def displacement(self) -> np.ndarray:
        """Positions minus those of the first frame, shape (n_f, n_nodes, d), m."""
        return self.positions - self.positions[:1]


def truncated(scene_toml: str) -> str:
    """Return what the stresses of a reduced model of a scene lack, empty where that is nothing."""
    reduction = tomllib.loads(scene_toml).get("reduction", {})
    lacking = [name for name in ANSWERS if not reduction.get(name, False)]
    if not lacking:
        return ""
    return (
        f"stresses of the modes alone, without the static answers to {' and '.join(ANSWERS[name] for name in lacking)} "
        f"(reduction.{', reduction.'.join(lacking)}): they may be far off"
    )
