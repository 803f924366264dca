"""Cross-sections of beams: each class is a section, with its entries, coefficients and outermost fibres."""
