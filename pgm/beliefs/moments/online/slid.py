"""The belief of an online filter at the newest step of a window that slides."""

from __future__ import annotations

import numpy as np

from pgm.beliefs.moments.digits import close_points, last_places
from pgm.beliefs.moments.online.beliefs import MomentBelief, belief_of, nothing_to_iterate, refuse
from pgm.beliefs.moments.online.window import Make, Sliding
from pgm.beliefs.moments.steps.readings import Moments
from pgm.kernels.arrays import Array
from pgm.posteriors.belief_kind import FILTERED, PREDICTED
from pgm.posteriors.status import CLOSE_POINTS, FAR_APART, LAST_PLACE, Status


def slid(make: Make, step: int, behind: Sliding, log_evidence: Array) -> MomentBelief:
    """The belief at the newest step of a window: filtered, or predicted if nothing was read there.

    `behind` is the window; `make` makes the plan of some steps from their evidence. `step` is the
    number of the newest step, and `log_evidence` (*runs) that of all steps before, which is the
    belief's if nothing was read. A belief or log-evidence that is not finite is a `NumericalError`,
    but for the variances of what is not known yet, given a flat prior.
    """
    lead, window = behind.lead, behind.window
    if window is None:
        alone = behind.ahead(make, step)
        mean, cov, error = alone.ahead.mean[-1], alone.ahead.cov[-1], alone.error
        status, kind, plan, ahead = nothing_to_iterate(lead), PREDICTED, alone.plan, alone.ahead
        smoothed = None
    else:
        mean, cov, plan = window.beliefs.mean[-1], window.beliefs.cov[-1], window.plan
        ahead, smoothed = window.ahead, window.beliefs
        error = None if window.careful is None else window.careful.error
        status, kind = Status.of(window.residuals, window.converged, lead), FILTERED
        log_evidence = behind.log_evidence.reshape(lead)
    known = cov if ahead.diffuse is None else np.where(cov == np.inf, 0.0, cov)
    if not all(np.isfinite(part).all() for part in (mean, known, log_evidence)):
        refuse(step)
    careful = error is not None
    if error is not None:
        status = status._losing(error, FAR_APART)
    lost = close_points.error(plan, ahead)
    if lost is not None:
        status = status._losing(lost, CLOSE_POINTS)
    measured = status.digits is not None
    lost = last_places.error(plan, ahead, smoothed, careful=careful, measured=measured)
    if lost is not None:
        status = status._losing(lost, LAST_PLACE)
    status._warn()
    return belief_of(plan, step, Moments.of(plan, mean, cov), log_evidence, status, kind, behind)
