"""Array-only mathematics: pure functions on Gaussians, canonical forms and tables.

These functions are called kernels. A *run* is one of several sets of evidence for which inference
in a model is done at once. Kernels of one time step take components first and the *batch* last,
vectors (n, *batch) and matrices (n, n, *batch), with the runs as batch, or no axis where there is
one run. Kernels of all steps take *stacks*, with the components last: (steps, runs, n) and
(steps, runs, n, n), in memory with the runs or the steps fastest (`arrays.stacked`, `arrays.room`).
"..." in a shape stands for any leading axes.

A component is *determined* where its variance given the components before it, which is its pivot in
a triangular factorisation, is zero but for rounding.
"""
