"""One self-contained page of results: files in, HTML out; no PETSc."""
