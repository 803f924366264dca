"""All checks of a scene's sense, in the order of its tables.

Limits are orders of magnitude: what is a hundred times beyond the usual is worth a question. Refused is only what no
mechanism can have, such as a beam thicker than long or a motion faster than light.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from functools import cache
from itertools import chain

from pgmp_petsc.mesh.line_mesh import LineMesh
from pgmp_petsc.mesh.solid_mesh import SolidMesh
from pgmp_petsc.runtime.errors import Remark, warning
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.messages import input_error
from pgmp_petsc.scene.unit_systems import SI, unit_system
from pgmp_petsc.studies.plausibility.bodies import (
    body_findings,
    first_frequency,
    material_findings,
    matrix_findings,
    sizes_of,
)
from pgmp_petsc.studies.plausibility.loads import load_findings, motion_findings, stop_findings
from pgmp_petsc.studies.plausibility.settings import parameter_findings, setting_findings, unused_findings
from pgmp_petsc.studies.plausibility.unit_systems import system_findings

SEVERAL, SHOWN = 3, 6  # findings that are told as one, and entries of them that are named
NUMBER = re.compile(r"(?<![A-Za-z_])[-+]?\d[\d.,]*(e[-+]?\d+)?")


def plausibility(scene: Scene, meshes: Mapping[str, LineMesh | SolidMesh] | None = None) -> tuple[Remark, ...]:
    """Return a warning for each entry that probably is not meant.

    Parameters
    ----------
    scene : Scene
    meshes : mapping, optional
        Mesh of every body. Without it only straight beams are looked at, and stops of coordinates.

    Raises
    ------
    InputError
        If entries cannot be meant, one line for each.
    """
    first = cache(lambda: first_frequency(scene, meshes or {}))
    sizes, system = sizes_of(scene, meshes or {}), unit_system(scene)
    findings = list(
        chain(
            parameter_findings(scene),
            material_findings(scene, system),
            system_findings(scene, system),
            body_findings(scene, sizes),
            matrix_findings(scene, meshes or {}),
            load_findings(scene, sizes, system or SI, first),
            motion_findings(scene, sizes, system or SI),
            setting_findings(scene, sizes, first),
            unused_findings(scene),
        )
    )
    refused = [finding.text for finding in findings if finding.refused]
    if not refused:  # the mechanism of a scene with sense can be put together
        stops = list(stop_findings(scene, meshes))
        refused, findings = [finding.text for finding in stops if finding.refused], findings + stops
    if refused:
        raise input_error(refused)
    return tuple(warning(text) for text in _each_once(scene, [finding.text for finding in findings]))


def _each_once(scene: Scene, texts: Sequence[str]) -> list[str]:
    """Return texts that say the same of several names as the first of them, with how many others there are."""
    names = {*scene.bodies, *scene.materials, *scene.parameters, *scene.joints, *scene.effects, *scene.ground.points}
    name = re.compile("|".join(rf"\b{re.escape(one)}\b" for one in sorted(names, key=len, reverse=True)) or "$^")
    alike: dict[str, list[str]] = {}
    for text in texts:
        alike.setdefault(NUMBER.sub("#", name.sub("*", text)), []).append(text)
    said: list[str] = []
    for own in alike.values():
        more = f". The same of {len(own) - 1} others: {_entries(own[1:])}"
        said += [own[0] + more] if len(own) >= SEVERAL else own
    return said


def _entries(texts: Sequence[str]) -> str:
    """Return the entries that texts begin with, the first few of them."""
    shown = [re.split(r" = |: ", text, maxsplit=1)[0] for text in texts[:SHOWN]]
    return ", ".join(shown) + (", ..." if len(texts) > SHOWN else "")
