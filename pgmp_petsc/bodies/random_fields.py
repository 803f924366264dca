"""The random fields of a body: what its constants are multiplied by in every cell, affine in the fields' parameters.

    E(x) = E (1 + v sum_k sqrt(lambda_k) phi_k(x) xi_k),        int C(x, y) phi_k(y) dy = lambda_k phi_k(x),

with the coefficient of variation v and the Karhunen-Loeve expansion of a field of variance 1 and the correlation C,
``int phi_k^2 = 1`` (Ghanem and Spanos 1991, ch. 2; docs/uncertainty.md, random fields). The parameters xi_k are
bounded, so that ``1 - v sum_k |sqrt(lambda_k) phi_k(x)| max |xi_k|`` is the least factor that any sample can have
anywhere.

With one value a cell, at its middle, and the cells' volumes w as integration weights (Nystrom's method) it is the
symmetric eigenproblem of ``B = W^1/2 C W^1/2``. B is factored as ``B ~ L L^T`` by pivoted Cholesky (Harbrecht, Peters
and Schneider 2012), which knows how much of the trace is left out, so that the eigenvectors are those of the small
``L^T L``. The trace is the body's volume: ``lambda_k`` over it is the share of the variance that term k keeps.

Symmetric bodies have terms of one eigenvalue, a square plate the second and the third: any rotation of them is as good,
and round-off would choose one. They are those that ``int g phi_i phi_j`` is diagonal for, with increasing values, where
``g = sum_a a exp(2 x_a / L)`` of the place x from the middle of the extent L has no symmetry of its own.

Kernels are those of Rasmussen and Williams (2006, ch. 4), with r over the correlation length l:

    exponential  exp(-r/l)      squared_exponential  exp(-(r/l)^2 / 2)
    matern       2^(1-s) / Gamma(s) z^s K_s(z),  z = sqrt(2 s) r/l,  with the smoothness s; s = 1/2 is exponential
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache, partial

import numpy as np

from pgmp_petsc.base.errors import InputError, Remark, note, warning
from pgmp_petsc.bodies.affine import Monomial
from pgmp_petsc.bodies.profile import UNIFORM, Profile, Profiles
from pgmp_petsc.mesh.meshes import LineMesh, SolidMesh, reference_element
from pgmp_petsc.scene import Scene

ROLE = {"E": "modulus", "rho": "density"}  # of others it is a size
LEAST = 0.01  # of the mean: what a quantity may fall to
# of the correlation length: larger cells miss the field between their middles (Der Kiureghian and Ke 1988)
COARSE = 0.5
MUCH = 0.8  # of the variance: expansions that keep less are warned of
MORE = 4  # times the terms: how far a message looks for as many as would do


def profiles_of(scene: Scene, body: str, mesh: LineMesh | SolidMesh) -> Profiles:
    """Return the factors of a body on its mesh.

    Raises `InputError` if a field has more terms than the body has cells, keeps too little of its variance, or may fall
    to zero.
    """
    found: dict[str, Profile] = {}
    for name, field in scene.fields.items():
        if field.body == body:
            terms = field.variation * checked_expansion(scene, name, mesh).functions
            weights = [Monomial(((variable, 1),)) for variable in field.names(name)]
            found[ROLE.get(field.quantity, "size")] = Profile(dict(zip(weights, terms)))
    return Profiles(**found) if found else UNIFORM


def checked_expansion(scene: Scene, name: str, mesh: LineMesh | SolidMesh) -> Expansion:
    """Return the expansion of a scene's field over the mesh of its body; raises as `profiles_of`."""
    field, entry, (places, volumes) = scene.fields[name], f"fields.{name}", _cells(mesh)
    if field.terms > volumes.size:
        raise InputError(
            f"{entry}.terms = {field.terms}: {field.body} has {volumes.size} cells, and no more terms; take fewer, or "
            "a finer mesh"
        )
    expanded = partial(expansion, places, volumes, field.kernel, field.length, field.smoothness or 0.5)
    found = expanded(field.terms)
    if found.kept < field.least_share:
        more = expanded(min(MORE * field.terms, volumes.size))
        enough = np.flatnonzero(np.cumsum(more.shares) >= field.least_share)
        cure = f"take {enough[0] + 1}" if enough.size else f"take more than {more.shares.size}"
        raise InputError(
            f"{entry}.terms = {field.terms}: they keep {found.kept:.4g} of the variance, less than {entry}.least_share "
            f"= {field.least_share:g}; {cure}, or a longer correlation"
        )
    reach = np.sum(np.abs(found.functions), axis=0) * field.reach
    worst = int(np.argmax(reach))
    if not field.variation * reach[worst] <= 1.0 - LEAST:
        place, unit = scene.system.named(places[worst], "m")
        at = ", ".join(f"{x:.4g}" for x in place)
        limit, cure = "", "or fewer terms"
        if field.distribution == "normal":
            limit, cure = f" within {field.limit:g} deviations", 'a lower limit, or distribution = "uniform"'
        raise InputError(
            f"{entry}.variation = {field.variation:g}: with {field.terms} {field.distribution} variables{limit} "
            f"{field.quantity} of {field.body} may fall to {1.0 - field.variation * reach[worst]:.3g} times its mean, "
            f"at ({at}) {unit}, and must stay positive; take at most {(1.0 - LEAST) / reach[worst]:.3g}, {cure}"
        )
    return found


def field_remarks(scene: Scene, meshes: Mapping[str, LineMesh | SolidMesh]) -> Iterator[Remark]:
    """Yield what the expansions of a scene's fields keep and leave out; raises as `profiles_of`."""
    for name, field in scene.fields.items():
        mesh = meshes[field.body]
        found = checked_expansion(scene, name, mesh)
        least, most = (100 * field.variation * part for part in (found.deviations.min(), found.deviations.max()))
        text = (
            f"fields.{name}: {field.terms} {'term keeps' if field.terms == 1 else 'terms keep'} "
            f"{100 * found.kept:.3g} % of the variance of {field.quantity} over {field.body}; its coefficient of "
            f"variation is {least:.3g} to {most:.3g} % in place of {100 * field.variation:g} %"
        )
        say = note if found.kept >= MUCH else warning
        yield say(text if found.kept >= MUCH else f"{text}; take more fields.{name}.terms")
        size = float(np.max(np.ptp(mesh.nodes[mesh.cells], axis=1).max(axis=1)))
        if size > COARSE * field.length:
            yield warning(
                f"fields.{name}.length = {scene.system.shown(field.length, 'm'):g}: cells of {field.body} are up to "
                f"{scene.system.text(size, 'm')} long, more than half of it, and each has one value; take a finer mesh"
            )


def _cells(mesh: LineMesh | SolidMesh) -> tuple[np.ndarray, np.ndarray]:
    """Return the middles (n_cells, d) and the volumes (n_cells,) of the cells of a mesh."""
    middles = mesh.nodes[mesh.cells].mean(axis=1)
    if isinstance(mesh, LineMesh):
        return middles, mesh.lengths
    from pgmp_petsc.bodies.elasticity import volumes_of

    return middles, volumes_of(mesh.nodes[mesh.cells], reference_element(mesh.kind).mass).sum(axis=1)


LEFT_OUT = 1e-12  # of the trace: below, round-off decides
NUMBERS = 40_000_000  # of a factor: 320 MB
OVERSAMPLING = 100  # columns of a factor beside the wanted terms, at least
ALIKE = 1e-6  # of an eigenvalue, by which that of the next term is one with it
SEVERAL = 12  # terms behind the last one that may have its eigenvalue: symmetries of bodies make three of them
TIED = 1e-9  # of the largest remaining diagonal entry: of such the first cell is taken, not what round-off makes larger


@dataclass(frozen=True, eq=False)
class Expansion:
    """The first terms of an expansion."""

    functions: np.ndarray  # ``sqrt(lambda_k) phi_k`` in the cells, shape (n_terms, n_cells)
    shares: np.ndarray  # of the variance over the body that each term keeps, shape (n_terms,)

    @property
    def kept(self) -> float:
        """Share of the variance over the body that all terms keep."""
        return float(self.shares.sum())

    @property
    def deviations(self) -> np.ndarray:
        """Deviation of the truncated field in the cells, shape (n_cells,); that of the whole one is 1."""
        return np.sqrt(np.sum(self.functions**2, axis=0))


def correlation(kernel: str, distances: np.ndarray, smoothness: float = 0.5) -> np.ndarray:
    """Return the correlation at distances over the correlation length, of any shape; see the module."""
    if kernel == "exponential":
        return np.exp(-distances)
    if kernel == "squared_exponential":
        return np.exp(-0.5 * distances**2)
    from scipy.special import gamma, kv

    z = np.sqrt(2.0 * smoothness) * distances
    apart = z > 1e-10  # nearer, the correlation is 1 to round-off, and K_s is infinite
    found = np.ones_like(z)
    found[apart] = 2.0 ** (1.0 - smoothness) / gamma(smoothness) * z[apart] ** smoothness * kv(smoothness, z[apart])
    return found


def expansion(
    places: np.ndarray, volumes: np.ndarray, kernel: str, length: float, smoothness: float, n_terms: int
) -> Expansion:
    """Expand a field of variance 1 over cells in at most n_cells terms.

    Middles of the cells have shape (n_cells, d), m, and volumes m to the dimension of the cells; for the kernel with
    its correlation length (m) and smoothness see the module.
    """
    places, volumes = np.ascontiguousarray(places, dtype=float), np.ascontiguousarray(volumes, dtype=float)
    return _expansion(places.tobytes(), volumes.tobytes(), places.shape[1], kernel, length, smoothness, n_terms)


@lru_cache(maxsize=16)  # every model of a body asks for the same one
def _expansion(
    places: bytes, volumes: bytes, d: int, kernel: str, length: float, smoothness: float, n_terms: int
) -> Expansion:
    at, weights = np.frombuffer(places).reshape(-1, d), np.frombuffer(volumes)
    roots = np.sqrt(weights)

    def column(k: int) -> np.ndarray:
        return roots * roots[k] * correlation(kernel, np.linalg.norm(at - at[k], axis=1) / length, smoothness)

    factor = _pivoted_cholesky(column, weights, max(n_terms + OVERSAMPLING, NUMBERS // weights.size))
    values, vectors = (part[..., ::-1][..., : n_terms + SEVERAL] for part in np.linalg.eigh(factor.T @ factor))
    functions = ((factor @ vectors) / roots[:, None]).T
    middle, extent = weights @ at / weights.sum(), np.ptp(at, axis=0).max() or 1.0
    uneven = weights * (np.exp(2.0 * (at - middle) / extent) @ np.arange(1.0, d + 1.0))
    for group in np.split(np.arange(values.size), 1 + np.flatnonzero(-np.diff(values) > ALIKE * values[:-1])):
        own = functions[group]
        functions[group] = np.linalg.eigh((own * uneven) @ own.T)[1].T @ own
    functions, shares = functions[:n_terms], np.maximum(values[:n_terms], 0.0) / weights.sum()
    # positive at the first cell where it is large: round-off must not choose the sign of one as large on both sides
    large = np.abs(functions) > 0.5 * np.abs(functions).max(axis=1, keepdims=True)
    first = functions[np.arange(len(functions)), np.argmax(large, axis=1)]
    return Expansion(functions * np.where(first < 0.0, -1.0, 1.0)[:, None], shares)


def _pivoted_cholesky(column: Callable[[int], np.ndarray], diagonal: np.ndarray, most: int) -> np.ndarray:
    """Return L of ``B ~ L L^T`` with the columns that B's largest remaining diagonal entries name, shape (n, m)."""
    rest, trace = diagonal.copy(), float(diagonal.sum())
    found = np.empty((min(most, diagonal.size), diagonal.size))
    for m in range(len(found)):
        if rest.sum() <= LEFT_OUT * trace:
            return found[:m].T.copy()
        pivot = int(np.argmax(rest >= (1.0 - TIED) * rest.max()))
        found[m] = (column(pivot) - found[:m].T @ found[:m, pivot]) / np.sqrt(rest[pivot])
        rest = np.maximum(rest - found[m] ** 2, 0.0)
        rest[pivot] = 0.0
    return found.T.copy()
