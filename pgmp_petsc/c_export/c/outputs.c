/* What is seen of a state: frames of the nodes of outputs, and functions of them and of multipliers.

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
    double z[2 * N_FRAME], gradient[2 * N_FRAME], near = line_of(s, theta);
    attach(&s->a, nodes, pair);
    attach(&s->b, nodes, pair + 1);
    if (D == 2 && s->kind == ANGLE) return pair[1].angle - pair[0].angle;
    for (int end = 0; end < 2; end++) memcpy(z + end * N_FRAME, pair[end].z, sizeof pair[end].z);
    return evaluate_statement(s, z, near, gradient, 0);
}

/* A point's displacement against the rigid mechanism at the measured coordinates. */
static double deformation(const struct reading *o, const struct frame nodes[], const double theta[R]) {
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
    place_bodies(measured, nodes, bodies);
    attach(point, nodes, &frame);
    const double *body = bodies[point->body].z;
    for (int c = 0; c < D; c++) {
        moved[c] = frame.z[c] - body[c];
        for (int j = 0; j < D; j++) moved[c] -= point->point[j] * body[D + D * j + c];
    }
    for (int c = 0; c < D; c++) along += moved[c] * body[D + D * o->axis + c];
    return o->in_body ? along : moved[o->axis];
}

/* All readings, in steps of `stride`. */
static void read_nodes(const struct frame nodes[], const double theta[R], int stride, double found[]) {
    struct frame frame;
    for (int number = 0; number < N_READINGS; number++) {
        const struct reading *o = readings + number;
        double *value = found + stride * number;
        if (o->kind == DEFORMATION)
            *value = deformation(o, nodes, theta);
        else if (o->kind == MEASURE)
            *value = measure(&o->statement, nodes, theta);
        else {
            attach(&o->statement.b, nodes, &frame);
            *value = o->kind == ROTATION ? frame.angle : frame.z[o->axis] - o->origin;
        }
    }
}

/* Rates and accelerations of all readings: differences of eighth order along the motion, a line or a parabola, no further
   than 1e-2 rad or of the size. In a loop 0.02 rad from where it is stretched they are 1e-7 off; elsewhere round-off is
   left, of a deformation that of the two places whose difference it is. */
static void find_changes(const struct pgmp_model *m, const struct look *look, double found[][3]) {
    static const double first[9] = {3.0, -32.0, 168.0, -672.0, 0.0, 672.0, -168.0, 32.0, -3.0};
    static const double second[9] = {-9.0, 128.0, -1008.0, 8064.0, -14350.0, 8064.0, -1008.0, 128.0, -9.0};
    double speed = 1e-30, pull = 1e-30, theta[R], values[AT_LEAST_ONE(N_READINGS)];
    struct frame nodes[AT_LEAST_ONE(N_NODES)];
    find_pace(m, look, &speed, &pull);
    double far = fmin(2e-3 / speed, sqrt(2.5e-4 / pull));
    for (int side = 0; side < 9; side++) {
        see_nodes(m, look, (side - 4) * far, theta, nodes);
        read_nodes(nodes, theta, 1, values);
        for (int number = 0; number < N_READINGS; number++) {
            found[number][1] += first[side] * values[number] / (840.0 * far);
            found[number][2] += second[side] * values[number] / (5040.0 * far * far);
        }
    }
}

enum { AXIAL = 3, RADIAL, MAGNITUDE, ALONG_MOTION, SIZE_ALONG_MOTION };

static double size_of(const double x[3]) { return sqrt(x[0] * x[0] + x[1] * x[1] + x[2] * x[2]); }

/* The component of a joint's force or moment. */
double read_force(const struct force *f, const struct frame nodes[], const double multipliers[]) {
    double slopes[N_FRAME] = {0}, acting[3] = {0}, along[3] = {0}, z[2 * N_FRAME], gradient[2 * N_FRAME], axial = 0.0;
    struct frame a, b;
    if (f->component >= ALONG_MOTION) {
        double along_motion = -multipliers[force_terms[f->first].row] * force_terms[f->first].factor;
        return f->component == ALONG_MOTION ? along_motion : fabs(along_motion);
    }
    attach(&f->b, nodes, &b);
    for (int k = f->first; k < f->last; k++) {
        const struct term *term = force_terms + k;
        double slope, bend;
        attach(&term->statement.a, nodes, &a);
        memcpy(z, a.z, sizeof a.z);
        memcpy(z + N_FRAME, b.z, sizeof b.z);
        of_term(term, evaluate_statement(&term->statement, z, 0.0, gradient, 0), &slope, &bend);
        for (int c = 0; c < N_FRAME; c++) slopes[c] -= f->sign * multipliers[term->row] * slope * gradient[N_FRAME + c];
    }
    for (int c = 0; c < D && !f->turning; c++) acting[c] = slopes[c];
    for (int k = 1; k <= D && f->turning; k++) { /* sum of d_k x g_k */
        const double *d = b.z + D * k, *g = slopes + D * k;
        if (D == 3) acting[0] += d[1] * g[D - 1] - d[D - 1] * g[1], acting[1] += d[D - 1] * g[0] - d[0] * g[D - 1];
        acting[2] += d[0] * g[1] - d[1] * g[0];
    }
    if (f->component == MAGNITUDE) return size_of(acting);
    if (D == 2 && f->turning) return acting[2];
    attach(&f->a, nodes, &a);
    if (f->component < AXIAL && !f->in_body) return acting[f->component];
    if (f->component < AXIAL) {
        const double *d = (f->sign < 0.0 ? a.z : b.z) + D * (1 + f->component);
        for (int c = 0; c < D; c++) axial += d[c] * acting[c];
        return axial;
    }
    for (int k = 0; k < D; k++)
        for (int c = 0; c < D; c++) along[c] += f->axis[k] * a.z[D + D * k + c];
    for (int c = 0; c < D; c++) axial += along[c] * acting[c];
    for (int c = 0; c < D; c++) acting[c] -= axial * along[c];
    return f->component == AXIAL ? axial : size_of(acting);
}

void pgmp_observe(struct pgmp_model *m) { pgmp_observe_at(m, pgmp_time(m), pgmp_time(m)); }

void pgmp_observe_at(struct pgmp_model *m, double time, double since) {
    double found[AT_LEAST_ONE(N_READINGS)][3] = {{0}}, bases[AT_LEAST_ONE(N_BASES)][3], theta[R];
    double acting[N_FORCES + R + N_CONTROLS][3] = {{0}};
    struct frame nodes[AT_LEAST_ONE(N_NODES)];
    struct look look;
    look_at(m, &look);
    m->elastic_rotation = find_rotation(m, &look);
    if (m->elastic_rotation > ROTATION_LIMIT) m->validity |= PGMP_ROTATION;
    see_nodes(m, &look, 0.0, theta, nodes);
    read_nodes(nodes, theta, 3, &found[0][0]);
    if (DEPTH) find_changes(m, &look, found);
    for (int k = 0; k < N_BASES; k++) {
        double rates[2];
        bases[k][0] = evaluate_piece(N_STRENGTHS + R + k, time, since, rates);
        bases[k][1] = rates[0], bases[k][2] = rates[1];
    }
#if N_FORCES || DRIVES
    struct acting now;
    act(m, time, since, &now);
    find_forces(m, &now, 0, nodes, acting);
#endif
#if N_CONTROLS
    find_held(m, acting + N_FORCES + R);
#endif
    combine(time, m->parameters, bases, found, acting + N_CARRIED, m->outputs, m->counted);
    show_counts(m, time);
}
