/* A reduced mechanism in C99: steps of bounded work (with laws that have edges MAX_TRIALS and more), no allocation, no
   library but libm.

   written by pgmp_petsc

   Set parameters and strengths after pgmp_initialise; pgmp_start weighs the tables with the parameters and finds the
   accelerations at time 0; pgmp_step takes one step of STEP seconds and returns validity; pgmp_observe evaluates the
   outputs. A step that fails is not taken: state and time stay as they were, and validity has PGMP_NOT_CONVERGED until
   one succeeds, as with other strengths. Whoever has an integrator of its own sets q and v and asks pgmp_accelerate for
   a. Numbers are in the units of the scene. */

#ifndef PGMP_MODEL_H
#define PGMP_MODEL_H

#include "sizes.h"

/* D dimensions, N coordinates, R of them measured on the mechanism; what else they are, equations.h says */
#define PACKED(n) ((n) * ((n) + 1) / 2)
#define N_FRAME (D * (D + 1))
#define N_DOFS (D * (D + 1) / 2)
#define N_POSE (D == 2 ? 3 : 12)
#define AT_LEAST_ONE(n) ((n) > 0 ? (n) : 1)

#include "equations.h"

/* What is wrong, bits of pgmp_model.validity; 0 is fine. */
enum {
    PGMP_ROTATION = 1,      /* an elastic rotation is, or was, beyond ROTATION_LIMIT */
    PGMP_OUT_OF_RANGE = 2,  /* a coordinate is, or was, outside the range of the tables */
    PGMP_NOT_CONVERGED = 4, /* the last step that was asked for failed and was not taken */
    PGMP_NOT_FINITE = 8,    /* the state is no finite number */
    PGMP_PARAMETER = 16,    /* a parameter is outside what the model was built for, or no finite number */
    PGMP_UNCOUNTED = 32     /* more cycles waited to be closed than there is room for: the smallest counted as closed */
};

struct pgmp_model {
    double parameters[AT_LEAST_ONE(N_PARAMETERS)];
    double strengths[AT_LEAST_ONE(N_STRENGTHS)]; /* used where follows_scene is 0 */
    int follows_scene[AT_LEAST_ONE(N_STRENGTHS)];
    struct own own; /* tables weighted with the parameters, and what else a kind of model keeps */
    double laws[AT_LEAST_ONE(N_ACTIONS)][N_LAW];
    double controls[AT_LEAST_ONE(N_CONTROLS)][AT_LEAST_ONE(N_CONTROL)];
    /* state: coordinates, their rates, accelerations, auxiliary ones, those that the scheme goes on from, those of the step
       before */
    double q[N], v[N], a[N], auxiliary[N], recent[N], before[N];
    int beyond[AT_LEAST_ONE(N_EDGES)]; /* whether each edge of a law is crossed */
    double beside[AT_LEAST_ONE(N_BESIDE)]; /* of each controller its states, rates, auxiliary ones and its force */
    double carried[AT_LEAST_ONE(N_CARRIED)]; /* forces in joints that friction hangs on */
    long sampled;                          /* steps after which controllers were sampled last */
    double contraction; /* of Newton's iteration, expected in the next step */
    long number;        /* steps taken */
    /* of each output that is counted by rainflow: its value when it was seen last, turning points that wait, the damage
       of the half cycles up to each, their number, and the damage of what is closed and of all so far */
    double counted[AT_LEAST_ONE(N_COUNTS)], turns[AT_LEAST_ONE(N_COUNTS)][N_WAITING], halves[AT_LEAST_ONE(N_COUNTS)][N_WAITING];
    int waiting[AT_LEAST_ONE(N_COUNTS)];
    double closed[AT_LEAST_ONE(N_COUNTS)], damages[AT_LEAST_ONE(N_COUNTS)];
    double outputs[AT_LEAST_ONE(N_OUTPUTS)];
    double elastic_rotation; /* rad, the largest of any node at this instant */
    double correction;       /* what the last step taken left, estimated, in units of the mechanism's size or 1 rad */
    int validity;
};

void pgmp_initialise(struct pgmp_model *model);
void pgmp_start(struct pgmp_model *model);
void pgmp_weigh(struct pgmp_model *model); /* parameters that changed within a run */
int pgmp_step(struct pgmp_model *model);
void pgmp_observe(struct pgmp_model *model); /* at pgmp_time */
void pgmp_observe_at(struct pgmp_model *model, double time, double since); /* as pgmp_accelerate */
double pgmp_time(const struct pgmp_model *model);
/* Accelerations of the state at a time; what acts over time is that of the pieces that hold at the time `since`. */
void pgmp_accelerate(struct pgmp_model *model, double time, double since);
/* When what acts over time jumps or bends next after a time, and a very large number if it does not. */
double pgmp_next_break(const struct pgmp_model *model, double time);

extern const char *const pgmp_parameter_names[], *const pgmp_strength_names[], *const pgmp_output_names[];
extern const int pgmp_prescribed[N]; /* which coordinates are given: by a motion, or by how far a joint is off */

#endif
