/* A reduced model: its tables over the rigid coordinates, and what is made of them.

   written by pgmp_petsc */

#ifndef PGMP_EQUATIONS_H
#define PGMP_EQUATIONS_H

/* R rigid coordinates theta (rad) before M flexible ones delta, the last N_GIVEN of them constants: how far joints are
   off */
#define N (R + M)
#define N_ALL N
#define N_PAIRS (SECOND_ORDER ? PACKED(M) : 0)
#define N_FACTORS (M + N_PAIRS)
#define TENSOR(n) (R == 1 ? (n) : R == 2 ? (n) * (n) : (n) * (n) * (n)) /* of each coordinate n */
#define RIGID_POWERS TENSOR(8)
#define SYMMETRIC 0 /* but for the flexible block, which takes means, see add_tangent */

enum {
    COUPLING = PACKED(N),
    STIFFNESS = COUPLING + PACKED(R) * M,
    CUBIC = STIFFNESS + PACKED(M),
    SWING = CUBIC + (SECOND_ORDER ? M * (M + 1) * (M + 2) / 6 : 0),
    GYROSCOPIC = SWING + (SECOND_ORDER ? PACKED(R) * PACKED(M) : 0),
    DRIVEN = GYROSCOPIC + (SECOND_ORDER ? R * (M * (M - 1) / 2) : 0),
    DAMPING = DRIVEN + (DRIVEN_CURVATURE ? R * PACKED(M) : 0),
    END = DAMPING + (STRUCTURAL_DAMPING ? PACKED(N) : 0),
    LOAD_END = N + (SECOND_ORDER ? PACKED(M) : 0)
};

struct own {
    double rigid_rows[RIGID_ROWS][PACKED(R)], terms[N_ROWS][END], loads[AT_LEAST_ONE(N_LOADS)][N_ROWS][LOAD_END];
    /* polynomials of the rigid inertia in the cell that it was asked for last, and the number of it, -1 for none */
    double rigid[RIGID_POWERS][PACKED(R)];
    int rigid_cell;
};

#ifdef PGMP_TABLES_H /* what is no concern of those who call the model */

struct pgmp_model;

#define N_STENCIL TENSOR(4)

extern const struct axis axes[R], rigid_axes[R], fine_axes[R];
/* Rows of the rigid inertia; numbers of those that reach into a cell along a coordinate, and what makes the coefficients
   of its polynomials of them. */
extern const double rigid_table[RIGID_ROWS][N_TERMS][PACKED(R)], rigid_matrices[R][RIGID_CELLS][8][RIGID_REACH];
extern const int rigid_stencils[R][RIGID_CELLS][RIGID_REACH];
extern const double terms_table[N_ROWS][N_TERMS][END];
extern const double loads_table[AT_LEAST_ONE(N_LOAD_TERMS)][N_ROWS][LOAD_END];
extern const double shapes_table[N_ROWS][N_FACTORS][N_SHAPES];
extern const double branch_table[N_BRANCH_PARTS][N_BRANCH][N_BODIES][N_POSE];
extern const double actions_table[AT_LEAST_ONE(N_FINE)][AT_LEAST_ONE(N_ACTION_ENTRIES)];
extern const double winding[R][N_BODIES], node_points[AT_LEAST_ONE(N_NODES)][D];
extern const int node_bodies[];
extern const double gap_table[N_ROWS][AT_LEAST_ONE(N_GAPS)][AT_LEAST_ONE(N_GAP_ENTRIES)];
extern const double gap_changes[N_ROWS][AT_LEAST_ONE(N_GAPS)][AT_LEAST_ONE(N_GAP_CHANGES)];
void weigh_gaps(const double *p, double *weights);

/* Rows of a table over the coordinates, with their weights for the value and for the derivative with each of them. */
struct stencil { int rows[N_STENCIL]; double weights[1 + R][N_STENCIL]; };
/* The weights along one coordinate, and their first and second derivatives. */
void find_along(const struct axis *axis, double theta, int rows[4], double weights[3][4]);

/* What is evaluated at one place: value first, then the derivatives. */
struct terms {
    double rigid[1 + R][PACKED(R)], table[1 + R][END], load[1 + R][LOAD_END];
};

/* Iteration matrix [[corner, row], [column, factor + skew]]; factor and skew are packed lower triangles. */
struct matrix {
    double factor[AT_LEAST_ONE(PACKED(M))], corner[R][R], column[R][AT_LEAST_ONE(M)], row[R][AT_LEAST_ONE(M)];
    double skew[AT_LEAST_ONE(PACKED(M))];
};

/* Displacements of the nodes in body frames, their rates and accelerations, as far as outputs read them. */
struct look { double moved[3][N_SHAPES]; };

int locate(const struct axis *axis, double theta, double *place);
void find_stencil(const struct axis of[R], const double theta[R], struct stencil *stencil);
void interpolate(struct pgmp_model *m, const struct stencil *stencil, const double theta[R],
                 const double strengths[], struct terms *t);
void add_rows(const struct stencil *stencil, int n_parts, int n, const double *table, double *found);
void evaluate_lagrangian(const struct terms *t, const double q[N], const double rate[N], const double rates[N],
                         double gain_v, double gain_a, int fresh, double r[N], struct matrix *matrix);
void eliminate(struct matrix *matrix);
void solve(const struct matrix *matrix, double x[N]);

#endif

#endif
