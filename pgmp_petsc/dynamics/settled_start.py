"""What is said of runs and samples that start from static equilibrium."""

from __future__ import annotations

import numpy as np

from pgmp_petsc.dynamics.second_order_system import SecondOrderSystem
from pgmp_petsc.runtime.remarks import Remark, note, warning
from pgmp_petsc.scene import Scene

ELSEWHERE = "begin elsewhere (simulation.initial) to find the one that it falls to"


def require_settled(system: SecondOrderSystem) -> None:
    """Refuse a single run that has no static equilibrium to start from; its system is closed then.

    Raises
    ------
    InputError
        With the reason.
    """
    if system.settled is not None and system.settled.reasons:
        system.close()
        system.settled.require()


def start_remarks(scene: Scene, system: SecondOrderSystem) -> tuple[Remark, ...]:
    """Return where runs of a scene start from static equilibrium, and whether they will stay there."""
    settled = system.settled
    if settled is None:
        return ()
    places = ", ".join(f"{name} = {value:.6g} rad" for name, value in zip(settled.names, settled.theta[0]))
    if not settled.free:
        return (note(f"the run starts from static deformation with coordinates held at {places}{_let_go(scene)}"),)
    remarks = [note(f"the run starts from static equilibrium at {places}")]
    if np.any(settled.unstable):
        remarks.append(
            warning(
                f"the static equilibrium at {places} is unstable: the smallest disturbance, round-off too, makes the "
                f"mechanism leave it; {ELSEWHERE}"
            )
        )
    return tuple(remarks)


def starts_remarks(scene: Scene, unstable: np.ndarray) -> tuple[Remark, ...]:
    """Return where the samples of an ensemble start from, and how many will not stay there (a mask)."""
    if not scene.initial.equilibrium:
        return ()
    if scene.initial.coordinates == "held":
        return (note(f"every sample starts from its own static deformation with coordinates held{_let_go(scene)}"),)
    remarks = [note("every sample starts from its own static equilibrium")]
    if unstable.any():
        remarks.append(
            warning(
                f"the static equilibrium of {int(unstable.sum())} of {unstable.size} samples is unstable: the smallest "
                f"disturbance, round-off too, makes the mechanism leave it; {ELSEWHERE}"
            )
        )
    return tuple(remarks)


def _let_go(scene: Scene) -> str:
    """Return what is said of coordinates that are held at first: prescribed ones go on as they are told."""
    driven = {effect.coordinate for effect in scene.effects.values() if effect.type == "prescribed_motion"}
    if not driven:
        return ", and lets them go"
    let_go = [name for name in scene.coordinates if name not in driven]
    return f", and lets {', '.join(let_go)} go" if let_go else ""
