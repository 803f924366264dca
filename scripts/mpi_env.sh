# Environment for mpirun on one's own machine; source it. What is already set stays as it is.

# Small dense LAPACK calls are several times faster on one thread, and the ranks do not fight for cores.
export OMP_NUM_THREADS="${OMP_NUM_THREADS:-1}"

# Open MPI refuses to run as root, as one does in a container, unless told twice.
if [ "$(id -u)" -eq 0 ]; then
    export OMPI_ALLOW_RUN_AS_ROOT="${OMPI_ALLOW_RUN_AS_ROOT:-1}"
    export OMPI_ALLOW_RUN_AS_ROOT_CONFIRM="${OMPI_ALLOW_RUN_AS_ROOT_CONFIRM:-1}"
fi

# Outside a batch job, whose scheduler decides this: allow more ranks than cores, and bind none, because two
# jobs at once would be bound to the same core.
if [ -z "${SLURM_JOB_ID:-}${PBS_JOBID:-}${LSB_JOBID:-}" ]; then
    export OMPI_MCA_rmaps_base_oversubscribe="${OMPI_MCA_rmaps_base_oversubscribe:-1}"
    export OMPI_MCA_hwloc_base_binding_policy="${OMPI_MCA_hwloc_base_binding_policy:-none}"
    # a rank that waits leaves its core to others: with more ranks than cores they would wait for each other's turns
    export OMPI_MCA_mpi_yield_when_idle="${OMPI_MCA_mpi_yield_when_idle:-1}"
    # looking for clusters' networks takes every start a fifth of a second
    export OMPI_MCA_pml="${OMPI_MCA_pml:-ob1}"
fi
