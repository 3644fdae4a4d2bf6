"""Smoothers of a chain with Gaussian beliefs: iterated, in rounds, and of a fixed lag."""
