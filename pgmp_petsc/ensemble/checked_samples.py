"""Which samples of an ensemble are checked: chosen by their numbers, so that ranks and batches have no part in it.

Where the scene gives no share, it is `SHARE`, or less where estimates would take more than `PRICE` of the time that
runs take. The price is counted, not measured, as the samples must be the same whenever and wherever an ensemble is run:
an estimate has some `EVALUATIONS` with the unknowns of beams, each with its neighbours, and of condensed bodies, each
with all others of its body; a run has its steps with the reduced coordinates. A sample with lengths of its own is alone
in the lanes of its estimate, and its mechanism is placed anew at every angle.
"""

from __future__ import annotations

from pgmp_petsc.dynamics.generalised_alpha import count_steps
from pgmp_petsc.indicator.coverage import is_estimated
from pgmp_petsc.indicator.schedule import schedules
from pgmp_petsc.models import REDUCED, LengthLanes, Model, ReducedModel
from pgmp_petsc.runtime.vectors import LANES
from pgmp_petsc.scene import Scene

PERIOD = 10_000
SHARE = 0.02
PRICE = 0.25
EVALUATIONS = 260  # of both sets of instants that an estimate has at least, corrections of all of them included
# us of one core: an unknown of a beam, a pair of unknowns of a condensed body, a reduced coordinate in a step, a body
# that is placed
OF_BEAM, OF_PAIR, OF_STEP, OF_PLACE = 0.8, 0.17, 0.09, 200.0
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
    evaluation = 0.0
    for body in mechanism.bodies:
        n = mechanism.space.n_pose * body.n_nodes + body.n_internal
        evaluation += OF_BEAM * n if body.component is None or body.component.rigid else OF_PAIR * n**2
    step = OF_STEP * (tables.n_coordinates + tables.n_modes)
    estimate = _evaluations(model.scene) * evaluation
    if isinstance(model, LengthLanes):
        estimate = LANES * estimate + OF_PLACE * model.n_places
    return estimate / (count_steps(simulation.duration, simulation.step) * step)


def _evaluations(scene: Scene) -> float:
    """Return how many evaluations an estimate is taken to have."""
    if all(effect.type != "end_stop" for effect in scene.effects.values()):
        return EVALUATIONS
    duration = scene.simulation.duration
    densest = schedules(count_steps(duration, scene.simulation.step), duration)[-2:]  # compared with one another
    return max(EVALUATIONS, sum(schedule.steps.size for schedule in densest))


def checked(share: float, n_samples: int) -> list[tuple[int, int]]:
    """Return the ranges (first, last) of the samples 0 to n_samples - 1 that are checked, last - 1 the last of each.

    The first ``share`` of every ten thousand. As samples are independent, these are as good as any others.
    """
    found = []
    for first in range(0, n_samples if share > 0.0 else 0, PERIOD):
        together = min(max(n_samples - first, FEWEST), PERIOD)
        found.append((first, min(first + max(1, round(share * together)), n_samples)))
    return found
