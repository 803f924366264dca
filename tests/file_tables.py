"""What files have, as tables of docs/files.md, from the declarations of results.

.venv/bin/python tests/file_tables.py         writes them into the page
"""

from pathlib import Path

from pgmp_petsc.declare.records import Record
from pgmp_petsc.declare.views import Row, described
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
