"""Pictures of networks, cluster graphs and beliefs; every function takes and returns axes."""

from pgm.plot.bands import errors
from pgm.plot.clusters import cluster_graph
from pgm.plot.confidence import ellipses
from pgm.plot.networks import network
from pgm.plot.paths import trajectory

__all__ = ["cluster_graph", "ellipses", "errors", "network", "trajectory"]
