"""Gaussian networks of any shape: eliminating rows, messages as square roots."""

from pgm.inference.gaussian.run import run

__all__ = ["run"]
