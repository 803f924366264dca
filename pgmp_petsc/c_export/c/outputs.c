/* What is seen of a state: frames of the nodes of outputs, and functions of them.

   written by pgmp_petsc */

#include <math.h>
#include <string.h>

#include "tables.h"

#define REACH 0.05 /* rad, or of the size, beyond a limited range, to which deformations are evaluated */

/* The frame of a point, from those of the nodes. */
void attach(const struct side *side, const struct frame nodes[], struct frame *frame) {
    if (side->slot < 0) {
        for (int c = 0; c < N_FRAME; c++) frame->z[c] = c < D ? side->point[c] : (c - D) % (D + 1) == 0;
        frame->angle = 0.0;
        return;
    }
    *frame = nodes[side->slot];
    for (int j = 0; j < D; j++)
        for (int c = 0; c < D; c++) frame->z[c] += side->arm[j] * frame->z[D + D * j + c];
}

/* In the plane frames count the turns of an angle, in space it is nearest to a line over the coordinates. */
static double measure(const struct statement *s, const struct frame nodes[], const double theta[R]) {
    struct frame pair[2];
    double z[2 * N_FRAME], gradient[2 * N_FRAME], near = s->turns[0];
    attach(&s->a, nodes, pair);
    attach(&s->b, nodes, pair + 1);
    if (D == 2 && s->kind == ANGLE) return pair[1].angle - pair[0].angle;
    for (int end = 0; end < 2; end++) memcpy(z + end * N_FRAME, pair[end].z, sizeof pair[end].z);
    for (int k = 0; k < R; k++) near += s->turns[1 + k] * theta[k];
    return evaluate_statement(s, z, near, gradient, 0);
}

/* How a point moves, from how the nodes do. */
static void attach_rate(const struct side *side, const struct frame rates[], struct frame *rate) {
    attach(side, rates, rate);
    if (side->slot < 0) memset(rate, 0, sizeof *rate);
}

/* The rate of a measure: in the plane an angle's is the difference of those of its frames. */
static double measure_rate(const struct statement *s, const struct frame nodes[], const struct frame rates[]) {
    struct frame pair[2], moving[2];
    double z[2 * N_FRAME], gradient[2 * N_FRAME], total = 0.0;
    for (int end = 0; end < 2; end++) {
        attach(end ? &s->b : &s->a, nodes, pair + end);
        attach_rate(end ? &s->b : &s->a, rates, moving + end);
        memcpy(z + end * N_FRAME, pair[end].z, sizeof pair[end].z);
    }
    evaluate_statement(s, z, 0.0, gradient, 0);
    for (int c = 0; c < N_FRAME; c++) total += gradient[c] * moving[0].z[c] + gradient[N_FRAME + c] * moving[1].z[c];
    return total;
}

/* A point's displacement against the rigid mechanism at the measured coordinates. */
static double deformation(const struct output *o, const struct frame nodes[], const double theta[R]) {
    const struct side *point = &o->statement.b;
    struct frame bodies[N_BODIES], frame;
    double measured[R], moved[D], along = 0.0;
    for (int k = 0; k < R; k++) {
        const struct axis *axis = branch_axes + k;
        double upper = axis->lower + axis->n_cells * axis->step;
        measured[k] = measure(coordinates + k, nodes, theta);
        double reach = IS_LENGTH(coordinates[k].kind) ? REACH * SIZE : REACH;
        if (!axis->periodic && !(measured[k] >= axis->lower - reach && measured[k] <= upper + reach)) return NAN;
    }
    place_bodies(measured, bodies);
    attach(point, nodes, &frame);
    const double *body = bodies[point->body].z;
    for (int c = 0; c < D; c++) {
        moved[c] = frame.z[c] - body[c];
        for (int j = 0; j < D; j++) moved[c] -= point->point[j] * body[D + D * j + c];
    }
    for (int c = 0; c < D; c++) along += moved[c] * body[D + D * o->axis + c];
    return o->in_body ? along : moved[o->axis];
}

/* Displacements of the nodes in body frames and their rates. */
static void find_displacements(const struct pgmp_model *m, double moved[N_SHAPES], double rates[N_SHAPES]) {
    double factors[N_FACTORS], changes[N_FACTORS];
    struct stencil stencil;
    for (int i = 0, pair = M; i < M; i++) {
        factors[i] = m->q[R + i], changes[i] = m->v[R + i];
        for (int j = 0; SECOND_ORDER && j <= i; j++, pair++) {
            double half = i == j ? 0.5 : 1.0;
            factors[pair] = half * m->q[R + i] * m->q[R + j];
            changes[pair] = half * (m->v[R + i] * m->q[R + j] + m->q[R + i] * m->v[R + j]);
        }
    }
    find_stencil(axes, m->q, &stencil);
    for (int c = 0; c < N_SHAPES; c++) moved[c] = rates[c] = 0.0;
    for (int p = 0; p < N_STENCIL; p++)
        for (int i = 0; i < N_FACTORS; i++) {
            double weight = stencil.weights[0][p] * factors[i], change = stencil.weights[0][p] * changes[i];
            for (int k = 0; k < R; k++) change += stencil.weights[1 + k][p] * m->v[k] * factors[i];
            for (int c = 0; c < N_SHAPES; c++) {
                moved[c] += weight * shapes_table[stencil.rows[p]][i][c];
                if (READS_RATES) rates[c] += change * shapes_table[stencil.rows[p]][i][c];
            }
        }
}

static void find_nodes(const double theta[R], const double moved[N_SHAPES], struct frame nodes[]) {
    struct frame bodies[N_BODIES];
    place_bodies(theta, bodies);
    for (int k = 0; k < N_NODES; k++) {
        turn_frame(bodies[node_bodies[k]].z, moved + N_DOFS * k, node_points[k], nodes + k);
        nodes[k].angle = bodies[node_bodies[k]].angle + moved[N_DOFS * k + D];
    }
}

/* Add the rates of the frames of nodes: differences of fourth order along the motion. */
static void find_rates(const struct pgmp_model *m, const double moved[N_SHAPES], const double changes[N_SHAPES],
                       struct frame rates[]) {
    static const double offsets[4] = {-2.0, -1.0, 1.0, 2.0}, shares[4] = {1.0, -8.0, 8.0, -1.0};
    double far = 1e-300, theta[R], there[N_SHAPES];
    struct frame nodes[AT_LEAST_ONE(N_NODES)];
    for (int k = 0; k < R; k++) far = fabs(m->v[k]) > far ? fabs(m->v[k]) : far;
    for (int c = 0; c < N_SHAPES; c++) far = fabs(changes[c]) > far ? fabs(changes[c]) : far;
    far = 2e-3 / far;
    for (int side = 0; side < 4; side++) {
        double h = offsets[side] * far, share = shares[side] / (12.0 * far);
        for (int k = 0; k < R; k++) theta[k] = m->q[k] + h * m->v[k];
        for (int c = 0; c < N_SHAPES; c++) there[c] = moved[c] + h * changes[c];
        find_nodes(theta, there, nodes);
        for (int k = 0; k < N_NODES; k++) {
            for (int c = 0; c < N_FRAME; c++) rates[k].z[c] += share * nodes[k].z[c];
            rates[k].angle += share * nodes[k].angle;
        }
    }
}

void pgmp_observe(struct pgmp_model *m) {
    double moved[N_SHAPES], changes[N_SHAPES];
    struct frame nodes[AT_LEAST_ONE(N_NODES)], rates[AT_LEAST_ONE(N_NODES)], frame;
    find_displacements(m, moved, changes);
    m->elastic_rotation = 0.0;
    for (int c = N_DOFS * N_NODES; c < N_SHAPES; c += N_DOFS - D) { /* rotations of all flexible nodes */
        double square = 0.0;
        for (int i = 0; i < N_DOFS - D; i++) square += moved[c + i] * moved[c + i];
        if (sqrt(square) > m->elastic_rotation) m->elastic_rotation = sqrt(square);
    }
    if (m->elastic_rotation > ROTATION_LIMIT) m->validity |= PGMP_ROTATION;
    find_nodes(m->q, moved, nodes);
    memset(rates, 0, sizeof rates);
    if (READS_RATES) find_rates(m, moved, changes, rates);
    for (int number = 0; number < N_OUTPUTS; number++) {
        const struct output *o = outputs + number;
        double *value = m->outputs + number;
        if (o->kind == DEFORMATION)
            *value = deformation(o, nodes, m->q);
        else if (o->kind == MEASURE)
            *value = o->rate ? measure_rate(&o->statement, nodes, rates) : measure(&o->statement, nodes, m->q);
        else {
            if (o->rate)
                attach_rate(&o->statement.b, rates, &frame);
            else
                attach(&o->statement.b, nodes, &frame);
            *value = o->kind == ROTATION ? frame.angle : frame.z[o->axis] - (o->rate ? 0.0 : o->origin);
        }
    }
}
