"""The job scripts, with stand-ins for the scheduler: what they run, when they stop, and what they submit again."""

from __future__ import annotations

import os
import shutil
import signal
import stat
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from conftest import MPI_ENVIRONMENT, ROOT, TIMEOUT_SECONDS
from runs import PAPER_SCENE, SMALL, overridden, pgmp

from pgmp_petsc.reduction.rom import ReducedOrderModel
from pgmp_petsc.results import Ensemble

SCRIPTS = ("build.slurm", "montecarlo.slurm", "build.pbs", "montecarlo.pbs")
SLURM, PBS = SCRIPTS[:2], SCRIPTS[2:]
SUBMITTED = {
    "slurm": "sbatch --time=9 --dependency=afterany:17 scripts/hpc/",
    "pbs": "qsub --time=9 -W depend=afterany:17 scripts/hpc/",
}
STUBS = {
    "srun": '[ "$1" = --ntasks ] || exit 64\necho "srun $2" >>"$CALLS"\nexec mpirun -n "${@:2}"\n',
    "sbatch": 'echo "sbatch $*" >>"$CALLS"\n',
    "qsub": 'echo "qsub $*" >>"$CALLS"\n',
}
PROGRAM = f'exec {sys.executable} -m pgmp_petsc.cli.main "$@"\n'
# leaves a part of its work every tenth of a second, and has all with the fifth one
WORKER = """
[ "${OMPI_COMM_WORLD_RANK:-0}" = 0 ] || exit 0
echo "pgmp $*" >>"$CALLS"
while [ "$1" != -o ]; do shift; done
output=$2
mkdir -p "$output.partial"
echo "{}" >"$output.partial/run.json"
[ "${WORK:-}" != none ] || exec sleep 60
[ "${WORK:-}" != failing ] || exit 3
[ "${WORK:-}" != late ] || trap 'mv "$output.partial/1" "$output"; rm -r "$output.partial"; exit 1' TERM
for part in 1 2 3 4 5; do
    [ ! -e "$output.partial/$part" ] || continue
    sleep 0.1
    touch "$output.partial/$part"
    [ "${WORK:-}" != slow ] || [ "$part" != 2 ] || exec sleep 60
done
mv "$output.partial/5" "$output"
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
    executable(tmp_path / ".venv" / "bin" / "pgmp", PROGRAM)
    return tmp_path


def executable(path: Path, text: str) -> None:
    path.write_text(f"#!/usr/bin/env bash\n{text}")
    path.chmod(path.stat().st_mode | stat.S_IXUSR)


def start(checkout: Path, script: str, **variables: object) -> subprocess.Popen[str]:
    """Start a script as the scheduler would, in the directory that it was submitted from."""
    known = {key: value for key, value in os.environ.items() if not key.startswith(("SLURM_", "PBS_"))}
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


def stop(job: subprocess.Popen[str], when: Path) -> None:
    """Send the signal before the wall time's end to the script alone, once a file is there."""
    deadline = time.monotonic() + TIMEOUT_SECONDS
    while not list(when.parent.glob(when.name)):
        assert job.poll() is None and time.monotonic() < deadline, job.communicate()
        time.sleep(0.01)
    job.send_signal(signal.SIGUSR1)


def calls(checkout: Path) -> list[str]:
    path = checkout / "calls"
    return path.read_text().splitlines() if path.exists() else []


def worker(checkout: Path) -> dict[str, str]:
    """Put a quick stand-in in the place of pgmp, without MPI; return what every script needs."""
    executable(checkout / ".venv" / "bin" / "pgmp", WORKER)
    return {"LAUNCH": "env", "SCENE": "scene.toml", "ROM": "rom.h5", "SAMPLES": "9", "OUTPUT": "many.h5"}


def output_of(checkout: Path, script: str) -> Path:
    return checkout / ("rom.h5" if script.startswith("build") else "many.h5")


@pytest.fixture(scope="module")
def rom(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("hpc") / "rom.h5"
    pgmp("build", PAPER_SCENE, "-o", path, *overridden(*SMALL))
    return path


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
def test_a_job_stopped_by_the_signal_submits_itself(checkout: Path, script: str) -> None:
    given = worker(checkout) | {"SUBMIT": "--time=9", "SLURM_JOB_ID": 17}
    job, output = start(checkout, script, WORK="slow", **given), output_of(checkout, script)
    stop(job, output.with_name(f"{output.name}.partial") / "2")
    assert "stopped before the end of the wall time" in ended(job)[0]
    assert calls(checkout)[1:] == [f"{SUBMITTED['slurm']}{script}"] and not output.exists()
    run(checkout, script, **given)
    assert calls(checkout)[2].endswith(f"-o {output.name} --resume") and output.exists()
    assert len(calls(checkout)) == 3, "not submitted again"


@pytest.mark.parametrize("script", PBS)
def test_a_job_stopped_by_its_own_clock_submits_itself(checkout: Path, script: str) -> None:
    given = worker(checkout) | {"SUBMIT": "--time=9", "PBS_JOBID": 17, "LEAD": 2, "WALLTIME": "0:03"}
    out, _ = run(checkout, script, WORK="slow", **given)
    assert "$ timeout 1 env" in out and "stopped before the end of the wall time" in out
    assert calls(checkout)[1:] == [f"{SUBMITTED['pbs']}{script}"]
    run(checkout, script, **given | {"WALLTIME": 60})
    assert calls(checkout)[2].endswith("--resume") and len(calls(checkout)) == 3
    assert output_of(checkout, script).exists()


def test_a_job_that_ends_when_it_is_stopped_is_done(checkout: Path) -> None:
    given = worker(checkout)
    job = start(checkout, "build.slurm", WORK="late", **given)
    stop(job, checkout / "rom.h5.partial" / "1")
    assert "done at the last moment" in ended(job)[0]
    assert len(calls(checkout)) == 1, "not submitted again"


def test_a_job_that_finished_nothing_is_not_repeated(checkout: Path) -> None:
    given = worker(checkout) | {"WORK": "none"}
    for _ in range(2):  # the second one is a resumed job
        (checkout / "calls").unlink(missing_ok=True)
        job = start(checkout, "build.slurm", **given)
        stop(job, checkout / "calls")
        _, err = ended(job, 143)
        assert err.startswith("build.slurm: nothing was finished within the wall time")
    assert run(checkout, "build.pbs", 124, LEAD=2, WALLTIME=3, **given)[1].startswith("build.pbs: nothing was finished")
    assert all(line.startswith("pgmp build") for line in calls(checkout))


@pytest.mark.parametrize("script", SCRIPTS)
def test_a_failure_ends_the_job(checkout: Path, script: str) -> None:
    run(checkout, script, 3, WORK="failing", **worker(checkout))
    assert len(calls(checkout)) == 1, "not submitted again"


@pytest.mark.parametrize(
    ("script", "without", "message"),
    [
        ("build.slurm", "SCENE", "build.slurm: SCENE is not set; needed: SCENE ROM"),
        ("build.pbs", "ROM", "build.pbs: ROM is not set; needed: SCENE ROM"),
        ("montecarlo.slurm", "SAMPLES", "montecarlo.slurm: SAMPLES is not set; needed: ROM SAMPLES"),
        ("montecarlo.pbs", "ROM", "montecarlo.pbs: ROM is not set"),
    ],
)
def test_what_is_not_set_is_named(checkout: Path, script: str, without: str, message: str) -> None:
    given = worker(checkout)
    del given[without]
    assert message in run(checkout, script, 2, **given)[1]


def test_what_is_not_there_is_named(checkout: Path) -> None:
    given = worker(checkout)
    assert "a wall time of more than 120 s is needed" in run(checkout, "build.pbs", 2, WALLTIME=120, **given)[1]
    (checkout / ".venv" / "bin" / "pgmp").unlink()
    assert "submit from the checkout, after scripts/setup" in run(checkout, "build.slurm", 2, **given)[1]


def test_modules_are_loaded(checkout: Path) -> None:
    given = worker(checkout) | {"MODULES": "petsc slepc", "BASH_FUNC_module%%": '() { echo "module $*"; }'}
    assert "module load petsc slepc" in run(checkout, "build.slurm", **given)[0]


def test_ranks_and_wall_time_are_those_of_the_scheduler(checkout: Path) -> None:
    given = {key: value for key, value in worker(checkout).items() if key != "LAUNCH"}
    assert "$ srun --ntasks 1 .venv/bin/pgmp build" in run(checkout, "build.slurm", **given)[0]
    assert "$ srun --ntasks 3 " in run(checkout, "montecarlo.slurm", RANKS=3, SLURM_NTASKS=2, **given)[0]
    assert calls(checkout)[-1].startswith("pgmp") and "srun 3" in calls(checkout)
    nodes = checkout / "nodes"
    nodes.write_text("a\na\n")
    executable(checkout / "bin" / "qstat", '[ "$*" = "-f 17" ] && echo "    Resource_List.walltime = 01:02:03"\n')
    out, _ = run(checkout, "build.pbs", PBS_JOBID=17, PBS_NODEFILE=nodes, **given)
    assert "$ timeout 3603 mpirun -n 2 .venv/bin/pgmp build" in out
    executable(checkout / "bin" / "qstat", "exit 1\n")
    assert "$ timeout 14280 mpirun -n 1 " in run(checkout, "build.pbs", RANKS=1, PBS_NODEFILE=nodes, **given)[0]


def test_samples_are_taken_up_on_other_ranks(checkout: Path, rom: Path) -> None:
    """The real program: one uninterrupted PBS job, and two Slurm jobs of which the first is stopped."""
    given = {"ROM": rom, "SAMPLES": 120, "SEED": 5, "EXTRA": "--override ensemble.batch=1"}
    run(checkout, "montecarlo.pbs", OUTPUT=checkout / "whole.h5", RANKS=1, **given)
    given |= {"OUTPUT": checkout / "parts.h5"}
    job = start(checkout, "montecarlo.slurm", RANKS=2, **given)
    stop(job, checkout / "parts.h5.partial" / "*.npz")
    ended(job)
    assert calls(checkout)[-1].startswith("sbatch") and not (checkout / "parts.h5").exists()
    assert "120 samples" in run(checkout, "montecarlo.slurm", RANKS=1, **given)[0]
    assert calls(checkout)[-1] == "srun 1"
    whole, parts = (Ensemble.read(checkout / name) for name in ("whole.h5", "parts.h5"))
    assert (parts.record.seed, len(parts.status)) == (5, 120)
    for name, values in whole.outputs.items():
        np.testing.assert_array_equal(parts.outputs[name], values)


def test_a_build_is_taken_up_on_other_ranks(checkout: Path) -> None:
    """The real program: one uninterrupted PBS job, and two Slurm jobs of which the first is stopped after a body."""
    # so many angles that some are left when the signal comes
    extra = "--override reduction.modes=4 --override 'reduction.angles = 480'"
    given = {"SCENE": ROOT / "scenes" / "slider_crank_solid2d.toml", "EXTRA": extra}
    run(checkout, "build.pbs", ROM="whole.h5", RANKS=1, **given)
    job = start(checkout, "build.slurm", ROM="parts.h5", SLURM_NTASKS=2, **given)
    stop(job, checkout / "parts.h5.partial" / "component-*.npz")
    ended(job)
    assert calls(checkout)[0] == "srun 2" and calls(checkout)[1].startswith("sbatch")
    assert "--resume" in run(checkout, "build.slurm", ROM="parts.h5", RANKS=1, **given)[0]
    assert calls(checkout)[2:] == ["srun 1"] and not (checkout / "parts.h5.partial").exists()
    whole, parts = (ReducedOrderModel.read(checkout / name) for name in ("whole.h5", "parts.h5"))
    np.testing.assert_allclose(parts.frequencies_hz, whole.frequencies_hz, rtol=1e-9)


def test_the_scripts_are_sound() -> None:
    """What a shell can say without running them, and shellcheck where it is installed."""
    for script in (ROOT / "scripts" / "hpc").iterdir():
        subprocess.run(["bash", "-n", script], check=True)
        assert (script.suffix == ".sh") != bool(script.stat().st_mode & stat.S_IXUSR), script
    if shutil.which("shellcheck"):
        subprocess.run(["shellcheck", "-x", *(ROOT / "scripts" / "hpc").iterdir()], cwd=ROOT, check=True)
