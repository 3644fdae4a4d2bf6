"""Compiling networks to cluster graphs."""

from pgm.compile.compiling import Balanced, BalancedGraph, Method, compile
from pgm.compile.dynamic import DynamicGraph, SliceGraph, SliceLayout
from pgm.compile.machine import Compilation, Compiled
from pgm.compile.methods import LTRIP, Bethe, JoinGraph, JunctionTree
from pgm.compile.orders import (
    MinDegree,
    MinFill,
    NestedDissection,
    Order,
    StochasticMinFill,
    WeightedMinFill,
)

__all__ = [
    "LTRIP",
    "Balanced",
    "BalancedGraph",
    "Bethe",
    "Compilation",
    "Compiled",
    "DynamicGraph",
    "JoinGraph",
    "JunctionTree",
    "Method",
    "MinDegree",
    "MinFill",
    "NestedDissection",
    "Order",
    "SliceGraph",
    "SliceLayout",
    "StochasticMinFill",
    "WeightedMinFill",
    "compile",
]
