"""Parameter values of samples, keyed by the number of the sample.

A design (docs/uncertainty.md, samplers) gives uniform numbers, of which the inverse distribution function, truncated to
the parameter's bounds where it has any, makes values; or the values are those of a file. In a Latin hypercube (McKay,
Beckman and Conover, Technometrics 21 (1979) 239-245) sample k lies within its slice where its own stream says.
Scrambled Sobol sequences (Matousek, Journal of Complexity 14 (1998) 527-556; `scipy.stats.qmc.Sobol`) take turns:
sample k is point k // R of replicate k % R. Saltelli's blocks (Computer Physics Communications 181 (2010) 259-270) are
point A of a sequence in 2 d dimensions, A with parameter 1 .. d of B, and B; block k is of replicate k % R.

Sample k draws from a stream of its own, ``Generator(PCG64(SeedSequence(seed, spawn_key=(k,))))``, so that its numbers
depend on no other one.

Copulas make of uniform numbers of independent parameters those of parameters that depend on each other. Each is a
Rosenblatt transform (Annals of Mathematical Statistics 23 (1952) 470-472), one parameter after the other by what is
known of those before it: as many uniform numbers go in as come out, so that points of Latin hypercubes, of Sobol
sequences and of rare events' normal variables serve as random ones do.

======== ==============================================================================================================
gaussian uniform numbers become normal ones, z, these ``L z`` with ``L L^T`` the correlation matrix, and uniform again
student  z is of a spherical t distribution of f degrees of freedom: ``z_j = sqrt((f + z_1^2 + .. + z_(j-1)^2) / (f + j
         - 1)) t``, t of f + j - 1 degrees
clayton  ``psi(s) = (1 + s)^(-1 / theta)``: low values come together
gumbel   ``psi(s) = exp(-s^(1 / theta))``: high values come together
frank    ``psi(s) = -log(1 - (1 - e^-theta) e^-s) / theta``: none do in the end
======== ==============================================================================================================

The last three are Archimedean, ``C(u) = psi(psi^-1(u_1) + .. + psi^-1(u_d))``: of u_j with ``t = psi^-1(u_1) + .. +
psi^-1(u_(j-1))`` known the share below is ``psi^(m)(t + psi^-1(u_j)) / psi^(m)(t)``, m = j - 1, of the m-th derivative
(Hofert, Maechler and McNeil, Journal of Multivariate Analysis 110 (2012) 133-150, give them as polynomials), which
bisection inverts.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from pgmp_petsc.base.errors import InputError, Remark, gathered, note, warning
from pgmp_petsc.base.units import behind
from pgmp_petsc.ensemble.plan import Plan
from pgmp_petsc.files.seal import identity
from pgmp_petsc.results.numbers import Arrays, share_text
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.parameters import ARCHIMEDEAN, correlation_matrix, kendall, uncertain_names, variables_of
from pgmp_petsc.scene.units import own_units, own_values, to_own
from pgmp_petsc.scene.uses import ordered_ends

BITS = 30  # of the numbers of a Sobol sequence
MOST_OF_LATIN_HYPERCUBE = 100_000_000  # samples: every rank holds 4 bytes a parameter of each
OF_ORDER, OF_SCRAMBLE, OF_BLOCKS, OF_RARE = 0, 1, 2, 3  # first keys of streams that are no sample's


#: Gives the uniform numbers between 0 and 1 of samples first to last - 1 of a design, shape (last - first, d).
Design = Callable[[int, int], np.ndarray]


def independent(seed: int, d: int) -> Design:
    """Return independent random samples of d parameters; the seed is that of all streams."""

    def uniform(first: int, last: int) -> np.ndarray:
        streams = map(_Mixed, _mixed(seed, np.arange(first, last)))
        numbers = [np.random.Generator(np.random.PCG64(own)).random(d) for own in streams]
        return np.array(numbers).reshape(last - first, d)

    return uniform


class _Mixed(np.random.bit_generator.ISeedSequence):
    """A `SeedSequence` of which is known what it says first, four words of 64 bits."""

    def __init__(self, words: np.ndarray) -> None:
        self._words = words

    def generate_state(self, n_words: int, dtype: type = np.uint32) -> np.ndarray:
        return self._words


def _mixed(seed: int, numbers: np.ndarray) -> np.ndarray:
    """Return what ``SeedSequence(seed, spawn_key=(number,))`` says first of numbers below 2^32, (n, 4) words of 64
    bits.

    numpy does so for one after the other in 20 us each, which is 3 % of a reduced sample; here the last word, the
    number, is mixed into what the seed has made for all at once, as O'Neill's seed_seq_fe does, which numpy promises to
    keep.
    """
    whole = 2**32 - 1
    constant = 0x43B0D7E5 * pow(0x931E8875, 16, 2**32) & whole  # as it is behind a seed of four words and less
    pool, key = [], numbers.astype(np.uint32)
    for own in np.random.SeedSequence(seed).pool:
        value = key ^ np.uint32(constant)
        constant = constant * 0x931E8875 & whole
        value = value * np.uint32(constant)
        value ^= value >> np.uint32(16)
        value = np.uint32(0xCA01F9DD * int(own) & whole) - np.uint32(0x4973F715) * value
        pool.append(value ^ (value >> np.uint32(16)))
    constant, words = 0x8B51F9DD, np.empty((numbers.size, 8), dtype=np.uint32)
    for k in range(8):
        value = pool[k % 4] ^ np.uint32(constant)
        constant = constant * 0x58F38DED & whole
        value = value * np.uint32(constant)
        words[:, k] = value ^ (value >> np.uint32(16))
    return words.view(np.uint64)


def latin_hypercube(seed: int, d: int, n: int) -> Design:
    """Return a Latin hypercube of n samples; raises `InputError` if its permutations would not fit in memory."""
    if n > MOST_OF_LATIN_HYPERCUBE:
        raise InputError(
            f"-n {n} with the sampler latin_hypercube: at most {MOST_OF_LATIN_HYPERCUBE:,} samples, since every rank "
            "holds the order of all; take sobol"
        )
    orders = [stream(seed, OF_ORDER, k).permutation(np.arange(n, dtype=np.uint32)) for k in range(d)]
    within = independent(seed, d)

    def uniform(first: int, last: int) -> np.ndarray:
        return (np.array([order[first:last] for order in orders], dtype=float).T + within(first, last)) / n

    return uniform


def sobol(seed: int, d: int, n_replicates: int, purpose: int = OF_SCRAMBLE) -> Design:
    """Return scrambled Sobol sequences that take turns, by streams whose first key is the `purpose`."""
    streams = [stream(seed, purpose, number) for number in range(n_replicates)]
    sequences = [scipy.stats.qmc.Sobol(d, scramble=True, bits=BITS, seed=own) for own in streams]

    def points(sequence: scipy.stats.qmc.Sobol, first: int, n: int) -> np.ndarray:
        """Return points first to first + n - 1: multiples of 2^-30 and half of it, as 0 has no finite quantile."""
        if first < sequence.num_generated:
            sequence.reset()
        if first > sequence.num_generated:
            sequence.fast_forward(first - sequence.num_generated)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of a stretch that is no power of two
            return sequence.random(n) + 0.5 ** (BITS + 1)

    def uniform(first: int, last: int) -> np.ndarray:
        found = np.empty((last - first, d))
        for number, sequence in enumerate(sequences):
            begin = first + (number - first) % n_replicates  # its first sample from `first` on
            here = np.arange(begin, last, n_replicates)
            if here.size:
                found[here - first] = points(sequence, begin // n_replicates, here.size)
        return found

    return uniform


def saltelli(seed: int, d: int, n_replicates: int) -> Design:
    """Return Saltelli's blocks, of scrambled Sobol sequences that take turns."""
    base, size = sobol(seed, 2 * d, n_replicates, OF_BLOCKS), d + 2

    def uniform(first: int, last: int) -> np.ndarray:
        if first == last:
            return np.empty((0, d))
        begin, end = first // size, -(-last // size)
        both = base(begin, end)
        blocks = np.repeat(both[:, None, :d], size, axis=1)
        for k in range(d):
            blocks[:, k + 1, k] = both[:, d + k]
        blocks[:, d + 1] = both[:, d:]
        return blocks.reshape(-1, d)[first - begin * size : last - begin * size]

    return uniform


def stream(seed: int, *key: int) -> np.random.Generator:
    """Return the random stream of a sample, or with two keys of something else, that the seed leads to."""
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=key)))


MUCH_CUT_OFF = 0.1  # of a distribution by its bounds
FEW_POINTS = 8  # of a replicate
IN_TURNS = ("sobol", "saltelli")  # samplers of several sequences, which take turns
ROUNDS_NAMED = 2  # of all replicates: one would not show whether sequences take turns
FEW_OF_BETTER = 4  # samples of a better model to each Sobol sequence


def unit_of_better(unit: int) -> int:
    """Return of how many samples those of a better model are a multiple, where so many belong together
    (`Sampler.unit`)."""
    return FEW_OF_BETTER * unit if unit > 1 else 1


class Sampler:
    """The source of the samples of a planned ensemble.

    `names` are the parameters that are drawn, or that a file gives, sorted; `kind` is ``random``, ``latin_hypercube``,
    ``sobol``, ``saltelli``, or ``file``; `extends` says whether a longer run has the samples of a shorter one. Raises
    `InputError` if no parameter has a distribution, or the number of samples does not suit the design.
    """

    def __init__(self, scene: Scene, plan: Plan) -> None:
        self._scene, self._plan = scene, plan
        self.kind = "file" if plan.file is not None else scene.ensemble.sampler
        self.names = drawn_names(scene) if plan.file is None else sorted(plan.file.values)
        self._design = None if plan.file is not None else self._designed()
        self.extends = self.kind != "latin_hypercube"
        self._mixing = mixing_of(scene, self.names) if plan.file is None else None

    def draw(self, first: int, last: int) -> dict[str, np.ndarray]:
        """Return samples first to last - 1: values of all parameters, each (last - first,); those that are not drawn
        keep that of the run."""
        if self._plan.file is not None:
            given = {name: column[first:last] for name, column in self._plan.file.values.items()}
            return {name: np.full(last - first, value) for name, value in self._scene.values.items()} | given
        return values_of(self._scene, self.names, self._design(first, last), self._mixing)

    @property
    def unit(self) -> int:
        """Number of samples that belong together: numbers that are not multiples leave some without the others."""
        return self._scene.ensemble.replicates if self.kind == "sobol" else self._size

    @property
    def _size(self) -> int:
        """Number of samples that a point of the design makes."""
        return len(self.names) + 2 if self.kind == "saltelli" else 1

    def replicates(self, n: int) -> np.ndarray | None:
        """Return which independent replicate each of n samples belongs to, (n,); None where samples are independent."""
        if self.kind not in IN_TURNS:
            return None
        return np.arange(n) // self._size % self._scene.ensemble.replicates  # blocks take turns as a whole

    def described(self, n: int) -> np.ndarray:
        """Return which of n samples statistics are of, (n,): all, but of blocks the points A and B."""
        return np.isin(np.arange(n) % self._size, (0, self._size - 1))

    @property
    def named(self) -> tuple[str, str]:
        """The design in words, and the identity of its first numbers, which tells it from what another version of the
        program reads out of the same words. Uniform numbers are the same to the bit on every machine, as values need
        not be."""
        if self._design is None:
            return self.kind, ""
        kind, n_replicates = self.kind, 1
        if kind in IN_TURNS:
            n_replicates = self._scene.ensemble.replicates
            kind = f"{kind} of {n_replicates} replicates"
        n = ROUNDS_NAMED * n_replicates * self._size
        return kind, identity(self._design(0, n if self.extends else min(n, self._plan.n_samples)))

    def _designed(self) -> Design:
        seed, d, n, asked = self._plan.seed, len(self.names), self._plan.n_samples, self._scene.ensemble
        if self.kind == "saltelli" and self._plan.is_limited and n % (d + 2):
            near = max(n - n % (d + 2), d + 2)
            raise InputError(
                f"-n {n} with the sampler saltelli: each of its base points takes {d + 2} samples, the number of "
                f"uncertain parameters ({d}) and two; give a multiple, such as {near} or {near + d + 2}"
            )
        if self.kind == "saltelli":
            return saltelli(seed, d, asked.replicates)
        if self.kind == "sobol":
            return sobol(seed, d, asked.replicates)
        return latin_hypercube(seed, d, n) if self.kind == "latin_hypercube" else independent(seed, d)


def drawn_names(scene: Scene) -> list[str]:
    """Return the parameters that are drawn, sorted. Raises `InputError` if there is none."""
    names = uncertain_names(scene)
    if not names:
        raise InputError(
            "parameters: none has a distribution, so there is nothing to draw from; give one, such as "
            '[parameters.r1] distribution = { name = "norm", loc = 5.6e-3, scale = 0.56e-3 }'
        )
    return names


def values_of(scene: Scene, names: Sequence[str], uniform: np.ndarray, mixing: Mixing | None) -> dict[str, np.ndarray]:
    """Return the values of all parameters, each (n,), that uniform numbers (n, d) of some, not correlated yet, mean;
    others have the value of the run."""
    values = {name: np.full(len(uniform), value) for name, value in scene.values.items()}
    for column, name in zip((uniform if mixing is None else mixing.applied(uniform)).T, names):
        values[name] = scene.parameters[name].quantiles(column)
    return values


def draw(scene: Scene, seed: int, first: int, last: int) -> dict[str, np.ndarray]:
    """Return samples first to last - 1 of the scene's sampler, as `Sampler.draw`; not for those that depend on N."""
    return Sampler(scene, Plan(last, seed)).draw(first, last)


@gathered
def sampler_remarks(scene: Scene, plan: Plan) -> Iterator[Remark]:
    asked, n = scene.ensemble, plan.n_samples
    if plan.file is not None:
        what = "intervals take them for independent samples of one distribution, which nothing here can check"
        unused = "; distributions and [correlation] of the scene have no part in them"
        yield from plan.file.remarks
        yield note(f"samples are those of '{plan.file.path}': {what}{unused}")
        return
    if asked.sampler == "latin_hypercube":
        yield note(
            "intervals take the samples of a Latin hypercube for independent ones: that of the mean is too wide, "
            "the more so the nearer outputs are to sums of functions of one parameter each; the sampler sobol has "
            "intervals of the size of its errors. A longer run has other samples"
        )
    if asked.sampler == "saltelli":
        yield note(
            "statistics, probabilities and bands are of the base points A and B of the sampler saltelli, whose "
            "other samples repeat their values"
        )
        yield from _of_replicates(n, asked.replicates, len(uncertain_names(scene)) + 2)
    if asked.sampler == "sobol":
        yield from _of_replicates(n, asked.replicates, 1)
    yield from draw_remarks(scene)


@gathered
def _of_replicates(n: int, n_replicates: int, size: int) -> Iterator[Remark]:
    """Return what is to be said of the number of samples of scrambled sequences, of each point of which `size` are."""
    yield note(
        f"intervals follow from the spread between {n_replicates} scrambled Sobol sequences; of probabilities that "
        "came true in a few samples they are wider than those of independent ones"
    )
    each = n // (n_replicates * size)
    if each < FEW_POINTS:
        points = f"{each} blocks" if size > 1 else f"{each}"
        few = f"{n} samples are {points} to each of {n_replicates} scrambled Sobol sequences, which fill space from"
        yield warning(f"{few} some dozen points on; draw more, or take fewer ensemble.replicates")
    elif n % (n_replicates * size) or each & (each - 1):
        low = n_replicates * size * 2 ** int(np.log2(each))
        balanced = f"{low} or {2 * low}" if low < n else f"{low}"
        yield note(f"Sobol sequences are balanced at powers of two: {balanced} samples are better used than {n}")


@gathered
def draw_remarks(scene: Scene) -> Iterator[Remark]:
    variables = variables_of(scene)  # of which fields say where they are cut off
    for name, parameter in scene.parameters.items():
        if parameter.distribution is None:
            continue
        if parameter.value is not None:
            yield note(
                f"parameters.{name}.value = {to_own(scene, name) * parameter.value:g} is that of single runs and has "
                "no part in an ensemble, which draws from the distribution"
            )
        with np.errstate(all="ignore"):  # scipy divides by zero where there is no variance
            varies_finitely = parameter.bounds is not None or np.isfinite(parameter.deviation)
        if not varies_finitely:
            yield warning(
                f"parameters.{name}: its distribution, {parameter.distribution.name}, has no finite variance, so "
                "that deviations, and means with them, need not settle with more samples, nor do their intervals "
                "hold; give bounds, or go by the quantiles"
            )
        below, above = parameter.cut_off
        if below + above > 0.0 and name not in variables:
            low, high = own_values(scene, {name: np.array(parameter.bounds)})[name]
            ends = f"[{low:g}, {high:g}]{behind(own_units(scene)[name])}"
            text = (
                f"parameters.{name}: its distribution is truncated to the bounds {ends} and renormalised; "
                f"they cut off {_percent(below)} below and {_percent(above)} above"
            )
            much = "; so much is missing that bounds and distribution may not mean the same quantity: check both"
            yield warning(text + much) if below + above > MUCH_CUT_OFF else note(text)


def physical(scene: Scene, values: Arrays) -> np.ndarray:
    """Return which samples lie inside all bounds, finite, positive or not negative where that is needed, lower ends of
    stops and limits below upper ones."""
    fine = np.ones(len(next(iter(values.values()))), dtype=bool)
    for name, parameter in scene.parameters.items():
        fine &= np.isfinite(values[name])
        if parameter.bounds is not None:
            fine &= (values[name] >= parameter.bounds[0]) & (values[name] <= parameter.bounds[1])
    for name in scene.positive_parameters:
        fine &= values[name] > 0.0
    for name in scene.parameters_not_negative:
        fine &= values[name] >= 0.0
    for ends in ordered_ends(scene):
        lower, upper = ends.at(scene, values)
        fine &= lower < upper
    return fine


def _percent(share: float) -> str:
    return share_text(share) if share > 1e-9 or share == 0.0 else "less than 1e-7 %"


def refuse_drawn(scene: Scene, settings: Sequence[str]) -> None:
    """Refuse a value for a parameter that every sample draws anew; the same on all ranks."""
    for setting in settings:
        name = setting.partition("=")[0].strip()
        parameter = scene.parameters[name]
        if parameter.distribution is not None:
            nominal, value = own_values(scene, {name: [parameter.nominal, parameter.current]})[name]
            held = f"{{nominal={nominal!r}, value={value!r}}}"
            raise InputError(
                f"--set {setting}: every sample draws '{name}' from parameters.{name}.distribution, so a value has no "
                f"part in an ensemble; to move the distribution, --override parameters.{name}.distribution.loc=...; to "
                f"hold the parameter, replace it: --override 'parameters.{name}={held}'"
            )


HALVINGS = 60  # of an interval of 1, to round-off
POINTS = 100  # of Gauss's quadrature of Debye's function


@dataclass(frozen=True, eq=False)
class Mixing:
    """The copula of correlated parameters."""

    factor: np.ndarray  # l of the correlation matrix ``L L^T``, shape (d, d)
    joined: np.ndarray  # numbers of the parameters that a coefficient names, in order
    copula: str  # its name
    #: degrees of freedom of Student's copula, theta of an Archimedean one; NaN of the Gaussian one, which has none
    number: float

    def applied(self, uniform: np.ndarray) -> np.ndarray:
        """Return the uniform numbers (n, d) of correlated parameters; other columns stay as they are."""
        made = {"gaussian": self._gaussian, "student": self._student} | dict.fromkeys(ARCHIMEDEAN, self._archimedean)
        return made[self.copula](uniform)

    def _gaussian(self, uniform: np.ndarray) -> np.ndarray:
        found, normal = uniform.copy(), scipy.special.ndtri(uniform)
        # one product after the other: a sample must not depend on how many there are
        for row in np.flatnonzero(np.count_nonzero(self.factor, axis=1) > 1):
            found[:, row] = scipy.special.ndtr(sum(self.factor[row, k] * normal[:, k] for k in range(row + 1)))
        return found

    def _student(self, uniform: np.ndarray) -> np.ndarray:
        found, freedom, squares, spherical = uniform.copy(), self.number, np.zeros(len(uniform)), {}
        for number, column in enumerate(self.joined):
            known = np.sqrt((freedom + squares) / (freedom + number))
            spherical[column] = known * scipy.special.stdtrit(freedom + number, uniform[:, column])
            squares = squares + spherical[column] ** 2
            correlated = sum(self.factor[column, k] * own for k, own in spherical.items())
            found[:, column] = scipy.special.stdtr(freedom, correlated)
        return found

    def _archimedean(self, uniform: np.ndarray) -> np.ndarray:
        # columns in one piece: of others numpy takes another logarithm where memory next to them is what it writes to
        found = np.array(uniform.T, order="C")
        total = _inverse(self.copula, self.number, found[self.joined[0]])
        for m, column in enumerate(self.joined[1:], start=1):
            wanted = np.log(found[column]) + _derivative(self.copula, self.number, m, total)
            low, high = np.zeros(len(uniform)), np.ones(len(uniform))
            for _ in range(HALVINGS):
                middle = 0.5 * (low + high)
                further = total + _inverse(self.copula, self.number, middle)
                less = _derivative(self.copula, self.number, m, further) < wanted
                low, high = np.where(less, middle, low), np.where(less, high, middle)
            found[column] = 0.5 * (low + high)
            total = total + _inverse(self.copula, self.number, found[column])
        return found.T.copy()


def mixing_of(scene: Scene, names: Sequence[str]) -> Mixing | None:
    """Return what correlated parameters are made with; None where all are independent."""
    matrix = correlation_matrix(scene, names)
    if matrix is None:
        return None
    asked = scene.ensemble
    joined, number = np.flatnonzero(np.count_nonzero(matrix, axis=1) > 1), np.nan
    if asked.copula in ARCHIMEDEAN:
        number = theta_of(asked.copula, kendall(float(matrix[joined[0], joined[1]])))
    elif asked.copula == "student":
        number = float(asked.copula_freedom)
    return Mixing(np.linalg.cholesky(matrix), joined, asked.copula, number)


def theta_of(copula: str, tau: float) -> float:
    """Return theta of an Archimedean copula with Kendall's coefficient tau, between 0 and 1.

    ``tau = theta / (theta + 2)`` of Clayton's, ``1 - 1 / theta`` of Gumbel's, ``1 - 4 (1 - D(theta)) / theta`` of
    Frank's with Debye's function ``D(theta) = 1 / theta int_0^theta t / (e^t - 1) dt`` (Genest, Biometrika 74 (1987)
    549-555).
    """
    if copula == "clayton":
        return 2.0 * tau / (1.0 - tau)
    if copula == "gumbel":
        return 1.0 / (1.0 - tau)
    nodes, weights = np.polynomial.legendre.leggauss(POINTS)
    low, high = 1e-6, 1e3
    for _ in range(2 * HALVINGS):
        theta = 0.5 * (low + high)
        t = 0.5 * theta * (nodes + 1.0)
        debye = 0.5 * np.sum(weights * t * np.exp(-t) / -np.expm1(-t))
        low, high = (theta, high) if 1.0 - 4.0 * (1.0 - debye) / theta < tau else (low, theta)
    return 0.5 * (low + high)


def _inverse(copula: str, theta: float, u: np.ndarray) -> np.ndarray:
    """Return ``psi^-1(u)``, (n,)."""
    if copula == "clayton":
        return np.expm1(-theta * np.log(u))
    if copula == "gumbel":
        return (-np.log(u)) ** theta
    return np.log(np.expm1(-theta) / np.expm1(-theta * u))


def _derivative(copula: str, theta: float, m: int, s: np.ndarray) -> np.ndarray:
    """Return the logarithm of the magnitude of the m-th derivative of psi, m from 1, but for a constant, (n,)."""
    if copula == "clayton":
        return -(1.0 / theta + m) * np.log1p(s)
    polynomial = np.polynomial.Polynomial
    if copula == "gumbel":
        # exp(-x) s^-m p_m(x) with x = s^a, whose derivative is the same of m + 1
        a, p = 1.0 / theta, polynomial([1.0])
        for number in range(m):
            p = polynomial([number, a]) * p - polynomial([0.0, a]) * p.deriv()
        x = s**a
        return np.log(p(x)) - x - m * np.log(s)
    # y = z / (1 - z) with z = (1 - e^-theta) e^-s falls with s by y (1 + y)
    p = polynomial([0.0, 1.0])
    for _ in range(m - 1):
        p = polynomial([0.0, 1.0, 1.0]) * p.deriv()
    z = -np.expm1(-theta) * np.exp(-s)
    return np.log(p(z / (1.0 - z)))
