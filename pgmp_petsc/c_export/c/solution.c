/* Solving with the iteration matrix: factors L D U of the flexible block, bordered by the rigid coordinates.

   L and U have unit diagonals, and U = L^T but for gyroscopic terms. Pivots are positive at reasonable steps; where one
   is not, all becomes NaN.

   written by pgmp_petsc */

#include <math.h>

#include "tables.h"

static const double *upper_of(const struct matrix *m) { return SECOND_ORDER ? m->skew : m->factor; }

static void substitute(const struct matrix *m, double x[]) {
    const double *lower = m->factor, *upper = upper_of(m);
    for (int i = 0; i < M; i++)
        for (int j = 0; j < i; j++) x[i] -= lower[PACKED(i) + j] * x[j];
    for (int i = M - 1; i >= 0; i--) {
        x[i] *= lower[PACKED(i) + i];
        for (int j = i + 1; j < M; j++) x[i] -= upper[PACKED(j) + i] * x[j];
    }
}

/* L takes the place of the symmetric part with D^-1 on its diagonal, U transposed that of the skew part, if any. */
static void factorise(struct matrix *m) {
    double *lower = m->factor, *upper = SECOND_ORDER ? m->skew : m->factor;
    for (int i = 0, e = 0; SECOND_ORDER && i < M; i++, e++)
        for (int j = 0; j < i; j++, e++) {
            double even = lower[e], odd = upper[e];
            lower[e] = even + odd;
            upper[e] = even - odd;
        }
    for (int k = 0; k < M; k++) {
        double pivot = lower[PACKED(k) + k], inverse = pivot > 0.0 ? 1.0 / pivot : NAN;
        lower[PACKED(k) + k] = inverse;
        for (int i = k + 1; i < M; i++) {
            double down = lower[PACKED(i) + k], across = upper[PACKED(i) + k]; /* L_ik D_k and D_k U_ki */
            lower[PACKED(i) + k] = down * inverse;
            upper[PACKED(i) + k] = across * inverse;
            for (int j = k + 1; j < i; j++) {
                lower[PACKED(i) + j] -= down * upper[PACKED(j) + k];
                if (SECOND_ORDER) upper[PACKED(i) + j] -= across * lower[PACKED(j) + k];
            }
            lower[PACKED(i) + i] -= down * across * inverse;
        }
    }
}

/* Gauss-Jordan elimination without pivots. */
static void invert(double corner[R][R]) {
    for (int p = 0; p < R; p++) {
        double pivot = 1.0 / corner[p][p];
        corner[p][p] = 1.0;
        for (int j = 0; j < R; j++) corner[p][j] *= pivot;
        for (int i = 0; i < R; i++) {
            if (i == p) continue;
            double times = corner[i][p];
            corner[i][p] = 0.0;
            for (int j = 0; j < R; j++) corner[i][j] -= times * corner[p][j];
        }
    }
}

/* Factors take the place of the flexible block S, S^-1 C that of the column, (s - R S^-1 C)^-1 that of the corner;
   coordinates that are given are not corrected. */
void eliminate(struct matrix *m) {
    for (int k = 0; k < R; k++)
        if (pgmp_prescribed[k]) {
            for (int j = 0; j < R; j++) m->corner[k][j] = j == k;
            for (int i = 0; i < M; i++) m->row[k][i] = 0.0;
        }
    for (int i = M - N_GIVEN; i < M; i++) {
        for (int j = 0; j < M; j++) {
            int entry = i < j ? PACKED(j) + i : PACKED(i) + j;
            m->factor[entry] = j == i, m->skew[entry] = 0.0;
        }
        for (int k = 0; k < R; k++) m->column[k][i] = 0.0;
    }
    factorise(m);
    for (int k = 0; k < R; k++) substitute(m, m->column[k]);
    for (int k = 0; k < R; k++)
        for (int j = 0; j < R; j++)
            for (int i = 0; i < M; i++) m->corner[k][j] -= m->row[k][i] * m->column[j][i];
    invert(m->corner);
}

/* Replaces a residual by its Newton correction. */
void solve(const struct matrix *m, double x[N]) {
    double right[R];
    for (int i = 0; i < N; i++)
        if (pgmp_prescribed[i]) x[i] = 0.0;
    substitute(m, x + R);
    for (int k = 0; k < R; k++) {
        right[k] = x[k];
        for (int i = 0; i < M; i++) right[k] -= m->row[k][i] * x[R + i];
    }
    for (int k = 0; k < R; k++) {
        x[k] = 0.0;
        for (int j = 0; j < R; j++) x[k] += m->corner[k][j] * right[j];
        for (int i = 0; i < M; i++) x[R + i] -= m->column[k][i] * x[k];
    }
}
