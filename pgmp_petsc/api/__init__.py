"""The Python interface, whose names `pgmp_petsc` hands on: scenes, reduced models, runs, results.

Every function is collective on its ``comm`` and raises the package's own errors (`InputError`, `RunError`) on all ranks
alike. Results are the same on all ranks.
"""
