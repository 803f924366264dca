"""Time integration of the full-order and the reduced model, one or many samples at a time."""
