"""pgm: cluster-graph inference for (dynamic) Bayesian networks."""

from collections.abc import Callable
from importlib import import_module
from typing import TYPE_CHECKING, Any
from warnings import warn

from pgm.clustergraph import ClusterGraph
from pgm.compile import (
    LTRIP,
    Balanced,
    Bethe,
    Compiled,
    JoinGraph,
    JunctionTree,
    MinDegree,
    MinFill,
    NestedDissection,
    StochasticMinFill,
    WeightedMinFill,
    compile,
)
from pgm.cpds import (
    Cauchy,
    CausalIndependence,
    GaussianCPD,
    Huber,
    Kronecker,
    LinearGaussianCPD,
    MixtureCPD,
    NoisyMax,
    NoisyOr,
    NonlinearGaussianCPD,
    NonlinearGaussianFactor,
    RobustNoise,
    SampledCPD,
    StudentT,
    SwitchingCPD,
    TableCPD,
    TruncatedLeastSquares,
    noise,
    plate,
    shifts,
)
from pgm.display.notebook import hand_in as _hand_in
from pgm.errors import (
    ArrayError,
    BeliefWarning,
    ConvergenceWarning,
    EvidenceError,
    EvidenceWarning,
    ExecutorError,
    FileError,
    GraphError,
    GridWarning,
    LinearisationError,
    LinearisationWarning,
    LostWarning,
    ModelError,
    NumericalError,
    ParticleWarning,
    PgmError,
    PrecisionWarning,
)
from pgm.evidence import constant, records, sightings, soft, unknown
from pgm.factors import AffineGaussian, CanonicalForm, Gaussian, GaussianMixture, Table
from pgm.inference import (
    BeliefFamily,
    Calibration,
    CellProposal,
    Filtering,
    FixedLag,
    Flooding,
    Gaussians,
    Grid,
    GrowingMap,
    Injection,
    Kind,
    KLDSampling,
    LevenbergMarquardt,
    LikelihoodSampling,
    Loopy,
    OnlineFilter,
    Particles,
    Prepared,
    Residual,
    Sequential,
    Smoothing,
    Threshold,
    audit,
    estimate,
    filter,
    infer,
    max_marginals,
    most_probable,
    prepare,
    query,
    sensitivity,
    smooth,
)
from pgm.io import stamped, timeline
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
from pgm.networks import BayesianNetwork, DynamicBayesianNetwork, MarkovNetwork
from pgm.variables import Discrete, Variable, variables

if TYPE_CHECKING:
    from pgm import comparison, consistency, learning, maps, plot, recordings, results
    from pgm.comparison import compare, study
    from pgm.io.alignment import PoseErrors
    from pgm.io.euroc import read_euroc
    from pgm.io.kitti import read_kitti, write_kitti
    from pgm.io.networks import (
        from_pgmpy,
        from_pyagrum,
        read_bif,
        read_fg,
        read_uai,
        read_uai_evidence,
        read_uai_query,
        read_xmlbif,
        to_pgmpy,
        to_pyagrum,
        write_bif,
        write_fg,
        write_uai,
        write_uai_evidence,
        write_uai_result,
        write_xmlbif,
    )
    from pgm.io.poses import Poses
    from pgm.io.tum import read_tum, write_tum
    from pgm.learning import fit
    from pgm.recordings.drives.recording import Recording
    from pgm.viewer.view import view

__version__ = "0.1.0"

# Slow to import, or seldom wanted: loaded when first asked for.
_MODULES = (
    "comparison",
    "consistency",
    "learning",
    "maps",
    "plot",
    "recordings",
    "results",
    "viewer",
)
_LATER = {
    "pgm.comparison": ("compare", "study"),
    "pgm.io.networks": (
        "from_pgmpy",
        "from_pyagrum",
        "read_bif",
        "read_fg",
        "read_uai",
        "read_uai_evidence",
        "read_uai_query",
        "read_xmlbif",
        "to_pgmpy",
        "to_pyagrum",
        "write_bif",
        "write_fg",
        "write_uai",
        "write_uai_evidence",
        "write_uai_result",
        "write_xmlbif",
    ),
    "pgm.io.alignment": ("PoseErrors",),
    "pgm.io.euroc": ("read_euroc",),
    "pgm.io.kitti": ("read_kitti", "write_kitti"),
    "pgm.io.poses": ("Poses",),
    "pgm.io.tum": ("read_tum", "write_tum"),
    "pgm.learning": ("fit",),
    "pgm.recordings.drives.recording": ("Recording",),
    "pgm.viewer": ("view",),
}


# Results, which had their names here in the version before.
_MOVED = (
    "Associations",
    "Audit",
    "Cluster",
    "Comparison",
    "Fit",
    "FitStatus",
    "GridBelief",
    "Lost",
    "MostProbable",
    "OnlineBelief",
    "ParticleBelief",
    "Posterior",
    "Rejections",
    "Stamped",
    "Status",
    "Timeline",
)


def _pictures() -> Callable[[Any], str]:
    from pgm.plot.diagrams.notebook import svg

    return svg


def _pages() -> Callable[[Any], str]:
    from pgm.viewer import html

    return html


def _reports() -> Callable[..., Any]:
    from pgm.viewer import report

    return report


def _surveys() -> Callable[..., Any]:
    from pgm.viewer.study_report import report

    return report


# Networks and posteriors are shown by modules of layers above theirs, loaded when a notebook asks.
_hand_in(pictures=_pictures, pages=_pages, reports=_reports, surveys=_surveys)


if not TYPE_CHECKING:  # to type checkers it would say that every name exists

    def __getattr__(name: str) -> Any:
        """Load a module, or the module of a name, when it is first asked for."""
        if name in _MODULES:
            return import_module(f"pgm.{name}")
        for module, names in _LATER.items():
            if name in names:
                return getattr(import_module(module), name)
        if name in _MOVED:
            warn(f"pgm.{name} is pgm.results.{name} now", DeprecationWarning, stacklevel=2)
            return getattr(import_module("pgm.results"), name)
        from pgm.inference.old_names import old

        return old("pgm", name)


def __dir__() -> list[str]:
    """The public names, of modules that are not loaded yet too."""
    return sorted({*__all__, *(name for name in globals() if name.startswith("__"))})


__all__ = [
    "LTRIP",
    "AffineGaussian",
    "ArrayError",
    "Balanced",
    "BayesianNetwork",
    "BeliefFamily",
    "BeliefWarning",
    "Bethe",
    "Calibration",
    "CanonicalForm",
    "Cauchy",
    "CausalIndependence",
    "CellProposal",
    "ClusterGraph",
    "Compiled",
    "ConvergenceWarning",
    "Cubature",
    "Discrete",
    "DynamicBayesianNetwork",
    "EvidenceError",
    "EvidenceWarning",
    "ExecutorError",
    "FileError",
    "Filtering",
    "FixedLag",
    "Flooding",
    "GaussHermite",
    "Gaussian",
    "GaussianCPD",
    "GaussianMixture",
    "Gaussians",
    "GraphError",
    "Grid",
    "GridWarning",
    "GrowingMap",
    "Huber",
    "Injection",
    "JoinGraph",
    "JunctionTree",
    "KLDSampling",
    "Kind",
    "Kronecker",
    "LevenbergMarquardt",
    "LikelihoodSampling",
    "LinearGaussianCPD",
    "LinearisationError",
    "LinearisationWarning",
    "Lineariser",
    "Loopy",
    "LostWarning",
    "MarkovNetwork",
    "MinDegree",
    "MinFill",
    "MixtureCPD",
    "ModelError",
    "MonteCarlo",
    "NestedDissection",
    "NoisyMax",
    "NoisyOr",
    "NonlinearGaussianCPD",
    "NonlinearGaussianFactor",
    "NumericalError",
    "OnlineFilter",
    "ParticleWarning",
    "Particles",
    "PgmError",
    "PoseErrors",
    "Poses",
    "PrecisionWarning",
    "Prepared",
    "QuasiMonteCarlo",
    "Recording",
    "Residual",
    "RobustNoise",
    "SampledCPD",
    "Sequential",
    "Smoothing",
    "StatisticalRegression",
    "StochasticMinFill",
    "StudentT",
    "SwitchingCPD",
    "Table",
    "TableCPD",
    "Taylor",
    "Threshold",
    "TruncatedLeastSquares",
    "Unscented",
    "Variable",
    "WeightedMinFill",
    "audit",
    "compare",
    "comparison",
    "compile",
    "consistency",
    "constant",
    "estimate",
    "filter",
    "fit",
    "from_pgmpy",
    "from_pyagrum",
    "infer",
    "learning",
    "maps",
    "max_marginals",
    "most_probable",
    "noise",
    "plate",
    "plot",
    "prepare",
    "query",
    "read_bif",
    "read_euroc",
    "read_fg",
    "read_kitti",
    "read_tum",
    "read_uai",
    "read_uai_evidence",
    "read_uai_query",
    "read_xmlbif",
    "recordings",
    "records",
    "results",
    "sensitivity",
    "shifts",
    "sightings",
    "smooth",
    "soft",
    "stamped",
    "study",
    "timeline",
    "to_pgmpy",
    "to_pyagrum",
    "unknown",
    "variables",
    "view",
    "write_bif",
    "write_fg",
    "write_kitti",
    "write_tum",
    "write_uai",
    "write_uai_evidence",
    "write_uai_result",
    "write_xmlbif",
]
