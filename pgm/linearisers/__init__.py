"""Linearisers: what turns a nonlinear CPD into an affine Gaussian one at a belief."""

from pgm.linearisers.function import (
    Affine,
    ArrayLineariser,
    BoundFunction,
    FunctionTemplate,
    Lineariser,
)
from pgm.linearisers.regression import Points, StatisticalRegression
from pgm.linearisers.rules import Cubature, GaussHermite, Unscented
from pgm.linearisers.sampled import MonteCarlo, QuasiMonteCarlo
from pgm.linearisers.taylor import TAYLOR, Taylor

__all__ = [
    "TAYLOR",
    "Affine",
    "ArrayLineariser",
    "BoundFunction",
    "Cubature",
    "FunctionTemplate",
    "GaussHermite",
    "Lineariser",
    "MonteCarlo",
    "Points",
    "QuasiMonteCarlo",
    "StatisticalRegression",
    "Taylor",
    "Unscented",
]
