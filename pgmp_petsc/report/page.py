"""The page: one HTML file that needs no network, with a section a scene: everything that the template writes, worked
out of the scene's results, and data to take along as CSV with all digits.

Figures from a file are ``<data>`` elements with the file's own number, its name and its dataset. Styles, script,
pictures and data are within the page, and its content policy lets it load nothing else.
"""

from __future__ import annotations

import base64
import re
import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import resources
from pathlib import Path, PurePath
from types import SimpleNamespace
from typing import Any

import numpy as np

from pgmp_petsc.base import __version__
from pgmp_petsc.base.errors import InputError, counted, visible
from pgmp_petsc.base.units import behind
from pgmp_petsc.declare.ideas import OUTPUTS
from pgmp_petsc.figures.ensembles import values_of
from pgmp_petsc.figures.style import MODELS, axis_unit, quantity, scene_of, tell_apart
from pgmp_petsc.figures.trajectories import Comparison, labels_of, outputs_of, paired
from pgmp_petsc.files.claims import check_output, named, replacing
from pgmp_petsc.files.hdf5 import KINDS, RunRecord
from pgmp_petsc.report import charts
from pgmp_petsc.report.budget import decision, error_budget, mesh_twins, model_error, verdict
from pgmp_petsc.report.charts import Chart, Curve
from pgmp_petsc.report.film import Film
from pgmp_petsc.report.sources import (
    Build,
    Datum,
    Interval,
    Place,
    Sentence,
    Source,
    chance_of,
    compact_json,
    failed_of,
    mean_of,
    of_kind,
    read_sources,
)
from pgmp_petsc.results import Ensemble, Fit, Tradeoff, Trajectory
from pgmp_petsc.results.ensemble import RareEvent
from pgmp_petsc.results.numbers import ROUND_OFF, one_unit_each, plain
from pgmp_petsc.results.summary import Columns, columns_of, csv_text

MODEL_WORDS = {"full": "Full-order model", "components": "Model of component modes", "reduced": "Reduced model"}
MOST_CURVES = 7
MOST_SHARES = 12  # parameters of a design point
MOST_FAILED = 20
MOST_DECIDING = 3  # parameters of a joint's force
HARDLY = 1e-5  # share of an output's values below which differences of its extremes are no picture


@dataclass(frozen=True)
class Table:
    """A table: its head, rows of sentences, and the text below it."""

    head: list[str]
    rows: list[list[Sentence]]
    note: str = ""


def section_of(sources: Sequence[Source]) -> SimpleNamespace:
    """Return the part of a scene; the names are those of the template."""
    scene = scene_of(sources[0].record)
    header = scene.get("scene", {})
    meshes = [other for _, other in mesh_twins(sources)]  # the error budget has these
    runs = [source for source in of_kind(sources, Trajectory) if source not in meshes]
    ensembles = of_kind(sources, Ensemble)
    studies = of_kind(sources, Tradeoff)
    comparisons = paired([source.result for source in runs])
    error = model_error(sources, comparisons)
    filmed = next((source for source in runs if source.result.frames is not None), None)
    film = None if filmed is None else Film(filmed.result, filmed.name)
    labels = labels_of(comparisons, {id(source.result): source.path for source in runs})
    return SimpleNamespace(
        name=str(header.get("name", "scene without a name")),
        description=str(header.get("description", "")),
        decision=decision(sources, error),
        verdict=verdict(sources, error),
        film=film,
        film_of="" if film is None else film_words(filmed, scene, bool(ensembles)),
        parameters=_parameters(scene, sources[0]),
        outputs=_outputs(scene, comparisons, labels, ensembles),
        statistics=[_statistics(source, len(ensembles) > 1) for source in ensembles if source.result.statistics],
        distributions=list(_distributions(scene, ensembles)),
        rankings=[
            (_ranked(source), [charts.ranking(name, found) for name, found in source.result.sobol.items()])
            for source in ensembles
            if source.result.sobol
        ],
        loads=next(filter(None, (charts.loads(source.result) for source in runs)), []),
        sizing=[_sizing(source, ensembles) for source in runs[:1] if _carried(source.result)],
        budget=error_budget(sources, error),
        energies=list(_energies(runs)),
        tradeoffs=[_tradeoff(source) for source in studies],
        rare_events=[_rare_event(source) for source in of_kind(sources, RareEvent)],
        fits=[(_fit(source), charts.fit(source.result)) for source in of_kind(sources, Fit)],
        failures=[_failures(source) for source in ensembles if source.result.status.any()],
        remarks=_remarks(sources),
        cost=_cost(sources),
        origins=_origins(sources),
        commands=_commands(sources),
        downloads=[download for source in sources for download in downloads_of(source)],
        absent=list(_absent(runs, ensembles, film)),
    )


def beside_each_other(sources: Sequence[Source]) -> Table | None:
    """Return figures of several ensembles, else of several runs of one model, side by side; None where there are none.

    Of two, the difference of the second from the first, with its interval from those of both, whose samples are taken
    as independent of each other: where they share draws it is narrower.
    """
    chosen, meshes = of_kind(sources, Ensemble), [other for _, other in mesh_twins(sources)]
    for model in MODELS if len(chosen) < 2 else ():
        runs = [one for one in of_kind(sources, Trajectory) if one not in meshes]
        chosen = [one for one in runs if one.result.model == model]
        if len(chosen) > 1:
            break
    if len(chosen) < 2:
        return None
    apart = tell_apart([one.record for one in chosen], files=[one.path for one in chosen])
    head = ["figure", *(", ".join(dict.fromkeys(filter(None, (one.name, text)))) for one, text in zip(chosen, apart))]
    of_all = [dict(_compared(one)) for one in chosen]
    rows: list[list[Sentence]] = []
    for name in of_all[0]:
        if all(name in known for known in of_all):
            values = [known[name] for known in of_all]
            unit = values[0][2]
            factor, unit = (100.0, unit) if unit == "%" else axis_unit(unit, *(of for of, _, _ in values))
            shown = behind(unit)
            row: list[Sentence] = [[name]]
            row += [[f"{factor * of:.4g}{_to_both_sides(factor * half)}{shown}"] for of, half, _ in values]
            if len(values) == 2:
                (first, a, _), (second, b, _) = values
                change, half = second - first, float(np.hypot(a, b))
                alike = abs(change) <= max(np.nan_to_num(half), ROUND_OFF * max(abs(first), abs(second)))
                said = "no difference is seen" if alike else "differs" if half > 0.0 else ""
                by = f"{plain(factor * change, 3, '+')}{_to_both_sides(factor * half)}{shown}"
                row.append([f"{'equal' if change == 0.0 else by}{f': {said}' if said and change else ''}"])
            rows.append(row)
    head += ["second less first"] if len(chosen) == 2 else []
    what = "intervals of sampling" if isinstance(chosen[0].result, Ensemble) else "largest by size over each run"
    return Table(head, rows, f"Of each file: {what}; errors of the models are in the error budget.") if rows else None


def _to_both_sides(half: float) -> str:
    return f" ± {plain(half)}" if half > 0.0 else ""


def _compared(source: Source) -> Iterator[tuple[str, tuple[float, float, str]]]:
    """Yield figures of a file by name: the value, half its interval, NaN where it has none, and the unit."""
    result = source.result
    if isinstance(result, Trajectory):
        for name, values in result.outputs.items():
            known = np.nan_to_num(values)
            most = known[np.argmax(np.abs(known))]
            yield name, (float(most), np.nan, result.units.get(name, "1"))
        return
    for label, chance in result.probabilities.items():
        if np.isfinite(chance.estimate):
            yield f"P({label})", (float(chance.estimate), 0.5 * float(np.diff(chance.interval)[0]), "%")
    for name, s in result.statistics.items():
        if s.count and name not in result.first_passages:
            half = 0.0 if s.constant else 0.5 * float(np.diff(s.mean_interval)[0])
            yield f"{name}, mean", (float(s.mean), half, result.units.get(name, "1"))


def film_words(source: Source, scene: Mapping[str, Any], among_samples: bool) -> str:
    """Return what is seen in the film: which run, and where its parameters are not those of the scene."""
    words = f"{MODEL_WORDS[source.result.model]}, {source.name}"
    nominal = {name: entry.get("nominal") for name, entry in scene.get("parameters", {}).items()}
    units = {name: str(entry.get("unit", "1")) for name, entry in scene.get("parameters", {}).items()}
    other = [
        f"{quantity(name, value, units[name])} (nominally {quantity(name, nominal[name], units[name]).split(' = ')[1]})"
        for name, value in source.record.parameters.items()
        if isinstance(nominal.get(name), (int, float)) and value != nominal[name]
    ]
    if other:
        words += f", at {', '.join(other)}"
    elif among_samples:
        words += ", at the nominal parameters"
    if among_samples:
        words += ": a single run, none of the samples"
    return words


def _parameters(scene: Mapping[str, Any], source: Source) -> Table:
    rows = []
    for name, value in source.record.parameters.items():
        entry = scene.get("parameters", {}).get(name, {})
        factor, shown = axis_unit(str(entry.get("unit", "1")), np.array([value]))
        shown = behind(shown)
        drawn_from = entry.get("distribution")
        drawn = "fixed"
        if isinstance(drawn_from, dict):
            arguments = ", ".join(
                f"{len(item)} {'distributions' if key == 'of' else key}"
                if isinstance(item, list)
                else f"{key} = {factor * item:.6g}{shown}"
                if key in ("loc", "scale")
                else f"{key} = {item:g}"
                for key, item in drawn_from.items()
                if isinstance(item, (int, float, list))
            )
            drawn = f"{drawn_from.get('name', '')}({arguments})"
        bounds = entry.get("bounds")
        if bounds:
            drawn += f", from {factor * bounds[0]:.6g} to {factor * bounds[1]:.6g}{shown}"
        shown_value = Datum(value, f"{factor * value:.6g}", source.name, f"@parameters/{name}")
        rows.append([[name], [str(entry.get("description", ""))], [shown_value, shown], [drawn]])
    return Table(["parameter", "what it is", "value", "distribution"], rows)


def _outputs(
    scene: Mapping[str, Any], comparisons: Sequence[Comparison], labels: Sequence[str], ensembles: Sequence[Source]
) -> list[Chart]:
    """Return a chart an output: the runs, and the bands of the first ensemble that has them."""
    banded = next((source.result for source in ensembles if any(b.count for b in source.result.bands.values())), None)
    bands = {} if banded is None else {name: band for name, band in banded.bands.items() if band.count}
    runs = [
        (run, ", ".join(dict.fromkeys(filter(None, (MODELS[run.model], *label.split(", "))))))
        for comparison, label in zip(comparisons, labels)
        for run in comparison.runs
    ][:MOST_CURVES]
    units, model = ({}, "full") if banded is None else (dict(banded.units), banded.model)
    for run, _ in reversed(runs):
        units |= {name: run.units.get(name, "1") for name in run.outputs}
    levels = charts.levels_of(scene.get("ensemble", {}).get("probabilities", {}))
    found = []
    for name in dict.fromkeys([*(name for run, _ in runs for name in run.outputs), *bands]):
        curves = [Curve(label, run.model, run.time, run.outputs[name]) for run, label in runs if name in run.outputs]
        level = levels.get(name)
        level = level if level is not None and level.when == "ever" else None
        found.append(charts.output_over_time(name, units.get(name, "1"), curves, bands.get(name), model, level))
    return found


def _statistics(source: Source, several: bool) -> Table:
    ensemble = source.result
    first = next(iter(ensemble.statistics.values()))
    head = ["", "mean", "deviation", "samples", *(f"{100 * p:g} %" for p in first.probabilities)]
    rows: list[list[Sentence]] = []
    names = [name for name in ensemble.statistics if name not in ensemble.parameters]
    drawn = [name for name in ensemble.parameters if name in ensemble.statistics]
    of_all = {*names} - {*ensemble.first_passages} if ensemble.status.any() else {}
    for name in (*names, *drawn):
        s, title = ensemble.statistics[name], _title(ensemble, name)
        mean, factor, unit = mean_of(source, name)
        place = Place(source.name, f"/statistics/{name}")
        title += unit and f" ({unit.strip()})"
        count = [place.datum("count", s.count, str(s.count))]
        quantiles: list[Sentence] = [[]] * s.probabilities.size
        if not s.count:
            never = "no sample has one" if name in ensemble.without_passage else "not known: no sample tells"
            mean, std, count = [never], [], []
        elif s.constant:
            std = ["constant"]
        else:
            std = place.figure("std", s.std, "std_interval", s.std_interval, factor)
            quantiles = [
                place.figure("quantiles", q, "quantile_intervals", ends, factor, str(k))
                for k, (q, ends) in enumerate(zip(s.quantiles, s.quantile_intervals))
            ]
        if name in of_all:
            bounds = [place.ends("quantile_bounds", ends, factor, str(k)) for k, ends in enumerate(s.quantile_bounds)]
            quantiles = [[*cell, " {", low, ", ", high, "}"] for cell, (low, high) in zip(quantiles, bounds)]
        rows.append([[title], mean, std, count, *quantiles])
    of = f"{source.name}: " if several else ""
    note = f"{of}{MODEL_WORDS[ensemble.model]}; brackets hold {100 * first.confidence:g} % intervals of sampling alone."
    if of_all:
        note += " Braces hold the bounds of the quantiles of all samples, whatever the failed ones would have been."
    return Table(head, rows, note)


def _distributions(scene: Mapping[str, Any], ensembles: Sequence[Source]) -> Iterator[Chart]:
    """Yield the densities of the first ensemble: outputs, what is known of them over time, and parameters.

    Extremes that hardly differ beside the output itself have none: the least angle of a drive that begins there.
    """
    levels = charts.levels_of(scene.get("ensemble", {}).get("probabilities", {}))
    for source in ensembles[:1]:
        ensemble = source.result
        failed = ensemble.status != 0
        names = [name for name in ensemble.statistics if name not in ensemble.parameters]
        for name in (*names, *ensemble.parameters):
            s = ensemble.statistics.get(name)
            if s is None or not s.edges.size or s.constant:  # of what is the same in all samples there is no density
                continue
            of_input = name in ensemble.parameters
            lost = ensemble.parameters[name][failed] if of_input else np.empty(0)
            values, (output, _, which) = values_of(ensemble, name), name.partition(".")
            level = levels.get(output)
            if level is not None and which != {"end": "", "ever": "max" if level.above else "min"}[level.when]:
                level = None
            if which and level is None:
                known = (ensemble.statistics.get(one, s) for one in (name, output))
                if np.ptp(values) < HARDLY * max(np.abs(one.quantiles).max(initial=0.0) for one in known):
                    continue
            unit = ensemble.units.get(name, "1")
            found = charts.distribution(name, unit, values, ensemble.model, level, lost, of_input)
            yield replace(found, title=_title(ensemble, name))


def _title(ensemble: Ensemble, name: str) -> str:
    return name + (", first passage" if name in ensemble.first_passages else "")


def _ranked(source: Source) -> str:
    found = next(iter(source.result.sobol.values()))
    total = "" if found.total is not None else "; total indices need the sampler saltelli"
    what = "blocks of samples" if found.method == "saltelli" else "samples"
    level = f"{100 * found.confidence:g} % intervals"
    return f"{source.name}: Sobol indices from {found.count} {what}, {level}{total}"


def _energies(runs: Sequence[Source]) -> Iterator[Chart]:
    run = next((one.result for one in runs if one.result.balance is not None and not one.result.rests), None)
    if run is not None:
        yield charts.energies(run, run.balance)
        if run.balance.exchanged > 0.0:
            yield charts.residual(run, run.balance)


def _carried(run: Trajectory) -> dict[str, Mapping[str, Any]]:
    """Return the entries of the outputs of what joints and drives carry, by name."""
    kinds = {entry["type"] for entry in scene_of(run.record).get("outputs", {}).values()}
    return outputs_of(run, tuple(kind for kind in kinds if "multipliers" in OUTPUTS.named(kind).reads))


def _sizing(run: Source, ensembles: Sequence[Source]) -> Table:
    """Return what each joint and drive carries: the largest of the run and of the samples, and what decides it."""
    rows: list[list[Sentence]] = []
    source = next((one for one in ensembles if one.result.extremes), None)
    head = ["output", "joint", "largest in the run"]
    if source is not None:
        highest = sorted(next(iter(source.result.statistics.values())).probabilities)[-1:]
        exceeded = [f"exceeded in {100.0 * (1.0 - p):.3g} %" for p in highest] or ["no quantile"]
        head += ["largest in samples, mean", *exceeded, "probability", "which parameter decides it"]
    for name, entry in _carried(run.result).items():
        values = run.result.outputs[name]
        most = int(np.argmax(np.abs(values)))
        factor, unit = axis_unit(run.result.units.get(name, "1"), values)
        largest = Datum(values[most], f"{factor * values[most]:.4g}", run.name, f"/outputs/{name}", str(most))
        row: list[Sentence] = [
            [name],
            [entry.get("joint") or entry.get("coordinate", "")],
            [largest, f" {unit} at {run.result.time[most]:.4g} s"],
        ]
        rows.append(row if source is None else [*row, *_over_samples(source, name, values[most] < 0.0)])
    what = "The largest is that by size, whatever its sign."
    if source is None:
        return Table(head, rows, f"{what} Samples of an ensemble with extremes = true add probabilities.")
    level = f"{100 * next(iter(source.result.statistics.values())).confidence:g} %"
    note = f"{what} {source.name}: brackets hold {level} intervals of sampling alone; shares are first Sobol indices."
    return Table(head, rows, note)


def _over_samples(source: Source, name: str, negative: bool) -> list[Sentence]:
    """Return mean and high quantile of an output's largest (or, where negative, smallest) value in each sample, the
    probabilities of events of it, and the parameters that decide it, the largest share first."""
    ensemble = source.result
    which = f"{name}.{'min' if negative else 'max'}"
    s = ensemble.statistics.get(which)
    if s is None or not s.count:
        return [["not known"], [], [], []]
    mean, factor, unit = mean_of(source, which)
    if s.constant:
        return [[*mean, unit], ["constant"], [], []]
    place, high = Place(source.name, f"/statistics/{which}"), []
    if s.probabilities.size:
        k = int(np.argmin(s.probabilities) if negative else np.argmax(s.probabilities))
        high = place.figure("quantiles", s.quantiles[k], "quantile_intervals", s.quantile_intervals[k], factor, str(k))
    chances: list[str | Datum | Interval] = []
    for label, event in scene_of(source.record).get("ensemble", {}).get("probabilities", {}).items():
        chance = ensemble.probabilities.get(label)
        if chance is not None and event.get("output") == name:
            place = Place(source.name, f"/probabilities/{label}")
            said = place.figure("estimate", chance.estimate, "interval", chance.interval, 100.0)
            chances += [f"P({label.replace('_', ' ')}) = ", said[0], " %", *said[1:]]
    found, decided = ensemble.sobol.get(which), []
    if found is not None:
        shown = [j for j in np.argsort(-np.nan_to_num(found.first)) if found.first_interval[j, 0] > 0.0]
        for j in shown[:MOST_DECIDING]:
            share = Datum(found.first[j], f"{100 * found.first[j]:.0f} %", source.name, f"/sobol/{which}/S1", str(j))
            decided += [", " if decided else "", f"{found.parameters[j]} ", share]
    figures = [[figure[0], unit, *figure[1:]] if figure else [] for figure in (mean, high)]
    return [*figures, chances, decided or ["not known" if found is None else "none by itself"]]


def _tradeoff(source: Source) -> tuple[Table, list[Chart], list[str]]:
    """Return the settings on the fronts, a chart an output, and the advice."""
    study = source.result
    chosen = study.pareto.any(axis=1)
    chosen[0] = True
    rows = []
    for row in np.flatnonzero(chosen)[np.argsort(study.times.batch[chosen])]:
        errors = [
            [Datum(study.errors[row, k], plain(100 * study.errors[row, k]), source.name, "/errors", f"{row},{k}")]
            for k in range(len(study.outputs))
        ]
        clock = "processor" if study.busy else "online"
        place = f"/{clock}/batch"
        batch = Datum(study.times.batch[row], plain(1e3 * study.times.batch[row], 3), source.name, place, str(row))
        rows.append([[study.name(row) + (" (the scene)" if row == 0 else "")], *errors, [batch]])
    head = ["setting", *(f"{name}, %" for name in study.outputs), "a sample, ms"]
    note = study.reference or "Errors are the largest over time and test values, of the output's largest value."
    failed = [f"{study.name(row)}: {reason}" for row, reason in enumerate(study.reasons) if reason]
    return Table(head, rows, note), [charts.accuracy_and_time(study, name) for name in study.outputs], [
        *study.advice, *(f"failed or too dear: {text}" for text in failed)
    ]  # fmt: skip


def _failures(source: Source) -> Table:
    ensemble = source.result
    failed, drawn = np.flatnonzero(ensemble.status), ensemble.parameters
    rows = []
    for k in failed[:MOST_FAILED]:
        values = [[Datum(v[k], f"{v[k]:.5g}", source.name, f"/parameters/{n}", str(k))] for n, v in drawn.items()]
        time = Datum(ensemble.failure_time[k], f"{ensemble.failure_time[k]:.4g}", source.name, "/failure_time", str(k))
        rows.append([[str(k)], *values, [time], [ensemble.meanings[int(ensemble.status[k])]]])
    units = [ensemble.units.get(name, "1") for name in drawn]
    head = ["sample", *(n if u == "1" else f"{n} ({u})" for n, u in zip(drawn, units)), "at (s)", "reason"]
    left = len(failed) - len(rows)
    return Table(head, rows, failed_of(source) + (f"; {left} more are in its data." if left else "."))


def _rare_event(source: Source) -> Table:
    found = source.result
    rows: list[list[Sentence]] = [[["probability"], chance_of(source) or ["not reached"], [""]]]
    likely = found.most_likely
    for k in range(0 if likely is None else len(likely.beta)):
        beta = Datum(likely.beta[k], f"{likely.beta[k]:.4g}", source.name, "/most_likely/beta", str(k))
        words = f", first-order probability {likely.probability[k]:.3g}"
        rows.append([[f"design point {k + 1}"], ["beta ", beta, words], [""]])
    for k in () if likely is None else np.argsort(-likely.shares[0])[:MOST_SHARES]:
        name, share = found.names[k], likely.shares[0, k]
        value = likely.parameters[name][0]
        at = Datum(value, f"{value:.5g}", source.name, f"/most_likely/parameters/{name}", "0")
        part = Datum(share, f"{100 * share:.1f}", source.name, "/most_likely/shares", f"0,{k}")
        rows.append([[name], [at], [part, " %"]])
    note = f"{source.name}: {found.event}, {100 * found.confidence:g} % interval of {len(found.status)} samples"
    lines = "; parameters, in the scene's units, are those at the first design point, with their shares in the event"
    return Table(["", "value", "share"], rows, f"{note}{'' if likely is None else lines}.")


def _fit(source: Source) -> Table:
    """Return the fitted parameters with their standard errors and limits."""
    found, rows = source.result, list[list[Sentence]]()
    for k, p in enumerate(found.parameters):
        factor, unit = axis_unit(p.unit, np.array([p.estimate]))
        shown = behind(unit)
        value = Datum(p.estimate, f"{factor * p.estimate:.6g}", source.name, "/estimates", str(k))
        error = f"{factor * p.error:.2g}{shown}" if np.isfinite(p.error) else "not identifiable"
        limits = f"{factor * p.lower:.6g} to {factor * p.upper:.6g}{shown}"
        rows.append([[p.name], [value, shown], [error], [f"{factor * p.start:.6g}{shown}"], [limits]])
    ended = "the fit converged" if found.converged else "the fit did not converge"
    note = f"{source.name}: {ended}, after {found.n_runs} runs; errors are standard errors."
    return Table(["parameter", "estimate", "error", "begun with", "searched in"], rows, note)


def _remarks(sources: Sequence[Source]) -> list[tuple[str, str, str]]:
    found: dict[tuple[str, str], list[str]] = {}
    for source in sources:
        for remark in source.record.remarks:
            found.setdefault((remark.kind, remark.text), []).append(source.name)
    rows = [(", ".join(dict.fromkeys(names)), kind, text) for (kind, text), names in found.items()]
    return sorted(rows, key=lambda row: row[1] != "warning")


def _cost(sources: Sequence[Source]) -> Table:
    rows = [
        [[source.name], [phase], [Datum(seconds, plain(seconds, 3), source.name, f"/timings/{phase}"), " s"]]
        for source in sources
        for phase, seconds in source.record.timings.items()
    ]
    return Table(["file", "phase", "wall time"], rows)


def _origins(sources: Sequence[Source]) -> Table:
    rows = []
    for source in sources:
        kind, model = KINDS[source.result.kind], getattr(source.result, "model", "")
        seed, of = source.record.seed, f", {MODELS[model]}" if model else ""
        written = ", ".join([f"pgmp {source.program}", *source.record.plugins])
        told = source.name, f"{kind}{of}", written, str(source.record.ranks), seed
        rows.append([["" if text is None else str(text)] for text in told])
    return Table(["file", "what it is", "written by", "ranks", "seed"], rows)


def _commands(sources: Sequence[Source]) -> list[str]:
    """Return commands that repeat the results, from the scenes that they carry: runs with other entries have others."""
    groups: list[list[Source]] = []
    for source in sorted(sources, key=lambda one: isinstance(one.result, Trajectory)):
        own = next((group for group in groups if _is_of(source, group[0].record)), None)
        if own is None:
            groups.append(own := [])
        own.append(source)
    endings = ["", *(f"_{number}" for number in range(2, len(groups) + 1))]
    return [command for group, ending in zip(groups, endings) for command in _of_scene(group, ending)]


def _is_of(source: Source, record: RunRecord) -> bool:
    """Tell whether a result is of the scene of another record; a run is given its values of parameters."""
    if not isinstance(source.result, Trajectory):
        return source.record.scene_toml == record.scene_toml
    scenes = (scene_of(one) for one in (source.record, record))
    of_run, other = (
        scene | {"parameters": {name: one | {"value": None} for name, one in scene.get("parameters", {}).items()}}
        for scene in scenes
    )
    return of_run == other


def _of_scene(sources: Sequence[Source], ending: str) -> list[str]:
    """Return commands that repeat results of one scene; names of files that they make have an ending."""
    scene = f"scene{ending}.toml"
    any_reduced = any(isinstance(one.result, Fit) or getattr(one.result, "model", "") == "reduced" for one in sources)
    builds = {source.result.kind: shlex.quote(source.name) for source in of_kind(sources, Build)}
    rom = builds.get("rom", f"rom{ending}.h5")
    found = [f"pgmp info {shlex.quote(str(sources[0].path))} --scene > {scene}"]
    if "rom" in builds or any_reduced:
        found.append(f"pgmp build {scene} -o {rom}")
    components = builds.get("components", f"{scene} --components")
    if "components" in builds:
        found.append(f"pgmp build {scene} --components -o {components}")
    meshes = [id(other) for _, other in mesh_twins(sources)]
    for source in sources:
        result, target = source.result, shlex.quote(source.name)
        if isinstance(result, Build):
            continue
        if id(source) in meshes:  # no entry of the scene says how its meshes were cut
            found.append(f"pgmp run {scene}  # writes the run on another mesh, here {target}")
            continue
        if isinstance(result, Fit):
            found.append(f"pgmp fit {rom} MEASURED.csv -o {target}")
            continue
        if isinstance(result, Tradeoff):
            quick = " --quick" if result.quick else ""
            found.append(f"pgmp tradeoff {scene}{quick} -n {result.samples} -o {target}")
            continue
        model = {"full": f"{scene} --full", "components": components}.get(result.model, rom)
        if isinstance(result, Ensemble):
            seed = result.record.seed
            asked = "--samples SAMPLES.csv" if seed is None else f"-n {len(result.status)} --seed {seed}"
            better = {} if result.joined is None else result.joined.status
            asked += "".join(f" --correct {shlex.quote(name)}={status.size}" for name, status in better.items())
            found.append(f"pgmp montecarlo {model} {asked} -o {target}")
        elif isinstance(result, RareEvent):
            asked = f"-n {result.asked} --seed {result.record.seed} --rare {shlex.quote(result.text or 'EVENT')}"
            found.append(f"pgmp montecarlo {model} {asked} -o {target}")
        else:
            values = "".join(f" --set {name}={value!r}" for name, value in result.record.parameters.items())
            found.append(f"pgmp simulate {model}{values} -o {target}")
    files = [name for name in sources[0].record.plugins if name.endswith(".py")]
    given = "".join(f" --plugin {shlex.quote(name)}" for name in files)
    return [re.sub(r"(?=  # | > |$)", lambda _: given, command, count=1) for command in found]


def _absent(runs: Sequence[Source], ensembles: Sequence[Source], film: Film | None) -> Iterator[str]:
    """Yield what the page does not show, and what would bring it."""
    if film is None:
        yield "no picture of the mechanism: no trajectory with frames is here; add a file of pgmp simulate"
    else:
        yield from film.left_out
    if any(source.result.rests for source in runs):
        yield "no energies of a mechanism that rests: they are of round-off alone"
    if len(runs) > MOST_CURVES:
        yield f"{MOST_CURVES} of {len(runs)} runs are in the charts over time"
    if not ensembles:
        yield "no probabilities and no intervals: no ensemble is here; add a file of pgmp montecarlo"
    elif len(ensembles) > 1:
        yield f"distributions and bands are those of {ensembles[0].name}; the tables have all ensembles"
    for source in ensembles:
        if not source.result.sobol:
            yield f"no ranking in {source.name}: it takes two uncertain parameters and 80 samples"
        if not source.result.probabilities:
            yield f"no probabilities in {source.name}: the scene has no ensemble.probabilities"
    if runs and all(source.result.balance is None for source in runs):
        yield "no balance of energy: the trajectories have none"


MOST_NUMBERS = 400_000  # of a table: about 8 MB; the files have the rest


@dataclass(frozen=True)
class Download:
    """A file within the page."""

    name: str  # under which it is saved
    about: str  # what is in it
    address: str  # ``data:`` address with the content


def downloads_of(source: Source) -> list[Download]:
    """Return the tables of a file, and the scene that it was made from."""
    stem = PurePath(source.name).with_suffix("").as_posix().replace("/", "_")
    result = source.result
    found = []
    for kind, about in ((Trajectory, "outputs over time"), (Ensemble, "samples"), (Tradeoff, "settings")):
        if isinstance(result, kind):
            found.append(_table(f"{stem}.csv", about, columns_of(result)))
    if isinstance(result, Ensemble):
        for name, band in result.bands.items():
            unit = result.units.get(name, "1")
            columns = {"time": ("s", band.time), "mean": (unit, band.mean), "std": (unit, band.std)}
            columns |= {f"q{100 * p:g}": (unit, band.quantiles[:, k]) for k, p in enumerate(band.probabilities)}
            found.append(_table(f"{stem}_{name}.csv", f"{name} over time, of the samples", columns))
    toml = result.record.scene_toml.encode("utf-8", "backslashreplace")
    return [*found, Download(f"{stem}.toml", "the scene, with all its defaults", _address("application/toml", toml))]


def _table(name: str, about: str, columns: Columns) -> Download:
    """Return a table; one with too many numbers has the first rows alone, and says so."""
    rows = len(next(iter(columns.values()))[1])
    kept = min(rows, max(1, MOST_NUMBERS // len(columns)))
    about = f"{about}, {rows} rows" if kept == rows else f"{about}, the first {kept} of {rows} rows: the file has all"
    return Download(name, about, _address("text/csv", csv_text(columns, kept).encode()))


def _address(kind: str, content: bytes) -> str:
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"


def write_report(files: Sequence[Path], output: Path) -> list[str]:
    """Write the page of result files, and return lines on what it is and on files given twice or not shown; by one
    process only.

    Files of different scenes get sections of their own, with the scenes' names. Raises `InputError` if a file is
    damaged, if nothing but models, or what a page does not show, is given, or if the output cannot be written, is
    one of the files, or is another file than a page of this program; `RunError` if the system fails to write.
    """
    check_output(output, "report", files)
    scenes, lines = read_sources(files)
    bare = [sources[0] for sources in scenes if all(hasattr(source.result, "selection") for source in sources)]
    if bare:
        raise InputError(
            f"file '{bare[0].path}' holds {named(bare[0].result.kind)}, and no results of its scene are here: add a "
            "trajectory or an ensemble of it"
        )
    text = page_of(scenes, lines)
    with replacing(output, "report") as partial:
        partial.write_text(text, encoding="utf-8", errors="replace")
    size = len(text.encode("utf-8", "replace")) / 1e6
    about = counted(sum(map(len, scenes)), "file")
    if len(scenes) > 1:
        about += f" of {len(scenes)} scenes, each in a section of its own"
    return [f"{output}: {about}, {plain(size)} MB", *lines]


def _largest_of_units(results: Sequence[object]) -> dict[str, float]:
    """Return the largest size that outputs of each unit have on a page."""
    largest: dict[str, float] = {}
    for result in results:
        if not isinstance(result, (Trajectory, Ensemble)):
            continue
        known = {}
        if isinstance(result, Ensemble):  # sizes of parameters say nothing about those of outputs
            known = {name: s.quantiles for name, s in result.statistics.items() if name not in result.parameters}
        for name, values in (known or result.outputs).items():
            size = float(np.max(np.abs(values[np.isfinite(values)]), initial=0.0))
            unit = result.units.get(name, "1")
            largest[unit] = max(size, largest.get(unit, 0.0))
    return largest


def page_of(scenes: Sequence[Sequence], lines: Sequence[str]) -> str:
    from jinja2 import Environment, PackageLoader, StrictUndefined  # only this command needs it

    environment = Environment(
        loader=PackageLoader("pgmp_petsc.report", "page"), autoescape=True, undefined=StrictUndefined, trim_blocks=True,
        lstrip_blocks=True,
    )  # fmt: skip
    environment.filters |= {"compact": compact_json, "sentence_case": lambda text: text[:1].upper() + text[1:]}
    with one_unit_each(_largest_of_units([source.result for sources in scenes for source in sources])):
        sections = [section_of(sources) for sources in scenes]
        beside = beside_each_other([source for sources in scenes for source in sources])
    title = sections[0].name if len(sections) == 1 else ", ".join(section.name for section in sections)
    folder = resources.files("pgmp_petsc.report") / "page"
    css, *scripts = ((folder / name).read_text(encoding="utf-8") for name in ("page.css", "surfaces.js", "page.js"))
    parts = {"title": title, "sections": sections, "beside": beside, "lines": lines, "version": __version__}
    text = environment.get_template("page.html").render(parts, css=css, script="".join(scripts))
    return visible(re.sub(r"\n{2,}", "\n", text).lstrip())
