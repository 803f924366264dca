"""Bodies: strain and kinetic energies, and the affine terms in which parameters enter them.

A scene's body and its shape (`shape`: a mesh, matrices, or what was made of one already) make a `body.Body` of some
kind; kinds are the classes in `kinds`, found by `body.kinds`, and what a body hands out is said in `body`: frames and
their place among the unknowns, matrices and blocks of elements, moments of inertia, the third derivative of the strain
energy, strains and stresses, what pictures show, a price, and traits. Nobody outside asks for the kind.

Below them are elements (`beam2d`, `beam3d`, `elasticity`), sections of beams (`sections`, found too),
solids and their frames (`solid`, `framed_solid`), matrices of other programs (`assembled`), what is made
of bodies (`component`, `floating`), and affine dependence on parameters (`affine`, `profile`, `random_fields`). Begin
with `body`, then `kinds.beam`.
"""
