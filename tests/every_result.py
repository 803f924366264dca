"""A result of every kind with all that its files may have, and the listing of a file: its datasets and attributes.

The listings under tests/listings are of files that the program wrote before results were declared. They are a contract
with other programs: a listing changes only where a file is to change, together with the version of its kind.
"""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import fielded
import h5py
import numpy as np
import synthetic

from pgmp_petsc.base.errors import Remark
from pgmp_petsc.results import Attempt, Balance, EffectSizes, EstimatedErrors, Selection
from pgmp_petsc.results.ensemble import Corrected, Figure, Joined, MostLikely, Stopping
from pgmp_petsc.results.estimates import OF_STEP, VALIDITY
from pgmp_petsc.results.gradients import DesignConstraint, Instants
from pgmp_petsc.results.selection import EffectSize

LISTINGS = Path(__file__).parent / "listings"
LEFT_OUT = ("program_version", "scene")  # of root attributes


def run_with_all() -> Any:
    """Return a reduced run with frames, fields, errors and a balance of energy."""
    run, flat = synthetic.trajectory("reduced", n_frames=3, n_times=21), fielded.flat_run(cells=(2, 1), n_frames=3)
    bar = replace(flat.fields["bar"], radius=0.25)
    rising = np.arange(21.0)
    balance = Balance(rising, 0.5 * rising, 0.0 * rising, {"motor": 1.5 * rising, "brake": 0.0 * rising})
    errors = replace(run.errors, absent={"crank_angle": "it is prescribed"})
    validity = {name: 0.25 for name in VALIDITY}
    frames = replace(run.frames, rigid=frozenset({"rod"}))
    return replace(run, errors=errors, balance=balance, validity=validity, fields={"bar": bar}, frames=frames)


def run_in_space() -> Any:
    """Return a full-order run of bodies in space that stopped, with two coordinates."""
    run = fielded.block_run()
    return replace(
        run, status=2, steps_divided=4, coordinates=np.ones((len(run.time), 2)),
        coordinate_units={"theta": "rad", "reach": "m"},
        record=replace(run.record, remarks=(Remark("note", "it stopped"),), seed=3),
        errors=EstimatedErrors(run.time, {"crank_angle": 0.5 * run.time}, {"crank_angle": 2.0}, OF_STEP),
    )  # fmt: skip


def ensemble_with_all() -> Any:
    """Return an ensemble with all figures, of which two better models have samples."""
    found = synthetic.described(12)
    figures = {
        "mean": Figure(1.0, np.array([0.5, 1.5]), 1.25, np.array([0.25, 2.0])),
        "std": Figure(0.5, np.array([0.25, 0.75])),
        "bias": Figure(0.125, np.array([0.0, 0.25])),
    }
    joined = Joined(
        ("full/4", "components", "reduced"),
        0.95,
        {
            "crank_angle": Corrected(figures, np.array([3, 5, 12]), np.array([0.9, 0.8]), np.array([1.0, 0.5])),
            "late": Corrected(
                {"estimate": Figure(0.5, np.array([0.25, 0.75]))}, np.array([3, 5, 12]), np.zeros(0), np.zeros(0)
            ),
        },
        {"full/4": {"crank_angle": np.ones(3)}, "components": {"crank_angle": np.ones(5)}},
        {"full/4": np.array([0, 2, 0]), "components": np.zeros(5, dtype=int)},
    )
    stopping = Stopping(
        "all rules are met", None, ("mean(crank_angle) +- 1 %", "std(slider_deformation)"), ("rad", "m"),
        np.array([0.01, 0.5]), np.array([True, False]), np.array([True, True]), np.array([6, 12]), np.ones((2, 2)),
        np.ones((2, 2, 2)),
    )  # fmt: skip
    return replace(
        found, balance={"residual": np.ones(12), "exchanged": np.full(12, 2.0)},
        kept={"unstable_start": np.zeros(12), "bands.crank_angle": np.ones((8, 21))}, joined=joined, stopping=stopping,
    )  # fmt: skip


def derivatives_with_contacts() -> Any:
    """Return derivatives of a run that meets an end stop and leaves it."""
    contacts = Instants(
        ("stop", "stop"), np.array([True, False]), np.array([0.25, 0.5]), np.array([0.125, 0.125]), np.ones((2, 2))
    )
    return replace(synthetic.derivatives(), contacts=contacts, steps_divided=2)


def robust_design() -> Any:
    design = synthetic.designed()
    constraint = DesignConstraint("std(crank_angle) <= 1", 0.5, -0.25, False, (-0.5, 0.25))
    return replace(
        design, constraints=(constraint, constraint), deviations=2.0, n_samples=8, goal_interval=np.array([0.0, 1.0]),
        confidence=0.9,
    )  # fmt: skip


def rare_with_design_points() -> Any:
    found = MostLikely(np.array([3.0]), np.array([[3.0]]), np.array([[1.0]]), {"r1": np.array([7e-3])}, True, 9)
    return replace(synthetic.rare_event(), most_likely=found, asked=5, text="end(crank_angle) > 6.5")


def modes_over_two_coordinates() -> Any:
    units = {"theta": "rad", "reach": "m"}
    return replace(synthetic.modes_table(n_theta=12), theta=np.arange(24.0).reshape(2, 12), coordinate_units=units)


SELECTION = Selection(
    tolerances={"reduction": 1e-2}, allowed={"basis": 3.5e-3}, chosen={"reduction.modes": 7},
    reasons={"reduction.modes": "leave 0.002"}, kept={"reduction.interpolation": "spline"},
    attempts=(
        Attempt("basis", {"modes": 4}, 100, np.array([0.5, np.inf]), np.inf, "x", 55.0, 0.5, "no convergence"),
        Attempt("step", {"step": 2e-3}, 500, np.array([0.25, 0.5]), 0.5, "x, load 'own', r = 1"),
    ),
    outputs=("angle", "x"), values={"r": np.array([1.0, 2.0])}, loads={"own": "the scene's own loads"},
    remarks=("no torque acts",), reference={"model": "full", "seconds": 2.0},
)  # fmt: skip
SIZES = EffectSizes(
    1e-3,
    (EffectSize("motor", "torque", 0.5, True, "of the energy"), EffectSize("", "gravity", np.nan, False, "from 1 kg")),
    {"theta": 6.5}, 2.0, ("the scene leaves out gravity",), {"theta": "rad"},
)  # fmt: skip

PARTS = (SELECTION, SIZES)
RESULTS = {
    "trajectory": run_with_all, "trajectory_in_space": run_in_space, "ensemble": ensemble_with_all,
    "ensemble_bare": lambda: synthetic.ensemble("full", 12), "shard": synthetic.shard,
    "modes": lambda: synthetic.modes_table(n_theta=5, reduced=False),
    "modes_two_coordinates": modes_over_two_coordinates, "tradeoff": synthetic.tradeoff,
    "sensitivities": derivatives_with_contacts, "fit": synthetic.fitted, "design": synthetic.designed,
    "design_robust": robust_design, "rare_event": rare_with_design_points,
}  # fmt: skip


def listing(path: Path) -> str:
    """Return a line for every dataset of a file, and every group that is empty or has attributes, in their order."""
    with h5py.File(path) as file:
        return "\n".join(_lines(file, "")) + "\n"


def _lines(item: h5py.Group | h5py.Dataset, name: str) -> Iterator[str]:
    about = " ".join(f"{key}={_text(value)}" for key, value in item.attrs.items() if key not in LEFT_OUT)
    if isinstance(item, h5py.Dataset):
        yield f"{name} {item.dtype} {item.shape} {about}"
        return
    if about or not len(item):
        yield f"{name}/ {about}"
    for key in item:
        yield from _lines(item[key], f"{name}/{key}")


def _text(value: Any) -> str:
    """Return an attribute with its type; numbers with six digits, which other processors agree in."""
    if isinstance(value, str):
        return repr(value)
    array = np.asarray(value)
    words = [f"{entry:.6g}" if isinstance(entry, float) else repr(entry) for entry in array.ravel().tolist()]
    return f"{type(value).__name__}:{array.dtype}{array.shape}[{', '.join(words)}]"
