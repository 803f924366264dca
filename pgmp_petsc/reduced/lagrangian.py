"""The Lagrangian of the reduced model: its terms in index notation, and all that is printed from them.

For any number of rigid coordinates theta_k and flexible ones delta, eta = [theta, delta]::

    T = 1/2 eta'^T Mass eta'      Mass_kl = M_kl + 2 b_kl.delta - delta^T c_kl delta
                                  Mass_kd = M_kd + (A_k^T + P_k) delta,    Mass_dd = M_dd
    U = 1/2 delta^T K delta + 1/6 V delta delta delta - a(t) (Q.eta + 1/2 delta^T B delta)

with tables that depend on theta, one index d for the flexible coordinates, and a(t) the amplitudes of the loads (Naets
et al. 2015, eqs. (11)-(12)). The residual is ``r = d/dt dT/d eta' - dT/d eta + dU/d eta``, d_k = d/d theta_k::

    r = M eta'' + sum_k theta_k' (d_k M) eta' + K delta - a Q + ...
        and in the rows of theta  - 1/2 eta'^T (d_k M) eta' + 1/2 delta^T (d_k K) delta - a (d_k Q).delta + ...

b is the symmetric part of ``(d_k rho)^T M (d_l Psi)``. Of second order in delta, where a scene asks for them (a
quadratic manifold as of Jain et al. 2017 with the modal derivatives chi of Wu and Tiso 2016)::

    V = third derivative of the strain energy,  B = f^T chi
    c_kl = (d_k d_l rho)^T M chi - sym(D_k^T M D_l) - sym(d_l P_k),   P_k = (d_k rho)^T M chi,
    A_k = skew part of D_k^T M Psi,   D_k = d_k (R Psi)

docs/method.md (reduced equations; second order in the deformation) says what each is, and what is left out.

Structural damping adds ``D eta'``. Damping proportional to the mass, ``alpha dT/d eta'``, needs no term of its own:
because T is quadratic in eta', it is what ``alpha eta'`` added to eta'' makes of the inertia forces.

With all of it the system is Lagrangian in the interpolated tables and conserves energy. Terms that a scene does not
call for have no entries. The iteration matrix leaves out second derivatives of the tables. Its flexible block is
symmetric but for gyroscopic terms, rows and columns of theta border it.

Rows of `TERMS` are these terms (`declare.forms`). Printed are residual and iteration matrix of LANES samples at once,
and the same in C; the exact derivatives of the residual; and the energies, which come from the same tables.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from fractions import Fraction
from pathlib import Path

import numpy as np

from pgmp_petsc.bodies.affine import evaluate_weights
from pgmp_petsc.declare.expressions import kept
from pgmp_petsc.declare.forms import (
    ANY,
    THETA,
    Loops,
    Polynomial,
    Target,
    Term,
    at,
    equations,
    in_c,
    in_python,
    tangents,
    total,
)
from pgmp_petsc.lanes.compiled import njit, text_mark
from pgmp_petsc.reduced.terms import ReducedTerms
from pgmp_petsc.reduction.cell_products import unpacked
from pgmp_petsc.reduction.interpolation import Interpolant
from pgmp_petsc.reduction.tables import with_units

HALF = Fraction(1, 2)
Output = tuple[Target, str, Polynomial, str]


def packed(letter: str) -> str:
    """Return how many entries are before a row of a packed symmetric matrix."""
    return f"({letter} * ({letter} + 1) >> 1)"


_CUBIC = f"layout.cubic + i * (i + 1) * (i + 2) // 6 + {packed('j')} + h"
_PAIR = f"({packed('k')} + l)"
_MATRIX = f"{packed('i')} + j"
_SECOND, _DRIVEN, _DAMPED = "second order", "prescribed motions of second order", "structural damping"
#: Letters k and l are of theta, i, j and h of delta. The parts of M, Q and D have different tables or rules.
TERMS = (
    Term("1/2 M[kl] v_k v_l", _PAIR, "rigid", "kinetic"),
    Term("M[i,k] v_i v_k", f"{packed('(r + i)')} + k", "inertia", "kinetic"),
    Term("1/2 M[ij] v_i v_j", f"{packed('(r + i)')} + r + j", "inertia", "kinetic"),
    Term("1/2 K[ij] q_i q_j", f"layout.stiffness + {_MATRIX}", "terms", "potential",
         less=Term("1/2 B[ij] q_i q_j", f"n + {_MATRIX}", "load", "load", "loads of second order")),
    Term("b[kl,i] v_k v_l q_i", f"layout.coupling + {_PAIR} * m + i", "inertia", "kinetic"),
    Term("Q[k] q_k", "k", "load", "force", "loads"),
    Term("Q[i] q_i", "r + i", "load", "load", "loads"),
    Term("1/6 V[ijh] q_i q_j q_h", _CUBIC, "terms", "potential", _SECOND),
    Term("-1/2 c[kl,ij] v_k v_l q_i q_j", f"layout.swing + {_PAIR} * {packed('m')} + {_MATRIX}", "terms",
         "kinetic", _SECOND),
    Term("A[k,i^j] v_k q_i v_j", "layout.gyroscopic + k * (m * (m - 1) >> 1) + (i * (i - 1) >> 1) + j", "terms",
         "kinetic", _SECOND),
    Term("P[k,ij] v_k q_i v_j", f"layout.driven + k * {packed('m')} + {_MATRIX}", "terms", "kinetic", _DRIVEN),
    Term("1/2 D[kl] u_k u_l", f"layout.damping + {_PAIR}", "terms", "dissipation", _DAMPED),
    Term("D[i,k] u_i u_k", f"layout.damping + {packed('(r + i)')} + k", "terms", "dissipation", _DAMPED),
    Term("1/2 D[ij] u_i u_j", f"layout.damping + {packed('(r + i)')} + r + j", "terms", "dissipation", _DAMPED),
)  # fmt: skip
CONDITIONS = {
    "loads": "loaded",
    _SECOND: "layout.cubic < layout.damping",
    _DRIVEN: "layout.driven < layout.damping",
    "loads of second order": "loaded and layout.cubic < layout.damping",
    _DAMPED: "layout.damping < layout.end",
}
PYTHON = '''"""The Lagrangian of the reduced model, printed from its terms."""

from pgmp_petsc.lanes.compiled import njit
from pgmp_petsc.lanes.vectors import (
    add, add_product, add_to_row, add_to_rows, dot, load, load_rows, polynomial, spread, store, zeros
)
from pgmp_petsc.reduced.arrays import layout_n_rigid


@njit(inline="always")
def inertia_of(layout, kept, entry, place):
    """Return an entry of the inertia, with its derivatives where inertia forces quadratic in the velocities act."""
    value, slopes = polynomial(kept, entry, place)
    return value, slopes if layout.quadratic else zeros(place)


@njit(cache=True, error_model="numpy", fastmath={{"contract"}}, counted=False)
def evaluate(layout, kept, place, gain_v, gain_a, fresh, loaded, work, matrix):
    """Evaluate the residual into ``work.balance`` and, if `fresh`, the iteration matrix; see `Work` and `Matrix`.

    `kept` are polynomials of the cell of every sample, weighted with its parameters: rows of `polynomial`; `place` is
    that in the cell, a tuple of vectors. The positions of `work` are those of the iterate, ``v`` and ``a`` what the
    inertia forces see; gain_v and gain_a are the derivatives of eta' and eta'' with eta within a step, vectors.
    """
    q, v, a, rate, balance = work.q, work.v, work.a, work.rate, work.balance
    factor, corner, column, row, skew = matrix.factor, matrix.corner, matrix.column, matrix.row, matrix.skew
    r, n = len(place), layout.n_eta
    m = n - r
    velocity = load_rows(v, 0, 1, place)
    for e in range(n):
        store(balance, e, 0.0)
    if fresh:
        for e in range(r * r):
            store(corner, e, 0.0)
        for e in range(r * m):
            store(column, e, 0.0)
            store(row, e, 0.0)
        for e in range(skew.shape[0]):
            store(skew, e, 0.0)
{evaluate}


@njit(cache=True, apart=True, error_model="numpy", fastmath={{"contract"}}, counted=False)
def fill_residual(layout, jets, load_jets, first, slopes, place, loaded, moment, balance):
    """Fill the residual (n_eta,).

    Parameters
    ----------
    jets, load_jets
        Of the tables and of all loads together, with their amplitudes; see `gradients.linearisation`.
    first, slopes
        Where in a jet the value and the derivatives begin of what is taken for the tables.
    place
        A tuple as long as there are rigid coordinates.
    loaded
        Whether there are loads.
    moment
        Coordinates, velocities and accelerations as inertia forces see them, and velocities, (4, n_eta).
    """
    q, v, a, rate = moment[0], moment[1], moment[2], moment[3]
    r, n, width = len(place), layout.n_eta, jets.shape[1]
    m = n - r
    velocity = load_rows(v, 0, 1, place)
    for e in range(n):
        store(balance, e, 0.0)
{residual}


@njit(cache=True, apart=True, error_model="numpy", fastmath={{"contract"}}, counted=False)
def fill_tangents(layout, jets, load_jets, place, loaded, moment, by_q, by_v, by_a):
    """Fill the derivatives (n_eta, n_eta) of the residual with coordinates, velocities and accelerations.

    Columns of theta of `by_q` are left zero; other parameters are those of `fill_residual`.
    """
    first, slopes = 0, 1
    q, v, a, rate = moment[0], moment[1], moment[2], moment[3]
    r, n, width = len(place), layout.n_eta, jets.shape[1]
    m = n - r
    velocity = load_rows(v, 0, 1, place)
    for e in range(n * n):
        store(by_q, e, 0.0)
        store(by_v, e, 0.0)
        store(by_a, e, 0.0)
{tangents}


@njit(cache=True, entry=True, error_model="numpy", counted=False)
def fill_energies(layout, entries, q, v, kinetic, strain):
    """Add the energies of states (n, n_eta) with their tables' entries (n, n_entries) to results (n,), J."""
    r, n = len(layout.rigid), layout.n_eta
    m = n - r
    for s in range(q.shape[0]):
{energies}


C = """{c}"""

COMPLETE = True
'''
C = """struct slopes {{ double of[R]; }};
#define load(array, at) ((array)[at])
#define store(array, at, x) ((array)[at] = (x))
#define add(array, at, x) ((array)[at] += (x))
#define add_to_row(array, at, x, y) ((array)[at] += (x) * (y))
#define spread(x) (x)
#define loaded (N_LOADS > 0)
#define zeros(place) ((struct slopes){{{{0}}}})

static inline struct slopes load_rows(const double *array, int first, int stride) {{
    struct slopes x;
    for (int k = 0; k < R; k++) x.of[k] = array[first + k * stride];
    return x;
}}

static inline struct slopes add_product(struct slopes total, struct slopes x, double y) {{
    for (int k = 0; k < R; k++) total.of[k] += x.of[k] * y;
    return total;
}}

static inline double dot(struct slopes x, struct slopes y) {{
    double total = 0.0;
    for (int k = 0; k < R; k++) total += x.of[k] * y.of[k];
    return total;
}}

static inline void add_to_rows(double *array, int first, int stride, struct slopes x, double y) {{
    for (int k = 0; k < R; k++) array[first + k * stride] += x.of[k] * y;
}}

/* Residual at eta, its rates and their rates and, if `fresh`, the iteration matrix without second derivatives of
   tables. */
void evaluate_lagrangian(const struct terms *t, const double q[N], const double rate[N], const double rates[N],
                         double gain_v, double gain_a, int fresh, double balance[N], struct matrix *matrix) {{
    enum {{ r = R, n = N, m = M }};
    const double *rigid = t->rigid[0], *table = t->table[0], *loads = t->load[0];
    double v[N], a[N], *factor = matrix->factor, *skew = matrix->skew;
    double *corner = matrix->corner[0], *column = matrix->column[0], *row = matrix->row[0];
    memset(balance, 0, N * sizeof(double));
    if (fresh) memset(matrix, 0, sizeof *matrix);
    /* damping proportional to the mass is what it adds to the accelerations */
    gain_a += gain_v * MASS_DAMPING;
    for (int i = 0; i < N; i++) v[i] = QUADRATIC ? rate[i] : 0.0, a[i] = rates[i] + MASS_DAMPING * rate[i];
    const struct slopes velocity = load_rows(v, 0, 1);
{evaluate}
}}
"""


def _iterated(term: Term, bound: Sequence[str]) -> Iterator[Output]:
    """Yield what an entry adds to the residual and, if `fresh`, to the iteration matrix.

    That leaves out what hardly matters to Newton's iteration: second derivatives of tables, and in the border of the
    flexible block, of terms of second order but for loads, their changes with theta and, in its rows and columns, with
    delta' and delta''. Prescribed coordinates are not corrected, so that their terms have no part in the border.
    """
    yield from _balanced(term, bound)
    blocks: dict[tuple[str, str, str], Polynomial] = {}
    for part in tangents(term, bound):
        gain = {"q": (), "v": ("gain_v",), "a": ("gain_a",)}[part.order]
        factor = part.factor
        rigid = [one in THETA or one == ANY for one in (part.row, part.column)]
        if any(rigid) and term.only == _DRIVEN:
            continue
        if any(rigid) and term.only == _SECOND:
            if part.source != "value":
                continue
            if not all(rigid):  # without rates of flexible coordinates
                rates = {f for f in factor if any(one[0] in "va" and one[2:] not in THETA for one in f)}
                factor = {f: x for f, x in factor.items() if f not in rates}
        key = part.row, part.column, part.source
        blocks[key] = total((1, blocks.get(key, {})), (1, total((1, factor), by=gain)))
    for (x, y, source), factor in blocks.items():
        if not ({x, y} & {ANY, *THETA}):
            if bound.index(x) <= bound.index(y):  # row x of the lower triangle, which is the outer loop's
                other = blocks.get((y, x, source), {})
                place = f"{packed(x)} + {y}"
                even = total((HALF, factor), (HALF, other))
                yield Target("factor", place), source, even, "fresh"
                yield Target("skew", place), source, total((HALF, factor), (-HALF, other)), "fresh"
        else:
            yield _bordered(x, y), source, factor, "fresh"


def _bordered(x: str, y: str) -> Target:
    """Return the place of a derivative of row x with y in the border of the flexible block."""
    if y == ANY:
        return Target("corner", f"{x} * r", "1") if x in THETA else Target("column", x, "m")
    if x == ANY:
        return Target("corner", y, "r") if y in THETA else Target("row", y, "m")
    if x in THETA and y in THETA:
        return Target("corner", f"{x} * r + {y}")
    outer, inner, array = (x, y, "row") if x in THETA else (y, x, "column")
    return Target(array, f"{outer} * m + {inner}")


def _balanced(term: Term, bound: Sequence[str]) -> Iterator[Output]:
    """Yield what an entry adds to the residual."""
    for part in equations(term, bound):
        x = part.row
        target = Target("balance", "0", "1") if x == ANY else Target("balance", at(x))
        yield target, part.source, part.factor, ""


def _differentiated(term: Term, bound: Sequence[str]) -> Iterator[Output]:
    """Yield what an entry adds to the derivatives of the residual, but for the columns of theta of `by_q`."""
    for part in tangents(term, bound):
        x, y, array = part.row, part.column, f"by_{part.order}"
        if y == ANY and part.order == "q":
            continue
        if ANY in (x, y):
            target = Target(array, at(y), "n") if x == ANY else Target(array, f"({at(x)}) * n", "1")
        else:
            target = Target(array, f"({at(x)}) * n + {at(y)}")
        yield target, part.source, part.factor, ""


def _stored(term: Term, bound: Sequence[str]) -> Iterator[Output]:
    """Yield what an entry adds to the energies."""
    if term.kind in ("kinetic", "potential"):
        kinetic = term.kind == "kinetic"
        scale = 1 if kinetic else -1
        yield Target("kinetic" if kinetic else "strain", "s"), "value", total((scale, term.factor_of(bound))), ""


def _printed() -> str:
    of_c = {
        name: (f"load({array}, {{}})", f"load_rows({array}, {end} + {{}}, {end})")
        for name, array, end in (
            ("rigid", "rigid", "PACKED(R)"), ("inertia", "table", "END"), ("terms", "table", "END"),
            ("load", "loads", "LOAD_END"),
        )
    }  # fmt: skip
    jets = {
        name: (f"load({array}, ({{}}) * width + first)", f"load_rows({array}, ({{}}) * width + slopes, 1, place)")
        for name, array in (("rigid", "jets"), ("inertia", "jets"), ("terms", "jets"), ("load", "load_jets"))
    }
    lanes = {
        "rigid": ("load(work.rigid, {})", "load_rows(work.rigid_slope, {}, layout_n_rigid(r), place)"),
        "inertia": "inertia_of(layout, kept, {}, place)",
        "terms": "polynomial(kept, {}, place)",
        "load": ("load(work.load, {})", "load_rows(work.load_slope, {}, layout.load_end, place)"),
    }
    stored = dict.fromkeys(jets, ("entries[s, {}]", ""))
    energies = Loops(_stored, stored, CONDITIONS, read="{}[s, {}]", add="{}[{}] += {}")

    def python(loops: Loops, indent: str = "    ") -> str:
        return "\n".join(indent + line for line in in_python(loops.lines(TERMS)))

    c = "\n".join(f"    {line}" for line in in_c(Loops(_iterated, of_c, CONDITIONS, "factor").lines(TERMS)))
    c = re.sub(r"layout\.(\w+)", lambda one: one[1].upper(), c)  # places in a row are constants of a model
    return PYTHON.format(
        evaluate=python(Loops(_iterated, lanes, CONDITIONS, "factor")),
        residual=python(Loops(_balanced, jets, CONDITIONS)),
        tangents=python(Loops(_differentiated, jets, CONDITIONS)),
        energies=python(energies, " " * 8).replace("spread(0.0)", "0.0"),
        c=C.format(evaluate=c),
    )


_MARK = text_mark(__name__, "pgmp_petsc.declare.forms", "pgmp_petsc.declare.expressions")
CODE = kept("lagrangian", _MARK, Path(__file__), _printed)
evaluate, fill_residual = CODE.evaluate, CODE.fill_residual
fill_tangents, fill_energies = CODE.fill_tangents, CODE.fill_energies


SINGULAR = 1e-13  # least eigenvalue of a matrix with a unit diagonal that factors need, some hundred times round-off


def reduced_energy(
    terms: ReducedTerms, values: Mapping[str, float | np.ndarray], q: np.ndarray, v: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return kinetic and strain energies, each of shape (n,), J, of a sample in several states, or of several samples.

    Parameter values are numbers or of shape (n,), reduced coordinates and velocities of shape (n, n_eta). Terms of
    second order in the deformation are in the energies where the model has them.
    """
    layout = terms.layout
    weights, r = evaluate_weights(terms.weights, values), len(layout.rigid)
    entries = _weighted(terms.terms, weights, q[:, :r])
    entries[:, : layout.n_rigid] = _weighted(terms.rigid, weights, q[:, :r])
    kinetic, strain = np.zeros((2, len(q)))
    fill_energies(layout, entries, np.ascontiguousarray(q), np.ascontiguousarray(v), kinetic, strain)
    return kinetic, strain


def _weighted(terms: Interpolant, weights: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """Return the sum of all terms at theta (n, n_theta), shape (n, n_entries).

    Weights have the shape (n_terms,) for several states of one sample, whose terms are added up before they are
    interpolated, or (n_terms, n).
    """
    if weights.ndim == 1:
        return Interpolant(terms.axes, np.tensordot(weights, terms.rows, (0, terms.n_theta)))(theta)
    return np.einsum("tn,nte->ne", weights, terms(theta))


def least_stiffness(terms: ReducedTerms, values: Mapping[str, float | np.ndarray], q: np.ndarray) -> np.ndarray:
    """Return the least share of the stiffness at rest that is left in the deformed state, shape (n,).

    The lowest eigenvalue of the tangent of the strain energy, ``K + V delta``, beside K, of what moves: 1 without terms
    of second order, and negative where their cubic energy, which has no lower bound, has pulled the state over its
    crest. NaN where K itself is not positive definite, as between samples that are too few for their interpolation.
    """
    layout = terms.layout
    weights = np.broadcast_to(evaluate_weights(terms.weights, values).T, (len(q), len(terms.weights)))
    r = len(layout.rigid)
    entries = np.einsum("nt,nte->ne", weights, terms.terms(q[:, :r]))
    moving = slice(terms.tables.n_modes - terms.tables.n_given)
    stiffness = with_units(unpacked(entries[:, layout.stiffness : layout.cubic])[:, moving, moving])
    bent = np.zeros_like(stiffness)
    if layout.second_order:
        cubic = _unpacked_cubic(entries[:, layout.cubic : layout.swing])[:, moving, moving]
        bent = np.einsum("nijk,nk->nij", cubic, q[:, r:])
    # both scaled to a unit diagonal of K, so that round-off decides on nothing but a singular one
    diagonal = np.einsum("nii->ni", stiffness)
    scale = 1.0 / np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0))
    stiffness, bent = (matrix * scale[:, :, None] * scale[:, None, :] for matrix in (stiffness, bent))
    positive = np.linalg.eigvalsh(stiffness)[:, 0] > SINGULAR
    share = np.full(len(q), np.nan)
    lower = np.linalg.inv(np.linalg.cholesky(stiffness[positive]))
    share[positive] = 1.0 + np.linalg.eigvalsh(lower @ bent[positive] @ np.swapaxes(lower, 1, 2))[:, 0]
    return share


def load_powers(
    terms: ReducedTerms, values: Mapping[str, float | np.ndarray], q: np.ndarray, v: np.ndarray
) -> dict[str, np.ndarray]:
    """Return each effect's power per unit amplitude, ``Q.eta' + sum_k theta_k' (d_k Q_delta).delta``, shape (n,), W."""
    tables, r, n_eta = terms.tables, terms.tables.n_coordinates, terms.layout.n_eta
    theta, delta, rate = q[:, :r], np.ascontiguousarray(q[:, r:]), np.ascontiguousarray(v[:, r:])
    load, slopes = terms.load(theta), [terms.load(theta, k) for k in range(r)]
    power = np.einsum("nli,ni->ln", load[:, :, :n_eta], v)
    for k, slope in enumerate(slopes):
        power += v[:, k] * np.einsum("nli,ni->ln", slope[:, :, r:n_eta], delta)
    if terms.layout.second_order:
        # d/dt of 1/2 delta^T B delta
        for number in range(len(power)):
            first = number * load.shape[2] + n_eta
            crossed = [_form(load, first, x) for x in (delta + rate, delta, rate)]
            power[number] += 0.5 * (crossed[0] - crossed[1] - crossed[2])
            for k, slope in enumerate(slopes):
                power[number] += 0.5 * v[:, k] * _form(slope, first, delta)
    weighted = np.broadcast_to(evaluate_weights(tables.load_weights, values).T, power.T.shape).T * power
    result: dict[str, np.ndarray] = {}
    for name, part in zip(tables.load_effects, weighted):
        result[name] = result.get(name, 0.0) + part
    return result


def damping_power(
    terms: ReducedTerms, values: Mapping[str, float | np.ndarray], q: np.ndarray, v: np.ndarray
) -> np.ndarray:
    """Return the power ``-eta'^T D eta'`` of structural damping but for what brakes the momentum, shape (n,), W."""
    entries = terms.damping_terms(q[:, : terms.tables.n_coordinates])
    weights = np.broadcast_to(evaluate_weights(terms.weights, values).T, (len(q), len(terms.weights)))
    return -_form(np.einsum("nt,nte->ne", weights, entries), 0, v)


def _form(entries: np.ndarray, first: int, x: np.ndarray) -> np.ndarray:
    """Return ``x^T A x`` for symmetric matrices packed from an entry on, in tables (n, ...), and x (n, m)."""
    result = np.zeros(len(x))
    _add_forms(entries.reshape(len(x), -1), first, np.ascontiguousarray(x), result)
    return result


@njit(cache=True, entry=True, error_model="numpy", counted=False)
def _add_forms(entries, first, x, result):
    """Add ``x^T A x`` to a result (n,); see `_form`."""
    for k in range(x.shape[0]):
        entry = first
        for i in range(x.shape[1]):
            row = 0.0
            for j in range(i):
                row += entries[k, entry + j] * x[k, j]
            result[k] += x[k, i] * (2.0 * row + entries[k, entry + i] * x[k, i])
            entry += i + 1


def _unpacked_cubic(packed: np.ndarray) -> np.ndarray:
    """Return tensors packed over ``i >= j >= k``, k fastest, as symmetric ones (n, m, m, m)."""
    m = next(m for m in range(packed.shape[1] + 1) if m * (m + 1) * (m + 2) == 6 * packed.shape[1])
    indices = np.indices((m, m, m))
    i, j, k = np.sort(indices, axis=0)[::-1]
    return packed[:, i * (i + 1) * (i + 2) // 6 + j * (j + 1) // 2 + k]
