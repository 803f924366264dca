"""``pgmp run``: everything from the check of a scene to the report, one line a step."""

from __future__ import annotations

from pathlib import Path

import click

from pgmp_petsc.api.ensembles import LARGEST_SEED, MOST_SAMPLES
from pgmp_petsc.api.jobs import PAGE, run as whole_run
from pgmp_petsc.cli.calls import Call
from pgmp_petsc.cli.options import PathName, Whole, scene_options
from pgmp_petsc.cli.report import quiet
from pgmp_petsc.runtime.errors import RunError


@click.command()
@click.argument("scene", metavar="SCENE", type=PathName())
@click.option(
    "--report", "page", metavar="FILE.html", type=PathName(), is_flag=False, flag_value=PAGE,
    help="Page to write; without a name, or without the option, report.html in the folder.",
)  # fmt: skip
@click.option(
    "-o", "--output", "folder", metavar="FOLDER", type=PathName(),
    help="Folder for all files; SCENE_results beside the scene if not given.",
)  # fmt: skip
@click.option(
    "-n", "n_samples", default=512, show_default=True, metavar="N", type=Whole(1, MOST_SAMPLES),
    help="Number of samples, where parameters have distributions.",
)  # fmt: skip
@click.option("--seed", default=0, show_default=True, metavar="S", type=Whole(0, LARGEST_SEED), help="Random seed.")
@click.option("--force", is_flag=True, help="Do all steps again, also those whose files are finished.")
@scene_options
@quiet
@click.pass_context
def run(
    context: click.Context,
    scene: Path,
    page: Path | None,
    folder: Path | None,
    n_samples: int,
    seed: int,
    force: bool,
    settings: tuple[str, ...],
    overrides: tuple[str, ...],
) -> None:
    """Check SCENE, build its reduced model, simulate, compare with a better model, draw samples, and write a report.

    The better model is the full-order one or, where that is too dear, the component model; what it will take is
    predicted and said first, and beyond reference.budget it is left out. Samples are drawn where parameters have
    distributions. Mechanisms that have no reduced model run as component or full-order models.

    All files are in one folder. A later run of the same scene takes those that are finished, and takes up what was
    begun; with --force it begins anew. Exit status 1 if a run stopped early or samples failed; the report says which.
    """
    call = Call(context, None, settings, overrides)
    changes = {key: value for key, value in call.arguments.items() if key in ("parameters", "overrides", "comm")}
    # the option without a name is the page in the folder
    own = None if page is None or str(page) == PAGE else page
    done = whole_run(scene, folder, page=own, n=n_samples, seed=seed, force=force, **changes)
    if done.failures:
        raise RunError("; ".join(done.failures))
