"""An estimate of the decimal digits that float64 leaves of a tree's beliefs.

A CPD is kept as *rows* A ξ − r, which are divided by the standard deviations of its noise. The
variables ξ are the coordinates of a *frame*: distances from the prior's means, in standard
deviations of the prior. So an entry of A of size a means that the CPD, or measurement, is a times
as sharp as the prior. Let a be the largest entry of all rows, and ε ≈ 10⁻¹⁶ the rounding of
float64. These errors are estimated:

- Means: a factorisation is wrong by about ε a in each row. This error shifts a mean by about ε a c
  of its own standard deviations, if c is its distance from the frame's mean in standard deviations
  of the prior.
- Covariances: one that is pushed down the tree is wrong by about ε times the prior's covariance. As
  this may be a² times as large as the covariance itself, the relative error is up to ε a².
- Relations without noise are solved for some of their variables, which are then replaced in the
  rows. The entries of the new rows count as entries a, and so do the reciprocals of the numbers
  divided by. Where it is not certain how many relations are independent, no digit is correct.
- Residuals: the right sides r are small differences of larger numbers, and are wrong by the
  rounding of these, in standard deviations of the noise.
- Linearised values: their rounding, where it is large, shifts means too (`linearised_rounding`).
"""

from __future__ import annotations

import numpy as np

from pgm.beliefs.gaussian.beliefs import Beliefs
from pgm.beliefs.gaussian.linearised_rounding import shift
from pgm.beliefs.gaussian.model import Model
from pgm.beliefs.gaussian.row_buffer import Buffer
from pgm.kernels.arrays import Array
from pgm.posteriors.status import CLOSE_POINTS, FAR_APART

# Decimal digits that float64 holds; a sum of many roundings takes one of them.
_DIGITS, _OF_SUMS = 15.6, 14.6
# Digits, counted from standard deviations, from which on an answer needs no warning.
SAFE_DIGITS = 6.6
# Units whose squares are in range.
_RANGE = 1e-140, 1e140


def kept_digits(buffer: Buffer, beliefs: Beliefs, log_evidence: Array) -> float:
    """The decimal digits that sending all messages in float64 keeps, for the worst run.

    Means have k digits if their errors are about 10⁻ᵏ of their standard deviations, covariances if
    their relative errors are about 10⁻ᵏ; the smaller of the two numbers is returned. It is zero if
    some number is not finite, or if the square of a variable's unit is out of float64's range.
    `buffer` has the rows from which `beliefs` and `log_evidence` were computed.
    """
    frame = buffer.model.frame
    total = beliefs.cov.sum() + log_evidence.sum() + frame.mean.sum()
    scale = frame.scale
    if scale.size and not (_RANGE[0] < scale.min() and scale.max() < _RANGE[1]):
        return 0.0
    far = float(np.abs(beliefs.mean).max(initial=1.0))
    if not np.isfinite(total + far + buffer.largest + buffer.coarse):
        return 0.0
    moved = max(buffer.largest * far, buffer.coarse, shift(buffer.model), 1.0)
    spread = max(buffer.largest, 1.0) ** 2
    return float(min(_OF_SUMS - np.log10(moved), _DIGITS - np.log10(spread)))


def cause(model: Model) -> str:
    """A text for the warning that digits are few: it names the cause, and what helps.

    The cause is that sigma points lie too close together, if their rounding alone takes too many
    digits; else it is that standard deviations of the model are too far apart.
    """
    few = _OF_SUMS - np.log10(max(shift(model), 1.0)) < SAFE_DIGITS
    return CLOSE_POINTS if few else FAR_APART
