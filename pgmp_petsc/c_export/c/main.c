/* Runs the model as the scene does and prints time and outputs as CSV:  main [NAME=VALUE ...] > run.csv

   cc -std=c99 -O2 *.c -lm -o main

   written by pgmp_petsc */

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "model.h"

#define BROKEN (PGMP_NOT_CONVERGED | PGMP_NOT_FINITE)

static struct pgmp_model model;

static int set(const char *text) {
    for (int k = 0; k < N_PARAMETERS; k++) {
        size_t length = strlen(pgmp_parameter_names[k]);
        if (strncmp(text, pgmp_parameter_names[k], length) == 0 && text[length] == '=') {
            char *end;
            model.parameters[k] = strtod(text + length + 1, &end);
            return end != text + length + 1 && *end == '\0';
        }
    }
    return 0;
}

static void show(void) {
    pgmp_observe(&model);
    printf("%.17g", pgmp_time(&model));
    for (int k = 0; k < N_OUTPUTS; k++) printf(",%.17g", model.outputs[k]);
    printf(",%.17g,%d\n", model.elastic_rotation, model.validity);
}

int main(int argc, char **argv) {
    pgmp_initialise(&model);
    for (int k = 1; k < argc; k++)
        if (!set(argv[k])) {
            fprintf(stderr, "%s: not NAME=VALUE of a parameter; parameters:", argv[k]);
            for (int p = 0; p < N_PARAMETERS; p++) fprintf(stderr, " %s", pgmp_parameter_names[p]);
            fprintf(stderr, "\n");
            return 2;
        }
    pgmp_start(&model);
    printf("time");
    for (int k = 0; k < N_OUTPUTS; k++) printf(",%s", pgmp_output_names[k]);
    printf(",elastic_rotation,validity\n");
    show();
    for (long number = 0; number < N_STEPS && !(model.validity & BROKEN); number++) {
        pgmp_step(&model);
        show();
    }
    if (model.validity & PGMP_NOT_FINITE)
        fprintf(stderr, "stopped at %g s: a state is no finite number\n", pgmp_time(&model));
    else if (model.validity & PGMP_NOT_CONVERGED)
        fprintf(stderr, "stopped at %g s: the iteration of the next step of %g s failed; export again with a smaller "
                        "simulation.step, and see whether pgmp simulate runs through\n", pgmp_time(&model), STEP);
    return model.validity & BROKEN ? 1 : 0;
}
