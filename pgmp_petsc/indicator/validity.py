"""How far a run leaves the small deformations that a linear reduced basis assumes.

**Elastic rotation**: the largest rotation of a node less that of its rigid body, rad; `results.errors` says from where
on it is too large.

**Elastic strain**: the largest strain along the outermost fibre of a beam, ``|eps| + c |kappa|`` with c half its
height. Steel yields at about 0.002.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.results.errors import VALIDITY
from pgmp_petsc.scene import Scene


class Validity:
    """Largest elastic rotations and strains of n samples, gathered over a run.

    Attributes
    ----------
    largest
        ``elastic_rotation`` (rad) and ``elastic_strain``, each of shape (n,).
    """

    def __init__(self, scene: Scene, mechanism: Mechanism, values: Mapping[str, np.ndarray], n: int) -> None:
        self._mechanism = mechanism
        self._half_heights = [half_height(scene, body.name, values) for body in mechanism.bodies]
        self.largest = {name: np.zeros(n) for name in VALIDITY}

    def add(self, frames: np.ndarray, poses: np.ndarray) -> None:
        """Take in some instants.

        Parameters
        ----------
        frames
            Of all nodes, shape (n_nodes, 3, n_instants, n).
        poses
            Of the rigid bodies, shape (n_bodies, 3, n_instants, n).
        """
        rotations, strains = [], []
        for body, pose, half in zip(self._mechanism.bodies, poses, self._half_heights):
            rotations.append(np.max(np.abs(frames[body.nodes, 2] - pose[2]), axis=(0, 1)))
            ends = frames[body.elements]  # (n_elements, 2, 3, n_instants, n)
            length = body.mesh.lengths[:, None, None]
            angle = 0.5 * (ends[:, 0, 2] + ends[:, 1, 2]) + body.directions[:, None, None]
            change = ends[:, 1] - ends[:, 0]
            axial = (np.cos(angle) * change[:, 0] + np.sin(angle) * change[:, 1]) / length - 1.0
            bending = change[:, 2] / length
            strains.append(np.max(np.abs(axial) + half * np.abs(bending), axis=(0, 1)))
        for name, found in zip(VALIDITY, (rotations, strains)):
            self.largest[name] = np.maximum(self.largest[name], np.max(found, axis=0))


def half_height(scene: Scene, body: str, values: Mapping[str, np.ndarray]) -> np.ndarray | float:
    """Return the distance of a beam's outermost fibre from its axis, m."""
    section = scene.bodies[body].section
    if section.shape == "circle":
        return scene.number(section.radius, values)
    return 0.5 * scene.number(section.height, values)
