"""Scenes: schema of a mechanism and its study, loading, changes from the command line. No PETSc, no MPI."""

from pgmp_petsc.scene.fields import GROUND, split_point
from pgmp_petsc.scene.loading import load_scene, scene_from_tables, scene_from_toml, scene_to_toml
from pgmp_petsc.scene.schema import Scene

__all__ = ["GROUND", "Scene", "load_scene", "scene_from_tables", "scene_from_toml", "scene_to_toml", "split_point"]
