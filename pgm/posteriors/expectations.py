"""Expectations given all measurements, as learning takes them: counts of tables, family beliefs.

A *family* is a CPD with its hidden parents and its child. A transition has a row for each step, a
sensor for each of its measurements, and a prior has one row.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from pgm.cpds import CPD, SwitchingCPD
from pgm.cpds.switching import Case
from pgm.kernels.arrays import Array, Integers, Mask
from pgm.linearisation.family import Family

PRIOR, TRANSITION, OBSERVATION = ROLES = "prior", "transition", "observation"


class Learnable(NamedTuple):
    """A CPD of which something is learnt, in its role; of a `SwitchingCPD` that of one `case`.

    A prior and a transition may be one object.
    """

    cpd: CPD
    role: str
    case: Case | None = None

    @property
    def own(self) -> CPD:
        """The CPD itself, or that of the case."""
        if self.case is None:
            return self.cpd
        assert isinstance(self.cpd, SwitchingCPD)
        return self.cpd.cases[self.case]


class RobustWeights(NamedTuple):
    """The weights of a sensor's measurements with robust noise, and where they were found.

    `weight` w (rows, runs); the `square` s (rows, runs) of the residual at which it was found; and
    the number of `components` (rows or 1, runs or 1) that were measured. `information` is the share
    of R⁻¹ with which all of them count in the covariances of beliefs; None where each counts there
    with its weight.
    """

    weight: Array
    square: Array
    components: Integers
    information: float | None = None


class FamilyBelief(NamedTuple):
    """The joint belief (rows, runs, n) of a CPD's hidden parents and, if hidden, its child.

    The n components are the hidden parents', then a hidden child's; the child of a sensor is not
    hidden. `family` is the CPD at its rows, `mean` is (rows, runs, n), `cov` (rows, runs, n, n).
    `values` (rows, runs or 1, d) are the measurements of a sensor, None for another CPD; `taken`, a
    mask of the same shape, marks the components that were measured, None if all were.
    `weights` (rows, runs) are the probabilities that the CPD holds there: of a mixture's Gaussians,
    which are runs, or of the states that choose it. None are ones. `robust` are the
    weights of measurements with robust noise, each of which counts with the covariance R / w; None
    for Gaussian noise. `cut` (rows, runs, d, d) is what a gate has cut off from the expected second
    moments of residuals, by the innovations that it rejects; None without a gate.
    """

    family: Family
    mean: Array
    cov: Array
    values: Array | None
    taken: Mask | None
    weights: Array | None = None
    robust: RobustWeights | None = None
    cut: Array | None = None


class Expectations(NamedTuple):
    """Expected counts of the states of tables' families, and the beliefs of other families."""

    counts: Mapping[Learnable, Array]
    families: Mapping[Learnable, FamilyBelief]
