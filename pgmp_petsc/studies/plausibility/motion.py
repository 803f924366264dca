"""How fast coordinates start and are driven."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from itertools import pairwise

import numpy as np

import pgmp_petsc.scene.effects as kinds
from pgmp_petsc.effects.motion import Motion
from pgmp_petsc.scene import Scene
from pgmp_petsc.studies.plausibility.bodies import Size
from pgmp_petsc.studies.plausibility.finding import Finding, doubt, named, refusal
from pgmp_petsc.studies.plausibility.loads import FAST, LIGHT
from pgmp_petsc.studies.plausibility.unit_systems import UnitSystem

MANY_TURNS = 1e3 * 2 * math.pi  # rad
N_LOOKED_AT = 2001  # instants of a run


def motion_findings(scene: Scene, sizes: Mapping[str, Size], system: UnitSystem) -> Iterator[Finding]:
    """Yield starts and motions that are too fast."""
    length, clock = system.length * max((size.length for size in sizes.values()), default=0.0), system.time
    for name, state in scene.simulation.initial.items():
        entry = f"simulation.initial.{name}"
        where, velocity = named(scene, f"{entry}.velocity", state.velocity)
        yield from _fast(where, velocity / clock, length, velocity)
        if abs(state.position) > MANY_TURNS:
            yield doubt(f"{entry}.position", "more than 1,000 turns; angles are in rad", state.position)
    for name, effect in scene.effects.items():
        if isinstance(effect, kinds.PrescribedMotion):
            yield from _driven(f"effects.{name}", effect, length, clock)
            yield from _out_of_range(scene, name, effect)
            if effect.table is not None and effect.table[0][0] > scene.simulation.duration:
                yield doubt(
                    f"effects.{name}.table",
                    f"begins at {effect.table[0][0]:g} s, but the run ends at simulation.duration = "
                    f"{scene.simulation.duration:g} s; nothing moves",
                )


def _driven(entry: str, effect: kinds.PrescribedMotion, length: float, clock: float) -> Iterator[Finding]:
    if effect.harmonic is not None:
        speed = 2 * math.pi * effect.harmonic.frequency_hz * effect.harmonic.amplitude
        yield from _fast(f"{entry}.harmonic", speed / clock, length)
    elif effect.spin_up is not None:
        yield from _fast(f"{entry}.spin_up.speed", effect.spin_up.speed / clock, length, effect.spin_up.speed)
    elif effect.constant_speed is not None:
        speed = effect.constant_speed.speed
        yield from _fast(f"{entry}.constant_speed.speed", speed / clock, length, speed)
    else:
        speed = max(abs((b[1] - a[1]) / (b[0] - a[0])) for a, b in pairwise(effect.table))
        yield from _fast(f"{entry}.table", speed / clock, length)


def _out_of_range(scene: Scene, name: str, effect: kinds.PrescribedMotion) -> Iterator[Finding]:
    """Yield a finding if a motion leaves the range of its coordinate, which a periodic one does not."""
    coordinate = scene.coordinates.get(effect.coordinate)
    if coordinate is None or coordinate.periodic:
        return
    angles = Motion(name, effect).at(np.linspace(0.0, scene.simulation.duration, N_LOOKED_AT)).angle
    low, high = coordinate.range
    furthest = angles.min() if low - angles.min() > angles.max() - high else angles.max()
    if not low <= furthest <= high:
        yield doubt(
            f"effects.{name}",
            f"moves {effect.coordinate} to {furthest:.6g} rad, beyond coordinates.{effect.coordinate}.range = "
            f"[{low:g}, {high:g}], where reduced runs end; widen the range, or move less",
        )


def _fast(entry: str, speed: float, length: float, *received: float) -> Iterator[Finding]:
    """Yield a finding if a body of this length, turned at this speed (rad/s), is too fast at its tip."""
    tip = abs(speed) * length
    words = f"{abs(speed):.3g} rad/s move the tip of a body of {length:.3g} m at {tip:.3g} m/s"
    if tip > LIGHT:
        yield refusal(entry, f"{words}, faster than light", *received)
    elif tip > FAST:
        yield doubt(entry, f"{words}; speeds are in rad/s", *received)
