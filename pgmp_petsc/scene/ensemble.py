"""An ensemble: many runs with drawn parameters, and which figures of them are asked for."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated, Literal, Self

from pydantic import Field, model_validator

from pgmp_petsc.runtime.errors import nearest_name
from pgmp_petsc.scene.fields import Integer, Name, Number, Table, at_most, exactly_one, refusal
from pgmp_petsc.scene.messages import problem

if TYPE_CHECKING:
    from pgmp_petsc.scene.schema import Scene

Probability = Annotated[Number, Field(gt=0.0, lt=1.0)]
Bins = Annotated[Integer, at_most(1_000_000, "every instant of every output has as many, of 8 bytes each")]
Batch = Annotated[Integer, at_most(1_000_000, "a rank holds the states and tables of so many samples at once")]
Instants = Annotated[Integer, at_most(100_000, "every sample of the bands has as many numbers of each output")]
OfBands = Annotated[Integer, at_most(10_000_000, "rank 0 holds all outputs of as many samples at every instant")]
Replicates = Annotated[Integer, Field(ge=2), at_most(1000, "each has a sequence of its own, of too few points then")]


class Event(Table):
    """An output above or below a level, at the end of a run or at any time in it."""

    output: str = Field(description="name of an output")
    above: Number | None = Field(None, description="the event is an output above this level, in the output's unit")
    below: Number | None = Field(None, description="the event is an output below this level, in the output's unit")
    when: Literal["end", "ever"] = Field(
        "end",
        description='"end": at the end time; "ever": at the end of any step, the start included; the instant of the '
        "first passage is then kept of every sample",
    )

    @property
    def level(self) -> float:
        """The level that is exceeded, or fallen below."""
        return self.below if self.above is None else self.above

    @model_validator(mode="after")
    def _one_level(self) -> Self:
        exactly_one(self, "above", "below")
        return self


class Ensemble(Table):
    """Many runs with parameters drawn from their distributions."""

    sampler: Literal["random", "latin_hypercube", "sobol", "saltelli"] = Field(
        "random",
        description='"random": independent samples; "latin_hypercube": one in each of N equally probable slices of '
        'every parameter; "sobol": scrambled Sobol sequences, independent replicates of them; "saltelli": base points '
        "and what differs from them in one parameter, for Sobol indices",
    )
    copula: Literal["gaussian", "student", "clayton", "gumbel", "frank"] = Field(
        "gaussian",
        description='how parameters of [correlation] depend on each other: "gaussian": extremes of two are independent '
        'in the end; "student": they come together, the more so the less `copula_freedom` is; '
        '"clayton": low values come together; "gumbel": high values do; "frank": neither do in the end',
    )
    copula_freedom: Number = Field(
        4.0, ge=1.0, le=1000.0, description="degrees of freedom of Student's copula; many are the Gaussian one"
    )
    replicates: Replicates = Field(
        8, description="scrambled Sobol sequences that take turns; intervals follow from their differences"
    )
    confidence: Probability = Field(0.95, description="level of all confidence intervals")
    bins: Bins | None = Field(
        None, ge=1, description="number of bins of the estimated densities; as many as the samples tell if not given"
    )
    quantiles: tuple[Probability, ...] = Field(
        (0.025, 0.25, 0.5, 0.75, 0.975), description="probabilities of the reported quantiles"
    )
    probabilities: dict[Name, Event] = Field({}, description="probabilities of events, by label")
    extremes: bool = Field(
        False,
        strict=True,
        description="keep the largest and the smallest value of every output over time, and when they are reached; "
        "outputs are then evaluated after every step",
    )
    bands: Instants = Field(
        51, ge=0, description="most instants at which outputs are described over time, start and end included; 0 = none"
    )
    band_samples: OfBands = Field(
        10_000, ge=2, description="most samples that the bands are of, the first ones; the pieces keep their outputs"
    )
    batch: Batch = Field(512, ge=1, description="most samples that a rank integrates together")
    checked_share: Number | None = Field(
        None,
        ge=0.0,
        le=1.0,
        description="share of the samples whose errors are estimated: the first of every ten thousand samples; "
        "of less than a thousand, the share of a thousand; 0 = none, 1 = all; by default 0.02, or less where that "
        "would take more than a quarter of the time of the runs, but always one sample, and more than one in blocks of "
        "eight",
    )
    failed_share: Number = Field(
        0.5,
        ge=0.0,
        le=1.0,
        description="largest share of failed samples of which the outputs are described without them; beyond it they "
        "have bounds of quantiles alone, and a warning",
    )
    balance: bool = Field(
        False, description="draw up the balance of energy of every sample, which needs its energies after every step"
    )

    @model_validator(mode="after")
    def _start_and_end(self) -> Self:
        if self.bands == 1:
            raise refusal("must be 0, or at least 2: the start and the end", "bands")
        return self


def ensemble_problems(scene: Scene) -> Iterator[str]:
    """Yield one line for each event that does not fit the scene's outputs."""
    for label, event in scene.ensemble.probabilities.items():
        entry = f"ensemble.probabilities.{label}"
        if event.output not in scene.outputs:
            what = f"there is no such output{nearest_name(event.output, scene.outputs)}"
            yield problem(f"{entry}.output", what, event.output)
        for kind in ("outputs", "parameters"):
            if label in getattr(scene, kind):
                yield problem(entry, f"{kind}.{label} has the same name; give the event another one")
