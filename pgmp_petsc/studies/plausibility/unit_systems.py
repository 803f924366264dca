"""What does not fit a scene whose materials are in other units than SI: gravity that is not said, units of parameters."""

from __future__ import annotations

from collections.abc import Iterator

from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.messages import Finding, doubt, refusal
from pgmp_petsc.scene.unit_systems import SI, STANDARD_GRAVITY, UnitSystem


def system_findings(scene: Scene, system: UnitSystem | None) -> Iterator[Finding]:
    """Yield what is wrong with a scene that is not in SI units: gravity that is not said, units of parameters."""
    if system in (None, SI):
        return
    name, material = next(iter(scene.materials.items()))
    shown = f"{name} has rho = {scene.number(material.rho):g} and E = {scene.number(material.E):g}"
    missing = [
        name
        for name, effect in scene.effects.items()
        if effect.uniform and "acceleration" not in effect.model_fields_set
    ]
    for effect in missing if system.gravity != STANDARD_GRAVITY else ():
        yield refusal(
            f"effects.{effect}.acceleration",
            f"missing, and 9.81 m/s2 does not fit: the materials are in {system} ({shown}); say acceleration = "
            f"{system.gravity:g} ({system.names[0]}/{system.names[2]}2), or give materials and lengths in SI units",
        )
    yield doubt(
        "materials",
        f"they are in {system} ({shown}), and all numbers are computed with as they are: outputs are in these units, but "
        f"messages that say m, kg, N or Pa mean {system}, {system.force} and {system.pressure}",
    )
    for name, parameter in scene.parameters.items():
        if parameter.unit not in ("", "-", "1", "rad"):
            yield doubt(
                f"parameters.{name}.unit",
                f"numbers with a unit are converted to SI, but the materials are in {system}; leave the unit out and "
                "give the number in these",
                parameter.unit,
            )
