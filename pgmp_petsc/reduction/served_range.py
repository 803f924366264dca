"""How far from its nominal parameters a reduced model serves.

A build tries the values that span its scene's distributions (`scene.spanning_values`: quantiles at three standard
deviations, or bounds): at these its matrices were looked at, and bases by tolerance were chosen. Half as far again is
served without a word; six standard deviations cost 1.6 % of the deformation where three cost 0.3 %
(`tests/hard_cases/test_far_from_nominal.py`). What lies outside is counted and warned of. Three times as far away as
the span it is refused: values of single runs, samples of a file, and distributions of which the greater part lies
there. Lengths and places are not served beyond the points of their polynomials at all. Of parameters that no
distribution and no bounds of the build's scene say anything of, 30 % around the nominal value are taken for the span.
What tables do not depend on, loads and local effects, may be anything.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from pgmp_petsc.reduction.rom import ReducedOrderModel
from pgmp_petsc.runtime.errors import InputError, Remark, warning
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.parameters import Parameter
from pgmp_petsc.scene.spanning_values import spanning_values

WIDER, FARTHEST = 1.5, 3.0  # times the span that a build tries
UNSAID = 0.3  # of the nominal value
NOTICED = 1e-4  # share of a distribution beyond what is served
ROUND_OFF = 1e-12  # of shares of distributions
CURE = "build with distributions, or bounds, that hold them (pgmp build SCENE)"


@dataclass(frozen=True)
class Served:
    """Values of a parameter that a reduced model serves."""

    #: low, high: ends of the range that is served without a warning
    low: float
    high: float
    #: least, most: ends beyond which it is refused
    least: float
    most: float

    @property
    def is_sharp(self) -> bool:
        """Whether nothing is served outside the range at all: that of a length."""
        return (self.low, self.high) == (self.least, self.most)

    def outside(self, values: np.ndarray) -> np.ndarray:
        """Return which values are not served without a warning."""
        return (values < self.low) | (values > self.high)

    def beyond(self, values: np.ndarray) -> np.ndarray:
        """Return which values are refused."""
        return (values < self.least) | (values > self.most)


def served_ranges(built: Scene, rom: ReducedOrderModel) -> dict[str, Served]:
    """Return the ranges of the parameters that the tables of a reduced model depend on, by name.

    Parameters
    ----------
    built
        The scene that it was built from.
    """
    weights = (*rom.tables.mass_weights, *rom.tables.stiffness_weights)
    found = {}
    for name in sorted({name for weight in weights for name, _ in weight.powers}):
        parameter = built.parameters[name]
        nominal = parameter.nominal
        low, high = (nominal - UNSAID * abs(nominal), nominal + UNSAID * abs(nominal))
        if parameter.distribution is not None or parameter.bounds is not None:
            tried = spanning_values(built, [name])[0][name]
            low, high = float(tried.min()), float(tried.max())
        ends = [nominal + factor * (end - nominal) for factor in (WIDER, FARTHEST) for end in (low, high)]
        found[name] = Served(*ends)
    if rom.family is not None:
        grid = rom.family.grid
        found |= {name: Served(low, high, low, high) for name, (low, high) in zip(grid.names, grid.ranges)}
    return found


def check_served(ranges: Mapping[str, Served], scene: Scene) -> tuple[Remark, ...]:
    """Return warnings of values of a single run, and of distributions, outside what is served.

    Raises `InputError` if a value, or the greater part of a distribution, is beyond what is served.
    """
    return tuple(warning(text) for name, served in ranges.items() for text in _of_parameter(name, served, scene))


def refuse_beyond(ranges: Mapping[str, Served], values: Mapping[str, np.ndarray], where: str) -> None:
    """Refuse samples beyond what is served; parameters as of `outside_of`.

    Raises `InputError`, naming the first of them.
    """
    for name, served in ranges.items():
        beyond = served.beyond(values.get(name, np.zeros(0)))
        if beyond.any():
            first = int(np.argmax(beyond))
            raise InputError(
                f"{where}: {int(beyond.sum())} of {beyond.size} samples are beyond what the reduced model serves, "
                f"number {first} with {name} = {values[name][first]:.6g}, which must be within [{served.least:.6g}, "
                f"{served.most:.6g}]; {CURE}"
            )


def outside_of(ranges: Mapping[str, Served], values: Mapping[str, np.ndarray], where: str) -> tuple[Remark, ...]:
    """Return a warning that counts samples outside what is served; nothing where all are inside.

    Parameters
    ----------
    values
        Of the parameters, shape (n,) each.
    where
        What the samples are, before the message.
    """
    known, lines = {name: served for name, served in ranges.items() if name in values}, []
    outside = {name: served.outside(values[name]) for name, served in known.items()}
    for name, which in outside.items():
        if which.any():
            lines.append(f"{int(which.sum())} in {name} ([{known[name].low:.6g}, {known[name].high:.6g}])")
    if not lines:
        return ()
    n = int(np.any(list(outside.values()), axis=0).sum())
    count = len(next(iter(outside.values())))
    return (
        warning(
            f"{where}: {n} of {count} samples are outside the range that the reduced model was built for, "
            f"{', '.join(lines)}; look at their estimated errors, or {CURE}"
        ),
    )


def _of_parameter(name: str, served: Served, scene: Scene) -> Iterator[str]:
    parameter, value = scene.parameters[name], np.array(scene.values[name])
    entry = f"parameters.{name}.value"
    if served.beyond(value):
        raise InputError(
            f"{entry} = {value:.6g}: beyond what the reduced model serves, [{served.least:.6g}, {served.most:.6g}]; "
            f"{CURE}, or take pgmp simulate SCENE --full"
        )
    if served.outside(value):
        yield (
            f"{entry} = {value:.6g}: outside [{served.low:.6g}, {served.high:.6g}], the range that the reduced model "
            f"was built for; look at the estimated errors, or {CURE}"
        )
    if parameter.distribution is None:
        return
    share, beyond = (
        1.0 - _share(parameter, *ends) for ends in ((served.low, served.high), (served.least, served.most))
    )
    what = (
        f"parameters.{name}.distribution: {100 * share:.2g} % of it lie outside [{served.low:.6g}, {served.high:.6g}]"
    )
    if served.is_sharp and beyond > ROUND_OFF:
        raise InputError(f"{what}, beyond which the reduced model serves no length and no place; {CURE}")
    if beyond > 0.5:
        raise InputError(
            f"{what}, the range that the reduced model was built for, and the greater part beyond what it serves, "
            f"[{served.least:.6g}, {served.most:.6g}]; {CURE}"
        )
    if share > NOTICED:
        yield f"{what}, the range that the reduced model was built for; look at the estimated errors, or {CURE}"


def _share(parameter: Parameter, low: float, high: float) -> float:
    """Return the share of a distribution, truncated to its bounds, between two numbers."""
    law, (least, most) = parameter.distribution.law, parameter.bounds or (-np.inf, np.inf)
    inside = float(law.cdf(min(high, most)) - law.cdf(max(low, least)))
    return max(inside, 0.0) / float(law.cdf(most) - law.cdf(least))
