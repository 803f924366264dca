/* Constant tables of the model, in tables.c, and what the parts of the model take of one another.

   written by pgmp_petsc */

#ifndef PGMP_TABLES_H
#define PGMP_TABLES_H

#include "model.h"

#define N_STENCIL TENSOR(4)

struct axis { double lower, step; int n_cells, n_rows, periodic, b_spline; };
/* A piece of a function of time: a polynomial of t - origin, of the fourth degree for places of a base, and a sinusoid: amplitude, rate, phase. */
struct piece { double begin, origin, cubic[5], wave[3]; };
/* A point of a body: slot of its node among the nodes of the tables, -1 on the ground; point and arm in its frame. */
struct side { int slot, body; double point[D], arm[D]; };
/* A statement about two points; an angle in space is near turns[0] + turns[1] theta_1 + ... */
struct statement { int kind; double turns[1 + R], axes[3][D]; struct side a, b; };
/* A factor times a statement, or times the spline of it: row of the closure that it adds to, or local effect, first and
   number of pieces, and the coordinate that an angle in the closure is near to, -1 where that is what the others leave of
   the row's value. */
struct term { int row, first, n_pieces, near; double factor; struct statement statement; };
struct spline_piece { double begin, end, cubic[4]; };
/* A law of a measure s. About is, in an iteration, the rate at which the law was evaluated last, NAN before that. One
   whose iterates jump between two branches is taken up from zero there, and the next about is NAN. Behind these is how
   far each edge of the law is crossed. */
enum { LAW_FORCE, LAW_STIFFNESS, LAW_DAMPING, LAW_ABOUT, LAW_END };
typedef void law_function(const double p[], double amplitude, double s, double rate, double about, double found[]);
/* A local effect: number of the first part of its measure, which is the sum of them, and of the last one; of its strength,
   and of its first edge among those of all; how many edges its law has; whose measure the law is of, and
   whether it rubs. One that leads
   does nothing but measure, for the law of the one behind it. */
enum { ALONE, LEADS, LED, BY_LOAD };
struct action { int first, last, strength, edge, n_edges, role, controlled, rubs; law_function *law; };
/* Where the law of an effect was evaluated last in an iteration: about as above, and of one that `rubs`, whose iterates are
   taken up from zero, what its rate follows from, its measure, rate and amplitude, and its force and damping there. */
struct iterate { double about, along[N], s, rate, amplitude, force, damping; };
/* A law of a controller, of its parameters, of time, reference and its rate, motions and their rates, and of its states:
   the force, its slopes by motions, rates and states, and the same of the rate of each state; and its first states. */
typedef void control_function(const double p[], const double x[], const double z[], double found[]);
/* A controller: its first number among those beside; the first of the actions that it acts by, one for each motion that it
   measures; after how many steps it is sampled, 0 of a continuous one; and its reference, a function of time, -1 where it
   is a parameter of the law. */
struct control { int n_states, n_motions, column, row, every, function, reference; control_function *law, *start; };
/* Responses of controllers: who responds, at what time, to which references; c, kappa, states, rates and forces. */
enum { CONTINUOUS, DUE, EVERYONE };
#define N_SLOPES (1 + 2 * MOST_MOTIONS)
struct response {
    int who;
    double time, kappa, references[AT_LEAST_ONE(N_CONTROLS)][2], forces[AT_LEAST_ONE(N_CONTROLS)];
    double c[AT_LEAST_ONE(N_BESIDE)], z[AT_LEAST_ONE(N_BESIDE)], rates[AT_LEAST_ONE(N_BESIDE)];
};
/* A part of a measure: numbers of its nodes among those of the effects, -1 on the ground. */
struct part { int a, b; double winding[R]; struct term term; };
/* A component of a force or moment in a joint between points a and b: its terms, the first axis of the joint in the
   frame of a, 1 on b's body and -1 on a's; and a term: a gap, and a factor of a statement. */
struct force { int first, last, component, turning, in_body; double sign, axis[D]; struct side a, b; };
/* A multiplier: of a gap, or behind these of the law of an effect. */
struct force_term { int gap; double factor; struct statement statement; };
struct reading { int kind, axis, in_body; double origin; struct statement statement; };

enum { MEASURE, ROTATION, POSITION, DEFORMATION };

extern const struct axis axes[R], rigid_axes[R], fine_axes[R], branch_axes[R];
/* Rows of the rigid inertia; numbers of those that reach into a cell along a coordinate, and what makes the coefficients
   of its polynomials of them. */
extern const double rigid_table[RIGID_ROWS][N_TERMS][PACKED(R)], rigid_matrices[R][RIGID_CELLS][8][RIGID_REACH];
extern const int rigid_stencils[R][RIGID_CELLS][RIGID_REACH];
extern const double terms_table[N_ROWS][N_TERMS][END];
extern const double loads_table[AT_LEAST_ONE(N_LOAD_TERMS)][N_ROWS][LOAD_END];
extern const double shapes_table[N_ROWS][N_FACTORS][N_SHAPES];
extern const double branch_table[N_BRANCH_PARTS][N_BRANCH][N_BODIES][N_POSE];
extern const double actions_table[AT_LEAST_ONE(N_FINE)][AT_LEAST_ONE(N_ACTION_ENTRIES)];
extern const double strength_sizes[];
extern const int load_of_term[], strength_of_load[], action_nodes[], function_pieces[];
extern const double parameter_values[], parameter_lower[], parameter_upper[], scale[], winding[R][N_BODIES];
extern const double node_points[AT_LEAST_ONE(N_NODES)][D], start_coordinates[N], start_rates[N];
extern const double closure_wanted[];
extern const int node_bodies[];
extern const struct piece pieces[];
extern const struct reading readings[];
extern const struct force forces[];
extern const struct force_term force_terms[];
extern const double gap_table[N_ROWS][AT_LEAST_ONE(N_GAPS)][AT_LEAST_ONE(N_GAP_ENTRIES)];
extern const double gap_changes[N_ROWS][AT_LEAST_ONE(N_GAPS)][AT_LEAST_ONE(N_GAP_CHANGES)];
extern const struct action actions[];
extern const struct part action_parts[];
extern const struct control controls[];
extern const int control_actions[];
extern const double control_origins[];
extern const struct statement coordinates[R];
extern const struct term closure[];
extern const struct spline_piece spline_pieces[];
void weigh(const double *p, double *terms, double *loads, double (*laws)[N_LAW], double *given,
           double (*controls)[AT_LEAST_ONE(N_CONTROL)]);
void weigh_gaps(const double *p, double *weights);
/* Makes outputs of readings, places of bases and forces, each with rate and acceleration, the time and the parameters. */
void combine(double time, const double *p, double (*bases)[3], double (*readings)[3], double (*forces)[3],
             double outputs[]);

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

/* Frame of a point: position and directors, in the plane the angle too, which counts turns. */
struct frame { double z[N_FRAME], angle; };

int locate(const struct axis *axis, double theta, double *place);
void find_stencil(const struct axis of[R], const double theta[R], struct stencil *stencil);
void interpolate(struct pgmp_model *m, const struct stencil *stencil, const double theta[R],
                 const double strengths[], struct terms *t);
void add_rows(const struct stencil *stencil, int n_parts, int n, const double *table, double *found);
double evaluate_piece(int function, double time, double since, double rates[2]);

void evaluate_lagrangian(const struct terms *t, const double q[N], const double rate[N], const double rates[N],
                         double gain_v, double gain_a, int fresh, double r[N], struct matrix *matrix);
void add_actions(const struct pgmp_model *m, const struct stencil *stencil, const double strengths[],
                 const double q[N], const double v[N], double gain_v, int fresh, struct iterate kept[],
                 double depths[],
                 struct response *response, double r[N], struct matrix *matrix,
                 double forces[], double loads[][N_DOFS]);
int bends(const struct pgmp_model *m, const struct iterate kept[], const double v[N]);
void respond(const struct pgmp_model *m, double motions[][2], struct response *at, double given[][3]);
void begin_response(const struct pgmp_model *m, double h, double time, struct response *at);
void begin_sampling(const struct pgmp_model *m, int who, double time, struct response *at);
void follow_response(struct pgmp_model *m, const struct response *at);
int jumps(const struct pgmp_model *m);
void eliminate(struct matrix *matrix);
void solve(const struct matrix *matrix, double x[N]);

double evaluate_statement(const struct statement *s, const double z[2 * N_FRAME], double turned, double gradient[],
                          double (*hessian)[2 * N_FRAME]);
void turn_frame(const double rigid[N_FRAME], const double moved[N_DOFS], const double point[D], struct frame *frame);
void attach(const struct side *side, const struct frame nodes[], struct frame *frame);
double of_term(const struct term *term, double s, double *slope, double *bend);
/* Forces in joints, and behind them what motions take, of the state with its accelerations. */
void find_forces(struct pgmp_model *m, const double strengths[], const struct frame nodes[], double found[][3]);
void find_strengths(const struct pgmp_model *m, double time, double since, double strengths[]);
void place_bodies(const double theta[R], double open, struct frame bodies[N_BODIES]);

#endif
