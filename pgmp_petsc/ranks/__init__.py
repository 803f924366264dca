"""Ranks of MPI: the start and the end of PETSc, agreement on failures, groups, and work that is dealt out.

A failure on one rank becomes the same failure on all of them (`agreement`), so that none waits for one that has left.
Samples and configurations are dealt to ranks as they get through them (`groups`). Begin with `agreement`.
"""
