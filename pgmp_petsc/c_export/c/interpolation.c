/* Tables over the rigid coordinates: weighted rows around a place, and functions of time.

   Rows are samples (Overhauser's cubics) or coefficients of uniform cubic B-splines; of several coordinates the
   rows of the last one run fastest.

   written by pgmp_petsc */

#include <math.h>
#include <string.h>

#include "tables.h"

/* The number of the cell of theta, and where in it, from 0 to 1. */
int locate(const struct axis *axis, double theta, double *place) {
    double position = (theta - axis->lower) / axis->step, cell = floor(position);
    *place = 0.0;
    if (!(fabs(theta) < 1e9)) return 0; /* lost: it still has a cell */
    if (!axis->periodic) {
        if (cell < 0.0) cell = 0.0;
        if (cell > axis->n_cells - 1) cell = axis->n_cells - 1;
    }
    *place = position - cell;
    if (!axis->periodic) return (int)cell;
    int number = (int)(cell - axis->n_cells * floor(cell / axis->n_cells));
    return number < axis->n_cells ? number : 0;
}

void find_along(const struct axis *axis, double theta, int rows[4], double weights[3][4]) {
    double s;
    int cell = locate(axis, theta, &s), first = axis->periodic || !axis->b_spline ? cell - 1 : cell;
    double t = 1.0 - s, s2 = s * s, s3 = s * s * s, step = axis->step, *w = weights[0];
    double *dw = weights[1], *ddw = weights[2], square = step * step;
    if (axis->b_spline) {
        w[0] = t * t * t / 6.0;
        w[1] = (4.0 - 6.0 * s2 + 3.0 * s3) / 6.0;
        w[2] = (4.0 - 6.0 * t * t + 3.0 * t * t * t) / 6.0;
        w[3] = s3 / 6.0;
        dw[0] = -0.5 * t * t / step;
        dw[1] = (-2.0 * s + 1.5 * s2) / step;
        dw[2] = (2.0 * t - 1.5 * t * t) / step;
        dw[3] = 0.5 * s2 / step;
        ddw[0] = t / square, ddw[1] = (3.0 * s - 2.0) / square;
        ddw[2] = (3.0 * t - 2.0) / square, ddw[3] = s / square;
    } else {
        double value = 3.0 * s2 - 2.0 * s3, near = s - 2.0 * s2 + s3, far = s3 - s2;
        double rate = 6.0 * s - 6.0 * s2, rate_near = 1.0 - 4.0 * s + 3.0 * s2, rate_far = 3.0 * s2 - 2.0 * s;
        w[0] = -0.5 * near, w[1] = 1.0 - value - 0.5 * far;
        w[2] = value + 0.5 * near, w[3] = 0.5 * far;
        dw[0] = -0.5 * rate_near / step, dw[1] = (-rate - 0.5 * rate_far) / step;
        dw[2] = (rate + 0.5 * rate_near) / step, dw[3] = 0.5 * rate_far / step;
        double bend = 6.0 - 12.0 * s, bend_near = 6.0 * s - 4.0, bend_far = 6.0 * s - 2.0;
        ddw[0] = -0.5 * bend_near / square, ddw[1] = (-bend - 0.5 * bend_far) / square;
        ddw[2] = (bend + 0.5 * bend_near) / square, ddw[3] = 0.5 * bend_far / square;
    }
    for (int k = 0; k < 4; k++) {
        rows[k] = first + k;
        if (axis->periodic)
            rows[k] = ((rows[k] % axis->n_rows) + axis->n_rows) % axis->n_rows;
        else if (!axis->b_spline && (rows[k] < 0 || rows[k] >= axis->n_rows)) {
            /* quadratic extrapolation beyond an end of the range: the weight goes to the rows inside */
            int inward = rows[k] < 0 ? 1 : -1;
            for (int j = 1; j <= 3; j++) {
                double share = j == 2 ? -3.0 : j == 1 ? 3.0 : 1.0;
                w[k + j * inward] += share * w[k];
                dw[k + j * inward] += share * dw[k];
                ddw[k + j * inward] += share * ddw[k];
            }
            w[k] = dw[k] = ddw[k] = 0.0;
            rows[k] = rows[k] < 0 ? 0 : axis->n_rows - 1;
        }
    }
}

void find_stencil(const struct axis of[R], const double theta[R], struct stencil *stencil) {
    int n = 1, rows[4];
    double one[3][4];
    stencil->rows[0] = 0;
    for (int w = 0; w <= R; w++) stencil->weights[w][0] = 1.0;
    for (int k = 0; k < R; k++) {
        find_along(of + k, theta[k], rows, one);
        for (int i = n - 1; i >= 0; i--) { /* from the last on, in place: each row makes four */
            int row = stencil->rows[i] * of[k].n_rows;
            for (int j = 3; j >= 0; j--) stencil->rows[4 * i + j] = row + rows[j];
            for (int w = 0; w <= R; w++) {
                double weight = stencil->weights[w][i];
                for (int j = 3; j >= 0; j--) stencil->weights[w][4 * i + j] = weight * one[w == k + 1][j];
            }
        }
        n *= 4;
    }
}

/* Adds the rows (n) of a table to values and, of 1 + R parts, derivatives, (n_parts, n). */
void add_rows(const struct stencil *stencil, int n_parts, int n, const double *table, double *found) {
    for (int p = 0; p < N_STENCIL; p += 4) {
        const double *r0 = table + (long)stencil->rows[p] * n, *r1 = table + (long)stencil->rows[p + 1] * n;
        const double *r2 = table + (long)stencil->rows[p + 2] * n, *r3 = table + (long)stencil->rows[p + 3] * n;
        for (int part = 0; part < n_parts; part++) {
            const double *w = stencil->weights[part] + p;
            double *into = found + (long)part * n;
            for (int e = 0; e < n; e++) into[e] += w[0] * r0[e] + w[1] * r1[e] + w[2] * r2[e] + w[3] * r3[e];
        }
    }
}

/* The coefficients of the rigid inertia in a cell, powers of the coordinates from number k on, from the rows that reach
   into it, of which the numbers along the coordinates before are in `row`. */
static void make_rigid(const struct pgmp_model *m, int k, const int cell[R], long row, double *made) {
    double part[PACKED(R) * RIGID_POWERS / 8];
    int n = PACKED(R);
    if (k == R) {
        memcpy(made, m->own.rigid_rows[row], sizeof m->own.rigid_rows[row]);
        return;
    }
    for (int j = k + 1; j < R; j++) n *= 8;
    memset(made, 0, 8 * (size_t)n * sizeof(double));
    for (int j = 0; j < RIGID_REACH; j++) {
        make_rigid(m, k + 1, cell, row * rigid_axes[k].n_rows + rigid_stencils[k][cell[k]][j], part);
        for (int p = 0; p < 8; p++)
            for (int i = 0; i < n; i++) made[p * n + i] += rigid_matrices[k][cell[k]][p][j] * part[i];
    }
}

/* A polynomial of degree 7 in every coordinate from number k on, the powers of the last one running fastest, and its
   derivatives. */
static double polynomial(const double *c, const double place[R], int k, double slopes[R]) {
    int stride = PACKED(R);
    double value = 0.0, inner[R] = {0};
    for (int j = k; j < R; j++) slopes[j] = 0.0;
    for (int j = k + 1; j < R; j++) stride *= 8;
    for (int p = 7; p >= 0; p--) {
        double part = k == R - 1 ? c[stride * p] : polynomial(c + stride * p, place, k + 1, inner);
        slopes[k] = slopes[k] * place[k] + value;
        value = value * place[k] + part;
        for (int j = k + 1; j < R; j++) slopes[j] = slopes[j] * place[k] + inner[j];
    }
    return value;
}

void interpolate(struct pgmp_model *m, const struct stencil *stencil, const double theta[R], const double strengths[],
                 struct terms *t) {
    double place[R], slopes[R];
    int cells[R], cell = 0;
    memset(t, 0, sizeof *t);
    for (int k = 0; k < R; k++) {
        cells[k] = locate(rigid_axes + k, theta[k], place + k);
        cell = cell * rigid_axes[k].n_cells + cells[k];
        place[k] *= rigid_axes[k].step;
    }
    if (cell != m->own.rigid_cell) make_rigid(m, 0, cells, 0, m->own.rigid[0]);
    m->own.rigid_cell = cell;
    for (int pair = 0; pair < PACKED(R); pair++) {
        t->rigid[0][pair] = polynomial(m->own.rigid[0] + pair, place, 0, slopes);
        for (int k = 0; k < R; k++) t->rigid[1 + k][pair] = slopes[k];
    }
    add_rows(stencil, 1 + R, END, &m->own.terms[0][0], &t->table[0][0]);
    for (int k = 0; !QUADRATIC && k < R; k++) /* without forces quadratic in the velocities the inertia stays */
        memset(t->table[1 + k], 0, STIFFNESS * sizeof(double));
    for (int load = 0; load < N_LOADS; load++) {
        double found[1 + R][LOAD_END] = {{0}};
        add_rows(stencil, 1 + R, LOAD_END, &m->own.loads[load][0][0], &found[0][0]);
        for (int part = 0; part <= R; part++)
            for (int e = 0; e < LOAD_END; e++) t->load[part][e] += strengths[strength_of_load[load]] * found[part][e];
    }
}
