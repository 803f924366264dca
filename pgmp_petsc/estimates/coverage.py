"""Which errors are not estimated, and why: every run without an estimate says so."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from pgmp_petsc.bodies.shape import lacks_foreshortening
from pgmp_petsc.estimates.coarser_run import FEWEST_STEPS, MOST, CoarserRun, StepErrors
from pgmp_petsc.mechanism.capabilities import comparing, why_no_full_model
from pgmp_petsc.mechanism.kinematics import MOST_COORDINATES
from pgmp_petsc.models import ComponentModel, FullModel, LengthLanes, ReducedModel, SeparateLengths
from pgmp_petsc.results.estimates import EstimatedErrors
from pgmp_petsc.results.numbers import share_text
from pgmp_petsc.runtime.errors import Remark, note, warning
from pgmp_petsc.scene import Scene
from pgmp_petsc.stepping.status import Status

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
SMALL = 0.01  # estimated error as a share of an output's largest value, up to which it is no harm that it is unsure
LARGE = 0.05  # estimated error as a share of an output's largest value, from which on a run warns of it


def is_estimated(scene: Scene) -> bool:
    """Return whether the errors of a scene's runs are estimated."""
    return scene.simulation.error_indicator and bool(scene.outputs)


def absence_of_estimates(scene: Scene, ensemble: bool = False, of_step: bool = False) -> tuple[Remark, ...]:
    """Return why the errors of a scene's run or ensemble are not estimated; nothing where they are.

    Those of a reduced model, or, `of_step`, of the time step of another one.
    """
    what, cure = ("errors of the time step", "compare with a smaller simulation.step") if of_step else ("errors", "")
    cure = cure or comparing(scene)
    if not scene.outputs:
        return (note(f"{what} were not estimated: the scene has no [outputs], whose errors these would be"),)
    if not scene.simulation.error_indicator:
        switch = "simulation.error_indicator = false"
    elif ensemble and scene.ensemble.checked_share == 0.0:
        switch = "ensemble.checked_share = 0"
    else:
        return ()
    return (note(f"{what} were not estimated: {switch} switches the estimate off; {cure}"),)


def few_steps(n_steps: int) -> tuple[Remark, ...]:
    """Return that estimates of a run of so few steps are unsure, and the cure; nothing where the steps are enough."""
    if n_steps >= FEW_STEPS:
        return ()
    return (
        note(
            "estimated errors are unsure, and may be many times too small or too large: the run has "
            f"{n_steps} steps, estimates want {FEW_STEPS} or more; take a smaller simulation.step"
        ),
    )


def too_few_steps(n_steps: int) -> tuple[Remark, ...]:
    """Return that a full-order or component run has too few steps for an estimate; nothing where they are enough."""
    if n_steps >= FEWEST_STEPS:
        return ()
    return (
        warning(
            f"errors of the time step were not estimated: the run has {n_steps} steps, the estimate needs "
            f"{FEWEST_STEPS} or more; take a smaller simulation.step"
        ),
    )


def large_errors(
    errors: Mapping[str, np.ndarray], sizes: Mapping[str, np.ndarray], model: str = "reduced"
) -> tuple[Remark, ...]:
    """Return a warning of outputs whose estimated errors are large, in any of some runs.

    Parameters
    ----------
    errors, sizes
        Largest error, and largest size, of every output in each run, shape (n_runs,); NaN where they are not known.
    model
        What runs are of.
    """
    found = []
    for name, values in errors.items():
        runs = np.flatnonzero(np.isfinite(values) & (sizes[name] > 0.0))
        shares = values[runs] / sizes[name][runs]
        n_large = int(np.sum(shares > LARGE))
        if n_large:
            worst = int(np.argmax(shares))
            share, size = float(shares[worst]), float(sizes[name][runs[worst]])
            text = share_text(share) if share <= 1.0 else f"more than all of it ({size:.2g})"
            many = f" at most, beyond {share_text(LARGE)} in {n_large} of {runs.size}"
            found.append(f"{name} {text}{many if values.size > 1 else ''}")
    if not found:
        return ()
    of = " of the samples that are checked" if any(values.size > 1 for values in errors.values()) else ""
    return (
        warning(
            f"large estimated errors{OF_MODEL[model]}{of}, as shares of the largest values over the run: "
            f"{', '.join(found)}; {SMALLER_ERRORS[model]}"
        ),
    )


def step_remarks(
    model: FullModel,
    time: np.ndarray,
    outputs: Mapping[str, np.ndarray],
    other: CoarserRun,
    errors: StepErrors | None,
) -> list[Remark]:
    """Return what is to be said of the estimated errors of a run's time step.

    Parameters
    ----------
    time, outputs
        Of the run, shape (n_t,), s, and each of the same shape.
    other, errors
        The run with the coarser step, and what it tells; None where it tells nothing.
    """
    with_step = f"a run with a step of {other.step:.3g} s, which these errors are taken from,"
    why = f"would take more than {100 * MOST:g} % of the run's own price, and was given up"
    if other.status[0] != Status.FINE:
        why = f"stopped at {other.failure_time[0]:.4g} s ({Status(other.status[0]).meaning})"
    if errors is None:
        if too_few_steps(time.size - 1):
            return list(too_few_steps(time.size - 1))
        return [
            warning(
                f"errors of the time step were not estimated: {with_step} {why}; compare with half the step "
                f"(--override simulation.step={0.5 * model.scene.simulation.step:.3g})"
            )
        ]
    remarks = []
    if errors.time[-1] < time[-1] * (1.0 - 1e-9):
        remarks.append(
            warning(
                f"errors of the time step were estimated up to {errors.time[-1]:.4g} s of {time[-1]:.4g} s: "
                f"{with_step} {why}; later ones may be larger, take a smaller simulation.step"
            )
        )
    if np.isfinite(errors.lost_hz):
        remarks.append(
            warning(
                f"the time step of {time[1] - time[0]:.3g} s does not follow a vibration at about {errors.lost_hz:.3g} "
                "Hz over the run: its phase is lost; take a smaller simulation.step, or damp it"
            )
        )
    if errors.unsure:
        large = (np.abs(found).max() > SMALL * np.abs(outputs[name]).max() for name, found in errors.outputs.items())
        say = warning if any(large) else note
        remarks.append(
            say(
                "estimated errors of the time step are unsure, and may be several times too small or too large: "
                f"{errors.unsure}; compare with a smaller simulation.step"
            )
        )
    return remarks


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
    at = ", ".join(f"{name} = {value:.6g}" for name, value in check.values.items())
    contained = "estimated errors of samples contain what they are off by; " if estimated else ""
    return note(
        f"{', '.join(model.lengths)}: tables and outputs are polynomials through those of {len(model.members)} "
        f"mechanisms; {contained}at {at}, between these, frequencies are within {check.frequencies:.2g} and the rigid "
        f"inertia within {check.inertia:.2g} of a model built there"
    )


def left_out_of_estimates(model: ReducedModel | LengthLanes) -> tuple[Remark, ...]:
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
        return ()
    return (
        note(
            f"estimated errors leave out what is of second order in the deformation of {', '.join(found)}; where it "
            f"bends much, {comparing(scene)}"
        ),
    )


def truncated_stresses(scene: Scene) -> tuple[Remark, ...]:
    """Return what a reduced basis leaves out of stresses, where outputs ask for these; nothing where it has it all."""
    keys = [key for key in ("static_modes", "inertia_modes") if not getattr(scene.reduction, key)]
    names = [f"outputs.{name}" for name, output in scene.outputs.items() if output.reads == "stresses"]
    if not (keys and names):
        return ()
    missing = {"static_modes": "loads", "inertia_modes": "inertia forces"}
    return (
        note(
            f"{', '.join(names)}: stresses of {scene.reduction.modes} modes lack the static answers to "
            f"{' and '.join(missing[key] for key in keys)} beyond these; build with "
            f"{' and '.join(f'reduction.{key} = true' for key in keys)}"
        ),
    )


def why_not_of_full_order(model: FullModel | SeparateLengths) -> tuple[Remark, ...]:
    """Return which errors of full-order and component runs are not estimated, and what measures them."""
    scene = model.scene
    if isinstance(model, SeparateLengths):
        return (note("errors of the mesh were not estimated: each sample has a mesh of its own lengths"),)
    if isinstance(model, ComponentModel):
        counts = ", ".join(f"{n} of {name}" for name, n in model.n_amplitudes.items())
        return (
            note(
                f"errors of the component modes ({counts}) were not estimated; take more reduction.modes, or "
                f"{comparing(scene)}"
            ),
            note(_left_out(scene)),
            *_condensed_alone(model),
        )
    cure = "pgmp tradeoff measures them"
    if len(scene.coordinates) > MOST_COORDINATES or any(body.element != "beam2d" for body in scene.bodies.values()):
        cure = "compare with a finer mesh"
    return (note(f"errors of the mesh were not estimated; {cure}"),)


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


def _condensed_alone(model: ComponentModel) -> tuple[Remark, ...]:
    """Return that ranks did not share bodies, where there were several ranks."""
    n_bodies = len(model.n_amplitudes)
    if model.n_ranks == 1:
        return ()
    idle = max(0, model.n_ranks - n_bodies)
    waited = f", and {idle} of {model.n_ranks} ranks had none" if idle else ""
    return (
        note(
            f"each of the {n_bodies} flexible bodies was condensed by one rank in its own memory{waited}; bodies too "
            "large for that need pgmp build, which shares each of them"
        ),
    )
