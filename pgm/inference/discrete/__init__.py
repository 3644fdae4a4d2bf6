"""Inference in discrete networks: potentials, messages and beliefs are tables.

A *run* is one set of evidence of a batch. In shapes, [runs] is an axis that a single run lacks. A
*plan* lays a graph's computations out once, for all later evidence.
"""

from pgm.inference.discrete.run import run

__all__ = ["run"]
