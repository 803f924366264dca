"""Orchestration of whole computations: one run, a table of modes, the paper's figures."""
