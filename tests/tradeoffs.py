"""Small trade-off studies, for tests on one rank and on several."""

from dataclasses import replace

from mpi4py import MPI

from pgmp_petsc.bench.tradeoff import Sweep, measure_tradeoff
from pgmp_petsc.results import Tradeoff
from pgmp_petsc.scene import Scene, scene_from_toml
from scenes import SLIDER_CRANK, meshes_of, tables

# the fewest settings in which every kind of line occurs
TINY = Sweep(
    modes=(3,), angles=(16,), schemes=("overhauser",), parameter_modes=(1,), own_modes=(), own_angles=(),
    own_others=False, finer=1, coarser=1, tensor_modes=(2,), tensor_angles=12, refinements=(2,), finest=4,
    component_modes=(3,), surfaces=2, repeats=1, few_repeats=1, reference_halvings=(4, 3),
)  # fmt: skip
# the scene's own setting and the full order: five tasks
LEAST = replace(
    TINY, modes=(), angles=(), schemes=(), parameter_modes=(), tensor_modes=(), refinements=(), finest=2,
    component_modes=(), surfaces=0, finer=0,
)  # fmt: skip
OUTPUTS = tables("""
outputs.crank_angle: type = "angle"; joint = "crank_hinge"
outputs.slider_deformation: type = "deformation"; point = "rod:tip"; axis = "x"
""")
SMALL = (
    "reduction.modes=4", "reduction.angles=24", "simulation.duration=0.02", "simulation.step=1e-3", "ensemble.batch=16",
    'bodies.crank.mesh="0.0:0.3:2"', 'bodies.rod.mesh="0.3:1.0:2"',
)  # fmt: skip
NORMAL = 'parameters.r1.distribution={name="norm", loc=5.6e-3, scale=0.56e-3}'


def small_scene(*overrides: str, outputs: str = OUTPUTS) -> Scene:
    """Return a slider-crank of two elements a body over 20 steps, its crank's radius uncertain."""
    return scene_from_toml(SLIDER_CRANK + outputs, ".", (*SMALL, NORMAL, *overrides))


def study(scene: Scene, sweep: Sweep = TINY, n_samples: int = 1000, comm: MPI.Comm = MPI.COMM_SELF) -> Tradeoff | None:
    """Measure the trade-off of a scene with meshes made in memory. Collective on `comm`."""
    return measure_tradeoff(scene, meshes_of(scene), sweep, n_samples, comm, lambda text: None)
