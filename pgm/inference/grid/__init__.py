"""Grids: beliefs as probabilities of cells, on the same declared networks."""
