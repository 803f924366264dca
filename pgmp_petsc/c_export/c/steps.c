/* Steps of the generalised-alpha scheme of Chung and Hulbert (1993) in the form of Arnold and Bruls (2007).

   A step does CORRECTIONS Newton corrections, REFRESH_EVERY with one matrix, and up to MAX_ITERATIONS where it needs
   them. They count as long as pgmp simulate would go on: what a correction leaves is estimated from how the iteration
   contracts, after the first one from how it did in the steps before. pgmp_model.correction is what is left by that
   estimate. A step that fails is tried twice more as pgmp simulate does, from another prediction and with a matrix of
   its own for each correction: at most MAX_ITERATIONS as they are, then CAREFUL_ITERATIONS, shortened to LONGEST.

   A step over the edge of a law is taken in parts, up to the edge and on; the edge is searched by Brent's method (1973,
   chapter 4) with steps of its own, a dozen for each edge and MAX_TRIALS at most.

   written by pgmp_petsc */

#include <math.h>
#include <string.h>

#include "tables.h"

static const struct scheme own_scheme = {ALPHA_M, ALPHA_F, BETA, GAMMA};

enum { EXTRAPOLATED, COASTING, CAREFUL, N_ATTEMPTS };
enum { MOST_TURNS = 100 };

void pgmp_initialise(struct pgmp_model *m) {
    memset(m, 0, sizeof *m);
    for (int k = 0; k < N_PARAMETERS; k++) m->parameters[k] = parameter_values[k];
    for (int k = 0; k < N_STRENGTHS; k++) m->follows_scene[k] = 1;
}

/* Lets friction act under forces in joints. */
static void load_friction(struct pgmp_model *m, const double carried[]) {
    for (int k = 0; k < N_CARRIED; k++) m->laws[carried_actions[k]][0] = carried[k];
}

void pgmp_weigh(struct pgmp_model *m) {
    weigh_tables(m);
    load_friction(m, m->carried);
    for (int k = 0; k < N_PARAMETERS; k++)
        if (!(m->parameters[k] >= parameter_lower[k] && m->parameters[k] <= parameter_upper[k]))
            m->validity |= PGMP_PARAMETER;
}

static void look_at_state(struct pgmp_model *m) {
    for (int i = 0; i < N; i++)
        if (!isfinite(m->q[i]) || !isfinite(m->v[i]) || !isfinite(m->a[i])) m->validity |= PGMP_NOT_FINITE;
    if (leaves_tables(m)) m->validity |= PGMP_OUT_OF_RANGE;
}

#if N_CARRIED > 0
/* The forces in joints that friction hangs on, in a state, with friction under those that were found before; `own_forces` as
   `own` of find_forces. */
static void find_carried(struct pgmp_model *m, const struct acting *now, const double *own_forces, const double q[N],
                         const double v[N], const double a[N], double carried[]) {
    const size_t size = N * sizeof(double);
    double own[3][N], found[N_FORCES + R][3], theta[R];
    struct frame nodes[AT_LEAST_ONE(N_NODES)];
    struct look look;
    memcpy(own[0], m->q, size), memcpy(own[1], m->v, size), memcpy(own[2], m->a, size);
    memmove(m->q, q, size), memmove(m->v, v, size), memmove(m->a, a, size);
    look_at(m, &look);
    see_nodes(m, &look, 0.0, theta, nodes);
    find_forces(m, now, own_forces, nodes, found);
    memcpy(m->q, own[0], size), memcpy(m->v, own[1], size), memcpy(m->a, own[2], size);
    for (int k = 0; k < N_CARRIED; k++) carried[k] = found[k][0];
}

enum { BEFORE, OFF, AHEAD, ACROSS, INVERSE }; /* rows of what is kept from correction to correction */

/* Takes these forces on, in correction `number` of an iteration, to those of which a state gives the same, from what it
   gives now, by Broyden's method (1965); returns whether any changes by more than SETTLED_IN_STEP. */
static int follow_carried(int number, const double found[N_CARRIED], double kept[INVERSE + N_CARRIED][N_CARRIED],
                          double carried[N_CARRIED]) {
    double whole = 0.0, size = 0.0, along = 0.0, (*inverse)[N_CARRIED] = kept + INVERSE;
    int unsettled = 0;
    for (int i = 0; number >= FIRST_SECANT && i < N_CARRIED; i++) {
        kept[AHEAD][i] = kept[ACROSS][i] = 0.0;
        for (int j = 0; j < N_CARRIED; j++) {
            kept[AHEAD][i] += inverse[i][j] * (kept[OFF][j] - (found[j] - carried[j]));
            kept[ACROSS][i] += inverse[j][i] * (carried[j] - kept[BEFORE][j]);
        }
        whole += carried[i] * carried[i];
        size += (carried[i] - kept[BEFORE][i]) * (carried[i] - kept[BEFORE][i]);
        along += (carried[i] - kept[BEFORE][i]) * kept[AHEAD][i];
    }
    const int known = size > SMALLEST_SECANT * SMALLEST_SECANT * whole; /* more than round-off */
    const int believed = along > WEAKEST * size && along < STRONGEST * size;
    for (int i = 0; i < N_CARRIED; i++)
        for (int j = 0; j < N_CARRIED; j++)
            if (known && believed)
                inverse[i][j] += (carried[i] - kept[BEFORE][i] - kept[AHEAD][i]) * kept[ACROSS][j] / along;
            else if (known || number < FIRST_SECANT)
                inverse[i][j] = i == j;
    for (int i = 0; i < N_CARRIED; i++) kept[BEFORE][i] = carried[i], kept[OFF][i] = found[i] - carried[i];
    for (int i = 0; i < N_CARRIED; i++) {
        for (int j = 0; j < N_CARRIED; j++) carried[i] += inverse[i][j] * kept[OFF][j];
        unsettled |= fabs(kept[OFF][i]) > SETTLED_IN_STEP * fabs(carried[i]);
    }
    return unsettled;
}
#endif

/* Accelerations and the forces that friction hangs on are found in turn, until these change by no more than round-off. */
void pgmp_accelerate(struct pgmp_model *m, double time, double since) {
    struct acting now;
    int changed = 1;
    act(m, time, since, &now);
    for (int turn = 0; changed && turn < MOST_TURNS; turn++) {
        find_accelerations(m, &now);
        changed = 0;
#if N_CARRIED > 0
        double found[N_CARRIED];
        find_carried(m, &now, 0, m->q, m->v, m->a, found);
        for (int k = 0; k < N_CARRIED; k++) {
            changed |= fabs(found[k] - m->carried[k]) > SETTLED * fabs(found[k]);
            m->carried[k] = found[k];
        }
        load_friction(m, m->carried);
#endif
    }
    look_at_state(m);
}

static void count(struct pgmp_model *m) {
    if (N_COUNTS > 0) pgmp_observe(m), count_step(m);
}

static void find_first(struct pgmp_model *m);

void pgmp_start(struct pgmp_model *m) {
    double depths[AT_LEAST_ONE(N_EDGES)];
    m->number = 0, m->validity = 0, m->correction = 0.0, m->contraction = FIRST_CONTRACTION;
    for (int i = 0; i < N; i++) m->q[i] = m->v[i] = 0.0;
    memset(m->carried, 0, sizeof m->carried);
    pgmp_weigh(m);
    stand_at_start(m);
    m->sampled = 0;
    if (N_CONTROLS > 0) {
        struct response response;
        memset(m->beside, 0, sizeof m->beside);
        begin_sampling(m, EVERYONE, 0.0, &response);
        look_at_motions(m, m->q, m->v, &response);
        follow_response(m, &own_scheme, &response);
    }
    pgmp_accelerate(m, 0.0, 0.0);
    find_depths(m, m->q, depths);
    for (int e = 0; e < N_EDGES; e++) m->beyond[e] = depths[e] > 0.0;
    find_first(m);
    start_counts(m);
    count(m);
}

static double at_most(double most, double x) { return x > most ? most : x; }

/* Auxiliary acceleration at the end of a step where coordinate i has the acceleration a. */
static double ahead_of(const struct pgmp_model *m, const struct scheme *s, int i, double a) {
    return ((1.0 - s->alpha_f) * a + s->alpha_f * m->recent[i] - s->alpha_m * m->auxiliary[i]) / (1.0 - s->alpha_m);
}

/* The end of a step, or of a part of one: its length, the state, and how far edges are crossed there. */
struct trial {
    const struct scheme *scheme;
    double forces[AT_LEAST_ONE(N_ALL - N)]; /* multipliers of constraints */
    double h, q[N], v[N], a[N], depths[AT_LEAST_ONE(N_EDGES)], left, carried[AT_LEAST_ONE(N_CARRIED)];
    struct response response;
};

/* Accelerations are extrapolated, at later attempts those for which q goes to q + h v, as a load that sets in at once
   gives light nodes accelerations that no step can follow. */
static void predict(const struct pgmp_model *m, int attempt, struct trial *t) {
    const struct scheme *s = t->scheme;
    memset(t->forces, 0, sizeof t->forces); /* the first correction finds them */
    const double h = t->h, m_share = s->alpha_m, beta = s->beta, gamma = s->gamma;
    for (int i = 0; i < N; i++) {
        double behind = m->auxiliary[i], kept = (1.0 - m_share) * (-(0.5 - beta) / beta * behind) + m_share * behind;
        kept -= s->alpha_f * m->recent[i];
        t->a[i] = attempt == EXTRAPOLATED ? 2.0 * m->recent[i] - m->before[i] : kept / (1.0 - s->alpha_f);
        double ahead = ahead_of(m, s, i, t->a[i]);
        t->q[i] = m->q[i] + h * m->v[i] + h * h * ((0.5 - beta) * behind + beta * ahead);
        t->v[i] = m->v[i] + h * ((1.0 - gamma) * behind + gamma * ahead);
    }
}

/* Newton's iteration from a prediction; returns whether it came to its end. */
static int converge(struct pgmp_model *m, int attempt, int in_part, const struct acting *now, struct trial *t) {
    const struct scheme *s = t->scheme;
    const double gain_v = s->gamma / (s->beta * t->h);
    const double gain_a = (1.0 - s->alpha_m) / ((1.0 - s->alpha_f) * s->beta * (t->h * t->h));
    const int usual = attempt == EXTRAPOLATED && !in_part, careful = attempt == CAREFUL;
    const int least = usual ? CORRECTIONS : 0, most = careful ? CAREFUL_ITERATIONS : MAX_ITERATIONS;
    double r[N_ALL], last = 0.0;
    struct iterate kept[AT_LEAST_ONE(N_ACTIONS)];
    struct matrix matrix;
    int active = 1, going = 1; /* it goes on until forces that friction hangs on are settled */
#if N_CARRIED > 0
    double found[N_CARRIED], followed[INVERSE + N_CARRIED][N_CARRIED];
    memcpy(t->carried, m->carried, sizeof m->carried);
#endif
    for (int k = 0; k < AT_LEAST_ONE(N_ACTIONS); k++) kept[k].about = N_ACTIONS ? NAN : 0.0;
    for (int number = 0; number < most && (going || number < least); number++) {
        double size = 0.0, share = 1.0, contraction = m->contraction;
        double tolerance = !usual ? TOLERANCE_OF_TRIALS : number == 0 ? TOLERANCE_OF_ONE : NEWTON_TOLERANCE;
        if (number == 1 && !careful) tolerance /= OF_OLD_FACTORS;
        int fresh = attempt != EXTRAPOLATED || number % REFRESH_EVERY == 0;
        int limited = 0, unsettled = 0;
#if N_CARRIED > 0
        find_carried(m, now, t->forces, t->q, t->v, t->a, found);
        unsettled = follow_carried(number, found, followed, t->carried) && !careful;
        load_friction(m, t->carried);
#endif
        correct(m, now, t->q, t->v, t->a, t->forces, gain_v, gain_a, fresh, kept, &t->response, &matrix, r);
        unsettled |= t->response.taken_up;
        for (int k = 0; k < N_ACTIONS; k++) limited |= isinf(kept[k].about);
        if (limited) last = 0.0; /* nothing follows from the size of the last correction */
        for (int i = 0; i < N && isfinite(size); i++) /* what is no number is not lost to a number behind it */
            size = fabs(r[i]) * scale[i] <= size ? size : fabs(r[i]) * scale[i];
        while (careful && isfinite(size) && size > LONGEST) size *= 0.5, share *= 0.5;
        for (int i = 0; i < N; i++) {
            double change = going ? share * r[i] : 0.0;
            t->q[i] -= change;
            t->v[i] -= gain_v * change;
            t->a[i] -= gain_a * change;
        }
        for (int i = N; going && i < N_ALL; i++) t->forces[i - N] -= share * r[i];
        /* how the iteration contracted before says nothing where a law bends */
        if (number == 0 && (ALWAYS_PROBED || bends(m, kept, t->v, gain_v))) contraction = FIRST_CONTRACTION;
        if (number > 0) contraction = at_most(WORST_CONTRACTION, size / (last > 1e-300 ? last : 1e-300));
        if (number == 1 && active && !careful) {
            double known = at_most(WORST_CONTRACTION, CAUTION * contraction);
            m->contraction = known > LEAST_CONTRACTION ? known : LEAST_CONTRACTION;
        }
        if (active) t->left = careful ? size : size * contraction / (1.0 - contraction);
        active = active && isfinite(size) && ((t->left > tolerance && size > ROUND_OFF) || (careful && limited));
        going = going && (active || (unsettled && size > ROUND_OFF));
        last = size;
    }
#if N_CARRIED > 0
    find_carried(m, now, t->forces, t->q, t->v, t->a, t->carried);
#endif
    return !active && isfinite(t->left);
}

/* Tries a step, or a part of one, of h to a time; returns whether an attempt came to its end. */
static int try_step(struct pgmp_model *m, double h, double end, int in_part, struct trial *t) {
    struct acting now;
    t->h = h;
    act(m, end, end, &now);
    if (in_part) m->contraction = FIRST_CONTRACTION;
    for (int attempt = 0; attempt < N_ATTEMPTS; attempt++) {
        predict(m, attempt, t);
        follow_motions(&now, t->q, t->v, t->a);
        begin_response(m, t->scheme, h, end, &t->response);
        int converged = converge(m, attempt, in_part, &now, t);
        load_friction(m, m->carried);
        if (converged) {
            if (PROJECTS && t->scheme == &own_scheme) project_motion(m, &now, h, t->q, t->v, t->a);
            find_depths(m, t->q, t->depths);
            if (N_CONTROLS > 0) look_at_motions(m, t->q, t->v, &t->response);
            return 1;
        }
        m->contraction = FIRST_CONTRACTION;
    }
    return 0;
}

/* Accelerations that the scheme begins with: of steps that cannot overshoot, see `first_accelerations` in pgmp_petsc. */
static void find_first(struct pgmp_model *m) {
    static const struct scheme implicit = {0.0, 0.0, 0.5, 1.0};
    double found[N] = {0};
    int fine = 1;
    for (int i = 0; i < N; i++) m->auxiliary[i] = m->recent[i] = m->before[i] = m->a[i];
    m->contraction = FIRST_CONTRACTION;
    for (int parts = 2; fine && parts > 0; parts--) {
        const double h = STEP / parts, gain_a = 2.0 / (h * h), weight = parts == 2 ? 2.0 : -1.0;
        struct trial t = {.scheme = &implicit};
        double r[N_ALL];
        struct acting now;
        struct matrix matrix;
        fine = try_step(m, h, h, 0, &t);
        act(m, h, h, &now);
        memset(r, 0, sizeof r);
        if (N_CARRIED == 0) correct(m, &now, t.q, t.v, t.a, t.forces, 2.0 / h, gain_a, 1, 0, &t.response, &matrix, r);
        for (int i = 0; i < N; i++) found[i] += weight * (t.a[i] - gain_a * r[i]);
    }
    for (int i = 0; fine && i < N; i++) m->auxiliary[i] = found[i];
    for (int i = 0; GOES_ON_RESOLVED && i < N; i++) m->recent[i] = m->before[i] = m->auxiliary[i];
    m->contraction = FIRST_CONTRACTION;
}

/* Goes to the end of a trial. */
static void follow(struct pgmp_model *m, const struct trial *t) {
    for (int i = 0; i < N; i++) {
        double ahead = ahead_of(m, t->scheme, i, t->a[i]);
        m->before[i] = m->recent[i], m->auxiliary[i] = ahead;
        m->q[i] = t->q[i], m->v[i] = t->v[i], m->recent[i] = m->a[i] = t->a[i];
    }
    m->correction = t->left;
    memcpy(m->carried, t->carried, sizeof m->carried), load_friction(m, m->carried);
    follow_response(m, t->scheme, &t->response);
    count_turns(m, m->q);
}

/* Samples controllers whose time it is; accelerations jump with their forces as far as steps resolve it, see
   `resolved_jump` in pgmp_petsc. */
static void sample(struct pgmp_model *m) {
    static const double none[AT_LEAST_ONE(N_ALL - N)];
    const double time = pgmp_time(m);
    double begun[N], jump[N];
    struct response response;
    struct acting now;
    begin_sampling(m, DUE, time, &response);
    look_at_motions(m, m->q, m->v, &response);
    follow_response(m, &own_scheme, &response);
    memcpy(begun, m->recent, sizeof begun);
    act(m, time, time, &now);
    follow_motions(&now, m->q, m->v, begun);
    for (int i = 0; i < N; i++) jump[i] = begun[i] - m->recent[i];
    for (int parts = 2; parts > 0; parts--) {
        const double h = STEP / parts, gain_a = 2.0 / (h * h), weight = parts == 2 ? 2.0 : -1.0;
        double r[N_ALL];
        struct matrix matrix;
        correct(m, &now, m->q, m->v, begun, none, 2.0 / h, gain_a, 1, 0, 0, &matrix, r);
        for (int i = 0; i < N; i++) jump[i] -= weight * gain_a * r[i];
    }
    for (int i = 0; i < N; i++) m->auxiliary[i] += jump[i], m->before[i] = m->recent[i] += jump[i];
    m->sampled = m->number, m->contraction = FIRST_CONTRACTION;
}

static int crosses(const struct pgmp_model *m, const double depths[], int edge) {
    return (depths[edge] > 0.0) != m->beyond[edge];
}

static int first_crossed(const struct pgmp_model *m, const double depths[], int edge) {
    while (edge < N_EDGES && !crosses(m, depths, edge)) edge++;
    return edge;
}

/* A step of Brent's method: the best instant b, the one before, a, and one across the root, c, with their depths; once
   an instant `inside` the first two was tried, what would be moved by less than the tolerance is the root. */
struct bracket { double a, b, c, fa, fb, fc, change, last; };

static int narrow(struct bracket *s, double tolerance, int inside) {
    if ((s->fa < 0.0) != (s->fb < 0.0)) s->c = s->a, s->fc = s->fa, s->change = s->last = s->b - s->a;
    if (fabs(s->fc) < fabs(s->fb)) {
        s->a = s->b, s->b = s->c, s->c = s->a;
        s->fa = s->fb, s->fb = s->fc, s->fc = s->fa;
    }
    double least = 0.5 * (tolerance + 4.0 * 2.220446049250313e-16 * fabs(s->b)), half = 0.5 * (s->c - s->b);
    if (s->fb == 0.0 || fabs(half) < least) return 1;
    double last = half, change = half;
    if (fabs(s->last) > least && fabs(s->fb) < fabs(s->fa)) {
        double trial;
        if (s->a == s->c) /* a line through both */
            trial = -s->fb * (s->b - s->a) / (s->fb - s->fa);
        else { /* an inverse parabola through all three */
            double behind = (s->fa - s->fb) / (s->a - s->b), across = (s->fc - s->fb) / (s->c - s->b);
            trial = -s->fb * (s->fc * across - s->fa * behind) / (across * behind * (s->fc - s->fa));
        }
        double bound = 3.0 * fabs(half) - least;
        if (2.0 * fabs(trial) < (fabs(s->last) < bound ? fabs(s->last) : bound)) {
            if (inside && fabs(trial) <= least) return 1;
            last = s->change, change = trial;
        }
    }
    s->last = last, s->change = change;
    s->a = s->b, s->fa = s->fb;
    s->b += fabs(change) > least ? change : half > 0.0 ? least : -least;
    return 0;
}

/* Finds when an edge is reached in the time `rest` up to an end, where its depth is known; returns whether it was. */
static int find_edge(struct pgmp_model *m, int edge, double rest, double end, double depth, int *n_trials,
                     double *root) {
    const double sign = m->beyond[edge] ? -1.0 : 1.0;
    struct bracket s = {.b = rest, .fb = sign * depth, .a = SHORTEST * rest};
    struct trial t = {.scheme = &own_scheme};
    if (!try_step(m, s.a, end - rest + s.a, 1, &t)) return 0;
    s.fa = sign * t.depths[edge];
    *root = 0.0;
    if (!(s.fa < 0.0)) return 1; /* it is there already */
    for (int inside = 0; !narrow(&s, TIME_TOLERANCE * rest, inside); inside = 1) {
        if (++*n_trials > MAX_TRIALS || !try_step(m, s.b, end - rest + s.b, 1, &t)) return 0;
        s.fb = sign * t.depths[edge];
    }
    *root = s.b;
    return 1;
}

/* Takes a step over edges in parts, as `edge_search` of the program; returns whether it came to its end. */
static int step_over_edges(struct pgmp_model *m, double end, struct trial *t) {
    double rest = STEP;
    int n_trials = 0;
    for (int n_found = 1;; n_found++) {
        double first = HUGE_VAL;
        int nearest = 0;
        for (int i = 0; n_found == 1 && i < N; i++) m->before[i] = m->recent[i];
        for (int e = first_crossed(m, t->depths, 0); e < N_EDGES; e = first_crossed(m, t->depths, e + 1)) {
            double root;
            if (!find_edge(m, e, rest, end, t->depths[e], &n_trials, &root)) return 0;
            if (root < first) first = root, nearest = e;
        }
        m->beyond[nearest] = !m->beyond[nearest];
        if (first > SHORTEST * STEP) {
            if (!try_step(m, first, end - rest + first, 1, t)) return 0;
            follow(m, t);
            rest -= first;
            if (rest <= SHORTEST * STEP) return 1;
            for (int i = 0; i < N; i++) m->before[i] = m->recent[i];
        }
        if (!try_step(m, rest, end, 1, t)) return 0;
        if (n_found == MAX_EVENTS || first_crossed(m, t->depths, 0) == N_EDGES) break;
    }
    follow(m, t);
    return 1;
}

/* The state at the beginning of a step, to which one that fails goes back. */
struct beginning {
    double q[N], v[N], a[N], auxiliary[N], recent[N], before[N], beside[AT_LEAST_ONE(N_BESIDE)];
    double carried[AT_LEAST_ONE(N_CARRIED)], correction;
    int beyond[AT_LEAST_ONE(N_EDGES)];
};

#define COPY(NAME) memcpy(&to->NAME, &from->NAME, sizeof to->NAME);
#define COPY_ALL                                                                                        \
    COPY(q) COPY(v) COPY(a) COPY(auxiliary) COPY(recent) COPY(before) COPY(beside) COPY(carried) COPY(beyond) \
    COPY(correction)

static void keep(const struct pgmp_model *from, struct beginning *to) { COPY_ALL }

static void go_back(struct pgmp_model *to, const struct beginning *from) {
    COPY_ALL
    load_friction(to, to->carried);
}

int pgmp_step(struct pgmp_model *m) {
    const double end = STEP * (m->number + 1);
    struct trial t = {.scheme = &own_scheme};
    m->validity &= ~PGMP_NOT_CONVERGED; /* a step that was not taken has left nothing behind */
    if (jumps(m)) sample(m);
    /* corrected twice, to see how it contracts */
    if ((m->number + 1) % PROBED_EVERY == 0) m->contraction = FIRST_CONTRACTION;
    if (!try_step(m, STEP, end, 0, &t)) return m->validity |= PGMP_NOT_CONVERGED;
    if (N_EDGES > 0 && first_crossed(m, t.depths, 0) < N_EDGES) {
        struct beginning kept;
        keep(m, &kept);
        int done = step_over_edges(m, end, &t);
        m->contraction = FIRST_CONTRACTION;
        if (!done) {
            go_back(m, &kept);
            return m->validity |= PGMP_NOT_CONVERGED;
        }
        memcpy(m->before, kept.recent, sizeof m->before);
    } else
        follow(m, &t);
    m->number++;
    look_at_state(m);
    count(m);
    return m->validity;
}
