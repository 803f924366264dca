"""``pgmp run``: everything from the check of a scene to the report, one line a step."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import click

from pgmp_petsc import __version__
from pgmp_petsc.bodies.shape import BodyShape
from pgmp_petsc.cli.build import build
from pgmp_petsc.cli.montecarlo import LARGEST_SEED, MOST_SAMPLES, montecarlo
from pgmp_petsc.cli.options import Whole, scene_options
from pgmp_petsc.cli.report import save, say, say_remarks
from pgmp_petsc.cli.simulate import simulate
from pgmp_petsc.experiments.price import Price, step_seconds
from pgmp_petsc.experiments.reference import Demand, Reference, choose_reference, component_model
from pgmp_petsc.mechanism.capabilities import Purpose, why_no_full_model
from pgmp_petsc.mechanism.kinematics import MOST_COORDINATES, RigidKinematics
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.models import FullModel
from pgmp_petsc.report.headlines import (
    headline_of_build,
    headline_of_comparison,
    headline_of_ensemble,
    headline_of_run,
)
from pgmp_petsc.runtime.agreement import agreed, on_root
from pgmp_petsc.runtime.claims import check_output
from pgmp_petsc.runtime.errors import InputError, RunError
from pgmp_petsc.runtime.identity import identity
from pgmp_petsc.runtime.steps import LABEL, Steps
from pgmp_petsc.scene import Scene, scene_to_toml
from pgmp_petsc.studies.inputs import read_scene
from pgmp_petsc.studies.prepared import settled
from pgmp_petsc.studies.simulate import simulate_full

IN_FOLDER = "report.html"
ROM, RUN, BETTER, MANY = "rom.h5", "run.h5", "better.h5", "samples.h5"


@click.command()
@click.argument("scene", metavar="SCENE", type=click.Path(path_type=Path))
@click.option(
    "--report", "page", metavar="FILE.html", type=click.Path(path_type=Path), is_flag=False, flag_value=IN_FOLDER,
    help="Page to write; without a name, or without the option, report.html in the folder.",
)  # fmt: skip
@click.option(
    "-o", "--output", "folder", metavar="FOLDER", type=click.Path(path_type=Path),
    help="Folder for all files; SCENE_results beside the scene if not given.",
)  # fmt: skip
@click.option(
    "-n", "n_samples", default=512, show_default=True, metavar="N", type=Whole(1, MOST_SAMPLES),
    help="Number of samples, where parameters have distributions.",
)  # fmt: skip
@click.option(
    "--seed", default=0, show_default=True, metavar="S", type=Whole(0, LARGEST_SEED), help="Random seed."
)
@click.option("--force", is_flag=True, help="Do all steps again, also those whose files are finished.")
@scene_options
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
    comm = context.obj.comm
    folder = scene.with_name(f"{scene.stem}_results") if folder is None else folder
    page = folder / IN_FOLDER if page is None or str(page) == IN_FOLDER else page
    loaded, meshes = read_scene(scene, overrides, settings, comm, Purpose.CHECK)
    steps = Steps(folder)
    on_root(comm, steps.make)
    on_root(comm, check_output, page, "report", (scene,))
    with agreed(comm, "assembling the mechanism"):
        mechanism = Mechanism.from_scene(loaded, meshes)
        kinematics = RigidKinematics(mechanism)
    say_remarks(context, loaded)
    say(context, f"check      {_checked(loaded, mechanism)}")
    key = identity(scene_to_toml(loaded), meshes, __version__)
    job = Job(context, scene, loaded, meshes, kinematics, steps, key, force, settings, overrides)
    job.build()
    job.simulate()
    job.compare()
    job.sample(n_samples, seed)
    job.write_report(page)
    if job.failures:
        raise RunError("; ".join(job.failures))


def _checked(scene: Scene, mechanism: Mechanism) -> str:
    """Return what a scene holds, in a line."""
    counts = {"body": len(scene.bodies), "joint": len(scene.joints), "effect": len(scene.effects)}
    plural = {"body": "bodies", "joint": "joints", "effect": "effects"}
    parts = [f"{n} {plural[what] if n != 1 else what}" for what, n in counts.items()]
    drawn = sum(parameter.distribution is not None for parameter in scene.parameters.values())
    return f"{scene.name}: {', '.join(parts)}, {mechanism.n_dofs} unknowns, {drawn} uncertain parameters"


@dataclass
class Job:
    """The steps of one run; each is collective on the command's ranks.

    Attributes
    ----------
    files
        What is there for the report.
    failures
        What went wrong although the job went on.
    """

    context: click.Context
    path: Path
    scene: Scene
    meshes: Mapping[str, BodyShape]
    kinematics: RigidKinematics
    steps: Steps
    key: str
    force: bool
    settings: tuple[str, ...]
    overrides: tuple[str, ...]
    files: list[Path] = field(default_factory=list)
    failures: list[str] = field(default_factory=list)

    @property
    def flexible(self) -> bool:
        """Whether any body deforms."""
        return any(body.flexible for body in self.scene.bodies.values())

    @property
    def model(self) -> str:
        """The model that runs and samples are of."""
        if not self.flexible:
            return "full"
        return "reduced" if len(self.scene.coordinates) <= MOST_COORDINATES else "components"

    @property
    def n_steps(self) -> float:
        """Time steps of one run."""
        return self.scene.simulation.duration / self.scene.simulation.step

    def build(self) -> None:
        """Build the reduced model."""
        if self.model != "reduced":
            why = "all bodies are rigid" if not self.flexible else f"{len(self.scene.coordinates)} coordinates"
            instead = "full-order" if self.model == "full" else "component"
            self._say("build", f"left out: no reduced model ({why}); runs are of the {instead} model")
            return

        def make(target: Path, resume: bool) -> None:
            with self._quietly():
                self.context.invoke(
                    build, scene=self.path, output=target, resume=resume, settings=self.settings,
                    overrides=self.overrides,
                )  # fmt: skip

        self._step("build", ROM, (), make, headline_of_build)

    def simulate(self) -> None:
        """Run the model once."""

        def make(target: Path, resume: bool) -> None:
            with self._quietly():
                self.context.invoke(simulate, output=target, **self._source(with_settings=True))

        self._step("simulate", RUN, (self._made_from(),), make, headline_of_run)

    def compare(self) -> None:
        """Run a better model of the same case, where that is affordable."""
        if self.model == "full":
            self._say("compare", "left out: the run is full-order; there is no better model")
            return
        known = (self._made_from(),)
        if self._is_finished(BETTER, known):  # what the better model takes need not be known
            self._take("compare", BETTER, self._headline_of_comparison, again=True)
            return
        try:
            better = self._better()
        except InputError as error:
            self._say("compare", f"left out: {str(error).removeprefix('compare: ')}")
            return
        if better is None:
            return
        self._say("compare", better.why)

        def make(target: Path, resume: bool) -> None:
            model, _ = settled(better.model, self.context.obj.comm)
            save(self.context, simulate_full(model, self.context.obj.comm), target)

        self._step("compare", BETTER, known, make, self._headline_of_comparison)

    def _headline_of_comparison(self, better: Path) -> str:
        return headline_of_comparison(self._of(RUN), better)

    def _better(self) -> Reference | None:
        """Return the model to compare with; None, after saying why, where the mesh is too dear for component runs."""
        comm, demand = self.context.obj.comm, Demand(
            "compare", self.n_steps, "all runs", "or shorten simulation.duration", self.scene.reduction.modes
        )  # fmt: skip
        if self.model == "reduced":
            return choose_reference(self.scene, self.meshes, self.kinematics, demand, comm)
        missing = why_no_full_model(self.scene)
        if missing:
            raise InputError(missing)
        budget = self.scene.reference.budget
        with agreed(comm, "preparing the full-order model"):
            mesh = FullModel(self.scene, self.meshes, self.kinematics)
            price = Price(step_seconds(mesh.kinematics.mechanism), self.n_steps)
        text = f"the mesh: its run is predicted to take {price} of processor time"
        if price.seconds > budget:
            self._say("compare", f"left out: {text}, and reference.budget = {budget:g} s")
            return None
        return Reference(mesh, price, f"{text}, within reference.budget = {budget:g} s", {})

    def sample(self, n_samples: int, seed: int) -> None:
        """Draw samples."""
        if not any(parameter.distribution is not None for parameter in self.scene.parameters.values()):
            self._say("ensemble", "left out: no parameter has a distribution")
            return
        if self.model != "reduced" and not self._affordable(n_samples):
            return

        def make(target: Path, resume: bool) -> None:
            with self._quietly():
                self.context.invoke(
                    montecarlo, output=target, n_samples=n_samples, seed=seed, resume=resume,
                    **self._source(with_settings=False),
                )  # fmt: skip

        known = (self._made_from(), n_samples, seed)
        self._step("ensemble", MANY, known, make, headline_of_ensemble)

    def _affordable(self, n_samples: int) -> bool:
        """Say what samples of a model that is not reduced will take, and whether they are within the budget."""
        comm, budget = self.context.obj.comm, self.scene.reference.budget
        if self.model == "components":
            mechanism = component_model(self.scene, self.meshes, comm, None, self.kinematics).kinematics.mechanism
        else:
            mechanism = self.kinematics.mechanism
        price = Price(step_seconds(mechanism), self.n_steps * n_samples)
        text = f"{n_samples} samples are predicted to take {price} of processor time, reference.budget = {budget:g} s"
        fine = price.seconds <= budget
        self._say("ensemble", text if fine else f"left out: {text}; take fewer with -n, or raise it")
        return fine

    def write_report(self, page: Path) -> None:
        """Write the page of all files that are there."""
        from pgmp_petsc.report.page import write_report

        for line in on_root(self.context.obj.comm, write_report, self.files, page):
            self._say("report", line)

    def _step(
        self, title: str, name: str, known: tuple, make: Callable[[Path, bool], None], headline: Callable[[Path], str]
    ) -> None:
        """Make a file unless it is finished, and say in a line what is in it."""
        comm, target = self.context.obj.comm, self._of(name)
        if self._is_finished(name, known):
            self._take(title, name, headline, again=True)
            return
        key = self._key(name, known)
        resume = not self.force and on_root(comm, self.steps.was_begun, name, key)
        on_root(comm, self.steps.begin, name, key)
        failure = ""
        try:
            make(target, resume)
        except RunError as error:
            # a run that stopped early has its file, which the report shows
            if not on_root(comm, self._is_written, target):
                raise
            failure = str(error)
        except click.exceptions.Exit as end:
            if end.exit_code != 1:
                raise
            failure = f"some samples failed; {target} says which"
        on_root(comm, self.steps.finish, name, key, failure)
        self._take(title, name, headline, again=False)

    def _key(self, name: str, known: tuple) -> str:
        """Return the checksum of what a file is made from: the scene, its meshes, and what else is known."""
        return identity(self.key, name, known)

    def _is_finished(self, name: str, known: tuple) -> bool:
        """Return whether a file of an earlier run may be taken."""
        return not self.force and on_root(self.context.obj.comm, self.steps.is_finished, name, self._key(name, known))

    def _take(self, title: str, name: str, headline: Callable[[Path], str], again: bool) -> None:
        """Keep a file for the report, and say in a line what is in it."""
        target = self._of(name)
        self.files.append(target)
        failure = on_root(self.context.obj.comm, self.steps.failure, name)
        self.failures += [failure] if failure else []
        ahead = " (finished before; --force does it again)" if again else ""
        self._say(title, f"{on_root(self.context.obj.comm, headline, target)} -> {target}{ahead}")

    def _is_written(self, target: Path) -> bool:
        """Return whether the step that failed left its file, which is newer than its note in the ledger."""
        ledger = self._of(LABEL)
        return target.exists() and target.stat().st_mtime_ns >= ledger.stat().st_mtime_ns

    def _source(self, with_settings: bool) -> dict[str, object]:
        """Return the arguments of a command that name the model."""
        if self.model == "reduced":
            return {"source": self._of(ROM)}
        kinds = {"full": self.model == "full", "components": self.model == "components"}
        settings = self.settings if with_settings else self._settings_of_fixed()
        return {"source": self.path, "settings": settings, "overrides": self.overrides, **kinds}

    def _settings_of_fixed(self) -> tuple[str, ...]:
        """Return the settings of parameters that are not drawn."""
        names = [setting.partition("=")[0].strip() for setting in self.settings]
        return tuple(
            setting for name, setting in zip(names, self.settings) if self.scene.parameters[name].distribution is None
        )

    def _made_from(self) -> str:
        """Return the checksum of the reduced model that a step runs; empty where there is none."""
        return on_root(self.context.obj.comm, self.steps.checksum, ROM) if self.model == "reduced" else ""

    def _of(self, name: str) -> Path:
        return self.steps.folder / name

    def _say(self, title: str, text: str) -> None:
        say(self.context, f"{title:10s} {text}")

    @contextmanager
    def _quietly(self) -> Iterator[None]:
        """Let commands within the block print nothing: their step has one line, and the report their warnings."""
        session = self.context.obj
        before, session.quiet, session.has_report = session.quiet, True, True
        try:
            yield
        finally:
            session.quiet, session.has_report = before, False
