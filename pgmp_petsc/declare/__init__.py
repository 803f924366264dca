"""Declarations: ideas that say what they are once, and what follows from that.

`records` has results: a field of a dataclass names its sizes, its unit and its meaning, and files and checks of shapes
follow; `views` has their datasets of xarray and the tables of the documentation.
"""
