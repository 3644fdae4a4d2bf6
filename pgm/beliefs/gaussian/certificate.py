"""An estimate of the decimal digits that float64 leaves of a tree's beliefs.

A CPD is kept as *rows* A ξ − r, which are divided by the standard deviations of its noise. The
variables ξ are the coordinates of a *frame*: distances from the prior's means, in standard
deviations of the prior. So an entry of A of size a means that the CPD, or measurement, is a times
as sharp as the prior. Let a be the largest entry of all rows, and ε ≈ 10⁻¹⁶ the rounding of
float64. Let κ be the largest ratio of a component's deviation to what it would be if all others
were known: one over the norm of its column in A. These errors are estimated:

- Means: a factorisation is wrong by about ε in units of each column's norm (Higham, Accuracy and
  Stability of Numerical Algorithms, 2002, Theorem 19.4). This error shifts a mean by about ε c of
  its own deviations, if c is the largest distance of a mean from the frame's, in units of one over
  the norm of its column; and by about ε κ times the largest residual of a row.
- Covariances: the same error changes them by about ε κ of themselves. On the way down the tree a
  variance is a sum that may be smaller than its summands, which magnifies their errors by as much.
- On graphs with loops, and where relations hold without noise, cruder bounds are taken: ε a c for
  means, with c in deviations of the prior, and ε a² for covariances.
- Relations without noise are solved for some of their variables, which are then replaced in the
  rows. The entries of the new rows count as entries a, and so do the reciprocals of the numbers
  divided by. Where it is not certain how many relations are independent, no digit is correct.
- Residuals: the right sides r are small differences of larger numbers, and are wrong by the
  rounding of these, in standard deviations of the noise.
- Linearised values: their rounding, where it is large, shifts means too (`linearised_rounding`).
"""

from __future__ import annotations

import numpy as np

from pgm.beliefs.gaussian.beliefs import Calibrated
from pgm.beliefs.gaussian.linearised_rounding import shift
from pgm.beliefs.gaussian.model import Model
from pgm.posteriors.status import CLOSE_POINTS, FAR_APART

# Decimal digits that float64 holds; a sum of many roundings takes one of them.
_DIGITS, _OF_SUMS = 15.6, 14.6
# Digits, counted from deviations, from which on they need not be told: by the crude bounds,
# and by the finer ones.
_SAFE_DIGITS, _MOST_DIGITS = 6.6, 9.0
# Units whose squares are in range.
_RANGE = 1e-140, 1e140


def kept_digits(model: Model, done: Calibrated) -> float:
    """The decimal digits that a solution in float64 keeps, for the worst run.

    Means have k digits if their errors are about 10⁻ᵏ of their standard deviations, covariances if
    their relative errors are about 10⁻ᵏ; the smaller of the two numbers is returned. It is zero if
    some number is not finite, or if the square of a variable's unit is out of float64's range.
    """
    frame, beliefs, sizes = model.frame, done.beliefs, done.sizes
    assert sizes is not None
    total = beliefs.cov.sum() + done.log_evidence.sum() + frame.mean.sum()
    scale = frame.scale
    if scale.size and not (_RANGE[0] < scale.min() and scale.max() < _RANGE[1]):
        return 0.0
    far = np.abs(beliefs.mean).max(initial=1.0)
    if not np.isfinite(total + far + sizes.largest + sizes.coarse + sizes.magnified):
        return 0.0
    if sizes.information is None:
        spread, moved = max(sizes.largest, 1.0) ** 2, sizes.largest * float(far)
    else:
        mean, variance = beliefs.in_frame()
        alone = np.sqrt(sizes.information)
        sharp = float((alone * np.sqrt(variance)).max(initial=1.0))
        spread = max(sharp, sizes.magnified)
        moved = float((alone[..., None] * np.abs(mean)).max(initial=sharp * sizes.residual))
    moved = max(moved, sizes.coarse, shift(model), 1.0)
    return float(min(_OF_SUMS - np.log10(moved), _DIGITS - np.log10(max(spread, 1.0))))


def are_few(digits: float, done: Calibrated) -> bool:
    """Whether a solution has so few digits that they are told, or decimals worth their time."""
    assert done.sizes is not None
    return digits < (_SAFE_DIGITS if done.sizes.information is None else _MOST_DIGITS)


def cause(model: Model) -> str:
    """A text for the warning that digits are few: it names the cause, and what helps.

    The cause is that sigma points lie too close together, if their rounding alone takes too many
    digits; else it is that standard deviations of the model are too far apart.
    """
    few = _OF_SUMS - np.log10(max(shift(model), 1.0)) < _SAFE_DIGITS
    return CLOSE_POINTS if few else FAR_APART
