"""``pgmp plot``: result files as pictures."""

from __future__ import annotations

from pathlib import Path

import click

from pgmp_petsc.api.films import LARGEST_SCALE
from pgmp_petsc.cli.options import Number, PathName, files_argument
from pgmp_petsc.cli.report import quiet, say_of_files


@click.command()
@files_argument
@click.option(
    "-o",
    "--output",
    required=True,
    metavar="DIR",
    type=PathName(),
    help="Directory for the pictures; made if it does not exist.",
)
@click.option(
    "--exaggerate",
    default=1.0,
    show_default=True,
    metavar="FACTOR",
    type=Number(min=1.0, max=LARGEST_SCALE),
    help="Enlarge the deformation in the pictures of the mechanism.",
)
@click.option(
    "--at",
    metavar="SECONDS",
    type=Number(min=0.0),
    help="Instant of the picture of solids; that of the largest stress if not given.",
)
@quiet
@click.pass_context
def plot(context: click.Context, files: tuple[Path, ...], output: Path, exaggerate: float, at: float | None) -> None:
    """Draw result FILEs: what belongs together goes into one picture.

    Results of different scenes never share a picture: with several, the names of pictures end with those of the
    scenes. Within one, keys tell results apart by what differs: parameters, other entries of the scene, the model,
    the seed, or else the file. Brackets hold confidence intervals.

    Tables of modes become frequencies.png or, with two coordinates, frequency_maps.png. Trajectories become
    trajectories.png (full-order and reduced ones are compared where they are of one case); the first that has
    them gives mechanism.png, energies.png, of solids solids.png (surfaces with von Mises' stress in colour) and, with
    two coordinates, coordinate_path.png. Ensembles become
    densities.png and, each ensemble by itself, bands.png (outputs over time) and sobol.png (which parameters
    matter), rare events rare_event.png, trade-off studies tradeoff.png, tradeoff_total.png and tradeoff_mesh.png.
    """
    from pgmp_petsc.figures.collection import draw

    say_of_files(context, files, draw, output, exaggerate, at)
