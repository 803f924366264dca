"""The trade-off study on more ranks than it has tasks: the same settings and errors as on one."""

import json

import numpy as np

LIMITED = 'coordinates.theta={joint="crank_hinge", range=[-0.5, 1.0]}'
SHORT = (LIMITED, "simulation.duration=0.01", "reduction.angles=8")


def test_more_ranks_than_tasks(mpirun, parallel_scripts) -> None:
    one, many = (json.loads(mpirun(n, parallel_scripts / "tradeoff.py", *SHORT).stdout) for n in (1, 6))
    assert many["names"] == one["names"] and all(many["timed"])
    # the eigensolver's random start changes the last digits
    np.testing.assert_allclose(many["errors"], one["errors"], rtol=1e-6, atol=1e-12)
