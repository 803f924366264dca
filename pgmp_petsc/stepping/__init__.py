"""Time integration: the generalised-alpha scheme, one driver for all systems, single or many samples at a time.

What comes in is a system, a subclass of `second_order_system.SecondOrderSystem` with parameter values of samples; what
goes out is every sample's motion, shown to observers, and its status. Begin with `generalised_alpha`, which has the
scheme and the run, driven by PETSc's TS or a loop. `alpha_step` has one step, the control of Newton's iteration and
retries with smaller steps, `edge_search` steps up to edges of laws, `static_equilibrium` settled starts,
`second_order_system` has the balance of energy too, `status` how a sample ended.
"""
