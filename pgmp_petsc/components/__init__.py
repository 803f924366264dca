"""Continuum bodies condensed to few unknowns: the frames of their faces, and component modes."""
