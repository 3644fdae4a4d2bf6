"""Discrete networks: messages as tables, laid out once for a graph that is asked again."""

from pgm.inference.discrete.run import run

__all__ = ["run"]
