"""Parameter values of samples, keyed by the number of the sample.

Values follow from a design's uniform numbers (`designs`) by the inverse distribution function, of the distribution
truncated to the parameter's bounds where it has any; or they are those of a file. Correlated parameters have a copula
(`ensemble.copulas`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from pgmp_petsc.ensemble.allotment import Plan
from pgmp_petsc.ensemble.copulas import Mixing, mixing_of
from pgmp_petsc.ensemble.designs import Blocks, Design, Independent, LatinHypercube, Replicates
from pgmp_petsc.runtime.errors import InputError, Remark, note, warning
from pgmp_petsc.runtime.seal import identity
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.random_fields import variables_of
from pgmp_petsc.scene.spanning_values import uncertain_names
from pgmp_petsc.scene.uses import ordered_ends

MUCH_CUT_OFF = 0.1  # of a distribution by its bounds
FEW_POINTS = 8  # of a replicate
IN_TURNS = ("sobol", "saltelli")  # samplers of several sequences, which take turns
ROUNDS_NAMED = 2  # of all replicates: one would not show whether sequences take turns


class Sampler:
    """Where the samples of an ensemble come from.

    Parameters
    ----------
    scene, plan
        The scene, whose parameters with a distribution are drawn, and the ensemble.

    Attributes
    ----------
    names
        Parameters that are drawn, or that a file gives, sorted.
    kind
        ``random``, ``latin_hypercube``, ``sobol``, ``saltelli``, or ``file``.
    extends
        Whether a longer run has the samples of a shorter one.

    Raises
    ------
    InputError
        If no parameter has a distribution, or the number of samples does not suit the design.
    """

    def __init__(self, scene: Scene, plan: Plan) -> None:
        self._scene, self._plan = scene, plan
        self.kind = "file" if plan.file is not None else scene.ensemble.sampler
        self.names = drawn_names(scene) if plan.file is None else sorted(plan.file.values)
        self._design = None if plan.file is not None else self._designed()
        self.extends = self._design is None or self._design.extends
        self._mixing = mixing_of(scene, self.names) if plan.file is None else None

    def draw(self, first: int, last: int) -> dict[str, np.ndarray]:
        """Return samples first to last - 1: values of all parameters, each (last - first,).

        Parameters that are not drawn keep the value of the run.
        """
        if self._plan.file is not None:
            given = {name: column[first:last] for name, column in self._plan.file.values.items()}
            return {name: np.full(last - first, value) for name, value in self._scene.values.items()} | given
        return values_of(self._scene, self.names, self._design.uniform(first, last), self._mixing)

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
        turns = self.kind in IN_TURNS
        n_replicates = self._scene.ensemble.replicates if turns else 1
        n = ROUNDS_NAMED * n_replicates * self._size
        numbers = self._design.uniform(0, n if self.extends else min(n, self._plan.n_samples))
        kind = f"{self.kind} of {n_replicates} replicates" if turns else self.kind
        return kind, identity(numbers)

    def _designed(self) -> Design:
        seed, d, n, asked = self._plan.seed, len(self.names), self._plan.n_samples, self._scene.ensemble
        if self.kind == "saltelli" and self._plan.is_limited and n % (d + 2):
            near = max(n - n % (d + 2), d + 2)
            raise InputError(
                f"-n {n} with the sampler saltelli: each of its base points takes {d + 2} samples, the number of "
                f"uncertain parameters ({d}) and two; give a multiple, such as {near} or {near + d + 2}"
            )
        if self.kind == "saltelli":
            return Blocks(seed, d, asked.replicates)
        if self.kind == "sobol":
            return Replicates(seed, d, asked.replicates)
        return LatinHypercube(seed, d, n) if self.kind == "latin_hypercube" else Independent(seed, d)


def drawn_names(scene: Scene) -> list[str]:
    """Return the parameters that are drawn, sorted.

    Raises
    ------
    InputError
        If there is none.
    """
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


def sampler_remarks(scene: Scene, plan: Plan) -> tuple[Remark, ...]:
    """Return what is to be said of where samples come from, and of what their intervals rest on."""
    asked, n, remarks = scene.ensemble, plan.n_samples, []
    if plan.file is not None:
        what = "intervals take them for independent samples of one distribution, which nothing here can check"
        unused = "; distributions and [correlation] of the scene have no part in them"
        return (*plan.file.remarks, note(f"samples are those of '{plan.file.path}': {what}{unused}"))
    if asked.sampler == "latin_hypercube":
        remarks.append(
            note(
                "intervals take the samples of a Latin hypercube for independent ones: that of the mean is too wide, "
                "the more so the nearer outputs are to sums of functions of one parameter each; the sampler sobol has "
                "intervals of the size of its errors. A longer run has other samples"
            )
        )
    if asked.sampler == "saltelli":
        remarks.append(
            note(
                "statistics, probabilities and bands are of the base points A and B of the sampler saltelli, whose "
                "other samples repeat their values"
            )
        )
        remarks += _of_replicates(n, asked.replicates, len(uncertain_names(scene)) + 2)
    if asked.sampler == "sobol":
        remarks += _of_replicates(n, asked.replicates, 1)
    return (*remarks, *draw_remarks(scene))


def _of_replicates(n: int, n_replicates: int, size: int) -> list[Remark]:
    """Return what is to be said of the number of samples of scrambled sequences, of each point of which `size` are."""
    remarks = [
        note(
            f"intervals follow from the spread between {n_replicates} scrambled Sobol sequences; of probabilities that "
            "came true in a few samples they are wider than those of independent ones"
        )
    ]
    each = n // (n_replicates * size)
    if each < FEW_POINTS:
        points = f"{each} blocks" if size > 1 else f"{each}"
        few = f"{n} samples are {points} to each of {n_replicates} scrambled Sobol sequences, which fill space from"
        remarks.append(warning(f"{few} some dozen points on; draw more, or take fewer ensemble.replicates"))
    elif n % (n_replicates * size) or each & (each - 1):
        low = n_replicates * size * 2 ** int(np.log2(each))
        balanced = f"{low} or {2 * low}" if low < n else f"{low}"
        remarks.append(
            note(f"Sobol sequences are balanced at powers of two: {balanced} samples are better used than {n}")
        )
    return remarks


def draw_remarks(scene: Scene) -> tuple[Remark, ...]:
    """Return what is to be said of the distributions that samples come from."""
    remarks, variables = [], variables_of(scene)  # of which fields say where they are cut off
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
        with np.errstate(all="ignore"):  # scipy divides by zero where there is no variance
            varies_finitely = parameter.bounds is not None or np.isfinite(parameter.deviation)
        if not varies_finitely:
            remarks.append(
                warning(
                    f"parameters.{name}: its distribution, {parameter.distribution.name}, has no finite variance, so "
                    "that deviations, and means with them, need not settle with more samples, nor do their intervals "
                    "hold; give bounds, or go by the quantiles"
                )
            )
        below, above = parameter.cut_off
        if below + above > 0.0 and name not in variables:
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
    """Return which samples lie inside all bounds, finite, positive or not negative where that is needed, lower ends of
    stops below upper ones."""
    fine = np.ones(len(next(iter(values.values()))), dtype=bool)
    for name, parameter in scene.parameters.items():
        fine &= np.isfinite(values[name])
        if parameter.bounds is not None:
            fine &= (values[name] >= parameter.bounds[0]) & (values[name] <= parameter.bounds[1])
    for name in scene.positive_parameters:
        fine &= values[name] > 0.0
    for name in scene.parameters_not_negative:
        fine &= values[name] >= 0.0
    for _, _, lower, upper, share in ordered_ends(scene):
        fine &= scene.number(lower, values) < share * scene.number(upper, values)
    return fine


def _percent(share: float) -> str:
    """Return a share in percent; one that no ensemble notices is nothing."""
    return f"{100 * share:.2g} %" if share > 1e-9 or share == 0.0 else "less than 1e-7 %"


def refuse_drawn(scene: Scene, settings: Sequence[str]) -> None:
    """Refuse a value for a parameter that every sample draws anew; the same on all ranks."""
    for setting in settings:
        name = setting.partition("=")[0].strip()
        parameter = scene.parameters[name]
        if parameter.distribution is not None:
            held = f"{{nominal={parameter.nominal:g}, value={parameter.current:g}}}"
            raise InputError(
                f"--set {setting}: every sample draws '{name}' from parameters.{name}.distribution, so a value has no "
                f"part in an ensemble; to move the distribution, --override parameters.{name}.distribution.loc=...; to "
                f"hold the parameter, replace it: --override 'parameters.{name}={held}'"
            )
