"""The page: one HTML file that needs no network, with a section a scene.

Figures from a file are ``<data>`` elements with the file's own number, its name and its dataset. Styles,
script, pictures and data are within the page, and its content policy lets it load nothing else.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from importlib import resources
from pathlib import Path

import numpy as np

from pgmp_petsc import __version__
from pgmp_petsc.report.section import section_of
from pgmp_petsc.report.sources import compact_json, read_sources, sentence_case
from pgmp_petsc.results import Ensemble, Trajectory
from pgmp_petsc.results.numbers import one_unit_each
from pgmp_petsc.runtime.claims import check_output
from pgmp_petsc.runtime.errors import InputError, counted
from pgmp_petsc.runtime.files import replacing


def write_report(files: Sequence[Path], output: Path) -> list[str]:
    """Write the page of result files, and return lines on what it is and on files given twice; by one process only.

    Files of different scenes get sections of their own, with the scenes' names.

    Raises
    ------
    InputError
        If a file is damaged or none that a page shows, if nothing but reduced models is given, or if the output cannot
        be written, is one of the files, or is another file than a page of this program.
    RunError
        If the system fails to write.
    """
    check_output(output, "report", files)
    scenes, lines = read_sources(files)
    bare = [sources[0] for sources in scenes if all(hasattr(source.result, "selection") for source in sources)]
    if bare:
        raise InputError(
            f"file '{bare[0].path}' holds a reduced model, and no results of its scene are here: add a trajectory or "
            "an ensemble of it"
        )
    text = page_of(scenes, lines)
    with replacing(output, "report") as partial:
        partial.write_text(text, encoding="utf-8", errors="replace")
    size = len(text.encode("utf-8", "replace")) / 1e6
    n_files = sum(map(len, scenes))
    about = counted(n_files, "file")
    if len(scenes) > 1:
        about += f" of {len(scenes)} scenes, each in a section of its own"
    return [f"{output}: {about}, {size:.2g} MB", *lines]


def _largest_of_units(results: Sequence[object]) -> dict[str, float]:
    """Return the largest size that outputs of each unit have on a page."""
    largest: dict[str, float] = {}
    for result in results:
        if not isinstance(result, (Trajectory, Ensemble)):
            continue
        known = {name: s.quantiles for name, s in result.statistics.items()} if isinstance(result, Ensemble) else {}
        for name, values in (known or result.outputs).items():
            size = float(np.max(np.abs(values[np.isfinite(values)]), initial=0.0))
            unit = result.units.get(name, "1")
            largest[unit] = max(size, largest.get(unit, 0.0))
    return largest


def page_of(scenes: Sequence[Sequence], lines: Sequence[str]) -> str:
    """Return the page's text."""
    from jinja2 import (  # only this command needs it
        Environment,
        PackageLoader,
        StrictUndefined,
    )

    environment = Environment(
        loader=PackageLoader("pgmp_petsc.report", "page"), autoescape=True, undefined=StrictUndefined, trim_blocks=True,
        lstrip_blocks=True,
    )  # fmt: skip
    environment.filters |= {"compact": compact_json, "sentence_case": sentence_case}
    with one_unit_each(_largest_of_units([source.result for sources in scenes for source in sources])):
        sections = [section_of(sources) for sources in scenes]
    title = sections[0].name if len(sections) == 1 else ", ".join(section.name for section in sections)
    folder = resources.files("pgmp_petsc.report") / "page"
    css, *scripts = ((folder / name).read_text(encoding="utf-8") for name in ("page.css", "surfaces.js", "page.js"))
    text = environment.get_template("page.html").render(
        title=title, sections=sections, lines=lines, version=__version__, css=css, script="".join(scripts)
    )
    return re.sub(r"\n{2,}", "\n", text).lstrip()
