"""What a scene holds as plain data, for `pgmp check --json`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from pgmp_petsc.bodies.assembled import Assembled
from pgmp_petsc.bodies.shape import BodyShape
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.outputs.outputs import OutputSet
from pgmp_petsc.scene import Scene


def summary_of_scene(scene: Scene, meshes: Mapping[str, BodyShape]) -> dict[str, Any]:
    """Return bodies, joints, coordinates, parameters, effects, outputs and remarks by their names, and counts."""
    mechanism = Mechanism.from_scene(scene, meshes)
    kinematics = RigidKinematics(mechanism)
    return {
        "scene": scene.name,
        "dimension": scene.dimension,
        "bodies": {body.name: _body(scene, body) | _mass_of(meshes.get(body.name)) for body in mechanism.bodies},
        "joints": {name: {"type": joint.type, "connect": list(joint.connect)} for name, joint in scene.joints.items()},
        "coordinates": {
            coordinate.name: {
                "unit": "rad",
                "range": [coordinate.lower, coordinate.upper],
                "periodic": coordinate.periodic,
                "prescribed": coordinate.prescribed,
            }
            for coordinate in mechanism.coordinates
        },
        "parameters": {
            name: {
                "value": parameter.current,
                "unit": parameter.unit,
                "distribution": None if parameter.distribution is None else parameter.distribution.name,
            }
            for name, parameter in scene.parameters.items()
        },
        "effects": {name: effect.type for name, effect in scene.effects.items()},
        "outputs": {name: {"unit": unit} for name, unit in OutputSet.of(scene, kinematics).units.items()},
        "unknowns": mechanism.n_dofs,
        "constraints": mechanism.n_constraints,
        "remarks": [asdict(remark) for remark in scene.remarks],
    }


def _body(scene: Scene, body) -> dict[str, Any]:
    """Return what kind of body it is and how large."""
    solid = None if body.meshed is None else body.meshed.solid.mesh
    n_nodes = len(body.shape.nodes) if solid is None else solid.n_nodes
    n_cells = len(body.shape.cells) if solid is None else solid.n_cells
    return {"element": scene.bodies[body.name].element if body.name in scene.bodies else "point mass",
            "flexible": body.flexible, "nodes": n_nodes, "cells": n_cells}  # fmt: skip


def _mass_of(mesh: BodyShape | None) -> dict[str, Any]:
    """Return mass (kg), centre of mass (m) and inertia about it (kg m2) of a body from matrices, at factors of 1."""
    if not isinstance(mesh, Assembled):
        return {}
    found = mesh.properties
    return {"mass": found.mass, "centre": found.centre.tolist(), "inertia": found.inertia.tolist()}
