"""Results and statuses, which calls return: for annotations and ``isinstance``.

Those of all families of beliefs are of one class: ``posterior.log_evidence_kind`` tells which is
of a `Grid` or of `Particles`, and the figures that these have are attributes of their `Status`.

================= ==================================== ========================================
name              what it is                           what returns it
================= ==================================== ========================================
`Posterior`       beliefs, log-evidence, and more      `pgm.filter`, `pgm.smooth`, `pgm.infer`
`Status`          iterations, convergence, digits      ``posterior.status``
`GridFigures`     what a grid's status has besides     `Status`, as attributes and ``numbers``
`ParticleFigures` what that of particles has besides   `Status`, as attributes and ``numbers``
`GridBelief`      probabilities of cells               ``posterior[x]``, of a `Grid`
`ParticleBelief`  weighted draws                       ``posterior[x]``, of `Particles`
`PointMixture`    a measurement, of either of these    ``posterior.predicted[z]``, ``left_out[z]``
`Innovations`     measurements less predictions        ``posterior.innovations[z]``
`Predictions`     beliefs of readings to be taken      ``belief.predicted``, in a loop
`StepInnovations` those of a step in a robot's loop    ``belief.innovations[z]``
`Rejections`      decisions of a sensor's gate         ``posterior.rejected[z]``
`Associations`    probabilities of what was sighted    ``posterior.associations[z]``
`Lost`            steps of beliefs probably wrong      ``posterior.lost``
`OnlineBelief`    the belief at one step of a loop     `OnlineFilter`'s ``predict``, ``update``
`Association`     the landmark that one was taken for  ``grown.associations[z]``
`Growth`          how large a growing map is           ``grown.status``
`CliqueTree`      a map's cliques, their messages      ``grown.cliques``
`MostProbable`    the likeliest assignment             `pgm.most_probable`
`Sensitivities`   what a probability depends on        `pgm.sensitivity`
`Sensitivity`     how it depends on a table's entries  ``found[x]`` of `Sensitivities`
`SensitiveEntry`  an entry on which it depends         ``found.ranked()``
`MaxMarginals`    the best assignment with each state  `pgm.max_marginals`
`Audit`           a smoother against the exact answer  `pgm.audit`
`Verdict`         whether it can be vouched for        ``posterior.verdict``, of `pgm.estimate`
`Comparison`      linearisers side by side             `pgm.compare`
`Row`             one lineariser under one schedule    ``comparison["Taylor", "filter"]``
`Judgement`       its KL from one oracle, and errors   ``row.by_oracle["Grid"]``
`Study`           methods over many drawn runs         `pgm.study`
`StudyRow`        one method's beliefs of one state    ``study["EKF"]``
`Statistic`       its NEES, RMSE, ..., with errors     ``study["EKF"].nees``
`Fit`             a model, with what was learnt        `pgm.fit`
`FitStatus`       the course of learning               ``pgm.fit(...).status``
`Sample`          states and measurements drawn        ``model.sample(...)``
`Timeline`        a log laid on steps, as evidence     `pgm.timeline`
`ControlReport`   what became of a control's rows      ``timeline.controls[u]``
`ReadingReport`   what became of a sensor's rows       ``timeline.readings[z]``
`Stamped`         rows of a log, with their stamps     `pgm.stamped`
`Cluster`         variables of a graph, and their CPDs ``graph.clusters[k]``
`Compilation`     what machine code takes, or why not  ``graph.compilation``
`Derivatives`     how a CPD's derivatives are found    ``cpd.derivatives``
================= ==================================== ========================================
"""

from typing import TYPE_CHECKING, Any

from pgm.clustergraph import Cluster
from pgm.compile import Compilation
from pgm.cpds import Derivatives
from pgm.inference import (
    Association,
    Associations,
    Audit,
    CliqueTree,
    GridBelief,
    GridFigures,
    Growth,
    Innovations,
    Lost,
    MaxMarginals,
    MostProbable,
    OnlineBelief,
    ParticleBelief,
    ParticleFigures,
    PointMixture,
    Posterior,
    Predictions,
    Rejections,
    SensitiveEntry,
    Sensitivities,
    Sensitivity,
    Status,
    StepInnovations,
    Verdict,
)
from pgm.io import ControlReport, ReadingReport, Stamped, Timeline
from pgm.networks import Sample

if TYPE_CHECKING:
    from pgm.comparison import Comparison, Judgement, Row, Statistic, Study, StudyRow
    from pgm.learning import Fit, FitStatus
else:  # loaded when first asked for, as they load SciPy

    def __getattr__(name: str) -> Any:
        """Load the module of a name that is seldom wanted."""
        if name in ("Comparison", "Judgement", "Row", "Statistic", "Study", "StudyRow"):
            from pgm import comparison

            return getattr(comparison, name)
        if name in ("Fit", "FitStatus"):
            from pgm import learning

            return getattr(learning, name)
        raise AttributeError(f"module 'pgm.results' has no attribute {name!r}")


def __dir__() -> list[str]:
    """The names of results, those not loaded yet too."""
    return sorted({*__all__, *(name for name in globals() if name.startswith("__"))})


__all__ = [
    "Association",
    "Associations",
    "Audit",
    "CliqueTree",
    "Cluster",
    "Comparison",
    "Compilation",
    "ControlReport",
    "Derivatives",
    "Fit",
    "FitStatus",
    "GridBelief",
    "GridFigures",
    "Growth",
    "Innovations",
    "Judgement",
    "Lost",
    "MaxMarginals",
    "MostProbable",
    "OnlineBelief",
    "ParticleBelief",
    "ParticleFigures",
    "PointMixture",
    "Posterior",
    "Predictions",
    "ReadingReport",
    "Rejections",
    "Row",
    "Sample",
    "SensitiveEntry",
    "Sensitivities",
    "Sensitivity",
    "Stamped",
    "Statistic",
    "Status",
    "StepInnovations",
    "Study",
    "StudyRow",
    "Timeline",
    "Verdict",
]
