/* Local effects: a law F(t, s, s') on a statement s about two frames. With its gradient g and the frames' Jacobian J

     r -= J^T F g,     dr/d eta = J^T ((k + gain_v c) g g^T - F h) J,     k = -dF/ds,  c = -dF/ds'

   without the change of J with eta. A measure is the sum of functions of statements, each about two frames of its own.
   Of a law that is led by the effect before it k + gain_v c is with the product of its
   own g and of g there. A node's frame is that of its rigid body, moved and turned by Psi delta + 1/2 chi
   delta delta in the body's frame; rigid frames and the angles of the effects are tables over theta.

   written by pgmp_petsc */

#include <math.h>
#include <string.h>

#include "tables.h"

/* A frame, its derivatives with eta, and those with the node's displacement and rotation in the body's frame. */
struct moving { double frame[N_FRAME], jacobian[N_FRAME][N], own[N_FRAME][N_DOFS]; };

/* Displacement and rotation of a node in its body's frame, and their derivatives with eta. */
static void displace(const struct stencil *stencil, int slot, const double q[N], double moved[N_DOFS],
                     double moving[N_DOFS][N]) {
    double found[1 + R][N_FACTORS][N_DOFS] = {{{0}}};
    for (int p = 0; p < N_STENCIL; p++)
        for (int part = 0; part <= R; part++)
            for (int f = 0; f < N_FACTORS; f++)
                for (int c = 0; c < N_DOFS; c++)
                    found[part][f][c] += stencil->weights[part][p] * shapes_table[stencil->rows[p]][f][N_DOFS * slot + c];
    memset(moving, 0, N_DOFS * N * sizeof(double));
    for (int c = 0; c < N_DOFS; c++) {
        moved[c] = 0.0;
        for (int i = 0, pair = M; i < M; i++) {
            moved[c] += found[0][i][c] * q[R + i]; /* Psi_i delta_i */
            moving[c][R + i] += found[0][i][c];
            for (int k = 0; k < R; k++) moving[c][k] += found[1 + k][i][c] * q[R + i];
            for (int j = 0; SECOND_ORDER && j <= i; j++, pair++) { /* 1/2 chi_ij delta_i delta_j */
                double half = i == j ? 0.5 : 1.0, both = half * q[R + i] * q[R + j];
                moved[c] += found[0][pair][c] * both;
                moving[c][R + i] += half * found[0][pair][c] * q[R + j];
                moving[c][R + j] += half * found[0][pair][c] * q[R + i];
                for (int k = 0; k < R; k++) moving[c][k] += found[1 + k][pair][c] * both;
            }
        }
    }
}

#if D == 2
/* The rotation, and the change of its directors with a rate of the angle. */
static void rotate(const double *angle, double turn[D][D]) {
    turn[0][0] = turn[1][1] = cos(*angle);
    turn[1][0] = sin(*angle), turn[0][1] = -turn[1][0];
}

static void spin_frame(const double *angle, const double rate[1], const double frame[N_FRAME], double change[N_FRAME]) {
    (void)angle;
    for (int c = 0; c < D; c++) change[2 + c] = rate[0] * frame[4 + c], change[4 + c] = -rate[0] * frame[2 + c];
}
#else
/* sin(t) / t, (1 - cos(t)) / t^2 and (t - sin(t)) / t^3 of a rotation vector's length t. */
static void factors_of(const double phi[3], double f[3]) {
    double s = phi[0] * phi[0] + phi[1] * phi[1] + phi[2] * phi[2], t = sqrt(s);
    f[0] = 1.0 - s / 6.0 * (1.0 - s / 20.0 * (1.0 - s / 42.0 * (1.0 - s / 72.0)));
    f[1] = 0.5 * (1.0 - s / 12.0 * (1.0 - s / 30.0 * (1.0 - s / 56.0 * (1.0 - s / 90.0))));
    f[2] = (1.0 - s / 20.0 * (1.0 - s / 42.0 * (1.0 - s / 72.0 * (1.0 - s / 110.0)))) / 6.0;
    if (s > 1e-2) f[0] = sin(t) / t, f[1] = (1.0 - cos(t)) / s, f[2] = (t - sin(t)) / (t * s);
}

static void rotate(const double phi[3], double turn[D][D]) {
    double x = phi[0], y = phi[1], z = phi[2], f[3];
    factors_of(phi, f);
    double a = f[0], b = f[1];
    turn[0][0] = 1.0 - b * (y * y + z * z), turn[0][1] = b * x * y - a * z, turn[0][2] = b * x * z + a * y;
    turn[1][0] = b * x * y + a * z, turn[1][1] = 1.0 - b * (x * x + z * z), turn[1][2] = b * y * z - a * x;
    turn[2][0] = b * x * z - a * y, turn[2][1] = b * y * z + a * x, turn[2][2] = 1.0 - b * (x * x + y * y);
}

/* spin = (1 - b P + c P^2) phi', P = phi x, in the turned frame; directors change by spin x d_k. */
static void spin_frame(const double phi[3], const double rate[3], const double frame[N_FRAME], double change[N_FRAME]) {
    double x = phi[0], y = phi[1], z = phi[2], f[3], spin[3];
    factors_of(phi, f);
    double b = f[1], c = f[2];
    double e = y * rate[2] - z * rate[1], g = z * rate[0] - x * rate[2], h = x * rate[1] - y * rate[0];
    spin[0] = rate[0] - b * e + c * (y * h - z * g);
    spin[1] = rate[1] - b * g + c * (z * e - x * h);
    spin[2] = rate[2] - b * h + c * (x * g - y * e);
    for (int k = 0; k < D; k++) {
        int after = (k + 1) % 3, before = (k + 2) % 3;
        for (int i = 0; i < D; i++)
            change[3 + 3 * k + i] = spin[before] * frame[3 + 3 * after + i] - spin[after] * frame[3 + 3 * before + i];
    }
}
#endif

/* The frame of a point of a body with a frame, moved and turned in the body's own frame. */
void turn_frame(const double rigid[N_FRAME], const double moved[N_DOFS], const double point[D], struct frame *frame) {
    double turn[D][D];
    rotate(moved + D, turn);
    for (int c = 0; c < D; c++) {
        frame->z[c] = rigid[c];
        for (int j = 0; j < D; j++) {
            frame->z[c] += (point[j] + moved[j]) * rigid[D + D * j + c];
            double total = 0.0;
            for (int k = 0; k < D; k++) total += turn[k][j] * rigid[D + D * k + c];
            frame->z[D + D * j + c] = total;
        }
    }
}

/* The frame of a node and its derivatives with eta, of the rigid one there (rigid, slopes with theta). */
static void place_node(const struct stencil *stencil, int slot, const double q[N], const double rigid[N_FRAME],
                       const double *slopes[R], struct moving *node) {
    static const double origin[D];
    double moved[N_DOFS], moving[N_DOFS][N], turn[D][D], rate[N_DOFS - D];
    struct frame frame;
    displace(stencil, slot, q, moved, moving);
    turn_frame(rigid, moved, origin, &frame);
    memcpy(node->frame, frame.z, sizeof frame.z);
    rotate(moved + D, turn);
    for (int i = 0; i < N; i++) {
        double change[N_FRAME] = {0};
        for (int c = 0; c < N_DOFS - D; c++) rate[c] = moving[D + c][i];
        spin_frame(moved + D, rate, node->frame, change);
        for (int c = 0; c < D; c++)
            for (int j = 0; j < D; j++) change[c] += moving[j][i] * rigid[D + D * j + c]; /* u_j' D_j */
        for (int c = 0; i < R && c < D; c++) {
            const double *slope = slopes[i];
            change[c] += slope[c]; /* z' + u_j D_j' */
            for (int j = 0; j < D; j++) {
                change[c] += moved[j] * slope[D + D * j + c];
                for (int k = 0; k < D; k++) change[D + D * j + c] += turn[k][j] * slope[D + D * k + c];
            }
        }
        for (int c = 0; c < N_FRAME; c++) node->jacobian[c][i] = change[c];
    }
    for (int i = 0; N_GAPS && i < N_DOFS; i++) {
        double change[N_FRAME] = {0};
        for (int c = 0; c < N_DOFS - D; c++) rate[c] = c == i - D;
        spin_frame(moved + D, rate, node->frame, change);
        for (int c = 0; c < D && i < D; c++) change[c] = rigid[D + D * i + c];
        for (int c = 0; c < N_FRAME; c++) node->own[c][i] = change[c];
    }
}

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
static double add_part(const struct part *part, const struct moving nodes[], double turned, const double q[N],
                       double projected[N], double (*bent)[N]) {
    double z[2 * N_FRAME], jacobian[2 * N_FRAME][N], gradient[2 * N_FRAME], hessian[2 * N_FRAME][2 * N_FRAME];
    double slope, bend, own[N] = {0};
    for (int k = 0; k < R; k++) turned += part->winding[k] * q[k];
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
static void load_part(const struct part *part, const struct moving nodes[], double turned, const double q[N], double force,
                      double loads[][N_DOFS]) {
    double z[2 * N_FRAME], jacobian[2 * N_FRAME][N], gradient[2 * N_FRAME], slope, bend;
    for (int k = 0; k < R; k++) turned += part->winding[k] * q[k];
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

/* A force that turns with its body has no symmetric tangent; its mean serves the symmetric flexible block. */
static void add_to_matrix(double tangent[N][N], struct matrix *m) {
    for (int i = 0; i < M; i++)
        for (int j = 0; j <= i; j++) m->factor[PACKED(i) + j] += 0.5 * (tangent[R + i][R + j] + tangent[R + j][R + i]);
    for (int k = 0; k < R; k++) {
        for (int i = 0; i < M; i++) m->column[k][i] += tangent[R + i][k], m->row[k][i] += tangent[k][R + i];
        for (int j = 0; j < R; j++) m->corner[k][j] += tangent[k][j];
    }
}

/* Forces and slopes of controllers, at the motions that their actions measure or the ones before these, which lead. */
static void give_forces(const struct pgmp_model *m, const struct moving nodes[], const double turned[],
                        const double q[N], const double v[N], struct response *response, double given[][3]) {
    double motions[AT_LEAST_ONE(N_CONTROL_ROWS)][2] = {{0}};
    for (int row = 0; response && row < N_CONTROL_ROWS; row++) {
        const struct action *action = actions + control_actions[row];
        double projected[N] = {0};
        if (action->role == LED) action--;
        for (int part = action->first; part < action->last; part++)
            motions[row][0] += add_part(action_parts + part, nodes, turned[part], q, projected, 0);
        motions[row][0] -= control_origins[row];
        for (int i = 0; i < N; i++) motions[row][1] += projected[i] * v[i];
    }
    respond(m, motions, response, given);
}

void add_actions(const struct pgmp_model *m, const struct stencil *stencil, const double strengths[],
                 const double q[N], const double v[N], double gain_v, int fresh, struct iterate kept[], double depths[],
                 struct response *response, double r[N], struct matrix *matrix, double forces[],
                 double loads[][N_DOFS]) {
    double given[AT_LEAST_ONE(N_ACTIONS)][3] = {{0}};
    double rigid[1 + R][AT_LEAST_ONE(N_ACTION_ENTRIES)] = {{0}}, tangent[N][N] = {{0}};
    double leading[N] = {0}, place = 0.0, speed = 0.0; /* of the effect whose measure a law is of */
    struct moving nodes[AT_LEAST_ONE(N_ACTION_NODES)];
    struct stencil fine;
    if (N_ACTIONS == 0) return;
    find_stencil(fine_axes, q, &fine);
    add_rows(&fine, 1 + R, N_ACTION_ENTRIES, &actions_table[0][0], &rigid[0][0]);
    for (int node = 0; node < N_ACTION_NODES; node++) {
        const double *slopes[R];
        for (int k = 0; k < R; k++) slopes[k] = rigid[1 + k] + N_FRAME * node;
        place_node(stencil, action_nodes[node], q, rigid[0] + N_FRAME * node, slopes, nodes + node);
    }
    give_forces(m, nodes, rigid[0] + N_FRAME * N_ACTION_NODES, q, v, response, given);
    for (int number = 0; number < N_ACTIONS; number++) {
        const struct action *action = actions + number;
        double s = 0.0, rate = 0.0, projected[N] = {0}, bent[N][N] = {{0}}, found[LAW_END + MOST_EDGES];
        for (int part = action->first; part < action->last; part++)
            s += add_part(action_parts + part, nodes, rigid[0][N_FRAME * N_ACTION_NODES + part], q, projected,
                          fresh ? bent : 0);
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
        if (kept && fresh && action->rubs) {
            struct iterate *at = kept + number;
            memcpy(at->along, action->role == LED ? leading : projected, sizeof projected);
            at->s = place, at->rate = own, at->amplitude = amplitude;
            at->force = found[LAW_FORCE], at->damping = found[LAW_DAMPING];
        }
        for (int e = 0; depths && e < action->n_edges; e++) depths[action->edge + e] = found[LAW_END + e];
        for (int i = 0; i < N; i++) r[i] -= found[LAW_FORCE] * projected[i];
        if (forces) forces[number] = found[LAW_FORCE];
        for (int part = action->first; loads && part < action->last; part++)
            load_part(action_parts + part, nodes, rigid[0][N_FRAME * N_ACTION_NODES + part], q, found[LAW_FORCE], loads);
        const double *damped = action->role == BY_LOAD ? projected : leading;
        for (int i = 0; fresh && i < N; i++)
            for (int j = 0; j < N; j++)
                tangent[i][j] += projected[i] * (found[LAW_STIFFNESS] * leading[j] +
                                                 gain_v * found[LAW_DAMPING] * damped[j]) -
                                 found[LAW_FORCE] * bent[i][j];
    }
    if (fresh) add_to_matrix(tangent, matrix);
}

/* Whether the law of a friction is not linear from where it was evaluated last to the rates v. */
int bends(const struct pgmp_model *m, const struct iterate kept[], const double v[N]) {
    for (int number = 0; number < N_ACTIONS; number++) {
        const struct iterate *at = kept + number;
        double rate = 0.0, found[LAW_END + MOST_EDGES];
        if (!actions[number].rubs) continue;
        for (int i = 0; i < N; i++) rate += at->along[i] * v[i];
        actions[number].law(m->laws[number], at->amplitude, at->s, rate, NAN, found);
        double off = fabs(found[LAW_FORCE] - at->force + at->damping * (rate - at->rate));
        if (!(off <= UNBALANCED * (fabs(found[LAW_FORCE]) + fabs(at->force)))) return 1;
    }
    return 0;
}
