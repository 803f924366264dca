"""Effect of a reduced model's own error on a figure: statistics, derivatives, designs and fits.

Errors are estimates e = reduced less full-order (`error_indicator`), so that y - e is what the full-order model would
have given: of a figure F the model's own part is about ``F(y) - F(y - e)``. From `COMPARABLE` of a figure on it is
printed beside the figure.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pgmp_petsc.estimates.coverage import SMALLER_ERRORS, absence_of_estimates, is_estimated
from pgmp_petsc.estimates.error_indicator import indicator_of
from pgmp_petsc.models import LengthLanes, ReducedModel
from pgmp_petsc.runtime.errors import Remark, note, warning
from pgmp_petsc.scene import Scene
from pgmp_petsc.stepping.generalised_alpha import integrate

COMPARABLE = 0.05  # of a figure
FEWEST = 5  # checked samples that tell of a deviation
DOUBTED = 0.25  # of a deviation, from which on an error that fewer of them have is a doubt of it
CURE = "a better basis (reduction.tolerance) makes it smaller, and full-order runs (--full) do without it"


@dataclass(frozen=True, eq=False)
class OwnErrors:
    """Estimated errors of some runs."""

    at_end: Mapping[str, np.ndarray]  # of every output at the end time, shape (n,), NaN where there is no estimate
    #: of every run: instants (s), and the errors of every output there
    histories: Sequence[tuple[np.ndarray, Mapping[str, np.ndarray]]]

    @classmethod
    def of_runs(cls, model: ReducedModel | LengthLanes, points: Sequence[Mapping[str, float]]) -> OwnErrors | None:
        """Run a model at parameter values and estimate its errors; None where the scene has no estimates."""
        if not is_estimated(model.scene):
            return None
        values = {name: np.array([point[name] for point in points]) for name in points[0]}
        watched = indicator_of(model).watch(values, np.arange(len(points)))
        with np.errstate(all="ignore"):  # a run that fails has no estimate
            done = integrate(model.batch(values, len(points)), model.scene.simulation, observer=watched)
            found = watched.estimate(done.status)
        return cls(found.at_end, found.histories)

    def over(self, time: np.ndarray, run: int = 0) -> dict[str, np.ndarray] | None:
        """Return the errors of a run at other instants (n_t,); None where one is not known."""
        instants, errors = self.histories[run]
        known = instants.size and all(np.isfinite(values).all() for values in errors.values())
        return {name: np.interp(time, instants, values) for name, values in errors.items()} if known else None


def not_known(scene: Scene, what: str) -> Remark:
    """Return why the model's own part of some figures is not known."""
    absent = absence_of_estimates(scene)
    why = absent[0].text if absent else "the full-order equations could not be solved about the motion"
    return note(f"what errors of the reduced model do to {what} is not known: {why}")


def of_statistics(
    quantities: Iterable[tuple[str, np.ndarray]],
    errors: Mapping[str, np.ndarray],
    fine: np.ndarray,
    units: Mapping[str, str],
    described: tuple[str, str],
    model: str = "reduced",
) -> tuple[Remark, ...]:
    """Return a warning of statistics to which errors are comparable; nothing where none is.

    Parameters
    ----------
    quantities
        Values of the samples, shape (N,) each, by the names of outputs.
    errors
        Estimated errors of these, NaN but for the samples that are checked.
    fine
        Which samples are described, shape (N,).
    units
        Of the quantities.
    described
        What goes by the mean, and what by the spread.
    model
        What was run; errors of others than the reduced model are those of their time step.
    """
    whose, cure = ("the reduced model", CURE) if model == "reduced" else ("the time step", SMALLER_ERRORS[model])
    told, n_checked = [], 0
    for name, values in quantities:
        if name in errors:
            n_checked = max(n_checked, int(np.sum(fine & np.isfinite(errors[name]) & np.isfinite(values))))
            told += _of_quantity(name, values, errors[name], fine, units.get(name, "1"), described)
    said = []
    if told:
        said.append(warning(f"{whose}'s own error is a good part of {'; '.join(told)}; {cure}"))
    if 0 < n_checked < FEWEST:
        said.append(
            note(
                f"what errors of {whose} do to deviations and quantiles is not known: it takes {FEWEST} checked "
                f"samples, and {n_checked} {'is' if n_checked == 1 else 'are'} here; ensemble.checked_share checks more"
            )
        )
    return tuple(said)


def _of_quantity(
    name: str, values: np.ndarray, errors: np.ndarray, fine: np.ndarray, unit: str, words: tuple[str, str]
) -> Iterator[str]:
    checked = fine & np.isfinite(errors) & np.isfinite(values)
    n = int(checked.sum())
    if not n:
        return
    y, e, all_fine = values[checked], errors[checked], values[fine & np.isfinite(values)]
    spread = float(all_fine.std(ddof=1)) if all_fine.size > 1 else 0.0
    tail, samples = "" if unit == "1" else f" {unit}", "1 checked sample" if n == 1 else f"{n} checked samples"
    if n >= FEWEST and e.std(ddof=1) > COMPARABLE * y.std(ddof=1):
        yield (
            f"{words[1]} of {name}: {samples} have a deviation of {y.std(ddof=1):.3g}{tail}, and of "
            f"{(y - e).std(ddof=1):.3g}{tail} without the estimated errors"
        )
    elif n < FEWEST and np.abs(e).max() > DOUBTED * spread > 0.0:
        yield (
            f"{words[1]} of {name}, of {spread:.3g}{tail} ({samples} with errors up to {np.abs(e).max():.3g}{tail}; "
            "ensemble.checked_share checks more)"
        )
    if abs(e.mean()) > COMPARABLE * max(abs(float(all_fine.mean())), spread):
        yield f"{words[0]} of {name}: about {e.mean():+.3g}{tail} of {all_fine.mean():.3g}{tail} ({samples})"


def of_figures(
    figures: Iterable[tuple[str, float, float, float]], sizes: str = "these figures", comparable: float = COMPARABLE
) -> tuple[Remark, ...]:
    """Return a warning of figures to which the error is comparable, and a note of how small it is otherwise.

    Parameters
    ----------
    figures
        What they are, their values, the values without the estimated errors, and the sizes that differences are
        compared with.
    sizes, comparable
        What the latter are, in words, and the share of them from which on there is a warning.
    """
    shares, told = [0.0], []
    for what, value, without, size in figures:
        share = abs(value - without) / size if size > 0.0 else 0.0
        shares.append(share)
        if share > comparable:
            told.append(f"{what}: {value:.5g}, about {without:.5g} without the estimated errors")
    if told:
        return (warning(f"the reduced model's own error is a good part of {'; '.join(told)}; {CURE}"),)
    return (note(f"errors of the reduced model are estimated at up to {100 * max(shares):.2g} % of {sizes}"),)
