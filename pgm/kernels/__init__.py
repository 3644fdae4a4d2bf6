"""Array-only mathematics: pure functions on Gaussians, canonical forms and tables.

At a step components come first and the batch last; over all steps stacks come first, laid out in
memory with the runs or the steps fastest (`arrays.stacked`, `arrays.room`).
"""
