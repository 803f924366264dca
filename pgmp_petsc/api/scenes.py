"""Scenes: from a file or from tables, and with other values; some to begin with, and what they may say."""

from __future__ import annotations

import os
import shlex
from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any

from pgmp_petsc.api.arguments import toml_data
from pgmp_petsc.api.declared import Argument, command, interface
from pgmp_petsc.api.ranks import ranks_of, tell, tell_remarks
from pgmp_petsc.base.errors import InputError
from pgmp_petsc.base.surroundings import Comm
from pgmp_petsc.declare.ideas import take
from pgmp_petsc.files.claims import check_output, replacing
from pgmp_petsc.ranks.agreement import agreed, on_root
from pgmp_petsc.scene import Scene, load_scene, loading, scene_from_tables

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
    found = on_root(comm, lambda: scene_from_tables(toml_data(tables), Path(directory)), doing="composing the scene")
    tell_remarks(comm, found.remarks)
    return found


@command(
    "new", "Write a commented scene that runs, to begin with.", 10, petsc=False,
    template=Argument(
        "Name of the scene to begin with; with `source` the scene's file.",
        listed=lambda: {name: loading.describe_template(name) for name in loading.template_names()},
    ),
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
        target = target if target.suffix else target.with_suffix(loading.ENDING)
        written, lines, attempt = on_root(comm, _write_made, Path(source), target, force)
        for line in lines:
            tell(comm, line)
    else:
        written = on_root(comm, loading.write_template, template, Path(file or f"{template}{loading.ENDING}"), force)
    for path in written:
        tell(comm, str(path))
    tell(comm, f"try: pgmp {attempt.format(shlex.quote(str(written[0])))}")
    return written


def _write_made(source: Path, file: Path, force: bool) -> tuple[list[Path], list[str], str]:
    """Write the scene of a file of another program; return what was written, what to say, and what to try."""
    from pgmp_petsc.figures.solids import part_picture  # few scenes are made so
    from pgmp_petsc.figures.style import save
    from pgmp_petsc.studies.new_scene import ROBOT, scene_of_part, scene_of_robot

    loading.check_scene_file(file)
    if source.suffix.lower() in ROBOT:
        text, lines = scene_of_robot(source, file)
        loading.write_files({file: text.encode()}, file, force)
        return [file], lines, "simulate {} --full -o run.h5"
    made, picture = scene_of_part(source, file), file.with_suffix(".png")
    if not force and picture.exists():
        raise InputError(f"file '{picture}' exists; give another name, or replace it with --force")
    loading.write_files({file: made.text.encode()}, file, force)
    places = {one.name: one.centre for one in made.part.cylinders}
    save(part_picture(made.part.mesh, places, f"{file.stem}: whole cylinders of {source.name}", "mm"), picture)
    return [file, picture], made.lines, "run {}"


@command(
    "schema", "What a scene may say, for editors or as a page.", 180, petsc=False, figures=None,
    report=lambda text, path, said: text.rstrip() if path is None else "",  # not where a file has it
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
