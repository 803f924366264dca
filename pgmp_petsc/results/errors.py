"""Estimated errors of one reduced run, and how far it left small deformations.

Layout within the file of a trajectory:

============================= ========== ======================================================================
dataset                       shape      content
============================= ========== ======================================================================
``/errors/time``              (n_e)      instants of evaluation, s
``/errors/<output>``          (n_e)      estimated error of the output, reduced less full-order; attributes
                                         ``maximum``, its largest size, and ``share``, that of the output's
                                         largest size over the run
``/validity/<name>``          ()         largest elastic rotation (rad) and strain over the run
============================= ========== ======================================================================

NaN where there is no estimate.
"""

from __future__ import annotations

from dataclasses import dataclass

import h5py
import numpy as np

from pgmp_petsc.results.layout import check_shape
from pgmp_petsc.runtime.files import put, take

TIME = "time"
# rad. Displacements linear in the deformation turn a length by phi and make it longer by phi^2 / 2 of itself, which is
# the relative error of a linear strain measure: one per cent here.
ROTATION_LIMIT = 0.14
VALIDITY = {
    "elastic_rotation": ("rad", "largest rotation of a node less that of its rigid body"),
    "elastic_strain": ("1", "largest strain along an outermost fibre"),
}


def beyond_limit(rotations: np.ndarray | float) -> np.ndarray:
    """Return which elastic rotations exceed `ROTATION_LIMIT`; NaN, where nothing is known, does not."""
    return np.asarray(rotations) > ROTATION_LIMIT


@dataclass(frozen=True)
class EstimatedErrors:
    """Estimated errors of a run.

    Parameters
    ----------
    time : ndarray, shape (n_e,)
        Instants of evaluation, s.
    outputs : dict of str to ndarray, shape (n_e,)
        Error of every output, reduced less full-order, in the output's unit.
    largest : dict of str to float
        Largest size of every output over the run, of which errors are a share.
    validity : dict of str to float
        Names of `VALIDITY`.
    """

    time: np.ndarray
    outputs: dict[str, np.ndarray]
    largest: dict[str, float]
    validity: dict[str, float]

    def __post_init__(self) -> None:
        check_shape("time of the errors", self.time, (None,))
        for name, values in self.outputs.items():
            check_shape(f"error of '{name}'", values, (len(self.time),))

    def maximum(self, output: str) -> float:
        """Return the largest size of an output's error, in its unit; NaN where there is no estimate."""
        return float(np.max(np.abs(self.outputs[output])))

    def share(self, output: str) -> float:
        """Return the largest error as a share of the output's largest size; NaN where that is zero."""
        largest = self.largest[output]
        return self.maximum(output) / largest if largest > 0.0 else float("nan")

    def write(self, file: h5py.File, units: dict[str, str]) -> None:
        """Write both groups."""
        group = file.create_group("errors", track_order=True)
        put(group, TIME, self.time, "s", "instants at which the errors are estimated")
        for name, values in self.outputs.items():
            words = f"estimated error of output '{name}', reduced less full-order"
            put(group, name, values, units.get(name, "1"), words).attrs.update(
                maximum=self.maximum(name), share=self.share(name), largest=self.largest[name]
            )
        for name, value in self.validity.items():
            put(file, f"validity/{name}", float(value), *VALIDITY[name])

    @classmethod
    def read(cls, file: h5py.File) -> EstimatedErrors | None:
        """Read both groups, None where there are none."""
        if "errors" not in file:
            return None
        group = file["errors"]
        names = [name for name in group if name != TIME]
        return cls(
            time=take(group, TIME, 1),
            outputs={name: take(group, name, 1) for name in names},
            largest={name: float(group[name].attrs["largest"]) for name in names},
            validity={name: float(take(file["validity"], name, 0)) for name in file["validity"]},
        )
