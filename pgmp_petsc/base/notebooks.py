"""Short HTML of what a notebook shows: a title, tables, remarks, and what is folded away."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from html import escape
from typing import NamedTuple

_CELL = "padding: 0 1em 0 0; text-align: left; vertical-align: top"


class Grid(NamedTuple):
    """A table with a first line; numbers have six digits."""

    head: Sequence[str]
    rows: Sequence[Sequence[object]]


def card(
    title: str,
    about: Mapping[str, object],
    grids: Iterable[Grid] = (),
    remarks: Iterable[object] = (),
    folded: Mapping[str, str] | None = None,
) -> str:
    """Return HTML of something: entries about it, a line each, and HTML folded under headings, which open it; tables
    without rows, and entries without a text, are left out."""
    lines = [(name.replace("_", " "), text) for name, text in about.items() if text not in ("", None)]
    parts = [f"<div><strong>{escape(title)}</strong></div>", _table((), lines)]
    parts += [_table(*grid) for grid in grids]
    parts += [f"<div>{escape(str(remark))}</div>" for remark in remarks]
    parts += [f"<details><summary>{escape(name)}</summary>{html}</details>" for name, html in (folded or {}).items()]
    return f'<div class="pgmp">{"".join(parts)}</div>'


def _table(head: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    if not rows:
        return ""
    heads = "".join(f'<th style="{_CELL}">{escape(one.replace("_", " "))}</th>' for one in head)
    cells = ("".join(f'<td style="{_CELL}">{escape(_text(value))}</td>' for value in row) for row in rows)
    body = "".join(f"<tr>{row}</tr>" for row in cells)
    return f"<table>{f'<tr>{heads}</tr>' if head else ''}{body}</table>"


def _text(value: object) -> str:
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(map(_text, value))}]"
    if value is None:
        return ""
    return f"{value:.6g}" if isinstance(value, float) else str(value)
