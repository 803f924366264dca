"""Compiled code: numba's functions with a cache on disk, and LANES samples side by side in one register.

A kernel is written once for one sample (`lane_items`) and compiled for numbers and for vectors (`vectors`, `tiles`).
What is compiled into a function marks its file of the cache, so that no old code is loaded (`compiled`); machine code
is made of what is called by its address alone (`compiled.Library`). Begin with `compiled`.
"""
