"""Runs beside each other: outputs within a share of their largest values, samples side by side, orders of errors."""

from collections.abc import Callable, Iterable, Mapping, Sequence

import numpy as np
from runs import Meshes, history, motion, samples

from pgmp_petsc.models import Model
from pgmp_petsc.results import Balance
from pgmp_petsc.scene import Scene

Outputs = Mapping[str, np.ndarray]


def assert_alike(wanted: Outputs, found: Outputs, share: float, *names: str) -> None:
    """Check all outputs, or those named, to a share of each one's largest value."""
    for name in names or wanted:
        allowed = share * np.abs(wanted[name]).max()
        np.testing.assert_allclose(found[name], wanted[name], rtol=0, atol=allowed, err_msg=name)


def assert_groups_alike(wanted: Outputs, found: Outputs, share: float, *groups: Sequence[str]) -> None:
    """Check groups of outputs, such as the components of a force, to a share of the largest value in each."""
    for group in groups:
        largest = max(np.abs(wanted[name]).max() for name in group)
        for name in group:
            np.testing.assert_allclose(found[name], wanted[name], rtol=0, atol=share * largest, err_msg=name)


def assert_samples_are_those_alone(
    model: Model, which: Iterable[int], share: float = 0.0, **values: np.ndarray
) -> dict[str, np.ndarray]:
    """Check that samples side by side have the outputs that each has alone, bit for bit or to a share of the largest
    value; return these outputs."""
    n = len(next(iter(values.values())))
    together = history(model, samples(model.scene, n, **values), n)[1]
    for k in which:
        alone = history(model, samples(model.scene, 1, **{name: one[[k]] for name, one in values.items()}), 1)[1]
        for name, own in alone.items():
            allowed = share * np.abs(own).max()
            np.testing.assert_allclose(together[name][:, k], own[:, 0], rtol=0, atol=allowed, err_msg=name)
    return together


def orders(errors: Sequence[float | Sequence[float]]) -> np.ndarray:
    """Return the orders of convergence between levels, each twice as fine as the one before."""
    return np.log2(np.array(errors[:-1]) / np.array(errors[1:]))


def assert_order(errors: Sequence[float | Sequence[float]], order: float = 2.0, within: float = 0.2) -> None:
    """Check the orders of convergence between levels, each twice as fine as the one before."""
    np.testing.assert_allclose(orders(errors), order, rtol=0, atol=within, err_msg=str(errors))


def balances(kind: str, scene_of: Callable[[str], Scene], *steps: float, meshes: Meshes | None = None) -> list[Balance]:
    """Return the energy balances of runs with these steps."""
    return [motion(kind, scene_of(f"simulation.step={step}"), meshes).balance for step in steps]


def residuals(found: Iterable[Balance]) -> list[float]:
    """Return the largest residual of each balance."""
    return [float(np.abs(balance.residual).max()) for balance in found]


def shares_left(found: Iterable[Balance]) -> list[float]:
    """Return the same as shares of the energy that is exchanged."""
    return [float(np.abs(balance.residual).max() / balance.exchanged) for balance in found]
