/* Solving with the iteration matrix: Cholesky factors of the flexible block, bordered by the rigid coordinates.

   The skew part of the flexible block is smaller than the symmetric one by some thousandths at most: so is what one
   refinement leaves of the error.

   written by pgmp_petsc */

#include <math.h>

#include "tables.h"

static void substitute(const double factor[], double x[]) {
    for (int i = 0, row = 0; i < M; row += ++i) {
        double total = x[i];
        for (int j = 0; j < i; j++) total -= factor[row + j] * x[j];
        x[i] = total * factor[row + i];
    }
    for (int i = M - 1; i >= 0; i--) {
        double total = x[i];
        for (int j = i + 1; j < M; j++) total -= factor[PACKED(j) + i] * x[j];
        x[i] = total * factor[PACKED(i) + i];
    }
}

static void factorise(double factor[]) {
    for (int i = 0; i < M; i++) {
        for (int j = 0; j <= i; j++) {
            double total = factor[PACKED(i) + j];
            for (int k = 0; k < j; k++) total -= factor[PACKED(i) + k] * factor[PACKED(j) + k];
            factor[PACKED(i) + j] = j < i ? total * factor[PACKED(j) + j] : 1.0 / sqrt(total);
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

/* The factor takes the place of the flexible block S, S^-1 C that of the column, (s - R S^-1 C)^-1 that of the corner;
   coordinates whose motion is given are not corrected. */
void eliminate(struct matrix *m) {
    for (int k = 0; k < R; k++)
        if (pgmp_prescribed[k]) {
            for (int j = 0; j < R; j++) m->corner[k][j] = j == k;
            for (int i = 0; i < M; i++) m->row[k][i] = 0.0;
        }
    factorise(m->factor);
    for (int k = 0; k < R; k++) substitute(m->factor, m->column[k]);
    for (int k = 0; k < R; k++)
        for (int j = 0; j < R; j++)
            for (int i = 0; i < M; i++) m->corner[k][j] -= m->row[k][i] * m->column[j][i];
    invert(m->corner);
}

static void solve_symmetric(const struct matrix *m, double x[N]) {
    double right[R];
    substitute(m->factor, x + R);
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

/* Replaces a residual by its Newton correction. */
void solve(const struct matrix *m, double x[N]) {
    double rest[N] = {0};
    for (int k = 0; k < R; k++)
        if (pgmp_prescribed[k]) x[k] = 0.0;
    solve_symmetric(m, x);
    if (!SECOND_ORDER) return;
    for (int i = 0, e = 0; i < M; i++)
        for (int j = 0; j < i; j++, e++) {
            rest[R + i] += m->skew[e] * x[R + j];
            rest[R + j] -= m->skew[e] * x[R + i];
        }
    solve_symmetric(m, rest);
    for (int i = 0; i < N; i++) x[i] -= rest[i];
}
