"""The measures by which traces are judged: how far apart points are, and what counts."""

from __future__ import annotations

import math

import numpy as np

from pgm.kernels.arrays import Array

# Values show slopes so far beside a point, in standard deviations; where nobody has told these they
# are taken to be so large.
BESIDE, UNTOLD = 1e-2, 1e-2
# Slopes are compared with those beside them over steps of about these shares of a deviation: of
# all components at once, with the same sign, and with signs by turns, lest the steps cancel.
NEAR = ((1e-2, 1.0), (1e-5, -1.0))
# Differences are taken over steps of these shares of a standard deviation, and the trace's slopes
# looked at so many steps away: at two distances, lest a function that swings be taken for straight.
SCALES, SIDES = (1e-2, 1e-4, 1e-6), (1.0, -1.0, 1.6, -1.6)
# The function is asked for about so many entries of slopes in doubt; so many points, at even
# distances, have their slopes compared with differences whether they are in doubt or not.
ASKED, EVEN = 256, 16
# Slopes that are the same differ by less: shares of themselves; of the noise and of the prediction,
# when they move it. Some are alike that differ by a share of an error, and of themselves.
OF_ITSELF, OF_NOISE, OF_PREDICTION, ALIKE = 1e-3, 1e-3, 1e-9, 0.1
# Slopes are in doubt from so much on.
DOUBT = 1e-3
# The rounding of a value is some units in its last place; a step is at least so many of those of
# its component, or no difference tells anything.
ROUNDING, APART = 1e-14, 1e3
# Values that are the same differ by less: shares of a value, of the largest of a batch, and of the
# noise's deviation.
OF_VALUE, OF_LARGEST, VALUES_OF_NOISE = 1e-9, 1e-12, 1e-6


def shares(shape: tuple[int, ...]) -> Array:
    """Numbers between 0.5 and 1.5, each another, by turns of φ."""
    numbers = np.arange(1.0, math.prod(shape) + 1.0)
    found: Array = 0.5 + np.modf(0.6180339887498949 * numbers)[0].reshape(shape)
    return found
