"""Reduced models as source for other programs: C99, and functional mock-up units made of it."""
