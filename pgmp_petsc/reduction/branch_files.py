"""The assembly branch of a mechanism in a file."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pgmp_petsc.mechanism.pose_branch import PoseBranch
from pgmp_petsc.runtime.errors import InputError
from pgmp_petsc.runtime.files import BUILD_AGAIN, put, take

if TYPE_CHECKING:
    import h5py

POSES = "m of positions, rad of angles, 1 of directors"


def put_branch(group: h5py.Group, branch: PoseBranch) -> None:
    """Write a branch; attributes `lower`, `upper` and `shape` give its grid."""
    group.attrs.update(
        lower=[axis[0] for axis in branch.axes],
        upper=[axis[-1] for axis in branch.axes],
        shape=[axis.size for axis in branch.axes],
        is_exact=branch.is_exact,
        n_redundant=branch.n_redundant,
    )
    about = "poses of the undeformed bodies, (theta, body, unknown)"
    put(group, "poses", branch.poses, POSES, f"{about}, last coordinate fastest")
    put(group, "rates", branch.rates, f"{POSES}; per rad", "their derivatives, (theta, body, unknown, coordinate)")
    about = "their second derivatives, (theta, body, unknown, coordinate, coordinate)"
    put(group, "curvatures", branch.curvatures, f"{POSES}; per rad^2", about)
    put(group, "winding", branch.winding, "1", "turns of bodies in a turn of a coordinate, (coordinate, body)")


def take_branch(group: h5py.Group) -> PoseBranch:
    """Read a branch.

    Raises
    ------
    InputError
        If its parts do not fit together.
    """
    about = group.attrs
    ends = zip(np.atleast_1d(about["lower"]), np.atleast_1d(about["upper"]), np.atleast_1d(about["shape"]))
    axes = tuple(np.linspace(lower, upper, int(n)) for lower, upper, n in ends)
    branch = PoseBranch(
        axes,
        take(group, "poses", 3),
        take(group, "rates", 4),
        take(group, "curvatures", 5),
        take(group, "winding", 2),
        bool(about["is_exact"]),
        int(about["n_redundant"]),
    )
    r, shape = len(axes), branch.poses.shape
    fits = shape[0] == np.prod([axis.size for axis in axes]) and min(axis.size for axis in axes) > 1
    fits &= branch.rates.shape == (*shape, r) and branch.curvatures.shape == (*shape, r, r)
    if not fits or branch.winding.shape != (r, shape[1]):
        raise InputError(f"file '{group.file.filename}': the parts of kinematics do not fit together; {BUILD_AGAIN}")
    return branch
