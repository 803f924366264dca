"""What was chosen for the tolerances of a scene, and why; the group ``/selection`` of a reduced model's file.

=============================== ========================= =======================================================
dataset or attribute            shape                     content
=============================== ========================= =======================================================
``tolerances``, ``allowed``     JSON attributes           the scene's tolerances; what each part of the error may be
``chosen``, ``reasons``         JSON attributes           entries that were chosen, by dotted name, and why
``kept``                        JSON attribute            entries that the scene gave itself
``reference``                   JSON attribute            ``model`` that errors are against (``full``, ``components``),
                                                          what it was predicted to take (s), why, and how far it is from
                                                          the mesh, by output
``remarks``                     JSON attribute            what was not varied, what does not count, the meshes' error
``/selection/errors``           (n_attempts, n_outputs)   largest error of every attempt; attribute ``outputs`` (JSON)
``/selection/largest``          (n_attempts)              what was compared with the allowed error
``/selection/cost``             (n_attempts)              multiplications a sample and Newton correction; 0 for steps
``/selection/seconds``          (n_attempts)              wall time of the attempt
``/selection/steps``            (n_attempts)              time steps
``/selection/attempts``         (n_attempts)              JSON: part, entries, where the error is, why it failed
``/selection/training/<name>``  (n_samples)               training values of a parameter
``training``                    JSON attribute            training loads: name and description
=============================== ========================= =======================================================
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from pgmp_petsc.runtime.files import put, shapes_of, take

if TYPE_CHECKING:
    import h5py

GROUP = "selection"
MAPPINGS = ("tolerances", "allowed", "chosen", "reasons", "kept")


@dataclass(frozen=True)
class Attempt:
    """Something that was tried.

    Parameters
    ----------
    part : str
        Part of the error that was looked at: ``basis``, ``interpolation`` or ``step``.
    entries : dict
        Entries of the scene that it stands for, without their table's name.
    n_steps : int
        Time steps.
    errors : ndarray, shape (n_outputs,)
        Largest error of every output, a share of its largest value over time.
    largest : float
        What was compared with the allowed error.
    where : str
        Output, load and parameter values of the largest error.
    cost : float
        Multiplications a sample and Newton correction.
    seconds : float
        Wall time.
    reason : str
        Why it could not be run; empty where it could.
    """

    part: str
    entries: Mapping[str, Any]
    n_steps: int
    errors: np.ndarray
    largest: float
    where: str
    cost: float = 0.0
    seconds: float = 0.0
    reason: str = ""


@dataclass(frozen=True)
class Selection:
    """What was chosen; see the table above."""

    tolerances: Mapping[str, float]
    allowed: Mapping[str, float]
    chosen: Mapping[str, Any]
    reasons: Mapping[str, str]
    kept: Mapping[str, Any]
    attempts: tuple[Attempt, ...]
    outputs: tuple[str, ...]
    values: Mapping[str, np.ndarray]
    loads: Mapping[str, str]
    remarks: tuple[str, ...]
    reference: Mapping[str, Any] = field(default_factory=dict)

    def write_into(self, file: h5py.File) -> None:
        """Write the group into an open file."""
        group = file.create_group(GROUP)
        for name in MAPPINGS:
            group.attrs[name] = json.dumps(dict(getattr(self, name)))
        group.attrs["remarks"] = json.dumps(self.remarks)
        group.attrs["reference"] = json.dumps(dict(self.reference))
        group.attrs["training"] = json.dumps(dict(self.loads))
        n = len(self.attempts)
        errors = np.array([attempt.errors for attempt in self.attempts]).reshape(n, len(self.outputs))
        about = "largest error of every attempt, a share of the output's largest value over time, (attempt, output)"
        put(group, "errors", errors, "1", about).attrs["outputs"] = json.dumps(self.outputs)
        columns = (
            ("largest", "largest", "1", "what was compared with the allowed error"),
            ("cost", "cost", "1", "multiplications a sample and Newton correction, 0 where a step was tried"),
            ("seconds", "seconds", "s", "wall time of the attempt"),
            ("steps", "n_steps", "1", "time steps"),
        )
        for name, attribute, unit, about in columns:
            put(group, name, np.array([getattr(attempt, attribute) for attempt in self.attempts]), unit, about)
        texts = [
            json.dumps({"part": a.part, "entries": dict(a.entries), "where": a.where, "reason": a.reason})
            for a in self.attempts
        ]
        put(group, "attempts", texts, "1", "what was tried, JSON")
        training = group.create_group("training")
        for name, values in self.values.items():
            put(training, name, values, "SI", "training values")

    @classmethod
    def read(cls, file: h5py.File) -> Selection | None:
        """Read the group of an open file; None where it has none."""
        if GROUP not in file:
            return None
        group = file[GROUP]
        with shapes_of(file):
            errors, texts = take(group, "errors", 2), [json.loads(text) for text in group["attempts"].asstr()[()]]
            columns = [take(group, name, 1).tolist() for name in ("steps", "largest", "cost", "seconds")]
            attempts = tuple(
                Attempt(errors=row, n_steps=n, largest=largest, cost=cost, seconds=seconds, **text)
                for text, row, n, largest, cost, seconds in zip(texts, errors, *columns, strict=True)
            )
            return cls(
                **{name: json.loads(group.attrs[name]) for name in MAPPINGS},
                attempts=attempts,
                outputs=tuple(json.loads(group["errors"].attrs["outputs"])),
                values={name: take(group, f"training/{name}", 1) for name in group["training"]},
                loads=json.loads(group.attrs["training"]),
                remarks=tuple(json.loads(group.attrs["remarks"])),
                reference=json.loads(group.attrs["reference"]),
            )

    def lines(self, attempts: bool = True) -> list[str]:
        """Say what was chosen and why, what was tried (if `attempts`), and on what."""
        asked = " and ".join(f"{table}.tolerance = {value:g}" for table, value in self.tolerances.items())
        lines = [f"chosen for {asked}"]
        lines += [f"  {name} = {json.dumps(value)}{self._why(name)}" for name, value in self.chosen.items()]
        if self.kept:
            given = ", ".join(f"{name} = {json.dumps(value)}" for name, value in self.kept.items())
            lines.append(f"  kept as given: {given}")
        for part, allowed in self.allowed.items() if attempts else ():
            tried = [attempt for attempt in self.attempts if attempt.part == part]
            if tried:
                lines.append(f"  {part}, allowed {allowed:.2g} of an output's largest value:")
                lines += [f"    {_attempt_text(attempt)}" for attempt in tried]
        for name, values in self.values.items():
            lines.append(f"  trained on {name} = {', '.join(f'{value:.4g}' for value in values)}")
        lines += [f"  trained on load '{name}': {about}" for name, about in self.loads.items()]
        return lines + [f"  {remark}" for remark in self.remarks]

    def _why(self, name: str) -> str:
        reason = self.reasons.get(name, "")
        return f": {reason}" if reason else ""


def _attempt_text(attempt: Attempt) -> str:
    what = ", ".join(f"{name} = {json.dumps(value)}" for name, value in attempt.entries.items())
    error = attempt.reason or f"{attempt.largest:.2g} ({attempt.where})"
    return f"{what}: {error}"
