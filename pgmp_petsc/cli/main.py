"""Entry point of ``pgmp``: parses the command line, runs one command on all ranks and ends them all alike.

Exit status: 0 fine, 1 the run or some of its samples failed, 2 bad input, 130 interrupted, 143 or 138 ended by
SIGTERM or SIGUSR1. Rank 0 alone prints results and messages; a traceback is printed where it happened. Arguments after
a bare ``--`` go to PETSc.

A command's module is imported only when the command is called: ``pgmp --help`` and ``pgmp info`` must not wait for
PETSc, and PETSc must be started with the user's options before any module imports it.
"""

from __future__ import annotations

import gc
import os
import sys
import time
import traceback
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from typing import NoReturn

import click
from click.shell_completion import CompletionItem

from pgmp_petsc.api import Found, found
from pgmp_petsc.base import __version__
from pgmp_petsc.base.errors import InputError, PgmpError, missing_extra, nearest_name, plain_reason, visible
from pgmp_petsc.base.progress import beating
from pgmp_petsc.base.surroundings import Comm, check_variables
from pgmp_petsc.cli.declared import Session, at_terminal, complain, painter
from pgmp_petsc.ranks.ending import LastingOutput, descriptor_of, ending_on_signals, release_petsc, what_is_kept
from pgmp_petsc.ranks.petsc import PREFIXES, start_mpi, unused_options

#: All commands by name, in the order of the group's help.
COMMANDS = {one.name: one for one in found() if one.name}


def load(head: Found) -> click.Command:
    """Import the module of a command that was found, and return it."""
    # what commands need takes a noticeable time, for which `pgmp --help` does not wait
    from pgmp_petsc.api.declared import found_command
    from pgmp_petsc.cli.declared import Declared

    command = Declared(found_command(head))
    gc.freeze()  # modules live to the end: later collections need not look through them
    gc.enable()
    return command


class LazyGroup(click.Group):
    """The group of `COMMANDS`."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command:
        """Import a command, after starting PETSc if it needs that; raises `click.UsageError` if there is no such
        command, or it was given options for PETSc and does not use it."""
        if cmd_name not in COMMANDS:
            raise click.UsageError(f"no command '{cmd_name}'{nearest_name(cmd_name, COMMANDS)}", ctx)
        command = COMMANDS[cmd_name]
        session = ctx.find_object(Session)
        if ctx.resilient_parsing:
            return load(command)  # a shell asks for what may follow: nothing runs
        check_variables()
        if command.petsc is True and session is not None:
            session.start_petsc()
        elif session is not None and session.petsc_options:
            given = f"was given PETSc options after '--': {' '.join(session.petsc_options)}"
            raise click.UsageError(f"'{cmd_name}' does not use PETSc, but {given}", ctx)
        return load(command)

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        """Complete the names of commands without importing them, and the options of the group."""
        begun = {name: command.help for name, command in COMMANDS.items() if name.startswith(incomplete)}
        names = [CompletionItem(name, help=about) for name, about in begun.items()]
        return [*names, *click.Command.shell_complete(self, ctx, incomplete)]

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl([(name, command.help) for name, command in COMMANDS.items()])


INTERRUPTED = 130
# How long a rank that failed waits for the others to fail with it, before it ends them.
GRACE_SECONDS = 20.0

QUIET = {"--quiet", "--help", "--version"}  # of whose work nothing is to be said


@click.group(cls=LazyGroup, invoke_without_command=True, subcommand_metavar="COMMAND [ARGS]...")
@click.version_option(__version__, prog_name="pgmp")
@click.pass_context
def pgmp(context: click.Context) -> None:
    """Reduced models of flexible mechanisms with uncertain parameters.

    Every command runs serially or under mpirun. Options after a bare '--' are passed to PETSc.
    """
    if context.invoked_subcommand is None:
        click.echo(context.get_help())


def main(argv: list[str] | None = None) -> NoReturn:
    """Run ``pgmp`` with the given arguments (default: the process's) and exit. Collective on COMM_WORLD."""
    began = time.monotonic()
    own, petsc_options = split_arguments(sys.argv[1:] if argv is None else argv)
    # the validation of scenes has no plug-ins; all installed packages would be looked through for some
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    gc.disable()  # until the command is loaded: what modules make stays, and would be looked through again and again
    try:
        comm = start_mpi()
    except InputError as error:
        if str(error):
            complain(f"pgmp: error: {error}", sys.stderr)
        sys.exit(error.exit_status)
    # A communicator of its own: what a failed rank sends must not meet collectives that others still run.
    closing = comm.Dup()
    session = Session(comm, petsc_options, began=began)
    with ending_on_signals(comm.rank):
        status, message = _run(own, session)
    gc.enable()
    status = _close(closing, status, message)
    closing.Free()
    _warn(session, status)
    release_petsc(comm)
    gc.freeze()  # what is still alive goes with the process; Python would look through it twice more
    sys.exit(status)


def split_arguments(arguments: list[str]) -> tuple[list[str], list[str]]:
    """Return the arguments before and after the first bare ``--``."""
    if "--" not in arguments:
        return list(arguments), []
    place = arguments.index("--")
    return list(arguments[:place]), list(arguments[place + 1 :])


def _run(arguments: list[str], session: Session) -> tuple[int, str | None]:
    """Run the command on this rank; return its exit status and the message of its failure.

    An unexpected exception ends all ranks at once: the others may be waiting in a collective operation.
    """
    comm = session.comm
    try:
        with beating(comm, not arguments or not QUIET.isdisjoint(arguments)), _standard_output(comm) as output:
            status = pgmp.main(args=arguments, prog_name="pgmp", standalone_mode=False, obj=session)
        # a reader of the output that has gone (`pgmp ... | head`) wants no more of it; the files are written
        if output is not None and output.failure is not None and not isinstance(output.failure, BrokenPipeError):
            done = "what was printed is incomplete, files that were written are complete"
            return 1, f"standard output: {output.failure.strerror}; {done}"
        return status if isinstance(status, int) else 0, None
    except PgmpError as error:
        return error.exit_status, str(error)
    except click.ClickException as error:
        return InputError.exit_status, _usage_message(error)
    except SystemExit as error:
        # Click ends the process itself when its reader has gone (`pgmp info F | head`).
        return error.code if isinstance(error.code, int) else 1, None
    except (KeyboardInterrupt, click.Abort):
        status, message = INTERRUPTED, "pgmp: interrupted"
        if comm.rank == 0:
            message = f"{message}: {what_is_kept()}"
    except BaseException as error:
        refusal = missing_extra(error) if isinstance(error, ModuleNotFoundError) else None
        if refusal is not None:
            return refusal.exit_status, str(refusal)
        plain = plain_reason(error)
        status, message = 1, traceback.format_exc() if plain is None else f"pgmp: error: {plain}"
    where = f"pgmp: rank {comm.rank}:\n" if comm.size > 1 else ""
    print(f"{where}{visible(message.rstrip())}", file=sys.stderr, flush=True)
    if comm.size > 1:
        comm.Abort(status)
    return status, None


@contextmanager
def _standard_output(comm: Comm) -> Iterator[LastingOutput | None]:
    """Let rank 0 alone print in the block; yield what outlives its output, None where that is no file."""
    descriptor = descriptor_of(sys.stdout)
    if comm.rank > 0:
        with open(os.devnull, "w") as silent, redirect_stdout(silent):
            yield None
    elif descriptor is None:
        yield None
    else:
        sys.stdout.flush()
        output = LastingOutput(descriptor, painter(at_terminal()))
        with output.text(sys.stdout.encoding) as stream, redirect_stdout(stream):
            yield output


def _warn(session: Session, status: int) -> None:
    """Name options that nothing used, and what is wrong with the cache of compiled code. Collective.

    Where bad input ended the run early, an option may not have had its turn.
    """
    if session.petsc_started and status != InputError.exit_status:
        names = unused_options(session.petsc_options, session.comm)
        if names and session.comm.rank == 0:
            given, known = " ".join(f"-{name}" for name in names), f"{', '.join(PREFIXES)} (docs/petsc_options.md)"
            remark = visible(f"PETSc options that nothing used: {given}; prefixes here: {known}")
            complain(f"pgmp: warning: {remark}", sys.stderr)
    # a command that computes nothing never loaded numba
    compiled = sys.modules.get("pgmp_petsc.lanes.compiled")
    problem = None if compiled is None else compiled.cache_problem()
    if problem is not None and session.comm.rank == 0:
        complain(f"pgmp: warning: {problem}", sys.stderr)


def _usage_message(error: click.ClickException) -> str:
    """Return one message for an error of the command line, with the nearest name and where to look."""
    context = getattr(error, "ctx", None)
    message = error.format_message()
    if isinstance(error, click.NoSuchOption) and context is not None:
        names = (name for option in context.command.get_params(context) for name in option.opts)
        known = [name for name in names if name.startswith("-")]
        message = f"no option '{error.option_name}'{nearest_name(error.option_name, known)}"
        if isinstance(context.command, click.Group):
            message += "; options of a command go behind its name"
    help_command = f" (see '{context.command_path} --help')" if context is not None else ""
    return visible(f"{message.rstrip('.')}{help_command}")


def _close(closing: Comm, status: int, message: str | None) -> int:
    """Agree on the exit status and let one rank print the message. Collective on ``closing``.

    Failures are meant to be agreed on within a command (:mod:`pgmp_petsc.ranks.agreement`), so every rank
    comes here at the same time. Where one does not, because a failure was not agreed on, the rank that failed
    does not wait for ever: it says so and ends the others.
    """
    if closing.size == 1:
        if message is not None:
            complain(f"pgmp: error: {message}", sys.stderr)
        return status
    import numpy as np
    from mpi4py import MPI

    mine = np.array([status, -closing.rank if message is not None else -closing.size])
    highest = np.empty_like(mine)
    request = closing.Iallreduce(mine, highest, op=MPI.MAX)
    if status == 0:
        request.Wait()
    else:
        deadline = time.monotonic() + GRACE_SECONDS
        while not request.Test():
            if time.monotonic() > deadline:
                print(f"pgmp: error: rank {closing.rank} failed alone: {message}", file=sys.stderr, flush=True)
                closing.Abort(status)
            time.sleep(0.001)
    if message is not None and closing.rank == -highest[1]:
        complain(f"pgmp: error: {message}", sys.stderr)
    return int(highest[0])


if __name__ == "__main__":
    main()
