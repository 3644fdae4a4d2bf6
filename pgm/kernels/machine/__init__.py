"""Machine code by LLVM: `emitter` writes it, `matrices` has those that it is written with.

`sweeps` are along chains, `newton` has the Gauss–Newton steps of chains, and `studies` the
draws and the statistics of simulated runs.
"""
