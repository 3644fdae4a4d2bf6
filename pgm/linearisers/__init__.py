"""Linearisers: what turns a nonlinear CPD into an affine Gaussian one at a belief."""

from pgm.linearisers.function import BoundFunction, FunctionTemplate, Lineariser
from pgm.linearisers.regression import Points, StatisticalRegression
from pgm.linearisers.rules import Cubature, MonteCarlo, Unscented
from pgm.linearisers.taylor import TAYLOR, Taylor

__all__ = [
    "TAYLOR",
    "BoundFunction",
    "Cubature",
    "FunctionTemplate",
    "Lineariser",
    "MonteCarlo",
    "Points",
    "StatisticalRegression",
    "Taylor",
    "Unscented",
]
