/* Steps of the generalised-alpha scheme of Chung and Hulbert (1993) in the form of Arnold and Bruls (2007).

   A step does CORRECTIONS Newton corrections, REFRESH_EVERY with one matrix, and up to MAX_ITERATIONS where it needs
   them. They count as long as pgmp simulate would go on: what a correction leaves is estimated from how the iteration
   contracts, after the first one from how it did in the steps before. pgmp_model.correction is what is left by that
   estimate. A step that fails is tried twice more as pgmp simulate does, from another prediction and with a matrix of
   its own for each correction: at most MAX_ITERATIONS as they are, then CAREFUL_ITERATIONS, shortened to LONGEST.

   written by pgmp_petsc */

#include <math.h>
#include <string.h>

#include "tables.h"

enum { EXTRAPOLATED, COASTING, CAREFUL, N_ATTEMPTS };

#define LARGE 1e30 /* gain that makes stiffness negligible beside mass */

void pgmp_initialise(struct pgmp_model *m) {
    memset(m, 0, sizeof *m);
    for (int k = 0; k < N_PARAMETERS; k++) m->parameters[k] = parameter_values[k];
    for (int k = 0; k < N_STRENGTHS; k++) m->follows_scene[k] = 1;
}

void pgmp_weigh(struct pgmp_model *m) {
    double of_terms[N_TERMS], of_loads[AT_LEAST_ONE(N_LOAD_TERMS)];
    weigh(m->parameters, of_terms, of_loads, m->laws);
    memset(m->rigid, 0, sizeof m->rigid);
    memset(m->terms, 0, sizeof m->terms);
    memset(m->loads, 0, sizeof m->loads);
    for (int t = 0; t < N_TERMS; t++) {
        for (int c = 0; c < N_CELLS; c++)
            for (int p = 0; p < PACKED(R) * RIGID_POWERS; p++) m->rigid[c][p] += of_terms[t] * rigid_table[c][t][p];
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

/* Strengths of what acts over time; coordinates whose motion is given are put where they are. */
static void act(const struct pgmp_model *m, double time, double since, double strengths[], double q[N], double v[N],
                double a[N]) {
    double rates[2];
    for (int k = 0; k < N_STRENGTHS; k++)
        strengths[k] = m->follows_scene[k] ? evaluate_piece(k, time, since, rates) : m->strengths[k];
    for (int k = 0; k < R; k++)
        if (pgmp_prescribed[k]) {
            q[k] = evaluate_piece(N_STRENGTHS + k, time, since, rates);
            v[k] = rates[0], a[k] = rates[1];
        }
}

/* The Newton correction at (q, v, a), in r; about as for `obey` of each action, or none. */
static void correct(const struct pgmp_model *m, const double strengths[], const double q[N], const double v[N],
                    const double a[N], double gain_v, double gain_a, int fresh, double about[], struct matrix *matrix,
                    double r[N]) {
    struct stencil stencil;
    struct terms t;
    find_stencil(axes, q, &stencil);
    interpolate(m, &stencil, q, strengths, &t);
    evaluate_lagrangian(&t, q, v, a, gain_v, gain_a, fresh, r, matrix);
    add_actions(m, &stencil, strengths, q, v, gain_v, fresh, about, r, matrix);
    if (fresh) eliminate(matrix);
    solve(matrix, r);
}

static void look_at_state(struct pgmp_model *m) {
    for (int i = 0; i < N; i++)
        if (!isfinite(m->q[i]) || !isfinite(m->v[i]) || !isfinite(m->a[i])) m->validity |= PGMP_NOT_FINITE;
    for (int k = 0; k < R; k++) {
        double upper = axes[k].lower + axes[k].n_cells * axes[k].step;
        if (!axes[k].periodic && !(m->q[k] >= axes[k].lower && m->q[k] <= upper)) m->validity |= PGMP_OUT_OF_RANGE;
    }
}

void pgmp_accelerate(struct pgmp_model *m, double time, double since) {
    double strengths[AT_LEAST_ONE(N_STRENGTHS)], r[N], at_rest[N] = {0};
    struct matrix matrix;
    act(m, time, since, strengths, m->q, m->v, at_rest);
    correct(m, strengths, m->q, m->v, at_rest, 0.0, LARGE, 1, 0, &matrix, r);
    for (int i = 0; i < N; i++) m->a[i] = at_rest[i] - LARGE * r[i];
    look_at_state(m);
}

void pgmp_start(struct pgmp_model *m) {
    m->number = 0, m->validity = 0, m->correction = 0.0, m->contraction = FIRST_CONTRACTION;
    pgmp_weigh(m);
    for (int i = 0; i < N; i++) m->q[i] = m->v[i] = 0.0;
    for (int k = 0; k < R; k++) m->q[k] = start_position[k], m->v[k] = start_velocity[k];
    pgmp_accelerate(m, 0.0, 0.0);
    for (int i = 0; i < N; i++) m->auxiliary[i] = m->before[i] = m->a[i];
}

double pgmp_time(const struct pgmp_model *m) { return STEP * m->number; }

static double at_most(double most, double x) { return x > most ? most : x; }

/* Auxiliary acceleration at the end of a step where coordinate i has the acceleration a. */
static double ahead_of(const struct pgmp_model *m, int i, double a) {
    return ((1.0 - ALPHA_F) * a + ALPHA_F * m->a[i] - ALPHA_M * m->auxiliary[i]) / (1.0 - ALPHA_M);
}

/* The end of a step: accelerations are extrapolated, at later attempts those for which q goes to q + h v, as a load
   that sets in at once gives light nodes accelerations that no step can follow. */
static void predict(const struct pgmp_model *m, int attempt, double q[N], double v[N], double a[N]) {
    const double h = STEP;
    for (int i = 0; i < N; i++) {
        double behind = m->auxiliary[i], kept = (1.0 - ALPHA_M) * (-(0.5 - BETA) / BETA * behind) + ALPHA_M * behind;
        a[i] = attempt == EXTRAPOLATED ? 2.0 * m->a[i] - m->before[i] : (kept - ALPHA_F * m->a[i]) / (1.0 - ALPHA_F);
        double ahead = ahead_of(m, i, a[i]);
        q[i] = m->q[i] + h * m->v[i] + h * h * ((0.5 - BETA) * behind + BETA * ahead);
        v[i] = m->v[i] + h * ((1.0 - GAMMA) * behind + GAMMA * ahead);
    }
}

/* Newton's iteration from a prediction; returns whether it came to its end, and what is left. */
static int converge(struct pgmp_model *m, int attempt, const double strengths[], double q[N], double v[N], double a[N],
                    double *left) {
    const double tolerance = attempt == EXTRAPOLATED ? NEWTON_TOLERANCE : TOLERANCE_OF_TRIALS;
    const int least = attempt == EXTRAPOLATED ? CORRECTIONS : 0, careful = attempt == CAREFUL;
    const int most = careful ? CAREFUL_ITERATIONS : MAX_ITERATIONS;
    double r[N], about[AT_LEAST_ONE(N_ACTIONS)], last = 0.0;
    struct matrix matrix;
    int active = 1;
    for (int k = 0; k < AT_LEAST_ONE(N_ACTIONS); k++) about[k] = N_ACTIONS ? NAN : 0.0;
    for (int number = 0; number < most && (active || number < least); number++) {
        double size = 0.0, share = 1.0, contraction = m->contraction;
        int fresh = attempt != EXTRAPOLATED || number % REFRESH_EVERY == 0;
        int limited = 0;
        correct(m, strengths, q, v, a, GAIN_V, GAIN_A, fresh, about, &matrix, r);
        for (int k = 0; k < N_ACTIONS; k++) limited |= isnan(about[k]);
        if (limited) last = 0.0; /* nothing follows from the size of the last correction */
        for (int i = 0; i < N && isfinite(size); i++) /* what is no number is not lost to a number behind it */
            size = fabs(r[i]) * scale[i] <= size ? size : fabs(r[i]) * scale[i];
        while (careful && isfinite(size) && size > LONGEST) size *= 0.5, share *= 0.5;
        for (int i = 0; i < N; i++) {
            double change = active ? share * r[i] : 0.0;
            q[i] -= change;
            v[i] -= GAIN_V * change;
            a[i] -= GAIN_A * change;
        }
        if (number > 0) contraction = at_most(WORST_CONTRACTION, size / (last > 1e-300 ? last : 1e-300));
        if (number == 1 && active && !careful) {
            double known = at_most(WORST_CONTRACTION, CAUTION * contraction);
            m->contraction = known > LEAST_CONTRACTION ? known : LEAST_CONTRACTION;
        }
        if (active) *left = careful ? size : size * contraction / (1.0 - contraction);
        active = active && isfinite(size) && ((*left > tolerance && size > ROUND_OFF) || (careful && limited));
        last = size;
    }
    return !active && isfinite(*left);
}

int pgmp_step(struct pgmp_model *m) {
    const double end = STEP * (m->number + 1);
    double q[N], v[N], a[N], strengths[AT_LEAST_ONE(N_STRENGTHS)], left = 0.0;
    int done = 0;
    m->validity &= ~PGMP_NOT_CONVERGED; /* a step that was not taken has left nothing behind */
    /* corrected twice, to see how it contracts; with friction always, which contracts otherwise in each step */
    int probed = RUBS || (m->number + 1) % PROBED_EVERY == 0;
    if (probed) m->contraction = FIRST_CONTRACTION;
    for (int attempt = 0; attempt < N_ATTEMPTS && !done; attempt++) {
        predict(m, attempt, q, v, a);
        act(m, end, end, strengths, q, v, a);
        done = converge(m, attempt, strengths, q, v, a, &left);
        if (!done) m->contraction = FIRST_CONTRACTION;
    }
    if (!done) return m->validity |= PGMP_NOT_CONVERGED;
    for (int i = 0; i < N; i++) {
        double ahead = ahead_of(m, i, a[i]);
        m->before[i] = m->a[i], m->auxiliary[i] = ahead;
        m->q[i] = q[i], m->v[i] = v[i], m->a[i] = a[i];
    }
    m->number++;
    m->correction = left;
    look_at_state(m);
    return m->validity;
}
