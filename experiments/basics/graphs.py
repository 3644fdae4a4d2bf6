"""The two kinds of graphical models, and how one becomes the other."""

from __future__ import annotations

from functools import partial

from matplotlib.figure import Figure

import pgm
import pgm.plot
from experiments.side_by_side import side_by_side

a, b, c, d = pgm.variables("a b c d")

# A loop, for which no arrows say the same: a is independent of c given b and d, and b of d given
# a and c.
FACTORS = [(a, b), (b, c), (c, d), (d, a)]


def directed() -> pgm.BayesianNetwork:
    """p(a) p(b | a) p(d | a) p(c | b, d)."""
    return pgm.BayesianNetwork(
        [
            pgm.GaussianCPD(a, mean=0.0, cov=1.0),
            pgm.LinearGaussianCPD(b, given={a: 1.0}, cov=1.0),
            pgm.LinearGaussianCPD(d, given={a: -1.0}, cov=1.0),
            pgm.LinearGaussianCPD(c, given={b: 1.0, d: 1.0}, cov=1.0),
        ]
    )


def kinds() -> Figure:
    """A Markov network, a Bayesian network, and that as a Markov network."""
    return side_by_side(
        {
            "undirected": partial(pgm.plot.markov_network, FACTORS),
            "directed": partial(pgm.plot.network, directed()),
            "made undirected": partial(pgm.plot.markov_network, directed()),
        },
        columns=3,
    )
