"""Uncertain parameters and their distributions, by the names and conventions of scipy.stats, and some of our own; how
they depend on each other; random fields over bodies; parameter values that span the distributions.

A correlation r is that of the normal variables ``Phi^-1(F(x))`` behind two parameters; their rank correlation
(Spearman's) is ``6 / pi asin(r / 2)`` (Kruskal, Journal of the American Statistical Association 53 (1958) 814-861).
With ``ensemble.copula = "student"`` these variables have a common multivariate t distribution with the matrix of r
(Demarta and McNeil, International Statistical Review 73 (2005) 111-129): Kendall's coefficient is ``2 / pi asin(r)`` as
before, and extremes of two come together with the probability ``2 t_(f + 1)(-sqrt((f + 1) (1 - r) / (1 + r)))``, of
normal ones 0. With ``clayton``, ``gumbel`` and ``frank`` all pairs depend on each other alike, with Kendall's
coefficient of their common r.

Field NAME with n terms has the parameters ``NAME_1`` .. ``NAME_n``, its uncorrelated variables of mean 0 and variance 1
(`bodies.random_fields`): uniform, or normal and cut off at a number of deviations. They are put among the scene's
parameters when it is read, and from there on are parameters like any others.

Bases and steps are tried, before samples come, on nominal values, quantiles at three standard deviations of a normal
distribution (bounds applied as an ensemble does), and the values half-way: alone, the others nominal (a star), and the
outermost ones together (corners).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from itertools import product
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from pydantic import ConfigDict, Field

from pgmp_petsc.base.errors import nearest_name
from pgmp_petsc.scene.distributions import Discrete, Empirical, Mixture, Normal, Uniform, quick
from pgmp_petsc.scene.fields import (
    AnyScene,
    Integer,
    Interval,
    Number,
    OrFile,
    OrText,
    PositiveNumber,
    Table,
    Unit,
    at_most,
    raw_tables,
    refusal,
)
from pgmp_petsc.scene.messages import problem, unknown

if TYPE_CHECKING:
    from scipy.stats import rv_continuous
    from scipy.stats._distn_infrastructure import rv_frozen


POINTS = 200  # of Gauss's quadrature over probabilities


#: Distributions of our own: the key that each needs, and all that it has.
OWN = {
    "discrete": ("values", ("values", "weights")),
    "empirical": ("values", ("values",)),
    "mixture": ("of", ("of", "weights")),
}
FEWEST = {"discrete": 1, "empirical": 2, "mixture": 1}
MOST_VALUES = 10_000  # every file carries them
SIMPLE = {"norm": Normal, "uniform": Uniform}  # without shapes


#: A number in the unit of a parameter, or a text with one of its own, which is converted before a scene is read.
Own = Annotated[Number, OrText()]


class Distribution(Table):
    """A continuous distribution of scipy.stats: its name, with ``loc``, ``scale`` and shapes as keys; or one of
    ``discrete``, ``empirical`` and ``mixture``, which have keys of their own."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, Own]

    name: str = Field(
        description="name of a continuous distribution of scipy.stats, such as norm; or discrete (values with "
        "weights), empirical (measured values, straight lines between them), mixture (of other distributions)"
    )
    values: Annotated[tuple[Own, ...], OrFile(False)] | None = Field(
        None,
        description="of discrete and empirical: numbers, or a file with one in each line (the first may be a name)",
    )
    weights: tuple[Number, ...] | None = Field(
        None, description="of discrete and mixture: how often each comes, in any proportion; equal if not given"
    )
    of: tuple[Distribution, ...] | None = Field(None, description="of mixture: the distributions")

    @property
    def arguments(self) -> dict[str, float]:
        """The arguments of the distribution by name, as given."""
        return dict(self.__pydantic_extra__)

    @property
    def text(self) -> str:
        """Its name, with what it takes in brackets."""
        takes = [f"{key}={value:g}" for key, value in self.arguments.items()]
        takes += [one.text for one in self.of or ()]
        if self.values is not None:
            takes.append(f"{len(self.values)} values from {min(self.values):g} to {max(self.values):g}")
        return f"{self.name}({', '.join(takes)})"

    def _of_scipy(self) -> rv_frozen:
        return _continuous(self.name)(**self.arguments)

    @property
    def frozen(self) -> Normal | Uniform | Discrete | Empirical | Mixture | rv_frozen:
        """The distribution with its arguments fixed: its median, shares below and above numbers, and the reverse."""
        if self.name in OWN:
            return self._own
        return self._simple or quick(self._of_scipy())

    @property
    def is_continuous(self) -> bool:
        """Whether no single value has a share."""
        return self.name not in OWN or not self._own.has_atoms

    @property
    def _own(self) -> Discrete | Empirical | Mixture:
        """One that scipy.stats has no name for."""
        n = len(self.of if self.name == "mixture" else self.values)
        weights = np.ones(n) if self.weights is None else np.array(self.weights)
        if self.name == "mixture":
            return Mixture([one.frozen for one in self.of], weights)
        values = np.array(self.values)
        return Discrete(values, weights) if self.name == "discrete" else Empirical(values)

    @property
    def support(self) -> tuple[float, float]:
        """Smallest and largest value; infinite where there is none."""
        low, high = (self._own if self.name in OWN else self._simple or self._of_scipy()).support()
        return float(low), float(high)

    @property
    def _simple(self) -> Normal | Uniform | None:
        """One of which scipy.stats need not be asked whether its arguments are fine."""
        arguments = {"loc": 0.0, "scale": 1.0} | self.arguments
        fine = len(arguments) == 2 and np.isfinite(list(arguments.values())).all() and arguments["scale"] > 0.0
        return SIMPLE[self.name](**arguments) if fine and self.name in SIMPLE else None

    def check_entries(self) -> None:
        needed, allowed = OWN.get(self.name, ("", ()))
        for key in ("values", "weights", "of"):
            if getattr(self, key) is not None and key not in allowed:
                has = f"its keys are {', '.join(allowed)}" if allowed else f"{', '.join(OWN)} have it"
                raise refusal(f"no key of {self.name}; {has}", key)
        if allowed:
            self._check_own(needed, allowed)
            return
        if self._simple is not None:
            return
        named = _continuous(self.name).shapes
        shapes = named.split(", ") if named else []
        allowed = [*shapes, "loc", "scale"]
        for key in self.arguments:
            if key not in allowed:
                what = f"unknown argument of {self.name}{nearest_name(key, allowed)}"
                raise refusal(f"{what} (allowed: {', '.join(allowed)})", key)
        for key in shapes:
            if key not in self.arguments:
                raise refusal(f"missing; {self.name} needs the shape parameters {', '.join(shapes)}", key)
        if self.arguments.get("scale", 1.0) <= 0.0:
            raise refusal("a positive number is needed", "scale")
        if np.isnan(self._of_scipy().support()).any():
            raise refusal(f"scipy.stats refuses these arguments of {self.name}")

    def _check_own(self, needed: str, allowed: tuple[str, ...]) -> None:
        for key in self.arguments:
            raise refusal(f"no key of {self.name}; its keys are {', '.join(allowed)}", key)
        parts = getattr(self, needed)
        if parts is None:
            raise refusal(f"missing; {self.name} needs it", needed)
        if len(parts) < FEWEST[self.name] or len(parts) > MOST_VALUES:
            raise refusal(f"{FEWEST[self.name]} to {MOST_VALUES:,} are needed, and {len(parts)} are given", needed)
        if self.name == "empirical" and min(parts) == max(parts):
            raise refusal("all values are the same, so nothing is drawn; leave the distribution out", needed)
        if self.weights is None:
            return
        if (n := len(self.weights)) != len(parts):
            raise refusal(f"{len(parts)} are needed, one for each of {needed}; {n} are given", "weights")
        least = min(self.weights)
        if least < 0.0 or (least == 0.0 and self.name == "mixture") or not max(self.weights) > 0.0:
            raise refusal("numbers above 0 are needed, of discrete values 0 too but not of all", "weights")


class Parameter(Table):
    """A quantity that may differ between samples; materials, sections and effects name it."""

    nominal: Own = Field(description="value at which the reduced basis is built")
    unit: str = Field(
        "",
        description="unit of the values, bounds, loc and scale, such as mm; the scene's if not given, to which they "
        "are converted",
    )
    description: str = Field("", description="what the parameter is, for reports")
    distribution: Distribution | None = Field(None, description="distribution that an ensemble draws from")
    bounds: Annotated[Interval, OrText()] | None = Field(
        None, description="smallest and largest value; the distribution is truncated to them, renormalised"
    )
    value: Own | None = Field(None, description="value of a single run (--set); nominal where it is not given")

    @property
    def current(self) -> float:
        """The value of a single run: `value`, or `nominal` where no value was set."""
        return self.nominal if self.value is None else self.value

    def quantiles(self, probabilities: np.ndarray, at_least: float = -np.inf) -> np.ndarray:
        """Return quantiles of the distribution truncated to its bounds, and a further lower one, which is renormalised.

        ``F^-1(F(low) + p (F(high) - F(low)))`` at probabilities of any shape, 0 to 1; where the bounds lie above the
        median by the probabilities of larger values, as those of smaller ones are 1 to round-off in the upper tail.
        """
        drawn, (low, high) = self.distribution.frozen, self._limits
        low, below = max(low, at_least), share_below(drawn)
        if drawn.cdf(low) > 0.5 and not isinstance(drawn, (Discrete, Empirical, Mixture)):
            values = drawn.isf(drawn.sf(low) - probabilities * (drawn.sf(low) - drawn.sf(high)))
        else:
            values = drawn.ppf(below(low) + probabilities * (drawn.cdf(high) - below(low)))
        return np.clip(values, low, high)

    @property
    def cut_off(self) -> tuple[float, float]:
        """The shares of the distribution that the bounds cut off, below and above."""
        drawn, (low, high) = self.distribution.frozen, self._limits
        return float(share_below(drawn)(low)), float(drawn.sf(high))

    @property
    def deviation(self) -> float:
        """The standard deviation of the distribution, truncated to its bounds; of truncated ones to some 1e-4 of it."""
        if sum(self.cut_off) < 1e-9:
            return float(self.distribution.frozen.std())
        places, weights = np.polynomial.legendre.leggauss(POINTS)
        values = self.quantiles(0.5 * (places + 1.0))
        mean = 0.5 * weights @ values
        return float(np.sqrt(0.5 * weights @ (values - mean) ** 2))

    @property
    def _limits(self) -> tuple[float, float]:
        return (-np.inf, np.inf) if self.bounds is None else self.bounds

    @property
    def varies(self) -> bool:
        """Whether it has other values than the nominal one by its distribution or its bounds."""
        return self.distribution is not None or self.bounds is not None

    @property
    def range(self) -> tuple[float, float]:
        """Smallest and largest value by its bounds and its distribution; infinite where neither says an end."""
        (low, high), drawn = self._limits, self.distribution
        least, most = (low, high) if drawn is None else drawn.support
        return max(low, least), min(high, most)

    def check_entries(self) -> None:
        if self.bounds is None:
            return
        low, high = self.bounds
        bounds = f"the parameter's bounds [{low}, {high}] {self.unit}".rstrip()
        for key in ("nominal", "value"):
            number = getattr(self, key)
            if number is not None and not low <= number <= high:
                raise refusal(f"must lie inside {bounds}", key)
        if self.distribution is None:
            return
        drawn = self.distribution.frozen
        below, above = (share_below(drawn)(low), drawn.cdf(high)), (drawn.sf(low), drawn.sf(high))
        if not max(below[1] - below[0], above[0] - above[1]) > 0.0:
            raise refusal(f"gives no samples inside {bounds}", "distribution")
        # scipy.stats counts the turns of circular distributions, such as vonmises: no truncation can draw from that
        if not (0.0 <= below[0] and below[1] <= 1.0 + 1e-9):
            shares = f"{below[0]:.3g} of its samples below {bounds} and {below[1]:.3g}"
            why = "below their upper end, which are no shares, as it repeats itself within them"
            raise refusal(f"has {shares} {why}; take narrower bounds, or another distribution", "distribution")


def share_below(frozen: object) -> Callable[[float], float]:
    """Return the function of the shares below numbers, which of continuous distributions is that up to them."""
    return getattr(frozen, "below", frozen.cdf)


def _continuous(name: str) -> rv_continuous:
    from scipy import stats  # half a second, which a scene without distributions need not wait for

    distribution = getattr(stats, name, None)
    if isinstance(distribution, stats.rv_continuous):
        return distribution
    known = [key for key, value in vars(stats).items() if isinstance(value, stats.rv_continuous)] + list(OWN)
    nearest = nearest_name(name, known)
    if len(nearest) >= 50:
        nearest = f"; known are norm, uniform, lognorm, truncnorm, weibull_min, ..., and {', '.join(OWN)}"
    raise refusal(f"no continuous distribution of scipy.stats{nearest}", "name")


ARCHIMEDEAN = ("clayton", "gumbel", "frank")
MOST_ALIKE, MOST_JOINED = 0.97, 20  # coefficient and parameters of theirs, beyond which round-off grows
SMALLEST_EIGENVALUE = 1e-10  # below, round-off decides whether the matrix has a factor


def correlation_matrix(scene: AnyScene, names: Sequence[str]) -> np.ndarray | None:
    """Return the matrix for parameters of some names, shape (d, d); None where none of them is correlated."""
    matrix = np.eye(len(names))
    for one, others in scene.correlation.items():
        for other, coefficient in others.items():
            if one in names and other in names:
                j, k = names.index(one), names.index(other)
                matrix[j, k] = matrix[k, j] = coefficient
    return matrix if np.any(matrix != np.eye(len(names))) else None


def correlation_problems(scene: AnyScene) -> Iterator[str]:
    """Yield one line for each coefficient that cannot be, or for a matrix that is none of correlations."""
    seen: dict[frozenset[str], str] = {}
    pairs = [(one, *pair) for one, others in scene.correlation.items() for pair in others.items()]
    lines = [line for pair in pairs for line in _of_pair(scene, *pair, seen)]
    yield from lines
    if not seen and scene.ensemble.copula != "gaussian":
        yield problem("ensemble.copula", "[correlation] names no parameters that it could join", scene.ensemble.copula)
    names = sorted({name for pair in seen for name in pair})
    matrix = None if lines else correlation_matrix(scene, names)
    if matrix is None:
        return
    if scene.ensemble.copula in ARCHIMEDEAN:
        yield from _not_alike(scene.ensemble.copula, names, matrix)
    smallest = float(np.linalg.eigvalsh(matrix)[0])
    if smallest < SMALLEST_EIGENVALUE:
        what = f"the matrix of {', '.join(names)} must be positive definite, and its smallest eigenvalue is"
        why = f"no parameters have all these coefficients together: {what} {smallest:.4g}"
        yield problem("correlation", f"{why}; make some coefficients smaller")
    if scene.ensemble.sampler == "saltelli":
        what = "Sobol indices are of independent parameters; leave the correlation out, or take another sampler"
        yield problem("correlation", f'ensemble.sampler = "saltelli" has no part for it: {what}')


def kendall(coefficient: float) -> float:
    """Return Kendall's coefficient of two parameters, of that between their normal variables."""
    return 2.0 / math.pi * math.asin(coefficient)


def _not_alike(copula: str, names: Sequence[str], matrix: np.ndarray) -> Iterator[str]:
    """Yield why an Archimedean copula cannot join parameters with this matrix."""
    of_pairs = matrix[np.triu_indices(len(names), 1)]
    low, high = float(of_pairs.min()), float(of_pairs.max())
    if not 0.0 < low == high <= MOST_ALIKE or len(names) > MOST_JOINED:
        yield problem(
            "correlation",
            f'ensemble.copula = "{copula}" joins up to {MOST_JOINED} parameters with one coefficient for all pairs, '
            f"above 0 and at most {MOST_ALIKE:g}; those of {', '.join(names)} are from {low:g} to {high:g}: give every "
            'pair the same one, or take the copula "gaussian" or "student"',
        )


def _of_pair(
    scene: AnyScene, one: str, other: str, coefficient: float, seen: dict[frozenset[str], str]
) -> Iterator[str]:
    """Yield what is wrong with one coefficient, and remember its pair."""
    entry = f"correlation.{one}.{other}"
    for name, where in ((one, f"correlation.{one}"), (other, entry)):
        if name not in scene.parameters:
            yield problem(where, f"there is no such parameter{nearest_name(name, scene.parameters)}")
        elif scene.parameters[name].distribution is None:
            yield problem(where, f"parameters.{name} has no distribution, so it does not vary; give it one")
    if one == other:
        yield problem(entry, "a parameter is fully correlated with itself; name two", coefficient)
    elif not -1.0 < coefficient < 1.0:
        yield problem(entry, "must lie between -1 and 1, both excluded", coefficient)
    pair = frozenset((one, other))
    if pair in seen and one != other:
        yield problem(entry, f"{seen[pair]} is the same coefficient; give one of them", coefficient)
    seen[pair] = entry


MOST_TERMS = 100
Terms = Annotated[Integer, Field(ge=1), at_most(MOST_TERMS, "each is a parameter, and an affine term of its body")]
NOT_AFFINE = (
    "stiffness and mass are not affine in a field of it; give fields of E and rho, or bodies of their own to the parts "
    "that differ"
)


class RandomField(Table):
    """A quantity that varies over a body at random: mean (1 + variation g(x)), g a Gaussian field or one like it."""

    body: str = Field(description="name of a flexible body")
    quantity: Literal["E", "rho", "width", "thickness", "radius", "height"] = Field(
        description='what varies: "E" or "rho", of a section by coefficients all its stiffness or mass; "width" of a '
        'rectangle of beam2d; "thickness" of solid2d; of "radius" and "height" stiffness is not affine: refused'
    )
    variation: PositiveNumber = Field(description="coefficient of variation: deviation over mean")
    length: Annotated[PositiveNumber, Unit("m")] = Field(description="correlation length (m)")
    kernel: Literal["exponential", "squared_exponential", "matern"] = Field(
        "exponential", description="correlation over the distance"
    )
    smoothness: PositiveNumber | None = Field(
        None, le=20.0, description="of the kernel matern, and needed there: 0.5 is exponential, 1.5 has a slope"
    )
    terms: Terms = Field(description="number of terms of the Karhunen-Loeve expansion, each with a parameter NAME_k")
    least_share: Number = Field(
        0.0, ge=0.0, lt=1.0, description="share of the variance that the terms have to keep; with less it is refused"
    )
    distribution: Literal["normal", "uniform"] = Field("normal", description="of the parameters NAME_k")
    limit: PositiveNumber = Field(
        3.0, le=8.0, description="where the normal distribution is cut off, in deviations; its variance stays 1"
    )

    @property
    def scale(self) -> float:
        """Deviation of the normal distribution that has a variance of 1 where it is cut off."""
        density = math.exp(-0.5 * self.limit**2) / math.sqrt(2.0 * math.pi)
        return 1.0 / math.sqrt(1.0 - 2.0 * self.limit * density / math.erf(self.limit / math.sqrt(2.0)))

    @property
    def reach(self) -> float:
        """Largest value of a parameter NAME_k."""
        return math.sqrt(3.0) if self.distribution == "uniform" else self.limit * self.scale

    def names(self, name: str) -> list[str]:
        """Return the names of the parameters of the field of some name."""
        return [f"{name}_{k}" for k in range(1, self.terms + 1)]

    def parameter(self, name: str, number: int) -> dict[str, Any]:
        """Return the raw table of a parameter, counted from 1, of the field of some name."""
        drawn = {"name": "norm", "loc": 0.0, "scale": self.scale}
        if self.distribution == "uniform":
            drawn = {"name": "uniform", "loc": -self.reach, "scale": 2.0 * self.reach}
        about = f"variable {number} of the random field {name}"
        return {"nominal": 0.0, "description": about, "distribution": drawn, "bounds": [-self.reach, self.reach]}

    def check_entries(self) -> None:
        if self.kernel == "matern" and self.smoothness is None:
            raise refusal("missing; needed: smoothness of the kernel matern, such as 1.5", "smoothness")
        if self.kernel != "matern" and self.smoothness is not None:
            raise refusal('for the kernel "matern" only', "smoothness")


def add_field_parameters(data: dict[str, Any]) -> None:
    """Put the parameters of all fields into raw tables, where they are not; what is no field is left for the
    validation."""
    fields = raw_tables(data, "fields")
    parameters = data.setdefault("parameters", {}) if fields else None
    for name, entry in fields.items() if isinstance(parameters, dict) else ():
        try:
            field = RandomField.model_validate(entry)
        except ValueError:  # pydantic's; names that are none raise it too
            continue
        for number, parameter in enumerate(field.names(name), 1):
            parameters.setdefault(parameter, field.parameter(name, number))


def variables_of(scene: AnyScene) -> dict[str, str]:
    """Return the parameters that are variables of fields, with the field of each."""
    return {parameter: name for name, field in scene.fields.items() for parameter in field.names(name)}


def field_problems(scene: AnyScene) -> Iterator[str]:
    """Yield one line for each field that does not fit its body, or whose parameters are other ones."""
    taken: dict[tuple[str, str], str] = {}
    for name, field in scene.fields.items():
        yield from _of_body(scene, name, field)
        other = taken.setdefault((field.body, field.quantity), name)
        if other != name:
            yield problem(f"fields.{name}.quantity", f"fields.{other} is of the same body already", field.quantity)
        for number, parameter in enumerate(field.names(name), 1):
            wanted = Parameter.model_validate(field.parameter(name, number))
            found = scene.parameters.get(parameter)
            if found is None or found.model_copy(update={"value": None}) != wanted:
                cure = "leave the table out (the field makes it), change the field, or give it another name"
                yield problem(f"parameters.{parameter}", f"is variable {number} of fields.{name}; {cure}")
    variables = variables_of(scene)
    for one, others in scene.correlation.items():
        for parameter in (one, *others):
            if parameter in variables:
                field = f"fields.{variables[parameter]}"
                yield problem(f"correlation.{one}", f"{parameter} is a variable of {field}, all uncorrelated")


def _of_body(scene: AnyScene, name: str, field: RandomField) -> Iterator[str]:
    entry, body = f"fields.{name}", scene.bodies.get(field.body)
    if body is None:
        yield unknown(f"{entry}.body", "body", field.body, scene.bodies)
        return
    if not body.flexible:
        yield problem(f"{entry}.body", "is rigid; a field needs a flexible body", field.body)
        return
    if body.section_scale is not None:
        what = "its section_scale changes the mesh that the field is over; give numbers to one of them"
        yield problem(f"{entry}.body", what, field.body)
    if body.matrices is not None:
        what = "its matrices are assembled, and nothing of them is known place by place; give it a mesh"
        yield problem(f"{entry}.body", what, field.body)
    affine = {"E", "rho"} | ({"thickness"} if body.element == "solid2d" else set())
    if body.element == "beam2d":
        affine |= set(body.section.proportional)
    if field.quantity not in affine:
        yield problem(f"{entry}.quantity", f"of a {body.element}: {NOT_AFFINE}", field.quantity)


OUTERMOST = 1.35e-3  # probability beyond three standard deviations of a normal distribution
LEAST_SHARE = 0.1  # of the nominal value, of a parameter that must be positive and may be as small as 0
BESIDE = 2.0  # a value that is given with --set over the nominal one, or under it
MOST_CORNERS = 3  # parameters whose corners are all taken; of more, only all low and all high


def uncertain_names(scene: AnyScene) -> list[str]:
    """Return the parameters with a distribution, sorted."""
    return sorted(name for name, parameter in scene.parameters.items() if parameter.distribution is not None)


def spanning_values(scene: AnyScene, names: Sequence[str] | None = None) -> tuple[dict[str, np.ndarray], int]:
    """Return the values of every parameter, shape (n_samples,), the nominal ones first, and n_samples.

    Those named vary, each with a distribution or with bounds; by default those with a distribution.
    """
    names = uncertain_names(scene) if names is None else names
    levels = {name: _levels(scene, name) for name in names}
    nominal = scene.nominal
    samples = [nominal]
    for name, (low, high) in levels.items():
        half_way = (0.5 * (low + nominal[name]), 0.5 * (nominal[name] + high))
        samples += [nominal | {name: value} for value in (low, *half_way, high)]
    corners = product(*levels.values()) if len(names) <= MOST_CORNERS else zip(*levels.values())
    samples += [nominal | dict(zip(names, corner)) for corner in corners if len(names) > 1]
    samples.append(scene.values)
    once = [sample for k, sample in enumerate(samples) if sample not in samples[:k]]
    return {name: np.array([sample[name] for sample in once]) for name in scene.parameters}, len(once)


def outermost_values(scene: AnyScene, share: float) -> dict[str, tuple[float, float]]:
    """Return what samples of each parameter lie between, but for a share of them on either side, its nominal value with
    them; of a parameter that is not drawn `BESIDE` it."""
    spans = {}
    for name, parameter in scene.parameters.items():
        near = parameter.nominal / BESIDE, parameter.nominal * BESIDE
        ends = _levels(scene, name, share) if parameter.varies else near
        spans[name] = (min(*ends, parameter.nominal), max(*ends, parameter.nominal))
    return spans


def _levels(scene: AnyScene, name: str, share: float = OUTERMOST) -> tuple[float, float]:
    """Return the outermost values of a parameter, bounds applied as an ensemble applies them."""
    parameter = scene.parameters[name]
    if parameter.distribution is None:
        low, high = parameter.bounds
        return (LEAST_SHARE * parameter.nominal if name in scene.positive_parameters and low <= 0.0 else low), high
    least = 0.0 if name in scene.parameters_not_negative else -np.inf
    low, high = parameter.quantiles(np.array([share, 1.0 - share]), least)
    return float(low), float(high)
