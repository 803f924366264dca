"""What files have, as tables of docs/files.md, from the declarations of results.

.venv/bin/python tests/file_tables.py         writes them into the page
"""

import string
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from pgmp_petsc.declare.records import Record, joined, written
from pgmp_petsc.files.claims import KINDS
from pgmp_petsc.models.component_file import ComponentsFile
from pgmp_petsc.reduction.rom_file import RomFile
from pgmp_petsc.results import READERS, EffectSizes, Selection
from pgmp_petsc.results.ensemble import ShardSamples

PAGE = Path(__file__).resolve().parents[1] / "docs" / "files.md"
HEADING = "## What is in them\n"
OPENING = """
Made by `python tests/file_tables.py` from the declarations in `pgmp_petsc/results/`, `pgmp_petsc/reduction/rom_file.py`
and `pgmp_petsc/models/component_file.py`. Sizes have names; equal names in
a table are equal sizes, `?` is an axis that is not there where its size is 1, `...` is any shape. `<name>` is the name
of an output, a parameter, an effect, a body or an event, `<frame>` a number (`00000`), `<unit>` the unit of what is
named. `path@key` is an attribute. Numbers of a row with a `*` may be missing (NaN). Every dataset has attributes `unit`
and `description`; every file has the attributes of its origin and `/timings`.
"""
#: Parts of a reduced model's file.
PARTS = {"the part of a reduced model on its tolerances": Selection, "the part on effects": EffectSizes}


class _Placeholders(string.Formatter):
    """Texts with the names of what is filled in."""

    def get_field(self, field_name: str, args: Any, kwargs: Any) -> Any:
        """Return a word that is given, else the name of a field."""
        words = f"<{field_name.rpartition('.')[2]}>"
        return kwargs.get(field_name, words).replace("{name}", "<name>"), field_name

    def convert_field(self, value: Any, conversion: str | None) -> Any:
        """Leave the name."""
        return value


_PLACEHOLDERS = _Placeholders()


class Row(NamedTuple):
    """One place in files of a kind of record: sizes, unit and meaning of an array or attribute, whether
    numbers may be missing, and whether it follows from the others."""

    place: str
    sizes: tuple[str, ...]
    unit: str
    about: str
    gaps: bool
    is_derived: bool


def described(kind: type[Record], base: str = "") -> Iterator[Row]:
    """Yield a row for each array and attribute that files of a kind of record may have; ``<name>`` is in the place of
    names."""
    for one in written(kind.STORED or kind):
        entry, place, sizes = one.entry, one.place, tuple(str(size) for size in one.entry.sizes)
        for level in range(one.depth):
            place = one.place_of(place, "<outer>" if level < one.depth - 1 else "{name}")
        place = joined(base, place if entry.keys else _PLACEHOLDERS.format(place))
        if one.is_record and not entry.about:
            for row in described(one.value, place):
                yield row._replace(sizes=(*sizes, *row.sizes)) if one.is_rows else row
        elif entry.about and (place or one.depth):
            if entry.each is not None:
                place, sizes = f"{place}/<{entry.each}>", sizes[1:]
            if isinstance(entry.part, int):
                sizes = (*sizes, "2")
            if entry.padded is not None:
                sizes = (*sizes[:-1], str(entry.padded))
            unit = entry.unit if entry.columns is None else "of each column"
            for key, words in entry.keys.items() if entry.keys else [("{name}", {})]:
                texts = [_PLACEHOLDERS.format(text, name=key, **words) for text in (place, unit, entry.about)]
                texts[1] = "" if one.is_attribute and unit == "1" else texts[1]
                for at in (texts[0], *(joined(base, other) for other in entry.also)):
                    yield Row(at, sizes, *texts[1:], bool(entry.gaps), entry.of is not None)


def tables() -> str:
    """Return the section of the page."""
    readers = {RomFile.kind: RomFile, ComponentsFile.kind: ComponentsFile, **READERS}
    kinds: dict[str, type[Record]] = {KINDS[kind].capitalize(): reader for kind, reader in readers.items()}
    kinds |= {KINDS["shard"].capitalize(): ShardSamples, **{name.capitalize(): kind for name, kind in PARTS.items()}}
    return "\n".join([HEADING + OPENING, *(_table(name, kind) for name, kind in kinds.items())])


def _table(name: str, kind: type[Record]) -> str:
    lines = [f"### {name}", "| place | sizes | unit | meaning |", "|---|---|---|---|"]
    return "\n".join([*lines, *(_line(row) for row in described(kind))]) + "\n"


def _line(row: Row) -> str:
    sizes = "" if ("@" in row.place or not row.unit) and not row.sizes else f"({', '.join(row.sizes)})"
    place = row.place if row.place.startswith("@") else f"/{row.place}"
    cells = (f"`{place}`{' *' if row.gaps else ''}", sizes, row.unit, row.about)
    return "| " + " | ".join(cell.replace("<", "&lt;") if cell is not cells[0] else cell for cell in cells) + " |"


def page() -> str:
    """Return the whole page with the section of today."""
    before, _, rest = PAGE.read_text(encoding="utf-8").partition(HEADING)
    _, mark, after = rest.partition("\n## ")
    return before + tables() + (mark + after if mark else "")


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
