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

#define FAIL(...) return (fmi3Status)unit_say(c, UNIT_ERROR, __VA_ARGS__)

static fmi3Instance instantiate(fmi3String name, fmi3String token, int exchange, fmi3InstanceEnvironment environment,
                                fmi3LogMessageCallback logger) {
    struct voice caller = {.environment = environment, .say = say, .logger = (void (*)(void))logger};
    return unit_new(caller, name, token, exchange);
}

EXPORT const char *fmi3GetVersion(void) { return "3.0"; }

EXPORT fmi3Status fmi3SetDebugLogging(fmi3Instance c, fmi3Boolean on, size_t n, const fmi3String categories[]) {
    (void)c, (void)on, (void)n, (void)categories;
    return fmi3OK; /* errors and warnings are always said */
}

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

EXPORT void fmi3FreeInstance(fmi3Instance c) { unit_free(c); }

EXPORT fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean given, fmi3Float64 tolerance,
                                              fmi3Float64 start, fmi3Boolean stops, fmi3Float64 stop) {
    (void)given, (void)tolerance, (void)stops, (void)stop;
    if (start != 0.0) FAIL("the start time is %g s; this model starts at 0", start);
    return fmi3OK;
}

EXPORT fmi3Status fmi3ExitInitializationMode(fmi3Instance c) { return (fmi3Status)unit_begin(c); }
EXPORT fmi3Status fmi3Reset(fmi3Instance c) { return (fmi3Status)unit_reset(c); }

/* Modes that ask for nothing here. */
#define MODE(NAME)                             \
    EXPORT fmi3Status fmi3##NAME(fmi3Instance c) { \
        (void)c;                               \
        return fmi3OK;                         \
    }
MODE(Terminate)
MODE(EnterEventMode)
MODE(EnterContinuousTimeMode)
MODE(EnterStepMode)
MODE(EvaluateDiscreteStates)
MODE(EnterConfigurationMode)
MODE(ExitConfigurationMode)

static fmi3Status check(fmi3Instance c, size_t n, size_t n_values) {
    if (n != n_values) FAIL("%lu values of %lu variables; all are scalars", (unsigned long)n_values, (unsigned long)n);
    return fmi3OK;
}

EXPORT fmi3Status fmi3GetFloat64(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3Float64 value[],
                                 size_t n_values) {
    if (check(c, n, n_values) != fmi3OK) return fmi3Error;
    return (fmi3Status)unit_get_real(c, vr, n, value);
}

EXPORT fmi3Status fmi3SetFloat64(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3Float64 value[],
                                 size_t n_values) {
    if (check(c, n, n_values) != fmi3OK) return fmi3Error;
    return (fmi3Status)unit_set_real(c, vr, n, value);
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
#define NONE(KIND, TYPE)                                                                                            \
    EXPORT fmi3Status fmi3Get##KIND(fmi3Instance c, const fmi3ValueReference vr[], size_t n, TYPE value[],          \
                                    size_t n_values) {                                                              \
        (void)vr, (void)value, (void)n_values;                                                                      \
        if (n > 0) FAIL("there are no variables of type %s", #KIND);                                                \
        return fmi3OK;                                                                                              \
    }                                                                                                               \
    NOT_SET(KIND, TYPE)
#define NOT_SET(KIND, TYPE)                                                                                         \
    EXPORT fmi3Status fmi3Set##KIND(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const TYPE value[],    \
                                    size_t n_values) {                                                              \
        (void)vr, (void)value, (void)n_values;                                                                      \
        if (n > 0) FAIL("no variable of type %s can be set", #KIND);                                                \
        return fmi3OK;                                                                                              \
    }
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
    if (n > 0) FAIL("there are no variables of type Binary");
    return fmi3OK;
}

EXPORT fmi3Status fmi3SetBinary(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const size_t sizes[],
                                const uint8_t *const value[], size_t n_values) {
    (void)vr, (void)sizes, (void)value, (void)n_values;
    if (n > 0) FAIL("no variable of type Binary can be set");
    return fmi3OK;
}

/* Co-simulation. */

EXPORT fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 current, fmi3Float64 size, fmi3Boolean no_set_state,
                             fmi3Boolean *event_needed, fmi3Boolean *terminate, fmi3Boolean *early_return,
                             fmi3Float64 *last_time) {
    fmi3Status status = (fmi3Status)unit_step(c, current, size);
    (void)no_set_state;
    *event_needed = *terminate = *early_return = false;
    *last_time = pgmp_time(&((struct unit *)c)->model);
    return status;
}

/* Model exchange. */

EXPORT fmi3Status fmi3UpdateDiscreteStates(fmi3Instance c, fmi3Boolean *needed, fmi3Boolean *terminate,
                                           fmi3Boolean *nominals_changed, fmi3Boolean *values_changed,
                                           fmi3Boolean *next_defined, fmi3Float64 *next) {
    *needed = *terminate = *nominals_changed = *values_changed = false;
    *next_defined = unit_next_event(c, next) != 0;
    return fmi3OK;
}

EXPORT fmi3Status fmi3CompletedIntegratorStep(fmi3Instance c, fmi3Boolean no_set_state, fmi3Boolean *enter_event_mode,
                                              fmi3Boolean *terminate) {
    (void)no_set_state;
    unit_end_step(c);
    *enter_event_mode = *terminate = false;
    return fmi3OK;
}

EXPORT fmi3Status fmi3SetTime(fmi3Instance c, fmi3Float64 time) {
    unit_set_time(c, time);
    return fmi3OK;
}

EXPORT fmi3Status fmi3SetContinuousStates(fmi3Instance c, const fmi3Float64 x[], size_t n) {
    return (fmi3Status)unit_set_states(c, n, x);
}

EXPORT fmi3Status fmi3GetContinuousStates(fmi3Instance c, fmi3Float64 x[], size_t n) {
    return (fmi3Status)unit_get_states(c, n, x);
}

EXPORT fmi3Status fmi3GetContinuousStateDerivatives(fmi3Instance c, fmi3Float64 derivatives[], size_t n) {
    return (fmi3Status)unit_get_derivatives(c, n, derivatives);
}

EXPORT fmi3Status fmi3GetNominalsOfContinuousStates(fmi3Instance c, fmi3Float64 nominals[], size_t n) {
    return (fmi3Status)unit_get_nominals(c, n, nominals);
}

EXPORT fmi3Status fmi3GetEventIndicators(fmi3Instance c, fmi3Float64 indicators[], size_t n) {
    (void)indicators;
    if (n > 0) FAIL("there are no event indicators");
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

/* What the model description says this FMU cannot do. */
#define CANNOT(NAME, ...)                                    \
    EXPORT fmi3Status fmi3##NAME(fmi3Instance c, __VA_ARGS__) { \
        REFUSE;                                              \
    }

#define REFUSE (void)state; FAIL("states are not kept")
CANNOT(GetFMUState, fmi3FMUState *state)
CANNOT(SetFMUState, fmi3FMUState state)
CANNOT(FreeFMUState, fmi3FMUState *state)
#undef REFUSE
#define REFUSE (void)state, (void)size; FAIL("states are not kept")
CANNOT(SerializedFMUStateSize, fmi3FMUState state, size_t *size)
#undef REFUSE
#define REFUSE (void)state, (void)bytes, (void)size; FAIL("states are not kept")
CANNOT(SerializeFMUState, fmi3FMUState state, uint8_t bytes[], size_t size)
CANNOT(DeserializeFMUState, const uint8_t bytes[], size_t size, fmi3FMUState *state)
#undef REFUSE
#define REFUSE                                                                                            \
    (void)unknowns, (void)n_unknowns, (void)knowns, (void)n_knowns, (void)seed, (void)n_seed, (void)found, \
        (void)n_found;                                                                                    \
    FAIL("there are no derivatives of this kind")
CANNOT(GetDirectionalDerivative, const fmi3ValueReference unknowns[], size_t n_unknowns,
       const fmi3ValueReference knowns[], size_t n_knowns, const fmi3Float64 seed[], size_t n_seed, fmi3Float64 found[],
       size_t n_found)
CANNOT(GetAdjointDerivative, const fmi3ValueReference unknowns[], size_t n_unknowns, const fmi3ValueReference knowns[],
       size_t n_knowns, const fmi3Float64 seed[], size_t n_seed, fmi3Float64 found[], size_t n_found)
#undef REFUSE
#define REFUSE (void)vr, (void)n, (void)orders, (void)value, (void)n_values; FAIL("there are no derivatives of outputs")
CANNOT(GetOutputDerivatives, const fmi3ValueReference vr[], size_t n, const int32_t orders[], fmi3Float64 value[],
       size_t n_values)
#undef REFUSE
#define REFUSE (void)vr, (void)n; FAIL("which variable depends on which is in modelDescription.xml")
CANNOT(GetNumberOfVariableDependencies, fmi3ValueReference vr, size_t *n)
#undef REFUSE
#define REFUSE                                                                                       \
    (void)vr, (void)elements, (void)independents, (void)of_elements, (void)kinds, (void)n;           \
    FAIL("which variable depends on which is in modelDescription.xml")
CANNOT(GetVariableDependencies, fmi3ValueReference vr, size_t elements[], fmi3ValueReference independents[],
       size_t of_elements[], int kinds[], size_t n)
#undef REFUSE
#define REFUSE (void)vr, (void)n, (void)one, (void)other; FAIL("there are no clocks")
CANNOT(GetIntervalDecimal, const fmi3ValueReference vr[], size_t n, fmi3Float64 one[], int other[])
CANNOT(GetShiftFraction, const fmi3ValueReference vr[], size_t n, uint64_t one[], uint64_t other[])
CANNOT(SetIntervalFraction, const fmi3ValueReference vr[], size_t n, const uint64_t one[], const uint64_t other[])
CANNOT(SetShiftFraction, const fmi3ValueReference vr[], size_t n, const uint64_t one[], const uint64_t other[])
#undef REFUSE
#define REFUSE (void)vr, (void)n, (void)one; FAIL("there are no clocks")
CANNOT(GetShiftDecimal, const fmi3ValueReference vr[], size_t n, fmi3Float64 one[])
CANNOT(SetIntervalDecimal, const fmi3ValueReference vr[], size_t n, const fmi3Float64 one[])
CANNOT(SetShiftDecimal, const fmi3ValueReference vr[], size_t n, const fmi3Float64 one[])
CANNOT(GetClock, const fmi3ValueReference vr[], size_t n, bool one[])
CANNOT(SetClock, const fmi3ValueReference vr[], size_t n, const bool one[])
#undef REFUSE
#define REFUSE (void)vr, (void)n, (void)counters, (void)resolutions, (void)qualifiers; FAIL("there are no clocks")
CANNOT(GetIntervalFraction, const fmi3ValueReference vr[], size_t n, uint64_t counters[], uint64_t resolutions[],
       int qualifiers[])
#undef REFUSE
#define REFUSE (void)vr, (void)time; FAIL("there are no clocks")
CANNOT(ActivateModelPartition, fmi3ValueReference vr, fmi3Float64 time)
