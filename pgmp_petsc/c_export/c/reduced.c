/* What a reduced model is made of: its tables, its Newton correction, nodes on a rigid mechanism, and what is seen of them.

   A node's frame is that of its rigid body, moved and turned by Psi delta + 1/2 chi delta delta in the body's frame; rigid
   frames and the angles of the effects are tables over theta. Poses come from the table of the assembly branch: of one
   coordinate its quintic Hermite polynomials close the loops to the last digit; where they do not, and of several
   coordinates, CLOSURES steps of Newton's method lead from there to the poses at the given coordinates.

   written by pgmp_petsc */

#include <math.h>
#include <string.h>

#include "tables.h"

#define LARGE 1e30 /* gain that makes stiffness negligible beside mass */

void weigh_tables(struct pgmp_model *m) {
    double of_terms[N_TERMS], of_loads[AT_LEAST_ONE(N_LOAD_TERMS)];
    struct own *own = &m->own;
    weigh(m->parameters, of_terms, of_loads, m->laws, m->q + (N - N_GIVEN), m->controls);
    memset(own, 0, sizeof *own);
    own->rigid_cell = -1;
    for (int t = 0; t < N_TERMS; t++) {
        for (int k = 0; k < RIGID_ROWS; k++)
            for (int e = 0; e < PACKED(R); e++) own->rigid_rows[k][e] += of_terms[t] * rigid_table[k][t][e];
        for (int k = 0; k < N_ROWS; k++)
            for (int e = 0; e < END; e++) own->terms[k][e] += of_terms[t] * terms_table[k][t][e];
    }
    for (int t = 0; t < N_LOAD_TERMS; t++)
        for (int k = 0; k < N_ROWS; k++)
            for (int e = 0; e < LOAD_END; e++) own->loads[load_of_term[t]][k][e] += of_loads[t] * loads_table[t][k][e];
}

void follow_motions(const struct acting *now, double q[N], double v[N], double a[N]) {
    for (int k = 0; k < R; k++)
        if (pgmp_prescribed[k]) q[k] = now->motions[k][0], v[k] = now->motions[k][1], a[k] = now->motions[k][2];
}

void correct(struct pgmp_model *m, const struct acting *now, const double q[N], const double v[N], const double a[N],
             const double forces[], double gain_v, double gain_a, int fresh, struct iterate kept[],
             struct response *response, struct matrix *matrix, double r[N]) {
    struct stencil stencil;
    struct terms t;
    (void)forces; /* there are no multipliers */
    find_stencil(axes, q, &stencil);
    interpolate(m, &stencil, q, now->strengths, &t);
    evaluate_lagrangian(&t, q, v, a, gain_v, gain_a, fresh, r, matrix);
    add_actions(m, now->strengths, q, v, gain_v, fresh, kept, 0, response, r, matrix, 0, 0);
    if (fresh) eliminate(matrix);
    solve(matrix, r);
}

void find_accelerations(struct pgmp_model *m, const struct acting *now) {
    double r[N], at_rest[N] = {0};
    struct matrix matrix;
    follow_motions(now, m->q, m->v, at_rest);
    correct(m, now, m->q, m->v, at_rest, 0, 0.0, LARGE, 1, 0, 0, &matrix, r);
    for (int i = 0; i < N; i++) m->a[i] = at_rest[i] - LARGE * r[i];
}

/* What flexible coordinates add to the static answer to joints that are off: at rest, theta held, without loads. */
static void answer_offsets(struct pgmp_model *m) {
    static const double none[AT_LEAST_ONE(N_STRENGTHS)];
    const double at_rest[N] = {0};
    double r[N];
    struct stencil stencil;
    struct terms t;
    struct matrix matrix;
    for (int number = 0; number < (N_GIVEN ? STARTING_CORRECTIONS : 0); number++) {
        find_stencil(axes, m->q, &stencil);
        interpolate(m, &stencil, m->q, none, &t);
        evaluate_lagrangian(&t, m->q, at_rest, at_rest, 0.0, 0.0, 1, r, &matrix);
        for (int k = 0; k < R; k++) {
            r[k] = 0.0;
            for (int j = 0; j < R; j++) matrix.corner[k][j] = j == k;
            for (int i = 0; i < M; i++) matrix.row[k][i] = 0.0;
        }
        eliminate(&matrix);
        solve(&matrix, r);
        for (int i = R; i < N; i++) m->q[i] -= r[i];
    }
}

void stand_at_start(struct pgmp_model *m) {
    for (int i = 0; i < (BALANCED ? N - N_GIVEN : R); i++) m->q[i] = start_coordinates[i], m->v[i] = start_rates[i];
    if (!BALANCED) answer_offsets(m);
}

void count_turns(struct pgmp_model *m, const double q[N]) { (void)m, (void)q; } /* tables count them */

void project_motion(struct pgmp_model *m, const struct acting *now, double h, const double q[N], double v[N], double a[N]) {
    (void)m, (void)now, (void)h, (void)q, (void)v, (void)a;
}

int leaves_tables(const struct pgmp_model *m) {
    int outside = 0;
    for (int k = 0; k < R; k++) {
        double upper = axes[k].lower + axes[k].n_cells * axes[k].step;
        outside |= !axes[k].periodic && !(m->q[k] >= axes[k].lower && m->q[k] <= upper);
    }
    return outside;
}

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
static void turn_frame(const double rigid[N_FRAME], const double moved[N_DOFS], const double point[D], struct frame *frame) {
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

void place_holders(const struct pgmp_model *m, const double q[N], struct moving nodes[], double turned[]) {
    double rigid[1 + R][AT_LEAST_ONE(N_ACTION_ENTRIES)] = {{0}};
    struct stencil stencil, fine;
    (void)m;
    if (N_ACTIONS == 0) return;
    find_stencil(axes, q, &stencil);
    find_stencil(fine_axes, q, &fine);
    add_rows(&fine, 1 + R, N_ACTION_ENTRIES, &actions_table[0][0], &rigid[0][0]);
    for (int node = 0; node < N_ACTION_NODES; node++) {
        const double *slopes[R];
        for (int k = 0; k < R; k++) slopes[k] = rigid[1 + k] + N_FRAME * node;
        place_node(&stencil, action_nodes[node], q, rigid[0] + N_FRAME * node, slopes, nodes + node);
    }
    for (int part = 0; part < N_PARTS; part++) {
        turned[part] = rigid[0][N_FRAME * N_ACTION_NODES + part];
        for (int k = 0; k < R; k++) turned[part] += action_parts[part].winding[k] * q[k];
    }
}

/* A force that turns with its body has no symmetric tangent; its mean serves the symmetric flexible block. */
void add_tangent(double tangent[N][N], struct matrix *m) {
    for (int i = 0; i < M; i++)
        for (int j = 0; j <= i; j++) m->factor[PACKED(i) + j] += 0.5 * (tangent[R + i][R + j] + tangent[R + j][R + i]);
    for (int k = 0; k < R; k++) {
        for (int i = 0; i < M; i++) m->column[k][i] += tangent[R + i][k], m->row[k][i] += tangent[k][R + i];
        for (int j = 0; j < R; j++) m->corner[k][j] += tangent[k][j];
    }
}

#if N_BRANCH_PARTS == 3
/* Quintic Hermite polynomials through values, derivatives times the step and second ones times half its square. */
static void look_up(const double theta[R], double poses[N_BODIES][N_POSE]) {
    double position = (theta[0] - branch_axes[0].lower) / branch_axes[0].step;
    int cell = 0;
    if (position > 0.0) cell = position < N_BRANCH - 2 ? (int)position : N_BRANCH - 2;
    double x = position - cell, y = 1.0 - x, a = y * y * y, b = x * x * x;
    for (int body = 0; body < N_BODIES; body++)
        for (int i = 0; i < N_POSE; i++) {
            double near = branch_table[0][cell][body][i], far = branch_table[0][cell + 1][body][i];
            double near1 = branch_table[1][cell][body][i], far1 = branch_table[1][cell + 1][body][i];
            double near2 = branch_table[2][cell][body][i], far2 = branch_table[2][cell + 1][body][i];
            double from = near * (1.0 + x * (3.0 + 6.0 * x)) + x * (1.0 + 3.0 * x) * near1 + x * x * near2;
            double to = far * (1.0 + y * (3.0 + 6.0 * y)) - y * (1.0 + 3.0 * y) * far1 + y * y * far2;
            poses[body][i] = a * from + b * to;
        }
}
#else
/* From the nearest configuration to second order: values, first and second derivatives, k >= l. */
static void look_up(const double theta[R], double poses[N_BODIES][N_POSE]) {
    double away[R];
    long row = 0;
    for (int k = 0; k < R; k++) {
        const struct axis *axis = branch_axes + k;
        double nearest = floor((theta[k] - axis->lower) / axis->step + 0.5);
        if (!(nearest > 0.0)) nearest = 0.0;
        if (nearest > axis->n_rows - 1) nearest = axis->n_rows - 1;
        row = row * axis->n_rows + (long)nearest;
        away[k] = theta[k] - axis->lower - nearest * axis->step;
    }
    for (int body = 0; body < N_BODIES; body++)
        for (int i = 0; i < N_POSE; i++) {
            double total = branch_table[0][row][body][i];
            for (int k = 0, part = 1 + R; k < R; k++) {
                total += branch_table[1 + k][row][body][i] * away[k];
                for (int l = 0; l <= k; l++, part++)
                    total += branch_table[part][row][body][i] * (l < k ? 1.0 : 0.5) * away[k] * away[l];
            }
            poses[body][i] = total;
        }
}
#endif

#define TURN 6.283185307179586
void place_bodies(const double theta[R], const struct frame nodes[], struct frame bodies[N_BODIES]) {
    (void)nodes; /* poses begin with the table's */
    double poses[N_BODIES][N_POSE], inside[R], turns[R];
    int outside = 0;
    for (int k = 0; k < R; k++) {
        const struct axis *axis = branch_axes + k;
        turns[k] = axis->periodic ? floor((theta[k] - axis->lower) / TURN) : 0.0;
        inside[k] = theta[k] - TURN * turns[k];
        outside |= !(inside[k] >= axis->lower && inside[k] <= axis->lower + axis->n_cells * axis->step);
    }
    look_up(inside, poses);
    for (int k = 0; k < (BRANCH_IS_EXACT && !outside ? 0 : CLOSURES); k++) close_loops(inside, poses);
    for (int body = 0; body < N_BODIES; body++) {
        frame_of_pose(poses[body], bodies[body].z);
        bodies[body].angle = D == 2 ? poses[body][2] : 0.0;
        for (int k = 0; k < R; k++) bodies[body].angle += TURN * winding[k][body] * turns[k];
    }
}

/* A product and its derivatives, from those of its factors. */
static void multiply(const double x[3], const double y[3], double found[3]) {
    double second = x[2] * y[0] + 2.0 * x[1] * y[1] + x[0] * y[2];
    found[1] = x[1] * y[0] + x[0] * y[1], found[0] = x[0] * y[0], found[2] = second;
}

/* Displacements of the nodes in body frames, their rates and accelerations, as far as outputs read them. */
void look_at(const struct pgmp_model *m, struct look *look) {
    double (*moved)[N_SHAPES] = look->moved;
    double factors[N_FACTORS][3], one[R][3][4];
    int rows[R][4];
    for (int i = 0, pair = M; i < M; i++) {
        double delta[3] = {m->q[R + i], m->v[R + i], m->a[R + i]};
        memcpy(factors[i], delta, sizeof delta);
        for (int j = 0; SECOND_ORDER && j <= i; j++, pair++) {
            double half = i == j ? 0.5 : 1.0, other[3] = {half * m->q[R + j], half * m->v[R + j], half * m->a[R + j]};
            multiply(delta, other, factors[pair]);
        }
    }
    for (int k = 0; k < R; k++) {
        find_along(axes + k, m->q[k], rows[k], one[k]);
        for (int j = 0; j < 4; j++) { /* of theta, then of time */
            double slope = one[k][1][j], bend = one[k][2][j];
            one[k][1][j] = slope * m->v[k], one[k][2][j] = bend * m->v[k] * m->v[k] + slope * m->a[k];
        }
    }
    memset(moved, 0, 3 * N_SHAPES * sizeof(double));
    for (int p = 0; p < N_STENCIL; p++) {
        double weight[3] = {1.0, 0.0, 0.0}, part[3];
        long row = 0;
        for (int k = 0, digits = p; k < R; k++) { /* rows of the last coordinate run fastest */
            int j = digits >> 2 * (R - 1 - k) & 3;
            double along[3] = {one[k][0][j], one[k][1][j], one[k][2][j]};
            row = row * axes[k].n_rows + rows[k][j];
            multiply(weight, along, weight);
        }
        for (int i = 0; i < N_FACTORS; i++) {
            multiply(weight, factors[i], part);
            for (int order = 0; order <= DEPTH; order++)
                for (int c = 0; c < N_SHAPES; c++) moved[order][c] += part[order] * shapes_table[row][i][c];
        }
    }
}

void see_nodes(const struct pgmp_model *m, const struct look *look, double after, double theta[R], struct frame nodes[]) {
    double half = DEPTH > 1 ? 0.5 * after * after : 0.0, moved[N_SHAPES];
    struct frame bodies[N_BODIES];
    for (int k = 0; k < R; k++) theta[k] = m->q[k] + after * m->v[k] + half * m->a[k];
    for (int c = 0; c < N_SHAPES; c++) moved[c] = look->moved[0][c] + after * look->moved[1][c] + half * look->moved[2][c];
    place_bodies(theta, nodes, bodies);
    for (int k = 0; k < N_NODES; k++) {
        turn_frame(bodies[node_bodies[k]].z, moved + N_DOFS * k, node_points[k], nodes + k);
        nodes[k].angle = bodies[node_bodies[k]].angle + moved[N_DOFS * k + D];
    }
}

void find_pace(const struct pgmp_model *m, const struct look *look, double *speed, double *pull) {
    for (int k = 0; k < R; k++) {
        *speed = fmax(*speed, scale[k] * fabs(m->v[k]));
        *pull = fmax(*pull, DEPTH > 1 ? scale[k] * fabs(m->a[k]) : 0.0);
    }
    for (int c = 0; c < N_SHAPES; c++) {
        double unit = c < N_DOFS * N_NODES && c % N_DOFS < D ? 1.0 / SIZE : 1.0;
        *speed = fmax(*speed, unit * fabs(look->moved[1][c])), *pull = fmax(*pull, unit * fabs(look->moved[2][c]));
    }
}

/* The largest rotation of a flexible node. */
double find_rotation(const struct pgmp_model *m, const struct look *look) {
    double largest = 0.0;
    (void)m;
    for (int c = N_DOFS * N_NODES; c < N_SHAPES; c += N_DOFS - D) {
        double square = 0.0;
        for (int i = 0; i < N_DOFS - D; i++) square += look->moved[0][c + i] * look->moved[0][c + i];
        largest = fmax(largest, sqrt(square));
    }
    return largest;
}
