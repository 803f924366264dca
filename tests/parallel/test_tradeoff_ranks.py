"""The trade-off study on one rank and on several: the same settings, references and errors."""

import json

import numpy as np

LIMITED = 'coordinates.theta={joint="crank_hinge", range=[-0.5, 1.0]}'
SHORT = (LIMITED, "simulation.duration=0.01", "reduction.angles=8")


def test_errors_do_not_depend_on_the_number_of_ranks(mpirun, parallel_scripts) -> None:
    one, several = (json.loads(mpirun(n, parallel_scripts / "tradeoff.py", "tiny", *SHORT).stdout) for n in (1, 3))
    assert several["ranks"] == 3
    assert several["names"] == one["names"] and several["reasons"] == one["reasons"]
    assert several["steps"] == one["steps"] and all(several["timed"])
    for name in ("errors", "moved", "mesh"):
        # the eigensolver's random start changes the last digits
        np.testing.assert_allclose(several[name], one[name], rtol=1e-6, atol=1e-12)


def test_more_ranks_than_tasks(mpirun, parallel_scripts) -> None:
    one, many = (json.loads(mpirun(n, parallel_scripts / "tradeoff.py", "least", *SHORT).stdout) for n in (1, 6))
    assert many["names"] == one["names"] and all(many["timed"])
    np.testing.assert_allclose(many["errors"], one["errors"], rtol=1e-6, atol=1e-12)
