"""Which uncertain parameters matter: Sobol indices of outputs, with intervals.

The first index of a parameter is the share of an output's variance that its value alone explains,
``S1 = Var(E(y | x_i)) / Var(y)``; the total one what is left when all others are known, ``ST = E(Var(y | x_~i)) /
Var(y)`` (Saltelli et al., Computer Physics Communications 181 (2010) 259-270). Two ways lead to them:

- Samples in Saltelli's blocks, of independent replicates of Sobol sequences in turn: the estimators of SALib for both,
  intervals from the spread between replicates. Resampled blocks of one sequence, which know nothing of how evenly it
  fills space, make intervals three times as wide as its errors.
- Any samples, one parameter after the other: the first index alone, ``1 - E(r^2) / Var(y)``, r what straight lines in
  slices of equal probability leave of the output, adjusted for their coefficients (as Pearson's correlation ratio:
  Kelley, PNAS 21 (1935) 554-559). It ranks parameters at no further cost. Errors are, to the first order, means of
  ``(1 - S1) (y - mean)^2 / Var(y) - r^2 / Var(y)`` (the influence of a sample: Da Veiga and Gamboa, Journal of
  Nonparametric Statistics 25 (2013) 573-595), whose deviation makes the interval.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

import numpy as np

from pgmp_petsc.base.errors import Remark, gathered, note, warning
from pgmp_petsc.ensemble import intervals
from pgmp_petsc.ensemble.statistics import is_constant
from pgmp_petsc.results.statistics import Sensitivity

IN_SLICE, FEWEST_IN_SLICE = 40, 20  # samples: as many as that, fewer where there are few slices
FEWEST_SLICES, FEW_SLICES, MOST_SLICES = 4, 8, 25
MOST_GIVEN = 10_000  # samples that the slices are of, the first ones: their intervals are a percent or two wide
FEWEST_OF_REPLICATE = 4  # blocks
FEW_OF_REPLICATE = 16  # blocks, below which measured intervals are short: 89 to 97 % at 95 %


def of_blocks(values: np.ndarray, names: list[str], confidence: float, n_replicates: int) -> Sensitivity | None:
    """Return the indices of an output whose samples (N,) are Saltelli's blocks, of so many independent Sobol sequences
    in turn.

    Blocks with a sample that failed (NaN) are left out. None where too few are left of a replicate, or one does not
    vary.
    """
    d = len(names)
    blocks = values.reshape(-1, d + 2)
    known = np.isfinite(blocks).all(axis=1)
    parts = [k + n_replicates * np.flatnonzero(known[k::n_replicates]) for k in range(n_replicates)]
    if min(map(len, parts)) < FEWEST_OF_REPLICATE or any(is_constant(blocks[part]) for part in parts):
        return None
    # the estimators are biased for outputs far from zero
    scaled = (blocks - blocks[known].mean()) / blocks[known].std()

    def indices(chosen: np.ndarray) -> np.ndarray:
        # Saltelli et al. 2010, table 2: (b) of first indices, (f) of total ones, which is Jansen's
        a, mixed, b = scaled[chosen, :1], scaled[chosen, 1:-1], scaled[chosen, -1:]
        parts = np.mean(b * (mixed - a), axis=0), 0.5 * np.mean((a - mixed) ** 2, axis=0)
        return np.array(parts) / np.concatenate([a, b]).var()

    found = indices(known)
    ends = intervals.of_replicates(found, np.array([indices(part) for part in parts]), confidence)
    return Sensitivity(
        tuple(names), "saltelli", int(known.sum()), confidence, found[0], ends[0], found[1], ends[1]
    )  # fmt: skip


def of_given(values: np.ndarray, parameters: Mapping[str, np.ndarray], confidence: float) -> Sensitivity | None:
    """Return the first indices of an output from any samples (N,), of the first that are fine.

    None where they are too few, or nothing varies.
    """
    from scipy.special import ndtri

    chosen = np.flatnonzero(np.isfinite(values))[:MOST_GIVEN]
    n = chosen.size
    n_slices = min(n // FEWEST_IN_SLICE, max(n // IN_SLICE, FEW_SLICES), MOST_SLICES)
    if n_slices < FEWEST_SLICES or is_constant(values[chosen]):
        return None
    output = (values[chosen] - values[chosen].mean()) / values[chosen].std()
    found = [_explained(output[np.argsort(x[chosen], kind="stable")], n_slices) for x in parameters.values()]
    first, errors = np.array(found).T
    ends = first[:, None] + ndtri(0.5 + 0.5 * confidence) * errors[:, None] * np.array([-1.0, 1.0])
    return Sensitivity(tuple(parameters), "given data", n, confidence, first, ends)


def _explained(ordered: np.ndarray, n_slices: int) -> tuple[float, float]:
    """Return the share of the variance that straight lines in slices explain, less what chance adds, and its error.

    `ordered` are values (n,) of mean 0 and variance 1, in the order of the parameter.
    """
    n, numbers = ordered.size, np.arange(ordered.size)
    places = numbers * n_slices // n
    counts = np.bincount(places)
    steps = numbers - (np.bincount(places, numbers) / counts)[places]
    steps /= np.sqrt(np.bincount(places, steps**2))[places]
    lines = (np.bincount(places, ordered) / counts)[places] + np.bincount(places, ordered * steps)[places] * steps
    left = (ordered - lines) ** 2
    share = 1.0 - np.sum(left) / (n - 2 * n_slices) * (n - 1) / n
    # without the leverage of a sample what a line leaves of it is too small
    left /= 1.0 - 1.0 / counts[places] - steps**2
    return float(share), float(np.std((1.0 - share) * ordered**2 - left) / np.sqrt(n))


def sensitivities(
    quantities: Iterable[tuple[str, np.ndarray]],
    parameters: Mapping[str, np.ndarray],
    names: list[str],
    fine: np.ndarray,
    n_replicates: int | None,
    confidence: float,
) -> dict[str, Sensitivity]:
    """Return the indices of all quantities that have them, of names and columns (N,), one in memory at a time.

    `names` are those of the parameters, columns (N,), that are drawn; `fine`, (N,), the samples that are.
    `n_replicates` Sobol sequences are what Saltelli's blocks are of in turn; None of other samples.
    """
    if n_replicates is None and len(names) < 2:
        return {}
    places, n = np.flatnonzero(fine), fine.size
    if n_replicates is None:
        n = int(places[MOST_GIVEN - 1]) + 1 if places.size > MOST_GIVEN else n  # those hold the first that are fine
        first = {name: parameters[name][:n].copy() for name in names}
    found = {}
    for name, values in quantities:
        known = np.where(fine[:n], values[:n], np.nan)
        if n_replicates is None:
            found[name] = of_given(known, first, confidence)
        else:
            found[name] = of_blocks(known, names, confidence, n_replicates)
    return {name: one for name, one in found.items() if one is not None}


def sensitivity_remarks(
    found: Mapping[str, Sensitivity], n_replicates: int | None, n_parameters: int, fine: np.ndarray, correlated: bool
) -> tuple[Remark, ...]:
    """Return what is to be said of the indices: of what they are, and why there are none."""
    if n_replicates is not None:
        return _of_blocks(fine.reshape(-1, n_parameters + 2), n_replicates)
    n_fine = int(fine.sum())
    if n_parameters < 2:
        return ()
    fewest = FEWEST_IN_SLICE * FEWEST_SLICES
    if n_fine < fewest:
        few = "1 sample is" if n_fine == 1 else f"{n_fine} samples are"
        return (note(f"{few} too few to rank parameters by first Sobol indices, which takes {fewest}"),)
    if not found:
        return ()
    count = max(one.count for one in found.values())
    text = f"first Sobol indices are estimated from {count} samples in slices of each parameter"
    if correlated:
        return (note(f"{text}; parameters are correlated, so that shares overlap and may sum to more than 1"),)
    return (note(f"{text}; total ones, which know of parameters that act together, take the sampler saltelli"),)


@gathered
def _of_blocks(fine: np.ndarray, n_replicates: int) -> Iterator[Remark]:
    """Return what is to be said of blocks with these fine samples, (n_blocks, d + 2)."""
    known, size = fine.all(axis=1), fine.shape[1]
    if not known.all():
        yield warning(
            f"Sobol indices are of the {known.sum()} of {known.size} blocks without a failed sample, and are "
            "biased where samples do not fail at random"
        )
    least = min(int(known[k::n_replicates].sum()) for k in range(n_replicates))
    if least < FEWEST_OF_REPLICATE:
        few = f"{known.sum()} blocks of samples are too few for Sobol indices, which take {FEWEST_OF_REPLICATE}"
        what = f"{few} of each of {n_replicates} Sobol sequences (ensemble.replicates)"
        yield note(f"{what}; give at least -n {FEWEST_OF_REPLICATE * n_replicates * size}")
    elif least < FEW_OF_REPLICATE:
        few = f"intervals of Sobol indices follow from {n_replicates} Sobol sequences of {least} blocks"
        enough = f"from -n {FEW_OF_REPLICATE * n_replicates * size} on they hold as often as they say"
        yield note(f"{few} each, and may be short of such few; {enough}")
