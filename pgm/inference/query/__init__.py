"""Single queries: `query` gives the joint of a few variables of a discrete network given evidence.

It finds the part of the network that the joint depends on (`requisite`), plans an order of the
other variables of that part (`plan`) and sums them out in this order (`elimination`). Whether the
evidence on the rest of the network is possible is examined separately (`left_out`).
`most_probable` has the likeliest values of all hidden variables (`maximising`), of some, the
others summed out (`marginal_map`; a search, `branch_and_bound`, where their tables are too large),
or several assignments, one after another (`k_best`); `max_marginals` has the best assignment with
each state of each variable. `sensitivity` tells how a posterior probability depends on each entry
of each table.
"""

from pgm.inference.query.question import query

__all__ = ["query"]
