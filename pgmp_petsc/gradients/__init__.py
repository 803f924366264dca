"""Derivatives of runs of the reduced model with parameters: forward sensitivities, step by step.

tables' jets (`linearisation`) -> residual and its derivatives (`reduced.lagrangian`), with local effects
(`local_effects`) -> along a run (`linearisation`) -> start, steps and outputs (`differentiated`)
"""
