"""Inference in discrete networks: potentials, messages and beliefs are tables.

`run` gives the posterior of a network from its cluster graph and evidence: exactly, by two passes
of messages over a graph without loops; or by a schedule of messages on any graph. The other modules
lay tables out in flat arrays, compute messages, and read marginals and joints from them. A *run*
is one set of evidence of a batch. A *plan* is the layout of a graph's tables and messages, made
once for all later evidence.
"""

from pgm.beliefs.discrete.run import run

__all__ = ["run"]
