"""The assembled mechanism as it stands at the start: what a picture of a scene needs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pgmp_petsc.results.trajectory import Frames


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
