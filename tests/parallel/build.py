"""Build reduced-order models on several ranks and write them. Used by test_build.py.

Arguments: the directory of the results, then cases ``name:ranks_per_group:scramble_seed`` (0: no scrambling), each with
its scene from `CASES`. An error is printed by every rank in place of a file.
"""

import sys
from collections.abc import Callable, Mapping
from pathlib import Path

from two_coordinates import double_pendulum, five_bar, over

from pgmp_petsc.ranks.petsc import start_petsc
from scenes import four_bar, meshes_of, slider_crank

start_petsc()

from mpi4py import MPI  # noqa: E402
from runs import quick_return  # noqa: E402
from scrambling import scrambled  # noqa: E402

from pgmp_petsc.base.errors import PgmpError, RunError  # noqa: E402
from pgmp_petsc.modes.problem import ModeSet  # noqa: E402
from pgmp_petsc.ranks.groups import RankGroup  # noqa: E402
from pgmp_petsc.reduction.build import build_rom  # noqa: E402

# as few angles as modes can be followed over: models are compared with each other, not with the mechanism
FEW = "reduction.angles=12"
GRAVITY = 'effects.weight={type="gravity"}'
STATIC = "reduction.static_modes=true"
SECOND = "reduction.second_order=true"
SPLINE = 'reduction.interpolation="spline"'
EXTENDED = (STATIC, "reduction.inertia_modes=true", "reduction.parameter_modes=1", "reduction.modes=3")
UNCERTAIN = 'parameters.r1={nominal=5.6e-3, distribution={name="norm", loc=5.6e-3, scale=5.6e-4}}'
PART = (
    "coordinates.theta.range=[0.2,1.4]", "coordinates.theta.periodic=false", "simulation.initial.theta.position=0.2",
    "reduction.angles=4",
)  # fmt: skip
LIMITED = (
    "coordinates.theta1.range=[0.2,1.4]", "coordinates.theta1.periodic=false", "simulation.initial.theta1.position=0.2",
)  # fmt: skip
CASES = {
    "plain": lambda: slider_crank(FEW),
    "reflected": lambda: four_bar(GRAVITY, FEW),
    # a joint whose line turns with a flexible body, under its weight
    "curved": lambda: quick_return(STATIC, SECOND, *PART, "reduction.modes=3"),
    "extended": lambda: slider_crank(UNCERTAIN, *EXTENDED, SPLINE, "reduction.sampling_tolerance=0.3", *PART),
    "two": lambda: over(double_pendulum(GRAVITY), (5, 6)),
    "two_static": lambda: over(double_pendulum(GRAVITY, STATIC, "reduction.inertia_modes=true", *LIMITED), (3, 5)),
    "two_crossing": lambda: five_bar("reduction.modes=2", "reduction.angles=14"),
    "fails": lambda: slider_crank("reduction.angles=8", "reduction.modes=3"),
    "refused": lambda: slider_crank("reduction.modes=31"),
}  # fmt: skip


def fail_in_the_middle(modes: ModeSet) -> ModeSet:
    """Fail at one configuration, which belongs to one group only."""
    if modes.theta[0] > 4.5:
        raise RunError(f"eigenproblem at theta = {modes.theta[0]:.6g} rad: spoilt by the test")
    return modes


def run(directory: Path, case: str, cases: Mapping = CASES, meshes: Callable = meshes_of) -> None:
    name, ranks_per_group, seed = case.split(":")
    world = MPI.COMM_WORLD
    scene = cases[name]()
    options = {}
    if name == "fails":
        options["scramble"] = fail_in_the_middle
    elif int(seed):
        options["scramble"] = lambda modes: scrambled(int(seed), modes)
    outcome = f"{case} built"
    try:
        rom = build_rom(scene, meshes(scene), RankGroup.split(world, int(ranks_per_group)), **options)
        if (rom is None) != (world.rank > 0):
            outcome = f"{case} is on the wrong ranks"
        if rom is not None:
            rom.write(directory / f"{name}_{world.size}_{ranks_per_group}_{seed}.h5")
    except PgmpError as error:
        outcome = f"{case} {type(error).__name__}: {error}"
    for line in world.gather(outcome) or ():
        print(line)


if __name__ == "__main__":
    for argument in sys.argv[2:]:
        run(Path(sys.argv[1]), argument)
