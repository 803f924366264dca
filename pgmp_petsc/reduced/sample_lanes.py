"""The samples of a reduced batch as they lie in lanes, with all that the compiled equations take and keep of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from pgmp_petsc.bodies.affine import evaluate_weights
from pgmp_petsc.lanes.lane_items import SampleBlocks, aligned
from pgmp_petsc.lanes.vectors import LANES, N_POWERS, N_POWERS_OF_RIGID, aligned_zeros
from pgmp_petsc.reduced.action_frames import KeptPlaces
from pgmp_petsc.reduced.action_kernel import ABOUT, Acting
from pgmp_petsc.reduced.actions import ReducedActions
from pgmp_petsc.reduced.arrays import Equations, Matrix, Memory, Weights
from pgmp_petsc.reduced.carried_forces import CarriedForces
from pgmp_petsc.reduced.terms import ReducedTerms


class ReducedLanes:
    """Samples in blocks of LANES, in an order that may change; no sample's numbers depend on its lane.

    They have parameter values (n_samples,) each; `effects` are the names of the effects with loads, each once, and a
    mask (n_eta,) says which coordinates' motions are prescribed. `equations` are what the kernels take, and `memory`
    what they keep of every block; `load_weights` those of the load terms, (n_load_terms, n_samples), `place_weights` of
    the terms of the places of actions.
    """

    def __init__(
        self,
        terms: ReducedTerms,
        actions: ReducedActions,
        effects: Sequence[str],
        values: Mapping[str, np.ndarray],
        prescribed: np.ndarray,
        n_samples: int,
    ) -> None:
        self._blocks = SampleBlocks(n_samples, LANES, -(-n_samples // LANES))
        self._carried = actions.carried or CarriedForces.none(len(terms.layout.rigid))
        self._term_weights, self.load_weights, self.place_weights, self._gap_weights = (
            np.broadcast_to(evaluate_weights(w, values).T, (n_samples, len(w))).T
            for w in (terms.weights, terms.tables.load_weights, actions.weights, self._carried.weights)
        )
        self.equations = Equations(
            terms.layout,
            terms.grid,
            terms.cells,
            Weights(
                self.packed(self._term_weights),
                self.packed(self.load_weights),
                np.array([effects.index(name) for name in terms.tables.load_effects], dtype=np.int64),
                np.zeros(len(terms.weights), dtype=np.int64),
            ),
            actions.of_samples(values, n_samples),
            0.0 if terms.damping is None else terms.damping.mass,
            prescribed,
            terms.scale,
            self._carried.carried,
        )
        self.memory = self._allocate(len(effects), len(actions.actions), len(actions.edges))

    def _allocate(self, n_effects: int, n_actions: int, n_edges: int) -> Memory:
        """Return what is kept of every block, empty."""
        layout, n_blocks = self.equations.layout, self._blocks.n_blocks
        r, m = len(layout.rigid), layout.n_eta - len(layout.rigid)
        n_powers = N_POWERS**r
        shapes = (m * (m + 1) // 2, r * r, r * m, r * m, m * (m + 1) // 2 if layout.second_order else 0)
        local, n_acting = self.equations.local.places, n_blocks if n_actions else 0
        cells, local_cells = aligned_zeros((n_blocks, LANES)), aligned_zeros((n_acting, 2, LANES))
        cells[:] = local_cells[:] = -1.0
        return Memory(
            self._blocks.samples,
            cells,
            aligned_zeros((n_blocks, layout.n_rigid * N_POWERS_OF_RIGID**r, LANES)),
            aligned_zeros((n_blocks, layout.end * n_powers, LANES)),
            aligned_zeros((n_blocks, n_effects * layout.load_end * n_powers, LANES)),
            Matrix(*(aligned_zeros((n_blocks, n, LANES)) for n in shapes)),
            KeptPlaces(
                local_cells,
                self.packed(self.place_weights)[:n_acting],
                *(aligned_zeros((n_acting, one.polynomials.shape[2], LANES)) for one in (local.rigid, local.shapes)),
            ),
            Acting.empty(n_acting, layout.n_eta),
            np.empty((self._blocks.n_samples, ABOUT + 1, n_actions)),
            np.empty((self._blocks.n_samples, n_edges)),
            self._carried.kept(self.packed(self._gap_weights), self._blocks.n_samples, n_effects, n_actions),
        )

    def zeros(self, dtype: type = float) -> np.ndarray:
        """Return a zero for every lane, aligned, shape (n_blocks, LANES)."""
        return aligned_zeros((self._blocks.n_blocks, LANES)).view(dtype)

    def packed(self, rows: np.ndarray) -> np.ndarray:
        """Return rows (n, n_samples) as vectors, aligned, (n_blocks, n, LANES)."""
        blocks = aligned_zeros((self._blocks.n_blocks, len(rows), LANES))
        blocks[:] = self._blocks.pack(rows)
        return blocks

    def packed_over(self, rows: np.ndarray) -> np.ndarray:
        """Return rows at several instants, of all samples together or of each, (n_t, 1 or n_samples, n), as vectors,
        aligned, (n_t, n_blocks, n, LANES)."""
        found, by_rows = aligned((len(rows), self._blocks.n_blocks, rows.shape[2], LANES)), np.swapaxes(rows, 1, 2)
        found[:] = by_rows[:, None] if rows.shape[1] == 1 else self._blocks.pack(by_rows, 1)
        return found

    def unpacked(self, vectors: np.ndarray) -> np.ndarray:
        """Return vectors (n_blocks, ..., LANES) by samples, shape (..., n_samples)."""
        return self._blocks.unpack(vectors)

    def sets(self, samples: np.ndarray) -> np.ndarray:
        """Return some samples, a mask, as sets of lanes, shape (n_blocks,)."""
        return self._blocks.mask(samples) @ (1 << np.arange(LANES))

    def regroup(self, q: np.ndarray, samples: np.ndarray) -> None:
        """Put samples that are near each other in the tables side by side, and those that are not to advance last.

        Lanes that enter a cell together are filled at once. Coordinates of all samples have shape (n_samples, n_eta);
        samples are the mask of those to advance.
        """
        if self._blocks.n_blocks == 1:
            return
        number = np.zeros(len(q))
        with np.errstate(invalid="ignore"):
            for theta, axis in zip(q.T, self.equations.grid):
                place = (theta - axis.lower) / axis.step
                number = np.floor(number) * axis.n_cells + (place % axis.n_cells if axis.periodic else place)
        blocks = self._blocks.ordered(np.argsort(np.where(samples, number, np.inf), kind="stable"))
        memory, weights, of_lanes = self.memory, self.equations.weights, blocks.samples
        moved = of_lanes != memory.samples
        if moved.any():
            self._blocks = blocks
            memory.samples[:], memory.cells[moved] = of_lanes, -1.0
            np.moveaxis(memory.places.cells, 1, -1)[moved[: len(memory.places.cells)]] = -1.0
            weights.terms[:], weights.loads[:] = blocks.pack(self._term_weights), blocks.pack(self.load_weights)
            memory.places.weights[:] = blocks.pack(self.place_weights)[: len(memory.places.weights)]
            memory.carried.cells[moved[: len(memory.carried.cells)]] = -1.0
            memory.carried.weights[:] = blocks.pack(self._gap_weights)

    def matrices(self) -> np.ndarray:
        """Return the iteration matrices without their skew part, shape (n_samples, n_eta, n_eta)."""
        r, n = len(self.equations.layout.rigid), self.equations.layout.n_eta
        factor, corner, column, row = (self.unpacked(part).T for part in self.memory.matrix[:4])
        result = np.empty((len(factor), n, n))
        rows, columns = np.tril_indices(n - r)
        result[:, r + rows, r + columns] = result[:, r + columns, r + rows] = factor
        result[:, :r, :r] = corner.reshape(-1, r, r)
        result[:, r:, :r] = np.swapaxes(column.reshape(-1, r, n - r), 1, 2)
        result[:, :r, r:] = row.reshape(-1, r, n - r)
        return result
