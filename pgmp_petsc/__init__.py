"""Parametric Global Modal Parameterization of flexible mechanisms on PETSc and SLEPc."""

__version__ = "0.1.0"
