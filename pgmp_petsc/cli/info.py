"""``pgmp info``: what a result file holds."""

from __future__ import annotations

import os
import tomllib
from datetime import datetime
from pathlib import Path

import click

from pgmp_petsc.cli.output_form import output_form, say_figures
from pgmp_petsc.cli.report import say
from pgmp_petsc.runtime.agreement import on_root


@click.command()
@click.argument("file", type=click.Path(path_type=Path))
@click.option("--scene", is_flag=True, help="Print the scene that the file was made from, as TOML.")
@output_form
@click.pass_context
def info(context: click.Context, file: Path, scene: bool) -> None:
    """Say what FILE holds: its origin, parameters, timings and datasets."""
    if context.obj.json:
        say_figures(context, on_root(context.obj.comm, figures_of, file, scene))
        return
    say(context, on_root(context.obj.comm, _scene if scene else describe, file))


def describe(path: Path) -> str:
    """Return the description of a result file of any kind."""
    from pgmp_petsc.results import EffectSizes, Selection
    from pgmp_petsc.runtime.files import KINDS, RunRecord, open_file, shapes_of
    from pgmp_petsc.runtime.timings import Timings

    with open_file(path, KINDS) as file, shapes_of(file):
        record = RunRecord.read(file)
        parameters = ", ".join(f"{name} = {value:g}" for name, value in record.parameters.items())
        model = file.attrs.get("model")
        lines = [
            f"{path}: {KINDS[file.attrs['kind']]}" + (f" of the {model} model" if model else ""),
            f"written    {datetime.fromtimestamp(os.path.getmtime(path)):%Y-%m-%d %H:%M}"
            f" by pgmp {file.attrs['program_version']}, format {file.attrs['format_version']}",
            f"scene      {_scene_name(record.scene_toml)}",
            f"parameters {parameters or 'none'}",
            f"seed       {'none' if record.seed is None else record.seed}",
            f"ranks      {record.ranks}",
        ]
        if record.remarks:
            lines += ["", *(f"  {remark}" for remark in record.remarks)]
        selection = Selection.read(file)
        if selection is not None:
            lines += ["", *selection.lines()]
        sizes = EffectSizes.read(file)
        if sizes is not None:
            lines += ["", "effects, chosen by their size", *sizes.lines()]
        if record.timings:
            lines += ["", "timings", _indented(Timings(record.timings).table())]
        lines += ["", "datasets", _indented(_datasets(file))]
        known = _estimates(file, path)
        if known:
            lines += ["", *known]
        if file.attrs["kind"] == "tradeoff":
            lines += ["", "summary", _indented(_tradeoff(path))]
        return "\n".join(lines)


def figures_of(path: Path, scene: bool) -> dict[str, object]:
    """Return what a file holds as plain data; with `scene` its scene's tables alone."""
    from pgmp_petsc.results import Selection
    from pgmp_petsc.results.readers import READERS
    from pgmp_petsc.results.summary import origin_of, summary_of
    from pgmp_petsc.runtime.files import KINDS, RunRecord, open_file, shapes_of

    with open_file(path, KINDS) as file, shapes_of(file):
        record, kind = RunRecord.read(file), str(file.attrs["kind"])
        if scene:
            return tomllib.loads(record.scene_toml)
        about = {"file": path, "kind": kind, "program_version": file.attrs["program_version"], **origin_of(record)}
        selection = Selection.read(file)
        about["chosen"] = None if selection is None else selection.chosen
        about["datasets"] = _shapes(file)
    return about if kind not in READERS else {**about, **summary_of(READERS[kind].read(path))}


def _shapes(file) -> dict[str, dict[str, object]]:
    """Return shape, unit and description of every dataset."""
    import h5py

    found = {}

    def visit(name: str, item: object) -> None:
        if isinstance(item, h5py.Dataset):
            unit, about = (str(item.attrs.get(key, "")) for key in ("unit", "description"))
            found[f"/{name}"] = {"shape": list(item.shape), "unit": unit, "description": about}

    file.visititems(visit)
    return found


def _estimates(file, path: Path) -> list[str]:
    """Return the figures of an ensemble, estimated errors, validity, and its balance of energy; a remark says what is
    not there."""
    from pgmp_petsc.cli import ensemble_table, estimates
    from pgmp_petsc.results import Ensemble, Trajectory

    if file.attrs["kind"] == "ensemble":
        ensemble = Ensemble.read(path)
        found = estimates.of_ensemble(ensemble) if ensemble.validity else []
        return [*ensemble_table.lines_of(ensemble), *found, *estimates.of_balance(ensemble)]
    if file.attrs["kind"] == "rare_event":
        from pgmp_petsc.cli.rare import lines_of
        from pgmp_petsc.results.rare_event import RareEvent

        return lines_of(RareEvent.read(path))
    if file.attrs["kind"] in ("sensitivities", "fit", "design"):
        from pgmp_petsc.cli.gradient_tables import lines_of_file

        return lines_of_file(path, str(file.attrs["kind"]))
    if file.attrs["kind"] != "trajectory" or "validity" not in file:
        return []
    trajectory = Trajectory.read(path)
    errors = trajectory.errors
    lines = [] if errors is None else estimates.of_trajectory(errors, trajectory.units)
    return [*lines, estimates.of_validity(trajectory.validity)]


def _tradeoff(path: Path) -> str:
    """Return the table and the advice of a trade-off study."""
    from pgmp_petsc.cli.tradeoff_table import summary
    from pgmp_petsc.results.tradeoff import Tradeoff

    return summary(Tradeoff.read(path))


def _scene(path: Path) -> str:
    """Return the resolved scene of a result file."""
    from pgmp_petsc.runtime.files import KINDS, RunRecord, open_file

    with open_file(path, KINDS) as file:
        return RunRecord.read(file).scene_toml.rstrip()


def _scene_name(scene_toml: str) -> str:
    """Return the name that a scene gives itself."""
    try:
        return str(tomllib.loads(scene_toml)["scene"]["name"])
    except (tomllib.TOMLDecodeError, KeyError, TypeError):
        return "without a name"


def _datasets(file) -> str:
    """Return one line a dataset: name, shape, unit, description; a numbered series (frames) is one line."""
    import h5py

    rows: list[tuple[str, str, str, str]] = []

    def visit(name: str, item: object) -> None:
        if not isinstance(item, h5py.Dataset) or name.startswith("timings/"):
            return
        series, number, rest = _of_lengths(name)
        if number:
            return
        name = f"{series}/<models of all lengths>/{rest}" if series else name
        group, _, last = name.rpartition("/")
        description = str(item.attrs.get("description", ""))
        if last.isdigit():
            if int(last) > 0:
                return
            name, description = f"{group}/<{len(file[group])} frames>", description.replace(" at 0 s", "")
        shape = " x ".join(str(length) for length in item.shape) or "scalar"
        rows.append((f"/{name}", shape, str(item.attrs.get("unit", "")), description))

    file.visititems(visit)
    widths = [max((len(row[column]) for row in rows), default=0) for column in range(3)]
    padded = [[f"{text:<{width}}" for text, width in zip(row, [*widths, 0])] for row in rows]
    return "\n".join("  ".join(row).rstrip() for row in padded)


def _of_lengths(name: str) -> tuple[str, int, str]:
    """Return the group of models of several lengths that a data set is in, the number of its model, and its name there;
    nothing where it is in none."""
    group, _, inside = name.partition("/")
    number, _, rest = inside.partition("/")
    return (group, int(number), rest) if group == "lengths" and number.isdigit() else ("", 0, "")


def _indented(text: str) -> str:
    """Indent every line by two spaces."""
    return "\n".join(f"  {line}" for line in text.splitlines())
