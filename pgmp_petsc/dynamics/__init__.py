"""Time integration of the full-order and the reduced model, one or many samples at a time.

What comes in is a model's equations with parameter values of samples; what goes out is every sample's motion, shown to
observers, and its status. `generalised_alpha` has the scheme and the run, and is where to begin; all models are
subclasses of `second_order_system.SecondOrderSystem`.

Scheme and control: `alpha_step` (one step, Newton's iteration, retries), `edge_search` (steps up to edges of laws),
`drivers` (PETSc's TS or a loop), `status`. Statics: `static_equilibrium`. Energies: `energies`, `full_energy`,
`reduced_energy`. Full order: `full_systems` over `full_problem` and `full_parts` (what there is), `full_kernel` and its
elements, forces and constraints (compiled equations), `full_steps` (compiled steps). Reduced: `reduced_system` over
`reduced_terms` and `reduced_actions` (tables), `reduced_kernel` and `reduced_lagrangian` (compiled equations),
`reduced_steps` (compiled steps).
"""
