"""Ideas declare themselves and are found: one class says what a scene may write and what the models make of it.

What comes in: folders of the package, entry points of installed packages, files given by ``--plugin`` or
``pgmp.use``. What goes out: the classes of a family by their ``type``, from which the scene makes its schema. Begin
with `ideas`; `plugins` loads files and says with which of them a result was made.

`records` has results: a field of a dataclass names its sizes, its unit and its meaning, and files and checks of shapes
follow.

An expression of a declaration (`expressions`) is checked as it is declared, differentiated by sympy, and printed as
Python that numba compiles and as C99; laws (`effects.action`) are declared so. Of sums of products with tables in index
notation, as of a Lagrangian (`reduced.lagrangian`), `forms` prints the equations of motion and their derivatives.
"""
