"""Beliefs: a folder a family, of the values given as ``belief=`` and of networks without time.

Each imports from those before it alone: `points` (what cells and weighted draws have in common),
`own` (a family of beliefs, and how one of a user's own runs), `gaussian` and `moments` (means and
covariances, of any network and over time), `discrete` and `markov` (tables, of any network and over
time), `grid` (probabilities of cells), `particles` (weighted draws).
"""
