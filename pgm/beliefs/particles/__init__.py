"""Beliefs as weighted draws: particle filters and smoothers of dynamic networks."""
