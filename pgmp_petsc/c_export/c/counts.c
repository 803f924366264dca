/* Damage by cycles of outputs, counted by rainflow as the run goes (ASTM E1049-85, section 5.4.4), digit by digit as
   `lanes.rainflow` of pgmp_petsc does.

   written by pgmp_petsc */

#include <math.h>
#include <string.h>

#include "tables.h"

#if N_COUNTS > 0
static double damage_of(double first, double second, int n_parts, double (*curve)[3], double ultimate) {
    double amplitude = 0.5 * fabs(first - second), mean = 0.5 * (first + second);
    int part = 0;
    if (mean > 0.0) {
        if (!(mean < ultimate)) return 1.0;
        amplitude /= 1.0 - mean / ultimate;
    }
    while (part + 1 < n_parts && amplitude >= curve[part + 1][0]) part++;
    double damage = pow(amplitude / curve[part][0], curve[part][2]) / curve[part][1];
    return damage < 1.0 ? damage : 1.0;
}

static int turns_back(const double point[], int n, double value) {
    return !((value - point[n - 1]) * (point[n - 1] - point[n - 2]) >= 0.0);
}

/* Takes the next value of an output. */
static void take(struct pgmp_model *m, int number, double value, double (*curve)[3], double ultimate) {
    double *point = m->turns[number], *half = m->halves[number], *closed = m->closed + number;
    const int n_parts = counts[number].n_parts;
    int n = m->waiting[number];
    if (n == N_WAITING && turns_back(point, n, value)) { /* the smallest cycle is taken for closed */
        *closed += damage_of(point[n - 2], point[n - 1], n_parts, curve, ultimate);
        n -= 2;
        m->validity |= PGMP_UNCOUNTED;
    }
    if (isnan(value))
        *closed = NAN;
    else if (n > 1 && !turns_back(point, n, value))
        point[n - 1] = value;
    else if (n != 1 || value != point[0])
        point[n++] = value;
    while (n > 2 && fabs(point[n - 1] - point[n - 2]) >= fabs(point[n - 2] - point[n - 3])) {
        double share = n == 3 ? 0.5 : 1.0;
        *closed += share * damage_of(point[n - 3], point[n - 2], n_parts, curve, ultimate);
        if (n == 3)
            point[0] = point[1], point[1] = point[2], n = 2;
        else
            point[n - 3] = point[n - 1], n -= 2;
    }
    half[0] = 0.0;
    if (n > 1) half[n - 1] = half[n - 2] + 0.5 * damage_of(point[n - 2], point[n - 1], n_parts, curve, ultimate);
    m->waiting[number] = n;
    m->damages[number] = *closed + half[n > 1 ? n - 1 : 0];
}
#endif

void count_step(struct pgmp_model *m) {
#if N_COUNTS > 0
    double curves[N_COUNTS][MOST_PARTS][3], ultimates[N_COUNTS];
    weigh_counts(m->parameters, curves, ultimates);
    for (int k = 0; k < N_COUNTS; k++) take(m, k, m->counted[k], curves[k], ultimates[k]);
#else
    (void)m;
#endif
}

void start_counts(struct pgmp_model *m) {
    memset(m->waiting, 0, sizeof m->waiting);
    memset(m->closed, 0, sizeof m->closed);
    memset(m->damages, 0, sizeof m->damages);
}

void show_counts(struct pgmp_model *m, double time) {
#if N_COUNTS > 0
    for (int k = 0; k < N_COUNTS; k++) {
        const double damage = m->damages[k], longest = counts[k].run_out;
        double shown = damage;
        if (longest > 0.0 && !isnan(damage)) shown = damage * longest > time ? time / damage : longest;
        m->outputs[counts[k].output] = shown;
    }
#else
    (void)m, (void)time;
#endif
}
