"""What is taken of several rigid coordinates and of continuum bodies, and what more coordinates would cost."""

from __future__ import annotations

from pgmp_petsc.mechanism.kinematics import MOST_COORDINATES
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.runtime.errors import InputError
from pgmp_petsc.scene import Scene

BYTES = 8
# of an eigenproblem with 15 modes on one core, measured from 36 to 3006 unknowns
SECONDS, SECONDS_PER_UNKNOWN = 6e-3, 1.6e-5


def check_features(scene: Scene) -> None:
    """Refuse settings for one coordinate where a scene has several, and for beams where it has continuum bodies.

    Raises
    ------
    InputError
        Naming the entry of the scene.
    """
    reduction, simulation = scene.reduction, scene.simulation
    _check_continuum(scene)
    settings = {
        "reduction.second_order": reduction.second_order,
        "reduction.sampling_tolerance": reduction.sampling_tolerance,
        "reduction.tolerance": reduction.tolerance,
        "simulation.tolerance": simulation.tolerance,
    }
    for entry, value in settings.items():
        if value:
            check_single(scene, f"{entry} = {'true' if value is True else format(value, 'g')}")
    for name, effect in scene.effects.items():
        if effect.type == "geometric_stiffening":
            check_single(scene, f"effects.{name}")


def check_beams(scene: Scene, what: str) -> None:
    """Refuse something that is for beams only where a scene has continuum bodies.

    Raises
    ------
    InputError
        Beginning with `what`.
    """
    continuum = [name for name, body in scene.bodies.items() if body.continuum]
    if continuum:
        verb = "is" if len(continuum) == 1 else "are"
        raise InputError(
            f"{what}: for bodies of beams only, but {', '.join(continuum)} {verb} of continuum elements; leave it out"
        )


def _check_continuum(scene: Scene) -> None:
    reduction, simulation = scene.reduction, scene.simulation
    entries = {
        "reduction.second_order = true": reduction.second_order,
        f"reduction.tolerance = {reduction.tolerance}": reduction.tolerance is not None,
        f"simulation.tolerance = {simulation.tolerance}": simulation.tolerance is not None,
        'reduction.effects = "auto"': reduction.effects == "auto",
        **{
            f"effects.{name}": effect.type in ("geometric_stiffening", "mode_inertia")
            for name, effect in scene.effects.items()
        },
    }
    for entry, given in entries.items():
        if given:
            check_beams(scene, entry)


def check_single(scene: Scene, what: str) -> None:
    """Refuse something that is for one coordinate only where a scene has several.

    Raises
    ------
    InputError
        Beginning with `what`.
    """
    n, names = len(scene.coordinates), ", ".join(scene.coordinates)
    if n > 1:
        raise InputError(f"{what}: for one rigid coordinate only, but the scene has {n}: {names}; leave it out")


def check_flexible(scene: Scene) -> None:
    """Refuse a scene without flexible bodies, which has nothing to reduce.

    Raises
    ------
    InputError
        Saying what to do instead.
    """
    if not any(body.flexible for body in scene.bodies.values()):
        raise InputError("bodies: all are rigid, so there is nothing to reduce; run pgmp simulate SCENE --full instead")


def check_count(scene: Scene, mechanism: Mechanism) -> None:
    """Refuse more coordinates than can be sampled.

    Raises
    ------
    InputError
        Saying what the configurations of all coordinates would take.
    """
    n, names = len(mechanism.coordinates), ", ".join(scene.coordinates)
    if n <= MOST_COORDINATES:
        return
    angles, n_modes = scene.reduction.angles, scene.reduction.modes
    count, n_eta = float(angles) ** n, n + n_modes
    tables = len(mechanism.mass_weights) * (n_eta**2 + n * n * n_modes) + len(mechanism.stiffness_weights) * n_modes**2
    n_bytes = count * (tables + mechanism.n_dofs * n_modes) * BYTES
    hours = count * (SECONDS + SECONDS_PER_UNKNOWN * mechanism.n_dofs) / 3600
    raise InputError(
        f"coordinates: {names}: {n} independent coordinates were given; at most {MOST_COORDINATES} are taken. "
        f"reduction.angles = {angles} along each would make {angles}^{n} = {count:.3g} configurations: about "
        f"{hours:.3g} hours of eigenproblems on one rank, and {n_bytes / 1e9:.3g} GB of tables and modes. Join bodies "
        "until two coordinates are left"
    )
