"""Solvers of large eigenproblems: shift-invert with checked pairs, over factors of MUMPS (`shift_invert`)."""
