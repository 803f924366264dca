"""Solvers of large eigenproblems: shift-invert with checked pairs (`shift_invert`) over factors of MUMPS
(`shifted_factor`)."""
