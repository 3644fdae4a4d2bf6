"""Compiling networks to cluster graphs."""

from pgm.compile.bethe import Bethe
from pgm.compile.compiling import Method, compile
from pgm.compile.junction import JunctionTree
from pgm.compile.layout import SliceLayout
from pgm.compile.orders import MinFill, NestedDissection, Order, WeightedMinFill
from pgm.compile.slices import SliceGraph

__all__ = [
    "Bethe",
    "JunctionTree",
    "Method",
    "MinFill",
    "NestedDissection",
    "Order",
    "SliceGraph",
    "SliceLayout",
    "WeightedMinFill",
    "compile",
]
