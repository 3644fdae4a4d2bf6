"""pgm: cluster-graph inference for (dynamic) Bayesian networks."""

from pgm.cpds import GaussianCPD, LinearGaussianCPD, NonlinearGaussianCPD, noise
from pgm.errors import (
    EvidenceError,
    GraphError,
    LinearisationError,
    ModelError,
    NumericalError,
    PgmError,
)
from pgm.evidence import constant, sightings
from pgm.factors import AffineGaussian, CanonicalForm, Gaussian
from pgm.linearisers import Cubature, MonteCarlo, StatisticalRegression, Taylor, Unscented
from pgm.networks import DynamicBayesianNetwork
from pgm.variables import Variable, variables

__version__ = "0.1.0"
