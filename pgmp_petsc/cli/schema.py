"""``pgmp schema``: what a scene may say, for editors and as a page."""

from __future__ import annotations

from pathlib import Path

import click

from pgmp_petsc.cli.options import PathName
from pgmp_petsc.cli.report import quiet, say
from pgmp_petsc.runtime.agreement import on_root
from pgmp_petsc.runtime.errors import InputError

PAGES = (".md", ".markdown")


@click.command()
@click.option(
    "-o",
    "--output",
    metavar="FILE.json|FILE.md",
    type=PathName(),
    help="File to write; standard output has the JSON schema if it is not given.",
)
@quiet
@click.pass_context
def schema(context: click.Context, output: Path | None) -> None:
    """Write the JSON schema of scenes for editors (FILE.json), or all entries of a scene as a page (FILE.md).

    An editor with a TOML language server (Even Better TOML, taplo) completes and checks a scene whose first line is

        #:schema FILE.json
    """
    from pgmp_petsc.scene.editor_schema import schema_text

    if output is None:
        say(context, schema_text().rstrip())
        return
    on_root(context.obj.comm, _write, output)
    say(context, f"{output}")
    if output.suffix.lower() not in PAGES:
        say(context, f'an editor takes it for a scene that begins with the line "#:schema {output.name}"')


def _write(output: Path) -> None:
    """Write the page or the schema; by one process."""
    from pgmp_petsc.runtime.claims import check_output
    from pgmp_petsc.runtime.files import replacing
    from pgmp_petsc.scene.editor_schema import schema_text
    from pgmp_petsc.scene.reference_page import reference_page

    suffix = output.suffix.lower()
    if output.is_dir():
        raise InputError(f"output '{output}' is a directory; give the name of a file in it, FILE.json or FILE.md")
    if suffix not in (".json", *PAGES):
        raise InputError(
            f"output '{output}': a schema is JSON for editors or a page in Markdown; name it "
            f"'{output.with_suffix('.json')}' or '{output.with_suffix('.md')}'"
        )
    is_page = suffix in PAGES
    target = check_output(output, "reference" if is_page else "schema")
    text = reference_page() if is_page else schema_text()
    with replacing(target) as partial:
        partial.write_text(text, encoding="utf-8")
