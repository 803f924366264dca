# shellcheck shell=bash
# What the job scripts beside it share; they source it from the directory that they were submitted from, the checkout.
#
# A job runs one `pgmp` command that keeps what is finished in <output>.partial. Before the wall time ends it is stopped
# and the job submits itself again, to run after its own end; the next one takes up what is there. A job that finished
# nothing is not repeated.
#
#   RANKS     number of ranks (default: what the scheduler has given)
#   EXTRA     further options of pgmp, quoted as in a shell; what stands after -- goes to PETSc
#   MODULES   modules to load, such as "petsc slepc"
#   SUBMIT    options of sbatch or qsub that the next job needs too
#   LAUNCH    what starts the ranks, if not `srun --ntasks RANKS` or `mpirun -n RANKS`
#   LEAD      seconds from stopping the command to the end of the job (default: 120)

readonly pgmp=.venv/bin/pgmp
# filled by the functions below
command=() extra=() output='' before='' older='' status=0 stopped=false

fail() {
    echo "${0##*/}: $*" >&2
    exit 2
}

# NAME...: refuse to start without these variables.
needed() {
    local name
    for name in "$@"; do
        [ -n "${!name:-}" ] || fail "$name is not set; needed: $* (see docs/hpc.md)"
    done
}

prepare() {
    [ -x "$pgmp" ] || fail "no $pgmp in $PWD: submit from the checkout, after scripts/setup"
    if [ -n "${MODULES:-}" ]; then
        set +u  # modules are not written for it
        # shellcheck disable=SC2086  # names of several modules
        module load $MODULES
        set -u
    fi
    # shellcheck source=scripts/mpi_env.sh
    source scripts/mpi_env.sh
    mapfile -t extra < <(xargs -r printf '%s\n' <<<"${EXTRA:-}")
}

build_command() {
    needed SCENE ROM
    output=$ROM
    command=("$pgmp" build "$SCENE" -o "$output")
    resume_if_stopped
}

montecarlo_command() {
    needed ROM SAMPLES
    output=${OUTPUT:-${ROM%.h5}_samples.h5}
    command=("$pgmp" montecarlo "$ROM" -n "$SAMPLES" --seed "${SEED:-0}" -o "$output")
    resume_if_stopped
}

# Not at once: a command that keeps nothing, such as a build with a tolerance, refuses --resume.
resume_if_stopped() {
    [ ! -e "$output.partial" ] || command+=(--resume)
    command+=("${extra[@]}")
    before=$(finished) older=$(written)
}

# Changes with every part of the work that the command keeps.
finished() {
    local part=(-type f ! -name run.json ! -name '*.writing')
    { [ ! -e "$output.partial" ] || find "$output.partial" "${part[@]}" -printf '%p %s %T@\n'; } | sort | cksum
}

# Changes when the result is written.
written() {
    [ ! -e "$output" ] || stat -c '%i %Y %s' "$output"
}

# DEFAULT...: run the command through LAUNCH or the default until it ends or USR1 comes; sets status and stopped.
run_until_signal() {
    local launch=("$@") child
    [ -z "${LAUNCH:-}" ] || read -ra launch <<<"$LAUNCH"
    echo "\$ ${launch[*]} ${command[*]}"
    trap 'stopped=true' USR1
    "${launch[@]}" "${command[@]}" &
    child=$!
    wait "$child" || status=$?
    if $stopped; then
        stop "$child"
    fi
}

# PID: end a process, gently at first, and set its status.
stop() {
    local waited=0
    echo "stopped before the end of the wall time"
    kill -TERM "$1" 2>/dev/null || true
    while kill -0 "$1" 2>/dev/null && [ "$waited" -lt $((${LEAD:-120} / 2)) ]; do
        sleep 1
        waited=$((waited + 1))
    done
    if kill -0 "$1" 2>/dev/null; then
        kill -KILL "$1" || true
    fi
    status=0
    wait "$1" || status=$?
}

# SECONDS DEFAULT...: the same for a scheduler without such a signal, after so many seconds less LEAD.
run_for() {
    local seconds=$(($1 - ${LEAD:-120})) start=$SECONDS launch=("${@:2}")
    [ -z "${LAUNCH:-}" ] || read -ra launch <<<"$LAUNCH"
    [ "$seconds" -gt 0 ] || fail "a wall time of more than ${LEAD:-120} s is needed"
    echo "\$ timeout $seconds ${launch[*]} ${command[*]}"
    timeout --kill-after=$((${LEAD:-120} / 2)) "$seconds" "${launch[@]}" "${command[@]}" || status=$?
    # its status alone does not tell: a command killed for its memory has the same
    if [ $((SECONDS - start)) -ge "$seconds" ]; then
        stopped=true
        echo "stopped before the end of the wall time"
    fi
}

# The wall time of a PBS job, in seconds: WALLTIME, what qstat says, or that of the scripts' heads.
pbs_seconds() {
    local text=${WALLTIME:-}
    if [ -z "$text" ] && command -v qstat >/dev/null; then
        text=$(qstat -f "${PBS_JOBID:-}" 2>/dev/null | sed -n 's/^ *Resource_List\.walltime = //p') || true
    fi
    awk -F: '{ for (i = 1; i <= NF; i++) seconds = 60 * seconds + $i; print seconds }' <<<"${text:-04:00:00}"
}

pbs_ranks() {
    if [ -n "${RANKS:-}" ]; then
        echo "$RANKS"
    elif [ -n "${PBS_NODEFILE:-}" ]; then
        awk 'END { print NR }' "$PBS_NODEFILE"
    else
        echo 1
    fi
}

# SUBMIT_COMMAND...: end the job; where it was stopped, submit the next one.
finish() {
    local options
    if [ "$status" -eq 0 ] || ! $stopped; then
        exit "$status"
    fi
    if [ "$(written)" != "$older" ]; then
        echo "done at the last moment"
        exit 0
    fi
    if [ "$(finished)" = "$before" ]; then
        echo "${0##*/}: nothing was finished within the wall time; a longer one, or more ranks, are needed" >&2
        exit "$status"
    fi
    read -ra options <<<"${SUBMIT:-}"
    "$1" "${options[@]}" "${@:2}"
}
