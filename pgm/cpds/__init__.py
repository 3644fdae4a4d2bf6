"""Conditional probability distributions."""

from pgm.cpds.base import CPD
from pgm.cpds.linear import AffineCPD, GaussianCPD, LinearGaussianCPD
from pgm.cpds.noise import Noise, noise
from pgm.cpds.nonlinear import NonlinearGaussianCPD

__all__ = [
    "CPD",
    "AffineCPD",
    "GaussianCPD",
    "LinearGaussianCPD",
    "Noise",
    "NonlinearGaussianCPD",
    "noise",
]
