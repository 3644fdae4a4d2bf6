"""Filters and smoothers of dynamic networks, on chains of slices.

The slice of a time step is the vector of all hidden variables at that step. Arrays over a whole
chain have the steps 0..T as their first axis and the runs as their second.
"""
