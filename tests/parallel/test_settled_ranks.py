"""Runs and samples that start from static equilibrium: the same on any number of ranks."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT
from runs import IN_TURN, PGMP, overridden

from pgmp_petsc.results import Ensemble, Trajectory

BEAMS, SOLIDS = (str(ROOT / "scenes" / f"{name}.toml") for name in ("slider_crank", "slider_crank_solid2d"))
GRAVITY = 'effects.weight={type="gravity", direction=[0.0, -1.0]}'
SETTLED = overridden("initial.equilibrium=true", "simulation.duration=0.003", "simulation.step=1e-3", GRAVITY)
FREE = [*SETTLED, *overridden('initial.coordinates="free"')]
FEW = overridden("reduction.modes=3", "reduction.angles=12", "reduction.parameter_modes=0", "ensemble.batch=2")
SMALL = overridden("simulation.step=1e-4", "simulation.duration=3e-4")
N = 5


@pytest.fixture(scope="module")
def folder(mpirun: Callable, tmp_path_factory: pytest.TempPathFactory) -> Callable[[int], Path]:
    """Return a function that gives the folder of the results of a number of ranks."""
    rom = tmp_path_factory.mktemp("settled") / "rom.h5"
    mpirun(1, *PGMP, "build", BEAMS, *FREE, *FEW, "-o", rom)
    made: dict[int, Path] = {}

    def made_by(n: int) -> Path:
        if n not in made:
            made[n] = tmp_path_factory.mktemp(f"settled_{n}")
            wanted = [
                ["montecarlo", str(rom), "-n", str(N), "--seed", "3", "-o", str(made[n] / "reduced.h5")],
                ["montecarlo", BEAMS, "--full", *FREE, *FEW, "-n", "3", "-o", str(made[n] / "full.h5")],
                # let go at time zero: waves need small steps
                ["simulate", SOLIDS, "--full", *SETTLED, *SMALL, "-o", str(made[n] / "held.h5")],
                ["simulate", SOLIDS, "--full", *FREE, "-o", str(made[n] / "free.h5")],
            ]
            # small models are not dealt out otherwise
            small = "import pgmp_petsc.studies.simulate as study\nstudy.UNKNOWNS_PER_RANK = 1\n"
            done = mpirun(n, "-c", small + IN_TURN, json.dumps(wanted))
            statuses = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("[")]
            # a sample without equilibrium is a record, with exit status 1
            said = f"{done.stdout}\n{done.stderr}"
            assert len(statuses) == 4 and all(set(ranks) <= {0, 1} for ranks in statuses[:2]), said
            assert statuses[2:] == [[0] * n] * 2, said
        return made[n]

    return made_by


@pytest.mark.parametrize("n", [2, 3])
@pytest.mark.parametrize("name", ["reduced.h5", "full.h5"])
def test_samples_are_those_of_one_rank(folder: Callable, n: int, name: str) -> None:
    one, several = (Ensemble.read(folder(ranks) / name) for ranks in (1, n))
    assert (one.status == 0).any()
    np.testing.assert_array_equal(several.status, one.status)
    for output, values in one.outputs.items():
        np.testing.assert_array_equal(several.outputs[output], values)


@pytest.mark.parametrize("n", [2, 3])
@pytest.mark.parametrize("name", ["held.h5", "free.h5"])
def test_solids_that_ranks_share_settle_where_one_rank_does(folder: Callable, n: int, name: str) -> None:
    one, several = (Trajectory.read(folder(ranks) / name) for ranks in (1, n))
    for output, values in one.outputs.items():
        # sums in another order: 1e-9 of the largest value over three steps
        np.testing.assert_allclose(several.outputs[output], values, rtol=0, atol=1e-8 * np.abs(values).max())
    strain = one.balance.strain[0]
    assert strain > 0.0
    np.testing.assert_allclose(several.balance.strain[0], strain, rtol=1e-6)
