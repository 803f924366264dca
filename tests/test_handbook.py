"""README and docs: blocks of code are what they say, commands have the options that texts name, links lead somewhere.

The blocks are really run by `scripts/check_docs`; here it is what can be known of them without running.
"""

import importlib
import os
import re
import shutil
import subprocess
import tomllib
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import click
import fastjsonschema
import handbook_blocks
import handbook_run
import html5lib
import pytest
from conftest import ROOT, TIMEOUT_SECONDS
from handbook_blocks import Block, blocks_of, commands_of, merged, notebook_of, pages, shell_of, without_launcher

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.cli.main import COMMANDS, load
from pgmp_petsc.scene import load_scene, scene_from_tables
from pgmp_petsc.scene.loading import template_names
from pgmp_petsc.scene.reference_page import editor_schema, reference_page, unit_of

PAGES = pages()
BLOCKS = [block for path in PAGES for block in blocks_of(path)]
SHELL = [block for block in BLOCKS if block.kind == "sh"]
TOML = [block for block in BLOCKS if block.kind == "toml"]
SCENES = [*sorted((ROOT / "scenes").glob("*.toml")), *sorted((ROOT / "pgmp_petsc/scene/templates").glob("*.toml"))]
#: A scene that has what blocks of TOML refer to.
BASE = ROOT / "scenes" / "slider_crank.toml"


@cache
def command(name: str) -> click.Command:
    return load(COMMANDS[name])


def texts_of(path: Path) -> str:
    """Return a page without its blocks."""
    return re.sub(r"^```.*?^```$", "", path.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)


@pytest.mark.parametrize("kind", sorted({block.kind for block in BLOCKS}))
def test_blocks_are_known_kinds(kind: str) -> None:
    """An indented block that is no code is an equation, or is marked as what a program printed."""
    assert kind in ("sh", "toml", "python", "text", "output")
    for block in BLOCKS:
        if block.kind == "text":
            assert re.search(r" [=<>] |:=|\|\|", block.text), f"{block}: no equation, and no command that is known"


@pytest.mark.parametrize("block", SHELL, ids=str)
def test_shell_blocks_are_shell(block: Block) -> None:
    done = subprocess.run(["bash", "-n"], input=shell_of(block), capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("block", SHELL, ids=str)
def test_commands_of_blocks_are_taken(block: Block) -> None:
    """Options and their values as the commands read them; scripts, modules, tests and scenes that exist."""
    for words in map(without_launcher, commands_of(shell_of(block))):
        if words[0].rpartition("/")[2] == "pgmp" and len(words) > 1 and not any("$" in word for word in words):
            arguments = words[2 : words.index("--")] if "--" in words else words[2:]
            with command(words[1]).make_context(words[1], arguments, obj=SimpleNamespace(json=False, quiet=False)):
                pass
        if "-m" in words[1:2] and words[2].startswith("benchmarks"):
            assert runs(words[2]), f"{block}: {words[2]}"
        for word in words:
            if re.match(r"(\.\./)?(scenes|scripts|tests|benchmarks|meshes)/[\w/.]+$", word) and "%" not in word:
                assert (ROOT / word).exists(), f"{block}: {word} does not exist"


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.name)
def test_commands_in_texts_have_the_options(path: Path) -> None:
    for code in re.findall(r"(?<!`)`(pgmp [^`]+)`(?!`)", texts_of(path)):
        for one in re.findall(r"pgmp ([^;]+)", code):
            name, *rest = one.split()
            if name in ("COMMAND", "...") or name.startswith("-"):
                continue
            assert name in COMMANDS, f"{path.name}: `{code}`: there is no such command"
            known = {option for parameter in command(name).params for option in parameter.opts} | {"--help", "--"}
            for word in rest[: rest.index("--")] if "--" in rest else rest:
                option = word.strip("[]().,").partition("=")[0]
                assert not option.startswith("--") or option in known, f"{path.name}: `{code}`: no option {option}"


@pytest.mark.parametrize("block", TOML, ids=str)
def test_toml_blocks_are_parts_of_scenes(block: Block) -> None:
    """A whole scene is read; the tables of a part fit into the scene of the page, or into one of the repository."""
    if "file" in block.marks:
        scene_from_tables(tomllib.loads(block.text), ROOT)
        return
    bases = [path.read_text(encoding="utf-8") for path in SCENES]
    if block.name:
        bases = [one.text for one in TOML if (one.page, one.name) == (block.page, block.name) and "file" in one.marks]
    problems = []
    for base in bases:
        tables = merged(base, block.text)
        post = [0.9, 0.1, 0.0] if re.search("(beam|solid)3d", base) else [0.9, 0.1]  # that a part connects to
        tables.setdefault("ground", {}).setdefault("points", {})["post"] = post
        try:
            scene_from_tables(tables, BASE.parent)
            return
        except InputError as error:
            problems.append(str(error))
    pytest.fail(f"{block} fits into no scene: {min(problems, key=len)}")


def anchors_of(path: Path) -> set[str]:
    """Return the anchors of a page's headings, as the handbook and code hosts make them."""
    heads = re.findall(r"^#+ (.*)$", path.read_text(encoding="utf-8"), flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", head.lower()).strip().replace(" ", "-") for head in heads}


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.name)
def test_links_lead_somewhere(path: Path) -> None:
    for target in re.findall(r"\]\(([^)\s]+)\)", texts_of(path)):
        if target.startswith(("http://", "https://")):
            continue
        file, _, anchor = target.partition("#")
        place = (path.parent / file).resolve() if file else path
        made = place.name == "changelog.md"  # by scripts/docs
        assert place.exists() or made, f"{path.name}: {target}"
        if anchor:
            assert anchor in anchors_of(place), f"{path.name}: {target}"


def test_every_page_is_in_the_navigation() -> None:
    settings = (ROOT / "scripts" / "handbook" / "mkdocs.yml").read_text(encoding="utf-8")
    named = set(re.findall(r": (\w+\.md)$", settings, flags=re.MULTILINE))
    made = {"index.md", "changelog.md"}
    assert named == {path.name for path in PAGES if path.name != "README.md"} | made


def test_the_page_of_all_entries_is_that_of_the_models() -> None:
    text = (ROOT / "docs" / "scene_reference.md").read_text(encoding="utf-8")
    assert text == reference_page(), "write it again: pgmp schema -o docs/scene_reference.md"


def test_every_entry_of_a_scene_is_described() -> None:
    schema = editor_schema()
    assert len(schema["definitions"]) > 50
    for name, model in {"Scene": schema, **schema["definitions"]}.items():
        for key, entry in model["properties"].items():
            assert entry.get("description") or len(entry.get("enum", ())) == 1, f"{name}.{key}"
            # a number that has a unit on the page may be a text with another one
            assert not unit_of(entry) or "string" in str(entry), f"{name}.{key}"


@pytest.fixture(scope="module")
def validate():
    return fastjsonschema.compile(editor_schema())


@pytest.mark.parametrize("path", SCENES, ids=lambda path: path.stem)
def test_scenes_and_templates_are_those_of_the_schema(path: Path, validate) -> None:
    validate(tomllib.loads(path.read_text(encoding="utf-8")))
    load_scene(path)


@pytest.mark.parametrize(
    ("part", "entry"),
    [
        ("[bodies.crank]\nmash = 'x.msh'", "crank"), ("[materials.steel]\nE = -1.0\nnu = 0.3\nrho = 7800.0", "steel"),
        ("[materials.steel]\nE = 2e11\nnu = 0.5\nrho = 7800.0", "steel.nu"),
        ("[effects.motor]\ntype = 'torc'\njoint = 'crank_hinge'", "effects.motor"),
        ("[reduction]\nangles = 1e7", "reduction"), ("[reduction]\nmodes = 0", "reduction.modes"),
        ("[simulation]\nspectral_radius = 1.5", "simulation.spectral_radius"),
        ("[joints.slider]\ntype = 'point_on_line'\nconnect = ['ground', 'rod:tip']\ndirection = [1.0, 0.0]", "slider"),
        ("[ground.points]\npost = [1.0]", "post"), ("effects = 'all'", "effects"),
    ],
)  # fmt: skip
def test_what_the_schema_refuses_is_refused(part: str, entry: str, validate) -> None:
    """Editors underline nothing that a scene may say."""
    tables = merged(BASE.read_text(encoding="utf-8"), part)
    with pytest.raises(fastjsonschema.JsonSchemaException, match=entry):
        validate(tables)
    with pytest.raises(InputError):
        scene_from_tables(tables, BASE.parent)


def test_numbers_of_parameters_may_be_texts_with_a_unit(validate) -> None:
    bounds = 'bounds = ["5 mm", "11 mm"]'
    part = f'[parameters.r1]\nunit = "m"\nnominal = "8 mm"\n{bounds}\ndistribution = {{name="norm",loc="8 mm",scale="0.4 mm"}}'
    tables = merged(BASE.read_text(encoding="utf-8"), part)
    validate(tables)
    assert scene_from_tables(tables, BASE.parent).parameters["r1"].distribution.arguments["scale"] == pytest.approx(
        4e-4
    )


def test_all_effects_may_be_chosen_at_once(validate) -> None:
    validate(merged(BASE.read_text(encoding="utf-8"), "effects = 'auto'"))


def test_templates_are_in_the_documentation() -> None:
    text = (ROOT / "docs" / "first_steps.md").read_text(encoding="utf-8")
    assert set(template_names()) <= set(re.findall(r"^\| `(\w+)` \|", text, flags=re.MULTILINE))


def claims() -> list[tuple[str, str, str]]:
    """Return the rows of the list of claims: where, the claim, and what checks it."""
    text = (ROOT / "docs" / "claims.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (.+?) \| (.+?) \| (.+?) \|$", text, flags=re.MULTILINE)
    return [row for row in rows if row[0] not in ("where", "---")]


def test_claims_have_checks() -> None:
    """Of every claim the test or command that checks it exists; tests by their names."""
    found = claims()
    assert len(found) > 30
    for _, claim, how in found:
        checks = re.findall(r"`([^`]+)`", how)
        assert checks, f"{claim}: nothing checks it"
        for check in checks:
            assert exists(check), f"{claim}: {check} does not exist"


def runs(module: str) -> bool:
    """Return whether there is such a benchmark, with all that it imports."""
    found = importlib.import_module(module)
    return not hasattr(found, "__path__") or (Path(found.__file__).parent / "__main__.py").exists()


def exists(check: str) -> bool:
    """Return whether there is such a test, benchmark, command or script."""
    file, _, name = check.partition("::")
    if file.startswith("tests/") and file.endswith(".py"):
        return (ROOT / file).exists() and f"def {name}" in (ROOT / file).read_text(encoding="utf-8")
    if check.startswith("python -m benchmarks"):
        return runs(check.split()[2])
    if check.startswith("pgmp "):
        return check.split()[1] in COMMANDS
    return (ROOT / check.split()[0]).exists()


def test_ten_minutes_types_what_the_first_steps_say() -> None:
    script = (ROOT / "scripts" / "ten_minutes").read_text(encoding="utf-8")
    block = next(block for block in SHELL if block.page == "README.md" and block.text.startswith("scripts/setup"))
    said = [" ".join(words) for words in commands_of(block.text)]
    assert said[0] == "scripts/setup" and len(said) == 3
    typed = re.findall(r"^typed (.*)$", script, flags=re.MULTILINE)
    assert [one for one in typed if one in said] == said


@pytest.mark.parametrize("name", ["docs", "check_docs", "ten_minutes"])
def test_scripts_are_shell_and_can_be_run(name: str) -> None:
    path = ROOT / "scripts" / name
    assert path.stat().st_mode & 0o111
    subprocess.run(["bash", "-n", path], check=True)


def test_ten_minutes_keeps_what_is_there(tmp_path: Path) -> None:
    done = subprocess.run([ROOT / "scripts" / "ten_minutes", tmp_path], capture_output=True, text=True, check=False)
    assert done.returncode == 2 and "exists; give the name of a new folder" in done.stderr


def test_blocks_that_fail_are_told(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch) -> None:
    """What `scripts/check_docs` says of a page: blocks that end as they should, others, and what is not run."""
    page = tmp_path / "page.md"
    fence = "```"
    page.write_text(
        f"<!-- given: touch there -->\n\n{fence}sh\nls there\n{fence}\n\n{fence}sh\nfalse\n{fence}\n"
        f"\n<!-- ends with: 1 -->\n\n{fence}sh\nfalse\n{fence}\n"
        f"\n<!-- not run: no cluster -->\n\n{fence}sh\nsbatch x\n{fence}\n"
    )
    monkeypatch.setattr(handbook_blocks, "ROOT", tmp_path)
    assert handbook_run.check(page, dear=False) == 1
    said = capsys.readouterr().out
    assert said.count("FAILED") == 1 and "page.md:7: FAILED" in said and "not run: no cluster" in said


def code_of(notebook: dict) -> list[str]:
    return ["".join(cell["source"]) for cell in notebook["cells"] if cell["cell_type"] == "code"]


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.stem)
def test_pages_are_notebooks(path: Path, tmp_path: Path) -> None:
    """What is run of a page is in cells, in order; all other lines are text."""
    notebook = notebook_of(path)
    assert (notebook["nbformat"], notebook["nbformat_minor"]) == (4, 5)
    cells = ["".join(cell["source"]) for cell in notebook["cells"]]
    assert len({cell["id"] for cell in notebook["cells"]}) == len(cells)
    assert all(re.fullmatch(r"[a-zA-Z0-9-_]{1,64}", cell["id"]) for cell in notebook["cells"])
    run = [
        block for block in blocks_of(path) if "not run" not in block.marks and block.kind in ("sh", "python", "toml")
    ]
    run = [block for block in run if block.kind != "toml" or {"file", "into"} & {*block.marks}]
    code = code_of(notebook)[1:]
    assert len(code) == len(run)
    for block, text in zip(run, code):
        assert (shell_of(block) if block.kind == "sh" else block.text).splitlines()[-1] in text
    for text in code:
        if text.startswith("%%bash"):
            subprocess.run(["bash", "-n"], input=text.partition("\n")[2], text=True, check=True)
        elif not text.startswith("%%writefile"):
            compile(text, path.name, "exec")
    assert not any("<!-- not run" in text or "<!-- given" in text for text in cells)
    prose = [line for line in texts_of(path).splitlines() if line.startswith("#")]
    assert [line for text in cells for line in text.splitlines() if line in prose] == prose


def test_a_part_of_a_scene_is_put_into_its_file_by_a_notebook(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (text,) = (text for text in code_of(notebook_of(ROOT / "docs" / "tutorial.md")) if "import tomli_w" in text)
    name = re.search(r"scene = Path\('(.*)'\)", text)[1]
    monkeypatch.chdir(tmp_path)
    (tmp_path / name).write_text(BASE.read_text(encoding="utf-8"), encoding="utf-8")
    before = tomllib.loads(BASE.read_text(encoding="utf-8"))
    exec(compile(text, "tutorial", "exec"), {"Path": Path})
    after = tomllib.loads((tmp_path / name).read_text(encoding="utf-8"))
    assert after != before and after["joints"] == before["joints"]


def test_the_demo_runs_as_a_notebook(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its cells one after the other in one program, with the settings of a small model in place of its own."""
    import matplotlib.pyplot as plt

    plt.switch_backend("agg")
    monkeypatch.chdir(tmp_path)
    code = code_of(notebook_of(ROOT / "docs" / "demo.md"))
    assert sum(len(text.splitlines()) for text in code[1:]) <= 60
    small = {"reduction.modes": 4, "reduction.angles": 24, "simulation.duration": 0.05, "ensemble.bands": 10}
    scene = ROOT / "scenes" / "slider_crank_paper.toml"
    (settings,) = (k for k, text in enumerate(code) if text.startswith("scene_file = "))
    code[settings] = f"scene_file, overrides, samples = {str(scene)!r}, {small!r}, 32"
    names: dict[str, object] = {}
    monkeypatch.setenv("PATH", os.environ["PATH"])  # which the first cell changes
    for text in code:
        exec(compile(text, "demo", "exec"), names)
    plt.close("all")
    said = capsys.readouterr().out
    assert said.count("% of the largest value") == 6 and "0 samples failed" in said
    assert names["page"].name == "demo.html" and (tmp_path / "demo.html").stat().st_size > 100_000
    assert len(names["many"].status) == 32


@pytest.mark.parametrize(("asked", "least"), [("clearance", 5), ("reduction.tolerance", 3), ("zzzz", 0)])
def test_the_search_works_from_files(asked: str, least: int) -> None:
    """Where `scripts/docs` has built the handbook, and there is a browser."""
    page, browser = ROOT / "build" / "handbook" / "search.html", shutil.which("chromium-headless-shell")
    if browser is None or not (page.parent / "search" / "sections.js").exists():
        pytest.skip("no handbook is built, or there is no browser")
    options = ["--no-sandbox", "--disable-gpu", "--virtual-time-budget=4000", "--dump-dom"]
    seen = subprocess.run(
        [browser, *options, f"{page.as_uri()}?q={asked}"], capture_output=True, text=True, timeout=TIMEOUT_SECONDS
    ).stdout
    tree = html5lib.parse(seen, namespaceHTMLElements=False)
    found = next(item for item in tree.iter() if item.get("id") == "mkdocs-search-results")
    links = [item.get("href") for item in found.iter("a")]
    assert len(links) >= least and bool(links) == bool(least)
    assert all((page.parent / link.partition("#")[0]).exists() for link in links)
