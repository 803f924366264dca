"""Tolerances of scenes whose lengths or places are parameters: chosen at the nominal ones, checked at the extreme ones.

A tolerance is met by runs of one mechanism (`choice`). What it leaves open is chosen with the nominal lengths; then the
same is asked with nothing left open at both ends of every length, the others nominal, and together. That all models
between them are as good follows from how smooth they are in a length, which every build measures (`length_build`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

from pgmp_petsc.bodies.line_bodies import at_lengths
from pgmp_petsc.bodies.shape import BodyShape
from pgmp_petsc.experiments.finished import Finished
from pgmp_petsc.reduction.build import build_rom
from pgmp_petsc.results.selection import Selection
from pgmp_petsc.runtime.errors import InputError, RunError
from pgmp_petsc.runtime.groups import RankGroup
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.lengths import extremes, length_names, with_numbers
from pgmp_petsc.scene.numerics import Reduction, Simulation
from pgmp_petsc.selection.choice import Choice, choose


def choose_over_lengths(
    scene: Scene,
    meshes: Mapping[str, BodyShape],
    group: RankGroup,
    say: Callable[[str], None] = lambda text: None,
    finished: Finished | None = None,
) -> Choice:
    """Choose what the tolerances of a scene leave open, with any lengths; see `choose`. Collective on ``group.world``.

    Raises
    ------
    InputError, RunError
        As `choose`; with the lengths at which what was chosen does not keep the tolerance.
    """
    names = length_names(scene)
    if not names:
        return choose(scene, meshes, group, say, finished)
    nominal = {name: scene.nominal[name] for name in names}
    say(f"tolerances: what they leave open is chosen at {_words(nominal)}, and checked at the ends of the range")
    found = _chosen_at(scene, nominal, meshes, group, say, finished)
    chosen = scene.model_copy(update={"reduction": found.scene.reduction, "simulation": found.scene.simulation})
    asked, remarks = _asked_again(scene, chosen), []
    for lengths in extremes(scene):
        check = _chosen_at(asked, lengths, meshes, group, lambda text: None, None)
        remarks.append(f"at {_words(lengths)}: {_left(check.selection)}")
    selection = replace(found.selection, remarks=(*found.selection.remarks, *remarks))
    return Choice(chosen, build_rom(chosen, meshes, group), selection)


def _chosen_at(
    scene: Scene,
    lengths: Mapping[str, float],
    meshes: Mapping[str, BodyShape],
    group: RankGroup,
    say: Callable[[str], None],
    finished: Finished | None,
) -> Choice:
    """Choose with some lengths, m."""
    shapes = at_lengths(scene.with_values(lengths), meshes)
    try:
        return choose(with_numbers(scene, lengths), shapes, group, say, finished)
    except (InputError, RunError) as error:
        raise type(error)(f"at {_words(lengths)}: {error}") from error


def _asked_again(scene: Scene, chosen: Scene) -> Scene:
    """Return a scene with its tolerances in which everything is given that was chosen."""
    update: dict[str, Reduction | Simulation] = {"simulation": chosen.simulation}
    if scene.reduction.tolerance is not None:
        kept = {"tolerance": scene.reduction.tolerance}
        update["reduction"] = Reduction(**chosen.reduction.model_dump(exclude_none=True) | kept)
    if scene.simulation.tolerance is not None:
        kept = {"tolerance": scene.simulation.tolerance}
        update["simulation"] = Simulation(**chosen.simulation.model_dump() | kept)
    return scene.model_copy(update=update)


def _words(lengths: Mapping[str, float]) -> str:
    return ", ".join(f"{name} = {value:.6g}" for name, value in lengths.items())


def _left(selection: Selection) -> str:
    """Say what is left of each part of the error."""
    parts = {attempt.part: attempt.largest for attempt in selection.attempts}
    return ", ".join(f"{part} leaves {left:.2g}" for part, left in parts.items()) or "nothing was left to look at"
