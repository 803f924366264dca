"""Scenes: from a file or from tables, and with other values; some to begin with, and what they may say.

And the check of a scene, before anything is solved.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from os import PathLike, fspath
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pgmp_petsc.api.arguments import plain
from pgmp_petsc.api.declared import Argument, command, interface
from pgmp_petsc.api.ranks import ranks_of, solving_ranks_of, tell, tell_remarks
from pgmp_petsc.base.errors import InputError, counted
from pgmp_petsc.base.progress import doing
from pgmp_petsc.base.surroundings import Comm
from pgmp_petsc.bodies.shape import BodyShape
from pgmp_petsc.declare.ideas import take
from pgmp_petsc.files.claims import check_output, replacing
from pgmp_petsc.mechanism.capabilities import Purpose
from pgmp_petsc.mesh.solid_mesh import SolidMesh
from pgmp_petsc.ranks.agreement import agreed, on_root
from pgmp_petsc.scene import Scene, load_scene, scene_from_tables
from pgmp_petsc.scene.loading import (
    ENDING,
    check_scene_file,
    describe_template,
    template_names,
    write_files,
    write_template,
)
from pgmp_petsc.studies.check import describe_scene, describe_trial, summary_of_scene
from pgmp_petsc.studies.inputs import read_scene

if TYPE_CHECKING:
    from pgmp_petsc.components.condensing import Trial
    from pgmp_petsc.results.selection import EffectSizes


Overrides = Mapping[str, object] | Sequence[str] | None
Parameters = Mapping[str, float] | Sequence[str]
SCENE = Argument("Scene, or its file.", word="SCENE")
PAGES = (".md", ".markdown")


@interface(path=Argument("A file as docs/extending.md shows it."))
def use(path: str | PathLike[str], *, comm: Comm | None = None) -> None:
    """Take the ideas that a Python file declares, which scenes may name from then on. Collective on `comm`.

    Every rank runs the file. One that is in use already is left as it is; one that has changed is read again.

    Raises
    ------
    InputError
        If it cannot be read, is not Python, fails, has no idea in it, or has one that is not whole or whose name is
        taken; with the file and line.
    """
    with agreed(ranks_of(comm), "reading plugins"):
        take(Path(path))


@interface(path=Argument("The file; paths of meshes are relative to its folder."))
def load(
    path: str | PathLike[str],
    overrides: Overrides = (),
    parameters: Parameters | None = None,
    *,
    comm: Comm | None = None,
) -> Scene:
    """Return the scene of a TOML file.

    `overrides` are there before the scene is validated; with `parameters` nominal values stay.
    """
    comm = ranks_of(comm)
    found = on_root(comm, load_scene, Path(path), overrides, parameters)
    tell_remarks(comm, found.remarks)
    return found


@interface(
    tables=Argument('``{"scene": {"name": ...}, "bodies": {...}, ...}``, with plain numbers or numpy\'s.'),
    directory=Argument("Folder that paths of meshes are relative to."),
)
def compose(tables: Mapping[str, Any], directory: str | PathLike[str] = ".", *, comm: Comm | None = None) -> Scene:
    """Return the scene of tables as a TOML file has them; those of the first rank count, and are left as they are."""
    comm = ranks_of(comm)

    def composing_the_scene() -> Scene:
        return scene_from_tables(plain(tables), Path(directory))

    found = on_root(comm, composing_the_scene)
    tell_remarks(comm, found.remarks)
    return found


def _templates() -> dict[str, str]:
    return {name: describe_template(name) for name in template_names()}


@command(
    "new", "Write a commented scene that runs, to begin with.", 10, petsc=False,
    template=Argument("Name of the scene to begin with; with `source` the scene's file.", listed=_templates),
    file=Argument("The scene's file; TEMPLATE.toml if not given.", word="FILE.toml", by_last_place=True),
    source=Argument("Make the scene of this part of CAD, or robot.", "--from", "PART.step|ROBOT.urdf"),
    force=Argument("Replace files that exist."),
    gives="What was written.",
)  # fmt: skip
def new(
    template: str,
    file: str | PathLike[str] | None = None,
    *,
    source: str | PathLike[str] | None = None,
    force: bool = False,
    comm: Comm | None = None,
) -> list[Path]:
    """Write the commented scene `template` to `file`, or to TEMPLATE.toml, and its mesh beside it where it has one.

    With `source` it is made of another program's file: of a part of CAD (STEP) held at its widest bore and loaded at
    the farthest one, with FILE.png that shows its bores; or of a robot (URDF, MJCF), whose links are rigid bodies.
    It runs as it is: pgmp run FILE.toml
    """
    comm, attempt = ranks_of(comm), "run {}"
    if source is not None:
        if file is not None:
            raise InputError(f"'{template}' '{file}': with --from one name is needed, that of the scene's file")
        target = Path(template)
        target = target if target.suffix else target.with_suffix(ENDING)
        written, lines, attempt = on_root(comm, _write_made, Path(source), target, force)
        for line in lines:
            tell(comm, line)
    else:
        written = on_root(comm, write_template, template, Path(file or f"{template}{ENDING}"), force)
    for path in written:
        tell(comm, str(path))
    tell(comm, f"try: pgmp {attempt.format(written[0])}")
    return written


def _write_made(source: Path, file: Path, force: bool) -> tuple[list[Path], list[str], str]:
    """Write the scene of a file of another program; return what was written, what to say, and what to try."""
    from pgmp_petsc.figures.solids import part_picture  # few scenes are made so
    from pgmp_petsc.figures.style import save
    from pgmp_petsc.studies.new_scene import ROBOT, scene_of_part, scene_of_robot

    check_scene_file(file)
    if source.suffix.lower() in ROBOT:
        text, lines = scene_of_robot(source, file)
        write_files({file: text.encode()}, file, force)
        return [file], lines, "simulate {} --full -o run.h5"
    made, picture = scene_of_part(source, file), file.with_suffix(".png")
    if not force and picture.exists():
        raise InputError(f"file '{picture}' exists; give another name, or replace it with --force")
    write_files({file: made.text.encode()}, file, force)
    places = {one.name: one.centre for one in made.part.cylinders}
    save(part_picture(made.part.mesh, places, f"{file.stem}: whole cylinders of {source.name}", "mm"), picture)
    return [file, picture], made.lines, "run {}"


def _shown(text: str, path: Path | None, said: object) -> str:
    """Return a schema where there is no file that has it."""
    return text.rstrip() if path is None else ""


@command(
    "schema", "What a scene may say, for editors or as a page.", 180, petsc=False, report=_shown, figures=None,
    output=Argument(
        "File to write; standard output has the JSON schema if it is not given.", "-o --output", "FILE.json|FILE.md"
    ),
    gives="The text; the JSON schema where there is no file.",
)  # fmt: skip
def schema(output: str | PathLike[str] | None = None, *, comm: Comm | None = None) -> str:
    """Write the JSON schema of scenes for editors (FILE.json), or all entries of a scene as a page (FILE.md).

    An editor with a TOML language server (Even Better TOML, taplo) completes and checks a scene whose first line is

        #:schema FILE.json
    """
    comm = ranks_of(comm)
    target = None if output is None else Path(output)
    text = on_root(comm, _write_schema, target)
    if target is not None:
        tell(comm, f"{target}")
        if target.suffix.lower() not in PAGES:
            tell(comm, f'an editor takes it for a scene that begins with the line "#:schema {target.name}"')
    return text


def _write_schema(output: Path | None) -> str:
    from pgmp_petsc.scene.reference_page import reference_page, schema_text  # few ask for it

    if output is None:
        return schema_text()
    suffix = output.suffix.lower()
    if os.path.isdir(output):  # a Path's own way raises for names that are too long
        raise InputError(f"output '{output}' is a directory; give the name of a file in it, FILE.json or FILE.md")
    if suffix not in (".json", *PAGES):
        cure = f"name it '{output.with_suffix('.json')}' or '{output.with_suffix('.md')}'"
        raise InputError(f"output '{output}': a schema is JSON for editors or a page in Markdown; {cure}")
    is_page = suffix in PAGES
    target = check_output(output, "reference" if is_page else "schema")
    text = reference_page() if is_page else schema_text()
    with replacing(target) as partial:
        partial.write_text(text, encoding="utf-8")
    return text


@dataclass(frozen=True, eq=False)
class Checked:
    """A scene that holds together."""

    #: scene, meshes: the scene, whose `remarks` say what is probably not meant, and the mesh of every body
    scene: Scene
    meshes: Mapping[str, BodyShape]
    text: str  # what is in it: bodies, unknowns, active effects, estimated memory
    picture: Path | None = None  # file of the assembled mechanism; None where none was asked for
    trial: Trial | None = None  # what a build will take; None where it was not tried, or there are no continuum bodies
    sizes: EffectSizes | None = None  # sizes of all effects; None where they were not asked for
    #: tried, name: whether a trial was asked for, and what messages call the scene
    tried: bool = False
    name: str = "the scene"

    @property
    def trial_text(self) -> str:
        """Findings of the trial, in words."""
        if self.trial is None:
            return "  trial         no continuum bodies: nothing to try"
        return describe_trial(self.trial)

    def summary(self) -> dict[str, Any]:
        """Return the figures of ``pgmp check --json``."""
        found = {"trial": self.trial, "sizes_of_effects": self.sizes}
        return summary_of_scene(self.scene, self.meshes) | {k: v for k, v in found.items() if v is not None}


def _report(found: Checked, name: Path, said: object, strict: bool) -> str:
    """Return what was found besides the scene itself, which was printed before."""
    lines = [found.trial_text] if found.tried else []
    return "\n".join([*lines, *([] if found.sizes is None else found.sizes.lines())])


def _figures(found: Checked, strict: bool) -> dict[str, Any]:
    return found.summary() | ({"trial": found.trial} if found.tried else {})


def _status(found: Checked, strict: bool) -> int:
    if strict and found.scene.remarks:
        warnings = counted(len(found.scene.remarks), "warning")
        raise InputError(f"{found.name}: {warnings}, see above, and --strict takes none")
    return 0


@command(
    "check", "Validate a scene and say what is in it.", 30, report=_report, figures=_figures, status=_status,
    scene=SCENE,
    effects=Argument("Also estimate the size of every available effect: what to keep, what to leave."),
    trial=Argument("Also factorise the largest continuum body, and predict time and memory."),
    picture=Argument(
        "Also draw the assembled mechanism with the names of bodies, joints and points; beside it, as FILE_BODY.png, "
        "each part of cells with its named faces.", "--plot", "FILE.png"
    ),
    shell={"strict": Argument("End with status 2 if there are warnings.")},
)  # fmt: skip
def check(
    scene: Scene | str | PathLike[str],
    *,
    effects: bool = False,
    trial: bool = False,
    picture: str | PathLike[str] | None = None,
    parameters: Parameters | None = None,
    overrides: Overrides = (),
    comm: Comm | None = None,
) -> Checked:
    """Validate `scene` and print its bodies, unknowns, active effects and estimated memory; solve nothing.

    With `trial` the largest continuum body is factorised once on all ranks, which tells what a build will take. With
    `effects` the mechanism runs once with rigid bodies, and modes are computed at a few of its configurations; bodies
    of continuum elements are condensed for that, as in a build.

    What cannot be meant is refused with its entry's name. What probably is not meant is named in a warning: with
    `strict` these end the check with status 2 too.
    """
    comm = solving_ranks_of(comm) if effects or trial else ranks_of(comm)
    target = None if picture is None else Path(picture)
    inputs = () if isinstance(scene, Scene) else (Path(fspath(scene)),)
    if target is not None:
        on_root(comm, check_output, target, "picture", inputs)
    purpose = Purpose.SIZES if effects else Purpose.CHECK
    loaded, meshes = read_scene(scene, overrides, parameters, comm, purpose)
    text = on_root(comm, describe_scene, loaded, meshes)
    tell(comm, text)
    tell_remarks(comm, loaded.remarks)
    if target is not None:
        for line in on_root(comm, _draw, loaded, meshes, target, inputs):
            tell(comm, line)
    return Checked(
        loaded,
        meshes,
        text,
        target,
        _tried(loaded, meshes, comm) if trial else None,
        _sizes(loaded, meshes, comm) if effects else None,
        trial,
        "the scene" if isinstance(scene, Scene) else fspath(scene),
    )


def _draw(scene: Scene, meshes: Mapping[str, BodyShape], picture: Path, inputs: Sequence[Path]) -> list[str]:
    """Draw the assembled mechanism and its parts of cells, and say where; by one process only."""
    from pgmp_petsc.figures.mechanism import assembly  # matplotlib takes a noticeable time
    from pgmp_petsc.figures.solids import meshed_part
    from pgmp_petsc.figures.style import save
    from pgmp_petsc.studies.field_frames import assembly_of

    parts = {name: mesh for name, mesh in meshes.items() if isinstance(mesh, SolidMesh)}
    files = {name: picture.with_name(f"{picture.stem}_{name}.png") for name in parts}
    for file in files.values():
        check_output(file, "picture", inputs)
    lines = [f"  picture       {save(assembly(assembly_of(scene, meshes)), picture)}"]
    with doing("drawing parts"):
        for name, file in files.items():
            nodes, metre = scene.system.named(parts[name].nodes, "m")
            part = meshed_part(replace(parts[name], nodes=nodes), name, metre)
            lines.append(f"  faces         {save(part, file)}")
    return lines


def _tried(scene: Scene, meshes: Mapping[str, BodyShape], comm: Comm) -> Trial | None:
    from pgmp_petsc.components.condensing import try_largest

    return try_largest(scene, meshes, comm)


def _sizes(scene: Scene, meshes: Mapping[str, BodyShape], comm: Comm) -> EffectSizes:
    from pgmp_petsc.components.condensing import condensed
    from pgmp_petsc.ranks.groups import RankGroup
    from pgmp_petsc.studies.effect_sizes import estimate_effects

    with RankGroup.split(comm, 1) as group:
        shapes = condensed(scene, meshes, group, large=True)
    return on_root(comm, lambda: estimate_effects(scene, meshes, shapes=shapes))
