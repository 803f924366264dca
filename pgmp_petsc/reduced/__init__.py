"""The reduced system: coordinates theta and amplitudes delta of one basis (Naets et al. 2015, eqs. (8)-(14)).

What comes in are the tables of a ROM and parameter values; what goes out is a system for `stepping`. Begin with
`system`. `terms` and `actions` make what a sample needs of the tables, `lagrangian` has the equations and the
energies, of which `kernel` makes corrections, `action_kernel` evaluates laws on `action_frames`, `bordered` solves,
`steps` are the compiled steps, and `gap_forces` has what opens joints.
"""
