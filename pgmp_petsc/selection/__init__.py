"""Knobs from tolerances: which basis, angles, interpolation and step keep the errors that a scene allows."""
