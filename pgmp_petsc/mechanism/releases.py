"""What a joint holds in the motion, and what it releases there.

The statements s of a joint are zero in the configuration: the rigid mechanism closes with them, and they count its
coordinates. In the motion an elastic joint holds some of these directions, and releases others: their rows are no
constraints, and springs act on them (`effects.springs`).

Along an axis e_k of its reference frame, fixed in the first body, the statement is ``e_k . (p_b - p_a)``. About it, it
is a cosine that turning about e_k alone changes at first order, and turning about the axes that the joint leaves free
never does. With f the axes of the second body that are those of the first as the bodies are placed:

- all turning held: ``e_(k+2) . f_(k+1)``, the sine of a rotation about e_k; in the plane the rotation itself,
- turning about e_j free: ``e_l . f_j``, l the third axis,
- turning about two axes free: the joint's own statement.

Where the joint is off by an offset (place, turn), what it holds is about the moved point and the turned axes. What it
releases is measured where the joint should be, and its spring is at rest where the joint is: its length is the measure
of place and turn, ``e_k . place`` along an axis. Both are the same to first order, and the offset is a factor of
nothing: it is a parameter of the springs.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.bodies.affine import AffineSum, Quantity
from pgmp_petsc.mechanism.joints import Release, triad
from pgmp_petsc.mechanism.statements import ANGLE, Statement, along, angle, perpendicular
from pgmp_petsc.scene.joints import DAMPED_BY, PARALLEL, TURNS, Elastic, Offset
from pgmp_petsc.scene.messages import problem

AXES = ("first", "second", "third")


def parted(
    statements: Sequence[Statement],
    joint: tuple[np.ndarray, np.ndarray],
    turn: np.ndarray,
    rest: float,
    elastic: Elastic,
    entry: str,
    off: tuple[Offset, np.ndarray, Sequence[Statement]] | None = None,
) -> tuple[tuple[Statement, ...], tuple[Release, ...]]:
    """Return what an elastic joint holds in the motion, and what it releases.

    Parameters
    ----------
    statements
        What it holds in the configuration.
    joint
        The same axes in the frames of a and b, as `scene.joints.JointEntry.statements` takes them, shape (d, d) each.
    turn
        What turns vectors of the frame of a into that of b, as placed, shape (d, d).
    rest
        How far b is turned against a in the plane, as placed, rad.
    elastic, entry
        The table, and its name in the scene.
    off
        How far the joint is off, the rotation of its axes by that, shape (d, d), and its statements about these.

    Raises
    ------
    InputError
        If it has a stiffness or damping where the joint is free, its axes are oblique to those of the joint, or the
        joint is turned by an offset, so that what it releases is off by more the further it has moved.
    """
    in_a = triad(*(np.array(axis, dtype=float) for axis in elastic.reference))
    in_b, d = turn @ in_a, len(in_a)
    offset, turned, moved = off or (None, np.eye(d), statements)
    own = {key: [k for k, part in enumerate(statements) if part.is_length == (key == "stiffness")] for key in DAMPED_BY}
    slopes = {key: _slopes([statements[k] for k in rows], *joint) for key, rows in own.items()}
    held, released = [], []
    for key, rows in own.items():
        parts = [moved[k] for k in rows]
        stiffness = getattr(elastic, key)
        if not stiffness:
            held += parts
            continue
        axes = in_a if d == 3 or key == "stiffness" else np.ones((1, 1))
        is_held = _held(slopes[key][key == "turning_stiffness"], axes, key, elastic, f"{entry}.{key}")
        for name in (key, DAMPED_BY[key]):
            _refuse_free(name, getattr(elastic, name), is_held, entry)
        if all(np.isinf(k) for k, of in zip(_numbers(stiffness), is_held) if of):
            held += parts
            continue
        if offset is not None and any(offset.turn):
            _refuse_turned(key, is_held, f"{entry.removesuffix('elastic')}offset.turn", offset)

        def measures(axes: np.ndarray, parts: list[Statement]) -> list[Statement | None]:
            return _along(axes) if key == "stiffness" else _about(axes, in_b, is_held, parts)

        exact, moving = measures(in_a, [statements[k] for k in rows]), measures(turned @ in_a, parts)
        for axis in np.flatnonzero(is_held):
            if stiffness[axis] == np.inf:
                held.append(moving[axis])
            else:
                part = exact[axis]
                at_rest = [Quantity(rest if part.kind == ANGLE else 0.0)]
                if offset is not None:
                    slope = np.concatenate(_slopes([part], *joint), axis=1)[0]
                    given = (*(offset.place or (0.0,) * d), *(offset.turn or (0.0,) * TURNS[d]))
                    at_rest += [Quantity.of(x) * float(s) for x, s in zip(given, slope) if abs(s) > PARALLEL]
                released.append(Release(part, key, int(axis), AffineSum.total(*at_rest)))
    return tuple(held), tuple(released)


def _refuse_turned(key: str, is_held: np.ndarray, entry: str, offset: Offset) -> None:
    """Refuse axes that are turned by an offset where the joint moves on along them, or about several axes."""
    if key == "stiffness" and not is_held.all():
        words = "turns what the joint slides along, which it releases across that by more the further it slides"
    elif np.count_nonzero(~is_held) > 1:
        words = "turns what the joint turns about, and it turns about several axes"
    else:
        return
    words += ": not made for a joint with elastic in these directions; take place, or inf for them"
    raise InputError(problem(entry, words, list(offset.turn)))


def loosened(
    statements: Sequence[Statement], in_a: np.ndarray, loose: str
) -> tuple[tuple[Statement, ...], tuple[Release, ...]]:
    """Return what a joint with a clearance holds in the motion, and what it releases there.

    Parameters
    ----------
    statements
        What it holds in the configuration.
    in_a
        Its axes in the frame of a, one a column, shape (d, d); the identity of one without.
    loose
        As of `scene.joints.JointTable`.
    """
    held, lengths = ([part for part in statements if part.is_length == of] for of in (False, True))
    axes = list(in_a.T)
    meets = len(lengths) == len(axes)
    if loose == "across" and not (meets and len(axes) == 2):  # in the plane a pin's axis is across it
        held = [*([along(axes[0])] if meets else []), *held]
        axes = axes[1:]
    return tuple(held), tuple(Release(along(axis), "clearance", number) for number, axis in enumerate(axes))


def sines(in_a: np.ndarray, in_b: np.ndarray) -> list[Statement]:
    """Return the sines of rotations about the axes of a triad (3, 3) in a, whose directions in b are others (3, 3)."""
    return [perpendicular(in_a[:, k - 1], in_b[:, k - 2]) for k in range(3)]


def _along(in_a: np.ndarray) -> list[Statement]:
    return [along(axis) for axis in in_a.T]


def _about(in_a: np.ndarray, in_b: np.ndarray, is_held: np.ndarray, own: Sequence[Statement]) -> list[Statement | None]:
    """Return what measures the rotation about each axis that is held (`parted`)."""
    free = np.flatnonzero(~is_held)
    if len(in_a) == 2:
        return [angle(np.eye(2), np.eye(2))]
    if not free.size:
        return sines(in_a, in_b)
    if free.size == 1:
        j = int(free[0])
        return [None if k == j else perpendicular(in_a[:, 3 - j - k], in_b[:, j]) for k in range(3)]
    return [own[0] if of else None for of in is_held]


def _slopes(parts: Sequence[Statement], in_a: np.ndarray, in_b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the changes of statements with displacements (n, d) and rotations (n, 1 or 3) of b, in the frame of a, as
    assembled: where the axes of a joint in both frames are the same."""
    d = len(in_a)
    turned = in_a @ in_b.T  # the directors of b in a, one a column
    frames = (np.concatenate([np.zeros(d), directors.T.ravel()])[:, None] for directors in (np.eye(d), turned))
    a, b = frames
    moved, turning = np.zeros((len(parts), d)), np.zeros((len(parts), 1 if d == 2 else 3))
    for row, part in enumerate(parts):
        slopes = part.gradient(a, b)[d * (d + 1) :, 0].reshape(d + 1, d)
        moved[row] = slopes[0]
        # a rotation w changes the director d_k by w x d_k
        pulls = turned @ slopes[1:]
        turning[row] = pulls[0, 1] - pulls[1, 0] if d == 2 else _axial(pulls)
    return moved, turning


def _held(slopes: np.ndarray, axes: np.ndarray, key: str, elastic: Elastic, entry: str) -> np.ndarray:
    """Return which axes, one a column, are held where statements have such slopes (n, n_axes); the others are free."""
    part = np.linalg.pinv(slopes) @ slopes @ axes
    held, free = (np.linalg.norm(of, axis=0) < PARALLEL for of in (axes - part, part))
    if not np.all(held | free):
        words = "an axis that is oblique to what the joint leaves free is neither held nor free; take axes along and "
        words += f"across it in {entry.removesuffix(key)}reference"
        raise InputError(problem(entry, words, list(getattr(elastic, key))))
    return held


def _refuse_free(name: str, numbers: Sequence[float | str], is_held: np.ndarray, entry: str) -> None:
    """Refuse what acts along or about an axis that the joint leaves free."""
    for axis, (number, of) in enumerate(zip(numbers, is_held)):
        if not of and number != 0.0:
            turning = name.startswith("turning")
            which = "turning" if turning and is_held.size == 1 else f"the {AXES[axis]} axis of reference"
            what = which if which == "turning" else f"turning about {which}" if turning else f"sliding along {which}"
            words = f"the joint leaves {what} free: 0 is needed there, and springs are effects of their own"
            raise InputError(problem(f"{entry}.{name}", words, list(numbers)))


def _axial(matrix: np.ndarray) -> np.ndarray:
    """Return ``sum_k d_k x s_k`` of ``sum_k d_k s_k^T``, shape (3,)."""
    return np.array([matrix[1, 2] - matrix[2, 1], matrix[2, 0] - matrix[0, 2], matrix[0, 1] - matrix[1, 0]])


def _numbers(values: Sequence[float | str]) -> list[float]:
    """Return numbers, with 0 for a parameter, which is finite."""
    return [0.0 if isinstance(value, str) else value for value in values]
