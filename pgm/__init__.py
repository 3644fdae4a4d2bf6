"""pgm: cluster-graph inference for (dynamic) Bayesian networks."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from pgm.clustergraph import Cluster, ClusterGraph
from pgm.compile import (
    LTRIP,
    Balanced,
    Bethe,
    JoinGraph,
    JunctionTree,
    MinFill,
    NestedDissection,
    StochasticMinFill,
    WeightedMinFill,
    compile,
)
from pgm.cpds import (
    GaussianCPD,
    Kronecker,
    LinearGaussianCPD,
    NonlinearGaussianCPD,
    TableCPD,
    noise,
    shifts,
)
from pgm.errors import (
    EvidenceError,
    ExecutorError,
    FileError,
    GraphError,
    GridWarning,
    LinearisationError,
    ModelError,
    NumericalError,
    PgmError,
    PrecisionWarning,
)
from pgm.evidence import constant, records, sightings, soft
from pgm.factors import AffineGaussian, CanonicalForm, Gaussian, Table
from pgm.inference import (
    Audit,
    Calibration,
    ChainPosterior,
    Filtering,
    FixedLag,
    Flooding,
    Grid,
    GridBelief,
    GridPosterior,
    GridStatus,
    KeptPosterior,
    Kind,
    LevenbergMarquardt,
    MostProbable,
    OnlineBelief,
    OnlineFilter,
    OnlineGrid,
    OnlineGridBelief,
    Posterior,
    Residual,
    Sequential,
    Smoothing,
    StatePosterior,
    Status,
    audit,
    filter,
    infer,
    most_probable,
    query,
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

if TYPE_CHECKING:
    from pgm.comparison import Comparison, compare
    from pgm.io.networks import (
        from_pgmpy,
        read_bif,
        read_uai,
        read_uai_evidence,
        read_xmlbif,
        to_pgmpy,
        write_bif,
        write_xmlbif,
    )

__version__ = "0.1.0"


def __getattr__(name: str) -> Any:
    """Load what is slow to import, or seldom wanted, when it is first asked for."""
    if name in ("comparison", "consistency", "plot"):
        return import_module(f"pgm.{name}")
    if name in ("Comparison", "compare"):
        return getattr(import_module("pgm.comparison"), name)
    if name in __all__:
        return getattr(import_module("pgm.io.networks"), name)
    raise AttributeError(f"module 'pgm' has no attribute {name!r}")


__all__ = [
    "LTRIP",
    "AffineGaussian",
    "Audit",
    "Balanced",
    "BayesianNetwork",
    "Bethe",
    "Calibration",
    "CanonicalForm",
    "ChainPosterior",
    "Cluster",
    "ClusterGraph",
    "Comparison",
    "Cubature",
    "Discrete",
    "DynamicBayesianNetwork",
    "EvidenceError",
    "ExecutorError",
    "FileError",
    "Filtering",
    "FixedLag",
    "Flooding",
    "GaussHermite",
    "Gaussian",
    "GaussianCPD",
    "GraphError",
    "Grid",
    "GridBelief",
    "GridPosterior",
    "GridStatus",
    "GridWarning",
    "JoinGraph",
    "JunctionTree",
    "KeptPosterior",
    "Kind",
    "Kronecker",
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
    "OnlineGrid",
    "OnlineGridBelief",
    "PgmError",
    "Posterior",
    "PrecisionWarning",
    "QuasiMonteCarlo",
    "Residual",
    "Sequential",
    "Smoothing",
    "Stamped",
    "StatePosterior",
    "StatisticalRegression",
    "Status",
    "StochasticMinFill",
    "Table",
    "TableCPD",
    "Taylor",
    "Timeline",
    "Unscented",
    "Variable",
    "WeightedMinFill",
    "audit",
    "compare",
    "compile",
    "constant",
    "filter",
    "from_pgmpy",
    "infer",
    "most_probable",
    "noise",
    "query",
    "read_bif",
    "read_uai",
    "read_uai_evidence",
    "read_xmlbif",
    "records",
    "shifts",
    "sightings",
    "smooth",
    "soft",
    "stamped",
    "timeline",
    "to_pgmpy",
    "variables",
    "write_bif",
    "write_xmlbif",
]
