"""Discrete networks: messages as tables."""

from pgm.inference.discrete.run import run

__all__ = ["run"]
