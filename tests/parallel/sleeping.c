/* Ranks that wait for a message give the processor away with sched_yield, which on Linux leaves them in line with those
   that work. Tests have more ranks than cores, and two jobs at once: here a rank that has waited for a while sleeps
   between its looks, longer from one to the next. Its work in between is told by its own time: on a busy machine it
   stands in line meanwhile. It asks for short turns, so that it has one soon after it wakes: beside other jobs ranks
   that exchange much take half as long with them. Kernels before 6.12 do not mind. */
#define _GNU_SOURCE
#include <sched.h>
#include <stdint.h>
#include <sys/prctl.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

enum { LOOKS = 20, BUSY_NS = 20000, PAUSE_NS = 20000, LONGEST_NS = 200000, TURN_NS = 200000 };

/* sched_attr of Linux, which libraries do not declare everywhere */
struct turns {
    uint32_t size, policy;
    uint64_t flags;
    int32_t nice;
    uint32_t priority;
    uint64_t runtime, deadline, period;
};

static long long now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
    return 1000000000LL * t.tv_sec + t.tv_nsec;
}

static void take_short_turns(void)
{
    struct turns turns = {.size = sizeof turns};

    if (syscall(SYS_sched_getattr, 0, &turns, sizeof turns, 0) == 0 && turns.policy == SCHED_OTHER) {
        turns.runtime = TURN_NS;
        syscall(SYS_sched_setattr, 0, &turns, 0);
    }
}

int sched_yield(void)
{
    static long long last;
    static int looks;
    static struct timespec pause = {0, PAUSE_NS};

    if (last == 0) {
        prctl(PR_SET_TIMERSLACK, 1000);
        take_short_turns();
    }
    if (now() - last > BUSY_NS)
        looks = 0; /* it has worked in between */
    if (++looks < LOOKS)
        syscall(SYS_sched_yield);
    else {
        pause.tv_nsec = looks == LOOKS ? PAUSE_NS : pause.tv_nsec + pause.tv_nsec / 8;
        if (pause.tv_nsec > LONGEST_NS)
            pause.tv_nsec = LONGEST_NS;
        nanosleep(&pause, 0);
    }
    last = now();
    return 0;
}
