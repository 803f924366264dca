"""Bodies: strain and kinetic energies, and the affine terms in which parameters enter them."""
