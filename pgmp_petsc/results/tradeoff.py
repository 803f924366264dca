"""What accuracy costs: errors and times of many settings of all models, and of response surfaces.

Layout of the file (kind ``tradeoff``; root attributes ``batch``: samples that were timed together, ``repeats``: how
often each time was taken, the least is kept, ``waiting``: wall time over processor time of these runs, ``samples``:
number of samples that the advice is for, ``quick``: whether fewer settings were measured, ``reference_model``: ``full``
or ``components``, which errors are against, ``reference``: why, and how far it is from the mesh, and
``rigid_coordinates``, their number):

=============================== ========================= ==========================================================
dataset                         shape                     content
=============================== ========================= ==========================================================
``/settings/family``            (n)                       ``reduced``, ``components``, ``full`` (the mesh) or
                                                          ``surface`` (response surface)
``/settings/<column>``          (n)                       what was set: ``step`` (s), ``refinement`` (parts that every
                                                          cell of the scene's meshes is cut into), ``nodes`` of a
                                                          surface, ``component_modes`` that bodies in floating frames
                                                          serve, and every entry of the scene's [reduction]; 0, false or
                                                          empty where it has no meaning; ``coordinates``: unknowns;
                                                          ``cosine`` between neighbouring spaces of modes, the smallest
``/settings/flags``             (n)                       options of ``pgmp`` that turn the scene into the setting
``/settings/reason``            (n)                       why it failed, or was too dear for more than its times; empty
                                                          where it has errors
``/errors``                     (n, n_outputs)            largest error over time and test values, as a share of the
                                                          output's largest value; NaN where the setting failed;
                                                          attribute ``names`` (JSON): the outputs
``/offline``                    (n)                       wall time before the first sample, s
``/online/batch``               (n)                       wall time a sample, in a batch, s
``/online/single``              (n)                       wall time of one sample alone, s
``/processor/<time>``           (n)                       the same three, processor time of the one serial process, s
``/pareto``                     (n, n_outputs)            1 where no setting of its family is both cheaper online and
                                                          more accurate
``/parameters/<name>``          (n_test)                  test values
``/reference/refinement``       (n_references)            a reference for every mesh that settings were run on
``/reference/step``             (n_references)            its last step, s
``/reference/moved``            (n_references, n_outputs) by how much the last halving of the step moved it
``/reference/reason``           (n_references)            why it was not refined further
``/mesh/refinement``, ``cells`` (n_meshes)                meshes that were compared, all with the scene's step; none of
                                                          continuum cells
``/mesh/errors``                (n_meshes, n_outputs)     difference to the finest of them, 0 for that
``/advice``                     (n_sentences)             which setting to take
=============================== ========================= ==========================================================
"""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import dataclass

import h5py
import numpy as np

from pgmp_petsc.results.layout import check_shape, put_named, take_named, units_of
from pgmp_petsc.runtime.files import RunRecord, open_file, put, shapes_of, take, write_file

FAMILIES = ("reduced", "components", "full", "surface")
BUSY = 1.2  # wall time over processor time above which a machine had other things to do
# columns that settings are named by
_NEEDED = (
    "angles", "component_modes", "coordinates", "inertia_modes", "interpolation", "modes", "nodes", "parameter_modes",
    "refinement", "second_order", "static_modes", "step",
)  # fmt: skip
_ATTRIBUTES = {
    "batch": int, "repeats": int, "samples": int, "quick": bool, "waiting": float, "reference": str,
    "reference_model": str, "rigid_coordinates": int,
}  # fmt: skip
_COLUMN_UNITS = {"step": "s"}
_CLOCKS = {
    "wall": ("offline", "online/batch", "online/single"),
    "processor": ("processor/offline", "processor/batch", "processor/single"),
}


@dataclass(frozen=True)
class References:
    """The converged full-order runs that errors are measured against, one for every mesh.

    Parameters
    ----------
    refinement : ndarray of int, shape (n_references,)
        Parts that every cell of the scene's meshes is cut into.
    step : ndarray, shape (n_references,)
        Last step, s.
    moved : ndarray, shape (n_references, n_outputs)
        Change at the last halving of the step, as a share of the output's largest value.
    reason : tuple of str
        Why the step was not halved again.
    """

    refinement: np.ndarray
    step: np.ndarray
    moved: np.ndarray
    reason: tuple[str, ...]


@dataclass(frozen=True)
class MeshErrors:
    """Discretisation errors: full-order runs on refined meshes.

    Parameters
    ----------
    refinement, cells : ndarray of int, shape (n_meshes,)
        Parts of every cell, rising, and the number of cells of all bodies.
    errors : ndarray, shape (n_meshes, n_outputs)
        Difference to the finest mesh, as a share of the output's largest value.
    """

    refinement: np.ndarray
    cells: np.ndarray
    errors: np.ndarray


@dataclass(frozen=True)
class Times:
    """Times of n settings by one clock.

    Parameters
    ----------
    offline, batch, single : ndarray, shape (n,)
        Before the first sample, of a sample in a batch, and of one alone, s; NaN where the setting failed.
    """

    offline: np.ndarray
    batch: np.ndarray
    single: np.ndarray


@dataclass(frozen=True)
class Tradeoff:
    """Errors and times of n settings.

    Parameters
    ----------
    record : RunRecord
    units : dict of str to str
        Unit of every output, in the order of the columns of `errors`.
    test_values : dict of str to ndarray, shape (n_test,)
        Parameter values at which errors were measured; empty where the scene has no parameters.
    parameter_units : dict of str to str
    families : tuple of str
        See :data:`FAMILIES`.
    columns : dict of str to ndarray, shape (n,)
        What was set; numbers, booleans or texts. The first setting is the scene's own.
    flags, reasons : tuple of str
        Options of ``pgmp``, and reasons of failure.
    errors : ndarray, shape (n, n_outputs)
    wall, processor : Times
        By the clock on the wall, and processor times of the one serial process that measured a setting.
    references : References
    mesh : MeshErrors
    batch, repeats : int
        Samples timed together, and how often.
    samples : int
        Number of samples that the advice is for.
    quick : bool
        Whether fewer settings were measured.
    waiting : float
        Wall time over processor time of the timed runs; 1 on a quiet machine.
    advice : tuple of str
        Which setting to take; a line that begins with ``--`` holds options to paste.
    reference, reference_model : str
        What errors are against, and why; ``full`` for the mesh, or ``components``.
    rigid_coordinates : int
        Number of rigid coordinates.
    """

    record: RunRecord
    units: dict[str, str]
    test_values: dict[str, np.ndarray]
    parameter_units: dict[str, str]
    families: tuple[str, ...]
    columns: dict[str, np.ndarray]
    flags: tuple[str, ...]
    reasons: tuple[str, ...]
    errors: np.ndarray
    wall: Times
    processor: Times
    references: References
    mesh: MeshErrors
    batch: int
    repeats: int
    samples: int = 1
    quick: bool = False
    waiting: float = 1.0
    advice: tuple[str, ...] = ()
    reference: str = ""
    reference_model: str = "full"
    rigid_coordinates: int = 1

    def __post_init__(self) -> None:
        n, n_outputs = len(self.families), len(self.units)
        unknown = set(self.families) - set(FAMILIES)
        if unknown:
            raise ValueError(f"families {sorted(unknown)}; allowed: {', '.join(FAMILIES)}")
        check_shape("errors", self.errors, (n, n_outputs))
        for name, data in (*self.columns.items(), *vars(self.wall).items(), *vars(self.processor).items()):
            check_shape(f"'{name}'", data, (n,))
        for name, texts in (("flags", self.flags), ("reasons", self.reasons)):
            check_shape(name, np.array(texts, dtype=object), (n,))
        check_shape("moved", self.references.moved, (len(self.references.refinement), n_outputs))
        check_shape("mesh errors", self.mesh.errors, (len(self.mesh.refinement), n_outputs))

    @property
    def busy(self) -> bool:
        """Whether the machine had so much else to do that wall times say little."""
        return self.waiting > BUSY

    @property
    def times(self) -> Times:
        """The times to compare: by the wall, or processor times where the machine was busy.

        On a quiet machine both are the same, because every setting is measured by one serial process.
        """
        return self.processor if self.busy else self.wall

    @property
    def outputs(self) -> list[str]:
        """Names of the outputs."""
        return list(self.units)

    @property
    def varied(self) -> tuple[str, ...]:
        """Names of the parameters that differ between test values."""
        return tuple(name for name, values in self.test_values.items() if np.ptp(values) > 0.0)

    @property
    def simulated(self) -> np.ndarray:
        """Settings of one of the models, not of a response surface, shape (n,)."""
        return np.array([family != "surface" for family in self.families], dtype=bool)

    @property
    def own_mesh(self) -> np.ndarray:
        """Settings on the scene's own meshes, whose errors are against the same reference, shape (n,)."""
        return self.columns["refinement"] == 1

    @property
    def pareto(self) -> np.ndarray:
        """Settings on the scene's meshes than which none of its family is cheaper online and better, (n, n_outputs)."""
        return self.fronts(self.times.batch)

    def fronts(self, cost: np.ndarray) -> np.ndarray:
        """Return the fronts as `pareto` does, for any cost of shape (n,)."""
        result = np.zeros(self.errors.shape, dtype=bool)
        for family in FAMILIES:
            kind = self.own_mesh & (np.array(self.families) == family)
            for column in range(self.errors.shape[1]):
                result[kind, column] = pareto_front(cost[kind], self.errors[kind, column])
        return result

    def total_seconds(self, n_samples: int) -> np.ndarray:
        """Return the time of n samples, build and preparation included, shape (n,), s."""
        return self.times.offline + n_samples * self.times.batch

    def name(self, row: int) -> str:
        """Return a setting in words: ``reduced, 7 + 1 modes, 48 angles, spline, 1 ms``."""
        at = {name: values[row] for name, values in self.columns.items()}
        if self.families[row] == "surface":
            return f"response surface, {at['nodes']} {self.reference_runs}"
        words = ["full order"]
        if self.families[row] == "components":
            words = ["component modes", f"for {at['component_modes']} modes"]
        if self.families[row] == "reduced":
            words = ["reduced", f"{self.modes(row)} modes", f"{at['angles']} angles", str(at["interpolation"])]
            words += ["second order"] if at["second_order"] else []
        words.append(f"{1e3 * at['step']:.4g} ms")
        words += [f"cells / {at['refinement']}"] if at["refinement"] > 1 else []
        return ", ".join(words)

    @property
    def reference_runs(self) -> str:
        """What a response surface goes through."""
        return "component runs" if self.reference_model == "components" else "full-order runs"

    def modes(self, row: int) -> str:
        """Return ``7 + 1 + 2``: modes, static modes and those of other parameters; without those it has not."""
        n_modes, n_coordinates = int(self.columns["modes"][row]), int(self.columns["coordinates"][row])
        n_parameter = int(self.columns["parameter_modes"][row])
        words = [str(n_modes)]
        if self.columns["static_modes"][row] or self.columns["inertia_modes"][row]:
            # a setting that failed has none to count
            words.append(
                str(n_coordinates - self.rigid_coordinates - n_modes - n_parameter) if n_coordinates else "static"
            )
        elif n_parameter:
            words.append("0")
        return " + ".join([*words, str(n_parameter)] if n_parameter else words)

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write the file; by one process only. Raises as :func:`~pgmp_petsc.runtime.files.write_file`."""
        attributes = {name: getattr(self, name) for name in _ATTRIBUTES}
        with write_file(path, "tradeoff", attributes) as file:
            self.record.write(file)
            settings = file.create_group("settings", track_order=True)
            _put_texts(settings, "family", self.families, "reduced, component or full-order model, or response surface")
            for name, values in self.columns.items():
                about = f"{name.replace('_', ' ')} of the setting"
                if values.dtype.kind in "OU":
                    _put_texts(settings, name, values.tolist(), about)
                else:
                    put(settings, name, values, _COLUMN_UNITS.get(name, "1"), about)
            _put_texts(settings, "flags", self.flags, "options of pgmp that turn the scene into the setting")
            _put_texts(settings, "reason", self.reasons, "why the setting failed; empty where it did not")
            about = "largest error over time and test values, as a share of the output's largest value"
            errors = put(file, "errors", self.errors, "1", about)
            errors.attrs["names"], errors.attrs["units"] = json.dumps(self.outputs), json.dumps(self.units)
            for clock, places in _CLOCKS.items():
                about = ("before the first sample", f"a sample, {self.batch} together", "of one sample alone")
                for data, place, words in zip(vars(getattr(self, clock)).values(), places, about):
                    put(file, place, data, "s", f"{clock} time {words}")
            put(file, "pareto", self.pareto.astype(np.int8), "1", "1 where none of its kind is cheaper and better")
            put_named(file, "parameters", self.test_values, self.parameter_units, "test values of '{name}'")
            put(file, "reference/refinement", self.references.refinement, "1", "parts of every cell")
            put(file, "reference/step", self.references.step, "s", "last step of the reference")
            put(file, "reference/moved", self.references.moved, "1", "change at the last halving of the step")
            _put_texts(file, "reference/reason", self.references.reason, "why it was not refined further")
            put(file, "mesh/refinement", self.mesh.refinement, "1", "parts of every cell")
            put(file, "mesh/cells", self.mesh.cells, "1", "cells of all bodies")
            put(file, "mesh/errors", self.mesh.errors, "1", "difference to the finest mesh")
            _put_texts(file, "advice", self.advice, "which setting to take")

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> Tradeoff:
        """Read a file; raises `InputError` where it is not a whole trade-off study."""
        with open_file(path, "tradeoff") as file, shapes_of(file):
            settings = file["settings"]
            if not isinstance(settings, h5py.Group):  # a data set is gone through number by number
                raise TypeError("'/settings' is no group")
            names = [name for name in settings if name not in ("family", "flags", "reason")]
            missing = set(_NEEDED) - set(names)
            if missing:
                raise KeyError(f"/settings lacks {', '.join(sorted(missing))}")
            references = References(
                take(file, "reference/refinement", 1),
                take(file, "reference/step", 1),
                take(file, "reference/moved", 2),
                _take_texts(file, "reference/reason"),
            )
            mesh = (take(file, "mesh/refinement", 1), take(file, "mesh/cells", 1), take(file, "mesh/errors", 2))
            return cls(
                record=RunRecord.read(file),
                units=json.loads(file["errors"].attrs["units"]),
                test_values=take_named(file, "parameters", 1),
                parameter_units=units_of(file, "parameters"),
                families=_take_texts(settings, "family"),
                columns={name: _take_column(settings, name) for name in names},
                flags=_take_texts(settings, "flags"),
                reasons=_take_texts(settings, "reason"),
                errors=take(file, "errors", 2),
                **{clock: Times(*(take(file, place, 1) for place in places)) for clock, places in _CLOCKS.items()},
                references=references,
                mesh=MeshErrors(*mesh),
                **{name: kind(file.attrs[name]) for name, kind in _ATTRIBUTES.items()},
                advice=_take_texts(file, "advice"),
            )


def pareto_front(cost: np.ndarray, error: np.ndarray) -> np.ndarray:
    """Return which points no other one dominates: is at most as dear and at most as wrong, and less of one of them.

    Parameters
    ----------
    cost, error
        Shape (n,); a point with a number that is not finite is never on the front.
    """
    known = np.isfinite(cost) & np.isfinite(error)
    at_most = (cost[:, None] <= cost) & (error[:, None] <= error)
    less = (cost[:, None] < cost) | (error[:, None] < error)
    return known & ~np.any(at_most & less & known[:, None], axis=0)


def _put_texts(group: h5py.Group, name: str, texts: Sequence[str], description: str) -> None:
    data = np.array(list(texts), dtype=h5py.string_dtype())
    put(group, name, data, "1", description)


def _take_texts(group: h5py.Group, name: str) -> tuple[str, ...]:
    return tuple(text.decode() for text in take(group, name, 1, texts=True))


def _take_column(group: h5py.Group, name: str) -> np.ndarray:
    if h5py.check_string_dtype(group[name].dtype) is None:
        return take(group, name, 1)
    return np.array(_take_texts(group, name), dtype=object)
