"""The models of a family of lengths in a file: ``/lengths/<number>`` holds the model of each point."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from pgmp_petsc.reduction.length_family import LengthCheck, LengthFamily
from pgmp_petsc.reduction.length_grid import LengthGrid
from pgmp_petsc.runtime.errors import InputError
from pgmp_petsc.runtime.files import BUILD_AGAIN, put, take

if TYPE_CHECKING:
    import h5py

    from pgmp_petsc.reduction.rom import ReducedOrderModel


def put_family(group: h5py.Group, family: LengthFamily) -> None:
    """Write the members of a family; attributes `parameters`, `lower`, `upper` and `n_points` give its grid."""
    grid, check = family.grid, family.check
    lower, upper = np.array(grid.ranges).T
    group.attrs.update(parameters=list(grid.names), lower=lower, upper=upper, n_points=grid.n_points)
    values = np.array([[point[name] for name in grid.names] for point in grid.points])
    put(group, "values", values, "m", "lengths of every model, (model, parameter)")
    about = group.create_group("check")
    about.attrs.update(frequencies=check.frequencies, inertia=check.inertia)
    put(
        about,
        "values",
        np.array([check.values[name] for name in grid.names]),
        "m",
        "lengths of the model compared with",
    )
    for number, member in enumerate(family.members):
        member.write_into(group.create_group(str(number)))


def take_family(group: h5py.Group, member: Callable[[h5py.Group], ReducedOrderModel]) -> LengthFamily:
    """Read what `put_family` wrote; `member` reads the model of a point.

    Raises
    ------
    InputError
        If its parts do not fit together.
    """
    about = group.attrs
    names = tuple(str(name) for name in about["parameters"])
    ranges = tuple((float(low), float(high)) for low, high in zip(about["lower"], about["upper"], strict=True))
    grid, checked = LengthGrid(names, ranges, int(about["n_points"])), group["check"]
    members = tuple(member(group[str(number)]) for number in range(grid.n_points ** len(names)))
    first = members[0]
    fits = all(
        one.tables.mass.shape == first.tables.mass.shape and one.projection.shape == first.projection.shape
        for one in members
    )
    if not fits or len(ranges) != len(names):
        raise InputError(f"file '{group.file.filename}': the models of lengths do not fit together; {BUILD_AGAIN}")
    values = dict(zip(names, (float(value) for value in take(checked, "values", 1)), strict=True))
    check = LengthCheck(values, float(checked.attrs["frequencies"]), float(checked.attrs["inertia"]))
    return LengthFamily(grid, members, check)
