"""pgm: cluster-graph inference for (dynamic) Bayesian networks."""

__version__ = "0.1.0"
