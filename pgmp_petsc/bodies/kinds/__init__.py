"""Kinds of bodies, one a module: each is found, and nobody imports one.

What a kind is asked for is said in `bodies.body`.
"""
