"""Effect of a reduced model's own error on a figure: statistics, derivatives, designs and fits.

Errors are estimates e = reduced less full-order (`error_indicator`), so that y - e is what the full-order model would
have given: of a figure F the model's own part is about ``F(y) - F(y - e)``. From `COMPARABLE` of a figure on it is
printed beside the figure.

Which errors are not estimated, and why: every run without an estimate says so.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING

import numpy as np

from pgmp_petsc.base.errors import Remark, counted, gathered, note, warning
from pgmp_petsc.base.units import SI, Units, UnitSystem, behind
from pgmp_petsc.bodies.shape import lacks_foreshortening
from pgmp_petsc.estimates.coarser_run import MOST, CoarserRun, StepErrors, fewest_steps, relied_on, times_of
from pgmp_petsc.mechanism.capabilities import comparing, why_no_full_model
from pgmp_petsc.mechanism.kinematics import MOST_COORDINATES
from pgmp_petsc.models import ComponentModel, FullModel, SeparateLengths
from pgmp_petsc.outputs.multipliers import joints_of, judged
from pgmp_petsc.results.estimates import ANSWERS, LARGE, EstimatedErrors
from pgmp_petsc.results.numbers import Arrays, felt, misaligned, nothing, number_text, share_text, sizes_of, with_unit
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.outputs import after_start
from pgmp_petsc.scene.units import values_text
from pgmp_petsc.stepping.status import Status

if TYPE_CHECKING:
    from pgmp_petsc.models import LengthLanes, Reduced

# steps of a run below which its estimates are unsure: the first steps are integrated with the order of the scheme
# itself, and what they do wrong is a good part of the error of a few (docs/method.md, "where it is less good")
FEW_STEPS = 10
OF_MODEL = {"reduced": "", "full": " of the time step", "components": " of the time step"}
SMALLER_ERRORS = {
    "reduced": "a smaller simulation.step (or simulation.tolerance) or a better basis (reduction.tolerance) makes them "
    "smaller, and pgmp tradeoff measures which of them does",
    "full": "take a smaller simulation.step, or leave it out and name a simulation.tolerance",
}
SMALLER_ERRORS["components"] = SMALLER_ERRORS["full"]
FIRST_ORDER = (
    "act in first order, which no basis makes better: compare with the full-order run (pgmp simulate SCENE --full)"
)
BRIEFLY = 0.5  # of a run, up to which a vibration that is lost is a shock that fades
SMALL = 0.01  # estimated error as a share of an output's largest value, up to which it is no harm that it is unsure
NEGLIGIBLE = 1e-6  # of the largest output of its unit: an error as small of an output that vanishes is none


def is_estimated(scene: Scene, of_step: bool = False) -> bool:
    """Return whether the errors of a scene's runs are estimated: those of a reduced model, or, `of_step`, of the time
    step of another one."""
    known = not of_step or times_of(scene, scene.simulation) > 1
    return scene.simulation.error_indicator and bool(scene.outputs) and known


def absence_of_estimates(scene: Scene, ensemble: bool = False, of_step: bool = False) -> tuple[Remark, ...]:
    """Return why the errors of a scene's run or ensemble, or `of_step` those of its time step, are not estimated;
    nothing where they are."""
    what, cure = ("errors of the time step", "compare with a smaller simulation.step") if of_step else ("errors", "")
    cure = cure or comparing(scene)
    if not scene.outputs:
        return (note(f"{what} were not estimated: the scene has no [outputs], whose errors these would be"),)
    if of_step and times_of(scene, scene.simulation) == 1:
        words = "the estimate takes a coarser step, which would miss samplings of controllers"
        return (note(f"{what} were not estimated: {words}; {cure}"),)
    if not scene.simulation.error_indicator:
        switch = "simulation.error_indicator = false"
    elif ensemble and scene.ensemble.checked_share == 0.0:
        switch = "ensemble.checked_share = 0"
    else:
        return ()
    return (note(f"{what} were not estimated: {switch} switches the estimate off; {cure}"),)


@gathered
def few_steps(n_steps: int) -> Iterator[Remark]:
    """Return that estimates of a run of so few steps are unsure, and the cure; nothing where the steps are enough."""
    if n_steps < FEW_STEPS:
        yield note(
            "estimated errors are unsure, and may be many times too small or too large: the run has "
            f"{n_steps} steps, estimates want {FEW_STEPS} or more; take a smaller simulation.step"
        )


@gathered
def too_few_steps(n_steps: int, scene: Scene) -> Iterator[Remark]:
    """Return that a full-order or component run of a scene has too few steps for an estimate; nothing where they are
    enough."""
    fewest = fewest_steps(times_of(scene, scene.simulation))
    if n_steps < fewest:
        yield warning(
            f"errors of the time step were not estimated: the run has {n_steps} steps, the estimate needs "
            f"{fewest} or more; take a smaller simulation.step"
        )


NOT_CONVERGED = ". What is wrong by more than all of it has not converged"
BY_IMPACTS = (
    ": where impacts make every small difference larger, as in joints with clearance, no step may be small enough, and "
    "statistics of many samples (pgmp montecarlo) are all that is known"
)


@gathered
def large_errors(
    errors: Arrays, sizes: Arrays, units: Units, model: str, scene: Scene, length: float = 0.0
) -> Iterator[Remark]:
    """Return a warning of outputs whose estimated errors are large, in any of some runs of a model.

    Largest errors, and largest sizes, of every output have shape (n_runs,); NaN where they are not known. Sizes are
    said in units of the scene; of an output that vanishes, the error itself. Displacements vanish beside a length of
    the mechanism too, components of what a joint carries beside the others, and so do their errors. Where joints of the
    scene have clearance, impacts may be why.
    """
    system, loose, joints = scene.system, bool(scene.loose), joints_of(scene)
    found, beside, none = [], sizes_of(sizes, units, length), nothing(sizes, units, length)
    in_joints, sizes = misaligned(sizes, units, joints), felt(sizes, units, length, joints)
    for name, values in errors.items():
        size, least = sizes[name], max(NEGLIGIBLE * beside[name], none[name])
        some = np.isfinite(values) & ((values > in_joints[name]) | (in_joints[name] == 0.0))
        runs = np.flatnonzero(some & ((size > 0.0) | ((size == 0.0) & (values > least) & (least > 0.0))))
        shares = np.divide(values[runs], size[runs], where=size[runs] > 0.0, out=np.full(runs.size, np.inf))
        n_large = int(np.sum(shares > LARGE))
        if n_large:
            worst = int(np.argmax(shares))
            share, whole = float(shares[worst]), system.named(float(size[runs[worst]]), units[name])
            text = share_text(share) if share <= 1.0 else f"more than all of it ({with_unit(*whole, 2)})"
            if np.isinf(share):
                lack = system.named(float(values[runs[worst]]), units[name])
                text = f"all of it ({with_unit(*lack, 2)}, where the run has none)"
            many = f" at most, beyond {share_text(LARGE)} in {n_large} of {runs.size}"
            found.append(f"{name} {text}{many if values.size > 1 else ''}")
    if not found:
        return
    of = " of the samples that are checked" if any(values.size > 1 for values in errors.values()) else ""
    known = {None: 1.0, **scene.values}  # of one run; offsets of 0 are none there, in samples they differ
    offsets = {name: joint.offset for name, joint in scene.joints.items() if joint.offset}
    off = [f"joints.{name}.offset" for name, one in offsets.items() if of or one.part(known).has(None)]
    beyond = f"; {', '.join(off)} {FIRST_ORDER}" if off and model == "reduced" else ""
    lost = NOT_CONVERGED + BY_IMPACTS * loose if any(" more than all of it" in one for one in found) else ""
    yield warning(
        f"large estimated errors{OF_MODEL[model]}{of}, as shares of the largest values over the run: "
        f"{', '.join(found)}; {SMALLER_ERRORS[model]}{beyond}{lost}"
    )


@gathered
def largest_at_start(scene: Scene, outputs: Arrays, units: Units) -> Iterator[Remark]:
    """Return which outputs (n_t,) of a run are largest at the start, where they are not judged."""
    system, told = scene.system, []
    sizes = {name: np.max(np.abs(values)) for name, values in judged(scene, outputs).items()}
    largest = felt(sizes, units, joints=joints_of(scene))
    late = after_start(scene)
    for name in late:
        start, later = abs(float(outputs[name][0])), float(largest[name])
        if start > (1.0 + SMALL) * later > 0.0 and name not in scene.counted:
            both = (with_unit(*system.named(one, units[name]), 3) for one in (start, later))
            told.append("{} ({}, later {} at most)".format(name, *both))
    if told:
        counted = ", but cycles are counted from time 0" if {*late} & {*scene.counted} else ""
        yield warning(
            f"largest at time 0: {', '.join(told)}. What joints carry where bodies start undeformed hangs there on the "
            "mesh and on modes alone: estimated errors, and extremes, events and bands of ensembles, begin with the "
            f"next instant{counted}; start with initial.equilibrium = true, or let loads grow from zero"
        )


@gathered
def step_remarks(
    model: FullModel, time: np.ndarray, outputs: Arrays, other: CoarserRun, errors: StepErrors | None
) -> Iterator[Remark]:
    """Return what is to be said of the estimated errors of a run's time step, None where the run with the coarser step
    tells nothing; times, s, and outputs, those that are more than round-off, have shape (n_t,)."""
    with_step = f"a run with a step of {other.step:.3g} s, which these errors are taken from,"
    most = MOST / round(other.step / float(time[1] - time[0]))
    why = f"would take more than {100 * most:.3g} % of the run's own price, and was given up"
    if other.status[0] != Status.FINE:
        why = f"stopped at {other.failure_time[0]:.4g} s ({Status(other.status[0]).meaning})"
    if runs_away := relied_on(model.scene, time, outputs, other)[1]:
        why = f"ran away from this one by itself (outputs.{runs_away})"
    elif np.isfinite(other.until[0]):
        why = f"failed in most of its steps from {other.until[0]:.4g} s on"
    if errors is None:
        half = f"compare with half the step (--override simulation.step={0.5 * float(time[1] - time[0]):.3g})"
        unknown = warning(f"errors of the time step were not estimated: {with_step} {why}; {half}")
        yield from too_few_steps(time.size - 1, model.scene) or (unknown,)
        return
    if errors.time[-1] < time[-1] * (1.0 - 1e-9):
        yield warning(
            f"errors of the time step were estimated up to {errors.time[-1]:.4g} s of {time[-1]:.4g} s: "
            f"{with_step} {why}; later ones may be larger, take a smaller simulation.step"
        )
    if np.isfinite(errors.lost_hz):
        begin, end = errors.lost_within
        part, cure = (
            f"from {begin:.3g} s to {end:.3g} s",
            "let what sets it off, such as a start at once, set in slowly",
        )
        if end - begin > BRIEFLY * errors.time[-1]:
            part, cure = "over the run", "damp it"
        yield warning(
            f"the time step of {time[1] - time[0]:.3g} s does not follow a vibration at about {errors.lost_hz:.3g} "
            f"Hz {part}: its phase is lost; take a smaller simulation.step, or {cure}"
        )
    if errors.unsure:
        sizes = {name: np.abs(values).max() for name, values in outputs.items()}
        large = (np.abs(errors.outputs[name]).max() > SMALL * size for name, size in sizes.items())
        say = warning if any(large) else note
        yield say(
            "estimated errors of the time step are unsure, and may be several times too small or too large: "
            f"{errors.unsure}; compare with a smaller simulation.step"
        )


def not_estimated(errors: EstimatedErrors, scene: Scene) -> list[Remark]:
    """Return which outputs have no estimate although the scene's errors can be estimated, and why."""
    return [
        note(
            f"errors were not estimated for {', '.join(name for name, why in errors.absent.items() if why == reason)}: "
            f"{reason}; {comparing(scene)}"
        )
        for reason in dict.fromkeys(errors.absent.values())
    ]


def polynomials_of_lengths(model: LengthLanes, estimated: bool) -> Remark:
    """Return what is between a model of any lengths and those that were built, and whether estimates hold it."""
    check = model.check
    at = values_text(model.scene, model.checked)
    contained = "estimated errors of samples contain what they are off by; " if estimated else ""
    return note(
        f"{', '.join(model.lengths)}: tables and outputs are polynomials through those of {len(model.members)} "
        f"mechanisms; {contained}at {at}, between these, frequencies are within {check.frequencies:.2g} and the rigid "
        f"inertia within {check.inertia:.2g} of a model built there"
    )


@gathered
def left_out_of_estimates(model: Reduced) -> Iterator[Remark]:
    """Return which condensed bodies are checked without what is of second order in their deformation, and the cure."""
    scene, found = model.scene, []
    for name, shape in model.meshes.items():
        if not lacks_foreshortening(shape):
            continue
        why = "it was built with simulation.error_indicator = false, or it is not slender"
        if scene.bodies[name].section_scale is not None:
            why = "its cross-section is scaled"
        elif scene.bodies[name].matrices is not None:
            why = "its matrices do not tell it"
        found.append(f"bodies.{name} ({why})")
    if not found or not is_estimated(scene):
        return
    yield note(
        f"estimated errors leave out what is of second order in the deformation of {', '.join(found)}; where it "
        f"bends much, {comparing(scene)}"
    )


@gathered
def truncated_stresses(scene: Scene) -> Iterator[Remark]:
    """Return what a reduced basis leaves out of stresses, where outputs ask for these; nothing where it has it all."""
    keys = [key for key in ANSWERS if not getattr(scene.reduction, key)]
    names = [f"outputs.{name}" for name, output in scene.outputs.items() if "stresses" in output.reads]
    if not (keys and names):
        return
    yield note(
        f"{', '.join(names)}: stresses of {scene.reduction.modes} modes lack the static answers to "
        f"{' and '.join(ANSWERS[key] for key in keys)} beyond these; build with "
        f"{' and '.join(f'reduction.{key} = true' for key in keys)}"
    )


def why_not_of_full_order(model: FullModel | SeparateLengths) -> tuple[Remark, ...]:
    """Return which errors of full-order and component runs are not estimated, and what measures them.

    There are none where no body deforms.
    """
    scene, is_separate = model.scene, isinstance(model, SeparateLengths)
    model = model.model if is_separate else model
    if not any(body.flexible for body in scene.bodies.values()):
        return ()
    if isinstance(model, ComponentModel):
        counts = ", ".join(f"{n} of {name}" for name, n in model.n_amplitudes.items())
        return (
            note(
                f"errors of the component modes ({counts}) were not estimated; take more reduction.modes, or "
                f"{comparing(scene)}"
            ),
            note(_left_out(scene)),
            *condensed_alone(model),
        )
    if is_separate:
        return (note("errors of the mesh were not estimated: each sample has a mechanism of its own"),)
    cure = "pgmp tradeoff measures them"
    if len(scene.coordinates) > MOST_COORDINATES or any(
        body.kind not in ("beam2d", "rigid") for body in scene.bodies.values()
    ):
        cure = "compare with a finer mesh"
    return (note(f"errors of the mesh were not estimated in the run itself; {cure}"),)


def _left_out(scene: Scene) -> str:
    """Return what of second order in the deformation component modes leave out, and the cure."""
    what = "left out: what is of second order in the deformation of a body in its floating frame"
    if scene.static_stiffening:
        return f"{what}, but for the foreshortening of bodies that bend and what follows from it (geometric_stiffening)"
    missing = why_no_full_model(scene)
    if missing:
        return f"{what} (stiffening by loads, foreshortening), which matrices do not tell; {comparing(scene)}"
    return (
        f"{what} (stiffening by loads, foreshortening); the effects geometric_stiffening and mode_inertia add these, a "
        "full-order run has it all"
    )


@gathered
def condensed_alone(model: ComponentModel) -> Iterator[Remark]:
    """Return that ranks did not share bodies, where there were several ranks."""
    n_bodies = len(model.n_amplitudes)
    if model.n_ranks == 1:
        return
    idle = max(0, model.n_ranks - n_bodies)
    waited = f", and {idle} of {model.n_ranks} ranks had none" if idle else ""
    yield note(
        f"each of the {n_bodies} flexible bodies was condensed by one rank in its own memory{waited}; bodies too "
        "large for that need pgmp build, which shares each of them"
    )


COMPARABLE = 0.05  # of a figure
MOST_NAMED = 6  # figures of one warning
FEWEST = 5  # checked samples that tell of a deviation
CURE = "a smaller simulation.step or reduction.tolerance makes it smaller"


@gathered
def of_statistics(
    quantities: Iterable[tuple[str, np.ndarray]],
    errors: Arrays,
    fine: np.ndarray,
    units: Units,
    described: tuple[str, str],
    model: str = "reduced",
    system: UnitSystem = SI,
) -> Iterator[Remark]:
    """Return a warning of statistics to which errors are comparable; nothing where none is.

    Values of the samples, shape (N,) each, come by the names of outputs, their estimated errors are NaN but for the
    samples that are checked, and those that are `fine` are described, what goes by the mean, and what by the spread.
    Errors of other models than the reduced one are those of their time step; they are said in units of the system.
    """
    own = "the reduced model", f"{CURE}, and full-order runs (--full) do without it"
    whose, cure = own if model == "reduced" else ("the time step", SMALLER_ERRORS[model])
    told, n_checked = [], 0
    for name, values in quantities:
        if name in errors:
            n_checked = max(n_checked, int(np.sum(fine & np.isfinite(errors[name]) & np.isfinite(values))))
            (of_values, unit), (of_errors, _) = (
                system.named(one, units.get(name, "1")) for one in (values, errors[name])
            )
            told += _of_quantity(name, of_values, of_errors, fine, unit, described)
    if told:
        yield warning(f"{whose}'s own error is a good part of {'; '.join(told)}; {cure}")
    if 0 < n_checked < FEWEST:
        yield note(
            f"what errors of {whose} do to deviations and quantiles is not known well: to see how they vary takes "
            f"{FEWEST} checked samples, and {n_checked} {'is' if n_checked == 1 else 'are'} here; "
            "ensemble.checked_share checks more"
        )


def _of_quantity(
    name: str, values: np.ndarray, errors: np.ndarray, fine: np.ndarray, unit: str, words: tuple[str, str]
) -> Iterator[str]:
    checked = fine & np.isfinite(errors) & np.isfinite(values)
    n = int(checked.sum())
    if not n:
        return
    y, e, all_fine = values[checked], errors[checked], values[fine & np.isfinite(values)]
    spread = float(all_fine.std(ddof=1)) if all_fine.size > 1 else 0.0
    tail, samples = behind(unit), "1 checked sample" if n == 1 else f"{n} checked samples"
    if n >= FEWEST and e.std(ddof=1) > COMPARABLE * y.std(ddof=1):
        yield (
            f"{words[1]} of {name}: {samples} have a deviation of {y.std(ddof=1):.3g}{tail}, and of "
            f"{(y - e).std(ddof=1):.3g}{tail} without the estimated errors"
        )
    elif n < FEWEST and np.abs(e).max() > COMPARABLE * spread > 0.0:
        yield (
            f"{words[1]} of {name}, of {spread:.3g}{tail} ({samples} with errors up to {np.abs(e).max():.3g}{tail}; "
            "ensemble.checked_share checks more)"
        )
    if abs(e.mean()) > COMPARABLE * max(abs(float(all_fine.mean())), spread):
        yield f"{words[0]} of {name}: about {e.mean():+.3g}{tail} of {all_fine.mean():.3g}{tail} ({samples})"


def of_figures(
    figures: Iterable[tuple[str, float, float, float]], sizes: str = "these figures", comparable: float = COMPARABLE
) -> tuple[Remark, ...]:
    """Return a warning of figures to which the error is comparable, the worst ones first, and a note of how small it is
    otherwise.

    Of each figure come what it is, its value, that without the estimated errors, and the size that differences are
    compared with: what that is in words, and the share of it from which on there is a warning.
    """
    shares, told = [0.0], []
    for what, value, without, size in figures:
        share = abs(value - without) / size if size > 0.0 else 0.0
        shares.append(share)
        if share > comparable:
            both = np.array([value, without])
            shown, other = (number_text(one, both, 9) for one in both)
            told.append((share, f"{what}: {shown}, about {other} without the estimated errors"))
    if told:
        named = [text for _, text in sorted(told, key=lambda one: -one[0])[:MOST_NAMED]]
        if len(told) > MOST_NAMED:
            named.append(f"and of {counted(len(told) - MOST_NAMED, 'other')}, by a smaller share")
        return (warning(f"the reduced model's own error is a good part of {'; '.join(named)}; {CURE}"),)
    return (note(f"errors of the reduced model are estimated at up to {share_text(max(shares))} of {sizes}"),)
