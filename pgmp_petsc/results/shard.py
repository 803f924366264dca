"""The file of a shard: samples of a part of an ensemble, for ``pgmp merge`` to join with the others."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pgmp_petsc.declare.records import JSON, Result, array, attribute, check_sizes, run_record
from pgmp_petsc.results.statistics import MODELS
from pgmp_petsc.runtime.errors import Remark, from_json, to_json
from pgmp_petsc.runtime.files import RunRecord

KIND = "shard"
PARAMETERS = "parameters."  # before the names of columns that are parameters
_REMARKS = (to_json, from_json)


@dataclass(frozen=True)
class Place:
    """Which part of which ensemble a shard is.

    Attributes
    ----------
    number, count
        Of the shard, from 1, and of shards.
    n_samples
        Of the whole ensemble.
    first
        Number of the first sample.
    run
        What the ensemble is, by key; the same for all shards.
    file
        Of the samples where they are from a file: its path, the identity of its content and the parameters it gives.
    """

    number: int
    count: int
    n_samples: int
    first: int
    run: dict[str, object]
    file: dict[str, object] | None = None


@dataclass(frozen=True)
class ShardSamples(Result):
    """The samples of a shard; the remarks of its record are those on the scene.

    `columns` are by ``<kind>.<name>``, and ``status`` and ``failure_time``; arrays of a file are read one by one.
    """

    kind = KIND
    model: str = attribute("@model", allowed=MODELS, about="full, components or reduced")
    record: RunRecord = run_record()
    place: Place = attribute(
        "@shard", code=(lambda place: json.dumps(vars(place)), lambda text: Place(**json.loads(text))),
        about="which part it is of which ensemble (JSON)",
    )  # fmt: skip
    units: dict[str, str] = attribute("@units", code=JSON, about="of the outputs, by name (JSON)")
    not_estimated: tuple[Remark, ...] = attribute(
        "@not_estimated", code=_REMARKS, about="on errors that are not estimated (JSON)"
    )
    file_remarks: tuple[Remark, ...] = attribute("@file_remarks", code=_REMARKS, about="on a file of samples (JSON)")
    checked_share: float = attribute("@checked_share", about="of the samples whose errors are estimated")
    found: tuple[Remark, ...] = attribute(
        "@found", code=_REMARKS, about="on pieces of the checkpoint that were not taken up (JSON)"
    )
    columns: Mapping[str, np.ndarray] = array(
        "sample", unit="SI", about="{name} of each sample", ordered=True, colons=True, lazy=True,
        gaps=lambda name: not name.startswith(PARAMETERS),
    )  # fmt: skip
    bands: Mapping[str, np.ndarray] = array(
        "known", "time", unit="SI", about="{name} over time, one sample a row", ordered=True, colons=True, lazy=True,
        gaps=True,
    )  # fmt: skip

    def __post_init__(self) -> None:
        if not isinstance(self.units, dict):
            raise ValueError(f"units are {self.units!r}; needed: one of every output")
        if "status" not in [*self.columns]:
            raise ValueError("columns lack 'status'")
        sizes = check_sizes(self)
        if sizes.get("known", 0) > sizes["sample"]:
            raise ValueError(f"bands are of {sizes['known']} samples; needed: at most the {sizes['sample']} there are")

    @property
    def status(self) -> np.ndarray:
        """How each sample ended, 0 = fine, shape (n,)."""
        return self.columns["status"]


#: Read a shard; its arrays are read one by one, within the block.
read_shard = ShardSamples.opened
