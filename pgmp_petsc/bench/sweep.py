"""Which settings the trade-off study measures: lines through two settings, and a small tensor.

The first lines go through the scene's own setting, and a tensor of modes, static modes and steps lies where few angles
and splines are. The best reduced settings of these give the second lines. The best ones follow from errors and the
number of operations, never from measured times: the settings are the same in every run.

Response surfaces: outputs over time as functions of the parameters, interpolated between full-order runs.

With one uncertain parameter a cubic spline (not-a-knot; a polynomial where there are fewer than four nodes), with
several a cubic radial basis function with a polynomial, every instant of every output by itself. This is
what one would do without a reduced model: it knows nothing of the mechanism, and holds for the loads, the start and the
outputs of its runs only.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from scipy.interpolate import CubicSpline, RBFInterpolator

from pgmp_petsc.bench.candidates import Limits
from pgmp_petsc.bench.cases import Setting, own_steps, step_of
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.numerics import Reduction
from pgmp_petsc.scene.spanning_values import uncertain_names

AS_GOOD = 1.5  # how far above the smallest error a setting is still as good, if it is cheaper
GOOD_ENOUGH = 0.01  # an error for which the cheapest setting is a second best one
ALONG_EACH = 0.7  # power of the angles of one coordinate that are taken along each of several: 48 become 15


@dataclass(frozen=True)
class Sweep:
    """How far each line goes."""

    modes: tuple[int, ...]  # of the lines through the best settings, as are angles and schemes of interpolation
    angles: tuple[int, ...]
    schemes: tuple[str, ...]
    parameter_modes: tuple[int, ...]  # of the line through the best setting, where a parameter is uncertain
    own_modes: tuple[float, ...]  # factors on the scene's own number, of the line through its setting
    own_angles: tuple[int, ...]  # of that line
    own_others: bool  # whether lines of static modes and interpolation go through the scene's setting too
    finer: int  # halvings of the scene's step, of the reduced and the full-order model
    coarser: int  # doublings
    tensor_modes: tuple[int, ...]  # with and without static modes, with the scene's step and the one twice as long
    tensor_angles: int
    refinements: tuple[int, ...]  # parts of every cell that both models are run with
    finest: int  # parts of every cell of the mesh that tells the others' discretisation errors
    component_modes: tuple[int, ...]  # that the component model's bodies serve; the last one's steps are varied
    surfaces: int  # number of response surfaces
    repeats: int  # how often times are taken: of batches
    few_repeats: int  # and of builds and single samples
    reference_halvings: tuple[int, int]  # of the scene's step that the reference may take, also on refined meshes

    def over(self, n_coordinates: int) -> Sweep:
        """Return the sweep for a number of coordinates: of several, angles along each of them and fewer."""
        if n_coordinates == 1:
            return self
        few = tuple(dict.fromkeys(round(angles**ALONG_EACH) for angles in self.angles))
        own = tuple(dict.fromkeys(round(angles**ALONG_EACH) for angles in self.own_angles))
        schemes = tuple(scheme for scheme in self.schemes if scheme != "spectral")
        tensor = round(self.tensor_angles**ALONG_EACH)
        return replace(self, angles=few, own_angles=own, tensor_angles=tensor, schemes=schemes)


FULL = Sweep(
    modes=(2, 3, 5, 7, 10, 15, 22), angles=(16, 24, 32, 64, 96), schemes=("overhauser", "spline", "spectral"),
    parameter_modes=(0, 1, 2), own_modes=(0.5, 1.5), own_angles=(48, 96), own_others=True, finer=2, coarser=3,
    tensor_modes=(4, 7, 12), tensor_angles=48, refinements=(2, 4), finest=8, component_modes=(4, 10, 22), surfaces=4,
    repeats=3, few_repeats=2, reference_halvings=(7, 5),
)  # fmt: skip
QUICK = Sweep(
    modes=(2,), angles=(24,), schemes=(), parameter_modes=(2,), own_modes=(), own_angles=(), own_others=False, finer=0,
    coarser=3, tensor_modes=(4, 8), tensor_angles=48, refinements=(2,), finest=4, component_modes=(4, 12), surfaces=3,
    repeats=2, few_repeats=1, reference_halvings=(3, 3),
)  # fmt: skip


def own_setting(scene: Scene) -> Setting:
    """Return what the scene says."""
    return Setting("reduced", own_steps(scene), reduction=scene.reduction)


def first_settings(scene: Scene, sweep: Sweep, limits: Limits) -> list[Setting]:
    """Return the scene's own setting, first, the lines through it, the tensor, the full order and the surfaces."""
    own = own_setting(scene)
    n = own_steps(scene)
    static = _static(limits)
    settings = [own]
    settings += [own.with_reduction(modes=round(factor * own.reduction.modes)) for factor in sweep.own_modes]
    if sweep.own_others:
        settings += [own.with_reduction(static_modes=value) for value in static]
        settings += _sampled(own, sweep.own_angles, sweep.schemes)
    settings += [replace(own, n_steps=steps) for steps in _steps(n, sweep.finer - 1, 1)]
    few = own if _adaptive(own) else own.with_reduction(angles=sweep.tensor_angles, interpolation="spline")
    coarse = _steps(n, 0, 1)
    for modes, value, steps in product(_within(sweep.tensor_modes, limits), static, coarse):
        plain = {"inertia_modes": False, "parameter_modes": 0}
        settings.append(replace(few, n_steps=steps).with_reduction(modes=modes, static_modes=value, **plain))
    settings += [Setting("full", steps) for steps in _steps(n, sweep.finer, sweep.coarser)]
    settings += [Setting("full", n, refinement) for refinement in (sweep.refinements if limits.refinable else ())]
    settings += [Setting("components", n, component_modes=modes) for modes in sweep.component_modes]
    last = Setting("components", n, component_modes=sweep.component_modes[-1]) if sweep.component_modes else None
    settings += [replace(last, n_steps=steps) for steps in _steps(n, sweep.finer, sweep.coarser) if last]
    settings += [Setting("surface", n, nodes=k) for k in node_counts(len(uncertain_names(scene)), sweep.surfaces)]
    return _once(settings)


def settings_around(best: Sequence[Setting], scene: Scene, sweep: Sweep, limits: Limits) -> list[Setting]:
    """Return lines through the best settings, the best one's first; those of another are of modes and steps alone."""
    n = own_steps(scene)
    settings: list[Setting] = []
    for number, setting in enumerate(best):
        # what modes at other parameters add to one number of modes need not be independent of another's
        plain = setting.with_reduction(parameter_modes=0)
        settings += [plain.with_reduction(modes=modes) for modes in _within(sweep.modes, limits)]
        settings += [replace(setting, n_steps=steps) for steps in _steps(n, sweep.finer, sweep.coarser)]
        if number > 0:
            continue
        if limits.second_order:
            settings.append(setting.with_reduction(second_order=not setting.reduction.second_order))
        settings += [setting.with_reduction(static_modes=value) for value in _static(limits)]
        settings += _extended(setting, sweep, scene)
        settings += _sampled(setting, sweep.angles, sweep.schemes)
        if limits.refinable:
            settings += [replace(setting, refinement=refinement) for refinement in sweep.refinements]
    return _once(settings)


def best_settings(
    settings: Sequence[Setting], worst_errors: Sequence[float], n_coordinates: Sequence[int]
) -> list[Setting]:
    """Return the best reduced settings on the scene's meshes: one as good as any, then one that is good enough; none
    where every one failed.

    Errors are the largest of any output, NaN where a setting failed; numbers of coordinates are those of reduced ones.
    """
    points = [
        (error, setting.n_steps * n**2, setting)
        for setting, error, n in zip(settings, worst_errors, n_coordinates)
        if setting.family == "reduced" and setting.refinement == 1 and error == error
    ]
    if not points:
        return []
    smallest = min(error for error, _, _ in points)
    limits = (AS_GOOD * smallest, max(GOOD_ENOUGH, AS_GOOD * smallest))
    return _once(_cheapest(points, lambda error, limit=limit: error <= limit) for limit in limits)


def columns_of(settings: Sequence[Setting], scene: Scene) -> dict[str, np.ndarray]:
    """Return what was set, by name, each of shape (n_settings,); 0, false or empty where it has no meaning."""
    duration = scene.simulation.duration
    columns = {
        "step": np.array([step_of(duration, setting.n_steps) for setting in settings]),
        "refinement": np.array([setting.refinement for setting in settings]),
        "nodes": np.array([setting.nodes for setting in settings]),
        "component_modes": np.array([setting.component_modes for setting in settings]),
    }
    for key in Reduction.model_fields:
        values = [None if setting.reduction is None else getattr(setting.reduction, key) for setting in settings]
        kind = next((type(value) for value in values if value is not None), float)
        filled = [kind() if value is None else value for value in values]
        plain = kind in (bool, int, float)
        columns[key] = np.array(filled if plain else [str(value) for value in filled], dtype=kind if plain else object)
    return columns


def _cheapest(points: Sequence[tuple[float, int, Setting]], good: Callable[[float], bool]) -> Setting:
    """Return the setting with the fewest operations among the good ones; of equals, that with the fewest angles."""
    among = [point for point in points if good(point[0])]
    return min(among, key=lambda point: (point[1], point[2].reduction.angles))[2]


def _sampled(setting: Setting, angles: Sequence[int], schemes: Sequence[str]) -> list[Setting]:
    """Return other ways to sample and interpolate the tables."""
    if _adaptive(setting):
        tolerance = setting.reduction.sampling_tolerance
        return [setting.with_reduction(sampling_tolerance=other) for other in (10.0 * tolerance, tolerance / 10.0)]
    return [
        *(setting.with_reduction(angles=n) for n in angles),
        *(setting.with_reduction(interpolation=scheme) for scheme in schemes),
    ]


def _extended(setting: Setting, sweep: Sweep, scene: Scene) -> list[Setting]:
    """Return bases with the static answer to inertia forces or without, then with modes at other parameter values."""
    other = setting.with_reduction(inertia_modes=not setting.reduction.inertia_modes)
    if not uncertain_names(scene):
        return [other]
    with_inertia = setting.with_reduction(inertia_modes=True)
    return [other, *(with_inertia.with_reduction(parameter_modes=n) for n in sweep.parameter_modes)]


def _adaptive(setting: Setting) -> bool:
    """Whether angles are added until a tolerance holds, which splines alone can do."""
    return setting.reduction.sampling_tolerance is not None


def _static(limits: Limits) -> tuple[bool, ...]:
    """Return the choices of static modes that differ: without loads there are none."""
    return (False, True) if limits.n_static else (False,)


def _within(modes: Sequence[int], limits: Limits) -> list[int]:
    return [n for n in modes if n <= limits.n_modes]


def _steps(n: int, finer: int, coarser: int) -> list[int]:
    """Return n, its doubles, and its halves as far as they are whole."""
    coarse = [n // 2**k for k in range(1, coarser + 1) if n % 2**k == 0]
    return [n, *(n * 2**k for k in range(1, finer + 1)), *coarse]


def _once(settings: Iterable[Setting]) -> list[Setting]:
    """Leave out repetitions; the order stays."""
    return list(dict.fromkeys(settings))


# of the polynomial beside a cubic radial basis function, which needs at least the first
DEGREES = (2, 1)


class ResponseSurface:
    """Interpolates outputs over time between nodes in the space of the parameters.

    Parameters
    ----------
    nodes
        Parameter values, shape (n_nodes, n_parameters).
    outputs
        Outputs at the nodes, each of shape (n_t, n_nodes).

    Raises
    ------
    ValueError
        If there are too few nodes for any interpolation.
    """

    def __init__(self, nodes: np.ndarray, outputs: Mapping[str, np.ndarray]) -> None:
        self._names = list(outputs)
        every = np.concatenate(list(outputs.values())).T  # (n_nodes, n_outputs * n_t)
        # a deformation may be no number at some instants of a run that leaves a limited range
        self._known = np.isfinite(every).all(axis=0)
        data = every[:, self._known]
        self._low, self._width = nodes.min(axis=0), np.ptp(nodes, axis=0)
        scaled = self._scaled(nodes)
        if nodes.shape[1] == 1:
            self._interpolate = CubicSpline(scaled[:, 0], data)
        else:
            self._interpolate = RBFInterpolator(scaled, data, kernel="cubic", degree=_degree(*nodes.shape))

    def evaluate(self, points: np.ndarray) -> dict[str, np.ndarray]:
        """Return the outputs over time, each of shape (n_t, n), at parameter values of shape (n, n_parameters).

        Where a run of the surface has no number, neither has the surface.
        """
        scaled = self._scaled(points)
        rows = np.full((len(points), self._known.size), np.nan)
        rows[:, self._known] = self._interpolate(scaled[:, 0] if scaled.shape[1] == 1 else scaled)
        return dict(zip(self._names, np.split(rows.T, len(self._names))))

    def _scaled(self, points: np.ndarray) -> np.ndarray:
        return (points - self._low) / self._width


def node_counts(n_uncertain: int, steps: int) -> list[int]:
    """Return numbers of nodes that are worth a try, the fewest first: 3, 5, 9, ... or multiples of 2 n + 1."""
    if n_uncertain == 0:
        return []
    if n_uncertain == 1:
        return [2**k + 1 for k in range(1, steps + 1)]
    return [(2 * n_uncertain + 1) * 2**k for k in range(steps)]


def _degree(n_nodes: int, n_parameters: int) -> int:
    """Return the largest degree whose polynomials the nodes determine, with one node to spare."""
    terms = {1: n_parameters + 1, 2: (n_parameters + 1) * (n_parameters + 2) // 2}
    for degree in DEGREES:
        if n_nodes > terms[degree]:
            return degree
    raise ValueError(f"{n_nodes} nodes for {n_parameters} parameters; at least {terms[1] + 1} are needed")
