/* The Lagrangian of the reduced model, quadratic in the velocities, with tables over R rigid coordinates theta:

     T = 1/2 eta'^T Mass eta'      Mass_kl = M_kl + 2 b_kl.delta - delta^T c_kl delta
                                   Mass_kd = M_kd + A_k^T delta,    Mass_dd = M_dd
     U = 1/2 delta^T K delta + 1/6 V delta^3 - a(t) (Q.eta + 1/2 delta^T B delta)

   Residual r = d/dt dT/d eta' - dT/d eta + dU/d eta, and its iteration matrix, without second derivatives of tables.

   written by pgmp_petsc */

#include <math.h>
#include <string.h>

#include "tables.h"

#define PAIR(k, j) ((k) >= (j) ? PACKED(k) + (j) : PACKED(j) + (k))

/* Where the residual is evaluated, with sums over the tables' derivatives with each coordinate. */
struct work {
    const struct terms *t;
    const double *q, *rate, *v, *a;
    double gain_v, gain_a;
    int fresh;
    double *r, moved[R][N], pulled[R][N], turned[R][AT_LEAST_ONE(M)];
    struct matrix *matrix;
};

/* How a table entry changes in time. */
static double drift_of(const struct work *w, int entry) {
    double total = 0.0;
    for (int h = 0; h < R; h++) total += w->t->table[1 + h][entry] * w->v[h];
    return total;
}

static void add_inertia_and_stiffness(struct work *w) {
    const double *q = w->q, *v = w->v, *a = w->a, *value = w->t->table[0];
    double *r = w->r;
    memset(w->moved, 0, sizeof w->moved);
    memset(w->pulled, 0, sizeof w->pulled);
    memset(w->turned, 0, sizeof w->turned);
    for (int i = 0; i < N; i++) r[i] = 0.0;
    for (int k = 0; k < R; k++)
        for (int j = 0; j < R; j++) {
            r[k] += w->t->rigid[0][PAIR(k, j)] * a[j]; /* M_kj theta_j'' */
            for (int h = 0; h < R; h++) {
                w->moved[h][k] += w->t->rigid[1 + h][PAIR(k, j)] * v[j];
                w->pulled[h][k] += w->t->rigid[1 + h][PAIR(k, j)] * a[j];
            }
        }
    for (int i = 0; i < M; i++) {
        int at = PACKED(R + i), row = R + i;
        for (int c = 0; c <= row; c++) {
            double mass = value[at + c];
            r[row] += mass * a[c]; /* M eta'' */
            if (c < row) r[c] += mass * a[row];
            for (int h = 0; h < R; h++) {
                double slope = w->t->table[1 + h][at + c];
                w->moved[h][row] += slope * v[c]; /* (d_h M) eta' */
                w->pulled[h][row] += slope * a[c];
                if (c < row) w->moved[h][c] += slope * v[row], w->pulled[h][c] += slope * a[row];
            }
            if (w->fresh) {
                double both = w->gain_a * mass + w->gain_v * drift_of(w, at + c);
                if (c < R)
                    w->matrix->column[c][i] = w->matrix->row[c][i] = both;
                else
                    w->matrix->factor[PACKED(i) + c - R] = both;
            }
        }
        for (int j = 0; j <= i; j++) {
            int entry = STIFFNESS + PACKED(i) + j;
            r[row] += value[entry] * q[R + j]; /* K delta */
            if (j < i) r[R + j] += value[entry] * q[row];
            for (int h = 0; h < R; h++) {
                double bends = w->t->table[1 + h][entry];
                w->turned[h][i] += bends * q[R + j]; /* (d_h K) delta */
                if (j < i) w->turned[h][j] += bends * q[row];
            }
            if (w->fresh) w->matrix->factor[PACKED(i) + j] += value[entry];
        }
    }
}

static void add_rigid_rows(struct work *w) {
    const double *q = w->q, *v = w->v;
    for (int k = 0; k < R; k++) {
        double twice = 0.0, bending = 0.0, leaning = 0.0;
        for (int i = 0; i < N; i++) {
            w->r[i] += v[k] * w->moved[k][i]; /* theta_k' (d_k M) eta' */
            twice += v[i] * w->moved[k][i];
        }
        for (int i = 0; i < M; i++) {
            double slope = w->t->load[1 + k][R + i];
            bending += q[R + i] * w->turned[k][i];
            leaning += q[R + i] * slope;
            w->turned[k][i] -= slope;
        }
        w->r[k] += 0.5 * (bending - twice) - leaning; /* 1/2 delta (d_k K) delta - 1/2 eta' (d_k M) eta' - d_k Q.delta */
    }
    for (int i = 0; i < N; i++) w->r[i] -= w->t->load[0][i]; /* - a Q */
    for (int k = 0; w->fresh && k < R; k++) {
        for (int i = 0; i < M; i++) {
            double swing = w->gain_v * w->moved[k][R + i];
            w->matrix->column[k][i] += w->turned[k][i] + swing + w->pulled[k][R + i];
            w->matrix->row[k][i] += w->turned[k][i] - swing;
        }
        for (int j = 0; j < R; j++) {
            double total = w->gain_a * w->t->rigid[0][PAIR(k, j)] + w->pulled[j][k];
            total += w->gain_v * (w->moved[j][k] - w->moved[k][j]);
            for (int h = 0; h < R; h++) total += w->t->rigid[1 + h][PAIR(k, j)] * (w->gain_v * v[h]);
            w->matrix->corner[k][j] = total;
        }
    }
}

/* Terms of sum_kl theta_k' theta_l' b_kl.delta of the kinetic energy, pair by pair (k >= j). */
static void add_coupling(struct work *w) {
    const double *q = w->q, *v = w->v, *a = w->a, gain_v = w->gain_v;
    struct matrix *m = w->matrix;
    for (int k = 0, at = COUPLING; k < R; k++)
        for (int j = 0; j <= k; j++, at += M) {
            double turning = (j == k ? 1.0 : 2.0) * v[k] * v[j], leant = 0.0, leaning = 0.0, drift = 0.0;
            double turned[R] = {0}, turning_on[R] = {0}; /* (d b).delta, (d b).delta' */
            for (int i = 0; i < M; i++) {
                double b = w->t->table[0][at + i], change = drift_of(w, at + i);
                w->r[R + i] -= b * turning; /* - b theta_k' theta_j' */
                leant += b * q[R + i];
                leaning += b * v[R + i];
                for (int h = 0; h < R; h++) {
                    double slope = w->t->table[1 + h][at + i];
                    turned[h] += slope * q[R + i];
                    turning_on[h] += slope * v[R + i];
                    if (w->fresh) m->column[h][i] -= slope * turning, m->row[h][i] -= slope * turning;
                }
                for (int side = 0; w->fresh && side < (j < k ? 2 : 1); side++) {
                    int own = side ? j : k, other = side ? k : j;
                    m->column[own][i] -= 2.0 * gain_v * (b * v[other]);
                    m->row[own][i] += 2.0 * (b * (gain_v * v[other] + a[other]) + change * v[other]);
                }
            }
            for (int h = 0; h < R; h++) drift += turned[h] * v[h];
            for (int side = 0; side < (j < k ? 2 : 1); side++) {
                int own = side ? j : k, other = side ? k : j;
                w->r[own] += 2.0 * (leant * a[other] + leaning * v[other] + drift * v[other]); /* 2 (b.delta theta')' */
                if (!w->fresh) continue;
                m->corner[own][other] += 2.0 * (leant * w->gain_a + gain_v * (leaning + drift));
                for (int h = 0; h < R; h++) { /* how (b.delta)' and b.delta change with every theta */
                    double swept = gain_v * v[other];
                    m->corner[own][h] += 2.0 * (turned[h] * (swept + a[other]) + turning_on[h] * v[other]);
                    m->corner[h][own] -= 2.0 * turned[h] * swept;
                }
            }
            for (int h = 0; h < R; h++) w->r[h] -= turned[h] * turning; /* - (d b).delta theta_k' theta_j' */
        }
}

/* Terms of 1/6 V delta^3 - 1/2 a delta^T B delta. */
static void add_cubic(struct work *w) {
    const double *q = w->q + R, *value = w->t->table[0];
    double bent[AT_LEAST_ONE(PACKED(M))] = {0}, energy[R] = {0};
    for (int i = 0, e = CUBIC; i < M; i++)
        for (int j = 0; j <= i; j++) {
            double both = q[i] * q[j];
            for (int k = 0; k <= j; k++, e++) {
                /* entries with equal indices count once, others for each of their orders */
                double orders = j < i ? (k < j ? 6.0 : 3.0) : (k < j ? 3.0 : 1.0);
                bent[PACKED(i) + j] += value[e] * q[k]; /* V delta */
                if (k < j) bent[PACKED(i) + k] += value[e] * q[j];
                if (j < i) bent[PACKED(j) + k] += value[e] * q[i];
                for (int h = 0; h < R; h++) energy[h] += orders * w->t->table[1 + h][e] * (both * q[k]);
            }
        }
    for (int h = 0; h < R; h++) w->r[h] += energy[h] / 6.0;
    for (int i = 0, e = 0; i < M; i++)
        for (int j = 0; j <= i; j++, e++) {
            double load = w->t->load[0][LOAD_END - N_PAIRS + e], stiff = 0.5 * bent[e] - load;
            double both = (j < i ? 2.0 : 1.0) * q[i] * q[j];
            w->r[R + i] += stiff * q[j]; /* 1/2 (V delta) delta - a B delta */
            if (j < i) w->r[R + j] += stiff * q[i];
            for (int h = 0; h < R; h++) w->r[h] -= 0.5 * w->t->load[1 + h][LOAD_END - N_PAIRS + e] * both;
            if (w->fresh) w->matrix->factor[e] += bent[e] - load;
        }
}

/* Terms of - 1/2 sum_kl theta_k' theta_l' delta^T c_kl delta. */
static void add_swing(struct work *w) {
    const double *q = w->q + R, *v = w->v, *a = w->a, gain_v = w->gain_v;
    struct matrix *m = w->matrix;
    for (int k = 0, at = SWING; k < R; k++)
        for (int j = 0; j <= k; j++, at += PACKED(M)) {
            double turning = (j == k ? 1.0 : 2.0) * v[k] * v[j], held = 0.0, moving = 0.0, drift = 0.0;
            double along[AT_LEAST_ONE(M)] = {0}, energy[R] = {0}; /* c delta, delta^T (d c) delta */
            for (int i = 0, e = 0; i < M; i++)
                for (int c = 0; c <= i; c++, e++) {
                    double value = w->t->table[0][at + e], both = (c < i ? 2.0 : 1.0) * q[i] * q[c];
                    along[i] += value * q[c];
                    if (c < i) along[c] += value * q[i];
                    for (int h = 0; h < R; h++) energy[h] += w->t->table[1 + h][at + e] * both;
                    if (w->fresh) m->factor[e] += turning * value;
                }
            for (int i = 0; i < M; i++) {
                held += q[i] * along[i];
                moving += v[R + i] * along[i];
                w->r[R + i] += turning * along[i]; /* theta_k' theta_j' c delta */
            }
            for (int h = 0; h < R; h++) drift += energy[h] * v[h];
            for (int side = 0; side < (j < k ? 2 : 1); side++) {
                int own = side ? j : k, other = side ? k : j;
                w->r[own] -= held * a[other] + 2.0 * moving * v[other] + drift * v[other]; /* (delta c delta theta')' */
                if (!w->fresh) continue;
                m->corner[own][other] -= w->gain_a * held + 2.0 * gain_v * moving;
                for (int i = 0; i < M; i++) {
                    m->column[own][i] += 2.0 * gain_v * (v[other] * along[i]);
                    m->row[own][i] -= 2.0 * ((gain_v * v[other] + a[other]) * along[i]);
                }
            }
            for (int h = 0; h < R; h++) w->r[h] += 0.5 * turning * energy[h];
        }
}

/* Terms of sum_k theta_k' (A_k delta').delta, A_k skew. */
static void add_gyroscopic(struct work *w) {
    const double *q = w->q + R, *v = w->v, *a = w->a;
    memset(w->matrix->skew, 0, w->fresh ? sizeof w->matrix->skew : 0);
    for (int k = 0, at = GYROSCOPIC; k < R; k++, at += M * (M - 1) / 2) {
        double along[AT_LEAST_ONE(M)] = {0}, across[AT_LEAST_ONE(M)] = {0}, changing[R] = {0}, total = 0.0;
        double pushed = a[k] + 2.0 * w->gain_v * v[k];
        for (int i = 0, e = 0; i < M; i++)
            for (int j = 0; j < i; j++, e++) {
                double value = w->t->table[0][at + e], change = drift_of(w, at + e);
                along[i] += value * q[j];
                along[j] -= value * q[i];
                across[i] += 2.0 * value * v[R + j] + change * q[j]; /* 2 A delta' + A' delta */
                across[j] -= 2.0 * value * v[R + i] + change * q[i];
                for (int h = 0; h < R; h++)
                    changing[h] += w->t->table[1 + h][at + e] * (v[R + i] * q[j] - v[R + j] * q[i]);
                if (w->fresh) w->matrix->skew[PACKED(i) + j] -= value * pushed + v[k] * change;
            }
        for (int i = 0; i < M; i++) {
            w->r[R + i] -= a[k] * along[i] + v[k] * across[i];
            total += a[R + i] * along[i];
            if (w->fresh) w->matrix->column[k][i] -= w->gain_a * along[i], w->matrix->row[k][i] -= w->gain_a * along[i];
        }
        for (int h = 0; h < R; h++) {
            total += changing[h] * v[h];
            w->r[h] += changing[h] * v[k]; /* theta_k' delta'.(d A_k) delta */
        }
        w->r[k] -= total; /* - delta''.(A delta) - delta'.(A' delta) */
    }
}

/* D eta' */
static void add_damping(struct work *w) {
    for (int i = 0, e = DAMPING; i < N; i++)
        for (int j = 0; j <= i; j++, e++) {
            double d = w->t->table[0][e], braked = w->gain_v * d;
            w->r[i] += d * w->rate[j];
            if (j < i) w->r[j] += d * w->rate[i];
            if (!w->fresh) continue;
            if (i < R) {
                w->matrix->corner[i][j] += braked;
                if (j < i) w->matrix->corner[j][i] += braked;
            } else if (j < R)
                w->matrix->column[j][i - R] += braked, w->matrix->row[j][i - R] += braked;
            else
                w->matrix->factor[PACKED(i - R) + j - R] += braked;
        }
}

/* Residual at eta, its rates and their rates and, if `fresh`, the iteration matrix. */
void evaluate_lagrangian(const struct terms *t, const double q[N], const double rate[N], const double rates[N],
                         double gain_v, double gain_a, int fresh, double r[N], struct matrix *matrix) {
    double v[N], a[N];
    struct work w = {.t = t, .q = q, .rate = rate, .v = v, .a = a, .gain_v = gain_v, .fresh = fresh};
    w.r = r, w.matrix = matrix;
    /* damping proportional to the mass is what it adds to the accelerations */
    w.gain_a = gain_a + gain_v * MASS_DAMPING;
    for (int i = 0; i < N; i++) v[i] = QUADRATIC ? rate[i] : 0.0, a[i] = rates[i] + MASS_DAMPING * rate[i];
    add_inertia_and_stiffness(&w);
    add_rigid_rows(&w);
    add_coupling(&w);
    if (SECOND_ORDER) {
        add_cubic(&w);
        add_swing(&w);
        add_gyroscopic(&w);
    }
    if (STRUCTURAL_DAMPING) add_damping(&w);
}
