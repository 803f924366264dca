"""What tests of every kind share: running a command on several ranks, and limits of time and chance."""

import atexit
import gc
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import hypothesis
import pytest
import warm_start
from hypothesis.internal.conjecture import providers

ROOT = Path(__file__).resolve().parent.parent
SCRIPTS = Path(__file__).resolve().parent / "parallel"  # that tests run on several ranks
gc.disable()  # until tests begin: modules and tests stay
os.fsync = os.fstat  # no file has to outlast the machine, and each would wait some milliseconds for the disk
if sys.dont_write_bytecode:
    # Every process of the suite would compile all of the package anew, and the tests with it, some ten seconds each:
    # what is compiled is kept, where it is in nobody's way.
    sys.dont_write_bytecode, sys.pycache_prefix = False, str(ROOT / ".pytest_cache" / "bytecode")
    os.environ |= {"PYTHONDONTWRITEBYTECODE": "", "PYTHONPYCACHEPREFIX": sys.pycache_prefix}
# Against hangs only, so that no test fails because the machine is busy. Multiply it by PGMP_TEST_PATIENCE.
TIMEOUT_SECONDS = 1200.0 * float(os.environ.get("PGMP_TEST_PATIENCE", "1"))
SLEEPING = "PGMP_TEST_SLEEPING"  # where processes of the suite find what makes ranks sleep
# Python looks for what it may collect after so many new objects, ten and so many such times: what models and compiled
# functions are made of is most of what there is, and stays.
COLLECTIONS = (10_000, 20, 50)


def _sleeping() -> dict[str, str]:
    """Return what makes ranks sleep while they wait; nothing where there is no compiler, and tests take longer."""
    if SLEEPING in os.environ:  # of the process that started this one
        return {"LD_PRELOAD": os.environ[SLEEPING]}
    compiler = shutil.which("cc") or shutil.which("gcc")
    if compiler is None:
        return {}
    folder = Path(tempfile.mkdtemp(prefix="pgmp_tests_"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    os.environ[SLEEPING] = str(folder / "sleeping.so")
    command = [compiler, "-O2", "-shared", "-fPIC", "-o", os.environ[SLEEPING], str(SCRIPTS / "sleeping.c")]
    subprocess.run(command, capture_output=True, check=True)
    return {"LD_PRELOAD": os.environ[SLEEPING]}


# More ranks than cores and two jobs at once are allowed; small LAPACK calls are fastest with one thread.
MPI_ENVIRONMENT = {
    "OMPI_ALLOW_RUN_AS_ROOT": "1",
    "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1",
    "OMPI_MCA_rmaps_base_oversubscribe": "1",
    "OMPI_MCA_hwloc_base_binding_policy": "none",
    # two ranks that wait by spinning starve each other, a hundred times slower, beside other jobs on two cores
    "OMPI_MCA_mpi_yield_when_idle": "1",
    # looking for clusters' networks takes every start a fifth of a second
    "OMPI_MCA_pml": "ob1",
    "OMP_NUM_THREADS": "1",
} | _sleeping()
# A process alone waits for nobody: there MUMPS gives its turn away in some hundred looks for messages a solution, a
# third of the time of a small one and, beside other processes, many times that.
ALONE = {"OMPI_MCA_mpi_yield_when_idle": "0"}
os.environ |= ALONE
PGMP = ("-m", "pgmp_petsc.cli.main")
# What takes long and has a shorter sibling in the suite: more ranks, a larger scene, another kind of compiled code. It
# is left out where nobody asks for it, so that the suite ends within half an hour; `scripts/test --thorough` has it.
THOROUGH = (
    "hard_cases/test_revolutions.py::test_energy_is_kept_without_damping[100-",
    "parallel/test_results_of_ranks.py::test_results_are_those_of_one_rank[3-effects",
    "parallel/test_results_of_ranks.py::test_results_are_those_of_one_rank[3-settled",
    "parallel/test_results_of_ranks.py::test_results_are_those_of_one_rank[3-springs",
    "parallel/test_results_of_ranks.py::test_results_are_those_of_one_rank[3-model in space",
    "parallel/test_results_of_ranks.py::test_results_are_those_of_one_rank[2-solids-",
    "parallel/test_build.py::test_frequencies_do_not_depend_on_ranks_and_signs[3-",
    "parallel/test_build.py::test_tables_are_the_same_but_for_one_constant_rotation[3-",
    "parallel/test_build.py::test_frequencies_do_not_depend_on_ranks_and_signs[5-",
    "parallel/test_build.py::test_tables_are_the_same_but_for_one_constant_rotation[5-",
    "parallel/test_build.py::test_even_the_constant_rotation_is_the_identity_without_a_reflection[5-",
    "parallel/test_build.py::test_the_condensed_bodies_do_not_depend_on_ranks[3-",
    "commands/test_component_command.py::test_the_scenes_run_as_they_are[six_joint_arm]",
    "commands/test_component_command.py::test_the_scenes_run_as_they_are[palletizer]",
    "gradients/test_linearisation.py::test_the_residual_is_that_of_the_engine[two coordinates]",
    "bodies/test_components.py::test_a_component_does_not_depend_on_ranks_but_for_its_internal_coordinates[quad8-3]",
    "bodies/test_components.py::test_a_component_does_not_depend_on_ranks_but_for_its_internal_coordinates[hexahedron20-3]",
    "test_contacts_benchmark.py::test_contacts_are_counted_and_timed",
    "verification/test_component_stiffening.py::test_a_slider_crank_is_that_of_the_mesh[solids]",
    "verification/test_couplings.py::test_reduced_runs_are_those_of_full_order_and_of_c[gear]",
    "verification/test_couplings.py::test_reduced_runs_are_those_of_full_order_and_of_c[rack]",
    "verification/test_error_indicator.py::test_estimates_are_within_a_factor_of_the_true_errors[sudden step]",
    "verification/test_error_indicator.py::test_the_scene_is_within_the_factor_on_nearly_all_of_many_samples[false]",
    "verification/test_error_indicator.py::test_estimates_are_within_a_factor_of_the_true_errors[paper's basis]",
    "verification/test_error_indicator.py::test_estimates_are_within_the_factor[beams in space]",
    "verification/test_error_indicator.py::test_estimates_are_within_the_factor[cells in the plane]",
    "verification/test_error_indicator.py::test_estimates_are_within_the_factor[driven cells in the plane]",
    "verification/test_error_indicator.py::test_estimates_are_within_the_factor[three coordinates]",
    "verification/test_error_indicator.py::test_estimates_are_within_the_factor[end stop]",
    "verification/test_error_indicator.py::test_estimates_are_within_the_factor[controller, two coordinates]",
    "verification/test_error_indicator.py::test_estimates_see_friction_stops_and_the_step[frame_in_space]",
    "verification/test_exported.py::test_component_models[six_joint_arm]",
    "verification/test_exported.py::test_component_models[scara]",
    "verification/test_exported.py::test_loads_that_set_in_at_once[0.0005-2.0-2]",
    "verification/test_modal_damping.py::test_what_it_takes_is_what_is_lost[solids in space]",
    "verification/test_sliding_coordinates.py::test_all_models_agree_on_the_moving_mass[reduced-True]",
    "verification/test_scenes.py::test_the_reduced_model_follows_the_full_order_one[spatial_mixed]",
    "verification/test_three_coordinates.py::test_a_robot_moves_as_its_mesh[scara-5-0.005]",
    "verification/test_three_coordinates.py::test_interpolation_over_three_coordinates_is_of_order_four",
    "verification/test_tolerance.py::test_a_thousandth_of_the_rigid_motion_with_the_step_of_the_scene",
    "verification/test_tolerance.py::test_the_reduction_keeps_its_tolerance_on_the_mesh[own load-two",
    "verification/test_tolerance.py::test_the_reduction_keeps_its_tolerance_on_the_mesh[another load-two",
    "verification/test_tolerance.py::test_what_errors_are_against_is_said_before_and_kept[two coordinates]",
)
# Folders whose dearest files take a quarter to a minute and a half of a processor, as measured file by file; elsewhere
# one takes seconds. What begins with them ends on both processes at about the same time.
LONG = ("parallel/", "verification/", "commands/", "hard_cases/")
# Random cases are the same in every run, and none has a limit of time: neither luck nor load decides about a test.
hypothesis.settings.register_profile("suite", derandomize=True, deadline=None, database=None)
hypothesis.settings.load_profile("suite")
# nor has it the numbers of the modules that happen to be imported, which took seconds to be found
providers._get_local_constants = lambda: providers._local_constants


def run_mpi(n: int, *command: object, check_status: int | None = 0) -> subprocess.CompletedProcess[str]:
    """Run Python with the arguments ``command`` on ``n`` ranks and return what it printed.

    A command of the program on one rank runs in this process, unless it has options for PETSc, which starts once.
    """
    if n == 1 and command[:2] == PGMP and "--" not in command:
        from runs import pgmp

        return pgmp(*command[2:], status=check_status)
    paths = [str(ROOT), str(ROOT / "tests"), os.environ.get("PYTHONPATH", "")]
    environment = os.environ | MPI_ENVIRONMENT | {"PYTHONPATH": os.pathsep.join(filter(None, paths))}
    if n == 1:
        environment |= ALONE
    # mpirun waits this long, and two seconds unless told, for ranks that write their last words before it kills them
    environment["OMPI_MCA_odls_base_sigkill_timeout"] = "0" if n == 1 else "1"
    arguments = ["mpirun", "-n", str(n), *warm_start.python(environment), *(str(word) for word in command)]
    process = subprocess.Popen(
        arguments, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment,
        start_new_session=True,
    )  # fmt: skip
    try:
        out, err = process.communicate(timeout=TIMEOUT_SECONDS)
    except subprocess.TimeoutExpired:
        # The whole session: mpirun killed alone may leave its ranks behind.
        os.killpg(process.pid, signal.SIGKILL)
        out, err = process.communicate()
        pytest.fail(f"{' '.join(arguments)} hangs\n{out}\n{err}")
    if check_status is not None:
        shown = f"{' '.join(arguments)} ended with {process.returncode}\n{out}\n{err}"
        assert process.returncode == check_status, shown
    return subprocess.CompletedProcess(arguments, process.returncode, out, err)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark what `THOROUGH` names; setup.cfg leaves it out. Folders whose files take longest come first, so that no
    process is left with one of these when the others have done; by the names of their files, as three of those with
    many ranks at once would have seven ranks wait for their turn on two cores at every message."""
    items.sort(key=lambda item: (not item.nodeid.removeprefix("tests/").startswith(LONG), item.path.name))
    for item in items:
        if item.nodeid.removeprefix("tests/").startswith(THOROUGH):
            item.add_marker("thorough")


def pytest_collection_finish() -> None:
    """Keep the environment that warm starts begin with, and look through no module and test again for what Python may
    collect."""
    warm_start.BEFORE_TESTS.update(os.environ)
    gc.freeze()
    gc.enable()
    gc.set_threshold(*COLLECTIONS)


def pytest_configure(config: pytest.Config) -> None:
    """Start the server of warm starts that processes of the suite share, in the one that starts these."""
    if config.getoption("numprocesses", None) and not hasattr(config, "workerinput"):
        warm_start.share()


@pytest.fixture(scope="session")
def accurate_rom() -> object:
    """Return the reduced-order model of `runs.accurate_scene`: 7 modes and a static one at 48 angles, splines."""
    # PETSc starts only where a test needs it
    from runs import accurate_scene, rom_of

    return rom_of(accurate_scene())


@pytest.fixture(scope="session")
def small_rom(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the file of the paper's reduced model with the settings of `runs.SMALL`, which no test may change."""
    from runs import SMALL, paper_scene, rom_of

    rom_of(paper_scene(*SMALL)).write(path := tmp_path_factory.mktemp("small") / "rom.h5")
    return path


@pytest.fixture(scope="session")
def commands(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with what the commands write; see `result_files.written_by_commands`."""
    from result_files import written_by_commands

    return written_by_commands(tmp_path_factory.mktemp("by_commands"))


@pytest.fixture(scope="module")
def folder(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder that the tests of a module share."""
    return tmp_path_factory.mktemp(request.module.__name__)


@pytest.fixture
def coarse(monkeypatch: pytest.MonkeyPatch) -> None:
    """Tabulate what is rigid on 24 x 24 configurations instead of 192 x 192, which takes half a minute in space, and
    along three coordinates at 8 places at least instead of 16.

    Splines over 2.2 rad then err by 2e-7 of its fourth derivatives.
    """
    from pgmp_petsc.reduction import tables

    monkeypatch.setattr(tables, "N_FINE_OF_MORE", 24)
    monkeypatch.setattr(tables, "FEWEST_OF_THREE", 8)


@pytest.fixture
def short_tables(coarse: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """Tabulate what is rigid on 12 x 12 configurations, or at 5 places along each of three coordinates: such tables are
    most of the code of a model in C, which is compared with the program on the same ones."""
    from pgmp_petsc.reduction import tables

    monkeypatch.setattr(tables, "N_FINE_OF_MORE", 12)
    monkeypatch.setattr(tables, "FEWEST_OF_THREE", 5)


@pytest.fixture(scope="module")
def quickly_compiled() -> Iterator[None]:
    """Compile FMUs without optimisation, which changes round-off alone."""
    from pgmp_petsc.c_export import fmu

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fmu, "OPTIONS", ("-O0", *(option for option in fmu.OPTIONS if option != "-O2")))
        yield


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make pictures as they are, and write empty ones: to draw one takes half a second."""
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    write, print_svg = Figure.savefig, FigureCanvasSVG.print_svg
    monkeypatch.setattr(Figure, "savefig", lambda _, *names, **given: write(Figure((1.0, 1.0)), *names, **given))
    monkeypatch.setattr(
        FigureCanvasSVG, "print_svg",  # of the charts of a page
        lambda _, *names, **given: print_svg(FigureCanvasSVG(Figure((1.0, 1.0))), *names, **given),
    )  # fmt: skip


@pytest.fixture
def no_plugins() -> Iterator[None]:
    """Forget the plugins of a test: other tests list what there is."""
    from pgmp_petsc.base.plugins import IN_USE
    from pgmp_petsc.declare.ideas import FAMILIES, WHEN_GROWN

    before = [dict(zip(family.names, family.found())) for family in FAMILIES], dict(IN_USE)
    yield
    for family, classes in zip(FAMILIES, before[0]):
        family.classes = classes
    IN_USE.clear()
    IN_USE.update(before[1])
    for told in WHEN_GROWN:
        told()
