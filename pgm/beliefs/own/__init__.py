"""Inference with a user's own family of beliefs: sweeps, posteriors and online steps.

A `BeliefFamily` says how a belief begins, is predicted, takes measurements, may flow back, and what
it shows; it sees a `Slice` of the network at each step.
"""
