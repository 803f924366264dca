/* Forces in joints of a tree, and what prescribed motions take.

   At the accelerations with which constraints are obeyed, a joint puts on the body that it moves what all forces on the
   frames of that body and of those that it carries are together, inertia included, the other way: a force f and a moment
   about its node. Of what it holds, S lambda = -f, multipliers follow; those of constraints that the tree leaves are solved
   for with the accelerations.

   written by pgmp_petsc */

#include <math.h>
#include <string.h>

#include "tables.h"

/* Adds a force on a frame as a force and a moment about a place. */
static void add_wrench(const double z[N_FRAME], const double force[N_FRAME], const double about[D], double into[N_DOFS]) {
    for (int k = 0; k <= D; k++) {
        const double *f = force + D * k;
        double arm[D];
        for (int c = 0; c < D; c++) arm[c] = k ? z[D * k + c] : z[c] - about[c], into[c] += k ? 0.0 : f[c];
        for (int turn = D; turn < N_DOFS; turn++) {
            const int one = D == 2 ? 0 : (turn + 1) % 3, other = D == 2 ? 1 : (turn + 2) % 3;
            into[turn] += arm[one] * f[other] - arm[other] * f[one];
        }
    }
}

/* What a statement does to the frame that a joint holds. */
static void hold_frame(const struct hold *h, const struct chain nodes[N_NODES], double into[N_DOFS]) {
    const struct statement *s = &constraints[h->term].statement;
    const struct side *side[2] = {&s->a, &s->b};
    double z[2 * N_FRAME], gradient[2 * N_FRAME];
    const int end = side[1]->slot == tree[h->body].held;
    for (int k = 0; k < 2; k++) attach_column(side[k], nodes, AT, z + k * N_FRAME);
    evaluate_statement(s, z, 0.0, gradient, 0);
    add_wrench(z + end * N_FRAME, gradient + end * N_FRAME, nodes[tree[h->body].held].z[AT], into);
}

/* Solves the normal equations of S^T lambda = -f for n rows, by elimination. */
static void share_out(int n, double s[N_DOFS][N_DOFS], const double f[N_DOFS], double found[N_DOFS]) {
    double a[N_DOFS][N_DOFS] = {{0}};
    for (int i = 0; i < n; i++) {
        found[i] = 0.0;
        for (int c = 0; c < N_DOFS; c++) {
            found[i] -= s[i][c] * f[c];
            for (int j = 0; j < n; j++) a[i][j] += s[i][c] * s[j][c];
        }
    }
    for (int k = 0; k < n; k++)
        for (int i = k + 1; i < n; i++) {
            double factor = a[i][k] / a[k][k];
            for (int j = k; j < n; j++) a[i][j] -= factor * a[k][j];
            found[i] -= factor * found[k];
        }
    for (int i = n - 1; i >= 0; i--) {
        for (int j = i + 1; j < n; j++) found[i] -= a[i][j] * found[j];
        found[i] /= a[i][i];
    }
}

void find_forces(struct pgmp_model *m, const struct acting *now, const double *own, const struct frame nodes[],
                 double found[][3]) {
    double r[N_ALL], on_frames[N_NODES][N_FRAME], left[AT_LEAST_ONE(N_LEFT)], multipliers[AT_LEAST_ONE(N_GAPS + N_ACTIONS)];
    double unused[N] = {0}, of_actions[AT_LEAST_ONE(N_ACTIONS)] = {0}, loads[AT_LEAST_ONE(N_ACTION_NODES)][N_DOFS] = {{0}};
    struct chain chains[N_NODES];
    find_residual(m, now, own, chains, on_frames, left, r);
    add_actions(m, now->strengths, m->q, m->v, 0.0, 0, 0, 0, 0, unused, 0, of_actions, loads);
    for (int g = 0; g < N_GAPS; g++) multipliers[g] = left_of_gap[g] < 0 ? 0.0 : left[left_of_gap[g]];
    for (int k = 0; k < (N_GAPS ? N_TREE : 0); k++) {
        const double *about = chains[tree[k].held].z[AT];
        double wrench[N_DOFS] = {0}, slopes[N_DOFS][N_DOFS] = {{0}}, shares[N_DOFS];
        int n = 0, read[N_DOFS];
        for (int i = 0; i < N_NODES; i++)
            if (owners[i] >= k && owners[i] < behind[k]) add_wrench(chains[i].z[AT], on_frames[i], about, wrench);
        for (int i = 0; i < N_ACTION_NODES; i++) {
            double frame[N_FRAME] = {0};
            if (owners[action_nodes[i]] < k || owners[action_nodes[i]] >= behind[k]) continue;
            for (int c = 0; c < D; c++) frame[c] = -loads[i][c];
            for (int turn = D; turn < N_DOFS; turn++) wrench[turn] -= loads[i][turn];
            add_wrench(chains[action_nodes[i]].z[AT], frame, about, wrench);
        }
        for (const struct hold *h = holds; h < holds + N_HOLDS; h++)
            if (h->body == k) hold_frame(h, chains, slopes[n]), read[n++] = h->gap;
        share_out(n, slopes, wrench, shares);
        for (int i = 0; i < n; i++)
            if (read[i] >= 0) multipliers[read[i]] = shares[i];
    }
    for (int k = 0; k < N_ACTIONS; k++) multipliers[N_GAPS + k] = -of_actions[k];
    for (int k = 0; k < N_FORCES; k++) found[k][0] = read_force(forces + k, nodes, multipliers);
    for (const struct drive *d = drives; d < drives + N_DRIVES; d++) found[N_FORCES + d->measured][0] = d->sign * r[d->coordinate];
    for (int row = 0; row < N_LEFT; row++)
        if (bonds[row].motion >= 0) found[N_FORCES + bonds[row].motion][0] = -left[row];
}
