"""Damping within the bodies. Modal damping is a constant matrix in each body's frame, which turns with the body,

    D = sum_i 2 zeta_i omega_i (M phi_i) (M phi_i)^T = P P^T,     forces  -R P P^T R^T q'

with the elastic modes of the free body at the nominal parameters. Rigid motions are M-orthogonal to them and not
damped. The rotation R of a beam is the mass-weighted mean of those of its nodes, in space the rotation closest to the
mean of their directors. That of a body on a mesh is the one that brings the places of its points closest to where they
are, ``int rho x X'^T dV = R U`` (polar decomposition, with X' the places less their centre of mass). The forces are
those of `full.damping`.

The amplitudes of a body in a floating frame are those of its elastic modes at the nominal parameters, the first ones
exact: each is damped by itself, ``2 zeta_i omega_i m_i xi_i'``, and the frame is R.

In space a node has a position and three directors. Its angular velocity is ``1/2 sum_k d_k x d_k'``, so that a couple m
acts on its director d_k with the force ``1/2 m x d_k``.

Elastic modes of a free body in its own frame are those of ``(K - omega^2 M) phi = 0`` beyond its rigid motions. They
are those of the material alone, in every model: without the point masses that a body carries, whose values may differ
from sample to sample. The frames of a body on a mesh have neither mass nor stiffness of their own.

Rayleigh's: stresses follow ``eps + beta eps'`` instead of the strains eps (Kelvin and Voigt), and the momentum is
braken at the rate alpha, forces ``-alpha M q'``. With eps' the rate of the beam's own strains, a rigid motion is not
damped by beta. The iteration matrix of the full-order model leaves modal damping out, so that each correction of a step
leaves up to the largest ratio of the one before: ratios beyond 0.3 or so need small steps.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal

import numpy as np
import scipy.sparse as sp
from pydantic import Field
from scipy.linalg import eigh
from scipy.sparse.linalg import eigsh

from pgmp_petsc.base.errors import InputError, nearest_name, shortened
from pgmp_petsc.bodies.body import Body
from pgmp_petsc.bodies.matrices import AffineMatrices, weighted_sum
from pgmp_petsc.effects.effect import Effect
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.mechanism.space import SPATIAL
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.effects import EffectEntry
from pgmp_petsc.scene.fields import Name, NotNegative, Number, Unit, no_parameter, refusal
from pgmp_petsc.scene.messages import MAX_RECEIVED, Finding, doubt, problem

SLOWEST = 4.0  # times as slowly as between hinges a beam with one free end and a mass may bend


_OF_DAMPING = no_parameter(
    "matrices of structural damping are made once for all samples; build once for each value (--override), or damp "
    "joints, springs or bushings, whose coefficients may be parameters"
)


class StructuralDamping(EffectEntry):
    """Damping within the bodies: Rayleigh's, or ratios of the modes of each free body."""

    type: Literal["structural_damping"]
    acts = "forces"
    on_vibrations = True
    bodies: tuple[Name, ...] | None = Field(None, min_length=1, description="names of bodies; all if not given")
    stiffness: Annotated[NotNegative, _OF_DAMPING, Unit("s")] = Field(
        0.0, description="share of the strain's rate that acts like strain (s): stresses of eps + stiffness eps'"
    )
    mass: Annotated[NotNegative, _OF_DAMPING, Unit("1/s")] = Field(
        0.0, description="braking of all motion, as in a viscous medium, by its momentum (1/s)"
    )
    ratios: Annotated[tuple[Annotated[Number, Field(ge=0.0, lt=1.0)], ...], _OF_DAMPING] = Field(
        (),
        description="damping ratios of the first elastic modes of each free body, without masses that it carries; "
        "modes of one frequency, as a round shaft's in two planes, have one ratio, and the last is of all modes of its "
        "frequency",
    )

    def check_entries(self) -> None:
        if not (self.stiffness or self.mass or any(self.ratios)):
            raise refusal("at least one of stiffness, mass and ratios must be above zero")

    def problems(self, scene: Scene, name: str) -> Iterator[str]:
        """Yield a line for each body that has no structural damping, or has that of an earlier effect."""
        flexible, entry = [body for body, of in scene.bodies.items() if of.flexible], f"effects.{name}"
        given = list(self.bodies or ())
        for body in given:
            if body not in scene.bodies:
                hint = nearest_name(body, flexible)
                yield problem(f"{entry}.bodies", f"there is no body '{shortened(body, MAX_RECEIVED)}'{hint}", given)
            elif body not in flexible:
                words = f"{body} is rigid; only flexible bodies have structural damping; leave it out"
                yield problem(f"{entry}.bodies", words, given)
        if self.bodies is None and not flexible:
            yield problem(entry, "all bodies are rigid; only flexible bodies have structural damping; leave it out")
        taken = {}
        for other, rival in scene.effects.items():
            if other == name:
                break
            if isinstance(rival, StructuralDamping):
                taken = dict.fromkeys(rival.bodies or flexible, other) | taken
        for body in dict.fromkeys(self.bodies or flexible):
            if body in taken:
                words = f"effects.{taken[body]} damps {body} too; give all the damping of a body in one effect"
                yield problem(entry, words)

    def doubts(
        self, scene: Scene, entry: str, frequencies: Mapping[str, float], first: Callable[[], float | None]
    ) -> Iterator[Finding]:
        """Yield more damping than the critical one."""
        found = [(body, frequencies[body]) for body in self.bodies or scene.bodies if frequencies.get(body, 0.0) > 0.0]
        if not found:
            return
        body, bending = min(found, key=lambda pair: pair[1])
        for key, ratio in (
            ("stiffness", lambda hz: math.pi * hz * self.stiffness),
            ("mass", lambda hz: self.mass / (4.0 * math.pi * hz)),
        ):
            # what is held less than by hinges bends more slowly: its damping by mass is worse than it looks
            if ratio(bending) <= (1.0 if key == "stiffness" else 1.0 / SLOWEST):
                continue
            frequency, what = first(), "the first mode of the mechanism, of"
            if frequency is None:
                frequency, what = bending, f"{body}, which between hinged ends bends with about"
            if ratio(frequency) > 1.0:
                yield doubt(
                    f"{entry}.{key}",
                    f"damps {what} {frequency:.3g} Hz, with {ratio(frequency):.3g} times the critical damping",
                    getattr(self, key),
                )

    @classmethod
    def if_added(cls, scene: Scene, run: Any, exchanged: float, tolerance: float) -> tuple[float, str] | None:
        """Say from which ratios on it would matter, for vibrations that last."""
        duration = scene.simulation.duration
        return np.nan, f"for vibrations that last: ratios from {tolerance:g} / (2 pi f {duration:g} s) on"

    @property
    def adds(self) -> str:
        return f"in {', '.join(self.bodies) if self.bodies else 'all flexible bodies'}"

    def forces(self, name: str, mechanism: Mechanism) -> Effect:
        """Return what is damped, by the body's number, and how; see the module."""
        effect, own = Effect(name), self.bodies
        damped = (body.flexible if own is None else body.name in own for body in mechanism.bodies)
        effect.dampings = {number: self for number, is_damped in enumerate(damped) if is_damped}
        return effect


@dataclass(frozen=True)
class ModalDamping:
    """Modal damping of one body."""

    effect: str  # name of the effect
    body: int  # number of the body
    dofs: np.ndarray  # its unknowns that are damped, node after node, shape (n_own,)
    factor: np.ndarray  # p in the body's frame, velocities and spins node after node, shape (n_rows, n_modes)
    #: what R is measured by: where nodes have rotations of their own their shares in the body's mass, shape (n_nodes,
    #: 1), and on a mesh ``M X'``, shape (n_nodes, d), kg m
    levers: np.ndarray


def modal_damping(
    effects: Sequence[Effect], bodies: Sequence[Body], nominal: Mapping[str, float]
) -> tuple[ModalDamping, ...]:
    """Return the modal damping of all bodies on their meshes that have one, for bodies as the unknowns are numbered.

    Raises `InputError` if a body's mesh has fewer modes than ratios are given.
    """
    every = _with_ratios(effects)
    return tuple(_of_body(*one, bodies[one[1]], nominal) for one in every if not bodies[one[1]].n_amplitudes)


def amplitude_damping(
    effects: Sequence[Effect], bodies: Sequence[Body], nominal: Mapping[str, float]
) -> dict[int, tuple[str, np.ndarray]]:
    """Return, by the number of the body, the effect and ``2 zeta_i omega_i m_i`` of every amplitude, shape (n,), N s/m,
    of bodies in floating frames.

    Raises `InputError` if a body has fewer component modes than ratios are given.
    """
    found = {}
    for effect, number, ratios in _with_ratios(effects):
        n, name = len(ratios), bodies[number].name
        for floating in bodies[number].blocks("floating"):
            if n > floating.n:
                raise InputError(
                    f"effects.{effect}.ratios: {n} modes of {name} are asked for; it has {floating.n} "
                    "component modes; take more reduction.modes"
                )
            mass, stiffness = floating.modal(nominal)
            of_modes = _of_modes(effect, ratios, np.sqrt(stiffness / mass), name)
            coefficients = np.zeros(floating.n)
            coefficients[: of_modes.size] = 2.0 * of_modes * np.sqrt(stiffness * mass)[: of_modes.size]
            found[number] = effect, coefficients
    return found


def check_ratios(effects: Sequence[Effect], bodies: Sequence[Body], nominal: Mapping[str, float]) -> None:
    """Raise `InputError` where runs would: for modes that a body has not, and two ratios of one frequency."""
    modal_damping(effects, bodies, nominal)
    amplitude_damping(effects, bodies, nominal)


def _with_ratios(effects: Sequence[Effect]) -> Iterator[tuple[str, int, tuple[float, ...]]]:
    """Yield the names of effects with ratios, the numbers of the bodies that they damp, and these ratios."""
    for effect in effects:
        for number, entry in effect.dampings.items():
            if any(entry.ratios):
                yield effect.name, number, entry.ratios


def _of_body(
    effect: str, number: int, ratios: Sequence[float], body: Body, nominal: Mapping[str, float]
) -> ModalDamping:
    omega, phi, mass = free_modes(body, nominal, len(ratios), f"effects.{effect}.ratios")
    factor = mass @ phi * np.sqrt(2.0 * _of_modes(effect, ratios, omega, body.name) * omega)
    places = body.points
    if len(places):
        d = places.shape[1]
        along = mass[::d, ::d]
        centre = np.asarray(along.sum(axis=0)) @ places / along.sum()
        return ModalDamping(effect, number, body.own_dofs, factor, along @ (places - centre))
    of_nodes = mass.diagonal()[: body.node_dofs * body.n_nodes : body.node_dofs, None]
    shares = of_nodes / of_nodes.sum()
    own = body.own_dofs
    if body.node_dofs == SPATIAL.n_dofs:
        own = np.arange(*(SPATIAL.n_pose * node for node in (body.nodes.start, body.nodes.stop)))
    return ModalDamping(effect, number, own, factor, shares)


def _of_modes(effect: str, ratios: Sequence[float], omega: np.ndarray, body: str) -> np.ndarray:
    """Return the ratios of the modes that have one, shape (n,), where they have the angular frequencies omega, rad/s,
    in order: those of the last ratio's frequency have it too.

    Raises `InputError` where modes of one frequency have two: which of them is which is left to round-off.
    """
    one_frequency = _repeated(omega)
    n = len(ratios)
    while n < omega.size and one_frequency[n - 1]:
        n += 1
    of_modes = np.pad(np.array(ratios), (0, n - len(ratios)), mode="edge")
    for k in np.flatnonzero(one_frequency[: n - 1] & (np.diff(of_modes) != 0.0)):
        raise InputError(
            f"effects.{effect}.ratios: modes {k + 1} and {k + 2} of {body} have one frequency, "
            f"{omega[k] / math.tau:.4g} Hz, as a round shaft's in two planes, and no order of their own; give both one "
            f"ratio, not {of_modes[k]:g} and {of_modes[k + 1]:g}, if need be in an effect for {body} alone"
        )
    return of_modes


def _repeated(omega: np.ndarray) -> np.ndarray:
    """Return which of frequencies in order, but the last, are the next one too, to what solvers leave of it."""
    return np.diff(omega) <= SAME * omega[1:]


SAME = 1e-6  # of a frequency: those of a round beam's two planes are found alike to 2e-10
DENSE = 300  # unknowns up to which a dense solver is faster


def free_modes(
    body: Body, values: Mapping[str, float], n_modes: int, entry: str
) -> tuple[np.ndarray, np.ndarray, sp.csr_matrix]:
    """Compute the first n_modes elastic modes of a flexible body, and what has the frequency of the last of them too:
    their angular frequencies, shape (n,), rad/s, M-orthonormal modes in the body's frame, shape (n_own, n), at the
    unknowns `Body.own_dofs`, and M, shape (n_own, n_own).

    Raises `InputError`, with the scene entry that asks for them, if the mesh has fewer modes.
    """
    alone = replace(body.alone(), lumps={})
    own = alone.own_dofs
    n_dofs, n_rigid = own.size, alone.node_dofs  # as many rigid motions as a node has unknowns
    if n_modes > n_dofs - n_rigid:
        raise InputError(f"{entry}: {n_modes} modes of {body.name} are asked for; its mesh has {n_dofs - n_rigid}")
    matrices = AffineMatrices([alone], range(alone.dofs.size))
    mass, stiffness = (weighted_sum(terms, values)[own][:, own] for terms in (matrices.mass, matrices.stiffness))
    n = n_modes
    while True:  # one more shows whether the last has its frequency alone
        squares, vectors = _lowest(stiffness, mass, min(n_rigid + n + 1, n_dofs))
        omega = np.sqrt(squares[n_rigid:])
        if n == omega.size or not _repeated(omega)[n - 1]:
            return omega[:n], vectors[:, n_rigid : n_rigid + n], mass
        n += 1


def _lowest(stiffness: sp.csr_matrix, mass: sp.csr_matrix, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the n lowest eigenvalues of a free body, in order, and their M-orthonormal vectors."""
    n_dofs = mass.shape[0]
    if n_dofs <= DENSE or n >= n_dofs - 1:
        return eigh(stiffness.toarray(), mass.toarray(), subset_by_index=(0, n - 1))
    # a small negative shift keeps the matrix regular in spite of the rigid motions
    shift = -1e-9 * stiffness.diagonal().sum() / mass.diagonal().sum()
    start = np.random.default_rng(0).standard_normal(n_dofs)
    squares, vectors = eigsh(stiffness.tocsc(), n, mass.tocsc(), sigma=shift, v0=start)
    order = np.argsort(squares)
    return squares[order], vectors[:, order]
