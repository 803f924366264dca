/* What acts over time: functions in pieces, and the strengths and given motions that follow them.

   written by pgmp_petsc */

#include <math.h>

#include "tables.h"

double pgmp_time(const struct pgmp_model *m) { return STEP * m->number; }

/* A function at a time, and its two derivatives, from the piece that holds at the time `since`. */
double evaluate_piece(int function, double time, double since, double rates[2]) {
    int p = function_pieces[function];
    while (p + 1 < function_pieces[function + 1] && since >= pieces[p + 1].begin) p++;
    const struct piece *f = pieces + p;
    double s = time - f->origin, rate = f->wave[1], phase = rate * time + f->wave[2];
    double wave = f->wave[0] * sin(phase), slope = f->wave[0] * cos(phase);
    const double *c = f->cubic;
    rates[0] = c[1] + s * (2.0 * c[2] + s * (3.0 * c[3] + s * 4.0 * c[4])) + rate * slope;
    rates[1] = 2.0 * c[2] + s * (6.0 * c[3] + s * 12.0 * c[4]) - rate * rate * wave;
    return c[0] + s * (c[1] + s * (c[2] + s * (c[3] + s * c[4]))) + wave;
}

double pgmp_next_break(const struct pgmp_model *m, double time) {
    double next = 1e300;
    for (int f = 0; f < N_STRENGTHS + R; f++)
        for (int p = function_pieces[f] + 1; p < function_pieces[f + 1]; p++)
            if (pieces[p].begin > time && pieces[p].begin < next && (f >= N_STRENGTHS || m->follows_scene[f]))
                next = pieces[p].begin;
    return next;
}

void act(const struct pgmp_model *m, double time, double since, struct acting *now) {
    double rates[2];
    for (int k = 0; k < N_STRENGTHS; k++)
        now->strengths[k] = m->follows_scene[k] ? evaluate_piece(k, time, since, rates) : strength_sizes[k] * m->strengths[k];
    for (int k = 0; k < R; k++)
        if (function_pieces[N_STRENGTHS + k] < function_pieces[N_STRENGTHS + k + 1])
            now->motions[k][0] = evaluate_piece(N_STRENGTHS + k, time, since, now->motions[k] + 1);
}
