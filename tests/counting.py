"""Counting of method calls."""

from collections import Counter
from collections.abc import Iterable

import pytest


def count_calls(monkeypatch: pytest.MonkeyPatch, watched: Iterable[tuple[type, str]]) -> Counter:
    """Return a counter of the calls of methods (class, name) from now on, by ``Class.name``."""
    counted: Counter = Counter()
    for owner, name in watched:
        original = getattr(owner, name)

        def count(
            self: object,
            *args: object,
            _original: object = original,
            _name: str = f"{owner.__name__}.{name}",
            **given: object,
        ) -> object:
            counted[_name] += 1
            return _original(self, *args, **given)

        monkeypatch.setattr(owner, name, count)
    return counted
