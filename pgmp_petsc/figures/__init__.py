"""Pictures of results: data in, a matplotlib `Figure` out; no state of pyplot, no PETSc."""
