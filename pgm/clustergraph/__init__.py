"""Cluster graphs: clusters of variables, joined by sepsets."""

from pgm.clustergraph.cluster import Cluster, check_families, check_running_intersection
from pgm.clustergraph.structure import ClusterGraph

__all__ = ["Cluster", "ClusterGraph", "check_families", "check_running_intersection"]
