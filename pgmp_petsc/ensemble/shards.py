"""Shards of an ensemble: parts that are runs of their own, on one machine or many, and are joined to what one run of
all samples gives, bit for bit.

A sample's numbers depend on the seed and its own number alone, and statistics are of all samples together: shards keep
samples, and whoever joins them describes them.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from pgmp_petsc.base.errors import InputError, Remark
from pgmp_petsc.base.resources import Timings
from pgmp_petsc.ensemble.checkpoint import Checkpoint, Columns, joined
from pgmp_petsc.ensemble.description import Origin, describe_ensemble
from pgmp_petsc.ensemble.plan import Plan, SampleFile
from pgmp_petsc.ensemble.sampling import Sampler
from pgmp_petsc.files.hdf5 import RunRecord
from pgmp_petsc.results.ensemble import Ensemble, Place, ShardSamples
from pgmp_petsc.scene import scene_from_toml, scene_to_toml
from pgmp_petsc.scene.border import own_values

CHECKSUM = 64  # characters
OUTPUTS = "outputs."  # before the names of columns that are outputs


def shard_of(origin: Origin, plan: Plan, checkpoint: Checkpoint, ranks: int, timings: Timings) -> ShardSamples:
    """Return what a finished checkpoint of a shard holds."""
    scene, file = origin.scene, plan.file
    first, last = plan.samples
    of_file = None if file is None else {"path": str(file.path), "identity": file.identity, "names": [*file.values]}
    place = Place(plan.shard.number, plan.shard.count, plan.n_samples, first, checkpoint.run, of_file)
    seed = None if file is not None else plan.seed
    return ShardSamples(
        origin.model,
        RunRecord(scene_to_toml(scene), own_values(scene), seed, ranks, timings.as_dict(), scene.remarks),
        place,
        origin.units,
        origin.said,
        () if file is None else file.remarks,
        origin.checked_share,
        checkpoint.remarks,
        checkpoint.columns(),
        checkpoint.bands(min(scene.ensemble.band_samples, last)),
    )


class Shards:
    """All shards of an ensemble, in their order; in place of a checkpoint. Their columns are put together in a folder.

    Raises `InputError` if they are not all shards of one ensemble, each once.
    """

    def __init__(self, paths: Sequence[Path], shards: Sequence[ShardSamples], folder: Path) -> None:
        _check(paths, [shard.place for shard in shards])
        ordered = sorted(zip(paths, shards), key=lambda pair: pair[1].place.number)
        self._shards, self._folder = [shard for _, shard in ordered], folder
        self._n_samples = shards[0].place.n_samples
        ends = [shard.place.first for shard in self._shards[1:]] + [self._n_samples]
        for (path, shard), end in zip(ordered, ends):
            n, fine = len(shard.status), shard.status == 0
            if n != end - shard.place.first:
                raise InputError(
                    f"file '{path}' is damaged: {n} samples, not {end - shard.place.first}; write it again"
                )
            for name in shard.columns:
                if name.startswith(OUTPUTS) and np.isnan(shard.columns[name][fine]).any():
                    raise InputError(f"file '{path}' is damaged: {name} is NaN of fine samples; write it again")
        self._check_instants([path for path, _ in ordered])
        self.remarks: tuple[Remark, ...] = tuple(remark for shard in self._shards for remark in shard.found)

    def _check_instants(self, paths: Sequence[Path]) -> None:
        """Raise `InputError` where the bands of a shard have other instants than those of the first."""
        # those of a shard are alike
        counts = [
            (path, shard.bands[next(iter(shard.bands))].shape[1])
            for path, shard in zip(paths, self._shards)
            if shard.bands
        ]
        for path, n in counts:
            if n != counts[0][1]:
                what = f"bands at {n} instants, not {counts[0][1]}"
                raise InputError(f"file '{path}' is damaged: {what}; write it again")

    def columns(self) -> Columns:
        """Return all samples as columns; raises `RunError` if the system fails to write them."""
        columns = Columns(self._folder, self._n_samples)
        for shard in self._shards:
            for name in shard.columns:
                columns.put(shard.place.first, {name: shard.columns[name]})
        return columns

    def bands(self, n: int) -> Mapping[str, np.ndarray]:
        """Return the outputs of the first n samples at the instants of the bands, each (n, n_t)."""
        return joined(shard.bands for shard in self._shards if shard.place.first < n)

    def described(self, output: Path) -> Ensemble:
        """Return the ensemble."""
        first = self._shards[0]
        record, place = first.record, first.place
        scene = scene_from_toml(record.scene_toml, ".").with_remarks(record.remarks)
        origin = Origin(first.model, scene, first.units, first.not_estimated, first.checked_share)
        columns, file = self.columns(), None
        if place.file is not None:
            names, parameters = place.file["names"], columns.of("parameters")
            values = {str(name): parameters[name] for name in names}
            file = SampleFile(Path(place.file["path"]), values, str(place.file["identity"]), first.file_remarks)
        plan = Plan(place.n_samples, record.seed or 0, output, file=file)
        ranks = sum(shard.record.ranks for shard in self._shards)
        seconds: Counter[str] = Counter()  # of all shards together: they may have run one after the other
        for shard in self._shards:
            seconds.update(shard.record.timings)
        return describe_ensemble(origin, plan, Sampler(scene, plan), self, ranks, Timings(dict(seconds)))


def _check(paths: Sequence[Path], places: Sequence[Place]) -> None:
    """Refuse what is not all shards of one ensemble, each once."""
    path, place = paths[0], places[0]
    for other_path, other in zip(paths[1:], places[1:]):
        for key in {**place.run, **other.run}:
            one, two = place.run.get(key), other.run.get(key)
            if one != two:
                plain = not any(isinstance(value, str) and len(value) == CHECKSUM for value in (one, two))
                shown = f" ({one} in '{path}', {two} in '{other_path}')" if plain else ""
                raise InputError(
                    f"'{other_path}' is a shard of another ensemble than '{path}': its {key} differs{shown}"
                )
        if other.count != place.count:
            raise InputError(
                f"'{other_path}' is one of {other.count} shards and '{path}' one of {place.count}: take those of one "
                "division"
            )
    known: dict[int, Path] = {}
    for one_path, one in zip(paths, places):
        if one.number in known:
            raise InputError(f"shard {one.number}/{one.count} is there twice: '{known[one.number]}' and '{one_path}'")
        known[one.number] = one_path
    absent = [f"{number}/{place.count}" for number in range(1, place.count + 1) if number not in known]
    if absent:
        raise InputError(f"missing: shard {', '.join(absent)}; give the files of all {place.count}")
