"""Linearisers: what turns a nonlinear CPD into an affine Gaussian one at a belief."""

from pgm.linearisers.function import BoundFunction
from pgm.linearisers.lineariser import ArrayLineariser, Line, Lineariser, Prepared, apart
from pgm.linearisers.points import Points
from pgm.linearisers.regression import StatisticalRegression
from pgm.linearisers.rules import Cubature, GaussHermite, Unscented
from pgm.linearisers.sampled import MonteCarlo, QuasiMonteCarlo
from pgm.linearisers.taylor import TAYLOR, Taylor
from pgm.linearisers.template import FunctionTemplate

__all__ = [
    "TAYLOR",
    "ArrayLineariser",
    "BoundFunction",
    "Cubature",
    "FunctionTemplate",
    "GaussHermite",
    "Line",
    "Lineariser",
    "MonteCarlo",
    "Points",
    "Prepared",
    "QuasiMonteCarlo",
    "StatisticalRegression",
    "Taylor",
    "Unscented",
    "apart",
]
