"""Beliefs compared, by oracles and by the truth: on one model's evidence, and on drawn runs."""

from pgm.comparison.comparing import compare
from pgm.comparison.judgement import Judgement
from pgm.comparison.oracle import Oracle
from pgm.comparison.row import Row
from pgm.comparison.study_result import Statistic, Study, StudyRow
from pgm.comparison.studying import study
from pgm.comparison.table import Comparison

__all__ = [
    "Comparison",
    "Judgement",
    "Oracle",
    "Row",
    "Statistic",
    "Study",
    "StudyRow",
    "compare",
    "study",
]
