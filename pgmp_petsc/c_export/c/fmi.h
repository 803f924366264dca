/* What the versions of FMI have in common; included behind the declarations of one, which has defined

     FMI(NAME)       the version's own name of a function or a type
     FMI_DERIVATIVES the function that gives derivatives of states
     status, instance, reference, real, boolean

   written by pgmp_petsc */

#define REFUSE(...) return (status)unit_say(c, UNIT_ERROR, __VA_ARGS__)

EXPORT status FMI(SetDebugLogging)(instance c, boolean on, size_t n, const FMI(String) categories[]) {
    (void)c, (void)on, (void)n, (void)categories;
    return FMI(OK); /* errors and warnings are always said */
}

EXPORT void FMI(FreeInstance)(instance c) { unit_free(c); }
EXPORT status FMI(ExitInitializationMode)(instance c) { return (status)unit_begin(c); }
EXPORT status FMI(Reset)(instance c) { return (status)unit_reset(c); }

/* Modes that ask for nothing here. */
#define MODE(NAME)                          \
    EXPORT status FMI(NAME)(instance c) {   \
        (void)c;                            \
        return FMI(OK);                     \
    }
MODE(Terminate)
MODE(EnterEventMode)
MODE(EnterContinuousTimeMode)

/* Model exchange. */

EXPORT status FMI(CompletedIntegratorStep)(instance c, boolean no_set_state, boolean *enter_event_mode,
                                           boolean *terminate) {
    (void)no_set_state;
    unit_end_step(c);
    *enter_event_mode = *terminate = 0;
    return FMI(OK);
}

EXPORT status FMI(SetTime)(instance c, real time) {
    unit_set_time(c, time);
    return FMI(OK);
}

EXPORT status FMI(SetContinuousStates)(instance c, const real x[], size_t n) {
    return (status)unit_set_states(c, n, x);
}

EXPORT status FMI(GetContinuousStates)(instance c, real x[], size_t n) { return (status)unit_get_states(c, n, x); }
EXPORT status FMI_DERIVATIVES(instance c, real x[], size_t n) { return (status)unit_get_derivatives(c, n, x); }

EXPORT status FMI(GetNominalsOfContinuousStates)(instance c, real nominals[], size_t n) {
    return (status)unit_get_nominals(c, n, nominals);
}

EXPORT status FMI(GetEventIndicators)(instance c, real indicators[], size_t n) {
    (void)indicators;
    if (n > 0) REFUSE("there are no event indicators");
    return FMI(OK);
}

/* What the model description says this FMU cannot do: each with what it takes, and why not. */
#define CANNOT(NAME, WHY, IGNORED, ...)              \
    EXPORT status FMI(NAME)(instance c, __VA_ARGS__) { \
        IGNORED;                                     \
        REFUSE(WHY);                                   \
    }
#define NOT_KEPT "states are not kept"
