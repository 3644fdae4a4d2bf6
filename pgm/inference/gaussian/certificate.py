"""The digits that float64 leaves of a tree's beliefs, by how far apart its deviations lie.

Rows are divided by their noise and multiplied by the prior's deviations: the size a of their
entries is by how much a CPD or measurement is sharper than the prior. A factorisation moves each
row by some 10⁻¹⁶ a, and a mean by as many of its deviations, times its distance from the prior's
mean in deviations of the prior. A covariance pushed down the tree keeps what is small to 10⁻¹⁶ of
the prior's, 10⁻¹⁶ a² of itself. What relations without noise put into rows counts as they do, and
the reciprocals of what they are divided by; where it is not certain how many of them are
independent, no digits are. The rounding of linearised values, where it is large, shifts them too.
"""

from __future__ import annotations

import numpy as np

from pgm.inference.gaussian.beliefs import Beliefs
from pgm.inference.gaussian.linearised_rounding import shift
from pgm.inference.gaussian.model import Model
from pgm.inference.gaussian.row_buffer import Buffer
from pgm.inference.status import CLOSE_POINTS, FAR_APART
from pgm.kernels.arrays import Array

# What float64 holds; a sum of many roundings takes a digit of it.
_DIGITS, _OF_SUMS = 15.6, 14.6
# Digits, counted from the deviations, that answers have where nothing is said.
SAFE_DIGITS = 6.6
# Units whose squares are in range.
_RANGE = 1e-140, 1e140


def kept_digits(buffer: Buffer, beliefs: Beliefs, log_evidence: Array) -> float:
    """The digits, counted from the deviations, that passes in float64 keep."""
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
    """Why digits are few: what the warning says of it."""
    few = _OF_SUMS - np.log10(max(shift(model), 1.0)) < SAFE_DIGITS
    return CLOSE_POINTS if few else FAR_APART
