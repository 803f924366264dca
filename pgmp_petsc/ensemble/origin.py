"""Where the samples of an ensemble come from, as far as their description needs it: no model has to be at hand."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from pgmp_petsc.dynamics.generalised_alpha import count_steps
from pgmp_petsc.ensemble.checked_samples import share_of
from pgmp_petsc.ensemble.columns import Columns
from pgmp_petsc.indicator.coverage import (
    absence_of_estimates,
    few_steps,
    left_out_of_estimates,
    polynomials_of_lengths,
    truncated_stresses,
    why_not_of_full_order,
)
from pgmp_petsc.models import REDUCED, LengthLanes, Model
from pgmp_petsc.runtime.remarks import Remark
from pgmp_petsc.scene import Scene


@dataclass(frozen=True)
class Origin:
    """What samples are of.

    Attributes
    ----------
    model
        ``full``, ``components`` or ``reduced``.
    scene
        The scene of the run.
    units
        Of the outputs, by name.
    not_estimated
        What is to be said of errors that are not estimated.
    checked_share
        Of the samples whose errors are estimated.
    """

    model: str
    scene: Scene
    units: dict[str, str]
    not_estimated: tuple[Remark, ...]
    checked_share: float

    @classmethod
    def of(cls, model: Model) -> Origin:
        """Return that of a model."""
        scene, share = model.scene, share_of(model)
        if isinstance(model, REDUCED):
            absent = (*absence_of_estimates(scene, ensemble=True), *truncated_stresses(scene))
            if share > 0.0:
                absent += few_steps(count_steps(scene.simulation.duration, scene.simulation.step))
                absent += left_out_of_estimates(model)
            absent += (polynomials_of_lengths(model, share > 0.0),) if isinstance(model, LengthLanes) else ()
        else:
            absent = (*absence_of_estimates(scene, ensemble=True, of_step=True), *why_not_of_full_order(model))
        return cls(model.name, scene, dict(model.outputs.units), tuple(absent), share)


class Kept(Protocol):
    """Samples that are finished: in a checkpoint, or in the files of shards."""

    @property
    def remarks(self) -> tuple[Remark, ...]:
        """What was found and not taken up."""

    def columns(self) -> Columns:
        """Return what is known of all samples as columns ``<kind>.<name>``, with ``status`` and ``failure_time``."""

    def bands(self, n: int) -> Mapping[str, np.ndarray]:
        """Return the outputs of those among the first n samples at the instants of the bands, each (n_known, n_t)."""
