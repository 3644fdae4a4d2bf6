"""Passes over all steps of a chain with Gaussian beliefs, forward and back, in float64."""
