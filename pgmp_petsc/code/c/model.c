/* The equations are those of a Lagrangian quadratic in the velocities, with tables over one rigid coordinate theta:

     T = 1/2 eta'^T Mass eta',   U = 1/2 delta^T K delta + 1/6 V delta^3 - a(t) (Q.eta + 1/2 delta^T B delta)

   stepped by the generalised-alpha scheme of Chung and Hulbert (1993) in the form of Arnold and Bruls (2007), with
   CORRECTIONS Newton corrections a step, whatever they are worth: pgmp_model.correction says it.

   written by pgmp_petsc */

#include <math.h>
#include <string.h>

#include "tables.h"

#define LARGE 1e30 /* gain that makes stiffness negligible beside mass */
#define TURN 6.283185307179586

/* What is evaluated at one theta. */
struct terms {
    double rigid, rigid_slope, value[END], slope[END], load[LOAD_END], load_slope[LOAD_END];
    double damper[AT_LEAST_ONE(N_DAMPERS)][N];
};

static int locate(double theta, double lower, double width, int n_cells, double *place) {
    double position = (theta - lower) / width, cell = floor(position);
    if (!(fabs(position) < 1e9)) {
        *place = 0.0; /* lost: it still has a cell */
        return 0;
    }
    int number;
    if (PERIODIC) {
        number = (int)(cell - n_cells * floor(cell / n_cells));
        if (number >= n_cells) number = 0;
    } else {
        if (cell < 0.0) cell = 0.0;
        if (cell > n_cells - 1) cell = n_cells - 1;
        number = (int)cell;
    }
    *place = position - cell;
    return number;
}

/* Rows of the tables, with their weights for values and slopes. */
static void stencil(double theta, int rows[4], double weights[4], double slopes[4]) {
    double s;
    int cell = locate(theta, AXIS_LOWER, AXIS_STEP, AXIS_CELLS, &s), first = PERIODIC || !B_SPLINE ? cell - 1 : cell;
    double t = 1.0 - s, s2 = s * s, s3 = s * s * s;
    if (B_SPLINE) {
        weights[0] = t * t * t / 6.0;
        weights[1] = (4.0 - 6.0 * s2 + 3.0 * s3) / 6.0;
        weights[2] = (4.0 - 6.0 * t * t + 3.0 * t * t * t) / 6.0;
        weights[3] = s3 / 6.0;
        slopes[0] = -0.5 * t * t / AXIS_STEP;
        slopes[1] = (-2.0 * s + 1.5 * s2) / AXIS_STEP;
        slopes[2] = (2.0 * t - 1.5 * t * t) / AXIS_STEP;
        slopes[3] = 0.5 * s2 / AXIS_STEP;
    } else {
        double value = 3.0 * s2 - 2.0 * s3, near = s - 2.0 * s2 + s3, far = s3 - s2;
        double rate = 6.0 * s - 6.0 * s2, rate_near = 1.0 - 4.0 * s + 3.0 * s2, rate_far = 3.0 * s2 - 2.0 * s;
        weights[0] = -0.5 * near, weights[1] = 1.0 - value - 0.5 * far;
        weights[2] = value + 0.5 * near, weights[3] = 0.5 * far;
        slopes[0] = -0.5 * rate_near / AXIS_STEP, slopes[1] = (-rate - 0.5 * rate_far) / AXIS_STEP;
        slopes[2] = (rate + 0.5 * rate_near) / AXIS_STEP, slopes[3] = 0.5 * rate_far / AXIS_STEP;
    }
    for (int k = 0; k < 4; k++) {
        rows[k] = first + k;
        if (PERIODIC)
            rows[k] = ((rows[k] % N_ROWS) + N_ROWS) % N_ROWS;
        else if (!B_SPLINE && (rows[k] < 0 || rows[k] >= N_ROWS)) {
            /* quadratic extrapolation beyond an end of the range: the weight goes to the rows inside */
            int inward = rows[k] < 0 ? 1 : -1;
            for (int j = 1; j <= 3; j++) {
                double share = j == 2 ? -3.0 : j == 1 ? 3.0 : 1.0;
                weights[k + j * inward] += share * weights[k];
                slopes[k + j * inward] += share * slopes[k];
            }
            weights[k] = slopes[k] = 0.0;
            rows[k] = rows[k] < 0 ? 0 : N_ROWS - 1;
        }
    }
}

static double strength(const struct pgmp_model *m, int load, double time) {
    if (!m->follows_scene[load]) return m->strengths[load];
    int p = load_pieces[load];
    while (p + 1 < load_pieces[load + 1] && time >= pieces[p + 1].begin) p++;
    const struct piece *f = pieces + p;
    double s = time - f->origin;
    return f->cubic[0] + s * (f->cubic[1] + s * (f->cubic[2] + s * f->cubic[3]))
           + f->wave[0] * sin(f->wave[1] * time + f->wave[2]);
}

/* Poses (x, y, phi) of the undeformed bodies, and the rates of phi, from quintic Hermite polynomials. */
static void place_bodies(double theta, double poses[N_BODIES][3], double turning[N_BODIES]) {
    double turns = PERIODIC ? floor((theta - BRANCH_LOWER) / TURN) : 0.0, inside = theta - TURN * turns;
    double position = (inside - BRANCH_LOWER) / BRANCH_STEP;
    int cell = 0;
    if (position > 0.0) cell = position < N_BRANCH - 2 ? (int)position : N_BRANCH - 2;
    double x = position - cell, y = 1.0 - x, a = y * y * y, b = x * x * x;
    for (int body = 0; body < N_BODIES; body++) {
        for (int i = 0; i < 3; i++) {
            double near = branch_table[0][cell][body][i], far = branch_table[0][cell + 1][body][i];
            double near1 = branch_table[1][cell][body][i], far1 = branch_table[1][cell + 1][body][i];
            double near2 = branch_table[2][cell][body][i], far2 = branch_table[2][cell + 1][body][i];
            double from = near * (1.0 + x * (3.0 + 6.0 * x)) + x * (1.0 + 3.0 * x) * near1 + x * x * near2;
            double to = far * (1.0 + y * (3.0 + 6.0 * y)) - y * (1.0 + 3.0 * y) * far1 + y * y * far2;
            poses[body][i] = a * from + b * to;
            if (i == 2) {
                double dfrom = near * (3.0 + 12.0 * x) + (1.0 + 6.0 * x) * near1 + 2.0 * x * near2;
                double dto = far * (3.0 + 12.0 * y) - (1.0 + 6.0 * y) * far1 + 2.0 * y * far2;
                turning[body] = (a * dfrom - 3.0 * y * y * from - b * dto + 3.0 * x * x * to) / BRANCH_STEP;
            }
        }
        poses[body][2] += TURN * winding[body] * turns;
    }
}

static void gradients_of_dampers(const double q[N], const int rows[4], const double weights[4],
                                 const double slopes[4], struct terms *t) {
    double poses[N_BODIES][3], turning[N_BODIES];
    place_bodies(q[0], poses, turning);
    for (int d = 0; d < N_DAMPERS; d++) {
        double *g = t->damper[d];
        for (int i = 0; i < N; i++) g[i] = 0.0;
        for (int end = 0; end < 2; end++) {
            int slot = end ? dampers[d].b : dampers[d].a, column = 3 * slot + 2;
            double sign = end ? 1.0 : -1.0;
            if (slot < 0) continue;
            g[0] += sign * turning[node_bodies[slot]];
            for (int k = 0; k < 4; k++) {
                for (int i = 0, pair = M; i < M; i++) {
                    double shape = sign * shapes_table[rows[k]][i][column];
                    g[i + 1] += weights[k] * shape;
                    g[0] += slopes[k] * shape * q[i + 1];
                    for (int j = 0; SECOND_ORDER && j <= i; j++, pair++) {
                        double half = (i == j ? 0.5 : 1.0) * sign * shapes_table[rows[k]][pair][column];
                        g[i + 1] += weights[k] * half * q[j + 1];
                        g[j + 1] += weights[k] * half * q[i + 1];
                        g[0] += slopes[k] * half * q[i + 1] * q[j + 1];
                    }
                }
            }
        }
    }
}

static void interpolate(const struct pgmp_model *m, const double q[N], const double amplitudes[], struct terms *t) {
    int rows[4], cell;
    double weights[4], slopes[4], place;
    cell = locate(q[0], CELL_LOWER, CELL_WIDTH, N_CELLS, &place);
    place *= CELL_WIDTH;
    t->rigid = t->rigid_slope = 0.0;
    for (int p = RIGID_POWERS - 1; p >= 0; p--) {
        t->rigid_slope = t->rigid_slope * place + t->rigid;
        t->rigid = t->rigid * place + m->rigid[cell][p];
    }
    stencil(q[0], rows, weights, slopes);
    const double *r0 = m->terms[rows[0]], *r1 = m->terms[rows[1]], *r2 = m->terms[rows[2]], *r3 = m->terms[rows[3]];
    for (int e = 0; e < END; e++) {
        t->value[e] = weights[0] * r0[e] + weights[1] * r1[e] + weights[2] * r2[e] + weights[3] * r3[e];
        t->slope[e] = slopes[0] * r0[e] + slopes[1] * r1[e] + slopes[2] * r2[e] + slopes[3] * r3[e];
    }
    for (int e = 0; e < LOAD_END; e++) t->load[e] = t->load_slope[e] = 0.0;
    for (int load = 0; load < N_LOADS; load++)
        for (int k = 0; k < 4; k++)
            for (int e = 0; e < LOAD_END; e++) {
                t->load[e] += amplitudes[load] * weights[k] * m->loads[load][rows[k]][e];
                t->load_slope[e] += amplitudes[load] * slopes[k] * m->loads[load][rows[k]][e];
            }
    if (N_DAMPERS > 0) gradients_of_dampers(q, rows, weights, slopes, t);
}

static void substitute(const double factor[PACKED(M)], double x[M]) {
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

/* The Newton correction at (q, v, a), in r. */
static void correct(const struct pgmp_model *m, const double q[N], const double v[N], const double rates[N],
                    const double amplitudes[], double gain_v, double gain_a, double r[N]) {
    struct terms t;
    double a[N], moved[N], turned[M], pulled[N], column[M], row[M], factor[PACKED(M)], skew[PACKED(M)], corner;
    interpolate(m, q, amplitudes, &t);
    /* damping proportional to the mass is what it adds to the accelerations */
    for (int i = 0; i < N; i++) a[i] = rates[i] + MASS_DAMPING * v[i];
    gain_a += gain_v * MASS_DAMPING;
    double v0 = v[0], a0 = a[0], v00 = v0 * v0;
    r[0] = t.rigid * a0; /* M_00 theta'' */
    moved[0] = t.rigid_slope * v0;
    pulled[0] = t.rigid_slope * a0;
    corner = gain_a * t.rigid + gain_v * (t.rigid_slope * v0);
    for (int i = 0, entry = 0; i < M; i++) {
        int at = PACKED(i + 1);
        double ai = a[i + 1], vi = v[i + 1], qi = q[i + 1], mass = t.value[at], slope = t.slope[at];
        double total = mass * a0, change = slope * v0, pull = slope * a0, turn = 0.0;
        r[0] += mass * ai; /* M_0i delta_i'' */
        moved[0] += slope * vi;
        pulled[0] += slope * ai;
        column[i] = row[i] = gain_a * mass + gain_v * (slope * v0);
        for (int j = 0; j <= i; j++, entry++) {
            double mij = t.value[at + 1 + j], dm = t.slope[at + 1 + j];
            double kij = t.value[STIFFNESS + entry], bends = t.slope[STIFFNESS + entry];
            total += mij * a[j + 1] + kij * q[j + 1]; /* M_ij delta_j'' + K_ij delta_j */
            change += dm * v[j + 1];
            turn += bends * q[j + 1];
            pull += dm * a[j + 1];
            if (j < i) {
                r[j + 1] += mij * ai + kij * qi;
                moved[j + 1] += dm * vi;
                turned[j] += bends * qi;
                pulled[j + 1] += dm * ai;
            }
            factor[entry] = gain_a * mij + gain_v * (dm * v0) + kij;
        }
        r[i + 1] = total, moved[i + 1] = change, turned[i] = turn, pulled[i + 1] = pull;
    }
    double twice = 0.0, bending = 0.0, leaning = 0.0;
    for (int i = 0; i < N; i++) {
        r[i] += v0 * moved[i] - t.load[i]; /* theta' (d M) eta' - a Q */
        twice += v[i] * moved[i];
    }
    for (int i = 0; i < M; i++) {
        bending += q[i + 1] * turned[i];
        leaning += q[i + 1] * t.load_slope[i + 1];
        turned[i] -= t.load_slope[i + 1];
        column[i] += turned[i] + gain_v * moved[i + 1] + pulled[i + 1];
        row[i] += turned[i] - gain_v * moved[i + 1];
    }
    r[0] += 0.5 * (bending - twice) - leaning; /* 1/2 delta (d K) delta - 1/2 eta' (d M) eta' - d Q.delta */
    corner += pulled[0];
    double leant = 0.0, swung = 0.0, turning = 0.0, turning_on = 0.0;
    for (int i = 0; i < M; i++) {
        double c = t.value[COUPLING + i], db = t.slope[COUPLING + i];
        r[i + 1] -= c * v00; /* - b theta'^2 */
        leant += c * q[i + 1];
        swung += c * v[i + 1];
        turning += db * q[i + 1];
        turning_on += db * v[i + 1];
        column[i] -= 2.0 * gain_v * (c * v0) + db * v00;
        row[i] += 2.0 * (c * (gain_v * v0 + a0) + db * v00) - db * v00;
    }
    r[0] += 2.0 * (leant * a0 + swung * v0 + turning * v00) - turning * v00; /* 2 (b.delta theta')' - (d b).delta */
    corner += 2.0 * (leant * gain_a + gain_v * (swung + turning * v0));
    corner += 2.0 * (turning * a0 + turning_on * v0);
    if (SECOND_ORDER) {
        double bent[PACKED(M)], cubic = 0.0, along[M], across[M], energy = 0.0, held = 0.0, moving = 0.0;
        for (int e = 0; e < PACKED(M); e++) bent[e] = 0.0;
        for (int i = 0, e = CUBIC; i < M; i++)
            for (int j = 0; j <= i; j++) {
                double part = 0.0, last = 0.0;
                for (int k = 0; k <= j; k++, e++) {
                    double w = t.value[e];
                    bent[PACKED(i) + j] += w * q[k + 1]; /* V delta */
                    if (k < j) bent[PACKED(i) + k] += w * q[j + 1];
                    if (j < i) bent[PACKED(j) + k] += w * q[i + 1];
                    if (k < j)
                        part += t.slope[e] * q[k + 1];
                    else
                        last = t.slope[e] * q[k + 1];
                }
                cubic += (j < i ? 6.0 * part + 3.0 * last : 3.0 * part + last) * (q[i + 1] * q[j + 1]);
            }
        r[0] += cubic / 6.0;
        double leaning2 = 0.0;
        for (int i = 0; i < M; i++) along[i] = across[i] = 0.0;
        for (int i = 0, e = 0; i < M; i++)
            for (int j = 0; j <= i; j++, e++) {
                double c = t.value[SWING + e], both = q[i + 1] * q[j + 1];
                double load = t.load[LOAD_END - N_PAIRS + e], stiff = 0.5 * bent[e] - load;
                if (j < i) both += both;
                energy += t.slope[SWING + e] * both;
                leaning2 += t.load_slope[LOAD_END - N_PAIRS + e] * both;
                along[i] += c * q[j + 1];
                across[i] += stiff * q[j + 1];
                if (j < i) {
                    along[j] += c * q[i + 1];
                    across[j] += stiff * q[i + 1];
                }
                factor[e] += bent[e] - load + v00 * c;
            }
        for (int i = 0; i < M; i++) {
            held += q[i + 1] * along[i];
            moving += v[i + 1] * along[i];
            r[i + 1] += across[i] + v00 * along[i]; /* 1/2 (V delta) delta - a B delta + theta'^2 c delta */
            column[i] += 2.0 * gain_v * (v0 * along[i]);
            row[i] -= 2.0 * ((gain_v * v0 + a0) * along[i]);
            along[i] = across[i] = 0.0;
        }
        r[0] += 0.5 * (v00 * energy - leaning2) - (held * a0 + 2.0 * moving * v0 + energy * v00);
        corner -= gain_a * held + 2.0 * gain_v * moving;
        double pushed = a0 + 2.0 * gain_v * v0, total = 0.0;
        for (int i = 0, e = GYROSCOPIC; i < M; i++)
            for (int j = 0; j < i; j++, e++) {
                double w = t.value[e], change = t.slope[e] * v0;
                along[i] += w * q[j + 1];
                along[j] -= w * q[i + 1];
                across[i] += 2.0 * w * v[j + 1] + change * q[j + 1];
                across[j] -= 2.0 * w * v[i + 1] + change * q[i + 1];
                skew[e - GYROSCOPIC] = -(w * pushed + v0 * change);
            }
        for (int i = 0; i < M; i++) {
            r[i + 1] -= a0 * along[i] + v0 * across[i]; /* - theta'' A delta - theta' (2 A delta' + A' delta) */
            total += a[i + 1] * along[i];
            column[i] -= gain_a * along[i];
            row[i] -= gain_a * along[i];
        }
        r[0] -= total; /* terms of d A cancel in the row of the one coordinate */
    }
    if (STRUCTURAL_DAMPING)
        for (int i = 0, e = DAMPING; i < N; i++)
            for (int j = 0; j <= i; j++, e++) {
                double d = t.value[e], braked = gain_v * d;
                r[i] += d * v[j]; /* D eta' */
                if (j < i) r[j] += d * v[i];
                if (i == 0)
                    corner += braked;
                else if (j == 0)
                    column[i - 1] += braked, row[i - 1] += braked;
                else
                    factor[PACKED(i - 1) + j - 1] += braked;
            }
    for (int d = 0; d < N_DAMPERS; d++) {
        const double *g = t.damper[d];
        double rate = 0.0;
        for (int i = 0; i < N; i++) rate += g[i] * v[i];
        for (int i = 0; i < N; i++) r[i] += m->dampers[d] * rate * g[i]; /* c s' ds/d eta */
        double braked = gain_v * m->dampers[d];
        corner += braked * g[0] * g[0];
        for (int i = 0, e = 0; i < M; i++) {
            column[i] += braked * g[0] * g[i + 1];
            row[i] += braked * g[0] * g[i + 1];
            for (int j = 0; j <= i; j++, e++) factor[e] += braked * g[i + 1] * g[j + 1];
        }
    }
    for (int i = 0; i < M; i++) {
        for (int j = 0; j < i; j++) {
            double total = factor[PACKED(i) + j];
            for (int k = 0; k < j; k++) total -= factor[PACKED(i) + k] * factor[PACKED(j) + k];
            factor[PACKED(i) + j] = total * factor[PACKED(j) + j];
        }
        double total = factor[PACKED(i) + i];
        for (int k = 0; k < i; k++) total -= factor[PACKED(i) + k] * factor[PACKED(i) + k];
        factor[PACKED(i) + i] = 1.0 / sqrt(total);
    }
    substitute(factor, column);
    for (int i = 0; i < M; i++) corner -= row[i] * column[i];
    corner = 1.0 / corner;
    for (int pass = 0; pass < (SECOND_ORDER ? 2 : 1); pass++) {
        double rest[N], *x = pass ? rest : r;
        if (pass) {
            for (int i = 0; i < N; i++) rest[i] = 0.0;
            for (int i = 0, e = 0; i < M; i++)
                for (int j = 0; j < i; j++, e++) {
                    rest[i + 1] += skew[e] * r[j + 1];
                    rest[j + 1] -= skew[e] * r[i + 1];
                }
        }
        substitute(factor, x + 1);
        double total = x[0];
        for (int i = 0; i < M; i++) total -= row[i] * x[i + 1];
        x[0] = total * corner;
        for (int i = 0; i < M; i++) x[i + 1] -= column[i] * x[0];
        if (pass)
            for (int i = 0; i < N; i++) r[i] -= rest[i];
    }
}

void pgmp_initialise(struct pgmp_model *m) {
    memset(m, 0, sizeof *m);
    for (int k = 0; k < N_PARAMETERS; k++) m->parameters[k] = parameter_values[k];
    for (int k = 0; k < N_LOADS; k++) m->follows_scene[k] = 1;
}

void pgmp_weigh(struct pgmp_model *m) {
    double of_terms[N_TERMS], of_loads[AT_LEAST_ONE(N_LOAD_TERMS)];
    weigh(m->parameters, of_terms, of_loads, m->dampers);
    memset(m->rigid, 0, sizeof m->rigid);
    memset(m->terms, 0, sizeof m->terms);
    memset(m->loads, 0, sizeof m->loads);
    for (int t = 0; t < N_TERMS; t++) {
        for (int c = 0; c < N_CELLS; c++)
            for (int p = 0; p < RIGID_POWERS; p++) m->rigid[c][p] += of_terms[t] * rigid_table[c][t][p];
        for (int k = 0; k < N_ROWS; k++)
            for (int e = 0; e < END; e++) m->terms[k][e] += of_terms[t] * terms_table[k][t][e];
    }
    for (int t = 0; t < N_LOAD_TERMS; t++)
        for (int k = 0; k < N_ROWS; k++)
            for (int e = 0; e < LOAD_END; e++) m->loads[load_of_term[t]][k][e] += of_loads[t] * loads_table[t][k][e];
    for (int k = 0; k < N_PARAMETERS; k++)
        if (!(m->parameters[k] >= parameter_lower[k] && m->parameters[k] <= parameter_upper[k]))
            m->validity |= PGMP_PARAMETER;
}

static void look_at_state(struct pgmp_model *m) {
    for (int i = 0; i < N; i++)
        if (!isfinite(m->q[i]) || !isfinite(m->v[i]) || !isfinite(m->a[i])) m->validity |= PGMP_NOT_FINITE;
    if (!PERIODIC && !(m->q[0] >= BRANCH_LOWER && m->q[0] <= BRANCH_UPPER)) m->validity |= PGMP_OUT_OF_RANGE;
}

void pgmp_start(struct pgmp_model *m) {
    double amplitudes[AT_LEAST_ONE(N_LOADS)], r[N];
    m->number = 0, m->validity = 0, m->correction = 0.0;
    pgmp_weigh(m);
    for (int i = 0; i < N; i++) m->q[i] = m->v[i] = m->a[i] = 0.0;
    m->q[0] = START_POSITION, m->v[0] = START_VELOCITY;
    for (int k = 0; k < N_LOADS; k++) amplitudes[k] = strength(m, k, 0.0);
    correct(m, m->q, m->v, m->a, amplitudes, 0.0, LARGE, r);
    for (int i = 0; i < N; i++) m->a[i] = m->auxiliary[i] = m->before[i] = -LARGE * r[i];
    look_at_state(m);
}

double pgmp_time(const struct pgmp_model *m) { return STEP * m->number; }

int pgmp_step(struct pgmp_model *m) {
    const double weight = 1.0 / (1.0 - ALPHA_M), h = STEP;
    double q[N], v[N], a[N], r[N], amplitudes[AT_LEAST_ONE(N_LOADS)], size = 0.0;
    m->number++;
    for (int k = 0; k < N_LOADS; k++) amplitudes[k] = strength(m, k, pgmp_time(m));
    for (int i = 0; i < N; i++) {
        a[i] = 2.0 * m->a[i] - m->before[i];
        double ahead = ((1.0 - ALPHA_F) * a[i] + ALPHA_F * m->a[i] - ALPHA_M * m->auxiliary[i]) * weight;
        q[i] = m->q[i] + h * m->v[i] + h * h * ((0.5 - BETA) * m->auxiliary[i] + BETA * ahead);
        v[i] = m->v[i] + h * ((1.0 - GAMMA) * m->auxiliary[i] + GAMMA * ahead);
    }
    for (int number = 0; number < CORRECTIONS; number++) {
        correct(m, q, v, a, amplitudes, GAIN_V, GAIN_A, r);
        size = 0.0;
        for (int i = 0; i < N; i++) {
            q[i] -= r[i];
            v[i] -= GAIN_V * r[i];
            a[i] -= GAIN_A * r[i];
            size = fabs(r[i]) * scale[i] > size ? fabs(r[i]) * scale[i] : size;
        }
    }
    for (int i = 0; i < N; i++) {
        m->before[i] = m->a[i];
        m->auxiliary[i] = ((1.0 - ALPHA_F) * a[i] + ALPHA_F * m->a[i] - ALPHA_M * m->auxiliary[i]) * weight;
        m->q[i] = q[i], m->v[i] = v[i], m->a[i] = a[i];
    }
    m->correction = size;
    if (!(size <= CONVERGED)) m->validity |= PGMP_NOT_CONVERGED;
    look_at_state(m);
    return m->validity;
}

/* The frame (x, y, phi) of a point, from the frames of the output nodes. */
static void frame_of(const struct side *side, double frames[][3], double frame[3]) {
    if (side->slot < 0) {
        frame[0] = side->point[0], frame[1] = side->point[1], frame[2] = 0.0;
        return;
    }
    const double *node = frames[side->slot], c = cos(node[2]), s = sin(node[2]);
    frame[0] = node[0] + c * side->arm[0] - s * side->arm[1];
    frame[1] = node[1] + s * side->arm[0] + c * side->arm[1];
    frame[2] = node[2];
}

void pgmp_observe(struct pgmp_model *m) {
    int rows[4];
    double weights[4], slopes[4], moved[N_SHAPES], factors[N_FACTORS], frames[AT_LEAST_ONE(N_NODES)][3];
    double poses[N_BODIES][3], turning[N_BODIES];
    for (int i = 0, pair = M; i < M; i++) {
        factors[i] = m->q[i + 1];
        for (int j = 0; SECOND_ORDER && j <= i; j++, pair++)
            factors[pair] = (i == j ? 0.5 : 1.0) * m->q[i + 1] * m->q[j + 1];
    }
    stencil(m->q[0], rows, weights, slopes);
    for (int c = 0; c < N_SHAPES; c++) moved[c] = 0.0;
    for (int k = 0; k < 4; k++)
        for (int i = 0; i < N_FACTORS; i++)
            for (int c = 0; c < N_SHAPES; c++) moved[c] += weights[k] * factors[i] * shapes_table[rows[k]][i][c];
    m->elastic_rotation = 0.0;
    for (int c = 3 * N_NODES; c < N_SHAPES; c++)
        if (fabs(moved[c]) > m->elastic_rotation) m->elastic_rotation = fabs(moved[c]);
    if (m->elastic_rotation > ROTATION_LIMIT) m->validity |= PGMP_ROTATION;
    place_bodies(m->q[0], poses, turning);
    for (int k = 0; k < N_NODES; k++) {
        const double *pose = poses[node_bodies[k]], c = cos(pose[2]), s = sin(pose[2]);
        double x = node_points[k][0] + moved[3 * k], y = node_points[k][1] + moved[3 * k + 1];
        frames[k][0] = pose[0] + c * x - s * y;
        frames[k][1] = pose[1] + s * x + c * y;
        frames[k][2] = pose[2] + moved[3 * k + 2];
    }
    for (int number = 0; number < N_OUTPUTS; number++) {
        const struct output *o = outputs + number;
        double a[3], b[3], c, s, value = 0.0;
        frame_of(&o->a, frames, a);
        frame_of(&o->b, frames, b);
        if (o->kind == ANGLE) value = b[2] - a[2];
        if (o->kind == ROTATION) value = b[2];
        if (o->kind == POSITION) value = b[o->axis] - o->x;
        if (o->kind == DISTANCE) value = hypot(b[0] - a[0], b[1] - a[1]);
        if (o->kind == SLIDING) {
            c = cos(a[2]), s = sin(a[2]);
            value = (c * o->x - s * o->y) * (b[0] - a[0]) + (s * o->x + c * o->y) * (b[1] - a[1]);
        }
        if (o->kind == DEFORMATION) {
            /* against the rigid mechanism at the measured coordinate, the joint that stands behind the outputs */
            double first[3], second[3], measured, of[3], change[2];
            frame_of(&outputs[N_OUTPUTS].a, frames, first);
            frame_of(&outputs[N_OUTPUTS].b, frames, second);
            measured = second[2] - first[2];
            place_bodies(measured, poses, turning);
            const double *pose = poses[o->b.body];
            c = cos(pose[2]), s = sin(pose[2]);
            of[0] = pose[0] + c * o->b.point[0] - s * o->b.point[1];
            of[1] = pose[1] + s * o->b.point[0] + c * o->b.point[1];
            change[0] = b[0] - of[0], change[1] = b[1] - of[1];
            value = change[o->axis];
            if (o->in_body) value = o->axis ? c * change[1] - s * change[0] : c * change[0] + s * change[1];
            if (!PERIODIC && !(measured >= BRANCH_LOWER && measured <= BRANCH_UPPER)) value = NAN;
        }
        m->outputs[number] = value;
    }
}
