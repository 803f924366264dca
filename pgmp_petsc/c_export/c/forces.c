/* Forces and moments in joints, and what prescribed motions take.

   The multiplier of a constraint is minus the row of a vector that opens it: a sum of products of tables and of their
   derivatives with theta (gap_table, gap_changes) with factors of the state, which are the same for all (in pgmp_petsc:
   reduced/gap_forces.py), and with what local effects do to the nodes that they hold at. What a joint does follows from
   the gradients of its statements, with minus the force of its law where it gives way; what a motion takes is the
   residual of its coordinate.

   written by pgmp_petsc */

#include <math.h>
#include <string.h>

#include "tables.h"

#define N_ALONG (M + (GAPS_CURVED ? R * M : 0))

#if N_GAPS > 0
/* Factors of a kind of terms, times the weight of each of them, one after the other. */
static double *weigh_factors(const double *entries, int n, const double *weights, int n_terms, double *found) {
    for (int t = 0; t < n_terms; t++)
        for (int e = 0; e < n; e++) *found++ = weights[t] * entries[e];
    return found;
}

static void find_multipliers(const struct pgmp_model *m, const double strengths[], double loads[][N_DOFS],
                             double multipliers[]) {
    double weights[AT_LEAST_ONE(N_GAP_TERMS)], factors[AT_LEAST_ONE(N_GAP_ENTRIES)];
    double slopes[R][AT_LEAST_ONE(N_GAP_CHANGES)], inert[N + PACKED(R) * (1 + M) + 2 * R * M], stiff[M + PACKED(M)];
    double worked[1 + M], changed[R][M + R * M], v[N];
    const double *d = m->q + R, *own = weights;
    int swing = N + PACKED(R), bent = M;
    struct stencil stencil;
    weigh_gaps(m->parameters, weights);
    for (int t = 0; t < N_LOAD_TERMS; t++)
        weights[GAP_MASS + GAP_STIFFNESS + t] *= strengths[strength_of_load[load_of_term[t]]];
    for (int i = 0; i < N; i++) v[i] = QUADRATIC ? m->v[i] : 0.0, inert[i] = m->a[i] + MASS_DAMPING * m->v[i];
    for (int k = 0, pair = N; k < R; k++) {
        for (int i = 0; i < M; i++) changed[k][i] = v[k] * v[R + i] + 0.5 * inert[k] * d[i];
        for (int j = 0; j <= k; j++, pair++) {
            inert[pair] = (j == k ? 1.0 : 2.0) * v[k] * v[j];
            for (int i = 0; i < M; i++) inert[swing++] = inert[pair] * d[i];
        }
    }
    for (int h = 0; h < R; h++)
        for (int i = 0; i < M; i++) {
            inert[swing++] = -2.0 * v[h] * v[R + i] - inert[h] * d[i];
            for (int k = 0; k < R; k++) changed[k][M + h * M + i] = -v[k] * v[h] * d[i];
        }
    for (int h = 0; h < GAPS_DRIVEN; h++)
        for (int i = 0; i < M; i++) inert[swing++] = inert[h] * d[i];
    worked[0] = -1.0;
    for (int i = 0; i < M; i++) {
        stiff[i] = d[i], worked[1 + i] = -d[i];
        for (int j = 0; j <= i; j++) stiff[bent++] = (i == j ? 0.5 : 1.0) * d[i] * d[j];
    }
    double *into = weigh_factors(inert, GAPS_CURVED ? swing : N + PACKED(R), own, GAP_MASS, factors);
    into = weigh_factors(stiff, GAPS_CURVED ? bent : M, own += GAP_MASS, GAP_STIFFNESS, into);
    into = weigh_factors(worked, GAPS_CURVED ? 1 + M : 1, own += GAP_STIFFNESS, N_LOAD_TERMS, into);
    into = weigh_factors(m->v, N, own + N_LOAD_TERMS, GAP_DAMPING, into);
    for (int node = 0; node < N_ACTION_NODES; node++)
        for (int f = 0; f < N_DOFS; f++) {
            *into++ = -loads[node][f];
            for (int i = 0; GAPS_CURVED && i < M; i++) *into++ = -loads[node][f] * d[i];
        }
    for (int k = 0; k < R; k++) weigh_factors(changed[k], N_ALONG, weights, GAP_MASS, slopes[k]);
    find_stencil(axes, m->q, &stencil);
    for (int g = 0; g < N_GAPS; g++) {
        multipliers[g] = 0.0;
        for (int p = 0; p < N_STENCIL; p++) {
            int row = stencil.rows[p];
            for (int e = 0; e < N_GAP_ENTRIES; e++)
                multipliers[g] -= stencil.weights[0][p] * factors[e] * gap_table[row][g][e];
            for (int k = 0; k < R; k++)
                for (int e = 0; e < N_GAP_CHANGES; e++)
                    multipliers[g] -= stencil.weights[1 + k][p] * slopes[k][e] * gap_changes[row][g][e];
        }
    }
}

#endif

void find_forces(struct pgmp_model *m, const struct acting *now, const double *own, const struct frame nodes[],
                 double found[][3]) {
    const double *strengths = now->strengths;
    double multipliers[AT_LEAST_ONE(N_GAPS + N_ACTIONS)], r[N] = {0}, forces_of[AT_LEAST_ONE(N_ACTIONS)] = {0};
    double loads[AT_LEAST_ONE(N_ACTION_NODES)][N_DOFS] = {{0}};
    struct stencil stencil;
    struct terms t;
    struct matrix matrix;
    (void)own;
    find_stencil(axes, m->q, &stencil);
    if (DRIVES) { /* what motions take is the residual of their coordinates */
        interpolate(m, &stencil, m->q, strengths, &t);
        evaluate_lagrangian(&t, m->q, m->v, m->a, 0.0, 0.0, 0, r, &matrix);
    }
    add_actions(m, strengths, m->q, m->v, 0.0, 0, 0, 0, 0, r, &matrix, forces_of, N_GAPS ? loads : 0);
#if N_GAPS > 0
    find_multipliers(m, strengths, loads, multipliers);
#endif
    for (int k = 0; k < N_ACTIONS; k++) multipliers[N_GAPS + k] = -forces_of[k];
    for (int k = 0; k < N_FORCES; k++) found[k][0] = read_force(forces + k, nodes, multipliers);
    for (int k = 0; k < R; k++) found[N_FORCES + k][0] = r[k];
}
