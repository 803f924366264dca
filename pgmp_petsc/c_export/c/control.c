/* Controllers: states z' = g and a force u = h of motions in the mechanics, within the steps of the mechanics.

   At the end of a step z = c + kappa g(z, s, s'); what is solved here at given s and s' is a force with slopes by these.
   One that is sampled holds its force, and goes on by Euler's implicit rule over its sample time.

   written by pgmp_petsc */

#include <math.h>
#include <string.h>

#include "tables.h"

enum { MOST_RESPONSES = 30 };
#define CLOSE 1e-14 /* of the states, and of the terms that make them, where their iteration ends */

static double *force_of(double beside[], const struct control *one) { return beside + one->column + 3 * one->n_states; }

/* Eliminates n rows with pivoting; right becomes the solutions, of its first n_right columns. */
static void solve_states(int n, int n_right, double matrix[][1 + MOST_STATES], double right[][N_SLOPES]) {
    for (int k = 0; k < n; k++) {
        int best = k;
        for (int i = k + 1; i < n; i++)
            if (fabs(matrix[i][k]) > fabs(matrix[best][k])) best = i;
        for (int j = 0; j < n; j++) {
            double kept = matrix[k][j];
            matrix[k][j] = matrix[best][j], matrix[best][j] = kept;
        }
        for (int j = 0; j < n_right; j++) {
            double kept = right[k][j];
            right[k][j] = right[best][j], right[best][j] = kept;
        }
        for (int i = 0; i < n; i++) {
            double factor = matrix[i][k] / matrix[k][k];
            for (int j = k; i != k && j < n; j++) matrix[i][j] -= factor * matrix[k][j];
            for (int j = 0; i != k && j < n_right; j++) right[i][j] -= factor * right[k][j];
        }
    }
    for (int k = 0; k < n; k++)
        for (int j = 0; j < n_right; j++) right[k][j] /= matrix[k][k];
}

/* Lets the states of a controller respond to what is given to its law, x. */
static void solve_response(const struct control *one, const double p[], const double x[], double kappa,
                           struct response *at, double found[N_SLOPES]) {
    double matrix[1 + MOST_STATES][1 + MOST_STATES], right[1 + MOST_STATES][N_SLOPES];
    double law[(1 + MOST_STATES) * (N_SLOPES + MOST_STATES)], *z = at->z + one->column;
    const int n = one->n_states, n_slopes = 1 + 2 * one->n_motions, width = n_slopes + n;
    int converged = 0;
    for (int number = 0; number < MOST_RESPONSES && !converged; number++) {
        double largest = 0.0, change = 0.0;
        one->law(p, x, z, law);
        for (int i = 0; i < n; i++) {
            const double *row = law + width * (1 + i);
            right[i][0] = at->c[one->column + i] + kappa * row[0] - z[i];
            /* of a state, or of an error, that is small between large numbers only the digits of these are known */
            double size = fabs(at->c[one->column + i]) + fabs(kappa * row[0]);
            for (int k = 1; k < n_slopes; k++) right[i][k] = kappa * row[k], size += fabs(right[i][k] * x[2 + k]);
            for (int j = 0; j < n; j++) {
                const double share = kappa * row[n_slopes + j];
                matrix[i][j] = (i == j) - share, size += fabs(share * z[j]);
            }
            largest = fmax(largest, size);
        }
        solve_states(n, n_slopes, matrix, right);
        for (int i = 0; i < n; i++) {
            z[i] += right[i][0];
            largest = fmax(largest, fabs(z[i])), change = fmax(change, fabs(right[i][0]));
        }
        converged = change <= CLOSE * largest;
    }
    for (int k = 0; k < n_slopes; k++) {
        found[k] = converged ? law[k] : NAN;
        for (int i = 0; i < n; i++) found[k] += law[n_slopes + i] * right[i][k];
    }
    for (int i = 0; i < n; i++) at->rates[one->column + i] = law[width * (1 + i)];
}

/* By how much slopes have a force change over a way of motions and rates. */
static double along(const struct control *one, const double found[], const double way[]) {
    double change = 0.0;
    for (int k = 0; k < 2 * one->n_motions; k++) change += found[1 + k] * way[k];
    return change;
}

/* Linearises a force that jumped since the iterate before at a place between both, where it is about halfway. */
static void take_up(int number, const double p[], const double x[], struct response *at, double found[N_SLOPES]) {
    const struct control *one = controls + number;
    const int n = 2 * one->n_motions;
    double way[N_SLOPES], between[3 + N_SLOPES], there[N_SLOPES], low = 0.0, high = 1.0;
    double *about = at->about[number], *before = at->before[number], change = found[0] - before[0];
    for (int k = 0; k < n; k++) way[k] = x[3 + k] - about[k];
    const int jumped = fabs(change) > JUMPS * fmax(fabs(along(one, found, way)), fabs(along(one, before, way)));
    memcpy(about, x + 3, n * sizeof(double)), memcpy(before, found, (1 + n) * sizeof(double));
    if (!jumped || n == 0) return;
    memcpy(between, x, (3 + n) * sizeof(double));
    for (int halving = 0; halving < HALVINGS; halving++) {
        const double share = 0.5 * (low + high);
        for (int k = 0; k < n; k++) between[3 + k] = x[3 + k] + (share - 1.0) * way[k];
        solve_response(one, p, between, at->kappa, at, there);
        const double beyond = (there[0] - found[0]) / change + 0.5;
        if (beyond > 0.0) high = share;
        else low = share;
        if (fabs(beyond) <= HALF && fabs(along(one, there, way)) >= fabs(change)) break;
    }
    for (int k = 0; k < n; k++) way[k] = x[3 + k] - between[3 + k];
    there[0] += along(one, there, way);
    memcpy(found, there, (1 + n) * sizeof(double));
    about[0] = NAN;
    at->taken_up = 1;
}

/* Forces and slopes for the actions: of those that respond at the motions and rates given for every row, and of others
   the force that they hold. */
void respond(const struct pgmp_model *m, double motions[][2], struct response *at, double given[][3]) {
    if (N_CONTROLS == 0) return;
    if (at) at->taken_up = 0;
    for (int k = 0; k < N_CONTROLS; k++) {
        const struct control *one = controls + k;
        double x[3 + N_SLOPES], found[N_SLOPES] = {0}, beside[AT_LEAST_ONE(N_BESIDE)];
        int sampled = one->every > 0, due = sampled && m->number % one->every == 0;
        memcpy(beside, m->beside, sizeof beside);
        found[0] = *force_of(beside, one);
        if (at && (at->who == EVERYONE || (at->who == DUE ? due : !sampled))) {
            x[0] = at->time, x[1] = at->references[k][0], x[2] = at->references[k][1];
            for (int i = 0; i < one->n_motions; i++)
                for (int j = 0; j < 2; j++) x[3 + 2 * i + j] = motions[one->row + i][j];
            if (at->who == EVERYONE) {
                one->start(m->controls[k], x, x, at->c + one->column);
                memcpy(at->z + one->column, at->c + one->column, one->n_states * sizeof(double));
            }
            solve_response(one, m->controls[k], x, at->who == DUE ? one->every * STEP : at->kappa, at, found);
            at->forces[k] = found[0];
            if (at->who == CONTINUOUS) take_up(k, m->controls[k], x, at, found);
        }
        given[control_actions[one->row]][0] = found[0];
        for (int i = 0; i < one->n_motions; i++)
            for (int j = 0; j < 2; j++) given[control_actions[one->row + i]][1 + j] = -found[1 + 2 * i + j];
    }
}

/* What laws are given at a time. */
static void look(const struct pgmp_model *m, double time, struct response *at) {
    double rates[2];
    at->time = time;
    for (int k = 0; k < N_CONTROLS; k++) {
        const struct control *one = controls + k;
        at->references[k][0] = m->controls[k][one->reference], at->references[k][1] = 0.0;
        if (one->function < 0) continue;
        at->references[k][0] = evaluate_piece(one->function, time, time, rates);
        at->references[k][1] = rates[0];
    }
}

/* Lets no force be taken up that jumped since an iterate before. */
void forget_iterates(struct response *at) {
    at->taken_up = 0;
    for (int k = 0; k < N_CONTROLS; k++) at->about[k][0] = NAN;
}

/* Begins the iteration of a step of h, or of a part of one, to a time. */
void begin_response(const struct pgmp_model *m, const struct scheme *s, double h, double time, struct response *at) {
    const double share = h * s->gamma / (1.0 - s->alpha_m);
    at->who = CONTINUOUS;
    at->kappa = s->gamma / (s->beta * h) / ((1.0 - s->alpha_m) / ((1.0 - s->alpha_f) * s->beta * (h * h)));
    look(m, time, at);
    forget_iterates(at);
    for (int k = 0; k < N_CONTROLS; k++)
        for (int i = controls[k].column, n = controls[k].n_states; i < controls[k].column + n; i++) {
            const double *z = m->beside + i;
            at->c[i] = z[0] + h * (1.0 - s->gamma) * z[2 * n] + share * (s->alpha_f * z[n] - s->alpha_m * z[2 * n]);
            at->z[i] = at->c[i] + at->kappa * z[n];
        }
}

/* Begins a response without a step: that of all at the start, or of those that are sampled now. */
void begin_sampling(const struct pgmp_model *m, int who, double time, struct response *at) {
    at->who = who, at->kappa = 0.0;
    look(m, time, at);
    memcpy(at->c, m->beside, sizeof m->beside), memcpy(at->z, m->beside, sizeof m->beside);
}

/* Takes what is beside to where the last response was. */
void follow_response(struct pgmp_model *m, const struct scheme *s, const struct response *at) {
    for (int k = 0; k < N_CONTROLS; k++) {
        const struct control *one = controls + k;
        int sampled = one->every > 0, n = one->n_states;
        if (at->who == DUE ? !(sampled && m->number % one->every == 0) : at->who == CONTINUOUS && sampled) continue;
        for (int i = one->column; i < one->column + n; i++) {
            double *z = m->beside + i, rate = at->rates[i];
            double ahead = ((1.0 - s->alpha_f) * rate + s->alpha_f * z[n] - s->alpha_m * z[2 * n]) / (1.0 - s->alpha_m);
            z[0] = at->z[i];
            if (at->who == DUE) continue;
            z[n] = rate, z[2 * n] = at->who == EVERYONE ? rate : ahead;
        }
        *force_of(m->beside, one) = at->forces[k];
    }
}

/* Whether any force jumps at the beginning of the next step. */
int jumps(const struct pgmp_model *m) {
    for (int k = 0; k < N_CONTROLS; k++)
        if (m->number > m->sampled && controls[k].every > 0 && m->number % controls[k].every == 0) return 1;
    return 0;
}
