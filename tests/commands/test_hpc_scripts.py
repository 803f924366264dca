"""The job scripts, with stand-ins for the scheduler: what they run, when they stop, and what they submit again."""

import os
import shlex
import shutil
import signal
import stat
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import warm_start
from conftest import MPI_ENVIRONMENT, ROOT, TIMEOUT_SECONDS
from runs import PGMP

from pgmp_petsc.results import Ensemble

SCRIPTS = ("build.slurm", "montecarlo.slurm", "build.pbs", "montecarlo.pbs")
SLURM, PBS = SCRIPTS[:2], SCRIPTS[2:]
STUBS = {
    # as with MpiDefault=none where DEFAULT says so: the ranks do not find each other
    "srun": """
case $1 in --mpi=list) echo "MPI plugin types are... none ${PLUGINS:-pmi2 pmix}"; exit ;; esac
default=${DEFAULT:-fine}
case $1 in --mpi=*) [ "$1" = "--mpi=${WORKING:-pmix}" ] && default=fine || default=none; shift ;; esac
[ "$1" = --ntasks ] || exit 64
[ "$default" != none ] || { echo "not built with SLURM's PMI" >&2; exit 1; }
[ "$3" = .venv/bin/python ] || echo "srun $2" >>"$CALLS"
exec mpirun -n "${@:2}"
""",
    # of the number of a whole array it names all jobs
    "squeue": """
[ "$3" != "${SLURM_ARRAY_JOB_ID:-}" ] || echo 0:01
[ "$5" = %L ] && echo "${LEFT:-1:00:00}" || echo 2:00:00
""",
    "scontrol": 'echo "scontrol $*" >>"$CALLS"\n[ "${REQUEUE:-yes}" = yes ]\n',
    "sbatch": 'echo "sbatch $*" >>"$CALLS"\n[ "${QUEUE:-open}" = open ]\n',
    "qsub": 'echo "qsub $*" >>"$CALLS"\n[ "${QUEUE:-open}" = open ]\n',
    "qstat": '[ "$*" = "-f ${PBS_JOBID:-}" ] || exit 64\nprintf "%b" "Job Id: $PBS_JOBID\\n$JOB"\n',
}
# what qstat says of a job: long lines are folded
JOB = (
    "    Job_Name = many\\n    project = _pbs_project_default\\n    Account_Name = steel\\n"
    "    Resource_List.ncpus = 4\\n    Resource_List.place = scatter\\n"
    "    Resource_List.select = 2:ncpus=2:\\n\\tmpiprocs=2:mem=4gb\\n    Resource_List.walltime = 01:00:00\\n"
)
PBS_AGAIN = (
    "qsub -V -l select=2:ncpus=2:mpiprocs=2:mem=4gb -l place=scatter -l walltime=01:00:00 -N many -A steel -q work "
)
STOPPED = 75
# leaves a part of its work every tenth of a second, and has all with the fifth one
WORKER = """
[ "${OMPI_COMM_WORLD_RANK:-0}" = 0 ] || exit 0
echo "pgmp $*" >>"$CALLS"
while [ "$1" != -o ]; do shift; done
output=$2
[ ! -e "$output.partial/foreign" ] || exit 2
mkdir -p "$output.partial"
echo "{}" >"$output.partial/run.json"
[ "${WORK:-}" != none ] || exec sleep 60
[ "${WORK:-}" != failing ] || exit 3
[ "${WORK:-}" != killed ] || kill -KILL $$
[ "${WORK:-}" != late ] || trap 'mv "$output.partial/1.npz" "$output"; rm -r "$output.partial"; exit 1' USR1
[ "${WORK:-}" != deaf ] || trap '' USR1 TERM
for part in 1 2 3 4 5; do
    [ ! -e "$output.partial/$part.npz" ] || continue
    sleep 0.1
    touch "$output.partial/$part.npz"
    [ "${WORK:-}" != slow ] || [ "$part" != 2 ] || exec sleep 60
    [ "${WORK:-}" != deaf ] || [ "$part" != 2 ] || for i in {1..600}; do sleep 0.1; done
done
mv "$output.partial/5.npz" "$output"
rm -r "$output.partial"
"""


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """Return a directory like the checkout after scripts/setup, with the scheduler's commands in bin/."""
    for place in ("scripts/hpc", ".venv/bin", "bin"):
        (tmp_path / place).mkdir(parents=True)
    for script in (ROOT / "scripts" / "hpc").iterdir():
        shutil.copy(script, tmp_path / "scripts" / "hpc")
    shutil.copy(ROOT / "scripts" / "mpi_env.sh", tmp_path / "scripts")
    for name, text in STUBS.items():
        executable(tmp_path / "bin" / name, text)
    executable(tmp_path / ".venv" / "bin" / "pgmp", f'exec {shlex.join(warm_start.python())} {shlex.join(PGMP)} "$@"\n')
    executable(tmp_path / ".venv" / "bin" / "python", f'exec {sys.executable} "$@"\n')
    return tmp_path


def executable(path: Path, text: str) -> None:
    path.write_text(f"#!/usr/bin/env bash\n{text}")
    path.chmod(path.stat().st_mode | stat.S_IXUSR)


def start(checkout: Path, script: str, **variables: object) -> subprocess.Popen[str]:
    """Start a script as the scheduler would, in the directory that it was submitted from."""
    known = {key: value for key, value in os.environ.items() if not key.startswith(("SLURM_", "PBS_"))}
    known |= {"SLURM_JOB_ID": "17"} if script in SLURM else {"PBS_JOBID": "17", "PBS_O_QUEUE": "work", "JOB": JOB}
    where = "SLURM_SUBMIT_DIR" if script in SLURM else "PBS_O_WORKDIR"
    paths = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
    environment = known | MPI_ENVIRONMENT | {where: str(checkout), "PYTHONPATH": paths}
    environment |= {"CALLS": str(checkout / "calls"), "PATH": f"{checkout / 'bin'}:{os.environ['PATH']}"}
    return subprocess.Popen(
        ["bash", checkout / "scripts" / "hpc" / script],
        env=environment | {name: str(value) for name, value in variables.items()},
        stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd="/",
    )  # fmt: skip


def run(checkout: Path, script: str, status: int = 0, **variables: object) -> tuple[str, str]:
    """Run a script to its end; return what it said."""
    return ended(start(checkout, script, **variables), status)


def ended(job: subprocess.Popen[str], status: int = 0) -> tuple[str, str]:
    out, err = job.communicate(timeout=TIMEOUT_SECONDS)
    assert job.returncode == status, f"{job.args} ended with {job.returncode}\n{out}\n{err}"
    return out, err


def stop(job: subprocess.Popen[str], when: Path, number: signal.Signals = signal.SIGUSR1, size: int = 0) -> None:
    """Send a signal to the script alone, once a file of at least a size (bytes) is there."""
    deadline = time.monotonic() + TIMEOUT_SECONDS
    while not any(path.stat().st_size >= size for path in when.parent.glob(when.name)):
        assert job.poll() is None and time.monotonic() < deadline, job.communicate()
        time.sleep(0.01)
    job.send_signal(number)


def calls(checkout: Path) -> list[str]:
    path = checkout / "calls"
    return path.read_text().splitlines() if path.exists() else []


def worker(checkout: Path) -> dict[str, str]:
    """Put a quick stand-in in the place of pgmp, without MPI; return what every script needs."""
    executable(checkout / ".venv" / "bin" / "pgmp", WORKER)
    return {"LAUNCH": "env", "SCENE": "scene.toml", "ROM": "rom.h5", "SAMPLES": "9", "OUTPUT": "many.h5"}


def output_of(checkout: Path, script: str) -> Path:
    return checkout / ("rom.h5" if script.startswith("build") else "many.h5")


def stopped(
    checkout: Path, script: str, status: int = STOPPED, output: str = "", part: int = 2, work: str = "slow",
    number: signal.Signals = signal.SIGUSR1, **variables: object,
) -> tuple[str, str]:  # fmt: skip
    """Run a script that is stopped after some parts of its work."""
    job, path = start(checkout, script, WORK=work, **variables), output_of(checkout, script)
    stop(job, checkout / f"{output or path.name}.partial" / f"{part}.npz", number)
    return ended(job, status)


@pytest.mark.parametrize("script", SCRIPTS)
def test_a_job_with_enough_time_runs_once(checkout: Path, script: str) -> None:
    given = worker(checkout) | {"EXTRA": """--override 'outputs.a={ b = "c d" }' -- -log_view""", "SEED": 4}
    run(checkout, script, **given)
    command = "build scene.toml -o rom.h5"
    if script.startswith("montecarlo"):
        command = "montecarlo rom.h5 -n 9 --seed 4 -o many.h5"
    assert calls(checkout) == [f'pgmp {command} --override outputs.a={{ b = "c d" }} -- -log_view']
    assert output_of(checkout, script).exists()


@pytest.mark.parametrize("script", SLURM)
def test_a_stopped_job_is_queued_again_under_its_id(checkout: Path, script: str) -> None:
    given, output = worker(checkout), output_of(checkout, script)
    out, _ = stopped(checkout, script, **given)
    assert "stopped before the end of the wall time" in out and "job 17 is queued again under its id" in out
    assert calls(checkout)[1:] == ["scontrol requeue 17"] and not output.exists()
    out, _ = run(checkout, script, SLURM_RESTART_COUNT=1, **given)
    assert f"== {script}, job 17, restart 1, " in out and "goes on from it (--resume)" in out
    assert calls(checkout)[2].endswith(f"-o {output.name} --resume") and output.exists()
    assert len(calls(checkout)) == 3, "not queued again"


def test_one_job_of_an_array_is_queued_again_alone(checkout: Path) -> None:
    """The id of an array's last job is that of the whole array."""
    given = worker(checkout) | {"SLURM_ARRAY_JOB_ID": 17, "SLURM_ARRAY_TASK_ID": 3, "OUTPUT": "m%any.h5"}
    assert "3600 s left" in stopped(checkout, "montecarlo.slurm", output="m3ny.h5", **given)[0]
    assert calls(checkout)[1:] == ["scontrol requeue 17_3"]
    stopped(checkout, "montecarlo.slurm", output="n3.h5", REQUEUE="no", **given | {"OUTPUT": "n%a.h5"})
    assert calls(checkout)[-1].startswith("sbatch ")


def test_where_slurm_queues_nothing_again_a_new_job_has_the_same_options(checkout: Path) -> None:
    own = {"JOB_NAME": "press", "JOB_PARTITION": "long", "JOB_ACCOUNT": "steel", "JOB_QOS": "low", "JOB_NUM_NODES": 2}
    own |= {"NTASKS": 6, "MEM_PER_CPU": 2000, "CPUS_PER_TASK": 1}
    given = worker(checkout) | {"REQUEUE": "no", "SUBMIT": "--mail-type=END"}
    given |= {f"SLURM_{name}": value for name, value in own.items()}
    out, _ = stopped(checkout, "build.slurm", **given)
    assert "Jobs that depend on the success of this one will not begin" in out
    assert calls(checkout)[2] == (
        "sbatch --ntasks=6 --time=2:00:00 --job-name=press --partition=long --account=steel --qos=low --nodes=2 "
        "--cpus-per-task=1 --mem-per-cpu=2000 --mail-type=END --dependency=afterany:17 scripts/hpc/build.slurm"
    )


@pytest.mark.parametrize("script", PBS)
def test_a_job_stopped_by_its_own_clock_is_followed_by_one_with_its_options(checkout: Path, script: str) -> None:
    given = worker(checkout) | {"SUBMIT": "-m e", "LEAD": 57, "WALLTIME": "1:00"}
    out, _ = run(checkout, script, STOPPED, WORK="slow", **given)
    assert "60 s left; the command is stopped after 3 s" in out and "stopped before the end of the wall time" in out
    assert calls(checkout)[1:] == [f"{PBS_AGAIN}-W depend=afterany:17 -m e scripts/hpc/{script}"]
    run(checkout, script, **given | {"WALLTIME": 600})
    assert calls(checkout)[2].endswith("--resume") and len(calls(checkout)) == 3
    assert output_of(checkout, script).exists()


def test_one_job_of_a_pbs_array_is_followed_by_one_that_knows_its_index(checkout: Path) -> None:
    given = worker(checkout) | {"PBS_JOBID": "17[3].host", "PBS_ARRAY_INDEX": 3, "ROM": "r%a.h5"}
    stopped(checkout, "build.pbs", output="r3.h5", **given)
    assert calls(checkout)[1] == f"{PBS_AGAIN}scripts/hpc/build.pbs"
    run(checkout, "build.pbs", PGMP_INDEX=3, **{k: v for k, v in given.items() if k != "PBS_ARRAY_INDEX"})
    assert calls(checkout)[2] == "pgmp build scene.toml -o r3.h5 --resume"


@pytest.mark.parametrize("script", SCRIPTS)
def test_what_cannot_be_queued_is_said(checkout: Path, script: str) -> None:
    given = worker(checkout) | {"REQUEUE": "no", "QUEUE": "closed"}
    _, err = stopped(checkout, script, status=1, **given)
    output = output_of(checkout, script).name
    assert f"{script}: the rest could not be queued; what was finished is in '{output}.partial'" in err


def test_a_command_that_does_not_heed_the_signal_is_killed(checkout: Path) -> None:
    stopped(checkout, "build.slurm", work="deaf", LEAD=3, **worker(checkout))
    assert calls(checkout)[1:] == ["scontrol requeue 17"]


def test_a_job_that_ends_when_it_is_stopped_is_done(checkout: Path) -> None:
    out, _ = stopped(checkout, "build.slurm", 0, part=1, work="late", THEN="touch then", **worker(checkout))
    assert "done at the last moment" in out and (checkout / "then").exists()
    assert len(calls(checkout)) == 1, "not queued again"


def test_a_job_that_finished_nothing_is_not_repeated(checkout: Path) -> None:
    given = worker(checkout) | {"WORK": "none"}
    for script in ("build.slurm", "build.slurm", "build.pbs"):  # the second one is a resumed job
        (checkout / "calls").unlink(missing_ok=True)
        job = start(checkout, script, **given)
        stop(job, checkout / "calls", size=1)  # a shell makes the file before it writes the line
        _, err = ended(job, 128 + signal.SIGUSR1)
        assert err.startswith(f"{script}: nothing was finished within the wall time")
        assert len(calls(checkout)) == 1


@pytest.mark.parametrize("script", SCRIPTS)
def test_a_failure_ends_the_job(checkout: Path, script: str) -> None:
    _, err = run(checkout, script, 3, WORK="failing", THEN="touch then", **worker(checkout))
    assert f"{script}: the command ended with status 3; its own message begins with 'pgmp:'" in err
    assert len(calls(checkout)) == 1, "not queued again"
    assert not (checkout / "then").exists()
    _, err = run(checkout, script, 137, WORK="killed", **worker(checkout))
    assert f"a signal ended it (memory, perhaps); what was finished is in '{output_of(checkout, script).name}" in err


def test_a_job_that_is_cancelled_says_so(checkout: Path) -> None:
    _, err = stopped(checkout, "build.slurm", 143, number=signal.SIGTERM, **worker(checkout))
    assert "build.slurm: ended from outside (SIGTERM: cancelled, preempted, or out of time)" in err
    assert "no further job is submitted, what was finished is in 'rom.h5.partial': the same job goes on" in err
    assert len(calls(checkout)) == 1


def test_a_signal_before_the_command_is_said(checkout: Path) -> None:
    slow = "() { echo >>loading; for i in {1..12}; do sleep 0.1; done; }"
    for number, status in ((signal.SIGUSR1, STOPPED), (signal.SIGTERM, 143)):
        (checkout / "loading").unlink(missing_ok=True)
        job = start(checkout, "build.slurm", MODULES="petsc", **worker(checkout), **{"BASH_FUNC_module%%": slow})
        stop(job, checkout / "loading", number)
        _, err = ended(job, status)
        assert "build.slurm: a signal came before the command had begun" in err
        assert calls(checkout) == []


def test_what_belongs_to_another_run_can_be_removed(checkout: Path) -> None:
    given = worker(checkout)
    (checkout / "rom.h5.partial").mkdir()
    (checkout / "rom.h5.partial" / "foreign").touch()
    _, err = run(checkout, "build.slurm", 2, **given)
    assert "If that belongs to another run that nobody needs any more: rm -r 'rom.h5.partial', and submit again" in err
    shutil.rmtree(checkout / "rom.h5.partial")
    run(checkout, "build.slurm", **given)


def test_a_chain_goes_on_when_the_result_is_complete(checkout: Path) -> None:
    given = worker(checkout) | {"THEN": "echo $ROM >then"}
    stopped(checkout, "build.pbs", **given)
    assert not (checkout / "then").exists()
    run(checkout, "build.pbs", **given)
    assert (checkout / "then").read_text() == "rom.h5\n"


def test_seeds_and_arrays_have_outputs_of_their_own(checkout: Path) -> None:
    given = worker(checkout) | {"OUTPUT": ""}
    run(checkout, "montecarlo.slurm", **given)
    run(checkout, "montecarlo.slurm", SEED=4, **given)
    run(checkout, "montecarlo.slurm", SEED=4, SLURM_ARRAY_JOB_ID=1, SLURM_ARRAY_TASK_ID=3, **given)
    run(checkout, "montecarlo.pbs", PBS_ARRAY_INDEX=8, EXTRA="--set r=0.%a", **given | {"OUTPUT": "a%a.h5"})
    run(checkout, "montecarlo.pbs", **given | {"ROM": "s.toml", "EXTRA": "--full"})
    run(checkout, "montecarlo.pbs", SEED=4, SHARDS=8, PBS_ARRAY_INDEX=2, **given)
    assert [line.split(" ", 2)[2] for line in calls(checkout)] == [
        "rom.h5 -n 9 --seed 0 -o rom_samples_seed0.h5", "rom.h5 -n 9 --seed 4 -o rom_samples_seed4.h5",
        "rom.h5 -n 9 --seed 7 -o rom_samples_seed7.h5", "rom.h5 -n 9 --seed 8 -o a8.h5 --set r=0.8",
        "s.toml -n 9 --seed 0 -o s_samples_seed0.h5 --full",
        "rom.h5 -n 9 --seed 4 --shard 2/8 -o rom_samples_seed4_shard2of8.h5",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("script", "variables", "message"),
    [
        ("build.slurm", {"SLURM_ARRAY_JOB_ID": 9, "SLURM_ARRAY_TASK_ID": 3}, "ROM = rom.h5: all jobs of the array"),
        ("montecarlo.pbs", {"PBS_ARRAY_INDEX": 3}, "OUTPUT = many.h5: all jobs of the array would write this file"),
        ("montecarlo.slurm", {"OUTPUT": "m%a.h5"}, "OUTPUT = m%a.h5: %a is the index in a job array, and this job is"),
        ("build.slurm", {"SCENE": "s%a.toml"}, "SCENE = s%a.toml: %a is the index in a job array"),
        ("montecarlo.pbs", {"ROM": "r%a.h5"}, "ROM = r%a.h5: %a is the index in a job array"),
        ("montecarlo.slurm", {"EXTRA": "--until 'P(low) +- 0.01"}, "EXTRA = --until 'P(low) +- 0.01: quotes do not"),
        ("build.slurm", {"LEAD": "08", "LEFT": "0:07"}, "LEAD = 8: the job has 7 s in all"),
        ("montecarlo.slurm", {"SHARDS": 8}, "SHARDS = 8: needed: an array of jobs, one a shard, from 1 to 8"),
        ("montecarlo.slurm", {"SEED": "-1"}, "SEED = -1: needed: a whole number, 0 or more"),
        ("build.slurm", {"LEAD": 60, "LEFT": "0:50"}, "LEAD = 60: the job has 50 s in all; give it more, or a smaller"),
        ("build.slurm", {"LEAD": "2m"}, "LEAD = 2m: needed: a number of seconds"),
        ("build.slurm", {"LEFT": "NOT_SET"}, "how long this job has is not understood: 'NOT_SET'; say it with WALLT"),
        ("build.pbs", {"LEAD": 3600}, "LEAD = 3600: the job has 3600 s in all"),
        ("build.slurm", {"SCENE": ""}, "SCENE is not set; needed: SCENE ROM"),
        ("build.pbs", {"ROM": ""}, "ROM is not set; needed: SCENE ROM"),
        ("montecarlo.slurm", {"SAMPLES": ""}, "SAMPLES is not set; needed: ROM SAMPLES"),
        ("montecarlo.pbs", {"ROM": ""}, "ROM is not set"),
    ],
)
def test_what_cannot_be_meant_is_refused(checkout: Path, script: str, variables: dict, message: str) -> None:
    assert f"{script}: {message}" in run(checkout, script, 2, **worker(checkout) | variables)[1]
    assert calls(checkout) == []


def test_what_is_not_there_is_named(checkout: Path) -> None:
    given = worker(checkout)
    executable(checkout / "bin" / "sleep", '[ "$1" != 2 ] || exit 0\nexec /bin/sleep "$@"\n')  # from try to try
    for script, asked in (("build.slurm", "squeue"), ("build.pbs", "qstat")):
        executable(checkout / "bin" / asked, "exit 1\n")
        _, err = run(checkout, script, 2, **given)
        assert f"{script}: {asked} does not say how long this job has; say it with WALLTIME=seconds" in err
        run(checkout, script, WALLTIME=60, **given)
    (checkout / ".venv" / "bin" / "pgmp").unlink()
    assert "submit from the checkout, after scripts/setup" in run(checkout, "build.slurm", 2, **given)[1]


@pytest.mark.parametrize(
    ("script", "variables", "said"),
    [
        ("build.slurm", {"LEFT": "1-00:10:00"}, "87000 s left; the command is stopped after 86880 s"),
        ("build.slurm", {"LEFT": "1:00"}, "60 s left; the command is stopped after 45 s"),
        ("build.slurm", {"LEFT": "UNLIMITED"}, "the job has no wall time: the command runs to its end"),
        ("build.pbs", {}, "3600 s left; the command is stopped after 3480 s"),
        ("build.pbs", {"JOB": "    Job_Name = many\\n"}, "the job has no wall time: the command runs to its end"),
        ("build.slurm", {"MODULES": "petsc slepc", "BASH_FUNC_module%%": '() { echo "module $*"; }'},
         "module load petsc slepc"),
        # ranks are those of the scheduler, unless told
        ("build.slurm", {"LAUNCH": ""}, "$ srun --ntasks 1 .venv/bin/pgmp build"),
        ("montecarlo.slurm", {"LAUNCH": "", "RANKS": 3, "SLURM_NTASKS": 2}, "$ srun --ntasks 3 "),
        ("build.pbs", {"LAUNCH": "", "PBS_NODEFILE": "nodes"}, "$ mpirun -n 2 .venv/bin/pgmp build"),
        ("build.pbs", {"LAUNCH": "", "PBS_NODEFILE": "nodes", "RANKS": 1}, "$ mpirun -n 1 "),
    ],
)  # fmt: skip
def test_what_a_job_says_of_its_time_and_ranks(checkout: Path, script: str, variables: dict, said: str) -> None:
    (checkout / "nodes").write_text("a\na\n")
    assert said in run(checkout, script, **worker(checkout) | variables)[0]
    assert calls(checkout)[-1].startswith("pgmp")
    assert variables.get("RANKS") != 3 or "srun 3" in calls(checkout)


def test_what_starts_the_ranks_is_found(checkout: Path) -> None:
    """SLURM's own default, MpiDefault=none, leaves every rank alone with all the work."""
    given = worker(checkout) | {"LAUNCH": "", "DEFAULT": "none", "RANKS": 2}
    out, _ = run(checkout, "build.slurm", **given)
    assert "started with 'srun --mpi=pmix': it works here, and 'srun' does not" in out
    assert "$ srun --mpi=pmix --ntasks 2 .venv/bin/pgmp" in out
    assert "$ srun --mpi=pmi2 --ntasks 2 .venv" in run(checkout, "build.slurm", WORKING="pmi2", **given)[0]
    out, _ = run(checkout, "build.slurm", PLUGINS="cray", **given)
    assert "started with 'mpirun'" in out and "$ mpirun -n 2 .venv" in out
    executable(checkout / "bin" / "mpirun", "echo no such host >&2\nexit 1\n")
    _, err = run(checkout, "build.slurm", 2, PLUGINS="cray", **given)
    assert (
        "build.slurm: nothing starts 2 rank(s) in one MPI; tried:\nsrun: not built with SLURM's PMI\nmpirun: no" in err
    )
    assert "say how with LAUNCH" in err


def test_heads_leave_variables_to_the_one_who_submits() -> None:
    """With -V in the head an exported variable beats the one given with qsub -v."""
    for script in PBS:
        assert "#PBS -V" not in (ROOT / "scripts" / "hpc" / script).read_text()
    for script in SLURM:
        text = (ROOT / "scripts" / "hpc" / script).read_text()
        assert "--output=%x-%j.out" in text and "--requeue" in text and "--signal" not in text


def test_samples_are_taken_up_on_other_ranks(checkout: Path, small_rom: Path) -> None:
    """The real program: one uninterrupted PBS job, and two Slurm jobs of which the first is stopped."""
    given = {"ROM": small_rom, "SAMPLES": 80, "SEED": 5, "EXTRA": "--override ensemble.batch=1"}
    run(checkout, "montecarlo.pbs", OUTPUT=checkout / "whole.h5", RANKS=1, **given)
    given |= {"OUTPUT": checkout / "parts.h5"}
    job = start(checkout, "montecarlo.slurm", RANKS=2, **given)
    stop(job, checkout / "parts.h5.partial" / "*.npz")
    assert "pgmp: stopped by SIGUSR1: what was finished is kept in" in ended(job, STOPPED)[1]
    assert calls(checkout)[-1] == "scontrol requeue 17" and not (checkout / "parts.h5").exists()
    assert "80 samples" in run(checkout, "montecarlo.slurm", RANKS=1, **given)[0]
    assert calls(checkout)[-1] == "srun 1"
    whole, parts = (Ensemble.read(checkout / name) for name in ("whole.h5", "parts.h5"))
    assert (parts.record.seed, len(parts.status)) == (5, 80)
    np.testing.assert_equal(parts.outputs, whole.outputs)


def test_the_scripts_are_sound() -> None:
    """What a shell can say without running them, and shellcheck where it is installed."""
    for script in (ROOT / "scripts" / "hpc").iterdir():
        subprocess.run(["bash", "-n", script], check=True)
        assert (script.suffix == ".sh") != bool(script.stat().st_mode & stat.S_IXUSR), script
    if shutil.which("shellcheck"):
        subprocess.run(["shellcheck", "-x", *(ROOT / "scripts" / "hpc").iterdir()], cwd=ROOT, check=True)
