"""Chains of slices of finitely many states: messages as probabilities of states."""
