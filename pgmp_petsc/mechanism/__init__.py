"""Mechanisms: joints, unknowns, rigid kinematics and the null space of the constraints."""
