"""The random fields of a body: what its constants are multiplied by in every cell, affine in the fields' parameters.

    E(x) = E (1 + v sum_k sqrt(lambda_k) phi_k(x) xi_k)

with the coefficient of variation v and the expansion of `karhunen_loeve`. The parameters xi_k are bounded, so that
``1 - v sum_k |sqrt(lambda_k) phi_k(x)| max |xi_k|`` is the least factor that any sample can have anywhere.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from pgmp_petsc.bodies.affine import Monomial
from pgmp_petsc.bodies.karhunen_loeve import Expansion, expansion
from pgmp_petsc.bodies.profile import UNIFORM, Profile, Profiles
from pgmp_petsc.mesh.line_mesh import LineMesh
from pgmp_petsc.mesh.solid_mesh import SolidMesh
from pgmp_petsc.runtime.errors import InputError, Remark, note, warning
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.random_fields import RandomField

ROLE = {"E": "modulus", "rho": "density"}  # of others it is a size
LEAST = 0.01  # of the mean: what a quantity may fall to
# of the correlation length: larger cells miss the field between their middles (Der Kiureghian and Ke 1988)
COARSE = 0.5
MUCH = 0.8  # of the variance: expansions that keep less are warned of
MORE = 4  # times the terms: how far a message looks for as many as would do


def profiles_of(scene: Scene, body: str, mesh: LineMesh | SolidMesh) -> Profiles:
    """Return the factors of a body on its mesh.

    Raises
    ------
    InputError
        If a field has more terms than the body has cells, keeps too little of its variance, or may fall to zero.
    """
    found: dict[str, Profile] = {}
    for name, field in scene.fields.items():
        if field.body == body:
            terms = field.variation * checked_expansion(name, field, mesh).functions
            weights = [Monomial(((variable, 1),)) for variable in field.names(name)]
            found[ROLE.get(field.quantity, "size")] = Profile(dict(zip(weights, terms)))
    return Profiles(**found) if found else UNIFORM


def checked_expansion(name: str, field: RandomField, mesh: LineMesh | SolidMesh) -> Expansion:
    """Return the expansion of a field of some name over the mesh of its body; raises as `profiles_of`."""
    entry, (places, volumes) = f"fields.{name}", _cells(mesh)
    if field.terms > volumes.size:
        raise InputError(
            f"{entry}.terms = {field.terms}: {field.body} has {volumes.size} cells, and no more terms; take fewer, or "
            "a finer mesh"
        )
    found = _expanded(field, places, volumes, field.terms)
    if found.kept < field.least_share:
        more = _expanded(field, places, volumes, min(MORE * field.terms, volumes.size))
        enough = np.flatnonzero(np.cumsum(more.shares) >= field.least_share)
        cure = f"take {enough[0] + 1}" if enough.size else f"take more than {more.shares.size}"
        raise InputError(
            f"{entry}.terms = {field.terms}: they keep {found.kept:.4g} of the variance, less than {entry}.least_share "
            f"= {field.least_share:g}; {cure}, or a longer correlation"
        )
    reach = np.sum(np.abs(found.functions), axis=0) * field.reach
    worst = int(np.argmax(reach))
    if not field.variation * reach[worst] <= 1.0 - LEAST:
        place = ", ".join(f"{x:.4g}" for x in places[worst])
        limit, cure = "", "or fewer terms"
        if field.distribution == "normal":
            limit, cure = f" within {field.limit:g} deviations", 'a lower limit, or distribution = "uniform"'
        raise InputError(
            f"{entry}.variation = {field.variation:g}: with {field.terms} {field.distribution} variables{limit} "
            f"{field.quantity} of {field.body} may fall to {1.0 - field.variation * reach[worst]:.3g} times its mean, "
            f"at ({place}) m, and must stay positive; take at most {(1.0 - LEAST) / reach[worst]:.3g}, {cure}"
        )
    return found


def field_remarks(scene: Scene, meshes: Mapping[str, LineMesh | SolidMesh]) -> Iterator[Remark]:
    """Yield what the expansions of a scene's fields keep and leave out; raises as `profiles_of`."""
    for name, field in scene.fields.items():
        mesh = meshes[field.body]
        found = checked_expansion(name, field, mesh)
        least, most = (100 * field.variation * part for part in (found.deviations.min(), found.deviations.max()))
        text = (
            f"fields.{name}: {field.terms} {'term keeps' if field.terms == 1 else 'terms keep'} "
            f"{100 * found.kept:.3g} % of the variance of {field.quantity} over {field.body}; its coefficient of "
            f"variation is {least:.3g} to {most:.3g} % in place of {100 * field.variation:g} %"
        )
        say = note if found.kept >= MUCH else warning
        yield say(text if found.kept >= MUCH else f"{text}; take more fields.{name}.terms")
        size = float(np.max(_sizes(mesh)))
        if size > COARSE * field.length:
            yield warning(
                f"fields.{name}.length = {field.length:g}: cells of {field.body} are up to {size:.3g} m long, more "
                f"than half of it, and each has one value; take a finer mesh"
            )


def _expanded(field: RandomField, places: np.ndarray, volumes: np.ndarray, n_terms: int) -> Expansion:
    return expansion(places, volumes, field.kernel, field.length, field.smoothness or 0.5, n_terms)


def _cells(mesh: LineMesh | SolidMesh) -> tuple[np.ndarray, np.ndarray]:
    """Return the middles (n_cells, d) and the volumes (n_cells,) of the cells of a mesh."""
    middles = mesh.nodes[mesh.cells].mean(axis=1)
    if isinstance(mesh, LineMesh):
        return middles, mesh.lengths
    from pgmp_petsc.bodies.elasticity import volumes_of
    from pgmp_petsc.mesh.reference_element import reference_element

    return middles, volumes_of(mesh.nodes[mesh.cells], reference_element(mesh.kind).mass).sum(axis=1)


def _sizes(mesh: LineMesh | SolidMesh) -> np.ndarray:
    """Return the largest extents of the cells along an axis, m."""
    return np.ptp(mesh.nodes[mesh.cells], axis=1).max(axis=1)
