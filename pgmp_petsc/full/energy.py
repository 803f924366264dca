"""Energies and powers of full-order samples, compiled; see `energies`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from pgmp_petsc.base.surroundings import Comm
from pgmp_petsc.bodies.beam2d import strain_rates, strains, stresses, viscous_stresses, work_of
from pgmp_petsc.effects import Motion
from pgmp_petsc.full.damping import add_modal_damping
from pgmp_petsc.full.elements import add_energies, add_energies_of_beams, add_energies_of_masses
from pgmp_petsc.full.floating import add_energies_of_floating
from pgmp_petsc.full.forces import act
from pgmp_petsc.full.kernel import of_element
from pgmp_petsc.full.parts import section_owners
from pgmp_petsc.full.problem import FullEquations
from pgmp_petsc.lanes.compiled import njit
from pgmp_petsc.lanes.lane_items import items, sine_cosine
from pgmp_petsc.stepping.second_order_system import Energies

KINETIC, STRAIN, OF_EFFECTS = range(3)  # rows of the table; those of effects begin at the last


@dataclass(frozen=True, eq=False)
class EnergyNames:
    """Which effect each row of a table of energies belongs to, in the order of `energies_of`."""

    #: for every row after the first two whether it is a potential energy, and the name of the effect; None where a body
    #: has no damping
    rows: tuple[tuple[bool, str] | None, ...]

    @classmethod
    def of(cls, equations: FullEquations, motions: Sequence[Motion]) -> EnergyNames:
        """Name the rows of a model."""
        names = equations.damping.effects
        braked = [(False, names[k]) if k in names else None for k in section_owners(equations.unknowns.bodies)]
        of_modes = [(False, one.effect) for one in equations.modal]
        weights = [(effect.conservative, effect.name) for effect in equations.loads]
        acting = [(stored, action.effect) for stored in (False, True) for action in equations.actions]
        return cls((*braked, *of_modes, *weights, *acting, *((False, motion.name) for motion in motions)))

    def energies(self, table: np.ndarray) -> Energies:
        """Return what a table of shape (2 + n_rows, ...) holds."""
        found = Energies(table[KINETIC], table[STRAIN])
        for row, values in zip(self.rows, table[OF_EFFECTS:]):
            if row is not None:
                is_potential, effect = row
                add: Callable = found.add_potential if is_potential else found.add_power
                add(effect, values)
        return found

    def summed(self, table: np.ndarray, comm: Comm) -> Energies:
        """Return the sum of the tables of all ranks, whose rows may be of other effects. Collective on `comm`."""
        own = self.energies(table)
        found = Energies(*comm.allreduce(np.array([own.kinetic, own.strain])))
        for kind in ("potential", "powers"):
            parts = comm.allgather(getattr(own, kind))
            for effect in dict.fromkeys(effect for part in parts for effect in part):
                getattr(found, kind)[effect] = sum(part[effect] for part in parts if effect in part)
        return found


@njit(cache=True, entry=True, error_model="numpy")
def energies_of(problem, conservative, strengths, blocks, q, v, multipliers, turns):
    """Return energies and powers of states, shape (n, n_rows, n_lanes), J and W; of what is counted on this rank.

    Rows are the kinetic and the strain energy, the power of the structural damping of every body, of modal damping, of
    loads (their potential energy where they are conservative, a mask (n_loads,)), of actions, the potential energy of
    actions, and the power of prescribed motions. Of each state `strengths` has what acts, one a row, and `blocks` the
    block of samples, (n,); states have shapes (n, n_dofs, n_constraints or n_turns, n_lanes).
    """
    n_lanes, n_bodies = q.shape[2], problem.section.shape[1]
    n_modal, n_loads = problem.modal.kinds.size, conservative.size
    n_angles = problem.angles.dofs.shape[0]
    n_actions, n_motions = problem.actions.counted.size, strengths.speeds.shape[1]
    modal = OF_EFFECTS + n_bodies
    loads = modal + n_modal
    actions = loads + n_loads
    motions = actions + 2 * n_actions
    table = np.zeros((q.shape[0], motions + n_motions, n_lanes))
    unwanted, nowhere = np.zeros(q.shape[1:]), np.arange(q.shape[1])
    for k in range(q.shape[0]):
        block, result = blocks[k], table[k]
        powers = result[OF_EFFECTS:modal]
        if problem.elements.length.size:
            _add_elements(problem.elements, problem.width, problem.section, block, q[k], v[k], result)
        if problem.lumps.dofs.size:
            _add_lumps(problem.lumps, problem.width, problem.section, block, v[k], result)
        if problem.solids.region.size:
            add_energies(problem.solids, block, q[k], v[k], result[KINETIC], result[STRAIN], powers)
        if problem.beams.length.size:
            add_energies_of_beams(
                problem.beams, problem.rayleigh, block, q[k], v[k], result[KINETIC], result[STRAIN], powers
            )
        if problem.masses.body.size:
            add_energies_of_masses(problem.masses, problem.rayleigh, block, v[k], result[KINETIC], powers)
        if problem.floating.body.size:
            add_energies_of_floating(
                problem.dimension, problem.floating, problem.width, problem.rayleigh, block, strengths.loads[k],
                conservative, q[k], v[k], result, powers, result[loads:actions],
            )  # fmt: skip
        if n_modal:
            add_modal_damping(problem.modal, problem.dimension, q[k], v[k], unwanted, nowhere, result[modal:loads])
            for body in range(n_modal):
                if not problem.modal.counted[body]:
                    result[modal + body] = 0.0
        for entry in range(problem.loads.dofs.size):
            number, dof = problem.loads.numbers[entry], problem.loads.dofs[entry]
            for lane in range(n_lanes):
                moved = -q[k, dof, lane] if conservative[number] else v[k, dof, lane]
                strength = strengths.loads[k, number] * problem.loads.weights[block, number, lane]
                result[loads + number, lane] += problem.loads.values[entry] * strength * moved
        if n_actions:
            now = act(
                problem.actions, problem.width, block, strengths.actions[k], q[k], v[k], turns[k, n_angles:], 0.0,
                np.bool_(False), np.bool_(False),
            )  # fmt: skip
            for action in range(n_actions):
                if problem.actions.counted[action]:
                    result[actions + action] = now.powers[action]
                    result[actions + n_actions + action] = now.stored[action]
        for row in range(problem.constraints.places.size):
            motion, number = problem.constraints.motions[row], problem.constraints.places[row]
            if motion >= 0 and problem.constraints.counted[row]:
                for lane in range(n_lanes):
                    result[motions + motion, lane] = -multipliers[k, number, lane] * strengths.speeds[k, motion]
    return table


@njit(cache=True, apart=True, error_model="numpy")
def _add_elements(elements, width, sections, block, q, v, result):
    """Add the energies of all elements, and the power of the damping of their bodies."""
    q, v, sections, result = items(q, width), items(v, width), items(sections, width), items(result, width)
    for e in range(elements.length.size):
        if not elements.counted[e]:
            continue
        length, body = elements.length[e], elements.body[e]
        section = sections[block, body, 0], sections[block, body, 1], sections[block, body, 2]
        line, rotary = sections[block, body, 3], sections[block, body, 4]
        u, rate = of_element(q, elements.dofs, e), of_element(v, elements.dofs, e)
        sin, cos = sine_cosine(0.5 * (u[2] + u[5]) + elements.direction[e])
        strain = strains(u, cos, sin, length)
        from_rest = strain[0] - 1.0, strain[1], strain[2]
        result[STRAIN] += 0.5 * work_of(from_rest, stresses(strain, section), length)
        moving = line * (_shared(rate[0], rate[3]) + _shared(rate[1], rate[4])) + rotary * _shared(rate[2], rate[5])
        moving *= length / 3.0  # q'.M q'
        result[KINETIC] += 0.5 * moving
        if elements.damped:
            rates = strain_rates(rate, strain, cos, sin, length)
            viscous = viscous_stresses(rates, section, sections[block, body, 5])
            result[OF_EFFECTS + body] -= work_of(rates, viscous, length) + sections[block, body, 6] * moving


@njit(error_model="numpy", forceinline=True)
def _shared(one, other):
    """Return three times the mean square of what is linear between two values."""
    return one * one + one * other + other * other


@njit(cache=True, apart=True, error_model="numpy")
def _add_lumps(lumps, width, sections, block, v, result):
    """Add the energies of the nodes' own masses, and the power of what brakes them."""
    masses, sections = items(lumps.mass, width), items(sections, width)
    v, result = items(v, width), items(result, width)
    for k in range(lumps.dofs.size):
        dof, body = lumps.dofs[k], lumps.body[k]
        if lumps.counted[k]:
            moving = masses[block, k] * v[dof] * v[dof]
            result[KINETIC] += 0.5 * moving
            result[OF_EFFECTS + body] -= sections[block, body, 6] * moving
