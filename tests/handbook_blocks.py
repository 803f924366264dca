"""The code blocks of README and docs: where they stand, what they are, what comments above say of running them; pages
as notebooks.

A comment above a block is not seen by readers:

``<!-- not run: REASON -->``     what it needs is not here (a cluster, another PETSc), or it only shows a form
``<!-- dear: TIME -->``          run by ``scripts/check_docs --dear`` alone
``<!-- given: COMMAND -->``      what has to be there already: run before it; repeatable
``<!-- ends with: STATUS -->``   the exit status of its last command, where that is not 0
``<!-- output -->``              what a program printed
``<!-- file: NAME -->``          the block is the content of a file
``<!-- into: NAME -->``          TOML: its tables take the place of those of the same names in a file
``<!-- shown in: NAME -->``      the same, tried and not kept
"""

import inspect
import re
import shlex
import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]

#: What is said of the blocks of README, which begin so: its source is shown on the first page of the repository.
OF_README = {
    "scripts/setup": {"not run": ["scripts/ten_minutes does it in a fresh clone"]},
    "scripts/demo": {"not run": ["installs, computes some minutes, tests for half an hour"]},
    ". scripts/mpi_env.sh": {"dear": ["1 min"]},
    "PGMP_PYTHON=": {"not run": ["needs another PETSc"]},
}
MARKS = ("not run", "dear", "given", "ends with", "output", "file", "into", "shown in")
_MARK = re.compile(r"<!-- (" + "|".join(MARKS) + r")(?:: (.*?))? -->")
#: Words that begin a line of a shell block.
_COMMANDS = re.compile(
    r"(\$ )?([A-Z_]+=\S+ )*(\.venv/bin/)?(pgmp|python3?|pytest|mpirun|scripts/\S+|\.|source|cd|for|export|eval|"
    r"apt-get|pip|git|cc|sbatch|qsub|build=\$\(.*|time|S=\S+)( |$)"
)
_SHELLS = ("sh", "bash", "shell", "console")
_END = re.compile(r"[;|&<>()]+$")


@dataclass(frozen=True)
class Block:
    """A block of code."""

    page: str  # path below the repository
    #: line, end: of its first line, that of a fence included, from 1; of its last one
    line: int
    end: int
    kind: str  # ``sh``, ``toml``, ``python``, ``output`` or ``text`` (an equation)
    text: str  # without fence and indent
    marks: dict[str, list[str]] = field(default_factory=dict)  # what the comments above it say, by their kind

    def __str__(self) -> str:
        return f"{self.page}:{self.line}"

    @property
    def name(self) -> str:
        """The file that it is, or is a part of."""
        return next((self.marks[key][0] for key in ("file", "into", "shown in") if key in self.marks), "")


def pages() -> list[Path]:
    """Return README and the pages of docs/."""
    return [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


def blocks_of(path: Path) -> list[Block]:
    lines = path.read_text(encoding="utf-8").splitlines()
    page, found, k = path.relative_to(ROOT).as_posix(), [], 0
    is_list = False
    while k < len(lines):
        line = lines[k]
        if fence := re.match(r"(`{3,})(\S*)", line):
            last = next(n for n in range(k + 1, len(lines)) if lines[n].startswith(fence[1]))
            found.append(_block(page, lines, k, last + 1, fence[2], lines[k + 1 : last]))
            k = last + 1
            continue
        if line.startswith("    ") and not is_list and (not lines[k - 1].strip() or lines[k - 1].startswith("#")):
            last = k
            while last < len(lines) and (lines[last].startswith("    ") or not lines[last].strip()):
                last += 1
            text = [one[4:] for one in lines[k:last]]
            while not text[-1]:
                text.pop()
            found.append(_block(page, lines, k, last, "", text))
            k = last
            continue
        if line.strip():
            is_list = bool(re.match(r"([-*] |\d+\. )", line)) or is_list and line.startswith(" ")
        k += 1
    return found


def _block(page: str, lines: list[str], first: int, end: int, language: str, text: list[str]) -> Block:
    marks: dict[str, list[str]] = {}
    k = first - 1
    while k >= 0 and (not lines[k].strip() or _MARK.fullmatch(lines[k].strip())):
        if mark := _MARK.fullmatch(lines[k].strip()):
            marks.setdefault(mark[1], []).insert(0, mark[2] or "")
        k -= 1
    if page == "README.md":
        marks |= next((said for start, said in OF_README.items() if text[0].startswith(start)), {})
    kind = "sh" if language in _SHELLS else language or _kind_of(text)
    return Block(page, first + 1, end, "output" if "output" in marks else kind, "\n".join(text) + "\n", marks)


def _kind_of(text: list[str]) -> str:
    """Return what an indented block is, by its lines."""
    if any(_COMMANDS.match(line) for line in text):
        return "sh"
    if re.match(r"\[[\w.]+\]$", text[0]):
        return "toml"
    return "python" if text[0].startswith("import ") else "text"


def shell_of(block: Block) -> str:
    """Return the commands of a shell block; of one that shows a dialogue what stands after its prompts."""
    lines = block.text.splitlines()
    if not any(line.startswith("$ ") for line in lines):
        return block.text
    kept, ending, goes_on = [], "", False
    for line in lines:
        if line.startswith("$ ") or goes_on or ending:
            command = line.removeprefix("$ ")
            kept.append(command)
            goes_on = command.endswith("\\")
            if ending and line == ending:
                ending = ""
            elif here := re.search(r"<<'?(\w+)'?$", command):
                ending = here[1]
    return "\n".join(kept) + "\n"


def commands_of(text: str) -> Iterator[list[str]]:
    """Yield the words of every simple command of a shell text, without redirections, here-documents and variables."""
    text = re.sub(r"<<'?(\w+)'?\n.*?\n\1\n", "\n", text, flags=re.DOTALL).replace("\\\n", " ")
    for line in text.splitlines():
        lexer = shlex.shlex(line, posix=True, punctuation_chars=";|&<>()")
        lexer.whitespace_split, lexer.commenters = True, "#"
        words: list[str] = []
        for word in [*lexer, ";"]:
            if not _END.match(word):
                words.append(word)
                continue
            while words and (re.match(r"\w+=", words[0]) or words[0] in ("do", "time", "env", "$", "for")):
                words.pop(0)
            if words:
                yield words
            words = []


def without_launcher(words: list[str]) -> list[str]:
    """Return a command without ``mpirun -n P``."""
    if words[0] in ("mpirun", "srun"):
        start = next(
            (k for k, word in enumerate(words) if k and word.endswith(("pgmp", "python")) or word == "-m"), None
        )
        return words[start:] if start else words
    return words


def merged(text: str, part: str) -> dict[str, Any]:
    """Return the tables of a scene with those of a part in place of its own of the same names."""
    tables = tomllib.loads(text)
    for name, entry in tomllib.loads(part).items():
        holds_tables = isinstance(entry, dict) and all(isinstance(one, dict) for one in entry.values())
        tables[name] = {**tables.get(name, {}), **entry} if holds_tables else entry
    return tables


#: The first cell of code of a notebook: commands are found, and run where their kernel does.
BEGIN = """# a copy of a page of the handbook; its folder is the repository's, its kernel .venv/bin/python
import os
import sys
from pathlib import Path

os.environ["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
"""


def notebook_of(path: Path) -> dict[str, Any]:
    """Return a page as a notebook (nbformat 4.5): blocks that are run here are cells of code, all else is text."""
    lines, cells, first = path.read_text(encoding="utf-8").splitlines(), [], 0
    for block in blocks_of(path):
        code = _code_of(block)
        if code:
            cells += [*_text_cell(lines[first : block.line - 1]), ("code", code)]
            first = block.end
    cells += _text_cell(lines[first:])
    if any(kind == "code" for kind, _ in cells):
        cells.insert(1, ("code", BEGIN))
    return {
        "cells": [_cell(kind, number, text) for number, (kind, text) in enumerate(cells)],
        "metadata": {"language_info": {"name": "python"}},
        "nbformat": 4,
        "nbformat_minor": 5,
    }


def _cell(kind: str, number: int, text: str) -> dict[str, Any]:
    own = {"execution_count": None, "outputs": []} if kind == "code" else {}
    source = text.rstrip("\n").splitlines(keepends=True)
    return {"cell_type": kind, "id": f"cell-{number}", "metadata": {}, "source": source, **own}


def _text_cell(lines: Sequence[str]) -> list[tuple[str, str]]:
    """Return a cell of text without what readers do not see, none where nothing is left."""
    text = "\n".join(line for line in lines if not _MARK.fullmatch(line.strip())).strip("\n")
    return [("markdown", text)] if text else []


def _code_of(block: Block) -> str:
    """Return what a cell of code has in place of a block, nothing where it is not run."""
    if "not run" in block.marks or block.kind in ("output", "text"):
        return ""
    if "file" in block.marks:
        return f"%%writefile {block.name}\n{block.text}"
    if "into" in block.marks:
        imports = "import tomllib\nfrom typing import Any\n\nimport tomli_w"
        write = f'scene.write_text(tomli_w.dumps(merged(scene.read_text(), """\n{block.text}""")))'
        return f"{imports}\n\n\n{inspect.getsource(merged)}\n\nscene = Path({block.name!r})\n{write}\n"
    if block.kind == "sh":
        may_fail = " --no-raise-error" if "ends with" in block.marks else ""
        return "\n".join([f"%%bash{may_fail}", *block.marks.get("given", ()), shell_of(block)])
    return block.text if block.kind == "python" else ""
