"""Solvers of large eigenproblems."""
