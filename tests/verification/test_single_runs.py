"""One full-order run on one rank, as compiled lanes, against the same run with PETSc's matrices."""

from collections.abc import Mapping

import numpy as np
import pytest
from conftest import ROOT
from mpi4py import MPI
from runs import trajectory

from pgmp_petsc.full.distributed import FullDistributed
from pgmp_petsc.full.systems import FullBatch
from pgmp_petsc.mechanism.capabilities import Purpose
from pgmp_petsc.models import FullModel
from pgmp_petsc.results import Trajectory
from pgmp_petsc.stepping.status import Status
from pgmp_petsc.studies.inputs import read_scene

# Either iteration leaves at most 1e-12 of the size or of 1 rad in a step (`alpha_step.NEWTON_TOLERANCE`), both
# at most 1e-10 in 40 steps. Rates carry what is left over the step, 1e-9 of speeds of order 1, energies twice that.
ROUND_OFF = 1e-10
OF_ENERGIES = 1e-8  # of the most energy that is moved around, and 1 nJ

SCENES = (
    "double_four_bar", "double_pendulum", "five_bar", "four_bar", "quick_return", "slider_crank",
    "slider_crank_effects", "spinning_beam",
)  # fmt: skip
WEIGHT = 'effects.load={type="gravity"}'
PUSH = 'effects.push={type="torque", joint="crank_hinge", table=[[0.0, %g], [1.0, %g]]}'
# scenes that ship, and what these have not: another start, a run that hits an end stop, and one whose steps fail
CASES = {
    **{name: (name, ()) for name in SCENES},
    "settled": ("slider_crank", (WEIGHT, "initial.equilibrium=true", 'initial.coordinates="free"')),
    "end stop": (
        "slider_crank_effects",
        ("simulation.initial.theta.position=0.6", "simulation.initial.theta.velocity=-60.0"),
    ),
    "modal damping": ("slider_crank", ('effects.loss={type="structural_damping", mass=0.5, ratios=[0.01, 0.02]}',)),
    # fails at once; where an iteration just fails is a matter of round-off, and not the same in both
    "failing": ("slider_crank", (PUSH % (5e5, 5e5),)),
}


class Distributed(FullModel):
    """Runs with PETSc's matrices on one rank too."""

    def single(self, values: Mapping[str, float], comm: MPI.Comm) -> FullDistributed:
        return self.distributed(values, comm)


def both(name: str, *overrides: str, n_steps: int = 20) -> tuple[Trajectory, Trajectory]:
    """Run a scene of the repository for some steps, in lanes and with PETSc's matrices."""
    scene, meshes = read_scene(ROOT / "scenes" / f"{name}.toml", overrides, (), MPI.COMM_SELF, Purpose.CHECK)
    simulation = scene.simulation.model_copy(update={"duration": n_steps * scene.simulation.step})
    scene = scene.model_copy(update={"simulation": simulation})
    model = FullModel(scene, meshes)
    assert isinstance(model.single(scene.values, MPI.COMM_SELF), FullBatch)
    return trajectory(model), trajectory(Distributed(scene, meshes))


def compare(lanes: Trajectory, matrices: Trajectory) -> None:
    np.testing.assert_array_equal(lanes.time, matrices.time)
    assert (lanes.status, lanes.steps_divided) == (matrices.status, matrices.steps_divided)
    assert [remark.text for remark in lanes.record.remarks] == [remark.text for remark in matrices.record.remarks]
    pairs = [(lanes.outputs[name], expected) for name, expected in matrices.outputs.items()]
    pairs.append((lanes.coordinates, matrices.coordinates))
    pairs += [(lanes.frames.positions[name], places) for name, places in matrices.frames.positions.items()]
    pairs += [(lanes.frames.rotations[name], turns) for name, turns in matrices.frames.rotations.items()]
    for found, expected in pairs:
        np.testing.assert_allclose(found, expected, rtol=0, atol=ROUND_OFF * max(1.0, np.abs(expected).max()))
    one, two = lanes.balance, matrices.balance
    tolerance = OF_ENERGIES * two.exchanged + 1e-9
    assert one.work.keys() == two.work.keys()
    for name in ("kinetic", "strain", "potential", "residual"):
        np.testing.assert_allclose(getattr(one, name), getattr(two, name), rtol=0, atol=tolerance)
    for name, done in two.work.items():
        np.testing.assert_allclose(one.work[name], done, rtol=0, atol=tolerance)


@pytest.mark.parametrize("case", CASES)
def test_both_forms_of_a_run_agree(case: str) -> None:
    name, overrides = CASES[case]
    lanes, matrices = both(name, *overrides)
    assert (lanes.status != Status.FINE) == (case == "failing")
    compare(lanes, matrices)
