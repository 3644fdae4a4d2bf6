"""Is a belief right about its own errors? Errors, normalised errors, coverage, whiteness.

NaN in a truth is a component that is not known. Normalised errors and regions are then those of the
marginal of the components that are; the length of an error is known where all of its components
are. Results say how many they are made of, as their `count`.
"""

from pgm.consistency.autocorrelation import Whiteness, whiteness
from pgm.consistency.averages import Average, anees, anis, average, mean_band
from pgm.consistency.errors import error, kl, log_score, nees, nis, rmse
from pgm.consistency.over_time import OverTime, over_time, rmse_over_time
from pgm.consistency.ranking import Ranked, Ranking, ranking
from pgm.consistency.regions import Coverage, coverage

__all__ = [
    "Average",
    "Coverage",
    "OverTime",
    "Ranked",
    "Ranking",
    "Whiteness",
    "anees",
    "anis",
    "average",
    "coverage",
    "error",
    "kl",
    "log_score",
    "mean_band",
    "nees",
    "nis",
    "over_time",
    "ranking",
    "rmse",
    "rmse_over_time",
    "whiteness",
]
