"""The digits of a chain's means that their own last place in float64 leaves.

Half a last place u(m) is the error of a mean that was found in twice the digits and rounded once.
A pass in float64 rounds at each step, and so do nonlinear functions in any pass: shares u(m) / σ
are carried along the chain as in `close_points`,

    ν_t = ρ_t ν_{t−1} + (u(m_t) / σ_t)²,

and a smoother adds the last place of its own means. As long as no u(m) / σ exceeds 10⁻⁶ a pass in
float64 has six digits, and nothing is told.
"""

from __future__ import annotations

import numpy as np

from pgm.inference.chain.backward import Beliefs
from pgm.inference.chain.close_points import carried
from pgm.inference.chain.forward import Filtered, Forward
from pgm.inference.chain.plan import ChainPlan
from pgm.inference.chain.readings import Moments
from pgm.inference.status import ENOUGH_DIGITS
from pgm.kernels import last_place
from pgm.kernels.arrays import Array, deviation, variances

# The last place of a mean, in standard deviations, from which on it is told.
TOLD = 10.0**-ENOUGH_DIGITS
_NEAR = (TOLD / float(np.finfo(np.float64).eps)) ** 2


def error(
    plan: ChainPlan,
    swept: Forward | Filtered,
    smoothed: Beliefs | None,
    *,
    careful: bool,
    measured: bool,
) -> Array | None:
    """The standard deviations by which last places may move means, (runs,): the largest of a chain.

    Parameters
    ----------
    plan : ChainPlan
    swept : Forward or Filtered
        The forward pass, of which another one is made where not all of it is known.
    smoothed : Beliefs or None
        The means and covariances of a smoother.
    careful : bool
        Whether all of it was found in twice the digits, and rounded at the end.
    measured : bool
        Whether digits are told anyhow; else the answer is None where last places leave six.
    """
    every = [] if smoothed is None else [(smoothed.mean, smoothed.cov)]
    if measured or swept.far:
        every.append((swept.mean, swept.cov))
    with np.errstate(all="ignore"):
        if not measured:
            every = [each for each in every if _may_count(*each)]
        if not every:
            return None
        most = np.max([of_beliefs(*each).max(axis=0, initial=0.0) for each in every], axis=0)
        if careful and plan.exact:
            return np.asarray(0.5 * most)
        if not measured and not (most > TOLD).any():
            return None
        ahead = swept.whole if isinstance(swept, Filtered) else swept
        past = carried(ahead, of_beliefs(ahead.mean, ahead.cov) ** 2)
        return past if smoothed is None else np.hypot(past, most)


def of_step(moments: Moments) -> Array | float:
    """The largest u(m) / σ after a step of an online filter, (runs,); 0 where none exceeds 10⁻⁶."""
    mean, cov = moments.mean, moments.cov
    variance = np.einsum("ii...->i...", cov)
    if not (mean * mean > _NEAR * variance).any():
        return 0.0
    found = of_beliefs(*moments.by_run)
    return found if (found > TOLD).any() else 0.0


def _may_count(mean: Array, cov: Array) -> bool:
    return last_place.may_count(mean, variances(cov), TOLD)


def of_beliefs(mean: Array, cov: Array) -> Array:
    """The largest u(m) / σ of the components of beliefs (..., n) and (..., n, n), as (...)."""
    return last_place.in_deviations(mean, deviation(cov))
