/* Constant tables of the model, in tables.c, and what the parts of the model take of one another.

   written by pgmp_petsc */

#ifndef PGMP_TABLES_H
#define PGMP_TABLES_H

struct axis { double lower, step; int n_cells, n_rows, periodic, b_spline; };

#include "model.h"

/* A piece of a function of time: a polynomial of t - origin, of the fourth degree for places of a base, and a sinusoid: amplitude, rate, phase. */
struct piece { double begin, origin, cubic[5], wave[3]; };
/* A point of a body: slot of its node among the nodes of the tables, -1 on the ground; point and arm in its frame. */
struct side { int slot, body; double point[D], arm[D]; };
/* A statement about two points; an angle in space is near turns[0] + turns[1] theta_1 + ... */
struct statement { int kind; double turns[1 + R], axes[3][D]; struct side a, b; };
/* A factor times a statement, or times the spline of it: row of the closure that it adds to, or local effect, first and
   number of pieces, and whether an angle is near to what the others leave of the row's value. */
struct term { int row, first, n_pieces, left; double factor; struct statement statement; };
struct spline_piece { double begin, end, cubic[4]; };
/* A law of a measure s. About is, in an iteration, the rate at which the law was evaluated last, NAN before that. One
   whose iterates jump between two branches is taken up from zero there, and the next about is NAN. Behind these is how
   far each edge of the law is crossed. */
enum { LAW_FORCE, LAW_STIFFNESS, LAW_DAMPING, LAW_ABOUT, LAW_END };
typedef void law_function(const double p[], double amplitude, double s, double rate, double about, double found[]);
/* A local effect: number of the first part of its measure, which is the sum of them, and of the last one; of its strength,
   and of its first edge among those of all; how many edges its law has; whose measure the law is of, and
   whether its law bends over the rate. One that leads does nothing but measure, for the law of the one behind it. */
enum { ALONE, LEADS, LED, BY_LOAD };
struct action { int first, last, strength, edge, n_edges, role, controlled, bends; law_function *law; };
/* Where the law of an effect was evaluated last in an iteration: about as above, and of one that bends what its rate
   follows from, its measure, rate and amplitude, and its force, stiffness and damping there. */
struct iterate { double about, along[N], s, rate, amplitude, force, stiffness, damping; };
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
    int who, taken_up; /* whether a force was taken up between two iterates */
    double time, kappa, references[AT_LEAST_ONE(N_CONTROLS)][2], forces[AT_LEAST_ONE(N_CONTROLS)];
    double c[AT_LEAST_ONE(N_BESIDE)], z[AT_LEAST_ONE(N_BESIDE)], rates[AT_LEAST_ONE(N_BESIDE)];
    double about[AT_LEAST_ONE(N_CONTROLS)][N_SLOPES]; /* motions and rates of the iterate before, none where no number */
    double before[AT_LEAST_ONE(N_CONTROLS)][N_SLOPES]; /* forces and slopes of that */
};
/* A part of a measure: numbers of its nodes among those of the effects, -1 on the ground. */
struct part { int a, b; double winding[R]; struct term term; };
/* A component of a force or moment in a joint between points a and b: its terms, the first axis of the joint in the
   frame of a, 1 on b's body and -1 on a's. The row of a term is its multiplier's: of a gap, or behind these of the law of
   an effect. */
struct force { int first, last, component, turning, in_body; double sign, axis[D]; struct side a, b; };
/* What is counted over a run: number of its output, of the parts of its curve, and the longest life, 0 of a damage. */
struct count { int output, n_parts; double run_out; };
struct reading { int kind, axis, in_body; double origin; struct statement statement; };

enum { MEASURE, ROTATION, POSITION, DEFORMATION };

extern const struct axis branch_axes[R]; /* ranges of the measured coordinates */
extern const double strength_sizes[]; /* SI units in one of each strength */
extern const int load_of_term[], strength_of_load[], action_nodes[], function_pieces[];
extern const double parameter_values[], parameter_lower[], parameter_upper[], scale[];
extern const double start_coordinates[N], start_rates[N];
extern const double closure_wanted[];
extern const struct piece pieces[];
extern const struct reading readings[];
extern const struct count counts[];
extern const struct force forces[]; /* first those that friction hangs on */
extern const int carried_actions[]; /* numbers of their local effects, whose laws take them as the first parameter */
extern const struct term force_terms[];
extern const struct action actions[];
extern const struct part action_parts[];
extern const struct control controls[];
extern const int control_actions[];
extern const double control_origins[];
extern const struct statement coordinates[R];
extern const struct term closure[], constraints[]; /* these of a tree of joints alone */
extern const struct spline_piece spline_pieces[];
void weigh(const double *p, double *terms, double *loads, double (*laws)[N_LAW], double *given,
           double (*controls)[AT_LEAST_ONE(N_CONTROL)]);
/* Makes outputs of readings, places of bases and forces, each with rate and acceleration, the time and the parameters;
   and what is counted. */
void combine(double time, const double *p, double (*bases)[3], double (*readings)[3], double (*forces)[3],
             double outputs[], double counted[]);
void weigh_counts(const double *p, double (*curves)[MOST_PARTS][3], double ultimates[]);
/* Counts what was seen last, from a new start or from the last step on; and shows it among the outputs. */
void start_counts(struct pgmp_model *m);
void count_step(struct pgmp_model *m);
void show_counts(struct pgmp_model *m, double time);

/* Frame of a point: position and directors, in the plane the angle too, which counts turns. */
struct frame { double z[N_FRAME], angle; };

double evaluate_piece(int function, double time, double since, double rates[2]);

/* A frame, its derivatives with the coordinates, and those with the node's displacement and rotation in the body's frame. */
struct moving { double frame[N_FRAME], jacobian[N_FRAME][N], own[N_FRAME][N_DOFS]; };
/* Coefficients of the generalised-alpha scheme. */
struct scheme { double alpha_m, alpha_f, beta, gamma; };
/* What acts at an instant: strengths, and measured coordinates whose motion is given, with rates and accelerations. */
struct acting { double strengths[AT_LEAST_ONE(N_STRENGTHS)], motions[R][3]; };

void add_actions(const struct pgmp_model *m, const double strengths[], const double q[N], const double v[N],
                 double gain_v, int fresh, struct iterate kept[], double depths[], struct response *response,
                 double r[N], struct matrix *matrix, double forces[], double loads[][N_DOFS]);
int bends(const struct pgmp_model *m, const struct iterate kept[], const double v[N], double gain_v);
void respond(const struct pgmp_model *m, double motions[][2], struct response *at, double given[][3]);
void begin_response(const struct pgmp_model *m, const struct scheme *s, double h, double time, struct response *at);
void forget_iterates(struct response *at);
void begin_sampling(const struct pgmp_model *m, int who, double time, struct response *at);
void follow_response(struct pgmp_model *m, const struct scheme *s, const struct response *at);
int jumps(const struct pgmp_model *m);
void find_depths(const struct pgmp_model *m, const double q[N], double depths[]);
void look_at_motions(const struct pgmp_model *m, const double q[N], const double v[N], struct response *at);
void find_held(const struct pgmp_model *m, double found[][3]);

double evaluate_statement(const struct statement *s, const double z[2 * N_FRAME], double turned, double gradient[],
                          double (*hessian)[2 * N_FRAME]);
void attach(const struct side *side, const struct frame nodes[], struct frame *frame);
double line_of(const struct statement *s, const double theta[R]);
double of_term(const struct term *term, double s, double *slope, double *bend);
/* Forces in joints, and behind them what motions take, of the state with its accelerations: of a tree with those of a step
   and multipliers that belong to them, or where these are 0 with those by which constraints are obeyed. */
void find_forces(struct pgmp_model *m, const struct acting *now, const double *own, const struct frame nodes[],
                 double found[][3]);
double read_force(const struct force *f, const struct frame nodes[], const double multipliers[]);
/* What acts over time at an instant. */
void act(const struct pgmp_model *m, double time, double since, struct acting *now);
/* One Newton step to poses that hold the joints together at given coordinates. */
void close_loops(const double theta[R], double poses[N_BODIES][N_POSE]);
void frame_of_pose(const double pose[N_POSE], double z[N_FRAME]);

/* What each kind of model has in its own way: its tables, its start, its Newton correction, in r, and accelerations. */
void weigh_tables(struct pgmp_model *m);
void stand_at_start(struct pgmp_model *m);
void follow_motions(const struct acting *now, double q[N], double v[N], double a[N]);
void correct(struct pgmp_model *m, const struct acting *now, const double q[N], const double v[N], const double a[N],
             const double forces[], double gain_v, double gain_a, int fresh, struct iterate kept[],
             struct response *response, struct matrix *matrix, double r[N_ALL]);
void find_accelerations(struct pgmp_model *m, const struct acting *now);
/* Makes velocities and accelerations at the end of a step of h consistent with the constraints; where PROJECTS alone. */
void project_motion(struct pgmp_model *m, const struct acting *now, double h, const double q[N], double v[N], double a[N]);
int leaves_tables(const struct pgmp_model *m);
void count_turns(struct pgmp_model *m, const double q[N]); /* what angles are near to, in a state that is kept */
/* Nodes of the local effects, and what the angles of their parts are near to; and what their tangents add to the matrix. */
void place_holders(const struct pgmp_model *m, const double q[N], struct moving nodes[], double turned[]);
void add_tangent(double tangent[N][N], struct matrix *matrix);
/* What is seen: looked at once; frames of all nodes after a time on a line or a parabola, and what angles are near to; how
   fast they move at most, in units of the size or rad; and the rigid mechanism at measured coordinates. */
void look_at(const struct pgmp_model *m, struct look *look);
void see_nodes(const struct pgmp_model *m, const struct look *look, double after, double theta[R], struct frame nodes[]);
void find_pace(const struct pgmp_model *m, const struct look *look, double *speed, double *pull);
double find_rotation(const struct pgmp_model *m, const struct look *look);
void place_bodies(const double theta[R], const struct frame nodes[], struct frame bodies[N_BODIES]);

#endif
