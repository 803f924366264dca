"""Made-up results in the likeness of the slider-crank's, for tests of files, pictures and commands."""

from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace

import numpy as np

from pgmp_petsc import results
from pgmp_petsc.ensemble.statistics import describe
from pgmp_petsc.files.hdf5 import RunRecord
from pgmp_petsc.results import gradients
from pgmp_petsc.results.ensemble import DESCRIBED, EXTREMES, Place, ShardSamples
from pgmp_petsc.results.estimates import VALIDITY
from scenes import tables

SCENE = tables("""
scene: name = "slider_crank"
parameters.r1: nominal = 5.6e-3; unit = "m"
""")
CRANK, ROD = 0.3, 0.7


def record(r1: float = 5.6e-3, seed: int | None = None) -> RunRecord:
    return RunRecord(SCENE, {"r1": r1}, seed, 2, {"eigenproblems": 1.25, "tables": 0.5})


def trajectory(model: str = "full", r1: float = 5.6e-3, n_frames: int = 60, n_times: int = 1001) -> results.Trajectory:
    """Return a run that looks like the paper's; the reduced one is wrong by some per cent."""
    time = np.linspace(0.0, 1.0, n_times)
    angle = _angle(time, r1)
    wrong = 0.0 if model == "full" else 1.0
    wave = np.sin(330.0 * time * (r1 / 5.6e-3)) * np.exp(-time)
    deformation = -1.6e-4 * (5.6e-3 / r1) ** 2 * np.minimum(time / 0.25, 1.0) * np.sin(angle) + 2e-5 * wave
    outputs = {
        "crank_angle": angle * (1.0 + wrong * 6e-5 * np.sin(5.0 * time)),
        "slider_position": CRANK * np.cos(angle) + np.sqrt(ROD**2 - (CRANK * np.sin(angle)) ** 2),
        "slider_deformation": deformation * (1.0 + wrong * 0.04 * np.cos(9.0 * time)),
    }
    return results.Trajectory(
        model=model, record=record(r1), time=time, outputs=outputs,
        units={"crank_angle": "rad", "slider_position": "m", "slider_deformation": "m"}, coordinates=angle[:, None],
        modal=np.outer(wave, np.arange(3.0)) if model == "reduced" else None,
        errors=errors(time, outputs) if model == "reduced" else None,
        frames=frames(np.linspace(0.0, 1.0, n_frames), r1) if n_frames else None,
    )  # fmt: skip


def errors(time: np.ndarray, outputs: dict[str, np.ndarray]) -> results.EstimatedErrors:
    """Return estimates of some per cent at every tenth instant."""
    return results.EstimatedErrors(
        time=time[::10],
        outputs={name: 0.03 * values[::10] * np.cos(7.0 * time[::10]) for name, values in outputs.items()},
        largest={name: float(np.abs(values).max()) for name, values in outputs.items()},
    )


def frames(time: np.ndarray, r1: float = 5.6e-3, n_elements: int = 5) -> results.Frames:
    """Return shapes of crank and rod, bent like half a sine."""
    angle = _angle(time, r1)
    tilt = -np.arcsin(CRANK / ROD * np.sin(angle))
    s = np.linspace(0.0, 1.0, n_elements + 1)
    cells = np.column_stack([np.arange(n_elements), np.arange(1, n_elements + 1)])
    bend = 2e-3 * np.sin(12.0 * time)[:, None] * np.sin(np.pi * s)
    pin = CRANK * np.column_stack([np.cos(angle), np.sin(angle)])

    def placed(origin: np.ndarray, length: float, direction: np.ndarray) -> np.ndarray:
        along = np.stack([np.cos(direction), np.sin(direction)], axis=-1)[:, None, :]
        across = np.stack([-np.sin(direction), np.cos(direction)], axis=-1)[:, None, :]
        return origin[:, None, :] + length * s[:, None] * along + bend[..., None] * across

    return results.Frames(
        time=time,
        positions={"crank": placed(0.0 * pin, CRANK, angle), "rod": placed(pin, ROD, tilt)},
        rotations={"crank": angle[:, None] + 0.0 * s, "rod": tilt[:, None] + 0.0 * s},
        nodes={"crank": np.column_stack([CRANK * s, 0 * s]), "rod": np.column_stack([ROD * s, 0 * s])},
        cells={"crank": cells, "rod": cells},
    )


def ensemble(model: str = "full", n_samples: int = 2000, n_failed: int = 3, seed: int = 1) -> results.Ensemble:
    """Return samples of r1 and what follows from them; the last ``n_failed`` samples failed."""
    random = np.random.default_rng(seed)
    r1 = random.normal(5.6e-3, 0.56e-3, n_samples)
    shift = 0.0 if model == "full" else 1.0
    relative = r1 / 5.6e-3
    outputs = {
        "crank_angle": 5.283 + 1.67 * (relative - 1.0) + shift * 1e-3,
        "slider_deformation": -0.9e-4 * relative**-3.0 * (1.0 + 0.02 * shift),
    }
    status = np.zeros(n_samples, dtype=np.int32)
    failure_time = np.full(n_samples, np.nan)
    if n_failed:
        status[-n_failed:] = 2
        failure_time[-n_failed:] = 0.4
        for values in outputs.values():
            values[-n_failed:] = np.nan
    return results.Ensemble(
        model=model, record=record(seed=seed), parameters={"r1": r1}, outputs=outputs,
        units={"r1": "m", "crank_angle": "rad", "slider_deformation": "m"}, status=status,
        meanings={0: "fine", 2: "Newton's method did not converge"}, failure_time=failure_time,
        steps_divided=np.ones(n_samples, dtype=np.int32),
        statistics={name: statistics(values) for name, values in (outputs | {"r1": r1}).items()},
        **(estimates(outputs) if model == "reduced" else {}),
    )  # fmt: skip


def estimates(outputs: dict[str, np.ndarray], n_checked: int = 20) -> dict[str, dict[str, np.ndarray]]:
    n_samples = len(next(iter(outputs.values())))
    checked = np.arange(n_samples) < n_checked
    at_end = {name: np.where(checked, 1e-3 * values, np.nan) for name, values in outputs.items()}
    return {
        "errors": {name: 1.5 * np.abs(values) for name, values in at_end.items()},
        "errors_at_end": at_end,
        "errors_unsure": {name: np.where(checked, 0.0, np.nan) for name in outputs},
        "validity": {name: np.where(checked, 1e-3, np.nan) for name in VALIDITY},
    }


def described(n_samples: int = 60) -> results.Ensemble:
    """Return an ensemble with all that may be known of one."""
    plain = ensemble("reduced", n_samples)
    outputs = plain.outputs
    columns = {f"{name}/{which}": np.linspace(0.0, 1.0, n_samples) for name in outputs for which in EXTREMES}
    units = {f"{name}.{which}": plain.units[name] for name in outputs for which in DESCRIBED} | {"late": "s"}
    return replace(
        plain,
        units=plain.units | units,
        extremes=columns,
        first_passages={"late": np.full(n_samples, np.nan)},
        probabilities={
            "late": results.Chance(
                "crank_angle above 5 rad at any time", 3, 57, 3 / 57, np.array([0.01, 0.2]), 0.9, 0, 1e-3, 0.2
            )
        },
        bands={name: band((0.1, 0.5, 0.9)) for name in outputs},
        sobol={name: sensitivity(True) for name in outputs} | {"crank_angle.max": sensitivity(False)},
    )


def band(probabilities: tuple[float, ...]) -> results.Band:
    """Return an output over time whose samples spread evenly, by 1 at the end."""
    time = np.linspace(0.0, 1.0, 21)
    quantiles = np.sin(time)[:, None] + time[:, None] * (np.array(probabilities) - 0.5)
    return results.Band(time, np.sin(time), time / np.sqrt(12.0), quantiles, np.array(probabilities), 40)


def sensitivity(total: bool) -> results.Sensitivity:
    """Return indices of two parameters, total ones where they are asked for."""
    first, above = np.array([0.7, 0.2]), np.array([0.75, 0.3])
    ends = np.array([-0.1, 0.1])
    of_total = (above, above[:, None] + ends) if total else (None, None)
    return results.Sensitivity(
        ("r1", "push"), "saltelli" if total else "given data", 64, 0.95, first, first[:, None] + ends, *of_total
    )


def statistics(values: np.ndarray) -> results.Statistics:
    """Return the statistics of the finite values; the others are missing."""
    fine = values[np.isfinite(values)]
    return describe(fine, 50, (0.05, 0.5, 0.95), values.size - fine.size)


INSTANTS = np.linspace(0.0, 1.0, 60)
ANGLE, BEND = 5.0 * INSTANTS**2, 1e-4 * np.sin(5.0 * INSTANTS)


def derivatives() -> results.Derivatives:
    found = {
        "crank_angle": {"r1": -300.0 * INSTANTS, "c": 2.0 * INSTANTS},
        "slider_deformation": {"r1": BEND, "c": 0.0 * INSTANTS},
    }
    return results.Derivatives(
        record(), INSTANTS, {"crank_angle": ANGLE, "slider_deformation": BEND}, found,
        {"crank_angle": "rad", "slider_deformation": "m", "r1": "m", "c": "1"},
        {"r1": (0.56e-3, gradients.DEVIATION), "c": (2e-4, gradients.PERCENT)}, np.diag([1.0, 0.0]),
    )  # fmt: skip


def fitted() -> results.Fit:
    """Return a fit of two parameters, of which one is not identifiable."""
    outputs = {
        "crank_angle": gradients.FittedOutput("rad", ANGLE + 1e-3, ANGLE, 0.9 * ANGLE, 1e-3, True),
        "slider_deformation": gradients.FittedOutput("m", BEND + 1e-6, BEND, 0.5 * BEND, 1e-6, False),
    }
    parameters = (
        gradients.FittedParameter("r1", "m", 5.6e-3, 6.001e-3, 4.8e-6, 1e-3, 12e-3),
        gradients.FittedParameter("c", "1", 0.02, 0.03, np.inf, 1e-3, 0.1),
    )
    return results.Fit(record(), INSTANTS, outputs, parameters, np.eye(2), 20, True)


def designed() -> results.Design:
    """Return a design of one parameter under one constraint."""
    outputs = {"crank_angle": ANGLE, "slider_deformation": BEND}
    return results.Design(
        record(), "minimise max(abs(slider_deformation))", 1e-4, 5e-5,
        (gradients.DesignParameter("r1", "m", 5.6e-3, 6.2e-3, 1e-3, 12e-3),),
        (gradients.DesignConstraint("end(crank_angle) >= 4.5", -0.2, 0.0, True),),
        np.array([[5.6e-3], [6.4e-3], [6.2e-3]]), np.array([1e-4, 4e-5, 5e-5]), None, 1, INSTANTS, outputs, outputs,
        {"crank_angle": "rad", "slider_deformation": "m"}, True,
    )  # fmt: skip


def rare_event(n: int = 6) -> results.RareEvent:
    """Return a rare event of subset simulation; the last sample failed."""
    normal = np.linspace(1.0, 3.0, n)
    value, status = 5.0 + normal, np.where(np.arange(n) < n - 1, 0, 2)
    value[-1] = np.nan
    levels = np.array([5.5, 6.5])
    return results.RareEvent(
        "reduced", record(seed=1), "end(crank_angle) > 6.5", "crank_angle", "rad", 0.95, 1e-4, np.array([5e-5, 2e-4]),
        0.3, 2e-4, 12.0, levels, np.array([0.1, 0.01]), np.array([1.0, 0.4]), (levels, np.array([1e-2, 1e-4])), ("r1",),
        normal[:, None], value, np.zeros(n), {"r1": 5.6e-3 + 5.6e-4 * normal}, status,
    )  # fmt: skip


def shard(n: int = 4) -> ShardSamples:
    """Return the first of two shards; its last sample failed."""
    fine = np.arange(n) < n - 1
    columns = {
        "parameters.r1": 5.6e-3 + 1e-4 * np.arange(n), "outputs.crank_angle": np.where(fine, 5.0, np.nan),
        "status": np.where(fine, 0, 2), "failure_time": np.where(fine, np.nan, 0.4),
    }  # fmt: skip
    place = Place(1, 2, 2 * n, 0, {"scene": "1234"})
    bands = {"crank_angle": np.ones((n, 3))}
    return ShardSamples("reduced", record(seed=1), place, {"crank_angle": "rad"}, (), (), 0.01, (), columns, bands)


def modes_table(r1: float = 5.6e-3, n_theta: int = 200, n_modes: int = 6, reduced: bool = True) -> results.ModesTable:
    """Return frequencies in the bands of the paper's Fig. 2."""
    theta = np.linspace(0.0, 2 * np.pi, n_theta)
    low = np.array([49.0, 229.2, 277.0, 694.4, 1250.0, 1360.0])[:n_modes]
    high = np.array([64.1, 238.9, 357.0, 750.4, 1300.0, 1374.0])[:n_modes]
    share = np.cos(theta[:, None] * np.array([2, 4, 2, 2, 2, 2])[:n_modes]) * 0.5 + 0.5
    growth = (r1 / 5.6e-3) ** np.array([0.3, 0.9, 1.0, 0.6, 1.0, 1.0])[:n_modes]
    full = (low + (high - low) * share) * growth
    return results.ModesTable(record(r1), theta, full, full * 1.0005 if reduced else None)


def _angle(time: np.ndarray, r1: float) -> np.ndarray:
    """Return the crank's angle: slow at first, 5.3 rad after 1 s, a little more with a lighter crank."""
    return 5.28 * time**2.2 * (5.6e-3 / r1) ** 0.4 + 0.15 * np.sin(2.0 * np.pi * time) * time


def tradeoff(
    n_outputs: int = 2, surfaces: bool = True, refined: bool = True, components: bool = False
) -> results.Tradeoff:
    """Return a study of few settings: the scene's own, three better ones, one that failed, the full order, surfaces,
    and component modes where they are asked for."""
    rows = [  # family, step, refinement, nodes, modes, static, angles, errors of both outputs, offline, batch, single
        ("reduced", 1e-3, 1, 0, 15, False, 629, 1e-5, 6e-2, 6.0, 4e-3, 0.12),
        ("reduced", 1e-3, 1, 0, 7, True, 48, 5e-6, 4e-3, 0.8, 2e-3, 0.11),
        ("reduced", 2e-3, 1, 0, 7, True, 48, 2e-5, 5e-3, 0.8, 1e-3, 0.06),
        ("reduced", 1e-3, 1, 0, 2, False, 48, 1e-4, 3e-1, 0.7, 1e-3, 0.10),
        ("reduced", 1e-3, 1, 0, 99, False, 48, np.nan, np.nan, np.nan, np.nan, np.nan),
        ("full", 1e-3, 1, 0, 0, False, 0, 3e-5, 4e-3, 0.3, 5e-3, 0.20),
        ("full", 5e-4, 1, 0, 0, False, 0, 7e-6, 2e-3, 0.3, 1e-2, 0.40),
    ]
    if refined:
        rows.append(("reduced", 1e-3, 2, 0, 7, True, 48, 5e-6, 4e-3, 0.9, 2e-3, 0.11))
        rows.append(("full", 1e-3, 2, 0, 0, False, 0, 3e-5, 4e-3, 0.3, 8e-3, 0.25))
    if surfaces:
        rows.append(("surface", 1e-3, 1, 3, 0, False, 0, 2e-3, 4e-1, 0.4, 1e-5, 1e-4))
        rows.append(("surface", 1e-3, 1, 9, 0, False, 0, 4e-5, 4e-3, 0.6, 1.1e-5, 1e-4))
    if components:
        rows.append(("components", 1e-3, 1, 0, 10, False, 0, 3e-5, 4e-3, 0.4, 3e-3, 0.15))
        rows.append(("components", 2e-3, 1, 0, 10, False, 0, 9e-5, 9e-3, 0.4, 1.5e-3, 0.08))
    family, step, refinement, nodes, modes, static, angles, first, second, offline, batch, single = zip(*rows)
    reduced = np.array([name == "reduced" for name in family])
    columns = {
        "step": np.array(step), "refinement": np.array(refinement), "nodes": np.array(nodes),
        "modes": np.where(reduced, modes, 0), "component_modes": np.where(np.array(family) == "components", modes, 0),
        "static_modes": np.array(static), "angles": np.array(angles), "second_order": np.zeros(len(rows), dtype=bool),
        "inertia_modes": np.zeros(len(rows), dtype=bool), "parameter_modes": np.zeros(len(rows), dtype=int),
        "interpolation": np.where(reduced, "spline", "").astype(object),
        "coordinates": np.where(reduced, 1 + np.array(modes) + np.array(static), 36),
    }  # fmt: skip
    return results.Tradeoff(
        record=record(),
        units=dict(list({"crank_angle": "rad", "slider_deformation": "m"}.items())[:n_outputs]),
        test_values={"r1": np.linspace(4.3e-3, 6.9e-3, 8)},
        parameter_units={"r1": "m"},
        families=family,
        columns=columns,
        flags=tuple("" if row == 0 else f"--override reduction.modes={modes[row]}" for row in range(len(rows))),
        reasons=tuple("reduction.modes = 99: too many" if number == 99 else "" for number in modes),
        errors=np.column_stack([first, second])[:, :n_outputs],
        wall=results.Times(*map(np.array, (offline, batch, single))),
        processor=results.Times(*(0.5 * np.array(times) for times in (offline, batch, single))),
        references=results.References(
            np.array([1, 2]), np.array([1e-5, 2e-5]), np.array([[1e-8, 3e-5], [1e-8, 3e-4]])[:, :n_outputs], ("", "")
        ),
        mesh=results.MeshErrors(
            np.array([1, 2, 4]), np.array([10, 20, 40]), np.array([[2e-5, 1e-2], [5e-6, 3e-3], [0, 0]])[:, :n_outputs]
        ),
        batch=128,
        repeats=3,
        samples=10_000,
        advice=("For 1 % take the second one:\n--override reduction.modes=7",),
    )


def assert_same(one, other, where: str = "result") -> None:
    """Compare two results down to every number, and the order of names, but for what they leave out of comparisons."""
    if isinstance(one, Mapping):
        assert set(one) == set(other), where
        for name in one:
            assert_same(one[name], other[name], f"{where}[{name}]")
        return
    assert type(one) is type(other), where
    if is_dataclass(one):
        for item in (item for item in fields(one) if item.compare):
            assert_same(getattr(one, item.name), getattr(other, item.name), f"{where}.{item.name}")
    elif isinstance(one, tuple):
        assert len(one) == len(other), where
        for number, (own, others) in enumerate(zip(one, other)):
            assert_same(own, others, f"{where}[{number}]")
    elif isinstance(one, (np.ndarray, float)):
        np.testing.assert_array_equal(one, other, err_msg=where)
    else:
        assert one == other, where
