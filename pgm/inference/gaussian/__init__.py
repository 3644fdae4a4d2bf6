"""Gaussian networks of any shape; a factor is kept as a root A of its information matrix AᵀA."""

from pgm.inference.gaussian.run import run

__all__ = ["run"]
