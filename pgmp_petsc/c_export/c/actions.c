/* Local effects: a law F(t, s, s') on a statement s about two frames. With its gradient g and the frames' Jacobian J

     r -= J^T F g,     dr/d eta = J^T ((k + gain_v c) g g^T - F h) J,     k = -dF/ds,  c = -dF/ds'

   with the coordinates eta of the model, without the change of J with them. A measure is the sum of functions of
   statements, each about two frames of its own. Of a law that is led by the effect before it k + gain_v c is with the
   product of its own g and of g there. A matrix that is SYMMETRIC, as that of component models is in the program, has
   nothing of these products, and h of splines alone.

   written by pgmp_petsc */

#include <math.h>
#include <string.h>

#include "tables.h"

/* Both frames of a part, and their Jacobian; a point at an arm moves with the directors. */
static void attach_pair(const struct part *part, const struct moving nodes[], double z[2 * N_FRAME],
                        double jacobian[2 * N_FRAME][N]) {
    memset(jacobian, 0, 2 * N_FRAME * N * sizeof(double));
    for (int end = 0; end < 2; end++) {
        const struct side *side = end ? &part->term.statement.b : &part->term.statement.a;
        int node = end ? part->b : part->a, first = end * N_FRAME;
        if (node < 0) {
            for (int c = 0; c < N_FRAME; c++)
                z[first + c] = c < D ? side->point[c] : (c - D) % (D + 1) == 0; /* directors are those of the ground */
            continue;
        }
        memcpy(z + first, nodes[node].frame, sizeof nodes[node].frame);
        memcpy(jacobian + first, nodes[node].jacobian, sizeof nodes[node].jacobian);
        for (int j = 0; j < D; j++)
            for (int c = 0; c < D; c++) {
                z[first + c] += side->arm[j] * z[first + D + D * j + c];
                for (int i = 0; i < N; i++)
                    jacobian[first + c][i] += side->arm[j] * jacobian[first + D + D * j + c][i];
            }
    }
}

/* Value of a part; its derivative is added to those of the measure, its second ones to `bent`, where that is wanted. */
static double add_part(const struct part *part, const struct moving nodes[], double turned, double projected[N],
                       double (*bent)[N]) {
    double z[2 * N_FRAME], jacobian[2 * N_FRAME][N], gradient[2 * N_FRAME], hessian[2 * N_FRAME][2 * N_FRAME];
    double slope, bend, own[N] = {0};
    attach_pair(part, nodes, z, jacobian);
    double s = evaluate_statement(&part->term.statement, z, turned, gradient, bent ? hessian : 0);
    double value = of_term(&part->term, s, &slope, &bend);
    for (int i = 0; i < N; i++) {
        for (int c = 0; c < 2 * N_FRAME; c++) own[i] += gradient[c] * jacobian[c][i];
        projected[i] += slope * own[i];
    }
    if (!bent) return value;
    for (int i = 0; i < N; i++)
        for (int j = 0; j < N; j++) bent[i][j] += bend * own[i] * own[j];
    for (int c = 0; c < 2 * N_FRAME; c++)
        for (int d = 0; d < 2 * N_FRAME; d++) {
            double by = slope * hessian[c][d];
            if (by == 0.0) continue; /* few are not */
            for (int i = 0; i < N; i++)
                for (int j = 0; j < N; j++) bent[i][j] += by * jacobian[c][i] * jacobian[d][j];
        }
    return value;
}

/* What a force on a part does to displacements and rotations of its nodes in body frames. */
static void load_part(const struct part *part, const struct moving nodes[], double turned, double force,
                      double loads[][N_DOFS]) {
    double z[2 * N_FRAME], jacobian[2 * N_FRAME][N], gradient[2 * N_FRAME], slope, bend;
    attach_pair(part, nodes, z, jacobian);
    of_term(&part->term, evaluate_statement(&part->term.statement, z, turned, gradient, 0), &slope, &bend);
    for (int end = 0; end < 2; end++) {
        const double *arm = end ? part->term.statement.b.arm : part->term.statement.a.arm, *g = gradient + end * N_FRAME;
        int node = end ? part->b : part->a;
        for (int c = 0; node >= 0 && c < N_FRAME; c++) {
            double pull = c < D ? g[c] : g[c] + arm[c / D - 1] * g[c % D];
            for (int i = 0; i < N_DOFS; i++) loads[node][i] += force * slope * pull * nodes[node].own[c][i];
        }
    }
}

/* Forces and slopes of controllers, at the motions that their actions measure or the ones before these, which lead. */
static void give_forces(const struct pgmp_model *m, const struct moving nodes[], const double turned[],
                        const double v[N], struct response *response, double given[][3]) {
    double motions[AT_LEAST_ONE(N_CONTROL_ROWS)][2] = {{0}};
    for (int row = 0; response && row < N_CONTROL_ROWS; row++) {
        const struct action *action = actions + control_actions[row];
        double projected[N] = {0};
        if (action->role == LED) action--;
        for (int part = action->first; part < action->last; part++)
            motions[row][0] += add_part(action_parts + part, nodes, turned[part], projected, 0);
        motions[row][0] -= control_origins[row];
        for (int i = 0; i < N; i++) motions[row][1] += projected[i] * v[i];
    }
    respond(m, motions, response, given);
}

void add_actions(const struct pgmp_model *m, const double strengths[], const double q[N], const double v[N],
                 double gain_v, int fresh, struct iterate kept[], double depths[], struct response *response,
                 double r[N], struct matrix *matrix, double forces[], double loads[][N_DOFS]) {
    double given[AT_LEAST_ONE(N_ACTIONS)][3] = {{0}}, turned[AT_LEAST_ONE(N_PARTS)], tangent[N][N] = {{0}};
    double leading[N] = {0}, place = 0.0, speed = 0.0; /* of the effect whose measure a law is of */
    struct moving nodes[AT_LEAST_ONE(N_ACTION_NODES)];
    if (N_ACTIONS == 0) return;
    place_holders(m, q, nodes, turned);
    give_forces(m, nodes, turned, v, response, given);
    for (int number = 0; number < N_ACTIONS; number++) {
        const struct action *action = actions + number;
        double s = 0.0, rate = 0.0, projected[N] = {0}, bent[N][N] = {{0}}, found[LAW_END + MOST_EDGES];
        int curved = !SYMMETRIC;
        for (int part = action->first; part < action->last; part++) curved |= action_parts[part].term.n_pieces > 0;
        for (int part = action->first; part < action->last; part++)
            s += add_part(action_parts + part, nodes, turned[part], projected, fresh && curved ? bent : 0);
        for (int i = 0; i < N; i++) rate += projected[i] * v[i];
        if (action->role != LED && action->role != BY_LOAD) {
            place = s, speed = rate;
            memcpy(leading, projected, sizeof leading);
        }
        if (action->role == LEADS) {
            if (kept) kept[number].about = rate;
            continue;
        }
        double strength = action->strength < 0 ? 0.0 : strengths[action->strength];
        double amplitude = action->role == BY_LOAD ? speed : strength, own = action->role == BY_LOAD ? rate : speed;
        action->law(action->controlled ? given[number] : m->laws[number], amplitude, place, own,
                    kept && fresh ? kept[number].about : NAN, found);
        if (kept) kept[number].about = found[LAW_ABOUT];
        if (kept && fresh && action->bends) {
            struct iterate *at = kept + number;
            memcpy(at->along, action->role == LED ? leading : projected, sizeof projected);
            at->s = place, at->rate = own, at->amplitude = amplitude;
            at->force = found[LAW_FORCE], at->stiffness = found[LAW_STIFFNESS], at->damping = found[LAW_DAMPING];
        }
        for (int e = 0; depths && e < action->n_edges; e++) depths[action->edge + e] = found[LAW_END + e];
        for (int i = 0; i < N; i++) r[i] -= found[LAW_FORCE] * projected[i];
        if (forces) forces[number] = found[LAW_FORCE];
        for (int part = action->first; loads && part < action->last; part++)
            load_part(action_parts + part, nodes, turned[part], found[LAW_FORCE], loads);
        const double *damped = action->role == BY_LOAD ? projected : leading;
        double stiffness = found[LAW_STIFFNESS], damping = gain_v * found[LAW_DAMPING];
        if (SYMMETRIC && action->role != ALONE) stiffness = 0.0;
        if (SYMMETRIC && action->role == LED) damping = 0.0;
        for (int i = 0; fresh && i < N; i++)
            for (int j = 0; j < N; j++)
                tangent[i][j] += projected[i] * (stiffness * leading[j] + damping * damped[j]) - found[LAW_FORCE] * bent[i][j];
    }
    if (fresh) add_tangent(tangent, matrix);
}

/* Whether a law is not linear from where it was evaluated last to the rates v, which change by gain_v with places. */
int bends(const struct pgmp_model *m, const struct iterate kept[], const double v[N], double gain_v) {
    for (int number = 0; number < N_ACTIONS; number++) {
        const struct iterate *at = kept + number;
        double rate = 0.0, found[LAW_END + MOST_EDGES];
        if (!actions[number].bends) continue;
        for (int i = 0; i < N; i++) rate += at->along[i] * v[i];
        double way = actions[number].role == BY_LOAD ? 0.0 : (rate - at->rate) / gain_v;
        actions[number].law(m->laws[number], at->amplitude, at->s + way, rate, NAN, found);
        double off = fabs(found[LAW_FORCE] - at->force + at->stiffness * way + at->damping * (rate - at->rate));
        if (!(off <= UNBALANCED * (fabs(found[LAW_FORCE]) + fabs(at->force)))) return 1;
    }
    return 0;
}

/* How far every edge of a law is crossed in a state, negative where it is not. */
void find_depths(const struct pgmp_model *m, const double q[N], double depths[]) {
    static const double none[AT_LEAST_ONE(N_STRENGTHS)];
    double at_rest[N] = {0}, r[N] = {0};
    if (N_EDGES == 0) return;
    add_actions(m, none, q, at_rest, 0.0, 0, 0, depths, 0, r, 0, 0, 0);
}

/* Lets controllers respond to a state. */
void look_at_motions(const struct pgmp_model *m, const double q[N], const double v[N], struct response *at) {
    static const double none[AT_LEAST_ONE(N_STRENGTHS)];
    double r[N] = {0};
    forget_iterates(at);
    add_actions(m, none, q, v, 0.0, 0, 0, 0, at, r, 0, 0, 0);
}

/* What controllers put on their joints from now on: those whose time it is are sampled when the next step begins. */
void find_held(const struct pgmp_model *m, double found[][3]) {
    struct response now;
    int jumping = jumps(m);
    if (jumping) begin_sampling(m, DUE, pgmp_time(m), &now), look_at_motions(m, m->q, m->v, &now);
    for (int k = 0; k < N_CONTROLS; k++) {
        int every = controls[k].every, due = jumping && every > 0 && m->number % every == 0;
        found[k][0] = due ? now.forces[k] : m->beside[controls[k].column + 3 * controls[k].n_states];
    }
}
