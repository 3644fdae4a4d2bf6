"""Chains of slices: forward messages as moments, backward ones by Bayes' rule.

The engine of dynamic networks: everything is stacked along the axis of time.
"""
