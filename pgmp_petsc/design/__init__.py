"""What derivatives of runs are for: shares of parameters, values that fit a measurement, best values.

In come a reduced model and parameters; out go results of `sensitivities`, `fit` and `optimize`. Begin at
`derivatives`; `fitting` is least squares of what `gradients` gives, `optimization` finds the best under constraints.
"""
