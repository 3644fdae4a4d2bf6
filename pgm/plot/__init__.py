"""Pictures of networks, cluster graphs and beliefs; those that draw take and return axes."""

from pgm.plot.belief_map import belief_map
from pgm.plot.clusters import cluster_graph
from pgm.plot.consistency import coverage, nees, nis, whiteness
from pgm.plot.graphviz import dot
from pgm.plot.networks import network
from pgm.plot.over_time import errors, kl, rmse
from pgm.plot.plane import ellipses, trajectory
from pgm.plot.records import convergence

__all__ = [
    "belief_map",
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
