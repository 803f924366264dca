"""What every feature needs, and that every command compares it with its scene."""

import pytest
from combinations import KINDS, TINY
from conftest import ROOT
from mpi4py import MPI

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.mechanism.capabilities import FEATURES, Purpose, check_capabilities
from pgmp_petsc.scene import Scene, scene_from_toml
from pgmp_petsc.studies.inputs import read_scene

#: What asks for each feature that an entry of a scene asks for.
ASKING = {
    "terms of second order": ("reduction.second_order=true",),
    "adaptive sampling": ("reduction.sampling_tolerance=0.1", 'reduction.interpolation="spline"'),
    "choice of the reduction by a tolerance": ("reduction.tolerance=0.1",),
    "choice of the step by a tolerance": ("simulation.tolerance=0.1",),
    "choice of effects": ('reduction.effects="auto"',),
    "stiffness by loads, inertia of changing modes": ('effects.x={type="mode_inertia"}',
                                                      'effects.y={type="geometric_stiffening"}'),
}  # fmt: skip


def scene_of(kind: str, *overrides: str) -> Scene:
    return scene_from_toml(KINDS[kind], ".", (*TINY, *overrides))


@pytest.mark.parametrize("feature", [f for f in FEATURES if f.name in ASKING], ids=lambda feature: feature.name)
@pytest.mark.parametrize("purpose", list(Purpose))
def test_a_feature_is_refused_where_it_is_used_and_nowhere_else(feature, purpose: Purpose) -> None:
    asked = ASKING[feature.name]
    check_capabilities(scene_of("beams", *asked), purpose)
    commands = (Purpose.SIZES,)  # it takes no such mechanism, whatever the scene asks for
    for kind in ("two coordinates", "cells in the plane"):
        scene = scene_of(kind, *asked)
        if not any(other.name != feature.name and purpose in other.purposes and list(other.entries(scene))
                     for other in FEATURES) and purpose not in commands:  # fmt: skip
            check_capabilities(scene, purpose)


@pytest.mark.parametrize("purpose", [Purpose.FULL, Purpose.CHECK, Purpose.BUILD, Purpose.TRADEOFF])
@pytest.mark.parametrize("name", ["five_bar", "platform_3rrr", "slider_crank_solid2d", "rssr_beams", "spatial_mixed"])
def test_every_kind_that_can_be_reduced_may_have_tolerances(name: str, purpose: Purpose) -> None:
    tolerances = ["simulation.tolerance=1e-2", "reduction.tolerance=1e-2"]
    read_scene(ROOT / "scenes" / f"{name}.toml", tolerances, [], MPI.COMM_SELF, purpose)


@pytest.mark.parametrize("purpose", [Purpose.FULL, Purpose.CHECK])
def test_the_step_of_rigid_mechanisms_is_not_chosen_by_a_tolerance(purpose: Purpose) -> None:
    with pytest.raises(InputError, match="simulation.tolerance = 0.1: .* but all are rigid; leave it out, and give"):
        check_capabilities(scene_of("all rigid in the plane", "simulation.tolerance=0.1"), purpose)


@pytest.mark.parametrize("purpose", [Purpose.BUILD, Purpose.MODES, Purpose.REDUCED, Purpose.TRADEOFF])
def test_rigid_mechanisms_have_nothing_to_reduce(purpose: Purpose) -> None:
    with pytest.raises(
        InputError, match="all are rigid, so there is nothing to reduce; run pgmp simulate SCENE --full"
    ):
        check_capabilities(scene_of("all rigid in the plane"), purpose)


def test_angles_that_a_tolerance_finds_are_priced_as_those_that_nobody_gives(tmp_path) -> None:
    """Three coordinates at 629 angles along each, the default of one, would be refused."""
    text = (ROOT / "scenes" / "platform_3rrr.toml").read_text()
    (tmp_path / "scene.toml").write_text(text.replace("angles = 6 ", "tolerance = 0.01 "))
    read_scene(tmp_path / "scene.toml", [], [], MPI.COMM_SELF, Purpose.BUILD)
