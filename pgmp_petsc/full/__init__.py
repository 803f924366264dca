"""The full-order system, of all unknowns with joints as constraints, and that of component models, of the coordinates
that a tree of joints has.

    M(p) q'' + g_int(q, p) + C(q)^T lambda = g_ext(q, t),    c(q) = 0        (Naets et al. 2015, eqs. (1)-(3))

What comes in is a mechanism with its effects and parameter values; what goes out is a system for `stepping`. Begin with
`systems`. `problem` and `parts` say what there is, `kernel` has the compiled equations with their elements, forces,
damping, floating bodies and constraints (`node_constraints`), `steps` the compiled steps, `energy` the energies.
`layout` orders the unknowns for `batched_ldl`; `distributed` is one sample on many ranks, and statics, which
`rank_solver` solves with PETSc.

Component models take `joint_systems` in place of `systems`: `joint_tree` says which coordinates there are, `joint_map`
what all frames are of them, `joint_matrix` and `joint_kernel` have a correction of the step.
"""
