/* The model as an FMU of FMI 2.0.3, for co-simulation and model exchange; declarations as the standard has them.

   written by pgmp_petsc */

#include <string.h>

#include "unit.h"

typedef double fmi2Real;
typedef int fmi2Integer, fmi2Boolean;
typedef const char *fmi2String;
typedef char fmi2Byte;
typedef unsigned int fmi2ValueReference;
typedef void *fmi2Component, *fmi2ComponentEnvironment, *fmi2FMUstate;
typedef enum { fmi2OK, fmi2Warning, fmi2Discard, fmi2Error, fmi2Fatal, fmi2Pending } fmi2Status;
typedef enum { fmi2ModelExchange, fmi2CoSimulation } fmi2Type;
typedef int fmi2StatusKind;
typedef void (*fmi2Logger)(fmi2ComponentEnvironment, fmi2String, fmi2Status, fmi2String, fmi2String, ...);
typedef struct {
    fmi2Logger logger;
    void *(*allocateMemory)(size_t, size_t);
    void (*freeMemory)(void *);
    void (*stepFinished)(fmi2ComponentEnvironment, fmi2Status);
    fmi2ComponentEnvironment componentEnvironment;
} fmi2CallbackFunctions;
typedef struct {
    fmi2Boolean newDiscreteStatesNeeded, terminateSimulation, nominalsOfContinuousStatesChanged;
    fmi2Boolean valuesOfContinuousStatesChanged, nextEventTimeDefined;
    fmi2Real nextEventTime;
} fmi2EventInfo;

static void say(const struct voice *me, int status, const char *text) {
    ((fmi2Logger)me->logger)(me->environment, me->name, (fmi2Status)status,
                             status == UNIT_WARNING ? "logStatusWarning" : "logStatusError", "%s", text);
}

#define FMI(NAME) fmi2##NAME
#define FMI_DERIVATIVES fmi2GetDerivatives
typedef fmi2Status status;
typedef fmi2Component instance;
typedef fmi2Boolean boolean;
typedef fmi2Real real;
#include "fmi.h"

EXPORT fmi2String fmi2GetTypesPlatform(void) { return "default"; }
EXPORT fmi2String fmi2GetVersion(void) { return "2.0"; }

EXPORT fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                                     const fmi2CallbackFunctions *callbacks, fmi2Boolean visible, fmi2Boolean logging) {
    struct voice caller = {.say = say};
    (void)resources, (void)visible, (void)logging;
    if (callbacks != NULL) {
        caller.environment = callbacks->componentEnvironment;
        caller.logger = (void (*)(void))callbacks->logger;
    }
    return unit_new(caller, name, guid, type == fmi2ModelExchange);
}

EXPORT fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean given, fmi2Real tolerance, fmi2Real start,
                                      fmi2Boolean stops, fmi2Real stop) {
    (void)given, (void)tolerance, (void)stops, (void)stop;
    if (start != 0.0) REFUSE("the start time is %g s; this model starts at 0", start);
    return fmi2OK;
}

EXPORT fmi2Status fmi2EnterInitializationMode(fmi2Component c) {
    (void)c;
    return fmi2OK;
}

EXPORT fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real value[]) {
    return (status)unit_get_real(c, vr, n, value);
}

EXPORT fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Integer value[]) {
    int status = UNIT_OK;
    for (size_t k = 0; k < n && status == UNIT_OK; k++) status = unit_get_integer(c, vr[k], value + k);
    return (fmi2Status)status;
}

EXPORT fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Boolean value[]) {
    int status = UNIT_OK;
    for (size_t k = 0; k < n && status == UNIT_OK; k++) status = unit_get_boolean(c, vr[k], value + k);
    return (fmi2Status)status;
}

/* Of a kind of which there are no variables, or none that can be set. */
#define NONE(NAME, TYPE, WHY)                                                                              \
    EXPORT fmi2Status fmi2##NAME(fmi2Component c, const fmi2ValueReference vr[], size_t n, TYPE value[]) { \
        (void)vr, (void)value;                                                                             \
        if (n > 0) REFUSE(WHY);                                                                            \
        return fmi2OK;                                                                                     \
    }
NONE(GetString, fmi2String, "there are no Strings")
NONE(SetString, const fmi2String, "there are no Strings")
NONE(SetInteger, const fmi2Integer, "no whole number can be set")

EXPORT fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real value[]) {
    return (status)unit_set_real(c, vr, n, value);
}

EXPORT fmi2Status fmi2SetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Boolean value[]) {
    int status = UNIT_OK;
    for (size_t k = 0; k < n && status == UNIT_OK; k++) status = unit_set_boolean(c, vr[k], value[k]);
    return (fmi2Status)status;
}

/* Co-simulation. */

EXPORT fmi2Status fmi2DoStep(fmi2Component c, fmi2Real current, fmi2Real size, fmi2Boolean no_set_state) {
    (void)no_set_state;
    return (status)unit_step(c, current, size);
}

EXPORT fmi2Status fmi2CancelStep(fmi2Component c) { REFUSE("steps are not asynchronous"); }

/* Model exchange. */

EXPORT fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *info) {
    memset(info, 0, sizeof *info);
    info->nextEventTimeDefined = unit_next_event(c, &info->nextEventTime);
    return fmi2OK;
}

/* What else it cannot do. */
CANNOT(GetFMUstate, NOT_KEPT, (void)state, fmi2FMUstate *state)
CANNOT(SetFMUstate, NOT_KEPT, (void)state, fmi2FMUstate state)
CANNOT(FreeFMUstate, NOT_KEPT, (void)state, fmi2FMUstate *state)
CANNOT(SerializedFMUstateSize, NOT_KEPT, ((void)state, (void)size), fmi2FMUstate state, size_t *size)
CANNOT(SerializeFMUstate, NOT_KEPT, ((void)state, (void)bytes, (void)size), fmi2FMUstate state, fmi2Byte bytes[],
       size_t size)
CANNOT(DeSerializeFMUstate, NOT_KEPT, ((void)state, (void)bytes, (void)size), const fmi2Byte bytes[], size_t size,
       fmi2FMUstate *state)
CANNOT(GetDirectionalDerivative, "there are no directional derivatives",
       ((void)unknown, (void)n_unknown, (void)known, (void)n_known, (void)seed, (void)value),
       const fmi2ValueReference unknown[], size_t n_unknown, const fmi2ValueReference known[], size_t n_known,
       const fmi2Real seed[], fmi2Real value[])
CANNOT(SetRealInputDerivatives, "inputs are constant in a step", ((void)vr, (void)n, (void)order, (void)value),
       const fmi2ValueReference vr[], size_t n, const fmi2Integer order[], const fmi2Real value[])
CANNOT(GetRealOutputDerivatives, "there are no derivatives of outputs", ((void)vr, (void)n, (void)order, (void)value),
       const fmi2ValueReference vr[], size_t n, const fmi2Integer order[], fmi2Real value[])

#define STATUS(KIND, TYPE) \
    CANNOT(Get##KIND, "steps are not asynchronous", ((void)kind, (void)value), fmi2StatusKind kind, TYPE *value)
STATUS(Status, fmi2Status)
STATUS(RealStatus, fmi2Real)
STATUS(IntegerStatus, fmi2Integer)
STATUS(BooleanStatus, fmi2Boolean)
STATUS(StringStatus, fmi2String)
