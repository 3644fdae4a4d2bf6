"""How many digits float64 leaves of a tree's beliefs: how far apart its deviations lie.

Rows are divided by their noise and multiplied by the prior's deviations, so that a row's size says
by how much a CPD or reading is sharper than the prior. A QR factorisation moves each row by about
10⁻¹⁶ of the largest row's size, and a mean by as many of its own deviations. Three sizes bound it:

- the largest entry of what eliminations leave, of matrices and right sides alike;
- the numbers that residuals are differences of, over the noise, or over the prior's deviations
  where there is none;
- the reciprocal of the least singular value of relations without noise that was used; where
  another was close to it, how many relations there are is not certain, and no digits are.
"""

from __future__ import annotations

import numpy as np

from pgm.inference.gaussian.buffer import Buffer
from pgm.inference.gaussian.tree import Calibrated

# What float64 holds, but for a digit that a sum of some roundings takes.
_DIGITS = 14.6
# Digits of a mean, counted from its deviation, that answers have where nothing is said.
SAFE_DIGITS = 7.6
# Units whose squares are in range.
_RANGE = 1e-140, 1e140


def kept_digits(buffer: Buffer, done: Calibrated) -> float:
    """The digits, counted from the deviations."""
    beliefs, frame = done.beliefs, buffer.model.frame
    total = beliefs.mean.sum() + beliefs.cov.sum() + done.log_evidence.sum() + frame.mean.sum()
    scale = frame.scale
    if scale.size and not (_RANGE[0] < scale.min() and scale.max() < _RANGE[1]):
        return 0.0
    if not np.isfinite(total + buffer.lost):
        return 0.0
    return _DIGITS - float(np.log10(max(buffer.lost, buffer.coarse, 1.0)))
