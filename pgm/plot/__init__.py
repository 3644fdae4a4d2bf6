"""Pictures of networks, cluster graphs and beliefs; those that draw take and return axes."""

from pgm.plot.bands import errors
from pgm.plot.clusters import cluster_graph
from pgm.plot.confidence import ellipses
from pgm.plot.consistency import nees, nis
from pgm.plot.consistency_coverage import coverage
from pgm.plot.consistency_runs import kl, rmse
from pgm.plot.consistency_whiteness import whiteness
from pgm.plot.graphviz import dot
from pgm.plot.networks import network
from pgm.plot.paths import trajectory
from pgm.plot.records import convergence

__all__ = [
    "cluster_graph",
    "convergence",
    "coverage",
    "dot",
    "ellipses",
    "errors",
    "kl",
    "nees",
    "network",
    "nis",
    "rmse",
    "trajectory",
    "whiteness",
]
