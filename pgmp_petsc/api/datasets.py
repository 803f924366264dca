"""Results as datasets of xarray: their arrays by name, with units and descriptions as attributes.

Outputs have their own names; what else there is begins with its kind and a dot, which no name of a scene has:
``parameter.r1``, ``state.theta``, ``error.crank_angle``, ``energy.kinetic``. A result declares these names (``label``).
"""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

from pgmp_petsc import __version__
from pgmp_petsc.declare.records import Record
from pgmp_petsc.declare.views import variables
from pgmp_petsc.results.summary import origin_of
from pgmp_petsc.runtime.errors import InputError

if TYPE_CHECKING:
    import xarray

    from pgmp_petsc.api.result import Result


def dataset_of(result: Result) -> xarray.Dataset:
    """Return the dataset of a result.

    Raises
    ------
    InputError
        If xarray is not installed, or results of its kind have none.
    """
    try:
        import xarray
    except ImportError as error:
        raise InputError(
            "to_xarray: the package xarray is not installed (pip install 'xarray<2024.4' suits numpy before 2); the "
            f"arrays themselves are attributes of the result ({error})"
        ) from error
    found = [*variables(result.data)] if isinstance(result.data, Record) else []
    if not found:
        raise InputError(f"to_xarray: there is no dataset of a {result.kind}; its arrays are attributes")
    axes = {axis for _, one in found for axis in one.axes} | {name for name, one in found if one.is_axis}
    taken = [name for name, one in found if name in axes and not one.is_axis]
    if taken:
        raise InputError(
            f"to_xarray: '{taken[0]}' is the name of an axis of the dataset; give the scene's another name"
        )
    record = result.record
    about = {
        "kind": result.kind,
        "scene": origin_of(record)["scene"],
        "program_version": __version__,
        "parameters": json.dumps(record.parameters),
        "remarks": [str(remark) for remark in record.remarks],
    }
    about |= {"model": result.data.model} if hasattr(result.data, "model") else {}
    about |= {} if record.seed is None else {"seed": record.seed}
    arrays = {
        is_axis: {name: (one.axes, one.values, one.attributes) for name, one in found if one.is_axis is is_axis}
        for is_axis in (False, True)
    }
    return xarray.Dataset(arrays[False], arrays[True], about)
