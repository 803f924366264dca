"""``pgmp new``: a commented scene to begin with."""

from __future__ import annotations

from pathlib import Path

import click

from pgmp_petsc.cli.options import PathName
from pgmp_petsc.cli.report import quiet, say
from pgmp_petsc.runtime.agreement import on_root
from pgmp_petsc.scene.template import describe_template, template_names, write_template


class TemplateCommand(click.Command):
    """Lists the templates in its help."""

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Say what each template shows."""
        with formatter.section("Templates"):
            formatter.write_dl([(name, describe_template(name)) for name in template_names()])


@click.command(cls=TemplateCommand)
@click.argument(
    "template",
    metavar="TEMPLATE",
    shell_complete=lambda context, option, begun: [name for name in template_names() if name.startswith(begun)],
)
@click.argument("file", metavar="FILE.toml", type=PathName())
@click.option("--force", is_flag=True, help="Replace files that exist.")
@quiet
@click.pass_context
def new(context: click.Context, template: str, file: Path, force: bool) -> None:
    """Write the commented scene TEMPLATE to FILE.toml, and its mesh beside it where it has one.

    It runs as it is: pgmp run FILE.toml
    """
    written = on_root(context.obj.comm, write_template, template, file, force)
    for path in written:
        say(context, str(path))
    say(context, f"try: pgmp run {file}")
