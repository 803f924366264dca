"""Everything from the check of a scene to the report, one line a step."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from os import PathLike, fspath
from pathlib import Path

from pgmp_petsc.api.arguments import Range
from pgmp_petsc.api.declared import Argument, command
from pgmp_petsc.api.ensembles import montecarlo
from pgmp_petsc.api.modes import build
from pgmp_petsc.api.ranks import solving_ranks_of, tell, tell_remarks, untold
from pgmp_petsc.api.runs import simulate
from pgmp_petsc.api.scenes import Overrides, Parameters
from pgmp_petsc.api.sources import keeping, settled
from pgmp_petsc.base import __version__
from pgmp_petsc.base.errors import InputError, NotFollowed, RunError, counted
from pgmp_petsc.base.plugins import in_use
from pgmp_petsc.base.progress import doing
from pgmp_petsc.base.surroundings import Comm
from pgmp_petsc.bench.prices import Price, prospects, quicker, step_of_samples
from pgmp_petsc.bench.reference import Demand, Reference, choose_reference, component_model
from pgmp_petsc.bodies.shape import BodyShape
from pgmp_petsc.ensemble.plan import LARGEST_SEED, MOST_SAMPLES
from pgmp_petsc.estimates.own_error import is_estimated
from pgmp_petsc.files.checkpoint_folder import LEDGER, Steps
from pgmp_petsc.files.claims import check_output
from pgmp_petsc.files.seal import identity
from pgmp_petsc.mechanism.capabilities import Purpose, why_no_full_model, why_no_grid, why_refused
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.mesh.meshes import LineMesh, refined
from pgmp_petsc.models import FullModel
from pgmp_petsc.models.lengths import why_of_one_mesh
from pgmp_petsc.ranks.agreement import agreed, on_root
from pgmp_petsc.ranks.ending import keep, keep_no_longer
from pgmp_petsc.reduction.length_family import why_no_family
from pgmp_petsc.reduction.rom import ReducedOrderModel
from pgmp_petsc.report import budget
from pgmp_petsc.results import Trajectory
from pgmp_petsc.scene import Scene, scene_to_toml
from pgmp_petsc.scene.parameters import uncertain_names
from pgmp_petsc.studies.inputs import coarser_parts, read_scene
from pgmp_petsc.studies.simulate import simulate as simulated

PAGE = "report.html"
ROM, RUN, BETTER, MANY = "rom.h5", "run.h5", "better.h5", "samples.h5"
FINER, COARSER = "finer.h5", "coarser.h5"  # of other meshes: lines are cut, parts of CAD are meshed anew


@dataclass(frozen=True)
class Done:
    """Results of a run."""

    files: tuple[Path, ...]  # results, in the order of the steps
    page: Path  # the report
    failures: tuple[str, ...]  # what went wrong although the run went on: runs that stopped early, samples that failed


def _status(done: Done) -> None:
    if done.failures:
        raise RunError("; ".join(done.failures))


@command(
    "run", "Everything from the check of a scene to a report.", 20, status=_status,
    scene=Argument("The scene's file.", word="SCENE"),
    folder=Argument(
        "Folder for all files; SCENE_results beside the scene if not given.", "-o --output", "FOLDER"
    ),
    page=Argument(
        f"Page to write; without a name, or without the option, {PAGE} in the folder.", "--report", "FILE.html",
        empty=PAGE, read=lambda page: None if str(page) == PAGE else page,
    ),
    n=Argument("Number of samples, where parameters have distributions.", "-n", "N", Range(1, MOST_SAMPLES)),
    seed=Argument("Random seed.", word="S", allowed=Range(0, LARGEST_SEED)),
    force=Argument("Do all steps again, also those whose files are finished."),
    gives="Files, the page, and what failed although the run went on.",
)  # fmt: skip
def run(
    scene: str | PathLike[str],
    folder: str | PathLike[str] | None = None,
    *,
    page: str | PathLike[str] | None = None,
    n: int = 512,
    seed: int = 0,
    force: bool = False,
    parameters: Parameters | None = None,
    overrides: Overrides = (),
    comm: Comm | None = None,
) -> Done:
    """Check `scene`, build its reduced model, simulate, compare with a better model, draw samples, and write a report.

    The better model is the full-order one or, where that is too dear, the component model; what it will take is
    predicted and said first, and beyond reference.budget it is left out. Samples are drawn where parameters have
    distributions; of another model where its steps are predicted to take a third of the reduced one's. Mechanisms that
    have no reduced model run as component models, or as full-order ones where their steps are as much quicker.

    All files are in one folder. A later run of the same scene takes those that are finished, and takes up what was
    begun; with `force` it begins anew. Exit status 1 if a run stopped early or samples failed; the report says which.
    """
    comm = solving_ranks_of(comm)
    path = Path(fspath(scene))
    place = path.with_name(f"{path.stem}_results") if folder is None else Path(folder)
    target = place / PAGE if page is None else Path(page)
    loaded, meshes = read_scene(path, overrides, parameters, comm, Purpose.CHECK)
    steps = Steps(place)
    with ExitStack() as held:
        on_root(comm, lambda: held.enter_context(steps.held()), doing="holding the folder")
        keep(place, "*.h5")
        # of an interrupted command it is still to be said what is there
        held.push(lambda kind, *_: None if kind is KeyboardInterrupt else keep_no_longer(place))
        on_root(comm, check_output, target, "report", (path,))
        with agreed(comm, "assembling the mechanism"):
            mechanism = Mechanism.from_scene(loaded, meshes)
            kinematics = RigidKinematics(mechanism)
        tell_remarks(comm, loaded.remarks)
        tell(comm, f"check      {_checked(loaded, mechanism)}")
        key = identity(scene_to_toml(loaded), meshes, __version__, *in_use().values())
        job = _Job(comm, path, loaded, meshes, kinematics, steps, key, force, parameters, overrides)
        job.build()
        job.simulate()
        job.compare()
        job.refine()
        job.sample(n, seed)
        job.write_report(target)
        return Done(tuple(job.files), target, tuple(job.failures))


def _checked(scene: Scene, mechanism: Mechanism) -> str:
    counts = {"body": len(scene.bodies), "joint": len(scene.joints), "effect": len(scene.effects)}
    plural = {"body": "bodies", "joint": "joints", "effect": "effects"}
    parts = [f"{n} {plural[what] if n != 1 else what}" for what, n in counts.items()]
    drawn = sum(parameter.distribution is not None for parameter in scene.parameters.values())
    return f"{scene.name}: {', '.join(parts)}, {mechanism.n_dofs} unknowns, {counted(drawn, 'uncertain parameter')}"


@dataclass
class _Job:
    """The steps of one run; each is collective on the call's ranks."""

    comm: Comm
    path: Path
    scene: Scene
    meshes: Mapping[str, BodyShape]
    kinematics: RigidKinematics
    steps: Steps
    key: str
    force: bool
    settings: tuple[str, ...]
    overrides: tuple[str, ...]
    files: list[Path] = field(default_factory=list)  # what is there for the report
    failures: list[str] = field(default_factory=list)  # what went wrong although the job went on

    @property
    def changes(self) -> str:
        """How the scene's file is changed by options, for people; empty where it is not."""
        return " ".join([*(f"--set {text}" for text in self.settings), *(f"--override {t}" for t in self.overrides)])

    @property
    def flexible(self) -> bool:
        return any(body.flexible for body in self.scene.bodies.values())

    @property
    def model(self) -> str:
        """The model that runs and samples are of."""
        return self._not_reduced[0] if self.why_not_reduced else "reduced"

    @cached_property
    def _not_reduced(self) -> tuple[str, str]:
        """The model in place of the reduced one, and why it is the full-order one where component modes would do."""
        refused = not self.flexible or why_refused(self.scene, Purpose.COMPONENTS, self.meshes)
        if refused or why_of_one_mesh(self.scene, uncertain_names(self.scene)):
            return "full", ""
        model, why = quicker(prospects(self.scene, self.meshes, self.kinematics.mechanism, 0, 0), "components")
        return model or "components", why

    @cached_property
    def why_not_reduced(self) -> str:
        """Why there is no reduced model; empty where there is one."""
        if not self.flexible:
            return "all bodies are rigid"
        if why_no_grid(self.scene, self.kinematics.mechanism):
            return f"{len(self.scene.coordinates)} coordinates"
        return why_refused(self.scene, Purpose.BUILD, self.meshes) or why_no_family(self.scene, self.meshes)

    @property
    def n_steps(self) -> float:
        return self.scene.simulation.duration / self.scene.simulation.step

    def build(self) -> None:
        def make(target: Path, resume: bool) -> None:
            build(
                self.path, parameters=self.settings, overrides=self.overrides, output=target, resume=resume,
                on_all_ranks=False, comm=self.comm,
            )  # fmt: skip

        if self.model == "reduced":
            try:
                return self._step("build", ROM, (), make, budget.headline_of_build)
            except NotFollowed as error:
                self.why_not_reduced = str(error)
        model, why = self._not_reduced
        instead = f"{'full-order' if model == 'full' else 'component'} model{f', as {why}' if why else ''}"
        self._say("build", f"left out: no reduced model ({self.why_not_reduced}); runs are of the {instead}")

    def simulate(self) -> None:
        def make(target: Path, resume: bool) -> None:
            simulate(**self._source(self.model, with_settings=True), output=target, on_all_ranks=False, comm=self.comm)

        self._step("simulate", RUN, (self._made_from(),), make, budget.headline_of_run)

    def compare(self) -> None:
        """Run a better model of the same case, where that is affordable."""
        if self.model == "full":
            self._say("compare", "left out: the run is full-order; there is no better model")
            return
        known, headline = (self._made_from(),), partial(budget.headline_of_comparison, self._of(RUN))
        if self._is_finished(BETTER, known):  # what the better model takes need not be known
            self._take("compare", BETTER, headline, again=True)
            return
        try:
            better = self._better()
        except InputError as error:
            self._say("compare", f"left out: {str(error).removeprefix('compare: ')}")
            return
        if better is None:
            return
        self._say("compare", better.why)

        def make(target: Path, resume: bool) -> str:
            why = self._run_full(better.model, target)
            return f"{why}; {target}, which the run is compared with, holds it up to there" if why else ""

        self._step("compare", BETTER, known, make, headline)

    def refine(self) -> None:
        """Run the better model on other meshes, for the mesh's share: lines with twice the elements, or parts of CAD
        with larger cells; where these are all that deforms, and it is affordable."""
        flexible = [name for name, body in self.scene.bodies.items() if body.flexible]
        lines = {name: mesh for name, mesh in self.meshes.items() if isinstance(mesh, LineMesh)}
        solids = [name for name in flexible if name not in lines]
        given = [name for name in solids if not self.scene.bodies[name].of_cad]
        own = next((self._of(name) for name in (BETTER, RUN) if self._of(name) in self.files), None)
        kind = None if own is None else on_root(self.comm, lambda: Trajectory.read(own, frame=0).model)
        if not flexible:
            return self._say("mesh", "left out: no body deforms")
        if given:
            why = (
                f"cells of a file are not cut: {', '.join(given)}; simulate with --override bodies.{given[0]}.mesh=FILE"
            )
            return self._say("mesh", f"left out: {why}, and give the report both runs")
        if kind not in ("full", "components") or (not solids and kind == "components"):
            return self._say("mesh", "left out: no run of the mesh to compare with")
        name, headline = COARSER if solids else FINER, partial(budget.headline_of_meshes, own)
        if self._is_finished(name, ()):
            return self._take("mesh", name, headline, again=True)
        if solids:
            with doing("coarser mesh"):
                others = coarser_parts(self.scene, self.comm)
        else:
            others = {name: refined(mesh, 2) for name, mesh in lines.items()}
        meshes = dict(self.meshes) | others
        if kind == "components":
            model = component_model(self.scene, meshes, self.comm)
        else:
            with agreed(self.comm, "preparing the other mesh"):
                model = FullModel(self.scene, meshes)
        price = Price.of(model.kinematics.mechanism, self.n_steps, True)
        if price.seconds > (limit := self.scene.reference.budget):
            self._say("mesh", f"left out: it is predicted to take {price}, and reference.budget = {limit:g} s")
            return None

        return self._step("mesh", name, (), lambda target, _: self._run_full(model, target), headline)

    def _run_full(self, model: FullModel, target: Path) -> str:
        """Run a model on meshes, write the trajectory, and return why it stopped; empty where it did not."""
        with keeping("trajectory", self.comm, target, False, (self.path,)) as keeper:
            settled_model, _ = settled(model, self.comm)
            data = simulated(settled_model, self.comm)
            keeper.result(data, self.scene)
        return self.comm.bcast("" if data is None else data.why_stopped)

    def _better(self) -> Reference | None:
        """Return the model to compare with; None, after saying why, where the mesh is too costly for component runs."""
        comm, demand = self.comm, Demand(
            "compare", self.n_steps, "all runs", "or shorten simulation.duration", self.scene.reduction.modes,
            by_itself=True,
        )  # fmt: skip
        if self.model == "reduced":
            return choose_reference(self.scene, self.meshes, self.kinematics, demand, comm)
        missing = why_no_full_model(self.scene)
        if missing:
            raise InputError(missing)
        limit = self.scene.reference.budget
        with agreed(comm, "preparing the full-order model"):
            mesh = FullModel(self.scene, self.meshes, self.kinematics)
            price = Price.of(mesh.kinematics.mechanism, self.n_steps, True)
        text = f"the mesh: its run is predicted to take {price} of processor time"
        if price.seconds > limit:
            self._say("compare", f"left out: {text}, and reference.budget = {limit:g} s")
            return None
        return Reference(mesh, price, f"{text}, within reference.budget = {limit:g} s", {})

    def sample(self, n_samples: int, seed: int) -> None:
        if not any(parameter.distribution is not None for parameter in self.scene.parameters.values()):
            self._say("ensemble", "left out: no parameter has a distribution")
            return
        if self.model != "reduced" and not self._affordable(n_samples):
            return
        may_differ = self.model == "reduced" and self.scene.reduction.tolerance is None  # which chose the reduced one
        model, why = self._quicker() if may_differ else (self.model, "")
        if why:
            self._say("ensemble", f"of the model with the quicker steps: {why}")

        def make(target: Path, resume: bool) -> str:
            found = montecarlo(
                n=n_samples, seed=seed, output=target, resume=resume, on_all_ranks=False, comm=self.comm,
                **self._source(model, with_settings=False),
            )  # fmt: skip
            failed = self.comm.bcast(found.data is not None and bool(found.status.any()))
            return f"some samples failed; {target} says which" if failed else ""

        known = (self._made_from(), n_samples, seed, *([model] if why else []))

        def headline(path: Path) -> str:
            return budget.headline_of_ensemble(path, *(file for file in self.files if file.name != ROM))

        self._step("ensemble", MANY, known, make, headline)

    def _quicker(self) -> tuple[str, str]:
        """Return the model that samples are of where there is a reduced one, and why if it is another."""

        def found() -> tuple[str, str]:
            n_flexible = ReducedOrderModel.read(self._of(ROM)).tables.n_modes
            models = prospects(self.scene, self.meshes, self.kinematics.mechanism, n_flexible, 0)
            model, why = quicker(models, "reduced")
            # nobody estimates the error of component modes, so that they decide no probability
            decides = self.scene.ensemble.probabilities and is_estimated(self.scene)
            keeps = not model or (model == "components" and decides)
            return ("reduced", "") if keeps else (model, why)

        return on_root(self.comm, found)

    def _affordable(self, n_samples: int) -> bool:
        """Say what samples of a model that is not reduced will take, and whether they are within the budget."""
        comm, limit = self.comm, self.scene.reference.budget
        if self.model == "components":
            mechanism = component_model(self.scene, self.meshes, comm, None, self.kinematics).kinematics.mechanism
        else:
            mechanism = self.kinematics.mechanism
        price = Price.of(mechanism, self.n_steps * n_samples)
        price = replace(price, step=step_of_samples(self.scene, price.step, mechanism.bodies))
        text = f"{n_samples} samples are predicted to take {price} of processor time, reference.budget = {limit:g} s"
        fine = price.seconds <= limit
        self._say("ensemble", text if fine else f"left out: {text}; take fewer with -n, or raise it")
        return fine

    def write_report(self, page: Path) -> None:
        """Write the page of all files that are there."""
        from pgmp_petsc.report.page import write_report

        on_root(self.comm, self.steps.check_files, [file.name for file in self.files])
        with doing("report"):
            lines = on_root(self.comm, write_report, self.files, page)
        for line in lines:
            self._say("report", line)

    def _step(
        self, title: str, name: str, known: tuple, make: Callable[[Path, bool], str | None],
        headline: Callable[[Path], str],
    ) -> None:  # fmt: skip
        """Make a file unless it is finished, and say in a line what is in it; `make` returns what went wrong."""
        comm, target = self.comm, self._of(name)
        if self._is_finished(name, known):
            self._take(title, name, headline, again=True)
            return
        key = self._key(name, known)
        resume = not self.force and on_root(comm, self.steps.was_begun, name, key)
        self._say_what_is_replaced(title, name)
        on_root(comm, self.steps.begin, name, key, self.changes)
        try:
            with untold(), doing(title):
                failure = make(target, resume) or ""
        except RunError as error:
            # a run that stopped early has its file, which the report shows
            if not on_root(comm, self._is_written, target):
                raise
            failure = str(error)
        on_root(comm, self.steps.finish, name, key, failure)
        self._take(title, name, headline, again=False)

    def _say_what_is_replaced(self, title: str, name: str) -> None:
        """Say whose file a step is going to replace, unless the same is asked for again with --force."""
        before = on_root(self.comm, self.steps.replaced, name)
        if before is None or (self.force and before == self.changes):
            return
        whose = before or "the scene without options"
        if before == self.changes:
            whose = "an earlier state of the scene, its meshes or the number of samples"
        self._say(title, f"replaces {self._of(name)} of {whose}; -o FOLDER keeps both")

    def _key(self, name: str, known: tuple) -> str:
        """Return the checksum of what a file is made from: the scene, its meshes, and what else is known."""
        return identity(self.key, name, known)

    def _is_finished(self, name: str, known: tuple) -> bool:
        """Return whether a file of an earlier run may be taken."""
        return not self.force and on_root(self.comm, self.steps.is_finished, name, self._key(name, known))

    def _take(self, title: str, name: str, headline: Callable[[Path], str], again: bool) -> None:
        """Keep a file for the report, and say in a line what is in it."""
        target = self._of(name)
        self.files.append(target)
        failure = on_root(self.comm, self.steps.failure, name)
        self.failures += [failure] if failure else []
        ahead = " (finished before; --force does it again)" if again else ""
        with doing(title):
            said = on_root(self.comm, headline, target)
        self._say(title, f"{said} -> {target}{ahead}")

    def _is_written(self, target: Path) -> bool:
        """Return whether the step that failed left its file, which is newer than its note in the ledger."""
        return target.exists() and target.stat().st_mtime_ns >= self._of(LEDGER).stat().st_mtime_ns

    def _source(self, model: str, with_settings: bool) -> dict[str, object]:
        if model == "reduced":
            return {"source": self._of(ROM)}
        settings = self.settings
        if not with_settings:  # what is drawn has none
            drawn = uncertain_names(self.scene)
            settings = tuple(one for one in settings if one.partition("=")[0].strip() not in drawn)
        return {"source": self.path, "model": model, "parameters": settings, "overrides": self.overrides}

    def _made_from(self) -> str:
        """Return the checksum of the reduced model that a step runs; empty where there is none."""
        return on_root(self.comm, self.steps.checksum, ROM) if self.model == "reduced" else ""

    def _of(self, name: str) -> Path:
        return self.steps.folder / name

    def _say(self, title: str, text: str) -> None:
        tell(self.comm, f"{title:10s} {text}")
