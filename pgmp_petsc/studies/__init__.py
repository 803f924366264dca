"""Orchestration of whole computations: checks, builds, single runs, tables of modes, beginnings of scenes."""
