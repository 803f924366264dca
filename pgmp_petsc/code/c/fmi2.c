/* The model as an FMU for co-simulation, FMI 2.0.3; instances are static, MOST_INSTANCES of a process.

   written by pgmp_petsc */

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#include "fmu.h"
#include "model.h"

#ifdef _WIN32
#define EXPORT __declspec(dllexport)
#elif defined(__GNUC__)
#define EXPORT __attribute__((visibility("default")))
#else
#define EXPORT
#endif

#define MOST_INSTANCES 4
#define MESSAGE 400

typedef double fmi2Real;
typedef int fmi2Integer, fmi2Boolean;
typedef const char *fmi2String;
typedef char fmi2Byte;
typedef unsigned int fmi2ValueReference;
typedef void *fmi2Component, *fmi2ComponentEnvironment, *fmi2FMUstate;
typedef enum { fmi2OK, fmi2Warning, fmi2Discard, fmi2Error, fmi2Fatal, fmi2Pending } fmi2Status;
typedef enum { fmi2ModelExchange, fmi2CoSimulation } fmi2Type;
typedef int fmi2StatusKind;
typedef struct {
    void (*logger)(fmi2ComponentEnvironment, fmi2String, fmi2Status, fmi2String, fmi2String, ...);
    void *(*allocateMemory)(size_t, size_t);
    void (*freeMemory)(void *);
    void (*stepFinished)(fmi2ComponentEnvironment, fmi2Status);
    fmi2ComponentEnvironment componentEnvironment;
} fmi2CallbackFunctions;

/* Value references: what a number is begins at these. */
enum { PARAMETERS = 0, STRENGTHS = 1000000, OUTPUTS = 2000000, ELASTIC_ROTATION = 3000000, CORRECTION, BLOCK = 1000000 };
enum { VALIDITY = 0, VALID = 0 };

struct instance {
    struct pgmp_model model;
    fmi2CallbackFunctions callbacks;
    char name[64];
    int used, running, stale, unweighed, warned;
};

static struct instance instances[MOST_INSTANCES];

static fmi2Status say(const fmi2CallbackFunctions *callbacks, fmi2String name, fmi2Status status, const char *format,
                      ...) {
    char text[MESSAGE];
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    if (callbacks->logger != NULL)
        callbacks->logger(callbacks->componentEnvironment, name, status,
                          status == fmi2Warning ? "logStatusWarning" : "logStatusError", "%s", text);
    return status;
}

#define FAIL(...) return say(&me->callbacks, me->name, fmi2Error, __VA_ARGS__)

/* Brings outputs up to what was set. */
static void refresh(struct instance *me) {
    if (me->unweighed) {
        if (me->running)
            pgmp_weigh(&me->model);
        else
            pgmp_start(&me->model);
        me->unweighed = 0, me->stale = 1;
    }
    if (me->stale) pgmp_observe(&me->model);
    me->stale = 0;
}

EXPORT fmi2String fmi2GetTypesPlatform(void) { return "default"; }
EXPORT fmi2String fmi2GetVersion(void) { return "2.0"; }

EXPORT fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[]) {
    (void)c, (void)on, (void)n, (void)categories;
    return fmi2OK; /* errors and warnings are always said */
}

EXPORT fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                                     const fmi2CallbackFunctions *callbacks, fmi2Boolean visible, fmi2Boolean logging) {
    (void)resources, (void)visible, (void)logging;
    if (type != fmi2CoSimulation) {
        say(callbacks, name, fmi2Error, "this FMU is for co-simulation, not for model exchange");
        return NULL;
    }
    if (guid == NULL || strcmp(guid, FMU_GUID) != 0) {
        say(callbacks, name, fmi2Error, "the GUID is not %s: modelDescription.xml is of another model", FMU_GUID);
        return NULL;
    }
    for (int k = 0; k < MOST_INSTANCES; k++) {
        struct instance *me = instances + k;
        if (me->used) continue;
        memset(me, 0, sizeof *me);
        me->callbacks = *callbacks, me->used = 1, me->unweighed = 1;
        snprintf(me->name, sizeof me->name, "%s", name);
        pgmp_initialise(&me->model);
        return me;
    }
    say(callbacks, name, fmi2Error, "there are %d instances already; at most so many in a process", MOST_INSTANCES);
    return NULL;
}

EXPORT void fmi2FreeInstance(fmi2Component c) {
    if (c != NULL) ((struct instance *)c)->used = 0;
}

EXPORT fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean given, fmi2Real tolerance, fmi2Real start,
                                      fmi2Boolean stops, fmi2Real stop) {
    struct instance *me = c;
    (void)given, (void)tolerance, (void)stops, (void)stop;
    if (start != 0.0) FAIL("the start time is %g s; this model starts at 0", start);
    return fmi2OK;
}

EXPORT fmi2Status fmi2EnterInitializationMode(fmi2Component c) {
    (void)c;
    return fmi2OK;
}

EXPORT fmi2Status fmi2ExitInitializationMode(fmi2Component c) {
    struct instance *me = c;
    me->running = 0, me->unweighed = 1;
    refresh(me);
    me->running = 1;
    if (me->model.validity & PGMP_NOT_FINITE) FAIL("the accelerations at the start are no finite numbers");
    return fmi2OK;
}

EXPORT fmi2Status fmi2Terminate(fmi2Component c) {
    (void)c;
    return fmi2OK;
}

EXPORT fmi2Status fmi2Reset(fmi2Component c) {
    struct instance *me = c;
    pgmp_initialise(&me->model);
    me->running = 0, me->unweighed = 1, me->warned = 0;
    return fmi2OK;
}

EXPORT fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real value[]) {
    struct instance *me = c;
    refresh(me);
    for (size_t k = 0; k < n; k++) {
        unsigned block = vr[k] / BLOCK, number = vr[k] % BLOCK;
        if (block == 0 && number < N_PARAMETERS)
            value[k] = me->model.parameters[number];
        else if (block == 1 && number < N_LOADS)
            value[k] = me->model.strengths[number];
        else if (block == 2 && number < N_OUTPUTS)
            value[k] = me->model.outputs[number];
        else if (vr[k] == ELASTIC_ROTATION)
            value[k] = me->model.elastic_rotation;
        else if (vr[k] == CORRECTION)
            value[k] = me->model.correction;
        else
            FAIL("there is no Real with value reference %u", vr[k]);
    }
    return fmi2OK;
}

EXPORT fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Integer value[]) {
    struct instance *me = c;
    refresh(me);
    for (size_t k = 0; k < n; k++) {
        if (vr[k] != VALIDITY) FAIL("there is no Integer with value reference %u", vr[k]);
        value[k] = me->model.validity;
    }
    return fmi2OK;
}

EXPORT fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Boolean value[]) {
    struct instance *me = c;
    refresh(me);
    for (size_t k = 0; k < n; k++) {
        if (vr[k] == VALID)
            value[k] = me->model.validity == 0;
        else if (vr[k] / BLOCK == 1 && vr[k] % BLOCK < N_LOADS)
            value[k] = me->model.follows_scene[vr[k] % BLOCK];
        else
            FAIL("there is no Boolean with value reference %u", vr[k]);
    }
    return fmi2OK;
}

EXPORT fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2String value[]) {
    struct instance *me = c;
    (void)vr, (void)value;
    if (n > 0) FAIL("there are no Strings");
    return fmi2OK;
}

EXPORT fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real value[]) {
    struct instance *me = c;
    fmi2Status status = fmi2OK;
    for (size_t k = 0; k < n; k++) {
        unsigned block = vr[k] / BLOCK, number = vr[k] % BLOCK;
        if (!isfinite(value[k])) FAIL("value %g of value reference %u is no finite number", value[k], vr[k]);
        if (block == 0 && number < N_PARAMETERS) {
            if (me->model.parameters[number] != value[k]) me->unweighed = 1;
            me->model.parameters[number] = value[k];
        } else if (block == 1 && number < N_LOADS) {
            me->model.strengths[number] = value[k];
            if (!me->running) me->unweighed = 1;
            if (me->model.follows_scene[number] && value[k] != 0.0 && !me->warned) {
                me->warned = 1;
                status = say(&me->callbacks, me->name, fmi2Warning,
                             "effects.%s is set but has no effect as long as effects.%s_follows_scene is true",
                             pgmp_load_names[number], pgmp_load_names[number]);
            }
        } else
            FAIL("no Real with value reference %u can be set", vr[k]);
    }
    return status;
}

EXPORT fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Integer value[]) {
    struct instance *me = c;
    (void)vr, (void)value;
    if (n > 0) FAIL("no Integer can be set");
    return fmi2OK;
}

EXPORT fmi2Status fmi2SetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Boolean value[]) {
    struct instance *me = c;
    for (size_t k = 0; k < n; k++) {
        if (vr[k] / BLOCK != 1 || vr[k] % BLOCK >= N_LOADS) FAIL("no Boolean with value reference %u can be set", vr[k]);
        me->model.follows_scene[vr[k] % BLOCK] = value[k] != 0;
        if (!me->running) me->unweighed = 1;
    }
    return fmi2OK;
}

EXPORT fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2String value[]) {
    struct instance *me = c;
    (void)vr, (void)value;
    if (n > 0) FAIL("there are no Strings");
    return fmi2OK;
}

EXPORT fmi2Status fmi2DoStep(fmi2Component c, fmi2Real current, fmi2Real size, fmi2Boolean no_set_state) {
    struct instance *me = c;
    double steps = floor(size / STEP + 0.5);
    (void)no_set_state;
    if (!(steps >= 1.0) || !(fabs(size - steps * STEP) <= 1e-6 * STEP))
        FAIL("a communication step of %.17g s; it must be a whole number of steps of %.17g s", size, (double)STEP);
    if (!(fabs(current - pgmp_time(&me->model)) <= 1e-3 * STEP))
        FAIL("the communication point is %.17g s, but the model is at %.17g s", current, pgmp_time(&me->model));
    refresh(me);
    for (double k = 0.0; k < steps; k += 1.0) {
        pgmp_step(&me->model);
        if (me->model.validity & PGMP_NOT_FINITE)
            FAIL("the state is no finite number at %g s; take a smaller step", pgmp_time(&me->model));
    }
    me->stale = 1;
    return fmi2OK;
}

EXPORT fmi2Status fmi2CancelStep(fmi2Component c) {
    struct instance *me = c;
    FAIL("steps are not asynchronous");
}

/* What the model description says this FMU cannot do. */
#define CANNOT(...) \
    { \
        struct instance *me = c; \
        FAIL(__VA_ARGS__); \
    }
#define UNUSED_ORDER (void)vr, (void)n, (void)order, (void)value

EXPORT fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state) { (void)state; CANNOT("states are not kept") }
EXPORT fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state) { (void)state; CANNOT("states are not kept") }
EXPORT fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state) { (void)state; CANNOT("states are not kept") }
EXPORT fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate state, size_t *size) {
    (void)state, (void)size;
    CANNOT("states are not kept")
}
EXPORT fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size) {
    (void)state, (void)bytes, (void)size;
    CANNOT("states are not kept")
}
EXPORT fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state) {
    (void)state, (void)bytes, (void)size;
    CANNOT("states are not kept")
}
EXPORT fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference unknown[], size_t n_unknown,
                                               const fmi2ValueReference known[], size_t n_known, const fmi2Real seed[],
                                               fmi2Real value[]) {
    (void)unknown, (void)n_unknown, (void)known, (void)n_known, (void)seed, (void)value;
    CANNOT("there are no directional derivatives")
}
EXPORT fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                              const fmi2Integer order[], const fmi2Real value[]) {
    UNUSED_ORDER;
    CANNOT("inputs are constant in a step")
}
EXPORT fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                               const fmi2Integer order[], fmi2Real value[]) {
    UNUSED_ORDER;
    CANNOT("there are no derivatives of outputs")
}
EXPORT fmi2Status fmi2GetStatus(fmi2Component c, fmi2StatusKind kind, fmi2Status *value) {
    (void)kind, (void)value;
    CANNOT("steps are not asynchronous")
}
EXPORT fmi2Status fmi2GetRealStatus(fmi2Component c, fmi2StatusKind kind, fmi2Real *value) {
    (void)kind, (void)value;
    CANNOT("steps are not asynchronous")
}
EXPORT fmi2Status fmi2GetIntegerStatus(fmi2Component c, fmi2StatusKind kind, fmi2Integer *value) {
    (void)kind, (void)value;
    CANNOT("steps are not asynchronous")
}
EXPORT fmi2Status fmi2GetBooleanStatus(fmi2Component c, fmi2StatusKind kind, fmi2Boolean *value) {
    (void)kind, (void)value;
    CANNOT("steps are not asynchronous")
}
EXPORT fmi2Status fmi2GetStringStatus(fmi2Component c, fmi2StatusKind kind, fmi2String *value) {
    (void)kind, (void)value;
    CANNOT("steps are not asynchronous")
}
