"""What MkDocs is told besides its settings: pages from outside docs/, the notebook as a page, equations as MathML.

The files in docs/ are also read where the repository is, so their links lead to files of the repository. Here README.md
becomes the first page, and scenes that pages link to lie beside them.
"""

from __future__ import annotations

import json
import re
from pathlib import Path

from latex2mathml.converter import convert
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
NOTEBOOK = "notebooks/demo.ipynb"
#: Pages made from files elsewhere.
OTHER_PAGES = {"index.md": "README.md", "changelog.md": "CHANGELOG.md"}
#: Files that pages link to, beside the pages.
BESIDE = ("scenes/*.toml", "LICENSE")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages and files from outside docs/."""
    for name, source in OTHER_PAGES.items():
        files.append(File.generated(config, name, content=_from_top((ROOT / source).read_text(encoding="utf-8"))))
    notebook = (ROOT / "docs" / NOTEBOOK).read_text(encoding="utf-8")
    files.append(File.generated(config, "notebook.md", content=notebook_page(notebook)))
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
    return re.sub(r"\]\(\.\./(scenes/[^)]*|LICENSE)\)", r"](\1)", markdown)


def on_page_content(html: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Turn equations (arithmatex marks them) into MathML, which browsers draw by themselves."""
    html = re.sub(
        r'<div class="arithmatex">\\\[(.*?)\\\]</div>', lambda found: _mathml(found[1], "block"), html, flags=re.S
    )
    return re.sub(r'<span class="arithmatex">\\\((.*?)\\\)</span>', lambda found: _mathml(found[1], "inline"), html)


def notebook_page(text: str) -> str:
    """Return a notebook as Markdown: its cells one after the other."""
    parts = []
    for cell in json.loads(text)["cells"]:
        source = "".join(cell["source"])
        parts.append(source if cell["cell_type"] == "markdown" else f"```python\n{source}\n```")
    return "\n\n".join(parts) + "\n"


def _from_top(text: str) -> str:
    """Return a page of the top folder with links as from docs/."""
    return re.sub(r"\]\(docs/", "](", text).replace("](CHANGELOG.md)", "](changelog.md)")


def _mathml(latex: str, display: str) -> str:
    for mark, sign in (("&lt;", "<"), ("&gt;", ">"), ("&amp;", "&")):
        latex = latex.replace(mark, sign)
    return convert(latex, display=display)
