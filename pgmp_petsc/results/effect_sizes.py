"""Sizes of effects, as estimated before a build: what to keep and what to leave; of a reduced model whose effects were
chosen (``effects = "auto"``).

The assembled mechanism as it stands at the start: what a picture of a scene needs.
"""

from __future__ import annotations

import json
from dataclasses import dataclass

import numpy as np

from pgmp_petsc.declare.records import JSON, Record, array, attribute
from pgmp_petsc.results.trajectory import Frames


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
        "effects/shares@speeds", code=JSON, about="largest speed of each coordinate, rad/s (JSON)"
    )
    exchanged: float = attribute("effects/shares@exchanged", unit="J", about="energy moved around")
    warnings: tuple[str, ...] = attribute(
        "effects/shares@warnings", code=(json.dumps, lambda text: tuple(json.loads(text))),
        about="what the scene leaves out that exceeds the tolerance (JSON)",
    )  # fmt: skip

    def lines(self) -> list[str]:
        """Return the report, line by line."""
        speeds = ", ".join(f"{name} up to {speed:.3g} rad/s" for name, speed in self.largest_speed.items())
        lines = [
            f"  sizes of effects in the motion of the rigid mechanism: {speeds}; {self.exchanged:.3g} J moved around",
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
    """Undeformed bodies at one configuration, with the names of what is on them.

    Parameters
    ----------
    scene : str
        Name of the scene.
    configuration : str
        In words: ``theta = 0 rad``.
    frames : Frames
        One frame: where the bodies are.
    joints, points : dict of str to ndarray, shape (d,)
        Places of joints and of named points (``crank:tip``, ``ground:origin``), m.
    """

    scene: str
    configuration: str
    frames: Frames
    joints: dict[str, np.ndarray]
    points: dict[str, np.ndarray]
