# shellcheck shell=bash
# What the job scripts beside it share; they source it from the directory that they were submitted from, the checkout.
#
# A job runs one `pgmp` command that keeps what is finished in <output>.partial. LEAD seconds before its wall time ends
# the command is stopped, and the job is queued again: by SLURM under the same id, else as a new job with the same
# options. The next one takes up what is there. A job that finished nothing is not repeated. A job that was stopped ends
# with status 75, so that jobs that depend on its success do not begin. docs/hpc.md lists the variables.

readonly pgmp=.venv/bin/pgmp python=.venv/bin/python
: "${script:?}"  # the name of the one that sources this
readonly STOPPED=75  # EX_TEMPFAIL of sysexits.h: not done, to be tried again
readonly array_index=${SLURM_ARRAY_TASK_ID:-${PBS_ARRAY_INDEX:-${PGMP_INDEX:-}}}
# the number of an array's last job is that of the whole array
own=${SLURM_JOB_ID:-${PBS_JOBID:-}}
[ -z "${SLURM_ARRAY_TASK_ID:-}" ] || own=${SLURM_ARRAY_JOB_ID}_$SLURM_ARRAY_TASK_ID
readonly own
# filled by the functions below
command=() extra=() launch=() output='' before='' older='' status=0 seconds='' lead=120
stopped=false resumed=false ended_by=''
# before anything that takes time: without them a signal ends the script without a word
trap 'stopped=true' USR1
trap 'ended_by=SIGTERM' TERM
trap 'ended_by=SIGINT' INT

fail() {
    echo "$script: $*" >&2
    exit 2
}

# NAME...: refuse to start without these variables.
needed() {
    local name
    for name in "$@"; do
        [ -n "${!name:-}" ] || fail "$name is not set; needed: $* (see docs/hpc.md)"
    done
}

# NAME: a variable's value with the index of the job array in the place of %a.
indexed() {
    local value=${!1:-}
    if [[ $value == *%a* && -z $array_index ]]; then
        fail "$1 = $value: %a is the index in a job array, and this job is in none"
    fi
    printf '%s' "${value//'%a'/$array_index}"
}

# NAME: an output that was given has to differ from job to job of an array.
of_its_own() {
    if [[ -n $array_index && ${!1} != *%a* ]]; then
        fail "$1 = ${!1}: all jobs of the array would write this file; put %a, the index, into its name"
    fi
}

prepare() {
    [ -x "$pgmp" ] || fail "no $pgmp in $PWD: submit from the checkout, after scripts/setup"
    echo "== $script${own:+, job $own}${SLURM_RESTART_COUNT:+, restart $SLURM_RESTART_COUNT}," \
        "$HOSTNAME, $(date '+%Y-%m-%d %H:%M:%S')"
    if [ -n "${MODULES:-}" ]; then
        set +u  # modules are not written for it
        # shellcheck disable=SC2086  # names of several modules
        module load $MODULES
        set -u
    fi
    # shellcheck source=scripts/mpi_env.sh
    source scripts/mpi_env.sh
}

build_command() {
    local scene
    needed SCENE ROM
    of_its_own ROM
    scene=$(indexed SCENE)
    output=$(indexed ROM)
    command=("$pgmp" build "$scene" -o "$output")
    resume_if_stopped
}

# In an array the seed is SEED plus the index: the same samples again would say nothing new. With SHARDS the jobs are
# parts of one ensemble, and the index, from 1, is the number of the part.
montecarlo_command() {
    local seed=${SEED:-0} rom name samples part=()
    needed ROM SAMPLES
    [[ $seed =~ ^[0-9]+$ ]] || fail "SEED = $seed: needed: a whole number, 0 or more"
    seed=$((10#$seed))
    rom=$(indexed ROM)
    samples=$(indexed SAMPLES)
    name=${rom%.h5}
    if [ -n "${SHARDS:-}" ]; then
        [ -n "${array_index:-}" ] || fail "SHARDS = $SHARDS: needed: an array of jobs, one a shard, from 1 to $SHARDS"
        output=${name%.toml}_samples_seed${seed}_shard${array_index}of$SHARDS.h5
        part=(--shard "$array_index/$SHARDS")
    else
        seed=$((seed + ${array_index:-0}))
        output=${name%.toml}_samples_seed$seed.h5
    fi
    if [ -n "${OUTPUT:-}" ]; then
        of_its_own OUTPUT
        output=$(indexed OUTPUT)
    fi
    command=("$pgmp" montecarlo "$rom" -n "$samples" --seed "$seed" "${part[@]}" -o "$output")
    resume_if_stopped
}

# Not at once: a command that keeps nothing, such as a build with a tolerance, refuses --resume.
resume_if_stopped() {
    local text
    text=$(indexed EXTRA)
    text=$(xargs -r printf '%s\n' <<<"$text" 2>/dev/null) || fail "EXTRA = $EXTRA: quotes do not match"
    [ -z "$text" ] || mapfile -t extra <<<"$text"
    if [ -e "$output.partial" ]; then
        resumed=true
        command+=(--resume)
        echo "'$output.partial' is there: $script goes on from it (--resume)"
    fi
    command+=("${extra[@]}")
    before=$(finished) older=$(written)
}

# Changes with every part of the work that the command keeps.
finished() {
    { [ ! -e "$output.partial" ] || find "$output.partial" -type f -name '*.npz' -printf '%p %s %T@\n'; } | sort | cksum
}

# Changes when the result is written.
written() {
    [ ! -e "$output" ] || stat -c '%i %Y %s' "$output"
}

# COMMAND...: whether it starts as many ranks as wanted in one MPI; without a PMI each would be alone with all the work.
starts_mpi() {
    local world='import sys; from mpi4py import MPI; sys.exit(MPI.COMM_WORLD.size != int(sys.argv[1]))'
    timeout 120 "$@" "$python" -c "$world" "$ranks" </dev/null
}

# What starts the ranks in a SLURM job: as the site has it, else what works. SLURM's own default is --mpi=none.
slurm_launch() {
    local way ways said='' known
    ranks=${RANKS:-${SLURM_NTASKS:-1}}
    [ -z "${LAUNCH:-}" ] || { read -ra launch <<<"$LAUNCH"; return; }
    ways=(srun)
    known=$(srun --mpi=list 2>&1) || true
    for way in pmix pmi2; do
        ! grep -qw "$way" <<<"$known" || ways+=("srun --mpi=$way")
    done
    for way in "${ways[@]}" mpirun; do
        read -ra launch <<<"$way"
        case $way in mpirun) launch+=(-n "$ranks") ;; *) launch+=(--ntasks "$ranks") ;; esac
        if known=$(starts_mpi "${launch[@]}" 2>&1); then
            [ -z "$said" ] || echo "started with '$way': it works here, and 'srun' does not"
            return
        fi
        said="$said"$'\n'"$way: $(tail -n 3 <<<"$known")"
    done
    fail "nothing starts $ranks rank(s) in one MPI; tried:$said"$'\n'"say how with LAUNCH (see docs/hpc.md)"
}

# What starts the ranks in a PBS job.
pbs_launch() {
    ranks=${RANKS:-}
    if [ -z "$ranks" ]; then
        ranks=1
        [ -z "${PBS_NODEFILE:-}" ] || ranks=$(awk 'END { print NR }' "$PBS_NODEFILE")
    fi
    launch=(mpirun -n "$ranks")
    [ -z "${LAUNCH:-}" ] || read -ra launch <<<"$LAUNCH"
}

# TEXT: seconds of 90, 1:30, 00:01:30 or 0-00:01:30.
seconds_of() {
    awk -F '[:-]' '{ for (i = NF; i > 0; i--) { s += $i * w[NF - i] } print s }
        BEGIN { w[0] = 1; w[1] = 60; w[2] = 3600; w[3] = 86400 }' <<<"$1"
}

# QUESTION...: what the scheduler answers, asked three times; fails where there is no answer.
asked() {
    local answer try
    for try in 1 2 3; do
        if answer=$("$@" 2>/dev/null) && [ -n "$answer" ]; then
            echo "$answer"
            return
        fi
        [ "$try" -eq 3 ] || sleep 2
    done
    return 1
}

# Set how long the job has, and how long before its end the command is stopped.
slurm_time() {
    local left=${WALLTIME:-}
    [ -n "$left" ] || left=$(asked squeue --noheader --jobs "$own" --format %L) ||
        fail "squeue does not say how long this job has; say it with WALLTIME=seconds"
    keep_time "$left"
}

pbs_time() {
    local left=${WALLTIME:-} known
    if [ -z "$left" ]; then
        known=$(asked pbs_job) || fail "qstat does not say how long this job has; say it with WALLTIME=seconds"
        left=$(field Resource_List.walltime <<<"$known")
    fi
    keep_time "$left"
}

# TEXT: the time that is left; LEAD is 120 s, or a quarter of it where that is less.
keep_time() {
    local left
    case $1 in
        UNLIMITED | '')
            echo "the job has no wall time: the command runs to its end"
            return
            ;;
        *[!0-9:-]*) fail "how long this job has is not understood: '$1'; say it with WALLTIME=seconds" ;;
    esac
    left=$(seconds_of "$1")
    lead=${LEAD:-$((left < 480 ? left / 4 : 120))}
    [[ $lead =~ ^[0-9]+$ ]] || fail "LEAD = $lead: needed: a number of seconds"
    lead=$((10#$lead))
    seconds=$((left - lead))
    [ "$seconds" -gt 0 ] || fail "LEAD = $lead: the job has $left s in all; give it more, or a smaller LEAD"
    echo "$left s left; the command is stopped after $seconds s"
}

# The job as PBS has it, one attribute a line.
pbs_job() {
    qstat -f "${PBS_JOBID:-}" | sed -e ':a' -e 'N' -e '$!ba' -e 's/\n\t//g'
}

# NAME: an attribute of such a job.
field() {
    awk -v name="$1" '{ place = index($0, " = ") } { key = substr($0, 1, place - 1); gsub(/ /, "", key) }
        key == name { print substr($0, place + 3); exit }'
}

# Run the command until it ends, the time is over, or a signal comes; sets status, stopped and ended_by.
run_command() {
    local child clock=''
    echo "\$ ${launch[*]} ${command[*]}"
    if $stopped || [ -n "$ended_by" ]; then
        echo "$script: a signal came before the command had begun" >&2
        status=$STOPPED
        return
    fi
    if [ -n "$seconds" ]; then
        # its streams are closed: nobody is to wait for it
        alarm "$seconds" </dev/null >/dev/null 2>&1 &
        clock=$!
    fi
    "${launch[@]}" "${command[@]}" &
    child=$!
    # a signal ends the waiting, not the command
    while true; do
        status=0
        wait "$child" || status=$?
        kill -0 "$child" 2>/dev/null || break
        if $stopped || [ -n "$ended_by" ]; then
            stop "$child"
            break
        fi
    done
    [ -z "$clock" ] || kill "$clock" 2>/dev/null || true
}

# SECONDS: send USR1 to the script after them.
alarm() {
    trap 'kill $!; exit' TERM
    trap - USR1 INT
    sleep "$1" &
    wait $!
    kill -USR1 $$
}

# PID: end the command and set its status. It ends itself with USR1, which mpirun and srun pass on; srun answers TERM by
# killing the ranks.
stop() {
    local gentle
    [ -n "$ended_by" ] || echo "stopped before the end of the wall time"
    for gentle in USR1 TERM; do
        kill -s "$gentle" "$1" 2>/dev/null || break
        ended_within $((lead / 4 + 1)) "$1" && break
    done
    kill -s KILL "$1" 2>/dev/null || true
    status=0
    wait "$1" || status=$?
}

# SECONDS PID: whether it ends within them.
ended_within() {
    local tenths=$(($1 * 10))
    while kill -0 "$2" 2>/dev/null; do
        [ "$tenths" -gt 0 ] || return 1
        tenths=$((tenths - 1))
        sleep 0.1
    done
}

# End the job; where it was stopped, queue the rest of its work with the function that is named.
finish() {
    if [ "$(written)" != "$older" ] && { [ "$status" -eq 0 ] || $stopped; }; then
        ! $stopped || echo "done at the last moment"
        status=0
    elif [ -n "$ended_by" ]; then
        echo "$script: ended from outside ($ended_by: cancelled, preempted, or out of time);" \
            "no further job is submitted, $(kept)" >&2
        exit 143
    elif $stopped; then
        if [ "$(finished)" = "$before" ]; then
            echo "$script: nothing was finished within the wall time; a longer one, or more ranks, are needed" >&2
            [ "$status" -ne 0 ] || status=1
            exit "$status"
        fi
        if ! "$1"; then
            echo "$script: the rest could not be queued; $(kept)" >&2
            exit 1
        fi
        exit "$STOPPED"
    elif [ "$status" -ne 0 ]; then
        echo "$script: the command ended with status $status; its own message begins with 'pgmp:'" >&2
        if $resumed && [ "$status" -eq 2 ]; then
            echo "$script: it was to go on from '$output.partial'. If that belongs to another run that nobody needs" \
                "any more: rm -r '$output.partial', and submit again; else give another output" >&2
        elif [ "$status" -gt 128 ]; then
            echo "$script: a signal ended it (memory, perhaps); $(kept)" >&2
        fi
        exit "$status"
    fi
    if [ "$status" -eq 0 ] && [ -n "${THEN:-}" ]; then
        echo "\$ $THEN"
        bash -c "$THEN"
    fi
    exit "$status"
}

kept() {
    if [ -e "$output.partial" ]; then
        echo "what was finished is in '$output.partial': the same job goes on from there"
    else
        echo "nothing is kept of what was not done"
    fi
}

# Under the same id, so that jobs which depend on this one wait; else as a new job with the options of this one.
slurm_again() {
    local options further limit pair name
    if scontrol requeue "$own"; then
        echo "job $own is queued again under its id"
        return
    fi
    echo "SLURM does not queue job $own again; a new job goes on." \
        "Jobs that depend on the success of this one will not begin"
    options=(--ntasks="${SLURM_NTASKS:-1}")
    ! limit=$(asked squeue --noheader --jobs "$own" --format %l) || options+=(--time="$limit")
    for pair in job-name:SLURM_JOB_NAME partition:SLURM_JOB_PARTITION account:SLURM_JOB_ACCOUNT qos:SLURM_JOB_QOS \
        reservation:SLURM_JOB_RESERVATION nodes:SLURM_JOB_NUM_NODES cpus-per-task:SLURM_CPUS_PER_TASK \
        mem:SLURM_MEM_PER_NODE mem-per-cpu:SLURM_MEM_PER_CPU; do
        name=${pair#*:}
        [ -z "${!name:-}" ] || options+=("--${pair%%:*}=${!name}")
    done
    read -ra further <<<"${SUBMIT:-}"
    # the new job is in no array: it has the index, and its own id, from elsewhere
    env -u SLURM_ARRAY_TASK_ID -u SLURM_ARRAY_JOB_ID PGMP_INDEX="$array_index" \
        sbatch "${options[@]}" "${further[@]}" --dependency="afterany:$SLURM_JOB_ID" "scripts/hpc/$script"
}

# As a new job with the options of this one; only PBS's operators may queue a job again under its id.
pbs_again() {
    local known options=(-V) further value pair
    known=$(asked pbs_job) || known=''
    for pair in select place nodes walltime; do
        value=$(field "Resource_List.$pair" <<<"$known")
        # old-style requests are kept as nodes; what PBS made of them as select would be a second request
        [ "$pair" != nodes ] || ! grep -q 'Resource_List.select = ' <<<"$known" || continue
        [ -z "$value" ] || options+=(-l "$pair=$value")
    done
    for pair in -N:Job_Name -A:Account_Name -P:project; do
        value=$(field "${pair#*:}" <<<"$known")
        [ -z "$value" ] || [ "$value" = _pbs_project_default ] || options+=("${pair%%:*}" "$value")
    done
    [ -z "${PBS_O_QUEUE:-}" ] || options+=(-q "$PBS_O_QUEUE")
    # PBS knows no dependency on one job of an array
    [[ $own == *'['* ]] || options+=(-W depend="afterany:$own")
    read -ra further <<<"${SUBMIT:-}"
    [ -z "$array_index" ] || export PGMP_INDEX=$array_index
    qsub "${options[@]}" "${further[@]}" "scripts/hpc/$script"
}
