"""Random parameter values, keyed by the number of the sample.

Sample k has a random stream of its own, spawned from the seed with key k; the rank that integrates it, the batch it is
in and the number of samples have no part in it. Values follow from uniform numbers by the inverse distribution
function, of the distribution truncated to the parameter's bounds where it has any.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from pgmp_petsc.runtime.errors import InputError
from pgmp_petsc.runtime.remarks import Remark, note, warning
from pgmp_petsc.scene import Scene

MUCH_CUT_OFF = 0.1  # of a distribution by its bounds


def draw(scene: Scene, seed: int, first: int, last: int) -> dict[str, np.ndarray]:
    """Draw samples first to last - 1.

    Parameters with a distribution are drawn, the others keep the value of the run.

    Returns
    -------
    dict of str to ndarray, shape (last - first,)

    Raises
    ------
    InputError
        If no parameter has a distribution.
    """
    uncertain = sorted(name for name, parameter in scene.parameters.items() if parameter.distribution is not None)
    if not uncertain:
        raise InputError(
            "parameters: none has a distribution, so there is nothing to draw from; give one, such as "
            '[parameters.r1] distribution = { name = "norm", loc = 5.6e-3, scale = 0.56e-3 }'
        )
    uniform = np.array([_stream(seed, number).random(len(uncertain)) for number in range(first, last)])
    uniform = uniform.reshape(last - first, len(uncertain))
    values = {name: np.full(last - first, value) for name, value in scene.values.items()}
    for column, name in zip(uniform.T, uncertain):
        values[name] = scene.parameters[name].quantiles(column)
    return values


def draw_remarks(scene: Scene) -> tuple[Remark, ...]:
    """Return what is to be said of the distributions that samples come from."""
    remarks = []
    for name, parameter in scene.parameters.items():
        if parameter.distribution is None:
            continue
        if parameter.value is not None:
            remarks.append(
                note(
                    f"parameters.{name}.value = {parameter.value:g} is that of single runs and has no part in an "
                    "ensemble, which draws from the distribution"
                )
            )
        below, above = parameter.cut_off
        if below + above > 0.0:
            low, high = parameter.bounds
            text = (
                f"parameters.{name}: its distribution is truncated to the bounds [{low:g}, {high:g}] and renormalised; "
                f"they cut off {_percent(below)} below and {_percent(above)} above"
            )
            if below + above > MUCH_CUT_OFF:
                text += "; so much is missing that bounds and distribution may not mean the same quantity: check both"
                remarks.append(warning(text))
            else:
                remarks.append(note(text))
    return tuple(remarks)


def physical(scene: Scene, values: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return which samples lie inside all bounds, finite, and positive where sections and materials need it."""
    fine = np.ones(len(next(iter(values.values()))), dtype=bool)
    for name, parameter in scene.parameters.items():
        fine &= np.isfinite(values[name])
        if parameter.bounds is not None:
            fine &= (values[name] >= parameter.bounds[0]) & (values[name] <= parameter.bounds[1])
    for name in scene.positive_parameters:
        fine &= values[name] > 0.0
    return fine


def _stream(seed: int, number: int) -> np.random.Generator:
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=(number,))))


def _percent(share: float) -> str:
    """Return a share in percent; one that no ensemble notices is nothing."""
    return f"{100 * share:.2g} %" if share > 1e-9 or share == 0.0 else "less than 1e-7 %"
