"""Beliefs of chains with discrete and continuous states: mixtures of a few Gaussians."""
