/* Times every step of a model in C, with its outputs: mean, all but one of ten thousand and the slowest,
   in us of processor time, and the slowest by the clock on the wall. */

#define _POSIX_C_SOURCE 199309L

#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#include "model.h"

static struct pgmp_model model;
static double times[10000000];

static int order(const void *a, const void *b) {
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

static double now(clockid_t clock) {
    struct timespec t;
    clock_gettime(clock, &t);
    return 1e6 * t.tv_sec + 1e-3 * t.tv_nsec;
}

int main(int argc, char **argv) {
    long n = argc > 1 ? atol(argv[1]) : 1000000;
    double sum = 0.0, wall = 0.0;
    int again = 0;
    if (n < 1 || n > 10000000) return 2;
    pgmp_initialise(&model);
    pgmp_start(&model);
    for (long k = 0; k < n; k++) {
        /* the run over and over: a motor's torque that goes on would turn it ever faster */
        if (model.number == N_STEPS) again |= model.validity, pgmp_start(&model);
        double begun = now(CLOCK_MONOTONIC), before = now(CLOCK_PROCESS_CPUTIME_ID);
        pgmp_step(&model);
        pgmp_observe(&model);
        times[k] = now(CLOCK_PROCESS_CPUTIME_ID) - before;
        begun = now(CLOCK_MONOTONIC) - begun;
        wall = begun > wall ? begun : wall;
        sum += times[k];
    }
    qsort(times, n, sizeof *times, order);
    printf("%g %g %g %g %d\n", sum / n, times[(long)(0.9999 * (n - 1))], times[n - 1], wall, again | model.validity);
    return 0;
}
