"""Stress fields of a run at the instants of its frames, as results keep them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from pgmp_petsc.models.stress_fields import FieldPoints, Fields
from pgmp_petsc.results.stress_fields import StressField


def stress_frames(points: Mapping[str, FieldPoints], instants: Sequence[Fields]) -> dict[str, StressField]:
    """Return the fields of all bodies over some instants; nothing where there are no instants."""
    if not instants:
        return {}
    return {
        name: StressField(
            kind=field.kind,
            nodes=field.mesh.nodes,
            cells=field.mesh.cells,
            positions=np.array([fields[name][0] for fields in instants]),
            quantities={key: np.array([fields[name][1][key] for fields in instants]) for key in field.quantities},
            units=field.quantities,
        )
        for name, field in points.items()
    }
