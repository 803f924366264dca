"""A click group that imports a command's module only when that command is called.

``pgmp --help`` and ``pgmp info`` must not wait for PETSc, and PETSc must be started with the user's options
before any module imports it; both need to know the command before its module is touched.
"""

from __future__ import annotations

import gc
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import click
from click.shell_completion import CompletionItem

from pgmp_petsc.api.found import Found, found
from pgmp_petsc.base.errors import nearest_name
from pgmp_petsc.base.surroundings import check_variables
from pgmp_petsc.cli.session import Session


@dataclass(frozen=True)
class LazyCommand:
    """A command that is found, and what the group's help says of it."""

    #: where its declaration is, its line of help, and whether PETSc is started before the module is imported
    head: Found

    def load(self) -> click.Command:
        """Import the module and return the command."""
        # what commands need takes a noticeable time, for which `pgmp --help` does not wait
        from pgmp_petsc.api.declared import found_command
        from pgmp_petsc.cli.declared import Declared

        command = Declared(found_command(self.head))
        gc.freeze()  # modules live to the end: later collections need not look through them
        gc.enable()
        return command


def found_commands() -> dict[str, LazyCommand]:
    """Return all commands by name, in the order of the group's help."""
    return {one.name: LazyCommand(one) for one in found() if one.name}


class LazyGroup(click.Group):
    """A group of :class:`LazyCommand`."""

    def __init__(self, *args: Any, lazy: Mapping[str, LazyCommand], **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._lazy = lazy

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names in the order in which they were registered."""
        return list(self._lazy)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command:
        """Import a command, after starting PETSc if it needs that.

        Raises `click.UsageError` if there is no such command, or it was given options for PETSc and does not use it.
        """
        if cmd_name not in self._lazy:
            raise click.UsageError(f"no command '{cmd_name}'{nearest_name(cmd_name, self._lazy)}", ctx)
        command = self._lazy[cmd_name]
        session = ctx.find_object(Session)
        if ctx.resilient_parsing:
            return command.load()  # a shell asks for what may follow: nothing runs
        check_variables()
        if command.head.petsc is True and session is not None:
            session.start_petsc()
        elif session is not None and session.petsc_options:
            given = " ".join(session.petsc_options)
            raise click.UsageError(
                f"'{cmd_name}' does not use PETSc, but was given PETSc options after '--': {given}", ctx
            )
        return command.load()

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        """Complete the names of commands without importing them, and the options of the group."""
        names = [
            CompletionItem(name, help=command.head.help)
            for name, command in self._lazy.items()
            if name.startswith(incomplete)
        ]
        return [*names, *click.Command.shell_complete(self, ctx, incomplete)]

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """List the commands without importing them."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, command.head.help) for name, command in self._lazy.items()])
