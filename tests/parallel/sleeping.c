/* Ranks that wait for a message give the processor away with sched_yield, which on Linux leaves them in line with those
   that work. Tests have more ranks than cores, and two jobs at once: here a rank that has waited for a while sleeps
   between its looks, longer from one to the next. Its work in between is told by its own time: on a busy machine it
   stands in line meanwhile. */
#define _GNU_SOURCE
#include <sched.h>
#include <sys/prctl.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

enum { LOOKS = 2000, BUSY_NS = 20000, PAUSE_NS = 20000, LONGEST_NS = 1000000 };

static long long now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
    return 1000000000LL * t.tv_sec + t.tv_nsec;
}

int sched_yield(void)
{
    static long long last;
    static int looks;
    static struct timespec pause = {0, PAUSE_NS};

    if (last == 0)
        prctl(PR_SET_TIMERSLACK, 1000);
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
