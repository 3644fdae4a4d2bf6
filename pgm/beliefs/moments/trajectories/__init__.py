"""Draws of whole trajectories from Gaussian laws, and their densities by the model."""
