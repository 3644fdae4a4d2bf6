"""The forward sweep of a single run, one small product after another.

It leaves what the general sweep leaves. A step that is out of the ordinary goes the general way;
where a number is not finite, or a covariance indefinite, the whole sweep does, and refuses it.
"""

from __future__ import annotations

import numpy as np

from pgm.errors import PgmError
from pgm.inference.chain.forward import Forward, put, start
from pgm.inference.chain.plan import ChainPlan
from pgm.inference.chain.single_motion import Motion
from pgm.inference.chain.single_rows import MoveRows
from pgm.inference.chain.single_sight import Sight
from pgm.kernels import roots
from pgm.kernels.arrays import Mask


def run(plan: ChainPlan) -> tuple[Forward, Mask] | None:
    """Sweep forward, each CPD linearised once; whether a run has nothing to iterate, (1,).

    None where the general sweep has to find out what is wrong.
    """
    moves, sight = [MoveRows(link) for link in plan.transition], Sight(plan)
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):  # see above
        try:
            out = _sweep(plan, Motion(plan.layout, moves), sight)
        except PgmError:
            out = None
        lost = out is None or not _proper(plan, out)
    for prepared in (*moves, *sight.reads):
        if lost or not prepared.family.erroneous:
            prepared.family.forget_errors()
    return None if out is None or lost else (out, np.array([sight.linear]))


def _sweep(plan: ChainPlan, motion: Motion[int], sight: Sight) -> Forward | None:
    out = Forward.empty(plan)
    predicted_mean, predicted_cov = out.predicted_mean[:, 0], out.predicted_cov[:, 0]
    kept_mean, kept_cov, log_density = out.mean[:, 0], out.cov[:, 0], out.log_density[:, 0]
    states = plan.layout.state_places
    first, spread = start(plan, linearise=True)
    predicted_mean[0, states] = first[0]
    put(out.predicted_cov[0], states, spread)
    mean, cov = predicted_mean[0], predicted_cov[0]
    for step in range(plan.steps + 1):
        if step:
            mean, cov = motion.predict(step - 1, mean, cov)
            predicted_mean[step], predicted_cov[step] = mean, cov
        found = sight.update(step, mean, cov)
        if found is None:
            return None
        mean, cov, log_density[step] = found
        kept_mean[step], kept_cov[step] = mean, cov
    return out


def _proper(plan: ChainPlan, out: Forward) -> bool:
    """Whether all numbers are finite, and no lineariser has made a prediction indefinite."""
    total = out.mean.sum() + out.cov.sum() + out.log_density.sum()
    if not np.isfinite(total):
        return False
    rough = any(link.family.approximate for link in plan.transition)
    return not rough or roots.is_proper(roots.root(out.predicted_cov[1:]))
