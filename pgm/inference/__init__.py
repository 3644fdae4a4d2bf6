"""Inference on compiled networks: message schedules, posteriors, and online filters.

A *schedule* says which messages are sent in which order, and how often nonlinear CPDs are
linearised. `infer`, `filter` and `smooth` run one on evidence and return a posterior: marginals,
joints, log-evidence and status; `prepare` has it run many times, with other values. `query`,
`most_probable`, `max_marginals` and `sensitivity` answer single questions about discrete networks,
`audit` estimates how far a Gaussian posterior is from the exact one, and an `OnlineFilter` takes
one step at a time in a robot's loop, and a `GrowingMap` takes what a network without time grows
by.
"""

from typing import TYPE_CHECKING, Any

from pgm.beliefs.grid.belief import GridBelief
from pgm.beliefs.grid.family import Grid
from pgm.beliefs.grid.figures import GridFigures
from pgm.beliefs.hypotheses.family import Gaussians
from pgm.beliefs.moments.outcomes.marginals import Marginals
from pgm.beliefs.own.family import BeliefFamily
from pgm.beliefs.particles.cell_proposal import CellProposal
from pgm.beliefs.particles.family import Particles
from pgm.beliefs.particles.figures import ParticleFigures
from pgm.beliefs.particles.number import KLDSampling, LikelihoodSampling
from pgm.beliefs.particles.settings import Injection
from pgm.beliefs.points.particle_belief import ParticleBelief
from pgm.beliefs.points.point_mixture import PointMixture
from pgm.inference.audit import Audit, audit
from pgm.inference.dynamic import filter, smooth
from pgm.inference.engine import infer
from pgm.inference.estimating import estimate
from pgm.inference.growing import Association, CliqueTree, GrowingMap, Growth
from pgm.inference.online import OnlineFilter
from pgm.inference.prepared import Prepared, prepare
from pgm.inference.query import query
from pgm.inference.query.assignments import MostProbable
from pgm.inference.query.max_marginals import MaxMarginals, max_marginals
from pgm.inference.query.most_probable import most_probable
from pgm.inference.query.sensitivities import SensitiveEntry, Sensitivities, Sensitivity
from pgm.inference.query.sensitivity import sensitivity
from pgm.posteriors.associations import Associations
from pgm.posteriors.belief_kind import Kind
from pgm.posteriors.figures import Threshold
from pgm.posteriors.innovations import Innovations
from pgm.posteriors.lost import Lost
from pgm.posteriors.online_belief import OnlineBelief
from pgm.posteriors.posterior import Posterior
from pgm.posteriors.predictions import Predictions
from pgm.posteriors.rejections import Rejections
from pgm.posteriors.status import Status
from pgm.posteriors.step_innovations import StepInnovations
from pgm.posteriors.verdict import Verdict
from pgm.schedules.damping import LevenbergMarquardt
from pgm.schedules.schedule import (
    Calibration,
    Filtering,
    FixedLag,
    Flooding,
    Loopy,
    Residual,
    Schedule,
    Sequential,
    Smoothing,
)

if not TYPE_CHECKING:  # to type checkers it would say that every name exists

    def __getattr__(name: str) -> Any:
        """A class by its name of the version before, with a note."""
        from pgm.inference.old_names import old

        return old("pgm.inference", name)


__all__ = [
    "Association",
    "Associations",
    "Audit",
    "BeliefFamily",
    "Calibration",
    "CellProposal",
    "CliqueTree",
    "Filtering",
    "FixedLag",
    "Flooding",
    "Gaussians",
    "Grid",
    "GridBelief",
    "GridFigures",
    "GrowingMap",
    "Growth",
    "Injection",
    "Innovations",
    "KLDSampling",
    "Kind",
    "LevenbergMarquardt",
    "LikelihoodSampling",
    "Loopy",
    "Lost",
    "Marginals",
    "MaxMarginals",
    "MostProbable",
    "OnlineBelief",
    "OnlineFilter",
    "ParticleBelief",
    "ParticleFigures",
    "Particles",
    "PointMixture",
    "Posterior",
    "Predictions",
    "Prepared",
    "Rejections",
    "Residual",
    "Schedule",
    "SensitiveEntry",
    "Sensitivities",
    "Sensitivity",
    "Sequential",
    "Smoothing",
    "Status",
    "StepInnovations",
    "Threshold",
    "Verdict",
    "audit",
    "estimate",
    "filter",
    "infer",
    "max_marginals",
    "most_probable",
    "prepare",
    "query",
    "sensitivity",
    "smooth",
]
