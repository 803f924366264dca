/* Every instance has memory of its own, and all that they share is constant: threads may have one each.

   written by pgmp_petsc */

#include "unit.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define MESSAGE 400
#define FAIL(...) return unit_say(&me->voice, UNIT_ERROR, __VA_ARGS__)

struct unit *unit_new(struct voice voice, const char *name, const char *token, int exchange) {
    struct unit *me;
    snprintf(voice.name, sizeof voice.name, "%s", name == NULL ? "" : name);
    if (token == NULL || strcmp(token, FMU_GUID) != 0) {
        unit_say(&voice, UNIT_ERROR, "the token is not %s: modelDescription.xml is of another model", FMU_GUID);
        return NULL;
    }
    if (exchange && !EXCHANGE) {
        unit_say(&voice, UNIT_ERROR, "a component model, or one with controllers or damages, is for co-simulation alone");
        return NULL;
    }
    me = calloc(1, sizeof *me);
    if (me == NULL) {
        unit_say(&voice, UNIT_ERROR, "there is no memory for an instance, %lu bytes", (unsigned long)sizeof *me);
        return NULL;
    }
    me->voice = voice, me->exchange = exchange;
    unit_reset(me);
    return me;
}

void unit_free(struct unit *me) { free(me); }

int unit_say(const struct voice *voice, int status, const char *format, ...) {
    char text[MESSAGE];
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    if (voice->logger != NULL) voice->say(voice, status, text);
    return status;
}

/* Brings outputs up to what was set. */
static void refresh(struct unit *me) {
    if (me->unweighed) {
        if (me->running)
            pgmp_weigh(&me->model);
        else
            pgmp_start(&me->model);
        me->standing |= me->model.validity & PGMP_PARAMETER;
        me->unweighed = 0, me->stale = 1;
    }
    if (!me->stale) return;
    if (me->exchange) {
        me->model.validity = me->standing; /* states that an integrator tries and leaves again have no say */
        pgmp_accelerate(&me->model, me->time, me->since);
        pgmp_observe_at(&me->model, me->time, me->since);
    } else
        pgmp_observe(&me->model);
    me->stale = 0;
}

int unit_reset(struct unit *me) {
    pgmp_initialise(&me->model);
    me->running = 0, me->unweighed = 1, me->warned = 0, me->standing = 0;
    me->time = me->since = 0.0;
    return UNIT_OK;
}

int unit_begin(struct unit *me) {
    me->running = 0, me->unweighed = 1, me->standing = 0;
    refresh(me);
    me->running = 1;
    if (me->model.validity & PGMP_NOT_FINITE) FAIL("the accelerations at the start are no finite numbers");
    return UNIT_OK;
}

/* The number of the coordinate that a state belongs to. */
static int coordinate_of(unsigned state) {
    unsigned free = (unsigned)unit_count_states() / 2, number = state % free;
    int i = -1;
    do i++; while (pgmp_prescribed[i] || number-- > 0);
    return i;
}

size_t unit_count_states(void) {
    size_t n = 2 * N;
    for (int k = 0; k < N; k++) n -= pgmp_prescribed[k] ? 2 : 0;
    return n;
}

static double state_of(const struct unit *me, unsigned state) {
    return (state < unit_count_states() / 2 ? me->model.q : me->model.v)[coordinate_of(state)];
}

static double derivative_of(const struct unit *me, unsigned state) {
    return (state < unit_count_states() / 2 ? me->model.v : me->model.a)[coordinate_of(state)];
}

int unit_get_real(struct unit *me, const unsigned vr[], size_t n, double value[]) {
    refresh(me);
    for (size_t k = 0; k < n; k++) {
        unsigned block = vr[k] / BLOCK, number = vr[k] % BLOCK;
        if (block == OF_PARAMETERS && number < N_PARAMETERS)
            value[k] = me->model.parameters[number];
        else if (block == OF_STRENGTHS && number < N_STRENGTHS)
            value[k] = me->model.strengths[number];
        else if (block == OF_OUTPUTS && number < N_OUTPUTS)
            value[k] = me->model.outputs[number];
        else if (block == OF_STATES && number < unit_count_states())
            value[k] = state_of(me, number);
        else if (block == OF_DERIVATIVES && number < unit_count_states())
            value[k] = derivative_of(me, number);
        else if (vr[k] == ELASTIC_ROTATION)
            value[k] = me->model.elastic_rotation;
        else if (vr[k] == CORRECTION)
            value[k] = me->model.correction;
        else if (vr[k] == TIME)
            value[k] = me->exchange ? me->time : pgmp_time(&me->model);
        else
            FAIL("there is no real number with value reference %u", vr[k]);
    }
    return UNIT_OK;
}

int unit_get_integer(struct unit *me, unsigned vr, int *value) {
    refresh(me);
    if (vr != VALIDITY) FAIL("there is no whole number with value reference %u", vr);
    *value = me->model.validity;
    return UNIT_OK;
}

int unit_get_boolean(struct unit *me, unsigned vr, int *value) {
    refresh(me);
    if (vr == VALID)
        *value = me->model.validity == 0;
    else if (vr / BLOCK == OF_FOLLOWS && vr % BLOCK < N_STRENGTHS)
        *value = me->model.follows_scene[vr % BLOCK];
    else
        FAIL("there is no Boolean with value reference %u", vr);
    return UNIT_OK;
}

/* What acts has changed: in model exchange, and before a run, so do the accelerations. */
static void act_anew(struct unit *me) {
    if (!me->running) me->unweighed = 1;
    if (me->exchange) me->stale = 1;
}

int unit_set_real(struct unit *me, const unsigned vr[], size_t n, const double value[]) {
    int status = UNIT_OK;
    for (size_t k = 0; k < n; k++) {
        unsigned block = vr[k] / BLOCK, number = vr[k] % BLOCK;
        if (!isfinite(value[k])) FAIL("value %g of value reference %u is no finite number", value[k], vr[k]);
        if (block == OF_PARAMETERS && number < N_PARAMETERS) {
            if (me->model.parameters[number] != value[k]) me->unweighed = 1;
            me->model.parameters[number] = value[k];
        } else if (block == OF_STRENGTHS && number < N_STRENGTHS) {
            me->model.strengths[number] = value[k];
            act_anew(me);
            if (me->model.follows_scene[number] && value[k] != 0.0 && !me->warned) {
                me->warned = 1;
                status = unit_say(&me->voice, UNIT_WARNING,
                                  "effects.%s is set but has no effect as long as effects.%s_follows_scene is true",
                                  pgmp_strength_names[number], pgmp_strength_names[number]);
            }
        } else
            FAIL("no real number with value reference %u can be set", vr[k]);
    }
    return status;
}

int unit_set_boolean(struct unit *me, unsigned vr, int value) {
    if (vr / BLOCK != OF_FOLLOWS || vr % BLOCK >= N_STRENGTHS)
        FAIL("no Boolean with value reference %u can be set", vr);
    me->model.follows_scene[vr % BLOCK] = value != 0;
    act_anew(me);
    return UNIT_OK;
}

int unit_step(struct unit *me, double current, double size) {
    double steps = floor(size / STEP + 0.5);
    if (!(steps >= 1.0) || !(fabs(size - steps * STEP) <= 1e-6 * STEP))
        FAIL("a communication step of %.17g s; it must be a whole number of steps of %.17g s", size, (double)STEP);
    if (!(fabs(current - pgmp_time(&me->model)) <= 1e-3 * STEP))
        FAIL("the communication point is %.17g s, but the model is at %.17g s", current, pgmp_time(&me->model));
    refresh(me);
    me->stale = 1;
    for (double k = 0.0; k < steps; k += 1.0) {
        pgmp_step(&me->model);
        if (me->model.validity & PGMP_NOT_CONVERGED)
            FAIL("the iteration of the step of %g s from %g s failed, and the model stays there; export again with a "
                 "smaller simulation.step", (double)STEP, pgmp_time(&me->model));
        if (me->model.validity & PGMP_NOT_FINITE)
            FAIL("the state is no finite number at %g s; export again with a smaller simulation.step",
                 pgmp_time(&me->model));
    }
    return UNIT_OK;
}

static int check_count(const struct unit *me, size_t n) {
    if (n != unit_count_states()) FAIL("%lu states; this model has %lu", (unsigned long)n, (unsigned long)unit_count_states());
    return UNIT_OK;
}

int unit_get_states(struct unit *me, size_t n, double values[]) {
    refresh(me);
    for (unsigned k = 0; k < n && n == unit_count_states(); k++) values[k] = state_of(me, k);
    return check_count(me, n);
}

int unit_set_states(struct unit *me, size_t n, const double values[]) {
    for (unsigned k = 0; k < n && n == unit_count_states(); k++)
        (k < n / 2 ? me->model.q : me->model.v)[coordinate_of(k)] = values[k];
    me->stale = 1;
    return check_count(me, n);
}

int unit_get_derivatives(struct unit *me, size_t n, double values[]) {
    refresh(me);
    for (unsigned k = 0; k < n && n == unit_count_states(); k++) values[k] = derivative_of(me, k);
    if (me->model.validity & PGMP_NOT_FINITE)
        return unit_say(&me->voice, UNIT_DISCARD, "the accelerations at %g s are no finite numbers", me->time);
    return check_count(me, n);
}

int unit_get_nominals(struct unit *me, size_t n, double values[]) {
    for (size_t k = 0; k < n; k++) values[k] = 1.0;
    return check_count(me, n);
}

void unit_set_time(struct unit *me, double time) {
    if (me->time != time) me->stale = 1;
    me->time = time;
}

void unit_end_step(struct unit *me) {
    refresh(me);
    me->standing = me->model.validity;
}

int unit_next_event(struct unit *me, double *next) {
    double found = pgmp_next_break(&me->model, me->time);
    me->since = me->time, me->stale = 1;
    if (found < 1e299) *next = found;
    return found < 1e299;
}
