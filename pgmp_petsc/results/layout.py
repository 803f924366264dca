"""What the kinds of result file have in common: groups of named arrays, and checks of shapes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import numpy as np

from pgmp_petsc.runtime.files import put, take

if TYPE_CHECKING:
    import h5py

MODELS = ("full", "components", "reduced")


def check_shape(name: str, data: np.ndarray, shape: tuple[int | None, ...]) -> None:
    """Raise `ValueError` unless ``data`` has the given shape; None stands for any length."""
    fits = data.ndim == len(shape) and all(want in (None, got) for want, got in zip(shape, data.shape))
    if not fits:
        wanted = ", ".join("any" if length is None else str(length) for length in shape)
        raise ValueError(f"{name} has shape {data.shape}; needed: ({wanted})")


def check_model(model: str) -> None:
    """Raise `ValueError` unless ``model`` names one of the two models."""
    if model not in MODELS:
        raise ValueError(f"model is '{model}'; allowed: {', '.join(MODELS)}")


def take_known(group: h5py.Group, name: str, n_dimensions: int) -> np.ndarray:
    """Read a dataset in which no number may be missing; raises `ValueError` where one is NaN."""
    data = take(group, name, n_dimensions)
    if np.isnan(data).any():
        raise ValueError(f"dataset '{group.name.rstrip('/')}/{name}' holds NaN, which no number of it can be")
    return data


def put_named(
    file: h5py.File, group: str, arrays: Mapping[str, np.ndarray], units: Mapping[str, str], description: str
) -> None:
    """Write arrays as ``/<group>/<name>``, kept in their order; ``{name}`` in the description is replaced."""
    target = file.create_group(group, track_order=True)
    for name, data in arrays.items():
        put(target, name, data, units.get(name, "1"), description.format(name=name))


def take_named(
    file: h5py.File, group: str, n_dimensions: int, read: Callable[[h5py.Group, str, int], np.ndarray] = take
) -> dict[str, np.ndarray]:
    """Read all arrays of a group, in the order of writing; an absent group is an empty one."""
    return {name: read(file[group], name, n_dimensions) for name in file.get(group, {})}


def units_of(file: h5py.File, *groups: str) -> dict[str, str]:
    """Return the unit of every array in the groups."""
    return {name: str(data.attrs["unit"]) for group in groups for name, data in file.get(group, {}).items()}


def frame_name(number: int) -> str:
    """Return the dataset name of a frame: ``00012``."""
    return f"{number:05d}"
