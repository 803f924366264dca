"""Joints a scene may have: classes that are found, one a type, with the statements that each holds.

In: a table ``[joints.NAME]`` (`scene.joints`). Out: `mechanism.statements` about two frames, which are to be zero;
closure, constraints, forces and code in C are made of them. Joints that share a point are in `meeting`, those that move
along a line or plane in `guided`.
"""
