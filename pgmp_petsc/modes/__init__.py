"""Constrained eigenmodes at sampled configurations, and their continuity over the configurations."""
