"""Beliefs compared on one model and its evidence, by oracles and by the truth."""

from pgm.comparison.comparing import compare
from pgm.comparison.judgement import Judgement
from pgm.comparison.oracle import Oracle
from pgm.comparison.row import Row
from pgm.comparison.table import Comparison

__all__ = ["Comparison", "Judgement", "Oracle", "Row", "compare"]
