"""What was chosen for a scene, and why, parts of a reduced model's file: effects by their sizes, entries for
tolerances. The assembled mechanism at the start, which a picture of a scene needs."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from pgmp_petsc.declare.records import JSON, Record, array, attribute
from pgmp_petsc.results.trajectory import Frames

_TEXTS = (json.dumps, lambda text: tuple(json.loads(text)))


@dataclass(frozen=True)
class EffectSize(Record):
    """The size of one effect; its name in the scene, "" if the scene does not have it."""

    name: str = attribute("shares@names", about="names in the scene (JSON)")
    kind: str = attribute("shares@kinds", about="types of the effects (JSON)")
    share: float = array(
        at="shares", about="size of each effect as a share, NaN where only a threshold is known", gaps=True
    )
    keeps: bool = attribute(
        "shares@keeps", code=(bool, bool), about="whether it is above the tolerance, or what the scene is about (JSON)"
    )
    measure: str = attribute(
        "shares@measures", about="what the share is of, or from which number on the effect would matter (JSON)"
    )


@dataclass(frozen=True)
class EffectSizes(Record):
    """The sizes of all effects of a scene, those of the scene first."""

    tolerance: float = attribute("effects/shares@tolerance", about="share above which an effect matters")
    sizes: tuple[EffectSize, ...] = array("effect", at="effects")
    largest_speed: dict[str, float] = attribute(
        "effects/shares@speeds", code=JSON, about="largest speed of each coordinate (JSON)"
    )
    exchanged: float = attribute("effects/shares@exchanged", unit="J", about="energy moved around")
    warnings: tuple[str, ...] = attribute(
        "effects/shares@warnings", code=_TEXTS, about="what the scene leaves out that exceeds the tolerance (JSON)"
    )
    units: dict[str, str] = attribute(
        "effects/shares@units", code=JSON, absent={}, about="unit of each coordinate, rad where it is not said (JSON)"
    )
    joule: str = attribute(
        "effects/shares@joule", absent="J", when=lambda own: own.joule != "J",
        about="unit of the energy moved around, J where it is not said",
    )  # fmt: skip

    def lines(self) -> list[str]:
        per = {name: f"{self.units.get(name, 'rad')}/s" for name in self.largest_speed}
        speeds = ", ".join(f"{name} up to {speed:.3g} {per[name]}" for name, speed in self.largest_speed.items())
        lines = [
            f"  sizes of effects in the motion of the rigid mechanism: {speeds}; {self.exchanged:.3g} {self.joule} "
            "moved around",
            f"  an effect matters from a share of {self.tolerance:g} on",
        ]
        for size in self.sizes:
            share = "        -" if np.isnan(size.share) else f"{size.share:9.2g}"
            verdict = "keep " if size.keeps else "leave"
            verdict = verdict if not np.isnan(size.share) or size.name else "-    "
            name = f"{size.name} ({size.kind})" if size.name else f"({size.kind})"
            lines.append(f"    {name:38s} {share}  {verdict}  {size.measure}")
        return lines + [f"  warning: {warning}" for warning in self.warnings]


@dataclass(frozen=True)
class Assembly:
    """Undeformed bodies at one configuration, with the names of what is on them."""

    scene: str  # name of the scene
    configuration: str  # in words: ``theta = 0 rad``
    frames: Frames  # one frame: where the bodies are
    #: joints, points: places of joints and of named points (``crank:tip``, ``ground:origin``), m
    joints: dict[str, np.ndarray]
    points: dict[str, np.ndarray]
    spans: dict[str, np.ndarray]  # of what acts between two points both, (2, d), m
    metre: str = "m"  # unit of places


def spans_in(tables: Mapping[str, Any]) -> dict[str, tuple[str, str]]:
    """Return the two points of each spring, rope, cylinder and other effect that acts between two, and of distances
    that are coordinates, by their names in the tables of a scene."""
    entries = {**tables.get("coordinates", {}), **tables.get("effects", {})}
    pulls = {name: (one["point"], one["towards"]) for name, one in entries.items() if one.get("towards")}
    return pulls | {name: tuple(one["points"]) for name, one in entries.items() if one.get("points")}


GROUP = "selection"
_MAPPING = (lambda values: json.dumps(dict(values)), json.loads)


def _mapping(name: str, about: str, **how: Any) -> Any:
    return attribute(f"{GROUP}@{name}", code=_MAPPING, about=f"{about} (JSON)", **how)


@dataclass(frozen=True)
class Attempt(Record):
    """Something that was tried: the part of the error (basis, interpolation or step), entries of the scene without
    their table's name, where the error is largest, and the reason why it could not be run, empty where it could."""

    part: str = array(at="attempts", part="part", about="what was tried, JSON")
    entries: Mapping[str, Any] = array(at="attempts", part="entries", code=(dict, dict))
    n_steps: int = array(at="steps", about="time steps")
    errors: np.ndarray = array(
        "output", gaps=True,
        about="largest error of every attempt, a share of the output's largest value over time, (attempt, output)",
    )  # fmt: skip
    largest: float = array(about="what was compared with the allowed error", gaps=True)
    where: str = array(at="attempts", part="where")
    cost: float = array(
        about="multiplications a sample and Newton correction, 0 where a step was tried", default=0.0, gaps=True
    )
    seconds: float = array(unit="s", about="wall time of the attempt", default=0.0, gaps=True)
    reason: str = array(at="attempts", part="reason", default="")


@dataclass(frozen=True)
class Selection(Record):
    """The entries that were chosen for the tolerances, and why."""

    tolerances: Mapping[str, float] = _mapping("tolerances", "the scene's tolerances")
    allowed: Mapping[str, float] = _mapping("allowed", "what each part of the error may be")
    chosen: Mapping[str, Any] = _mapping("chosen", "entries that were chosen, by dotted name")
    reasons: Mapping[str, str] = _mapping("reasons", "why they were")
    kept: Mapping[str, Any] = _mapping("kept", "entries that the scene gave itself")
    attempts: tuple[Attempt, ...] = array("attempt", at=GROUP)
    outputs: tuple[str, ...] = attribute(
        f"{GROUP}/errors@outputs", "output", code=_TEXTS, about="names of the outputs (JSON)"
    )
    values: Mapping[str, np.ndarray] = array(
        "training", at=f"{GROUP}/training", unit="SI", about="training values", gaps=True, ordered=True
    )
    loads: Mapping[str, str] = _mapping("training", "training loads: name and description")
    remarks: tuple[str, ...] = attribute(
        f"{GROUP}@remarks", code=_TEXTS, about="what was not varied, what does not count, the meshes' error (JSON)"
    )
    reference: Mapping[str, Any] = _mapping(
        "reference", "what errors are against (full, components), what it was predicted to take (s), why, and how far "
        "it is from the mesh, by output", default={},
    )  # fmt: skip

    def lines(self, attempts: bool = True) -> list[str]:
        """Say what was chosen and why, what was tried (if `attempts`), and on what."""
        asked = " and ".join(f"{table}.tolerance = {value:g}" for table, value in self.tolerances.items())
        lines = [f"chosen for {asked}"]
        chosen = {f"  {name} = {json.dumps(value)}": self.reasons.get(name) for name, value in self.chosen.items()}
        lines += [f"{text}: {reason}" if reason else text for text, reason in chosen.items()]
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


def _attempt_text(attempt: Attempt) -> str:
    what = ", ".join(f"{name} = {json.dumps(value)}" for name, value in attempt.entries.items())
    error = attempt.reason or f"{attempt.largest:.2g} ({attempt.where})"
    return f"{what}: {error}"
