"""Ensembles: sampling of the parameters, integration over ranks, statistics."""
