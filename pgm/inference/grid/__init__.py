"""Grids: beliefs of dynamic networks as probabilities of cells."""
