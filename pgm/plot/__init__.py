"""Pictures of networks, cluster graphs and beliefs; those that draw take and return axes."""

from pgm.plot.animation import animate_beliefs
from pgm.plot.cells import belief_map
from pgm.plot.cloud import particles
from pgm.plot.clusters import cluster_graph
from pgm.plot.compared import comparison
from pgm.plot.consistency import coverage, nees, nis, whiteness
from pgm.plot.graphviz import dot
from pgm.plot.grid_map import grid_map
from pgm.plot.networks import network
from pgm.plot.occupancy import occupancy_map
from pgm.plot.over_time import errors, kl, rmse
from pgm.plot.plane import ellipses, trajectory
from pgm.plot.records import convergence
from pgm.plot.stacks import beliefs_over_time

__all__ = [
    "animate_beliefs",
    "belief_map",
    "beliefs_over_time",
    "cluster_graph",
    "comparison",
    "convergence",
    "coverage",
    "dot",
    "ellipses",
    "errors",
    "grid_map",
    "kl",
    "nees",
    "network",
    "nis",
    "occupancy_map",
    "particles",
    "rmse",
    "trajectory",
    "whiteness",
]
