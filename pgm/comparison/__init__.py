"""Linearisers and schedules compared on one model and its evidence."""

from pgm.comparison.comparing import compare
from pgm.comparison.oracle import Oracle
from pgm.comparison.row import Row
from pgm.comparison.table import Comparison

__all__ = ["Comparison", "Oracle", "Row", "compare"]
