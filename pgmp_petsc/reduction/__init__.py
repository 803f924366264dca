"""Reduced tables over the sampled configurations, their interpolation, and the ROM file."""
