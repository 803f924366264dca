"""Runs of a model at some parameter values, from which a derivative, a fit, a design or a probability is made: what
their errors are, and how far they leave what the model holds for."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from pgmp_petsc.base.errors import Remark, note
from pgmp_petsc.estimates.error_indicator import Estimate, indicator_of
from pgmp_petsc.estimates.own_error import absence_of_estimates, is_estimated
from pgmp_petsc.estimates.validity import Validity, remarks_of
from pgmp_petsc.mechanism.capabilities import comparing
from pgmp_petsc.models import ComponentModel, Model, Reduced
from pgmp_petsc.results.estimates import VALIDITY
from pgmp_petsc.scene.units import values_text
from pgmp_petsc.stepping.generalised_alpha import (
    Attempt,
    Run,
    Together,
    integrate,
    integrate_with_smaller_steps,
)
from pgmp_petsc.stepping.status import Status


@dataclass(frozen=True)
class RunsAtPoints:
    """What n runs say of themselves."""

    model: Model
    errors: Estimate | None  # None where there are none: the scene says so, or the model is of components
    validity: dict[str, np.ndarray]  # by the names of `VALIDITY`, shape (n,); of a reduced model alone

    @classmethod
    def of(cls, model: Reduced | ComponentModel, points: Sequence[Mapping[str, float]]) -> Self:
        """Run a reduced model at parameter values, with smaller steps where it fails. Component models are not run:
        they tell neither."""
        if model.name == ComponentModel.name:
            return cls(model, None, {})
        scene, n = model.scene, len(points)
        values = {name: np.array([point[name] for point in points]) for name in points[0]}
        indicator = indicator_of(model) if is_estimated(scene) else None
        whole = Estimate.nothing(model.outputs.functions, n)
        validity = {name: np.full(n, np.nan) for name in VALIDITY}

        def run(attempt: Attempt) -> Run:
            own = {name: of[attempt.samples] for name, of in values.items()}
            system = model.batch(own, attempt.samples.size)
            seen, watched = Validity(model, system, own, attempt.simulation), None
            if indicator is not None:
                watched = indicator.stepped(attempt.simulation).watch(system, np.arange(attempt.samples.size))
            watches = [seen] if watched is None else [seen, watched]
            with np.errstate(all="ignore"):  # a run that fails has no estimate
                done = integrate(system, attempt.simulation, observer=Together(watches))
                if watched is not None:
                    whole.put(attempt.samples.tolist(), watched.estimate(done.status))
            for name, largest in seen.extremes.items():
                validity[name][attempt.samples] = largest
            return done

        outcome = integrate_with_smaller_steps(run, scene.simulation, np.ones(n, dtype=bool))
        for sample in np.flatnonzero(outcome.status != Status.FINE).tolist():
            apart = {name: value for name, value in points[sample].items() if value != scene.values.get(name)}
            where = values_text(scene, apart) or "the scene's values"
            why = f"the run at {where} stopped at {outcome.failure_time[sample]:.4g} s: "
            for reasons in whole.absent.values():
                reasons[sample] = why + Status(outcome.status[sample]).meaning
        return cls(model, None if indicator is None else whole, validity)

    def not_known(self, what: str, names: Iterable[str] = ()) -> Remark:
        """Return why the model's own part of some figures, which are of outputs with these names, is not known."""
        scene = self.model.scene
        if self.model.name == ComponentModel.name:
            why = f"errors of component modes are not estimated; take more reduction.modes, or {comparing(scene)}"
            if not any(body.flexible for body in scene.bodies.values()):
                why = "all bodies are rigid, so that these are errors of the time step; take half of simulation.step"
        elif self.errors is None:
            why = absence_of_estimates(scene)[0].text
        else:
            why = f"{self.errors.why_not(names)}; {comparing(scene)}"
        return note(f"what errors of the {self.model.title} model do to {what} is not known: {why}")

    def beyond(self, whose: str = "samples") -> tuple[Remark, ...]:
        """Return how far the runs, which are `whose`, leave what the model holds for."""
        return remarks_of(self.model.scene, self.validity, whose) if self.validity else ()
