/* Poses of undeformed bodies that hold the joints together at given coordinates, by steps of Newton's method. What is said
   twice is allowed: the steps are those of least squares.

   written by pgmp_petsc */

#include <math.h>
#include <string.h>

#include "tables.h"

#define N_UNKNOWNS (N_BODIES * N_POSE)

void frame_of_pose(const double pose[N_POSE], double z[N_FRAME]) {
#if D == 2
    z[0] = pose[0], z[1] = pose[1];
    z[2] = z[5] = cos(pose[2]), z[3] = sin(pose[2]), z[4] = -z[3];
#else
    memcpy(z, pose, N_FRAME * sizeof(double));
#endif
}

/* Adds a gradient in the frame of a point of a body to that in the body's pose. */
static void add_to_pose(const double z[N_FRAME], const double point[D], const double gradient[N_FRAME], double *row) {
    double of_directors[D][D];
    for (int j = 0; j < D; j++)
        for (int c = 0; c < D; c++) of_directors[j][c] = gradient[D + D * j + c] + point[j] * gradient[c];
    for (int c = 0; c < D; c++) row[c] += gradient[c];
#if D == 2
    for (int c = 0; c < D; c++) /* d d_1 / d phi = d_2, d d_2 / d phi = -d_1 */
        row[2] += of_directors[0][c] * z[4 + c] - of_directors[1][c] * z[2 + c];
#else
    (void)z;
    for (int j = 0; j < D; j++)
        for (int c = 0; c < D; c++) row[D + D * j + c] += of_directors[j][c];
#endif
}

static void frame_of_point(const struct side *side, double poses[N_BODIES][N_POSE], double body[N_FRAME],
                           double z[N_FRAME]) {
    if (side->body < 0) {
        for (int c = 0; c < N_FRAME; c++) z[c] = c < D ? side->point[c] : (c - D) % (D + 1) == 0;
        return;
    }
    frame_of_pose(poses[side->body], body);
    memcpy(z, body, N_FRAME * sizeof(double));
    for (int j = 0; j < D; j++)
        for (int c = 0; c < D; c++) z[c] += side->point[j] * body[D + D * j + c];
}

/* What the angle of a statement in space is near to. */
double line_of(const struct statement *s, const double theta[R]) {
    double near = s->turns[0];
    for (int k = 0; k < R; k++) near += s->turns[1 + k] * theta[k];
    return near;
}

/* Value of a term where its statement is s, and its first and second derivatives in s. */
double of_term(const struct term *term, double s, double *slope, double *bend) {
    const struct spline_piece *piece = spline_pieces + term->first;
    *slope = term->factor, *bend = 0.0;
    if (!term->n_pieces) return term->factor * s;
    double period = piece[term->n_pieces - 1].end - piece->begin, x = s;
    if (period > 0.0) x -= period * floor((s - piece->begin) / period);
    for (int k = 1; k < term->n_pieces && x >= piece[1].begin; k++) piece++;
    const double *c = piece->cubic;
    x -= piece->begin;
    *slope *= c[1] + x * (2.0 * c[2] + x * 3.0 * c[3]);
    *bend = term->factor * (2.0 * c[2] + x * 6.0 * c[3]);
    return term->factor * (c[0] + x * (c[1] + x * (c[2] + x * c[3])));
}

/* Adds the derivatives of a statement times a factor to those in the poses, and returns its value. */
static double add_statement(const struct statement *s, double near, double poses[N_BODIES][N_POSE],
                            const struct term *term, double row[N_UNKNOWNS]) {
    double z[2 * N_FRAME], bodies[2][N_FRAME], gradient[2 * N_FRAME], slope = 1.0, bend;
    frame_of_point(&s->a, poses, bodies[0], z);
    frame_of_point(&s->b, poses, bodies[1], z + N_FRAME);
#if D == 2 /* angles count turns with the bodies */
    if (term && s->kind == ANGLE)
        near = (s->b.body < 0 ? 0.0 : poses[s->b.body][2]) - (s->a.body < 0 ? 0.0 : poses[s->a.body][2]);
#endif
    double value = evaluate_statement(s, z, near, gradient, 0);
    if (term) value = of_term(term, value, &slope, &bend);
    for (int i = 0; i < 2 * N_FRAME; i++) gradient[i] *= slope;
    if (s->a.body >= 0) add_to_pose(bodies[0], s->a.point, gradient, row + N_POSE * s->a.body);
    if (s->b.body >= 0) add_to_pose(bodies[1], s->b.point, gradient + N_FRAME, row + N_POSE * s->b.body);
    return value;
}

/* One Newton step, of the normal equations; lengths are in units of the mechanism's size. */
void close_loops(const double theta[R], double poses[N_BODIES][N_POSE]) {
    static const int n_rows = N_CLOSURE, n_terms = N_CLOSURE_TERMS;
    double normal[N_UNKNOWNS][N_UNKNOWNS] = {{0}}, right[N_UNKNOWNS] = {0};
    for (int number = 0, term = 0; number < n_rows + R; number++) {
        const struct statement *s = number < n_rows ? &closure[term].statement : coordinates + number - n_rows;
        double wanted = number < n_rows ? closure_wanted[number] : theta[number - n_rows];
        double row[N_UNKNOWNS] = {0}, gap = -wanted;
        if (number >= n_rows) gap += add_statement(s, wanted, poses, 0, row);
        for (; number < n_rows && term < n_terms && closure[term].row == number; term++) {
            double near = closure[term].left ? -gap / closure[term].factor : line_of(&closure[term].statement, theta);
            gap += add_statement(&closure[term].statement, near, poses, closure + term, row);
        }
        double unit = IS_LENGTH(s->kind) ? 1.0 / SIZE : 1.0;
        int n_own = 0, own[N_UNKNOWNS]; /* places of two or three bodies */
        for (int i = 0; i < N_UNKNOWNS; i++)
            if (row[i] != 0.0) row[own[n_own++] = i] *= unit * (i % N_POSE < D ? SIZE : 1.0);
        for (int i = 0; i < n_own; i++) {
            right[own[i]] += row[own[i]] * gap * unit;
            for (int j = 0; j <= i; j++) normal[own[i]][own[j]] += row[own[i]] * row[own[j]];
        }
    }
    int first[N_UNKNOWNS]; /* what is 0 before the first entry of a row stays 0, along a chain nearly all of it */
    for (int i = 0; i < N_UNKNOWNS; i++) {
        for (first[i] = 0; normal[i][first[i]] == 0.0 && first[i] < i;) first[i]++;
        for (int j = first[i]; j <= i; j++) {
            double total = normal[i][j];
            for (int k = first[i] > first[j] ? first[i] : first[j]; k < j; k++) total -= normal[i][k] * normal[j][k];
            normal[i][j] = j < i ? total / normal[j][j] : sqrt(total);
        }
    }
    for (int i = 0; i < N_UNKNOWNS; i++) {
        for (int j = first[i]; j < i; j++) right[i] -= normal[i][j] * right[j];
        right[i] /= normal[i][i];
    }
    for (int i = N_UNKNOWNS - 1; i >= 0; i--) {
        for (int j = i + 1; j < N_UNKNOWNS; j++) right[i] -= normal[j][i] * right[j];
        right[i] /= normal[i][i];
        poses[i / N_POSE][i % N_POSE] -= right[i] * (i % N_POSE < D ? SIZE : 1.0);
    }
}
