"""Which samples of an ensemble are checked: chosen by their numbers, so that ranks and batches have no part in it.

Where the scene gives no share, it is `SHARE`, or less where estimates would take more than `PRICE` of the time that
runs take. The price is counted, not measured, as the samples must be the same whenever and wherever an ensemble is run:
an estimate has a run with smaller steps, and evaluations at two sets of instants with the unknowns of beams, each with
its neighbours, and of condensed bodies, each with all others of its body; a run has its steps with the reduced
coordinates. A sample with lengths of its own is alone in the lanes of its estimate, and its mechanism is placed anew at
every angle.
"""

from __future__ import annotations

from pgmp_petsc.dynamics.generalised_alpha import count_steps
from pgmp_petsc.indicator.coverage import is_estimated
from pgmp_petsc.indicator.schedule import FINER, most_evaluations, price_of_evaluation, schedules
from pgmp_petsc.models import REDUCED, LengthLanes, Model, ReducedModel
from pgmp_petsc.runtime.vectors import LANES

PERIOD = 10_000
SHARE = 0.02
PRICE = 0.25
OF_STEP, OF_PLACE = 0.09, 200.0  # us of one core: a reduced coordinate in a step, a body that is placed
FEWEST = 1_000  # samples of which a share is taken, where there are less: already a small ensemble has some


def share_of(model: Model) -> float:
    """Return the share of a model's samples that are checked."""
    if not is_estimated(model.scene):
        return 0.0
    given = model.scene.ensemble.checked_share
    if not isinstance(model, REDUCED):  # a fifth of the price of a run
        return SHARE if given is None else given
    return min(SHARE, PRICE / price_of(model)) if given is None else given


def price_of(model: ReducedModel | LengthLanes) -> float:
    """Return about how many runs of a sample cost as much as an estimate of its errors."""
    mechanism, simulation, tables = model.kinematics.mechanism, model.scene.simulation, model.terms.tables
    n_steps = count_steps(simulation.duration, simulation.step)
    sets = schedules(n_steps, simulation.duration, most_evaluations(mechanism))[:2]  # by these most samples are settled
    evaluations = sum(one.steps.size for one in sets)
    estimate = evaluations * price_of_evaluation(mechanism)
    if isinstance(model, LengthLanes):
        estimate = LANES * estimate + OF_PLACE * model.n_places
    return FINER + estimate / (n_steps * OF_STEP * (tables.n_coordinates + tables.n_modes))


def checked(share: float, n_samples: int) -> list[tuple[int, int]]:
    """Return the ranges (first, last) of the samples 0 to n_samples - 1 that are checked, last - 1 the last of each.

    The first ``share`` of every ten thousand. As samples are independent, these are as good as any others.
    """
    found = []
    for first in range(0, n_samples if share > 0.0 else 0, PERIOD):
        together = min(max(n_samples - first, FEWEST), PERIOD)
        found.append((first, min(first + max(1, round(share * together)), n_samples)))
    return found
