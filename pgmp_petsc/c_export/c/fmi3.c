/* The model as an FMU of FMI 3.0, for co-simulation and model exchange; declarations as the standard has them.

   written by pgmp_petsc */

#include <stdbool.h>
#include <stdint.h>

#include "unit.h"

typedef enum { fmi3OK, fmi3Warning, fmi3Discard, fmi3Error, fmi3Fatal } fmi3Status;
typedef void *fmi3Instance, *fmi3InstanceEnvironment, *fmi3FMUState;
typedef uint32_t fmi3ValueReference;
typedef double fmi3Float64;
typedef bool fmi3Boolean;
typedef const char *fmi3String;
typedef void (*fmi3LogMessageCallback)(fmi3InstanceEnvironment, fmi3Status, fmi3String, fmi3String);
typedef void (*fmi3Callback)(void); /* of what this FMU never calls back */

static void say(const struct voice *me, int status, const char *text) {
    ((fmi3LogMessageCallback)me->logger)(me->environment, (fmi3Status)status,
                                         status == UNIT_WARNING ? "logStatusWarning" : "logStatusError", text);
}

#define FMI(NAME) fmi3##NAME
#define FMI_DERIVATIVES fmi3GetContinuousStateDerivatives
typedef fmi3Status status;
typedef fmi3Instance instance;
typedef fmi3Boolean boolean;
typedef fmi3Float64 real;
#include "fmi.h"

static fmi3Instance instantiate(fmi3String name, fmi3String token, int exchange, fmi3InstanceEnvironment environment,
                                fmi3LogMessageCallback logger) {
    struct voice caller = {.environment = environment, .say = say, .logger = (void (*)(void))logger};
    return unit_new(caller, name, token, exchange);
}

EXPORT const char *fmi3GetVersion(void) { return "3.0"; }

EXPORT fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String resources,
                                                 fmi3Boolean visible, fmi3Boolean logging,
                                                 fmi3InstanceEnvironment environment, fmi3LogMessageCallback logger) {
    (void)resources, (void)visible, (void)logging;
    return instantiate(name, token, 1, environment, logger);
}

EXPORT fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources,
                                                fmi3Boolean visible, fmi3Boolean logging, fmi3Boolean event_mode,
                                                fmi3Boolean early_return, const fmi3ValueReference intermediate[],
                                                size_t n_intermediate, fmi3InstanceEnvironment environment,
                                                fmi3LogMessageCallback logger, fmi3Callback update) {
    (void)resources, (void)visible, (void)logging, (void)event_mode, (void)early_return;
    (void)intermediate, (void)n_intermediate, (void)update;
    return instantiate(name, token, 0, environment, logger);
}

EXPORT fmi3Instance fmi3InstantiateScheduledExecution(fmi3String name, fmi3String token, fmi3String resources,
                                                      fmi3Boolean visible, fmi3Boolean logging,
                                                      fmi3InstanceEnvironment environment,
                                                      fmi3LogMessageCallback logger, fmi3Callback update,
                                                      fmi3Callback lock, fmi3Callback unlock) {
    struct voice caller = {.environment = environment, .say = say, .logger = (void (*)(void))logger};
    (void)name, (void)token, (void)resources, (void)visible, (void)logging, (void)update, (void)lock, (void)unlock;
    unit_say(&caller, UNIT_ERROR, "this FMU is for co-simulation and model exchange, not for scheduled execution");
    return NULL;
}

EXPORT fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean given, fmi3Float64 tolerance,
                                              fmi3Float64 start, fmi3Boolean stops, fmi3Float64 stop) {
    (void)given, (void)tolerance, (void)stops, (void)stop;
    if (start != 0.0) REFUSE("the start time is %g s; this model starts at 0", start);
    return fmi3OK;
}

MODE(EnterStepMode)
MODE(EvaluateDiscreteStates)
MODE(EnterConfigurationMode)
MODE(ExitConfigurationMode)

static fmi3Status check(fmi3Instance c, size_t n, size_t n_values) {
    if (n != n_values) REFUSE("%lu values of %lu variables; all are scalars", (unsigned long)n_values, (unsigned long)n);
    return fmi3OK;
}

EXPORT fmi3Status fmi3GetFloat64(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3Float64 value[],
                                 size_t n_values) {
    if (check(c, n, n_values) != fmi3OK) return fmi3Error;
    return (status)unit_get_real(c, vr, n, value);
}

EXPORT fmi3Status fmi3SetFloat64(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3Float64 value[],
                                 size_t n_values) {
    if (check(c, n, n_values) != fmi3OK) return fmi3Error;
    return (status)unit_set_real(c, vr, n, value);
}

EXPORT fmi3Status fmi3GetInt32(fmi3Instance c, const fmi3ValueReference vr[], size_t n, int32_t value[],
                               size_t n_values) {
    int status = (int)check(c, n, n_values), number;
    for (size_t k = 0; k < n && status == UNIT_OK; k++)
        if ((status = unit_get_integer(c, vr[k], &number)) == UNIT_OK) value[k] = number;
    return (fmi3Status)status;
}

EXPORT fmi3Status fmi3GetBoolean(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3Boolean value[],
                                 size_t n_values) {
    int status = (int)check(c, n, n_values), is;
    for (size_t k = 0; k < n && status == UNIT_OK; k++)
        if ((status = unit_get_boolean(c, vr[k], &is)) == UNIT_OK) value[k] = is != 0;
    return (fmi3Status)status;
}

EXPORT fmi3Status fmi3SetBoolean(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3Boolean value[],
                                 size_t n_values) {
    int status = (int)check(c, n, n_values);
    for (size_t k = 0; k < n && status == UNIT_OK; k++) status = unit_set_boolean(c, vr[k], value[k]);
    return (fmi3Status)status;
}

/* Types of which there are no variables. */
#define REFUSED(NAME, TYPE, WHY, KIND)                                                                        \
    EXPORT fmi3Status fmi3##NAME(fmi3Instance c, const fmi3ValueReference vr[], size_t n, TYPE value[],       \
                                 size_t n_values) {                                                           \
        (void)vr, (void)value, (void)n_values;                                                                \
        if (n > 0) REFUSE(WHY, KIND);                                                                         \
        return fmi3OK;                                                                                        \
    }
#define NOT_SET(KIND, TYPE) REFUSED(Set##KIND, const TYPE, "no variable of type %s can be set", #KIND)
#define NONE(KIND, TYPE) \
    REFUSED(Get##KIND, TYPE, "there are no variables of type %s", #KIND) \
    NOT_SET(KIND, TYPE)
NONE(Float32, float)
NONE(Int8, int8_t)
NONE(UInt8, uint8_t)
NONE(Int16, int16_t)
NONE(UInt16, uint16_t)
NONE(UInt32, uint32_t)
NONE(Int64, int64_t)
NONE(UInt64, uint64_t)
NONE(String, fmi3String)
NOT_SET(Int32, int32_t)

EXPORT fmi3Status fmi3GetBinary(fmi3Instance c, const fmi3ValueReference vr[], size_t n, size_t sizes[],
                                const uint8_t *value[], size_t n_values) {
    (void)vr, (void)sizes, (void)value, (void)n_values;
    if (n > 0) REFUSE("there are no variables of type Binary");
    return fmi3OK;
}

EXPORT fmi3Status fmi3SetBinary(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const size_t sizes[],
                                const uint8_t *const value[], size_t n_values) {
    (void)vr, (void)sizes, (void)value, (void)n_values;
    if (n > 0) REFUSE("no variable of type Binary can be set");
    return fmi3OK;
}

/* Co-simulation. */

EXPORT fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 current, fmi3Float64 size, fmi3Boolean no_set_state,
                             fmi3Boolean *event_needed, fmi3Boolean *terminate, fmi3Boolean *early_return,
                             fmi3Float64 *last_time) {
    fmi3Status done = (status)unit_step(c, current, size);
    (void)no_set_state;
    *event_needed = *terminate = *early_return = false;
    *last_time = pgmp_time(&((struct unit *)c)->model);
    return done;
}

EXPORT fmi3Status fmi3UpdateDiscreteStates(fmi3Instance c, fmi3Boolean *needed, fmi3Boolean *terminate,
                                           fmi3Boolean *nominals_changed, fmi3Boolean *values_changed,
                                           fmi3Boolean *next_defined, fmi3Float64 *next) {
    *needed = *terminate = *nominals_changed = *values_changed = false;
    *next_defined = unit_next_event(c, next) != 0;
    return fmi3OK;
}

EXPORT fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance c, size_t *n) {
    (void)c;
    *n = 0;
    return fmi3OK;
}

EXPORT fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance c, size_t *n) {
    (void)c;
    *n = unit_count_states();
    return fmi3OK;
}

/* What else it cannot do. */
CANNOT(GetFMUState, NOT_KEPT, (void)state, fmi3FMUState *state)
CANNOT(SetFMUState, NOT_KEPT, (void)state, fmi3FMUState state)
CANNOT(FreeFMUState, NOT_KEPT, (void)state, fmi3FMUState *state)
CANNOT(SerializedFMUStateSize, NOT_KEPT, ((void)state, (void)size), fmi3FMUState state, size_t *size)
CANNOT(SerializeFMUState, NOT_KEPT, ((void)state, (void)bytes, (void)size), fmi3FMUState state, uint8_t bytes[],
       size_t size)
CANNOT(DeserializeFMUState, NOT_KEPT, ((void)state, (void)bytes, (void)size), const uint8_t bytes[], size_t size,
       fmi3FMUState *state)
#define NO_DERIVATIVES "there are no derivatives of this kind"
#define SEEDED                                                                                             \
    ((void)unknowns, (void)n_unknowns, (void)knowns, (void)n_knowns, (void)seed, (void)n_seed, (void)found, \
     (void)n_found)
CANNOT(GetDirectionalDerivative, NO_DERIVATIVES, SEEDED, const fmi3ValueReference unknowns[], size_t n_unknowns,
       const fmi3ValueReference knowns[], size_t n_knowns, const fmi3Float64 seed[], size_t n_seed, fmi3Float64 found[],
       size_t n_found)
CANNOT(GetAdjointDerivative, NO_DERIVATIVES, SEEDED, const fmi3ValueReference unknowns[], size_t n_unknowns,
       const fmi3ValueReference knowns[], size_t n_knowns, const fmi3Float64 seed[], size_t n_seed, fmi3Float64 found[],
       size_t n_found)
CANNOT(GetOutputDerivatives, "there are no derivatives of outputs",
       ((void)vr, (void)n, (void)orders, (void)value, (void)n_values), const fmi3ValueReference vr[], size_t n,
       const int32_t orders[], fmi3Float64 value[], size_t n_values)
#define DESCRIBED "which variable depends on which is in modelDescription.xml"
CANNOT(GetNumberOfVariableDependencies, DESCRIBED, ((void)vr, (void)n), fmi3ValueReference vr, size_t *n)
CANNOT(GetVariableDependencies, DESCRIBED,
       ((void)vr, (void)elements, (void)independents, (void)of_elements, (void)kinds, (void)n), fmi3ValueReference vr,
       size_t elements[], fmi3ValueReference independents[], size_t of_elements[], int kinds[], size_t n)
#define NO_CLOCKS "there are no clocks"
#define ONE ((void)vr, (void)n, (void)one)
#define TWO ((void)vr, (void)n, (void)one, (void)other)
#define CLOCKS const fmi3ValueReference vr[], size_t n
CANNOT(GetIntervalDecimal, NO_CLOCKS, TWO, CLOCKS, fmi3Float64 one[], int other[])
CANNOT(GetShiftFraction, NO_CLOCKS, TWO, CLOCKS, uint64_t one[], uint64_t other[])
CANNOT(SetIntervalFraction, NO_CLOCKS, TWO, CLOCKS, const uint64_t one[], const uint64_t other[])
CANNOT(SetShiftFraction, NO_CLOCKS, TWO, CLOCKS, const uint64_t one[], const uint64_t other[])
CANNOT(GetShiftDecimal, NO_CLOCKS, ONE, CLOCKS, fmi3Float64 one[])
CANNOT(SetIntervalDecimal, NO_CLOCKS, ONE, CLOCKS, const fmi3Float64 one[])
CANNOT(SetShiftDecimal, NO_CLOCKS, ONE, CLOCKS, const fmi3Float64 one[])
CANNOT(GetClock, NO_CLOCKS, ONE, CLOCKS, bool one[])
CANNOT(SetClock, NO_CLOCKS, ONE, CLOCKS, const bool one[])
CANNOT(GetIntervalFraction, NO_CLOCKS, ((void)vr, (void)n, (void)counters, (void)resolutions, (void)qualifiers), CLOCKS,
       uint64_t counters[], uint64_t resolutions[], int qualifiers[])
CANNOT(ActivateModelPartition, NO_CLOCKS, ((void)vr, (void)time), fmi3ValueReference vr, fmi3Float64 time)
