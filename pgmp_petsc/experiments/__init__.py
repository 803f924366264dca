"""Runs that errors and prices are measured with: histories, the reference, its price."""
