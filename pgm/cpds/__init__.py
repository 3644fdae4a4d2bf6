"""Conditional probability distributions."""

from pgm.cpds.base import CPD
from pgm.cpds.causal_independence import CausalIndependence
from pgm.cpds.conditional import ConditionalGaussian, Noise, noise
from pgm.cpds.derivatives import Derivatives
from pgm.cpds.gaussian import AffineCPD, GaussianCPD, LinearGaussianCPD, NonlinearGaussianCPD
from pgm.cpds.losses import Cauchy, Huber, StudentT, TruncatedLeastSquares
from pgm.cpds.mixture import MixtureCPD
from pgm.cpds.noisy_max import NoisyMax, NoisyOr
from pgm.cpds.repeated import plate
from pgm.cpds.residual import NonlinearGaussianFactor
from pgm.cpds.robust import RobustNoise
from pgm.cpds.sampled import SampledCPD
from pgm.cpds.structured import Kronecker, shifts
from pgm.cpds.switching import SwitchingCPD
from pgm.cpds.table import TableCPD

__all__ = [
    "CPD",
    "AffineCPD",
    "Cauchy",
    "CausalIndependence",
    "ConditionalGaussian",
    "Derivatives",
    "GaussianCPD",
    "Huber",
    "Kronecker",
    "LinearGaussianCPD",
    "MixtureCPD",
    "Noise",
    "NoisyMax",
    "NoisyOr",
    "NonlinearGaussianCPD",
    "NonlinearGaussianFactor",
    "RobustNoise",
    "SampledCPD",
    "StudentT",
    "SwitchingCPD",
    "TableCPD",
    "TruncatedLeastSquares",
    "noise",
    "plate",
    "shifts",
]
