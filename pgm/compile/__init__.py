"""Compiling networks to cluster graphs."""

from pgm.compile.layout import SliceLayout
from pgm.compile.slices import SliceGraph, compile

__all__ = ["SliceGraph", "SliceLayout", "compile"]
