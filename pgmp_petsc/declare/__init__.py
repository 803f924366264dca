"""Ideas that are declared once, and what is made of their declarations.

An expression of a declaration (`expressions`) is checked as it is declared, differentiated by sympy, and printed as
Python that numba compiles and as C99. Begin with `effects.laws`, whose laws are declared so.
"""
