"""The assembly branch of a mechanism in a file."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pgmp_petsc.mechanism.continuation import PoseBranch
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
    poses, sizes = take(group, "poses", 3), np.atleast_1d(about["shape"])
    if not (sizes.ndim == 1 and sizes.dtype.kind in "iu" and np.all(sizes > 1) and np.prod(sizes) == len(poses)):
        raise _misfit(group)
    ends = zip(np.atleast_1d(about["lower"]), np.atleast_1d(about["upper"]), sizes, strict=True)
    axes = tuple(np.linspace(lower, upper, n) for lower, upper, n in ends)
    branch = PoseBranch(
        axes,
        poses,
        take(group, "rates", 4),
        take(group, "curvatures", 5),
        take(group, "winding", 2),
        bool(about["is_exact"]),
        int(about["n_redundant"]),
    )
    r, shape = len(axes), poses.shape
    fits = branch.rates.shape == (*shape, r) and branch.curvatures.shape == (*shape, r, r)
    if not fits or branch.winding.shape != (r, shape[1]) or not np.isfinite(np.concatenate(axes)).all():
        raise _misfit(group)
    return branch


def _misfit(group: h5py.Group) -> InputError:
    return InputError(f"file '{group.file.filename}': the parts of kinematics do not fit together; {BUILD_AGAIN}")
