"""Run the code blocks of README and docs, page by page, each in a folder of its own: what `scripts/check_docs` does.

Folders have links to scenes, meshes, benchmarks, tests and scripts of the repository, and `pgmp` and `python` are those
of this checkout. See `handbook_blocks` for the comments that say what is not run.
"""

import argparse
import os
import shlex
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import tomli_w

sys.path.insert(0, str(Path(__file__).resolve().parent))

from conftest import ROOT
from handbook_blocks import Block, blocks_of, merged, pages, shell_of

LINKED = ("scenes", "meshes", "benchmarks", "tests", "scripts", "docs", "pgmp_petsc", ".venv")
LINES = 12  # of what a failing block printed


@dataclass
class Page:
    """A page and the folder that its blocks run in."""

    path: Path
    folder: Path
    environment: dict[str, str]

    def shell(self, text: str) -> subprocess.CompletedProcess[str]:
        """Run a shell text; it ends with the first command that fails."""
        return subprocess.run(
            ["bash", "-eo", "pipefail", "-c", text],
            cwd=self.folder, env=self.environment, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT, text=True, errors="replace", check=False,
        )  # fmt: skip

    def run(self, block: Block, before: Sequence[str]) -> str:
        """Run a block, of Python after the others of its page; return what went wrong, or nothing."""
        for command in block.marks.get("given", ()):
            done = self.shell(command)
            if done.returncode:
                return f"given {command}: {_end_of(done)}"
        if block.kind == "toml":
            return self._toml(block)
        if "file" in block.marks:
            (self.folder / block.name).write_text(block.text, encoding="utf-8")
            return ""
        if block.kind == "python":
            (self.folder / "blocks.py").write_text("\n".join([*before, block.text]), encoding="utf-8")
            done = self.shell("python blocks.py")
        else:
            done = self.shell(shell_of(block))
        wanted = int(block.marks.get("ends with", ["0"])[0])
        return _end_of(done) if done.returncode != wanted else ""

    def _toml(self, block: Block) -> str:
        """Keep a scene, or put a part of one into it."""
        if "file" in block.marks:
            (self.folder / block.name).write_text(block.text, encoding="utf-8")
        elif "into" in block.marks:
            path = self.folder / block.name
            path.write_text(tomli_w.dumps(merged(path.read_text(encoding="utf-8"), block.text)), encoding="utf-8")
        return ""


def _end_of(done: subprocess.CompletedProcess[str]) -> str:
    return "\n".join([f"status {done.returncode}", *done.stdout.splitlines()[-LINES:]])


def environment_of(folder: Path) -> dict[str, str]:
    """Return the environment in which `pgmp` and `python` are those of this checkout; makes what starts them."""
    tools = folder / ".tools"
    tools.mkdir()
    python = f"exec {shlex.quote(sys.executable)}"
    for name, command in (("pgmp", f"{python} -m pgmp_petsc.cli.main"), ("python", python)):
        (tools / name).write_text(f'#!/bin/sh\n{command} "$@"\n')
        (tools / name).chmod(0o755)
    paths = f"{tools}{os.pathsep}{os.environ.get('PATH', '')}"
    return {**os.environ, "PATH": paths, "PYTHONPATH": str(ROOT), "MPLBACKEND": "agg"}


def check(path: Path, dear: bool) -> int:
    """Run the blocks of a page, say what came of each, and return how many failed."""
    failed, program = 0, []
    with tempfile.TemporaryDirectory(prefix="pgmp_docs_") as name:
        folder = Path(name)
        for one in LINKED:
            (folder / one).symlink_to(ROOT / one)
        page = Page(path, folder, environment_of(folder))
        for block in blocks_of(path):
            why = _left_out(block, dear)
            if why:
                print(f"  {block}: {why}", flush=True)
                continue
            start = time.monotonic()
            problem = page.run(block, program)
            if block.kind == "python" and "file" not in block.marks:
                program.append(block.text)
            took = f"{time.monotonic() - start:.1f} s"
            print(f"  {block}: {'FAILED, ' if problem else ''}{took}" + (f"\n{problem}" if problem else ""), flush=True)
            failed += bool(problem)
    return failed


def _left_out(block: Block, dear: bool) -> str:
    if block.kind in ("text", "output"):
        return f"{'an equation' if block.kind == 'text' else 'what is printed'}, not run"
    if "not run" in block.marks:
        return f"not run: {block.marks['not run'][0]}"
    if "dear" in block.marks and not dear:
        return f"not run without --dear: {block.marks['dear'][0]}"
    return ""


def main() -> int:
    """Run the blocks of the pages that are named, or of all."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("names", nargs="*", metavar="PAGE", help="such as docs/tutorial.md; all if none is given")
    parser.add_argument("--dear", action="store_true", help="run also what takes long")
    given = parser.parse_args()
    chosen = [Path(name).resolve() for name in given.names] or pages()
    unknown = [str(path) for path in chosen if not path.is_file()]
    if unknown:
        parser.error(f"there is no page {', '.join(unknown)}")
    failed = 0
    for path in chosen:
        print(path.relative_to(ROOT), flush=True)
        failed += check(path, given.dear)
    print(f"{failed} blocks failed" if failed else "every block that can be run here does what it should")
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
