"""Estimated errors of one run; and limits of what says how far a run left small deformations.

Layout within the file of a trajectory:

============================= ========== ======================================================================
dataset                       shape      content
============================= ========== ======================================================================
``/errors/time``              (n_e)      instants of evaluation, s
``/errors/<output>``          (n_e)      estimated error of the output: of a reduced run its output less that of the
                                         full-order equations, with what the time step does wrong; of full-order and
                                         component runs what the time step does wrong, up to the last of these
                                         instants; attributes
                                         ``maximum``, its largest size, and ``share``, that of the output's
                                         largest size over the run; ``not_estimated``, why there is none
============================= ========== ======================================================================

NaN where there is no estimate.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import h5py
import numpy as np

from pgmp_petsc.results.layout import check_shape
from pgmp_petsc.runtime.files import put, take

TIME, ABSENT = "time", "not_estimated"
OF_REDUCED, OF_STEP = "reduced less full-order", "of the time step"
# rad. Displacements linear in the deformation turn a length by phi and make it longer by phi^2 / 2 of itself, which is
# the relative error of a linear strain measure: one per cent here.
ROTATION_LIMIT = 0.14
# Metals yield at 0.002 to 0.007 and glass fibre breaks at about 0.02: beyond this none but rubber is linear.
STRAIN_LIMIT = 0.01
# A share of a mode's stiffness: static deflections change by as much, frequencies by half of it.
SHARE_LIMIT = 0.1
# With geometric stiffening, of first order in the forces: what it leaves out is about the square of the share.
SHARE_LIMIT_WITH_STIFFENING = 0.5
VALIDITY = {
    "elastic_rotation": ("rad", "largest rotation of a node less that of its rigid body"),
    "elastic_strain": ("1", "largest strain along an outermost fibre"),
    "stiffness_gained": ("1", "largest share by which forces in the bodies stiffen a mode"),
    "stiffness_lost": ("1", "largest share by which forces in the bodies soften a mode, negative; -1 is buckling"),
}


def limits_of(second_order: bool) -> dict[str, float]:
    """Return the largest size of every value of `VALIDITY` that is not worth a warning.

    Parameters
    ----------
    second_order
        Whether the model has geometric stiffening.
    """
    return {
        "elastic_rotation": ROTATION_LIMIT,
        "elastic_strain": STRAIN_LIMIT,
        "stiffness_gained": float("inf") if second_order else SHARE_LIMIT,
        "stiffness_lost": SHARE_LIMIT_WITH_STIFFENING if second_order else SHARE_LIMIT,
    }


def beyond_limit(name: str, values: np.ndarray | float, second_order: bool = False) -> np.ndarray:
    """Return which values of a name of `VALIDITY` exceed their limit; NaN, where nothing is known, does not."""
    return np.abs(values) > limits_of(second_order)[name]


@dataclass(frozen=True)
class EstimatedErrors:
    """Estimated errors of a run.

    Parameters
    ----------
    time : ndarray, shape (n_e,)
        Instants of evaluation, s.
    outputs : dict of str to ndarray, shape (n_e,)
        Error of every output, in the output's unit.
    largest : dict of str to float
        Largest size of every output over the run, of which errors are a share.
    what : str
        What these errors are of (attribute ``what`` of the group): `OF_REDUCED` or `OF_STEP`.
    absent : dict of str to str
        Why outputs have no estimate, those that have none.
    """

    time: np.ndarray
    outputs: dict[str, np.ndarray]
    largest: dict[str, float]
    what: str = OF_REDUCED
    absent: dict[str, str] = field(default_factory=dict)

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

    def of_one_run(self) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
        """Return the largest error and the largest size of every output, as of an ensemble of one sample, (1,) each."""
        maxima, sizes = ({name: np.array([of(name)]) for name in self.outputs} for of in (self.maximum, self.largest.get))
        return maxima, sizes

    def write(self, file: h5py.File, units: dict[str, str]) -> None:
        """Write the group."""
        group = file.create_group("errors", track_order=True)
        group.attrs["what"] = self.what
        put(group, TIME, self.time, "s", "instants at which the errors are estimated")
        for name, values in self.outputs.items():
            words = f"estimated error of output '{name}', {self.what}"
            found = {"maximum": self.maximum(name), "share": self.share(name), "largest": self.largest[name]}
            if name in self.absent:
                found[ABSENT] = self.absent[name]
            put(group, name, values, units.get(name, "1"), words).attrs.update(found)

    @classmethod
    def read(cls, file: h5py.File) -> EstimatedErrors | None:
        """Read the group, None where there is none."""
        if "errors" not in file:
            return None
        group = file["errors"]
        names = [name for name in group if name != TIME]
        return cls(
            time=take(group, TIME, 1),
            outputs={name: take(group, name, 1) for name in names},
            largest={name: float(group[name].attrs["largest"]) for name in names},
            what=str(group.attrs.get("what", OF_REDUCED)),  # files of earlier versions have those of reduced runs
            absent={name: str(group[name].attrs[ABSENT]) for name in names if ABSENT in group[name].attrs},
        )
