/* The model as a functional mock-up unit, whichever version of FMI asks: instances, variables, steps and states.

   written by pgmp_petsc */

#ifndef PGMP_UNIT_H
#define PGMP_UNIT_H

#include <stddef.h>

#include "fmu.h"
#include "model.h"

#ifdef _WIN32
#define EXPORT __declspec(dllexport)
#elif defined(__GNUC__)
#define EXPORT __attribute__((visibility("default")))
#else
#define EXPORT
#endif

/* As both versions of FMI number them. */
enum { UNIT_OK, UNIT_WARNING, UNIT_DISCARD, UNIT_ERROR };

/* Value references: what a number is begins at these. */
enum {
    BLOCK = 1000000,
    OF_PARAMETERS = 0,
    OF_STRENGTHS = 1,
    OF_OUTPUTS = 2,
    OF_FOLLOWS = 4,
    OF_STATES = 5,
    OF_DERIVATIVES = 6,
    ELASTIC_ROTATION = 3 * BLOCK,
    CORRECTION,
    VALIDITY,
    VALID,
    TIME
};

/* How messages reach who called. */
struct voice {
    char name[64];
    void *environment;
    void (*say)(const struct voice *voice, int status, const char *text); /* of the version of FMI */
    void (*logger)(void);
};

struct unit {
    struct voice voice; /* the first, so that FMI's pointer is one to it too */
    struct pgmp_model model;
    int exchange; /* model exchange, or co-simulation */
    int running, stale, unweighed, warned, standing;
    double time, since; /* of model exchange: now, and when the pieces over time were chosen */
};

/* NULL, which is said, where there is none. */
struct unit *unit_new(struct voice voice, const char *name, const char *token, int exchange);
void unit_free(struct unit *unit);
int unit_say(const struct voice *voice, int status, const char *format, ...);
int unit_begin(struct unit *unit);
int unit_reset(struct unit *unit);
int unit_get_real(struct unit *unit, const unsigned vr[], size_t n, double value[]);
int unit_get_integer(struct unit *unit, unsigned vr, int *value);
int unit_get_boolean(struct unit *unit, unsigned vr, int *value);
int unit_set_real(struct unit *unit, const unsigned vr[], size_t n, const double value[]);
int unit_set_boolean(struct unit *unit, unsigned vr, int value);
int unit_step(struct unit *unit, double current, double size);
/* Of model exchange: positions and rates of the coordinates that are free, one behind the other. */
size_t unit_count_states(void);
int unit_get_states(struct unit *unit, size_t n, double values[]);
int unit_set_states(struct unit *unit, size_t n, const double values[]);
int unit_get_derivatives(struct unit *unit, size_t n, double values[]);
int unit_get_nominals(struct unit *unit, size_t n, double values[]);
void unit_set_time(struct unit *unit, double time);
void unit_end_step(struct unit *unit);
int unit_next_event(struct unit *unit, double *next); /* at an event: whether there is one to come, and when */

#endif
