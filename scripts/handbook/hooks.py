"""What MkDocs is told besides its settings: pages from outside docs/, notebooks of pages, equations as MathML, a search
that works from files.

The files in docs/ are also read where the repository is, so their links lead to files of the repository. Here README.md
becomes the first page, and scenes that pages link to lie beside them.
"""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path

from latex2mathml.converter import convert
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
sys.path.insert(0, str(ROOT / "tests"))
from handbook_blocks import notebook_of  # noqa: E402 (beside the tests that run the pages)

#: Pages with code that is run, as notebooks, by their names.
NOTEBOOKS = {path.stem: notebook_of(path) for path in sorted((ROOT / "docs").glob("*.md"))}
NOTEBOOKS = {name: one for name, one in NOTEBOOKS.items() if any(cell["cell_type"] == "code" for cell in one["cells"])}
#: Pages made from files elsewhere.
OTHER_PAGES = {"index.md": "README.md", "changelog.md": "CHANGELOG.md"}
#: Files that pages link to, beside the pages.
BESIDE = ("scenes/*.toml", "LICENSE")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages and files from outside docs/."""
    for name, source in OTHER_PAGES.items():
        files.append(File.generated(config, name, content=_from_top((ROOT / source).read_text(encoding="utf-8"))))
    for path, notebook in NOTEBOOKS.items():
        files.append(File.generated(config, f"notebooks/{path}.ipynb", content=json.dumps(notebook, indent=1)))
    files.append(File.generated(config, "handbook.css", content=(HERE / "handbook.css").read_text(encoding="utf-8")))
    schema = (ROOT / "build" / "scene.schema.json").read_text(encoding="utf-8")  # which scripts/docs has written
    files.append(File.generated(config, "scene.schema.json", content=schema))
    for pattern in BESIDE:
        for path in sorted(ROOT.glob(pattern)):
            name = path.relative_to(ROOT).as_posix()
            files.append(File.generated(config, name, content=path.read_bytes()))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Let links to the repository's files lead to where they are in the handbook."""
    markdown = re.sub(r"\]\(\.\./README\.md", "](index.md", markdown)
    markdown = re.sub(r"\]\(\.\./(scenes/[^)]*|LICENSE)\)", r"](\1)", markdown)
    name = page.file.src_uri.removesuffix(".md")
    return f"{markdown}\n\n[This page as a notebook](notebooks/{name}.ipynb)\n" if name in NOTEBOOKS else markdown


def on_page_content(html: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Turn equations (arithmatex marks them) into MathML, which browsers draw by themselves."""
    html = re.sub(
        r'<div class="arithmatex">\\\[(.*?)\\\]</div>', lambda found: _mathml(found[1], "block"), html, flags=re.S
    )
    return re.sub(r'<span class="arithmatex">\\\((.*?)\\\)</span>', lambda found: _mathml(found[1], "inline"), html)


def on_post_build(config: MkDocsConfig) -> None:
    """Make the index a script, and the search one that loads it: pages that are files may neither fetch nor work."""
    folder = Path(config.site_dir) / "search"
    index = json.loads((folder / "search_index.json").read_text(encoding="utf-8"))
    (folder / "sections.js").write_text(f"var handbook = {json.dumps(index['docs'])};", encoding="utf-8")
    (folder / "main.js").write_text((HERE / "search.js").read_text(encoding="utf-8"), encoding="utf-8")
    for name in ("search_index.json", "worker.js"):
        (folder / name).unlink()


def _from_top(text: str) -> str:
    """Return a page of the top folder with links as from docs/."""
    return re.sub(r"\]\(docs/", "](", text).replace("](CHANGELOG.md)", "](changelog.md)")


def _mathml(latex: str, display: str) -> str:
    for mark, sign in (("&lt;", "<"), ("&gt;", ">"), ("&amp;", "&")):
        latex = latex.replace(mark, sign)
    return convert(latex, display=display)
