"""Learning: parameters of networks, by expectation-maximisation or in closed form."""

from pgm.learning.fitting import fit
from pgm.learning.values import (
    Coefficients,
    Covariance,
    DegreesOfFreedom,
    Fit,
    FitStatus,
    Offset,
    Parameter,
    Table,
)

__all__ = [
    "Coefficients",
    "Covariance",
    "DegreesOfFreedom",
    "Fit",
    "FitStatus",
    "Offset",
    "Parameter",
    "Table",
    "fit",
]
