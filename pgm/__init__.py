"""pgm: cluster-graph inference for (dynamic) Bayesian networks."""

from importlib import import_module
from types import ModuleType

from pgm.clustergraph import Cluster, ClusterGraph
from pgm.compile import (
    Bethe,
    JunctionTree,
    MinFill,
    NestedDissection,
    WeightedMinFill,
    compile,
)
from pgm.cpds import GaussianCPD, LinearGaussianCPD, NonlinearGaussianCPD, TableCPD, noise
from pgm.errors import (
    EvidenceError,
    GraphError,
    LinearisationError,
    ModelError,
    NumericalError,
    PgmError,
)
from pgm.evidence import constant, sightings, soft
from pgm.factors import AffineGaussian, CanonicalForm, Gaussian, Table
from pgm.inference import (
    Audit,
    Calibration,
    ChainPosterior,
    Filtering,
    Flooding,
    LevenbergMarquardt,
    MostProbable,
    OnlineBelief,
    OnlineFilter,
    Posterior,
    Residual,
    Sequential,
    Smoothing,
    Status,
    audit,
    filter,
    infer,
    most_probable,
    smooth,
)
from pgm.io import Stamped, Timeline, stamped, timeline
from pgm.linearisers import (
    Cubature,
    GaussHermite,
    Lineariser,
    MonteCarlo,
    QuasiMonteCarlo,
    StatisticalRegression,
    Taylor,
    Unscented,
)
from pgm.networks import BayesianNetwork, DynamicBayesianNetwork
from pgm.variables import Discrete, Variable, variables

__version__ = "0.1.0"


def __getattr__(name: str) -> ModuleType:
    """Load what is slow to import (matplotlib, scipy.special) when it is first asked for."""
    if name in ("consistency", "plot"):
        return import_module(f"pgm.{name}")
    raise AttributeError(f"module 'pgm' has no attribute {name!r}")


__all__ = [
    "AffineGaussian",
    "Audit",
    "BayesianNetwork",
    "Bethe",
    "Calibration",
    "CanonicalForm",
    "ChainPosterior",
    "Cluster",
    "ClusterGraph",
    "Cubature",
    "Discrete",
    "DynamicBayesianNetwork",
    "EvidenceError",
    "Filtering",
    "Flooding",
    "GaussHermite",
    "Gaussian",
    "GaussianCPD",
    "GraphError",
    "JunctionTree",
    "LevenbergMarquardt",
    "LinearGaussianCPD",
    "LinearisationError",
    "Lineariser",
    "MinFill",
    "ModelError",
    "MonteCarlo",
    "MostProbable",
    "NestedDissection",
    "NonlinearGaussianCPD",
    "NumericalError",
    "OnlineBelief",
    "OnlineFilter",
    "PgmError",
    "Posterior",
    "QuasiMonteCarlo",
    "Residual",
    "Sequential",
    "Smoothing",
    "Stamped",
    "StatisticalRegression",
    "Status",
    "Table",
    "TableCPD",
    "Taylor",
    "Timeline",
    "Unscented",
    "Variable",
    "WeightedMinFill",
    "audit",
    "compile",
    "constant",
    "filter",
    "infer",
    "most_probable",
    "noise",
    "sightings",
    "smooth",
    "soft",
    "stamped",
    "timeline",
    "variables",
]
