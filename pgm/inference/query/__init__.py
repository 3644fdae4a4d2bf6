"""Single queries: the joint of a few variables, from the part of a network that bears on it.

The files, in the order of the computation:

- ``requisite``: the CPDs and the evidence that bear on what is asked;
- ``plan``: in which order the other variables are summed out, and what it costs;
- ``elimination``: products and sums of tables in that order; evidence of probability zero, and
  where it contradicts the tables;
- ``question``: `pgm.query`.
"""

from pgm.inference.query.question import query

__all__ = ["query"]
