/* A component model in joint coordinates y. Frames z = (p, d_1 .. d_D) of all nodes follow from the ground outward,

     z = z(y),    z' = J y',    z'' = J y'' + g(y, y');    r_y = J^T r_z,    A = J^T S J,

   with frames' own derivatives J beside them, and C^T lambda of the constraints c that the tree leaves. A body in its frame has r = p + sum_k d_k w_k, w_k = X_k + Psi_k xi + 1/2 xi
   chi_k xi; the equations are those of full/floating.py and full/joint_map.py in pgmp_petsc.

   written by pgmp_petsc */

#include <math.h>
#include <string.h>

#include "tables.h"

#define LARGE 1e30 /* gain that makes stiffness negligible beside mass */
#define POSES 6    /* Newton steps to rigid poses, from those of the bodies' frames */

/* A motion in a frame: displacement and turn, their rates and accelerations, and their derivatives with n coordinates from
   `first` on. */
struct motion {
    double way[3][D], turn[3][D][D], ways[MOST][D], turns[MOST][D][D];
    int first, n;
};

static const struct motion nothing;

/* Adds a multiple of what displacement and turn make of directors. */
static void add_moved(const double from[N_FRAME], const double way[D], const double turn[D][D], double factor,
                      double to[N_FRAME]) {
    for (int k = 0; k < D; k++)
        for (int c = 0; c < D; c++) {
            double director = factor * from[D + D * k + c];
            to[c] += way[k] * director;
            for (int j = 0; j < D; j++) to[D + D * j + c] += turn[k][j] * director;
        }
}

/* Fills a frame that moves in another. */
static void carry(const struct chain *from, const struct motion *s, struct chain *to) {
    int last = from->n > s->first + s->n ? from->n : s->first + s->n;
    memset(to->z, 0, (size_t)(SLOPES + last) * sizeof to->z[0]);
    for (int i = 0; i < SLOPES + from->n; i++) {
        for (int c = 0; c < D; c++) to->z[i][c] = from->z[i][c];
        add_moved(from->z[i], s->way[0], s->turn[0], 1.0, to->z[i]);
    }
    add_moved(from->z[AT], s->way[1], s->turn[1], 1.0, to->z[RATE]);
    add_moved(from->z[AT], s->way[2], s->turn[2], 1.0, to->z[MORE]);
    add_moved(from->z[RATE], s->way[1], s->turn[1], 2.0, to->z[MORE]);
    for (int i = 0; i < s->n; i++) add_moved(from->z[AT], s->ways[i], s->turns[i], 1.0, to->z[SLOPES + s->first + i]);
    to->n = last, to->angle = from->angle;
}

/* The place of a joint in the frame that it is on, and of the frame that it holds in the joint's. */
static void stand_before(const struct body *b, struct motion *s) {
    *s = nothing;
    memcpy(s->way[0], b->before[0], sizeof s->way[0]), memcpy(s->turn[0], b->before[1], sizeof s->turn[0]);
}

static void stand_after(const struct body *b, struct motion *s) {
    *s = nothing;
    for (int k = 0; k < D; k++)
        for (int j = 0; j < D; j++) s->turn[0][j][k] = b->after[1 + k][j], s->way[0][j] -= b->after[0][k] * b->after[1 + k][j];
}

/* What a joint slides along and turns about its first axis. */
static void move(const struct body *b, const double q[N], const double v[N], const double a[N], struct motion *s) {
    int x = D - 2, y = D - 1, slides = b->sliding >= 0;
    double angle = 0.0, rate = 0.0, more = 0.0;
    *s = nothing, s->first = b->turning >= 0 ? b->turning : b->sliding;
    if (b->turning >= 0) angle = q[b->turning], rate = v[b->turning], more = a[b->turning], s->n = 1;
    if (D == 3) s->turn[0][0][0] = 1.0;
    double sine = sin(angle), cosine = cos(angle);
    s->turn[0][x][x] = s->turn[0][y][y] = cosine, s->turn[0][y][x] = sine, s->turn[0][x][y] = -sine;
    s->turn[1][x][x] = s->turn[1][y][y] = -sine * rate, s->turn[1][y][x] = cosine * rate, s->turn[1][x][y] = -cosine * rate;
    s->turn[2][x][x] = s->turn[2][y][y] = -sine * more - cosine * rate * rate;
    s->turn[2][y][x] = cosine * more - sine * rate * rate, s->turn[2][x][y] = -s->turn[2][y][x];
    s->turns[0][x][x] = s->turns[0][y][y] = -sine, s->turns[0][y][x] = cosine, s->turns[0][x][y] = -cosine;
    if (!slides) return;
    s->way[0][0] = q[b->sliding], s->way[1][0] = v[b->sliding], s->way[2][0] = a[b->sliding];
    if (!s->n) memset(s->turns[0], 0, sizeof s->turns[0]);
    s->ways[s->n++][0] = 1.0;
}

#if D == 2
/* The turn by s, (value, rate, acceleration), and its derivative. */
static void turn_by(double s[3][N_TURNS], double turn[3][D][D], double by[N_TURNS][D][D]) {
    double sine = sin(s[0][0]), cosine = cos(s[0][0]), own[D][D] = {{cosine, -sine}, {sine, cosine}};
    double slope[D][D] = {{-sine, -cosine}, {cosine, -sine}};
    for (int l = 0; l < D; l++)
        for (int k = 0; k < D; k++) {
            turn[0][l][k] = own[l][k], by[0][l][k] = slope[l][k], turn[1][l][k] = s[1][0] * slope[l][k];
            turn[2][l][k] = s[2][0] * slope[l][k] - s[1][0] * s[1][0] * own[l][k];
        }
}
#else
static double dot3(const double x[3], const double y[3]) { return x[0] * y[0] + x[1] * y[1] + x[2] * y[2]; }

/* The turn R = c + s x + s s^T / (1 + c), c^2 = 1 - s.s, by s, (value, rate, acceleration), and its derivatives. */
static void turn_by(double s[3][N_TURNS], double turn[3][D][D], double by[N_TURNS][D][D]) {
    double c[3] = {sqrt(1.0 - dot3(s[0], s[0]))}, k[3] = {1.0 / (1.0 + c[0])};
    c[1] = -dot3(s[0], s[1]) / c[0], k[1] = -k[0] * k[0] * c[1];
    c[2] = -(dot3(s[1], s[1]) + dot3(s[0], s[2]) + c[1] * c[1]) / c[0];
    k[2] = -k[0] * k[0] * c[2] + 2.0 * k[0] * k[0] * k[0] * c[1] * c[1];
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            double both = s[0][i] * s[0][j], both1 = s[1][i] * s[0][j] + s[0][i] * s[1][j];
            double both2 = s[2][i] * s[0][j] + 2.0 * s[1][i] * s[1][j] + s[0][i] * s[2][j];
            turn[0][i][j] = k[0] * both, turn[1][i][j] = k[1] * both + k[0] * both1;
            turn[2][i][j] = k[2] * both + 2.0 * k[1] * both1 + k[0] * both2;
            for (int t = 0; t < 3; t++)
                by[t][i][j] = k[0] * (k[0] * s[0][t] / c[0] * both + (t == i ? s[0][j] : 0.0) + (t == j ? s[0][i] : 0.0));
        }
    for (int i = 0; i < 3; i++)
        for (int order = 0; order < 3; order++) {
            int j = (i + 1) % 3, l = (i + 2) % 3;
            turn[order][i][i] += c[order], turn[order][l][j] += s[order][i], turn[order][j][l] -= s[order][i];
            by[order][i][i] -= s[0][order] / c[0];
        }
    for (int t = 0; t < 3; t++) by[t][(t + 2) % 3][(t + 1) % 3] += 1.0, by[t][(t + 1) % 3][(t + 2) % 3] -= 1.0;
}
#endif

/* How a face moves in its body; returns how far it is turned. */
static double deform(const struct body *b, const struct face *f, const double q[N], const double v[N], const double a[N],
                     struct motion *s) {
    const double *x = q + b->first, *x1 = v + b->first, *x2 = a + b->first, *shape = shapes + f->shapes;
    double turned[3][N_TURNS] = {{0}}, by[N_TURNS][D][D];
    const int n = b->n;
    *s = nothing, s->first = b->first, s->n = n;
    for (int l = 0; l < D; l++) {
        s->way[0][l] = f->centre[l];
        for (int i = 0; i < n; i++) {
            double plain = shape[l * n + i], way = plain, moving = 0.0;
            const int *row = curve_rows + f->bends + l * n + i;
            for (int e = f->bends < 0 ? 0 : row[0]; e < (f->bends < 0 ? 0 : row[1]); e++)
                way += curves[e] * x[curve_columns[e]], moving += curves[e] * x1[curve_columns[e]];
            s->ways[i][l] = way;
            s->way[0][l] += 0.5 * (plain + way) * x[i], s->way[1][l] += way * x1[i];
            s->way[2][l] += way * x2[i] + moving * x1[i];
        }
    }
    for (int t = 0; t < N_TURNS; t++)
        for (int i = 0; i < n; i++) {
            double turn = shape[(D + t) * n + i];
            turned[0][t] += turn * x[i], turned[1][t] += turn * x1[i], turned[2][t] += turn * x2[i];
        }
    turn_by(turned, s->turn, by);
    for (int i = 0; i < n; i++)
        for (int t = 0; t < N_TURNS; t++)
            for (int l = 0; l < D; l++)
                for (int k = 0; k < D; k++) s->turns[i][l][k] += shape[(D + t) * n + i] * by[t][l][k];
    double square = 0.0;
    for (int t = 0; t < N_TURNS; t++) square += turned[0][t] * turned[0][t];
    return D == 2 ? turned[0][0] : asin(fmin(1.0, sqrt(square)));
}

/* Adds to a displacement what the transposed of a turn makes of another one. */
static void add_back(const double turn[D][D], const double way[D], double factor, double into[D]) {
    for (int k = 0; k < D; k++)
        for (int l = 0; l < D; l++) into[k] -= factor * turn[l][k] * way[l];
}

/* The motion of the frame in what moves in it. */
static void invert(const struct motion *s, struct motion *back) {
    *back = nothing, back->first = s->first, back->n = s->n;
    add_back(s->turn[0], s->way[0], 1.0, back->way[0]);
    add_back(s->turn[1], s->way[0], 1.0, back->way[1]), add_back(s->turn[0], s->way[1], 1.0, back->way[1]);
    add_back(s->turn[2], s->way[0], 1.0, back->way[2]), add_back(s->turn[1], s->way[1], 2.0, back->way[2]);
    add_back(s->turn[0], s->way[2], 1.0, back->way[2]);
    for (int i = 0; i < s->n; i++)
        add_back(s->turns[i], s->way[0], 1.0, back->ways[i]), add_back(s->turn[0], s->ways[i], 1.0, back->ways[i]);
    for (int l = 0; l < D; l++)
        for (int k = 0; k < D; k++) {
            for (int order = 0; order < 3; order++) back->turn[order][k][l] = s->turn[order][l][k];
            for (int i = 0; i < s->n; i++) back->turns[i][k][l] = s->turns[i][l][k];
        }
}

/* Directors that are coordinates from `at` on, or all of a frame; in the plane position and angle are. */
static void take_coordinates(int at, int from, const double q[N], const double v[N], const double a[N], struct chain *z) {
    int n = at + N_FRAME - from > z->n ? at + N_FRAME - from : z->n;
    if (D == 2) n = at + N_POSE;
    memset(z->z[SLOPES + z->n], 0, (size_t)(n - z->n) * sizeof z->z[0]), z->n = n;
    for (int c = from; c < (D == 2 ? D : N_FRAME); c++) {
        z->z[AT][c] = q[at + c - from], z->z[RATE][c] = v[at + c - from], z->z[MORE][c] = a[at + c - from];
        z->z[SLOPES + at + c - from][c] = 1.0;
    }
    if (D == 3) return;
    double angle = q[at + 2], rate = v[at + 2], more = a[at + 2], sine = sin(angle), cosine = cos(angle);
    double along[4] = {cosine, sine, -sine, cosine}, across[4] = {-sine, cosine, -cosine, -sine};
    for (int c = 0; c < 4; c++) {
        z->z[AT][D + c] = along[c], z->z[RATE][D + c] = rate * across[c], z->z[SLOPES + at + 2][D + c] = across[c];
        z->z[MORE][D + c] = more * across[c] - rate * rate * along[c];
    }
    z->angle = angle;
}

double place(const double q[N], const double v[N], const double a[N], struct chain nodes[N_NODES]) {
    struct chain joint, moved;
    struct motion s, back;
    double largest = 0.0;
    for (const struct body *b = tree; b < tree + N_TREE; b++) {
        struct chain *held = nodes + b->held, *base = nodes + b->base;
        if (b->kind == FREE)
            memset(base->z, 0, sizeof base->z), base->n = 0, take_coordinates(b->natural, 0, q, v, a, base);
        else {
            stand_before(b, &s);
            if (b->on < 0) { /* directors are those of the ground */
                memset(&moved, 0, sizeof moved);
                for (int k = 0; k < D; k++) moved.z[AT][D + D * k + k] = 1.0;
            }
            carry(b->on < 0 ? &moved : nodes + b->on, &s, &joint);
            if (b->kind == BALL) {
                *held = joint;
                for (int i = SLOPES; i < SLOPES + held->n; i++) memset(held->z[i] + D, 0, D * D * sizeof(double));
                take_coordinates(b->natural, D, q, v, a, held);
                for (int i = 0; i < SLOPES + held->n; i++)
                    for (int j = 0; j < D; j++)
                        for (int c = 0; c < D; c++) held->z[i][c] -= b->after[0][j] * held->z[i][D + D * j + c];
            } else {
                move(b, q, v, a, &s);
                carry(&joint, &s, &moved);
                stand_after(b, &s);
                carry(&moved, &s, held);
                held->angle += b->rest + (b->turning >= 0 ? q[b->turning] : 0.0);
            }
        }
        for (const struct face *f = faces + b->faces; f < faces + b->last_face && b->kind != FREE; f++)
            if (f->node == b->held) {
                double turned = deform(b, f, q, v, a, &s);
                largest = fmax(largest, fabs(turned));
                invert(&s, &back);
                carry(held, &back, base);
                base->angle -= D == 2 ? turned : 0.0;
            }
        for (const struct face *f = faces + b->faces; f < faces + b->last_face; f++) {
            if (f->node == b->held && b->kind != FREE) continue;
            double turned = deform(b, f, q, v, a, &s);
            largest = fmax(largest, fabs(turned));
            carry(base, &s, nodes + f->node);
            nodes[f->node].angle += D == 2 ? turned : 0.0;
        }
    }
    return largest;
}

static double dot(const double x[N_FRAME], const double y[N_FRAME]) {
    double total = 0.0;
    for (int c = 0; c < N_FRAME; c++) total += x[c] * y[c];
    return total;
}

/* Adds what a force on a frame does on coordinates, and the force itself to those on frames where they are wanted. */
static void project(const struct chain nodes[N_NODES], int number, const double force[N_FRAME], double r[N_ALL],
                    double (*on_frames)[N_FRAME]) {
    const struct chain *node = nodes + number;
    for (int i = 0; i < node->n; i++) r[i] += dot(force, node->z[SLOPES + i]);
    for (int c = 0; on_frames && c < N_FRAME; c++) on_frames[number][c] += force[c];
}

/* Adds the mass of a frame, a density of its vectors, to the matrix. */
static void add_mass(const struct chain *node, double (*density)[1 + D], double gain, struct matrix *m) {
    for (int i = 0; i < node->n; i++) {
        double moved[N_FRAME] = {0};
        for (int k = 0; k <= D; k++)
            for (int l = 0; l <= D; l++)
                for (int c = 0; c < D; c++) moved[D * k + c] += gain * density[k][l] * node->z[SLOPES + i][D * l + c];
        for (int j = 0; j <= i; j++) {
            double both = dot(moved, node->z[SLOPES + j]);
            m->a[i][j] += both;
            if (j < i) m->a[j][i] += both;
        }
    }
}

/* Moments of a deformed body: s_k = int rho w_k, J_kl = int rho w_k w_l, w_l' and w_l'' in place of the second, g_lk = int
   rho w_l dw_k / dxi, h = sum_kl d_l.d_k' int rho Psi_l Psi_k xi'. */
struct shaped { double s[3][D], j[3][D][D], g[D][D][MOST], h[MOST]; };

/* Where parts of a body's table begin. */
struct places { int fields, mixed, viscous, both, stiffness; };

static struct places places_of(const struct body *b) {
    const int *first = first_entries + b->rows;
    struct places at = {.fields = 1 + D + D * D};
    at.mixed = at.fields + D * b->n, at.viscous = at.mixed + D * D * b->n, at.both = at.viscous + b->n;
    at.stiffness = at.both + first[D * D * b->n + b->n] - first[D * D * b->n];
    return at;
}

static void shape_body(const struct body *b, const double *table, double spin[D][D], double x[3][MOST],
                       struct shaped *f) {
    const struct places at = places_of(b);
    const int n = b->n, *first = first_entries + b->rows, *column = columns + b->columns;
    double bent[D][D] = {{0}}, bending[D][D] = {{0}};
    memset(f, 0, sizeof *f);
    for (int k = 0; k < D; k++) {
        f->s[0][k] = table[1 + k];
        for (int i = 0; i < n; i++)
            for (int order = 0; order < 3; order++) f->s[order][k] += table[at.fields + k * n + i] * x[order][i];
    }
    for (int l = 0; l < D; l++)
        for (int k = 0; k < D; k++)
            for (int j = 0, row = (l * D + k) * n; j < n; j++) {
                double total = table[at.mixed + row + j], rate = 0.0;
                for (int e = first[row + j]; e < first[row + j + 1]; e++)
                    total += table[at.both + e] * x[0][column[e]], rate += table[at.both + e] * x[1][column[e]];
                f->g[l][k][j] = total;
                f->h[j] += spin[k][l] * rate;
            }
    for (int l = 0; l < D; l++)
        for (int k = 0; k < D; k++)
            for (int i = 0, row = D * D * n + n + (l * D + k) * n; i < (b->curved ? n : 0); i++) {
                double total = 0.0, rate = 0.0; /* int rho X_l chi_k xi */
                for (int e = first[row + i]; e < first[row + i + 1]; e++)
                    total += table[at.stiffness + e] * x[0][column[e]], rate += table[at.stiffness + e] * x[1][column[e]];
                f->g[l][k][i] += total;
                bent[l][k] += x[0][i] * total, bending[l][k] += x[1][i] * rate;
            }
    for (int l = 0; l < D; l++)
        for (int k = 0; k < D; k++) {
            /* g has all of X_l chi_k, and nothing of X_k chi_l: w_l w_k has half of both */
            f->j[0][l][k] = table[1 + D + l * D + k] + 0.5 * (bent[k][l] - bent[l][k]), f->j[2][l][k] = bending[l][k];
            for (int i = 0; i < n; i++) {
                f->j[0][l][k] += (table[at.mixed + (k * D + l) * n + i] + f->g[l][k][i]) * x[0][i];
                f->j[1][l][k] += f->g[l][k][i] * x[1][i], f->j[2][l][k] += f->g[l][k][i] * x[2][i];
            }
        }
}

/* Adds inertia, weight, elasticity and damping of a flexible body, and its tangents. */
static void add_flexible(const struct pgmp_model *m, const struct body *b, const double strengths[],
                         const struct chain nodes[N_NODES], const double q[N], const double v[N], const double a[N],
                         double gain_v, double gain_a, int fresh, struct matrix *matrix, double r[N_ALL],
                         double (*on_frames)[N_FRAME]) {
    const struct chain *node = nodes + b->base;
    const double *table = m->own.table + b->table, *z = node->z[AT] + D, *z1 = node->z[RATE] + D;
    const struct places at = places_of(b);
    const int n = b->n, *first = first_entries + b->rows + D * D * n, *column = columns + b->columns;
    double z2[N_FRAME], force[N_FRAME] = {0}, spin[D][D] = {{0}}, turned[D][D] = {{0}}, x[3][MOST], along[D] = {0};
    struct shaped f;
    for (int c = 0; c < N_FRAME; c++) z2[c] = node->z[MORE][c] + b->alpha * node->z[RATE][c];
    for (int k = 0; k < N_GRAVITY; k++)
        for (int c = 0; c < D; c++) z2[c] -= strengths[gravity_strengths[k]] * m->own.gravity[k][c];
    for (int i = 0; i < n; i++)
        x[0][i] = q[b->first + i], x[1][i] = v[b->first + i], x[2][i] = a[b->first + i] + b->alpha * v[b->first + i];
    for (int l = 0; l < D; l++)
        for (int c = 0; c < D; c++) {
            along[l] += z[D * l + c] * z2[c];
            for (int k = 0; k < D; k++)
                spin[l][k] += z[D * l + c] * z1[D * k + c], turned[l][k] += z2[D + D * l + c] * z[D * k + c];
        }
    shape_body(b, table, spin, x, &f);
    for (int c = 0; c < D; c++) {
        force[c] = table[0] * z2[c];
        for (int k = 0; k < D; k++) {
            double d = z[D * k + c], d1 = 2.0 * z1[D * k + c], d2 = z2[D + D * k + c];
            force[c] += d2 * f.s[0][k] + d1 * f.s[1][k] + d * f.s[2][k];
            force[D + D * k + c] += f.s[0][k] * z2[c];
            for (int l = 0; l < D; l++) /* int rho w_l (d_k'' w_k + 2 d_k' w_k' + d_k w_k'') */
                force[D + D * l + c] += d2 * f.j[0][l][k] + d1 * f.j[1][l][k] + d * f.j[2][l][k];
        }
    }
    project(nodes, b->base, force, r, on_frames);
    for (int i = 0; i < n; i++) {
        double total = 2.0 * f.h[i] + table[at.viscous + i] * x[1][i];
        for (int l = 0; l < D; l++) {
            total += table[at.fields + l * n + i] * along[l];
            for (int k = 0; k < D; k++) total += turned[l][k] * f.g[l][k][i];
        }
        for (int e = first[i]; e < first[i + 1]; e++)
            total += table[at.both + e] * x[2][column[e]] +
                     table[at.stiffness + e] * (x[0][column[e]] + b->beta * x[1][column[e]]);
        r[b->first + i] += total;
    }
    if (!fresh) return;
    double gain_m = gain_a + b->alpha * gain_v, stiffer = 1.0 + b->beta * gain_v, density[1 + D][1 + D];
    density[0][0] = table[0];
    for (int k = 0; k < D; k++) {
        density[0][1 + k] = density[1 + k][0] = f.s[0][k];
        for (int l = 0; l < D; l++) density[1 + k][1 + l] = f.j[0][k][l];
    }
    add_mass(node, density, gain_m, matrix);
    for (int i = 0; i < n; i++) {
        double push[N_FRAME] = {0};
        int own = b->first + i;
        for (int c = 0; c < D; c++)
            for (int k = 0; k < D; k++) {
                push[c] += gain_m * z[D * k + c] * table[at.fields + k * n + i];
                for (int l = 0; l < D; l++) push[D + D * l + c] += gain_m * z[D * k + c] * f.g[l][k][i];
            }
        for (int j = 0; j < node->n; j++) {
            double both = dot(push, node->z[SLOPES + j]);
            matrix->a[own][j] += both, matrix->a[j][own] += both;
        }
        for (int e = first[i]; e < first[i + 1]; e++)
            matrix->a[own][b->first + column[e]] += gain_m * table[at.both + e] + stiffer * table[at.stiffness + e];
        matrix->a[own][own] += gain_v * table[at.viscous + i];
    }
}

/* Loads on frames and on coordinates. */
static void add_loads(const struct pgmp_model *m, const double strengths[], const struct chain nodes[N_NODES], double r[N_ALL],
                      double (*on_frames)[N_FRAME]) {
    for (const struct push *f = pushes; f < pushes + N_PUSHES; f++) {
        double value = -f->value * m->own.loads[f->term] * strengths[strength_of_load[load_of_term[f->term]]];
        double force[N_FRAME] = {0};
        if (f->node < 0) {
            r[f->component] += value;
            continue;
        }
        if (D == 2 && f->component == D)
            for (int c = 0; c < D; c++) force[D + c] = value * nodes[f->node].z[AT][2 * D + c];
        else
            force[f->component] = value;
        project(nodes, f->node, force, r, on_frames);
    }
}

void attach_column(const struct side *side, const struct chain nodes[N_NODES], int column, double z[N_FRAME]) {
    memset(z, 0, N_FRAME * sizeof *z);
    if (side->slot < 0) {
        for (int c = 0; c < N_FRAME && column == AT; c++) z[c] = c < D ? side->point[c] : (c - D) % (D + 1) == 0;
        return;
    }
    const struct chain *node = nodes + side->slot;
    if (column >= SLOPES + node->n) return;
    memcpy(z, node->z[column], N_FRAME * sizeof *z);
    for (int j = 0; j < D; j++)
        for (int c = 0; c < D; c++) z[c] += side->arm[j] * z[D + D * j + c];
}

/* Adds a term of a constraint at its multiplier to the residual, and its slopes to the matrix; returns its value, and what
   of its acceleration is not C y'' in `drift`. */
static double add_term(const struct term *term, double near, double force, double scale, const struct chain nodes[N_NODES],
                       int fresh, struct matrix *matrix, double r[N_ALL], double *drift, double (*on_frames)[N_FRAME]) {
    const struct side *a = &term->statement.a, *b = &term->statement.b;
    double z[SLOPES][2 * N_FRAME], gradient[2 * N_FRAME], hessian[2 * N_FRAME][2 * N_FRAME], slope, bend, rate = 0.0;
    for (int k = 0; k < SLOPES; k++)
        attach_column(a, nodes, k, z[k]), attach_column(b, nodes, k, z[k] + N_FRAME);
    double value = of_term(term, evaluate_statement(&term->statement, z[AT], near, gradient, hessian), &slope, &bend);
    for (int c = 0; c < 2 * N_FRAME; c++) {
        rate += gradient[c] * z[RATE][c];
        *drift += slope * gradient[c] * z[MORE][c];
        for (int d = 0; d < 2 * N_FRAME; d++) *drift += slope * z[RATE][c] * hessian[c][d] * z[RATE][d];
    }
    *drift += bend * rate * rate;
    for (int end = 0; on_frames && end < 2; end++) {
        const struct side *side = end ? b : a;
        for (int c = 0; c < N_FRAME && side->slot >= 0; c++) {
            double arm = c < D ? 1.0 : side->arm[c / D - 1], pull = arm * gradient[end * N_FRAME + c % D];
            on_frames[side->slot][c] += force * slope * (c < D ? pull : pull + gradient[end * N_FRAME + c]);
        }
    }
    for (int i = 0; i < N; i++) {
        double own = 0.0, moved[2 * N_FRAME];
        attach_column(a, nodes, SLOPES + i, moved), attach_column(b, nodes, SLOPES + i, moved + N_FRAME);
        for (int c = 0; c < 2 * N_FRAME; c++) own += slope * gradient[c] * moved[c];
        r[i] += force * own;
        if (fresh) matrix->a[i][N + term->row] += scale * own, matrix->a[N + term->row][i] += scale * own;
    }
    return value;
}

/* What the angle of a statement is near to: the plane's nodes count turns. */
static double near_of(const struct statement *s, const struct chain nodes[N_NODES], double tracked) {
    if (D == 3) return tracked;
    return (s->b.slot < 0 ? 0.0 : nodes[s->b.slot].angle) - (s->a.slot < 0 ? 0.0 : nodes[s->a.slot].angle);
}

/* Adds the constraints; their rows become how far they are off, or, where `accelerating`, their accelerations. */
static void add_constraints(const struct pgmp_model *m, const struct acting *now, const double forces[], double gain_a,
                            int accelerating, const struct chain nodes[N_NODES], int fresh, struct matrix *matrix,
                            double r[N_ALL], double (*on_frames)[N_FRAME]) {
    const double scale = gain_a * TYPICAL_MASS;
    int t = 0;
    for (int row = 0; row < N_LEFT; row++) {
        const int motion = bonds[row].motion;
        double off = -bonds[row].wanted - (motion < 0 ? 0.0 : now->motions[motion][0]);
        double drift = motion < 0 ? 0.0 : -now->motions[motion][2];
        for (; t < N_CONSTRAINT_TERMS && constraints[t].row == row; t++) {
            const struct term *term = constraints + t;
            double tracked = motion < 0 ? line_of(&term->statement, m->own.turned) : now->motions[motion][0];
            if (term->left) tracked = -off / term->factor;
            double near = near_of(&term->statement, nodes, tracked);
            off += add_term(term, near, forces[row], scale, nodes, fresh, matrix, r, &drift, on_frames);
        }
        r[N + row] = scale * (accelerating ? drift / LARGE : off);
    }
}

/* Eliminates with pivoting. */
static void factorise(struct matrix *m) {
    for (int k = 0; k < N_ALL; k++) {
        int best = k;
        for (int i = k + 1; i < N_ALL; i++)
            if (fabs(m->a[i][k]) > fabs(m->a[best][k])) best = i;
        m->order[k] = best;
        for (int j = 0; j < N_ALL && best != k; j++) {
            double kept = m->a[k][j];
            m->a[k][j] = m->a[best][j], m->a[best][j] = kept;
        }
        for (int i = k + 1; i < N_ALL; i++) {
            double factor = m->a[i][k] /= m->a[k][k];
            for (int j = k + 1; factor != 0.0 && j < N_ALL; j++) m->a[i][j] -= factor * m->a[k][j];
        }
    }
}

static void solve(const struct matrix *m, double x[N_ALL]) {
    for (int k = 0; k < N_ALL; k++) {
        double kept = x[m->order[k]];
        x[m->order[k]] = x[k], x[k] = kept;
    }
    for (int i = 0; i < N_ALL; i++)
        for (int j = 0; j < i; j++) x[i] -= m->a[i][j] * x[j];
    for (int i = N_ALL - 1; i >= 0; i--) {
        for (int j = i + 1; j < N_ALL; j++) x[i] -= m->a[i][j] * x[j];
        x[i] /= m->a[i][i];
    }
}

/* The residual, and the matrix; rows of coordinates whose motion is given are for what they are off. */
static void evaluate(struct pgmp_model *m, const struct acting *now, const double q[N], const double v[N],
                     const double a[N], const double forces[], double gain_v, double gain_a, int fresh, struct iterate kept[],
                     struct response *response, struct matrix *matrix, double r[N_ALL], struct chain nodes[N_NODES],
                     double (*on_frames)[N_FRAME]) {
    place(q, v, a, nodes);
    memset(r, 0, N_ALL * sizeof *r);
    if (fresh) memset(matrix->a, 0, sizeof matrix->a);
    for (int k = 0; k < N_MASSES; k++) {
        const struct chain *node = nodes + masses[k].node;
        double force[N_FRAME] = {0}, alpha = masses[k].alpha;
        for (int i = 0; i <= D; i++)
            for (int j = 0; j <= D; j++)
                for (int c = 0; c < D; c++)
                    force[D * i + c] += m->own.densities[k][i][j] * (node->z[MORE][D * j + c] + alpha * node->z[RATE][D * j + c]);
        project(nodes, masses[k].node, force, r, on_frames);
        if (fresh) add_mass(node, m->own.densities[k], gain_a + alpha * gain_v, matrix);
    }
    for (const struct body *b = tree; b < tree + N_TREE; b++)
        if (b->table >= 0)
            add_flexible(m, b, now->strengths, nodes, q, v, a, gain_v, gain_a, fresh, matrix, r, on_frames);
    add_loads(m, now->strengths, nodes, r, on_frames);
    add_constraints(m, now, forces, gain_a, gain_a == LARGE, nodes, fresh, matrix, r, on_frames);
    add_actions(m, now->strengths, q, v, gain_v, fresh, kept, 0, response, r, matrix, 0, 0);
}

/* Puts a row of the matrix to that of a coordinate alone. */
static void give(const struct drive *d, double off, double scale, int fresh, struct matrix *matrix, double r[N_ALL]) {
    for (int j = 0; fresh && j < N_ALL; j++) matrix->a[d->coordinate][j] = j == d->coordinate ? scale : 0.0;
    r[d->coordinate] = scale * off;
}

void correct(struct pgmp_model *m, const struct acting *now, const double q[N], const double v[N], const double a[N],
             const double forces[], double gain_v, double gain_a, int fresh, struct iterate kept[],
             struct response *response, struct matrix *matrix, double r[N_ALL]) {
    const double scale = gain_a * TYPICAL_MASS;
    struct chain nodes[N_NODES];
    evaluate(m, now, q, v, a, forces, gain_v, gain_a, fresh, kept, response, matrix, r, nodes, 0);
    for (const struct drive *d = drives; d < drives + N_DRIVES; d++)
        give(d, q[d->coordinate] - d->sign * now->motions[d->measured][0], scale, fresh, matrix, r);
    if (fresh) factorise(matrix);
    solve(matrix, r);
    for (int k = N; k < N_ALL; k++) r[k] *= scale; /* of the multipliers */
}

/* Accelerations with which constraints are obeyed, and multipliers. */
static void accelerate(struct pgmp_model *m, const struct acting *now, const double q[N], const double v[N], double a[N],
                       double left[]) {
    static const double at_rest[N_ALL];
    double r[N_ALL];
    struct chain nodes[N_NODES];
    struct matrix matrix;
    evaluate(m, now, q, v, at_rest, at_rest, 0.0, LARGE, 1, 0, 0, &matrix, r, nodes, 0);
    for (const struct drive *d = drives; d < drives + N_DRIVES; d++)
        give(d, -d->sign * now->motions[d->measured][2] / LARGE, LARGE * TYPICAL_MASS, 1, &matrix, r);
    factorise(&matrix);
    solve(&matrix, r);
    for (int i = 0; i < N; i++) a[i] = -LARGE * r[i];
    for (int k = N; k < N_ALL; k++) left[k - N] = -LARGE * TYPICAL_MASS * r[k];
}

void find_accelerations(struct pgmp_model *m, const struct acting *now) {
    double left[AT_LEAST_ONE(N_LEFT)];
    accelerate(m, now, m->q, m->v, m->a, left);
}

/* The least change dv in the norm of the mass with which C v = c_t, of which a step's worth is an acceleration, and then the
   accelerations at these velocities. */
void project_motion(struct pgmp_model *m, const struct acting *now, double h, const double q[N], double v[N], double a[N]) {
    static const double at_rest[N_ALL];
    const double scale = LARGE * TYPICAL_MASS;
    double r[N_ALL], left[AT_LEAST_ONE(N_LEFT)], off[N_ALL] = {0};
    struct chain nodes[N_NODES];
    struct matrix matrix;
    evaluate(m, now, q, v, at_rest, at_rest, 0.0, LARGE, 1, 0, 0, &matrix, r, nodes, 0);
    for (int row = 0; row < N_LEFT; row++) {
        for (int i = 0; i < N; i++) off[N + row] += matrix.a[N + row][i] * v[i];
        off[N + row] -= bonds[row].motion < 0 ? 0.0 : scale * now->motions[bonds[row].motion][1];
        off[N + row] /= h * LARGE;
    }
    for (const struct drive *d = drives; d < drives + N_DRIVES; d++)
        give(d, (v[d->coordinate] - d->sign * now->motions[d->measured][1]) / (h * LARGE), scale, 1, &matrix, off);
    factorise(&matrix);
    solve(&matrix, off);
    for (int i = 0; i < N; i++) v[i] -= h * LARGE * off[i];
    accelerate(m, now, q, v, a, left);
}

void find_residual(struct pgmp_model *m, const struct acting *now, const double *own, struct chain nodes[N_NODES],
                   double on_frames[N_NODES][N_FRAME], double left[], double r[N_ALL]) {
    double a[N];
    memcpy(a, m->a, sizeof a);
    for (int k = 0; own && k < N_LEFT; k++) left[k] = own[k];
    if (!own) accelerate(m, now, m->q, m->v, a, left);
    memset(on_frames, 0, N_NODES * sizeof *on_frames);
    evaluate(m, now, m->q, m->v, a, left, 0.0, 1.0, 0, 0, 0, 0, r, nodes, on_frames);
}

void weigh_tables(struct pgmp_model *m) {
    double of_terms[N_TERMS], given[1], *into[3] = {m->own.table, m->own.densities[0][0], m->own.gravity[0]};
    weigh(m->parameters, of_terms, m->own.loads, m->laws, given, m->controls);
    const int sizes[3] = {N_WORDS, N_MASSES * (1 + D) * (1 + D), N_GRAVITY * D};
    for (int part = 0; part < 3; part++)
        for (int e = 0; e < sizes[part]; e++) {
            into[part][e] = 0.0;
            for (int t = 0; t < N_TERMS; t++) {
                const double *of_term[3] = {moments[t], densities[t][0][0], gravity[t][0]};
                into[part][e] += of_terms[t] * of_term[part][e];
            }
        }
}

void stand_at_start(struct pgmp_model *m) {
    memcpy(m->q, start_coordinates, sizeof m->q), memcpy(m->v, start_rates, sizeof m->v);
    memcpy(m->own.turned, start_turned, sizeof m->own.turned);
}

/* The scheme integrates given motions: see `give`. */
void follow_motions(const struct acting *now, double q[N], double v[N], double a[N]) { (void)now, (void)q, (void)v, (void)a; }

int leaves_tables(const struct pgmp_model *m) { return m->validity & PGMP_OUT_OF_RANGE; }

static void see(const double q[N], const double v[N], const double a[N], struct frame nodes[N_NODES]) {
    struct chain chains[N_NODES];
    place(q, v, a, chains);
    for (int k = 0; k < N_NODES; k++) memcpy(nodes[k].z, chains[k].z[AT], sizeof nodes[k].z), nodes[k].angle = chains[k].angle;
}

/* Angles nearest to those before, of what takes note of turns. */
static void turn_on(const struct statement *s, const struct chain nodes[N_NODES], double *turned) {
    double z[2 * N_FRAME], gradient[2 * N_FRAME];
    attach_column(&s->a, nodes, AT, z), attach_column(&s->b, nodes, AT, z + N_FRAME);
    *turned = evaluate_statement(s, z, near_of(s, nodes, *turned), gradient, 0);
}

void count_turns(struct pgmp_model *m, const double q[N]) {
    static const double at_rest[N];
    struct chain nodes[N_NODES];
    place(q, at_rest, at_rest, nodes);
    for (int k = 0; k < R; k++) turn_on(coordinates + k, nodes, m->own.turned + k);
    for (int k = 0; k < N_PARTS; k++) turn_on(&action_parts[k].term.statement, nodes, m->own.turned + R + k);
}

void place_holders(const struct pgmp_model *m, const double q[N], struct moving nodes[], double turned[]) {
    static const double at_rest[N];
    struct chain chains[N_NODES];
    place(q, at_rest, at_rest, chains);
    memset(nodes, 0, N_ACTION_NODES * sizeof *nodes);
    for (int k = 0; k < N_ACTION_NODES; k++)
        for (int c = 0; c < N_FRAME; c++) {
            const struct chain *node = chains + action_nodes[k];
            nodes[k].frame[c] = node->z[AT][c];
            for (int i = 0; i < node->n; i++) nodes[k].jacobian[c][i] = node->z[SLOPES + i][c];
            if (c < D) nodes[k].own[c][c] = 1.0;
        }
    for (int k = 0; k < N_ACTION_NODES; k++) /* what turns a node along the ground's axes turns its directors */
        for (int j = D; j < N_FRAME; j += D)
            for (int turn = D; turn < N_DOFS; turn++) {
                const int one = D == 2 ? 0 : (turn + 1) % 3, other = D == 2 ? 1 : (turn + 2) % 3;
                nodes[k].own[j + other][turn] = nodes[k].frame[j + one], nodes[k].own[j + one][turn] = -nodes[k].frame[j + other];
            }
    for (int k = 0; k < N_PARTS; k++) turned[k] = near_of(&action_parts[k].term.statement, chains, m->own.turned[R + k]);
}

void add_tangent(double tangent[N][N], struct matrix *matrix) {
    for (int i = 0; i < N; i++)
        for (int j = 0; j < N; j++) matrix->a[i][j] += 0.5 * (tangent[i][j] + tangent[j][i]);
}

void look_at(const struct pgmp_model *m, struct look *look) {
    struct chain nodes[N_NODES];
    look->rotation = place(m->q, m->v, m->a, nodes), look->speed = look->pull = 0.0;
    for (int k = 0; k < N_NODES; k++)
        for (int c = 0; c < N_FRAME; c++) {
            double unit = c < D ? 1.0 / SIZE : 1.0;
            look->speed = fmax(look->speed, unit * fabs(nodes[k].z[RATE][c]));
            look->pull = fmax(look->pull, unit * fabs(nodes[k].z[MORE][c]));
        }
}

double find_rotation(const struct pgmp_model *m, const struct look *look) {
    (void)m;
    return look->rotation;
}

void find_pace(const struct pgmp_model *m, const struct look *look, double *speed, double *pull) {
    (void)m;
    *speed = fmax(*speed, look->speed), *pull = fmax(*pull, DEPTH > 1 ? look->pull : 0.0);
}

void see_nodes(const struct pgmp_model *m, const struct look *look, double after, double theta[R], struct frame nodes[]) {
    double half = DEPTH > 1 ? 0.5 * after * after : 0.0, q[N];
    (void)look;
    for (int i = 0; i < N; i++) q[i] = m->q[i] + after * m->v[i] + half * m->a[i];
    see(q, m->v, m->a, nodes);
    memcpy(theta, m->own.turned, R * sizeof *theta);
}

void place_bodies(const double theta[R], const struct frame nodes[], struct frame bodies[N_BODIES]) {
    double poses[N_BODIES][N_POSE];
    for (int k = 0; k < N_BODIES; k++) {
        const struct frame *node = nodes + body_nodes[k];
        memcpy(poses[k], node->z, sizeof poses[k]);
        if (D == 2) poses[k][2] = node->angle;
        for (int j = 0; j < D; j++)
            for (int c = 0; c < D; c++) poses[k][c] -= body_centres[k][j] * node->z[D + D * j + c];
    }
    /* they begin at poses of deformed bodies, as near as that may be */
    for (int k = 0; k < POSES; k++) close_loops(theta, poses);
    for (int k = 0; k < N_BODIES; k++) frame_of_pose(poses[k], bodies[k].z), bodies[k].angle = D == 2 ? poses[k][2] : 0.0;
}
