/* Instances of an FMU (VERSION of FMI) made, run and freed by threads at once, again and again. */
#include <pthread.h>
#include <stdio.h>
#include <string.h>

#include "unit.h"

enum { N_THREADS = 4, N_TIMES = 3, MANY = 20 };

#if VERSION == 2
typedef struct {
    void (*logger)(void *, const char *, int, const char *, const char *, ...);
    void *others[3], *environment;
} callbacks;
void *fmi2Instantiate(const char *, int, const char *, const char *, const callbacks *, int, int);
int fmi2ExitInitializationMode(void *), fmi2DoStep(void *, double, double, int);
int fmi2GetReal(void *, const unsigned[], size_t, double[]), fmi2SetReal(void *, const unsigned[], size_t, const double[]);
void fmi2FreeInstance(void *);
static void *make(void) {
    callbacks none = {0};
    return fmi2Instantiate("one", 1, FMU_GUID, "", &none, 0, 0);
}
static int begin(void *c) { return fmi2ExitInitializationMode(c); }
static int step(void *c, double at) { return fmi2DoStep(c, at, STEP, 1); }
static int get(void *c, unsigned vr, double *value) { return fmi2GetReal(c, &vr, 1, value); }
static int set(void *c, unsigned vr, double value) { return fmi2SetReal(c, &vr, 1, &value); }
static void release(void *c) { fmi2FreeInstance(c); }
#else
#include <stdbool.h>
void *fmi3InstantiateCoSimulation(const char *, const char *, const char *, bool, bool, bool, bool, const unsigned[],
                                  size_t, void *, void *, void *);
int fmi3ExitInitializationMode(void *), fmi3DoStep(void *, double, double, bool, bool *, bool *, bool *, double *);
int fmi3GetFloat64(void *, const unsigned[], size_t, double[], size_t);
int fmi3SetFloat64(void *, const unsigned[], size_t, const double[], size_t);
void fmi3FreeInstance(void *);
static void *make(void) {
    return fmi3InstantiateCoSimulation("one", FMU_GUID, "", 0, 0, 0, 0, NULL, 0, NULL, NULL, NULL);
}
static int begin(void *c) { return fmi3ExitInitializationMode(c); }
static int step(void *c, double at) {
    bool flags[3];
    double reached;
    return fmi3DoStep(c, at, STEP, 1, flags, flags + 1, flags + 2, &reached);
}
static int get(void *c, unsigned vr, double *value) { return fmi3GetFloat64(c, &vr, 1, value, 1); }
static int set(void *c, unsigned vr, double value) { return fmi3SetFloat64(c, &vr, 1, &value, 1); }
static void release(void *c) { fmi3FreeInstance(c); }
#endif

/* The first output after some steps with a radius of its own. */
static int run(int number, double *found) {
    void *c = make();
    int status = c == NULL;
    if (c == NULL) return status;
    status |= set(c, 0, 5.6e-3 + 1e-4 * number) | begin(c);
    for (int k = 0; k < MANY; k++) status |= step(c, k * STEP);
    status |= get(c, OF_OUTPUTS * BLOCK, found);
    release(c);
    return status;
}

struct task {
    int number, status;
    double found[N_TIMES];
    pthread_t thread;
};

static void *work(void *given) {
    struct task *task = given;
    for (int k = 0; k < N_TIMES; k++) task->status |= run(task->number, task->found + k);
    return NULL;
}

int main(void) {
    static struct task tasks[N_THREADS];
    int status = 0;
    for (int k = 0; k < N_THREADS; k++) {
        tasks[k].number = k;
        pthread_create(&tasks[k].thread, NULL, work, tasks + k);
    }
    for (int k = 0; k < N_THREADS; k++) {
        double alone;
        pthread_join(tasks[k].thread, NULL);
        status |= tasks[k].status | run(k, &alone);
        for (int i = 0; i < N_TIMES; i++) status |= memcmp(&alone, tasks[k].found + i, sizeof alone) != 0;
    }
    puts(status == 0 ? "the same" : "others");
    return status != 0;
}
