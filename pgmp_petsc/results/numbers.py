"""Figures in words: as many digits as an interval leaves them, intervals, percentages, and prefixes of units.

A person reads 12 MPa and 140 %, where files hold 1.2e7 Pa and 1.4. Within a page (`one_unit_each`) all figures of a
unit have one prefix.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar

import numpy as np

from pgmp_petsc.base.units import LENGTHS, behind

ROUND_OFF = 1e-12  # of a quantity's size: what varies by less is the same throughout
VANISHING = 1e-9  # of the largest output of its unit: an output that small is what round-off leaves of none
# of the most that a joint carries: parts out of square turn more into its other components, of which so little is none.
# ISO 2768-2, class H, allows 0.2 mm on 100 mm, twenty times as much
MISALIGNED = 1e-4
Arrays = Mapping[str, np.ndarray]  # by the names of outputs or parameters
TORQUES = "N m", "N mm"
DIGITS = 2  # of an interval's width that are shown
PLAIN = (1e-4, 1e7)  # sizes that are written without a power of ten
MOST = 100.0  # a share beyond it is of something that is hardly there
READABLE = 2e-2  # of the largest figure of a page: smaller ones have a prefix of their own
# Powers of 1000 that are written as prefixes, for the units that are used with them.
_PREFIXES = {0: "", -1: "m", -2: "\N{MICRO SIGN}", -3: "n", 1: "k", 2: "M", 3: "G"}
_PREFIXED_UNITS = {"m", "s", "N", "N m", "Pa", "J", "W", "rad", "Hz"}
_largest: ContextVar[Mapping[str, float]] = ContextVar("largest", default={})


def sizes_of(outputs: Mapping[str, np.ndarray], units: Mapping[str, str], length: float = 0.0) -> dict[str, float]:
    """Return beside what each output is round-off: the largest one in its unit, at least 1 rad and a length; of forces
    and torques also that of the others at the length. Pure numbers are not beside others: damages may be tiny."""
    kinds = {name: (units.get(name, "1"), name if units.get(name, "1") == "1" else "") for name in outputs}
    found = {kind: {"rad": 1.0, **dict.fromkeys(LENGTHS, length)}.get(kind[0], 0.0) for kind in kinds.values()}
    for name, values in outputs.items():
        sizes = np.abs(values)
        found[kinds[name]] = max(found[kinds[name]], float(np.max(sizes[np.isfinite(sizes)], initial=0.0)))
    force = ("N", "")
    for torque in [kind for kind in found if kind[0] in TORQUES and force in found and length > 0.0]:
        found[force], found[torque] = (
            max(found[force], found[torque] / length),
            max(found[torque], found[force] * length),
        )
    return {name: found[kind] for name, kind in kinds.items()}


def nothing(sizes: Mapping[str, np.ndarray], units: Mapping[str, str], length: float = 0.0) -> dict[str, float]:
    """Return below which size each output is none: what round-off leaves beside others of its unit, as a symmetric
    machine does of a motion; of pure numbers a share of 1, as of a damage, with which a part fails."""
    beside = sizes_of(sizes, units, length)
    return {name: ROUND_OFF if units.get(name, "1") == "1" else VANISHING * beside[name] for name in sizes}


def misaligned(
    sizes: Mapping[str, np.ndarray], units: Mapping[str, str], joints: Mapping[str, str]
) -> dict[str, np.ndarray]:
    """Return below which size each output is none beside others in its unit of what the same joint carries, in each of
    some runs; names of joints come by those of outputs, and where there is none it is zero."""
    parts = {name: (joints[name], units.get(name, "1")) for name in sizes if name in joints}
    carried: dict[tuple[str, str], np.ndarray] = {}
    for name, part in parts.items():
        carried[part] = np.fmax(carried.get(part, 0.0), sizes[name])
    none = np.zeros(())
    return {name: MISALIGNED * carried[parts[name]] if name in parts else none for name in sizes}


def felt(
    sizes: Mapping[str, np.ndarray], units: Mapping[str, str], length: float = 0.0, joints: Mapping[str, str] = {}
) -> dict[str, np.ndarray]:
    """Return largest sizes of outputs, each of one shape, with zero where they are `nothing`, or beside other
    components in the same of some `joints`."""
    least, beside = nothing(sizes, units, length), misaligned(sizes, units, joints)
    return {name: np.where(size <= np.maximum(least[name], beside[name]), 0.0, size) for name, size in sizes.items()}


def plain(value: float, digits: int = 2, sign: str = "") -> str:
    """Return a figure with so many digits, ``140`` and not ``1.4e+02``; with a power of ten beyond `PLAIN`."""
    text = f"{value:{sign}.{digits}g}"
    if "e" not in text or not PLAIN[0] <= abs(value) < PLAIN[1]:
        return text
    return f"{float(text):{sign}.0f}"


def share_text(share: float, digits: int = 2) -> str:
    """Return a share in per cent: ``0.12 %``, ``140 %``; of what is round-off, a bound."""
    if share > MOST:
        return f"more than {100.0 * MOST:,.0f} %"
    return f"{plain(100.0 * share, digits)} %" if np.isfinite(share) else "not known"


def axis_unit(unit: str, *arrays: np.ndarray) -> tuple[float, str]:
    """Return the factor and the prefixed unit that give values of at most three digits before the point."""
    largest = max((np.nanmax(np.abs(values), initial=0.0) for values in arrays), default=0.0)
    if unit not in _PREFIXED_UNITS or not np.isfinite(largest) or largest == 0.0:
        return 1.0, unit
    of_page = _largest.get().get(unit, 0.0)
    largest = max(of_page, largest) if largest >= READABLE * of_page else largest
    # 0.3 m reads better than 300 mm, so that the prefix changes at a tenth of the unit; 150 MPa better than 0.15 GPa
    tenth = 1.0 if unit in ("N", "N m", "Pa") else 10.0
    power = int(np.floor(np.log10(largest * tenth) / 3.0 + 1e-9))
    power = min(max(power, -3), 0 if unit in ("m", "s", "rad") else 3)
    return 1000.0**-power, f"{_PREFIXES[power]}{unit}"


def with_unit(value: float, unit: str, digits: int = 4) -> str:
    """Return a figure with its prefixed unit: ``12 MPa``."""
    factor, shown = axis_unit(unit, np.array([value]))
    return plain(factor * value, digits) + behind(shown)


@contextmanager
def one_unit_each(largest: Mapping[str, float]) -> Iterator[None]:
    """Let figures of a unit have the prefix of the largest one of them within the block."""
    before = _largest.set(largest)
    try:
        yield
    finally:
        _largest.reset(before)


def number_text(value: float, ends: np.ndarray, most: int) -> str:
    """Return a figure with as many digits as its interval leaves it, `most` at most; 5 where that says nothing."""
    return "unknown" if np.isnan(value) else plain(value, _digits(value, _width(ends, value), most))


def interval_text(ends: np.ndarray, value: float = np.nan) -> str:
    """Return ``[1.234, 1.256]``, the interval of a value where that is known."""
    if np.isnan(ends).any():
        return "unknown"
    if np.isinf(ends).all():
        return "[too few samples]"
    texts = end_texts(ends, value)
    return f"[{texts[0]}, {texts[1]}]"


def end_texts(ends: np.ndarray, value: float = np.nan) -> list[str]:
    """Return both ends of an interval, which may be infinite, of a value where that is known."""
    width = _width(ends, value)
    return [
        ("-" if end < 0 else "") + "infinite" if np.isinf(end) else plain(end, _digits(end, width, 8)) for end in ends
    ]


def percent(level: float) -> str:
    """Return ``95 %``."""
    return f"{100 * level:g} %"


def _width(ends: np.ndarray, value: float) -> float:
    """Return how wide an interval is, from its value to the finite end where the other is infinite; 0 if unknown."""
    known = np.where(np.isfinite(ends), ends, value)
    width = abs(known[1] - known[0])
    return float(width) if np.isfinite(width) else 0.0


def _digits(value: float, width: float, most: int) -> int:
    """Return how many digits of a figure its interval leaves it, and two more for sums; 3 at least."""
    if not width > 0.0 or value == 0.0:
        return min(most, 5)
    return int(np.clip(np.floor(np.log10(abs(value))) - np.floor(np.log10(width)) + DIGITS, 3, most))
