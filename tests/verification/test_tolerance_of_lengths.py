"""Tolerances with lengths as parameters: chosen at the nominal length, checked at both ends of its range."""

import pytest
from length_scenes import HIGH, LOW, long_crank
from mpi4py import MPI
from runs import read_meshes

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.bench import choice as length_choice
from pgmp_petsc.bench.choice import Choice
from pgmp_petsc.mechanism.capabilities import Purpose, check_capabilities
from pgmp_petsc.ranks.groups import RankGroup
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.uses import length_names

KNOBS = "static_modes=true, inertia_modes=false, parameter_modes=0, second_order=false, angles=8, length_points=2"
OPEN = (
    f'reduction={{tolerance=0.1, {KNOBS}, interpolation="spline"}}',
    'outputs={angle={type="angle", joint="crank_hinge"}}', 'reference.loads="own"', "parameters.r1={nominal=5.6e-3}",
    "simulation.duration=0.02",
)  # fmt: skip


def chosen(scene: Scene, said: list[str]) -> Choice:
    """Choose on this process."""
    with RankGroup.split(MPI.COMM_SELF, 1) as group:
        return length_choice.choose_over_lengths(scene, read_meshes(scene), group, said.append)


def test_what_is_chosen_at_the_nominal_length_is_checked_at_both_ends() -> None:
    scene, said = long_crank(*OPEN), []
    check_capabilities(scene, Purpose.BUILD)
    found = chosen(scene, said)
    assert said[0].startswith("tolerances: what they leave open is chosen at rod_length = 0.7, and checked")
    assert length_names(found.scene) == ("rod_length",) and found.scene.reduction.tolerance is None
    assert found.scene.reduction.modes == found.selection.chosen["reduction.modes"]
    ends = [text for text in found.selection.remarks if text.startswith("at rod_length = ")]
    assert [text.split(":")[0] for text in ends] == [f"at rod_length = {end:g}" for end in (LOW, HIGH)]
    for text in ends:
        assert 0.0 < float(text.split("basis leaves ")[1]) < 0.1
    # a model of every length, with the modes that were chosen
    assert len(found.rom.family.members) == 2 and found.rom.frequencies_hz.shape[1] == found.scene.reduction.modes


def test_what_does_not_do_at_an_end_is_refused_with_the_length(monkeypatch: pytest.MonkeyPatch) -> None:
    scene, asked, choose = long_crank(*OPEN), [], length_choice.choose

    def only_where_short(own: Scene, *others: object) -> Choice:
        asked.append((own.bodies["rod"].line.length, "modes" in own.reduction.model_fields_set, length_names(own)))
        if own.bodies["rod"].line.length > 0.72:
            raise InputError("reduction.tolerance = 0.1: cannot be met")
        return choose(own, *others)

    monkeypatch.setattr(length_choice, "choose", only_where_short)
    with pytest.raises(InputError, match="^at rod_length = 0.735: reduction.tolerance = 0.1: cannot be met"):
        chosen(scene, [])
    assert asked == [(0.7, False, ()), (LOW, True, ()), (HIGH, True, ())]
