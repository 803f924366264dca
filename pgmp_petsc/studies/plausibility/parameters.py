"""Parameters: their distribution, bounds and nominal value."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.parameters import Parameter
from pgmp_petsc.scene.uses import uses_of
from pgmp_petsc.studies.plausibility.finding import Finding, doubt, refusal

CUT_OFF = 0.01  # share of a distribution beyond its bounds
NOT_POSITIVE = 1e-3  # share of a distribution where a parameter makes no sense
FAR = 1e-6  # share of a distribution beyond the nominal value
OTHER_UNIT = 300.0  # ratio of median and nominal value, from which on one of them is in another unit


def parameter_findings(scene: Scene) -> Iterator[Finding]:
    """Yield what is strange about parameters."""
    signs = {use.parameter: use.sign for use in uses_of(scene) if use.parameter is not None}
    for name, parameter in scene.parameters.items():
        if parameter.distribution is not None:
            with np.errstate(all="ignore"):  # distributions with arguments at the ends of what floats hold
                yield from _distribution(f"parameters.{name}", parameter, signs.get(name, "any"))


def _distribution(entry: str, parameter: Parameter, sign: str) -> Iterator[Finding]:
    law, nominal = parameter.distribution.law, parameter.nominal
    median = float(law.median())
    unit = f" {parameter.unit}" if parameter.unit else ""
    beyond = min(float(law.cdf(nominal)), float(law.sf(nominal)))
    if not np.isfinite(median):
        yield refusal(f"{entry}.distribution", "has no median that is a number; other arguments are needed")
    elif beyond < FAR and nominal * median > 0 and not 1 / OTHER_UNIT < median / nominal < OTHER_UNIT:
        yield refusal(
            f"{entry}.nominal",
            f"the median of its distribution is {median:.4g}{unit}, {median / nominal:.3g} times as much; is one of "
            "them in another unit? `unit` holds for both",
            nominal,
        )
    elif beyond < FAR:
        yield doubt(
            f"{entry}.nominal",
            f"lies outside its distribution, which has half of its samples below {median:.4g}{unit} and less than "
            f"{FAR:g} of them beyond this; the reduced basis is built where no sample is",
            nominal,
        )
    if parameter.bounds is not None:
        low, high = parameter.bounds
        lost = float(law.cdf(low) + law.sf(high))
        if lost > CUT_OFF:
            yield doubt(
                f"{entry}.bounds",
                f"{100 * lost:.3g} % of its distribution lies beyond them; widen them, or give a narrower distribution",
                list(parameter.bounds),
            )
    least = 0.0 if parameter.bounds is None else max(0.0, parameter.bounds[0])
    without_sense = float(law.cdf(0.0)) if least == 0.0 else 0.0
    if sign != "any" and without_sense > NOT_POSITIVE and (parameter.bounds is None or parameter.bounds[0] < 0.0):
        yield doubt(
            f"{entry}.distribution",
            f"{100 * without_sense:.3g} % of it is below 0, where this parameter makes no sense; give bounds, or a "
            "distribution of positive numbers such as lognorm",
        )
