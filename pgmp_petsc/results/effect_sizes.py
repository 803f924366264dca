"""Sizes of effects, as estimated before a build: what to keep and what to leave.

In a reduced model whose effects were chosen (``effects = "auto"``) they are the group ``effects``: ``shares`` (n), with
the attributes ``tolerance``, ``exchanged`` (J), ``names``, ``kinds``, ``keeps``, ``measures``, ``speeds`` (rad/s) and
``warnings``, all JSON.

The assembled mechanism as it stands at the start: what a picture of a scene needs.
"""

from __future__ import annotations

import json
from dataclasses import dataclass

import h5py
import numpy as np

from pgmp_petsc.results.trajectory import Frames
from pgmp_petsc.runtime.files import put, take


@dataclass(frozen=True)
class EffectSize:
    """The size of one effect.

    Attributes
    ----------
    name
        Name in the scene, or "" if the scene does not have it.
    kind
        Type of the effect.
    share
        Its size as a share, NaN where only a threshold can be given.
    keeps
        Whether it exceeds the tolerance, or is what the scene is about.
    measure
        What the share is a share of, or from which number on the effect would matter.
    """

    name: str
    kind: str
    share: float
    keeps: bool
    measure: str


@dataclass(frozen=True)
class EffectSizes:
    """The sizes of all effects of a scene.

    Attributes
    ----------
    tolerance
        Share above which an effect matters.
    sizes
        Of every effect, those of the scene first.
    largest_speed
        Largest speed of each coordinate, rad/s, and `exchanged`: the energy moved around, J.
    warnings
        What the scene leaves out that exceeds the tolerance.
    """

    tolerance: float
    sizes: tuple[EffectSize, ...]
    largest_speed: dict[str, float]
    exchanged: float
    warnings: tuple[str, ...]

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

    def write(self, file: h5py.File) -> None:
        """Write the group ``effects``."""
        shares = np.array([size.share for size in self.sizes])
        data = put(
            file, "effects/shares", shares, "1", "size of each effect as a share, NaN where only a threshold is known"
        )
        data.attrs["tolerance"], data.attrs["exchanged"] = self.tolerance, self.exchanged
        lists = {
            "names": [size.name for size in self.sizes],
            "kinds": [size.kind for size in self.sizes],
            "keeps": [bool(size.keeps) for size in self.sizes],
            "measures": [size.measure for size in self.sizes],
            "speeds": self.largest_speed,
            "warnings": self.warnings,
        }
        for key, value in lists.items():
            data.attrs[key] = json.dumps(value)

    @classmethod
    def read(cls, file: h5py.File) -> EffectSizes | None:
        """Read what `write` wrote; None where there is nothing."""
        if "effects/shares" not in file:
            return None
        shares, attributes = take(file, "effects/shares", 1), file["effects/shares"].attrs
        columns = [json.loads(attributes[key]) for key in ("names", "kinds", "keeps", "measures")]
        sizes = tuple(
            EffectSize(name, kind, float(share), keeps, measure)
            for share, name, kind, keeps, measure in zip(shares, *columns)
        )
        return cls(
            float(attributes["tolerance"]),
            sizes,
            json.loads(attributes["speeds"]),
            float(attributes["exchanged"]),
            tuple(json.loads(attributes["warnings"])),
        )


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
