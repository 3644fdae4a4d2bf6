"""The judgement of one oracle on a row's beliefs: their KL, its error, and what that is worth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pgm import consistency
from pgm.comparison.reference import Reference
from pgm.display import Listing, Shown, Summary, number
from pgm.factors import Gaussian
from pgm.kernels import sampled
from pgm.kernels.angles import difference
from pgm.kernels.arrays import Array, Mask
from pgm.kernels.sampled import Spread, Terms

# Of a normal number, the standard errors within which 95 % of its estimates are.
BAND = 1.96


@dataclass(frozen=True, eq=False, repr=False)
class Judgement(Shown):
    """How far one oracle has a row's beliefs from its own, and how well it knows.

    Attributes
    ----------
    kl_by_step : ndarray
        (T+1,), in nats, the mean over runs; NaN where there is none. Of an oracle made of draws its
        bias is subtracted, so that the KL of a right belief may be just below zero.
    error_by_step : ndarray
        (T+1,): the standard errors of `kl_by_step`, as the oracle's draws leave it: zero of an
        oracle without draws, NaN where it tells none, as an estimate, whose verdict has a bound.
    error : float
        The standard error of `kl`. Errors of two steps depend on each other, which it counts in.
    weak : str
        Why the oracle is too weak for this row, in words; empty where it is not.

    Examples
    --------
    >>> from pgm.examples import squares, z
    >>> iterated = pgm.smooth(squares, {z: [[9.0]]}, iterations=20)
    >>> audit = pgm.audit(iterated, samples=500, rng=0)
    >>> rows = {"once": pgm.smooth(squares, {z: [[9.0]]}), "iterated": iterated}
    >>> found = pgm.compare(squares, {z: [[9.0]]}, rows=rows, oracle=audit)
    >>> judgement = found["once"].by_oracle["Audit"]
    >>> judgement.kl > 10 * judgement.error, judgement.weak
    (True, '')
    """

    kl_by_step: Array
    error_by_step: Array
    error: float = np.nan
    weak: str = ""

    def __post_init__(self) -> None:
        self.kl_by_step.flags.writeable = self.error_by_step.flags.writeable = False

    @classmethod
    def none(cls, steps: int) -> Judgement:
        """The judgement on `steps` beliefs that nobody judges."""
        return cls(np.full(steps, np.nan), np.full(steps, np.nan))

    @property
    def kl(self) -> float:
        """The mean over steps of `kl_by_step`, in nats."""
        return mean_of_known(self.kl_by_step)

    @property
    def kl_most(self) -> float:
        """The largest of `kl_by_step`."""
        step = self.kl_step
        return np.nan if step is None else float(self.kl_by_step[step])

    @property
    def kl_step(self) -> int | None:
        """The step where the KL is largest; None without any."""
        known = ~np.isnan(self.kl_by_step)
        return int(np.nanargmax(self.kl_by_step)) if known.any() else None

    @property
    def _title(self) -> str:
        return f"Judgement({number(self.kl)} ± {number(self.error)} nats)"

    def _summary(self) -> Summary:
        rows = [("most", number(self.kl_most)), *([("too weak", self.weak)] if self.weak else [])]
        return Summary(self._title, [Listing(("", ""), rows)])


class Parts(NamedTuple):
    """The parts that groups of an oracle's draws have in the error of a mean over steps and runs.

    first, second: (units, G) and (units, G, G), as of `Terms`; units are runs, each with draws of
        its own, or one if all runs share the oracle.
    """

    first: Array
    second: Array

    def error(self, factor: float) -> float:
        """The standard error, for Student's t multiplied by a factor."""
        slope = (self.first**2).sum()
        curve = sampled.curvature(np.moveaxis(self.second, 0, -1)).sum()
        return factor * float(np.sqrt(sampled.variance(slope, curve)))

    def less(self, other: Parts) -> Parts:
        """The parts of a difference of two means that were judged by the same draws."""
        return Parts(self.first - other.first, self.second - other.second)


def judge(reference: Reference, belief: Gaussian, kept: Mask) -> tuple[Judgement, Parts | None]:
    """The KL of a belief from an oracle's, with its error, and the parts that groups have in that.

    belief: (*runs, T+1, d).
    kept: (T+1,): the steps at which both are proper.
    """
    found = Judgement.none(kept.size)
    if not kept.any():
        return found, None
    kl, error = found.kl_by_step.copy(), found.error_by_step.copy()
    oracle, own = reference.gaussian[..., kept], belief[..., kept]
    each = consistency.kl(oracle, own)
    kl[kept] = each.reshape(-1, each.shape[-1]).mean(axis=0)
    if reference.spread is None:
        error[kept] = reference.error
        return Judgement(kl, error, reference.error), None
    bias, variance, parts = _errors(reference, oracle, own, kept)
    kl[kept] -= bias
    error[kept] = reference.factor * np.sqrt(variance)
    return Judgement(kl, error, parts.error(reference.factor)), parts


def _errors(
    reference: Reference, oracle: Gaussian, belief: Gaussian, kept: Mask
) -> tuple[Array, Array, Parts]:
    """The biases and variances of mean KLs by step, (steps,), and the parts of groups in them."""
    spread = reference.spread
    assert spread is not None
    lead, size = belief.mean.shape[:-2], belief.mean.shape[-1]
    runs, steps = int(np.prod(lead)), int(kept.sum())
    shared = oracle.mean.ndim - 2 < len(lead)
    groups = len(spread.mean)
    tail, square = (steps, size), (steps, size, size)
    own = 1 if shared else runs
    means, covs = oracle.mean.reshape(own, *tail), oracle.cov.reshape(own, *square)
    shifts = spread.mean[..., kept, :].reshape(groups, own, *tail)
    squares = spread.cov[..., kept, :, :].reshape(groups, own, *square)
    others, wide = belief.mean.reshape(runs, *tail), belief.cov.reshape(runs, *square)
    bias, units = np.zeros(steps), list[Terms]()
    for run in range(runs):
        unit = 0 if shared else run
        offset = difference(means[unit], others[run], belief.angles)
        part = Spread(shifts[:, unit], squares[:, unit])
        terms = sampled.terms(offset, covs[unit], wide[run], part)
        bias += terms.bias / runs
        if shared and units:
            units[0] = Terms(units[0].first + terms.first, units[0].second + terms.second)
        else:
            units.append(terms)
    units = [Terms(each.first / runs, each.second / runs) for each in units]
    slope = np.sum([(each.first**2).sum(axis=0) for each in units], axis=0)
    variance = sampled.variance(slope, np.sum([each.curvature for each in units], axis=0))
    first = np.stack([each.first.mean(axis=-1) for each in units])
    second = np.stack([each.second.mean(axis=-1) for each in units])
    return bias, variance, Parts(first, second)


def mean_of_known(values: Array) -> float:
    """The mean of the entries that are not NaN; NaN if there are none."""
    known = values[~np.isnan(values)]
    return float(known.mean()) if known.size else np.nan
