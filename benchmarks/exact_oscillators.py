"""A prototype: steps that are exact for the oscillators of a reduced model's vibration modes.

The residual ``r(t, eta, eta', eta'')`` of a reduced model with one rigid coordinate is linear in the accelerations.
With the modes of inertia and stiffness in the middle of a step (`modes_at`; Omega = 0 for the rigid sum s)::

    eta = T z,   z = (s, x),   T^T M T = diag(M_tt, 1),   T^T K T = diag(0, Omega^2)
    z'' + Omega^2 z = g       where g is such that  r(t, T z, T z', T (g - Omega^2 z)) = 0

By variation of constants, exact for a g that is a polynomial over the step (Hairer, Lubich and Wanner, Geometric
Numerical Integration, 2nd ed. 2006, section XIII.1; Hochbruck and Ostermann, Acta Numerica 19, 2010, 209-286), with
``g(tau) = g_0 + (g_1 - g_0) tau/h + 1/2 bend ((tau/h)^2 - tau/h)`` and xi = h Omega::

    z_1  = cos z_0 + sin/Omega z'_0 + (1 - cos)/Omega^2 g_0 + (1 - sin/xi)/Omega^2 (g_1 - g_0) + ... bend
    z'_1 = -Omega sin z_0 + cos z'_0 + sin/Omega g_0 + (1 - cos)/(h Omega^2) (g_1 - g_0) + ... bend

So a free vibration keeps amplitude and phase with any step, a slow force has its static answer, and s is integrated
with order two, with `bend` three. g_1 is found by corrections ``g_1 -= T^T r / diag(M_tt, 1)``: the inertia and the
stiffness that the modes have drop out, so that they contract without a factorisation; all couplings of the mass matrix
are in r, implicitly. Without bend the step is symmetric once they have converged. bend is the second difference of g
over the last two steps, but for what bends of the torques' tables put into it.

*What goes wrong with long steps.* (1) g changes with theta, not linearly: the interpolant's kinks at the steps push all
modes, most where xi is near a multiple of 2 pi. (2) A mode with xi > pi is sampled less than twice a period; what its
vibration does to g is an alias. Remedies, each a `Variant`:

- Filters, as of mollified methods (Garcia-Archilla, Sanz-Serna and Skeel, SIAM J. Sci. Comput. 20, 1998, 930-963;
  Hochbruck and Lubich, Numer. Math. 83, 1999, 403-426; Hairer, Lubich and Wanner, section XIII.2): r is evaluated where
  the vibration is filtered. Theirs act on z and g, and take the static answer too: with ``sinc(xi)^2`` for g,
  ``cos(xi/2)^2`` of it is left, nothing at xi = pi. Here they act on what vibrates about the static answer z*::

      z~ = z* + phi(xi) (z - z*),   z~' = z*' + phi (z' - z*'),   z~'' = z*'' + phi (z'' - z*'')

- `held`: from some xi on, phi = 0, and the vibration u = z - z* goes on from step to step freely, whatever z*' does at
  the step; only bends of the torques' tables push it, which are known: ``u' -= T^T Q (a'_+ - a'_-) / Omega^2``.
- `projected`: such modes have their static answer alone.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pgmp_petsc.bodies.affine import evaluate_weights
from pgmp_petsc.reduced.system import ReducedSystem
from pgmp_petsc.reduced.terms import ReducedTerms
from pgmp_petsc.reduction.cell_products import unpacked
from pgmp_petsc.stepping.second_order_system import State

SOFT = 0.02  # of xi: below, series take the place of quotients
CONVERGED = 1e-12  # change of the coordinates by a correction, in units of the mechanism's size or of 1 rad
RUN_AWAY = 10.0  # in the same units: flexible coordinates are a hundredth

Filter = Callable[[np.ndarray], np.ndarray]  # phi of xi


def unfiltered(xi: np.ndarray) -> np.ndarray:
    """Return 1."""
    return np.ones_like(xi)


def sinc(xi: np.ndarray) -> np.ndarray:
    """Return sin(xi) / xi, the mean of the vibration over one step either way."""
    return np.sinc(xi / np.pi)


@dataclass(frozen=True)
class Variant:
    """How a step is made.

    Attributes
    ----------
    name
        For the table.
    corrections
        Most corrections of a step.
    phi
        Filter.
    curved
        Whether g has its bend.
    held_from
        From which xi on modes are held; only with a bend are they kept from being pushed.
    projected
        Whether the modes that are held have their static answer and nothing else.
    """

    name: str
    corrections: int
    phi: Filter = unfiltered
    curved: bool = False
    held_from: float = np.inf
    projected: bool = False


class Modes(NamedTuple):
    """Modes of n samples: T (n, n_eta, n_eta), its inverse, diag(M_tt, 1) and Omega with 0 first, (n, n_eta)."""

    shapes: np.ndarray
    inverse: np.ndarray
    mass: np.ndarray
    omega: np.ndarray


def modes_at(terms: ReducedTerms, weights: np.ndarray, theta: np.ndarray) -> Modes:
    """Return the modes of the undeformed mechanism, from the tables of the equations themselves.

    Parameters
    ----------
    weights
        Of the affine terms, shape (n, n_terms).
    theta
        Shape (n,), rad.
    """
    layout, at = terms.layout, theta[:, None]
    entries = np.einsum("nt,nte->ne", weights, terms.terms(at))
    entries[:, :1] = np.einsum("nt,nte->ne", weights, terms.rigid(at))
    mass, stiffness = unpacked(entries[:, : layout.coupling]), unpacked(entries[:, layout.stiffness : layout.cubic])
    follow = mass[:, 0, 1:] / mass[:, :1, 0]
    lower = np.linalg.cholesky(mass[:, 1:, 1:] - mass[:, 1:, :1] * follow[:, None, :])
    outer = np.swapaxes(np.linalg.inv(lower), 1, 2)
    squares, inner = np.linalg.eigh(np.swapaxes(outer, 1, 2) @ stiffness @ outer)
    n, m = squares.shape
    shapes = np.zeros((n, 1 + m, 1 + m))
    shapes[:, 0, 0] = 1.0
    shapes[:, 1:, 1:] = outer @ inner
    shapes[:, :1, 1:] = -follow[:, None, :] @ shapes[:, 1:, 1:]
    diagonal = np.concatenate([mass[:, :1, 0], np.ones((n, m))], axis=1)
    omega = np.concatenate([np.zeros((n, 1)), np.sqrt(np.maximum(squares, 0.0))], axis=1)
    return Modes(shapes, np.linalg.inv(shapes), diagonal, omega)


class Motion(NamedTuple):
    """Coordinates, velocities and accelerations, each (n, n_eta)."""

    z: np.ndarray
    v: np.ndarray
    a: np.ndarray

    def turned(self, matrices: np.ndarray) -> Motion:
        """Return it in other coordinates, by matrices (n, n_eta, n_eta)."""
        return Motion(*(np.einsum("nij,nj->ni", matrices, part) for part in self))


class Course(NamedTuple):
    """Force over a step: at its beginning, at its end, and its bend (second difference), each (n, n_eta)."""

    force: np.ndarray
    ahead: np.ndarray
    bend: np.ndarray


class Oscillators:
    """What oscillators do over a step, for Omega (n, n_eta) and a step in s."""

    def __init__(self, omega: np.ndarray, step: float) -> None:
        xi = omega * step
        soft = xi < SOFT
        safe = np.where(soft, 1.0, xi)
        versine = 2.0 * (np.sin(0.5 * safe) / safe) ** 2  # (1 - cos) / xi^2 without cancellation
        sine = np.sinc(xi / np.pi)
        self.xi, self._omega, self._step, self._cos, self._sine = xi, omega, step, np.cos(xi), sine
        self._constant = np.where(soft, 0.5 - xi**2 / 24.0, versine)
        self._rise = np.where(soft, 1.0 / 6.0 - xi**2 / 120.0, (1.0 - sine) / safe**2)
        self._bend = np.where(soft, -1.0 / 24.0 + xi**2 / 360.0, 0.5 * (sine - 2.0 * versine) / safe**2)
        rate = 0.5 * (1.0 + self._cos - 2.0 * sine) / safe**2
        self._bend_rate = np.where(soft, -1.0 / 12.0 + xi**2 / 80.0, rate)
        self._compliance = np.where(xi > 0.0, (step / np.where(xi > 0.0, xi, 1.0)) ** 2, 0.0)

    @property
    def answer(self) -> np.ndarray:
        """What the end of a step moves by a unit of force there, (n, n_eta)."""
        return self._step**2 * self._rise

    def flight(self, start: Motion, course: Course) -> Motion:
        """Return the end of a step."""
        h, omega, rise = self._step, self._omega, course.ahead - course.force
        pushed = self._constant * course.force + self._rise * rise + self._bend * course.bend
        z = self._cos * start.z + h * self._sine * start.v + h**2 * pushed
        pushed = self._sine * course.force + self._constant * rise + self._bend_rate * course.bend
        v = -omega * np.sin(self.xi) * start.z + self._cos * start.v + h * pushed
        return Motion(z, v, course.ahead - omega**2 * z)

    def still(self, course: Course, at_end: bool) -> Motion:
        """Return the static answer z* at an end of the step: the solution that is a polynomial; 0 for s."""
        h, f = self._step, self._compliance
        force, sign = (course.ahead, 0.5) if at_end else (course.force, -0.5)
        turn = f * course.bend / h**2
        return Motion(f * (force - turn), f * (course.ahead - course.force + sign * course.bend) / h, turn)

    def kick(self, jump: np.ndarray) -> np.ndarray:
        """Return by how much z*' jumps where the force's second difference over two steps has a `jump`."""
        return self._compliance * jump / self._step


class Pushes(NamedTuple):
    """Loads over two steps: amplitudes (3, n, n_loads) and ``T^T Q / diag(M_tt, 1)`` (n, n_loads, n_eta)."""

    amplitudes: np.ndarray
    before: np.ndarray
    now: np.ndarray

    def bend(self, forces: tuple[np.ndarray, np.ndarray, np.ndarray], ahead: np.ndarray) -> np.ndarray:
        """Return the bend of the force in the last step, without that of the amplitudes between two steps.

        Parameters
        ----------
        forces
            g one step before, at the beginning and at the end.
        ahead
            Pushes at the end, with the same modes.
        """
        pushes = self.before, self.now, ahead
        rest = [g - _sum(a, q) for g, a, q in zip(forces, self.amplitudes, pushes)]
        # (a q)'' = a q'' + 2 a' q' with a linear over the step
        turned = _sum(self.amplitudes[1], ahead - 2.0 * self.now + self.before)
        return (
            rest[2]
            - 2.0 * rest[1]
            + rest[0]
            + turned
            + 2.0 * _sum(np.diff(self.amplitudes, axis=0)[1], ahead - self.now)
        )

    @property
    def jump(self) -> np.ndarray:
        """What the amplitudes alone put into the second difference of the force."""
        return _sum(np.diff(self.amplitudes, 2, axis=0)[0], self.now)


def _sum(amplitudes: np.ndarray, pushes: np.ndarray) -> np.ndarray:
    return np.einsum("nl,nli->ni", amplitudes, pushes)


class ExactOscillators:
    """Steps of a batch of samples.

    Parameters
    ----------
    system
        Gives the start and the residual; one rigid coordinate.
    terms, values
        Its terms and parameter values.
    step
        s.
    variant
        How a step is made.

    Attributes
    ----------
    state
        Where the samples stand.
    lost
        Mask of the samples that ran away, shape (n,).
    n_corrections
        Evaluations of the residual so far, of all samples together.
    """

    def __init__(
        self,
        system: ReducedSystem,
        terms: ReducedTerms,
        values: Mapping[str, np.ndarray],
        step: float,
        variant: Variant,
    ) -> None:
        self._system, self._terms, self._step, self._variant = system, terms, step, variant
        n = system.n_samples
        self._weights = np.broadcast_to(evaluate_weights(terms.weights, values).T, (n, len(terms.weights)))
        start = system.start()
        self.state = Motion(start.q, start.v, start.a)
        self._smooth, self._before = self.state, None
        self._held = np.zeros(start.q.shape, dtype=bool)
        self.lost, self.n_corrections = np.zeros(n, dtype=bool), 0

    def advance(self, end: float) -> None:
        """Take one step that ends at a time (s)."""
        h, variant = self._step, self._variant
        modes = modes_at(self._terms, self._weights, self.state.z[:, 0] + 0.5 * h * self.state.v[:, 0])
        oscillators = Oscillators(modes.omega, h)
        held = oscillators.xi > variant.held_from
        phi = np.where(held, 0.0, variant.phi(oscillators.xi))
        start, now = self.state.turned(modes.inverse), self._smooth.turned(modes.inverse)
        # the filtered state fulfils the equations of motion: its force needs no evaluation
        force = now.a + modes.omega**2 * now.z
        ahead, before, pushes = force, force, None
        if self._before is not None:
            then = self._before.turned(modes.inverse)
            before = then.a + modes.omega**2 * then.z
            ahead = 2.0 * force - before
            if variant.curved:
                pushes = self._pushes(end, modes)
                ahead = ahead + pushes.jump
        theta = 2.0 * self._smooth.z[:, 0] - (self._smooth if self._before is None else self._before).z[:, 0]
        for count in range(variant.corrections + 1):
            bend = np.zeros_like(force)
            if pushes is not None:
                bend = pushes.bend((before, force, ahead), self._pushes_at(theta, modes))
            course = Course(force, ahead, bend)
            whole = oscillators.flight(self._released(oscillators, start, now, course, held, pushes), course)
            still = oscillators.still(course, True)
            smooth = Motion(*(s + phi * (z - s) for s, z in zip(still, whole)))
            shown = smooth.turned(modes.shapes)
            if count == variant.corrections:
                break
            theta = shown.z[:, 0]
            change = np.einsum("nji,nj->ni", modes.shapes, self._residual(end, shown)) / modes.mass
            ahead = ahead - change
            self.n_corrections += int(np.sum(~self.lost))
            size = np.abs(np.einsum("nij,nj->ni", modes.shapes, oscillators.answer * change)) * self._terms.scale
            if not np.max(size[~self.lost], initial=0.0) > CONVERGED:
                break
        if variant.projected:
            whole = Motion(*(np.where(held, s, z) for s, z in zip(smooth, whole)))
        self._go_on(whole.turned(modes.shapes), shown, held)

    def _released(
        self,
        oscillators: Oscillators,
        start: Motion,
        now: Motion,
        course: Course,
        held: np.ndarray,
        pushes: Pushes | None,
    ) -> Motion:
        """Return the start of a step; modes that stay held vibrate on about the static answer of this step."""
        if pushes is None:
            return start
        still = oscillators.still(course, False)
        both = held & self._held
        z = start.z + both * (still.z - now.z)
        v = start.v + both * (still.v - now.v - oscillators.kick(pushes.jump))
        return Motion(z, v, start.a)

    def _pushes(self, end: float, modes: Modes) -> Pushes:
        """Return the loads over the last step and this one."""
        times = np.array([end - 2.0 * self._step, end - self._step, end])
        amplitudes = self._system.load_amplitudes(times)[:, None] * self._system.load_weights
        return Pushes(amplitudes, *(self._pushes_at(part.z[:, 0], modes) for part in (self._before, self._smooth)))

    def _pushes_at(self, theta: np.ndarray, modes: Modes) -> np.ndarray:
        loads = self._terms.load(theta[:, None])[:, :, : modes.omega.shape[1]]
        return np.einsum("nji,nlj->nli", modes.shapes, loads) / modes.mass[:, None]

    def _residual(self, time: float, at: Motion) -> np.ndarray:
        """Return the residual, 0 of samples that are lost."""
        return np.where(self.lost[:, None], 0.0, self._system.residual(time, State(*at, np.zeros(0))))

    def _go_on(self, state: Motion, smooth: Motion, held: np.ndarray) -> None:
        """Accept the end of a step; samples that ran away stay where they were."""
        self.lost = self.lost | ~(np.abs(state.z * self._terms.scale)[:, 1:].max(axis=1) < RUN_AWAY)
        keep, self._before, self._held = self.lost[:, None], self._smooth, held
        self.state = Motion(*(np.where(keep, old, new) for old, new in zip(self.state, state)))
        self._smooth = Motion(*(np.where(keep, old, new) for old, new in zip(self._smooth, smooth)))
