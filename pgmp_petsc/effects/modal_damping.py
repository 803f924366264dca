"""Modal damping of free bodies: a constant matrix in each body's frame, which turns with the body.

    D = sum_i 2 zeta_i omega_i (M phi_i) (M phi_i)^T = P P^T,     forces  -R P P^T R^T q'

with the elastic modes of the free body at the nominal parameters. Rigid motions are M-orthogonal to them and not
damped. The rotation R of a beam is the mass-weighted mean of those of its nodes, in space the rotation closest to the
mean of their directors. That of a body on a mesh is the one that brings the places of its points closest to where they
are, ``int rho x X'^T dV = R U`` (polar decomposition, with X' the places less their centre of mass). The forces are
those of `dynamics.full_modal`.

The amplitudes of a body in a floating frame are those of its elastic modes at the nominal parameters, the first ones
exact: each is damped by itself, ``2 zeta_i omega_i m_i xi_i'``, and the frame is R.

In space a node has a position and three directors. Its angular velocity is ``1/2 sum_k d_k x d_k'``, so that a couple m
acts on its director d_k with the force ``1/2 m x d_k``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pgmp_petsc.bodies.body import Body
from pgmp_petsc.bodies.free_modes import free_modes, own_unknowns
from pgmp_petsc.effects.effect import Effect
from pgmp_petsc.effects.structural_damping import StructuralDamping
from pgmp_petsc.mechanism.space import SPATIAL
from pgmp_petsc.runtime.errors import InputError


@dataclass(frozen=True)
class ModalDamping:
    """Modal damping of one body.

    Attributes
    ----------
    effect
        Name of the effect.
    body
        Number of the body.
    dofs
        Its unknowns that are damped, node after node, shape (n_own,).
    factor
        P in the body's frame, velocities and spins node after node, shape (n_rows, n_modes).
    levers
        What R is measured by: where nodes have rotations of their own their shares in the body's mass, shape (n_nodes,
        1), and on a mesh ``M X'``, shape (n_nodes, d), kg m.
    """

    effect: str
    body: int
    dofs: np.ndarray
    factor: np.ndarray
    levers: np.ndarray


def modal_damping(
    effects: Sequence[Effect], bodies: Sequence[Body], nominal: Mapping[str, float]
) -> tuple[ModalDamping, ...]:
    """Return the modal damping of all bodies on their meshes that have one, for bodies as the unknowns are numbered.

    Raises
    ------
    InputError
        If a body's mesh has fewer modes than ratios are given.
    """
    found = []
    for effect in effects:
        if isinstance(effect, StructuralDamping):
            for number, damping in effect.of_body.items():
                if any(damping.ratios) and bodies[number].floating is None:
                    found.append(_of_body(effect.name, number, bodies[number], damping.ratios, nominal))
    return tuple(found)


def amplitude_damping(
    effects: Sequence[Effect], bodies: Sequence[Body], nominal: Mapping[str, float]
) -> dict[int, tuple[str, np.ndarray]]:
    """Return, by the number of the body, the effect and ``2 zeta_i omega_i m_i`` of every amplitude, shape (n,), N s/m,
    of bodies in floating frames.

    Raises
    ------
    InputError
        If a body has fewer component modes than ratios are given.
    """
    found = {}
    for effect in effects:
        if isinstance(effect, StructuralDamping):
            for number, damping in effect.of_body.items():
                floating, n = bodies[number].floating, len(damping.ratios)
                if floating is None or not any(damping.ratios):
                    continue
                if n > floating.n:
                    raise InputError(
                        f"effects.{effect.name}.ratios: {n} modes of {bodies[number].name} are asked for; it has "
                        f"{floating.n} component modes; take more reduction.modes"
                    )
                mass, stiffness = floating.modal(nominal)
                coefficients = np.zeros(floating.n)
                coefficients[:n] = 2.0 * np.array(damping.ratios) * np.sqrt(stiffness * mass)[:n]
                found[number] = effect.name, coefficients
    return found


def _of_body(
    effect: str, number: int, body: Body, ratios: Sequence[float], nominal: Mapping[str, float]
) -> ModalDamping:
    omega, phi, mass = free_modes(body, nominal, len(ratios), f"effects.{effect}.ratios")
    factor = mass @ phi * np.sqrt(2.0 * np.array(ratios) * omega)
    if body.meshed is not None:
        places = body.meshed.solid.mesh.nodes
        d = places.shape[1]
        along = mass[::d, ::d]
        centre = np.asarray(along.sum(axis=0)) @ places / along.sum()
        return ModalDamping(effect, number, own_unknowns(body), factor, along @ (places - centre))
    of_nodes = mass.diagonal()[: body.node_dofs * body.n_nodes : body.node_dofs, None]
    shares = of_nodes / of_nodes.sum()
    own = own_unknowns(body)
    if body.node_dofs == SPATIAL.n_dofs:
        own = np.arange(*(SPATIAL.n_pose * node for node in (body.nodes.start, body.nodes.stop)))
    return ModalDamping(effect, number, own, factor, shares)
