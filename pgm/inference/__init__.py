"""Inference on compiled networks: message schedules, posteriors, and online filters.

A *schedule* says which messages are sent in which order, and how often nonlinear CPDs are
linearised. `infer`, `filter` and `smooth` run one on evidence and return a posterior: marginals,
joints, log-evidence and status. `query` and `most_probable` answer single questions about discrete
networks, `audit` estimates how far a Gaussian posterior is from the exact one, and an
`OnlineFilter` takes one step at a time in a robot's loop.
"""

from pgm.inference.associations import Associations
from pgm.inference.audit import Audit, audit
from pgm.inference.belief_family import BeliefFamily
from pgm.inference.belief_kind import Kind
from pgm.inference.chain.innovations import Innovations
from pgm.inference.chain.marginals import Marginals
from pgm.inference.damping import LevenbergMarquardt
from pgm.inference.discrete.maximum import MostProbable, most_probable
from pgm.inference.dynamic import filter, smooth
from pgm.inference.engine import infer
from pgm.inference.figures import Threshold
from pgm.inference.grid.belief import GridBelief
from pgm.inference.grid.family import Grid
from pgm.inference.grid.figures import GridFigures
from pgm.inference.lost import Lost
from pgm.inference.online.filter import OnlineFilter
from pgm.inference.online_belief import OnlineBelief
from pgm.inference.particles.belief import ParticleBelief
from pgm.inference.particles.cell_proposal import CellProposal
from pgm.inference.particles.family import Particles
from pgm.inference.particles.figures import ParticleFigures
from pgm.inference.particles.number import KLDSampling, LikelihoodSampling
from pgm.inference.particles.settings import Injection
from pgm.inference.posterior import Posterior
from pgm.inference.query import query
from pgm.inference.rejections import Rejections
from pgm.inference.schedule import (
    Calibration,
    Filtering,
    FixedLag,
    Flooding,
    Residual,
    Schedule,
    Sequential,
    Smoothing,
)
from pgm.inference.status import Status

__all__ = [
    "Associations",
    "Audit",
    "BeliefFamily",
    "Calibration",
    "CellProposal",
    "Filtering",
    "FixedLag",
    "Flooding",
    "Grid",
    "GridBelief",
    "GridFigures",
    "Injection",
    "Innovations",
    "KLDSampling",
    "Kind",
    "LevenbergMarquardt",
    "LikelihoodSampling",
    "Lost",
    "Marginals",
    "MostProbable",
    "OnlineBelief",
    "OnlineFilter",
    "ParticleBelief",
    "ParticleFigures",
    "Particles",
    "Posterior",
    "Rejections",
    "Residual",
    "Schedule",
    "Sequential",
    "Smoothing",
    "Status",
    "Threshold",
    "audit",
    "filter",
    "infer",
    "most_probable",
    "query",
    "smooth",
]
