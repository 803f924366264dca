/* A reduced mechanism in C99: steps of fixed work, no allocation, no library but libm.

   written by pgmp_petsc

   Set parameters and strengths after pgmp_initialise; pgmp_start weighs the tables with the parameters and finds the
   accelerations at time 0; pgmp_step takes one step of STEP seconds; pgmp_observe evaluates the outputs. SI units. */

#ifndef PGMP_MODEL_H
#define PGMP_MODEL_H

#include "sizes.h"

#define N (M + 1)
#define PACKED(n) ((n) * ((n) + 1) / 2)
#define N_PAIRS (SECOND_ORDER ? PACKED(M) : 0)
#define N_FACTORS (M + N_PAIRS)
#define RIGID_POWERS 8
#define AT_LEAST_ONE(n) ((n) > 0 ? (n) : 1)

enum {
    COUPLING = PACKED(N),
    STIFFNESS = COUPLING + M,
    CUBIC = STIFFNESS + PACKED(M),
    SWING = CUBIC + (SECOND_ORDER ? M * (M + 1) * (M + 2) / 6 : 0),
    GYROSCOPIC = SWING + (SECOND_ORDER ? PACKED(M) : 0),
    DAMPING = GYROSCOPIC + (SECOND_ORDER ? M * (M - 1) / 2 : 0),
    END = DAMPING + (STRUCTURAL_DAMPING ? PACKED(N) : 0),
    LOAD_END = N + (SECOND_ORDER ? PACKED(M) : 0)
};

/* What is wrong, bits of pgmp_model.validity; 0 is fine. */
enum {
    PGMP_ROTATION = 1,      /* an elastic rotation is, or was, beyond ROTATION_LIMIT */
    PGMP_OUT_OF_RANGE = 2,  /* the coordinate is, or was, outside the range of the tables */
    PGMP_NOT_CONVERGED = 4, /* a correction at the end of a step was larger than CONVERGED */
    PGMP_NOT_FINITE = 8,    /* the state is no finite number */
    PGMP_PARAMETER = 16     /* a parameter is outside what the model was built for, or no finite number */
};

struct pgmp_model {
    double parameters[AT_LEAST_ONE(N_PARAMETERS)];
    double strengths[AT_LEAST_ONE(N_LOADS)]; /* used where follows_scene is 0 */
    int follows_scene[AT_LEAST_ONE(N_LOADS)];
    /* tables weighted with the parameters */
    double rigid[N_CELLS][RIGID_POWERS], terms[N_ROWS][END], loads[AT_LEAST_ONE(N_LOADS)][N_ROWS][LOAD_END];
    double dampers[AT_LEAST_ONE(N_DAMPERS)];
    /* state: theta (rad) and modal coordinates, their rates, accelerations, auxiliary ones, those of the step before */
    double q[N], v[N], a[N], auxiliary[N], before[N];
    long number; /* steps taken */
    double outputs[AT_LEAST_ONE(N_OUTPUTS)];
    double elastic_rotation; /* rad, the largest of any node at this instant */
    double correction;       /* the last one of the last step, in units of the mechanism's size or 1 rad */
    int validity;
};

void pgmp_initialise(struct pgmp_model *model);
void pgmp_start(struct pgmp_model *model);
void pgmp_weigh(struct pgmp_model *model); /* parameters that changed within a run */
int pgmp_step(struct pgmp_model *model);
void pgmp_observe(struct pgmp_model *model);
double pgmp_time(const struct pgmp_model *model);

extern const char *const pgmp_parameter_names[], *const pgmp_load_names[], *const pgmp_output_names[];

#endif
