"""Pictures of networks, cluster graphs and beliefs; those that draw take and return axes."""

from pgm.plot.beliefs.bands import bands
from pgm.plot.beliefs.cells import belief_map, grid_map, occupancy_map
from pgm.plot.beliefs.cloud import particles
from pgm.plot.beliefs.fan import forecast
from pgm.plot.beliefs.plane import ellipses, trajectory
from pgm.plot.beliefs.stacks import beliefs_over_time
from pgm.plot.diagrams.clusters import cluster_graph
from pgm.plot.diagrams.factor_graphs import factor_graph
from pgm.plot.diagrams.graphviz import dot
from pgm.plot.diagrams.networks import markov_network, network
from pgm.plot.moving.animation import animate_beliefs
from pgm.plot.moving.run import animate
from pgm.plot.statistics.compared import comparison, ranking
from pgm.plot.statistics.consistency import coverage, nees, nis, whiteness
from pgm.plot.statistics.over_time import errors, kl, rmse
from pgm.plot.statistics.records import convergence
from pgm.plot.statistics.studied import study

__all__ = [
    "animate",
    "animate_beliefs",
    "bands",
    "belief_map",
    "beliefs_over_time",
    "cluster_graph",
    "comparison",
    "convergence",
    "coverage",
    "dot",
    "ellipses",
    "errors",
    "factor_graph",
    "forecast",
    "grid_map",
    "kl",
    "markov_network",
    "nees",
    "network",
    "nis",
    "occupancy_map",
    "particles",
    "ranking",
    "rmse",
    "study",
    "trajectory",
    "whiteness",
]


def __dir__() -> list[str]:
    """The public names, without the folders and files that hold them."""
    return sorted({*__all__, *(name for name in globals() if name.startswith("__"))})
