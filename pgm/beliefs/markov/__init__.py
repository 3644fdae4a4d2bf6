"""Inference in dynamic networks of discrete variables, whose CPDs are tables.

The hidden variables of a step are a *slice*; messages along the chain of slices are probabilities
of joint states, or their logarithms. There are filters, smoothers, an online filter, the most
probable path and the expected counts of families.
"""
