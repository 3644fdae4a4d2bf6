"""Filters and smoothers of dynamic networks with Gaussian beliefs, on chains of slices.

The slice of a time step is the vector of all hidden variables at that step. The folders hold the
passes forward and back along a chain (in float64, in twice the digits, or as parallel scans), the
linearisation, gating and association of measurements, the tests of rounding, and the posteriors
that users are given. Arrays over a whole chain have the steps 0..T as their first axis and the runs
as their second.
"""
