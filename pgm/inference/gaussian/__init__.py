"""Gaussian networks of any shape, whose factors are rows A of information matrices AᵀA."""

from pgm.inference.gaussian.run import run

__all__ = ["run"]
