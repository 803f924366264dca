"""Tables of what is refused, a case a line: ``what is asked -> how the answer begins``.

An answer that begins with ``=`` or ``:`` speaks of the entry that is asked for; ``|`` in it stands for any words,
``||`` for the end of a line. ``&`` is between the parts of what is asked. A line goes on, indented, in the next.
"""

import re
import resource
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest

from pgmp_petsc.base.errors import InputError


def cases(text: str) -> list[tuple[str, str]]:
    """Return what is asked and what is said to it; empty lines and those that begin with # are for readers."""
    lines = (line for line in text.replace("\n    ", " ").splitlines() if line and not line.startswith("#"))
    return [tuple(" ".join(part.split()) for part in line.split(" -> ", 1)) for line in lines]


def check_said(message: str, said: str, asked: str) -> None:
    """Assert that a message has as many lines as are said, and that each begins so and goes on with these words."""
    if said.startswith(("=", ":")):
        said = asked.partition("=")[0] + (" " + said if said[0] == "=" else said)
    lines = said.split(" || ")
    assert message.count("\n") == len(lines) - 1, message
    for line, (start, *words) in zip(message.splitlines(), (one.split(" | ") for one in lines)):
        assert line.startswith(start) and all(word in line for word in words), f"{line!r} is not {said!r}"


@contextmanager
def full_disk(n_bytes: int) -> Iterator[None]:
    """Let no file grow beyond a size: to a process, that is a full disk."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (n_bytes, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)


def refusal(call: Callable, *arguments: object, error: type[Exception] = InputError, **options: object) -> str:
    """Return the message with which a call is refused."""
    with pytest.raises(error) as caught:
        call(*arguments, **options)
    assert error is not InputError or caught.value.exit_status == 2
    return str(caught.value)


def assert_refused(match: str, call: Callable, *arguments: object, **options: object) -> None:
    """Assert that a call is refused with a message in which an expression is found."""
    message = refusal(call, *arguments, **options)
    assert re.search(match, message), message
