"""A place heard from two beacons: on either side of their line, by a weak prior of three forms."""

import numpy as np

import pgm

P = pgm.Variable("p", components=("e", "n"))


def ranges(x):
    return lambda p: np.linalg.norm(p - np.array([x, 0.0]), axis=-1, keepdims=True)


HEARD = [
    pgm.NonlinearGaussianFactor(P, ranges(x), 0.04, value=value)
    for x, value in ((-2.0, 2.5), (2.0, 2.7))
]
MEAN, COV = np.array([0.0, 0.5]), 9.0 * np.eye(2)
PRIOR = pgm.GaussianCPD(P, MEAN, COV)
# The same density as a form, and as a residual.
FORM = pgm.CanonicalForm(
    P, np.eye(2) / 9.0, MEAN / 9.0, -0.5 * MEAN @ MEAN / 9.0 - np.log(2.0 * np.pi * 9.0)
)
RESIDUAL = pgm.NonlinearGaussianFactor(P, lambda p: p, COV, value=MEAN)
