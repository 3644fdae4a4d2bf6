"""Learning: parameters of a dynamic network, by expectation-maximisation."""

from pgm.learning.declared import Coefficients, Covariance, Offset, Parameter, Table
from pgm.learning.fitting import fit
from pgm.learning.result import Fit, FitStatus

__all__ = ["Coefficients", "Covariance", "Fit", "FitStatus", "Offset", "Parameter", "Table", "fit"]
