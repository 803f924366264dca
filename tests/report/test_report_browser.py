"""The page of results in a browser: nothing beyond the edge at three widths, no error, films that move and turn.

Needs Chromium, which `scripts/setup --tests` installs from Debian's packages; without any these tests are skipped.
"""

import json
import os
import re
import shutil
import subprocess
from dataclasses import replace
from html import unescape
from pathlib import Path

import matplotlib
import numpy as np
import pytest
import synthetic
from conftest import TIMEOUT_SECONDS
from fielded import block_run, flat_run

from pgmp_petsc.base.errors import warning
from pgmp_petsc.report.page import write_report

NAMES = ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome")
BROWSER = next(filter(None, map(shutil.which, NAMES)), None)
pytestmark = pytest.mark.skipif(BROWSER is None, reason=f"no browser here: none of {', '.join(NAMES)}")
WIDTHS = {"phone": 390, "tablet": 820, "desk": 1280}
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
const slider = film.querySelector("input"), choice = film.querySelector("select.factor");
const shape = () => [...film.querySelectorAll(".body path")].map((path) => path.getAttribute("d")).join();
const marks = () => [...film.closest("section.scene").querySelectorAll("line.instant")].map(
  (line) => Number(line.getAttribute("x1")));
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
const solid = document.querySelectorAll(".film")[1];
const frames = solid.querySelector("input"), large = solid.querySelector("select.factor");
const seen = () => {
  const canvas = solid.querySelector("canvas"), { width, height } = canvas;
  const pixels = canvas.getContext("2d").getImageData(0, 0, width, height).data;
  let left = width, right = 0, top = height, bottom = 0;
  for (let k = 0; k < width * height; k++) if (pixels[4 * k + 3]) {
    left = Math.min(left, k % width); right = Math.max(right, k % width);
    top = Math.min(top, Math.floor(k / width)); bottom = Math.max(bottom, Math.floor(k / width));
  }
  const row = Math.round((top + bottom) / 2) - 3;
  const colours = [0.05, 0.5, 0.93].map((share) => {
    const at = 4 * (row * width + left + Math.round(share * (right - left)));
    return [...pixels.slice(at, at + 3)];
  });
  return { left: left / width, right: right / width, tall: (bottom - top) / width, colours };
};
found.started = Number(frames.value);
found.seen = seen();
found.still = getComputedStyle(solid.querySelector("img")).display;
frames.value = 0; frames.dispatchEvent(new Event("input"));
found.first = seen();
found.largest = solid.querySelector(".legend output").textContent;
dispatchEvent(new Event("beforeprint"));
found.printed = [...solid.querySelectorAll(".instant span")].map((item) => item.textContent);
dispatchEvent(new Event("afterprint"));
found.restored = frames.value;
large.value = large.options[large.options.length - 1].value; large.dispatchEvent(new Event("change"));
frames.value = 3; frames.dispatchEvent(new Event("input"));
found.factor = Number(large.value);
found.bent = seen();
large.value = "1"; large.dispatchEvent(new Event("change"));
const zoom = solid.querySelector("select.zoom"), bar = () => solid.querySelector(".scale text").textContent;
found.bars = [bar()];
zoom.value = "2"; zoom.dispatchEvent(new Event("change"));
found.bars.push(bar());
found.closer = seen();
found.box = solid.querySelector(".mechanism").getAttribute("viewBox").split(" ").map(Number);
dispatchEvent(new Event("beforeprint"));
found.whole = seen();
dispatchEvent(new Event("afterprint"));
zoom.value = "1"; zoom.dispatchEvent(new Event("change"));
const stage = solid.querySelector(".stage"), place = stage.getBoundingClientRect();
stage.dispatchEvent(new MouseEvent("click", {
  clientX: place.left + found.seen.left * place.width, clientY: place.top + 0.5 * place.height,
}));
found.clicked = [zoom.value, seen()];
const table = [...document.querySelectorAll("table")].find((one) => one.querySelector("tbody tr:nth-child(4) td data"));
const head = table.querySelectorAll("thead th")[1];
const means = () => [...table.tBodies[0].rows].map((row) => Number(row.cells[1].querySelector("data")?.value));
found.sorted = [1, 2].map(() => {
  head.querySelector("button").click();
  return [head.getAttribute("aria-sort"), means()];
});
const block = document.querySelectorAll(".film")[2], place3 = block.querySelector(".stage"), pixels = () => {
  const canvas = block.querySelector("canvas");
  return canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data.join();
};
const press = (key) => place3.dispatchEvent(new KeyboardEvent("keydown", { key, bubbles: true }));
const whole = pixels();
press("ArrowLeft"); press("ArrowUp");
found.turned = pixels() !== whole;
press("Home");
found.back = pixels() === whole;
found.flatTurns = solid.querySelector(".stage").classList.contains("turns");
const paint = (name) => getComputedStyle(document.querySelector(name)).backgroundColor;
found.dark = matchMedia("(prefers-color-scheme: dark)").matches;
found.paints = [paint("body"), getComputedStyle(document.querySelector(".verdict p")).color];
const note = document.createElement("pre");
note.id = "found"; note.textContent = JSON.stringify(found);
document.body.append(note);
</script>
"""


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the page of a run, its full-order twin, an ensemble, a study, and a run of a solid.

    It measures itself when it is opened."""
    folder = tmp_path_factory.mktemp("browser")
    run = synthetic.trajectory("reduced", n_frames=61)
    long = warning("a warning of one very_long_word_" + "x" * 120)
    replace(run, record=replace(run.record, remarks=(long,))).write(folder / "run.h5")
    synthetic.trajectory("full").write(folder / "full.h5")
    synthetic.described().write(folder / "many.h5")
    synthetic.tradeoff().write(folder / "study.h5")
    target = folder / "report.html"
    for name, run in {"solid": flat_run(1e-3), "block": block_run()}.items():
        scene = synthetic.SCENE.replace("slider_crank", name)
        replace(run, record=replace(run.record, scene_toml=scene)).write(folder / f"{name}.h5")
    write_report([folder / f"{name}.h5" for name in ("run", "full", "many", "study", "solid", "block")], target)
    text = target.read_text(encoding="utf-8").replace("<title>", f"{FIRST}<title>", 1)
    target.write_text(text.replace("</body>", f"{LAST}</body>"), encoding="utf-8")
    return target


@pytest.fixture(scope="module", params=WIDTHS.values(), ids=WIDTHS.keys())
def opened(request: pytest.FixtureRequest, page: Path) -> tuple[dict, str]:
    """Return what the page measured at a width, and what the browser wrote about it."""
    return opened_at(page, request.param)


def opened_at(page: Path, width: int, *more: str) -> tuple[dict, str]:
    command = [
        BROWSER, "--headless", "--disable-gpu", *(["--no-sandbox"] if os.geteuid() == 0 else []),
        f"--user-data-dir={page.parent / 'profile'}", f"--window-size={width},900", "--enable-logging=stderr", *more,
        "--virtual-time-budget=2000", "--dump-dom", page.as_uri(),
    ]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT_SECONDS)
    found = re.search(r'<pre id="found">(.*?)</pre>', done.stdout, re.DOTALL)
    assert found is not None, done.stderr
    return json.loads(unescape(found[1])), done.stderr


def test_it_can_be_read_and_nothing_reaches_beyond_the_edge(opened: tuple[dict, str]) -> None:
    found, _ = opened
    assert found["width"] in WIDTHS.values()
    assert found["wide"] == [] and found["scroll"] <= 0 and found["overlapping"] == 0 and found["outside"] == []
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
    shown = [text.split() for text in found["values"] if text][: len(half)]
    # in the charts' units, of which these have prefixes
    prefixes = {"mm": 1e-3, "µm": 1e-6}
    numbers = [float(text[0]) * prefixes.get(text[1], 1.0) for text in shown]
    assert numbers == pytest.approx(list(half.values()), rel=1e-3)
    # charts are drawn over the same second: the mark stands in the middle of their axes
    assert all(after > before for before, after in zip(found["before"], found["after"])) and len(found["after"]) >= 3


def test_a_solid_is_where_it_is_in_its_colours(opened: tuple[dict, str]) -> None:
    """A bar of a length of 1 and a height of 0.2 moves to the right by its length; its stress grows along it."""
    found, _ = opened
    first, last = found["first"], found["seen"]
    assert found["started"] == 3 and found["still"] == "none"
    # pixels, of which there are at least two for one of the page
    pixels = 3.0 / 390.0
    length = last["right"] - last["left"]
    assert (first["left"], 1.0 - last["right"]) == pytest.approx(2 * (0.05 / 1.1,), abs=0.02)
    assert last["left"] - first["left"] == pytest.approx(length, abs=pixels)
    assert last["tall"] == pytest.approx(0.2 * length, abs=2 * pixels)
    colours = 255.0 * matplotlib.colormaps["viridis"](np.array([0.05, 0.5, 0.93]))[:, :3]
    np.testing.assert_allclose(last["colours"], colours, atol=10)
    least = 255.0 * np.array(matplotlib.colormaps["viridis"](0.0)[:3])
    np.testing.assert_allclose(first["colours"], [least, least, least], atol=3)
    assert found["largest"] == "0 MPa"
    # enlarged by 1e-3 of the length for every unit of the factor, less what it is bent by already
    assert found["bent"]["tall"] - last["tall"] == pytest.approx((found["factor"] - 1) * 1e-3 * length, rel=0.1)


def test_one_can_look_closer(opened: tuple[dict, str]) -> None:
    """A closer look goes along with the node of the largest stress, the right end, or with what one points at."""
    found, _ = opened
    pixels = 3.0 / 390.0
    assert found["bars"] == ["0.2 m", "0.1 m"]
    assert found["box"][2] == 5000.0 and found["closer"]["right"] == pytest.approx(0.5, abs=pixels)
    factor, at_left_end = found["clicked"]
    assert factor == "5" and at_left_end["left"] == pytest.approx(0.5, abs=pixels) and at_left_end["right"] > 0.99
    # paper has all of it, at the instant of the largest stress
    assert found["printed"] == ["1.00 s", "1"] and found["restored"] == "0"
    assert found["whole"]["right"] == found["seen"]["right"] and found["whole"]["left"] == found["seen"]["left"]


def test_tables_sort_and_films_in_space_turn(opened: tuple[dict, str]) -> None:
    found, _ = opened
    (first, up), (second, down) = found["sorted"]
    numbers = [value for value in up if value is not None]
    assert (first, second) == ("ascending", "descending") and len(numbers) > 2
    assert numbers == sorted(numbers) and down[: len(numbers)] == numbers[::-1]  # unknown ones stay behind
    assert found["turned"] and found["back"] and not found["flatTurns"]


@pytest.mark.parametrize("dark", [False, True])
def test_it_is_dark_where_the_screen_is(page: Path, dark: bool) -> None:
    """What is written stands out from its ground by 7 to 1, as WCAG's AAA has it, with both."""
    found, _ = opened_at(page, 820, f"--blink-settings=preferredColorScheme={0 if dark else 1}")
    ground, ink = (np.array(re.findall(r"\d+", text), float)[:3] / 255 for text in found["paints"])
    light, deep = sorted((luminance(ground), luminance(ink)), reverse=True)
    assert found["dark"] is dark and (luminance(ground) < 0.1) is dark and (light + 0.05) / (deep + 0.05) > 7.0


def luminance(colour: np.ndarray) -> float:
    linear = np.where(colour <= 0.04045, colour / 12.92, ((colour + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722])
