"""The page of results in a browser: nothing beyond the edge at two widths, no error, and a film that moves the charts.

Needs Chromium (Debian: chromium-headless-shell); without any these tests are skipped.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
from dataclasses import replace
from html import unescape
from pathlib import Path

import numpy as np
import pytest
import synthetic
from conftest import TIMEOUT_SECONDS

from pgmp_petsc.report.page import write_report
from pgmp_petsc.runtime.remarks import warning

NAMES = ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome")
BROWSER = next(filter(None, map(shutil.which, NAMES)), None)
pytestmark = pytest.mark.skipif(BROWSER is None, reason=f"no browser here: none of {', '.join(NAMES)}")
WIDTHS = {"phone": 390, "desk": 1280}
SMALLEST = 8.5  # px: what can be read in a chart on a phone

FIRST = "<script>window.failures = []; addEventListener('error', (e) => failures.push(e.message));</script>"
LAST = """
<script>
const wide = (item) => item.getBoundingClientRect().right > innerWidth + 1 || item.getBoundingClientRect().left < -1;
const items = [...document.querySelectorAll("body *")].filter(
  (item) => !item.closest(".scroll, pre, svg, script") && item.getClientRects().length);
const sections = [...document.querySelectorAll("section.scene > section")].map((item) => item.getBoundingClientRect());
const charts = [...document.querySelectorAll("svg.chart")];
const sizes = charts.flatMap((svg) => {
  const scale = svg.getBoundingClientRect().width / svg.viewBox.baseVal.width;
  return [...svg.querySelectorAll("text")].map((text) => parseFloat(getComputedStyle(text).fontSize) * scale);
});
const outside = charts.flatMap((svg) => {
  const box = svg.getBoundingClientRect();
  return [...svg.querySelectorAll("text")].filter((text) => {
    const own = text.getBoundingClientRect();
    return own.right > box.right + 3 || own.left < box.left - 3;
  }).map((text) => text.textContent);
});
const film = document.querySelector(".film");
const slider = film.querySelector("input"), choice = film.querySelector("select");
const shape = () => [...film.querySelectorAll(".body path")].map((path) => path.getAttribute("d")).join();
const marks = () => [...document.querySelectorAll("line.instant")].map((line) => Number(line.getAttribute("x1")));
const still = shape(), before = marks();
slider.value = 30; slider.dispatchEvent(new Event("input"));
const moved = shape(), after = marks();
choice.value = "10"; choice.dispatchEvent(new Event("change"));
const found = {
  failures, moved: still !== moved, enlarged: moved !== shape(), before, after, sizes, outside,
  clock: film.querySelector(".controls output").textContent,
  values: [...document.querySelectorAll("figcaption output")].map((item) => item.textContent),
  wide: items.filter(wide).map((item) => item.tagName + "." + item.getAttribute("class")),
  overlapping: sections.filter((box, k) => k > 0 && box.top < sections[k - 1].bottom - 1).length,
  scroll: document.documentElement.scrollWidth - innerWidth, width: innerWidth,
  loaded: performance.getEntriesByType("resource").map((item) => item.name).filter((name) => !name.startsWith("data:")),
  columns: getComputedStyle(document.querySelector(".charts")).gridTemplateColumns.split(" ").length,
};
const note = document.createElement("pre");
note.id = "found"; note.textContent = JSON.stringify(found);
document.body.append(note);
</script>
"""


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the page of a run, its full-order twin, an ensemble and a study; it measures itself when it is opened."""
    folder = tmp_path_factory.mktemp("browser")
    run = synthetic.trajectory("reduced", n_frames=61)
    long = warning("a warning of one very_long_word_" + "x" * 120)
    replace(run, record=replace(run.record, remarks=(long,))).write(folder / "run.h5")
    synthetic.trajectory("full").write(folder / "full.h5")
    synthetic.described().write(folder / "many.h5")
    synthetic.tradeoff().write(folder / "study.h5")
    target = folder / "report.html"
    write_report([folder / f"{name}.h5" for name in ("run", "full", "many", "study")], target)
    text = target.read_text(encoding="utf-8").replace("<title>", f"{FIRST}<title>", 1)
    target.write_text(text.replace("</body>", f"{LAST}</body>"), encoding="utf-8")
    return target


@pytest.fixture(scope="module", params=WIDTHS.values(), ids=WIDTHS.keys())
def opened(request: pytest.FixtureRequest, page: Path) -> tuple[dict, str]:
    """Return what the page measured at a width, and what the browser wrote about it."""
    command = [
        BROWSER, "--headless", "--disable-gpu", *(["--no-sandbox"] if os.geteuid() == 0 else []),
        f"--user-data-dir={page.parent / 'profile'}", f"--window-size={request.param},900", "--enable-logging=stderr",
        "--virtual-time-budget=2000", "--dump-dom", page.as_uri(),
    ]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT_SECONDS)
    found = re.search(r'<pre id="found">(.*?)</pre>', done.stdout, re.DOTALL)
    assert found is not None, done.stderr
    return json.loads(unescape(found[1])), done.stderr


def test_nothing_reaches_beyond_the_edge(opened: tuple[dict, str]) -> None:
    found, _ = opened
    assert found["width"] in WIDTHS.values()
    assert found["wide"] == [] and found["scroll"] <= 0 and found["overlapping"] == 0 and found["outside"] == []


def test_it_can_be_read(opened: tuple[dict, str]) -> None:
    found, _ = opened
    assert min(found["sizes"]) >= SMALLEST
    assert found["columns"] == (1 if found["width"] == WIDTHS["phone"] else 2) or found["width"] > 1000


def test_no_error_and_nothing_loaded(opened: tuple[dict, str]) -> None:
    found, log = opened
    assert found["failures"] == [] and found["loaded"] == []
    assert "CONSOLE" not in log, log


def test_the_film_moves_the_mechanism_and_the_charts(opened: tuple[dict, str]) -> None:
    found, _ = opened
    assert found["moved"] and found["enlarged"]
    assert found["clock"] == "0.500 s"
    run = synthetic.trajectory("reduced")
    half = {name: np.interp(0.5, run.time, values) for name, values in run.outputs.items()}
    assert [float(text.split()[0]) for text in found["values"] if text] == pytest.approx(list(half.values()), rel=1e-3)
    # charts are drawn over the same second: the mark stands in the middle of their axes
    assert all(after > before for before, after in zip(found["before"], found["after"])) and len(found["after"]) >= 3
